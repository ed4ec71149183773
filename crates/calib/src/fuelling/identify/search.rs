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
    /// A richer model that has to show on what did not fit it that it is better, from its fit to all: few trials. What they miss
    /// counts against it.
    Judged,
}

impl Effort {
    fn evaluations(self) -> usize {
        match self {
            Self::Delivered | Self::Compared => 300,
            Self::Judged => 12,
        }
    }
}

/// Errors as a function of parameters; `false` where they are no numbers.
pub(super) type Errors<'a> = &'a (dyn Fn(&[f64], &mut [f64]) -> bool + Sync);
/// Derivatives of the errors by the last parameters, as many as there are columns.
pub(super) type Slopes<'a> = &'a (dyn Fn(&[f64], &mut [Vec<f64>]) + Sync);

/// Levenberg-Marquardt with forward differences, and derivatives by the last parameters where they are given: two and some twenty
/// parameters, each run of the record a few milliseconds.
pub(super) fn searched(
    what: &'static str,
    (errors, slopes): (Errors<'_>, Option<(usize, Slopes<'_>)>),
    samples: usize,
    start: &[f64],
    effort: Effort,
    interrupt: &dyn Fn() -> bool,
) -> Result<LmOutcome, FuellingError> {
    let columns = vec![vec![0.0; samples]; start.len()];
    let mut problem = Differences { errors, slopes, samples, columns };
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
    errors: Errors<'a>,
    slopes: Option<(usize, Slopes<'a>)>,
    samples: usize,
    /// Derivatives by each parameter: independent runs, one by one on the cores that there are.
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
            // A search that ended beside a bound begins there again: beyond it there is nothing, before it there is.
            for h in [h, -h] {
                y[k] = x[k] + h;
                if errors(&y, column) {
                    column.iter_mut().zip(r.iter()).for_each(|(o, r)| *o = (*o - r) / h);
                    return true;
                }
            }
            false
        };
        let given = self.slopes.map_or(0, |s| s.0);
        let (differed, exact) = self.columns.split_at_mut(x.len() - given);
        let differences = || {
            // No short circuit: which of the columns are run must not depend on the threads.
            let finite: Vec<bool> = differed.par_iter_mut().enumerate().map(difference).collect();
            finite.iter().all(|f| *f)
        };
        let derivatives = || self.slopes.iter().for_each(|(_, slopes)| slopes(x, exact));
        if !rayon::join(differences, derivatives).0 {
            return false;
        }
        let n = self.columns.len();
        for (k, column) in self.columns.iter().enumerate() {
            column.iter().enumerate().for_each(|(t, d)| jac[t * n + k] = *d);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors that end at a bound: from beside it the slope is that of the other side.
    #[test]
    fn a_search_begins_beside_a_bound_too() {
        let errors: Errors<'_> = &|x, out| {
            out[0] = x[0] - 1.0;
            x[0] < 2.0
        };
        let found =
            searched("beside", (errors, None), 1, &[2.0 - 1e-9], Effort::Delivered, &|| false).unwrap();
        assert!((found.x[0] - 1.0).abs() < 1e-5, "{found:?}");
    }

    /// A search without an end: each step takes the same share of the squares. What is delivered must not be of it.
    #[test]
    fn a_search_at_its_limit_is_an_error_where_it_would_be_delivered() {
        let errors: Errors<'_> = &|x, out| {
            out[0] = (-x[0]).exp();
            true
        };
        let ended = |effort| searched("endless", (errors, None), 1, &[1.0], effort, &|| false);
        let status = Status::Limit;
        assert_eq!(ended(Effort::Delivered).unwrap_err(), FuellingError::Search { what: "endless", status });
        for effort in [Effort::Compared, Effort::Judged] {
            let found = ended(effort).unwrap();
            assert!(found.status == status && found.evaluations == effort.evaluations(), "{found:?}");
            assert!(found.x[0] > 2.0, "{found:?}");
        }
    }
}
