//! Logarithm and exponential of several numbers at once, for loops that compile to vector instructions.
//!
//! Additions, multiplications and shifts alone, so that every machine gives the same bits, whatever its C library.

/// Natural logarithms of positive, normal numbers; within 2 ulp, or 1e-16 near 1.
///
/// ```text
/// x = 2^k m,  m in [sqrt(1/2), sqrt(2)),  s = (m - 1)/(m + 1)
/// ln x = k ln 2 + 2 s (1 + s^2/3 + s^4/5 + ...)
/// ```
///
/// ```
/// let [a, b] = dynocal_numerics::lanes::ln([1.0, 10.0]);
/// assert!(a == 0.0 && (b - 10f64.ln()).abs() < 1e-15);
/// ```
#[inline(always)]
pub fn ln<const N: usize>(x: [f64; N]) -> [f64; N] {
    // ln 2 in a part whose product with any k is exact, and the rest.
    const HIGH: f64 = 0.693_147_180_369_123_8;
    const LOW: f64 = 1.908_214_929_270_587_7e-10;
    // Added to an integer below 2^51 it leaves the integer in the low bits of the sum.
    const MAGIC: u64 = 0x4330_0000_0000_0000;
    let mut out = [0.0; N];
    for i in 0..N {
        // Exponents counted from sqrt(1/2), so that m falls about 1.
        let shifted = x[i].to_bits().wrapping_sub(0x3fe6_a09e_667f_3bcd);
        let biased = shifted.wrapping_add(1 << 62) >> 52;
        let k = f64::from_bits(MAGIC | biased) - (f64::from_bits(MAGIC) + 1024.0);
        let m = f64::from_bits((shifted & 0x000f_ffff_ffff_ffff).wrapping_add(0x3fe6_a09e_667f_3bcd));
        let f = m - 1.0;
        let s = f / (m + 1.0);
        let z = s * s;
        let (z2, z4) = (z * z, z * z * z * z);
        let low = (1.0 / 3.0 + z / 5.0) + z2 * (1.0 / 7.0 + z / 9.0);
        let high = (1.0 / 11.0 + z / 13.0) + z2 * (1.0 / 15.0 + z / 17.0);
        let top = 1.0 / 19.0 + z / 21.0;
        let series = z * (low + z4 * (high + z4 * top));
        // 2 s = f - s f: the leading part without the rounding of s.
        out[i] = k * HIGH + (f - (s * f - (2.0 * s * series + k * LOW)));
    }
    out
}

/// Exponentials of numbers between -700 and 700 (those outside count as the bound); within 2 ulp.
///
/// ```text
/// x = n ln 2 + r,  |r| <= ln(2)/2,  e^x = 2^n (1 + r + r^2/2! + ... + r^13/13!)
/// ```
///
/// ```
/// let [a, b] = dynocal_numerics::lanes::exp([0.0, -1.0]);
/// assert!(a == 1.0 && (b - (-1f64).exp()).abs() < 1e-16);
/// ```
#[inline(always)]
pub fn exp<const N: usize>(x: [f64; N]) -> [f64; N] {
    const HIGH: f64 = 0.693_147_180_369_123_8;
    const LOW: f64 = 1.908_214_929_270_587_7e-10;
    // 1.5 2^52: a sum with it is rounded to an integer, which stands in its low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let mut out = [0.0; N];
    for i in 0..N {
        let x = if x[i] > 700.0 { 700.0 } else { x[i] };
        let x = if x < -700.0 { -700.0 } else { x };
        let sum = x * std::f64::consts::LOG2_E + ROUND;
        let n = sum - ROUND;
        let r = (x - n * HIGH) - n * LOW;
        let (r2, r4) = (r * r, r * r * r * r);
        let a = (1.0 / 2.0 + r / 6.0) + r2 * (1.0 / 24.0 + r / 120.0);
        let b = (1.0 / 720.0 + r / 5040.0) + r2 * (1.0 / 40_320.0 + r / 362_880.0);
        let c = (1.0 / 3_628_800.0 + r / 39_916_800.0) + r2 * (1.0 / 479_001_600.0 + r / 6_227_020_800.0);
        let value = 1.0 + (r + r2 * (a + r4 * (b + r4 * c)));
        out[i] = f64::from_bits(value.to_bits().wrapping_add(sum.to_bits() << 52));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distance in units of the last place of the expected value.
    fn ulps(found: f64, expected: f64) -> f64 {
        let place = f64::from_bits(expected.abs().to_bits() + 1) - expected.abs();
        (found - expected).abs() / place
    }

    #[test]
    fn logarithms_and_exponentials_agree_with_the_c_library() {
        let mut worst = (0.0f64, 0.0f64);
        for i in 0..200_000 {
            let y = -690.0 + 1380.0 * f64::from(i) / 200_000.0;
            let x = y.exp();
            let near = 1.0 + (y / 700.0) * 0.4;
            let l = ln([x, near]);
            worst.0 = worst.0.max(ulps(l[0], x.ln()));
            assert!((l[1] - near.ln()).abs() <= 2e-16 + 3e-16 * near.ln().abs(), "ln {near}: {}", l[1]);
            worst.1 = worst.1.max(ulps(exp([y])[0], y.exp()));
        }
        assert!(worst.0 <= 2.0 && worst.1 <= 2.0, "{worst:?} ulp");
    }

    #[test]
    fn what_is_not_a_number_stays_so_and_bounds_hold() {
        assert!(exp([f64::NAN])[0].is_nan());
        let [low, high] = exp([-1e300, 1e300]);
        assert!(low > 0.0 && low < 1e-300 && high > 1e300 && high.is_finite());
        assert_eq!(ln([1.0])[0], 0.0);
    }
}
