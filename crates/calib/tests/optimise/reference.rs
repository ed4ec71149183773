//! The reference record against optima of an independent solver. The numbers are those of the reference set named by
//! DYNOCAL_REFERENCE_DIR, where nothing else is said.

use crate::common::{engine_record, polynomial};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{Horizon, OptimiseOptions, Optimum, Seam, Segments, Way, optimise_models};
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
    p.inputs.iter_mut().for_each(|c| c.increment_weight = Some(0.0));
    p.inputs[1].rate_per_s = limit.map(|deg| deg / 0.03);
    p
}

fn solve(
    p: &CalibrationProblem,
    models: &[(&dyn Model, &[f64]); 2],
    start: &Dataset,
    most: usize,
) -> Optimum {
    let options = OptimiseOptions { max_iterations: most, ..OptimiseOptions::default() };
    solve_with(p, models, start, &options)
}

fn solve_with(
    p: &CalibrationProblem,
    models: &[(&dyn Model, &[f64]); 2],
    start: &Dataset,
    options: &OptimiseOptions,
) -> Optimum {
    let models = [("torque", models[0]), ("lambda", models[1])]
        .map(|(output, (model, theta))| OutputModel::plain(output, model, theta, &ENGINE));
    let clock = std::time::Instant::now();
    let found = optimise_models(p, &models, start, options, &|| false).expect("set up");
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

/// With the spark rate limited the record is start enough for the best optimum that is known.
#[test]
fn thesis_coefficients_with_a_rate_limit_reach_the_best_known_optimum() {
    let Some(dir) = reference_dir() else { return };
    let start = engine_record(&dir);
    let (t, l) = (literature::torque_7_8(), literature::lambda_7_8());
    let models: [(&dyn Model, &[f64]); 2] = [(&t.model, &t.theta), (&l.model, &l.theta)];
    let limited = solve(&fuel(Some(1.0)), &models, &start, 500);
    kept(&limited);
    assert!((limited.objective - 2.1277438987387822).abs() < 1e-6, "{}", limited.objective);
}

/// Segments against the batch: independent ones miss the demand at their seams, a look-ahead of 50 samples gives the batch.
#[test]
fn segments_of_polynomial_models() {
    let Some(dir) = reference_dir() else { return };
    let start = engine_record(&dir);
    let (t, l) = polynomial(&dir);
    let models: [(&dyn Model, &[f64]); 2] = [(&t.0, &t.1), (&l.0, &l.1)];
    let of = |length: f64, seam: Seam| {
        let way = Way::Segments(Segments { length_s: 0.03 * length, seam });
        solve_with(&fuel(None), &models, &start, &OptimiseOptions { way, ..OptimiseOptions::default() })
    };
    let ahead = of(500.0, Seam::LookAhead { ahead_s: 1.5 });
    kept(&ahead);
    assert!((ahead.objective - 2.389014814256187).abs() < 1e-5, "{}", ahead.objective);
    let short = of(100.0, Seam::LookAhead { ahead_s: 1.5 });
    kept(&short);
    assert!((short.objective - 2.389014814256187).abs() < 1e-5, "{}", short.objective);
    // Pinned ones meet the demand everywhere and cost what the reference's cost.
    let pinned = of(500.0, Seam::Pinned);
    kept(&pinned);
    assert!(pinned.objective <= 2.3907, "{}", pinned.objective);
    let independent = of(100.0, Seam::Independent);
    assert!(independent.violation("torque") > 20.0, "{:?}", independent.violations);
    // Without look-ahead a segment can end where the next one has no solution; its seam is named.
    let greedy = of(100.0, Seam::LookAhead { ahead_s: 0.0 });
    let failed: Vec<_> = greedy.parts.iter().filter(|p| !p.status.is_success()).collect();
    assert!(!failed.is_empty() && greedy.status != Status::Converged, "{:?}", greedy.parts);
    println!(
        "{} of {} greedy segments fail, first from {} s",
        failed.len(),
        greedy.parts.len(),
        failed[0].from_s
    );
}

/// A receding horizon of 20 samples over the first part of the record: every step solved, near the batch.
#[test]
fn receding_horizon_is_near_the_batch() {
    let Some(dir) = reference_dir() else { return };
    let start = engine_record(&dir).part(0, 300, "first 9 s".into());
    let (t, l) = polynomial(&dir);
    let models: [(&dyn Model, &[f64]); 2] = [(&t.0, &t.1), (&l.0, &l.1)];
    let batch = solve(&fuel(None), &models, &start, 300);
    let horizon = Horizon { length_s: 0.6, step_s: None, price: None, warm_barrier: 1e-6 };
    let options = OptimiseOptions { way: Way::Horizon(horizon), ..OptimiseOptions::default() };
    let found = solve_with(&fuel(None), &models, &start, &options);
    assert!(found.parts.iter().all(|p| p.status == Status::Converged));
    assert!(
        (found.objective / batch.objective - 1.0).abs() < 5e-3,
        "{} {}",
        found.objective,
        batch.objective
    );
    println!("{} steps, {} iterations", found.parts.len(), found.iterations);
}

/// 20 000 samples in one batch: the record ten times over, so that the mean stays about that of the single one.
#[test]
fn ten_minutes_are_one_batch() {
    let Some(dir) = reference_dir() else { return };
    let mut start = engine_record(&dir);
    start.channels.iter_mut().for_each(|c| c.values = c.values.repeat(10));
    let (t, l) = polynomial(&dir);
    let models: [(&dyn Model, &[f64]); 2] = [(&t.0, &t.1), (&l.0, &l.1)];
    let found = solve(&fuel(None), &models, &start, 300);
    kept(&found);
    assert!((found.objective / 2.389014814256187 - 1.0).abs() < 2e-3, "{}", found.objective);
}
