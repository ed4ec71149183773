//! The one player: a [`Plan`] on a [`Plant`], loops closed, recorded as a bed records, and watched.
//!
//! Row t of the record holds the inputs applied from instant t on and the outputs measured at instant t, so that y(t)
//! depends on u(t-1) and earlier. Before every sample the [`Watchdog`] sees what is about to be applied, after it what
//! was measured; when it objects, the plan ends there and the way back that it knows is driven.
//!
//! ```
//! use dynocal_ident::pi::PiGains;
//! use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
//! use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};
//! use dynocal_ident::play::{Unwatched, play};
//!
//! /// y(t+1) = 0.9 y(t) + 0.2 u(t)
//! struct Lag(Vec<Variable>, f64, f64);
//! impl Plant for Lag {
//!     fn variables(&self) -> &[Variable] { &self.0 }
//!     fn reset(&mut self, _seed: u64) { (self.1, self.2) = (0.0, 0.0) }
//!     fn step(&mut self, u: &[f64], dt_s: f64, y: &mut [f64]) -> Result<(), PlantError> {
//!         (self.1, self.2) = (0.9 * self.1 + 0.2 * u[0], self.2 + dt_s);
//!         y[0] = self.1;
//!         Ok(())
//!     }
//!     fn outputs(&self, y: &mut [f64]) -> Result<(), PlantError> { y[0] = self.1; Ok(()) }
//!     fn time_s(&self) -> f64 { self.2 }
//!     fn take_events(&mut self) -> Vec<LimitEvent> { Vec::new() }
//!     fn save(&self) -> PlantState { PlantState(vec![self.1, self.2]) }
//!     fn restore(&mut self, s: &PlantState) -> Result<(), PlantError> { (self.1, self.2) = (s.0[0], s.0[1]); Ok(()) }
//!     fn describe(&self) -> String { "lag".into() }
//! }
//! let variable = |name: &str, causality| Variable {
//!     name: name.into(), unit: "-".into(), causality, min: -10.0, max: 10.0, start: 0.0,
//! };
//! let mut lag = Lag(vec![variable("u", Causality::Input), variable("y", Causality::Output)], 0.0, 0.0);
//!
//! // Open loop: u = 1 leads to y = 0.2 / 0.1 = 2 at rest.
//! let plan = Plan::open_loop("step", 0.1, vec![PlanChannel::free("u", "-", vec![1.0; 200])]);
//! let played = play(&mut lag, &plan, &mut Unwatched)?.whole()?;
//! assert!((played.record.values("y")?[199] - 2.0).abs() < 1e-6);
//!
//! // Closed loop: whatever the feedforward, y comes to its demand.
//! let demand = PlanDemand { output: "y".into(), unit: "-".into(), values: vec![3.0; 200] };
//! let closed = PlanLoop::closed("y", "u", PiGains { ki: 0.5, kp: 0.2 });
//! let played = play(&mut lag, &plan.with_loops(vec![demand], vec![closed]), &mut Unwatched)?.whole()?;
//! assert!((played.record.values("y")?[199] - 3.0).abs() < 1e-3);
//! assert_eq!(played.record.values("y_demand")?[0], 3.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod delay;
mod faults;
mod oscillation;
mod record;
mod session;
mod watch;

pub use delay::{Answer, answer, loop_shift};
pub use faults::RecordFault;
pub use oscillation::{Oscillation, oscillation};
pub use record::{RecordTolerance, check_record, check_record_within};
pub use watch::{Band, Interruptible, UntilStill, Unwatched, Watchdog};

use serde::{Serialize, Serializer};

use crate::data::{DataError, Dataset};
use crate::plan::{Plan, PlanFault};
use crate::plant::{LimitEvent, Plant, PlantError};
use session::Session;

/// Why a plan ended before its last sample.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The next sample or the way back from it was predicted to pass a limit.
    Predicted {
        /// Predicted value with its band.
        value: f64,
        /// The limit.
        limit: f64,
        /// Samples ahead.
        ahead: usize,
    },
    /// The measured value came within the margin of a limit, or passed it.
    Measured {
        /// Value.
        value: f64,
        /// The limit.
        limit: f64,
    },
    /// The plant reported a limit of its own.
    Event(LimitEvent),
    /// The plant refused the inputs.
    #[serde(serialize_with = "as_text")]
    Refused(PlantError),
    /// All outputs stand still: no fault, but what was waited for.
    Still,
    /// The user asked to stop.
    Interrupted,
}

fn as_text<S: Serializer>(e: &PlantError, s: S) -> Result<S::Ok, S::Error> {
    s.collect_str(e)
}

/// Where a plan ended, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stop {
    /// First sample of the plan that was not played.
    pub sample: usize,
    /// Output, or what the plant calls it.
    pub output: String,
    /// Why.
    pub reason: Reason,
}

impl Stop {
    /// An objection of a watchdog; the player knows the sample.
    pub fn new(output: &str, reason: Reason) -> Self {
        Self { sample: 0, output: output.into(), reason }
    }
}

impl std::fmt::Display for Stop {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let (at, what) = (self.sample, &self.output);
        match &self.reason {
            Reason::Predicted { value, limit, ahead } => write!(
                f,
                "ended before sample {at}: `{what}` was predicted at {value:.4} within {ahead} samples, its limit is {limit}"
            ),
            Reason::Measured { value, limit } => {
                write!(
                    f,
                    "ended before sample {at}: `{what}` was measured at {value:.4}, its limit is {limit}"
                )
            }
            Reason::Event(e) => write!(
                f,
                "ended before sample {at}: the plant reported `{}` = {} at its limit {}",
                e.what, e.value, e.limit
            ),
            Reason::Refused(e) => write!(f, "ended before sample {at}: the plant refused it: {e}"),
            Reason::Still => write!(f, "ended before sample {at}: all outputs stand still"),
            Reason::Interrupted => write!(f, "interrupted before sample {at}"),
        }
    }
}

/// How near an output came to its limits.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitDistance {
    /// Output.
    pub output: String,
    /// Least distance to a limit, in the unit of the output; negative: passed.
    pub distance: f64,
}

/// A plan that was played.
#[derive(Clone, Debug)]
pub struct Played {
    /// Inputs as applied, outputs as measured, demands: the plan as far as it went (`played` rows).
    pub record: Dataset,
    /// Samples of the plan that were played.
    pub played: usize,
    /// Samples at the first row before the record begins.
    pub before: usize,
    /// Why it ended early; none where the plan was played to its end.
    pub stop: Option<Stop>,
    /// What was recorded on the way back after a stop; none where there was no way back.
    pub way_back: Option<Dataset>,
    /// Least distance of each limited output to a limit, measured, from the end of settling to the end of the way back;
    /// negative: passed.
    pub least_distance: Vec<LimitDistance>,
    /// Plant time used in s: settling, plan and way back.
    pub used_s: f64,
    /// Limits that the plant reported after settling.
    pub events: Vec<LimitEvent>,
}

impl Played {
    /// The same, where the plan was played to its end.
    ///
    /// # Errors
    /// [`PlayError::Ended`] with sample and reason.
    pub fn whole(self) -> Result<Self, PlayError> {
        match self.stop {
            None => Ok(self),
            Some(stop) => {
                Err(PlayError::Ended { plan: self.record.name, samples: self.played, stop: Box::new(stop) })
            }
        }
    }
}

/// A plan cannot be played.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlayError {
    /// The plan has faults: all of them.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Plan(Vec<PlanFault>),
    /// The plant lacks a channel, or fails before the plan begins.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A channel has another unit than the plant's variable.
    #[error("plan `{plan}`: `{channel}` is in {found}, the plant has it in {expected}")]
    Unit {
        /// Plan.
        plan: String,
        /// Channel.
        channel: String,
        /// Unit of the plan.
        found: String,
        /// Unit of the plant.
        expected: String,
    },
    /// The first row is not a safe point.
    #[error("the safe point is outside of the limits of `{output}`: {value} against {lower} to {upper}")]
    Unsafe {
        /// Output.
        output: String,
        /// Measured there.
        value: f64,
        /// Least value.
        lower: f64,
        /// Largest value.
        upper: f64,
    },
    /// A model of the watchdog does not go with the plan.
    #[error("the model that watches `{output}`: {reason}")]
    Model {
        /// Output.
        output: String,
        /// What is wrong.
        reason: String,
    },
    /// The way back to the safe point was refused: the plant stays where it is.
    #[error("plan `{plan}` {stop}; then the way back to the safe point was refused: {error}")]
    WayBack {
        /// Plan.
        plan: String,
        /// Why it was left.
        stop: Box<Stop>,
        /// What the plant said.
        error: PlantError,
    },
    /// The plan was to be played to its end, and was not.
    #[error("plan `{plan}` {stop} ({samples} samples were played)")]
    Ended {
        /// Plan.
        plan: String,
        /// Samples that were played.
        samples: usize,
        /// Why.
        stop: Box<Stop>,
    },
    /// The record.
    #[error(transparent)]
    Data(#[from] DataError),
}

/// What a watchdog sees: everything that was applied and measured since the player began, settling included.
///
/// With R rows of inputs applied there are R + 1 rows of outputs: row i was measured at the instant from which row i of the
/// inputs is applied. Row 0 is what the plant showed when the player began ([`Plant::outputs`]).
#[derive(Clone, Debug)]
pub struct Course {
    /// Channels of the plan (m).
    pub inputs: Vec<String>,
    /// Outputs of the plant, all of them (p).
    pub outputs: Vec<String>,
    /// Applied inputs, R x m row-major.
    pub u: Vec<f64>,
    /// Outputs, (R + 1) x p row-major.
    pub y: Vec<f64>,
    /// Rows before the first sample of the plan.
    pub before: usize,
}

impl Course {
    /// Rows of inputs that were applied, R.
    pub fn rows(&self) -> usize {
        self.u.len() / self.inputs.len().max(1)
    }

    /// Inputs of row i (m).
    pub fn input(&self, i: usize) -> &[f64] {
        let m = self.inputs.len();
        &self.u[i * m..(i + 1) * m]
    }

    /// Outputs of row i (p).
    pub fn output(&self, i: usize) -> &[f64] {
        let p = self.outputs.len();
        &self.y[i * p..(i + 1) * p]
    }

    /// The safe point: what was applied at the end of settling, or in the first row where nothing was.
    pub fn safe(&self) -> &[f64] {
        self.input(self.before.saturating_sub(1))
    }
}

/// Plays `plan` from the present state of `plant`.
///
/// # Errors
/// [`PlayError`] before the first sample: faults of the plan, names and units that the plant does not have, a safe point
/// that is not safe; and a way back that is refused. What else happens during the plan is no error but a [`Stop`].
pub fn play(plant: &mut dyn Plant, plan: &Plan, watchdog: &mut dyn Watchdog) -> Result<Played, PlayError> {
    let faults = plan.check();
    if !faults.is_empty() {
        return Err(PlayError::Plan(faults));
    }
    let mut session = Session::new(plant, plan)?;
    session.settle(watchdog)?;
    let (played, stop) = session.plan(watchdog);
    let stop = stop.map(|s| Stop { sample: played, ..s });
    if let Some(stop) = &stop {
        session.way_back(watchdog, stop)?;
    }
    session.played(played, stop)
}
