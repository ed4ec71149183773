//! Start inputs of a fuel optimisation: fuel and throttle that roughly give a reference at a given spark.
//!
//! A least-squares fit of the measured actuators on torque, lambda, speed and spark, plus look-ahead differences of
//! torque. It only has to be close: the demand of the optimisation is the models' own response to it.

use super::structured::MapError;
use super::{Actuators, MapLimits, Reference};
use dynocal_numerics::linalg;

/// A fitted start rule.
#[derive(Clone, Debug)]
pub struct StartRule {
    coefficients: [Vec<f64>; 2],
    limits: MapLimits,
}

const AHEAD: [usize; 3] = [2, 4, 7];

fn terms(at: impl Fn(usize) -> Reference, spark_deg: f64, row: &mut Vec<f64>) {
    row.clear();
    let r = at(0);
    let (t, l, n, i) =
        (r.torque_nm / 50.0, (r.lambda - 1.0) / 0.1, r.speed_rpm / 2000.0, 2000.0 / r.speed_rpm);
    let s = (spark_deg - 20.0) / 15.0;
    row.extend([1.0, t, t * t, t * t * t, n, n * n, i, t * n, t * i, t * t * n]);
    row.extend([l, l * l, l * t, l * n, s, s * s, s * t, s * n, s * s * t]);
    for k in AHEAD {
        let d = at(k).torque_nm / 50.0 - t;
        row.extend([d, d * n, d * i]);
    }
}

impl StartRule {
    /// Fits fuel and throttle on measured records: response and actuators (INJ, SA, throttle), row by row.
    ///
    /// # Errors
    /// [`MapError`].
    pub fn fit(records: &[(Vec<Reference>, Vec<Actuators>)], limits: MapLimits) -> Result<Self, MapError> {
        let (mut x, mut inj, mut throttle, mut row) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (response, actuators) in records {
            for t in 0..response.len().saturating_sub(AHEAD[2]) {
                terms(|k| response[t + k], actuators[t][1], &mut row);
                x.extend_from_slice(&row);
                inj.push(actuators[t][0]);
                throttle.push(actuators[t][2]);
            }
        }
        let (n, p) = (inj.len(), row.len());
        if n < p.max(1) {
            return Err(MapError::TooShort { found: n, needed: p });
        }
        let fit = |y: &[f64]| {
            linalg::least_squares(&x, n, p, y, 1e-7 * n as f64)
                .map(|f| f.x)
                .map_err(|e| MapError::Regression(e.to_string()))
        };
        Ok(Self { coefficients: [fit(&inj)?, fit(&throttle)?], limits })
    }

    /// Start actuators along a reference (already filtered to what the engine can follow) at a given spark.
    pub fn drive(&self, reference: &[Reference], spark_deg: &[f64]) -> Vec<Actuators> {
        let last = reference.len().saturating_sub(1);
        let mut row = Vec::new();
        (0..reference.len())
            .map(|t| {
                terms(|k| reference[(t + k).min(last)], spark_deg[t], &mut row);
                let dot = |c: &[f64]| row.iter().zip(c).map(|(a, b)| a * b).sum();
                self.limits.clamp([dot(&self.coefficients[0]), spark_deg[t], dot(&self.coefficients[1])])
            })
            .collect()
    }
}

/// `target` approached with at most `rate` per sample: a start that respects the limit of the optimisation.
pub fn rate_limited(target: &[f64], rate: f64) -> Vec<f64> {
    let mut now = target.first().copied().unwrap_or(0.0);
    target
        .iter()
        .map(|t| {
            now += (t - now).clamp(-rate, rate);
            now
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_limit_holds_and_reaches_the_target() {
        let target: Vec<f64> = (0..200).map(|t| if t < 50 { 5.0 } else { 30.0 }).collect();
        let y = rate_limited(&target, 0.8);
        assert!(y.windows(2).all(|w| (w[1] - w[0]).abs() <= 0.8 + 1e-12));
        assert_eq!(y[199], 30.0);
    }
}
