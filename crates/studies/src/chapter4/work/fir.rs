//! Example 1 of the thesis: the A-optimal input of a finite impulse response with three taps, eq. (4.29).
//!
//! ```text
//! J_A = tr(M^-1),   M = sum_t phi(t) phi(t)',   phi(t) = [u(t-1), u(t-2), u(t-3)],   |u| <= 10,  sigma^2 = 1
//! ```
//!
//! J_A falls with the scale of every sample, so that an optimum lies on binary signals; there a search over flips of
//! one and of two samples is exact in its steps, where a gradient method stops early.

use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::SAMPLES;

/// Largest amplitude.
pub const AMPLITUDE: f64 = 10.0;

/// Which rows count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rows {
    /// t = 4..100: no sample before the record is needed.
    Trim,
    /// t = 1..100 with zeros before the record.
    Zero,
}

/// `tr(M^-1)` of the input `u`; infinite where M is singular. The sum of [`variances`].
///
/// ```
/// use dynocal_studies::chapter4::work::fir::{Rows, trace_of_inverse};
/// assert_eq!(trace_of_inverse(&[10.0; 100], Rows::Trim), f64::INFINITY);
/// // One pulse each, far apart: M = 100 I over the rows that see it.
/// let mut u = vec![0.0; 100];
/// u[50] = 10.0;
/// assert!((trace_of_inverse(&u, Rows::Trim) - 0.03).abs() < 1e-15);
/// ```
pub fn trace_of_inverse(u: &[f64], rows: Rows) -> f64 {
    variances(u, rows).iter().sum()
}

/// Variances of the three parameters, the diagonal of M^-1 (Table 4.2); infinite where M is singular.
pub fn variances(u: &[f64], rows: Rows) -> [f64; 3] {
    let (mut a, mut b, mut c, mut d, mut e, mut f) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let at = |t: usize, lag: usize| if t >= lag { u[t - lag] } else { 0.0 };
    let first = if rows == Rows::Trim { 3 } else { 0 };
    for t in first..u.len() {
        let (x, y, z) = (at(t, 1), at(t, 2), at(t, 3));
        a += x * x;
        b += y * y;
        c += z * z;
        d += x * y;
        e += x * z;
        f += y * z;
    }
    let (m11, m22, m33) = (b * c - f * f, a * c - e * e, a * b - d * d);
    let determinant = a * m11 - d * (d * c - e * f) + e * (d * f - e * b);
    // Relative to the determinant of the diagonal, so that the test does not depend on the amplitude.
    if determinant <= 1e-12 * a * b * c {
        return [f64::INFINITY; 3];
    }
    [m11 / determinant, m22 / determinant, m33 / determinant]
}

/// Lower bound of J_A: every diagonal entry of M at most the number of its rows that see a sample, times 100.
pub fn bound(rows: Rows) -> f64 {
    let n = SAMPLES as f64;
    let seen = if rows == Rows::Trim { [n - 3.0; 3] } else { [n - 1.0, n - 2.0, n - 3.0] };
    seen.iter().map(|k| 1.0 / (k * AMPLITUDE * AMPLITUDE)).sum()
}

/// Best binary input of `starts` random starts, and its J_A.
pub fn search(rows: Rows, starts: usize, seed: u64) -> (Vec<f64>, f64) {
    let ends: Vec<(Vec<f64>, f64)> =
        (0..starts.max(1)).into_par_iter().map(|k| descend(rows, Rng64::stream(seed, k as u64))).collect();
    ends.into_iter().reduce(|a, b| if b.1 < a.1 { b } else { a }).unwrap_or_default()
}

/// Flips of one sample, then of two, until none helps.
fn descend(rows: Rows, mut rng: Rng64) -> (Vec<f64>, f64) {
    let mut u: Vec<f64> =
        (0..SAMPLES).map(|_| if rng.below(2) == 0 { AMPLITUDE } else { -AMPLITUDE }).collect();
    let mut best = trace_of_inverse(&u, rows);
    loop {
        let before = best;
        for i in 0..SAMPLES {
            for j in i..SAMPLES {
                flip(&mut u, i, j);
                let found = trace_of_inverse(&u, rows);
                if found < best {
                    best = found;
                } else {
                    flip(&mut u, i, j);
                }
            }
        }
        if best >= before {
            return (u, best);
        }
    }
}

fn flip(u: &mut [f64], i: usize, j: usize) {
    u[i] = -u[i];
    if j != i {
        u[j] = -u[j];
    }
}

/// Variances of the parameters of `n` uniformly distributed random signals.
pub fn udrn(rows: Rows, n: usize, seed: u64) -> Vec<[f64; 3]> {
    (0..n)
        .map(|k| {
            let mut rng = Rng64::stream(seed, (1 << 20) + k as u64);
            let u: Vec<f64> = (0..SAMPLES).map(|_| rng.uniform_in(-AMPLITUDE, AMPLITUDE)).collect();
            variances(&u, rows)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The best values known, from an independent search; both are close to a bound that none can pass.
    #[test]
    fn flips_reach_the_best_known_inputs() {
        for (rows, known) in [(Rows::Trim, 3.0934343434343e-4), (Rows::Zero, 3.0618654326667e-4)] {
            let (u, found) = search(rows, 8, 1);
            assert!(u.iter().all(|v| v.abs() == AMPLITUDE));
            assert!(found <= known * (1.0 + 1e-9), "{rows:?}: {found}, known {known}");
            assert!(found >= bound(rows));
            assert_eq!(found, trace_of_inverse(&u, rows));
        }
    }

    /// Thesis 8.51e-4 (one signal), median of an independent population 9.4e-4.
    #[test]
    fn random_signals_are_three_times_worse() {
        let j_a: Vec<f64> = udrn(Rows::Trim, 400, 1).iter().map(|v| v.iter().sum()).collect();
        let median = crate::chapter4::work::statistics::median(&j_a).unwrap();
        assert!((median / 9.4357e-4 - 1.0).abs() < 0.03, "{median}");
    }
}
