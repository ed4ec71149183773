//! Limits of some channels that depend on an operating point given by the others.
//!
//! ```text
//! c_j(o), h_j(o)     centre and half width of channel j, means of those at the operating points o_k with the weights
//!                    exp(-|o - o_k|^2 / (2 w^2)) in scaled operating channels
//! distance = max( region of the operating points at o,  max_j |x_j - c_j(o)| / h_j(o) )
//! ```
//!
//! For tables that were measured point by point: at each speed and load the spark, lambda or cam that could be run.

use serde::{Deserialize, Serialize};

use super::region::{Region, RegionKind};
use super::{Boundary, SpaceError};

/// Half widths below this share of a channel's range count as this share: one point says nothing about a width.
const NARROWEST: f64 = 0.01;

/// A region over operating channels and local channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OperatingBoundary {
    dim: usize,
    operating: Vec<usize>,
    local: Vec<usize>,
    region: Region,
    scale: Vec<f64>,
    width: f64,
    places: Vec<f64>,
    centres: Vec<f64>,
    halves: Vec<f64>,
    centre: Vec<f64>,
}

impl OperatingBoundary {
    /// From points (row by row, `dim` each); `operating` are the channels that make the operating point. Points whose
    /// operating channels differ by less than `tolerance` of their ranges belong together.
    ///
    /// # Errors
    /// [`SpaceError::TooFew`] with fewer than d + 2 operating points.
    pub fn learn(
        points: &[f64],
        dim: usize,
        operating: &[usize],
        tolerance: f64,
    ) -> Result<Self, SpaceError> {
        let local: Vec<usize> = (0..dim).filter(|j| !operating.contains(j)).collect();
        let range = |j: usize| {
            let column = points.iter().skip(j).step_by(dim.max(1));
            let low = column.clone().copied().fold(f64::INFINITY, f64::min);
            (low, column.copied().fold(f64::NEG_INFINITY, f64::max))
        };
        let scale: Vec<f64> =
            operating.iter().map(|j| range(*j)).map(|(l, h)| if h > l { h - l } else { 1.0 }).collect();
        let d = operating.len();
        let mut places: Vec<f64> = Vec::new();
        let mut limits: Vec<Vec<(f64, f64)>> = Vec::new();
        for x in points.chunks_exact(dim.max(1)) {
            let o: Vec<f64> = operating.iter().zip(&scale).map(|(j, s)| x[*j] / s).collect();
            let near = |p: &[f64]| p.iter().zip(&o).all(|(a, b)| (a - b).abs() <= tolerance);
            let at = places.chunks_exact(d.max(1)).position(near).unwrap_or_else(|| {
                places.extend_from_slice(&o);
                limits.push(vec![(f64::INFINITY, f64::NEG_INFINITY); local.len()]);
                limits.len() - 1
            });
            for ((low, high), j) in limits[at].iter_mut().zip(&local) {
                *low = low.min(x[*j]);
                *high = high.max(x[*j]);
            }
        }
        if d == 0 || limits.len() < d + 2 {
            return Err(SpaceError::TooFew { found: limits.len(), expected: d + 2, dim: d });
        }
        let narrowest: Vec<f64> = local.iter().map(|j| range(*j)).map(|(l, h)| NARROWEST * (h - l)).collect();
        let centres = limits.iter().flatten().map(|(l, h)| 0.5 * (l + h)).collect();
        let halves: Vec<f64> = limits
            .iter()
            .flat_map(|l| {
                l.iter().zip(&narrowest).map(|((l, h), n)| (0.5 * (h - l)).max(*n).max(f64::MIN_POSITIVE))
            })
            .collect();
        let mut region = Region::fit(RegionKind::Hull, &places, d, 400, 1.0);
        // The outermost operating points lie on the border.
        let worst = places.chunks_exact(d).map(|o| region.distance(o, None)).fold(0.0, f64::max);
        region.scale_by(worst);
        let mut model = Self {
            dim,
            operating: operating.to_vec(),
            local,
            region,
            width: spacing(&places, d),
            scale,
            places,
            centres,
            halves,
            centre: vec![0.0; dim],
        };
        model.centre = model.middle();
        Ok(model)
    }

    fn middle(&self) -> Vec<f64> {
        let mut centre = vec![0.0; self.dim];
        let o = self.region.centre().to_vec();
        self.operating.iter().zip(o.iter().zip(&self.scale)).for_each(|(j, (o, s))| centre[*j] = o * s);
        let at = self.local_limits(&o);
        self.local.iter().zip(&at.centres).for_each(|(j, c)| centre[*j] = *c);
        centre
    }

    /// Limits of the local channels at a scaled operating point, with their derivatives (local x operating).
    fn local_limits(&self, o: &[f64]) -> Limits {
        let (d, k) = (self.operating.len(), self.local.len());
        let squared = |p: &[f64]| p.iter().zip(o).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let exponents: Vec<f64> =
            self.places.chunks_exact(d).map(|p| -0.5 * squared(p) / (self.width * self.width)).collect();
        let largest = exponents.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = exponents.iter().map(|e| (e - largest).exp()).collect();
        let total: f64 = weights.iter().sum();
        let mut at = Limits {
            centres: vec![0.0; k],
            halves: vec![0.0; k],
            centre_slopes: vec![0.0; k * d],
            half_slopes: vec![0.0; k * d],
        };
        for (p, w) in weights.iter().enumerate() {
            for j in 0..k {
                at.centres[j] += w / total * self.centres[p * k + j];
                at.halves[j] += w / total * self.halves[p * k + j];
            }
        }
        for (p, w) in weights.iter().enumerate() {
            for i in 0..d {
                let slope = w / total * (self.places[p * d + i] - o[i]) / (self.width * self.width);
                for j in 0..k {
                    // The mean weight's own slope drops out with the difference to the mean.
                    at.centre_slopes[j * d + i] += slope * (self.centres[p * k + j] - at.centres[j]);
                    at.half_slopes[j * d + i] += slope * (self.halves[p * k + j] - at.halves[j]);
                }
            }
        }
        at
    }

    fn evaluate(&self, point: &[f64], gradient: Option<&mut [f64]>) -> f64 {
        if point.len() != self.dim || point.iter().any(|v| !v.is_finite()) {
            if let Some(g) = gradient {
                g.fill(0.0);
            }
            return f64::INFINITY;
        }
        let d = self.operating.len();
        let o: Vec<f64> = self.operating.iter().zip(&self.scale).map(|(j, s)| point[*j] / s).collect();
        let mut by_operating = vec![0.0; d];
        let outer = self.region.distance(&o, Some(&mut by_operating));
        let at = self.local_limits(&o);
        let share = |k: usize| (point[self.local[k]] - at.centres[k]) / at.halves[k];
        let worst = (0..self.local.len()).max_by(|a, b| share(*a).abs().total_cmp(&share(*b).abs()));
        let worst = worst.filter(|k| share(*k).abs() > outer);
        if let Some(g) = gradient {
            g.fill(0.0);
            match worst {
                None => {
                    self.operating
                        .iter()
                        .enumerate()
                        .for_each(|(i, j)| g[*j] = by_operating[i] / self.scale[i]);
                }
                Some(k) => {
                    let sign = share(k).signum();
                    g[self.local[k]] = sign / at.halves[k];
                    for i in 0..d {
                        let slope = at.centre_slopes[k * d + i] + share(k) * at.half_slopes[k * d + i];
                        g[self.operating[i]] = -sign * slope / at.halves[k] / self.scale[i];
                    }
                }
            }
        }
        worst.map_or(outer, |k| share(k).abs())
    }
}

struct Limits {
    centres: Vec<f64>,
    halves: Vec<f64>,
    centre_slopes: Vec<f64>,
    half_slopes: Vec<f64>,
}

/// Mean distance of an operating point to its nearest neighbour.
fn spacing(places: &[f64], d: usize) -> f64 {
    let n = places.len() / d;
    let row = |i: usize| &places[i * d..(i + 1) * d];
    let squared = |i: usize, k: usize| row(i).iter().zip(row(k)).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    let nearest =
        |i: usize| (0..n).filter(|k| *k != i).map(|k| squared(i, k)).fold(f64::INFINITY, f64::min).sqrt();
    ((0..n).map(nearest).sum::<f64>() / n as f64).max(1e-6)
}

impl Boundary for OperatingBoundary {
    fn dim(&self) -> usize {
        self.dim
    }

    fn centre(&self) -> &[f64] {
        &self.centre
    }

    fn distance(&self, point: &[f64]) -> f64 {
        self.evaluate(point, None)
    }

    fn distance_gradient(&self, point: &[f64], gradient: &mut [f64]) -> f64 {
        self.evaluate(point, Some(gradient))
    }

    fn clamp(&self, point: &mut [f64]) -> f64 {
        super::combine::clamp_by_bisection(self, point)
    }
}
