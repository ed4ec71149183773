//! Why labels cannot be fitted.

/// A fit that is not possible, with the names of things.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LabelError {
    /// A label contradicts itself.
    #[error("label `{label}`: {reason}")]
    Label {
        /// Label.
        label: String,
        /// Found and expected.
        reason: String,
    },
    /// Limits that no values keep.
    #[error("the limits of the labels contradict each other: no values keep `{limit}` with the others")]
    Contradiction {
        /// The limit that could not be kept.
        limit: String,
    },
    /// Nothing to fit to.
    #[error("found {found} samples that count, expected at least {expected}")]
    TooFew {
        /// Samples.
        found: usize,
        /// Least number.
        expected: usize,
    },
    /// No label that is not locked has any influence.
    #[error("{}", no_influence(*samples, labels))]
    NothingTold {
        /// Samples that count.
        samples: usize,
        /// Labels that may be fitted.
        labels: String,
    },
    /// A log of which too little counts.
    #[error(
        "found {found} of {samples} samples that count, expected at least {expected}; left out: {left_out}"
    )]
    LeftOut {
        /// Samples that count.
        found: usize,
        /// All samples.
        samples: usize,
        /// Least number.
        expected: usize,
        /// Reasons with their samples.
        left_out: String,
    },
    /// A function cannot be evaluated.
    #[error("node `{node}`: {reason}")]
    Node {
        /// Node.
        node: String,
        /// Found and expected.
        reason: String,
    },
    /// More cells than are fitted at once.
    #[error("found {found} cells, expected at most {most} in one fit")]
    TooLarge {
        /// Cells.
        found: usize,
        /// Bound.
        most: usize,
    },
    /// Numbers that are none.
    #[error("{what}: sample {index} is not a finite number")]
    NotFinite {
        /// Which numbers.
        what: &'static str,
        /// Index.
        index: usize,
    },
    /// The equations have no single solution.
    #[error("the data and the smoothness together do not determine the labels: {0}")]
    Singular(String),
}

fn no_influence(samples: usize, labels: &str) -> String {
    match labels {
        "" => format!(
            "all cells of all labels are locked: nothing is left to fit to the {samples} samples that count"
        ),
        _ => format!(
            "none of the {samples} samples that count depends on {labels} at the values that the search starts from: expected a start from which a change of a label changes the target (a time of 0, or one on a bound, may be none)"
        ),
    }
}

impl LabelError {
    pub(crate) fn label(label: &str, reason: impl Into<String>) -> Self {
        Self::Label { label: label.into(), reason: reason.into() }
    }
}
