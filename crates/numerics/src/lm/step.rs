//! The trust-region step of Levenberg-Marquardt in scaled variables q = D p.
//!
//! ```text
//! (S + mu I) q = -D^-1 J'r,   S = D^-1 J'J D^-1,   |q(mu)| = delta (to 10 %)   or mu = 0
//! ```
//!
//! S + mu I = U'U comes from the Cholesky factor of the Gram matrix as long as that keeps enough digits, else
//! from a QR factorisation of `[J D^-1; sqrt(mu) I]`, which is twice as accurate and about twice as slow.

use super::effective;
use crate::linalg::{QrWork, cholesky, dot, gram_upper, norm2, solve_upper, solve_upper_transposed};

/// Squared pivot of the unit-diagonal Gram matrix below which its Cholesky step would lose more than half of the digits.
const GRAM_PIVOT_FLOOR: f64 = 1e-9;

/// The linearised problem at a point.
pub(super) struct Model<'a> {
    pub(super) jac: &'a [f64],
    pub(super) r: &'a [f64],
    pub(super) gradient: &'a [f64],
    pub(super) scale: &'a [f64],
}

/// Solves for steps; buffers for one problem size.
pub(super) struct StepSolver {
    m: usize,
    n: usize,
    gram: Vec<f64>,
    factor: Vec<f64>,
    rhs: Vec<f64>,
    q: Vec<f64>,
    w: Vec<f64>,
    have_gram: bool,
    orthogonal: Orthogonal,
}

/// Buffers of the orthogonal path: R of `[J D^-1, r]`, and the small augmented system.
struct Orthogonal {
    /// Made at the first use: most problems never need it.
    tall: Option<QrWork>,
    scaled: Vec<f64>,
    small: QrWork,
    r: Vec<f64>,
    stacked: Vec<f64>,
    factor: Vec<f64>,
    ready: bool,
}

impl StepSolver {
    pub(super) fn new(m: usize, n: usize) -> Self {
        let w = n + 1;
        Self {
            m,
            n,
            gram: vec![0.0; n * n],
            factor: vec![0.0; n * n],
            rhs: vec![0.0; n],
            q: vec![0.0; n],
            w: vec![0.0; n],
            have_gram: false,
            orthogonal: Orthogonal {
                tall: None,
                scaled: Vec::new(),
                small: QrWork::new(w + n, w),
                r: vec![0.0; w * w],
                stacked: vec![0.0; (w + n) * w],
                factor: vec![0.0; w * w],
                ready: false,
            },
        }
    }

    /// The Jacobian or the scale has changed.
    pub(super) fn set_jacobian(&mut self) {
        self.have_gram = false;
        self.orthogonal.ready = false;
    }

    /// Fills `p` with the step for the trust radius `delta` and returns mu.
    pub(super) fn step(&mut self, model: &Model<'_>, delta: f64, p: &mut [f64]) -> f64 {
        self.prepare(model);
        // mu = 0 is the Gauss-Newton step; a singular S gets the least damping that rounding can see.
        let mut mu = 0.0;
        if !self.solve(model, 0.0) {
            mu = f64::EPSILON * self.n as f64;
            if !self.solve(model, mu) {
                mu = 1e-12;
                self.solve(model, mu);
            }
        }
        let floor = mu;
        let mut size = norm2(&self.q);
        if size > 1.1 * delta || size.is_nan() {
            mu = self.search_mu(model, delta, floor);
            size = norm2(&self.q);
        }
        debug_assert!(size.is_finite());
        for k in 0..self.n {
            p[k] = self.q[k] / effective(model.scale[k]);
        }
        mu
    }

    /// Newton iteration on 1/|q(mu)| = 1/delta with bounds (Hebden; More 1978, section 5).
    fn search_mu(&mut self, model: &Model<'_>, delta: f64, floor: f64) -> f64 {
        let mut low = floor;
        let mut high = norm2(&self.rhs) / delta;
        let mut next = self.newton_mu(floor, delta).clamp(low, high.max(low));
        let mut mu = floor;
        for _ in 0..12 {
            mu = if next <= low { (low * high).sqrt().max(1e-3 * high) } else { next };
            if !self.solve(model, mu) {
                low = mu;
                next = 0.0;
                continue;
            }
            let size = norm2(&self.q);
            if (size - delta).abs() <= 0.1 * delta {
                break;
            }
            if size > delta {
                low = low.max(mu);
            } else {
                high = high.min(mu);
            }
            next = self.newton_mu(mu, delta).clamp(low, high.max(low));
        }
        mu
    }

    /// One Newton step of the secular equation from the factor of S + mu I that stands in `factor`.
    fn newton_mu(&mut self, mu: f64, delta: f64) -> f64 {
        let size = norm2(&self.q);
        if !(size > 0.0 && size.is_finite()) {
            return mu;
        }
        self.w.copy_from_slice(&self.q);
        if solve_upper_transposed(&self.factor, self.n, &mut self.w).is_err() {
            return mu;
        }
        // d|q|/dmu = -|U'^-1 q|^2 / |q|.
        mu + (size / delta - 1.0) * size * size / dot(&self.w, &self.w)
    }

    fn prepare(&mut self, model: &Model<'_>) {
        for k in 0..self.n {
            self.rhs[k] = -model.gradient[k] / effective(model.scale[k]);
        }
        if self.have_gram {
            return;
        }
        let n = self.n;
        gram_upper(model.jac, self.m, n, &mut self.gram).expect("the buffers have the problem's size");
        for i in 0..n {
            for j in i..n {
                self.gram[i * n + j] /= effective(model.scale[i]) * effective(model.scale[j]);
            }
        }
        self.have_gram = true;
    }

    /// Solves (S + mu I) q = rhs into `q`, the factor into `factor`; `false` when it is singular.
    fn solve(&mut self, model: &Model<'_>, mu: f64) -> bool {
        let n = self.n;
        self.factor.copy_from_slice(&self.gram);
        for k in 0..n {
            self.factor[k * n + k] += mu;
        }
        let sound = cholesky(&mut self.factor, n).is_ok()
            && (0..n)
                .all(|k| self.factor[k * n + k].powi(2) > GRAM_PIVOT_FLOOR * (self.gram[k * n + k] + mu));
        if !sound {
            return self.solve_orthogonal(model, mu);
        }
        self.q.copy_from_slice(&self.rhs);
        solve_upper_transposed(&self.factor, n, &mut self.q).is_ok()
            && solve_upper(&self.factor, n, &mut self.q).is_ok()
            && self.q.iter().all(|v| v.is_finite())
    }

    /// The same from the QR factorisation of `[J D^-1, r; sqrt(mu) I, 0]`.
    fn solve_orthogonal(&mut self, model: &Model<'_>, mu: f64) -> bool {
        let (n, w) = (self.n, self.n + 1);
        let o = &mut self.orthogonal;
        if !o.ready {
            o.scaled.clear();
            for (row, r) in model.jac.chunks_exact(n.max(1)).zip(model.r) {
                o.scaled.extend(row.iter().zip(model.scale).map(|(v, d)| v / effective(*d)));
                o.scaled.push(*r);
            }
            let tall = o.tall.get_or_insert_with(|| QrWork::new(self.m, w));
            tall.r_factor(&o.scaled, &mut o.r).expect("the buffers have the problem's size");
            o.ready = true;
        }
        o.stacked[..w * w].copy_from_slice(&o.r);
        o.stacked[w * w..].fill(0.0);
        for k in 0..n {
            o.stacked[(w + k) * w + k] = mu.sqrt();
        }
        o.small.r_factor(&o.stacked, &mut o.factor).expect("the buffers have the problem's size");
        for i in 0..n {
            self.factor[i * n..(i + 1) * n].copy_from_slice(&o.factor[i * w..i * w + n]);
            self.q[i] = -o.factor[i * w + n];
        }
        let singular = (0..n).any(|k| self.factor[k * n + k] <= f64::EPSILON * n as f64);
        !singular && solve_upper(&self.factor, n, &mut self.q).is_ok() && self.q.iter().all(|v| v.is_finite())
    }
}
