//! Which samples of a record are fitted, which select, and which only test.

use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use crate::experiment::Experiment;
use crate::model::Model;

/// How samples are chosen for selection and test. The free run passes through all of them; only the weights differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Division {
    /// The end of each record tests, the part before it selects.
    #[default]
    End,
    /// Blocks of consecutive samples, drawn at random.
    Blocks,
    /// Single samples, drawn at random (thesis section 7.4). In a slow record each has fitted neighbours: the scores
    /// then say little about other records.
    Random,
}

/// Weights of the squared errors of one record for each use, N each.
#[derive(Clone, Debug)]
pub(super) struct Weights {
    pub(super) fit: Vec<f64>,
    pub(super) selection: Vec<f64>,
    pub(super) test: Vec<f64>,
}

/// Shares and their arrangement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shares {
    pub(super) division: Division,
    pub(super) selection: f64,
    pub(super) test: f64,
    /// Samples per block.
    pub(super) block: usize,
    pub(super) seed: u64,
}

/// Stream of the division, apart from those of the starts.
const STREAM: u64 = 1 << 40;

/// Weights of all records. Samples that only initialise, or that are missing, belong to none.
pub(super) fn divide(model: &dyn Model, data: &[Experiment], shares: &Shares) -> Vec<Weights> {
    let of = |(i, e): (usize, &Experiment)| {
        let first = e.first(model).min(e.len());
        let uses = arrange(e.len() - first, shares, &mut Rng64::stream(shares.seed, STREAM + i as u64));
        let weight = |t: usize, what: Use| {
            let own = t >= first && uses[t - first] == what && e.y[t].is_finite();
            if own { e.weight(t) } else { 0.0 }
        };
        let all = |what| (0..e.len()).map(|t| weight(t, what)).collect();
        Weights { fit: all(Use::Fit), selection: all(Use::Selection), test: all(Use::Test) }
    };
    data.iter().enumerate().map(of).collect()
}

/// The same without any selection or test.
pub(super) fn whole(model: &dyn Model, data: &[Experiment]) -> Vec<Weights> {
    let none = Shares { division: Division::End, selection: 0.0, test: 0.0, block: 1, seed: 0 };
    divide(model, data, &none)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Use {
    Fit,
    Selection,
    Test,
}

/// Use of each of `n` samples.
fn arrange(n: usize, shares: &Shares, rng: &mut Rng64) -> Vec<Use> {
    let block = match shares.division {
        Division::Random => 1,
        Division::Blocks => shares.block.clamp(1, n.max(1)),
        Division::End => n.max(1),
    };
    let count = |share: f64, of: usize| (share.clamp(0.0, 0.9) * of as f64).round() as usize;
    if shares.division == Division::End {
        let (selection, test) = (count(shares.selection, n), count(shares.test, n));
        let fit = n.saturating_sub(selection + test);
        return (0..n)
            .map(|t| match t {
                t if t < fit => Use::Fit,
                t if t < n - test.min(n) => Use::Selection,
                _ => Use::Test,
            })
            .collect();
    }
    let blocks = n.div_ceil(block);
    let (selection, test) = (count(shares.selection, blocks), count(shares.test, blocks));
    let mut order: Vec<usize> = (0..blocks).collect();
    for i in (1..blocks).rev() {
        order.swap(i, rng.below(i + 1));
    }
    let mut of_block = vec![Use::Fit; blocks];
    order.iter().take(selection).for_each(|b| of_block[*b] = Use::Selection);
    order.iter().skip(selection).take(test).for_each(|b| of_block[*b] = Use::Test);
    (0..n).map(|t| of_block[t / block]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(division: Division, block: usize) -> Vec<Use> {
        let shares = Shares { division, selection: 0.15, test: 0.15, block, seed: 3 };
        let uses = arrange(1000, &shares, &mut Rng64::new(1));
        let count = |what| uses.iter().filter(|u| **u == what).count();
        assert_eq!(
            (count(Use::Fit), count(Use::Selection), count(Use::Test)),
            (700, 150, 150),
            "{division:?}"
        );
        uses
    }

    #[test]
    fn shares_are_met_and_blocks_stay_together() {
        let end = counts(Division::End, 1);
        assert!(end[699] == Use::Fit && end[700] == Use::Selection && end[850] == Use::Test);
        let blocks = counts(Division::Blocks, 50);
        assert!(blocks.chunks(50).all(|b| b.iter().all(|u| *u == b[0])));
        let changes = |v: &[Use]| v.windows(2).filter(|w| w[0] != w[1]).count();
        // Six of twenty blocks leave the fit: at most twelve seams; single samples have far more.
        assert!(changes(&blocks) <= 12 && changes(&counts(Division::Random, 1)) > 200);
    }
}
