//! Why a campaign cannot go on.

use dynocal_calib::gains::TuneError;
use dynocal_calib::map::structures::MapError;
use dynocal_calib::optimise::OptimiseError;
use dynocal_files::FilesError;
use dynocal_ident::data::DataError;
use dynocal_ident::derived::DerivedError;
use dynocal_ident::plant::PlantError;
use dynocal_ident::play::{Oscillation, PlayError};
use dynocal_ident::stored::StoredError;
use dynocal_numerics::registry::BuildError;

/// Why a campaign cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum ChainError {
    /// A file.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A record.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A derived channel.
    #[error(transparent)]
    Derived(#[from] DerivedError),
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A plan that cannot be played.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// A member of a table.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The optimisation.
    #[error(transparent)]
    Optimise(#[from] OptimiseError),
    /// The map.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A stored model.
    #[error(transparent)]
    Model(#[from] StoredError),
    /// Estimation or selection.
    #[error("{what}: {reason}")]
    Identify {
        /// Model or step.
        what: String,
        /// Reason.
        reason: String,
    },
    /// The test signal.
    #[error("design: {0}")]
    Design(String),
    /// A plan ended early.
    #[error(
        "the record `{record}` {stop}; what was measured is kept in `{kept}`. Narrow `excite.ranges` or `design`, or move the limit"
    )]
    Stopped {
        /// Record.
        record: String,
        /// Where and why.
        stop: String,
        /// File with what was measured.
        kept: String,
    },
    /// A record whose first point is beyond a limit already.
    #[error(
        "the record `{record}` begins beyond a limit of [[abort]]: {output} is {found} at its first point, allowed is {allowed}. Narrow the ranges of the step that makes it (`excite.ranges`, `design`, `optimise.ranges`), or move the limit"
    )]
    BeginsBeyond {
        /// Record.
        record: String,
        /// Output.
        output: String,
        /// Its value at the first point.
        found: String,
        /// What the limit allows, in words.
        allowed: String,
    },
    /// A real bed must measure first.
    #[error(
        "{} wait to be run on the bed:\n{}\nPut each measured record at the path that stands beside it, with the channels {channels}, and start again: finished steps are kept (docs/bed.md)",
        if waiting.len() == 1 { "a plan".to_string() } else { format!("{} plans", waiting.len()) },
        waiting.join("\n")
    )]
    NeedsMeasurement {
        /// `plan -> measured`, one line for each.
        waiting: Vec<String>,
        /// Channels of the record.
        channels: String,
    },
    /// Two files with the record of one plan.
    #[error("`{found}` are all called like the plan `{plan}`: leave one")]
    TwoRecords {
        /// Files.
        found: String,
        /// Plan.
        plan: String,
    },
    /// A record of a bed that is not what the plan asked for.
    #[error("`{measured}` is not the record of the plan `{plan}`:\n{}", faults.join("\n"))]
    Record {
        /// Measured file.
        measured: String,
        /// Plan.
        plan: String,
        /// What differs, in sentences.
        faults: Vec<String>,
    },
    /// Gains of the loops.
    #[error(transparent)]
    Gains(#[from] TuneError),
    /// A record in which a loop oscillates.
    #[error(
        "the record `{record}` is refused: {oscillation}; it is kept in `{kept}`. Give smaller `gains` in [[loops]]; gains that are left out are identified on the plant, where a larger `tune.test_s` makes them surer"
    )]
    Oscillates {
        /// Record.
        record: String,
        /// Loop, period, amplitude.
        oscillation: Box<Oscillation>,
        /// File with what was measured.
        kept: String,
    },
    /// A step that only a plant in the loop can do.
    #[error(
        "the static map and the comparison of the maps step a plant themselves: on a real bed the chain ends with `dynocal calibrate SPEC --until invert`, which has written the map"
    )]
    NeedsPlant,
    /// Fuel by measured states.
    #[error("fuel by measured states (`fuelling`): {0}")]
    Fuelling(String),
    /// Ctrl-C.
    #[error("interrupted: finished steps are kept, start again with the same folder to go on")]
    Interrupted,
    /// The spec.
    #[error("spec: {key} = {found}: expected {expected}")]
    Spec {
        /// Key.
        key: String,
        /// Value.
        found: String,
        /// Expected.
        expected: String,
    },
}
