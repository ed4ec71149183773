//! Any calibration problem over a record, with polynomial models whose outputs are free or limited: their recursion stays.

use crate::{measure, numbers};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{OptimiseOptions, optimise_models};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::poly::PolyNarx;
use serde_json::{Value, json};
use std::error::Error;

/// Input: `problem` as TOML, `models` (each with `output`, `inputs`, `regressors`, `theta`), `channels` (name to values),
/// `sample_time_s`. Output: inputs by name, objective, CPU time of building and solving.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let problem: CalibrationProblem = toml::from_str(input["problem"].as_str().ok_or("no problem")?)?;
    let mut structures = Vec::new();
    for m in input["models"].as_array().ok_or("no models")? {
        let inputs: Vec<String> = serde_json::from_value(m["inputs"].clone())?;
        let regressors: Vec<String> = serde_json::from_value(m["regressors"].clone())?;
        let output = m["output"].as_str().ok_or("no output")?.to_string();
        let names: Vec<&str> = inputs.iter().map(String::as_str).collect();
        let structure = PolyNarx::parse(&names, &output, &regressors)?;
        structures.push((output, inputs, structure, numbers(m, "theta")?));
    }
    let models: Vec<OutputModel> = structures
        .iter()
        .map(|(output, inputs, structure, theta)| {
            let names: Vec<&str> = inputs.iter().map(String::as_str).collect();
            OutputModel::plain(output, structure, theta, &names)
        })
        .collect();
    let channels = input["channels"].as_object().ok_or("no channels")?;
    let channel = |name: &String| -> Result<Channel, Box<dyn Error>> {
        let role = if models.iter().any(|m| m.output == *name) { Role::Output } else { Role::Input };
        Ok(Channel { name: name.clone(), unit: "-".into(), role, values: numbers(&input["channels"], name)? })
    };
    let start = Dataset {
        name: "start".into(),
        sample_time_s: input["sample_time_s"].as_f64().ok_or("no sample_time_s")?,
        channels: channels.keys().map(channel).collect::<Result<_, _>>()?,
        init_samples: 0,
        origin: "peer".into(),
    };
    let defaults = OptimiseOptions::default();
    let tolerance = input["tolerance"].as_f64().unwrap_or(defaults.tolerance);
    let options = OptimiseOptions { tolerance, ..defaults };
    let mut last = None;
    let time = measure(|| {
        last = optimise_models(&problem, &models, &start, &options, &|| false).ok();
    })?;
    let found = last.ok_or("not solved")?;
    let by_name = |c: &Channel| (c.name.clone(), json!(c.values));
    let violation = found.violations.iter().map(|v| v.largest).fold(0.0, f64::max);
    Ok(json!({
        "time": time,
        "status": format!("{:?}", found.status),
        "iterations": found.iterations,
        "objective": found.objective,
        "violation": violation,
        "inputs": found.inputs.iter().map(by_name).collect::<serde_json::Map<_, _>>(),
    }))
}
