//! Training of a network in free run from a given start: Jacobian and Levenberg-Marquardt iterations.

use crate::{measure, numbers};
use dynocal_ident::estimate::train::Train;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::neural::NeuralNarx;
use serde_json::{Value, json};
use std::error::Error;

/// Input: `u` (N x 4), `y` (N), `theta` (231), most `evaluations`. Output: Jacobian in scaled units with its CPU time;
/// evaluations, iterations, cost in scaled units and CPU time of one training with its report, and of the report alone.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let (u, y, theta) = (numbers(input, "u")?, numbers(input, "y")?, numbers(input, "theta")?);
    let evaluations = input["evaluations"].as_u64().ok_or("no evaluations")? as usize;
    let data = [Experiment { name: "record".into(), u, y, init_samples: 0, weights: Vec::new() }];
    let net =
        NeuralNarx::new(&["inj", "spark", "throttle", "speed"], "torque", 10, 5, 1)?.scaled_to(&data)?;
    let (n, half) = (data[0].len(), net.output_half_range());
    let (mut free_run, mut s) = (vec![0.0; n], vec![0.0; n * net.n_params()]);
    let run = data[0].run(&net);
    let jacobian_time = measure(|| {
        net.sensitivities(&theta, &run, &mut free_run, &mut s);
    })?;
    let jacobian: Vec<f64> = s.iter().map(|v| v / half).collect();
    let train = |max_evaluations: usize| {
        let options =
            Train { starts: 1, selection: 0.0, max_evaluations, patience: usize::MAX, ..Train::default() };
        options.train(&net, &data, &[], Some(&theta), &|| false)
    };
    // One evaluation is the first Jacobian and the report with its covariance: what the iterations cost is the rest.
    let report_time = measure(|| {
        train(1).map(drop).unwrap_or_default();
    })?;
    let mut last = None;
    let time = measure(|| last = Some(train(evaluations)))?;
    let fit = last.ok_or("not trained")??.fit;
    Ok(json!({
        "time": time,
        "report_time": report_time,
        "jacobian_time": jacobian_time,
        "jacobian": jacobian,
        "evaluations": fit.evaluations,
        "iterations": fit.history.len() - 1,
        "cost": fit.mse * fit.samples as f64 / (half * half),
    }))
}
