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
    ahead: bool,
}

const AHEAD: [usize; 3] = [2, 4, 7];

/// Static terms of one sample.
fn static_terms(r: &Reference, spark_deg: f64) -> [f64; STATIC] {
    let [t, l, n, i, s] = scaled(r, spark_deg);
    [
        1.0,
        t,
        t * t,
        t * t * t,
        n,
        n * n,
        i,
        t * n,
        t * i,
        t * t * n,
        l,
        l * l,
        l * t,
        l * n,
        s,
        s * s,
        s * t,
        s * n,
        s * s * t,
    ]
}

const STATIC: usize = 19;

/// Derivatives of the static terms with respect to torque, lambda, speed and spark.
fn static_derivatives(r: &Reference, spark_deg: f64) -> [[f64; STATIC]; 4] {
    let [t, l, n, i, s] = scaled(r, spark_deg);
    let d = 1.0 / r.speed_rpm;
    let scale = |row: [f64; STATIC], by: f64| row.map(|v| v * by);
    let o = 0.0;
    [
        scale(
            [o, 1.0, 2.0 * t, 3.0 * t * t, o, o, o, n, i, 2.0 * t * n, o, o, l, o, o, o, s, o, s * s],
            1.0 / 50.0,
        ),
        scale([o, o, o, o, o, o, o, o, o, o, 1.0, 2.0 * l, t, n, o, o, o, o, o], 1.0 / 0.1),
        // n = N/2000 grows, i = 2000/N falls with speed: dn = n d, di = -i d.
        scale(
            [o, o, o, o, n, 2.0 * n * n, -i, t * n, -t * i, t * t * n, o, o, o, l * n, o, o, o, s * n, o],
            d,
        ),
        scale([o, o, o, o, o, o, o, o, o, o, o, o, o, o, 1.0, 2.0 * s, t, n, 2.0 * s * t], 1.0 / 15.0),
    ]
}

fn scaled(r: &Reference, spark_deg: f64) -> [f64; 5] {
    [
        r.torque_nm / 50.0,
        (r.lambda - 1.0) / 0.1,
        r.speed_rpm / 2000.0,
        2000.0 / r.speed_rpm,
        (spark_deg - 20.0) / 15.0,
    ]
}

fn terms(at: impl Fn(usize) -> Reference, spark_deg: f64, ahead: bool, row: &mut Vec<f64>) {
    row.clear();
    let r = at(0);
    row.extend(static_terms(&r, spark_deg));
    if ahead {
        let [t, _, n, i, _] = scaled(&r, spark_deg);
        for k in AHEAD {
            let d = at(k).torque_nm / 50.0 - t;
            row.extend([d, d * n, d * i]);
        }
    }
}

impl StartRule {
    /// Fits fuel and throttle on measured records: response and actuators (INJ, SA, throttle), row by row.
    ///
    /// With `ahead`, differences of the torque to come are terms as well; the rule then leads the response, and
    /// its static part is cleaner.
    ///
    /// # Errors
    /// [`MapError`].
    pub fn fit(records: &[(Vec<Reference>, Vec<Actuators>)], limits: MapLimits) -> Result<Self, MapError> {
        let (mut x, mut inj, mut throttle, mut row) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (response, actuators) in records {
            for t in 0..response.len().saturating_sub(AHEAD[2]) {
                terms(|k| response[t + k], actuators[t][1], true, &mut row);
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
        Ok(Self { coefficients: [fit(&inj)?, fit(&throttle)?], limits, ahead: true })
    }

    /// The rule without its look-ahead terms: actuators as a static function of the reference.
    pub fn without_look_ahead(mut self) -> Self {
        self.ahead = false;
        self.coefficients.iter_mut().for_each(|c| c.truncate(STATIC));
        self
    }

    /// Start actuators along a reference at a given spark.
    pub fn drive(&self, reference: &[Reference], spark_deg: &[f64]) -> Vec<Actuators> {
        let last = reference.len().saturating_sub(1);
        let mut row = Vec::new();
        (0..reference.len())
            .map(|t| {
                terms(|k| reference[(t + k).min(last)], spark_deg[t], self.ahead, &mut row);
                let dot = |c: &[f64]| row.iter().zip(c).map(|(a, b)| a * b).sum();
                self.limits.clamp([dot(&self.coefficients[0]), spark_deg[t], dot(&self.coefficients[1])])
            })
            .collect()
    }

    /// Derivatives of fuel and throttle of the static rule with respect to torque, lambda, speed and spark; zero where
    /// the rule is at a limit.
    pub fn derivatives(&self, r: &Reference, spark_deg: f64) -> [[f64; 4]; 2] {
        let (row, slopes) = (static_terms(r, spark_deg), static_derivatives(r, spark_deg));
        let dot = |a: &[f64], c: &[f64]| a.iter().zip(c).map(|(x, y)| x * y).sum::<f64>();
        std::array::from_fn(|k| {
            let c = &self.coefficients[k];
            let value = dot(&row, c);
            // Actuators are (INJ, SA, throttle), the rule gives INJ and throttle.
            let inside = value > self.limits.lower[2 * k] && value < self.limits.upper[2 * k];
            std::array::from_fn(|j| if inside { dot(&slopes[j], c) } else { 0.0 })
        })
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
    fn derivatives_agree_with_central_differences() {
        let limits = MapLimits { lower: [-1e6; 3], upper: [1e6; 3] };
        let coefficients: Vec<f64> = (0..STATIC).map(|k| 1.0 + 0.3 * (k as f64).sin()).collect();
        let rule = StartRule { coefficients: [coefficients.clone(), coefficients], limits, ahead: false };
        let (r, spark) = (Reference { torque_nm: 37.0, lambda: 1.04, speed_rpm: 1650.0 }, 13.0);
        let exact = rule.derivatives(&r, spark);
        let value = |v: [f64; 4]| {
            rule.drive(&[Reference { torque_nm: v[0], lambda: v[1], speed_rpm: v[2] }], &[v[3]])[0]
        };
        let at = [r.torque_nm, r.lambda, r.speed_rpm, spark];
        for j in 0..4 {
            let h = 1e-5 * at[j].abs();
            let (mut up, mut down) = (at, at);
            up[j] += h;
            down[j] -= h;
            let (a, b) = (value(up), value(down));
            for (k, actuator) in [(0, 0), (1, 2)] {
                let difference = (a[actuator] - b[actuator]) / (2.0 * h);
                let scale = exact[k][j].abs().max(1e-3);
                assert!((difference - exact[k][j]).abs() < 1e-7 * scale, "{j} {k}");
            }
        }
    }

    #[test]
    fn rate_limit_holds_and_reaches_the_target() {
        let target: Vec<f64> = (0..200).map(|t| if t < 50 { 5.0 } else { 30.0 }).collect();
        let y = rate_limited(&target, 0.8);
        assert!(y.windows(2).all(|w| (w[1] - w[0]).abs() <= 0.8 + 1e-12));
        assert_eq!(y[199], 30.0);
    }
}
