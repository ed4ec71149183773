//! Rational filters that start at rest, and what is needed of their polynomials.
//!
//! A polynomial is a slice of coefficients of q^0, q^-1, ..; denominators are monic.

use dynocal_numerics::linalg::axpy;

/// `out = num / den x`, all states zero before the first sample.
pub(crate) fn filter(num: &[f64], den: &[f64], x: &[f64], out: &mut [f64]) {
    moving(num, x, out);
    recurse(den, out);
}

/// `out = num x`, tap by tap along the record: no tap waits for another.
pub(crate) fn moving(num: &[f64], x: &[f64], out: &mut [f64]) {
    let n = x.len();
    match num.first() {
        Some(&1.0) => out.copy_from_slice(x),
        Some(&c) if c != 0.0 => out.iter_mut().zip(x).for_each(|(o, v)| *o = c * v),
        _ => out.fill(0.0),
    }
    for (j, &c) in num.iter().enumerate().take(n).skip(1) {
        if c != 0.0 {
            axpy(c, &x[..n - j], &mut out[j..]);
        }
    }
}

/// `x = x / den` in place, from rest. The common orders keep their states in registers.
pub(crate) fn recurse(den: &[f64], x: &mut [f64]) {
    match den {
        [] | [_] => {}
        [_, a] => recurse_order([*a], x),
        [_, a, b] => recurse_order([*a, *b], x),
        [_, a, b, c] => recurse_order([*a, *b, *c], x),
        [_, a, b, c, d] => recurse_order([*a, *b, *c, *d], x),
        _ => recurse_from(den, x, 0),
    }
}

fn recurse_order<const K: usize>(den: [f64; K], x: &mut [f64]) {
    let mut past = [0.0; K];
    for v in x {
        // The newest state comes last: it is the one that is waited for.
        let mut sum = *v;
        for k in (0..K).rev() {
            sum -= den[k] * past[k];
        }
        for k in (1..K).rev() {
            past[k] = past[k - 1];
        }
        past[0] = sum;
        *v = sum;
    }
}

/// `x = x / den` in place from sample `start` on; what stands before it is the history.
pub(crate) fn recurse_from(den: &[f64], x: &mut [f64], start: usize) {
    for t in start..x.len() {
        let back: f64 = den.iter().enumerate().take(t + 1).skip(1).map(|(j, c)| c * x[t - j]).sum();
        x[t] -= back;
    }
}

/// Two signals through the same recursion in one pass: each waits for itself, not for the other.
pub(crate) fn recurse_pair(den: &[f64], x: &mut [f64], y: &mut [f64]) {
    match den {
        [_, a] => pair_order([*a], x, y),
        [_, a, b] => pair_order([*a, *b], x, y),
        [_, a, b, c] => pair_order([*a, *b, *c], x, y),
        [_, a, b, c, d] => pair_order([*a, *b, *c, *d], x, y),
        _ => {
            recurse(den, x);
            recurse(den, y);
        }
    }
}

fn pair_order<const K: usize>(den: [f64; K], x: &mut [f64], y: &mut [f64]) {
    let mut past = [[0.0; 2]; K];
    for (v, w) in x.iter_mut().zip(y) {
        let mut sum = [*v, *w];
        for k in (0..K).rev() {
            sum[0] -= den[k] * past[k][0];
            sum[1] -= den[k] * past[k][1];
        }
        for k in (1..K).rev() {
            past[k] = past[k - 1];
        }
        past[0] = sum;
        [*v, *w] = sum;
    }
}

/// Product of two polynomials.
pub(crate) fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    multiply_into(a, b, &mut out);
    out
}

/// The same into a slice of its length.
pub(crate) fn multiply_into(a: &[f64], b: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
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
