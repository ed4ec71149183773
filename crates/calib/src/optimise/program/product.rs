//! Monomials of the columns of one sample, and affine readings of them.
//!
//! ```text
//! v(t) = g(t) prod_k x_k(t)^(p_k)          g(t): factor and imposed channels
//! ```

/// A monomial of columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Product {
    /// Factor of each sample (N).
    pub gain: Vec<f64>,
    /// Columns with their powers.
    pub powers: Vec<(usize, i32)>,
}

impl Product {
    /// Value at sample `t`, whose columns are `row`.
    pub fn value(&self, t: usize, row: &[f64]) -> f64 {
        self.powers.iter().fold(self.gain[t], |v, &(c, p)| v * row[c].powi(p))
    }

    /// Derivative with respect to column `k` of [`Product::powers`].
    pub fn slope(&self, t: usize, row: &[f64], k: usize) -> f64 {
        let (c, p) = self.powers[k];
        self.except(t, row, k, k) * f64::from(p) * row[c].powi(p - 1)
    }

    /// Second derivative with respect to columns `k` and `l` of [`Product::powers`].
    pub fn second(&self, t: usize, row: &[f64], k: usize, l: usize) -> f64 {
        let rest = self.except(t, row, k, l);
        let slope = |(c, p): (usize, i32)| f64::from(p) * row[c].powi(p - 1);
        match k == l {
            false => rest * slope(self.powers[k]) * slope(self.powers[l]),
            true => {
                let (c, p) = self.powers[k];
                rest * f64::from(p * (p - 1)) * if p == 1 { 0.0 } else { row[c].powi(p - 2) }
            }
        }
    }

    /// Whether the second derivative with respect to columns `k` and `l` is zero everywhere.
    pub fn is_straight(&self, k: usize, l: usize) -> bool {
        k == l && self.powers[k].1 == 1
    }

    fn except(&self, t: usize, row: &[f64], k: usize, l: usize) -> f64 {
        let kept = self.powers.iter().enumerate().filter(|(i, _)| *i != k && *i != l);
        kept.fold(self.gain[t], |v, (_, &(c, p))| v * row[c].powi(p))
    }
}

/// What a model reads for one of its inputs.
#[derive(Clone, Debug, PartialEq)]
pub enum Reading {
    /// Imposed: a value per sample (N).
    Given(Vec<f64>),
    /// `shift + gain x`.
    Linear {
        /// Column.
        column: usize,
        /// Gain.
        gain: f64,
        /// Shift.
        shift: f64,
    },
    /// `shift` and a product.
    Product {
        /// The product.
        product: Product,
        /// Shift.
        shift: f64,
    },
}

impl Reading {
    /// Value at sample `t`.
    pub fn value(&self, t: usize, row: &[f64]) -> f64 {
        match self {
            Self::Given(values) => values[t],
            Self::Linear { column, gain, shift } => shift + gain * row[*column],
            Self::Product { product, shift } => shift + product.value(t, row),
        }
    }

    /// Columns that it reads.
    pub fn columns(&self) -> Vec<usize> {
        match self {
            Self::Given(_) => Vec::new(),
            Self::Linear { column, .. } => vec![*column],
            Self::Product { product, .. } => product.powers.iter().map(|p| p.0).collect(),
        }
    }

    /// Derivative with respect to its `k`-th column.
    pub fn slope(&self, t: usize, row: &[f64], k: usize) -> f64 {
        match self {
            Self::Given(_) => 0.0,
            Self::Linear { gain, .. } => *gain,
            Self::Product { product, .. } => product.slope(t, row, k),
        }
    }

    /// Second derivative with respect to its `k`-th and `l`-th column.
    pub fn second(&self, t: usize, row: &[f64], k: usize, l: usize) -> f64 {
        match self {
            Self::Product { product, .. } => product.second(t, row, k, l),
            _ => 0.0,
        }
    }

    /// Whether that second derivative is zero everywhere.
    pub fn is_straight(&self, k: usize, l: usize) -> bool {
        match self {
            Self::Product { product, .. } => product.is_straight(k, l),
            _ => true,
        }
    }

    /// The column whose value gives `value`, for a reading of one column; the reading undone.
    pub fn invert(&self, t: usize, value: f64) -> f64 {
        match self {
            Self::Given(values) => values[t],
            Self::Linear { gain, shift, .. } => (value - shift) / gain,
            Self::Product { product, shift } => {
                let ratio = (value - shift) / product.gain[t];
                match product.powers[0].1 {
                    1 => ratio,
                    -1 => 1.0 / ratio,
                    p => ratio.signum() * ratio.abs().powf(1.0 / f64::from(p)),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_central_differences() {
        let p = Product { gain: vec![0.7, 1.3], powers: vec![(0, 2), (2, -1), (1, 1)] };
        let row = [1.4, -0.6, 2.2];
        let h = 1e-5;
        for k in 0..3 {
            let moved = |by: f64| {
                let mut r = row;
                r[p.powers[k].0] += by;
                r
            };
            let slope = (p.value(1, &moved(h)) - p.value(1, &moved(-h))) / (2.0 * h);
            assert!((slope - p.slope(1, &row, k)).abs() < 1e-9);
            for l in 0..3 {
                let second = (p.slope(1, &moved(h), l) - p.slope(1, &moved(-h), l)) / (2.0 * h);
                assert!((second - p.second(1, &row, l, k)).abs() < 1e-9, "{k} {l}");
                assert!(!p.is_straight(k, l) || p.second(1, &row, k, l) == 0.0);
            }
        }
    }

    #[test]
    fn readings_of_one_column_are_undone() {
        let product = Product { gain: vec![2.0], powers: vec![(0, -1)] };
        for r in
            [Reading::Linear { column: 0, gain: -3.0, shift: 0.4 }, Reading::Product { product, shift: -0.2 }]
        {
            assert!((r.invert(0, r.value(0, &[0.9])) - 0.9).abs() < 1e-14);
        }
    }
}
