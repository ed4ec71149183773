//! Free run, prediction, sensitivities and window derivatives of neural NARX models.

use dynocal_numerics::linalg::{axpy, dot};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

use super::{MAX_HIDDEN, MAX_WIDTH, NeuralNarx};
use crate::model::{Model, Run};

/// The parameters by name.
pub(super) struct Weights<'a> {
    pub(super) w1: &'a [f64],
    pub(super) b1: &'a [f64],
    pub(super) w2: &'a [f64],
    b2: f64,
}

/// What one sample needs.
pub(super) struct Layer {
    /// Scaled regressors (the first q entries).
    pub(super) z: [f64; MAX_WIDTH],
    /// Outputs of the neurons (the first h entries).
    pub(super) h: [f64; MAX_HIDDEN],
}

impl Layer {
    pub(super) fn new() -> Self {
        Self { z: [0.0; MAX_WIDTH], h: [0.0; MAX_HIDDEN] }
    }
}

impl NeuralNarx {
    pub(super) fn weights<'a>(&self, theta: &'a [f64]) -> Weights<'a> {
        let (h, q) = (self.hidden, self.width());
        let (w1, rest) = theta.split_at(h * q);
        let (b1, rest) = rest.split_at(h);
        Weights { w1, b1, w2: &rest[..h], b2: rest[h] }
    }

    /// Regressors of sample t with past outputs `y`, then the neurons; returns the output in its unit.
    pub(super) fn forward(&self, w: &Weights, u: &[f64], y: &[f64], t: usize, layer: &mut Layer) -> f64 {
        let (m, q, inputs) = (self.inputs.len(), self.width(), self.window.len());
        for (z, &(i, lag)) in layer.z.iter_mut().zip(&self.window) {
            *z = self.input_scales[i].scaled(u[(t - lag) * m + i]);
        }
        for (z, lag) in layer.z[inputs..q].iter_mut().zip(1..) {
            *z = self.output_scale.scaled(y[t - lag]);
        }
        let z = &layer.z[..q];
        let mut sum = w.b2;
        for (j, (h, row)) in layer.h.iter_mut().zip(w.w1.chunks_exact(q)).enumerate() {
            *h = (w.b1[j] + dot(row, z)).tanh();
            sum += w.w2[j] * *h;
        }
        self.output_scale.centre + self.output_scale.half * sum
    }

    /// df/dtheta at the sample in `layer`, in the unit of the output, into `row` (p).
    fn direct_gradient(&self, w: &Weights, layer: &Layer, row: &mut [f64]) {
        let (h, q, half) = (self.hidden, self.width(), self.output_scale.half);
        let (w1, rest) = row.split_at_mut(h * q);
        let (b1, rest) = rest.split_at_mut(h);
        for (j, row) in w1.chunks_exact_mut(q).enumerate() {
            let g = half * w.w2[j] * (1.0 - layer.h[j] * layer.h[j]);
            row.iter_mut().zip(&layer.z).for_each(|(v, z)| *v = g * z);
            b1[j] = g;
            rest[j] = half * layer.h[j];
        }
        rest[h] = half;
    }

    /// df/dy(t - lag); the scales of output and regressor cancel.
    pub(super) fn output_gradient(&self, w: &Weights, layer: &Layer, lag: usize) -> f64 {
        let (q, place) = (self.width(), self.window.len() + lag - 1);
        (0..self.hidden).map(|j| w.w2[j] * (1.0 - layer.h[j] * layer.h[j]) * w.w1[j * q + place]).sum()
    }

    /// First sample that is computed; the initial values are copied.
    fn begin(&self, run: &Run, y: &mut [f64]) -> usize {
        let start = run.start.max(self.max_lag()).min(run.len());
        y[..start].copy_from_slice(&run.y[..start]);
        start
    }
}

impl Model for NeuralNarx {
    fn n_inputs(&self) -> usize {
        self.inputs.len()
    }

    fn n_params(&self) -> usize {
        self.hidden * (self.width() + 2) + 1
    }

    fn max_lag(&self) -> usize {
        let inputs = if self.inputs.is_empty() { 0 } else { self.input_lags };
        inputs.max(self.output_lags)
    }

    fn output_lag(&self) -> usize {
        self.output_lags
    }

    fn param_name(&self, k: usize) -> String {
        let (h, q) = (self.hidden, self.width());
        if k < h * q {
            let (neuron, place) = (k / q + 1, k % q);
            return match self.window.get(place) {
                Some(&(i, lag)) => format!("neuron {neuron}: {}(t-{lag})", self.inputs[i]),
                None => format!("neuron {neuron}: {}(t-{})", self.output, place + 1 - self.window.len()),
            };
        }
        match k - h * q {
            j if j < h => format!("neuron {}: offset", j + 1),
            j if j < 2 * h => format!("output of neuron {}", j + 1 - h),
            _ => "offset".into(),
        }
    }

    fn is_linear_in_params(&self) -> bool {
        false
    }

    fn random_start(&self, rng: &mut Rng64) -> Option<Vec<f64>> {
        Some(self.draw(rng))
    }

    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        let (w, mut layer) = (self.weights(theta), Layer::new());
        for t in self.begin(run, y)..run.len() {
            y[t] = self.forward(&w, run.u, y, t, &mut layer);
            if !y[t].is_finite() {
                y[t..].fill(f64::NAN);
                return Status::Diverged;
            }
        }
        Status::Converged
    }

    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]) {
        let (w, mut layer) = (self.weights(theta), Layer::new());
        for t in self.begin(run, yhat)..run.len() {
            yhat[t] = self.forward(&w, run.u, run.y, t, &mut layer);
        }
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status {
        let (w, mut layer, p) = (self.weights(theta), Layer::new(), self.n_params());
        let start = self.begin(run, y);
        s[..start * p].fill(0.0);
        for t in start..run.len() {
            y[t] = self.forward(&w, run.u, y, t, &mut layer);
            if !y[t].is_finite() {
                y[t..].fill(f64::NAN);
                s[t * p..].fill(f64::NAN);
                return Status::Diverged;
            }
            let (past, now) = s.split_at_mut(t * p);
            let now = &mut now[..p];
            self.direct_gradient(&w, &layer, now);
            // Rows before the start are zero: nothing to add.
            for lag in 1..=self.output_lags.min(t - start) {
                axpy(self.output_gradient(&w, &layer, lag), &past[(t - lag) * p..(t - lag + 1) * p], now);
            }
        }
        Status::Converged
    }

    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]) {
        let (w, mut layer, p) = (self.weights(theta), Layer::new(), self.n_params());
        let start = run.start.max(self.max_lag()).min(run.len());
        s[..start * p].fill(0.0);
        for t in start..run.len() {
            self.forward(&w, run.u, run.y, t, &mut layer);
            self.direct_gradient(&w, &layer, &mut s[t * p..(t + 1) * p]);
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
        let (w, mut layer) = (self.weights(theta), Layer::new());
        let (q, n) = (self.width(), self.window.len());
        let value = self.forward(&w, run.u, run.y, t, &mut layer);
        grad.fill(0.0);
        hess.fill(0.0);
        for (j, row) in w.w1.chunks_exact(q).enumerate() {
            let h = layer.h[j];
            let slope = self.output_scale.half * w.w2[j] * (1.0 - h * h);
            let curvature = -2.0 * h * slope;
            for (a, &(i, _)) in self.window.iter().enumerate() {
                let da = row[a] / self.input_scales[i].half;
                grad[a] += slope * da;
                for (b, &(k, _)) in self.window.iter().enumerate() {
                    hess[a * n + b] += curvature * da * row[b] / self.input_scales[k].half;
                }
            }
        }
        value
    }
}
