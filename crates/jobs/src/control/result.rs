//! What a control job gives.

use dynocal_control::disk::DiskMargin;
use dynocal_control::error::ControlError;
use dynocal_control::margin::Margins;
use dynocal_control::predictor::TransportFlow;
use dynocal_control::response::MeasuredMargins;
use dynocal_control::runtime::PidGains;
use dynocal_control::stored::StoredController;
use dynocal_control::system::Transfer;
use dynocal_control::tune::{Asked, Lag, Tuned};
use dynocal_files::FilesError;
use dynocal_ident::stored::StoredError;
use serde::Serialize;

use super::bed::Distortion;
use super::decouple::Decoupled;
use super::picture::Picture;
use crate::page::PageError;

/// A control job, the body of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Controlled {
    /// Always `control`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether the gains keep all that is asked at every set point and for every draw, by margins and by the runs that check
    /// them.
    pub valid: bool,
    /// In words.
    pub verdict: Vec<String>,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// What was asked.
    pub asked: Asked,
    /// Balanced disk margin that was asked.
    pub disk_margin_asked: f64,
    /// Sample time in s; none: continuous.
    pub sample_time_s: Option<f64>,
    /// Names of the set points.
    pub points: Vec<String>,
    /// Set points that are outside of what the models were identified on.
    pub beyond: Vec<String>,
    /// Draws at each set point that were asked for.
    pub draws: usize,
    /// Factor by which gains were made smaller because loops act on each other (kp by it, ki by its square).
    pub detuned: f64,
    /// Channels over which gains are scheduled.
    pub schedule: Vec<String>,
    /// What stands between controllers and plant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decoupler: Option<Decoupled>,
    /// Records: what they show.
    pub measured: Vec<MeasuredResult>,
    /// What was measured and speaks against the models or their margins, in words; any makes the gains not valid.
    pub contradicted: Vec<String>,
    /// Loops.
    pub loops: Vec<LoopResult>,
    /// Relative gains at rest, outputs by inputs, for each set point; none where a plant has no steady gains.
    pub relative_gains: Vec<Option<Vec<f64>>>,
    /// All loops closed together, for each set point.
    pub together: Vec<Together>,
    /// Runs that check the margins.
    pub checks: Vec<RunCheck>,
    /// Margins that could not be run, and why.
    pub unchecked: Vec<String>,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// The controller as it runs elsewhere; none for continuous plants.
    #[serde(skip)]
    pub controller: Option<StoredController>,
    /// What is drawn.
    #[serde(skip)]
    pub(super) picture: Picture,
}

/// One loop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LoopResult {
    /// What it holds.
    pub output: String,
    /// By what.
    pub input: String,
    /// Proportional gain that is delivered, with its sign.
    pub kp: f64,
    /// Integral gain in 1/s that is delivered, with its sign.
    pub ki: f64,
    /// Derivative gain in s that is delivered, with its sign; 0: a PI.
    pub kd: f64,
    /// Time constant in s of the filter of the derivative.
    pub derivative_filter_s: f64,
    /// Where it comes from.
    pub rule: String,
    /// Sign of the channel.
    pub sign: f64,
    /// Lag with dead time of the channel at each set point; none where its step response does not settle.
    pub lags: Vec<Option<Lag>>,
    /// Gains of the search and of rules beside each other, positive: each judged alone at all set points.
    pub rules: Vec<Tuned>,
    /// Gains that each set point alone would have, positive.
    pub scheduled: Vec<Option<(f64, f64)>>,
    /// Gains that are delivered at each set point, with their sign; empty where one set of gains serves all.
    pub by_point: Vec<(f64, f64)>,
    /// Smith predictor about it.
    pub predictor: Option<PredictorResult>,
}

impl LoopResult {
    /// The gains that are delivered, with their sign.
    pub fn gains(&self) -> PidGains {
        PidGains { kp: self.kp, ki: self.ki, kd: self.kd, filter_s: self.derivative_filter_s }
    }

    /// Those of a set point: its own where gains are scheduled.
    pub fn gains_at(&self, point: usize) -> PidGains {
        let own = self.by_point.get(point).copied();
        own.map_or(self.gains(), |(kp, ki)| PidGains { kp, ki, ..self.gains() })
    }
}

/// A Smith predictor: how wrong its delay and gain may be, at the set point that stands least.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PredictorResult {
    /// Delay that it predicts in s.
    pub delay_s: f64,
    /// How much longer the delay of the plant may be in s until stability is first lost; none: not lost.
    pub above_s: Option<f64>,
    /// How much shorter, negative.
    pub below_s: Option<f64>,
    /// Factors of the gain of the plant about 1 between which it is stable, looked for from 0.1 to 10.
    pub gain: (f64, f64),
    /// Model of the plant without that delay.
    pub model: Transfer,
    /// Channel of the flow by which the delay goes, and the flow at which it is `delay_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow: Option<TransportFlow>,
}

/// What a record shows without a model, and the models that were made of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredResult {
    /// Record, the name of its set point.
    pub point: String,
    /// Segments of its spectra, and their highest frequency in Hz: 0.4 of the sampling frequency.
    pub segments: usize,
    /// Highest frequency in Hz.
    pub highest_hz: f64,
    /// By loop: orders of A and B, free run over the half that chose them in percent.
    pub models: Vec<((usize, usize), f64)>,
    /// By loop: distortion of the output by its own input, where the test was a multisine.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub distortion: Vec<Option<Distortion>>,
    /// By loop: margins of the measured channel under its gains, the other loops open.
    pub margins: Vec<MeasuredMargins>,
    /// By loop: largest distance of the model's channel from the measured one over frequencies whose coherence is above 0.8, in
    /// standard deviations of the measurement.
    pub distance: Vec<Option<f64>>,
    /// By loop: the same over the size of the response, where it is more than ten standard deviations; none: nowhere.
    pub wrong: Vec<Option<f64>>,
}

/// All loops closed together at one set point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Together {
    /// Set point.
    pub point: String,
    /// Whether it is stable, in words.
    pub stable: String,
    /// Margins of each loop at its output, the others closed; empty where the loop is not stable.
    pub loops: Vec<Margins>,
    /// Balanced disk margin at all inputs.
    pub inputs: Option<DiskMargin>,
    /// Balanced disk margin at all outputs.
    pub outputs: Option<DiskMargin>,
    /// Balanced disk margin at all inputs and outputs.
    pub both: Option<DiskMargin>,
    /// Skewed disk margins (1: of S, -1: of T), all places at once, and balanced ones of each loop alone with the others closed, by where
    /// they act.
    pub other_disks: Vec<(String, DiskMargin)>,
    /// By loop: how its output follows a step of its demand with every loop closed, of the nominal model; empty where the loop is not stable
    /// or where there is no run.
    pub steps: Vec<StepResult>,
    /// Largest ratio of asked to had over nominal model and draws: at most 1 keeps everything; none: not stable for all.
    pub violation: Option<f64>,
    /// The same of the nominal model alone.
    pub violation_nominal: Option<f64>,
    /// Draws of the model that were judged: those that are stable where the model is.
    pub draws: usize,
    /// Draws that are not stable.
    pub unstable_draws: usize,
}

/// How an output follows a step of its demand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepResult {
    /// Time in s after which it stays within 2 %; none: not within the run.
    pub settling_s: Option<f64>,
    /// How far it goes beyond, as a share of the step.
    pub overshoot: f64,
}

/// A margin as a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunCheck {
    /// Set point.
    pub point: String,
    /// Which margin, and which share of it.
    pub what: String,
    /// Natural logarithm of how much the response grows over the second half of the run.
    pub growth: f64,
    /// Whether it should be stable.
    pub expected_stable: bool,
    /// Whether the run does as it should.
    pub holds: bool,
}

/// A control job is not possible.
#[derive(Debug, thiserror::Error)]
pub enum ControlJobError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A model.
    #[error("{file}: {source}")]
    Model {
        /// Model file.
        file: String,
        /// What is wrong.
        source: StoredError,
    },
    /// A record.
    #[error("{file}: {source}")]
    Record {
        /// Record file.
        file: String,
        /// What is wrong.
        source: ControlError,
    },
    /// Gains are to be scheduled over points that make no grid.
    #[error(
        "schedule over {channels}: the {points} set points are no full grid of {expected}: give each combination of values once"
    )]
    Schedule {
        /// Channels.
        channels: String,
        /// Set points.
        points: usize,
        /// What a grid of their values has.
        expected: String,
    },
    /// No model of an output.
    #[error("the loop that holds `{output}`: no model of it; the models are those of {known}")]
    NoModel {
        /// Output.
        output: String,
        /// Outputs that there are.
        known: String,
    },
    /// Two models of one output.
    #[error("{file}: the output `{output}` has a model already: give one model for each output")]
    Twice {
        /// Model file.
        file: String,
        /// Output.
        output: String,
    },
    /// A model does not read the input of a loop.
    #[error(
        "the loop that holds `{output}` by `{input}`: its model does not read `{input}`; it reads {known}"
    )]
    NoInput {
        /// Output.
        output: String,
        /// Input.
        input: String,
        /// Inputs of the model.
        known: String,
    },
    /// A set point.
    #[error("{point}: {source}")]
    Point {
        /// Set point.
        point: String,
        /// What is wrong.
        source: ControlError,
    },
    /// A channel that changes its sign.
    #[error(
        "the answer of `{output}` to `{input}` at rest is {first:.3e} at {at_first} and {second:.3e} at {at_second}: no one PI holds both"
    )]
    Sign {
        /// Output.
        output: String,
        /// Input.
        input: String,
        /// Gain.
        first: f64,
        /// Where.
        at_first: String,
        /// Gain elsewhere.
        second: f64,
        /// Where.
        at_second: String,
    },
    /// A loop that no PI makes stable.
    #[error("the loop that holds `{output}` by `{input}`: {source}")]
    Loop {
        /// Output.
        output: String,
        /// Input.
        input: String,
        /// What is wrong.
        source: ControlError,
    },
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The user stopped it.
    #[error("interrupted before the loops were judged")]
    Interrupted,
}
