//! The structured inverse: a static part plus window differences that vanish in steady state.
//!
//! ```text
//! u(t) = static(T, N, lambda)
//!      + sum_k [T(t+k) - T(t)] (a_k + b_k N + c_k /N + d_k T)
//!      + sum_k [lambda(t+k) - lambda(t)] (e_k + f_k N + g_k T)
//!      + sum_k [N(t+k) - N(t)] (h_k + i_k T + j_k /N)
//! ```
//!
//! Linear in its coefficients, so it is fitted by least squares; it has no recursion, so it is stable for every
//! bounded reference. The differences are zero in steady state, so dynamics never spoil the static accuracy.

use super::{Actuators, FeedforwardMap, MapLimits, Reference, filter_torque};
use dynocal_numerics::linalg;
use serde::{Deserialize, Serialize};

/// Shape of the structured inverse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StructuredShape {
    /// Samples of look-ahead: the future end of the window.
    pub look_ahead: usize,
    /// Offsets k of the torque window (positive: ahead).
    pub torque_offsets: Vec<i32>,
    /// Offsets of the lambda window.
    pub lambda_offsets: Vec<i32>,
    /// Offsets of the speed window.
    pub speed_offsets: Vec<i32>,
    /// Ridge per sample (regressors are scaled to the order of one).
    pub ridge: f64,
    /// Weight of quasi-steady samples (others: 1).
    pub steady_weight: f64,
    /// A sample is quasi-steady when torque changes less than this over its window, in Nm ...
    pub steady_torque_nm: f64,
    /// ... and lambda less than this.
    pub steady_lambda: f64,
}

impl Default for StructuredShape {
    fn default() -> Self {
        Self {
            look_ahead: 4,
            torque_offsets: vec![4, 3, 2, 1, -2, -6],
            lambda_offsets: vec![4, 2, -2],
            speed_offsets: vec![3, -3],
            ridge: 1e-4,
            steady_weight: 11.0,
            steady_torque_nm: 1.5,
            steady_lambda: 0.015,
        }
    }
}

/// Region of references that the map was fitted on; references outside are clamped to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Torque in Nm.
    pub torque_nm: (f64, f64),
    /// Lambda.
    pub lambda: (f64, f64),
    /// Speed in rpm.
    pub speed_rpm: (f64, f64),
}

impl Region {
    /// Smallest box around `samples`.
    pub fn of(samples: &[Reference]) -> Self {
        let span = |f: fn(&Reference) -> f64| {
            samples
                .iter()
                .map(f)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)))
        };
        Self {
            torque_nm: span(|r| r.torque_nm),
            lambda: span(|r| r.lambda),
            speed_rpm: span(|r| r.speed_rpm),
        }
    }

    /// `r` moved to the nearest point of the region.
    pub fn clamp(&self, r: Reference) -> Reference {
        Reference {
            torque_nm: r.torque_nm.clamp(self.torque_nm.0, self.torque_nm.1),
            lambda: r.lambda.clamp(self.lambda.0, self.lambda.1),
            speed_rpm: r.speed_rpm.clamp(self.speed_rpm.0, self.speed_rpm.1),
        }
    }
}

/// One record of measured pairs: the response that was measured and the actuators that caused it.
pub struct Pairs<'a> {
    /// Measured (or simulated) torque, lambda and speed, row t measured at instant t.
    pub response: &'a [Reference],
    /// Actuators applied from instant t on.
    pub actuators: &'a [Actuators],
}

/// A fitted structured inverse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StructuredMap {
    /// Shape.
    pub shape: StructuredShape,
    /// Coefficients of INJ, SA and throttle, in the order of [`term_names`].
    pub coefficients: [Vec<f64>; 3],
    /// Region of the data.
    pub region: Region,
    /// Actuator limits.
    pub limits: MapLimits,
}

/// Why a map could not be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// Too few samples.
    #[error("dynamic map: {found} usable samples for {needed} coefficients; record a longer or richer test")]
    TooShort {
        /// Samples.
        found: usize,
        /// Coefficients.
        needed: usize,
    },
    /// The regression failed.
    #[error("dynamic map: {0}")]
    Regression(String),
}

// Scales that bring every term to the order of one.
const TORQUE: f64 = 50.0;
const SPEED: f64 = 2000.0;
const LAMBDA: f64 = 0.1;

fn scaled(r: &Reference) -> [f64; 4] {
    [r.torque_nm / TORQUE, (r.lambda - 1.0) / LAMBDA, r.speed_rpm / SPEED, SPEED / r.speed_rpm]
}

fn static_terms(r: &Reference, row: &mut Vec<f64>) {
    let [t, l, n, i] = scaled(r);
    row.extend([1.0, t, t * t, t * t * t, n, n * n, i, t * n, t * i, t * t * n, t * t * i, t * n * n]);
    row.extend([l, l * l, l * t, l * n, l * i, l * t * n]);
}

/// Names of the coefficients, in order (T in units of 50 Nm, N of 2000 rpm, L = (lambda - 1) / 0.1).
pub fn term_names(shape: &StructuredShape) -> Vec<String> {
    let mut names: Vec<String> = [
        "1", "T", "T^2", "T^3", "N", "N^2", "1/N", "T*N", "T/N", "T^2*N", "T^2/N", "T*N^2", "L", "L^2",
        "L*T", "L*N", "L/N", "L*T*N",
    ]
    .iter()
    .map(|s| (*s).to_string())
    .collect();
    for k in &shape.torque_offsets {
        names.extend(["1", "N", "1/N", "T"].iter().map(|s| format!("dT({k:+})*{s}")));
    }
    for k in &shape.lambda_offsets {
        names.extend(["1", "N", "T"].iter().map(|s| format!("dL({k:+})*{s}")));
    }
    for k in &shape.speed_offsets {
        names.extend(["1", "T", "1/N"].iter().map(|s| format!("dN({k:+})*{s}")));
    }
    names
}

/// Regressors of sample t; `at` gives the reference at an offset from t.
fn terms(shape: &StructuredShape, at: impl Fn(i32) -> Reference, row: &mut Vec<f64>) {
    row.clear();
    let centre = at(0);
    static_terms(&centre, row);
    let [t, l, n, i] = scaled(&centre);
    for &k in &shape.torque_offsets {
        let d = at(k).torque_nm / TORQUE - t;
        row.extend([d, d * n, d * i, d * t]);
    }
    for &k in &shape.lambda_offsets {
        let d = (at(k).lambda - 1.0) / LAMBDA - l;
        row.extend([d, d * n, d * t]);
    }
    for &k in &shape.speed_offsets {
        let d = at(k).speed_rpm / SPEED - n;
        row.extend([d, d * t, d * i]);
    }
}

impl StructuredShape {
    fn reach(&self) -> (usize, usize) {
        let all = || self.torque_offsets.iter().chain(&self.lambda_offsets).chain(&self.speed_offsets);
        let back = all().map(|k| -k).max().unwrap_or(0).max(0) as usize;
        let ahead = all().copied().max().unwrap_or(0).max(0) as usize;
        (back, ahead)
    }
}

impl StructuredMap {
    /// Fits the inverse by weighted, ridged least squares on measured pairs.
    ///
    /// # Errors
    /// [`MapError`] when there are fewer samples than coefficients or the regression fails.
    pub fn fit(shape: &StructuredShape, data: &[Pairs], limits: MapLimits) -> Result<Self, MapError> {
        let p = term_names(shape).len();
        let (back, ahead) = shape.reach();
        let (mut x, mut y, mut row) = (Vec::new(), [Vec::new(), Vec::new(), Vec::new()], Vec::new());
        let mut used: Vec<Reference> = Vec::new();
        for pairs in data {
            let r = pairs.response;
            for t in back..r.len().saturating_sub(ahead) {
                let at = |k: i32| r[(t as i64 + i64::from(k)) as usize];
                terms(shape, at, &mut row);
                let window = &r[t - back..=t + ahead];
                let weight = if quasi_steady(window, shape) { shape.steady_weight.sqrt() } else { 1.0 };
                x.extend(row.iter().map(|v| v * weight));
                for c in 0..3 {
                    y[c].push(pairs.actuators[t][c] * weight);
                }
                used.push(r[t]);
            }
        }
        let n = used.len();
        if n < p {
            return Err(MapError::TooShort { found: n, needed: p });
        }
        let mut coefficients: [Vec<f64>; 3] = Default::default();
        for c in 0..3 {
            coefficients[c] = linalg::least_squares(&x, n, p, &y[c], shape.ridge * n as f64)
                .map_err(|e| MapError::Regression(e.to_string()))?
                .x;
        }
        Ok(Self { shape: shape.clone(), coefficients, region: Region::of(&used), limits })
    }

    /// Actuators at sample t of a reference record (clamped at both ends of the record and to the region).
    pub fn at(&self, reference: &[Reference], t: usize) -> Actuators {
        let last = reference.len() as i64 - 1;
        let at = |k: i32| {
            let i = (t as i64 + i64::from(k)).clamp(0, last) as usize;
            self.region.clamp(reference[i])
        };
        let mut row = Vec::with_capacity(self.coefficients[0].len());
        terms(&self.shape, at, &mut row);
        let dot = |c: usize| row.iter().zip(&self.coefficients[c]).map(|(a, b)| a * b).sum();
        self.limits.clamp([dot(0), dot(1), dot(2)])
    }

    /// Steady-state actuators at an operating point.
    pub fn steady(&self, r: Reference) -> Actuators {
        self.at(&[r], 0)
    }
}

fn quasi_steady(window: &[Reference], shape: &StructuredShape) -> bool {
    let span = Region::of(window);
    span.torque_nm.1 - span.torque_nm.0 < shape.steady_torque_nm
        && span.lambda.1 - span.lambda.0 < shape.steady_lambda
}

impl FeedforwardMap for StructuredMap {
    fn name(&self) -> &str {
        "dynamic map"
    }

    fn drive(&self, demand: &[Reference], sample_time_s: f64) -> Vec<Actuators> {
        let torque: Vec<f64> = demand.iter().map(|r| r.torque_nm).collect();
        let filtered = filter_torque(&torque, sample_time_s);
        // Online the newest filtered sample is the far end of the window, so everything is `look_ahead` late.
        let late = |t: usize, k: i32| -> usize {
            (t as i64 + i64::from(k) - self.shape.look_ahead as i64).clamp(0, t as i64) as usize
        };
        let mut row = Vec::with_capacity(self.coefficients[0].len());
        (0..demand.len())
            .map(|t| {
                let at = |k: i32| {
                    let i = late(t, k);
                    // Speed is measured, not demanded: the map's centre uses the present one.
                    let speed =
                        demand[if k > 0 { t } else { (t as i64 + i64::from(k)).max(0) as usize }].speed_rpm;
                    self.region.clamp(Reference {
                        torque_nm: filtered[i],
                        lambda: demand[i].lambda,
                        speed_rpm: speed,
                    })
                };
                terms(&self.shape, at, &mut row);
                let dot = |c: usize| row.iter().zip(&self.coefficients[c]).map(|(a, b)| a * b).sum();
                self.limits.clamp([dot(0), dot(1), dot(2)])
            })
            .collect()
    }

    fn latency_s(&self, sample_time_s: f64) -> f64 {
        self.shape.look_ahead as f64 * sample_time_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> MapLimits {
        MapLimits { lower: [0.0, -90.0, -90.0], upper: [90.0, 90.0, 90.0] }
    }

    fn record(n: usize) -> Vec<Reference> {
        (0..n)
            .map(|t| {
                let t = t as f64 * 0.03;
                Reference {
                    torque_nm: 50.0 + 30.0 * (1.1 * t).sin() + 8.0 * (4.3 * t).cos(),
                    lambda: 1.0 + 0.05 * (2.3 * t).sin(),
                    speed_rpm: 2000.0 + 900.0 * (0.37 * t).cos(),
                }
            })
            .collect()
    }

    /// A plant that lies in the structure is recovered exactly.
    #[test]
    fn recovers_actuators_that_lie_in_the_structure() {
        let shape = StructuredShape { ridge: 0.0, ..Default::default() };
        let r = record(2000);
        let u: Vec<Actuators> = (0..r.len())
            .map(|t| {
                let ahead = r[(t + 4).min(r.len() - 1)].torque_nm - r[t].torque_nm;
                let i = 2000.0 / r[t].speed_rpm;
                let torque = r[t].torque_nm;
                [
                    4.0 + 0.18 * torque + 0.05 * ahead,
                    25.0 - 0.1 * torque * i,
                    5.0 + 0.2 * torque + 0.3 * ahead * i,
                ]
            })
            .collect();
        let data = [Pairs { response: &r[..1900], actuators: &u[..1900] }];
        let map = StructuredMap::fit(&shape, &data, limits()).unwrap();
        for t in [50, 400, 1500, 1950] {
            let got = map.at(&r, t);
            for c in 0..3 {
                assert!((got[c] - u[t][c]).abs() < 1e-6, "sample {t}, actuator {c}: {} {}", got[c], u[t][c]);
            }
        }
    }

    /// In steady state only the static part speaks, whatever the difference coefficients are.
    #[test]
    fn differences_vanish_in_steady_state() {
        let shape = StructuredShape::default();
        let p = term_names(&shape).len();
        let mut c = vec![0.0; p];
        c[0] = 3.0;
        c[1] = 2.0;
        c[18..].fill(1e3);
        let map = StructuredMap {
            shape,
            coefficients: [c.clone(), c.clone(), c],
            region: Region { torque_nm: (0.0, 100.0), lambda: (0.9, 1.1), speed_rpm: (1000.0, 3000.0) },
            limits: limits(),
        };
        let demand = vec![Reference { torque_nm: 50.0, lambda: 1.0, speed_rpm: 1500.0 }; 60];
        let u = map.drive(&demand, 0.03);
        assert!(u.iter().all(|a| (a[0] - 5.0).abs() < 1e-9));
    }
}
