//! Our side of the comparisons in `bench/peers`: reads one problem as JSON, computes it several times in one thread
//! and prints the result with the CPU time of one computation. Start-up and reading are not counted.
//!
//! ```text
//! peer sensitivities|estimation|linear|criterion|design|fuel|neural|record|selection|whole_map INPUT.json
//! ```

mod design;
mod estimation;
mod fuel;
mod linear;
mod neural;
mod record;
mod selection;
mod sensitivities;
mod whole_map;

use serde_json::{Value, json};
use std::error::Error;

/// What can be compared.
const KINDS: &str = "sensitivities|estimation|linear|criterion|design|fuel|neural|record|selection|whole_map";
/// Least CPU time in s over which computations are repeated: Linux counts hundredths.
const LEAST_CPU_S: f64 = 1.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [what, path] = arguments.as_slice() else {
        return Err(format!("usage: peer {KINDS} INPUT.json").into());
    };
    let input: Value = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let result = match what.as_str() {
        "sensitivities" => sensitivities::run(&input)?,
        "estimation" => estimation::run(&input)?,
        "linear" => linear::run(&input)?,
        "criterion" => design::evaluate(&input)?,
        "design" => design::search(&input)?,
        "fuel" => fuel::run(&input)?,
        "neural" => neural::run(&input)?,
        "record" => record::run(&input)?,
        "selection" => selection::run(&input)?,
        "whole_map" => whole_map::run(&input)?,
        other => return Err(format!("unknown comparison `{other}`").into()),
    };
    println!("{result}");
    Ok(())
}

/// User and system time of the process in s.
pub(crate) fn cpu_s() -> Result<f64, Box<dyn Error>> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = |k: usize| -> Result<f64, Box<dyn Error>> {
        Ok(after_name.split_whitespace().nth(k).ok_or("short /proc/self/stat")?.parse()?)
    };
    Ok((ticks(11)? + ticks(12)?) / 100.0)
}

/// Most memory that the process has held so far, in GiB.
pub(crate) fn peak_gib() -> Result<f64, Box<dyn Error>> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line =
        status.lines().find_map(|l| l.strip_prefix("VmHWM:")).ok_or("no VmHWM in /proc/self/status")?;
    let kib: f64 = line.split_whitespace().next().ok_or("short VmHWM")?.parse()?;
    Ok(kib / f64::from(1 << 20))
}

/// CPU time in s of one call of `work`, and the number of calls it is the mean of.
pub(crate) fn measure(mut work: impl FnMut()) -> Result<Value, Box<dyn Error>> {
    work();
    let (mut calls, mut batch) = (0, 1);
    let before = cpu_s()?;
    loop {
        (0..batch).for_each(|_| work());
        calls += batch;
        let spent = cpu_s()? - before;
        if spent >= LEAST_CPU_S {
            return Ok(json!({"cpu_s": spent / f64::from(calls), "calls": calls}));
        }
        batch *= if spent < 0.1 * LEAST_CPU_S { 4 } else { 1 };
    }
}

/// Numbers under `key`.
pub(crate) fn numbers(input: &Value, key: &str) -> Result<Vec<f64>, Box<dyn Error>> {
    Ok(serde_json::from_value(input[key].clone()).map_err(|e| format!("{key}: {e}"))?)
}
