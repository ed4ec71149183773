//! Recursive least squares with forgetting: online ([`Rls`], [`OnlineModel`]), and as an estimator over records ([`Recursive`]).
//!
//! ```text
//! theta(t) = argmin sum_s lambda^(t-s) (y(s) - phi(s)' theta)^2  +  lambda^t (theta - theta_0)' P_0^-1 (theta - theta_0)
//!
//! K = P phi / (lambda + phi'P phi)     theta += K (y - phi'theta)     P <- (P - K phi'P) / lambda
//! ```
//!
//! P = S S' is carried by its root S (Potter's update), so that rounding cannot make it indefinite however long it
//! runs; one update costs O(p^2).
//!
//! Reference: L. Ljung, System Identification (1999), section 11.2; G. J. Bierman, Factorization Methods for Discrete
//! Sequential Estimation (1977), chapter V.

use dynocal_numerics::linalg::dot;
use dynocal_numerics::registry::{self, BuildError, MemberDoc, ParamDoc};
use dynocal_numerics::status::{Iterate, Status};
use serde::Deserialize;

use super::cost::Cost;
use super::covariance::{CovarianceChoice, Rows, Stored};
use super::fit::Found;
use super::ols::{kept_rows, regression};
use super::table::{EstimatorRow, Fits, Gaps};
use super::{EstimateError, Estimator, Fit, Minimised, names, narx};
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::form::Form;
use crate::model::{Model, Run, usable_samples};

/// Row of the table.
pub(super) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
        name: "rls",
        what: "recursive least squares with forgetting over the records in their order: the last samples count most",
        params: &[
            ParamDoc {
                name: "forgetting",
                unit: "-",
                default: "1",
                what: "weight of a sample against the next one, in (0, 1]; memory 1/(1 - forgetting) samples",
            },
            ParamDoc {
                name: "variance",
                unit: "-",
                default: "1e12",
                what: "variance of the parameters about the start, in units of the noise variance and of each regressor's mean square",
            },
        ],
    },
    fits: Fits::Narx,
    gaps: Gaps::Bridged { free_run: false },
    build: |keys| {
        let made: Recursive = registry::keys("rls", keys)?;
        let fault = |key: &str, found: f64, expected: &str| {
            let message = format!("`{key}`: found {found}, expected {expected}");
            Err(BuildError::Keys { member: "rls".into(), message })
        };
        if !(made.forgetting > 0.0 && made.forgetting <= 1.0) {
            return fault("forgetting", made.forgetting, "more than 0 and at most 1");
        }
        if !(made.variance > 0.0 && made.variance <= 1e300) {
            return fault("variance", made.variance, "a positive number");
        }
        Ok(Box::new(made))
    },
};

/// Options of recursive least squares over whole records.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Recursive {
    /// Weight of a sample against the next one, in (0, 1].
    pub forgetting: f64,
    /// Variance of the parameters about the start, in units of the noise variance and of each regressor's mean square.
    pub variance: f64,
}

impl Default for Recursive {
    fn default() -> Self {
        Self { forgetting: 1.0, variance: 1e12 }
    }
}

impl Estimator for Recursive {
    /// The estimate after the last sample, with `P` times the noise variance as covariance. The noise variance is that of the
    /// weighted errors at the last estimate, weights summing to the number of samples.
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let model = narx("rls", model)?;
        let (samples, p) = (usable_samples(model, data)?, model.n_params());
        if !model.is_linear_in_params() {
            return Err(EstimateError::NotLinear { estimator: "rls", params: p });
        }
        if let Some(found) = start.map(<[f64]>::len).filter(|n| *n != p) {
            return Err(EstimateError::Start { found, expected: p });
        }
        let (mut phi, y) = regression(model, data, samples);
        let n = y.len();
        if n < p {
            let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
            let why = format!("{p} parameters; rows with missing samples are left out");
            return Err(DataError::TooShort { record, found: n, expected: p, why }.into());
        }
        // In units of each regressor's rms one variance is as wide for all parameters, whatever their units.
        let scale = rms(&phi, p);
        phi.chunks_exact_mut(p).for_each(|row| row.iter_mut().zip(&scale).for_each(|(v, s)| *v /= s));
        let begin: Vec<f64> = (0..p).map(|k| start.map_or(0.0, |theta| theta[k]) * scale[k]).collect();
        let mut rls = Rls::new(&begin, self.variance, self.forgetting);
        let (mut status, mut seen) = (Status::Converged, n);
        for (t, row) in phi.chunks_exact(p).enumerate() {
            if t % 4096 == 0 && interrupt() {
                (status, seen) = (Status::Interrupted, t);
                break;
            }
            rls.update(row, y[t]);
        }
        let scaled = rls.theta().to_vec();
        let age = |t: usize| self.forgetting.powf(0.5 * (n - 1 - t) as f64);
        let remembered: f64 = (0..n).map(|t| age(t).powi(2)).sum();
        let errors: Vec<f64> = phi
            .chunks_exact(p)
            .zip(&y)
            .enumerate()
            .map(|(t, (row, y))| (n as f64 / remembered).sqrt() * age(t) * (dot(row, &scaled) - y))
            .collect();
        for (t, row) in phi.chunks_exact_mut(p).enumerate() {
            let weight = age(t);
            row.iter_mut().zip(&scale).for_each(|(v, s)| *v *= weight * s);
        }
        let prior = age(0) * self.forgetting.sqrt() / self.variance.sqrt();
        let penalties: Vec<f64> = scale.iter().map(|s| prior * s).collect();
        let objective = errors.iter().map(|e| e * e).sum();
        let found = Found {
            estimator: "rls",
            minimised: Minimised::OneStep,
            theta: scaled.iter().zip(&scale).map(|(theta, s)| theta / s).collect(),
            names: names(model),
            status,
            evaluations: 1,
            history: vec![Iterate { evaluations: 1, objective, violation: 0.0, optimality: 0.0 }],
            warnings: interrupted(seen, n),
        };
        let mut evidence = Stored {
            errors: &errors,
            jacobian: &phi,
            params: p,
            records: kept_rows(model, data),
            penalties: &penalties,
            exogenous: model.output_lag() == 0,
            rows: Rows::Regressors,
        };
        // The sandwich for coloured errors knows no weights.
        let choice = if self.forgetting < 1.0 { CovarianceChoice::White } else { CovarianceChoice::Auto };
        Fit::new(found, &mut evidence, samples, choice, Cost::SQUARED)
    }
}

fn interrupted(seen: usize, all: usize) -> Vec<String> {
    if seen == all { Vec::new() } else { vec![format!("interrupted after {seen} of {all} samples")] }
}

/// Root mean square of each column; 1 for a column of zeros.
fn rms(phi: &[f64], p: usize) -> Vec<f64> {
    let mut square = vec![0.0; p];
    for row in phi.chunks_exact(p) {
        square.iter_mut().zip(row).for_each(|(s, v)| *s += v * v);
    }
    let n = (phi.len() / p.max(1)).max(1) as f64;
    square.iter().map(|s| if *s > 0.0 { (s / n).sqrt() } else { 1.0 }).collect()
}

/// Variances grow to this multiple of the start's at most, however long the excitation is missing.
const LARGEST_GROWTH: f64 = 1e3;

/// State of the recursion.
///
/// ```
/// use dynocal_ident::estimate::rls::Rls;
/// // y = 2 - 3 x, seen one sample after the other.
/// let mut rls = Rls::new(&[0.0, 0.0], 1e8, 1.0);
/// for x in [0.0, 1.0, 2.0, 3.0] {
///     rls.update(&[1.0, x], 2.0 - 3.0 * x);
/// }
/// assert!((rls.theta()[0] - 2.0).abs() < 1e-6 && (rls.theta()[1] + 3.0).abs() < 1e-6);
/// ```
#[derive(Clone, Debug)]
pub struct Rls {
    theta: Vec<f64>,
    /// S with P = S S', p x p row-major.
    root: Vec<f64>,
    forgetting: f64,
    largest: f64,
    projected: Vec<f64>,
    gain: Vec<f64>,
}

impl Rls {
    /// Starts at `theta` with P = `variance` I; `forgetting` in (0, 1], 1 forgets nothing. Memory: `1/(1 - forgetting)`
    /// samples.
    ///
    /// # Panics
    /// When `variance` or `forgetting` are outside their ranges: they are the program's choice, not data.
    pub fn new(theta: &[f64], variance: f64, forgetting: f64) -> Self {
        assert!(forgetting > 0.0 && forgetting <= 1.0, "forgetting {forgetting} is not in (0, 1]");
        assert!(variance > 0.0 && variance.is_finite(), "variance {variance} is not positive");
        let p = theta.len();
        let mut root = vec![0.0; p * p];
        (0..p).for_each(|k| root[k * p + k] = variance.sqrt());
        Self {
            theta: theta.to_vec(),
            root,
            forgetting,
            largest: LARGEST_GROWTH * variance,
            projected: vec![0.0; p],
            gain: vec![0.0; p],
        }
    }

    /// Takes one sample with regressors `phi` (p) and output `y`; returns the error of the prediction before it.
    /// A sample that is not finite changes nothing and gives NaN.
    pub fn update(&mut self, phi: &[f64], y: f64) -> f64 {
        let p = self.theta.len();
        let error = y - phi.iter().zip(&self.theta).map(|(a, b)| a * b).sum::<f64>();
        if !error.is_finite() {
            return f64::NAN;
        }
        // f = S'phi, then K = S f / (lambda + f'f).
        self.projected.fill(0.0);
        for (row, x) in self.root.chunks_exact(p.max(1)).zip(phi) {
            self.projected.iter_mut().zip(row).for_each(|(f, s)| *f += s * x);
        }
        let lambda = self.forgetting;
        let beta = lambda + self.projected.iter().map(|f| f * f).sum::<f64>();
        for (g, row) in self.gain.iter_mut().zip(self.root.chunks_exact(p.max(1))) {
            *g = row.iter().zip(&self.projected).map(|(s, f)| s * f).sum();
        }
        let alpha = 1.0 / (beta + (lambda * beta).sqrt());
        // Without excitation P would grow without bound in the directions that are not seen.
        let growth = 1.0 / lambda.sqrt();
        for i in 0..p {
            let row = &mut self.root[i * p..(i + 1) * p];
            row.iter_mut().zip(&self.projected).for_each(|(s, f)| *s -= alpha * self.gain[i] * f);
            let variance: f64 = row.iter().map(|s| s * s).sum::<f64>() * growth * growth;
            let factor = if variance > self.largest { (self.largest / variance).sqrt() } else { 1.0 };
            row.iter_mut().for_each(|s| *s *= growth * factor);
            self.theta[i] += self.gain[i] / beta * error;
        }
        error
    }

    /// Parameters (p).
    pub fn theta(&self) -> &[f64] {
        &self.theta
    }

    /// P (p x p row-major): covariance of the parameters in units of the noise variance.
    pub fn covariance(&self) -> Vec<f64> {
        let p = self.theta.len();
        let row = |i: usize| &self.root[i * p..(i + 1) * p];
        let entry = |i: usize, j: usize| row(i).iter().zip(row(j)).map(|(a, b)| a * b).sum();
        (0..p * p).map(|ij| entry(ij / p, ij % p)).collect()
    }

    /// Forgets how certain the parameters are (P = `variance` I) and keeps their values: after a change that is known, such
    /// as another actuator, the next samples count in full.
    ///
    /// # Panics
    /// When `variance` is not positive and finite.
    pub fn reset(&mut self, variance: f64) {
        assert!(variance > 0.0 && variance.is_finite(), "variance {variance} is not positive");
        let p = self.theta.len();
        self.root.fill(0.0);
        (0..p).for_each(|k| self.root[k * p + k] = variance.sqrt());
        self.largest = LARGEST_GROWTH * variance;
    }
}

/// Recursive least squares on the regressors of a model, one sample after the other.
///
/// ```
/// use dynocal_ident::estimate::rls::OnlineModel;
/// use dynocal_ident::model::poly::PolyNarx;
/// // y(t) = 0.5 y(t-1) + u(t)^2
/// let model = PolyNarx::parse(&["u"], "y", &["u(t)^2", "y(t-1)"])?;
/// let mut online = OnlineModel::new(&model, &[0.0, 0.0], 1e8, 1.0)?;
/// let mut y = 0.0;
/// for t in 0..40 {
///     let u = f64::from((t * t) % 5) - 1.0;
///     y = 0.5 * y + u * u;
///     online.update(&[u], y);
/// }
/// assert!((online.rls().theta()[0] - 1.0).abs() < 1e-6 && (online.rls().theta()[1] - 0.5).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct OnlineModel<'a> {
    model: &'a dyn Model,
    rls: Rls,
    /// The last samples, as many as the model looks back and the present one.
    u: Vec<f64>,
    y: Vec<f64>,
    jacobian: Vec<f64>,
    /// Samples seen, up to the length of the window.
    seen: usize,
}

impl<'a> OnlineModel<'a> {
    /// Starts at `theta` (p); see [`Rls::new`] for the others.
    ///
    /// # Errors
    /// [`EstimateError::NotLinear`], or [`EstimateError::Start`] for a start of another length.
    ///
    /// # Panics
    /// As of [`Rls::new`].
    pub fn new(
        model: &'a dyn Model,
        theta: &[f64],
        variance: f64,
        forgetting: f64,
    ) -> Result<Self, EstimateError> {
        let (p, window) = (model.n_params(), model.max_lag() + 1);
        if !model.is_linear_in_params() {
            return Err(EstimateError::NotLinear { estimator: "rls", params: p });
        }
        if theta.len() != p {
            return Err(EstimateError::Start { found: theta.len(), expected: p });
        }
        Ok(Self {
            model,
            rls: Rls::new(theta, variance, forgetting),
            u: vec![0.0; window * model.n_inputs()],
            y: vec![0.0; window],
            jacobian: vec![0.0; window * p],
            seen: 0,
        })
    }

    /// Takes the inputs (m) and the output of one sample; returns the error of the prediction before it, NaN while
    /// the lags are not filled and where a sample in them is missing (NaN): such samples teach nothing.
    ///
    /// # Panics
    /// When `u` does not hold the model's inputs.
    pub fn update(&mut self, u: &[f64], y: f64) -> f64 {
        let (m, window) = (self.model.n_inputs(), self.y.len());
        assert_eq!(u.len(), m, "one value for each input");
        self.u.copy_within(m.., 0);
        self.y.copy_within(1.., 0);
        self.u[(window - 1) * m..].copy_from_slice(u);
        self.y[window - 1] = y;
        self.seen = (self.seen + 1).min(window);
        if self.seen < window {
            return f64::NAN;
        }
        let p = self.model.n_params();
        let run = Run { u: &self.u, y: &self.y, start: window - 1 };
        self.model.one_step_jacobian(self.rls.theta(), &run, &mut self.jacobian);
        self.rls.update(&self.jacobian[(window - 1) * p..], y)
    }

    /// Parameters and covariance.
    pub fn rls(&self) -> &Rls {
        &self.rls
    }

    /// [`Rls::reset`].
    pub fn reset(&mut self, variance: f64) {
        self.rls.reset(variance);
    }
}
