//! All cells of a map as one program, on quadratic responses or on Gaussian processes that were learnt from points.

use crate::{measure, numbers};
use dynocal_calib::steady::cell::{Setting, Side};
use dynocal_calib::steady::whole::{Coupling, solve_whole};
use dynocal_ident::model::response::{Ask, Points, Prediction, Response, ResponseModel, learner};
use serde::Deserialize;
use serde_json::{Value, json};
use std::error::Error;

/// `constant + gradient' x + x' hessian x / 2`.
#[derive(Deserialize)]
struct Quadratic {
    constant: f64,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
}

impl Response for Quadratic {
    fn dim(&self) -> usize {
        self.gradient.len()
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        let d = x.len();
        (out.mean, out.variance, out.noise) = (self.constant, 0.0, 0.0);
        for (i, row) in self.hessian.chunks_exact(d).enumerate() {
            let slope: f64 = row.iter().zip(x).map(|(h, x)| h * x).sum();
            out.mean += x[i] * (self.gradient[i] + 0.5 * slope);
            if ask >= Ask::Gradient {
                out.gradient[i] = self.gradient[i] + slope;
            }
        }
        if ask >= Ask::Hessian {
            out.hessian.copy_from_slice(&self.hessian);
        }
    }

    fn describe(&self) -> String {
        "quadratic".into()
    }
}

/// Gaussian processes of values at the points `x`, one for each response.
fn learnt(x: &[f64], values: Vec<Vec<f64>>, dim: usize) -> Result<Vec<ResponseModel>, Box<dyn Error>> {
    let learner = learner("gaussian_process", &toml::Table::new())?;
    let inputs: Vec<String> = (0..dim).map(|i| format!("x{i}")).collect();
    let one = |y: Vec<f64>| {
        let points = Points { inputs: inputs.clone(), output: "y".into(), x: x.to_vec(), y };
        Ok(learner.learn(&points, &|| false)?.model)
    };
    values.into_iter().map(one).collect()
}

/// Input `responses` (the first is minimised, the others have their `upper` limits), `dim`, `axes`, `starts` (cells x dim), `pairs`,
/// `smooth`; all factors from 0 to 1. With `points` and the `values` of each response there, processes are learnt from them and stand
/// for the responses, limits with `z` standard deviations, `caution` of them on what is minimised. Output: `x` (cells x dim), status, iterations, CPU time.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let responses: Vec<Quadratic> = serde_json::from_value(input["responses"].clone())?;
    let upper = numbers(input, "upper")?;
    let count = |key: &str| input[key].as_u64().map(|n| n as usize).ok_or(format!("no {key}"));
    let (dim, axes) = (count("dim")?, count("axes")?);
    let starts: Vec<Vec<f64>> = numbers(input, "starts")?.chunks(dim).map(<[f64]>::to_vec).collect();
    let values: Option<Vec<Vec<f64>>> = serde_json::from_value(input["values"].clone())?;
    let processes = values.map(|v| learnt(&numbers(input, "points")?, v, dim)).transpose()?;
    let models: Vec<&dyn Response> = match &processes {
        Some(models) => models.iter().map(|m| m as &dyn Response).collect(),
        None => responses.iter().map(|r| r as &dyn Response).collect(),
    };
    let or_none = |key: &str| input[key].as_f64().unwrap_or(0.0);
    let side = |(k, limit): (usize, &f64)| Side {
        response: k + 1,
        limit: *limit,
        sign: 1.0,
        scale: 1.0,
        caution: 1.0,
    };
    let mut weights = vec![0.0; responses.len()];
    weights[0] = 1.0;
    let setting = Setting {
        models,
        weights,
        sides: upper.iter().enumerate().map(side).collect(),
        z: or_none("z"),
        caution: or_none("caution"),
        ranges: vec![dynocal_numerics::interval::Interval::new(0.0, 1.0); dim],
        axes,
    };
    let coupling = Coupling {
        weights: vec![1.0; starts.len()],
        pairs: serde_json::from_value(input["pairs"].clone())?,
        smooth: input["smooth"].as_f64().ok_or("no smooth")?,
        steps: vec![None; dim - axes],
        monotone: Vec::new(),
    };
    let mut found = None;
    let time = measure(|| found = Some(solve_whole(&setting, &starts, &coupling, &|| false)))?;
    let found = found.ok_or("nothing was solved")?;
    let x: Vec<&Vec<f64>> = found.cells.iter().map(|c| &c.x).collect();
    Ok(json!({"time": time, "x": x, "status": found.status, "iterations": found.iterations}))
}
