//! Tables moved onto points that were measured at rest.
//!
//! First by the static terms ([`anchor`]), then by a surface ([`Surface`]) on the tables or in their place, where that predicts points that
//! are left out much better than the tables do. A throttle that is nearly open moves by tens of degrees for a few Newton metres:
//! terms in degrees that follow it are wrong everywhere else. So an actuator whose values are positive and differ by a factor is looked at
//! in its logarithm and its reciprocal too, and what is missed of it counts as a share.

use super::super::anchor::{self, Moved};
use super::super::structured::StructuredShape;
use super::super::structured::terms::{self, Scale, Term};
use super::super::surface::Surface;
use super::super::{FeedforwardMap, SteadyPoint};
use super::LeadLagMap;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::linalg;

/// Share of what the table misses of the points, in squares, that a surface may miss at most of points that it has not seen: many are
/// tried, and the best of them fits scatter by chance.
const LEAVES: f64 = 0.3;
/// What a table misses in the mean of squares, as a share of a value or of the spread of all, below which there is nothing to be had.
const NOTHING: f64 = 1e-3;
/// Fewest points: fewer tell nothing of points that they are not.
const LEAST: usize = 12;
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
            // Beyond the widest opening that a reciprocal knows.
            Self::Reciprocal => {
                if w > 0.0 {
                    1.0 / w
                } else {
                    f64::INFINITY
                }
            }
        }
    }
}

/// What moves an actuator beyond the terms.
struct Beyond {
    surface: Surface,
    warp: Warp,
    /// Whether it stands on the table, in the actuator's own unit; else in its place.
    on_table: bool,
    /// Values that the table and the points have.
    within: Interval,
}

impl Beyond {
    /// The best of coordinates in the place of the table and, where it was not fitted to the points, on it; none where it is better to stay.
    /// `u` the points, `table` what it has there, `stays` what it says of points that it has not seen.
    fn best(
        places: &[[f64; 2]],
        u: &[f64],
        table: &[f64],
        (stays, on_table): (&[f64], bool),
    ) -> Option<Self> {
        if u.len() < LEAST {
            return None;
        }
        let within = Interval::spanning(u.iter().chain(table).copied());
        let points = Interval::spanning(u.iter().copied());
        let ratio = points.lower > 0.0 && points.upper >= FACTOR * points.lower;
        let spread = (within.upper - within.lower).max(f64::MIN_POSITIVE);
        // Of all options alike, and of staying.
        let miss = |k: usize, said: f64| (u[k] - within.clamp(said)) / if ratio { u[k] } else { spread };
        let stay: f64 = stays.iter().enumerate().map(|(k, t)| miss(k, *t).powi(2)).sum();
        if stay < NOTHING * NOTHING * u.len() as f64 {
            return None;
        }
        let mut best: Option<(f64, Self)> = None;
        let mut tried = |warp: Warp, on_table: bool| {
            let base = |k: usize| if on_table { table[k] } else { 0.0 };
            let y: Vec<f64> = (0..u.len()).map(|k| warp.of(u[k]) - base(k)).collect();
            let found = Surface::through(places, &y, |k, s| miss(k, warp.back(s + base(k))));
            if let Some((surface, left)) = found.filter(|f| best.as_ref().is_none_or(|b| f.1 < b.0)) {
                best = Some((left, Self { surface, warp, on_table, within }));
            }
        };
        if on_table {
            tried(Warp::Plain, true);
        }
        tried(Warp::Plain, false);
        if ratio {
            tried(Warp::Log, false);
            tried(Warp::Reciprocal, false);
        }
        best.filter(|b| b.0 < LEAVES * stay).map(|b| b.1)
    }

    /// What the table becomes where it has the value `table`.
    fn at(&self, place: [f64; 2], table: f64) -> f64 {
        let said = self.warp.back(self.surface.at(place) + if self.on_table { table } else { 0.0 });
        self.within.clamp(said)
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
        if let Some((terms, Moved { coefficients: moved, .. })) = &moved {
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
        let fitted =
            |c: usize| moved.as_ref().is_some_and(|(_, m)| m.coefficients[c].iter().any(|v| *v != 0.0));
        let beyond = |c: usize| {
            let u: Vec<f64> = points.iter().map(|p| p.actuators[c]).collect();
            let table: Vec<f64> = tables.iter().map(|u| u[c]).collect();
            // What terms that were fitted to the points miss of them is what they miss of those that they have not seen.
            let unseen = moved.as_ref().map(|(_, m)| &m.missed[c]).filter(|_| fitted(c));
            let stays: Vec<f64> = match unseen {
                Some(missed) => u.iter().zip(missed).map(|(u, e)| u - e).collect(),
                None => table.clone(),
            };
            Beyond::best(&places, &u, &table, (&stays, unseen.is_none()))
        };
        let beyond: Vec<Option<Beyond>> = (0..self.actuators.len()).map(beyond).collect();
        if beyond.iter().any(Option::is_some) {
            let by_terms = map.clone();
            let mut at_rest = vec![0.0; self.actuators.len()];
            map.move_base(&box_of, |at, c| {
                // Not as it is held in its port: what is added is added to the table.
                by_terms.at_rest(at, &by_terms.corners(at), &mut at_rest);
                beyond[c].as_ref().map_or(0.0, |b| b.at(axes(at), at_rest[c]) - at_rest[c])
            });
        } else if moved.is_none() {
            return None;
        }
        Some(map)
    }

    /// The static terms, and their coefficients for every actuator; none where it is better to stay.
    fn terms_moved(&self, scales: &[Scale], points: &[SteadyPoint]) -> Option<(Vec<Term>, Moved)> {
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
    use super::super::super::{ActuatorPort, Port, Ports};
    use super::super::{ActuatorTables, LagLaw};
    use super::*;

    fn grid(side: u32) -> Vec<[f64; 2]> {
        let at = |k: u32| 2.0 * f64::from(k) / f64::from(side - 1) - 1.0;
        (0..side * side).map(|k| [at(k / side), at(k % side)]).collect()
    }

    /// A throttle that opens wide towards the end of the demand: between the points it is found as well where it is nearly shut.
    #[test]
    fn a_throttle_that_opens_wide_is_found_everywhere() {
        let truth = |x: [f64; 2]| 1.0 / (0.06 + 0.01 * x[1] - 0.04 * x[0]);
        let u: Vec<f64> = grid(6).iter().map(|x| truth(*x)).collect();
        let table: Vec<f64> = grid(6).iter().map(|x| 25.0 + 10.0 * x[0]).collect();
        let found = Beyond::best(&grid(6), &u, &table, (&table, true)).unwrap();
        for x in [[-0.9, 0.1], [0.1, -0.5], [0.5, 0.7], [0.9, -0.9]] {
            let got = found.at(x, 25.0 + 10.0 * x[0]);
            assert!((got / truth(x) - 1.0).abs() < 0.01, "{x:?}: {got} {}", truth(x));
        }
    }

    /// Scatter moves nothing, or hardly ever: many surfaces are tried, and one may fit it by chance.
    #[test]
    fn scatter_moves_nothing() {
        let mut rng = dynocal_numerics::rng::Rng64::stream(1, 2);
        for (side, scatter) in [(4, 0.1), (5, 0.1), (6, 0.1), (4, 0.5), (5, 0.5), (6, 0.5)] {
            let places = grid(side);
            let moved = (0..100).filter(|_| {
                let u: Vec<f64> =
                    places.iter().map(|_| 20.0 * rng.uniform_in(-scatter, scatter).exp()).collect();
                {
                    let table = vec![20.0; places.len()];
                    Beyond::best(&places, &u, &table, (&table, true)).is_some()
                }
            });
            let moved = moved.count();
            assert!(moved <= 5, "{side} {scatter}: {moved}");
        }
        let flat = [20.0; 36];
        assert!(Beyond::best(&grid(6), &flat, &flat, (&flat, true)).is_none());
        assert!(Beyond::best(&[[0.0, 0.0]], &[20.0], &[10.0], (&[10.0], true)).is_none());
    }

    /// Where a table stood beyond its port the points are met all the same.
    #[test]
    fn a_table_beyond_its_port_comes_back_to_the_points() {
        let ports = Ports {
            demands: vec![Port { name: "torque".into(), unit: "Nm".into() }],
            given: vec![Port { name: "speed".into(), unit: "rpm".into() }],
            actuators: vec![ActuatorPort { name: "u".into(), unit: "deg".into(), lower: 2.0, upper: 60.0 }],
        };
        let axis = |low: f64, high: f64| (0..6).map(|k| low + (high - low) * f64::from(k) / 5.0).collect();
        let (demand, given): (Vec<f64>, Vec<f64>) = (axis(10.0, 90.0), axis(1000.0, 3000.0));
        let bent = |t: f64, n: f64| 1.0 / (0.12 - 0.001 * t) + n / 1000.0;
        let mut map = LeadLagMap {
            region: vec![Interval::new(10.0, 90.0), Interval::new(1000.0, 3000.0)],
            others: Vec::new(),
            loss: vec![0.0],
            steps: None,
            actuators: vec![ActuatorTables {
                base: vec![-5.0; 36],
                slopes: Vec::new(),
                lag_s: vec![0.0; 36],
                law: LagLaw::NONE,
            }],
            ports,
            demand: demand.clone(),
            given: given.clone(),
        };
        map.actuators[0].base.iter_mut().enumerate().for_each(|(k, b)| *b += 0.01 * k as f64);
        let points: Vec<SteadyPoint> = demand
            .iter()
            .flat_map(|t| given.iter().map(move |n| (*t, *n)))
            .map(|(t, n)| SteadyPoint { reference: vec![t, n], actuators: vec![bent(t, n)] })
            .collect();
        let moved = map.onto(&points).unwrap();
        for p in &points {
            let got = moved.steady(&p.reference)[0];
            assert!((got / p.actuators[0] - 1.0).abs() < 0.02, "{:?}: {got} {}", p.reference, p.actuators[0]);
        }
    }
}
