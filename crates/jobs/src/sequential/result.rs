//! What a campaign gives.

use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::stop::Forecast;
use dynocal_files::FilesError;
use dynocal_ident::data::Dataset;
use dynocal_ident::estimate::EstimateError;
use dynocal_ident::model::poly::StructureError;
use dynocal_ident::plant::PlantError;
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::status::Status;
use serde::Serialize;

use crate::page::PageError;

/// A campaign, the body of `summary.json` (without the samples).
#[derive(Clone, Debug, Serialize)]
pub struct Sequenced {
    /// Always `sequential`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether every model came out and no output passed a limit.
    pub valid: bool,
    /// What came of it, in a sentence.
    pub verdict: String,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// Designed records, in their order.
    pub rounds: Vec<RoundLine>,
    /// Whether the stop rule ended the campaign before its budget.
    pub stopped: bool,
    /// Outputs.
    pub outputs: Vec<OutputLine>,
    /// Bed time of the first and the designed records in s.
    pub bed_s: f64,
    /// Bed time of the held-out record in s.
    pub held_out_s: f64,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// The first record and the designed ones.
    #[serde(skip)]
    pub records: Vec<Dataset>,
    /// The held-out record.
    #[serde(skip)]
    pub held_out: Dataset,
    /// Free runs of the last models over the held-out record, by output.
    #[serde(skip)]
    pub computed: Vec<Vec<f64>>,
    /// Models from all records, by output.
    #[serde(skip)]
    pub models: Vec<StoredModel>,
}

/// One designed record.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RoundLine {
    /// Number, from 1.
    pub round: usize,
    /// How its search ended.
    pub status: Status,
    /// Criterion of the record.
    pub criterion: f64,
    /// Error of the first output on the held-out record before it was measured: RMS, unit of the output.
    pub rmse_before: Option<f64>,
    /// What the stop rule expected of it.
    pub forecast: Option<Forecast>,
    /// Whether it was measured; the last one is not where the stop rule ended the campaign.
    pub measured: bool,
}

/// One output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutputLine {
    /// Output.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// RMS of the free-run error on the held-out record with the first record alone; none where it diverges.
    pub rmse_first: Option<f64>,
    /// With all records.
    pub rmse_designed: Option<f64>,
    /// With the first record and random ones of the same recipe and bed time instead.
    pub rmse_random: Option<f64>,
    /// Parameters.
    pub parameters: Vec<ParameterLine>,
    /// Least and largest measured value in the designed records.
    pub measured: Interval,
}

/// A parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterLine {
    /// Name.
    pub name: String,
    /// Value from all records.
    pub value: f64,
    /// Its standard error; none where it is not determined.
    pub std_error: Option<f64>,
    /// Standard error from the first record alone.
    pub std_error_first: Option<f64>,
}

/// A campaign is not possible.
#[derive(Debug, thiserror::Error)]
pub enum SequentialError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The plant lacks a channel.
    #[error("the plant has no {role} `{name}`; there are: {known}")]
    Channel {
        /// Input or output.
        role: &'static str,
        /// Name.
        name: String,
        /// Names that there are.
        known: String,
    },
    /// A channel in another unit than the plant's.
    #[error("channel `{name}` is given in `{found}`: the plant has it in `{expected}`")]
    Unit {
        /// Channel.
        name: String,
        /// Unit of the spec.
        found: String,
        /// Unit of the plant.
        expected: String,
    },
    /// A model of this kind has no sensitivities that a design could use.
    #[error(
        "output `{output}`: a model of the kind `{kind}` cannot be designed for here: expected a NARX kind (`polynomial`, `arx`, `poly_arx`)"
    )]
    Kind {
        /// Output.
        output: String,
        /// Kind.
        kind: String,
    },
    /// A model.
    #[error("output `{output}`: {source}")]
    Structure {
        /// Output.
        output: String,
        /// What is wrong.
        source: StructureError,
    },
    /// Keys of a model.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// An estimate.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// The campaign.
    #[error(transparent)]
    Loop(#[from] LoopError),
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
}
