//! Prediction errors of linear models and their exact gradient.
//!
//! ```text
//! w_i = B_i/F_i u_i      x = A y - sum w_i      eps = D/C x
//!
//! d eps/d a_j   =   D/C        y(t-j)          d eps/d c_j   = - 1/C       eps(t-j)
//! d eps/d b_i,j = - D/(C F_i)  u_i(t-nk-j)     d eps/d d_j   =   1/C       x(t-j)
//! d eps/d f_i,j =   D/(C F_i)  w_i(t-j)
//! ```
//!
//! All filters are at rest before the first sample. One filtered signal serves a whole polynomial: its columns are
//! that signal delayed.

use super::filter::{filter, multiply};
use super::{LinearModel, Polynomials};

/// Prediction errors of one record; holds all buffers, so that an evaluation allocates polynomials only.
#[derive(Clone, Debug)]
pub struct PredictionErrors<'a> {
    model: &'a LinearModel,
    /// One input after the other (m x N).
    u: Vec<Vec<f64>>,
    y: &'a [f64],
    w: Vec<Vec<f64>>,
    x: Vec<f64>,
    filtered: Vec<f64>,
}

impl<'a> PredictionErrors<'a> {
    /// For a record with inputs `u` (N x m row-major) and output `y` (N).
    pub fn new(model: &'a LinearModel, u: &[f64], y: &'a [f64]) -> Self {
        let (n, m) = (y.len(), model.n_inputs());
        let channel = |i: usize| u.iter().skip(i).step_by(m).copied().collect();
        Self {
            model,
            u: (0..m).map(channel).collect(),
            y,
            w: vec![vec![0.0; n]; m],
            x: vec![0.0; n],
            filtered: vec![0.0; n],
        }
    }

    /// Prediction errors `eps` (N) for `theta` (p); `false` when they are not finite.
    pub fn errors(&mut self, theta: &[f64], eps: &mut [f64]) -> bool {
        self.evaluate(&self.model.polynomials(theta), eps)
    }

    /// Prediction errors and their Jacobian (N x p row-major).
    pub fn jacobian(&mut self, theta: &[f64], eps: &mut [f64], jac: &mut [f64]) -> bool {
        let p = self.model.polynomials(theta);
        if !self.evaluate(&p, eps) {
            return false;
        }
        let (model, width) = (self.model, self.model.n_params());
        let mut rows = Columns { jac, width, next: 0 };
        filter(&p.d, &p.c, self.y, &mut self.filtered);
        rows.delayed(&self.filtered, 1.0, 1, model.na);
        let shaped: Vec<Vec<f64>> = p.f.iter().map(|f| multiply(&p.c, f)).collect();
        for (i, o) in model.orders.iter().enumerate() {
            filter(&p.d, &shaped[i], &self.u[i], &mut self.filtered);
            rows.delayed(&self.filtered, -1.0, o.nk, o.nb);
        }
        filter(&[1.0], &p.c, eps, &mut self.filtered);
        rows.delayed(&self.filtered, -1.0, 1, model.nc);
        filter(&[1.0], &p.c, &self.x, &mut self.filtered);
        rows.delayed(&self.filtered, 1.0, 1, model.nd);
        for (i, o) in model.orders.iter().enumerate() {
            if o.nf > 0 {
                filter(&p.d, &shaped[i], &self.w[i], &mut self.filtered);
                rows.delayed(&self.filtered, 1.0, 1, o.nf);
            }
        }
        jac.iter().all(|v| v.is_finite())
    }

    fn evaluate(&mut self, p: &Polynomials, eps: &mut [f64]) -> bool {
        filter(&p.a, &[1.0], self.y, &mut self.x);
        for (i, w) in self.w.iter_mut().enumerate() {
            filter(&p.b[i], &p.f[i], &self.u[i], w);
            self.x.iter_mut().zip(w.iter()).for_each(|(x, w)| *x -= w);
        }
        filter(&p.d, &p.c, &self.x, eps);
        eps.iter().all(|v| v.is_finite())
    }
}

/// Fills a row-major Jacobian group of columns by group.
struct Columns<'a> {
    jac: &'a mut [f64],
    width: usize,
    next: usize,
}

impl Columns<'_> {
    /// The next `count` columns are `sign * signal(t - lag)`, `lag = first, first + 1, ..`.
    fn delayed(&mut self, signal: &[f64], sign: f64, first: usize, count: usize) {
        if count == 0 {
            return;
        }
        for (t, row) in self.jac.chunks_exact_mut(self.width).enumerate() {
            for (j, v) in row[self.next..self.next + count].iter_mut().enumerate() {
                *v = if t >= first + j { sign * signal[t - first - j] } else { 0.0 };
            }
        }
        self.next += count;
    }
}
