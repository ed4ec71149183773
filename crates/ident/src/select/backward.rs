//! Backward elimination by F to remove.
//!
//! ```text
//! F_j = theta_j^2 / (s^2 P_jj),    P = (X'X)^-1,    s^2 = e'e / (n - p)          (thesis eq. 2.41)
//! ```
//!
//! All candidates are in at first; the one with the smallest F goes out, until all that are left reach the F to remove.
//! What a removal changes has a closed form, with v = X P_j / P_jj the part of column j outside the others:
//!
//! ```text
//! theta <- theta - P_j theta_j / P_jj,   e <- e + v theta_j,   h <- h - v^2 P_jj,   P <- P - P_j P_j' / P_jj
//! ```
//!
//! These are formed anew from a QR factorisation now and then, so that rounding does not pile up. The columns are stored:
//! for large pools take a forward method.

use dynocal_numerics::linalg::{axpy, dot, invert_upper, least_squares};
use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::basis::Basis;
use super::path::{Action, Change, Selection, Step, Stop, step};
use super::pool::Pool;
use super::{Select, SelectError, StopKeys, interrupted};
use crate::data::DataError;
use crate::estimate::EstimateError;
use crate::experiment::Experiment;

/// Removals between two factorisations.
const REFACTOR: usize = 16;
/// Most stored entries (samples x candidates): 0.8 GB.
const MOST_ENTRIES: usize = 100_000_000;

/// Backward elimination.
#[derive(Clone, Copy, Debug)]
pub struct Backward {
    /// F below which a term goes out; used when `stop` is [`Stop::F`].
    pub f_to_remove: f64,
    /// Which step is kept; [`Stop::Terms`] goes down to that many.
    pub stop: Stop,
    /// Fewest terms.
    pub min_terms: usize,
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Keys {
    f_to_remove: f64,
    stop: StopKeys,
    min_terms: usize,
    rho: f64,
}

impl Default for Keys {
    fn default() -> Self {
        Self { f_to_remove: 3.9, stop: StopKeys::F, min_terms: 1, rho: 2.0 }
    }
}

pub(super) const MEMBER: Member<dyn Select> = Member {
    doc: MemberDoc {
        name: "backward",
        what: "from all candidates down by F to remove, eq. (2.41)",
        params: &[
            super::F_TO_REMOVE,
            super::STOP,
            ParamDoc { name: "min_terms", unit: "-", default: "1", what: "fewest terms" },
            super::RHO,
        ],
    },
    build,
};

fn build(keys: &toml::Table) -> Result<Box<dyn Select>, BuildError> {
    let k: Keys = registry::keys("backward", keys)?;
    let stop = k.stop.stop("backward", k.min_terms.max(1), k.rho, k.f_to_remove)?;
    Ok(Box::new(Backward { f_to_remove: k.f_to_remove, stop, min_terms: k.min_terms.max(1) }))
}

impl Select for Backward {
    fn select(
        &self,
        pool: &Pool,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Selection, SelectError> {
        let p = pool.candidates().len();
        let basis = Basis::new(pool, data, 1)?;
        let n = basis.n();
        more_than(n, p, data, format!("{p} candidates, all of which are in at first"))?;
        if n.saturating_mul(p) > MOST_ENTRIES {
            let message = format!(
                "backward elimination starts from all {p} candidates over {n} samples, expected at most \
                 {MOST_ENTRIES} entries: use frols or forward"
            );
            return Err(SelectError::Pool { message });
        }
        let columns: Vec<Vec<f64>> = (0..p).map(|i| basis.plain(i)).collect();
        let mut full = Full::new(columns, basis.output().to_vec());
        drop(basis);
        full.factor(data)?;
        let total = dot(&full.y, &full.y);
        let rho = self.stop.rho();
        let row = |f: &Full, candidate: usize, before: f64| {
            let change = Change {
                candidate,
                action: Action::Removed,
                terms: f.left.len(),
                before,
                after: dot(&f.e, &f.e),
                press: f.press(),
            };
            step(pool, n, total, rho, change)
        };
        let mut path: Vec<Step> = Vec::new();
        leave_out_dependent(&mut full, &mut path, &row);
        let independent = path.len();
        let start = row(&full, 0, dot(&full.e, &full.e));
        while full.left.len() > self.min_terms {
            interrupted(interrupt)?;
            let (j, f) = full.least_useful();
            if matches!(self.stop, Stop::F { .. }) && f >= self.f_to_remove {
                break;
            }
            let (candidate, before) = (full.left[j], dot(&full.e, &full.e));
            full.remove(j);
            path.push(row(&full, candidate, before));
            if (path.len() - independent).is_multiple_of(REFACTOR) {
                full.factor(data)?;
                leave_out_dependent(&mut full, &mut path, &row);
            }
        }
        // The state before the first true removal competes with those after it.
        let mut states = vec![start];
        states.extend_from_slice(&path[independent..]);
        let steps = independent + self.stop.steps(&states).saturating_sub(1);
        Selection::new(pool, (0..p).collect(), path, steps)
    }
}

/// Rows of the terms that the last factorisation found dependent: nothing changes without them.
fn leave_out_dependent(full: &mut Full, path: &mut Vec<Step>, row: &dyn Fn(&Full, usize, f64) -> Step) {
    let rss = dot(&full.e, &full.e);
    for k in std::mem::take(&mut full.dependent) {
        path.push(row(full, k, rss));
    }
}

/// n samples are enough for p terms.
fn more_than(n: usize, p: usize, data: &[Experiment], why: String) -> Result<(), SelectError> {
    if n > p {
        return Ok(());
    }
    let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
    Err(EstimateError::from(DataError::TooShort { record, found: n, expected: p + 1, why }).into())
}

/// The regression on all terms that are left.
struct Full {
    /// Columns (n each) of the terms that are left, and their places in the pool.
    columns: Vec<Vec<f64>>,
    left: Vec<usize>,
    /// Terms found dependent by the last factorisation.
    dependent: Vec<usize>,
    y: Vec<f64>,
    theta: Vec<f64>,
    /// (X'X)^-1 (p x p).
    inverse: Vec<f64>,
    /// Residuals and leverages (n).
    e: Vec<f64>,
    h: Vec<f64>,
}

impl Full {
    fn new(columns: Vec<Vec<f64>>, y: Vec<f64>) -> Self {
        let (p, n) = (columns.len(), y.len());
        let (e, h) = (y.clone(), vec![0.0; n]);
        Self {
            left: (0..p).collect(),
            columns,
            dependent: Vec::new(),
            y,
            theta: vec![],
            inverse: vec![],
            e,
            h,
        }
    }

    /// Everything from a QR factorisation of the columns that are left; dependent ones are taken out first.
    fn factor(&mut self, data: &[Experiment]) -> Result<(), SelectError> {
        let numeric = |source| EstimateError::Numeric { estimator: "backward", source };
        let (mut fit, mut rows) = self.solve().map_err(numeric)?;
        if !fit.factor.dependent.is_empty() {
            let out = fit.factor.dependent.clone();
            for k in out.iter().rev() {
                self.dependent.push(self.left.remove(*k));
                self.columns.remove(*k);
            }
            (fit, rows) = self.solve().map_err(numeric)?;
        }
        let (p, n) = (self.left.len(), self.y.len());
        more_than(n, p, data, format!("{p} independent candidates"))?;
        let mut r_inverse = vec![0.0; p * p];
        invert_upper(&fit.factor.r, p, &mut r_inverse).map_err(numeric)?;
        // Back from pivoted order and unit columns.
        let mut a = vec![0.0; p * p];
        for i in 0..p {
            let k = fit.factor.order[i];
            for j in 0..p {
                a[k * p + j] = r_inverse[i * p + j] / fit.factor.scale[k];
            }
        }
        self.inverse = vec![0.0; p * p];
        for i in 0..p {
            for j in 0..=i {
                let v = dot(&a[i * p..(i + 1) * p], &a[j * p..(j + 1) * p]);
                self.inverse[i * p + j] = v;
                self.inverse[j * p + i] = v;
            }
        }
        self.theta = fit.x;
        let mut q = vec![0.0; p];
        for t in 0..n {
            let row = &rows[t * p..(t + 1) * p];
            self.e[t] = self.y[t] - dot(row, &self.theta);
            q.fill(0.0);
            row.iter().enumerate().for_each(|(k, x)| axpy(*x, &a[k * p..(k + 1) * p], &mut q));
            self.h[t] = dot(&q, &q);
        }
        Ok(())
    }

    /// Least squares on the columns that are left, and these row by row.
    fn solve(
        &self,
    ) -> Result<(dynocal_numerics::linalg::LeastSquaresFit, Vec<f64>), dynocal_numerics::linalg::LinalgError>
    {
        let (p, n) = (self.left.len(), self.y.len());
        let mut rows = vec![0.0; n * p];
        for (k, column) in self.columns.iter().enumerate() {
            rows[k..].iter_mut().step_by(p).zip(column).for_each(|(r, c)| *r = *c);
        }
        Ok((least_squares(&rows, n, p, &self.y, 0.0)?, rows))
    }

    fn press(&self) -> f64 {
        let sum: f64 = self.e.iter().zip(&self.h).map(|(e, h)| (e / (1.0 - h).max(1e-12)).powi(2)).sum();
        sum / self.y.len() as f64
    }

    /// Place and F of the term with the smallest F.
    fn least_useful(&self) -> (usize, f64) {
        let p = self.left.len();
        let s2 = dot(&self.e, &self.e) / (self.y.len() - p).max(1) as f64;
        let f = |j: usize| self.theta[j] * self.theta[j] / (s2 * self.inverse[j * p + j]);
        (0..p).map(|j| (j, f(j))).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
    }

    fn remove(&mut self, j: usize) {
        let p = self.left.len();
        let own: Vec<f64> = self.inverse[j * p..(j + 1) * p].to_vec();
        let mut v = vec![0.0; self.y.len()];
        for (column, weight) in self.columns.iter().zip(&own) {
            axpy(weight / own[j], column, &mut v);
        }
        axpy(self.theta[j], &v, &mut self.e);
        self.h.iter_mut().zip(&v).for_each(|(h, v)| *h -= v * v * own[j]);
        let theta_j = self.theta[j];
        axpy(-theta_j / own[j], &own, &mut self.theta);
        self.theta.remove(j);
        let mut smaller = Vec::with_capacity((p - 1) * (p - 1));
        for a in (0..p).filter(|a| *a != j) {
            for b in (0..p).filter(|b| *b != j) {
                smaller.push(self.inverse[a * p + b] - own[a] * own[b] / own[j]);
            }
        }
        self.inverse = smaller;
        self.left.remove(j);
        self.columns.remove(j);
    }
}
