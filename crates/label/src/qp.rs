//! Strictly convex quadratic programs by the dual active-set method.
//!
//! ```text
//! minimise  1/2 x'H x - g'x     subject to  c_i'x >= d_i
//! ```
//!
//! It starts at the unconstrained minimum and adds the limit that is passed most, with as many others dropped as its direction asks
//! for; every step raises the dual objective, so that it ends. The result is exact but for rounding.
//!
//! Reference: D. Goldfarb, A. Idnani, A numerically stable dual method for solving strictly convex quadratic programs, Mathematical
//! Programming 27 (1983), 1-33.

use dynocal_numerics::linalg;

use crate::error::LabelError;
use crate::label::Limit;

/// A solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// Point.
    pub x: Vec<f64>,
    /// Limits that hold it, with their multipliers (positive).
    pub active: Vec<(usize, f64)>,
}

/// State of the search: `J = H^-1/2 Q`, R the triangle of the active limits in it.
struct Search<'a> {
    n: usize,
    limits: &'a [Limit],
    x: Vec<f64>,
    /// n x n, column by column.
    j: Vec<f64>,
    /// Columns of R, column k of length k + 1.
    r: Vec<Vec<f64>>,
    active: Vec<usize>,
    u: Vec<f64>,
}

/// Solves it; `h` (n x n, row-major) must be positive definite, its upper triangle is read.
///
/// # Errors
/// [`LabelError::Singular`], [`LabelError::Contradiction`].
pub fn solve(h: &[f64], g: &[f64], limits: &[Limit]) -> Result<Solved, LabelError> {
    let n = g.len();
    let singular = |e: linalg::LinalgError| LabelError::Singular(e.to_string());
    let mut r = h.to_vec();
    linalg::cholesky(&mut r, n).map_err(singular)?;
    let mut x = g.to_vec();
    linalg::solve_upper_transposed(&r, n, &mut x).map_err(singular)?;
    linalg::solve_upper(&r, n, &mut x).map_err(singular)?;
    if limits.is_empty() {
        return Ok(Solved { x, active: Vec::new() });
    }
    let mut inverse = vec![0.0; n * n];
    linalg::inverse_upper(&r, n, &mut inverse).map_err(singular)?;
    // J = R^-1, columns apart.
    let mut j = vec![0.0; n * n];
    for a in 0..n {
        for b in a..n {
            j[b * n + a] = inverse[a * n + b];
        }
    }
    let mut search = Search { n, limits, x, j, r: Vec::new(), active: Vec::new(), u: Vec::new() };
    // Each limit enters at most a few times; what goes on longer turns in rounding.
    for _ in 0..50 * (limits.len() + n) + 100 {
        let Some(p) = search.most_passed() else {
            let active = search.active.iter().copied().zip(search.u.iter().copied()).collect();
            return Ok(Solved { x: search.x, active });
        };
        search.add(p)?;
    }
    Err(LabelError::Singular("the search for the active limits does not end".into()))
}

impl Search<'_> {
    fn slack(&self, p: usize) -> f64 {
        let l = &self.limits[p];
        l.terms.iter().map(|(k, c)| c * self.x[*k]).sum::<f64>() - l.least
    }

    fn tolerance(&self, p: usize) -> f64 {
        let l = &self.limits[p];
        let size = l.terms.iter().map(|(k, c)| (c * self.x[*k]).abs()).fold(l.least.abs(), f64::max);
        1e-12 * size.max(1e-12)
    }

    fn most_passed(&self) -> Option<usize> {
        let mut worst = None;
        let mut depth = 0.0;
        for p in 0..self.limits.len() {
            let s = self.slack(p);
            if s < -self.tolerance(p) && s < depth && !self.active.contains(&p) {
                (worst, depth) = (Some(p), s);
            }
        }
        worst
    }

    /// `J'c` of limit `p`.
    fn turned(&self, p: usize) -> Vec<f64> {
        let terms = &self.limits[p].terms;
        (0..self.n).map(|k| terms.iter().map(|(i, c)| c * self.j[k * self.n + i]).sum()).collect()
    }

    fn add(&mut self, p: usize) -> Result<(), LabelError> {
        let mut u_p = 0.0;
        loop {
            let (n, q) = (self.n, self.active.len());
            let d = self.turned(p);
            let mut z = vec![0.0; n];
            for k in q..n {
                linalg::axpy(d[k], &self.j[k * n..(k + 1) * n], &mut z);
            }
            let mut r = d[..q].to_vec();
            for k in (0..q).rev() {
                r[k] /= self.r[k][k];
                let v = r[k];
                for i in 0..k {
                    r[i] -= self.r[k][i] * v;
                }
            }
            let whole: f64 = d.iter().map(|v| v * v).sum();
            let free: f64 = d[q..].iter().map(|v| v * v).sum();
            // The dual step that an active limit allows, and the one that meets limit p.
            let blocking = (0..q).filter(|k| r[*k] > 1e-14).map(|k| (self.u[k] / r[k], k));
            let dual = blocking.min_by(|a, b| a.0.total_cmp(&b.0));
            let full = (free > 1e-20 * whole).then(|| -self.slack(p) / free);
            let step = match (dual, full) {
                (None, None) => {
                    return Err(LabelError::Contradiction { limit: self.limits[p].what.clone() });
                }
                (Some((t, _)), None) => t,
                (None, Some(t)) => t,
                (Some((a, _)), Some(b)) => a.min(b),
            };
            if full.is_some() {
                linalg::axpy(step, &z, &mut self.x);
            }
            for k in 0..q {
                self.u[k] -= step * r[k];
            }
            u_p += step;
            match (dual, full) {
                (Some((t, k)), b) if b.is_none_or(|b| t < b) => self.drop(k),
                _ => {
                    self.append(p, u_p, d);
                    return Ok(());
                }
            }
        }
    }

    /// Limit `p` joins: rotations of J's free columns make its part there a single entry.
    fn append(&mut self, p: usize, u: f64, mut d: Vec<f64>) {
        let (n, q) = (self.n, self.active.len());
        for k in (q + 1..n).rev() {
            let (a, b) = (d[k - 1], d[k]);
            if b == 0.0 {
                continue;
            }
            let h = a.hypot(b);
            (d[k - 1], d[k]) = (h, 0.0);
            self.rotate(k - 1, a / h, b / h);
        }
        d.truncate(q + 1);
        self.r.push(d);
        self.active.push(p);
        self.u.push(u);
    }

    /// Limit in place `k` leaves; R becomes triangular again.
    fn drop(&mut self, k: usize) {
        self.active.remove(k);
        self.u.remove(k);
        self.r.remove(k);
        for m in k..self.r.len() {
            let (a, b) = (self.r[m][m], self.r[m][m + 1]);
            let h = a.hypot(b);
            let (c, s) = if h > 0.0 { (a / h, b / h) } else { (1.0, 0.0) };
            for column in &mut self.r[m..] {
                let (a, b) = (column[m], column[m + 1]);
                (column[m], column[m + 1]) = (c * a + s * b, c * b - s * a);
            }
            self.r[m].truncate(m + 1);
            self.rotate(m, c, s);
        }
    }

    /// Columns `k` and `k + 1` of J by the rotation (c, s).
    fn rotate(&mut self, k: usize, c: f64, s: f64) {
        let (left, right) = self.j[k * self.n..(k + 2) * self.n].split_at_mut(self.n);
        for (a, b) in left.iter_mut().zip(right) {
            (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
        }
    }
}
