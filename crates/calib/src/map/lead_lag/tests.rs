use super::super::{ActuatorPort, Port};
use super::search::{LONGEST_S, STEPS};
use super::*;

fn ports() -> Ports {
    let port = |name: &str| Port { name: name.into(), unit: "-".into() };
    let actuator = |name: &str| ActuatorPort { name: name.into(), unit: "-".into(), lower: -1e3, upper: 1e3 };
    Ports {
        demands: vec![port("torque"), port("lambda")],
        given: vec![port("speed")],
        actuators: ["inj", "throttle"].map(actuator).to_vec(),
    }
}

/// Tables of a function that bilinear interpolation gives exactly, without dynamics.
fn map(inj: impl Fn(f64, f64) -> f64) -> LeadLagMap {
    let (demand, given) = (vec![10.0, 50.0, 90.0], vec![1000.0, 2000.0, 3000.0]);
    let cells = |f: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
        demand.iter().flat_map(|t| given.iter().map(move |n| (*t, *n))).map(|(t, n)| f(t, n)).collect()
    };
    let tables = |base: Vec<f64>| ActuatorTables {
        slopes: vec![vec![-20.0; base.len()]],
        lag_s: vec![0.0; base.len()],
        law: LagLaw::NONE,
        base,
    };
    let actuators = vec![tables(cells(&inj)), tables(cells(&|t, _| 0.2 * t))];
    LeadLagMap {
        ports: ports(),
        region: [(10.0, 90.0), (0.9, 1.1), (1000.0, 3000.0)].map(Interval::from).to_vec(),
        others: vec![OtherReference { place: 1, rest: 1.0 }],
        demand,
        given,
        actuators,
        loss: Vec::new(),
        steps: None,
    }
}

/// Torque steps from 30 to 70 Nm at 1500 rpm.
fn step() -> Rows {
    let mut rows = Rows::new(3);
    (0..300).for_each(|t| rows.push(&[if t < 20 { 30.0 } else { 70.0 }, 1.0, 1500.0]));
    rows
}

#[test]
fn lead_and_lag_have_their_exact_step_response() {
    let law = LagLaw { tau_s: 0.2, by_given: 1.0, by_demand: 0.5, lead: 0.25 };
    let map = map(|t, _| 0.2 * t).with(&[(0, law)]);
    let drive = map.drive(&step(), 0.03);
    // Bilinear between the breakpoints: 70 Nm lies half-way from 50 to 90 Nm, 1500 rpm from 1000 to 2000 rpm.
    let tau = |t: f64, n: f64| 0.2 * (2000.0 / n) * (t / 50.0).sqrt();
    let tau = 0.25
        * [(50.0, 1e3), (50.0, 2e3), (90.0, 1e3), (90.0, 2e3)].map(|(t, n)| tau(t, n)).iter().sum::<f64>();
    for k in [1, 2, 10, 40] {
        let left = (-0.03 * f64::from(k) / tau).exp();
        let exact = 6.0 + 8.0 * (1.0 - left) + 0.25 * 8.0 * left;
        let got = drive.row(19 + k as usize)[0];
        assert!((got - exact).abs() < 1e-12, "{k}: {got} {exact}");
    }
    assert_eq!(drive.column(1)[20], 14.0);
    // At rest the tables alone speak, with the slope over lambda.
    assert!((drive.row(299)[0] - map.steady(&[70.0, 1.0, 1500.0])[0]).abs() < 1e-6);
    assert!((map.steady(&[70.0, 1.05, 1500.0])[0] - 13.0).abs() < 1e-12);
    assert!((map.steady(&[70.0, 9.0, 1500.0])[0] - 12.0).abs() < 1e-12, "lambda is held in its region");
}

#[test]
fn points_at_rest_move_the_tables() {
    let truth = |t: f64, n: f64| 3.0 + 0.19 * t + 800.0 / n + 1e-4 * t * t;
    let start = map(|t, n| 3.2 + 0.2 * t + 800.0 / n);
    let points: Vec<SteadyPoint> = (0..25)
        .map(|k| {
            let (t, n) = (12.0 + 19.0 * f64::from(k / 5), 1050.0 + 475.0 * f64::from(k % 5));
            // What the tables know of 800/n between their breakpoints is the same on either side.
            let known = start.steady(&[t, 1.0, n])[0] - (3.2 + 0.2 * t);
            SteadyPoint {
                reference: vec![t, 1.0, n],
                actuators: vec![truth(t, n) - 800.0 / n + known, 0.2 * t],
            }
        })
        .collect();
    let moved = start.anchored(&points).unwrap();
    for (t, n) in [(50.0, 2000.0), (50.0, 1000.0)] {
        let got = moved.steady(&[t, 1.0, n]);
        let edge = n.max(1050.0);
        let miss = truth(t, edge) - (3.2 + 0.2 * t + 800.0 / edge);
        assert!((got[0] - start.steady(&[t, 1.0, n])[0] - miss).abs() < 1e-3, "{t} {n}: {got:?}");
        assert!((got[1] - 0.2 * t).abs() < 1e-9);
    }
}

/// Who follows gets dynamics that are nearer to what the judge asks for than any lag without powers and lead; who leads acts at once.
#[test]
fn dynamics_are_those_that_the_judge_likes_best() {
    let start = map(|t, _| 0.2 * t);
    let wanted = LagLaw { tau_s: 0.14, by_given: 1.4, by_demand: 0.1, lead: 0.1 };
    let target = start.with(&[(0, wanted)]);
    let mut rows = step();
    (0..300).for_each(|t| rows.push(&[if t < 100 { 20.0 } else { 80.0 }, 1.0, 2800.0]));
    (0..300).for_each(|t| rows.push(&[if t < 100 { 30.0 } else { 60.0 }, 1.0, 1100.0]));
    let asked = target.drive(&rows, 0.03);
    let judge = |m: &dyn FeedforwardMap| {
        let got = m.drive(&rows, 0.03);
        got.iter().zip(asked.iter()).map(|(a, b)| (a[0] - b[0]).abs()).sum::<f64>()
    };
    let tuned = start.tuned(&judge, 1).unwrap();
    let plain = (0..=STEPS).map(|k| LONGEST_S * f64::from(k) / f64::from(STEPS));
    let plain = plain.map(|tau_s| judge(&start.with(&[(0, LagLaw { tau_s, ..LagLaw::NONE })])));
    assert!(judge(&*tuned) < plain.fold(f64::INFINITY, f64::min));
    assert_eq!(
        tuned.drive(&rows, 0.03).column(1),
        start.drive(&rows, 0.03).column(1),
        "who leads acts at once"
    );
    assert!(start.tuned(&|_| f64::NAN, 1).is_none());
}

/// A plant that is a lag of the leading actuator: its exact inverse is a lead. What is judged is better than without one, and at rest
/// nothing has moved; where the plant is at once, no lead pays.
#[test]
fn a_leader_goes_ahead_where_its_plant_is_behind() {
    let start = map(|t, _| 0.2 * t);
    let rows = step();
    let behind = |tau_s: f64| {
        let rows = rows.clone();
        move |m: &dyn FeedforwardMap| {
            let got = m.drive(&rows, 0.03);
            let mut state = FirstOrder::new(got.row(0)[1]);
            let error = |(g, r): (&[f64], &[f64])| (state.step(g[1], 0.03, tau_s) - 0.2 * r[0]).abs();
            got.iter().zip(rows.iter()).map(error).sum::<f64>()
        }
    };
    let judge = behind(0.2);
    let wide = Interval { lower: -1e3, upper: 1e3 };
    let led = start.led(&judge, 1, wide).unwrap();
    let (with, without) = (judge(&*led), judge(&start));
    assert!(with < 0.5 * without, "{with} {without}");
    let (drive, plain) = (led.drive(&rows, 0.03), start.drive(&rows, 0.03));
    let (a, b) = (drive.row(drive.len() - 1), plain.row(plain.len() - 1));
    assert!((a[1] - b[1]).abs() < 1e-3 && a[0] == b[0], "{a:?} {b:?}");
    let most = drive.column(1).into_iter().fold(0.0, f64::max);
    assert!(most > 1.2 * b[1], "{most}");
    assert!(start.led(&behind(0.0), 1, wide).is_none());
    // On its way it stays within a range, but where it rests beyond it.
    let narrow = start.led(&judge, 1, Interval { lower: 3.0, upper: 15.0 }).unwrap();
    let way = narrow.drive(&rows, 0.03).column(1);
    let most = way.iter().copied().fold(0.0, f64::max);
    assert!((most - 0.2 * 90.0).abs() < 1e-9, "{most}: the tables rest at 18 at most");
}

#[test]
fn tables_are_multiples_of_their_steps() {
    let mut map = map(|t, n| 0.2123 * t + 1e-3 * n);
    assert!(map.in_steps().is_none(), "nothing was asked for");
    map.actuators[0].lag_s = vec![0.0971; 9];
    map.steps = Some(Steps { actuators: vec![0.25, 0.0], lag_s: 0.02, rounding: Vec::new() });
    let rounded = map.in_steps().unwrap();
    let multiple = |v: f64, step: f64| ((v / step).round() - v / step).abs() < 1e-9;
    assert!(rounded.actuators[0].base.iter().all(|v| multiple(*v, 0.25)));
    assert!(rounded.actuators[0].lag_s.iter().all(|v| (v - 0.1).abs() < 1e-12));
    // A slope of one step is a quarter of an mg over the range of lambda, 0.2.
    assert!(rounded.actuators[0].slopes[0].iter().all(|v| multiple(*v, 0.25 / 0.2)));
    // No step of the other one.
    assert_eq!(rounded.actuators[1].base, map.actuators[1].base);
    // By what the base changes, and the slopes at the far end of lambda, 0.1 from its rest.
    let range = map.actuators[0].base[8] - map.actuators[0].base[0];
    let slope = (rounded.actuators[0].slopes[0][0] + 20.0).abs() * 0.1;
    let most =
        map.actuators[0].base.iter().zip(&rounded.actuators[0].base).map(|(a, b)| (a - b).abs() + slope);
    let most = most.fold(0.0, f64::max);
    let said = rounded.steps.as_ref().unwrap().rounding.clone();
    assert!((said[0] - most / range).abs() < 1e-12 && most > 0.0 && said[1] == 0.0, "{said:?}");
    // In decimals, and inside the limits of the actuator.
    map.steps = Some(Steps { actuators: vec![0.05, 0.0], lag_s: 0.05, rounding: Vec::new() });
    (map.actuators[0].base[0], map.actuators[0].lag_s[0]) = (0.349, 0.151);
    let rounded = map.in_steps().unwrap();
    assert_eq!((rounded.actuators[0].base[0], rounded.actuators[0].lag_s[0]), (0.35, 0.15));
    map.ports.actuators[0].lower = 0.36;
    assert_eq!(map.in_steps().unwrap().actuators[0].base[0], 0.4);
    // Once more changes nothing.
    assert_eq!(rounded.in_steps().unwrap().actuators, rounded.actuators);
}

#[test]
fn steps_of_nothing_are_refused() {
    use super::super::structures::MapStructure;
    let shape = |name: &str, step| LeadLagShape {
        resolution: [(name.to_string(), step)].into(),
        ..LeadLagShape::default()
    };
    let said = |shape: &LeadLagShape| {
        let mut faults = Faults::default();
        shape.check(&ports(), "invert.shape", &mut faults);
        format!("{faults:?}")
    };
    assert!(said(&shape("spark", 0.5)).contains("invert.shape.resolution.spark"));
    for step in [-0.5, 0.0, f64::NAN, 1e-320, 1e300] {
        assert!(said(&shape("inj", step)).contains("a millionth and a tenth of its range"), "{step}");
    }
    assert_eq!(said(&shape("inj", 0.5)), said(&LeadLagShape::default()));
}
