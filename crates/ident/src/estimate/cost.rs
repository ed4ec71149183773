//! Costs of an error: squared, or Huber's, which lets an outlier pull with a constant force only.
//!
//! ```text
//! rho(e) = e^2                    |e| <= c
//!          2 c |e| - c^2          beyond,          c = threshold x robust standard deviation
//! ```
//!
//! A cost enters Levenberg-Marquardt as the residual `f(e) = sign(e) sqrt(rho(e))`: its squares sum to the cost, and
//! `2 f f' = rho'` makes the gradient exact. The robust standard deviation (1.4826 times the median of |e|) is taken at
//! the start and after each search until it rests.
//!
//! The covariance follows from the errors' pseudo-values `psi(e) / mean psi'` in place of e, with psi = rho'/2.
//!
//! In a one-step fit an outlier of the output also stands in the regressors of the samples after it, where no cost of the
//! error can reach it: mark it as missing, or fit in free run.
//!
//! Reference: P. J. Huber, E. M. Ronchetti, Robust Statistics, 2nd ed. (2009), sections 7.3 to 7.8.

use dynocal_numerics::lm::{LeastSquares, LmOutcome};
use dynocal_numerics::status::Status;
use serde::Deserialize;

/// Which cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CostKind {
    /// e^2.
    #[default]
    Squared,
    /// Huber's.
    Huber,
}

/// Default threshold of Huber's cost: 95 % efficiency with normal errors.
pub const HUBER_THRESHOLD: f64 = 1.345;
/// Normal errors have a median absolute value of this part of their standard deviation.
const MAD_TO_STD: f64 = 1.482_602_218_505_602;
/// Most searches with a new scale.
const MOST_SCALES: usize = 20;
/// Relative change of the scale at which it rests.
const SCALE_TOLERANCE: f64 = 1e-4;

/// A cost with its scale: `c` is infinite for squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cost {
    c: f64,
}

impl Cost {
    pub(super) const SQUARED: Self = Self { c: f64::INFINITY };

    /// Huber's cost for these errors (zeros are samples that are not scored); squares where more than half are zero.
    fn huber(threshold: f64, errors: &[f64]) -> Self {
        let scale = robust_std(errors);
        if scale > 0.0 && threshold > 0.0 { Self { c: threshold * scale } } else { Self::SQUARED }
    }

    pub(super) fn is_squared(self) -> bool {
        self.c == f64::INFINITY
    }

    /// Relative distance of two scales.
    fn differs(self, other: Self) -> f64 {
        if self.c == other.c { 0.0 } else { (self.c / other.c - 1.0).abs() }
    }

    /// psi(e) = rho'(e) / 2.
    fn psi(self, e: f64) -> f64 {
        e.clamp(-self.c, self.c)
    }

    /// Replaces `e` by f(e) and returns f'(e).
    fn transform(self, e: &mut f64) -> f64 {
        let size = e.abs();
        if size <= self.c {
            return 1.0;
        }
        // c (2 |e| - c), and not 2 c |e| - c^2, so that neither overflows early.
        let root = self.c.sqrt() * (2.0 * size - self.c).sqrt();
        *e = root.copysign(*e);
        self.c / root
    }

    /// Share of the scored errors beyond the threshold.
    fn share_beyond(self, errors: &[f64]) -> f64 {
        let scored = errors.iter().filter(|e| **e != 0.0).count();
        errors.iter().filter(|e| e.abs() > self.c).count() as f64 / scored.max(1) as f64
    }

    /// This cost of the first `rows` residuals of `problem` at `x`, and the squares of the others; infinite where they cannot
    /// be computed.
    pub(super) fn total(self, problem: &mut dyn LeastSquares, rows: usize, x: &[f64]) -> f64 {
        let mut r = vec![0.0; problem.residuals()];
        if !problem.residual(x, &mut r) {
            return f64::INFINITY;
        }
        r[..rows].iter_mut().for_each(|e| {
            self.transform(e);
        });
        let total: f64 = r.iter().map(|e| e * e).sum();
        if total.is_finite() { total } else { f64::INFINITY }
    }

    /// Replaces errors by their pseudo-values `k psi(e) / mean psi'`, with Huber's correction
    /// `k = 1 + p/n (1 - mean psi') / mean psi'` for p parameters.
    pub(super) fn pseudo_values(self, errors: &mut [f64], params: usize) {
        if self.is_squared() {
            return;
        }
        let scored = errors.iter().filter(|e| **e != 0.0).count().max(1) as f64;
        let mean_slope = 1.0 - self.share_beyond(errors);
        if mean_slope <= 0.0 {
            return;
        }
        let gain = (1.0 + params as f64 / scored * (1.0 - mean_slope) / mean_slope) / mean_slope;
        errors.iter_mut().for_each(|e| *e = gain * self.psi(*e));
    }
}

/// 1.4826 times the median of the absolute values that are not zero.
fn robust_std(errors: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).filter(|e| *e > 0.0).collect();
    if sizes.is_empty() {
        return 0.0;
    }
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    MAD_TO_STD * *median
}

/// Minimises Huber's cost of the first `rows` residuals of `problem` from `start` with `search`, the scale taken anew after
/// each search until it rests. Gives the last outcome (evaluations and history of all searches) and the cost it is for.
pub(super) fn fit_scale(
    problem: &mut dyn LeastSquares,
    rows: usize,
    threshold: f64,
    start: &[f64],
    mut search: impl FnMut(&mut dyn LeastSquares, &[f64]) -> LmOutcome,
) -> (LmOutcome, Cost) {
    let mut r = vec![0.0; problem.residuals()];
    let mut scale_at = |problem: &mut dyn LeastSquares, x: &[f64]| {
        if problem.residual(x, &mut r) { Cost::huber(threshold, &r[..rows]) } else { Cost::SQUARED }
    };
    let mut cost = scale_at(problem, start);
    let mut found = search(&mut Costed { inner: problem, errors: rows, cost }, start);
    for _ in 1..MOST_SCALES {
        let next = scale_at(problem, &found.x);
        if next.differs(cost) <= SCALE_TOLERANCE || found.status == Status::Interrupted {
            break;
        }
        cost = next;
        let mut other = search(&mut Costed { inner: problem, errors: rows, cost }, &found.x);
        other.history.iter_mut().for_each(|i| i.evaluations += found.evaluations);
        other.evaluations += found.evaluations;
        other.jacobians += found.jacobians;
        found.history.append(&mut other.history);
        other.history = found.history;
        found = other;
    }
    (found, cost)
}

/// A sentence on the share of errors beyond the threshold, where it is more than normal errors have.
pub(super) fn outlier_note(cost: Cost, errors: &[f64]) -> Option<String> {
    let share = cost.share_beyond(errors);
    let far = Cost { c: 3.0 * cost.c }.share_beyond(errors);
    (far > 0.002).then(|| {
        format!(
            "{:.1}% of the errors are beyond Huber's threshold of {:.4e}, {:.1}% beyond three times that: look at them \
             before you trust the rest",
            100.0 * share,
            cost.c,
            100.0 * far
        )
    })
}

/// A least-squares problem whose first `errors` residuals are seen through a cost; the others (penalties) stay squared.
struct Costed<'a> {
    inner: &'a mut dyn LeastSquares,
    errors: usize,
    cost: Cost,
}

impl LeastSquares for Costed<'_> {
    fn n(&self) -> usize {
        self.inner.n()
    }

    fn residuals(&self) -> usize {
        self.inner.residuals()
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        let finite = self.inner.residual(x, r);
        if finite {
            r[..self.errors].iter_mut().for_each(|e| {
                self.cost.transform(e);
            });
        }
        finite
    }

    fn by_blocks(&self) -> bool {
        self.inner.by_blocks()
    }

    fn jacobian_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        // Penalties come last, in a block of their own: each block waits until it is known whether it is that one.
        let (n, cost, penalties) = (self.inner.n(), self.cost, self.residuals() > self.errors);
        let (mut errors, mut slopes): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
        let transform = |errors: &mut [f64], slopes: &mut [f64]| {
            for (e, row) in errors.iter_mut().zip(slopes.chunks_exact_mut(n.max(1))) {
                let slope = cost.transform(e);
                row.iter_mut().for_each(|v| *v *= slope);
            }
        };
        let finite = self.inner.jacobian_blocks(x, &mut |r, rows| {
            transform(&mut errors, &mut slopes);
            if !errors.is_empty() {
                take(&errors, &slopes);
            }
            errors.clear();
            errors.extend_from_slice(r);
            slopes.clear();
            slopes.extend_from_slice(rows);
        });
        if !penalties {
            transform(&mut errors, &mut slopes);
        }
        take(&errors, &slopes);
        finite
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        let n = self.inner.n();
        let finite = self.inner.residual_jacobian(x, r, jac);
        if finite {
            for (e, row) in r[..self.errors].iter_mut().zip(jac.chunks_exact_mut(n.max(1))) {
                let slope = self.cost.transform(e);
                if slope != 1.0 {
                    row.iter_mut().for_each(|v| *v *= slope);
                }
            }
        }
        finite
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    #[test]
    fn the_residual_form_has_the_cost_and_its_slope() {
        let cost = Cost { c: 1.5 };
        for e in [-40.0, -1.5001, -1.4, 0.0, 0.3, 1.5, 7.0] {
            let rho = |e: f64| if e.abs() <= 1.5 { e * e } else { 3.0 * e.abs() - 2.25 };
            let mut f = e;
            let slope = cost.transform(&mut f);
            assert!((f * f - rho(e)).abs() < 1e-12 * (1.0 + rho(e)) && f * e >= 0.0);
            let h = 1e-6;
            let numeric = (rho(e + h) - rho(e - h)) / (2.0 * h);
            assert!((2.0 * f * slope - numeric).abs() < 1e-5, "{e}: {} {numeric}", 2.0 * f * slope);
            assert!((f * slope - cost.psi(e)).abs() < 1e-12);
        }
    }

    /// Of normal errors with one in ten thrown far away, the robust standard deviation stays within 25 %.
    #[test]
    fn the_robust_deviation_withstands_outliers() {
        let mut rng = Rng64::new(2);
        let mut e: Vec<f64> = (0..5000).map(|_| 0.3 * rng.normal()).collect();
        assert!((robust_std(&e) / 0.3 - 1.0).abs() < 0.05);
        e.iter_mut().step_by(10).for_each(|v| *v += 100.0);
        assert!((robust_std(&e) / 0.3 - 1.0).abs() < 0.25);
        assert_eq!(robust_std(&[0.0, 0.0]), 0.0);
        assert_eq!(Cost::huber(1.345, &[0.0; 4]), Cost::SQUARED);
    }
}
