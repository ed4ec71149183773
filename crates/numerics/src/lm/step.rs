//! The trust-region step of Levenberg-Marquardt in scaled variables q = D p.
//!
//! ```text
//! (S + mu I) q = -D^-1 J'r,   S = D^-1 J'J D^-1,   |q(mu)| = delta (to 10 %)   or mu = 0
//! ```
//!
//! S + mu I = U'U comes from the Cholesky factor of the Gram matrix as long as that keeps enough digits, else
//! from a QR factorisation of `[J D^-1; sqrt(mu) I]`, which is twice as accurate and about twice as slow.

use super::effective;
use crate::linalg::{QrWork, cholesky, dot, gram_upper_add, norm2, solve_upper, solve_upper_transposed};

/// Squared pivot of the unit-diagonal Gram matrix below which its Cholesky step would lose more than half of the digits.
const GRAM_PIVOT_FLOOR: f64 = 1e-9;

/// Damping from which on every pivot is above that.
const GRAM_SAFE: f64 = 1e-8;
/// The same two for a step that need not be exact: all that J'J can give.
const GRAM_ROUNDING: f64 = 1e-12;

/// Variables from which on a factorisation costs more than what a step of the last digit gains.
const MANY: usize = 48;

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
    /// J'J as summed up, upper triangle; then scaled to D^-1 J'J D^-1.
    gram: Vec<f64>,
    factor: Vec<f64>,
    rhs: Vec<f64>,
    q: Vec<f64>,
    w: Vec<f64>,
    least_damping: f64,
    /// Pivots below this part of their diagonal are not trusted.
    pivot_floor: f64,
    /// Factorisations are dear: the last mu is tried first, and QR only where J'J cannot do.
    many: bool,
    /// mu of the last step: the next is likely to be near.
    last_mu: f64,
    orthogonal: Option<Orthogonal>,
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

impl Orthogonal {
    fn new(n: usize) -> Self {
        let w = n + 1;
        Self {
            tall: None,
            scaled: Vec::new(),
            small: QrWork::new(w + n, w),
            r: vec![0.0; w * w],
            stacked: vec![0.0; (w + n) * w],
            factor: vec![0.0; w * w],
            ready: false,
        }
    }
}

impl StepSolver {
    /// `by_blocks`: the Jacobian itself is never there, all comes from J'J.
    pub(super) fn new(m: usize, n: usize, least_damping: f64, by_blocks: bool) -> Self {
        let gram_only = by_blocks || least_damping >= GRAM_ROUNDING;
        Self {
            m,
            n,
            gram: vec![0.0; n * n],
            factor: vec![0.0; n * n],
            rhs: vec![0.0; n],
            q: vec![0.0; n],
            w: vec![0.0; n],
            least_damping,
            pivot_floor: if gram_only { GRAM_ROUNDING } else { GRAM_PIVOT_FLOOR },
            many: gram_only || n >= MANY,
            last_mu: 0.0,
            orthogonal: (!gram_only).then(|| Orthogonal::new(n)),
        }
    }

    pub(super) fn clear_gram(&mut self) {
        self.gram.fill(0.0);
    }

    /// Adds some rows of J to J'J.
    pub(super) fn add_rows(&mut self, jac: &[f64]) {
        let rows = jac.len() / self.n.max(1);
        gram_upper_add(jac, rows, self.n, &mut self.gram).expect("the buffers have the problem's size");
    }

    /// `|J_k|^2`, before the scaling.
    pub(super) fn square_of_column(&self, k: usize) -> f64 {
        self.gram[k * self.n + k]
    }

    /// J'J is complete: brings it to units of the scale.
    pub(super) fn scale_gram(&mut self, scale: &[f64]) {
        let n = self.n;
        self.w.iter_mut().zip(scale).for_each(|(w, d)| *w = 1.0 / effective(*d));
        for i in 0..n {
            let wi = self.w[i];
            for (g, wj) in self.gram[i * n + i..(i + 1) * n].iter_mut().zip(&self.w[i..]) {
                *g *= wi * wj;
            }
        }
        if let Some(o) = &mut self.orthogonal {
            o.ready = false;
        }
    }

    /// Fills `p` with the step for the trust radius `delta` and returns mu.
    pub(super) fn step(&mut self, model: &Model<'_>, delta: f64, p: &mut [f64]) -> f64 {
        for k in 0..self.n {
            self.rhs[k] = -model.gradient[k] / effective(model.scale[k]);
        }
        let mut high = norm2(&self.rhs) / delta;
        // The last mu first: a step of the right length is found at once, one that is too long bounds mu from below.
        let mut floor = None;
        let try_last = self.many && self.last_mu > self.least_damping && self.last_mu < high;
        if try_last && self.solve(model, self.last_mu) {
            let size = norm2(&self.q);
            if (size - delta).abs() <= 0.1 * delta {
                self.unscale(model, p);
                return self.last_mu;
            }
            if size > delta {
                floor = Some(self.last_mu);
            } else {
                high = self.last_mu;
            }
        }
        let mut mu = floor.unwrap_or_else(|| self.least_damped(model, delta));
        let size = norm2(&self.q);
        if size > 1.1 * delta || size.is_nan() {
            mu = self.search_mu(model, delta, mu, high);
        }
        self.last_mu = mu;
        self.unscale(model, p);
        mu
    }

    /// Solves with the least damping that is sensible and returns it: none where S is regular. A singular S gets the
    /// least that rounding can see, by QR; but not where a step that J'J can give is already longer than allowed.
    fn least_damped(&mut self, model: &Model<'_>, delta: f64) -> f64 {
        let least = self.least_damping;
        if self.solve_gram(least) {
            return least;
        }
        let safe = least.max(GRAM_SAFE);
        if self.many && self.solve_gram(safe) && (self.orthogonal.is_none() || norm2(&self.q) > 1.1 * delta) {
            return safe;
        }
        for mu in [0.0, f64::EPSILON * self.n as f64, 1e-12] {
            if self.solve_orthogonal(model, mu) {
                return mu;
            }
        }
        1e-12
    }

    fn unscale(&self, model: &Model<'_>, p: &mut [f64]) {
        debug_assert!(self.q.iter().all(|v| v.is_finite()));
        for ((p, q), d) in p.iter_mut().zip(&self.q).zip(model.scale) {
            *p = q / effective(*d);
        }
    }

    /// Newton iteration on 1/|q(mu)| = 1/delta with bounds (Hebden; More 1978, section 5).
    fn search_mu(&mut self, model: &Model<'_>, delta: f64, floor: f64, high: f64) -> f64 {
        let (mut low, mut high) = (floor, high);
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

    /// Solves (S + mu I) q = rhs into `q`, the factor into `factor`; `false` when it is singular.
    fn solve(&mut self, model: &Model<'_>, mu: f64) -> bool {
        self.solve_gram(mu) || (self.orthogonal.is_some() && self.solve_orthogonal(model, mu))
    }

    /// The same from the Cholesky factor alone; `false` where that has lost too many digits.
    fn solve_gram(&mut self, mu: f64) -> bool {
        let n = self.n;
        self.factor.copy_from_slice(&self.gram);
        for k in 0..n {
            self.factor[k * n + k] += mu;
        }
        let sound = cholesky(&mut self.factor, n).is_ok()
            && (0..n)
                .all(|k| self.factor[k * n + k].powi(2) > self.pivot_floor * (self.gram[k * n + k] + mu));
        if !sound {
            return false;
        }
        self.q.copy_from_slice(&self.rhs);
        solve_upper_transposed(&self.factor, n, &mut self.q).is_ok()
            && solve_upper(&self.factor, n, &mut self.q).is_ok()
            && self.q.iter().all(|v| v.is_finite())
    }

    /// The same from the QR factorisation of `[J D^-1, r; sqrt(mu) I, 0]`.
    fn solve_orthogonal(&mut self, model: &Model<'_>, mu: f64) -> bool {
        let (n, w) = (self.n, self.n + 1);
        let Some(o) = &mut self.orthogonal else { return false };
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
