//! Fuel over a record with exact torque and lambda, bounds and the spark rate limit: the product's own program.

use crate::{measure, numbers};
use dynocal_calib::fuel::problem::{Equality, FuelProblem, FuelSpec, Source};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::nlp::{NlpOptions, solve};
use serde_json::{Value, json};
use std::error::Error;

/// Structure, parameters and demand of one output.
struct Output {
    structure: PolyNarx,
    theta: Vec<f64>,
    demand: Vec<f64>,
}

/// Input: `u` (N x 4: INJ, SA, throttle, speed), `first`, `rate`, `bounds`, and for `torque` and `lambda` their
/// `regressors`, `theta`, `y` (of which `y[first - 1]` starts the demand). Output: inputs (N x 3), fuel, CPU time
/// of building and solving.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let u = numbers(input, "u")?;
    let n = u.len() / 4;
    let first = input["first"].as_u64().ok_or("no first sample")? as usize;
    let outputs = [output(input, "torque", &u, first)?, output(input, "lambda", &u, first)?];
    let start: Vec<f64> = u.chunks_exact(4).flat_map(|r| [r[0], r[1], r[2]]).collect();
    let speed: Vec<f64> = u.chunks_exact(4).map(|r| r[3]).collect();
    let bounds: [(f64, f64); 3] = serde_json::from_value(input["bounds"].clone())?;
    let rate = input["rate"].as_f64().ok_or("no rate")?;
    let build = || {
        let spec = FuelSpec {
            start: &start,
            given: &speed,
            n_given: 1,
            first,
            bounds,
            spark_rate_deg: rate,
            increment_weight: [0.0; 3],
        };
        let sources = || [0, 1, 2].map(Source::Decision).into_iter().chain([Source::Given(0)]).collect();
        let equalities = outputs.iter().map(|o| Equality {
            model: &o.structure,
            theta: &o.theta,
            inputs: sources(),
            demand: &o.demand,
        });
        FuelProblem::new(spec, equalities.collect())
    };
    let mut last = None;
    let time = measure(|| {
        let mut problem = build();
        let found = solve(&mut problem, &NlpOptions::default(), &|| false);
        let inputs = problem.inputs(&found.x);
        last = Some((problem.fuel_kg_h(&found.x), inputs, found));
    })?;
    let (fuel, inputs, found) = last.ok_or("not solved")?;
    Ok(json!({
        "time": time,
        "status": format!("{:?}", found.status),
        "iterations": found.history.len().saturating_sub(1),
        "fuel_kg_h": fuel,
        "inputs": inputs,
        "samples": n,
    }))
}

fn output(input: &Value, name: &str, u: &[f64], first: usize) -> Result<Output, Box<dyn Error>> {
    let of = &input[name];
    let texts: Vec<String> = serde_json::from_value(of["regressors"].clone())?;
    let structure = PolyNarx::parse(&["inj", "spark", "throttle", "speed"], name, &texts)?;
    let (theta, y) = (numbers(of, "theta")?, numbers(of, "y")?);
    let mut demand = vec![0.0; y.len()];
    structure.simulate(&theta, &Run { u, y: &y, start: first }, &mut demand);
    Ok(Output { structure, theta, demand })
}
