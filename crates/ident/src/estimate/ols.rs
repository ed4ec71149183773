//! Least squares on the one-step prediction error.
//!
//! ```text
//! theta = argmin sum_t w(t) rho(y(t) - phi(t)' theta)  + ridge n sum_k rms(phi_k)^2 theta_k^2
//! ```
//!
//! (thesis eq. 2.15, rho the square) with the measured outputs in phi, over all experiments together, by Householder QR in
//! unit column scaling. With Huber's cost ([`super::cost`]) Levenberg-Marquardt follows from there.

use dynocal_numerics::linalg::{LeastSquaresFit, dot, least_squares};
use dynocal_numerics::lm::{LeastSquares, LmOptions, levenberg_marquardt_interruptible};
use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use dynocal_numerics::status::{Iterate, Status};
use serde::Deserialize;

use super::cost::{Cost, CostKind, HUBER_THRESHOLD, fit_scale, outlier_note};
use super::covariance::{CovarianceChoice, Rows, Stored};
use super::fit::Found;
use super::noise::noise_warning;
use super::table::{EstimatorRow, Fits, Gaps};
use super::{EstimateError, Estimator, Fit, Minimised, names, narx};
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::form::Form;
use crate::model::usable_samples;

/// Row of the table.
pub(super) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
        name: "ols",
        what: "one-step prediction error by column-scaled QR least squares (PEM)",
        params: &[
            ParamDoc {
                name: "ridge",
                unit: "-",
                default: "0",
                what: "weight on squared parameters, each in units of its regressor's rms, relative to the number of samples",
            },
            ParamDoc {
                name: "cost",
                unit: "-",
                default: "\"squared\"",
                what: "cost of an error: squared, or huber, which outliers pull with a constant force only",
            },
            ParamDoc {
                name: "threshold",
                unit: "-",
                default: "1.345",
                what: "where Huber's cost turns linear, in robust standard deviations of the errors",
            },
            ParamDoc {
                name: "covariance",
                unit: "-",
                default: "\"auto\"",
                what: "white, robust (sandwich for coloured errors), or auto: as a test of the errors says",
            },
        ],
    },
    fits: Fits::Narx,
    gaps: Gaps::Bridged { free_run: false },
    build: |keys| Ok(Box::new(registry::keys::<Ols>("ols", keys)?)),
};

/// Options of least squares.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ols {
    /// Ridge weight; parameters count in units of their regressor's rms, so that it does not depend on units.
    pub ridge: f64,
    /// Cost of an error.
    pub cost: CostKind,
    /// Threshold of Huber's cost in robust standard deviations of the errors.
    pub threshold: f64,
    /// What the covariance assumes of the errors.
    pub covariance: CovarianceChoice,
}

impl Default for Ols {
    fn default() -> Self {
        Self {
            ridge: 0.0,
            cost: CostKind::Squared,
            threshold: HUBER_THRESHOLD,
            covariance: CovarianceChoice::Auto,
        }
    }
}

impl Estimator for Ols {
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        _start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let model = narx("ols", model)?;
        let samples = usable_samples(model, data)?;
        let p = model.n_params();
        if !model.is_linear_in_params() {
            return Err(EstimateError::NotLinear { estimator: "ols", params: p });
        }
        let (phi, y) = regression(model, data, samples);
        let samples = y.len();
        if samples < p {
            let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
            let why = format!("{p} parameters; rows with missing samples are left out");
            return Err(DataError::TooShort { record, found: samples, expected: p, why }.into());
        }
        let solved = solve(&phi, &y, p, self.ridge)?;
        let mut problem = Linear { phi: &phi, y: &y, ridge: self.penalties(&phi, p) };
        let mut errors = problem.errors(&solved.x);
        let (mut cost, mut warnings) = (Cost::SQUARED, Vec::new());
        let objective = solved.residual_sum_squares;
        let (mut theta, mut status, mut evaluations) = (solved.x, Status::Converged, 1);
        let mut history = vec![Iterate { evaluations: 1, objective, violation: 0.0, optimality: 0.0 }];
        if self.cost == CostKind::Huber {
            let options = LmOptions { cost_tolerance: 1e-14, ..LmOptions::default() };
            let rows = errors.len();
            let (found, used) = fit_scale(&mut problem, rows, self.threshold, &theta, |costed, x| {
                levenberg_marquardt_interruptible(costed, x, &options, interrupt)
            });
            (theta, status, evaluations, history) =
                (found.x, found.status, 1 + found.evaluations, found.history);
            cost = used;
            errors = problem.errors(&theta);
            warnings.extend(outlier_note(cost, &errors));
        }
        let found = Found {
            estimator: "ols",
            minimised: Minimised::OneStep,
            theta,
            names: names(model),
            status,
            evaluations,
            history,
            warnings,
        };
        let records = kept_rows(model, data);
        let mut evidence = Stored {
            errors: &errors,
            jacobian: &phi,
            params: p,
            records,
            penalties: &problem.ridge,
            exogenous: model.output_lag() == 0,
            rows: Rows::Regressors,
        };
        let mut fit = Fit::new(found, &mut evidence, samples, self.covariance, cost)?;
        fit.warnings.extend(noise_warning(model, &fit.theta, data, fit.minimised, &fit.residuals, None));
        Ok(fit)
    }
}

impl Ols {
    /// `sqrt(ridge n) rms(phi_k)` of each parameter; empty without ridge.
    fn penalties(&self, phi: &[f64], p: usize) -> Vec<f64> {
        if self.ridge <= 0.0 {
            return Vec::new();
        }
        let mut square = vec![0.0; p];
        for row in phi.chunks_exact(p) {
            square.iter_mut().zip(row).for_each(|(s, v)| *s += v * v);
        }
        square.iter().map(|s| (self.ridge * s).sqrt()).collect()
    }
}

/// Weighted regressors (samples x p, row-major) and outputs of the scored samples of all experiments; a row in which a
/// sample is missing (NaN) is left out.
pub(crate) fn regression(model: &dyn Model, data: &[Experiment], samples: usize) -> (Vec<f64>, Vec<f64>) {
    let p = model.n_params();
    // A model that is linear in theta has the same regressors for every theta.
    let theta = vec![0.0; p];
    let (mut phi, mut y) = (Vec::with_capacity(samples * p), Vec::with_capacity(samples));
    let mut rows = vec![0.0; data.iter().map(Experiment::len).max().unwrap_or(0) * p];
    for e in data {
        let run = e.run(model);
        let rows = &mut rows[..e.len() * p];
        model.one_step_jacobian(&theta, &run, rows);
        for t in run.start..e.len() {
            let (w, row) = (e.weight(t).sqrt(), &rows[t * p..(t + 1) * p]);
            if e.y[t].is_nan() || row.iter().any(|v| v.is_nan()) {
                continue;
            }
            phi.extend(row.iter().map(|v| w * v));
            y.push(w * e.y[t]);
        }
    }
    (phi, y)
}

/// Rows of [`regression`] that come from each record: all scored samples where none is missing.
pub(super) fn kept_rows(model: &dyn Model, data: &[Experiment]) -> Vec<usize> {
    let whole = |e: &Experiment| e.len() - e.first(model);
    if data.iter().all(|e| e.u.iter().chain(&e.y).all(|v| !v.is_nan())) {
        return data.iter().map(whole).collect();
    }
    data.iter().map(|e| regression(model, std::slice::from_ref(e), whole(e)).1.len()).collect()
}

/// Least squares with the ridge in units of the columns' rms.
pub(super) fn solve(phi: &[f64], y: &[f64], p: usize, ridge: f64) -> Result<LeastSquaresFit, EstimateError> {
    let n = y.len();
    if ridge <= 0.0 {
        return least_squares(phi, n, p, y, 0.0).map_err(numeric);
    }
    let mut scale = vec![0.0; p];
    for row in phi.chunks_exact(p) {
        scale.iter_mut().zip(row).for_each(|(s, v)| *s += v * v);
    }
    scale.iter_mut().for_each(|s| *s = if *s > 0.0 { (*s / n as f64).sqrt() } else { 1.0 });
    let scaled: Vec<f64> =
        phi.chunks_exact(p).flat_map(|row| row.iter().zip(&scale).map(|(v, s)| v / s)).collect();
    let mut fit = least_squares(&scaled, n, p, y, ridge * n as f64).map_err(numeric)?;
    for k in 0..p {
        fit.x[k] /= scale[k];
        fit.factor.scale[k] *= scale[k];
    }
    Ok(fit)
}

fn numeric(source: dynocal_numerics::linalg::LinalgError) -> EstimateError {
    EstimateError::Numeric { estimator: "ols", source }
}

/// `phi theta - y` and the ridge as a problem for Levenberg-Marquardt.
struct Linear<'a> {
    phi: &'a [f64],
    y: &'a [f64],
    ridge: Vec<f64>,
}

impl Linear<'_> {
    fn errors(&self, theta: &[f64]) -> Vec<f64> {
        self.phi.chunks_exact(theta.len()).zip(self.y).map(|(row, y)| dot(row, theta) - y).collect()
    }
}

impl LeastSquares for Linear<'_> {
    fn n(&self) -> usize {
        self.phi.len() / self.y.len().max(1)
    }

    fn residuals(&self) -> usize {
        self.y.len() + self.ridge.len()
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        let (errors, penalties) = r.split_at_mut(self.y.len());
        for ((r, row), y) in errors.iter_mut().zip(self.phi.chunks_exact(x.len())).zip(self.y) {
            *r = dot(row, x) - y;
        }
        for ((r, w), v) in penalties.iter_mut().zip(&self.ridge).zip(x) {
            *r = w * v;
        }
        r.iter().all(|v| v.is_finite())
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        let p = x.len();
        jac[..self.phi.len()].copy_from_slice(self.phi);
        jac[self.phi.len()..].fill(0.0);
        for (k, w) in self.ridge.iter().enumerate() {
            jac[self.phi.len() + k * p + k] = *w;
        }
        self.residual(x, r)
    }
}
