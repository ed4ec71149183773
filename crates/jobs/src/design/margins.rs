//! Margins of the output limits, and bands of the predictions.

use dynocal_design::schedule::{self, Basis, Schedule};
use dynocal_ident::validate::boundary::{Coverage, coverage};
use serde::{Deserialize, Serialize};

use super::loaded::Loaded;

/// What a margin stands on, in a spec.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MarginBasis {
    /// A key of the spec.
    Given,
    /// A share of the range: nothing is known.
    Range,
    /// Held-out blocks, too few for a quantile.
    FewBlocks,
    /// The quantile of held-out blocks.
    Quantile,
}

/// A margin with what it stands on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarginUsed {
    /// Distance inside the identified region, in the unit of the output.
    pub value: f64,
    /// Distance that the search kept: larger where the plan leaves the identified region near a limit.
    pub kept: f64,
    /// Stated share of blocks that pass a limit by the error of the model.
    pub rate: f64,
    /// Samples of a block.
    pub block: usize,
    /// Held-out blocks.
    pub blocks: usize,
    /// What it stands on.
    pub basis: MarginBasis,
}

/// Least length of a block that is taken where the spec does not say one, in samples and in longest lags.
const BLOCK: (usize, usize) = (20, 4);

/// Samples of a block: the time over which an error is one event.
pub(super) fn block_of(m: &Loaded) -> usize {
    let default = (BLOCK.1 * m.model.max_lag()).max(BLOCK.0);
    m.limits.as_ref().and_then(|l| l.block).unwrap_or(default)
}

/// The margin of a model with limits; none without limits.
pub fn margin_of(m: &Loaded) -> Option<MarginUsed> {
    let limits = m.limits.as_ref()?;
    let block = block_of(m);
    let used = |value: f64, blocks: usize, basis: MarginBasis| MarginUsed {
        value,
        kept: value,
        rate: limits.rate,
        block,
        blocks,
        basis,
    };
    if let Some(value) = limits.margin {
        return Some(used(value, 0, MarginBasis::Given));
    }
    let scores = schedule::block_scores(m.model.as_ref(), &m.theta, &m.held_out, block, m.boundary.as_ref());
    match schedule::margin(&scores, limits.rate) {
        Some(q) if q.basis == Basis::Quantile => Some(used(q.value, q.blocks, MarginBasis::Quantile)),
        Some(q) => Some(used(q.value, q.blocks, MarginBasis::FewBlocks)),
        None => {
            let first =
                Schedule { rate: limits.rate, ..Schedule::default() }.first(limits.upper - limits.lower);
            Some(used(first.value, 0, MarginBasis::Range))
        }
    }
}

/// Distances of a plan `u` (N x m) with the predicted output `y` (N) to what was identified, from sample `first` on.
pub(super) fn distances(m: &Loaded, u: &[f64], y: &[f64], first: usize) -> Option<Coverage> {
    m.boundary.as_ref().map(|b| coverage(b, u, y, first))
}

/// Half width of the band along a plan.
pub(super) fn band(margin: &MarginUsed, distances: Option<&Coverage>, n: usize) -> Vec<f64> {
    match distances {
        None => vec![margin.value; n],
        Some(c) => schedule::growth(&c.distances, margin.block).iter().map(|g| margin.value * g).collect(),
    }
}
