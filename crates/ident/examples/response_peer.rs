//! Our side of `bench/peers/response.py`: learns response models from points given as JSON and predicts.
//!
//! `response_peer PROBLEM.json` reads `{inputs, output, x, y, test, models: [{kind, ...}], repeat}` and prints, for each
//! model, prediction, standard deviations, left-out error and the CPU time of learning and of one prediction with gradient.

use std::time::Instant;

use dynocal_ident::model::response::{Ask, Points, Prediction, Response, ResponseModel, learner};
use serde::Deserialize;
use serde_json::json;

#[derive(Deserialize)]
struct Problem {
    inputs: Vec<String>,
    output: String,
    x: Vec<f64>,
    y: Vec<f64>,
    test: Vec<f64>,
    models: Vec<toml::Table>,
    /// Times that learning is repeated for the time.
    repeat: usize,
}

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let path = std::env::args().nth(1).ok_or("usage: response_peer PROBLEM.json")?;
    let problem: Problem = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let d = problem.inputs.len();
    let points = Points {
        inputs: problem.inputs.clone(),
        output: problem.output.clone(),
        x: problem.x.clone(),
        y: problem.y.clone(),
    };
    let mut results = Vec::new();
    for keys in &problem.models {
        let mut keys = keys.clone();
        let Some(toml::Value::String(kind)) = keys.remove("kind") else {
            return Err("a model needs a kind".into());
        };
        let kind = learner(&kind, &keys)?;
        let (cpu, wall) = (cpu_s()?, Instant::now());
        let mut learnt = kind.learn(&points, &|| false)?;
        for _ in 1..problem.repeat.max(1) {
            learnt = kind.learn(&points, &|| false)?;
        }
        let calls = problem.repeat.max(1) as f64;
        let (cpu, wall) = ((cpu_s()? - cpu) / calls, wall.elapsed().as_secs_f64() / calls);
        let mut at = Prediction::new(d);
        let (mut mean, mut std, mut measured) = (Vec::new(), Vec::new(), Vec::new());
        for x in problem.test.chunks_exact(d) {
            learnt.model.predict(x, Ask::Variance, &mut at);
            mean.push(at.mean);
            std.push(at.variance.sqrt());
            measured.push(at.measured_std());
        }
        let lengths = match &learnt.model {
            ResponseModel::GaussianProcess(model) => model.lengths(),
            _ => Vec::new(),
        };
        results.push(json!({
            "what": learnt.model.describe(), "mean": mean, "std": std, "measured_std": measured,
            "left_out_rmse": learnt.left_out.rmse(), "cpu_s": cpu, "wall_s": wall, "lengths": lengths,
            "predict_us": predict_us(&learnt.model, &problem.test, d)?, "notes": learnt.notes,
        }));
    }
    println!("{}", serde_json::to_string(&results)?);
    Ok(())
}

/// CPU time in microseconds of one prediction with variance and both gradients.
fn predict_us(model: &ResponseModel, test: &[f64], d: usize) -> Outcome<f64> {
    let mut at = Prediction::new(d);
    let (mut calls, before) = (0_usize, cpu_s()?);
    let mut sum = 0.0;
    while cpu_s()? - before < 0.2 {
        for x in test.chunks_exact(d).take(200) {
            model.predict(x, Ask::Gradient, &mut at);
            sum += at.mean + at.variance_gradient[0];
            calls += 1;
        }
    }
    let spent = cpu_s()? - before;
    if !sum.is_finite() {
        return Err("a prediction is not finite".into());
    }
    Ok(1e6 * spent / calls.max(1) as f64)
}

/// CPU time of this process, from the system's table of processes (in hundredths of a second).
fn cpu_s() -> Outcome<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks =
        |k: usize| -> Outcome<f64> { Ok(fields.get(k).ok_or("unexpected /proc/self/stat")?.parse()?) };
    Ok((ticks(11)? + ticks(12)?) / 100.0)
}
