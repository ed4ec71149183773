//! A measured file to a validated model: Box and Jenkins' gas furnace, first half to estimate, second half unseen.
//!
//!     cargo run --release -p dynocal --example identify

use std::error::Error;
use std::path::Path;

use dynocal::jobs::identify::{job, spec};
use dynocal::prelude::*;

fn main() -> Result<(), Box<dyn Error>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/gas_furnace/identify.toml");
    let overrides = spec::Overrides { out: Some("runs/example-identify".into()), ..Default::default() };
    let job = spec::read(&path, &overrides)?;
    let note = |text: &str| println!("{text}");
    let (found, folder) = job::run(&job, Watch { note: &note, ..Watch::silent() })?;
    for score in &found.scores {
        let fit = score.r2_percent.map_or("diverged".to_string(), |r2| format!("R2 {r2:.2} %"));
        println!("{} of {}, {:?}: {fit}", score.output, score.part, score.kind);
    }
    println!("model: {}", folder.path().join(&found.models[0].file).display());
    Ok(())
}
