//! Which points of a day come next: where the optimum lies as far as is known, and where the bed has not been.
//!
//! Planned points fill the whole space of the factors; the maps live on a small part of it, most of it at the ends of ranges, where
//! an optimum is sought among errors of models and finds those that look like gain. Points at the expected optimum show such gain
//! for what it is: the next models know better, and the optimum moves or stays.
//!
//! ```text
//! half of a batch   cells outside of what was reached, the farthest first: with the setting that is expected to be best there a little within
//!                   all limits, then with that of the nearest point where no loop stood at an end of its range, then with its neighbours';
//!                   where either of these is not expected to keep them, with the best that is farther within
//! the rest          by turns of the map so far (where the optimum is expected) and of the hopeful map (where it may lie: the
//!                   least m - 2 s); greedy over candidates x of either:  max  s(x) / |m(x)| * d(x)
//!                   m, s: mean and standard deviation of what is minimised; d: distance to the nearest measured point in shares
//!                   of the ranges
//! ```

use dynocal_design::points::Sobol;
use serde::{Deserialize, Serialize};

use super::cell::{Setting, Side};
use super::envelope::Envelope;
use super::grid::{Cell, CellState, corners, interpolate};
use dynocal_numerics::status::Status;

/// How many points of a day follow the optimum, and when that is enough.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineSpec {
    /// Share of the points of the day that are not planned but chosen on the way; 0: none.
    pub share: f64,
    /// Points of a batch, after which models and maps are made again.
    pub batch: usize,
    /// Root mean square error of what was promised for a batch, as a share of what is minimised, at which no more are needed.
    pub tolerance: f64,
    /// Gain that may still be there ([`Left::gain`]), in the unit of what is minimised, at which no more points are needed; 0: not asked.
    pub gain: f64,
    /// Interval of what is promised ([`Left::interval`]), in the unit of what is minimised, at which no more points are needed; 0: not asked.
    pub interval: f64,
}

/// What more points may be worth, in the unit of what is minimised: means over the cells that hold an optimum.
///
/// ```text
/// gain      mean of  max(0, m(x) - min (m - 2 s))      x: the map; the optimum may lie so far below it
/// interval  mean of  1.96 s(x)                         half width of the 95 % interval of what is expected in the cells
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Left {
    /// How far the optimum may lie below the map, in each cell by itself: what the map gives for less jumps is in it.
    pub gain: f64,
    /// Half width of the interval of the map.
    pub interval: f64,
}

impl Left {
    /// Of a map and of the same cells with [`HOPE`] for caution; none where no cell holds an optimum in both.
    pub fn of(cells: &[Cell], hopeful: &[Cell]) -> Option<Self> {
        let optimal = |c: &Cell| c.state == CellState::Optimal;
        let both: Vec<(&Cell, &Cell)> =
            cells.iter().zip(hopeful).filter(|(a, b)| optimal(a) && optimal(b)).collect();
        let n = both.len() as f64;
        let gain = |(a, b): &(&Cell, &Cell)| {
            let least = b.optimum.objective + HOPE * b.optimum.objective_deviation;
            (a.optimum.objective - least).max(0.0)
        };
        let interval = |(a, _): &(&Cell, &Cell)| 1.96 * a.optimum.objective_deviation;
        (n > 0.0).then(|| Self {
            gain: both.iter().map(gain).sum::<f64>() / n,
            interval: both.iter().map(interval).sum::<f64>() / n,
        })
    }

    /// Whether that is little enough: each that is asked for.
    pub fn is_enough(&self, spec: &RefineSpec) -> bool {
        let asked = [(spec.gain, self.gain), (spec.interval, self.interval)];
        asked.iter().any(|(most, _)| *most > 0.0) && asked.iter().all(|(most, is)| *most == 0.0 || is <= most)
    }
}

impl Default for RefineSpec {
    fn default() -> Self {
        Self { share: 0.5, batch: 8, tolerance: 0.002, gain: 0.0, interval: 0.0 }
    }
}

/// What the choice of the next points knows.
pub struct Known<'a> {
    /// Models, limits, ranges of all factors.
    pub setting: &'a Setting<'a>,
    /// Values of the axes of the map.
    pub axes: &'a [Vec<f64>],
    /// The map so far.
    pub cells: &'a [Cell],
    /// The same cells with [`HOPE`] for caution.
    pub hopeful: &'a [Cell],
    /// What was reached.
    pub envelope: &'a Envelope,
    /// Factors of all points that were measured.
    pub measured: &'a [Vec<f64>],
    /// Those at which every loop had room.
    pub with_room: &'a [Vec<f64>],
    /// Axes that were asked for so far.
    pub asked: &'a [Vec<f64>],
}

/// Caution with which the optimum is sought where it may lie: two standard deviations below what is expected.
pub const HOPE: f64 = -2.0;
/// Times that the bed is sent to a cell.
const TRIES: usize = 3;

/// How far within its limits, in their scales, the bed is sent to a cell: exactly at a limit it is passed as often as not, and the point ends before
/// it is there.
const WITHIN: f64 = 0.05;
/// How much farther for each time that it was sent there and did not come so far.
const FARTHER: f64 = 0.25;
/// Starts of the search for the setting of a cell that was not reached.
const STARTS: usize = 8;
/// Candidates between the cells.
const CANDIDATES: usize = 256;

impl Known<'_> {
    /// Cells that the bed has not reached and may be sent to.
    pub fn untried(&self) -> Vec<usize> {
        let filled = (0..self.cells.len()).filter(|k| self.cells[*k].state == CellState::Filled);
        filled.filter(|k| self.tries(*k) < TRIES).collect()
    }

    fn tries(&self, cell: usize) -> usize {
        self.asked.iter().filter(|a| self.same_place(a, &self.cells[cell].at)).count()
    }

    fn same_place(&self, a: &[f64], b: &[f64]) -> bool {
        let ranges = &self.setting.ranges;
        a.iter().zip(b).zip(ranges).all(|((a, b), r)| (a - b).abs() <= 1e-6 * r.width())
    }

    /// The next `count` points, all factors each.
    pub fn next(&self, count: usize, seed: u64, interrupt: &dyn Fn() -> bool) -> Vec<Vec<f64>> {
        let untried = self.untried();
        let outer = count.div_ceil(2).min(untried.len());
        let far = self.far_out(untried, outer);
        let mut chosen: Vec<Vec<f64>> = far.into_iter().map(|k| self.way_to(k, seed, interrupt)).collect();
        let sets = [self.candidates(self.cells, seed), self.candidates(self.hopeful, seed)];
        let unit =
            |x: &[f64]| -> Vec<f64> { self.setting.ranges.iter().zip(x).map(|(r, v)| r.share(*v)).collect() };
        let mut near: Vec<Vec<f64>> = self.measured.iter().chain(&chosen).map(|x| unit(x)).collect();
        let doubts = sets.each_ref().map(|set| set.iter().map(|x| self.doubt(x)).collect::<Vec<f64>>());
        while chosen.len() < count {
            let turn = (count - chosen.len()) % 2;
            let (candidates, doubt) = (&sets[turn], &doubts[turn]);
            let value = |k: usize| {
                let x = unit(&candidates[k]);
                let squares =
                    near.iter().map(|p| p.iter().zip(&x).map(|(a, b)| (a - b).powi(2)).sum::<f64>());
                doubt[k] * squares.fold(f64::INFINITY, f64::min).sqrt()
            };
            let values: Vec<f64> = (0..candidates.len()).map(value).collect();
            let best = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b]).then(b.cmp(a)));
            let Some(best) = best.filter(|k| values[*k] > 0.0) else { break };
            near.push(unit(&candidates[best]));
            chosen.push(candidates[best].clone());
        }
        chosen
    }

    /// Setting with which the bed is sent to a cell that it has not reached.
    fn way_to(&self, cell: usize, seed: u64, interrupt: &dyn Fn() -> bool) -> Vec<f64> {
        let Cell { at, optimum, .. } = &self.cells[cell];
        let nearest = self.with_room.iter().min_by(|a, b| self.apart(a, at).total_cmp(&self.apart(b, at)));
        let known = match (self.tries(cell), nearest) {
            (0, _) => return self.within(WITHIN, false).optimise(at, STARTS, &[], seed, interrupt).x,
            (1, Some(nearest)) => [at, &nearest[self.setting.axes..]].concat(),
            // A filled cell has the setting of its neighbours.
            _ => optimum.x.clone(),
        };
        if self.within(WITHIN, true).judge(&known, Status::Stalled, None).feasible {
            return known;
        }
        self.within(self.tries(cell) as f64 * FARTHER, true).optimise(at, STARTS, &[known], seed, interrupt).x
    }

    /// The setting with limits that are closer by a share of their scales; where it is to be `sure`, all with the asked probability: a cell may not have
    /// been reached for an end that was to be kept in the mean.
    fn within(&self, share: f64, sure: bool) -> Setting<'_> {
        let s = self.setting;
        let closer = |side: &Side| Side {
            limit: side.limit - share * side.sign * side.scale,
            caution: if sure { 1.0 } else { side.caution },
            ..side.clone()
        };
        Setting {
            models: s.models.clone(),
            weights: s.weights.clone(),
            sides: s.sides.iter().map(closer).collect(),
            ranges: s.ranges.clone(),
            ..*s
        }
    }

    /// Distance along the axes in shares of their ranges.
    fn apart(&self, a: &[f64], b: &[f64]) -> f64 {
        let each = a.iter().zip(b).zip(&self.setting.ranges[..self.setting.axes]);
        each.map(|((a, b), r)| ((a - b) / r.width()).powi(2)).sum::<f64>().sqrt()
    }

    /// Cells of `left` that are far out, and far from each other.
    fn far_out(&self, mut left: Vec<usize>, count: usize) -> Vec<usize> {
        let mut found: Vec<usize> = Vec::new();
        while found.len() < count {
            let value = |k: usize| {
                let at = &self.cells[k].at;
                let apart = found.iter().map(|j| self.apart(&self.cells[*j].at, at)).fold(1.0, f64::min);
                self.envelope.outside(at).min(1e9) * apart
            };
            let best = (0..left.len())
                .max_by(|a, b| value(left[*a]).total_cmp(&value(left[*b])).then(left[*b].cmp(&left[*a])));
            let Some(best) = best else { break };
            found.push(left.remove(best));
        }
        found
    }

    /// The map at its cells and between them, where it is no filling.
    fn candidates(&self, cells: &[Cell], seed: u64) -> Vec<Vec<f64>> {
        let n = self.setting.axes;
        let mut places: Vec<Vec<f64>> = self.cells.iter().map(|c| c.at.clone()).collect();
        if let Some(mut sequence) = Sobol::new(n, seed) {
            let ranges = &self.setting.ranges[..n];
            let place = |unit: Vec<f64>| ranges.iter().zip(unit).map(|(r, u)| r.value_at(u)).collect();
            places.extend((0..CANDIDATES).map(|_| place(sequence.next_point())));
        }
        let known = |at: &Vec<f64>| {
            let around = corners(self.axes, at);
            around.iter().all(|(k, _)| self.cells[*k].state != CellState::Filled)
        };
        places.iter().filter(|at| known(at)).map(|at| interpolate(self.axes, cells, at)).collect()
    }

    /// Standard deviation of what is minimised, as a share of it.
    fn doubt(&self, x: &[f64]) -> f64 {
        let at = self.setting.judge(x, Status::Stalled, None);
        let share = at.objective_deviation / at.objective.abs();
        if share.is_finite() { share } else { 0.0 }
    }
}
