//! The record of 10 s that tells most about a published torque model within limits of input, rate and torque.
//!
//!     cargo run --release -p dynocal --example design

use std::error::Error;

use dynocal::jobs::design::{load, parse, run};
use dynocal::prelude::*;

const SPEC: &str = r#"
length_s = 10.0
sample_time_s = 0.1
rivals = 5
channels = [
    { name = "fpw", unit = "us", lower = 2000.0, upper = 6000.0, hold_s = 0.2, rate_per_s = 15000.0, start = 3000.0 },
    { name = "abv", unit = "-", lower = 0.4, upper = 0.6, hold_s = 0.2 },
    { name = "speed", unit = "rpm", lower = 1000.0, upper = 2000.0, hold_s = 1.0, shape = "linear", start = 1500.0 },
]

[[models]]
literature = "torque_4_17"
criterion = "d"
limits = { lower = -10.0, upper = 40.0, margin = 3.0 }

[search]
starts = 2
evaluations = 500
"#;

fn main() -> Result<(), Box<dyn Error>> {
    let job = parse("design.toml", SPEC, &Overrides::default())?;
    let (found, curves) = run::make(&job, &load::load(&job)?, Watch::silent())?;
    println!("{} samples, J_D {:.2} (at the start {:.2})", found.samples, found.value, found.start_value);
    for rival in &found.efficiencies {
        println!(
            "{}: D-efficiency {:.1} % (median of {})",
            rival.rival, rival.d_percent.median, rival.signals
        );
    }
    let first: Vec<f64> = curves.u[..found.channels.len()].to_vec();
    println!("first sample: {first:?}");
    Ok(())
}
