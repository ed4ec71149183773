//! What of a run leaves the house: the table `[export]` of a spec, and what it means.

use std::path::{Path, PathBuf};

use dynocal_export::format::{EXPORTS, Keys, Precision};
use dynocal_export::package::Extrapolation;
use dynocal_files::spec::Faults;
use serde::{Deserialize, Serialize};

/// What is wanted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExportSpec {
    /// Formats (`dynocal list exports`).
    pub to: Vec<String>,
    /// Keys of the formats.
    pub keys: Keys,
    /// Look-ups outside their axes.
    pub extrapolation: Extrapolation,
    /// Sample time in s of a map whose run is not at hand.
    pub sample_time_s: Option<f64>,
    /// A2L of the ECU whose limits the characteristics take.
    pub a2l: Option<PathBuf>,
    /// Whether the plant of a run leaves too, as FMU.
    pub engine: bool,
    /// The library of the engine's FMU, where it does not stand beside the program.
    pub library: Option<PathBuf>,
}

/// Formats in which a plant leaves.
pub const UNITS: [&str; 2] = ["fmu2", "fmu3"];

/// The table `[export]` as typed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExportKeys {
    /// Formats (`dynocal list exports`).
    pub to: Vec<String>,
    /// Arithmetic of generated C.
    pub precision: Precision,
    /// Look-ups outside their axes.
    pub extrapolation: Extrapolation,
    /// A2L of the ECU whose limits the characteristics take, relative to the spec.
    pub a2l: Option<PathBuf>,
    /// Whether the plant leaves too, in those of the formats `fmu2` and `fmu3` that are wanted.
    pub engine: bool,
}

impl ExportKeys {
    /// Checks the names of the formats.
    pub fn check(&self, faults: &mut Faults) {
        let known: Vec<String> = EXPORTS.iter().map(|e| e.doc.name.to_string()).collect();
        if self.to.is_empty() {
            let expected = "a list of formats, e.g. [\"c\", \"dcm\"] (`dynocal list exports`)";
            faults.push("export.to", "nothing", expected);
        }
        for name in self.to.iter().filter(|n| !known.contains(n)) {
            faults.unknown("export.to", name, &known);
        }
        if self.engine && !self.to.iter().any(|n| UNITS.contains(&n.as_str())) {
            faults.push("export.engine", "true", "`fmu2` or `fmu3` in export.to: a plant leaves as an FMU");
        }
    }

    /// What is wanted, with paths that are relative to `folder`.
    pub fn wanted(&self, folder: &Path) -> ExportSpec {
        ExportSpec {
            to: self.to.clone(),
            keys: Keys { precision: self.precision },
            extrapolation: self.extrapolation,
            sample_time_s: None,
            a2l: self.a2l.as_ref().map(|p| folder.join(p)),
            engine: self.engine,
            library: None,
        }
    }
}
