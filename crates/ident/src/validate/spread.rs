//! Scores over a pool of validation records: mean, spread, confidence interval.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{Kind, Score, Seen, score};
use crate::experiment::Experiment;
use crate::model::Model;

/// Mean, spread and t interval of some values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Number of (finite) values.
    pub count: usize,
    /// Their mean; NaN without values.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub mean: f64,
    /// Standard deviation, with `count - 1`; NaN for fewer than two values.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub std: f64,
    /// Interval of the mean: `mean -+ t std / sqrt(count)`; NaN for fewer than two values.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub low: f64,
    /// Upper end.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub high: f64,
    /// Least value.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub min: f64,
    /// Largest value.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub max: f64,
    /// Confidence of the interval, e.g. 0.95.
    pub confidence: f64,
}

impl Spread {
    /// Of the finite ones of `values`; `confidence` of the interval between 0 and 1, e.g. 0.95.
    ///
    /// ```
    /// use dynocal_ident::validate::spread::Spread;
    /// let s = Spread::of(&[1.0, 2.0, 3.0], 0.95);
    /// assert_eq!((s.mean, s.std), (2.0, 1.0));
    /// // t(0.975; 2 degrees of freedom) = 4.30265
    /// assert!((s.high - 2.0 - 4.302_652_7 / 3f64.sqrt()).abs() < 1e-6);
    /// ```
    pub fn of(values: &[f64], confidence: f64) -> Self {
        let values: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let (std, half) = match StudentsT::new(0.0, 1.0, n - 1.0) {
            Ok(law) if (0.0..1.0).contains(&confidence) => {
                let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
                (std, law.inverse_cdf(0.5 + 0.5 * confidence) * std / n.sqrt())
            }
            _ => (f64::NAN, f64::NAN),
        };
        let min = values.iter().copied().fold(f64::NAN, f64::min);
        let max = values.iter().copied().fold(f64::NAN, f64::max);
        Self { count: values.len(), mean, std, low: mean - half, high: mean + half, min, max, confidence }
    }
}

/// Scores of one kind on several records, each record one value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScorePool {
    /// Name and score of each record.
    pub records: Vec<(String, Score)>,
    /// Records whose run did not stay finite; they are in no spread.
    pub diverged: usize,
    /// Root mean squared error.
    pub rmse: Spread,
    /// 95 % of the absolute errors.
    pub error_95: Spread,
    /// Coefficient of determination (thesis eq. 2.48).
    pub r2: Spread,
    /// NRMSE fit.
    pub nrmse_fit: Spread,
}

impl ScorePool {
    /// Spreads of scores that are there already. They must be of one kind.
    pub fn of(records: Vec<(String, Score)>, confidence: f64) -> Self {
        let good: Vec<&Score> = records.iter().map(|r| &r.1).filter(|s| s.status.is_success()).collect();
        let spread =
            |f: fn(&Score) -> f64| Spread::of(&good.iter().map(|s| f(s)).collect::<Vec<_>>(), confidence);
        Self {
            diverged: records.len() - good.len(),
            rmse: spread(|s| s.rmse),
            error_95: spread(|s| s.error_95),
            r2: spread(|s| s.r2),
            nrmse_fit: spread(|s| s.nrmse_fit),
            records,
        }
    }
}

/// Scores the model on each record of a validation pool.
pub fn score_pool(
    model: &dyn Model,
    theta: &[f64],
    records: &[Experiment],
    kind: Kind,
    seen: Seen,
    confidence: f64,
) -> ScorePool {
    let one = |e: &Experiment| (e.name.clone(), score(model, theta, std::slice::from_ref(e), kind, seen));
    ScorePool::of(records.iter().map(one).collect(), confidence)
}
