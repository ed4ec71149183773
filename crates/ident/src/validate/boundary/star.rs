//! A star-shaped region: its radius is a smooth function of the direction.
//!
//! ```text
//! distance(z) = |z| / r(z/|z|),   log r(u) = c + sum_k w_k exp(kappa (u'u_k - 1))
//! ```
//!
//! The directions u_k are those of points that have no point farther out within an angle; the weights make the radius go
//! through them (with a small ridge against noise). Follows regions with bays, which a convex hull fills.
//!
//! Reference: the star-shaped boundary of model-based calibration tools; G. Fasshauer, Meshfree Approximation Methods with
//! Matlab (2007), chapter 17 (radial functions on the sphere).

use dynocal_numerics::linalg::{axpy, cholesky, dot, norm2, solve_upper, solve_upper_transposed};
use serde::{Deserialize, Serialize};

/// Part of the unit matrix in the interpolation.
const RIDGE: f64 = 1e-2;
/// Narrowest and widest angle (rad) within which the farthest point decides.
const ANGLES: [f64; 2] = [0.25, 1.0];

/// Radius by direction, in coordinates about the centre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Star {
    /// Unit vectors, row by row.
    directions: Vec<f64>,
    weights: Vec<f64>,
    constant: f64,
    kappa: f64,
}

impl Star {
    /// From points about the origin (row by row, d each); at most `most` directions.
    pub(super) fn fit(points: &[f64], d: usize, most: usize) -> Self {
        let n = points.len() / d;
        // As many caps of this angle as a fifth of the points cover the sphere.
        let caps = (n as f64 / 5.0).max(2.0);
        let angle = (2.0 * caps.powf(-1.0 / (d.max(2) - 1) as f64)).clamp(ANGLES[0], ANGLES[1]);
        let mut order: Vec<(f64, usize)> =
            points.chunks_exact(d).map(norm2).enumerate().map(|(i, r)| (r, i)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let (mut directions, mut radii) = (Vec::new(), Vec::new());
        for (radius, i) in order {
            if radii.len() == most || radius <= 0.0 {
                break;
            }
            let u: Vec<f64> = points[i * d..(i + 1) * d].iter().map(|v| v / radius).collect();
            // From outside inwards: a direction that is near to one that is taken has a farther neighbour.
            let near = directions.chunks_exact(d).any(|other| dot(other, &u) > angle.cos());
            if !near {
                directions.extend_from_slice(&u);
                radii.push(radius.ln());
            }
        }
        let kappa = std::f64::consts::LN_2 / (1.0 - angle.cos());
        let constant = radii.iter().sum::<f64>() / radii.len().max(1) as f64;
        let k = radii.len();
        let row = |i: usize| &directions[i * d..(i + 1) * d];
        let mut matrix: Vec<f64> = (0..k * k)
            .map(|p| {
                (kappa * (dot(row(p / k), row(p % k)) - 1.0)).exp() + if p / k == p % k { RIDGE } else { 0.0 }
            })
            .collect();
        let mut weights: Vec<f64> = radii.iter().map(|r| r - constant).collect();
        let solved = cholesky(&mut matrix, k).is_ok()
            && solve_upper_transposed(&matrix, k, &mut weights).is_ok()
            && solve_upper(&matrix, k, &mut weights).is_ok();
        if !solved {
            // A sphere of the mean radius remains.
            weights.fill(0.0);
        }
        Self { directions, weights, constant, kappa }
    }

    /// Distance at z and its gradient.
    pub(super) fn distance(&self, z: &[f64]) -> (f64, Vec<f64>) {
        let (d, length) = (z.len(), norm2(z));
        if length == 0.0 {
            return (0.0, vec![0.0; d]);
        }
        let u: Vec<f64> = z.iter().map(|v| v / length).collect();
        let (mut log_radius, mut slope) = (self.constant, vec![0.0; d]);
        for (direction, w) in self.directions.chunks_exact(d).zip(&self.weights) {
            let part = w * (self.kappa * (dot(&u, direction) - 1.0)).exp();
            log_radius += part;
            axpy(self.kappa * part, direction, &mut slope);
        }
        let distance = length * (-log_radius).exp();
        // Only the part of the slope across the ray changes the direction.
        let along = dot(&slope, &u);
        let gradient = (0..d).map(|j| distance / length * (u[j] - (slope[j] - along * u[j]))).collect();
        (distance, gradient)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A region with a bay: radius 2 + cos 3a.
    fn flower() -> Vec<f64> {
        let radius = |a: f64| 2.0 + (3.0 * a).cos();
        let ring = (0..240).flat_map(|i| {
            let a = f64::from(i) / 240.0 * std::f64::consts::TAU;
            (1..=3).flat_map(move |k| {
                let r = radius(a) * f64::from(k) / 3.0;
                [r * a.cos(), r * a.sin()]
            })
        });
        ring.collect()
    }

    #[test]
    fn the_radius_of_a_flower_is_found() {
        let star = Star::fit(&flower(), 2, 400);
        for i in 0..60 {
            let a = f64::from(i) / 60.0 * std::f64::consts::TAU + 0.01;
            let r = 2.0 + (3.0 * a).cos();
            let (distance, _) = star.distance(&[r * a.cos(), r * a.sin()]);
            assert!((distance - 1.0).abs() < 0.12, "angle {a}: {distance}");
            // In proportion along the ray.
            let (half, _) = star.distance(&[0.5 * r * a.cos(), 0.5 * r * a.sin()]);
            assert!((2.0 * half - distance).abs() < 1e-12);
        }
    }

    #[test]
    fn gradient_is_that_of_differences() {
        let star = Star::fit(&flower(), 2, 400);
        for z in [[0.4, 1.3], [-2.0, 0.1], [0.7, -0.6]] {
            let (_, gradient) = star.distance(&z);
            for j in 0..2 {
                let (mut up, mut down) = (z, z);
                up[j] += 1e-6;
                down[j] -= 1e-6;
                let difference = (star.distance(&up).0 - star.distance(&down).0) / 2e-6;
                assert!((gradient[j] - difference).abs() < 1e-7, "{gradient:?} {difference}");
            }
        }
    }
}
