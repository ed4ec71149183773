//! The gauge of a convex hull about the origin, by the simplex method.
//!
//! ```text
//! gauge(b) = min sum_i lambda_i   subject to   sum_i lambda_i a_i = b,  lambda >= 0
//! ```
//!
//! is 1 on the hull of the points a_i, below 1 inside, and grows in proportion along rays. A small cross-polytope about the
//! origin joins the points: its corners are a feasible start, and the gauge stays finite where the points lie in a plane.
//! The multipliers of the optimum are the gradient: the facet that the ray to b goes through.
//!
//! Reference: G. B. Dantzig, Linear Programming and Extensions (1963), chapter 5; V. Chvatal, Linear Programming (1983),
//! chapter 7 (revised simplex method).

use dynocal_numerics::linalg::{axpy, dot};

/// Corners of the cross-polytope, in standard deviations.
const GUARD: f64 = 0.05;
/// Reduced costs above this are optimal.
const OPTIMAL: f64 = -1e-9;

/// Gauge of `b` (d) about the origin for points (row-major, d each), and its gradient.
pub(super) fn gauge(points: &[f64], b: &[f64]) -> (f64, Vec<f64>) {
    let d = b.len();
    let mut simplex = Simplex::new(b);
    let count = points.len() / d;
    // Far more than the 2d or so steps that are usual; every step leaves a feasible, hence too large, gauge.
    for step in 0..50 * d + 100 {
        // After many steps the first improving column instead of the best: that cannot cycle.
        let first_only = step > 20 * d + 40;
        let mut best: Option<(f64, Column)> = None;
        let mut offer = |reduced: f64, column: Column| {
            let better = best.is_none_or(|(r, _)| !first_only && reduced < r);
            if reduced < OPTIMAL && better {
                best = Some((reduced, column));
            }
        };
        for i in 0..count {
            offer(1.0 - dot(&simplex.y, &points[i * d..(i + 1) * d]), Column::Point(i));
        }
        for i in 0..d {
            offer(1.0 - GUARD * simplex.y[i], Column::Corner(i, GUARD));
            offer(1.0 + GUARD * simplex.y[i], Column::Corner(i, -GUARD));
        }
        let Some((_, column)) = best else { break };
        if !simplex.enter(column, points) {
            break;
        }
    }
    (simplex.x.iter().sum::<f64>().max(0.0), simplex.y)
}

#[derive(Clone, Copy)]
enum Column {
    Point(usize),
    /// Coordinate and value.
    Corner(usize, f64),
}

/// A basis: its inverse (d x d, row-major), the values of its columns, and the multipliers.
struct Simplex {
    d: usize,
    inverse: Vec<f64>,
    x: Vec<f64>,
    /// `y = 1' B^-1`, as all costs are one.
    y: Vec<f64>,
}

impl Simplex {
    /// The corners on the side of b.
    fn new(b: &[f64]) -> Self {
        let d = b.len();
        let mut inverse = vec![0.0; d * d];
        let y: Vec<f64> = b.iter().map(|v| if *v < 0.0 { -1.0 / GUARD } else { 1.0 / GUARD }).collect();
        (0..d).for_each(|i| inverse[i * d + i] = y[i]);
        Self { d, inverse, x: b.iter().map(|v| v.abs() / GUARD).collect(), y }
    }

    /// Takes a column in for the one that reaches zero first; false when none does.
    fn enter(&mut self, column: Column, points: &[f64]) -> bool {
        let d = self.d;
        let w: Vec<f64> = (0..d)
            .map(|i| {
                let row = &self.inverse[i * d..(i + 1) * d];
                match column {
                    Column::Point(k) => dot(row, &points[k * d..(k + 1) * d]),
                    Column::Corner(k, value) => row[k] * value,
                }
            })
            .collect();
        let ratio = |i: usize| self.x[i] / w[i];
        let candidates = (0..d).filter(|&i| w[i] > 1e-11);
        let Some(out) = candidates.min_by(|&a, &b| ratio(a).total_cmp(&ratio(b)).then(w[b].total_cmp(&w[a])))
        else {
            return false;
        };
        let step = ratio(out);
        for i in 0..d {
            self.x[i] = if i == out { step } else { (self.x[i] - step * w[i]).max(0.0) };
        }
        let row: Vec<f64> = self.inverse[out * d..(out + 1) * d].iter().map(|v| v / w[out]).collect();
        for i in 0..d {
            let target = &mut self.inverse[i * d..(i + 1) * d];
            if i == out { target.copy_from_slice(&row) } else { axpy(-w[i], &row, target) }
        }
        self.y.fill(0.0);
        for i in 0..d {
            axpy(1.0, &self.inverse[i * d..(i + 1) * d], &mut self.y);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauge_of_a_square_is_the_maximum_norm() {
        let square = [1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 0.2, 0.3];
        for (x, y) in [(0.3, 0.1), (1.0, 1.0), (-4.0, 0.5), (0.0, -2.5), (0.0, 0.0), (3.0, -3.0)] {
            let (value, normal) = gauge(&square, &[x, y]);
            assert!((value - f64::max(x.abs(), y.abs())).abs() < 1e-12, "{x} {y}: {value}");
            // The dual value is the same.
            assert!((normal[0] * x + normal[1] * y - value).abs() < 1e-12);
        }
    }

    #[test]
    fn gauge_of_a_simplex_about_its_centre() {
        // Corners e_i - c of the standard simplex in three coordinates, and the origin's: facets sum = const and x_i = const.
        let c = 0.25;
        let mut corners = vec![-c; 12];
        (0..3).for_each(|i| corners[3 * i + i] = 1.0 - c);
        for b in [[0.1, 0.2, 0.3], [-1.0, 0.3, 0.2], [0.2, -0.4, -0.7]] {
            let sides = [-b[0] / c, -b[1] / c, -b[2] / c, (b[0] + b[1] + b[2]) / (1.0 - 3.0 * c)];
            let expected = sides.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            assert!((gauge(&corners, &b).0 - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn points_in_a_plane_leave_a_finite_gauge() {
        let line = [1.0, 0.0, -1.0, 0.0];
        assert!((gauge(&line, &[0.5, 0.0]).0 - 0.5).abs() < 1e-12);
        assert!((gauge(&line, &[0.0, 0.05]).0 - 1.0).abs() < 1e-12);
    }

    /// Values of the same linear program by SciPy; origin in tests/reference/README.md.
    #[test]
    fn gauge_is_that_of_an_independent_linear_program() {
        let text = include_str!("../../../../../tests/reference/hull.json");
        let reference: serde_json::Value = serde_json::from_str(text).unwrap();
        let numbers = |v: &serde_json::Value| -> Vec<f64> {
            v.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
        };
        for case in reference["cases"].as_array().unwrap() {
            let (points, d) = (numbers(&case["points"]), case["dim"].as_u64().unwrap() as usize);
            let expected = numbers(&case["gauge"]);
            for (b, expected) in numbers(&case["queries"]).chunks_exact(d).zip(&expected) {
                let (value, normal) = gauge(&points, b);
                assert!((value - expected).abs() < 1e-8 * (1.0 + expected), "{value} {expected}");
                assert!((dot(&normal, b) - value).abs() < 1e-8 * (1.0 + expected));
            }
        }
    }
}
