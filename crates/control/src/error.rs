//! What cannot be computed of a loop.

/// A loop, a plant or a controller that cannot be used as asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ControlError {
    /// A number that cannot be.
    #[error("{what}: found {found}, expected {expected}")]
    Number {
        /// Which number.
        what: String,
        /// Its value.
        found: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// Systems that do not belong together.
    #[error("{what}: found {found}, expected {expected}")]
    Shape {
        /// What was compared.
        what: String,
        /// What is there.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// The loop is not stable, so that it has no margins.
    #[error("{what} is not stable ({poles}): it has no margins")]
    Unstable {
        /// Which loop.
        what: String,
        /// What is known of its unstable poles.
        poles: String,
    },
    /// A matrix without inverse.
    #[error("{what} is singular at {frequency_rad_s} rad/s")]
    Singular {
        /// Which matrix.
        what: String,
        /// Frequency.
        frequency_rad_s: f64,
    },
    /// A stored model that gives no linear model.
    #[error("{0}")]
    Model(String),
}

impl ControlError {
    pub(crate) fn number(what: impl Into<String>, found: f64, expected: &'static str) -> Self {
        Self::Number { what: what.into(), found, expected }
    }

    pub(crate) fn shape(what: impl Into<String>, found: impl ToString, expected: impl ToString) -> Self {
        Self::Shape { what: what.into(), found: found.to_string(), expected: expected.to_string() }
    }
}
