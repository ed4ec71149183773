//! Prediction-error estimation of a linear model with a noise model from the least-squares start.

use crate::{measure, numbers};
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::linear::{InputOrders, LinearModel};
use serde_json::{Value, json};
use std::error::Error;

/// Input: `u` (N), `y` (N), `orders` (na, nb, nc, nd, nf, nk). Output: `theta`, cost, evaluations, CPU time with the start.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let (u, y) = (numbers(input, "u")?, numbers(input, "y")?);
    let orders: Vec<usize> = serde_json::from_value(input["orders"].clone())?;
    let [na, nb, nc, nd, nf, nk] = orders.as_slice() else {
        return Err("orders: expected six numbers".into());
    };
    let (inputs, of_input) = match nb {
        0 => (Vec::new(), Vec::new()),
        _ => (vec!["u".to_string()], vec![InputOrders { nb: *nb, nf: *nf, nk: *nk }]),
    };
    let model = LinearModel { inputs, output: "y".into(), na: *na, orders: of_input, nc: *nc, nd: *nd };
    let u = if *nb == 0 { Vec::new() } else { u };
    let data = [Experiment { name: "record".into(), u, y, init_samples: 0, weights: Vec::new() }];
    let mut last = None;
    let time = measure(|| last = Some(Pem::default().estimate(&model, &data, None, &|| false)))?;
    let fit = last.ok_or("not estimated")??;
    Ok(json!({"time": time, "theta": fit.theta, "cost": fit.mse, "evaluations": fit.evaluations}))
}
