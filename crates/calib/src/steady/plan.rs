//! Which points are planned: those that fill the space, or those that are best for a quadratic inside of what was reached.
//!
//! ```text
//! sobol, latin_hypercube, maximin     the space of the factors is filled, all blocks before the day begins
//! d_optimal                           first block as sobol; the next among candidates inside the envelope:  max log det M
//! i_optimal                           the same:  min of the mean variance over the region that was reached
//! v_optimal                           the same:  min of the mean variance at the operating points of the maps
//! ```
//!
//! M is the information of a quadratic over all factors ([`dynocal_design::points::optimal`]). The envelope is known only when the first
//! block is measured, and grows with each: candidates outside of it would be spent on limits that were already met.

use dynocal_design::points::optimal::{Criterion, choose};
use dynocal_design::points::space::{latin_hypercube, maximin, shuffled};
use dynocal_design::points::{MOST_DIMENSIONS, Sobol, short_ways};
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use super::envelope::Envelope;
use super::grid::place;
use super::layout::Layout;

/// How points are planned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlanKind {
    /// A Sobol' sequence.
    #[default]
    Sobol,
    /// A random Latin hypercube.
    LatinHypercube,
    /// A Latin hypercube whose points keep far from each other.
    Maximin,
    /// The determinant of the information.
    DOptimal,
    /// The mean variance at the operating points of the maps.
    VOptimal,
    /// The mean variance over the region that was reached.
    IOptimal,
}

impl PlanKind {
    /// Whether later blocks are chosen from what was reached so far.
    pub fn follows_the_envelope(self) -> bool {
        matches!(self, Self::DOptimal | Self::VOptimal | Self::IOptimal)
    }
}

/// Order of the points within a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Always the nearest that is left: short transients.
    #[default]
    ShortWays,
    /// A random one: what drifts over the day is no trend of a factor.
    Random,
}

/// What bed time may be spent on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DayPlan {
    /// Points to learn from, repeats left out.
    pub points: usize,
    /// Points of a block.
    pub block: usize,
    /// Seed of the plan.
    pub seed: u64,
    /// How they are chosen.
    pub kind: PlanKind,
    /// Their order in a block.
    pub order: Order,
}

/// Candidates of the optimal plans, places of the variance, and those for each operating point of the maps.
const CANDIDATES: usize = 1024;
const PLACES: usize = 256;
const SETTINGS: usize = 4;

impl DayPlan {
    /// The planned points in the order in which they are measured, by blocks; of the kinds that follow the envelope the first block alone.
    pub fn blocks(&self, layout: &Layout) -> Vec<Vec<Vec<f64>>> {
        let d = layout.factors.len();
        let n = if self.kind.follows_the_envelope() { self.points.min(self.size()) } else { self.points };
        let mut unit = match self.kind {
            PlanKind::LatinHypercube => latin_hypercube(n, d, self.seed),
            PlanKind::Maximin => maximin(n, d, self.seed),
            _ => {
                let Some(mut s) = Sobol::new(d.min(MOST_DIMENSIONS), self.seed) else { return Vec::new() };
                (0..n).map(|_| s.next_point()).collect()
            }
        };
        let first = n.min(self.size());
        corners(&mut unit[..first], layout.axes);
        let (mut at, mut all) = (vec![0.5; d], Vec::new());
        for (number, block) in unit.chunks(self.size()).enumerate() {
            let order = self.ordered(block, &at, number);
            if let Some(last) = order.last() {
                at.clone_from(&block[*last]);
            }
            all.push(order.iter().map(|k| layout.from_unit(&block[*k])).collect());
        }
        all
    }

    /// The next block of at most `left` points, number `number` of the day, beside the points `there` that were measured, for a bed that
    /// stands at `now`; candidates lie inside of `envelope`, where that encloses enough of them.
    pub fn next_block(
        &self,
        layout: &Layout,
        axes: &[Vec<f64>],
        there: &[Vec<f64>],
        envelope: &Envelope,
        (number, left, now): (usize, usize, &[f64]),
    ) -> Vec<Vec<f64>> {
        let d = layout.factors.len();
        let inside = |unit: &Vec<f64>| envelope.contains(&layout.from_unit(unit)[..layout.axes]);
        let seed = self.seed.wrapping_add(number as u64);
        let Some(mut sequence) = Sobol::new(d.min(MOST_DIMENSIONS), seed) else { return Vec::new() };
        let all: Vec<Vec<f64>> = (0..CANDIDATES).map(|_| sequence.next_point()).collect();
        let mut candidates: Vec<Vec<f64>> = all.iter().filter(|x| inside(x)).cloned().collect();
        if candidates.len() < 2 * self.size() {
            candidates = all;
        }
        let region: Vec<Vec<f64>> = candidates.iter().take(PLACES).cloned().collect();
        let (criterion, over) = match self.kind {
            PlanKind::VOptimal => {
                let cells = self.operating_points(layout, axes, envelope);
                (Criterion::MeanVariance, if cells.is_empty() { region } else { cells })
            }
            PlanKind::IOptimal => (Criterion::MeanVariance, region),
            _ => (Criterion::Determinant, region),
        };
        let there: Vec<Vec<f64>> = there.iter().map(|x| layout.to_unit(x)).collect();
        let chosen = choose(&there, &candidates, &over, left.min(self.size()), criterion);
        let unit: Vec<Vec<f64>> = chosen.into_iter().map(|k| candidates[k].clone()).collect();
        let order = self.ordered(&unit, &layout.to_unit(now), number);
        order.into_iter().map(|k| layout.from_unit(&unit[k])).collect()
    }

    /// Cells inside of what was reached, with some settings of the free factors each, as places of the unit cube.
    fn operating_points(&self, layout: &Layout, axes: &[Vec<f64>], envelope: &Envelope) -> Vec<Vec<f64>> {
        let free = layout.factors.len() - layout.axes;
        let Some(mut sequence) = Sobol::new(free.clamp(1, MOST_DIMENSIONS), self.seed) else {
            return Vec::new();
        };
        let cells = (0..axes.iter().map(Vec::len).product()).map(|k| place(axes, k));
        let reached: Vec<Vec<f64>> = cells.filter(|at| envelope.contains(at)).collect();
        let mut all = Vec::new();
        for at in reached {
            let spans = at.iter().zip(&layout.factors);
            let unit: Vec<f64> = spans.map(|(x, f)| (x - f.lower) / (f.upper - f.lower)).collect();
            for _ in 0..SETTINGS {
                let setting = sequence.next_point();
                all.push(unit.iter().chain(&setting[..free]).copied().collect());
            }
        }
        all
    }

    fn size(&self) -> usize {
        self.block.max(1)
    }

    fn ordered(&self, block: &[Vec<f64>], at: &[f64], number: usize) -> Vec<usize> {
        match self.order {
            Order::ShortWays => short_ways(block, at),
            Order::Random => shuffled(block.len(), &mut Rng64::stream(self.seed, number as u64 + 1)),
        }
    }
}

/// Moves the first points to the corners of the axes, where they leave as many points again elsewhere: maps reach there.
fn corners(unit: &mut [Vec<f64>], axes: usize) {
    let all = 1usize << axes;
    if unit.len() < 2 * all {
        return;
    }
    for (corner, point) in unit.iter_mut().take(all).enumerate() {
        for (k, x) in point.iter_mut().take(axes).enumerate() {
            *x = f64::from(u8::from(corner >> k & 1 == 1));
        }
    }
}
