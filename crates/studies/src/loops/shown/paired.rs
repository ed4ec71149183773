//! Paired comparisons over seeds.

use dynocal_ident::validate::spread::Spread;
use serde::{Deserialize, Serialize};

/// Mean of paired differences a - b over seeds with its 95 % t interval.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Pairs.
    pub n: usize,
    /// Mean of a - b.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Pairs with a > b.
    pub greater: usize,
}

impl Paired {
    /// Of the differences `a - b`; none when lengths differ, fewer than two pairs, or a value is not finite.
    ///
    /// ```
    /// use dynocal_studies::loops::shown::paired::Paired;
    /// let d = Paired::of(&[2.0, 4.0, 6.0], &[1.0, 2.0, 3.0]).unwrap();
    /// assert_eq!((d.mean, d.greater), (2.0, 3));
    /// assert!(d.low < 0.0 && d.high > 4.0);
    /// ```
    pub fn of(a: &[f64], b: &[f64]) -> Option<Self> {
        let d: Vec<f64> = a.iter().zip(b).map(|(x, y)| x - y).collect();
        if a.len() != b.len() || d.len() < 2 || d.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let s = Spread::of(&d, 0.95);
        let greater = d.iter().filter(|v| **v > 0.0).count();
        Some(Self { n: d.len(), mean: s.mean, low: s.low, high: s.high, greater })
    }

    /// Of the logarithms of the ratios `a / b`, so that exp(mean) is the geometric mean ratio.
    pub fn ratios(a: &[f64], b: &[f64]) -> Option<Self> {
        let ln = |v: &[f64]| v.iter().map(|x| x.ln()).collect::<Vec<_>>();
        Self::of(&ln(a), &ln(b))
    }
}

/// Ratio of two sums over seeds with its 95 % interval from the delete-one jackknife.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ratio {
    /// Sum of the first over sum of the second.
    pub ratio: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Ratio {
    /// Of `sum a / sum b`; none for fewer than two pairs or a value that is not finite.
    ///
    /// ```
    /// use dynocal_studies::loops::shown::paired::Ratio;
    /// let r = Ratio::of(&[2.0, 4.0, 6.0, 8.0], &[1.0, 2.0, 3.0, 4.0]).unwrap();
    /// assert!((r.ratio - 2.0).abs() < 1e-14 && (r.high - r.low).abs() < 1e-12);
    /// ```
    pub fn of(a: &[f64], b: &[f64]) -> Option<Self> {
        let n = a.len();
        if n != b.len() || n < 2 || a.iter().chain(b).any(|v| !v.is_finite()) {
            return None;
        }
        let (sa, sb) = (a.iter().sum::<f64>(), b.iter().sum::<f64>());
        let ratio = sa / sb;
        let pseudo: Vec<f64> =
            a.iter().zip(b).map(|(x, y)| n as f64 * ratio - (n as f64 - 1.0) * (sa - x) / (sb - y)).collect();
        let s = Spread::of(&pseudo, 0.95);
        let half = 0.5 * (s.high - s.low);
        Some(Self { ratio, low: ratio - half, high: ratio + half })
    }
}
