//! Places of second derivatives in the lower triangle of the Hessian: wishes are collected, then merged.

use super::columns::FIXED;

/// A place that nothing is written to.
pub(super) const NOWHERE: usize = usize::MAX;

#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    wishes: Vec<(usize, usize)>,
}

impl Places {
    /// Number of the wish for (i, j); [`NOWHERE`] when one of them is no variable.
    pub(super) fn wish(&mut self, i: usize, j: usize) -> usize {
        if i == FIXED || j == FIXED {
            return NOWHERE;
        }
        self.wishes.push((i.max(j), i.min(j)));
        self.wishes.len() - 1
    }

    /// The distinct entries column by column, and where each wish went.
    pub(super) fn merge(self) -> (Vec<(usize, usize)>, Merged) {
        let mut order: Vec<usize> = (0..self.wishes.len()).collect();
        order.sort_unstable_by_key(|&k| (self.wishes[k].1, self.wishes[k].0));
        let mut entries: Vec<(usize, usize)> = Vec::new();
        let mut to = vec![0; self.wishes.len()];
        for k in order {
            if entries.last() != Some(&self.wishes[k]) {
                entries.push(self.wishes[k]);
            }
            to[k] = entries.len() - 1;
        }
        (entries, Merged(to))
    }
}

pub(super) struct Merged(Vec<usize>);

impl Merged {
    pub(super) fn place(&self, wish: usize) -> usize {
        if wish == NOWHERE { NOWHERE } else { self.0[wish] }
    }
}
