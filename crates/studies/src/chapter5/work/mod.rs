//! Prediction error against simulation error (thesis chapter 5 and section 7.4).
//!
//! [`known`] is the system (5.3) to (5.5) whose truth is known, with noise at the output (then the simulation error is
//! the right criterion) or in the equation (then the prediction error is); [`searches`] minimises the simulation error
//! by the methods of Table 5.1 and by ours, [`repeated`] does both over many records. [`engine`] makes records of an
//! engine as sections 5.5 and 7.4 did ([`excite`] draws references, [`plans`] and [`gains`] hold them in closed loop),
//! [`polynomials`] fits their structures and [`networks`] trains theirs. [`published`] holds what the thesis printed and what an
//! independent implementation found.
//!
//! Readings: u1 is a fraction; inputs are uniform, held 10, 10 and 100 samples (the printed R2 and MSE imply it), 1000
//! samples; the noise is output error of variance 0.5; a free run starts from the seven measured samples that the lags
//! need, and scores count the others.

pub mod engine;
pub mod excite;
pub mod gains;
pub mod known;
pub mod networks;
pub mod plans;
pub mod polynomials;
pub mod published;
pub mod repeated;
pub mod searches;

use dynocal_files::FilesError;
use dynocal_ident::data::DataError;
use dynocal_ident::estimate::EstimateError;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::StructureError;
use dynocal_ident::nullable;
use dynocal_ident::plant::PlantError;
use dynocal_ident::play::PlayError;
use dynocal_ident::signal;
use dynocal_ident::validate::{Kind, Seen, score};
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

/// A comparison of the chapter could not be made.
#[derive(Debug, thiserror::Error)]
pub enum Chapter5Error {
    /// An estimation failed.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// A record is not what it should be.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A file cannot be read.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A plan that could not be played.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// A signal or method is unknown.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// A structure does not fit its channels.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// A search is unknown.
    #[error("{0}")]
    Method(String),
    /// Fewer records than a comparison needs.
    #[error("{found} engine records, expected {expected}")]
    Records {
        /// Records found.
        found: usize,
        /// Records needed.
        expected: usize,
    },
    /// Interrupted.
    #[error("interrupted")]
    Interrupted,
}

/// Mean squared error and R2 of one model on one or several records.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fitness {
    /// Mean squared error; not finite (stored as null) where a free run diverges.
    #[serde(deserialize_with = "nullable::number")]
    pub mse: f64,
    /// `1 - sum e^2 / sum (z - mean z)^2`.
    #[serde(deserialize_with = "nullable::number")]
    pub r2: f64,
}

impl Fitness {
    /// Of `theta` on one record, computed as `kind` says.
    pub fn of(model: &dyn Model, theta: &[f64], record: &Experiment, kind: Kind) -> Self {
        let s = score(model, theta, std::slice::from_ref(record), kind, Seen::Unseen);
        Self { mse: s.mse, r2: s.r2 }
    }

    /// Means of the two over several records, each scored on its own (as the bars in the thesis' tables).
    pub fn mean_over(model: &dyn Model, theta: &[f64], records: &[Experiment], kind: Kind) -> Self {
        Self::mean(&records.iter().map(|r| Self::of(model, theta, r, kind)).collect::<Vec<_>>())
    }

    /// Means of the two.
    pub fn mean(all: &[Self]) -> Self {
        let n = all.len() as f64;
        let mean = |f: fn(&Self) -> f64| all.iter().map(f).sum::<f64>() / n;
        Self { mse: mean(|s| s.mse), r2: mean(|s| s.r2) }
    }
}

/// `n` samples of uniform random values between the ends of `range`, each held.
fn udrn(
    range: (f64, f64),
    hold_s: f64,
    n: usize,
    sample_time_s: f64,
    rng: &mut Rng64,
) -> Result<Vec<f64>, Chapter5Error> {
    let keys = [("lo", range.0), ("hi", range.1), ("hold_s", hold_s)];
    let keys = keys.into_iter().map(|(k, v)| (k.to_string(), toml::Value::Float(v))).collect();
    let mut u = vec![0.0; n];
    signal::signal("udrn", &keys)?.fill(&mut u, sample_time_s, rng)?;
    Ok(u)
}
