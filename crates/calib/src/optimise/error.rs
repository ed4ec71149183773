//! Why an optimisation could not be set up.

use dynocal_ident::data::{DataError, UnitAfter};
use dynocal_ident::derived::DerivedError;

/// Why an optimisation could not be set up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OptimiseError {
    /// The record lacks something.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A derived channel cannot be computed.
    #[error(transparent)]
    Derived(#[from] DerivedError),
    /// A stored model cannot be used sample by sample.
    #[error(transparent)]
    Stored(#[from] dynocal_ident::stored::StoredError),
    /// The demand cannot be formed.
    #[error(
        "the {output} model is unstable in free run on the start inputs of `{record}`: no demand can be formed from it"
    )]
    Unstable {
        /// Output.
        output: String,
        /// Record.
        record: String,
    },
    /// The start itself breaks a limit.
    #[error(
        "start inputs of `{record}` break the limits: {channel} is {found}{u} at sample {sample}, allowed {lower} to {upper}",
        u = UnitAfter(.unit)
    )]
    Start {
        /// Record.
        record: String,
        /// Channel.
        channel: String,
        /// Value.
        found: f64,
        /// Unit.
        unit: String,
        /// Sample.
        sample: usize,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// An input of a model that nothing gives.
    #[error(
        "the {output} model reads `{found}`, which is neither an input that may move nor given nor the output of another model; these are: {known}"
    )]
    Input {
        /// Output of the model.
        output: String,
        /// Name.
        found: String,
        /// Known names.
        known: String,
    },
    /// An output of the problem that no model computes.
    #[error("no model computes `{output}`, which the problem {role}; models are there for: {known}")]
    NoModel {
        /// Output.
        output: String,
        /// What the problem says of it.
        role: &'static str,
        /// Outputs of the models.
        known: String,
    },
    /// A model that the problem does not know, or a second one of an output.
    #[error("the model of `{output}` is {found}; expected one model for each output of the problem: {known}")]
    Model {
        /// Output.
        output: String,
        /// What is wrong with it.
        found: &'static str,
        /// Outputs of the problem.
        known: String,
    },
    /// A guard that a model has no boundary for.
    #[error(
        "the guard keeps the optimum where the models were identified, by a boundary of the kind `leverage`; the model of `{output}` has {found}; identify it again (`validate.boundary`), or leave the guard out"
    )]
    Guard {
        /// Output of the model.
        output: String,
        /// What it has.
        found: &'static str,
    },
    /// Draws of a model's parameters that cannot be had.
    #[error("a robust optimum holds for draws of the models' parameters; the model of `{output}` {found}")]
    Draws {
        /// Output of the model.
        output: String,
        /// What is wrong with it.
        found: String,
    },
    /// Models that read each other's outputs in a ring.
    #[error("the models of {outputs} read each other's outputs in a ring: the optimisation needs an order")]
    Ring {
        /// Their outputs.
        outputs: String,
    },
    /// An input that no model reads: nothing would hold it.
    #[error(
        "no model reads the input `{input}`: nothing would decide its value; leave it out of the problem"
    )]
    Unread {
        /// Input.
        input: String,
    },
    /// A record that is too short for the models' memory.
    #[error(
        "`{record}` has {found} samples; the models reach back {lag} samples, so at least {expected} are needed"
    )]
    Short {
        /// Record.
        record: String,
        /// Samples.
        found: usize,
        /// Longest lag.
        lag: usize,
        /// Samples needed.
        expected: usize,
    },
    /// A channel of the record is in another unit than a model takes it.
    #[error("{record}: `{channel}` is in `{found}`, the model of `{output}` takes it in `{expected}`")]
    Unit {
        /// Record.
        record: String,
        /// Channel.
        channel: String,
        /// Its unit.
        found: String,
        /// Output of the model.
        output: String,
        /// Unit of the model.
        expected: String,
    },
    /// A problem that no grid can be gone through for.
    #[error(
        "dynamic programming goes through a grid of what the models remember; here it has {found}; expected {expected}"
    )]
    Grid {
        /// What it has.
        found: String,
        /// What it may have.
        expected: String,
    },
    /// Bounds over the record that cross.
    #[error(
        "`{record}`: `{lower}` is {low} and `{upper}` {high} at {at_s} s; expected a lower bound below the upper one",
        low = found[0], high = found[1]
    )]
    Crossed {
        /// Record.
        record: String,
        /// Channel of the lower bound.
        lower: String,
        /// Channel of the upper bound.
        upper: String,
        /// Both values.
        found: [f64; 2],
        /// Time in s.
        at_s: f64,
    },
    /// A part of the record that is too short for its inputs to act within.
    #[error(
        "the way looks {found_s} s ahead, where the models reach back {lag} samples; expected `length_s` of at least {expected_s}"
    )]
    View {
        /// What was asked.
        found_s: f64,
        /// Longest lag.
        lag: usize,
        /// The least that acts.
        expected_s: f64,
    },
    /// Sample times differ.
    #[error("`{record}` is sampled every {found} s, the model of `{output}` every {expected} s")]
    SampleTime {
        /// Record.
        record: String,
        /// Its sample time in s.
        found: f64,
        /// Output of the model.
        output: String,
        /// Its sample time in s.
        expected: f64,
    },
}
