//! Correlation functions with one length per input (ARD), as functions of the squared scaled distance.
//!
//! ```text
//! r^2 = sum_j (x_j - x'_j)^2 / l_j^2
//! squared exponential   k = exp(-r^2/2)
//! Matern 3/2            k = (1 + a) exp(-a),           a = sqrt(3) r
//! Matern 5/2            k = (1 + a + a^2/3) exp(-a),   a = sqrt(5) r
//! ```
//!
//! Reference: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), section 4.2.

use serde::{Deserialize, Serialize};

/// Which correlation function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kernel {
    /// Infinitely smooth.
    SquaredExponential,
    /// Once differentiable.
    Matern32,
    /// Twice differentiable.
    #[default]
    Matern52,
}

/// Correlation and its first two derivatives with respect to r^2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correlation {
    /// k.
    pub value: f64,
    /// dk/d(r^2).
    pub slope: f64,
    /// d^2k/d(r^2)^2; 0 at r = 0 for Matern 3/2, where only its product with the squared difference has a limit (0).
    pub curvature: f64,
}

impl Kernel {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::SquaredExponential, Self::Matern32, Self::Matern52];

    /// Name in the user's words.
    pub fn words(self) -> &'static str {
        match self {
            Self::SquaredExponential => "squared exponential",
            Self::Matern32 => "Matern 3/2",
            Self::Matern52 => "Matern 5/2",
        }
    }

    /// Correlation and slope with respect to r^2.
    #[inline(always)]
    pub fn value_slope(self, r2: f64) -> (f64, f64) {
        match self {
            Self::SquaredExponential => {
                let e = exp(-0.5 * r2);
                (e, -0.5 * e)
            }
            Self::Matern32 => {
                let a = (3.0 * r2).sqrt();
                let e = exp(-a);
                ((1.0 + a) * e, -1.5 * e)
            }
            Self::Matern52 => {
                let a = (5.0 * r2).sqrt();
                let e = exp(-a);
                ((1.0 + a + a * a / 3.0) * e, -5.0 / 6.0 * (1.0 + a) * e)
            }
        }
    }

    /// Correlation with both derivatives.
    pub fn correlation(self, r2: f64) -> Correlation {
        let (value, slope) = self.value_slope(r2);
        Correlation { value, slope, curvature: self.curvature(r2) }
    }

    #[inline(always)]
    fn curvature(self, r2: f64) -> f64 {
        match self {
            Self::SquaredExponential => 0.25 * exp(-0.5 * r2),
            Self::Matern32 => {
                let a = (3.0 * r2).sqrt();
                if a > 0.0 { 2.25 * exp(-a) / a } else { 0.0 }
            }
            Self::Matern52 => 25.0 / 12.0 * exp(-(5.0 * r2).sqrt()),
        }
    }

    /// Turns squared distances into d^2k/d(r^2)^2, in place.
    #[inline(always)]
    pub(super) fn curve(self, r2: &mut [f64]) {
        match self {
            Self::SquaredExponential => {
                r2.iter_mut().for_each(|x| *x = Self::SquaredExponential.curvature(*x))
            }
            Self::Matern32 => r2.iter_mut().for_each(|x| *x = Self::Matern32.curvature(*x)),
            Self::Matern52 => r2.iter_mut().for_each(|x| *x = Self::Matern52.curvature(*x)),
        }
    }

    /// Turns squared distances into correlations, in place, and writes the slopes beside them.
    #[inline(always)]
    pub(super) fn apply(self, r2: &mut [f64], slope: &mut [f64]) {
        // One loop a kernel, so that the compiler can keep each in vector registers.
        match self {
            Self::SquaredExponential => each(r2, slope, |r2| Self::SquaredExponential.value_slope(r2)),
            Self::Matern32 => each(r2, slope, |r2| Self::Matern32.value_slope(r2)),
            Self::Matern52 => each(r2, slope, |r2| Self::Matern52.value_slope(r2)),
        }
    }
}

#[inline(always)]
fn each(r2: &mut [f64], slope: &mut [f64], of: impl Fn(f64) -> (f64, f64)) {
    for (value, slope) in r2.iter_mut().zip(slope) {
        (*value, *slope) = of(*value);
    }
}

/// exp(x) for x <= 0 without branches or calls, so that loops over it run in vector registers; below -708 it is 0.
///
/// x = k ln 2 + r, |r| <= ln 2 / 2; exp(r) by its series to r^13 (truncation below 4e-18); 2^k through the exponent bits.
/// Reference: W. J. Cody, W. Waite, Software Manual for the Elementary Functions (1980), chapter 6.
#[inline(always)]
fn exp(x: f64) -> f64 {
    // ln 2 in two parts, so that k ln 2 is subtracted without rounding.
    const HIGH: f64 = 6.931_471_803_691_238e-1;
    const LOW: f64 = 1.908_214_929_270_587_7e-10;
    // Adding 1.5 * 2^52 rounds to the nearest whole number, which then stands in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let clipped = if x < -708.0 { -708.0 } else { x };
    let shifted = clipped * std::f64::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = (clipped - k * HIGH) - k * LOW;
    let mut p = 1.0 / 6_227_020_800.0;
    p = p * r + 1.0 / 479_001_600.0;
    p = p * r + 1.0 / 39_916_800.0;
    p = p * r + 1.0 / 3_628_800.0;
    p = p * r + 1.0 / 362_880.0;
    p = p * r + 1.0 / 40_320.0;
    p = p * r + 1.0 / 5_040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    let e = 1.0 + r + r * r * p;
    let power = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52));
    if x < -708.0 { 0.0 } else { e * power }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_exponential_agrees_with_that_of_the_library() {
        for i in 0..200_000 {
            let x = -f64::from(i) * 0.00354;
            let (own, library) = (exp(x), x.exp());
            assert!((own - library).abs() <= 4e-16 * library, "exp({x}): {own} against {library}");
        }
        assert_eq!((exp(0.0), exp(-1e9), exp(f64::NEG_INFINITY)), (1.0, 0.0, 0.0));
        assert!(exp(f64::NAN).is_nan());
    }

    #[test]
    fn derivatives_with_respect_to_the_squared_distance_are_those_of_differences() {
        for kernel in Kernel::ALL {
            for r2 in [0.01, 0.3, 1.0, 4.0, 20.0] {
                let h = 1e-5 * r2;
                let (up, down) = (kernel.correlation(r2 + h), kernel.correlation(r2 - h));
                let at = kernel.correlation(r2);
                let slope = (up.value - down.value) / (2.0 * h);
                let curvature = (up.slope - down.slope) / (2.0 * h);
                assert!((at.slope - slope).abs() < 1e-8 * (slope.abs() + 1e-3), "{kernel:?} {r2}");
                assert!(
                    (at.curvature - curvature).abs() < 1e-8 * (curvature.abs() + 1e-3),
                    "{kernel:?} {r2}"
                );
            }
        }
    }
}
