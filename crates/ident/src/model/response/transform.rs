//! Transformed outputs: a model is learnt for g(y) and speaks in the unit of y.
//!
//! ```text
//! Box-Cox   g(y) = (y^l - 1) / l,  log y at l = 0      y > 0
//! logit     g(y) = log((y - low) / (high - y))         low < y < high
//! mean = G(m),  variance = G'(m)^2 v                   G the inverse of g, m and v of the transformed output
//! ```
//!
//! G(m) is the median of the response; the variance is that of first order.
//!
//! Source: G. E. P. Box, D. R. Cox, An analysis of transformations, J. R. Stat. Soc. B 26 (1964).

use serde::{Deserialize, Serialize};

use super::{Ask, Prediction, ResponseError};

/// Transform of an output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Transform {
    /// As measured.
    #[default]
    None,
    /// Power or logarithm.
    BoxCox {
        /// l; the logarithm at 0.
        power: f64,
    },
    /// Between two limits that the output never reaches.
    Logit {
        /// Lower limit, in the unit of the output.
        low: f64,
        /// Upper limit.
        high: f64,
    },
}

impl Transform {
    /// Whether nothing is changed.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }

    /// g(y).
    ///
    /// # Errors
    /// [`ResponseError::Key`] with the first value outside the domain.
    pub fn apply(&self, y: &[f64]) -> Result<Vec<f64>, ResponseError> {
        let outside = |expected: String, found: f64| ResponseError::Domain { expected, found };
        match *self {
            Self::None => Ok(y.to_vec()),
            Self::BoxCox { power } => match y.iter().find(|v| **v <= 0.0) {
                Some(v) => Err(outside("positive outputs".into(), *v)),
                None => Ok(y.iter().map(|v| box_cox(*v, power)).collect()),
            },
            Self::Logit { low, high } => match y.iter().find(|v| !(**v > low && **v < high)) {
                Some(v) => Err(outside(format!("outputs above {low} and below {high}"), *v)),
                None => Ok(y.iter().map(|v| ((v - low) / (high - v)).ln()).collect()),
            },
        }
    }

    /// G and its first three derivatives at m.
    pub fn inverse(&self, m: f64) -> [f64; 4] {
        match *self {
            Self::None => [m, 1.0, 0.0, 0.0],
            Self::BoxCox { power: 0.0 } => [m.exp(); 4],
            Self::BoxCox { power: l } => {
                // Where the power has no value the response has reached its limit.
                let b = (1.0 + l * m).max(1e-12);
                let y = b.powf(1.0 / l);
                [y, y / b, (1.0 - l) * y / (b * b), (1.0 - l) * (1.0 - 2.0 * l) * y / (b * b * b)]
            }
            Self::Logit { low, high } => {
                let s = 1.0 / (1.0 + (-m).exp());
                let (w, p) = (high - low, s * (1.0 - s));
                [low + w * s, w * p, w * p * (1.0 - 2.0 * s), w * p * (1.0 - 6.0 * p)]
            }
        }
    }

    /// G' where the response is `y`: 1 without a transform.
    pub fn slope_at(&self, y: f64) -> f64 {
        match *self {
            Self::None => 1.0,
            Self::BoxCox { power } => y.powf(1.0 - power),
            Self::Logit { low, high } => (y - low) * (high - y) / (high - low),
        }
    }

    /// Turns a prediction of g(y) into one of y.
    pub fn back(&self, ask: Ask, at: &mut Prediction) {
        if *self == Self::None {
            return;
        }
        let [y, g1, g2, g3] = self.inverse(at.mean);
        let d = at.gradient.len();
        if ask == Ask::Hessian {
            for j in 0..d {
                for l in 0..d {
                    let (a, b) = (at.gradient[j], at.gradient[l]);
                    let (va, vb) = (at.variance_gradient[j], at.variance_gradient[l]);
                    let (h, v) = (at.hessian[j * d + l], at.variance);
                    let second =
                        2.0 * (g2 * g2 + g1 * g3) * a * b * v + 2.0 * g1 * g2 * (h * v + a * vb + b * va);
                    at.variance_hessian[j * d + l] = second + g1 * g1 * at.variance_hessian[j * d + l];
                    at.hessian[j * d + l] = g2 * a * b + g1 * h;
                }
            }
        }
        if ask >= Ask::Gradient {
            for j in 0..d {
                at.variance_gradient[j] =
                    2.0 * g1 * g2 * at.gradient[j] * at.variance + g1 * g1 * at.variance_gradient[j];
                at.gradient[j] *= g1;
            }
        }
        at.mean = y;
        if ask >= Ask::Variance {
            at.variance *= g1 * g1;
            at.noise *= g1 * g1;
        }
    }
}

/// `(y^l - 1) / l`.
pub fn box_cox(y: f64, power: f64) -> f64 {
    if power == 0.0 { y.ln() } else { (y.powf(power) - 1.0) / power }
}
