//! Random records within output limits: blocks are drawn anew until the prediction keeps them.
//!
//! From the first sample on, the free run is followed until an output passes a limit. Then a stretch of one channel that
//! reaches this sample is drawn anew; the draw stays where the first violation comes later, or is smaller at the same
//! sample. Where this does not help for long, a stretch of all channels is drawn anew, twice as long each time the record
//! comes back to the same violation, and followed again. Rates, levels and regions hold at every draw.

use super::forecast::Forecast;
use crate::channel::limits::{ROUNDING, SAME};
use crate::channel::{Layout, SAFE};
use crate::problem::DesignProblem;
use dynocal_numerics::rng::Rng64;

/// Samples that are followed at once.
const CHUNK: usize = 16;
/// Draws at one sample before a longer stretch is drawn anew.
const PATIENCE: usize = 40;
/// Draws for each free value of a record at most, on average.
const DRAWS: usize = 400;

/// What values are drawn from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Values {
    /// All values within the bounds, uniformly.
    Uniform,
    /// So many equally spaced values from bound to bound (at least 2).
    Steps(usize),
}

impl Values {
    fn share(self, rng: &mut Rng64) -> f64 {
        match self {
            Self::Uniform => rng.uniform(),
            Self::Steps(n) => rng.below(n.max(2)) as f64 / (n.max(2) - 1) as f64,
        }
    }
}

/// Draws blocks of one problem anew (see the module).
pub(crate) struct Redraw<'l, 'a> {
    layout: &'l Layout,
    forecast: Forecast<'a>,
    values: Values,
    /// Conditions of regions that read a free value.
    conditions: Vec<Vec<usize>>,
    old: Vec<f64>,
    saved: Vec<f64>,
}

impl<'l, 'a> Redraw<'l, 'a> {
    /// For `problem` with its `layout`; limits are aimed `inside` by a share of their range.
    pub(crate) fn new(problem: &DesignProblem<'a>, layout: &'l Layout, inside: f64, values: Values) -> Self {
        let forecast = Forecast::new(problem, inside);
        let mut conditions = vec![Vec::new(); layout.len()];
        for g in 0..layout.regions.len() {
            for j in layout.regions.variables(g) {
                conditions[j].push(g);
            }
        }
        conditions.iter_mut().for_each(|c: &mut Vec<usize>| c.dedup());
        Self { layout, forecast, values, conditions, old: Vec::new(), saved: Vec::new() }
    }

    /// Whether no output has limits.
    pub(crate) fn is_free(&self) -> bool {
        self.forecast.is_free()
    }

    /// A record of its own, without regard to outputs.
    pub(crate) fn draw(&self, rng: &mut Rng64, x: &mut [f64]) {
        let (lower, upper) = self.layout.bounds();
        for (j, v) in x.iter_mut().enumerate() {
            *v = lower[j] + self.values.share(rng) * (upper[j] - lower[j]);
        }
        self.layout.repair(x);
        self.layout.round(x);
    }

    /// Moves `x`, which keeps all limits of the inputs, into the output limits; `false` where the draws did not suffice.
    pub(crate) fn settle(&mut self, rng: &mut Rng64, x: &mut [f64], stop: &dyn Fn() -> bool) -> bool {
        let n = self.layout.n_samples();
        self.layout.fill(x, self.forecast.record());
        let mut at = self.forecast.changed(0);
        let mut draws = DRAWS * x.len();
        // The furthest violation so far and how far back a stretch begins that is drawn for it; the present one and the draws
        // in vain there.
        let (mut furthest, mut back) = (0, self.least_reach());
        let (mut place, mut vain) = (0, 0);
        while at < n {
            let to = (at + CHUNK).min(n);
            let Some((sample, excess)) = self.forecast.first_violation(at, to) else {
                at = to;
                continue;
            };
            at = sample;
            if sample > furthest {
                (furthest, back) = (sample, self.least_reach());
            }
            if sample != place {
                (place, vain) = (sample, 0);
            }
            if draws == 0 || stop() {
                return false;
            }
            draws -= 1;
            if vain >= PATIENCE {
                (vain, back) = (0, (2 * back).min(sample + 1));
                at = self.start_over(rng, x, (sample + 1).saturating_sub(back), sample);
                continue;
            }
            // However long a stretch is drawn anew after them, single draws stay where they act on this sample.
            let near = self.least_reach().min(sample + 1);
            match self.attempt(rng, x, sample, excess, near) {
                Some(next) => (at, vain) = (next, vain + usize::from(next <= sample)),
                None => vain += 1,
            }
        }
        true
    }

    /// Samples before a violation that a draw may change at first.
    fn least_reach(&self) -> usize {
        self.forecast.reach().1 + 1
    }

    /// Draws a stretch of one channel anew; the sample to go on from where the draw stays.
    fn attempt(
        &mut self,
        rng: &mut Rng64,
        x: &mut [f64],
        sample: usize,
        excess: f64,
        back: usize,
    ) -> Option<usize> {
        let i = rng.below(self.layout.n_channels());
        let range = self.layout.variables(i);
        if range.is_empty() {
            return None;
        }
        let from = (sample + 1).saturating_sub(back);
        let s = from + rng.below(sample + 1 - from);
        let k = range.start + self.layout.knot(i, s).min(range.len() - 1);
        let length = if rng.below(3) == 0 { 1 + rng.below(3) } else { 1 };
        let stretch = k..(k + length).min(range.end);
        self.old.clear();
        self.old.extend_from_slice(&x[stretch.clone()]);
        let first = self.layout.first_sample(i, stretch.start);
        if !self.bridge(rng, i, stretch.clone(), x) || first > sample {
            x[stretch.clone()].copy_from_slice(&self.old);
            return None;
        }
        let last = (self.layout.last_sample(i, stretch.end - 1) + 1).min(self.layout.n_samples());
        self.layout.fill_part(x, i, first..last, self.forecast.record());
        let anew = self.forecast.changed(first);
        let mut saved = std::mem::take(&mut self.saved);
        self.forecast.save(anew, sample + 1, &mut saved);
        let found = self.forecast.first_violation(anew, sample + 1);
        let stays = found.is_none_or(|(s, e)| s == sample && e <= excess);
        if !stays {
            x[stretch].copy_from_slice(&self.old);
            self.layout.fill_part(x, i, first..last, self.forecast.record());
            self.forecast.changed(first);
            self.forecast.restore(anew, sample + 1, &saved);
        }
        self.saved = saved;
        stays.then_some(if found.is_none() { sample + 1 } else { sample })
    }

    /// Draws everything from sample `from` to `to` anew; the sample to follow the record from.
    fn start_over(&mut self, rng: &mut Rng64, x: &mut [f64], from: usize, to: usize) -> usize {
        let mut first = from;
        for i in 0..self.layout.n_channels() {
            let range = self.layout.variables(i);
            if range.is_empty() {
                continue;
            }
            let last = range.len() - 1;
            let stretch = range.start + self.layout.knot(i, from).min(last)
                ..range.start + self.layout.knot(i, to).min(last) + 1;
            self.old.clear();
            self.old.extend_from_slice(&x[stretch.clone()]);
            if !self.bridge(rng, i, stretch.clone(), x) {
                x[stretch.clone()].copy_from_slice(&self.old);
            }
            let begin = self.layout.first_sample(i, stretch.start);
            let end = (self.layout.last_sample(i, stretch.end - 1) + 1).min(self.layout.n_samples());
            self.layout.fill_part(x, i, begin..end, self.forecast.record());
            first = first.min(begin);
        }
        self.forecast.changed(first)
    }

    /// New values for the stretch of channel `i`, within bounds, levels and rates towards what stands around it, and within
    /// all regions; `false` where a draw met none.
    fn bridge(&self, rng: &mut Rng64, i: usize, stretch: std::ops::Range<usize>, x: &mut [f64]) -> bool {
        let (lower, upper) = self.layout.bounds();
        let limit = self.layout.rate(i).map(|r| r * SAFE);
        // From the far end: values from which what follows can still be reached.
        let mut rooms: Vec<(f64, f64)> = stretch.clone().map(|j| (lower[j], upper[j])).collect();
        if let Some(r) = limit {
            let mut next =
                (stretch.end < self.layout.variables(i).end).then(|| (x[stretch.end], x[stretch.end]));
            for room in rooms.iter_mut().rev() {
                if let Some((low, high)) = next {
                    *room = (room.0.max(low - r), room.1.min(high + r));
                }
                next = Some(*room);
            }
        }
        for (j, room) in stretch.clone().zip(&rooms) {
            let (mut low, mut high) = *room;
            if let Some(r) = limit.filter(|_| j > self.layout.variables(i).start) {
                (low, high) = (low.max(x[j - 1] - r), high.min(x[j - 1] + r));
            }
            let wanted = lower[j] + self.values.share(rng) * (upper[j] - lower[j]);
            let levels = self.layout.levels(i);
            x[j] = if levels.is_empty() {
                if low > high {
                    return false;
                }
                wanted.clamp(low, high)
            } else {
                let open: Vec<f64> =
                    levels.iter().copied().filter(|l| low - SAME <= *l && *l <= high + SAME).collect();
                if open.is_empty() {
                    return false;
                }
                open[rng.below(open.len())]
            };
        }
        self.keeps_regions(stretch, x)
    }

    fn keeps_regions(&self, stretch: std::ops::Range<usize>, x: &[f64]) -> bool {
        stretch.flat_map(|j| &self.conditions[j]).all(|g| self.layout.regions.condition(*g, x).0 <= ROUNDING)
    }
}
