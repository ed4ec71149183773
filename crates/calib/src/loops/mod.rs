//! Loops of test design and measurement: what a campaign does with designed records.
//!
//! [`iterate`] identifies, designs, measures and starts again (thesis Figure 4.2); [`sequential`] does so minute by minute in
//! one long test, given all data so far, and ends when [`stop`] says that the next minute is worth too little. Designs may
//! be for a [`pool`] of structures, [`robust`] over a distribution of parameters, for several outputs at once, and
//! within limits whose [`margin`] comes from held-out errors. [`lambda_hold`] keeps the mixture of an engine while a test
//! moves the air, [`rehearsal`] puts a model in the place of the plant.
//!
//! ```
//! use dynocal_calib::loops::bed::TestBed;
//! use dynocal_calib::loops::plan::{Aim, Structure};
//! use dynocal_calib::loops::rehearsal::{Input, ModelPlant};
//! use dynocal_calib::loops::{Rounds, iterate};
//! use dynocal_design::{channel::Channel, search::DesignOptions};
//! use dynocal_ident::{model::poly::PolyNarx, plant::Plant};
//!
//! let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-1)^2", "y(t-1)"])?;
//! let input = Input { name: "u".into(), unit: "-".into(), min: -1.0, max: 1.0, start: 0.0 };
//! let truth = vec![0.1, 1.0, 0.4, 0.5];
//! let mut plant = ModelPlant::new(Box::new(model.clone()), truth.clone(), "y", vec![input], 0.1)?;
//! let bed =
//!     TestBed { channels: vec![Channel::free("u", -1.0, 1.0)], sample_time_s: 0.3, settle_s: 1.0 };
//!
//! // A first record by hand, then two designed ones of 40 samples.
//! let first: Vec<f64> = (0..30).map(|t| 0.5 * (0.7 * t as f64).sin()).collect();
//! let initial = vec![bed.measure(&mut plant, "first", &first)?];
//! let search = DesignOptions { evaluations: 200, ..DesignOptions::default() };
//! let aim = Aim { criterion: "d".into(), keys: Default::default(), objective: vec![], adds: true, search, robust: None };
//! let structures = [Structure::new("y", &model)];
//! let rounds =
//!     Rounds { bed: &bed, structures: &structures, aim: &aim, samples: 40, rounds: 2, limits: &[] };
//! let done = iterate(&mut plant, &rounds, initial, &|| false)?;
//! let (before, after) = (&done.rounds[0].known[0].fit, &done.known[0].fit);
//! assert!(after.std_errors[1] < 0.5 * before.std_errors[1]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod bed;
pub mod lambda_hold;
pub mod margin;
pub mod model;
pub mod plan;
pub mod pool;
pub mod rehearsal;
pub mod robust;
pub mod rounds;
pub mod stop;
pub mod variance;

pub use rounds::{Campaign, Limit, Round, Rounds, StopRule, iterate, sequential};

use dynocal_design::error::DesignError;
use dynocal_design::search::Failure;
use dynocal_ident::data::DataError;
use dynocal_ident::estimate::EstimateError;
use dynocal_ident::plant::PlantError;
use dynocal_ident::play::PlayError;
use dynocal_numerics::registry::BuildError;

/// A loop could not go on.
#[derive(Debug, thiserror::Error)]
pub enum LoopError {
    /// The plant refused a call.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The plant refused a record.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// A record lacks something.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An estimation failed.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// A design problem is wrong.
    #[error(transparent)]
    Problem(#[from] DesignError),
    /// A design failed.
    #[error(transparent)]
    Search(#[from] Failure),
    /// A name or a key is unknown.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// A slice has the wrong length.
    #[error("{what}: found {found} values, expected {expected}")]
    Shape {
        /// What it is.
        what: &'static str,
        /// Length found.
        found: usize,
        /// Length expected, or a whole number of them.
        expected: usize,
    },
    /// A number is outside its meaning.
    #[error("{what}: found {found}, expected {expected}")]
    Number {
        /// What it is.
        what: &'static str,
        /// Value found.
        found: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A model cannot be run or its information is singular where it must not be.
    #[error("{what}: {reason}")]
    Model {
        /// Which model.
        what: String,
        /// What is wrong.
        reason: String,
    },
    /// Interrupted.
    #[error("interrupted")]
    Interrupted,
}
