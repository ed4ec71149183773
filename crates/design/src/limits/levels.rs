//! Channels that may take certain levels only: nearest record on the levels, then exchange over levels.
//!
//! The search works between the levels as if all values were allowed. Its record is then moved to the nearest one on
//! the levels that keeps rates, start and end (dynamic programming, exact),
//!
//! ```text
//! min sum_j (l_j - x_j)^2,   l_j a level,  |l_j - l_{j-1}| <= rate,  start and end as given
//! ```
//!
//! and improved by exchange: one free value after the other is tried on every other level, the values of the other
//! channels on a mesh that is halved, until nothing helps (coordinate exchange, R. K. Meyer & C. J. Nachtsheim,
//! Technometrics 37 (1995) 60-69).

use crate::channel::Layout;
use crate::error::{DesignError, tidy};
use crate::search::Chain;

/// Levels and bounds agree up to this share of the range.
const SAME: f64 = 1e-9;
/// Sweeps of projections for the channels without levels.
const SWEEPS: usize = 500;
/// First and last mesh of the channels without levels.
const MESH: (f64, f64) = (0.1, 1e-3);

impl Layout {
    /// Moves the channels with levels to the nearest record on them, then the others into their regions. Nothing
    /// happens without levels; `false` where no such record exists.
    pub fn round(&self, x: &mut [f64]) -> bool {
        if !self.has_levels() {
            return true;
        }
        for i in 0..self.n_channels() {
            if !self.levels(i).is_empty() && self.nearest(i, x).is_err() {
                return false;
            }
        }
        if self.region_violation(x) > 0.0 {
            // Only what has no levels may still move.
            let found = self.frozen(x).project(x, SWEEPS);
            return found && self.region_violation(x) == 0.0;
        }
        true
    }

    /// Whether a record on the levels exists at all.
    ///
    /// # Errors
    /// [`DesignError::Conflict`] with the channel whose levels are too far apart for its rate limit.
    pub(crate) fn check_levels_reach(&self, x: &mut [f64]) -> Result<(), DesignError> {
        for i in (0..self.n_channels()).filter(|i| !self.levels(*i).is_empty()) {
            self.nearest(i, x).map_err(|k| {
                let c = &self.channels()[i];
                let gap = self.levels(i).windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
                let gap = gap * (c.upper - c.lower);
                let rate = c.rate_per_sample.unwrap_or(f64::INFINITY);
                DesignError::Conflict {
                    first: format!("{} levels (the nearest two are {} apart)", c.name, tidy(gap)),
                    second: format!("rate limit {rate} per sample, start and end"),
                    by: (gap - rate).max(0.0),
                    sample: Some(k * c.hold),
                }
            })?;
        }
        Ok(())
    }

    /// The same layout with the channels that have levels fixed at `x`.
    fn frozen(&self, x: &[f64]) -> Layout {
        let fixed = (0..self.n_channels()).filter(|i| !self.levels(*i).is_empty());
        self.fixed_at(fixed.flat_map(|i| self.variables(i)), x)
    }

    /// Nearest values of channel `i` on its levels; an error names the free value that no level can reach.
    fn nearest(&self, i: usize, x: &mut [f64]) -> Result<(), usize> {
        let (levels, range) = (self.levels(i), self.variables(i));
        let (lower, upper) = self.bounds();
        let first = range.start;
        let limit = self.rates().iter().find(|r| range.contains(&r.j)).map_or(f64::INFINITY, |r| r.limit);
        let allowed = |j: usize, l: f64| lower[j] - SAME <= l && l <= upper[j] + SAME;
        let n = levels.len();
        let mut cost = vec![f64::INFINITY; n];
        let mut from = vec![0usize; range.len() * n];
        for (k, j) in range.clone().enumerate() {
            let mut next = vec![f64::INFINITY; n];
            for (a, l) in levels.iter().enumerate().filter(|(_, l)| allowed(j, **l)) {
                let reach = |b: &usize| k == 0 || (levels[*b] - l).abs() <= limit * (1.0 + SAME);
                let before = (0..n).filter(reach).min_by(|b, c| cost[*b].total_cmp(&cost[*c]));
                let Some(b) = before else { continue };
                from[k * n + a] = b;
                next[a] = (l - x[j]).powi(2) + if k == 0 { 0.0 } else { cost[b] };
            }
            if next.iter().all(|c| c.is_infinite()) {
                return Err(k);
            }
            cost = next;
        }
        let mut at = (0..n).min_by(|a, b| cost[*a].total_cmp(&cost[*b])).unwrap_or(0);
        for k in (0..range.len()).rev() {
            x[first + k] = levels[at];
            at = from[k * n + at];
        }
        Ok(())
    }
}

/// Puts the best design of `chain` on the levels and improves it there with a budget of its own. Nothing happens
/// without levels.
pub(crate) fn exchange(chain: &mut Chain, evaluations: usize) {
    let layout = chain.evaluator.layout().clone();
    let Some(mut best) = chain.best.take() else { return };
    if !layout.has_levels() {
        chain.best = Some(best);
        return;
    }
    layout.round(&mut best.x);
    chain.grant(evaluations);
    let mut at = chain.value(&best.x);
    let smooth =
        (0..layout.n_channels()).any(|i| layout.levels(i).is_empty() && !layout.variables(i).is_empty());
    let mut mesh = if smooth { MESH.0 } else { MESH.1 };
    best.converged = false;
    while chain.left() > 0 {
        let moved = sweep(chain, &layout, &mut best.x, &mut at, mesh);
        chain.note(at.0, at.1, mesh);
        if !moved && mesh <= MESH.1 {
            best.converged = chain.left() > 0;
            break;
        }
        if !moved {
            mesh *= 0.5;
        }
    }
    (best.f, best.violation, best.multipliers) = (at.0, at.1, None);
    chain.best = Some(best);
}

/// One pass over all free values; whether any was improved.
fn sweep(chain: &mut Chain, layout: &Layout, x: &mut [f64], at: &mut (f64, f64), mesh: f64) -> bool {
    let (lower, upper) = layout.bounds();
    let mut moved = false;
    for i in 0..layout.n_channels() {
        for j in layout.variables(i) {
            let levels = layout.levels(i);
            let trials: Vec<f64> = match levels.is_empty() {
                true => [mesh, -mesh].iter().map(|d| (x[j] + d).clamp(lower[j], upper[j])).collect(),
                false => levels
                    .iter()
                    .copied()
                    .filter(|l| lower[j] - SAME <= *l && *l <= upper[j] + SAME)
                    .collect(),
            };
            for to in trials {
                let before = x[j];
                if chain.left() == 0 || to == before {
                    continue;
                }
                x[j] = to;
                if rates_kept(layout, x, i, j) {
                    let found = chain.value(x);
                    if chain.better(found, *at) {
                        (*at, moved) = (found, true);
                        continue;
                    }
                }
                x[j] = before;
            }
        }
    }
    moved
}

/// Levels may lie a rounding further apart than the rate limit, other values may not.
fn rates_kept(layout: &Layout, x: &[f64], i: usize, j: usize) -> bool {
    let slack = if layout.levels(i).is_empty() { 0.0 } else { SAME };
    let near = layout.rates().iter().filter(|r| r.j == j || r.j == j + 1);
    near.into_iter().all(|r| (x[r.j] - x[r.j - 1]).abs() <= r.limit * (1.0 + slack))
}
