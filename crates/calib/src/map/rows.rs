//! Rows of numbers over time: N samples of a fixed number of channels, row-major.

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

/// N x width numbers, time down the rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rows {
    width: usize,
    values: Vec<f64>,
}

impl Rows {
    /// No row yet, of `width` columns.
    pub fn new(width: usize) -> Self {
        Self { width, values: Vec::new() }
    }

    /// Rows from row-major values; what does not fill a row is left out.
    pub fn from_values(width: usize, mut values: Vec<f64>) -> Self {
        values.truncate(values.len() / width.max(1) * width);
        Self { width, values }
    }

    /// Rows from columns of equal length; longer columns are cut to the shortest.
    pub fn from_columns(columns: &[&[f64]]) -> Self {
        let n = columns.iter().map(|c| c.len()).min().unwrap_or(0);
        let values = (0..n).flat_map(|t| columns.iter().map(move |c| c[t])).collect();
        Self { width: columns.len(), values }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.values.len() / self.width.max(1)
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Row `t`.
    pub fn row(&self, t: usize) -> &[f64] {
        &self.values[t * self.width..(t + 1) * self.width]
    }

    /// Row `t` to be written.
    pub fn row_mut(&mut self, t: usize) -> &mut [f64] {
        &mut self.values[t * self.width..(t + 1) * self.width]
    }

    /// All rows in order.
    pub fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.width.max(1))
    }

    /// Adds a row of [`Rows::width`] values.
    pub fn push(&mut self, row: &[f64]) {
        debug_assert_eq!(row.len(), self.width);
        self.values.extend_from_slice(row);
    }

    /// Column `k`, copied.
    pub fn column(&self, k: usize) -> Vec<f64> {
        self.iter().map(|r| r[k]).collect()
    }

    /// Replaces column `k`; values beyond the last row are left out.
    pub fn set_column(&mut self, k: usize, values: &[f64]) {
        let width = self.width;
        for (row, v) in self.values.chunks_exact_mut(width.max(1)).zip(values) {
            row[k] = *v;
        }
    }

    /// The first `n` rows.
    pub fn truncate(&mut self, n: usize) {
        self.values.truncate(n * self.width);
    }

    /// All values, row-major.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Least and largest value of every column.
    pub fn spans(&self) -> Vec<Interval> {
        let mut spans = vec![Interval::spanning([]); self.width];
        for row in self.iter() {
            for (s, v) in spans.iter_mut().zip(row) {
                *s = s.including(*v);
            }
        }
        spans
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_and_rows_are_two_views_of_one_thing() {
        let mut rows = Rows::from_columns(&[&[1.0, 2.0, 3.0], &[4.0, 5.0, 6.0]]);
        assert_eq!((rows.len(), rows.width(), rows.row(1)), (3, 2, &[2.0, 5.0][..]));
        rows.push(&[0.0, 9.0]);
        rows.set_column(0, &[7.0]);
        assert_eq!(rows.column(0), [7.0, 2.0, 3.0, 0.0]);
        assert_eq!(rows.spans(), [Interval::new(0.0, 7.0), Interval::new(4.0, 9.0)]);
        rows.truncate(1);
        assert_eq!(rows.values(), [7.0, 4.0]);
    }
}
