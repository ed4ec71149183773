//! Every row of the table of map structures: fitted, kept in a file, read back, it drives as before.

use dynocal_calib::map::structures::{FitTask, MAP_STRUCTURES, Pairs, StoredMap};
use dynocal_calib::map::{ActuatorPort, Port, Ports, Rows};

fn ports() -> Ports {
    let port = |name: &str, unit: &str| Port { name: name.into(), unit: unit.into() };
    let actuator =
        |name: &str, lower| ActuatorPort { name: name.into(), unit: "-".into(), lower, upper: 90.0 };
    Ports {
        demands: vec![port("torque", "Nm"), port("lambda", "-")],
        given: vec![port("speed", "rpm")],
        actuators: vec![actuator("inj", 0.0), actuator("spark", -90.0), actuator("throttle", 0.0)],
    }
}

/// References that go up and down, and actuators that follow a torque some samples ahead.
fn record(n: usize, phase: f64) -> (Rows, Rows) {
    let mut references = Rows::new(3);
    for t in 0..n {
        let t = t as f64 * 0.03 + phase;
        references.push(&[
            50.0 + 25.0 * (1.1 * t).sin() + 8.0 * (4.3 * t).cos(),
            1.0 + 0.05 * (2.3 * t).sin(),
            2000.0 + 900.0 * (0.37 * t).cos(),
        ]);
    }
    let mut actuators = Rows::new(3);
    for t in 0..n {
        let ahead = references.row((t + 6).min(n - 1))[0];
        let (lambda, i) = (references.row(t)[1], 2000.0 / references.row(t)[2]);
        actuators.push(&[4.0 + 0.18 * ahead / lambda, 25.0 - 0.1 * ahead * i, 5.0 + 0.2 * ahead]);
    }
    (references, actuators)
}

#[test]
fn every_structure_is_fitted_kept_and_read_back() {
    let (ports, data) = (ports(), [record(1500, 0.0), record(1500, 70.0)]);
    let pairs: Vec<Pairs> = data.iter().map(|(r, a)| Pairs { response: r, actuators: a }).collect();
    let unseen = record(600, 300.0).0;
    for row in MAP_STRUCTURES {
        assert!((row.fits)(&ports), "{}", row.doc.name);
        let task = FitTask { ports: &ports, pairs: &pairs, seed: 1, interrupt: &|| false };
        let fitted = (row.build)(&toml::Table::new()).unwrap().fit(&task).unwrap();
        assert!(fitted.scores.len() >= ports.actuators.len());
        let map = fitted.map.unwrap_or_else(|| panic!("{} found no map", row.doc.name));
        assert_eq!(map.structure(), row.doc.name);
        let text = serde_json::to_string(&map).unwrap();
        let again: StoredMap = serde_json::from_str(&text).unwrap();
        let (a, b) = (map.drive(&unseen, 0.03), again.drive(&unseen, 0.03));
        assert_eq!(a.values(), b.values(), "{}", row.doc.name);
        // Within limits, and at rest where it says that it rests.
        for (c, port) in ports.actuators.iter().enumerate() {
            assert!(a.iter().all(|u| u[c] >= port.lower && u[c] <= port.upper));
        }
        let held = Rows::from_values(3, [60.0, 1.0, 1800.0].repeat(600));
        let end = map.drive(&held, 0.03);
        for (u, rest) in end.row(599).iter().zip(map.steady(&[60.0, 1.0, 1800.0])) {
            assert!((u - rest).abs() < 1e-6 * (1.0 + rest.abs()), "{}: {u} {rest}", row.doc.name);
        }
    }
}

/// Files of the version before had no name of a structure: they hold the structured inverse.
#[test]
fn maps_of_the_version_before_are_read() {
    let ports = ports();
    let data = record(1500, 0.0);
    let pairs = [Pairs { response: &data.0, actuators: &data.1 }];
    let task = FitTask { ports: &ports, pairs: &pairs, seed: 1, interrupt: &|| false };
    let map = (MAP_STRUCTURES[0].build)(&toml::Table::new()).unwrap().fit(&task).unwrap().map.unwrap();
    let mut text = serde_json::to_value(&map).unwrap();
    assert!(text.as_object_mut().unwrap().remove("structure").is_some());
    let again: StoredMap = serde_json::from_value(text.clone()).unwrap();
    assert_eq!(again.structure(), "structured");
    text["structure"] = "tables".into();
    let fault = serde_json::from_value::<StoredMap>(text).unwrap_err().to_string();
    assert!(fault.contains("tables") && fault.contains("published_7_18"), "{fault}");
}

/// Keys that no structure takes, and channels for which one is not made.
#[test]
fn what_a_structure_does_not_take_is_refused() {
    for row in MAP_STRUCTURES {
        let keys: toml::Table = toml::from_str("nonsense = 1").unwrap();
        let fault = (row.build)(&keys).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(fault.contains("nonsense") && fault.contains(row.doc.name), "{fault}");
    }
    let mut other = ports();
    other.actuators.pop();
    assert!(!(MAP_STRUCTURES[1].fits)(&other) && (MAP_STRUCTURES[0].fits)(&other));
}
