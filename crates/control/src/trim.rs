//! Long-term trim: what feedback had to add to a map moves into the map, cell by cell, until feedback has nothing left to do.
//!
//! ```text
//! x = sum_i w_i x_i                                        w_i bilinear in the axes
//! x_i += (1 - exp(-dt/T)) w_i / sum_j w_j^2 * i            i = what the short feedback adds over map and trim
//! i   -= (1 - exp(-dt/T)) i                                handed over: the sum of both stays what it was
//! ```
//!
//! `T` is the memory: of what was learnt in a cell, `exp(-t/T)` is left after a time `t` spent in it. A trim is learnt at rest
//! only: who calls says when that is (a demand that moves shows the feedback what no map is to blame for).

use serde::{Deserialize, Serialize};

use crate::error::ControlError;

/// A map of trims over one or two axes, values row-major with the last axis fastest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LongTrim {
    /// Points of the axes, rising.
    pub axes: Vec<Vec<f64>>,
    /// Trims.
    pub values: Vec<f64>,
    /// Weight with which each was learnt, in s: 0 was never visited.
    pub learnt_s: Vec<f64>,
    /// Memory T in s.
    pub memory_s: f64,
    /// Largest trim either way.
    pub most: f64,
}

/// Cells about a point with their weights; at most four.
type Cells = [(usize, f64); 4];

impl LongTrim {
    /// No trim yet.
    ///
    /// # Errors
    /// [`ControlError`]: axes that do not rise, a memory or largest trim that is not positive.
    pub fn new(axes: Vec<Vec<f64>>, memory_s: f64, most: f64) -> Result<Self, ControlError> {
        let rises = |a: &Vec<f64>| a.len() >= 2 && a.windows(2).all(|p| p[0] < p[1]);
        if axes.is_empty() || axes.len() > 2 || !axes.iter().all(rises) {
            let found = format!("{axes:?}");
            return Err(ControlError::shape(
                "axes of a trim",
                found,
                "one or two of two rising points at least",
            ));
        }
        for (what, v) in [("memory_s", memory_s), ("most", most)] {
            if !(v > 0.0 && v.is_finite()) {
                return Err(ControlError::number(what, v, "a positive number"));
            }
        }
        let n = axes.iter().map(Vec::len).product();
        Ok(Self { axes, values: vec![0.0; n], learnt_s: vec![0.0; n], memory_s, most })
    }

    fn cells(&self, at: &[f64]) -> Cells {
        let along = |axis: &[f64], v: f64| {
            let k = axis.partition_point(|p| *p <= v).clamp(1, axis.len() - 1);
            let share = ((v - axis[k - 1]) / (axis[k] - axis[k - 1])).clamp(0.0, 1.0);
            (k - 1, if share.is_finite() { share } else { 0.0 })
        };
        let (i, a) = along(&self.axes[0], at[0]);
        match self.axes.get(1) {
            None => [(i, 1.0 - a), (i + 1, a), (i, 0.0), (i, 0.0)],
            Some(second) => {
                let (j, b) = along(second, at[1]);
                let n = second.len();
                let own = |di: usize, dj: usize| (i + di) * n + j + dj;
                [
                    (own(0, 0), (1.0 - a) * (1.0 - b)),
                    (own(0, 1), (1.0 - a) * b),
                    (own(1, 0), a * (1.0 - b)),
                    (own(1, 1), a * b),
                ]
            }
        }
    }

    /// The trim at a point of the axes, which is held at their ends.
    pub fn at(&self, at: &[f64]) -> f64 {
        self.cells(at).iter().map(|(k, w)| w * self.values[*k]).sum()
    }

    /// Learns from what feedback adds over a sample; gives how much of it the trim has taken over there.
    ///
    /// ```
    /// use dynocal_control::trim::LongTrim;
    /// let mut trim = LongTrim::new(vec![vec![1000.0, 2000.0]], 10.0, 1.0)?;
    /// let mut feedback = 0.2;
    /// (0..10_000).for_each(|_| feedback -= trim.learn(&[1500.0], feedback, 0.01));
    /// assert!(feedback.abs() < 1e-4 && (trim.at(&[1500.0]) - 0.2).abs() < 1e-4);
    /// # Ok::<(), dynocal_control::error::ControlError>(())
    /// ```
    pub fn learn(&mut self, at: &[f64], feedback: f64, dt_s: f64) -> f64 {
        if !(feedback.is_finite() && at.iter().all(|v| v.is_finite())) {
            return 0.0;
        }
        let cells = self.cells(at);
        let before = self.at(at);
        let size: f64 = cells.iter().map(|(_, w)| w * w).sum();
        let move_by = -(-dt_s / self.memory_s).exp_m1() * feedback / size;
        for (k, w) in cells {
            self.values[k] = (self.values[k] + w * move_by).clamp(-self.most, self.most);
            self.learnt_s[k] += w * dt_s;
        }
        self.at(at) - before
    }

    /// Share of the cells that were visited for a time of `least_s` at least.
    pub fn visited(&self, least_s: f64) -> f64 {
        self.learnt_s.iter().filter(|s| **s >= least_s).count() as f64 / self.learnt_s.len() as f64
    }
}
