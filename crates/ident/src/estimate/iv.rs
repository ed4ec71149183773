//! Instrumental variables: consistent where least squares is biased by coloured equation noise.
//!
//! ```text
//! theta = (Z' Phi)^-1 Z' Y                                   (thesis eq. 2.18)
//! ```
//!
//! The instruments Z (N x p) are the model's own regressors with noise-free signals in place of the measured ones
//! (eqs. 2.20, 2.21): the output is the free run of a first estimate. Measured inputs serve as they are while they do
//! not depend on the noise. Under feedback they do: then give an external reference r, from which output and inputs
//! are both modelled.
//!
//! Four-step IV filters regressors, instruments and output by the inverse of the noise model, which makes the
//! estimate nearly as sharp as maximum likelihood for linear models.
//!
//! Reference: T. Soderstrom, P. Stoica, Instrumental Variable Methods for System Identification (1983); L. Ljung,
//! System Identification (1999), eqs. (7.118) and (15.21) to (15.26).

use dynocal_numerics::linalg::{
    LinalgError, PivotedR, dot, least_squares, pivoted_r, solve_upper_transposed,
};
use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use dynocal_numerics::status::{Iterate, Status};
use serde::Deserialize;

use super::covariance::Rows;
use super::ols::{Ols, regression};
use super::rank::rank_warning;
use super::table::{EstimatorRow, Fits, Gaps};
use super::{CovarianceKind, EstimateError, Estimator, Fit, Minimised, Residuals, names, narx, short_name};
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::form::Form;
use crate::model::linear::filter::{filter, stabilised};
use crate::model::usable_samples;

/// Row of the table.
pub(super) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
        name: "iv",
        what: "instrumental variables from the free run of least squares, eqs. (2.18) to (2.21)",
        params: &[
            ParamDoc {
                name: "four_step",
                unit: "-",
                default: "true",
                what: "whether a noise model then filters the instruments",
            },
            ParamDoc {
                name: "noise_order",
                unit: "samples",
                default: "0",
                what: "order of that noise model; 0 for the number of parameters",
            },
            ParamDoc {
                name: "reference_order",
                unit: "samples",
                default: "4",
                what: "order of the models from an external reference, where there is one",
            },
        ],
    },
    fits: Fits::Narx,
    gaps: Gaps::Bridged { free_run: true },
    build: |keys| Ok(Box::new(registry::keys::<Iv>("iv", keys)?)),
};

/// Options of the instrumental-variable estimator.
///
/// ```
/// use dynocal_ident::estimate::{Estimator, iv::Iv};
/// use dynocal_ident::experiment::Experiment;
/// use dynocal_ident::model::poly::PolyNarx;
/// // y(t) = 0.5 y(t-1) + u(t-1), measured without noise.
/// let u: Vec<f64> = (0..80).map(|t| f64::from((t * t / 3) % 7) - 3.0).collect();
/// let mut y = vec![0.0; 80];
/// (1..80).for_each(|t| y[t] = 0.5 * y[t - 1] + u[t - 1]);
/// let data = [Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] }];
/// let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"])?;
/// let two_step = Iv { four_step: false, ..Iv::default() };
/// let fit = two_step.estimate(&model, &data, None, &|| false)?;
/// assert!((fit.theta[0] - 1.0).abs() < 1e-10 && (fit.theta[1] - 0.5).abs() < 1e-10);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Iv {
    /// Whether steps three and four (noise model, filtered instruments) follow.
    pub four_step: bool,
    /// Order of the autoregressive noise model; 0 stands for the number of lagged terms p.
    pub noise_order: usize,
    /// Order of the models of inputs and output from an external reference.
    pub reference_order: usize,
}

impl Default for Iv {
    fn default() -> Self {
        Self { four_step: true, noise_order: 0, reference_order: 4 }
    }
}

impl Estimator for Iv {
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        _start: Option<&[f64]>,
        _interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        self.estimate_with(narx("iv", model)?, data, None)
    }
}

impl Iv {
    /// The same with an external reference: one slice (N) per experiment that drives the loop and is independent of
    /// the noise.
    ///
    /// # Errors
    /// As of [`Estimator::estimate`]; [`crate::data::DataError::Length`] when a reference does not fit its record.
    pub fn estimate_with(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        reference: Option<&[&[f64]]>,
    ) -> Result<Fit, EstimateError> {
        let samples = usable_samples(model, data)?;
        if !model.is_linear_in_params() {
            return Err(EstimateError::NotLinear { estimator: "iv", params: model.n_params() });
        }
        let clean = match reference {
            Some(r) => self.reference_response(model, data, r)?,
            None => {
                let start = Ols::default().estimate(model, data, None, &|| false)?;
                free_runs(model, &start.theta, data)?
            }
        };
        let task = Task::new(model, data, samples);
        let mut found = task.solve(&task.instruments(&clean), None)?;
        let mut evaluations = 1;
        if self.four_step {
            // Instruments from the consistent estimate, then filtered by the noise model of its residuals.
            let clean = free_runs(model, &found.theta, &clean)?;
            let order = if self.noise_order == 0 { model.n_params() } else { self.noise_order };
            let whitening = task.noise_model(&found.theta, order)?;
            found = task.solve(&task.instruments(&clean), Some(&whitening))?;
            evaluations = 2;
        }
        task.report(found, evaluations)
    }

    /// Noise-free inputs and output: each modelled as ARX from the reference and simulated.
    fn reference_response(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        reference: &[&[f64]],
    ) -> Result<Vec<Experiment>, EstimateError> {
        let m = model.n_inputs();
        let mut clean = data.to_vec();
        for (i, e) in data.iter().enumerate() {
            let found = reference.get(i).map_or(0, |r| r.len());
            if found != e.len() {
                return Err(crate::data::DataError::Length {
                    record: e.name.clone(),
                    channel: "reference".into(),
                    found,
                    expected: e.len(),
                }
                .into());
            }
        }
        for channel in 0..=m {
            let signal = |e: &Experiment| -> Vec<f64> {
                if channel == m {
                    e.y.clone()
                } else {
                    e.u.iter().skip(channel).step_by(m).copied().collect()
                }
            };
            let signals: Vec<Vec<f64>> = data.iter().map(signal).collect();
            let modelled = arx_response(&signals, reference, self.reference_order.max(1)).map_err(numeric)?;
            for (e, response) in clean.iter_mut().zip(modelled) {
                if channel == m {
                    e.y = response;
                } else {
                    (0..response.len()).for_each(|t| e.u[t * m + channel] = response[t]);
                }
            }
        }
        Ok(clean)
    }
}

/// Response of an ARX model of `signals` on `drive`, orders and first lag 0; one signal per experiment.
fn arx_response(signals: &[Vec<f64>], drive: &[&[f64]], order: usize) -> Result<Vec<Vec<f64>>, LinalgError> {
    let width = 2 * order + 1;
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for (x, r) in signals.iter().zip(drive) {
        for t in order..x.len() {
            a.extend((1..=order).map(|lag| -x[t - lag]));
            a.extend((0..=order).map(|lag| r[t - lag]));
            b.push(x[t]);
        }
    }
    let found = least_squares(&a, b.len(), width, &b, 0.0)?.x;
    let den: Vec<f64> = std::iter::once(1.0).chain(found[..order].iter().copied()).collect();
    let den = stabilised(&den);
    let respond = |r: &&[f64]| {
        let mut out = vec![0.0; r.len()];
        filter(&found[order..], &den, r, &mut out);
        out
    };
    Ok(drive.iter().map(respond).collect())
}

fn numeric(source: LinalgError) -> EstimateError {
    EstimateError::Numeric { estimator: "iv", source }
}

/// The records with the free run of `theta` on their inputs as output.
fn free_runs(
    model: &dyn Model,
    theta: &[f64],
    data: &[Experiment],
) -> Result<Vec<Experiment>, EstimateError> {
    let mut clean = data.to_vec();
    for (out, e) in clean.iter_mut().zip(data) {
        if model.simulate(theta, &e.run(model), &mut out.y) != Status::Converged {
            return Err(EstimateError::Unstable {
                model: short_name(&names(model)),
                record: e.name.clone(),
                sample: out.y.iter().position(|v| !v.is_finite()).unwrap_or(0),
            });
        }
    }
    Ok(clean)
}

/// The regression: rows of all experiments one after the other.
struct Task<'a> {
    model: &'a dyn Model,
    phi: Vec<f64>,
    y: Vec<f64>,
    /// Rows of each experiment.
    rows: Vec<usize>,
}

/// A solution with what its report needs.
struct Solution {
    theta: Vec<f64>,
    covariance: Vec<f64>,
    noise_variance: f64,
    factor: PivotedR,
}

impl<'a> Task<'a> {
    fn new(model: &'a dyn Model, data: &[Experiment], samples: usize) -> Self {
        let (phi, y) = regression(model, data, samples);
        let rows = data.iter().map(|e| e.len() - e.first(model)).collect();
        Self { model, phi, y, rows }
    }

    /// The regressors with the clean signals in place of the measured ones.
    fn instruments(&self, clean: &[Experiment]) -> Vec<f64> {
        regression(self.model, clean, self.y.len()).0
    }

    /// `theta = (Q'Phi)^-1 Q'y` with Z = Q R, the dependent instruments left out together with their regressors.
    fn solve(&self, z: &[f64], whitening: Option<&[f64]>) -> Result<Solution, EstimateError> {
        let (n, p) = (self.y.len(), self.model.n_params());
        let whiten = |x: &[f64], width: usize| match whitening {
            Some(l) => filter_rows(l, x, width, &self.rows),
            None => x.to_vec(),
        };
        let (z, phi, y) = (whiten(z, p), whiten(&self.phi, p), whiten(&self.y, 1));
        let factor = pivoted_r(&z, n, p, 0.0).map_err(numeric)?;
        let kept = &factor.order[..factor.rank];
        let k = kept.len();
        let r: Vec<f64> = (0..k).flat_map(|i| factor.r[i * p..i * p + k].iter().copied()).collect();
        let (mut g, mut rhs, mut q) = (vec![0.0; k * k], vec![0.0; k], vec![0.0; k]);
        for t in 0..n {
            for (q, &c) in q.iter_mut().zip(kept) {
                *q = z[t * p + c] / factor.scale[c];
            }
            solve_upper_transposed(&r, k, &mut q).map_err(numeric)?;
            for i in 0..k {
                rhs[i] += q[i] * y[t];
                for (v, &c) in g[i * k..(i + 1) * k].iter_mut().zip(kept) {
                    *v += q[i] * phi[t * p + c];
                }
            }
        }
        let mut theta = vec![0.0; p];
        for (v, &c) in least_squares(&g, k, k, &rhs, 0.0).map_err(numeric)?.x.iter().zip(kept) {
            theta[c] = *v;
        }
        let errors = (0..n).map(|t| (y[t] - dot(&phi[t * p..(t + 1) * p], &theta)).powi(2));
        let noise_variance = errors.sum::<f64>() / (n - k).max(1) as f64;
        let covariance = covariance_of(&g, kept, p, noise_variance).map_err(numeric)?;
        Ok(Solution { theta, covariance, noise_variance, factor })
    }

    fn residuals(&self, theta: &[f64]) -> Vec<f64> {
        self.phi.chunks_exact(theta.len()).zip(&self.y).map(|(row, y)| y - dot(row, theta)).collect()
    }

    /// L of `L(q) w = e` for the residuals w, by least squares.
    fn noise_model(&self, theta: &[f64], order: usize) -> Result<Vec<f64>, EstimateError> {
        let w = self.residuals(theta);
        let (mut a, mut b, mut first) = (Vec::new(), Vec::new(), 0);
        for rows in &self.rows {
            for t in first + order..first + rows {
                a.extend((1..=order).map(|lag| -w[t - lag]));
                b.push(w[t]);
            }
            first += rows;
        }
        let l = least_squares(&a, b.len(), order, &b, 0.0).map_err(numeric)?.x;
        Ok(std::iter::once(1.0).chain(l).collect())
    }

    fn report(&self, found: Solution, evaluations: usize) -> Result<Fit, EstimateError> {
        let (samples, names) = (self.y.len(), names(self.model));
        let p = names.len();
        let cost: f64 = self.residuals(&found.theta).iter().map(|v| v * v).sum();
        let mut std_errors = vec![f64::NAN; p];
        for &k in &found.factor.order[..found.factor.rank] {
            std_errors[k] = found.covariance[k * p + k].sqrt();
        }
        Ok(Fit {
            estimator: "iv".into(),
            minimised: Minimised::OneStep,
            covariance: found.covariance,
            covariance_kind: CovarianceKind::White,
            std_errors,
            mse: cost / samples as f64,
            noise_variance: found.noise_variance,
            residuals: Residuals::default(),
            samples,
            rank: found.factor.rank,
            status: Status::Converged,
            evaluations,
            history: vec![Iterate { evaluations, objective: cost, violation: 0.0, optimality: 0.0 }],
            warnings: rank_warning(&found.factor, &names, &found.theta, Rows::Regressors)
                .into_iter()
                .collect(),
            notes: Vec::new(),
            starts: Vec::new(),
            learnt: None,
            theta: found.theta,
            names,
        })
    }
}

/// `s2 G^-1 G^-T` in the places of the kept parameters (p x p).
fn covariance_of(g: &[f64], kept: &[usize], p: usize, s2: f64) -> Result<Vec<f64>, LinalgError> {
    let k = kept.len();
    let mut inverse = Vec::with_capacity(k); // columns of G^-1
    for j in 0..k {
        let mut unit = vec![0.0; k];
        unit[j] = 1.0;
        inverse.push(least_squares(g, k, k, &unit, 0.0)?.x);
    }
    let mut covariance = vec![0.0; p * p];
    for (i, &a) in kept.iter().enumerate() {
        for (j, &b) in kept.iter().enumerate() {
            covariance[a * p + b] = s2 * inverse.iter().map(|column| column[i] * column[j]).sum::<f64>();
        }
    }
    Ok(covariance)
}

/// The moving average `l` along the rows of each experiment, at rest before its first row.
fn filter_rows(l: &[f64], x: &[f64], width: usize, rows: &[usize]) -> Vec<f64> {
    let mut out = vec![0.0; x.len()];
    let mut first = 0;
    for n in rows {
        for t in 0..*n {
            let row = &mut out[(first + t) * width..(first + t + 1) * width];
            for (lag, c) in l.iter().enumerate().take(t + 1) {
                let earlier = &x[(first + t - lag) * width..(first + t - lag + 1) * width];
                row.iter_mut().zip(earlier).for_each(|(o, v)| *o += c * v);
            }
        }
        first += n;
    }
    out
}
