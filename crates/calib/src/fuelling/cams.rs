//! What cams that are not where they rest do to the charge.

use dynocal_numerics::linalg::{LinalgError, dot, least_squares};
use serde::{Deserialize, Serialize};

/// Terms of the place at which a cam rests: a polynomial of degree 2 in scaled speed and pressure.
const TERMS: usize = 6;

/// Cams move the charge about what it is at rest, where they follow a schedule of speed and pressure:
///
/// ```text
/// ln c = ln c(N, p) + sum over intake and exhaust of (a + b p') (theta - theta at rest(N, p))
/// ```
///
/// with p' the scaled pressure. In a transient the phaser is behind the load, and what was measured at rest does not hold. Not
/// continued beyond the distances that the records show.
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
}

fn terms(n: f64, p: f64) -> [f64; TERMS] {
    [1.0, p, n, n * n, n * p, p * p]
}

impl CamLaw {
    /// Where cams rest, from scaled points `(speed, pressure)` and positions; nothing moves the charge yet.
    pub(super) fn of_rest(points: &[[f64; 2]], cams_deg: &[[f64; 2]]) -> Result<Self, LinalgError> {
        let rows: Vec<f64> = points.iter().flat_map(|[n, p]| terms(*n, *p)).collect();
        let fit = |k: usize| {
            let y: Vec<f64> = cams_deg.iter().map(|c| c[k]).collect();
            least_squares(&rows, points.len(), TERMS, &y, 1e-6).map(|found| found.x)
        };
        Ok(Self {
            rest_deg: [fit(0)?, fit(1)?],
            most_deg: [0.0; 2],
            per_deg: [0.0; 2],
            per_deg_pressure: [0.0; 2],
        })
    }

    /// Distances from rest in deg at a scaled speed and pressure.
    pub(super) fn off_deg(&self, [n, p]: [f64; 2], cams_deg: [f64; 2]) -> [f64; 2] {
        let terms = terms(n, p);
        [0, 1].map(|k| cams_deg[k] - dot(&terms, &self.rest_deg[k]))
    }

    /// What the charge at rest is multiplied by.
    pub(super) fn factor(&self, at: [f64; 2], cams_deg: [f64; 2]) -> f64 {
        let off = self.off_deg(at, cams_deg);
        let of = |k: usize| {
            let off = off[k].clamp(-self.most_deg[k], self.most_deg[k]);
            (self.per_deg[k] + self.per_deg_pressure[k] * at[1].clamp(-1.0, 1.0)) * off
        };
        (of(0) + of(1)).exp()
    }
}
