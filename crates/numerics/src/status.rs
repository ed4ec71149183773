//! How a computation ended. A status is a numerical outcome that a report shows; a caller's mistake is an
//! error instead, and a fault of ours a panic.

use serde::{Deserialize, Serialize};

/// Why an iteration stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// The stated tolerance is met.
    Converged,
    /// No trial step improves any more although the tolerance is not met.
    Stalled,
    /// The budget of iterations or evaluations is used up.
    Limit,
    /// No point that satisfies the constraints was found.
    Infeasible,
    /// Only non-finite values were met, also at the start.
    Diverged,
    /// Stopped on request.
    Interrupted,
}

impl Status {
    /// Whether the result may be passed on without a warning.
    pub fn is_success(self) -> bool {
        self == Status::Converged
    }
}

/// One line of an iteration history, the same for every optimiser so that they can be compared.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Iterate {
    /// Function evaluations so far.
    pub evaluations: usize,
    /// Best objective so far.
    pub objective: f64,
    /// Largest constraint violation there (0 without constraints).
    pub violation: f64,
    /// Norm of the (projected, scaled) gradient there.
    pub optimality: f64,
}
