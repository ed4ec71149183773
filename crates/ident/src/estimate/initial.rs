//! Where the memory of a model stands before its first scored sample.

use std::borrow::Cow;

use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

use super::fit::Found;
use super::missing::{MOST_UNKNOWNS, Recovered, bridged};
use super::sem::Sem;
use super::{EstimateError, Estimator, Fit, Minimised, names};
use crate::experiment::Experiment;
use crate::model::usable_samples;
use crate::model::{Model, Run};

pub use crate::model::initial::Initial;

/// The records with free runs that start as `rule` says, for estimators that start them from the outputs before the first
/// scored sample: at rest zeros stand there.
///
/// # Errors
/// [`EstimateError::Initial`]: a model that is not at rest at zero (with a constant), or a rule that the estimator has not.
pub(super) fn started<'a>(
    estimator: &'static str,
    model: &dyn Model,
    data: &'a [Experiment],
    rule: Initial,
) -> Result<Cow<'a, [Experiment]>, EstimateError> {
    let fault = |found: &str| EstimateError::Initial { estimator, rule, found: found.into() };
    match rule {
        Initial::Measured => Ok(Cow::Borrowed(data)),
        Initial::Estimated => Err(fault("an estimator that has no initial outputs among its parameters")),
        Initial::Rest => {
            let (m, lag) = (model.n_inputs(), model.max_lag());
            let (u, y, mut out) = (vec![0.0; (lag + 1) * m], vec![0.0; lag + 1], vec![0.0; lag + 1]);
            let theta = vec![1.0; model.n_params()];
            model.predict(&theta, &Run { u: &u, y: &y, start: lag }, &mut out);
            if out[lag] != 0.0 {
                return Err(fault("a model that is not at rest at zero (a constant, or scaled channels)"));
            }
            let padded = |e: &Experiment| {
                let mut p = e.at_rest(lag);
                if e.init_samples > 0 {
                    // They run freely too, and enter no score.
                    p.weights.resize(p.y.len(), 1.0);
                    p.weights[lag..(lag + e.init_samples).min(p.y.len())].fill(0.0);
                }
                p
            };
            Ok(Cow::Owned(data.iter().map(padded).collect()))
        }
    }
}

/// Free-run fit of any model whose initial outputs, and missing inputs (NaN), are estimated with the parameters.
///
/// ```text
/// v(t) = df/dz(t) + sum_j df/dy(t-j) v(t-j)        z an initial output or a missing input sample
/// ```
///
/// are the exact sensitivities with respect to them, by the recursion of those with respect to theta. The outputs before
/// the first scored sample are free in each record, as many as the model's longest output lag; missing outputs have no
/// weight. The search starts from the simulation-error fit that takes the measured values and straight lines across gaps.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FreeStates {
    /// Most cost evaluations.
    pub max_evaluations: usize,
    /// Relative decrease of the cost at which the search has converged.
    pub cost_tolerance: f64,
    /// Whether the initial outputs are estimated; else they are the measured ones.
    pub outputs: bool,
}

impl Default for FreeStates {
    fn default() -> Self {
        Self { max_evaluations: 200, cost_tolerance: 1e-12, outputs: true }
    }
}

/// A free-run fit with what it says about the states.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StatesFit {
    /// Parameters; their covariance takes the states as estimated.
    pub fit: Fit,
    /// Initial outputs of each record, the oldest first.
    pub initial: Vec<Vec<f64>>,
    /// Missing inputs.
    pub recovered: Vec<Recovered>,
}

impl FreeStates {
    /// Estimates parameters and states from all records together; `start` (p) replaces the simulation-error fit.
    ///
    /// ```
    /// use dynocal_ident::estimate::initial::FreeStates;
    /// use dynocal_ident::experiment::Experiment;
    /// use dynocal_ident::model::poly::PolyNarx;
    /// // y(t) = 0.9 y(t-1) + u(t-1) from y(0) = 5, of which the record says 4.
    /// let u: Vec<f64> = (0..60).map(|t| f64::from((t * t / 3) % 5) - 2.0).collect();
    /// let mut y = vec![5.0; 60];
    /// (1..60).for_each(|t| y[t] = 0.9 * y[t - 1] + u[t - 1]);
    /// y[0] = 4.0;
    /// let data = [Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] }];
    /// let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"])?;
    /// let found = FreeStates::default().estimate(&model, &data, None, &|| false)?;
    /// assert!((found.fit.theta[1] - 0.9).abs() < 1e-8 && (found.initial[0][0] - 5.0).abs() < 1e-7);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`EstimateError`]: as of [`Sem`], and more missing samples than [`MOST_UNKNOWNS`].
    pub fn estimate(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<StatesFit, EstimateError> {
        let (mut whole, mut missing) = (Vec::new(), Vec::new());
        for e in data {
            let (mut bridged, gaps) = bridged(e);
            if !gaps.outputs.is_empty() {
                bridged.weights =
                    (0..e.len()).map(|t| if e.y[t].is_nan() { 0.0 } else { e.weight(t) }).collect();
            }
            let unknowns = gaps.inputs.len();
            if unknowns > MOST_UNKNOWNS {
                return Err(EstimateError::Missing {
                    record: e.name.clone(),
                    found: unknowns,
                    most: MOST_UNKNOWNS,
                });
            }
            whole.push(bridged);
            missing.push(gaps.inputs);
        }
        let samples = usable_samples(model, &whole)?;
        let absent: usize = data
            .iter()
            .map(|e| e.y[e.first(model).min(e.len())..].iter().filter(|v| v.is_nan()).count())
            .sum();
        let first = match start {
            Some(theta) if theta.len() != model.n_params() => {
                return Err(EstimateError::Start { found: theta.len(), expected: model.n_params() });
            }
            Some(theta) => theta.to_vec(),
            None => Sem::default().estimate(model, &whole, None, interrupt)?.theta,
        };
        let mut problem = Augmented::new(model, &whole, missing, self.outputs);
        let x0 = problem.start(&first);
        let options = LmOptions {
            max_evaluations: self.max_evaluations,
            cost_tolerance: self.cost_tolerance,
            ..LmOptions::default()
        };
        let found = levenberg_marquardt_interruptible(&mut problem, &x0, &options, interrupt);
        problem.report(found, samples - absent)
    }
}

/// The free-run errors of all records as a function of theta, initial outputs and missing inputs.
struct Augmented<'a> {
    model: &'a dyn Model,
    /// Without gaps; the trial's states are written into them.
    records: Vec<Experiment>,
    measured: &'a [Experiment],
    /// (input, sample) of each record.
    missing: Vec<Vec<(usize, usize)>>,
    /// Free initial outputs of each record.
    outputs: usize,
    y: Vec<f64>,
    s: Vec<f64>,
}

impl<'a> Augmented<'a> {
    fn new(
        model: &'a dyn Model,
        measured: &'a [Experiment],
        missing: Vec<Vec<(usize, usize)>>,
        outputs: bool,
    ) -> Self {
        let longest = measured.iter().map(Experiment::len).max().unwrap_or(0);
        Self {
            model,
            records: measured.to_vec(),
            measured,
            missing,
            outputs: if outputs { model.output_lag() } else { 0 },
            y: vec![0.0; longest],
            s: vec![0.0; longest * model.n_params()],
        }
    }

    /// theta, then for each record its initial outputs and missing inputs.
    fn start(&self, theta: &[f64]) -> Vec<f64> {
        let (mut x, m) = (theta.to_vec(), self.model.n_inputs());
        for (e, missing) in self.measured.iter().zip(&self.missing) {
            let first = e.first(self.model);
            x.extend_from_slice(&e.y[first - self.outputs..first]);
            x.extend(missing.iter().map(|(i, t)| e.u[t * m + i]));
        }
        x
    }

    /// Writes the states of `x` into the records.
    fn place(&mut self, x: &[f64]) {
        let m = self.model.n_inputs();
        let mut rest = &x[self.model.n_params()..];
        for (e, missing) in self.records.iter_mut().zip(&self.missing) {
            let first = e.first(self.model);
            let (outputs, tail) = rest.split_at(self.outputs);
            e.y[first - self.outputs..first].copy_from_slice(outputs);
            let (inputs, tail) = tail.split_at(missing.len());
            missing.iter().zip(inputs).for_each(|((i, t), v)| e.u[t * m + i] = *v);
            rest = tail;
        }
    }

    fn report(&mut self, found: LmOutcome, samples: usize) -> Result<StatesFit, EstimateError> {
        let (p, m, width, rows) = (self.model.n_params(), self.model.n_inputs(), self.n(), self.residuals());
        let (mut r, mut jac) = (vec![0.0; rows], vec![0.0; rows * width]);
        self.residual_jacobian(&found.x, &mut r, &mut jac);
        let mut states = Vec::new();
        for (e, missing) in self.measured.iter().zip(&self.missing) {
            states
                .extend((1..=self.outputs).rev().map(|lag| format!("{}: initial output (t-{lag})", e.name)));
            states.extend(missing.iter().map(|(i, t)| format!("{}: input {} at sample {t}", e.name, i + 1)));
        }
        let all = Found {
            estimator: "sem",
            minimised: Minimised::FreeRun,
            theta: found.x.clone(),
            names: names(self.model).into_iter().chain(states).collect(),
            status: found.status,
            evaluations: found.evaluations,
            history: found.history,
            warnings: Vec::new(),
        };
        let mut fit = Fit::from_stored(all, &r, &jac, self.measured, samples)?;
        let (mut initial, mut recovered, mut next) = (Vec::new(), Vec::new(), p);
        for (record, missing) in self.missing.iter().enumerate() {
            initial.push(found.x[next..next + self.outputs].to_vec());
            next += self.outputs;
            for (i, sample) in missing {
                let std_error = fit.std_errors[next];
                let value = self.records[record].u[sample * m + i];
                let channel = format!("input {}", i + 1);
                recovered.push(Recovered { record, channel, sample: *sample, value, std_error });
                next += 1;
            }
        }
        let block = |row: usize| fit.covariance[row * width..row * width + p].iter().copied();
        fit.covariance = (0..p).flat_map(block).collect();
        fit.rank = fit.std_errors[..p].iter().filter(|v| !v.is_nan()).count();
        fit.std_errors.truncate(p);
        fit.theta.truncate(p);
        fit.names.truncate(p);
        Ok(StatesFit { fit, initial, recovered })
    }

    /// Columns of the states of record `k` from its free run in `y`, into the rows of that record.
    fn state_columns(&self, k: usize, theta: &[f64], column: usize, rows: &mut [f64]) {
        let (model, e, missing) = (self.model, &self.records[k], &self.missing[k]);
        let (width, lags, window) = (self.n(), model.output_lag(), model.window());
        let run = Run { u: &e.u, y: &self.y[..e.len()], start: e.first(model) };
        let count = self.outputs + missing.len();
        let (mut gy, mut gu) = (vec![0.0; lags], vec![0.0; window.len()]);
        let mut hess = vec![0.0; if missing.is_empty() { 0 } else { window.len() * window.len() }];
        // A ring of the last rows of v.
        let mut v = vec![0.0; (lags + 1) * count];
        let ring = |t: usize| (t % (lags + 1)) * count;
        for j in 0..self.outputs {
            let t = run.start - self.outputs + j;
            v[ring(t) + j] = 1.0;
        }
        let mut now = vec![0.0; count];
        for t in run.start..e.len() {
            now.fill(0.0);
            model.output_derivatives(theta, &run, t, &mut gy);
            for (lag, g) in (1..=lags).zip(&gy) {
                let earlier = &v[ring(t - lag)..ring(t - lag) + count];
                now.iter_mut().zip(earlier).for_each(|(n, v)| *n += g * v);
            }
            if !missing.is_empty() {
                model.window_derivatives(theta, &run, t, &mut gu, &mut hess);
                for (place, g) in window.iter().zip(&gu) {
                    for (c, (i, at)) in missing.iter().enumerate() {
                        if *i == place.0 && at + place.1 == t {
                            now[self.outputs + c] += g;
                        }
                    }
                }
            }
            v[ring(t)..ring(t) + count].copy_from_slice(&now);
            let w = e.weight(t).sqrt();
            let row = &mut rows[t * width + column..t * width + column + count];
            row.iter_mut().zip(&now).for_each(|(r, v)| *r = w * v);
        }
    }
}

impl LeastSquares for Augmented<'_> {
    fn n(&self) -> usize {
        let missing: usize = self.missing.iter().map(Vec::len).sum();
        self.model.n_params() + self.records.len() * self.outputs + missing
    }

    fn residuals(&self) -> usize {
        self.records.iter().map(Experiment::len).sum()
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        self.place(x);
        let (theta, mut row) = (&x[..self.model.n_params()], 0);
        for e in &self.records {
            let (run, y) = (e.run(self.model), &mut self.y[..e.len()]);
            if self.model.simulate(theta, &run, y) != Status::Converged {
                return false;
            }
            errors(e, run.start, y, &mut r[row..row + e.len()]);
            row += e.len();
        }
        true
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        self.place(x);
        let (p, width) = (self.model.n_params(), self.n());
        let (theta, mut row, mut column) = (&x[..p], 0, p);
        jac.fill(0.0);
        for k in 0..self.records.len() {
            let e = &self.records[k];
            let (n, run) = (e.len(), e.run(self.model));
            if self.model.sensitivities(theta, &run, &mut self.y[..n], &mut self.s[..n * p])
                != Status::Converged
            {
                return false;
            }
            errors(e, run.start, &self.y[..n], &mut r[row..row + n]);
            let rows = &mut jac[row * width..(row + n) * width];
            for t in run.start..n {
                let w = e.weight(t).sqrt();
                let into = rows[t * width..t * width + p].iter_mut();
                into.zip(&self.s[t * p..(t + 1) * p]).for_each(|(j, s)| *j = w * s);
            }
            self.state_columns(k, theta, column, rows);
            column += self.outputs + self.missing[k].len();
            row += n;
        }
        true
    }
}

/// Weighted errors from sample `start` on, zero before.
fn errors(e: &Experiment, start: usize, y: &[f64], r: &mut [f64]) {
    r[..start].fill(0.0);
    for t in start..e.len() {
        r[t] = e.weight(t).sqrt() * (y[t] - e.y[t]);
    }
}
