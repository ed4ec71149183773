//! Simulation-error estimation of eqs. (5.3), (5.4) from the least-squares start.

use crate::{measure, numbers};
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::literature;
use serde_json::{Value, json};
use std::error::Error;

/// Input: `u` (N x 3), `y` (N). Output: `theta`, evaluations, CPU time with the least-squares start.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let (u, y) = (numbers(input, "u")?, numbers(input, "y")?);
    let data = [Experiment { name: "record".into(), u, y, init_samples: 0, weights: Vec::new() }];
    let model = literature::torque_5_3().model;
    let mut last = None;
    let time = measure(|| last = Some(Sem::default().estimate(&model, &data, None, &|| false)))?;
    let fit = last.ok_or("not estimated")??;
    Ok(
        json!({"time": time, "theta": fit.theta, "evaluations": fit.evaluations, "status": format!("{:?}", fit.status)}),
    )
}
