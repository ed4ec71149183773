//! Dynamic programming as a way: against the batch, against sums that are known, and what it refuses.

use crate::common::{channel, problem};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{Dynamic, OptimiseError, OptimiseOptions, Optimum, Way, optimise_models};
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_numerics::status::Status;

fn record(n: usize, u: f64, y: f64) -> Dataset {
    let channels =
        vec![channel("u", "-", Role::Input, vec![u; n]), channel("y", "-", Role::Output, vec![y; n])];
    Dataset { name: "start".into(), sample_time_s: 0.1, channels, init_samples: 0, origin: "test".into() }
}

fn solve(
    text: &str,
    regressors: &[&str],
    theta: &[f64],
    start: &Dataset,
    way: Way,
) -> Result<Optimum, OptimiseError> {
    let y = PolyNarx::parse(&["u"], "y", regressors).expect("structure");
    let models = [OutputModel::plain("y", &y, theta, &["u"])];
    let options = OptimiseOptions { way, ..OptimiseOptions::default() };
    optimise_models(&problem(text), &models, start, &options, &|| false)
}

fn grid(cells: usize) -> Way {
    Way::Dynamic(Dynamic { cells: Some(cells), price: None })
}

const ONE: &str = r#"
    minimise = [{ channel = "u2" }, { channel = "y", weight = -1.0 }]
    inputs = [{ name = "u", unit = "-", lower = 0.0, upper = 0.8 }]
    limits = [{ output = "y", unit = "-" }]
    derive = [{ name = "u2", unit = "-", powers = { u = 2 } }]
"#;
const BENT: [&str; 3] = ["y(t-1)", "y(t-1)^2", "u(t-1)"];

/// y(t) = 0.9 y(t-1) - 0.05 y(t-1)^2 + u(t-1): the batch is within the error that the grid says, which falls to a quarter from
/// one grid to the next; and the way along the grid costs what its value says.
#[test]
fn one_remembered_value_agrees_with_the_batch_within_the_error_that_is_said() {
    let start = record(40, 0.3, 0.5);
    let of = |way| solve(ONE, &BENT, &[0.9, -0.05, 1.0], &start, way).expect("set up");
    let batch = of(Way::default());
    assert_eq!(batch.status, Status::Converged);
    let mut errors = Vec::new();
    for cells in [100, 200, 400] {
        let found = of(grid(cells));
        assert_eq!(found.status, Status::Converged);
        let by_grid = found.grid.clone().expect("grid");
        assert_eq!((by_grid.cells, by_grid.remembered.as_slice()), (cells, ["y(t)".to_string()].as_slice()));
        println!(
            "{cells}: {:.9} to {:.1e}, way {:.9}, batch {:.9}",
            by_grid.objective, by_grid.error, found.objective, batch.objective
        );
        assert!(by_grid.error > 1e-9, "the grids do not differ: the case shows nothing");
        assert!(
            (by_grid.objective - batch.objective).abs() <= by_grid.error,
            "{by_grid:?} {}",
            batch.objective
        );
        // A way that inputs really go costs no less than the optimum.
        assert!(found.objective > batch.objective - 1e-7, "{} {}", found.objective, batch.objective);
        assert!(found.objective - batch.objective <= by_grid.error, "{} {by_grid:?}", found.objective);
        errors.push(by_grid.error);
    }
    assert!(errors.windows(2).all(|e| e[1] < 0.4 * e[0]), "{errors:?}");
}

/// The same with a rate limit: what is remembered are the output and the input before. And with an output limit that is soft.
#[test]
fn a_rate_limit_is_a_second_remembered_value_and_a_limit_is_kept() {
    let start = record(25, 0.3, 0.5);
    let text = ONE
        .replace("upper = 0.8 }", "upper = 0.8, rate_per_s = 0.5 }")
        .replace(r#"{ output = "y", unit = "-" }"#, r#"{ output = "y", unit = "-", upper = 2.0 }"#);
    let of = |way| solve(&text, &BENT, &[0.9, -0.05, 1.0], &start, way).expect("set up");
    let (batch, found) = (of(Way::default()), of(grid(60)));
    assert_eq!((batch.status, found.status), (Status::Converged, Status::Converged));
    let by_grid = found.grid.clone().expect("grid");
    assert_eq!(by_grid.remembered, ["u(t-1)", "y(t)"]);
    println!(
        "{:.7} to {:.1e}, way {:.7}, batch {:.7}, {:?}",
        by_grid.objective, by_grid.error, found.objective, batch.objective, found.violations
    );
    assert!((by_grid.objective - batch.objective).abs() <= by_grid.error, "{by_grid:?} {}", batch.objective);
    // Both limits act in the batch, so that the case shows something; the rate is kept exactly, the limit as well as the grid can.
    let u = batch.input("u").expect("u");
    assert!(u.windows(2).any(|w| (w[1] - w[0]).abs() > 0.05 - 1e-6), "{u:?}");
    assert!(batch.outputs[0].values.iter().any(|y| *y > 2.0 - 1e-5));
    let rate = found.violations.iter().find(|v| v.of == "rate").expect("rate");
    assert!(rate.largest < 1e-9, "{rate:?}");
    assert!(found.violation("y") < 0.01, "{:?}", found.violations);
}

/// u^4 - 2 u^2 + 0.2 u per sample and y(t) = u(t-1) + 0.5 y(t-1): from a start in the upper minimum the grid finds the lower one, which
/// a local search does not.
#[test]
fn a_grid_has_no_start_to_stay_at() {
    let text = r#"
        minimise = [{ channel = "u4" }, { channel = "u2", weight = -2.0 }, { channel = "u", weight = 0.2 }]
        inputs = [{ name = "u", unit = "-", lower = -2.0, upper = 2.0 }]
        limits = [{ output = "y", unit = "-" }]
        derive = [{ name = "u2", unit = "-", powers = { u = 2 } }, { name = "u4", unit = "-", powers = { u = 4 } }]
    "#;
    let start = record(20, 1.0, 2.0);
    let of = |way| solve(text, &["u(t-1)", "y(t-1)"], &[1.0, 0.5], &start, way).expect("set up");
    let value = |u: f64| u.powi(4) - 2.0 * u * u + 0.2 * u;
    let root = (0..50).fold(-1.0f64, |u, _| u - (4.0 * u.powi(3) - 4.0 * u + 0.2) / (12.0 * u * u - 4.0));
    assert!(of(Way::default()).objective > value(root) + 0.1);
    assert!((of(grid(20)).objective - value(root)).abs() < 1e-8);
}

#[test]
fn more_than_two_remembered_values_are_named() {
    let start = record(30, 0.3, 0.5);
    let found =
        solve(ONE, &["y(t-1)", "y(t-2)", "u(t-1)", "u(t-2)"], &[0.5, 0.2, 0.1, 0.1], &start, grid(20));
    let message = found.expect_err("three values").to_string();
    assert!(
        message.contains("3 remembered values: u(t-1), y(t), y(t-1)") && message.contains("one or two"),
        "{message}"
    );
}
