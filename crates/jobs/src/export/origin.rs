//! Where a file came from: the run around it.

use std::path::Path;

use dynocal_export::package::{Provenance, ValidRange};
use dynocal_files::run_folder::digest;
use serde_json::Value;

/// The run around a file.
pub(super) struct Origin {
    run: String,
    spec_digest: String,
    /// Digest of all that the step read, data among it.
    data_digest: String,
    file: String,
    file_digest: String,
    /// Sample time of the run in s.
    pub(super) sample_time_s: Option<f64>,
}

fn value(path: &Path) -> Option<Value> {
    serde_json::from_slice(&std::fs::read(path).ok()?).ok()
}

impl Origin {
    /// Of a file with these bytes; without a run around it only the file is known.
    pub(super) fn of(path: &Path, bytes: &[u8]) -> Self {
        let step = path.parent().and_then(|f| value(&f.join("step.json")));
        let data = step.as_ref().and_then(|s| s.get("inputs_digest")).and_then(Value::as_str);
        let run = path.ancestors().skip(1).find(|f| f.join("run.json").is_file());
        let spec = run.and_then(|f| std::fs::read(f.join("spec.json")).ok());
        let dt = run.and_then(|f| value(&f.join("spec.json"))?.get("sample_time_s")?.as_f64());
        Self {
            run: run.map(|f| f.display().to_string()).unwrap_or_default(),
            spec_digest: spec.map(|b| digest(&b)).unwrap_or_default(),
            data_digest: data.unwrap_or_default().into(),
            file: path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            file_digest: digest(bytes),
            sample_time_s: dt,
        }
    }

    /// As an export carries it.
    pub(super) fn provenance(self, validity: Vec<ValidRange>) -> Provenance {
        Provenance {
            run: self.run,
            spec_digest: self.spec_digest,
            version: env!("CARGO_PKG_VERSION").into(),
            data_digest: self.data_digest,
            file: self.file,
            file_digest: self.file_digest,
            validity,
        }
    }
}
