//! What can be wrong with a design problem as stated.

/// A design problem cannot be posed as asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// A slice has the wrong length.
    #[error("{what}: found {found} values, expected {expected}")]
    Shape {
        /// What it is.
        what: String,
        /// Length found.
        found: usize,
        /// Length expected.
        expected: usize,
    },
    /// A number is outside its meaning.
    #[error("{what}: found {found}, expected {expected}")]
    Number {
        /// What it is.
        what: String,
        /// Value found.
        found: f64,
        /// What was expected.
        expected: String,
    },
    /// Two limits contradict each other.
    #[error("infeasible limits: {first} and {second} conflict by {}{}", tidy(*.by), at(.sample))]
    Conflict {
        /// First limit with its number.
        first: String,
        /// Second limit with its number.
        second: String,
        /// How far apart they are, in the unit of the channel.
        by: f64,
        /// Sample where it happens, if at one.
        sample: Option<usize>,
    },
    /// A region makes no sense.
    #[error("region `{name}`: found {found}, expected {expected}")]
    Region {
        /// Name of the region.
        name: String,
        /// What is there.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// A criterion needs an objective signal and none is given.
    #[error("{term}: the criterion weighs predictions over an objective signal, but none is given")]
    NoObjectiveSignal {
        /// Name of the term.
        term: String,
    },
    /// Nothing is free to be designed.
    #[error("no input is free: every channel is given or has equal bounds")]
    NothingFree,
    /// No term has a criterion.
    #[error("no model has a criterion: there is nothing to minimise")]
    NoCriterion,
    /// The model's output or sensitivities grow without bound over a record.
    #[error("{term}: the model diverges over {record} (its output or a sensitivity is not finite)")]
    Diverged {
        /// Name of the term.
        term: String,
        /// Which record.
        record: String,
    },
    /// The random start is useless for every seed tried.
    #[error("no start found: {tried} random starts gave no finite criterion ({detail})")]
    NoStart {
        /// Starts tried.
        tried: usize,
        /// What is wrong with the last one.
        detail: String,
    },
}

fn at(sample: &Option<usize>) -> String {
    sample.map_or_else(String::new, |t| format!(" at sample {t}"))
}

/// A number for people: what rounding has left behind the tenth digit is taken off.
pub(crate) fn tidy(v: f64) -> f64 {
    if v == 0.0 || !v.is_finite() {
        return v;
    }
    let unit = 10f64.powi(v.abs().log10().floor() as i32 - 9);
    let rounded = (v / unit).round() * unit;
    // Through text, because the product of the digits and the power of ten is not a short number either.
    format!("{rounded:.9e}").parse().unwrap_or(rounded)
}
