//! The reference record against optima of an independent solver. The numbers are those of the reference set named by
//! DYNOCAL_REFERENCE_DIR, where nothing else is said.

use crate::common::{engine_record, polynomial};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{OptimiseOptions, Optimum, optimise_models};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::Dataset;
use dynocal_ident::model::{Model, literature};
use dynocal_numerics::status::Status;
use std::path::PathBuf;

const ENGINE: [&str; 4] = ["inj", "spark", "throttle", "speed"];

fn reference_dir() -> Option<PathBuf> {
    let dir = std::env::var_os("DYNOCAL_REFERENCE_DIR").map(PathBuf::from);
    if dir.is_none() {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
    }
    dir
}

/// The thesis' problem without weights on increments, which the reference does not have.
fn fuel(limit: Option<f64>) -> CalibrationProblem {
    let mut p = CalibrationProblem::thesis();
    p.inputs.iter_mut().for_each(|c| c.increment_weight = 0.0);
    p.inputs[1].rate_per_s = limit.map(|deg| deg / 0.03);
    p
}

fn solve(
    p: &CalibrationProblem,
    models: &[(&dyn Model, &[f64]); 2],
    start: &Dataset,
    most: usize,
) -> Optimum {
    let models = [
        OutputModel::plain("torque", models[0].0, models[0].1, &ENGINE),
        OutputModel::plain("lambda", models[1].0, models[1].1, &ENGINE),
    ];
    let options = OptimiseOptions { max_iterations: most, ..OptimiseOptions::default() };
    let clock = std::time::Instant::now();
    let found = optimise_models(p, &models, start, &options, &|| false).expect("set up");
    println!(
        "{:?} {} iterations, {:.10} to {:.10} kg/h, violations {:?}, {:.2?}",
        found.status,
        found.iterations,
        found.start_objective,
        found.objective,
        found.violations.iter().map(|v| v.largest).collect::<Vec<_>>(),
        clock.elapsed()
    );
    found
}

fn kept(found: &Optimum) {
    assert_eq!(found.status, Status::Converged);
    assert!(found.violations.iter().all(|v| v.largest < 1e-6), "{:?}", found.violations);
}

#[test]
fn polynomial_models_reach_the_published_optima() {
    let Some(dir) = reference_dir() else { return };
    let start = engine_record(&dir);
    let (t, l) = polynomial(&dir);
    let models: [(&dyn Model, &[f64]); 2] = [(&t.0, &t.1), (&l.0, &l.1)];
    let free = solve(&fuel(None), &models, &start, 300);
    kept(&free);
    assert!((free.start_objective - 2.5130714915357815).abs() < 1e-9, "{}", free.start_objective);
    // The tight solution of the independent solver is the optimum: nothing below is possible but by violation.
    assert!((free.objective - 2.389014814256187).abs() < 1e-7, "{}", free.objective);
    let limited = solve(&fuel(Some(1.0)), &models, &start, 300);
    kept(&limited);
    assert!((limited.objective - 2.390317721415519).abs() < 1e-7, "{}", limited.objective);
    let spark = limited.input("spark").expect("spark");
    let steepest = spark.windows(2).skip(limited.first - 1).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    assert!(steepest <= 1.0 + 1e-7, "{steepest}");
}

#[test]
fn thesis_coefficients_reach_the_published_optimum_from_the_record() {
    let Some(dir) = reference_dir() else { return };
    let start = engine_record(&dir);
    let (t, l) = (literature::torque_7_8(), literature::lambda_7_8());
    let models: [(&dyn Model, &[f64]); 2] = [(&t.model, &t.theta), (&l.model, &l.theta)];
    let found = solve(&fuel(None), &models, &start, 500);
    kept(&found);
    assert!(found.objective <= 2.13685 && found.objective > 2.119785060416482 - 1e-6, "{}", found.objective);
}
