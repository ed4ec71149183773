//! What the job gives.

use dynocal_calib::fuelling::{Fuelling, FuellingError};
use dynocal_files::FilesError;
use dynocal_ident::data::DataError;
use serde::{Deserialize, Serialize};

use super::records::Record;
use super::spec::Tables;
use super::stored::StoredFuelling;
use crate::page::PageError;

/// The result, the body of `summary.json` (without samples).
#[derive(Clone, Debug, Serialize)]
pub struct Fuelled {
    /// Always `fuelling`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether it may be used.
    pub valid: bool,
    /// The verdict in words.
    pub verdict: Vec<String>,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// What was identified.
    pub fuelling: Fuelling,
    /// What it says of each record.
    pub scores: Vec<Score>,
    /// Who drove the course that judges, and how; none for files. Ours first.
    pub driven: Vec<Driven>,
    /// Ranges of the records that identified.
    pub seen: Seen,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// Records and what the model shows of them.
    #[serde(skip)]
    pub records: Vec<Shown>,
    /// What is delivered as tables.
    #[serde(skip)]
    pub tables: Tables,
}

impl Fuelled {
    /// What is kept of it.
    pub fn stored(&self) -> StoredFuelling {
        StoredFuelling {
            valid: self.valid,
            fuelling: self.fuelling.clone(),
            injection_unit: self.records.first().map_or("-".into(), |s| s.record.injection_unit.clone()),
            seen: self.seen,
            tables: self.tables.clone(),
        }
    }
}

/// Errors of 1 / lambda on a record, root mean squares.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Record.
    pub record: String,
    /// `identification` or `unseen`.
    pub role: &'static str,
    /// Length in s.
    pub length_s: f64,
    /// Of the model.
    pub rms: f64,
    /// Of the same without a film, identified from the same records.
    pub rms_without_film: f64,
    /// Of 1 itself: what the mixture did.
    pub rms_of_mixture: f64,
    /// Share of the samples outside of what the identification saw.
    pub outside: f64,
}

/// How the mixture was while somebody drove, by the lambda that the sensor shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Driven {
    /// Who.
    pub name: String,
    /// Whether it is a rival of what was identified.
    pub rival: bool,
    /// What it tuned, on the records of the identification.
    pub setting: String,
    /// Mean of |lambda - 1|.
    pub mean: f64,
    /// Largest lambda - 1.
    pub lean: f64,
    /// Largest 1 - lambda.
    pub rich: f64,
}

/// The rival with the least mean error.
pub(super) fn best_rival(driven: &[Driven]) -> Option<&Driven> {
    driven.iter().filter(|d| d.rival).min_by(|a, b| a.mean.total_cmp(&b.mean))
}

/// Ranges of the records that identified.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seen {
    /// Speed in rpm.
    pub speed_rpm: [f64; 2],
    /// Manifold pressure in kPa.
    pub map_kpa: [f64; 2],
    /// Throttle in deg.
    pub throttle_deg: [f64; 2],
    /// Coolant in degC, where it counts.
    pub coolant_c: Option<[f64; 2]>,
    /// Intake and exhaust cam in deg, where they count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cams_deg: Option<[[f64; 2]; 2]>,
}

/// A record with what the model shows of it.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Record.
    pub record: Record,
    /// `identification`, `unseen`, or who drove.
    pub role: String,
    /// 1 / lambda by the model.
    pub richness: Vec<f64>,
}

/// Nothing comes of it.
#[derive(Debug, thiserror::Error)]
pub enum FuellingJobError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A record.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The plant.
    #[error("{0}")]
    Plant(String),
    /// The identification.
    #[error("{record}: {source}")]
    Identification {
        /// Record or records.
        record: String,
        /// Why.
        source: FuellingError,
    },
    /// A record that judges what was identified from it.
    #[error(
        "unseen: `{record}` is, in whole or in part, among the records of `identification`: expected one that was measured apart"
    )]
    Seen {
        /// Record.
        record: String,
    },
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The user stopped it.
    #[error("interrupted before the model was identified and judged; nothing was written")]
    Interrupted,
}
