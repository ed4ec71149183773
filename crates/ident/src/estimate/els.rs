//! Extended least squares for polynomial NARMAX models.
//!
//! The innovations are not measured: each pass regresses on the residuals of the pass before, until they repeat. A model
//! without terms in `e` is plain least squares; where the equation noise is coloured, that is biased and this is not.
//!
//! Reference: S. A. Billings, Nonlinear System Identification (2013), section 3.3; L. Ljung, System Identification
//! (1999), eq. (10.63) (pseudolinear regression).

use dynocal_numerics::linalg::{axpy, dot, least_squares};
use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use dynocal_numerics::status::{Iterate, Status};
use serde::Deserialize;

use super::fit::Found;
use super::table::{EstimatorRow, Fits, Gaps};
use super::{EstimateError, Estimator, Fit, Minimised, made_for};
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::form::Form;
use crate::model::narmax::{Narmax, padded};
use crate::model::{Model, Run, usable_samples};

/// Row of the table.
pub(super) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
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
    },
    fits: Fits::Forms(&["narmax"]),
    gaps: Gaps::Bridged { free_run: false },
    build: |keys| Ok(Box::new(registry::keys::<Els>("els", keys)?)),
};

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

impl Estimator for Els {
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        _start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        Els::estimate(self, made_for::<Narmax>("els", model)?, data, interrupt)
    }
}

impl Els {
    /// Estimates the parameters of `model` from all records together.
    ///
    /// ```
    /// use dynocal_ident::estimate::els::Els;
    /// use dynocal_ident::model::narmax::Narmax;
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
        let narx = model.with_innovations();
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
            (model.with_innovations().output().to_string(), i - e.u.len(), e.y[i - e.u.len()])
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
    let narx = model.with_innovations();
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
    let narx = model.with_innovations();
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
