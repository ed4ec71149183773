use super::super::{ActuatorPort, Port};
use super::*;
use dynocal_numerics::interval::Interval;

fn ports() -> Ports {
    let port = |name: &str, unit: &str| Port { name: name.into(), unit: unit.into() };
    let actuator =
        |name: &str, lower| ActuatorPort { name: name.into(), unit: "-".into(), lower, upper: 90.0 };
    Ports {
        demands: vec![port("torque", "Nm"), port("lambda", "-")],
        given: vec![port("speed", "rpm")],
        actuators: vec![actuator("inj", 0.0), actuator("spark", -90.0), actuator("throttle", -90.0)],
    }
}

fn record(n: usize) -> Rows {
    let mut rows = Rows::new(3);
    for t in 0..n {
        let t = t as f64 * 0.03;
        rows.push(&[
            50.0 + 30.0 * (1.1 * t).sin() + 8.0 * (4.3 * t).cos(),
            1.0 + 0.05 * (2.3 * t).sin(),
            2000.0 + 900.0 * (0.37 * t).cos(),
        ]);
    }
    rows
}

/// A plant that lies in the structure is recovered exactly.
#[test]
fn recovers_actuators_that_lie_in_the_structure() {
    let shape = StructuredShape { ridge: Some(0.0), ..Default::default() };
    let r = record(2000);
    let mut u = Rows::new(3);
    for t in 0..r.len() {
        let ahead = r.row((t + 4).min(r.len() - 1))[0] - r.row(t)[0];
        let (torque, i) = (r.row(t)[0], 2000.0 / r.row(t)[2]);
        u.push(&[
            4.0 + 0.18 * torque + 0.05 * ahead,
            25.0 - 0.1 * torque * i,
            5.0 + 0.2 * torque + 0.3 * ahead * i,
        ]);
    }
    let (mut response, mut actuators) = (r.clone(), u.clone());
    response.truncate(1900);
    actuators.truncate(1900);
    let map = StructuredMap::fit(&shape, &ports(), &[Pairs { response: &response, actuators: &actuators }])
        .unwrap();
    let mut got = [0.0; 3];
    for t in [50, 400, 1500, 1950] {
        map.at(&r, t, &mut got);
        for c in 0..3 {
            assert!((got[c] - u.row(t)[c]).abs() < 1e-6, "sample {t}, actuator {c}: {got:?} {:?}", u.row(t));
        }
    }
}

/// In steady state only the static part speaks, whatever the difference coefficients are.
#[test]
fn differences_vanish_in_steady_state() {
    let spans = [(10.0, 90.0), (0.9, 1.1), (1000.0, 3000.0)].map(Interval::from);
    let scales: Vec<Scale> = spans.iter().map(|s| Scale::of_range(*s)).collect();
    let terms = terms::terms(&ports(), &scales, &StructuredShape::default());
    let c: Vec<f64> = terms
        .iter()
        .enumerate()
        .map(|(k, t)| match (k, t.difference) {
            (0, _) => 3.0,
            (1, _) => 2.0,
            (_, Some(_)) => 1e3,
            _ => 0.0,
        })
        .collect();
    let map = StructuredMap {
        ports: ports(),
        look_ahead: 4,
        filter_s: vec![vec![0.12, 0.15], vec![]],
        scales,
        terms,
        coefficients: vec![c.clone(), c.clone(), c],
        region: spans.to_vec(),
    };
    let demand = Rows::from_values(3, [50.0, 1.0, 1500.0].repeat(60));
    // T is 50 Nm in units of the middle of its range, 50 Nm.
    assert!(map.drive(&demand, 0.03).iter().all(|u| (u[0] - 5.0).abs() < 1e-9));
}

/// The thesis' problem has the 18 static terms and 39 differences of the published comparison, each once.
#[test]
fn terms_are_those_of_the_roles_each_once() {
    let scales: Vec<Scale> = [(10.0, 90.0), (0.95, 1.05), (1000.0, 3000.0)]
        .map(Interval::from)
        .iter()
        .map(|s| Scale::of_range(*s))
        .collect();
    let terms = terms::terms(&ports(), &scales, &StructuredShape::default());
    let (differences, fixed): (Vec<_>, Vec<_>) = terms.iter().partition(|t| t.difference.is_some());
    assert_eq!((fixed.len(), differences.len()), (18, 6 * 4 + 3 * 3 + 3));
    for (k, t) in terms.iter().enumerate() {
        assert!(!terms[..k].contains(t), "{}", t.name(&ports()));
    }
}
