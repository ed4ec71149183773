//! Least squares with differences.

use super::FuellingError;
use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::status::Status;
use rayon::prelude::*;

/// Relative step of the differences.
const STEP: f64 = 1e-6;

/// How far a search goes.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Effort {
    /// Until it has come to an end: what is delivered. One that ends at its limit is an error.
    Delivered,
    /// What only chooses between models: at the limit the best so far, as far as those that are delivered may go.
    Compared,
    /// The same for a model that starts from its fit to all that a part of is taken: few trials.
    Judged,
}

impl Effort {
    fn evaluations(self) -> usize {
        match self {
            Self::Delivered | Self::Compared => 300,
            Self::Judged => 30,
        }
    }
}

/// Levenberg-Marquardt with forward differences: two and some twenty parameters, each run of the record a few milliseconds.
pub(super) fn searched(
    what: &'static str,
    errors: &(dyn Fn(&[f64], &mut [f64]) -> bool + Sync),
    samples: usize,
    start: &[f64],
    effort: Effort,
    interrupt: &dyn Fn() -> bool,
) -> Result<LmOutcome, FuellingError> {
    let columns = vec![vec![0.0; samples]; start.len()];
    let mut problem = Differences { errors, samples, columns };
    // One standard deviation of a parameter changes the cost by 1 / samples of it: steps below a hundredth of that say nothing.
    let cost_tolerance = 0.01 / samples as f64;
    let options = LmOptions { max_evaluations: effort.evaluations(), cost_tolerance, ..LmOptions::default() };
    let found = levenberg_marquardt_interruptible(&mut problem, start, &options, interrupt);
    match found.status {
        Status::Converged | Status::Stalled => Ok(found),
        Status::Limit if effort != Effort::Delivered => Ok(found),
        Status::Interrupted => Err(FuellingError::Interrupted),
        status => Err(FuellingError::Search { what, status }),
    }
}

struct Differences<'a> {
    errors: &'a (dyn Fn(&[f64], &mut [f64]) -> bool + Sync),
    samples: usize,
    /// Differences of each parameter: independent runs, one by one on the cores that there are.
    columns: Vec<Vec<f64>>,
}

impl LeastSquares for Differences<'_> {
    fn n(&self) -> usize {
        self.columns.len()
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
        let errors = self.errors;
        let difference = |(k, column): (usize, &mut Vec<f64>)| {
            let h = STEP * x[k].abs().max(1.0);
            let mut y = x.to_vec();
            y[k] += h;
            if !errors(&y, column) {
                return false;
            }
            column.iter_mut().zip(r.iter()).for_each(|(o, r)| *o = (*o - r) / h);
            true
        };
        // No short circuit: which of the columns are run must not depend on the threads.
        let finite: Vec<bool> = self.columns.par_iter_mut().enumerate().map(difference).collect();
        if !finite.iter().all(|f| *f) {
            return false;
        }
        let n = self.columns.len();
        for (k, column) in self.columns.iter().enumerate() {
            column.iter().enumerate().for_each(|(t, d)| jac[t * n + k] = *d);
        }
        true
    }
}
