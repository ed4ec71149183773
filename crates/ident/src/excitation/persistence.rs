//! Order of persistence of excitation of an input.
//!
//! An input is persistently exciting of order n when its n lags u(t), u(t-1) .. u(t-n+1) are linearly independent: a
//! model with n lags of it can then be identified. With the columns in this order and a QR factor of them,
//!
//! ```text
//! share(k) = |R_kk| / |column k|
//! ```
//!
//! is the part of the k-th lag that the lags before it do not explain; the order is the number of lags up to the first
//! share below the tolerance. (L. Ljung, System Identification, 2nd ed., section 13.2.)

use dynocal_numerics::linalg::{LinalgError, QrWork, norm2};
use serde::Serialize;

/// Order of one input.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Persistence {
    /// Largest n for which n lags are independent, at most the number that was tested.
    pub order: usize,
    /// Number of lags that were tested.
    pub tested: usize,
    /// Part of lag 0, 1, .. that the lags before it (and the constant) do not explain, 0 to 1.
    pub shares: Vec<f64>,
}

/// Order of the input with the samples `segments` (stretches without missing samples). With `offset` the lags must
/// also be independent of a constant term, as models of channels with a zero of their own have one: k sines then
/// have order 2 k whatever their mean.
///
/// # Errors
/// [`LinalgError::NotFinite`].
///
/// ```
/// use dynocal_ident::excitation::persistence::persistence;
/// let u: Vec<f64> = (0..200).map(|t| 5.0 + (0.3 * t as f64).sin() + (1.1 * t as f64).cos()).collect();
/// assert_eq!(persistence(&[&u], 20, 1e-6, true).unwrap().order, 4);
/// ```
pub fn persistence(
    segments: &[&[f64]],
    max_order: usize,
    tolerance: f64,
    offset: bool,
) -> Result<Persistence, LinalgError> {
    let ones = usize::from(offset);
    // As many rows as columns at least, or the rank would be that of the record's length.
    let rows = |order: usize| -> usize { segments.iter().map(|s| (s.len() + 1).saturating_sub(order)).sum() };
    let tested = (0..=max_order).rev().find(|n| rows(*n) >= 2 * (n + ones)).unwrap_or(0);
    let width = tested + ones;
    let mut factor = Accumulated::new(width);
    let mut row = vec![1.0; width];
    for s in segments {
        for t in tested.max(1) - 1..s.len() {
            for k in 0..tested {
                row[ones + k] = s[t - k];
            }
            factor.push(&row)?;
        }
    }
    let r = factor.finish()?;
    let share = |k: usize| {
        let column: Vec<f64> = (ones..=k).map(|i| r[i * width + k]).collect();
        let length = norm2(&column);
        // A lag that is its constant up to rounding moves by nothing.
        let whole = norm2(&(0..=k).map(|i| r[i * width + k]).collect::<Vec<_>>());
        if length > 1e-12 * whole { r[k * width + k].abs() / length } else { 0.0 }
    };
    let shares: Vec<f64> = (ones..width).map(share).collect();
    let order = shares.iter().position(|s| *s < tolerance).unwrap_or(tested);
    Ok(Persistence { order, tested, shares })
}

/// R factor of rows that come one by one.
struct Accumulated {
    width: usize,
    work: QrWork,
    block: Vec<f64>,
    filled: usize,
}

const BLOCK: usize = 1024;

impl Accumulated {
    fn new(width: usize) -> Self {
        let rows = width + BLOCK;
        Self { width, work: QrWork::new(rows, width), block: vec![0.0; rows * width], filled: width }
    }

    fn push(&mut self, row: &[f64]) -> Result<(), LinalgError> {
        let at = self.filled * self.width;
        self.block[at..at + self.width].copy_from_slice(row);
        self.filled += 1;
        if self.filled == self.width + BLOCK { self.reduce() } else { Ok(()) }
    }

    /// The rows so far become the first `width` ones: their R factor.
    fn reduce(&mut self) -> Result<(), LinalgError> {
        if let Some(index) = self.block.iter().position(|v| !v.is_finite()) {
            return Err(LinalgError::NotFinite { what: "input", index });
        }
        let mut r = vec![0.0; self.width * self.width];
        self.work.r_factor(&self.block, &mut r)?;
        self.block.fill(0.0);
        self.block[..r.len()].copy_from_slice(&r);
        self.filled = self.width;
        Ok(())
    }

    fn finish(mut self) -> Result<Vec<f64>, LinalgError> {
        if self.width > 0 {
            self.reduce()?;
        }
        self.block.truncate(self.width * self.width);
        Ok(self.block)
    }
}
