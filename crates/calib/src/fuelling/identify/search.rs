//! Least squares with differences.

use super::FuellingError;
use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::status::Status;

/// Relative step of the differences.
const STEP: f64 = 1e-6;

/// Levenberg-Marquardt with forward differences: two and some twenty parameters, each run of the record a few milliseconds.
pub(super) fn searched(
    what: &'static str,
    errors: &dyn Fn(&[f64], &mut [f64]) -> bool,
    samples: usize,
    start: &[f64],
    interrupt: &dyn Fn() -> bool,
) -> Result<LmOutcome, FuellingError> {
    let mut problem = Differences { errors, samples, n: start.len(), other: vec![0.0; samples] };
    // One standard deviation of a parameter changes the cost by 1 / samples of it: steps below a hundredth of that say nothing.
    let cost_tolerance = 0.01 / samples as f64;
    let options = LmOptions { max_evaluations: 300, cost_tolerance, ..LmOptions::default() };
    let found = levenberg_marquardt_interruptible(&mut problem, start, &options, interrupt);
    match found.status {
        Status::Converged | Status::Stalled => Ok(found),
        Status::Interrupted => Err(FuellingError::Interrupted),
        status => Err(FuellingError::Search { what, status }),
    }
}

struct Differences<'a> {
    errors: &'a dyn Fn(&[f64], &mut [f64]) -> bool,
    samples: usize,
    n: usize,
    other: Vec<f64>,
}

impl LeastSquares for Differences<'_> {
    fn n(&self) -> usize {
        self.n
    }

    fn residuals(&self) -> usize {
        self.samples
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        (self.errors)(x, r)
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        if !(self.errors)(x, r) {
            return false;
        }
        let mut y = x.to_vec();
        for k in 0..self.n {
            let h = STEP * x[k].abs().max(1.0);
            y[k] = x[k] + h;
            if !(self.errors)(&y, &mut self.other) {
                return false;
            }
            y[k] = x[k];
            for (t, (o, r)) in self.other.iter().zip(r.iter()).enumerate() {
                jac[t * self.n + k] = (o - r) / h;
            }
        }
        true
    }
}
