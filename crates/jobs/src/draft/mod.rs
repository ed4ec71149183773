//! The first spec of a job from a measurement file: its channels, units, ranges and sample time, with sensible defaults and a
//! comment where the user knows better.
//!
//! What is written runs as it stands: nothing is left to be filled in. What cannot be known from a file (which channels are
//! outputs, which model a design is for) is a flag, and what was assumed instead is said.

mod calibrate;
mod design;
mod file;
mod identify;
mod map;

use std::path::{Path, PathBuf};

use dynocal_files::FilesError;
use dynocal_files::dataset::Format;
use dynocal_files::measurement::ReadKeys;

pub use file::{Found, FoundChannel, found};

/// What is drafted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A spec of `identify`.
    Identify,
    /// A spec of `design`, for stored models.
    Design,
    /// A spec of `calibrate` on a bed.
    Calibrate,
    /// A spec of `map` on a bed.
    Map,
}

impl Kind {
    /// All kinds with their names.
    pub const ALL: [(&'static str, Kind); 4] = [
        ("identify", Kind::Identify),
        ("design", Kind::Design),
        ("calibrate", Kind::Calibrate),
        ("map", Kind::Map),
    ];

    /// Name of the job.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, k)| *k == self).map_or("", |(name, _)| name)
    }
}

/// What a user knows beside the file.
#[derive(Clone, Debug, Default)]
pub struct Wishes {
    /// How the file is read.
    pub read: ReadKeys,
    /// Its format, where neither its first bytes nor its name tell it.
    pub format: Option<Format>,
    /// The dialect of a CSV file as a spec says it: keys of `data.csv`, as in [`Wishes::read`].
    pub dialect: Option<String>,
    /// Outputs (for `calibrate` and `map`: what is demanded); the last channel that moves where none are named.
    pub outputs: Vec<String>,
    /// Inputs; every other channel that moves where none are named.
    pub inputs: Vec<String>,
    /// Imposed channels, for `calibrate` and `map`; `speed` where none are named.
    pub given: Vec<String>,
    /// Sample time in s of a file without time stamps.
    pub sample_time_s: Option<f64>,
    /// Whether every row is a steady point.
    pub steady: bool,
    /// Stored models, for `design`.
    pub models: Vec<PathBuf>,
}

/// A spec with what was assumed.
#[derive(Clone, Debug, PartialEq)]
pub struct Draft {
    /// TOML.
    pub text: String,
    /// What was assumed, in sentences.
    pub notes: Vec<String>,
}

/// A spec that cannot be drafted.
#[derive(Debug, thiserror::Error)]
pub enum DraftError {
    /// The file or a model.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// What the file lacks.
    #[error("{file}: found {found}, expected {expected}")]
    Lacks {
        /// File.
        file: String,
        /// Found.
        found: String,
        /// Expected.
        expected: String,
    },
}

/// Drafts a spec of `kind` from `file`; paths in it are relative to `folder`, that of the spec.
///
/// # Errors
/// [`DraftError`]: a file that cannot be read, has no channel that moves, no time, or lacks a channel that is named.
///
/// # Examples
/// ```
/// use dynocal_jobs::draft::{Kind, Wishes, draft};
/// let tmp = tempfile::tempdir().unwrap();
/// let file = tmp.path().join("bed.csv");
/// let rows = (0..40).map(|k| format!("{},{},{}\n", 0.1 * f64::from(k), k % 7, k % 5)).collect::<String>();
/// dynocal_files::atomic::write(&file, format!("time [s],throttle [deg],torque [Nm]\n{rows}").as_bytes()).unwrap();
/// let spec = draft(Kind::Identify, &file, tmp.path(), &Wishes::default()).unwrap();
/// assert!(spec.text.contains("column = \"torque\"\nunit = \"Nm\"\nrole = \"output\""));
/// assert!(spec.notes[0].contains("`torque`"));
/// ```
pub fn draft(kind: Kind, file: &Path, folder: &Path, wishes: &Wishes) -> Result<Draft, DraftError> {
    // Maps are made from points: where a file has no time, its rows are some.
    let mut wishes = wishes.clone();
    if matches!(kind, Kind::Map | Kind::Calibrate) && wishes.given.is_empty() && !wishes.inputs.is_empty() {
        // What is no input by name is none, but what the bed imposes by default.
        wishes.given = vec![calibrate::IMPOSED.into()];
    }
    let wishes = &wishes;
    let found = file::found_for(file, wishes, !wishes.steady && kind != Kind::Map)?;
    let path = relative(file, folder);
    match kind {
        Kind::Identify => identify::text(&found, &path, wishes),
        Kind::Design => design::text(&found, &path, folder, wishes),
        Kind::Calibrate => calibrate::text(&found, &path, wishes),
        Kind::Map => map::text(&found, &path, wishes),
    }
}

/// A path as a spec in `folder` says it.
fn relative(file: &Path, folder: &Path) -> String {
    let absolute = |p: &Path| std::path::absolute(p).unwrap_or_else(|_| p.to_path_buf());
    let (file, folder) = (absolute(file), absolute(folder));
    let shown = file.strip_prefix(&folder).map_or(file.as_path(), |inside| inside);
    shown.to_string_lossy().replace('\\', "/")
}

/// A text as TOML writes it.
fn quoted(text: &str) -> String {
    toml::Value::String(text.into()).to_string()
}

/// A number as TOML writes it, rounded to what a person reads; `up` says in which direction.
fn rounded(value: f64, up: bool) -> String {
    if value == 0.0 || !value.is_finite() {
        return "0.0".into();
    }
    let step = 10f64.powf(value.abs().log10().floor() - 2.0);
    let v = if up { (value / step).ceil() } else { (value / step).floor() } * step;
    let digits = (-step.log10()).ceil().clamp(0.0, 12.0) as usize;
    let text = format!("{v:.digits$}");
    if text.contains('.') { text } else { format!("{text}.0") }
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn bounds_enclose_and_are_short() {
        for (v, down, up) in [
            (1234.5, "1230.0", "1240.0"),
            (-0.012_345, "-0.0124", "-0.0123"),
            (20.0, "20.0", "20.0"),
            (0.0, "0.0", "0.0"),
        ] {
            assert_eq!((rounded(v, false).as_str(), rounded(v, true).as_str()), (down, up), "{v}");
        }
    }
}
