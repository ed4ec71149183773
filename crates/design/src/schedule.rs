//! Margins of output limits from held-out errors, and how limits are relaxed from one iteration to the next.
//!
//! A model's own covariance says little about its error where its structure is wrong, and then that error dominates.
//! What counts is the free-run error e on records that the model has not seen, block by block, each error in units of
//! how far the samples before it lie outside what was identified (d of [`dynocal_ident::validate::boundary`]; L is the
//! length of a block, the memory of the error):
//!
//! ```text
//! g(t) = max(1, max_{s = t-L .. t} d(s)^2)
//! score of a block  s_b = max_t |e(t)| / g(t)
//! margin            q: P(score of a new block > q) <= rate
//! band of a plan    y(t) +- q g(t)
//! ```
//!
//! The square is the order of the first term that a model with the right slopes leaves out. It widens the band in the
//! right direction, but no number from inside the region can promise a rate outside of it: a plan that leaves the
//! region is for small steps with a supervisor.
//!
//! With n blocks and `k = ceil((n + 1)(1 - rate)) <= n`, q is the k-th smallest score: the bound holds for any
//! distribution as long as new blocks are exchangeable with the held-out ones (split conformal prediction with
//! scaled errors; J. Lei et al., J. Am. Stat. Assoc. 113 (2018) 1094-1111). With fewer blocks no such number exists;
//! q is then the prediction bound `n (rate^(-1/n) - 1) mean(s)` of exponential scores (J. F. Lawless, Technometrics 13
//! (1971) 725-730), which is conservative for block maxima because they scatter less, and never below the largest score.
//!
//! The schedule (thesis section 4.4): a share of the range before anything is known, then the bound, but not less
//! than a share of the margin before, because a design goes where the records so far have not been.

use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::validate::boundary::{BoundaryModel, coverage};
use serde::{Deserialize, Serialize};

/// What a margin stands on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// Nothing but the range of the limits.
    Range,
    /// Held-out blocks, too few for a quantile: the bound of exponential scores.
    FewBlocks,
    /// The quantile of the held-out blocks.
    Quantile,
    /// The margin of the iteration before, which was larger.
    Kept,
}

/// A margin with what it stands on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Margin {
    /// Distance to keep from both limits inside the identified region, in the unit of the output.
    pub value: f64,
    /// Largest share of blocks that may pass a limit by the error of the model.
    pub rate: f64,
    /// Blocks that it was taken from.
    pub blocks: usize,
    /// What it stands on.
    pub basis: Basis,
}

/// Scores of held-out blocks (see the module): the free-run errors of `model` on `records` that it has not seen, in
/// blocks of `block` samples. What is left at the end of a record joins its last block. A block with a free run that
/// is not finite has an infinite score.
pub fn block_scores(
    model: &dyn Model,
    theta: &[f64],
    records: &[Experiment],
    block: usize,
    boundary: Option<&BoundaryModel>,
) -> Vec<f64> {
    let mut out = Vec::new();
    let block = block.max(1);
    for e in records {
        let first = e.first(model).min(e.len());
        let mut y = vec![0.0; e.len()];
        model.simulate(theta, &e.run(model), &mut y);
        // The plan will know its predicted outputs only, so that these give the distance here too.
        let growth = boundary.map(|b| growth(&coverage(b, &e.u, &y, first).distances, block));
        let score = |t: usize| {
            let size = (e.y[t] - y[t]).abs() / growth.as_ref().map_or(1.0, |g| g[t]);
            if y[t].is_finite() { size } else { f64::INFINITY }
        };
        let samples = e.len() - first;
        let count = (samples / block).max(usize::from(samples > 0));
        for b in 0..count {
            let to = if b + 1 == count { e.len() } else { first + (b + 1) * block };
            // A sample that was not measured is no error: NaN loses every comparison.
            out.push((first + b * block..to).map(score).fold(0.0, f64::max));
        }
    }
    out
}

/// The margin of a stated `rate` from the scores of held-out blocks; none without a block.
///
/// ```
/// use dynocal_design::schedule::{Basis, margin};
/// // 19 blocks are enough for 5 %: the largest of them.
/// let scores: Vec<f64> = (1..=19).map(f64::from).collect();
/// let q = margin(&scores, 0.05).unwrap();
/// assert_eq!((q.value, q.basis), (19.0, Basis::Quantile));
/// // Four are not.
/// let few = margin(&scores[..4], 0.05).unwrap();
/// assert!(few.value > 10.0 && few.basis == Basis::FewBlocks);
/// ```
pub fn margin(scores: &[f64], rate: f64) -> Option<Margin> {
    let n = scores.len();
    let rate = rate.clamp(1e-6, 1.0);
    let mut sorted = scores.to_vec();
    sorted.sort_by(f64::total_cmp);
    let largest = *sorted.last()?;
    // The last bits of (n + 1)(1 - rate) must not ask for one block more.
    let rank = (((n + 1) as f64) * (1.0 - rate) - 1e-9).ceil() as usize;
    if rank <= n {
        let value = sorted[rank.max(1) - 1];
        return Some(Margin { value, rate, blocks: n, basis: Basis::Quantile });
    }
    let size = n as f64;
    let mean = scores.iter().sum::<f64>() / size;
    let value = (size * (rate.powf(-1.0 / size) - 1.0) * mean).max(largest);
    Some(Margin { value, rate, blocks: n, basis: Basis::FewBlocks })
}

/// Growth g of the error along a plan (see the module) from its distances d to what was identified; `block` samples
/// are the memory.
///
/// ```
/// use dynocal_design::schedule::growth;
/// assert_eq!(growth(&[0.5, 2.0, 0.7, 0.1, 0.2], 2), [1.0, 4.0, 4.0, 4.0, 1.0]);
/// ```
pub fn growth(distances: &[f64], block: usize) -> Vec<f64> {
    let recent = |t: usize| distances[t.saturating_sub(block)..=t].iter().fold(1.0f64, |a, d| a.max(*d));
    (0..distances.len()).map(|t| recent(t).powi(2)).collect()
}

/// How the margin of one output goes from iteration to iteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Schedule {
    /// Largest share of blocks that may pass a limit by the error of the model.
    pub rate: f64,
    /// Margin before anything is known, as a share of the range of the limits.
    pub first_share: f64,
    /// Least share of the margin before that the next one keeps.
    pub keep: f64,
}

impl Default for Schedule {
    fn default() -> Self {
        Self { rate: 0.05, first_share: 0.2, keep: 0.5 }
    }
}

impl Schedule {
    /// Margin of the first iteration within limits of the range `range`.
    pub fn first(&self, range: f64) -> Margin {
        Margin { value: self.first_share * range, rate: self.rate, blocks: 0, basis: Basis::Range }
    }

    /// The next margin from the held-out `scores` of the present model: it grows at once where the errors ask for it
    /// and shrinks by steps. Without a block it stays.
    pub fn next(&self, before: &Margin, scores: &[f64]) -> Margin {
        let kept = self.keep * before.value;
        match margin(scores, self.rate) {
            None => *before,
            Some(m) if m.value < kept => Margin { value: kept, basis: Basis::Kept, ..m },
            Some(m) => m,
        }
    }
}
