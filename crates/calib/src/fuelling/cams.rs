//! What cams that are not where they rest do to the charge.

use dynocal_numerics::linalg::{LinalgError, dot, least_squares};
use serde::{Deserialize, Serialize};

/// Terms of the place at which a cam rests: a polynomial of degree 2 in scaled speed and pressure.
const TERMS: usize = 6;
/// Numbers of the straight law, and of its bends.
const STRAIGHT: usize = 4;
const BENT: usize = 5;

/// Cams move the charge about what it is at rest, where they follow a schedule of speed and pressure:
///
/// ```text
/// ln c = ln c(N, p) + sum over intake and exhaust of (a + b p' + d n' + e x) x  +  f x_intake x_exhaust,   x = theta - theta at rest(N, p)
/// ```
///
/// with p' and n' the scaled pressure and speed. In a transient the phaser is behind the load, and what was measured at rest does not
/// hold; where cams are moved whatever the load, they rest nowhere, and x is the distance from their mean. d, e and f only where the
/// records say them ([`CamBends`]). Not continued beyond the distances that the records show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CamLaw {
    /// Coefficients of the place at rest in deg, of intake and exhaust: 1, p', n', n'^2, n' p', p'^2.
    pub rest_deg: [Vec<f64>; 2],
    /// Largest distance from it that the records show, in deg.
    pub most_deg: [f64; 2],
    /// Slopes a in 1/deg.
    pub per_deg: [f64; 2],
    /// Slopes b in 1/deg.
    pub per_deg_pressure: [f64; 2],
    /// Speed and second degree, where they are worth it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bends: Option<CamBends>,
}

/// What cams do beyond straight lines: see [`CamLaw`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CamBends {
    /// Slopes d in 1/deg.
    pub per_deg_speed: [f64; 2],
    /// Curvatures e in 1/deg^2.
    pub per_deg2: [f64; 2],
    /// Product f in 1/deg^2.
    pub both: f64,
}

fn terms(n: f64, p: f64) -> [f64; TERMS] {
    [1.0, p, n, n * n, n * p, p * p]
}

impl CamLaw {
    /// Where cams rest, from scaled points `(speed, pressure)` and positions: on a surface where that explains half of how they move, at their
    /// mean otherwise. Nothing moves the charge yet.
    pub(super) fn of_rest(points: &[[f64; 2]], cams_deg: &[[f64; 2]]) -> Result<Self, LinalgError> {
        let rows: Vec<f64> = points.iter().flat_map(|[n, p]| terms(*n, *p)).collect();
        let fit = |k: usize| -> Result<Vec<f64>, LinalgError> {
            let y: Vec<f64> = cams_deg.iter().map(|c| c[k]).collect();
            let found = least_squares(&rows, points.len(), TERMS, &y, 1e-6)?.x;
            let mean = y.iter().sum::<f64>() / y.len().max(1) as f64;
            let squares =
                |at: &dyn Fn(usize) -> f64| (0..y.len()).map(|i| (y[i] - at(i)).powi(2)).sum::<f64>();
            // A surface that explains less than half of what a cam moves is no schedule: it would run away between the holds.
            let schedule =
                squares(&|i| dot(&rows[i * TERMS..(i + 1) * TERMS], &found)) < 0.5 * squares(&|_| mean);
            let still = || [mean].into_iter().chain(std::iter::repeat_n(0.0, TERMS - 1)).collect();
            Ok(if schedule { found } else { still() })
        };
        Ok(Self {
            rest_deg: [fit(0)?, fit(1)?],
            most_deg: [0.0; 2],
            per_deg: [0.0; 2],
            per_deg_pressure: [0.0; 2],
            bends: None,
        })
    }

    /// The law of cams that were held away from where they rest in the mean: least squares of what the logarithms of the charge are off,
    /// at scaled points, with bends; `most_deg` has to be known. Slopes are 0 with a standard deviation of pi / 360 a degree before any
    /// of it, beside errors of 1 %.
    pub(super) fn of_logarithms(
        &self,
        points: &[[f64; 2]],
        cams_deg: &[[f64; 2]],
        off: &[f64],
    ) -> Result<Self, LinalgError> {
        let mut law = Self { bends: Some(CamBends::default()), ..self.clone() };
        let most = law.most_of();
        let (mut rows, mut y) = (Vec::new(), off.to_vec());
        for (at, cams) in points.iter().zip(cams_deg) {
            let x = law.off_deg(*at, *cams);
            let x = [0, 1].map(|k| (x[k] / law.most_deg[k].max(1e-9)).clamp(-1.0, 1.0));
            let [n, p] = at.map(|v| v.clamp(-1.0, 1.0));
            rows.extend([x[0], x[1], p * x[0], p * x[1], n * x[0], n * x[1]]);
            rows.extend([x[0] * x[0], x[1] * x[1], x[0] * x[1]]);
        }
        for (k, most_deg) in most.iter().enumerate() {
            let weight = 0.01 / (most_deg * std::f64::consts::PI / 360.0).max(1e-9);
            rows.extend((0..most.len()).map(|j| if j == k { weight } else { 0.0 }));
            y.push(0.0);
        }
        let found = least_squares(&rows, y.len(), most.len(), &y, 1e-9)?.x;
        law.take(&found);
        Ok(law)
    }

    /// Places at rest in deg at a scaled speed and pressure.
    pub(super) fn at_rest_deg(&self, [n, p]: [f64; 2]) -> [f64; 2] {
        let terms = terms(n, p);
        [0, 1].map(|k| dot(&terms, &self.rest_deg[k]))
    }

    /// Distances from rest in deg at a scaled speed and pressure.
    pub(super) fn off_deg(&self, at: [f64; 2], cams_deg: [f64; 2]) -> [f64; 2] {
        let rest = self.at_rest_deg(at);
        [0, 1].map(|k| cams_deg[k] - rest[k])
    }

    /// Slopes of the logarithm of the charge at rest in 1/deg.
    pub(super) fn slopes(&self, at: [f64; 2]) -> [f64; 2] {
        let [n, p] = at.map(|v| v.clamp(-1.0, 1.0));
        let by_speed = self.bends.as_ref().map_or([0.0; 2], |b| b.per_deg_speed);
        [0, 1].map(|k| self.per_deg[k] + self.per_deg_pressure[k] * p + by_speed[k] * n)
    }

    /// What the charge at rest is multiplied by.
    pub(super) fn factor(&self, at: [f64; 2], cams_deg: [f64; 2]) -> f64 {
        let off = self.off_deg(at, cams_deg);
        let x = [0, 1].map(|k| off[k].clamp(-self.most_deg[k], self.most_deg[k]));
        let slopes = self.slopes(at);
        let bent = self.bends.as_ref().map_or(0.0, |b| {
            b.per_deg2[0] * x[0] * x[0] + b.per_deg2[1] * x[1] * x[1] + b.both * x[0] * x[1]
        });
        (slopes[0] * x[0] + slopes[1] * x[1] + bent).exp()
    }

    /// What a search moves: coefficients times the largest distances they are multiplied by, so that 1 is a factor of e.
    pub(super) fn given(&self) -> Vec<f64> {
        let m = self.most_deg;
        let by = |s: &[f64; 2]| [s[0] * m[0], s[1] * m[1]];
        let mut x = [by(&self.per_deg), by(&self.per_deg_pressure)].concat();
        if let Some(b) = &self.bends {
            x.extend(by(&b.per_deg_speed));
            x.extend([b.per_deg2[0] * m[0] * m[0], b.per_deg2[1] * m[1] * m[1], b.both * m[0] * m[1]]);
        }
        x
    }

    /// The reverse of [`CamLaw::given`]; how many numbers were taken.
    pub(super) fn take(&mut self, x: &[f64]) -> usize {
        let m = self.most_deg.map(|m| m.max(1e-9));
        let by = |at: usize| [x[at] / m[0], x[at + 1] / m[1]];
        (self.per_deg, self.per_deg_pressure) = (by(0), by(2));
        let Some(b) = &mut self.bends else { return STRAIGHT };
        b.per_deg_speed = by(STRAIGHT);
        b.per_deg2 = [x[STRAIGHT + 2] / (m[0] * m[0]), x[STRAIGHT + 3] / (m[1] * m[1])];
        b.both = x[STRAIGHT + 4] / (m[0] * m[1]);
        STRAIGHT + BENT
    }

    /// The largest distance in deg that goes with each number of [`CamLaw::given`]: of a product of both the mean.
    pub(super) fn most_of(&self) -> Vec<f64> {
        let m = self.most_deg;
        let mut all = [m, m].concat();
        if self.bends.is_some() {
            all.extend([m[0], m[1], m[0], m[1], 0.5 * (m[0] + m[1])]);
        }
        all
    }
}
