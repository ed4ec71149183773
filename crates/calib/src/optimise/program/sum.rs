//! Sums over samples, their limits, and soft limits on columns.

use std::ops::Range;

use super::columns::Columns;
use super::product::Product;

/// A limit on a sum over all samples.
#[derive(Clone, Debug, PartialEq)]
pub struct SumLimit {
    /// Summands.
    pub sum: Sum,
    /// Greatest value.
    pub upper: f64,
}

/// A sum of products over samples `from..to`.
#[derive(Clone, Debug, PartialEq)]
pub struct Sum {
    /// The product.
    pub product: Product,
    /// First sample.
    pub from: usize,
    /// One past the last.
    pub to: usize,
}

impl Sum {
    pub(super) fn samples(&self) -> Range<usize> {
        self.from..self.to
    }

    /// Its value.
    pub fn value(&self, columns: &Columns) -> f64 {
        self.value_of(columns.all(), columns.width())
    }

    /// Its value for these columns, samples x `width`.
    pub fn value_of(&self, values: &[f64], width: usize) -> f64 {
        self.samples().map(|t| self.product.value(t, &values[t * width..(t + 1) * width])).sum()
    }
}

/// A soft limit on a column: `price` times the sum of what is beyond it at the decided samples.
#[derive(Clone, Debug, PartialEq)]
pub struct SoftLimit {
    /// Column.
    pub column: usize,
    /// Whether values above are meant; else below.
    pub above: bool,
    /// Limit of each sample (N).
    pub limit: Vec<f64>,
    /// Price of one unit beyond it at one sample.
    pub price: f64,
}
