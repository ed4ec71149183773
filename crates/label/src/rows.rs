//! Rows of a sparse least-squares problem: which cells an operating point reads, and with which weights.

/// Sparse rows, one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// End of each row in `at` and `weight`.
    ends: Vec<usize>,
    at: Vec<usize>,
    weight: Vec<f64>,
}

impl Rows {
    /// Begins a row.
    pub fn start(&mut self) {
        self.ends.push(self.at.len());
    }

    /// Adds an entry to the last row (one must have been started; an entry that comes twice counts twice).
    pub fn push(&mut self, column: usize, weight: f64) {
        if weight == 0.0 {
            return;
        }
        self.at.push(column);
        self.weight.push(weight);
        if let Some(end) = self.ends.last_mut() {
            *end = self.at.len();
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Columns and weights of row `k`.
    pub fn row(&self, k: usize) -> (&[usize], &[f64]) {
        let from = if k == 0 { 0 } else { self.ends[k - 1] };
        (&self.at[from..self.ends[k]], &self.weight[from..self.ends[k]])
    }

    /// Row `k` times `x`.
    pub fn times(&self, k: usize, x: &[f64]) -> f64 {
        let (at, weight) = self.row(k);
        at.iter().zip(weight).map(|(j, w)| w * x[*j]).sum()
    }
}

/// Lower neighbour of `x` among strictly increasing `points`, and the share of the way to the upper one. Outside it is the edge: an ECU
/// does not extrapolate.
pub fn between(points: &[f64], x: f64) -> (usize, f64) {
    let n = points.len();
    if n < 2 || !(x > points[0]) {
        return (0, 0.0);
    }
    if x >= points[n - 1] {
        return (n - 2, 1.0);
    }
    let i = points.partition_point(|p| *p <= x) - 1;
    (i, (x - points[i]) / (points[i + 1] - points[i]))
}
