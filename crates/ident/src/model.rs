//! The contract of a dynamic model.
//!
//! A model is a structure with parameters theta (p of them), m inputs and one output:
//!
//! ```text
//! y(t) = f(u(t-k), y(t-j); theta)          simulated (free run): y on the right is the model's own output
//! ```
//!
//! Everything else stands on what this trait gives: estimation, covariance, information matrices, exact
//! design gradients and fuel optimisation. All work goes to buffers that the caller owns.

use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

pub mod fitted;
pub mod form;
pub mod initial;
pub mod kinds;
pub mod linear;
pub mod literature;
mod literature_kinds;
pub mod narmax;
pub mod neural;
mod output;
pub mod poly;
mod record;
pub mod response;

pub use output::{Kind, output};
pub use record::usable_samples;

/// One experiment as a model sees it.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// Inputs, N x m row-major.
    pub u: &'a [f64],
    /// Output, N: measured values. Free run reads `y[..start]` only; one-step prediction reads all of it.
    pub y: &'a [f64],
    /// First sample that is computed; at least [`Model::max_lag`].
    pub start: usize,
}

impl Run<'_> {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.y.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.y.is_empty()
    }
}

/// What takes a block of a free run: its first sample, the outputs, and the rows of the sensitivities.
pub type TakeRows<'a> = dyn FnMut(usize, &[f64], &[f64]) + 'a;

/// A start at which a model with a linear path is an ARX model: all but the parameters of that path stay as drawn and do
/// not contribute.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearPath {
    /// Parameters (p).
    pub theta: Vec<f64>,
    /// Places of the parameters in which the model is then linear, free run and prediction alike.
    pub places: Vec<usize>,
}

/// What only structures say of themselves that are trained from drawn parameters.
pub trait Drawn {
    /// Parameters (p) to start a search from.
    fn random_start(&self, rng: &mut Rng64) -> Vec<f64>;

    /// The linear path, for structures that have one beside others.
    fn linear_path(&self, rng: &mut Rng64) -> Option<LinearPath>;
}

/// A dynamic model structure with one output. Implementations are stateless: theta is passed in.
pub trait Model: form::Form {
    /// Number of inputs m.
    fn n_inputs(&self) -> usize;

    /// Number of parameters p.
    fn n_params(&self) -> usize;

    /// Longest lag of any input or output: the least value of [`Run::start`].
    fn max_lag(&self) -> usize;

    /// Longest lag of the output alone (0: no recursion).
    fn output_lag(&self) -> usize;

    /// Name of parameter k in the user's terms, e.g. `inj(t-1)*spark(t-1)`.
    fn param_name(&self, k: usize) -> String;

    /// Whether the one-step prediction is linear in theta (then least squares is direct).
    fn is_linear_in_params(&self) -> bool;

    /// Parameters to start a search from, for models that have no least-squares start.
    fn drawn(&self) -> Option<&dyn Drawn> {
        None
    }

    /// Free run: `y[..start]` is copied from `run.y`, the rest computed.
    ///
    /// Returns [`Status::Diverged`] as soon as a value is not finite (the rest of `y` is then NaN).
    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status;

    /// One-step-ahead prediction from measured outputs; `yhat[..start]` is copied from `run.y`.
    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]);

    /// Free run and its exact output sensitivities S = dy/dtheta (N x p row-major; rows before `start` zero):
    ///
    /// ```text
    /// s_k(t) = df/dtheta_k + sum_j df/dy(t-j) s_k(t-j)
    /// ```
    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status;

    /// [`Model::sensitivities`] in blocks of about `rows` samples, for records whose N x p matrix would be too long to
    /// keep: `take(t, y, s)` gets output and rows of the samples from t on, block by block, from `start` to the end.
    /// Structures that keep only what the recursion reads say so here; for the others the whole matrix is computed first.
    fn sensitivity_blocks(
        &self,
        theta: &[f64],
        run: &Run,
        rows: usize,
        y: &mut [f64],
        take: &mut TakeRows<'_>,
    ) -> Status {
        let (p, start, rows) = (self.n_params().max(1), run.start.min(run.len()), rows.max(1));
        let mut s = vec![0.0; run.len() * p];
        let status = self.sensitivities(theta, run, y, &mut s);
        if status == Status::Converged {
            let blocks = y[start..].chunks(rows).zip(s[start * p..].chunks(rows * p));
            blocks.enumerate().for_each(|(i, (y, s))| take(start + i * rows, y, s));
        }
        status
    }

    /// Jacobian of the one-step prediction with respect to theta (N x p row-major; rows before `start` zero).
    /// For a model that is linear in its parameters these are the regressors.
    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]);

    /// Adjoint of [`Model::sensitivities`] with respect to the inputs:
    ///
    /// ```text
    /// u_bar += (dy/du)' y_bar + (dS/du)' s_bar
    /// ```
    ///
    /// `y`, `s` are what [`Model::sensitivities`] gave for the same `theta` and `run`; `y_bar` (N), `s_bar` (N x p)
    /// are the weights, `u_bar` (N x m) is added to. Rows before `start` of the weights are ignored. An empty
    /// `s_bar` (then `s` may be empty too) asks for the output term only.
    fn sensitivity_adjoint(
        &self,
        theta: &[f64],
        run: &Run,
        y: &[f64],
        s: &[f64],
        y_bar: &[f64],
        s_bar: &[f64],
        u_bar: &mut [f64],
    );

    /// The (input, lag) pairs that the one-step prediction reads, in a fixed order (w of them).
    fn window(&self) -> &[(usize, usize)];

    /// One-step prediction at sample `t` with its gradient (w) and Hessian (w x w row-major) with respect to the
    /// inputs of [`Model::window`]; past outputs are `run.y`.
    fn window_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64;

    /// Derivatives of the one-step prediction at sample `t` with respect to the past outputs `y(t-1) ..
    /// y(t-output_lag)`, past outputs being `run.y`. By central differences unless the model knows better.
    fn output_derivatives(&self, theta: &[f64], run: &Run, t: usize, grad: &mut [f64]) {
        let (m, lag) = (self.n_inputs(), self.max_lag());
        let from = t - lag;
        let mut y = run.y[from..=t].to_vec();
        let mut predicted = vec![0.0; lag + 1];
        let mut at = |y: &[f64]| {
            self.predict(theta, &Run { u: &run.u[from * m..(t + 1) * m], y, start: lag }, &mut predicted);
            predicted[lag]
        };
        for (j, g) in (1..).zip(grad.iter_mut()) {
            let value = y[lag - j];
            let h = 6e-6 * (1.0 + value.abs());
            y[lag - j] = value + h;
            let up = at(&y);
            y[lag - j] = value - h;
            *g = (up - at(&y)) / (2.0 * h);
            y[lag - j] = value;
        }
    }

    /// One-step prediction at sample `t` with its gradient (w + l) and Hessian (w + l square, row-major) with respect to the
    /// inputs of [`Model::window`], then the past outputs `y(t-1) .. y(t-l)`, l being [`Model::output_lag`] and past outputs
    /// `run.y`. What concerns past outputs is by central differences unless the model knows better.
    fn joint_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        let (w, l, m, lag) = (self.window().len(), self.output_lag(), self.n_inputs(), self.max_lag());
        let n = w + l;
        let from = t - lag;
        let u = &run.u[from * m..(t + 1) * m];
        let mut y = run.y[from..=t].to_vec();
        let mut square = vec![0.0; w * w];
        let mut at = |y: &[f64], g: &mut [f64]| {
            let run = Run { u, y, start: lag };
            let value = self.window_derivatives(theta, &run, lag, &mut g[..w], &mut square);
            self.output_derivatives(theta, &run, lag, &mut g[w..]);
            value
        };
        let (mut up, mut down) = (vec![0.0; n], vec![0.0; n]);
        for j in 1..=l {
            let value = y[lag - j];
            let h = 1e-4 * (1.0 + value.abs());
            y[lag - j] = value + h;
            at(&y, &mut up);
            y[lag - j] = value - h;
            at(&y, &mut down);
            y[lag - j] = value;
            for k in 0..n {
                let second = (up[k] - down[k]) / (2.0 * h);
                hess[(w + j - 1) * n + k] = second;
                hess[k * n + w + j - 1] = second;
            }
        }
        let value = at(&y, grad);
        for a in 0..w {
            hess[a * n..a * n + w].copy_from_slice(&square[a * w..(a + 1) * w]);
        }
        value
    }
}
