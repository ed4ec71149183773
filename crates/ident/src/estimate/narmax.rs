//! Polynomial NARMAX models by extended least squares.
//!
//! ```text
//! y(t) = sum_k theta_k phi_k(u, y, e) + e(t)        phi_k a product of lagged inputs, outputs and innovations
//! ```
//!
//! The innovations are not measured: each pass regresses on the residuals of the pass before, until they repeat. A model
//! without terms in `e` is plain least squares; where the equation noise is coloured, that is biased and this is not.
//!
//! Reference: S. A. Billings, Nonlinear System Identification (2013), section 3.3; L. Ljung, System Identification
//! (1999), eq. (10.63) (pseudolinear regression).

use dynocal_numerics::linalg::{axpy, dot, least_squares};
use dynocal_numerics::registry::{MemberDoc, ParamDoc};
use dynocal_numerics::status::{Iterate, Status};
use serde::{Deserialize, Serialize};

use super::fit::Found;
use super::{EstimateError, Fit, Minimised};
use crate::data::DataError;
use crate::experiment::{Experiment, usable_samples};
use crate::model::poly::{PolyNarx, Source, StructureError};
use crate::model::{Model, Run};
use crate::validate::{Kind, Reference, Score, Seen, score_values};

/// Name of the innovations in regressors.
pub const INNOVATION: &str = "e";

/// The structure as a spec names it.
pub const STRUCTURE: MemberDoc = MemberDoc {
    name: "narmax",
    what: "polynomial with products of lagged inputs, outputs and innovations `e(t-k)`; estimator els",
    params: &[ParamDoc {
        name: "regressors",
        unit: "-",
        default: "",
        what: "terms as text, e.g. [\"y(t-1)\", \"inj(t-1)^2\", \"e(t-1)\"]",
    }],
};

/// The estimator as a spec names it.
pub const ELS: MemberDoc = MemberDoc {
    name: "els",
    what: "extended least squares: residuals of one pass are the innovations of the next; structure narmax",
    params: &[
        ParamDoc { name: "max_passes", unit: "-", default: "200", what: "most passes" },
        ParamDoc {
            name: "tolerance",
            unit: "standard errors",
            default: "1e-6",
            what: "largest change of a parameter at which the passes have converged",
        },
    ],
};

/// A polynomial NARMAX structure: a polynomial NARX model with the innovations as its last input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Narmax {
    with_innovations: PolyNarx,
}

/// Options of extended least squares.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Els {
    /// Most passes.
    pub max_passes: usize,
    /// Largest change of a parameter in a pass, in its standard errors, at which the passes have converged.
    pub tolerance: f64,
}

impl Default for Els {
    fn default() -> Self {
        Self { max_passes: 200, tolerance: 1e-6 }
    }
}

impl Narmax {
    /// A structure from regressors in text form, `e(t-1)` being the innovation of the sample before.
    ///
    /// ```
    /// use dynocal_ident::estimate::narmax::Narmax;
    /// let model = Narmax::parse(&["inj"], "torque", &["inj(t-1)", "torque(t-1)", "e(t-1)", "inj(t-1)*e(t-2)"])?;
    /// assert_eq!(model.regressor_texts()[3], "inj(t-1)*e(t-2)");
    /// assert!(Narmax::parse(&["inj"], "torque", &["e(t)"]).is_err());
    /// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
    /// ```
    ///
    /// # Errors
    /// [`StructureError`]: as of [`PolyNarx::parse`]; an innovation without lag; a channel that is named `e`.
    pub fn parse<A: AsRef<str>, B: AsRef<str>>(
        inputs: &[A],
        output: &str,
        regressors: &[B],
    ) -> Result<Self, StructureError> {
        let mut names: Vec<&str> = inputs.iter().map(AsRef::as_ref).collect();
        if names.contains(&INNOVATION) || output == INNOVATION {
            return Err(StructureError::Name {
                found: INNOVATION.into(),
                expected: "another name: in this structure `e` is the innovation",
            });
        }
        names.push(INNOVATION);
        let with_innovations = PolyNarx::parse(&names, output, regressors)?;
        let now = (names.len() - 1, 0);
        if with_innovations.window().contains(&now) {
            return Err(StructureError::Range {
                text: "e(t)".into(),
                what: "lag",
                found: 0,
                expected: "1 or more: the innovation of a sample is not known before it".into(),
            });
        }
        Ok(Self { with_innovations })
    }

    /// Regressors in text form.
    pub fn regressor_texts(&self) -> Vec<String> {
        self.with_innovations.regressor_texts()
    }

    /// Names of the measured inputs.
    pub fn inputs(&self) -> &[String] {
        let all = self.with_innovations.inputs();
        &all[..all.len() - 1]
    }

    /// The model as a NARX model whose last input is the innovation: with zeros there its free run is that of this model.
    pub fn with_innovations(&self) -> &PolyNarx {
        &self.with_innovations
    }

    /// What the free run simulates, where innovations are zero: the terms without them, with their parameters. None where
    /// every term has one.
    ///
    /// # Errors
    /// [`StructureError`] of the smaller structure.
    pub fn driven(&self, theta: &[f64]) -> Result<Option<(PolyNarx, Vec<f64>)>, StructureError> {
        let innovation = Source::Input(self.inputs().len());
        let own = self.with_innovations.regressors().iter().zip(theta);
        let left = own.filter(|(r, _)| r.reads().all(|(source, _)| source != innovation));
        let (terms, theta): (Vec<_>, Vec<f64>) = left.map(|(r, v)| (r.clone(), *v)).unzip();
        if terms.is_empty() {
            return Ok(None);
        }
        let output = self.with_innovations.output().to_string();
        Ok(Some((PolyNarx::new(self.inputs().to_vec(), output, terms)?, theta)))
    }

    /// Longest lag.
    pub fn max_lag(&self) -> usize {
        self.with_innovations.max_lag()
    }

    /// First sample of a record that is scored.
    pub fn first(&self, e: &Experiment) -> usize {
        e.init_samples.max(self.max_lag()).min(e.len())
    }

    /// Output of the model on a record (N): one step and k steps use the innovations up to then, the free run has none.
    pub fn output(&self, theta: &[f64], e: &Experiment, kind: Kind) -> Vec<f64> {
        let mut u = padded(e, self.inputs().len());
        let first = self.first(e);
        let mut y = e.y.clone();
        match kind {
            Kind::FreeRun => {
                let run = Run { u: &u, y: &e.y, start: first };
                self.with_innovations.simulate(theta, &run, &mut y);
            }
            Kind::OneStep => self.innovations(theta, e, &mut u, Some(&mut y)),
            Kind::KStep(k) => {
                self.innovations(theta, e, &mut u, None);
                self.k_step(theta, e, &u, k.max(1), &mut y);
            }
        }
        y
    }

    /// Scores of all records together.
    pub fn score(&self, theta: &[f64], data: &[Experiment], kind: Kind, seen: Seen) -> Score {
        let (mut z, mut zhat) = (Vec::new(), Vec::new());
        for e in data {
            let first = self.first(e);
            z.extend_from_slice(&e.y[first..]);
            zhat.extend_from_slice(&self.output(theta, e, kind)[first..]);
        }
        score_values(&z, &zhat, kind, seen, Reference::Noisy)
    }

    /// Fills the innovations into the last column of `u`, and the predictions that they are the errors of.
    fn innovations(&self, theta: &[f64], e: &Experiment, u: &mut [f64], mut predicted: Option<&mut [f64]>) {
        let (width, lag) = (self.inputs().len() + 1, self.max_lag());
        let mut tail = vec![0.0; lag + 1];
        for t in self.first(e)..e.len() {
            let from = t - lag;
            let run = Run { u: &u[from * width..(t + 1) * width], y: &e.y[from..=t], start: lag };
            self.with_innovations.predict(theta, &run, &mut tail);
            u[(t + 1) * width - 1] = e.y[t] - tail[lag];
            if let Some(p) = &mut predicted {
                p[t] = tail[lag];
            }
        }
    }

    /// For every t a free run over the last k samples, in which no innovation is known.
    fn k_step(&self, theta: &[f64], e: &Experiment, u: &[f64], k: usize, y: &mut [f64]) {
        let (width, lag, first) = (self.inputs().len() + 1, self.max_lag(), self.first(e));
        let mut tail = vec![0.0; lag + k];
        for t in first..e.len() {
            let free = k.min(t + 1 - first);
            let from = t + 1 - free - lag;
            let mut part = u[from * width..(t + 1) * width].to_vec();
            (lag..lag + free).for_each(|i| part[(i + 1) * width - 1] = 0.0);
            let run = Run { u: &part, y: &e.y[from..=t], start: lag };
            let tail = &mut tail[..lag + free];
            self.with_innovations.simulate(theta, &run, tail);
            y[t] = tail[lag + free - 1];
        }
    }
}

/// The inputs with a last column of zeros.
fn padded(e: &Experiment, m: usize) -> Vec<f64> {
    let mut u = Vec::with_capacity(e.len() * (m + 1));
    for t in 0..e.len() {
        u.extend_from_slice(&e.u[t * m..(t + 1) * m]);
        u.push(0.0);
    }
    u
}

impl Els {
    /// Estimates the parameters of `model` from all records together.
    ///
    /// ```
    /// use dynocal_ident::estimate::narmax::{Els, Narmax};
    /// use dynocal_ident::experiment::Experiment;
    /// let u: Vec<f64> = (0..80).map(|t| f64::from((t * t / 3) % 7) - 3.0).collect();
    /// let e: Vec<f64> = (0..80).map(|t| 0.1 * (f64::from((t * t * 7) % 11) - 5.0)).collect();
    /// let mut y = vec![0.0; 80];
    /// (1..80).for_each(|t| y[t] = 0.5 * y[t - 1] + u[t - 1] + e[t] + 0.6 * e[t - 1]);
    /// let data = [Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] }];
    /// let model = Narmax::parse(&["u"], "y", &["y(t-1)", "u(t-1)", "e(t-1)"])?;
    /// let fit = Els::default().estimate(&model, &data, &|| false)?;
    /// assert!((fit.theta[0] - 0.5).abs() < 0.05 && (fit.theta[1] - 1.0).abs() < 0.05);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`EstimateError`]: records that do not fit or are too short, overflow.
    pub fn estimate(
        &self,
        model: &Narmax,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let m = model.inputs().len();
        for e in data {
            check(model, e)?;
        }
        let mut records: Vec<Experiment> =
            data.iter().map(|e| Experiment { u: padded(e, m), ..e.clone() }).collect();
        let narx = &model.with_innovations;
        let samples = usable_samples(narx, &records)?;
        let mut theta = vec![0.0; narx.n_params()];
        let (mut history, mut status) = (Vec::new(), Status::Limit);
        for pass in 0..self.max_passes {
            let (phi, y) = super::ols::regression(narx, &records, samples);
            let solved = least_squares(&phi, samples, theta.len(), &y, 0.0).map_err(numeric)?;
            let moved = change(&theta, &solved.x, &phi, solved.residual_sum_squares / samples as f64);
            theta = solved.x;
            residuals(model, &theta, &mut records);
            history.push(Iterate {
                evaluations: pass + 1,
                objective: solved.residual_sum_squares,
                violation: 0.0,
                optimality: moved,
            });
            if moved <= self.tolerance {
                status = Status::Converged;
                break;
            }
            if interrupt() {
                status = Status::Interrupted;
                break;
            }
        }
        report(model, data, theta, status, history, samples)
    }
}

fn numeric(source: dynocal_numerics::linalg::LinalgError) -> EstimateError {
    EstimateError::Numeric { estimator: "els", source }
}

/// Shapes and values of one record.
fn check(model: &Narmax, e: &Experiment) -> Result<(), DataError> {
    let m = model.inputs().len();
    if e.u.len() != m * e.len() {
        let found = e.u.len() / m.max(1);
        return Err(DataError::Length {
            record: e.name.clone(),
            channel: "inputs".into(),
            found,
            expected: e.len(),
        });
    }
    if let Some(i) = e.u.iter().chain(&e.y).position(|v| !v.is_finite()) {
        let (channel, sample, found) = if i < e.u.len() {
            (model.inputs()[i % m].clone(), i / m, e.u[i])
        } else {
            (model.with_innovations.output().to_string(), i - e.u.len(), e.y[i - e.u.len()])
        };
        return Err(DataError::NonFinite { record: e.name.clone(), channel, sample, found });
    }
    Ok(())
}

/// Largest change of a parameter in its standard errors (by its regressor alone).
fn change(old: &[f64], new: &[f64], phi: &[f64], variance: f64) -> f64 {
    let p = new.len();
    let mut square = vec![0.0; p];
    for row in phi.chunks_exact(p) {
        square.iter_mut().zip(row).for_each(|(s, v)| *s += v * v);
    }
    let moved =
        |k: usize| (new[k] - old[k]).abs() * square[k].sqrt() / variance.sqrt().max(f64::MIN_POSITIVE);
    (0..p).map(moved).fold(0.0, f64::max)
}

/// The residuals of a pass become the innovations of the next; those before the first scored sample are zero.
fn residuals(model: &Narmax, theta: &[f64], records: &mut [Experiment]) {
    let narx = &model.with_innovations;
    let width = narx.n_inputs();
    for e in records {
        let mut predicted = vec![0.0; e.len()];
        let run = e.run(narx);
        let start = run.start;
        narx.predict(theta, &run, &mut predicted);
        for t in start..e.len() {
            e.u[(t + 1) * width - 1] = e.y[t] - predicted[t];
        }
    }
}

/// Innovations and their exact derivatives `psi = -de/dtheta`, `psi = phi - sum_j df/de(t-j) psi(t-j)`, give the covariance:
/// the passes end where `sum phi e = 0`, so that it is
///
/// ```text
/// s2 (Phi'Psi)^-1 Phi'Phi (Psi'Phi)^-1
/// ```
fn report(
    model: &Narmax,
    data: &[Experiment],
    theta: Vec<f64>,
    status: Status,
    history: Vec<Iterate>,
    samples: usize,
) -> Result<Fit, EstimateError> {
    let narx = &model.with_innovations;
    let (p, width, window) = (narx.n_params(), narx.n_inputs(), narx.window());
    let rows: usize = data.iter().map(Experiment::len).sum();
    let (mut r, mut jac, mut row) = (vec![0.0; rows], vec![0.0; rows * p], 0);
    let (mut grad, mut hess) = (vec![0.0; window.len()], vec![0.0; window.len() * window.len()]);
    let mut phi = vec![0.0; rows * p];
    for e in data {
        let mut u = padded(e, width - 1);
        model.innovations(&theta, e, &mut u, None);
        let run = Run { u: &u, y: &e.y, start: model.first(e) };
        let psi = &mut jac[row * p..(row + e.len()) * p];
        narx.one_step_jacobian(&theta, &run, psi);
        psi.iter_mut().for_each(|v| *v = -*v);
        phi[row * p..(row + e.len()) * p].copy_from_slice(psi);
        for t in run.start..e.len() {
            narx.window_derivatives(&theta, &run, t, &mut grad, &mut hess);
            let (past, now) = psi.split_at_mut(t * p);
            for (&(input, lag), g) in window.iter().zip(&grad) {
                if input == width - 1 && t >= lag + run.start {
                    axpy(-g, &past[(t - lag) * p..(t - lag + 1) * p], &mut now[..p]);
                }
            }
            r[row + t] = u[(t + 1) * width - 1];
        }
        for t in run.start..e.len() {
            let w = e.weight(t).sqrt();
            r[row + t] *= w;
            psi[t * p..(t + 1) * p].iter_mut().for_each(|v| *v *= w);
            phi[(row + t) * p..(row + t + 1) * p].iter_mut().for_each(|v| *v *= w);
        }
        row += e.len();
    }
    let mut warnings = Vec::new();
    if !dot(&r, &r).is_finite() || !jac.iter().all(|v| v.is_finite()) {
        warnings.push(
            "the innovations of the model grow without bound: its noise terms cannot be inverted".into(),
        );
        r.iter_mut().chain(&mut jac).filter(|v| !v.is_finite()).for_each(|v| *v = 0.0);
    }
    let found = Found {
        estimator: "els",
        minimised: Minimised::OneStep,
        theta,
        names: (0..p).map(|k| narx.param_name(k)).collect(),
        status,
        evaluations: history.len(),
        history,
        warnings,
    };
    let mut fit = Fit::from_stored(found, &r, &jac, data, samples)?;
    if fit.rank == p
        && let Some(covariance) = covariance(&phi, &jac, p, fit.noise_variance)
    {
        fit.std_errors = (0..p).map(|k| covariance[k * p + k].sqrt()).collect();
        fit.covariance = covariance;
    }
    Ok(fit)
}

/// `s2 (Phi'Psi)^-1 Phi'Phi (Psi'Phi)^-1` (p x p); none where it is singular.
fn covariance(phi: &[f64], psi: &[f64], p: usize, s2: f64) -> Option<Vec<f64>> {
    let (mut cross, mut gram) = (vec![0.0; p * p], vec![0.0; p * p]);
    for (a, b) in phi.chunks_exact(p).zip(psi.chunks_exact(p)) {
        for i in 0..p {
            axpy(a[i], b, &mut cross[i * p..(i + 1) * p]);
            axpy(a[i], a, &mut gram[i * p..(i + 1) * p]);
        }
    }
    // Columns of the inverse, then (inverse gram) inverse'.
    let mut inverse = vec![0.0; p * p];
    for j in 0..p {
        let unit: Vec<f64> = (0..p).map(|i| f64::from(u8::from(i == j))).collect();
        let solved = least_squares(&cross, p, p, &unit, 0.0).ok().filter(|s| s.factor.rank == p)?;
        solved.x.iter().enumerate().for_each(|(i, v)| inverse[i * p + j] = *v);
    }
    let half: Vec<f64> =
        (0..p * p).map(|ij| (0..p).map(|k| inverse[ij / p * p + k] * gram[k * p + ij % p]).sum()).collect();
    let entry = |i: usize, j: usize| s2 * dot(&half[i * p..(i + 1) * p], &inverse[j * p..(j + 1) * p]);
    Some((0..p * p).map(|ij| entry(ij / p, ij % p)).collect())
}
