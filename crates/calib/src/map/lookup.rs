//! Bilinear interpolation on a grid of two axes, held at its edges.

/// The four corners about a point of a grid (first axis slow, second fast) with their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Corners([(usize, f64); 4]);

impl Corners {
    /// Corners about `(x, y)`; beyond an axis its edge is held.
    pub(super) fn around(slow: &[f64], fast: &[f64], x: f64, y: f64) -> Self {
        let ((i, a), (j, b)) = (locate(slow, x), locate(fast, y));
        let (i1, j1) = ((i + 1).min(slow.len() - 1), (j + 1).min(fast.len() - 1));
        let at = |i: usize, j: usize| i * fast.len() + j;
        Self([
            (at(i, j), (1.0 - a) * (1.0 - b)),
            (at(i, j1), (1.0 - a) * b),
            (at(i1, j), a * (1.0 - b)),
            (at(i1, j1), a * b),
        ])
    }

    /// Value there of a table; `value(k)` is that of its cell `k`.
    pub(super) fn of(&self, value: impl Fn(usize) -> f64) -> f64 {
        self.0.iter().map(|(k, w)| w * value(*k)).sum()
    }
}

/// Interval of `axis` that holds `x` and the position in it (0 to 1, clamped).
fn locate(axis: &[f64], x: f64) -> (usize, f64) {
    let last = axis.len() - 1;
    if last == 0 || x <= axis[0] {
        return (0, 0.0);
    }
    if x >= axis[last] {
        return (last, 0.0);
    }
    let i = axis.partition_point(|v| *v <= x) - 1;
    (i, (x - axis[i]) / (axis[i + 1] - axis[i]))
}
