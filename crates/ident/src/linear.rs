//! Linear models with noise models as a task uses them: fit, score, save.
//!
//! [`crate::model::linear`] has the structures, [`crate::estimate::pem`] the estimation; here they meet the scores of
//! [`crate::validate`].

use serde::{Deserialize, Serialize};

use crate::estimate::initial::Initial;
use crate::estimate::missing::{Recovered, bridged};
use crate::estimate::pem::Pem;
use crate::estimate::{EstimateError, Fit};
use crate::experiment::Experiment;
use crate::model::Run;
use crate::model::linear::LinearModel;
use crate::validate::{Kind, Reference, Score, Seen, score_values};

/// A structure with its estimate: what a file keeps.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LinearFit {
    /// Structure.
    pub model: LinearModel,
    /// How its records began.
    pub initial: Initial,
    /// Parameters and what is known of them.
    pub fit: Fit,
    /// Missing samples as the fit reconstructs them.
    #[serde(default)]
    pub recovered: Vec<Recovered>,
}

/// Prediction-error fit of `model` to all records together.
///
/// ```
/// use dynocal_ident::estimate::pem::Pem;
/// use dynocal_ident::experiment::Experiment;
/// use dynocal_ident::linear::{LinearFit, fit_linear};
/// use dynocal_ident::model::linear::LinearModel;
/// use dynocal_ident::validate::{Kind, Seen};
/// let u: Vec<f64> = (0..60).map(|t| f64::from((t * t / 3) % 5) - 2.0).collect();
/// let mut y = vec![0.0; 60];
/// (1..60).for_each(|t| y[t] = 0.8 * y[t - 1] + u[t - 1]);
/// let data = [Experiment { name: "a".into(), u, y, init_samples: 5, weights: vec![] }];
/// let found = fit_linear(&LinearModel::oe(&["u"], "y", 1, 1, 1), &data, &Pem::default(), &|| false)?;
/// let saved = serde_json::to_string(&found).unwrap();
/// let again: LinearFit = serde_json::from_str(&saved).unwrap();
/// assert!(again.score(&data, Kind::FreeRun, Seen::Identification).rmse < 1e-7);
/// # Ok::<(), dynocal_ident::estimate::EstimateError>(())
/// ```
///
/// # Errors
/// As of [`Pem::estimate`].
pub fn fit_linear(
    model: &LinearModel,
    data: &[Experiment],
    options: &Pem,
    interrupt: &dyn Fn() -> bool,
) -> Result<LinearFit, EstimateError> {
    let (fit, recovered) = options.estimate_missing(model, data, None, interrupt)?;
    Ok(LinearFit { model: model.clone(), initial: options.initial, fit, recovered })
}

impl LinearFit {
    /// First sample of a record that is scored.
    pub fn first(&self, e: &Experiment) -> usize {
        let first = if self.initial == Initial::Rest {
            e.init_samples
        } else {
            e.init_samples.max(self.model.max_lag())
        };
        first.min(e.len())
    }

    /// Output of the model on a record (N). Records start as those of the fit did; where the fit estimated states they
    /// start from the measured values of the initialising samples, so that no scored output is used in advance.
    pub fn output(&self, e: &Experiment, kind: Kind) -> Vec<f64> {
        let (whole, _) = bridged(e);
        let mut measured = whole.y.clone();
        let first = self.first(e);
        // Only inputs and what initialises are bridged: a missing output is predicted.
        measured[first..].copy_from_slice(&e.y[first..]);
        let start = if self.initial == Initial::Rest { 0 } else { first };
        if start == 0 {
            measured[..first].copy_from_slice(&e.y[..first]);
        }
        let run = Run { u: &whole.u, y: &measured, start };
        let mut y = vec![0.0; e.len()];
        match kind {
            Kind::OneStep => self.model.predict(&self.fit.theta, &run, 1, &mut y),
            Kind::KStep(k) => self.model.predict(&self.fit.theta, &run, k, &mut y),
            Kind::FreeRun => {
                self.model.simulate(&self.fit.theta, &run, &mut y);
            }
        }
        y
    }

    /// Measured minus predicted one-step outputs of a record from its first scored sample on; NaN where the output is
    /// missing.
    pub fn residuals(&self, e: &Experiment) -> Vec<f64> {
        let first = self.first(e);
        let predicted = self.output(e, Kind::OneStep);
        e.y[first..].iter().zip(&predicted[first..]).map(|(y, p)| y - p).collect()
    }

    /// Scores of all records together; missing outputs are not scored.
    pub fn score(&self, data: &[Experiment], kind: Kind, seen: Seen) -> Score {
        let (mut z, mut zhat) = (Vec::new(), Vec::new());
        for e in data {
            let first = self.first(e);
            for (y, p) in e.y[first..].iter().zip(&self.output(e, kind)[first..]) {
                if !y.is_nan() {
                    z.push(*y);
                    zhat.push(*p);
                }
            }
        }
        score_values(&z, &zhat, kind, seen, Reference::Noisy)
    }
}
