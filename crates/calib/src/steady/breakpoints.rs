//! Fewer breakpoints of a map, chosen so that what lies between them is interpolated with the least error.
//!
//! ```text
//! minimise   E(S) = sum_l sum_k w_k [ f_l(k) - interpolation of f_l over the breakpoints S at k ]^2      over S of given size, ends kept
//! ```
//!
//! f are tables over the full axes (l: quantity, in shares of its range; k: cell). On one axis the error is a sum over the segments
//! between breakpoints, so that dynamic programming finds the least of all choices. On two axes it is done in turns: with the
//! breakpoints of the other axis given, the interpolation along it is known, and the same sum remains.
//!
//! Reference: R. Bellman, On the approximation of curves by line segments using dynamic programming, Comm. ACM 4 (1961), 284.

use super::grid::corners;

/// Tables over one or two axes, the last axis fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Tables {
    /// Values of the axes.
    pub axes: Vec<Vec<f64>>,
    /// Quantities, each with a value for every cell, in scales that make them comparable.
    pub layers: Vec<Vec<f64>>,
    /// Weight of each cell; 0 where it does not count.
    pub weights: Vec<f64>,
}

/// Turns of two axes after which the choice is taken as it is.
const TURNS: usize = 20;

impl Tables {
    /// Numbers of the breakpoints that are kept on each axis, `counts` of them (at least 2, at most all).
    pub fn choose(&self, counts: &[usize]) -> Vec<Vec<usize>> {
        let mut kept: Vec<Vec<usize>> = self.axes.iter().map(|a| (0..a.len()).collect()).collect();
        let mut least = f64::INFINITY;
        for _ in 0..TURNS {
            let before = kept.clone();
            for k in 0..self.axes.len() {
                kept[k] =
                    self.along(k, &kept, counts[k].clamp(2.min(self.axes[k].len()), self.axes[k].len()));
            }
            let error = self.error(&kept);
            if !(error < least) {
                // The first turn sees the other axis in full and may have been the better one.
                return if least.is_finite() { before } else { kept };
            }
            least = error;
        }
        kept
    }

    /// Sum of the weighted squared errors with the breakpoints `kept`.
    pub fn error(&self, kept: &[Vec<usize>]) -> f64 {
        let axes: Vec<Vec<f64>> =
            self.axes.iter().zip(kept).map(|(a, k)| k.iter().map(|i| a[*i]).collect()).collect();
        let places = places(&self.axes, kept);
        let at = |k: usize| super::grid::place(&self.axes, k);
        let cells = (0..self.weights.len()).filter(|k| self.weights[*k] > 0.0);
        cells
            .map(|k| {
                let around = corners(&axes, &at(k));
                let square = |layer: &Vec<f64>| {
                    let between: f64 = around.iter().map(|(c, w)| w * layer[places[*c]]).sum();
                    (layer[k] - between).powi(2)
                };
                self.weights[k] * self.layers.iter().map(square).sum::<f64>()
            })
            .sum()
    }

    /// The best `count` breakpoints of axis `k`, the other axis having those in `kept`.
    fn along(&self, k: usize, kept: &[Vec<usize>], count: usize) -> Vec<usize> {
        let lines = Lines::new(self, k, kept);
        let n = self.axes[k].len();
        // cost[a n + b]: error of the samples from a up to b, b left out.
        let mut cost = vec![0.0; n * n];
        for a in 0..n {
            for b in a + 1..n {
                cost[a * n + b] = lines.segment(a, b);
            }
        }
        // least[m][b]: least error up to b with m segments; from[m][b]: where the last of them begins.
        let segments = count - 1;
        let mut least = vec![vec![f64::INFINITY; n]; segments + 1];
        let mut from = vec![vec![0; n]; segments + 1];
        least[0][0] = 0.0;
        for m in 1..=segments {
            for b in m..n {
                for a in m - 1..b {
                    let error = least[m - 1][a] + cost[a * n + b];
                    if error < least[m][b] {
                        (least[m][b], from[m][b]) = (error, a);
                    }
                }
            }
        }
        let mut chosen = vec![n - 1];
        for m in (1..=segments).rev() {
            chosen.push(from[m][chosen[chosen.len() - 1]]);
        }
        chosen.reverse();
        chosen
    }
}

/// Numbers of the cells at the kept breakpoints, the last axis fastest.
pub fn places(axes: &[Vec<f64>], kept: &[Vec<usize>]) -> Vec<usize> {
    axes.iter().zip(kept).fold(vec![0], |all, (axis, kept)| {
        all.iter().flat_map(|base| kept.iter().map(move |i| base * axis.len() + i)).collect()
    })
}

/// Tables seen along one axis, with what the breakpoints of the other make of each sample.
struct Lines<'a> {
    axis: &'a [f64],
    /// Values by layer, then along the axis, then across.
    exact: Vec<f64>,
    /// The same, interpolated across.
    across: Vec<f64>,
    weights: Vec<f64>,
    layers: usize,
    width: usize,
}

impl<'a> Lines<'a> {
    fn new(t: &'a Tables, k: usize, kept: &[Vec<usize>]) -> Self {
        let n = t.axes[k].len();
        let other = (0..t.axes.len()).find(|o| *o != k);
        let width = other.map_or(1, |o| t.axes[o].len());
        let cell = |i: usize, j: usize| if k == 0 { i * width + j } else { j * n + i };
        let (mut exact, mut across) = (Vec::new(), Vec::new());
        for layer in &t.layers {
            for i in 0..n {
                for j in 0..width {
                    exact.push(layer[cell(i, j)]);
                    across.push(match other {
                        None => layer[cell(i, j)],
                        Some(o) => {
                            let breaks: Vec<f64> = kept[o].iter().map(|b| t.axes[o][*b]).collect();
                            let around = corners(&[breaks], &[t.axes[o][j]]);
                            around.iter().map(|(c, w)| w * layer[cell(i, kept[o][*c])]).sum()
                        }
                    });
                }
            }
        }
        let weights =
            (0..n).flat_map(|i| (0..width).map(move |j| (i, j))).map(|(i, j)| t.weights[cell(i, j)]);
        Self { axis: &t.axes[k], exact, across, weights: weights.collect(), layers: t.layers.len(), width }
    }

    /// Error of the samples from `a` up to `b` between breakpoints at both; `b` counts at the end of the axis only.
    fn segment(&self, a: usize, b: usize) -> f64 {
        let n = self.axis.len();
        let last = if b == n - 1 { b } else { b - 1 };
        let mut sum = 0.0;
        for i in a..=last {
            let share = (self.axis[i] - self.axis[a]) / (self.axis[b] - self.axis[a]);
            for j in 0..self.width {
                let weight = self.weights[i * self.width + j];
                if weight == 0.0 {
                    continue;
                }
                for l in 0..self.layers {
                    let at = |i: usize| (l * n + i) * self.width + j;
                    let between = (1.0 - share) * self.across[at(a)] + share * self.across[at(b)];
                    sum += weight * (self.exact[at(i)] - between).powi(2);
                }
            }
        }
        sum
    }
}
