//! What test signals give.

use dynocal_files::FilesError;
use dynocal_ident::excitation::correlation::InputCorrelation;
use dynocal_ident::excitation::coverage::{Coverage, PairCoverage};
use dynocal_ident::signal::analysis::Analysis;
use dynocal_numerics::registry::BuildError;
use serde::Serialize;

use super::spec::Job;
use crate::page::PageError;

/// The signals with what is known about them.
#[derive(Clone, Debug)]
pub struct Made {
    /// Samples of every channel.
    pub columns: Vec<Vec<f64>>,
    /// Numbers and curves of every channel.
    pub analyses: Vec<Analysis>,
    /// Coverage of every channel between its least and greatest value.
    pub coverage: Vec<Coverage>,
    /// Coverage of every pair of channels.
    pub pairs: Vec<PairCoverage>,
    /// Correlation of every pair of channels (thesis eqs. 2.45, 2.46).
    pub correlations: Vec<InputCorrelation>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// The body of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Summary<'a> {
    /// Always `signal`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: &'a str,
    /// A signal is what was asked for, or it is refused.
    pub valid: bool,
    /// What the user should know.
    pub warnings: &'a [String],
    /// The request as understood.
    pub signals: &'a Job,
    /// One a channel.
    pub analyses: &'a [Analysis],
    /// One a channel.
    pub coverage: &'a [Coverage],
    /// One a pair.
    pub pairs: &'a [PairCoverage],
    /// One a pair.
    pub correlations: &'a [InputCorrelation],
    /// Files, relative to the run folder.
    pub files: [&'static str; 2],
}

/// The signals could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SignalError {
    /// Keys that do not fit length or sample time.
    #[error("channel `{channel}`: {source}")]
    Build {
        /// Channel.
        channel: String,
        /// Why.
        source: BuildError,
    },
    /// A sample is infinite or not a number.
    #[error("channel `{channel}`: signal {signal}: a sample is not a finite number")]
    NotFinite {
        /// Channel.
        channel: String,
        /// Signal.
        signal: String,
    },
    /// The user stopped it.
    #[error("interrupted before all signals were made")]
    Interrupted,
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
}
