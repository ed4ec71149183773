//! The air charge.

use super::cams::CamLaw;
use dynocal_numerics::linalg::{LinalgError, least_squares};
use serde::{Deserialize, Serialize};

/// Number of terms of a polynomial of degree 4 in two variables.
pub(super) const TERMS: usize = 15;
/// Ridge beside rows of about 1.
const RIDGE: f64 = 1e-9;

/// Fuel per cycle that makes lambda 1 at a speed and a manifold pressure: a polynomial of degree 4 in both, scaled to the ranges
/// of the record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Charge {
    /// Middle and half width of the speed in rpm.
    pub speed_rpm: [f64; 2],
    /// Middle and half width of the pressure in kPa.
    pub pressure_kpa: [f64; 2],
    /// Coefficients in the unit of the injection: 1, p, n, then degree by degree with falling powers of n.
    pub coefficients: Vec<f64>,
    /// What cams that are not at rest do to it, where the records say it.
    #[serde(default)]
    pub cams: Option<CamLaw>,
}

impl Charge {
    /// Least relative error at points `(speed, pressure, fuel at lambda 1)`.
    ///
    /// # Errors
    /// [`LinalgError`] where a value is not finite.
    ///
    /// ```
    /// use dynocal_calib::fuelling::Charge;
    /// let truth = |n: f64, p: f64| 0.25 * p * (0.9 + 1e-4 * n - 2e-8 * n * n) - 1.0;
    /// let points: Vec<[f64; 3]> = (0..60)
    ///     .map(|k| (1000.0 + 400.0 * f64::from(k % 6), 30.0 + 6.0 * f64::from(k / 6)))
    ///     .map(|(n, p)| [n, p, truth(n, p)])
    ///     .collect();
    /// let charge = Charge::fit(&points)?;
    /// assert!((charge.at(1720.0, 47.0) / truth(1720.0, 47.0) - 1.0).abs() < 1e-6);
    /// # Ok::<(), dynocal_numerics::linalg::LinalgError>(())
    /// ```
    pub fn fit(points: &[[f64; 3]]) -> Result<Self, LinalgError> {
        let range = |k: usize| {
            let all = points.iter().map(|p| p[k]);
            let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            [0.5 * (low + high), (0.5 * (high - low)).max(1e-6 * high.abs()).max(1e-9)]
        };
        let scaled =
            Self { speed_rpm: range(0), pressure_kpa: range(1), coefficients: vec![0.0; TERMS], cams: None };
        scaled.again(points)
    }

    /// Coefficients anew, ranges and cams as they are.
    pub(super) fn again(&self, points: &[[f64; 3]]) -> Result<Self, LinalgError> {
        let mut out = self.clone();
        let mut rows = Vec::with_capacity(points.len() * TERMS);
        for [n, p, fuel] in points {
            rows.extend(out.terms(*n, *p).iter().map(|t| t / fuel));
        }
        out.coefficients = least_squares(&rows, points.len(), TERMS, &vec![1.0; points.len()], RIDGE)?.x;
        Ok(out)
    }

    /// Speed and pressure over the half widths of the record, from its middle.
    pub(super) fn scaled(&self, speed_rpm: f64, pressure_kpa: f64) -> [f64; 2] {
        let [n, p] =
            [(speed_rpm, self.speed_rpm), (pressure_kpa, self.pressure_kpa)].map(|(v, [m, w])| (v - m) / w);
        [n, p]
    }

    /// Derivatives of [`Charge::at`] by its coefficients.
    pub(super) fn terms(&self, speed_rpm: f64, pressure_kpa: f64) -> [f64; TERMS] {
        let [n, p] = self.scaled(speed_rpm, pressure_kpa);
        let (nn, np, pp) = (n * n, n * p, p * p);
        [1.0, p, n, nn, np, pp, nn * n, nn * p, n * pp, pp * p, nn * nn, nn * np, nn * pp, np * pp, pp * pp]
    }

    /// Fuel per cycle that makes lambda 1, in the unit of the injection; with cams at rest.
    pub fn at(&self, speed_rpm: f64, pressure_kpa: f64) -> f64 {
        let Ok(c) = <&[f64; TERMS]>::try_from(self.coefficients.as_slice()) else {
            return dynocal_numerics::linalg::dot(&self.terms(speed_rpm, pressure_kpa), &self.coefficients);
        };
        // Horner: identification asks for it some hundred million times.
        let [n, p] = self.scaled(speed_rpm, pressure_kpa);
        let first = c[0] + n * (c[2] + n * (c[3] + n * (c[6] + n * c[10])));
        let second = c[1] + n * (c[4] + n * (c[7] + n * c[11]));
        let third = c[5] + n * (c[8] + n * c[12]);
        first + p * (second + p * (third + p * (c[9] + n * c[13] + p * c[14])))
    }

    /// What cams at these places in deg multiply it by: 1 where nothing is known of them.
    pub fn cam_factor(&self, speed_rpm: f64, pressure_kpa: f64, cams_deg: Option<[f64; 2]>) -> f64 {
        let known = self.cams.as_ref().zip(cams_deg);
        known.map_or(1.0, |(law, cams)| law.factor(self.scaled(speed_rpm, pressure_kpa), cams))
    }

    /// Where the cams rest in deg, and what a degree away from there does to the logarithm of the charge as long as it is small, in 1/deg:
    /// each of intake and exhaust; none where nothing is known of them.
    pub fn cams_at(&self, speed_rpm: f64, pressure_kpa: f64) -> Option<[[f64; 2]; 2]> {
        let at = self.scaled(speed_rpm, pressure_kpa);
        self.cams.as_ref().map(|law| [law.at_rest_deg(at), law.slopes(at)])
    }

    /// Flow of that fuel into one cylinder per second.
    pub fn flow(&self, speed_rpm: f64, pressure_kpa: f64) -> f64 {
        self.at(speed_rpm, pressure_kpa) * speed_rpm / 120.0
    }
}
