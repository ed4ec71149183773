//! Where the memory of a model stands before its first scored sample.

use serde::{Deserialize, Serialize};

/// Choice of the initial states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Initial {
    /// At rest: everything before the record was zero.
    #[default]
    Zero,
    /// From the measured values of the initialising samples.
    Data,
    /// Estimated with the parameters, for each record.
    Estimate,
}
