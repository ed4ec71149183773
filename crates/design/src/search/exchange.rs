//! Exchange over levels: the record on the nearest levels is moved into the output limits, annealed and polished.
//!
//! 1. Blocks are drawn anew where an output passes its limits (module `redraw`), starting from the nearest record on the
//!    levels, or from random ones where this leads nowhere.
//! 2. One or two free values at a time go to other levels by Metropolis' rule, with a temperature that falls to zero; a
//!    pair moves two values of one channel, or one each of two channels at about the same time, so that one can give the
//!    other the room that an output limit leaves. Whether a move keeps the output limits is asked of the free run alone,
//!    before anything is paid for its criterion. The values of channels without levels move on a mesh.
//! 3. One free value after the other is tried on every other level until nothing helps (coordinate exchange, R. K. Meyer &
//!    C. J. Nachtsheim, Technometrics 37 (1995) 60-69).

use super::Chain;
use super::forecast::Forecast;
use super::redraw::{Redraw, Values};
use crate::channel::Layout;
use crate::channel::limits::SAME;
use crate::problem::DesignProblem;
use dynocal_numerics::rng::Rng64;

/// First and last mesh of the channels without levels.
const MESH: (f64, f64) = (0.1, 1e-3);
/// Random records that are tried where the nearest one cannot be moved into the output limits.
const FRESH: u64 = 8;
/// First temperature as a share of the median change of the objective by one move.
const WARM: f64 = 0.3;
/// Moves that this median is taken from.
const SAMPLED: usize = 40;
/// Moves tried for each evaluation at most: most of them may be refused by limits alone.
const TRIES: usize = 30;
/// Passes over all free values that are kept for the polish.
const SWEEPS: usize = 8;
/// Share of moves that change two values.
const PAIRS: f64 = 0.4;

/// Puts the best design of `chain` on the levels and improves it there with a budget of its own. Nothing happens
/// without levels.
pub(crate) fn exchange(chain: &mut Chain, problem: &DesignProblem, evaluations: usize) {
    let layout = chain.evaluator.layout().clone();
    if !layout.has_levels() {
        return;
    }
    let Some(mut best) = chain.best.take() else { return };
    chain.grant(evaluations);
    let mut rng = Rng64::new(chain.rng.below(1 << 48) as u64);
    onto_levels(chain, problem, &layout, &mut rng, &mut best.x);
    let at = chain.value(&best.x);
    let mut e = Exchange {
        forecast: Forecast::new(problem, 0.0),
        layout: &layout,
        x: best.x.clone(),
        at,
        best: (best.x.clone(), at),
        saved: Vec::new(),
    };
    e.load();
    e.anneal(chain, &mut rng);
    e.polish(chain);
    (best.f, best.violation) = e.best.1;
    best.x = e.best.0;
    best.multipliers = None;
    // A record is converged where no exchange of a single value was left that helps.
    best.converged = chain.left() > 0;
    chain.best = Some(best);
}

/// The nearest record on the levels, within the output limits where draws lead there.
fn onto_levels(chain: &mut Chain, problem: &DesignProblem, layout: &Layout, rng: &mut Rng64, x: &mut [f64]) {
    layout.round(x);
    let mut redraw = Redraw::new(problem, layout, 0.0, Values::Uniform);
    if redraw.is_free() || chain.value(x).1 <= 0.0 {
        return;
    }
    let nearest = x.to_vec();
    for fresh in 0..=FRESH {
        if fresh > 0 {
            redraw.draw(rng, x);
        }
        if redraw.settle(rng, x, &|| chain.interrupted()) && chain.value(x).1 <= 0.0 {
            return;
        }
    }
    x.copy_from_slice(&nearest);
}

/// One record on its way.
struct Exchange<'l, 'a> {
    forecast: Forecast<'a>,
    layout: &'l Layout,
    x: Vec<f64>,
    /// Objective and violation of `x`, and the best record so far.
    at: (f64, f64),
    best: (Vec<f64>, (f64, f64)),
    saved: Vec<f64>,
}

/// A free value and where it goes.
type Step = (usize, usize, f64);

impl Exchange<'_, '_> {
    /// The record into the forecast.
    fn load(&mut self) {
        self.layout.fill(&self.x, self.forecast.record());
        self.forecast.changed(0);
        if self.at.1 <= 0.0 {
            self.forecast.first_violation(0, self.layout.n_samples());
        }
    }

    fn anneal(&mut self, chain: &mut Chain, rng: &mut Rng64) {
        let budget = chain.left() - (SWEEPS * self.sweep_length()).min(chain.left() / 3);
        let (end, mut tries) = (chain.left() - budget, TRIES * budget);
        let mut changes = Vec::with_capacity(SAMPLED);
        let mut first = f64::INFINITY;
        while chain.left() > end && tries > 0 {
            tries -= 1;
            let cold = 1.0 - (chain.left() - end) as f64 / budget.max(1) as f64;
            let steps = self.draw(rng, cold);
            let Some(found) = self.evaluated(chain, &steps) else { continue };
            if changes.len() < SAMPLED && found.1 <= 0.0 && self.at.1 <= 0.0 {
                changes.push((found.0 - self.at.0).abs());
                if changes.len() == SAMPLED {
                    changes.sort_by(f64::total_cmp);
                    first = WARM * changes[SAMPLED / 2];
                }
            }
            // Until the size of changes is known only what helps stays.
            let temperature = if first.is_finite() { first * (1.0 - cold) } else { 0.0 };
            let worse = -temperature * (1.0 - rng.uniform()).ln();
            self.keep_or_undo(chain, &steps, found, worse);
        }
        // The polish starts at the best record.
        (self.x, self.at) = self.best.clone();
        self.load();
        chain.note(self.at.0, self.at.1, f64::NAN);
    }

    /// One or two random steps.
    fn draw(&self, rng: &mut Rng64, cold: f64) -> Vec<Step> {
        let m = self.layout.n_channels();
        let mut i = rng.below(m);
        while self.layout.variables(i).is_empty() {
            i = rng.below(m);
        }
        let range = self.layout.variables(i);
        let j = range.start + rng.below(range.len());
        let mut steps = vec![(i, j, self.target(rng, i, j, cold))];
        if rng.uniform() < PAIRS {
            let (other, sample) = (rng.below(m), self.layout.first_sample(i, j));
            let range = self.layout.variables(other);
            if !range.is_empty() {
                // At about the same time: as far away as an output still sees both.
                let reach = self.forecast.reach().1 + 1;
                let from = sample.saturating_sub(reach);
                let near = from + rng.below((sample + reach).min(self.layout.n_samples() - 1) - from + 1);
                let k = range.start + self.layout.knot(other, near).min(range.len() - 1);
                if k != j {
                    steps.push((other, k, self.target(rng, other, k, cold)));
                }
            }
        }
        steps
    }

    fn target(&self, rng: &mut Rng64, i: usize, j: usize, cold: f64) -> f64 {
        let (levels, (lower, upper)) = (self.layout.levels(i), self.layout.bounds());
        match levels.is_empty() {
            false => levels[rng.below(levels.len())],
            true => {
                let size = MESH.0 * (MESH.1 / MESH.0).powf(cold);
                (self.x[j] + size * rng.normal()).clamp(lower[j], upper[j])
            }
        }
    }

    /// Objective and violation after `steps`, which stay made; none, with nothing changed, where they are refused by the
    /// limits or change nothing.
    fn evaluated(&mut self, chain: &mut Chain, steps: &[Step]) -> Option<(f64, f64)> {
        let (lower, upper) = self.layout.bounds();
        let open = |(_, j, to): &Step| lower[*j] - SAME <= *to && *to <= upper[*j] + SAME;
        if !steps.iter().all(open) || steps.iter().all(|(_, j, to)| self.x[*j] == *to) {
            return None;
        }
        self.saved.clear();
        for (_, j, to) in steps {
            self.saved.push(std::mem::replace(&mut self.x[*j], *to));
        }
        let rates = steps.iter().all(|(i, j, _)| rates_kept(self.layout, &self.x, *i, *j));
        if !rates || self.layout.region_violation(&self.x) > 0.0 {
            self.undo(steps);
            return None;
        }
        if !self.forecast.is_free() && self.at.1 <= 0.0 && !self.forecast_keeps(steps) {
            self.undo(steps);
            return None;
        }
        Some(chain.value(&self.x))
    }

    /// Whether the free run after `steps` keeps the output limits; the forecast follows the record.
    fn forecast_keeps(&mut self, steps: &[Step]) -> bool {
        let first = self.follow(steps);
        self.forecast.first_violation(first, self.layout.n_samples()).is_none()
    }

    /// Moves the samples of `steps` in the forecast; the first one to be computed anew.
    fn follow(&mut self, steps: &[Step]) -> usize {
        let n = self.layout.n_samples();
        let mut first = n;
        for (i, j, _) in steps {
            let from = self.layout.first_sample(*i, *j);
            let to = (self.layout.last_sample(*i, *j) + 1).min(n);
            self.layout.fill_part(&self.x, *i, from..to, self.forecast.record());
            first = first.min(self.forecast.changed(from));
        }
        first
    }

    fn undo(&mut self, steps: &[Step]) {
        for ((_, j, _), old) in steps.iter().zip(&self.saved).rev() {
            self.x[*j] = *old;
        }
        if !self.forecast.is_free() && self.at.1 <= 0.0 {
            let first = self.follow(steps);
            self.forecast.first_violation(first, self.layout.n_samples());
        }
    }

    /// Keeps a record that is better, or worse by no more than `worse`.
    fn keep_or_undo(&mut self, chain: &Chain, steps: &[Step], found: (f64, f64), worse: f64) -> bool {
        if !chain.better((found.0 - worse, found.1), self.at) {
            self.undo(steps);
            return false;
        }
        let first_within = found.1 <= 0.0 && self.at.1 > 0.0;
        self.at = found;
        if first_within {
            self.load();
        }
        if chain.better(self.at, self.best.1) {
            self.best = (self.x.clone(), self.at);
        }
        true
    }

    /// Evaluations of one pass over all free values at most.
    fn sweep_length(&self) -> usize {
        let values = |i: usize| self.layout.levels(i).len().max(3) - 1;
        (0..self.layout.n_channels()).map(|i| self.layout.variables(i).len() * values(i)).sum()
    }

    fn polish(&mut self, chain: &mut Chain) {
        let free = |i: usize| self.layout.levels(i).is_empty() && !self.layout.variables(i).is_empty();
        let mut mesh = if (0..self.layout.n_channels()).any(free) { MESH.0 } else { MESH.1 };
        while chain.left() > 0 {
            let moved = self.sweep(chain, mesh);
            chain.note(self.at.0, self.at.1, mesh);
            if !moved && mesh <= MESH.1 {
                break;
            }
            if !moved {
                mesh *= 0.5;
            }
        }
    }

    /// One pass over all free values; whether any was improved.
    fn sweep(&mut self, chain: &mut Chain, mesh: f64) -> bool {
        let (lower, upper) = (self.layout.bounds().0.to_vec(), self.layout.bounds().1.to_vec());
        let mut moved = false;
        for i in 0..self.layout.n_channels() {
            for j in self.layout.variables(i) {
                let levels = self.layout.levels(i);
                let trials: Vec<f64> = match levels.is_empty() {
                    true => [mesh, -mesh].iter().map(|d| (self.x[j] + d).clamp(lower[j], upper[j])).collect(),
                    false => levels.to_vec(),
                };
                for to in trials {
                    if chain.left() == 0 {
                        return true;
                    }
                    let step = [(i, j, to)];
                    let Some(found) = self.evaluated(chain, &step) else { continue };
                    moved |= self.keep_or_undo(chain, &step, found, 0.0);
                }
            }
        }
        moved
    }
}

/// Levels may lie a rounding further apart than the rate limit, other values may not.
fn rates_kept(layout: &Layout, x: &[f64], i: usize, j: usize) -> bool {
    let slack = if layout.levels(i).is_empty() { 0.0 } else { SAME };
    let range = layout.variables(i);
    let Some(limit) = layout.rate(i) else { return true };
    let kept = |a: usize, b: usize| (x[b] - x[a]).abs() <= limit * (1.0 + slack);
    (j == range.start || kept(j - 1, j)) && (j + 1 == range.end || kept(j, j + 1))
}
