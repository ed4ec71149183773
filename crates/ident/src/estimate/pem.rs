//! Prediction-error estimation of linear models with noise models (maximum likelihood for Gaussian noise).
//!
//! ```text
//! theta = argmin sum_t w(t) eps(t; theta)^2,   eps = D/C (A y - sum B_i/F_i u_i)
//! ```
//!
//! by Levenberg-Marquardt with the exact gradient of [`crate::model::linear`]. All filters are at rest before the
//! first sample of each experiment; its initialising samples run through them and enter no score. A trial with an
//! unstable filter gives a large or non-finite error and is a bad trial, nothing more.
//!
//! The start is least squares throughout: a high-order ARX model gives the innovations and the noise-free response,
//! from which the wanted polynomials follow linearly.
//!
//! Reference: E. J. Hannan, J. Rissanen, Recursive estimation of mixed autoregressive-moving average order,
//! Biometrika 69 (1982); K. Steiglitz, L. E. McBride, IEEE Trans. Autom. Control 10 (1965); L. Ljung, System
//! Identification (1999), section 10.4.

mod start;

use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use serde::Deserialize;

use super::fit::Found;
use super::{EstimateError, Fit, Minimised};
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::linear::{LinearModel, PredictionErrors};

/// Options of prediction-error estimation.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pem {
    /// Most cost evaluations.
    pub max_evaluations: usize,
    /// Relative decrease of the cost at which the search has converged.
    pub cost_tolerance: f64,
}

impl Default for Pem {
    fn default() -> Self {
        Self { max_evaluations: 200, cost_tolerance: 1e-14 }
    }
}

impl Pem {
    /// Estimates the parameters of `model` from all experiments together; `start` (p) replaces the least-squares start.
    ///
    /// ```
    /// use dynocal_ident::estimate::pem::Pem;
    /// use dynocal_ident::experiment::Experiment;
    /// use dynocal_ident::model::linear::LinearModel;
    /// // y(t) = 0.8 y(t-1) + u(t-1) without noise: an output-error model with F = 1 - 0.8 q^-1.
    /// let u: Vec<f64> = (0..60).map(|t| f64::from((t * t / 3) % 5) - 2.0).collect();
    /// let mut y = vec![0.0; 60];
    /// (1..60).for_each(|t| y[t] = 0.8 * y[t - 1] + u[t - 1]);
    /// let data = [Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] }];
    /// let fit = Pem::default().estimate(&LinearModel::oe(&["u"], "y", 1, 1, 1), &data, None, &|| false)?;
    /// assert!((fit.theta[0] - 1.0).abs() < 1e-8 && (fit.theta[1] + 0.8).abs() < 1e-8);
    /// # Ok::<(), dynocal_ident::estimate::EstimateError>(())
    /// ```
    ///
    /// # Errors
    /// [`EstimateError`]: orders or records that do not fit, too few samples, a start of the wrong length, overflow.
    pub fn estimate(
        &self,
        model: &LinearModel,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        model.check()?;
        let samples = scored_samples(model, data)?;
        let p = model.n_params();
        let mut problem = PredictionError::new(model, data);
        let start = match start {
            Some(theta) if theta.len() != p => {
                return Err(EstimateError::Start { found: theta.len(), expected: p });
            }
            Some(theta) => theta.to_vec(),
            None => start::least_squares_start(model, data).map_err(numeric)?,
        };
        // The start is a guess: when it is worse than no model at all, no model is the better one.
        let nothing = vec![0.0; p];
        let start = if problem.cost(&start) <= problem.cost(&nothing) { start } else { nothing };
        let options = LmOptions {
            max_evaluations: self.max_evaluations,
            cost_tolerance: self.cost_tolerance,
            ..LmOptions::default()
        };
        let found = levenberg_marquardt_interruptible(&mut problem, &start, &options, interrupt);
        problem.report(found, samples)
    }
}

fn numeric(source: dynocal_numerics::linalg::LinalgError) -> EstimateError {
    EstimateError::Numeric { estimator: "pem", source }
}

/// Number of scored samples of all records after checks of their shape.
fn scored_samples(model: &LinearModel, data: &[Experiment]) -> Result<usize, EstimateError> {
    let (m, p) = (model.n_inputs(), model.n_params());
    let mut total = 0;
    for e in data {
        let fault = |channel: &str, found| DataError::Length {
            record: e.name.clone(),
            channel: channel.into(),
            found,
            expected: e.len(),
        };
        if e.u.len() != m * e.len() {
            return Err(fault("inputs", e.u.len() / m.max(1)).into());
        }
        if !e.weights.is_empty() && e.weights.len() != e.len() {
            return Err(fault("weights", e.weights.len()).into());
        }
        if let Some(i) = e.u.iter().chain(&e.y).position(|v| !v.is_finite()) {
            let (channel, sample, found) = if i < e.u.len() {
                (model.inputs[i % m].clone(), i / m, e.u[i])
            } else {
                (model.output.clone(), i - e.u.len(), e.y[i - e.u.len()])
            };
            return Err(DataError::NonFinite { record: e.name.clone(), channel, sample, found }.into());
        }
        total += e.len().saturating_sub(e.init_samples);
    }
    if total <= p {
        let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
        let why = format!("{p} parameters and the noise variance");
        return Err(DataError::TooShort { record, found: total, expected: p + 1, why }.into());
    }
    Ok(total)
}

/// The prediction errors of all experiments, one row per sample; initialising samples count zero.
struct PredictionError<'a> {
    model: &'a LinearModel,
    data: &'a [Experiment],
    records: Vec<PredictionErrors<'a>>,
    rows: usize,
}

impl<'a> PredictionError<'a> {
    fn new(model: &'a LinearModel, data: &'a [Experiment]) -> Self {
        let records = data.iter().map(|e| PredictionErrors::new(model, &e.u, &e.y)).collect();
        Self { model, data, records, rows: data.iter().map(Experiment::len).sum() }
    }

    fn cost(&mut self, theta: &[f64]) -> f64 {
        let mut r = vec![0.0; self.rows];
        let cost: f64 =
            if self.residual(theta, &mut r) { r.iter().map(|v| v * v).sum() } else { f64::INFINITY };
        if cost.is_finite() { cost } else { f64::INFINITY }
    }

    fn report(&mut self, found: LmOutcome, samples: usize) -> Result<Fit, EstimateError> {
        let p = self.model.n_params();
        let (mut r, mut jac) = (vec![0.0; self.rows], vec![0.0; self.rows * p]);
        self.residual_jacobian(&found.x, &mut r, &mut jac);
        let unstable = self.model.unstable_parts(&found.x).into_iter().map(|part| {
            format!(
                "{part} has a root on or outside the unit circle: the standard errors do not hold there; try a lower order"
            )
        });
        let warnings = unstable.collect();
        let found = Found {
            estimator: "pem",
            minimised: Minimised::OneStep,
            theta: found.x,
            names: self.model.param_names(),
            status: found.status,
            evaluations: found.evaluations,
            history: found.history,
            warnings,
        };
        Fit::from_stored(found, &r, &jac, self.data, samples)
    }
}

impl LeastSquares for PredictionError<'_> {
    fn n(&self) -> usize {
        self.model.n_params()
    }

    fn residuals(&self) -> usize {
        self.rows
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        let mut row = 0;
        for (e, record) in self.data.iter().zip(&mut self.records) {
            let r = &mut r[row..row + e.len()];
            if !record.errors(x, r) {
                return false;
            }
            weigh(e, r, 1);
            row += e.len();
        }
        true
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        let p = self.model.n_params();
        let mut row = 0;
        for (e, record) in self.data.iter().zip(&mut self.records) {
            let (r, jac) = (&mut r[row..row + e.len()], &mut jac[row * p..(row + e.len()) * p]);
            if !record.jacobian(x, r, jac) {
                return false;
            }
            weigh(e, r, 1);
            weigh(e, jac, p);
            row += e.len();
        }
        true
    }
}

/// Zeroes the initialising rows and multiplies the others by the root of their weight.
fn weigh(e: &Experiment, rows: &mut [f64], width: usize) {
    rows[..e.init_samples.min(e.len()) * width].fill(0.0);
    if !e.weights.is_empty() && width > 0 {
        for (w, row) in e.weights.iter().zip(rows.chunks_exact_mut(width)) {
            row.iter_mut().for_each(|v| *v *= w.sqrt());
        }
    }
}
