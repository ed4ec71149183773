//! Why no map can be given.

use dynocal_calib::gains::TuneError;
use dynocal_files::FilesError;
use dynocal_ident::model::response::ResponseError;
use dynocal_ident::plant::PlantError;
use dynocal_ident::play::PlayError;
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::watch::Watch;

use crate::page::PageError;

/// No map can be given.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A plan that cannot be played.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// Gains of the loops.
    #[error(transparent)]
    Gains(#[from] TuneError),
    /// Keys of a model.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The plant lacks a channel.
    #[error("the plant has no {role} `{name}` in {unit}; there are: {known}")]
    Channel {
        /// Input or output.
        role: &'static str,
        /// Name.
        name: String,
        /// Unit that the problem has.
        unit: String,
        /// Variables that there are, with their units.
        known: String,
    },
    /// Edits that do not fit the maps.
    #[error("edits: {0}")]
    Edits(String),
    /// The front asks for a response that there is not.
    #[error(
        "{key}: the plant has no output `{name}`, and no derived channel is called so; there are: {known}"
    )]
    Response {
        /// Key of the spec.
        key: &'static str,
        /// Name.
        name: String,
        /// Outputs that there are, with their units.
        known: String,
    },
    /// A real bed must measure first.
    #[error(
        "{count} points wait to be measured on the bed:\n  {plan} -> {measured}\nPut the measured points at the path that stands beside the plan, a row for each point, with the channels {channels}, a column `point` with their numbers (or all of them in their order) and `time [s]` where drift is to be told; then start again: what is measured is kept (docs/map.md){}", if others.is_empty() { String::new() } else { format!(". Beside the records there are files that are called like no plan: {others}") }
    )]
    NeedsMeasurement {
        /// Points of the plan.
        count: usize,
        /// The plan.
        plan: String,
        /// Where its record goes.
        measured: String,
        /// Channels of the record.
        channels: String,
        /// Files beside the records that are called like no plan.
        others: String,
    },
    /// A record of a bed that does not fit its plan.
    #[error("{0}")]
    Record(String),
    /// A channel that the map of a driven input is to follow from.
    #[error("models.over: `{channel}` does not follow from what the points have: {why}")]
    Over {
        /// Channel.
        channel: String,
        /// What is missing.
        why: String,
    },
    /// A response model.
    #[error("response model of `{response}`: {source}")]
    Learn {
        /// Response.
        response: String,
        /// Why.
        source: ResponseError,
    },
    /// A response that does not depend on what is moved.
    #[error(
        "`{response}` shows no signal: its model misses unseen points by {rmse:.4} {unit} rms where the {points} measured points scatter by {spread:.4} {unit} themselves. Take it out of the problem, widen the ranges of the inputs, or average longer (`bed.approach.average_s`)"
    )]
    NoSignal {
        /// Response.
        response: String,
        /// Unit.
        unit: String,
        /// Error on unseen points.
        rmse: f64,
        /// Standard deviation of the measured values.
        spread: f64,
        /// Points.
        points: usize,
    },
    /// The points of the day are too few for what they are for.
    #[error(
        "bed.points: found {points}, expected at least {least}: points to learn from, repeats and verification together"
    )]
    Budget {
        /// Points of the spec.
        points: usize,
        /// Points of the smallest day.
        least: usize,
    },
    /// The bed time does not even reach for the fewest points.
    #[error(
        "bed.minutes: found {minutes:.4} min, of which the gains of the loops took {gains:.1}; expected, beside these, at least {least}"
    )]
    Minutes {
        /// Of the spec.
        minutes: f64,
        /// For the gains of the loops.
        gains: f64,
        /// What is needed beside them, in words.
        least: String,
    },
    /// Too few points came from the bed.
    #[error(
        "{usable} of {measured} measured points can be used, expected at least {least}: {end}{}", if notes.is_empty() { String::new() } else { format!(". Notes of the points: {notes}") }
    )]
    TooFew {
        /// Usable points.
        usable: usize,
        /// Points that were measured.
        measured: usize,
        /// Needed.
        least: usize,
        /// Why the day ended.
        end: String,
        /// Notes with how often they stand.
        notes: String,
    },
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
}

/// What a plan says when the user interrupts is one thing to them.
pub(super) fn stopped(watch: Watch<'_>) -> impl Fn(PlayError) -> MapError + '_ {
    move |e| if watch.interrupted() { MapError::Interrupted } else { MapError::Play(e) }
}
