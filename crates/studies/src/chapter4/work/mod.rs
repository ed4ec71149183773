//! Statistics of test signals on the known engine models of thesis chapter 4.
//!
//! The torque model (4.17) and the lambda model (4.53) play the engine: a [`source::Source`] gives identification
//! signals of 100 samples (kept by a [`library::Library`]), least squares gives a model from each noisy record, and
//! unseen signals say how well it predicts. A [`population::Population`] holds what came out, with standard errors.
//! [`constrained`] does so under output and rate limits, [`iterative`] repeats design and estimation,
//! [`objective_signal`] designs for one case, [`convergence`] compares searches, [`fir`] is Example 1; [`published`]
//! holds what the thesis printed and what an independent implementation found.
//!
//! Readings: convention `trim` (y(1..10) = 0, sums over t = 11..100), ABV as a fraction, regressor 17 of (4.17)
//! counted once, term 15 of (4.53) read as u3(t) u3(t-7), R2 in free run against noisy unseen outputs.

pub mod constrained;
pub mod convergence;
pub mod correlation;
pub mod distribution;
pub mod fir;
pub mod iterative;
pub mod library;
mod models;
pub mod objective_signal;
pub mod population;
pub mod published;
pub mod source;
pub mod statistics;

use dynocal_design::channel::Channel;
use dynocal_design::error::DesignError;
use dynocal_design::search::Failure;
use dynocal_ident::estimate::EstimateError;
use dynocal_ident::model::literature::{LiteratureModel, lambda_4_53, torque_4_17};
use dynocal_numerics::registry::BuildError;
use serde::{Deserialize, Serialize};

/// Samples of every signal.
pub const SAMPLES: usize = 100;
/// Longest lag of both models: samples that only initialise.
pub const START: usize = 10;

/// How large a population is.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Size {
    /// Identification signals.
    pub identification: usize,
    /// Validation signals of each random kind.
    pub validation: usize,
    /// Validation signals of each designed kind: fewer, because each costs a search; 0 for none.
    pub designed: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// The objective signal U0 of the prediction criteria: an APRBS with five levels.
const U0: &str = include_str!("../../../../../tests/reference/design_u0.json");

/// A statistic of the chapter could not be computed.
#[derive(Debug, thiserror::Error)]
pub enum Chapter4Error {
    /// A design failed.
    #[error(transparent)]
    Search(#[from] Failure),
    /// A design problem is wrong.
    #[error(transparent)]
    Problem(#[from] DesignError),
    /// A criterion is unknown.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// An estimation failed.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// A known model left the numbers.
    #[error("{model}: the free run over a test signal is not finite")]
    Diverged {
        /// Model.
        model: &'static str,
    },
    /// The stored objective signal cannot be read.
    #[error("objective signal U0: {0}")]
    Objective(String),
    /// Interrupted.
    #[error("interrupted")]
    Interrupted,
}

/// Output of the known engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Output {
    /// Torque in Nm, eq. (4.17).
    Torque,
    /// Lambda, eq. (4.53).
    Lambda,
}

impl Output {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Output::Torque => "torque",
            Output::Lambda => "lambda",
        }
    }
}

/// Models, limits and objective signal of the chapter.
#[derive(Clone, Debug)]
pub struct Setting {
    /// Torque model.
    pub torque: LiteratureModel,
    /// Lambda model.
    pub lambda: LiteratureModel,
    /// Box (4.16) with the speed range of section 4.6: fuel pulse width in us, ABV as a fraction, speed in rpm.
    pub channels: Vec<Channel>,
    /// Objective signal U0 (100 x 3).
    pub u0: Vec<f64>,
}

impl Setting {
    /// The setting of the chapter.
    ///
    /// # Errors
    /// [`Chapter4Error::Objective`] when the stored signal U0 is damaged.
    ///
    /// ```
    /// let s = dynocal_studies::chapter4::work::Setting::new()?;
    /// assert_eq!((s.u0.len(), s.channels.len()), (300, 3));
    /// # Ok::<(), dynocal_studies::chapter4::work::Chapter4Error>(())
    /// ```
    pub fn new() -> Result<Self, Chapter4Error> {
        #[derive(Deserialize)]
        struct Stored {
            u: Vec<[f64; 3]>,
        }
        let stored: Stored = serde_json::from_str(U0).map_err(|e| Chapter4Error::Objective(e.to_string()))?;
        let channels = vec![
            Channel::free("fpw", 2000.0, 6000.0),
            Channel::free("abv", 0.4, 0.6),
            Channel::free("speed", 1000.0, 2000.0),
        ];
        Ok(Self { torque: torque_4_17(), lambda: lambda_4_53(), channels, u0: stored.u.concat() })
    }

    /// The known model of an output.
    pub fn model(&self, output: Output) -> &LiteratureModel {
        match output {
            Output::Torque => &self.torque,
            Output::Lambda => &self.lambda,
        }
    }
}
