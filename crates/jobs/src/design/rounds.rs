//! Margins from round to round.
//!
//! The margin of a search is one number, the band of a plan grows where the plan leaves what was identified: which margin makes
//! the band touch its limit is known only from a plan. A margin whose band passes the limit is too small; one that was widened
//! until the band keeps it may be far too large, as the plan then stays where the band is narrow. Between the two it is halved.

use super::margins::MarginUsed;
use super::result::SafetyLine;

/// Designs that are made at most.
pub(super) const MOST_ROUNDS: usize = 6;
/// Margins stay below this share of the range, so that something is left.
const MOST_MARGIN: f64 = 0.45;
/// Too small and large enough lie this near together, as a share of the range: good enough.
const NEAR: f64 = 0.02;

/// What is known of the margin of each model.
#[derive(Debug, Default)]
pub(super) struct Bracket {
    /// Largest margin whose band passed a limit, smallest whose band kept it.
    known: Vec<(Option<f64>, Option<f64>)>,
}

impl Bracket {
    /// Margins for a further round after one with bands as `safety` says; whether any has changed.
    pub(super) fn next(&mut self, margins: &mut [Option<MarginUsed>], safety: &[SafetyLine]) -> bool {
        self.known.resize(margins.len(), (None, None));
        let mut any = false;
        for ((margin, line), (small, large)) in margins.iter_mut().zip(safety).zip(&mut self.known) {
            let (Some(q), Some(limits), Some(least)) = (margin, line.limits, line.least_distance_of_band)
            else {
                continue;
            };
            let (range, over) = (limits.width(), least.distance);
            if over < 0.0 {
                *small = Some(small.map_or(q.kept, |v| v.max(q.kept)));
            } else {
                *large = Some(large.map_or(q.kept, |v| v.min(q.kept)));
            }
            let next = match (*small, *large) {
                (Some(small), Some(large)) if large - small > NEAR * range => 0.5 * (small + large),
                (Some(_), None) => (q.kept - 1.05 * over).min(MOST_MARGIN * range).max(q.kept),
                _ => q.kept,
            };
            any |= next != q.kept;
            q.kept = next;
        }
        any
    }
}

/// Whether all bands keep their limits.
pub(super) fn bands_keep(safety: &[SafetyLine]) -> bool {
    safety.iter().filter_map(|s| s.least_distance_of_band).all(|d| d.distance >= 0.0)
}
