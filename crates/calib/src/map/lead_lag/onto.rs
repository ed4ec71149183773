//! Tables moved onto points that were measured at rest.
//!
//! First by the static terms ([`anchor`]), then by a surface ([`Surface`]) through what the points say, where points that are left out
//! confirm it. A throttle that is nearly open moves by tens of degrees for a few Newton metres: terms in degrees that follow it are wrong
//! everywhere else. So an actuator whose values are positive and differ by a factor is looked at in its logarithm and its reciprocal
//! too, its misses count as shares of it, and the surface may stand in the place of the table as well as on it.

use super::super::structured::StructuredShape;
use super::super::structured::terms::{self, Scale, Term};
use super::super::surface::Surface;
use super::super::{FeedforwardMap, SteadyPoint, anchor};
use super::LeadLagMap;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::linalg;

/// Share of what the table misses of the points, in squares, that a surface may miss at most of points that it has not seen.
const LEAVES: f64 = 0.75;
/// Factor between values from which on an actuator is looked at in other coordinates.
const FACTOR: f64 = 2.0;

/// Coordinate of an actuator.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Warp {
    Plain,
    Log,
    Reciprocal,
}

impl Warp {
    fn of(self, u: f64) -> f64 {
        match self {
            Self::Plain => u,
            Self::Log => u.ln(),
            Self::Reciprocal => 1.0 / u,
        }
    }

    fn back(self, w: f64) -> f64 {
        match self {
            Self::Plain => w,
            Self::Log => w.exp(),
            Self::Reciprocal => 1.0 / w,
        }
    }

    /// What an error in the coordinate is as a share of `u`.
    fn share(self, u: f64) -> f64 {
        match self {
            Self::Plain => 1.0 / u,
            Self::Log => 1.0,
            Self::Reciprocal => u,
        }
    }
}

/// What moves an actuator beyond the terms.
struct Beyond {
    surface: Surface,
    warp: Warp,
    /// What the surface is about; none: about the table.
    about: Option<f64>,
    /// Values that the table and the points have.
    within: Interval,
}

impl Beyond {
    /// The best of coordinates, on the table and in its place; none where it is better to stay. `u` the points, `table` what it has there.
    fn best(places: &[[f64; 2]], u: &[f64], table: &[f64]) -> Option<Self> {
        let within = Interval::spanning(u.iter().chain(table).copied());
        let ratio = within.lower > 0.0 && within.upper >= FACTOR * within.lower;
        let warps = if ratio { &[Warp::Plain, Warp::Log, Warp::Reciprocal][..] } else { &[Warp::Plain][..] };
        let counted =
            |warp: Warp| -> Vec<f64> { u.iter().map(|u| if ratio { warp.share(*u) } else { 1.0 }).collect() };
        let plain = counted(Warp::Plain);
        let stay: f64 = u.iter().zip(table).zip(&plain).map(|((u, t), w)| ((u - t) * w).powi(2)).sum();
        let mut best: Option<(f64, Self)> = None;
        for warp in warps {
            let mean = u.iter().map(|u| warp.of(*u)).sum::<f64>() / u.len().max(1) as f64;
            for about in [None, Some(mean)] {
                let y: Vec<f64> =
                    u.iter().zip(table).map(|(u, t)| warp.of(*u) - about.unwrap_or(warp.of(*t))).collect();
                let Some((surface, left)) = Surface::through(places, &y, &counted(*warp)) else { continue };
                if best.as_ref().is_none_or(|b| left < b.0) {
                    best = Some((left, Self { surface, warp: *warp, about, within }));
                }
            }
        }
        best.filter(|b| b.0 < LEAVES * stay).map(|b| b.1)
    }

    /// What is added to the table where it has the value `table`.
    fn at(&self, place: [f64; 2], table: f64) -> f64 {
        let about = self.about.unwrap_or(self.warp.of(table));
        let moved = self.warp.back(about + self.surface.at(place));
        // A reciprocal may go through zero where no point is.
        if moved.is_finite() { self.within.clamp(moved) - table } else { 0.0 }
    }
}

/// Where a value lies in a range, from -1 to 1; 0 where the range has no width.
fn scaled(range: Interval, x: f64) -> f64 {
    let half = 0.5 * (range.upper - range.lower);
    if half > 0.0 { (range.clamp(x) - range.middle()) / half } else { 0.0 }
}

impl LeadLagMap {
    /// Base tables moved by the correction of the points inside of their box, and by its value at the edge outside. None where it is
    /// better to stay.
    pub(super) fn onto(&self, points: &[SteadyPoint]) -> Option<Self> {
        let scales: Vec<Scale> = self.region.iter().map(|r| Scale::of_range(*r)).collect();
        let span = |r: usize| Interval::spanning(points.iter().map(|p| p.reference[r]));
        let box_of: Vec<Interval> = (0..self.region.len()).map(span).collect();
        let mut map = self.clone();
        let moved = self.terms_moved(&scales, points);
        if let Some((terms, moved)) = &moved {
            let mut row = Vec::new();
            map.move_base(&box_of, |at, c| {
                terms::values(terms, &scales, |r, _| at[r], &mut row);
                linalg::dot(&row, &moved[c])
            });
        }
        let first_given = self.ports.demands.len();
        let axes = |at: &[f64]| {
            let given = box_of.get(first_given).map_or(0.0, |b| scaled(*b, at[first_given]));
            [scaled(box_of[0], at[0]), given]
        };
        let places: Vec<[f64; 2]> = points.iter().map(|p| axes(&p.reference)).collect();
        let tables: Vec<Vec<f64>> = points.iter().map(|p| map.steady(&p.reference)).collect();
        let beyond = |c: usize| {
            let u: Vec<f64> = points.iter().map(|p| p.actuators[c]).collect();
            let table: Vec<f64> = tables.iter().map(|u| u[c]).collect();
            Beyond::best(&places, &u, &table)
        };
        let beyond: Vec<Option<Beyond>> = (0..self.actuators.len()).map(beyond).collect();
        if beyond.iter().any(Option::is_some) {
            let by_terms = map.clone();
            map.move_base(&box_of, |at, c| {
                beyond[c].as_ref().map_or(0.0, |b| b.at(axes(at), by_terms.steady(at)[c]))
            });
        } else if moved.is_none() {
            return None;
        }
        Some(map)
    }

    /// The static terms, and their coefficients for every actuator; none where it is better to stay.
    fn terms_moved(&self, scales: &[Scale], points: &[SteadyPoint]) -> Option<(Vec<Term>, Vec<Vec<f64>>)> {
        let all = terms::terms(&self.ports, scales, &StructuredShape::default());
        let own = anchor::at_rest(&all, self.ports.demands.len());
        let terms: Vec<Term> = own.iter().map(|k| all[*k].clone()).collect();
        let moved = anchor::correction(&terms, scales, points, |r| self.steady(r))?;
        Some((terms, moved))
    }

    /// Adds `by` the references of a node and an actuator to the base tables; references are held in a box.
    fn move_base(&mut self, box_of: &[Interval], mut by: impl FnMut(&[f64], usize) -> f64) {
        let first_given = self.ports.demands.len();
        // Given channels beyond the first are no axes: where the points were.
        let mut at: Vec<f64> = box_of.iter().map(|b| b.middle()).collect();
        for (i, t) in self.demand.iter().enumerate() {
            for (j, n) in self.given.iter().enumerate() {
                at[0] = box_of[0].clamp(*t);
                if let Some(b) = box_of.get(first_given) {
                    at[first_given] = b.clamp(*n);
                }
                for (c, a) in self.actuators.iter_mut().enumerate() {
                    a.base[i * self.given.len() + j] += by(&at, c);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Vec<[f64; 2]> {
        (0..36).map(|k| [f64::from(k / 6) * 0.4 - 1.0, f64::from(k % 6) * 0.4 - 1.0]).collect()
    }

    /// A throttle that opens wide towards the end of the demand: between the points it is found as well where it is nearly shut.
    #[test]
    fn a_throttle_that_opens_wide_is_found_everywhere() {
        let truth = |x: [f64; 2]| 1.0 / (0.06 + 0.01 * x[1] - 0.04 * x[0]);
        let u: Vec<f64> = grid().iter().map(|x| truth(*x)).collect();
        let table: Vec<f64> = grid().iter().map(|x| 25.0 + 10.0 * x[0]).collect();
        let found = Beyond::best(&grid(), &u, &table).unwrap();
        for x in [[-0.9, 0.1], [0.1, -0.5], [0.5, 0.7], [0.9, -0.9]] {
            let got = 25.0 + 10.0 * x[0] + found.at(x, 25.0 + 10.0 * x[0]);
            assert!((got / truth(x) - 1.0).abs() < 0.01, "{x:?}: {got} {}", truth(x));
        }
    }

    /// Scatter moves nothing, or hardly ever: many surfaces are tried, and one may fit it by chance.
    #[test]
    fn scatter_moves_nothing() {
        let mut rng = dynocal_numerics::rng::Rng64::stream(1, 2);
        let moved = (0..40).filter(|_| {
            let u: Vec<f64> = (0..36).map(|_| 20.0 + rng.uniform_in(-1.0, 1.0)).collect();
            Beyond::best(&grid(), &u, &[20.0; 36]).is_some()
        });
        assert!(moved.count() <= 2);
        assert!(Beyond::best(&grid(), &[20.0; 36], &[20.0; 36]).is_none());
    }
}
