//! Confidence bands of predictions and free runs.
//!
//! ```text
//! var yhat(t) = j(t)' C j(t)           j = dyhat/dtheta, C the covariance of the parameters
//! var y(t)    = var yhat(t) + s2       a new measurement: s2 the variance of errors of that kind
//! ```
//!
//! First order in the parameters. A free run has errors of another size than one-step prediction: [`band`] therefore takes
//! s2 from the fit where it minimised the same kind, and else from that kind of error on the data of the estimation.
//!
//! Reference: G. A. F. Seber, C. J. Wild, Nonlinear Regression (1989), section 5.1.

use dynocal_numerics::linalg::dot;
use dynocal_numerics::status::Status;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};

use super::{Fit, Minimised};
use crate::experiment::Experiment;
use crate::model::Model;

/// Rows of sensitivities at a time.
const BLOCK: usize = 512;

/// Output of a model with what is known of its accuracy; NaN from where a free run diverges.
#[derive(Clone, Debug, Serialize)]
pub struct Band {
    /// Which output: one-step prediction or free run.
    pub kind: Minimised,
    /// First sample that is computed (before it the measured outputs stand, without spread).
    pub start: usize,
    /// Model output (N).
    pub y: Vec<f64>,
    /// Standard deviation of the model output from the parameters' (N).
    pub std_model: Vec<f64>,
    /// Standard deviation of a new measurement about the model output (N).
    pub std_measured: Vec<f64>,
    /// Variance of the errors that was added.
    pub noise_variance: f64,
}

impl Band {
    /// (lower, upper) bound between which the noise-free output lies with probability `level` (0.95 e.g.).
    pub fn of_model(&self, level: f64) -> (Vec<f64>, Vec<f64>) {
        self.bounds(&self.std_model, level)
    }

    /// (lower, upper) bound between which a measurement lies with probability `level`.
    pub fn of_measurement(&self, level: f64) -> (Vec<f64>, Vec<f64>) {
        self.bounds(&self.std_measured, level)
    }

    fn bounds(&self, std: &[f64], level: f64) -> (Vec<f64>, Vec<f64>) {
        let tail = 0.5 + 0.5 * level.clamp(0.0, 1.0);
        let k = Normal::standard().inverse_cdf(tail);
        let side = |sign: f64| {
            // Without spread the bound is the output, also at a level of one.
            let at = |(y, s): (&f64, &f64)| if *s == 0.0 { *y } else { y + sign * k * s };
            self.y.iter().zip(std).map(at).collect()
        };
        (side(-1.0), side(1.0))
    }
}

/// The band of `model` with the parameters of `fit` on the record `e`; `data` are the records of the estimation.
///
/// ```
/// use dynocal_ident::estimate::{Estimator, Minimised, bands::band, ols::Ols};
/// use dynocal_ident::experiment::Experiment;
/// use dynocal_ident::model::poly::PolyNarx;
/// // The mean of 100 values of variance 0.25: known to 0.05.
/// let model = PolyNarx::parse(&["u"], "y", &["1"])?;
/// let y: Vec<f64> = (0..100).map(|t| 3.0 + if t % 2 == 0 { 0.5 } else { -0.5 }).collect();
/// let e = Experiment { name: "a".into(), u: vec![0.0; 100], y, init_samples: 0, weights: vec![] };
/// let data = [e];
/// let white = Ols { covariance: dynocal_ident::estimate::CovarianceChoice::White, ..Ols::default() };
/// let fit = white.estimate(&model, &data, None, &|| false).unwrap();
/// let b = band(&model, &fit, &data, &data[0], Minimised::OneStep);
/// assert!((b.y[7] - 3.0).abs() < 1e-12 && (b.std_model[7] - 0.05).abs() < 1e-3);
/// let (low, high) = b.of_model(0.95);
/// assert!((high[7] - low[7] - 2.0 * 1.96 * b.std_model[7]).abs() < 1e-4);
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
pub fn band(model: &dyn Model, fit: &Fit, data: &[Experiment], e: &Experiment, kind: Minimised) -> Band {
    let noise_variance = if kind == fit.minimised {
        fit.noise_variance
    } else {
        error_variance(model, &fit.theta, data, kind)
    };
    let p = model.n_params();
    let run = e.run(model);
    let start = run.start.min(e.len());
    let mut y = vec![0.0; e.len()];
    let variance = |row: &[f64]| -> f64 {
        (0..p).map(|i| row[i] * dot(&fit.covariance[i * p..(i + 1) * p], row)).sum::<f64>().max(0.0)
    };
    // Standard deviations stay NaN where a free run has diverged.
    let mut std_model = vec![f64::NAN; e.len()];
    std_model[..start].fill(0.0);
    match kind {
        Minimised::OneStep => {
            let mut j = vec![0.0; e.len() * p];
            model.predict(&fit.theta, &run, &mut y);
            model.one_step_jacobian(&fit.theta, &run, &mut j);
            for (std, row) in std_model.iter_mut().zip(j.chunks_exact(p.max(1))).skip(start) {
                *std = variance(row).sqrt();
            }
        }
        Minimised::FreeRun => {
            model.sensitivity_blocks(&fit.theta, &run, BLOCK, &mut y, &mut |t, _, rows| {
                for (std, row) in std_model[t..].iter_mut().zip(rows.chunks_exact(p.max(1))) {
                    *std = variance(row).sqrt();
                }
            });
        }
    }
    let mut std_measured: Vec<f64> = std_model.iter().map(|s| (s * s + noise_variance).sqrt()).collect();
    std_measured[..start].fill(0.0);
    Band { kind, start, y, std_model, std_measured, noise_variance }
}

/// Mean squared error of that kind over the scored samples; NaN when a free run diverges.
fn error_variance(model: &dyn Model, theta: &[f64], data: &[Experiment], kind: Minimised) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for e in data {
        let run = e.run(model);
        let mut y = vec![0.0; e.len()];
        match kind {
            Minimised::OneStep => model.predict(theta, &run, &mut y),
            Minimised::FreeRun if model.simulate(theta, &run, &mut y) != Status::Converged => {
                return f64::NAN;
            }
            Minimised::FreeRun => {}
        }
        for t in run.start.min(e.len())..e.len() {
            sum += e.weight(t) * (y[t] - e.y[t]).powi(2);
            total += f64::from(u8::from(e.weight(t) > 0.0));
        }
    }
    sum / total
}
