//! Criterion with gradient, and whole designs, for the torque model (4.17) in the box (4.16), convention trim.

use crate::{cpu_s, measure, numbers};
use dynocal_design::channel::Channel;
use dynocal_design::criterion::criterion;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};
use dynocal_design::search::{DesignOptions, design};
use dynocal_ident::model::literature;
use serde_json::{Value, json};
use std::error::Error;

/// Builds the problem of the input (`criterion`, `u0`, N = 100) and hands it to `work`.
fn with_problem(
    input: &Value,
    work: impl FnOnce(&DesignProblem) -> Result<Value, Box<dyn Error>>,
) -> Result<Value, Box<dyn Error>> {
    let model = literature::torque_4_17();
    let u0 = numbers(input, "u0")?;
    let name = input["criterion"].as_str().ok_or("no criterion")?;
    let wanted = criterion(name, &Default::default())?;
    let problem = DesignProblem {
        channels: vec![
            Channel::free("fpw", 2000.0, 6000.0),
            Channel::free("abv", 0.4, 0.6),
            Channel::free("speed", 1000.0, 2000.0),
        ],
        n_samples: 100,
        convention: Convention::Trim,
        start: 10,
        terms: vec![Term {
            objective_signal: &u0,
            ..Term::new("torque", &model.model, &model.theta, model.noise_variance, wanted.as_ref())
        }],
    };
    work(&problem)
}

/// Input also `u` (N x 3). Output: `value`, `gradient` (N x 3), CPU time of both together.
pub(crate) fn evaluate(input: &Value) -> Result<Value, Box<dyn Error>> {
    let u = numbers(input, "u")?;
    with_problem(input, |problem| {
        let mut evaluator = Evaluator::new(problem)?;
        let mut gradient = vec![0.0; u.len()];
        let mut value = 0.0;
        let time = measure(|| value = evaluator.value_gradient(&u, 8.0, &mut gradient))?;
        Ok(json!({"time": time, "value": value, "gradient": gradient}))
    })
}

/// Input also `starts` (list of N x 3), `evaluations` (default those of the search), `repeats` (default 1: all starts
/// that often, for the clock's sake). Output: `values`, mean CPU time of one design with its set-up.
pub(crate) fn search(input: &Value) -> Result<Value, Box<dyn Error>> {
    let starts: Vec<Vec<f64>> = serde_json::from_value(input["starts"].clone())?;
    with_problem(input, |problem| {
        let (mut values, mut evaluations, mut records) = (Vec::new(), Vec::new(), Vec::new());
        let mut options = DesignOptions::default();
        if let Some(n) = input["evaluations"].as_u64() {
            options.evaluations = n as usize;
        }
        let repeats = input["repeats"].as_u64().unwrap_or(1).max(1) as usize;
        let before = cpu_s()?;
        for (k, start) in starts.iter().cycle().take(repeats * starts.len()).enumerate() {
            let seed = (k % starts.len()) as u64;
            let options = DesignOptions { seed, start: Some(start.clone()), ..options.clone() };
            let found = design(problem, &options, &|| false, &|_| {})?;
            if k < starts.len() {
                values.push(found.value);
                evaluations.push(found.evaluations);
                records.push(found.u);
            }
        }
        let calls = repeats * starts.len();
        let time = json!({"cpu_s": (cpu_s()? - before) / calls as f64, "calls": calls});
        Ok(json!({"time": time, "values": values, "evaluations": evaluations, "records": records}))
    })
}
