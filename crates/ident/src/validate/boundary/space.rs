//! The coordinates of a point: lagged inputs and outputs.

use serde::{Deserialize, Serialize};

use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::poly::Regressor;

/// Lagged inputs, then lagged outputs, of one sample.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Space {
    /// (input, lag).
    pub inputs: Vec<(usize, usize)>,
    /// Output lags.
    pub outputs: Vec<usize>,
}

/// A boundary cannot be learnt.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpaceError {
    /// A record does not have the inputs.
    #[error("{record}: {found} inputs, the boundary reads input number {expected}")]
    Inputs {
        /// Record.
        record: String,
        /// Inputs found.
        found: usize,
        /// Highest input that is read, one-based.
        expected: usize,
    },
    /// Too few points.
    #[error("boundary: {found} whole samples, expected at least {expected} for {dim} lagged channels")]
    TooFew {
        /// Points found.
        found: usize,
        /// Points needed.
        expected: usize,
        /// Coordinates.
        dim: usize,
    },
    /// Not a probability.
    #[error("boundary: quantile is {found}, expected above 0 and below 1")]
    Quantile {
        /// The number.
        found: f64,
    },
}

impl Space {
    /// All that the one-step prediction of a model reads.
    pub fn of(model: &dyn Model) -> Self {
        Self { inputs: model.window().to_vec(), outputs: (1..=model.output_lag()).collect() }
    }

    /// The present values of m inputs: for stationary maps and limits of a design.
    pub fn of_inputs(m: usize) -> Self {
        Self { inputs: (0..m).map(|i| (i, 0)).collect(), outputs: Vec::new() }
    }

    /// Number of coordinates.
    pub fn dim(&self) -> usize {
        self.inputs.len() + self.outputs.len()
    }

    /// The coordinates in text form, e.g. `inj(t-1)`.
    pub fn names(&self, inputs: &[String], output: &str) -> Vec<String> {
        let of_inputs = self.inputs.iter().map(|&(i, lag)| Regressor::input(i, lag));
        let all = of_inputs.chain(self.outputs.iter().map(|&lag| Regressor::output(lag)));
        all.map(|r| r.format(inputs, output)).collect()
    }

    /// Longest lag.
    pub fn max_lag(&self) -> usize {
        self.inputs.iter().map(|i| i.1).chain(self.outputs.iter().copied()).max().unwrap_or(0)
    }

    /// The point of sample t (at least [`Space::max_lag`]): `u` N x m row-major, `y` N.
    pub fn point(&self, u: &[f64], m: usize, y: &[f64], t: usize, point: &mut [f64]) {
        let (inputs, outputs) = point.split_at_mut(self.inputs.len());
        for (p, (i, lag)) in inputs.iter_mut().zip(&self.inputs) {
            *p = u[(t - lag) * m + i];
        }
        for (p, lag) in outputs.iter_mut().zip(&self.outputs) {
            *p = y[t - lag];
        }
    }

    /// The finite points of all records (row-major), in `count` contiguous blocks of each record.
    pub(super) fn blocks(&self, data: &[Experiment], count: usize) -> Result<Vec<Vec<f64>>, SpaceError> {
        let mut blocks = vec![Vec::new(); count];
        let mut point = vec![0.0; self.dim()];
        let needed = self.inputs.iter().map(|i| i.0 + 1).max().unwrap_or(0);
        for e in data {
            let m = e.u.len().checked_div(e.len()).unwrap_or(0);
            if m < needed {
                return Err(SpaceError::Inputs { record: e.name.clone(), found: m, expected: needed });
            }
            let first = self.max_lag().min(e.len());
            for t in first..e.len() {
                self.point(&e.u, m, &e.y, t, &mut point);
                if point.iter().all(|v| v.is_finite()) {
                    blocks[(t - first) * count / (e.len() - first)].extend_from_slice(&point);
                }
            }
        }
        Ok(blocks)
    }
}
