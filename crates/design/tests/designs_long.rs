//! Long records: the cost grows with the length, and a local run reduces the projected gradient as far as a user asks.

mod common;

use common::*;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator};
use dynocal_design::search::{DesignOptions, design, random_record};
use dynocal_numerics::status::Status;

/// Largest component of the projected gradient of J_D per unit of range at the record `u`.
fn projected_gradient(problem: &DesignProblem, u: &[f64]) -> f64 {
    let mut g = vec![0.0; u.len()];
    assert!(Evaluator::new(problem).unwrap().value_gradient(u, 1.0, &mut g).is_finite());
    u.iter().zip(&g).enumerate().fold(0.0, |worst, (k, (u, g))| {
        let c = &problem.channels[k % problem.channels.len()];
        let range = c.upper - c.lower;
        let x = (u - c.lower) / range;
        f64::max(worst, ((x - g * range).clamp(0.0, 1.0) - x).abs())
    })
}

/// A D-optimal record of 1000 samples on three channels from a random one: the projected gradient, computed here from
/// the gradient in the samples, falls to 1e-4 of that of the start.
#[test]
fn a_local_run_over_a_thousand_samples_ends_at_a_stationary_record() {
    let model = chapter_4_model("torque");
    let d = named("d");
    let p = problem(term(&model, d.as_ref(), &[], &[]), 1000, Convention::Trim);
    let start = random_record(&p, 2).unwrap();
    let before = projected_gradient(&p, &start);
    let options = DesignOptions {
        search: "local".into(),
        start: Some(start),
        evaluations: 4000,
        gradient_tolerance: 1e-4 * before,
        value_tolerance: 0.0,
        ..Default::default()
    };
    let found = design(&p, &options, &|| false, &|_| {}).unwrap();
    let after = projected_gradient(&p, &found.u);
    println!("{before:e} to {after:e} in {} evaluations, J_D {}", found.evaluations, found.value);
    assert_eq!(found.status, Status::Converged);
    assert!(after <= 1.001e-4 * before, "{before:e} to {after:e} in {} evaluations", found.evaluations);
    // Ten times the rows of the record of 100 samples: at least p ln 10 more information than its best.
    assert!(found.value < -438.7 - 22.0 * 10f64.ln(), "{}", found.value);
}
