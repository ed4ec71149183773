//! Free run, prediction, sensitivities and window derivatives of neural NARX models.

use dynocal_numerics::linalg::axpy;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

use super::NeuralNarx;
use super::network::Pass;
use crate::model::{Drawn, LinearPath, Model, Run, TakeRows};

impl NeuralNarx {
    /// Regressors of sample t with past outputs `y`, then the neurons; returns the output in its unit.
    pub(super) fn forward(&self, theta: &[f64], u: &[f64], y: &[f64], t: usize, pass: &mut Pass) -> f64 {
        let (m, inputs) = (self.inputs.len(), self.window.len());
        for (z, &(i, lag)) in pass.z.iter_mut().zip(&self.window) {
            *z = self.input_scales[i].scaled(u[(t - lag) * m + i]);
        }
        for (z, lag) in pass.z[inputs..self.width()].iter_mut().zip(1..) {
            *z = self.output_scale.scaled(y[t - lag]);
        }
        self.output_scale.centre + self.output_scale.half * self.network.forward(theta, pass)
    }

    /// One-step prediction at sample t with gradient (n) and Hessian (n x n) with respect to the first `n` regressors in their
    /// units.
    fn derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        n: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        let mut pass = Pass::new();
        let value = self.forward(theta, run.u, run.y, t, &mut pass);
        self.network.backward(theta, &mut pass);
        let scale = |entry: usize| match self.window.get(entry) {
            Some(&(i, _)) => &self.input_scales[i],
            None => &self.output_scale,
        };
        let units: Vec<f64> = (0..n).map(|entry| 1.0 / scale(entry).half).collect();
        let gain = self.output_scale.half;
        self.network.hessian(theta, &pass, &units, hess);
        hess[..n * n].iter_mut().for_each(|h| *h *= gain);
        self.network.input_slopes(theta, &pass, &mut grad[..n]);
        grad.iter_mut().zip(&units).for_each(|(g, unit)| *g *= gain * unit);
        value
    }

    /// df/dy(t - lag), after the network's backward pass; the scales of output and regressor cancel.
    pub(super) fn output_gradient(&self, theta: &[f64], pass: &Pass, lag: usize) -> f64 {
        self.network.slope_of(theta, pass, self.window.len() + lag - 1)
    }

    /// First sample that is computed.
    pub(super) fn first(&self, run: &Run) -> usize {
        run.start.max(self.max_lag()).min(run.len())
    }

    /// The same, after the initial values are copied.
    fn begin(&self, run: &Run, y: &mut [f64]) -> usize {
        let start = self.first(run);
        y[..start].copy_from_slice(&run.y[..start]);
        start
    }

    /// Output of sample t into `y` and its sensitivities into `now` (p); `past` holds the rows of the samples before,
    /// the last one at its end. `false` when the output is not finite.
    fn step(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        y: &mut [f64],
        past: &[f64],
        now: &mut [f64],
        pass: &mut Pass,
    ) -> bool {
        y[t] = self.forward(theta, run.u, y, t, pass);
        if !y[t].is_finite() {
            return false;
        }
        let p = now.len();
        self.network.backward(theta, pass);
        self.network.gradient(pass, self.output_scale.half, now);
        for (row, lag) in past.rchunks_exact(p).zip(1..=self.layout.output_lags) {
            axpy(self.output_gradient(theta, pass, lag), row, now);
        }
        true
    }
}

impl Drawn for NeuralNarx {
    fn random_start(&self, rng: &mut Rng64) -> Vec<f64> {
        self.random_start(rng)
    }

    fn linear_path(&self, rng: &mut Rng64) -> Option<LinearPath> {
        let places = self.network.linear_path()?;
        let mut theta = self.random_start(rng);
        theta[self.network.output_weights()].fill(0.0);
        Some(LinearPath { theta, places: places.collect() })
    }
}

impl Model for NeuralNarx {
    fn n_inputs(&self) -> usize {
        self.inputs.len()
    }

    fn n_params(&self) -> usize {
        self.network.params
    }

    fn max_lag(&self) -> usize {
        self.window.iter().map(|w| w.1).max().unwrap_or(0).max(self.layout.output_lags)
    }

    fn output_lag(&self) -> usize {
        self.layout.output_lags
    }

    fn param_name(&self, k: usize) -> String {
        self.network.param_name(k, &|place| match self.window.get(place) {
            Some(&(i, 0)) => format!("{}(t)", self.inputs[i]),
            Some(&(i, lag)) => format!("{}(t-{lag})", self.inputs[i]),
            None => format!("{}(t-{})", self.output, place + 1 - self.window.len()),
        })
    }

    fn is_linear_in_params(&self) -> bool {
        false
    }

    fn drawn(&self) -> Option<&dyn Drawn> {
        Some(self)
    }

    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        let mut pass = Pass::new();
        for t in self.begin(run, y)..run.len() {
            y[t] = self.forward(theta, run.u, y, t, &mut pass);
            if !y[t].is_finite() {
                y[t..].fill(f64::NAN);
                return Status::Diverged;
            }
        }
        Status::Converged
    }

    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]) {
        let mut pass = Pass::new();
        for t in self.begin(run, yhat)..run.len() {
            yhat[t] = self.forward(theta, run.u, run.y, t, &mut pass);
        }
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status {
        let (mut pass, p) = (Pass::new(), self.n_params());
        let start = self.begin(run, y);
        s[..start * p].fill(0.0);
        for t in start..run.len() {
            let (past, now) = s.split_at_mut(t * p);
            // Rows before the start are zero: nothing to add.
            if !self.step(theta, run, t, y, &past[start * p..], &mut now[..p], &mut pass) {
                y[t..].fill(f64::NAN);
                s[t * p..].fill(f64::NAN);
                return Status::Diverged;
            }
        }
        Status::Converged
    }

    fn sensitivity_blocks(
        &self,
        theta: &[f64],
        run: &Run,
        rows: usize,
        y: &mut [f64],
        take: &mut TakeRows<'_>,
    ) -> Status {
        let (mut pass, p, lags) = (Pass::new(), self.n_params(), self.layout.output_lags);
        let (start, rows) = (self.begin(run, y), rows.max(lags).max(1));
        // The rows that the recursion still reads stand before those of the block.
        let mut s = vec![0.0; (lags + rows) * p];
        let mut t = start;
        while t < run.len() {
            let count = rows.min(run.len() - t);
            let known = lags.min(t - start);
            for i in 0..count {
                let (past, now) = s.split_at_mut((lags + i) * p);
                let past = &past[(lags - known) * p..];
                if !self.step(theta, run, t + i, y, past, &mut now[..p], &mut pass) {
                    y[t + i..].fill(f64::NAN);
                    return Status::Diverged;
                }
            }
            take(t, &y[t..t + count], &s[lags * p..(lags + count) * p]);
            s.copy_within(count * p..(count + lags) * p, 0);
            t += count;
        }
        Status::Converged
    }

    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]) {
        let (mut pass, p) = (Pass::new(), self.n_params());
        let start = self.first(run);
        s[..start * p].fill(0.0);
        for t in start..run.len() {
            self.forward(theta, run.u, run.y, t, &mut pass);
            self.network.backward(theta, &mut pass);
            self.network.gradient(&pass, self.output_scale.half, &mut s[t * p..(t + 1) * p]);
        }
    }

    fn sensitivity_adjoint(
        &self,
        theta: &[f64],
        run: &Run,
        y: &[f64],
        s: &[f64],
        y_bar: &[f64],
        s_bar: &[f64],
        u_bar: &mut [f64],
    ) {
        super::adjoint::sensitivity_adjoint(self, theta, run, y, s, y_bar, s_bar, u_bar);
    }

    fn window(&self) -> &[(usize, usize)] {
        &self.window
    }

    fn window_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        self.derivatives(theta, run, t, self.window.len(), grad, hess)
    }

    fn joint_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        self.derivatives(theta, run, t, self.width(), grad, hess)
    }
}
