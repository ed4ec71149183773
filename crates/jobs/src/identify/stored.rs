//! Structures of every kind in one form that a file can hold, and the outputs of a fitted one.

use dynocal_ident::estimate::narmax::Narmax;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::linear::{LinearModel, PredictionErrors};
use dynocal_ident::model::neural::NeuralNarx;
use dynocal_ident::model::poly::{PolyNarx, StructureError};
use dynocal_ident::model::{Model, Run};
use dynocal_ident::validate::{self, Kind};
use serde::{Deserialize, Serialize};

/// A model structure with its channels, as `model.json` holds it under `structure` (`kind` says which).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Stored {
    /// Polynomial NARX.
    Polynomial(PolyNarx),
    /// Neural NARX.
    Neural(NeuralNarx),
    /// Linear with a noise model.
    Linear(LinearModel),
    /// Polynomial NARMAX.
    Narmax(Narmax),
}

impl Stored {
    /// Number of parameters.
    pub fn n_params(&self) -> usize {
        match self {
            Stored::Polynomial(m) => m.n_params(),
            Stored::Neural(m) => m.n_params(),
            Stored::Linear(m) => m.n_params(),
            Stored::Narmax(m) => m.with_innovations().n_params(),
        }
    }

    /// The structure as a NARX model; none for those with a noise model.
    pub fn narx(&self) -> Option<&dyn Model> {
        match self {
            Stored::Polynomial(m) => Some(m),
            Stored::Neural(m) => Some(m),
            Stored::Linear(_) | Stored::Narmax(_) => None,
        }
    }
}

/// A structure with parameters, ready to simulate and predict.
#[derive(Clone, Debug)]
pub struct Fitted {
    stored: Stored,
    theta: Vec<f64>,
    /// The part of a model with a noise model that the inputs drive, with its parameters; none for a time series.
    driven: Option<(PolyNarx, Vec<f64>)>,
}

impl Fitted {
    /// `theta` (p) as estimated.
    ///
    /// # Errors
    /// [`StructureError`] of a model whose names cannot stand in regressors.
    pub fn new(stored: Stored, theta: Vec<f64>) -> Result<Self, StructureError> {
        let driven = match &stored {
            Stored::Linear(m) if m.n_inputs() > 0 => Some(m.deterministic(&theta)?),
            Stored::Narmax(m) => m.driven(&theta)?,
            _ => None,
        };
        Ok(Self { stored, theta, driven })
    }

    /// The structure.
    pub fn stored(&self) -> &Stored {
        &self.stored
    }

    /// Parameters.
    pub fn theta(&self) -> &[f64] {
        &self.theta
    }

    /// What the free run simulates, with its parameters; none for a time series, which nothing drives.
    pub fn simulated(&self) -> Option<(&dyn Model, &[f64])> {
        match (&self.driven, self.stored.narx()) {
            (Some((m, theta)), _) => Some((m, theta)),
            (None, Some(m)) => Some((m, &self.theta)),
            (None, None) => None,
        }
    }

    /// First sample that is scored: the same for all kinds of output, so that their numbers can be compared.
    pub fn first(&self, e: &Experiment) -> usize {
        let lag = match &self.stored {
            Stored::Linear(m) => m.max_lag().max(self.driven.as_ref().map_or(0, |d| d.0.max_lag())),
            Stored::Narmax(m) => m.max_lag(),
            other => other.narx().map_or(0, Model::max_lag),
        };
        e.init_samples.max(lag)
    }

    /// Output on one record as `kind` says; samples before [`Fitted::first`] are the measured ones. None where the
    /// structure has no such output.
    pub fn output(&self, e: &Experiment, kind: Kind) -> Option<Vec<f64>> {
        if let Some(m) = self.stored.narx() {
            return Some(validate::output(m, &self.theta, e, kind));
        }
        let linear = match &self.stored {
            Stored::Narmax(m) => return Some(m.output(&self.theta, e, kind)),
            Stored::Linear(m) => m,
            _ => return None,
        };
        let first = self.first(e);
        match kind {
            Kind::FreeRun => {
                let (m, theta) = self.simulated()?;
                let run = Run { u: &e.u, y: &e.y, start: first.max(m.max_lag()).min(e.len()) };
                let mut y = vec![0.0; e.len()];
                m.simulate(theta, &run, &mut y);
                Some(y)
            }
            Kind::OneStep => {
                let mut eps = vec![0.0; e.len()];
                if !PredictionErrors::new(linear, &e.u, &e.y).errors(&self.theta, &mut eps) {
                    eps.fill(f64::NAN);
                }
                let predicted = |(t, (y, eps)): (usize, (&f64, &f64))| if t < first { *y } else { y - eps };
                Some(e.y.iter().zip(&eps).enumerate().map(predicted).collect())
            }
            Kind::KStep(k) => {
                let mut y = vec![0.0; e.len()];
                linear.predict(&self.theta, &Run { u: &e.u, y: &e.y, start: first.min(e.len()) }, k, &mut y);
                Some(y)
            }
        }
    }
}
