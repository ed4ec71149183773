//! Demands that give way where they cannot be met exactly.

use super::common::{agrees_with_differences, channel, problem};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::program::Program;
use dynocal_calib::optimise::{DemandFrom, OptimiseOptions, Optimum, optimise_models, parts};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::model::poly::PolyNarx;

const N: usize = 60;
const CLOSED: usize = 20;

/// A burner behind a valve that is imposed: heat(t) = a(t-1) v(t-1).
fn heater() -> (CalibrationProblem, PolyNarx) {
    let problem = problem(
        r#"
        inputs = [{ name = "a", unit = "kW", lower = 0.0, upper = 9.0, increment_weight = 0.0 }]
        given = [{ name = "v", unit = "-", lower = 0.0, upper = 2.0 }]
        demands = [{ output = "heat", unit = "kW", lower = 0.0, upper = 10.0 }]
        minimise = [{ channel = "a", weight = 2.0 }]
        "#,
    );
    (problem, PolyNarx::parse(&["a", "v"], "heat", &["a(t-1)*v(t-1)"]).unwrap())
}

/// The valve is open as far as `closed` says at one sample, fully elsewhere; 5 kW are asked for.
fn record(closed: f64) -> Dataset {
    let mut v = vec![1.0; N];
    v[CLOSED] = closed;
    Dataset {
        name: "start".into(),
        sample_time_s: 1.0,
        channels: vec![
            channel("a", "kW", Role::Input, vec![4.0; N]),
            channel("v", "-", Role::Input, v),
            channel("heat", "kW", Role::Output, vec![5.0; N]),
        ],
        init_samples: 0,
        origin: "test".into(),
    }
}

fn solve(closed: f64, give: f64) -> Optimum {
    let (problem, heat) = heater();
    let model = OutputModel::plain("heat", &heat, &[1.0], &["a", "v"]);
    let options = OptimiseOptions { demand: DemandFrom::Record, give, ..OptimiseOptions::default() };
    optimise_models(&problem, &[model], &record(closed), &options, &|| false).unwrap()
}

/// Where the valve is shut nothing meets the demand: an exact search finds no way, one whose demands give way misses at this sample
/// alone, by all that is missing, and elsewhere by what the price of a demand is worth.
#[test]
fn a_demand_gives_way_only_where_it_must() {
    assert!(!solve(0.0, 0.0).status.is_success());
    let give = 1e-6;
    let found = solve(0.0, give);
    assert!(found.status.is_success());
    let a = found.input("a").unwrap();
    // At the optimum the price of a sample's demand is 2 / n, that of what it gives is s O / (n give range^2): s = 2 give range^2 / O,
    // with O = 2 x 4 kW at the start.
    let gives = 2.0 * give * 100.0 / 8.0;
    for t in (2..N - 1).filter(|t| *t != CLOSED) {
        assert!((a[t] - (5.0 - gives)).abs() < 1e-6, "a({t}) = {}", a[t]);
    }
    let violation = &found.violations[0];
    assert!((violation.largest - 5.0).abs() < 1e-9 && violation.at_s == Some((CLOSED + 1) as f64));
}

/// Where the exact search ends, nothing gives way.
#[test]
fn what_can_be_met_is_met_exactly() {
    let (exact, found) = (solve(0.7, 0.0), solve(0.7, 1e-3));
    assert!(exact.status.is_success());
    assert_eq!(exact.inputs, found.inputs);
    assert!(found.violation("heat") < 1e-6);
}

#[test]
fn derivatives_with_give_are_exact() {
    let (problem, heat) = heater();
    let model = OutputModel::plain("heat", &heat, &[1.0], &["a", "v"]);
    let options = OptimiseOptions { demand: DemandFrom::Record, ..OptimiseOptions::default() };
    let record = record(0.3);
    let mut parts = parts(&problem, &[model], &record, &options).unwrap();
    parts.rows[0].give = (0..N).map(|t| 1.0 + 0.1 * t as f64).collect();
    agrees_with_differences(&mut Program::new(parts));
}
