//! Response models of one step behind the contract of a dynamic model: `y(t) = f(u(t-k), y(t-j))` with a free run.
//!
//! The model's parameters were estimated with the response; as a [`Model`] it has none (p = 0), so what remains are the free
//! run, the one-step prediction and their derivatives with respect to inputs and past outputs.

use dynocal_numerics::status::Status;

use super::{Ask, Learn, Learnt, Points, Prediction, Response, ResponseError, ResponseModel};
use crate::experiment::Experiment;
use crate::model::{Model, Run};
use crate::validate::boundary::Space;

/// A response model over lagged inputs and outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct ResponseNarx {
    model: ResponseModel,
    space: Space,
    n_inputs: usize,
}

/// Lagged inputs and outputs of all records as points; samples with a missing value, and those that only initialise, are
/// left out. `inputs` are the names of all inputs of the records.
///
/// # Errors
/// [`ResponseError::Points`] when a record has fewer inputs than names.
pub fn one_step_points(
    data: &[Experiment],
    space: &Space,
    inputs: &[String],
    output: &str,
) -> Result<Points, ResponseError> {
    let m = inputs.len();
    let mut points =
        Points { inputs: space.names(inputs, output), output: output.into(), x: Vec::new(), y: Vec::new() };
    let mut point = vec![0.0; space.dim()];
    for e in data {
        if e.u.len() != e.len() * m {
            let (found, points, expected) = (e.u.len(), e.len(), e.len() * m);
            let output = format!("{} of {}", output, e.name);
            return Err(super::PointsError::Shape { output, found, points, expected, inputs: m }.into());
        }
        for t in e.init_samples.max(space.max_lag())..e.len() {
            space.point(&e.u, m, &e.y, t, &mut point);
            if e.y[t].is_finite() && point.iter().all(|v| v.is_finite()) {
                points.x.extend_from_slice(&point);
                points.y.push(e.y[t]);
            }
        }
    }
    Ok(points)
}

/// Learns `kind` on one-step points of the records.
///
/// # Errors
/// [`ResponseError`].
pub fn learn(
    kind: &dyn Learn,
    data: &[Experiment],
    space: &Space,
    inputs: &[String],
    output: &str,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<(ResponseNarx, Learnt), ResponseError> {
    let points = one_step_points(data, space, inputs, output)?;
    let learnt = kind.learn(&points, interrupt)?;
    let narx = ResponseNarx { model: learnt.model.clone(), space: space.clone(), n_inputs: inputs.len() };
    Ok((narx, learnt))
}

impl ResponseNarx {
    /// A stored response model over lagged channels; `None` where the number of coordinates differs.
    pub fn new(model: ResponseModel, space: Space, n_inputs: usize) -> Option<Self> {
        let fits = model.dim() == space.dim() && space.inputs.iter().all(|(i, _)| *i < n_inputs);
        fits.then_some(Self { model, space, n_inputs })
    }

    /// The response model.
    pub fn response(&self) -> &ResponseModel {
        &self.model
    }

    /// Prediction of sample t from inputs and the outputs in `y`.
    fn step(&self, u: &[f64], y: &[f64], t: usize, ask: Ask, buffers: &mut Buffers) {
        self.space.point(u, self.n_inputs, y, t, &mut buffers.point);
        self.model.predict(&buffers.point, ask, &mut buffers.at);
    }

    fn buffers(&self) -> Buffers {
        let d = self.space.dim();
        Buffers { point: vec![0.0; d], at: Prediction::new(d) }
    }
}

struct Buffers {
    point: Vec<f64>,
    at: Prediction,
}

impl Model for ResponseNarx {
    fn n_inputs(&self) -> usize {
        self.n_inputs
    }

    fn n_params(&self) -> usize {
        0
    }

    fn max_lag(&self) -> usize {
        self.space.max_lag()
    }

    fn output_lag(&self) -> usize {
        self.space.outputs.iter().copied().max().unwrap_or(0)
    }

    fn param_name(&self, _k: usize) -> String {
        String::new()
    }

    fn is_linear_in_params(&self) -> bool {
        false
    }

    fn simulate(&self, _theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        let mut buffers = self.buffers();
        let start = run.start.min(run.len());
        y[..start].copy_from_slice(&run.y[..start]);
        for t in start..run.len() {
            self.step(run.u, y, t, Ask::Mean, &mut buffers);
            if !buffers.at.mean.is_finite() {
                y[t..].fill(f64::NAN);
                return Status::Diverged;
            }
            y[t] = buffers.at.mean;
        }
        Status::Converged
    }

    fn predict(&self, _theta: &[f64], run: &Run, yhat: &mut [f64]) {
        let mut buffers = self.buffers();
        let start = run.start.min(run.len());
        yhat[..start].copy_from_slice(&run.y[..start]);
        for t in start..run.len() {
            self.step(run.u, run.y, t, Ask::Mean, &mut buffers);
            yhat[t] = buffers.at.mean;
        }
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], _s: &mut [f64]) -> Status {
        self.simulate(theta, run, y)
    }

    fn one_step_jacobian(&self, _theta: &[f64], _run: &Run, _s: &mut [f64]) {}

    /// Backwards in time: `l(t) = y_bar(t) + sum_j df(t+j)/dy(t) l(t+j)`, `u_bar += df/du l`.
    fn sensitivity_adjoint(
        &self,
        _theta: &[f64],
        run: &Run,
        y: &[f64],
        _s: &[f64],
        y_bar: &[f64],
        _s_bar: &[f64],
        u_bar: &mut [f64],
    ) {
        let mut buffers = self.buffers();
        let mut adjoint = y_bar.to_vec();
        let count = self.space.inputs.len();
        for t in (run.start.min(run.len())..run.len()).rev() {
            let l = adjoint[t];
            if l == 0.0 {
                continue;
            }
            self.step(run.u, y, t, Ask::Gradient, &mut buffers);
            let (by_input, by_output) = buffers.at.gradient.split_at(count);
            for ((i, lag), g) in self.space.inputs.iter().zip(by_input) {
                u_bar[(t - lag) * self.n_inputs + i] += g * l;
            }
            for (lag, g) in self.space.outputs.iter().zip(by_output) {
                // Outputs before the start are given.
                if t - lag >= run.start {
                    adjoint[t - lag] += g * l;
                }
            }
        }
    }

    fn window(&self) -> &[(usize, usize)] {
        &self.space.inputs
    }

    fn window_derivatives(
        &self,
        _theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        let mut buffers = self.buffers();
        self.step(run.u, run.y, t, Ask::Hessian, &mut buffers);
        let (d, w) = (self.space.dim(), self.space.inputs.len());
        grad.copy_from_slice(&buffers.at.gradient[..w]);
        for i in 0..w {
            hess[i * w..(i + 1) * w].copy_from_slice(&buffers.at.hessian[i * d..i * d + w]);
        }
        buffers.at.mean
    }

    fn output_derivatives(&self, _theta: &[f64], run: &Run, t: usize, grad: &mut [f64]) {
        let mut buffers = self.buffers();
        self.step(run.u, run.y, t, Ask::Gradient, &mut buffers);
        grad.fill(0.0);
        for (lag, g) in self.space.outputs.iter().zip(&buffers.at.gradient[self.space.inputs.len()..]) {
            grad[lag - 1] = *g;
        }
    }
}
