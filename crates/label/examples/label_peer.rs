//! Our side of `bench/peers/labels.py`: a map with smoothness from samples, timed without reading and writing.
//!
//! ```text
//! label_peer INPUT.json        axes "x" and "y", samples "u", "v", "z", weight of the roughness "smooth"; prints JSON
//! ```

mod process;

use std::error::Error;
use std::time::Instant;

use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{Options, Problem, fit};
use dynocal_label::rows::Rows;
use serde_json::{Value, json};

use process::{cpu_s, peak_gib};

/// Time in s over which a computation is repeated.
const LEAST_S: f64 = 1.0;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: label_peer INPUT.json")?;
    let input: Value = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let numbers = |key: &str| -> Result<Vec<f64>, Box<dyn Error>> {
        Ok(serde_json::from_value(input[key].clone()).map_err(|e| format!("`{key}`: {e}"))?)
    };
    let (x, y, u, v, z) = (numbers("x")?, numbers("y")?, numbers("u")?, numbers("v")?, numbers("z")?);
    let smooth = input["smooth"].as_f64();
    let axes = vec![Axis::new("x", "-", &x), Axis::new("y", "-", &y)];
    let label = Label::new("MAP", "-", axes, &vec![0.0; x.len() * y.len()]);
    let options = Options { smooth, ..Options::default() };
    let mut values = Vec::new();
    let (mut calls, before) = (0.0, cpu_s()?);
    let clock = Instant::now();
    while calls == 0.0 || cpu_s()? - before < LEAST_S {
        // The rows are part of the work: a log gives states, not weights.
        let mut rows = Rows::default();
        for (u, v) in u.iter().zip(&v) {
            rows.start();
            label.enter(&mut rows, 0, 1.0, &[*u, *v]);
        }
        values = fit(&Problem::new(std::slice::from_ref(&label), &rows, &z), &options)?.values;
        calls += 1.0;
    }
    let found = json!({
        "values": values,
        "cpu_s": (cpu_s()? - before) / calls,
        "wall_s": clock.elapsed().as_secs_f64() / calls,
        "peak_gib": peak_gib()?,
    });
    println!("{found}");
    Ok(())
}
