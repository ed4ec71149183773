//! A bed that starts at the first values of a record is at rest there.

use dynocal_ident::plant::Plant;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_plant::testbed::settings::BedOptions;

/// The bed of a set with `bed`, started at `first`; its inputs by name.
fn bed(set: &str, text: &str, first: &[(&str, f64)]) -> EngineBed {
    let params = EngineParams::named(set).expect("a set");
    let table: toml::Table = toml::from_str(text).expect("a table");
    let options = BedOptions::from_table(set, &table).expect("a bed");
    let settings = BedSettings { options, ..BedSettings::of_set(set, &params).expect("a bed of the set") };
    let value = |name: &str| first.iter().find(|f| f.0 == name).map(|f| f.1);
    EngineBed::new(&params, settings.at_first(&params, &value).expect("a start")).expect("a bed")
}

#[test]
fn a_wastegate_that_is_an_input_starts_where_it_is_asked_for() {
    let text = "real = true\ninputs = [\"wastegate\"]\noutputs = [\"wastegate_bore\"]\n";
    let mut b = bed("gtdi_2l", text, &[("wastegate", 6.0)]);
    let start = b.variables().iter().find(|v| v.name == "wastegate").expect("an input").start;
    assert_eq!(start, 6.0);
    let u: Vec<f64> = b.variables().iter().take(5).map(|v| v.start).collect();
    let mut y = [0.0; 6];
    b.step(&u, 0.01, &mut y).expect("a step");
    assert!((y[5] - 6.0).abs() < 1e-9, "{y:?}");
}

#[test]
fn a_loop_of_lambda_starts_at_its_demand() {
    let first = [("lambda_demand", 1.1), ("throttle", 20.0), ("speed", 3000.0)];
    for set in ["thesis", "gtdi_2l"] {
        let mut b = bed(set, "real = false\n[loops]\nlambda = true\n", &first);
        let mut u: Vec<f64> = b.variables().iter().take(4).map(|v| v.start).collect();
        u[0] = 1.1;
        let mut y = [0.0; 5];
        b.step(&u, 0.01, &mut y).expect("a step");
        assert!((y[1] - 1.1).abs() < 0.01, "{set}: lambda {}", y[1]);
    }
}
