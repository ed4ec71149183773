//! What is made of maps: their inverses, and what they miss.

use dynocal_calib::map::static_map::{StaticMap, StaticPoint};
use dynocal_calib::map::{ActuatorPort, Port, Ports};
use dynocal_calib::steady::day::Purpose;
use dynocal_jobs::map::Mapped;
use dynocal_jobs::map::drive::Drive;
use dynocal_jobs::map::inverse::of;

use super::engine::{Bench, DAY, Fault, run_with};

/// Two speeds, u = f(torque, speed) at three torques.
fn map(values: [[f64; 2]; 3]) -> StaticMap {
    let port = |name: &str, unit: &str| Port { name: name.into(), unit: unit.into() };
    let demand = vec![20.0, 40.0, 60.0];
    let given = vec![1000.0, 2000.0];
    let point = |d: usize, g: usize| StaticPoint {
        demand: demand[d],
        given: given[g],
        actuators: vec![values[d][g]],
        errors: Vec::new(),
        objective: 0.0,
        missed: String::new(),
    };
    StaticMap {
        ports: Ports {
            demands: vec![port("torque", "Nm")],
            given: vec![port("speed", "rpm")],
            actuators: vec![ActuatorPort {
                name: "throttle".into(),
                unit: "deg".into(),
                lower: 0.0,
                upper: 60.0,
            }],
        },
        points: (0..6).map(|k| point(k / 2, k % 2)).collect(),
        demand,
        given,
        bed_s: 0.0,
    }
}

/// u = torque / 4 at 1000 rpm and torque / 2 at 2000 rpm: the inverse is 4 u and 2 u, held at the ends of the columns.
#[test]
fn a_plane_is_inverted_exactly() {
    let found = of(&map([[5.0, 10.0], [10.0, 20.0], [15.0, 30.0]]), "throttle").unwrap();
    assert!(found.inputs == [5.0, 10.0, 15.0, 20.0, 30.0] && found.several.is_empty());
    for (u, row) in found.inputs.iter().zip(found.values.chunks(2)) {
        assert!(
            (row[0] - (4.0 * u).min(60.0)).abs() < 1e-12 && (row[1] - (2.0 * u).max(20.0)).abs() < 1e-12,
            "{u} {row:?}"
        );
    }
    assert!(found.error < 1e-12, "{}", found.error);
    let csv = found.csv();
    assert!(
        csv.starts_with("throttle [deg],torque at speed 1000 rpm [Nm],torque at speed 2000 rpm [Nm]\n"),
        "{csv}"
    );
    assert!(csv.contains("10.000000,40.000000,20.000000"), "{csv}");
}

/// A column that falls again has two torques for one throttle: the lower one is given, and the speed is named.
#[test]
fn what_has_two_inverses_is_named() {
    let found = of(&map([[5.0, 10.0], [15.0, 20.0], [10.0, 30.0]]), "throttle").unwrap();
    assert_eq!(found.several, [1000.0]);
    let at_ten = found.inputs.iter().position(|u| *u == 10.0).unwrap();
    assert!((found.values[2 * at_ten] - 30.0).abs() < 1e-12, "{found:?}");
    assert!(of(&map([[5.0; 2]; 3]), "throttle").is_none() && of(&map([[5.0; 2]; 3]), "spark").is_none());
}

/// What was not reached has no part in the inverse, and columns that go through other values of the input are each kept at their ends: throttles of 6 to 17 deg at one
/// speed and of 15 to 58 at the other.
#[test]
fn an_inverse_is_as_good_at_the_ends_of_every_column() {
    let mut of_two = map([[6.0, 15.0], [8.7, 19.0], [17.0, 58.0]]);
    let found = of(&of_two, "throttle").unwrap();
    assert!(found.error <= 0.2, "{found:?}");
    let at = |found: &dynocal_jobs::map::inverse::Inverse, u: f64, g: usize| {
        let i = found.inputs.iter().position(|v| *v == u).unwrap();
        found.values[2 * i + g]
    };
    for (u, g, y) in [(6.0, 0, 20.0), (17.0, 0, 60.0), (15.0, 1, 20.0), (58.0, 1, 60.0)] {
        assert!((at(&found, u, g) - y).abs() <= 0.2, "{u} {y} {found:?}");
    }
    // A cell that was filled says 16 deg where less is asked for at 1000 rpm.
    of_two.points[4].actuators[0] = 5.0;
    of_two.points[4].missed = "filled from its neighbours".into();
    let found = of(&of_two, "throttle").unwrap();
    assert!(found.several.is_empty() && (at(&found, 58.0, 0) - 40.0).abs() < 1e-9, "{found:?}");
}

/// The worst of what is known is what the map of a driven input misses: on points, between the lines, along them, in the verification.
#[test]
fn what_was_measured_along_lines_and_in_the_verification_counts() {
    let day = format!("{DAY}[bed.sweep]\npass_s = 20.0\n");
    let found = run_with(&day, 4, Bench::new(0.5, Fault::None)).unwrap();
    let d = &found.drives[0];
    let t = d.trimmed.as_ref().unwrap();
    assert!(!d.rough() && t.held < 0.02 && d.words().contains("scatters by"), "{}", d.words());
    // What the verification says is the rms of what its deviations do to the torque.
    let measured = found.verified.iter().filter(|v| v.measured);
    let misses: Vec<f64> =
        measured.filter_map(|v| v.deviations.iter().find(|d| d.response == "load")?.at_demand).collect();
    let rms = (misses.iter().map(|m| m * m).sum::<f64>() / misses.len() as f64).sqrt();
    assert!(misses.len() > 4 && (d.verified.unwrap() - rms).abs() < 1e-12, "{misses:?} {:?}", d.verified);
    // The load goes nearly with the torque: its slope is about 1, and a miss of one is about a miss of the other.
    for v in found.verified.iter().filter(|v| v.measured) {
        let load = v.deviations.iter().find(|d| d.response == "load").unwrap();
        let (share, told) = ((load.measured / load.promised).ln(), load.at_demand.unwrap());
        assert!(share.abs() < 1e-9 || (0.6..1.4).contains(&(told / share)), "{share} {told}");
    }
    let says = |change: &dyn Fn(&mut Drive)| {
        let mut other = d.clone();
        change(&mut other);
        (other.rough(), other.missed())
    };
    assert_eq!(says(&|d| d.verified = Some(0.08)), (true, "8.0 %".to_string()));
    assert_eq!(says(&|d| d.trimmed.as_mut().unwrap().held = 0.07), (true, "7.0 %".to_string()));
    assert_eq!(says(&|d| d.trimmed.as_mut().unwrap().between = Some(0.06)), (true, "6.0 %".to_string()));
    // The error on points counts where there are no lines that tell more.
    assert!(says(&|d| (d.trimmed, d.error) = (None, 0.09)).0 && !says(&|d| d.error = 0.09).0);
}

/// A verification point that has not come to rest is waited for once more, where points and bed time are left; what it says then counts.
#[test]
fn a_verification_point_that_does_not_rest_is_measured_again() {
    // 40 planned points, 5 repeats and 8 to verify leave one of 54.
    let day = format!("{DAY}[bed.refine]\nshare = 0.0\n");
    let run = |fault| run_with(&day, 1, Bench::new(0.0, fault)).unwrap();
    let quiet = run(Fault::None);
    let verify = |m: &Mapped| -> Vec<(bool, f64)> {
        let of = m.points.iter().filter(|p| p.purpose == Purpose::Verify);
        of.map(|p| (p.point.usable, p.point.at_s - p.point.used_s)).collect()
    };
    let first = verify(&quiet);
    assert!(quiet.points.len() < 54 && first.len() == 8, "{}", quiet.points.len());
    // Torque swings while the first of them is held, and no longer.
    let swung = run(Fault::SwingsIn(first[0].1, first[0].1 + 21.0));
    let again = verify(&swung);
    assert!(again.len() == 9 && !again[0].0 && again[1..].iter().all(|p| p.0), "{again:?}");
    assert!(
        swung.verified.len() == 8 && swung.verified.iter().all(|v| v.measured && v.kept),
        "{:?}",
        swung.warnings
    );
    assert!(swung.valid, "{}", swung.verdict);
}
