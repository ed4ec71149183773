//! What a simulation gives.

use dynocal_files::FilesError;
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::stored::StoredError;
use dynocal_numerics::interval::Interval;
use serde::Serialize;

use crate::page::PageError;

/// A simulation, the body of `summary.json` (without the samples).
#[derive(Clone, Debug, Serialize)]
pub struct Simulated {
    /// Always `simulate`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether every output stayed near what was measured of it.
    pub valid: bool,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// Models, in the order of the spec.
    pub models: Vec<Used>,
    /// One for each record and output.
    pub outputs: Vec<Output>,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// Records with the channels that drove the models; samples are in files.
    #[serde(skip)]
    pub records: Vec<Dataset>,
}

/// A model as it was used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Used {
    /// File, as the spec names it.
    pub file: String,
    /// Output, in the user's terms.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Channels that drive it.
    pub inputs: Vec<String>,
    /// Parameters.
    pub parameters: usize,
}

/// A free run that left what was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Left {
    /// First sample far outside.
    pub sample: usize,
    /// What it does, in words.
    pub words: String,
}

/// One output on one record.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Output {
    /// Record as the preparation of the model left it.
    pub record: String,
    /// Output.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Samples.
    pub samples: usize,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Least and greatest value; none where the run diverged at once.
    pub range: Option<Interval>,
    /// First sample that is not a finite number; none where all are.
    pub diverged_at: Option<usize>,
    /// Where the run left what was ever measured of the output; none where it stays near.
    pub departure: Option<Left>,
    /// Root mean square of measured less simulated over the scored samples, in the unit of the output; none where the
    /// record has no measured output, or where the run diverged.
    pub rmse: Option<f64>,
    /// Simulated output.
    #[serde(skip)]
    pub y: Vec<f64>,
    /// Measured output.
    #[serde(skip)]
    pub measured: Option<Vec<f64>>,
}

/// A simulation is not possible.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A record.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A model on a record.
    #[error("{file}: {source}")]
    Model {
        /// Model file.
        file: String,
        /// What is wrong.
        source: StoredError,
    },
    /// Two models of one output.
    #[error("{file}: the output `{output}` is that of {other} as well: give one model for each output")]
    Twice {
        /// Model file.
        file: String,
        /// Output.
        output: String,
        /// The other file.
        other: String,
    },
    /// A model that another one drives.
    #[error(
        "{file}: its input `{input}` is the output of {other}: models that drive each other run together in `dynocal identify --model .. --model ..`, which needs measured outputs to start from"
    )]
    Driven {
        /// Model file.
        file: String,
        /// Input.
        input: String,
        /// File of the model that computes it.
        other: String,
    },
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The user stopped it.
    #[error("interrupted before all models were simulated")]
    Interrupted,
}
