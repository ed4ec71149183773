//! Fuel over a record with exact torque and lambda, bounds and the spark rate limit: the product's own way.

use crate::{measure, numbers, peak_gib};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{OptimiseOptions, Way, optimise_models};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::Model;
use dynocal_ident::model::neural::NeuralNarx;
use dynocal_ident::model::poly::PolyNarx;
use serde_json::{Value, json};
use std::error::Error;

const INPUTS: [&str; 4] = ["inj", "spark", "throttle", "speed"];

/// Structure and parameters of one output.
struct Output {
    structure: Box<dyn Model>,
    theta: Vec<f64>,
    y: Vec<f64>,
}

/// Input: `u` (N x 4: INJ, SA, throttle, speed), `rate` in deg per sample, `bounds`, and for `torque` and `lambda` their
/// `regressors` or `network`, `theta`, `y` (of which the first samples start the demand); `way` where it is not the batch,
/// `max_iterations`. Output: inputs (N x 3), fuel, parts solved of all, CPU time of building and solving, most memory held.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let u = numbers(input, "u")?;
    let outputs = [output(input, "torque")?, output(input, "lambda")?];
    let models = ["torque", "lambda"].map(|n| n.to_string());
    let channel = |name: &str, role, values| Channel { name: name.into(), unit: "-".into(), role, values };
    let column = |c: usize| u.iter().skip(c).step_by(4).copied().collect::<Vec<f64>>();
    let inputs = INPUTS.iter().enumerate().map(|(c, name)| channel(name, Role::Input, column(c)));
    let measured = models.iter().zip(&outputs).map(|(name, o)| channel(name, Role::Output, o.y.clone()));
    let start = Dataset {
        name: "start".into(),
        sample_time_s: 1.0,
        channels: inputs.chain(measured).collect(),
        init_samples: 0,
        origin: "peer".into(),
    };
    let mut problem = CalibrationProblem::thesis();
    let bounds: [(f64, f64); 3] = serde_json::from_value(input["bounds"].clone())?;
    for (c, bounds) in problem.inputs.iter_mut().zip(bounds) {
        (c.lower, c.upper) = bounds;
        c.increment_weight = Some(0.0);
    }
    problem.inputs[1].rate_per_s = input["rate"].as_f64();
    let of = |k: usize| OutputModel::plain(&models[k], &*outputs[k].structure, &outputs[k].theta, &INPUTS);
    let mut options = OptimiseOptions { way: way(input)?, ..OptimiseOptions::default() };
    if let Some(most) = input["max_iterations"].as_u64() {
        options.max_iterations = most as usize;
    }
    let mut last = None;
    let time = measure(|| {
        last = optimise_models(&problem, &[of(0), of(1)], &start, &options, &|| false).ok();
    })?;
    let found = last.ok_or("not solved")?;
    let solved = found.parts.iter().filter(|p| p.status.is_success()).count();
    let inputs: Vec<f64> =
        (0..start.len()).flat_map(|t| found.inputs.iter().map(move |c| c.values[t])).collect();
    Ok(json!({
        "time": time,
        "status": format!("{:?}", found.status),
        "iterations": found.iterations,
        "fuel_kg_h": found.objective,
        "inputs": inputs,
        "samples": start.len(),
        "parts": found.parts.len(),
        "parts_solved": solved,
        "peak_gib": peak_gib()?,
    }))
}

/// The batch, or the way of the input.
fn way(input: &Value) -> Result<Way, Box<dyn Error>> {
    match &input["way"] {
        Value::Null => Ok(Way::default()),
        given => Ok(serde_json::from_value(given.clone())?),
    }
}

fn output(input: &Value, name: &str) -> Result<Output, Box<dyn Error>> {
    let of = &input[name];
    let structure: Box<dyn Model> = match &of["network"] {
        Value::Null => {
            let texts: Vec<String> = serde_json::from_value(of["regressors"].clone())?;
            Box::new(PolyNarx::parse(&INPUTS, name, &texts)?)
        }
        network => Box::new(neural(network, name)?),
    };
    Ok(Output { structure, theta: numbers(of, "theta")?, y: numbers(of, "y")? })
}

/// One layer of `hidden` neurons over lags 1 to `lags` of the inputs and lag 1 of the output, with the ranges of `inputs` and `output`.
fn neural(of: &Value, name: &str) -> Result<NeuralNarx, Box<dyn Error>> {
    let count = |key: &str| of[key].as_u64().map(|n| n as usize).ok_or(format!("network: no number `{key}`"));
    let inputs: Vec<[f64; 2]> = serde_json::from_value(of["inputs"].clone())?;
    let output: [f64; 2] = serde_json::from_value(of["output"].clone())?;
    let net = NeuralNarx::new(&INPUTS, name, count("hidden")?, count("lags")?, 1)?;
    Ok(net.with_ranges(&inputs, output)?)
}
