//! Labels of described functions, from a spec to what is written.

mod axes;
mod function;
mod honest;

use std::path::Path;

use dynocal_files::atomic;
use dynocal_jobs::label::function::{Fitted, run, spec};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::watch::Watch;

/// The fit of a spec in `folder`, or what was said.
fn fitted(folder: &Path, text: &str) -> Result<Fitted, String> {
    let path = folder.join("spec.toml");
    atomic::write(&path, text.as_bytes()).unwrap();
    let over = Overrides { out: Some(folder.join("run")), ..Overrides::default() };
    let job = spec::read(&path, &over).map_err(|e| e.to_string())?;
    run(&job, Watch::silent()).map(|f| f.0).map_err(|e| e.to_string())
}

/// The labels that were written.
fn dcm(found: &Fitted, folder: &Path) -> String {
    let file = found.files.iter().find(|f| f.ends_with(".dcm")).unwrap();
    std::fs::read_to_string(folder.join("run").join(file)).unwrap()
}
