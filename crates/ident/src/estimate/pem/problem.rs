//! The least-squares problem behind prediction-error estimation.

use dynocal_numerics::lm::LeastSquares;

use super::super::initial::Initial;
use super::super::missing::{Recovered, Unknowns, bridged, scale_rows};
use super::super::{EstimateError, Fit};
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::linear::{LinearModel, PredictionErrors, Unknown};

/// One record with its buffers.
pub(super) struct Record<'a> {
    /// With straight lines across its gaps.
    pub(super) e: std::borrow::Cow<'a, Experiment>,
    /// First scored row.
    pub(super) first: usize,
    errors: PredictionErrors<'a>,
    unknowns: Unknowns,
}

/// The prediction errors of all records, one row per sample; rows that only initialise count zero.
pub(super) struct PredictionError<'a> {
    model: &'a LinearModel,
    pub(super) records: Vec<Record<'a>>,
    pub(super) rows: usize,
    /// Scored samples with a measured output.
    pub(super) samples: usize,
    /// Gradient of the log of the likelihood's scale factor.
    direction: Vec<f64>,
}

impl<'a> PredictionError<'a> {
    /// # Errors
    /// [`EstimateError`]: shapes, values that are not finite, too few samples, too much missing.
    pub(super) fn new(
        model: &'a LinearModel,
        data: &'a [Experiment],
        initial: Initial,
    ) -> Result<Self, EstimateError> {
        let mut records = Vec::with_capacity(data.len());
        let (mut samples, mut parameters) = (0, model.n_params());
        for e in data {
            check(model, e)?;
            let record = record(model, e, initial)?;
            let scored = e.y.iter().skip(record.first).filter(|v| !v.is_nan()).count();
            parameters += record.unknowns.parameters();
            samples += scored;
            records.push(record);
        }
        if samples <= parameters {
            let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
            let why = format!("{parameters} parameters and the noise variance");
            return Err(DataError::TooShort { record, found: samples, expected: parameters + 1, why }.into());
        }
        let rows = data.iter().map(Experiment::len).sum();
        Ok(Self { model, records, rows, samples, direction: vec![0.0; model.n_params()] })
    }

    /// Unknown states and missing inputs: degrees of freedom beside the parameters.
    pub(super) fn nuisance_parameters(&self) -> usize {
        self.records.iter().map(|r| r.unknowns.parameters()).sum()
    }

    /// Whether anything but the parameters is estimated: an evaluation then costs many times more.
    pub(super) fn has_unknowns(&self) -> bool {
        self.records.iter().any(|r| !r.unknowns.is_empty())
    }

    pub(super) fn cost(&mut self, theta: &[f64], r: &mut [f64]) -> f64 {
        let cost: f64 = if self.residual(theta, r) { r.iter().map(|v| v * v).sum() } else { f64::INFINITY };
        if cost.is_finite() { cost } else { f64::INFINITY }
    }

    /// `det(G_y'G_y)^(1/2n)` at the last evaluation; 1 when no output is missing.
    pub(super) fn likelihood_scale(&self) -> f64 {
        let log: f64 = self.records.iter().map(|r| r.unknowns.log_det()).sum();
        (0.5 * log / self.samples as f64).exp()
    }

    /// The missing samples at the parameters of `fit`.
    pub(super) fn recovered(&mut self, fit: &Fit) -> Vec<Recovered> {
        let mut out = Vec::new();
        let mut r = vec![0.0; self.rows];
        if !self.residual(&fit.theta, &mut r) {
            return out;
        }
        for (k, record) in self.records.iter().enumerate() {
            for (what, sample, change, std) in record.unknowns.solution() {
                let channel = match what {
                    Unknown::Output => &self.model.output,
                    Unknown::Input(i) => &self.model.inputs[i],
                    Unknown::InputState(_) | Unknown::NoiseState => continue,
                };
                let guess = record.errors.value(what, sample);
                let std_error = std * fit.noise_variance.sqrt();
                out.push(Recovered {
                    record: k,
                    channel: channel.clone(),
                    sample,
                    value: guess + change,
                    std_error,
                });
            }
        }
        out.sort_by(|a, b| (a.record, &a.channel, a.sample).cmp(&(b.record, &b.channel, b.sample)));
        out
    }

    /// Multiplies all residuals by the scale factor of the likelihood, when outputs are missing.
    fn scale(&mut self, r: &mut [f64], jac: &mut [f64]) {
        if self.records.iter().all(|r| r.unknowns.is_empty()) {
            return;
        }
        let gain = self.likelihood_scale();
        if jac.is_empty() {
            r.iter_mut().for_each(|v| *v *= gain);
            return;
        }
        self.direction.fill(0.0);
        for record in &self.records {
            record.unknowns.add_log_det_gradient(&record.errors, &record.e, &mut self.direction);
        }
        self.direction.iter_mut().for_each(|v| *v *= 0.5 / self.samples as f64);
        scale_rows(r, jac, gain, &self.direction);
    }
}

/// Bridges the gaps and lists what is unknown.
fn record<'a>(
    model: &'a LinearModel,
    e: &'a Experiment,
    initial: Initial,
) -> Result<Record<'a>, EstimateError> {
    let known = !e.y.iter().chain(&e.u).any(|v| v.is_nan());
    let (whole, mut missing) = if known {
        (std::borrow::Cow::Borrowed(e), Default::default())
    } else {
        let (whole, missing) = bridged(e);
        (std::borrow::Cow::Owned(whole), missing)
    };
    let lag = e.init_samples.max(model.max_lag());
    let measured = initial == Initial::Measured && (model.na == 0 || model.orders.iter().all(|o| o.nf == 0));
    let first = if initial == Initial::Rest { e.init_samples } else { lag };
    if first >= e.len() {
        let why = format!("{first} samples initialise, one must be left");
        return Err(
            DataError::TooShort { record: e.name.clone(), found: e.len(), expected: first + 1, why }.into()
        );
    }
    let mut states = Vec::new();
    let errors = match initial {
        Initial::Measured if measured => {
            // What stands before the first prediction is taken as it is.
            missing.outputs.retain(|t| *t >= first);
            missing.inputs.retain(|(_, t)| *t >= first);
            PredictionErrors::from_measured(model, &whole.u, &whole.y, first)
        }
        Initial::Rest => PredictionErrors::new(model, &whole.u, &whole.y),
        _ => {
            for (i, o) in model.orders.iter().enumerate() {
                states.extend((0..o.nf).map(|j| (Unknown::InputState(i), first + j)));
            }
            states.extend((0..model.nc.max(model.nd)).map(|j| (Unknown::NoiseState, first + j)));
            PredictionErrors::new(model, &whole.u, &whole.y)
        }
    };
    let channels: Vec<String> = model.inputs.iter().chain([&model.output]).cloned().collect();
    let unknowns = Unknowns::new(e, &channels, &missing, first, states)?;
    Ok(Record { e: whole, first, errors, unknowns })
}

/// Shapes and values of one record; NaN is a missing sample.
fn check(model: &LinearModel, e: &Experiment) -> Result<(), DataError> {
    let m = model.n_inputs();
    let fault = |channel: &str, found| DataError::Length {
        record: e.name.clone(),
        channel: channel.into(),
        found,
        expected: e.len(),
    };
    if e.u.len() != m * e.len() {
        return Err(fault("inputs", e.u.len() / m.max(1)));
    }
    if !e.weights.is_empty() && e.weights.len() != e.len() {
        return Err(fault("weights", e.weights.len()));
    }
    if let Some(i) = e.u.iter().chain(&e.y).position(|v| v.is_infinite()) {
        let (channel, sample, found) = if i < e.u.len() {
            (model.inputs[i % m].clone(), i / m, e.u[i])
        } else {
            (model.output.clone(), i - e.u.len(), e.y[i - e.u.len()])
        };
        return Err(DataError::NonFinite { record: e.name.clone(), channel, sample, found });
    }
    Ok(())
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
        for record in &mut self.records {
            let (e, n) = (&record.e, record.e.len());
            let r = &mut r[row..row + n];
            if !record.errors.errors(x, r) {
                return false;
            }
            weigh(e, record.first, r, 1);
            if !record.unknowns.is_empty() {
                if !record.unknowns.refresh(&record.errors, e) {
                    return false;
                }
                record.unknowns.project(r, 1, 0);
            }
            row += n;
        }
        self.scale(r, &mut []);
        true
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        let p = self.model.n_params();
        let mut row = 0;
        for record in &mut self.records {
            let (e, n) = (&record.e, record.e.len());
            let (r, jac) = (&mut r[row..row + n], &mut jac[row * p..(row + n) * p]);
            if !record.errors.jacobian(x, r, jac) {
                return false;
            }
            weigh(e, record.first, r, 1);
            weigh(e, record.first, jac, p);
            if !record.unknowns.is_empty() {
                if !record.unknowns.refresh(&record.errors, e) {
                    return false;
                }
                record.unknowns.project(r, 1, 0);
                // Variable projection with the Jacobian of Kaufman (1975): where the unknowns have their best values for
                // this x the gradient is exact.
                record.unknowns.apply(&mut record.errors);
                if !record.errors.jacobian(x, r, jac) {
                    return false;
                }
                weigh(e, record.first, r, 1);
                weigh(e, record.first, jac, p);
                (0..p).for_each(|k| record.unknowns.project(jac, p, k));
                record.unknowns.project(r, 1, 0);
            }
            row += n;
        }
        self.scale(r, jac);
        true
    }
}

/// Zeroes the initialising rows and multiplies the others by the root of their weight.
fn weigh(e: &Experiment, first: usize, rows: &mut [f64], width: usize) {
    rows[..first.min(e.len()) * width].fill(0.0);
    if !e.weights.is_empty() && width > 0 {
        for (w, row) in e.weights.iter().zip(rows.chunks_exact_mut(width)) {
            row.iter_mut().for_each(|v| *v *= w.sqrt());
        }
    }
}
