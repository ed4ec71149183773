//! A calibration as a library call: `cargo run --release -p dynocal-jobs --example calibrate -- SPEC OUT`.

use dynocal_jobs::calibrate::job;
use dynocal_numerics::watch::Watch;
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let (Some(spec), Some(out)) = (args.get(1), args.get(2)) else {
        return Err("expected SPEC OUT".into());
    };
    let campaign = job::read(Path::new(spec), None, Some(Path::new(out)))?;
    let note = |text: &str| eprintln!("{text}");
    let done = job::run(&campaign, "validate", Watch { note: &note, ..Watch::silent() })?;
    println!("{}\n{}", done.verdict, done.report.display());
    Ok(())
}
