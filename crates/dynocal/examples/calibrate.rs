//! A whole calibration on the virtual engine at reduced length: from a test signal to a validated dynamic map.
//!
//!     cargo run --release -p dynocal --example calibrate

use std::error::Error;
use std::path::Path;

use dynocal::jobs::calibrate::job;
use dynocal::numerics::watch::Watch;

fn main() -> Result<(), Box<dyn Error>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/gtdi/quick.toml");
    let campaign = job::read(&path, None, Some(Path::new("runs/example-calibrate")))?;
    let note = |text: &str| println!("{text}");
    let done = job::run(&campaign, "validate", Watch { note: &note, ..Watch::silent() })?;
    for warning in &done.warnings {
        println!("warning: {warning}");
    }
    println!("valid: {}, report: {}", done.valid, done.report.display());
    Ok(())
}
