//! What is fitted to which logs.

use std::path::{Path, PathBuf};

use dynocal_files::run_folder::RunPlace;
use dynocal_label::ve::Keys;
use serde::Serialize;

use crate::place::Place;

/// A fit of the fuel table.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Logs.
    pub logs: Vec<PathBuf>,
    /// Tune that holds the table; none: the one that the first log carries.
    pub tune: Option<PathBuf>,
    /// Definition of the ECU, for what a label can hold.
    pub definition: Option<PathBuf>,
    /// Lambda that is wanted everywhere; none: what the target table of the tune asks for.
    pub target_lambda: Option<f64>,
    /// How it is done.
    pub keys: Keys,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
}

impl Job {
    /// The fuel table from `logs`.
    pub fn ve(
        logs: Vec<PathBuf>,
        tune: Option<PathBuf>,
        definition: Option<PathBuf>,
        out: Option<&Path>,
    ) -> Self {
        let place = Place::run("label-ve", out);
        Self {
            name: place.name,
            logs,
            tune,
            definition,
            target_lambda: None,
            keys: Keys::default(),
            out: place.out,
        }
    }
}
