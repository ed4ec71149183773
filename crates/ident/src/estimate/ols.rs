//! Ordinary least squares on the one-step prediction error.
//!
//! ```text
//! theta = argmin sum_t w(t) (y(t) - phi(t)' theta)^2  + ridge n sum_k rms(phi_k)^2 theta_k^2
//! ```
//!
//! (thesis eq. 2.15) with the measured outputs in phi, over all experiments together, by Householder QR in unit
//! column scaling.

use dynocal_numerics::linalg::{LeastSquaresFit, least_squares};
use dynocal_numerics::status::{Iterate, Status};
use serde::Deserialize;

use super::covariance::{covariance, rank_warning};
use super::{EstimateError, Estimator, Fit, Minimised, names};
use crate::experiment::{Experiment, usable_samples};
use crate::model::Model;

/// Options of least squares.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ols {
    /// Ridge weight; parameters count in units of their regressor's rms, so that it does not depend on units.
    pub ridge: f64,
}

impl Estimator for Ols {
    fn estimate(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        _start: Option<&[f64]>,
        _interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let samples = usable_samples(model, data)?;
        let p = model.n_params();
        if !model.is_linear_in_params() {
            return Err(EstimateError::NotLinear { estimator: "ols", params: p });
        }
        let (phi, y) = regression(model, data, samples);
        let solved = solve(&phi, &y, p, self.ridge)?;
        let names = names(model);
        let noise_variance = solved.residual_sum_squares / (samples - solved.factor.rank).max(1) as f64;
        let (covariance, std_errors) = covariance(&solved.factor, p, noise_variance).map_err(numeric)?;
        let warnings = rank_warning(&solved.factor, &names).into_iter().collect();
        Ok(Fit {
            estimator: "ols".into(),
            minimised: Minimised::OneStep,
            theta: solved.x,
            names,
            covariance,
            std_errors,
            mse: solved.residual_sum_squares / samples as f64,
            noise_variance,
            samples,
            rank: solved.factor.rank,
            status: Status::Converged,
            evaluations: 1,
            history: vec![Iterate {
                evaluations: 1,
                objective: solved.residual_sum_squares,
                violation: 0.0,
                optimality: 0.0,
            }],
            warnings,
        })
    }
}

/// Weighted regressors (samples x p, row-major) and outputs of the scored samples of all experiments.
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
            let w = e.weight(t).sqrt();
            phi.extend(rows[t * p..(t + 1) * p].iter().map(|v| w * v));
            y.push(w * e.y[t]);
        }
    }
    (phi, y)
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
