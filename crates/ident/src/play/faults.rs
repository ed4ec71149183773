//! What can be wrong with the record of a plan, each in a sentence.

use crate::data::UnitAfter;

/// A fault of a record.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RecordFault {
    /// A channel is not there.
    #[error("there is no channel `{channel}`; channels are: {}", .known.join(", "))]
    Missing {
        /// Channel.
        channel: String,
        /// Names there are.
        known: Vec<String>,
    },
    /// A channel is in another unit.
    #[error("`{channel}` is in {found}, the plan has it in {expected}")]
    Unit {
        /// Channel.
        channel: String,
        /// Unit of the record.
        found: String,
        /// Unit of the plan.
        expected: String,
    },
    /// A sample is not a number.
    #[error("`{channel}` has no value at {time_s:.3} s (sample {sample})")]
    NotFinite {
        /// Channel.
        channel: String,
        /// Sample.
        sample: usize,
        /// Its time in the plan.
        time_s: f64,
    },
    /// Too short or too long.
    #[error("it has {found} samples ({found_s:.2} s), the plan has {expected} ({expected_s:.2} s)")]
    Length {
        /// Samples of the record.
        found: usize,
        /// Their time in s.
        found_s: f64,
        /// Samples of the plan.
        expected: usize,
        /// Their time in s.
        expected_s: f64,
    },
    /// The sample time is another.
    #[error("its samples are {found_s} s apart, those of the plan {expected_s} s")]
    Interval {
        /// Of the record, in s.
        found_s: f64,
        /// Of the plan, in s.
        expected_s: f64,
    },
    /// The stamps do not begin at 0.
    #[error(
        "its stamps begin at {found_s} s, the plan begins at 0 s: rows of another time, or of another clock"
    )]
    Start {
        /// First stamp in s.
        found_s: f64,
    },
    /// A stamp is off.
    #[error("sample {sample} has the stamp {found_s} s, expected {expected_s:.4} s after the first")]
    Stamp {
        /// Sample.
        sample: usize,
        /// Time since the first stamp.
        found_s: f64,
        /// Expected.
        expected_s: f64,
    },
    /// A channel without a loop is not what the plan asked for.
    #[error(
        "`{channel}` is not as planned in {samples} of {of} samples: worst at {time_s:.2} s, found {found:.4}{u}, planned {planned:.4}{u}",
        u = UnitAfter(.unit)
    )]
    NotAsPlanned {
        /// Channel.
        channel: String,
        /// Unit.
        unit: String,
        /// Samples that are off.
        samples: usize,
        /// Samples that were compared.
        of: usize,
        /// Time of the worst.
        time_s: f64,
        /// Its value.
        found: f64,
        /// Planned.
        planned: f64,
    },
    /// A channel that a loop drives leaves the range that the plan allows.
    #[error(
        "`{channel}` reaches {found:.4}{u} at {time_s:.2} s: the plan allows {lower} to {upper}{u}",
        u = UnitAfter(.unit)
    )]
    OutsideRange {
        /// Channel.
        channel: String,
        /// Unit.
        unit: String,
        /// Worst value.
        found: f64,
        /// Its time.
        time_s: f64,
        /// Least value of the plan.
        lower: f64,
        /// Greatest value of the plan.
        upper: f64,
    },
    /// An output passes a limit of the plan.
    #[error("`{output}` passes its limit of {limit}{u}: {found:.4}{u} at {time_s:.2} s", u = UnitAfter(.unit))]
    Limit {
        /// Output.
        output: String,
        /// Unit.
        unit: String,
        /// The limit.
        limit: f64,
        /// Worst value.
        found: f64,
        /// Its time.
        time_s: f64,
    },
    /// A value that no sensor gives.
    #[error(
        "`{channel}` reads {found}{u} at {time_s:.2} s, in {samples} samples like that: half of its values lie between {lower:.4} and {upper:.4}{u}",
        u = UnitAfter(.unit)
    )]
    Implausible {
        /// Channel.
        channel: String,
        /// Unit.
        unit: String,
        /// Worst value.
        found: f64,
        /// Its time.
        time_s: f64,
        /// Samples that are implausible.
        samples: usize,
        /// Lower quartile.
        lower: f64,
        /// Upper quartile.
        upper: f64,
    },
    /// A channel stands still where it should move.
    #[error(
        "`{channel}` stands at {value}{u} from {from_s:.2} s to {to_s:.2} s while the plan moves: is it recorded?",
        u = UnitAfter(.unit)
    )]
    Constant {
        /// Channel.
        channel: String,
        /// Unit.
        unit: String,
        /// Value.
        value: f64,
        /// Begin of the stretch in s.
        from_s: f64,
        /// End of it.
        to_s: f64,
    },
    /// An output answers too late or too early.
    #[error("`{output}` answers `{driver}` after {delay_s:.2} s, expected {shortest_s} to {longest_s} s: {}", shift(*.delay_s, *.longest_s))]
    Delay {
        /// Output.
        output: String,
        /// What it answers.
        driver: String,
        /// Found, in s.
        delay_s: f64,
        /// Least plausible delay.
        shortest_s: f64,
        /// Greatest plausible delay.
        longest_s: f64,
    },
    /// The loop acts on another time of the output than the record shows.
    #[error(
        "`{input}` acts on `{output}` as it stands {delay_s:.2} s later in the record: the output is shifted against the input"
    )]
    Shifted {
        /// Output.
        output: String,
        /// Input of the loop.
        input: String,
        /// Shift of the output in s; positive: late.
        delay_s: f64,
    },
}

fn shift(delay_s: f64, longest_s: f64) -> &'static str {
    if delay_s > longest_s {
        "the output is late against the inputs"
    } else {
        "the output is ahead of its cause"
    }
}
