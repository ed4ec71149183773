//! Which points carry a fit, and which do not belong to it.
//!
//! ```text
//! h_i                                                     leverage
//! t_i = e_i / (s_(i) sqrt(1 - h_i))                       studentised residual, s_(i) without point i
//! (n-p-1) s_(i)^2 = sum e^2 - e_i^2 / (1 - h_i)
//! D_i = e_i^2 h_i / (p s^2 (1 - h_i)^2)                   Cook's distance
//! ```
//!
//! Source: R. D. Cook, S. Weisberg, Residuals and Influence in Regression (1982), chapters 2 and 3.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Share of data sets without outliers in which a point is named as one.
const LEVEL: f64 = 0.05;

/// Numbers per point (n each).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Influence {
    /// Leverages h.
    pub leverage: Vec<f64>,
    /// Studentised residuals t; 0 where a point carries its own prediction alone.
    pub studentised: Vec<f64>,
    /// Cook's distances.
    pub cook: Vec<f64>,
    /// Points (from 0) whose studentised residual exceeds the Bonferroni limit at 5 %.
    pub outliers: Vec<usize>,
}

impl Influence {
    /// From residuals and leverages of a fit with p coefficients.
    pub fn of(residuals: &[f64], leverage: &[f64], p: usize) -> Self {
        let n = residuals.len();
        let squares: f64 = residuals.iter().map(|e| e * e).sum();
        let s2 = squares / n.saturating_sub(p).max(1) as f64;
        let free = n.saturating_sub(p + 1).max(1) as f64;
        let (mut studentised, mut cook) = (vec![0.0; n], vec![0.0; n]);
        for i in 0..n {
            let (e, rest) = (residuals[i], 1.0 - leverage[i]);
            if rest > 1e-9 && squares > 0.0 {
                let without = ((squares - e * e / rest) / free).max(f64::MIN_POSITIVE);
                studentised[i] = e / (without * rest).sqrt();
                cook[i] = e * e * leverage[i] / (p as f64 * s2 * rest * rest);
            }
        }
        let limit = match StudentsT::new(0.0, 1.0, free) {
            Ok(law) => law.inverse_cdf(1.0 - 0.5 * LEVEL / n.max(1) as f64),
            Err(_) => f64::INFINITY,
        };
        let outliers = (0..n).filter(|i| studentised[*i].abs() > limit).collect();
        Self { leverage: leverage.to_vec(), studentised, cook, outliers }
    }

    /// Sentences that name the outliers.
    pub fn notes(&self, output: &str) -> Vec<String> {
        let one = |i: &usize| {
            format!(
                "{output}: row {} lies {:.1} standard deviations from the prediction of the others (leverage {:.2})",
                i + 1,
                self.studentised[*i].abs(),
                self.leverage[*i]
            )
        };
        self.outliers.iter().map(one).collect()
    }
}
