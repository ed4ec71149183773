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
//! From rest one filtered signal serves a whole polynomial: its columns are that signal delayed. Where a record starts
//! from measured values, each column is filtered by itself.

use dynocal_numerics::linalg::dot;

use super::filter::{filter, moving, multiply_into, recurse, recurse_from, recurse_pair};
use super::{LinearModel, Polynomials};

/// Prediction errors of one record; holds all buffers: an evaluation allocates nothing.
#[derive(Clone, Debug)]
pub struct PredictionErrors<'a> {
    model: &'a LinearModel,
    /// One input after the other (m x N).
    u: Vec<Vec<f64>>,
    y: Vec<f64>,
    /// Samples before this one only start the filters; 0 for filters at rest.
    start: usize,
    /// Initial states: which, at which sample, value.
    states: Vec<(Unknown, usize, f64)>,
    polynomials: Polynomials,
    /// C F_i.
    shaped: Vec<Vec<f64>>,
    /// Parameters that `w`, `x` and `eps` belong to.
    at: Vec<f64>,
    w: Vec<Vec<f64>>,
    x: Vec<f64>,
    eps: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
}

/// A quantity that the errors are linear in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unknown {
    /// A sample of the output.
    Output,
    /// A sample of input i.
    Input(usize),
    /// A state of `B_i/F_i`.
    InputState(usize),
    /// A state of `D/C`.
    NoiseState,
}

impl<'a> PredictionErrors<'a> {
    /// For a record with inputs `u` (N x m row-major) and output `y` (N), all filters at rest before it.
    pub fn new(model: &'a LinearModel, u: &[f64], y: &[f64]) -> Self {
        Self::from_measured(model, u, y, 0)
    }

    /// The same from the measured values of the samples before `start`: errors and noise are zero there, the
    /// responses to the inputs share the measured output. Errors before `start` are zero.
    pub fn from_measured(model: &'a LinearModel, u: &[f64], y: &[f64], start: usize) -> Self {
        let (n, m) = (y.len(), model.n_inputs());
        let channel = |i: usize| u.iter().skip(i).step_by(m).copied().collect();
        Self {
            model,
            u: (0..m).map(channel).collect(),
            y: y.to_vec(),
            start: start.min(n),
            states: Vec::new(),
            polynomials: model.polynomials(&vec![0.0; model.n_params()]),
            shaped: model.orders.iter().map(|o| vec![0.0; o.nf + model.nc + 1]).collect(),
            at: Vec::new(),
            w: vec![vec![0.0; n]; m],
            x: vec![0.0; n],
            eps: vec![0.0; n],
            first: vec![0.0; n],
            second: vec![0.0; n],
        }
    }

    /// Prediction errors `eps` (N) for `theta` (p); `false` when they are not finite.
    pub fn errors(&mut self, theta: &[f64], eps: &mut [f64]) -> bool {
        let finite = self.evaluate(theta);
        eps.copy_from_slice(&self.eps);
        finite
    }

    /// Prediction errors and their Jacobian (N x p row-major).
    pub fn jacobian(&mut self, theta: &[f64], eps: &mut [f64], jac: &mut [f64]) -> bool {
        // After an accepted step the search asks for the point that it has just tried.
        let finite = self.at == theta || self.evaluate(theta);
        eps.copy_from_slice(&self.eps);
        if !finite {
            return false;
        }
        for (s, f) in self.shaped.iter_mut().zip(&self.polynomials.f) {
            multiply_into(&self.polynomials.c, f, s);
        }
        if self.start > 0 {
            self.columns_from_measured(jac);
        } else {
            self.columns_from_rest(jac);
        }
        true
    }

    fn columns_from_rest(&mut self, jac: &mut [f64]) {
        let (model, p) = (self.model, &self.polynomials);
        let mut rows = Columns { jac, width: model.n_params(), next: 0 };
        if model.na > 0 {
            filter(&p.d, &p.c, &self.y, &mut self.first);
            rows.delayed(&self.first, 1.0, 1, model.na);
        }
        let mut of_f = rows.next + model.orders.iter().map(|o| o.nb).sum::<usize>() + model.nc + model.nd;
        for (i, o) in model.orders.iter().enumerate() {
            moving(&p.d, &self.u[i], &mut self.first);
            if o.nf == 0 {
                recurse(&self.shaped[i], &mut self.first);
            } else {
                moving(&p.d, &self.w[i], &mut self.second);
                recurse_pair(&self.shaped[i], &mut self.first, &mut self.second);
                let next = std::mem::replace(&mut rows.next, of_f);
                rows.delayed(&self.second, 1.0, 1, o.nf);
                of_f = std::mem::replace(&mut rows.next, next);
            }
            rows.delayed(&self.first, -1.0, o.nk, o.nb);
        }
        if model.nc + model.nd > 0 {
            self.first.copy_from_slice(&self.eps);
            self.second.copy_from_slice(&self.x);
            recurse_pair(&p.c, &mut self.first, &mut self.second);
            rows.delayed(&self.first, -1.0, 1, model.nc);
            rows.delayed(&self.second, 1.0, 1, model.nd);
        }
    }

    fn columns_from_measured(&mut self, jac: &mut [f64]) {
        let (model, p, start) = (self.model, &self.polynomials, self.start);
        let (column, work) = (&mut self.first, &mut self.second);
        let mut rows = Columns { jac, width: model.n_params(), next: 0 };
        let mut fill = |signal: &[f64], sign: f64, num: &[f64], den: &[f64], lags: std::ops::Range<usize>| {
            for lag in lags {
                work[..start].fill(0.0);
                for t in start..signal.len() {
                    work[t] = if t >= lag { signal[t - lag] } else { 0.0 };
                }
                filter(num, den, work, column);
                rows.delayed(column, sign, 0, 1);
            }
        };
        fill(&self.y, 1.0, &p.d, &p.c, 1..model.na + 1);
        for (i, o) in model.orders.iter().enumerate() {
            fill(&self.u[i], -1.0, &p.d, &self.shaped[i], o.nk..o.nk + o.nb);
        }
        fill(&self.eps, -1.0, &[1.0], &p.c, 1..model.nc + 1);
        fill(&self.x, 1.0, &[1.0], &p.c, 1..model.nd + 1);
        for (i, o) in model.orders.iter().enumerate() {
            fill(&self.w[i], 1.0, &p.d, &self.shaped[i], 1..o.nf + 1);
        }
    }

    fn evaluate(&mut self, theta: &[f64]) -> bool {
        self.model.fill(theta, &mut self.polynomials);
        self.at.clear();
        self.at.extend_from_slice(theta);
        let (p, start) = (&self.polynomials, self.start);
        moving(&p.a, &self.y, &mut self.x);
        let sharing = self.model.orders.iter().filter(|o| o.nf > 0).count().max(1) as f64;
        for (i, w) in self.w.iter_mut().enumerate() {
            moving(&p.b[i], &self.u[i], w);
            for (_, t, v) in self.states.iter().filter(|s| s.0 == Unknown::InputState(i)) {
                w[*t] += v;
            }
            if start > 0 && self.model.orders[i].nf > 0 {
                w[..start].iter_mut().zip(&self.y).for_each(|(w, y)| *w = y / sharing);
                recurse_from(&p.f[i], w, start);
            } else {
                recurse(&p.f[i], w);
            }
            self.x.iter_mut().zip(w.iter()).for_each(|(x, w)| *x -= w);
        }
        self.x[..start].fill(0.0);
        moving(&p.d, &self.x, &mut self.eps);
        for (_, t, v) in self.states.iter().filter(|s| s.0 == Unknown::NoiseState) {
            self.eps[*t] += v;
        }
        recurse(&p.c, &mut self.eps);
        dot(&self.eps, &self.eps).is_finite()
    }

    /// Change of the errors by a unit of `of` at sample 0 (N), at the parameters of the last evaluation.
    pub(crate) fn unit_response(&self, of: Unknown) -> Vec<f64> {
        let p = &self.polynomials;
        let mut impulse = vec![0.0; self.y.len()];
        if let Some(first) = impulse.first_mut() {
            *first = if matches!(of, Unknown::Input(_) | Unknown::InputState(_)) { -1.0 } else { 1.0 };
        }
        let through = |num: &[f64], den: &[f64], x: &[f64]| {
            let mut out = vec![0.0; x.len()];
            filter(num, den, x, &mut out);
            out
        };
        match of {
            Unknown::Output => through(&p.a, &[1.0], &through(&p.d, &p.c, &impulse)),
            Unknown::Input(i) => through(&p.b[i], &p.f[i], &through(&p.d, &p.c, &impulse)),
            Unknown::InputState(i) => through(&[1.0], &p.f[i], &through(&p.d, &p.c, &impulse)),
            Unknown::NoiseState => through(&[1.0], &p.c, &impulse),
        }
    }

    /// Adds `change` to a quantity that is not known.
    pub(crate) fn add(&mut self, of: Unknown, sample: usize, change: f64) {
        self.at.clear();
        match of {
            Unknown::Output => self.y[sample] += change,
            Unknown::Input(i) => self.u[i][sample] += change,
            Unknown::InputState(_) | Unknown::NoiseState if sample >= self.y.len() => {}
            Unknown::InputState(_) | Unknown::NoiseState => {
                match self.states.iter_mut().find(|s| s.0 == of && s.1 == sample) {
                    Some(state) => state.2 += change,
                    None => self.states.push((of, sample, change)),
                }
            }
        }
    }

    /// Present value of a sample of the output or an input; of a state, 0.
    pub(crate) fn value(&self, of: Unknown, sample: usize) -> f64 {
        match of {
            Unknown::Output => self.y[sample],
            Unknown::Input(i) => self.u[i][sample],
            Unknown::InputState(_) | Unknown::NoiseState => 0.0,
        }
    }

    /// Derivatives of the response to a unit of output with respect to the parameters it depends on.
    pub(crate) fn output_response_gradient(&self) -> Vec<(usize, Vec<f64>)> {
        let (model, p, n) = (self.model, &self.polynomials, self.y.len());
        let mut impulse = vec![0.0; n];
        impulse.iter_mut().take(1).for_each(|v| *v = 1.0);
        let through = |num: &[f64], den: &[f64], x: &[f64]| {
            let mut out = vec![0.0; x.len()];
            filter(num, den, x, &mut out);
            out
        };
        let whitened = through(&[1.0], &p.c, &impulse);
        let of_a = through(&p.d, &[1.0], &whitened);
        let of_d = through(&p.a, &[1.0], &whitened);
        let of_c = through(&[-1.0], &p.c, &through(&p.a, &[1.0], &of_a));
        let first_c = model.na + model.orders.iter().map(|o| o.nb).sum::<usize>();
        let mut out = Vec::new();
        for (base, first, count) in
            [(of_a, 0, model.na), (of_c, first_c, model.nc), (of_d, first_c + model.nc, model.nd)]
        {
            for lag in (1..=count).filter(|lag| *lag <= n) {
                out.push((first + lag - 1, [&vec![0.0; lag][..], &base[..n - lag]].concat()));
            }
        }
        out
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
        let (next, head) = (self.next, first + count - 1);
        for (t, row) in self.jac.chunks_exact_mut(self.width).enumerate().take(head) {
            for (j, v) in row[next..next + count].iter_mut().enumerate() {
                *v = if t >= first + j { sign * signal[t - first - j] } else { 0.0 };
            }
        }
        let rows = self.jac.chunks_exact_mut(self.width).skip(head);
        for (row, window) in rows.zip(signal.windows(count)) {
            for (v, s) in row[next..next + count].iter_mut().zip(window.iter().rev()) {
                *v = sign * s;
            }
        }
        self.next += count;
    }
}
