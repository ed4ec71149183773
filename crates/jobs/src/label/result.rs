//! What a fit of labels gives.

use dynocal_export::ExportError;
use dynocal_files::FilesError;
use dynocal_label::LabelError;
use dynocal_label::label::Label;
use dynocal_label::ve::Found;
use serde::Serialize;

use crate::page::PageError;

/// A fit of the fuel table, the body of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Labelled {
    /// Always `label`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether the table may be used: false where it explains unseen samples worse than the one before.
    pub valid: bool,
    /// What came out, in words, most important first.
    pub verdict: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// The label with its values before.
    pub label: Label,
    /// Fit and judgement.
    pub found: Found,
    /// Values that are handed over: those before where the table is not changed.
    pub values: Vec<f64>,
    /// Half widths of the 95 % intervals; none where no data tell of a cell.
    pub half_width: Vec<Option<f64>>,
    /// Logs, as they are named.
    pub logs: Vec<String>,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// The changed tune and table, where they are written.
    #[serde(skip)]
    pub handed: Vec<(String, Vec<u8>)>,
}

/// A fit is not possible.
#[derive(Debug, thiserror::Error)]
pub enum LabelJobError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// The tune or the definition of the ECU.
    #[error(transparent)]
    Tune(#[from] ExportError),
    /// The fit.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// A log without a channel that is needed.
    #[error("{file}: no channel for {what}, expected one that is called {expected}; channels are: {known}")]
    Channel {
        /// Log.
        file: String,
        /// What is missing.
        what: &'static str,
        /// Names that would do.
        expected: String,
        /// Names there are.
        known: String,
    },
    /// A channel in another unit than the function takes it in.
    #[error(
        "{file}: channel `{channel}` is in `{found}`, expected `{expected}`, the unit that the spec says"
    )]
    Unit {
        /// File.
        file: String,
        /// Channel.
        channel: String,
        /// Its unit.
        found: String,
        /// Unit of the spec.
        expected: String,
    },
    /// A lambda that is none.
    #[error(
        "{file}: channel `{channel}` has a median of {median:.3} as lambda, expected 0.4 to 3: an air-fuel ratio must be called AFR, a voltage is neither"
    )]
    Lambda {
        /// Log.
        file: String,
        /// Channel.
        channel: String,
        /// Middle value.
        median: f64,
    },
    /// A fuel correction that is no percentage.
    #[error(
        "{file}: channel `{channel}` has a median of {median:.3}, expected percent, 33 to 300 of a running engine: 100 is no correction"
    )]
    Correction {
        /// Log.
        file: String,
        /// Channel.
        channel: String,
        /// Middle value.
        median: f64,
    },
    /// A log that is hardly ever where the table is.
    #[error(
        "{file}: {outside:.0} % of {samples} samples with fuel lie outside of `{table}`: found speeds of {speed_rpm:.0?} and loads of {load:.1?}, expected {axes:.0?} (at most {most:.0} % outside): is it the log, the tune and the load of this engine?"
    )]
    Outside {
        /// Log.
        file: String,
        /// Share of the samples in percent, and what it may be.
        outside: f64,
        /// Greatest share.
        most: f64,
        /// Samples with fuel.
        samples: usize,
        /// Table.
        table: String,
        /// Least and greatest speed.
        speed_rpm: [f64; 2],
        /// Least and greatest load.
        load: [f64; 2],
        /// Ends of the axes.
        axes: [[f64; 2]; 2],
    },
    /// No tune anywhere.
    #[error("{file}: the log carries no tune: give the one that was in the ECU with --tune FILE.msq")]
    NoTune {
        /// Log.
        file: String,
    },
    /// An option that is out of its range.
    #[error("{option}: found {found}, expected {expected}")]
    Option {
        /// Option.
        option: &'static str,
        /// Found.
        found: String,
        /// Expected.
        expected: &'static str,
    },
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The user stopped it.
    #[error("interrupted before the table was fitted")]
    Interrupted,
}
