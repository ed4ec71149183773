//! Rational filters that start at rest, and what is needed of their polynomials.
//!
//! A polynomial is a slice of coefficients of q^0, q^-1, ..; denominators are monic.

/// `out = num / den x`, all states zero before the first sample.
pub(crate) fn filter(num: &[f64], den: &[f64], x: &[f64], out: &mut [f64]) {
    let (head, tail) = (num.len().max(den.len()) - 1, x.len());
    // The first samples lack history; after them every sum has its full length.
    for t in 0..head.min(tail) {
        let forward: f64 = num.iter().take(t + 1).enumerate().map(|(j, c)| c * x[t - j]).sum();
        let back: f64 = den.iter().take(t + 1).enumerate().skip(1).map(|(j, c)| c * out[t - j]).sum();
        out[t] = forward - back;
    }
    for t in head..tail {
        let mut v = 0.0;
        for (j, c) in num.iter().enumerate() {
            v += c * x[t - j];
        }
        for (j, c) in den.iter().enumerate().skip(1) {
            v -= c * out[t - j];
        }
        out[t] = v;
    }
}

/// Product of two polynomials.
pub(crate) fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

/// Whether all roots of a monic polynomial (in q) lie inside the unit circle: every reflection coefficient of the
/// step-down recursion (Schur-Cohn) is below one in size.
pub(crate) fn stable(p: &[f64]) -> bool {
    let mut c = p.to_vec();
    while c.len() > 1 {
        let n = c.len() - 1;
        let k = c[n];
        if k.is_nan() || k.abs() >= 1.0 {
            return false;
        }
        let lower: Vec<f64> = (0..n).map(|i| (c[i] - k * c[n - i]) / (1.0 - k * k)).collect();
        c = lower;
    }
    true
}

/// The polynomial with its roots pulled towards zero, all by one factor, until they lie inside the unit circle with
/// a margin of a hundredth. Non-finite coefficients give 1.
pub(crate) fn stabilised(p: &[f64]) -> Vec<f64> {
    if p.iter().any(|v| !v.is_finite()) {
        let mut rest = vec![0.0; p.len()];
        rest[0] = 1.0;
        return rest;
    }
    let scaled =
        |gain: f64| -> Vec<f64> { p.iter().enumerate().map(|(j, v)| v * gain.powi(j as i32)).collect() };
    // Roots of `scaled(g)` are g times those of p: with the margin, p itself passes when its roots are below 0.99.
    let mut gain = 1.0;
    while !stable(&scaled(gain / 0.99)) {
        gain *= 0.95;
    }
    scaled(gain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stability_of_known_roots() {
        // (1 - 0.9 q^-1)(1 + 0.5 q^-1) and complex roots of radius sqrt(0.98) and sqrt(1.02).
        assert!(stable(&multiply(&[1.0, -0.9], &[1.0, 0.5])));
        assert!(!stable(&multiply(&[1.0, -1.1], &[1.0, 0.5])));
        assert!(stable(&[1.0, -1.2, 0.98]) && !stable(&[1.0, -1.2, 1.02]));
        assert!(!stable(&[1.0, f64::NAN]));
        let pulled = stabilised(&[1.0, -2.0]);
        assert!(pulled[1] > -0.99 && pulled[1] < -0.9);
        assert_eq!(stabilised(&[1.0, -0.5]), [1.0, -0.5]);
    }

    #[test]
    fn filter_of_an_impulse_is_the_series_of_the_quotient() {
        // (1 + q^-1) / (1 - 0.5 q^-1) = 1 + 1.5 q^-1 + 0.75 q^-2 + ..
        let mut out = [0.0; 4];
        filter(&[1.0, 1.0], &[1.0, -0.5], &[1.0, 0.0, 0.0, 0.0], &mut out);
        assert_eq!(out, [1.0, 1.5, 0.75, 0.375]);
    }
}
