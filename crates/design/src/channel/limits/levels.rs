//! Channels that may take certain levels only: nearest record on the levels, then exchange over levels.
//!
//! The search works between the levels as if all values were allowed. Its record is then moved to the nearest one on
//! the levels that keeps rates, start and end (dynamic programming, exact),
//!
//! ```text
//! min sum_j (l_j - x_j)^2,   l_j a level,  |l_j - l_{j-1}| <= rate,  start and end as given
//! ```
//!
//! and improved by exchange (module `exchange`).

use super::SAME;
use crate::channel::Layout;
use crate::error::{DesignError, tidy};

/// Sweeps of projections for the channels without levels.
const SWEEPS: usize = 500;

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
