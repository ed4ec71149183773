//! The region of the axes that was reached: the convex hull of the points that were measured, for one or two axes.
//!
//! A cell of a map inside of it has measured points on all sides; outside nothing is known of limits. Distances are in shares of
//! the ranges of the axes.

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

/// Share of the range of an axis by which a place may lie outside of the hull and still counts as inside: rounding.
const ROUNDING: f64 = 1e-6;

/// A convex hull over one or two axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    /// Ranges of the axes that distances are shares of.
    pub ranges: Vec<Interval>,
    /// Corners, in the units of the axes: the two ends of one axis, else a polygon against the clock. Fewer than three of two
    /// axes enclose nothing.
    pub corners: Vec<Vec<f64>>,
}

impl Envelope {
    /// The hull of `points` (one or two axes each); those that are not finite are left out.
    pub fn of(points: &[Vec<f64>], ranges: &[Interval]) -> Self {
        let mut all: Vec<Vec<f64>> =
            points.iter().filter(|p| p.iter().all(|v| v.is_finite())).cloned().collect();
        all.sort_by(|a, b| {
            a.iter().zip(b).fold(std::cmp::Ordering::Equal, |o, (a, b)| o.then(a.total_cmp(b)))
        });
        all.dedup();
        let corners = match ranges.len() {
            1 => all.first().into_iter().chain(all.last()).cloned().collect(),
            _ => chain(&all),
        };
        Self { ranges: ranges.to_vec(), corners }
    }

    /// Whether the place `at` lies inside.
    pub fn contains(&self, at: &[f64]) -> bool {
        self.outside(at) <= ROUNDING
    }

    /// How far `at` lies outside, in shares of the ranges; 0 inside, infinite where the hull encloses nothing.
    pub fn outside(&self, at: &[f64]) -> f64 {
        let unit: Vec<Vec<f64>> = self.corners.iter().map(|c| self.unit(c)).collect();
        let p = self.unit(at);
        match (self.ranges.len(), unit.as_slice()) {
            (1, [low, high]) => (low[0] - p[0]).max(p[0] - high[0]).max(0.0),
            (1, _) => f64::INFINITY,
            (_, corners) if corners.len() < 3 => f64::INFINITY,
            (_, corners) => {
                let edges = || corners.iter().zip(corners.iter().cycle().skip(1));
                if edges().all(|(a, b)| turn(a, b, &p) >= 0.0) {
                    return 0.0;
                }
                edges().map(|(a, b)| to_edge(a, b, &p)).fold(f64::INFINITY, f64::min)
            }
        }
    }

    fn unit(&self, at: &[f64]) -> Vec<f64> {
        self.ranges.iter().zip(at).map(|(r, v)| r.share(*v)).collect()
    }
}

/// Twice the area of the triangle a, b, p: positive where p lies left of the way from a to b.
fn turn(a: &[f64], b: &[f64], p: &[f64]) -> f64 {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
}

/// Distance of p to the edge from a to b.
fn to_edge(a: &[f64], b: &[f64], p: &[f64]) -> f64 {
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    let share = ((p[0] - a[0]) * x + (p[1] - a[1]) * y) / (x * x + y * y).max(f64::MIN_POSITIVE);
    let s = share.clamp(0.0, 1.0);
    (p[0] - a[0] - s * x).hypot(p[1] - a[1] - s * y)
}

/// Lower and upper chain of sorted points (A. M. Andrew, Inf. Process. Lett. 9, 1979).
fn chain(sorted: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let half = |points: &mut dyn Iterator<Item = &Vec<f64>>| {
        let mut hull: Vec<Vec<f64>> = Vec::new();
        for p in points {
            while let [.., a, b] = hull.as_slice()
                && turn(a, b, p) <= 0.0
            {
                hull.pop();
            }
            hull.push(p.clone());
        }
        hull.pop();
        hull
    };
    let mut all = half(&mut sorted.iter());
    all.extend(half(&mut sorted.iter().rev()));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_a_square_and_its_middle_has_four_corners() {
        let points = [[0.0, 0.0], [4.0, 0.0], [2.0, 1.0], [4.0, 2.0], [0.0, 2.0], [2.0, 0.0]];
        let points: Vec<Vec<f64>> = points.iter().map(|p| p.to_vec()).collect();
        let hull = Envelope::of(&points, &[Interval::new(0.0, 4.0), Interval::new(0.0, 2.0)]);
        assert_eq!(hull.corners, [[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]]);
        assert!(hull.contains(&[4.0, 2.0]) && hull.contains(&[1.0, 0.5]) && hull.contains(&[2.0, 0.0]));
        assert!(!hull.contains(&[4.1, 1.0]));
        // Shares of the ranges: 1 of 4, and from the corner 3-4-5.
        assert!((hull.outside(&[5.0, 1.0]) - 0.25).abs() < 1e-12);
        assert!((hull.outside(&[4.0 + 4.0 * 0.3, 2.0 + 2.0 * 0.4]) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn one_axis_has_two_ends_and_points_on_a_line_enclose_nothing() {
        let one = Envelope::of(&[vec![3.0], vec![1.0], vec![2.0]], &[Interval::new(0.0, 10.0)]);
        assert!(one.contains(&[1.0]) && one.contains(&[3.0]) && (one.outside(&[4.0]) - 0.1).abs() < 1e-12);
        let line = Envelope::of(&[vec![0.0, 0.0], vec![1.0, 1.0]], &[Interval::new(0.0, 1.0); 2]);
        assert!(!line.contains(&[0.5, 0.5]));
    }
}
