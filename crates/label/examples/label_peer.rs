//! Our side of `bench/peers/labels.py`: a map with smoothness from samples, timed without reading and writing.
//!
//! ```text
//! label_peer INPUT.json        axes "x" and "y", samples "u", "v", "z", weight of the roughness "smooth"; prints JSON
//! ```

use std::error::Error;
use std::time::Instant;

use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{Options, Problem, fit};
use dynocal_label::rows::Rows;
use serde_json::{Value, json};

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

/// User and system time of the process in s.
fn cpu_s() -> Result<f64, Box<dyn Error>> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = |k: usize| -> Result<f64, Box<dyn Error>> {
        Ok(after_name.split_whitespace().nth(k).ok_or("short /proc/self/stat")?.parse()?)
    };
    Ok((ticks(11)? + ticks(12)?) / 100.0)
}

/// Most memory that the process has held so far, in GiB.
fn peak_gib() -> Result<f64, Box<dyn Error>> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).ok_or("no VmHWM")?;
    let kib: f64 = line.split_whitespace().nth(1).ok_or("no number in VmHWM")?.parse()?;
    Ok(kib / 1048576.0)
}
