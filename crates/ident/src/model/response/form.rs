//! Response models as the house keeps its models: over present and lagged channels, in one stored form.
//!
//! ```text
//! y(t) = f(u(t-k), y(t-j))        no lags at all: a steady model, every row a point of its own
//! ```
//!
//! What is learnt stands in the structure, and theta is empty (p = 0): a Gaussian process is its points, a tree its splits.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Ask, LearntModel, Points, PointsError, Prediction, Response, ResponseModel};
use crate::experiment::Experiment;
use crate::model::form::{Driven, Form, FormRow};
use crate::model::initial::{Initial, free_run};
use crate::model::poly::{Regressor, StructureError};
use crate::model::{Kind, Model, Run, output};
use dynocal_numerics::status::Status;

/// The form in a file.
pub(super) static FORM: FormRow = FormRow {
    name: "response",
    narx: false,
    initial: Initial::Measured,
    read: |text| {
        let form: ResponseForm = serde_json::from_value(text)?;
        match form.fault() {
            Some(fault) => Err(serde::de::Error::custom(fault)),
            None => Ok(Arc::new(form)),
        }
    },
};

/// A response model over channels and their lags: its kind before it has seen points, and the model afterwards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResponseForm {
    inputs: Vec<String>,
    output: String,
    /// (input, lag), lags of one input together.
    window: Vec<(usize, usize)>,
    /// Lags of the output, from 1.
    output_lags: usize,
    /// Which kind learns it, with its keys.
    learner: Learner,
    #[serde(default)]
    learnt: Option<LearntModel>,
}

/// A kind of response model with its keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Learner {
    /// Name in the table of response models.
    pub name: String,
    /// Its keys.
    pub keys: toml::Table,
}

impl ResponseForm {
    /// The structure of `output` over `window` (input, lag) and `output_lags` past outputs, before it is learnt.
    ///
    /// # Errors
    /// [`StructureError::Empty`] where it reads nothing, [`StructureError::Range`] where it reads an input that is not there.
    pub fn new(
        inputs: &[String],
        output: &str,
        window: Vec<(usize, usize)>,
        output_lags: usize,
        learner: Learner,
    ) -> Result<Self, StructureError> {
        if window.is_empty() && output_lags == 0 {
            return Err(StructureError::Empty { output: output.into() });
        }
        if let Some((i, _)) = window.iter().find(|(i, _)| *i >= inputs.len()) {
            let expected = format!("1 to {}", inputs.len());
            let text = format!("a response model of {output}");
            return Err(StructureError::Range { text, what: "input number", found: i + 1, expected });
        }
        let (inputs, output) = (inputs.to_vec(), output.to_string());
        Ok(Self { inputs, output, window, output_lags, learner, learnt: None })
    }

    /// The same with what was learnt.
    ///
    /// # Errors
    /// [`StructureError::Orders`] where the model takes another number of inputs.
    pub fn with(&self, model: ResponseModel) -> Result<Self, StructureError> {
        let (found, expected) = (model.dim(), self.coordinates());
        if found != expected {
            let (output, inputs) = (self.output.clone(), self.names());
            return Err(StructureError::Orders { output, found, expected, inputs });
        }
        Ok(Self { learnt: Some(Arc::new(model).into()), ..self.clone() })
    }

    /// Which kind learns it.
    pub fn learner(&self) -> &Learner {
        &self.learner
    }

    /// The response model, once it is learnt.
    pub fn response(&self) -> Option<&ResponseModel> {
        self.learnt.as_ref().map(|m| m.0.as_ref())
    }

    /// Whether it reads the present alone: every row is then a point of its own.
    pub fn is_steady(&self) -> bool {
        self.max_lag() == 0
    }

    /// Names of the coordinates: those of the inputs for a steady model, `inj(t-1)` else.
    pub fn names(&self) -> Vec<String> {
        if self.is_steady() {
            return self.window.iter().map(|(i, _)| self.inputs[*i].clone()).collect();
        }
        let of_inputs = self.window.iter().map(|&(i, lag)| Regressor::input(i, lag));
        let all = of_inputs.chain((1..=self.output_lags).map(Regressor::output));
        all.map(|r| r.format(&self.inputs, &self.output)).collect()
    }

    /// Present and lagged values of all records as points; samples that only initialise, have no weight or miss a value are
    /// left out.
    ///
    /// # Errors
    /// [`PointsError::Shape`] when a record has another number of inputs.
    pub fn points(&self, data: &[Experiment]) -> Result<Points, PointsError> {
        let m = self.inputs.len();
        let mut points =
            Points { inputs: self.names(), output: self.output.clone(), x: Vec::new(), y: Vec::new() };
        let mut point = vec![0.0; self.coordinates()];
        for e in data {
            if e.u.len() != e.len() * m {
                let (found, points, expected) = (e.u.len(), e.len(), e.len() * m);
                let output = format!("{} of {}", self.output, e.name);
                return Err(PointsError::Shape { output, found, points, expected, inputs: m });
            }
            for t in e.init_samples.max(self.max_lag())..e.len() {
                self.point(&e.u, &e.y, t, &mut point);
                let weighs = e.weights.get(t).is_none_or(|w| *w > 0.0);
                if weighs && e.y[t].is_finite() && point.iter().all(|v| v.is_finite()) {
                    points.x.extend_from_slice(&point);
                    points.y.push(e.y[t]);
                }
            }
        }
        Ok(points)
    }

    fn coordinates(&self) -> usize {
        self.window.len() + self.output_lags
    }

    fn point(&self, u: &[f64], y: &[f64], t: usize, out: &mut [f64]) {
        let m = self.inputs.len();
        let (of_inputs, of_outputs) = out.split_at_mut(self.window.len());
        of_inputs.iter_mut().zip(&self.window).for_each(|(p, (i, lag))| *p = u[(t - lag) * m + i]);
        of_outputs.iter_mut().zip(1..).for_each(|(p, lag)| *p = y[t - lag]);
    }

    /// What does not fit in a file.
    fn fault(&self) -> Option<String> {
        if let Err(e) =
            Self::new(&self.inputs, &self.output, self.window.clone(), self.output_lags, self.learner.clone())
        {
            return Some(e.to_string());
        }
        let found = self.response()?.dim();
        let expected = self.coordinates();
        (found != expected).then(|| {
            format!("the response model of `{}` takes {found} inputs, expected {expected}", self.output)
        })
    }

    /// Prediction of sample t from inputs and the outputs in `y`. Only what is learnt is driven; a structure without a model
    /// predicts nothing.
    fn step(&self, u: &[f64], y: &[f64], t: usize, ask: Ask, buffers: &mut Buffers) {
        self.point(u, y, t, &mut buffers.point);
        match self.response() {
            Some(model) => model.predict(&buffers.point, ask, &mut buffers.at),
            None => buffers.at.mean = f64::NAN,
        }
    }

    fn buffers(&self) -> Buffers {
        let d = self.coordinates();
        Buffers { point: vec![0.0; d], at: Prediction::new(d) }
    }
}

struct Buffers {
    point: Vec<f64>,
    at: Prediction,
}

impl Form for ResponseForm {
    fn row(&self) -> &'static FormRow {
        &FORM
    }

    fn inputs(&self) -> &[String] {
        &self.inputs
    }

    fn output(&self) -> &str {
        &self.output
    }

    fn parameter_names(&self) -> Vec<String> {
        Vec::new()
    }

    fn memory(&self) -> usize {
        self.max_lag()
    }

    fn driven(&self, _theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        if self.learnt.is_none() {
            let (output, kind) = (self.output.clone(), self.learner.name.clone());
            return Err(StructureError::NotLearnt { output, kind });
        }
        Ok(Some(Driven { model: Arc::new(self.clone()), theta: Vec::new() }))
    }

    fn computed(
        &self,
        theta: &[f64],
        driven: Option<&Driven>,
        e: &Experiment,
        kind: Kind,
        initial: Initial,
    ) -> Option<Vec<f64>> {
        let d = driven?;
        if kind == Kind::FreeRun {
            let first = e.init_samples.max(self.memory()).min(e.len());
            return Some(free_run(d.model.as_ref(), theta, e, first, initial).y);
        }
        Some(output(d.model.as_ref(), theta, e, kind))
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

impl Model for ResponseForm {
    fn n_inputs(&self) -> usize {
        self.inputs.len()
    }

    fn n_params(&self) -> usize {
        0
    }

    fn max_lag(&self) -> usize {
        self.window.iter().map(|(_, lag)| *lag).chain([self.output_lags]).max().unwrap_or(0)
    }

    fn output_lag(&self) -> usize {
        self.output_lags
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

    /// There are no parameters, so that S has no columns.
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
        let (mut adjoint, m) = (y_bar.to_vec(), self.inputs.len());
        for t in (run.start.min(run.len())..run.len()).rev() {
            let l = adjoint[t];
            if l == 0.0 {
                continue;
            }
            self.step(run.u, y, t, Ask::Gradient, &mut buffers);
            let (by_input, by_output) = buffers.at.gradient.split_at(self.window.len());
            for ((i, lag), g) in self.window.iter().zip(by_input) {
                u_bar[(t - lag) * m + i] += g * l;
            }
            for (lag, g) in (1..).zip(by_output) {
                // Outputs before the start are given.
                if t - lag >= run.start {
                    adjoint[t - lag] += g * l;
                }
            }
        }
    }

    fn window(&self) -> &[(usize, usize)] {
        &self.window
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
        let (d, w) = (self.coordinates(), self.window.len());
        grad.copy_from_slice(&buffers.at.gradient[..w]);
        for i in 0..w {
            hess[i * w..(i + 1) * w].copy_from_slice(&buffers.at.hessian[i * d..i * d + w]);
        }
        buffers.at.mean
    }

    fn output_derivatives(&self, _theta: &[f64], run: &Run, t: usize, grad: &mut [f64]) {
        let mut buffers = self.buffers();
        self.step(run.u, run.y, t, Ask::Gradient, &mut buffers);
        grad.copy_from_slice(&buffers.at.gradient[self.window.len()..]);
    }

    /// Window first, then past outputs: the order of the coordinates.
    fn joint_derivatives(
        &self,
        _theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        let mut buffers = self.buffers();
        self.step(run.u, run.y, t, Ask::Hessian, &mut buffers);
        grad.copy_from_slice(&buffers.at.gradient);
        hess.copy_from_slice(&buffers.at.hessian);
        buffers.at.mean
    }
}
