//! Stepwise least squares by PRESS: one column in or out at a time, as long as the prediction of left-out points improves.
//!
//! ```text
//! e = y - X b,   h_i = x_i'(X'X)^-1 x_i,   PRESS = sum_i (e_i / (1 - h_i))^2
//! in:   q = unit part of the new column outside the span;   e <- e - q q'e,    h <- h + q^2
//! out:  g = X (X'X)^-1 e_j, d = (X'X)^-1_jj;                e <- e + g b_j/d,  h <- h - g^2/d
//! ```
//!
//! What is minimised is log PRESS + 2 p / n, p columns.
//!
//! Sources: D. M. Allen, The relationship between variable selection and data augmentation and a method for prediction,
//! Technometrics 16 (1974); D. C. Montgomery, E. A. Peck, G. G. Vining, Introduction to Linear Regression Analysis,
//! section 4.3; R. D. Cook, S. Weisberg, Residuals and Influence in Regression (1982).

use dynocal_numerics::linalg::{axpy, cholesky, dot, invert_upper, solve_upper, solve_upper_transposed};
use rayon::prelude::*;

use super::LeftOut;
use super::features::Coefficients;

/// A column counts as inside the span of the others when less than this of its length lies outside.
const DEPENDENT: f64 = 1e-8;
/// No point may carry its own prediction by more than this.
const LEVERAGE: f64 = 1.0 - 1e-9;
/// A column must lower PRESS by this over n to stand in the model: about a t value of 2. Without it one in six columns
/// that do nothing would stay.
const PRICE: f64 = 2.0;

/// Candidate columns with a rule of what may stand beside what.
pub(super) struct Pool<'a> {
    /// One column (n) per candidate.
    pub(super) columns: &'a [Vec<f64>],
    /// Whether a candidate may stand in a model with the others that are marked.
    pub(super) allowed: &'a (dyn Fn(usize, &[bool]) -> bool + Sync),
    /// Columns that are always in.
    pub(super) always: &'a [usize],
    /// Most columns.
    pub(super) most: usize,
}

/// Least squares over some columns.
#[derive(Clone, Debug)]
pub(super) struct LeastSquares {
    /// Which columns, ascending.
    pub(super) columns: Vec<usize>,
    /// Orthonormal basis, one vector (n) per column.
    basis: Vec<Vec<f64>>,
    /// X = Q R, upper triangular.
    r: Vec<f64>,
    /// Residuals (n).
    pub(super) residuals: Vec<f64>,
    /// Leverages (n).
    pub(super) leverage: Vec<f64>,
}

/// A column that goes in or out, with the cost that it leaves.
#[derive(Clone, Copy)]
struct Step {
    column: usize,
    cost: f64,
}

impl LeastSquares {
    /// Fit of `y` by the columns given. `None` where they are dependent.
    pub(super) fn of(pool: &[Vec<f64>], columns: &[usize], y: &[f64]) -> Option<Self> {
        let n = y.len();
        let k = columns.len();
        let mut fit = Self {
            columns: columns.to_vec(),
            basis: Vec::with_capacity(k),
            r: vec![0.0; k * k],
            residuals: y.to_vec(),
            leverage: vec![0.0; n],
        };
        for (j, column) in columns.iter().enumerate() {
            let mut q = pool[*column].clone();
            let before = dot(&q, &q).sqrt();
            // Twice is enough.
            for _ in 0..2 {
                for (i, other) in fit.basis.iter().enumerate() {
                    let part = dot(other, &q);
                    fit.r[i * k + j] += part;
                    axpy(-part, other, &mut q);
                }
            }
            let rest = dot(&q, &q).sqrt();
            if !(rest > DEPENDENT * before) {
                return None;
            }
            q.iter_mut().for_each(|v| *v /= rest);
            fit.r[j * k + j] = rest;
            let along = dot(&q, &fit.residuals);
            axpy(-along, &q, &mut fit.residuals);
            fit.leverage.iter_mut().zip(&q).for_each(|(h, q)| *h += q * q);
            fit.basis.push(q);
        }
        Some(fit)
    }

    /// Sum of squared residuals of left-out points.
    pub(super) fn press(&self) -> f64 {
        press(self.residuals.iter().zip(&self.leverage).map(|(e, h)| (*e, *h)))
    }

    /// What the steps decrease.
    fn cost(&self) -> f64 {
        cost(self.press(), self.columns.len(), self.residuals.len())
    }

    /// PRESS with one more column; `None` where it lies in the span.
    fn with(&self, column: &[f64]) -> Option<f64> {
        let before = dot(column, column).sqrt();
        let mut q = column.to_vec();
        for _ in 0..2 {
            for other in &self.basis {
                let part = dot(other, &q);
                axpy(-part, other, &mut q);
            }
        }
        let rest = dot(&q, &q).sqrt();
        if !(rest > DEPENDENT * before) {
            return None;
        }
        let along = dot(&q, &self.residuals) / (rest * rest);
        let each = self.residuals.iter().zip(&self.leverage).zip(&q);
        Some(press(each.map(|((e, h), q)| (e - along * q, h + q * q / (rest * rest)))))
    }

    /// PRESS without the column at place `j`.
    fn without(&self, j: usize, y: &[f64]) -> f64 {
        let k = self.columns.len();
        // g = Q R^-T e_j, and d = |R^-T e_j|^2.
        let mut w = vec![0.0; k];
        w[j] = 1.0;
        if solve_upper_transposed(&self.r, k, &mut w).is_err() {
            return f64::INFINITY;
        }
        let d = dot(&w, &w);
        let n = self.residuals.len();
        let mut g = vec![0.0; n];
        self.basis.iter().zip(&w).for_each(|(q, w)| axpy(*w, q, &mut g));
        // b_j = g'y.
        let b = dot(&g, y);
        let each = self.residuals.iter().zip(&self.leverage).zip(&g);
        press(each.map(|((e, h), g)| (e + g * b / d, h - g * g / d)))
    }

    /// Coefficients with their covariance; the noise is that of the residuals with n - p degrees of freedom.
    pub(super) fn coefficients(&self, y: &[f64]) -> Option<Coefficients> {
        let (n, k) = (y.len(), self.columns.len());
        let mut values: Vec<f64> = self.basis.iter().map(|q| dot(q, y)).collect();
        solve_upper(&self.r, k, &mut values).ok()?;
        let noise = dot(&self.residuals, &self.residuals) / (n.saturating_sub(k).max(1)) as f64;
        let mut inverse = vec![0.0; k * k];
        invert_upper(&self.r, k, &mut inverse).ok()?;
        let row = |i: usize| &inverse[i * k..(i + 1) * k];
        let covariance = (0..k * k).map(|p| noise * dot(row(p / k), row(p % k))).collect();
        Some(Coefficients { values, covariance, noise })
    }

    /// Residuals of left-out points with their variance, times a unit.
    pub(super) fn left_out(&self, unit: f64) -> LeftOut {
        let (n, k) = (self.residuals.len(), self.columns.len());
        let noise = dot(&self.residuals, &self.residuals) / (n.saturating_sub(k).max(1)) as f64;
        let rest = || self.leverage.iter().map(|h| 1.0 - h.min(LEVERAGE));
        LeftOut {
            residuals: self.residuals.iter().zip(rest()).map(|(e, r)| unit * e / r).collect(),
            variance: rest().map(|r| unit * unit * noise / r).collect(),
        }
    }
}

fn cost(press: f64, columns: usize, n: usize) -> f64 {
    press.ln() + PRICE * columns as f64 / n as f64
}

fn press(each: impl Iterator<Item = (f64, f64)>) -> f64 {
    each.map(|(e, h)| if h > LEVERAGE { f64::INFINITY } else { (e / (1.0 - h)).powi(2) }).sum()
}

/// Columns in and out as long as the cost decreases, from the fewest columns and, where there are points for it, from all of
/// them: forward alone misses products whose factors do nothing alone. The better end is taken.
pub(super) fn stepwise(pool: &Pool<'_>, y: &[f64], interrupt: &dyn Fn() -> bool) -> Option<LeastSquares> {
    let few = walk(pool, y, pool.always, interrupt);
    let all: Vec<usize> = (0..pool.columns.len()).collect();
    let room = all.len() <= pool.most && 3 * all.len() <= 2 * y.len();
    let many = if room { walk(pool, y, &all, interrupt) } else { None };
    few.into_iter().chain(many).min_by(|a, b| a.cost().total_cmp(&b.cost()))
}

fn walk(pool: &Pool<'_>, y: &[f64], start: &[usize], interrupt: &dyn Fn() -> bool) -> Option<LeastSquares> {
    let mut inside = vec![false; pool.columns.len()];
    start.iter().for_each(|k| inside[*k] = true);
    let mut fit = LeastSquares::of(pool.columns, start, y)?;
    let most = pool.most.min(y.len().saturating_sub(2));
    // Steps never repeat a set, as each lowers the cost; the count is a guard against rounding.
    for _ in 0..4 * pool.columns.len() {
        let now = fit.cost();
        let (n, k) = (y.len(), fit.columns.len());
        let candidates: Vec<usize> = (0..inside.len())
            .filter(|k| !inside[*k] && fit.columns.len() < most && (pool.allowed)(*k, &inside))
            .collect();
        let into = candidates
            .par_iter()
            .filter_map(|c| Some(Step { column: *c, cost: cost(fit.with(&pool.columns[*c])?, k + 1, n) }))
            .collect::<Vec<_>>();
        let out = (0..fit.columns.len())
            .filter(|j| removable(pool, &inside, fit.columns[*j]))
            .map(|j| Step { column: fit.columns[j], cost: cost(fit.without(j, y), k - 1, n) });
        let best = into.into_iter().chain(out).min_by(|a, b| a.cost.total_cmp(&b.cost));
        let Some(best) = best.filter(|b| b.cost < now - 1e-9) else { break };
        inside[best.column] = !inside[best.column];
        let columns: Vec<usize> = (0..inside.len()).filter(|k| inside[*k]).collect();
        match LeastSquares::of(pool.columns, &columns, y) {
            Some(next) if next.cost() < now => fit = next,
            _ => break,
        }
        if interrupt() {
            break;
        }
    }
    Some(fit)
}

/// Whether all others may still stand without this column.
fn removable(pool: &Pool<'_>, inside: &[bool], column: usize) -> bool {
    if pool.always.contains(&column) {
        return false;
    }
    let mut rest = inside.to_vec();
    rest[column] = false;
    (0..rest.len()).all(|k| !rest[k] || pool.always.contains(&k) || (pool.allowed)(k, &rest))
}

/// Weighted least squares of y on the rows of `x` (n x k): coefficients and the inverse of `X'WX` (k x k), with a ridge so
/// small that it only decides where the rows leave something open. `None` when even that fails.
pub(super) fn weighted(x: &[f64], k: usize, weights: &[f64], y: &[f64]) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut gram = vec![0.0; k * k];
    let mut b = vec![0.0; k];
    for ((row, w), y) in x.chunks_exact(k).zip(weights).zip(y) {
        if *w < 1e-12 {
            continue;
        }
        for i in 0..k {
            let wi = w * row[i];
            b[i] += wi * y;
            axpy(wi, &row[i..], &mut gram[i * k + i..(i + 1) * k]);
        }
    }
    let size = (0..k).map(|i| gram[i * k + i]).fold(0.0, f64::max);
    (0..k).for_each(|i| gram[i * k + i] += 1e-10 * size);
    cholesky(&mut gram, k).ok()?;
    let mut inverse = vec![0.0; k * k];
    invert_upper(&gram, k, &mut inverse).ok()?;
    let row = |i: usize| &inverse[i * k..(i + 1) * k];
    let whole: Vec<f64> = (0..k * k).map(|p| dot(row(p / k), row(p % k))).collect();
    solve_upper_transposed(&gram, k, &mut b).ok()?;
    solve_upper(&gram, k, &mut b).ok()?;
    Some((b, whole))
}
