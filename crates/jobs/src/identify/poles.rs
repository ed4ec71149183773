//! Poles of a model about the middle of what was identified.
//!
//! ```text
//! A(z) = z^n - sum_j a_j z^(n-j),   a_j = dy(t) / dy(t-j) at rest,   poles: A(z) = 0
//! ```
//!
//! Of a linear model they are the same everywhere. Roots are found together by the iteration of Ehrlich and Aberth: O. Aberth,
//! Mathematics of Computation 27 (1973) 339-344.

use std::f64::consts::TAU;

use dynocal_ident::model::{Model, Run};
use dynocal_numerics::fft::Complex;
use serde::{Deserialize, Serialize};

/// A pole in the plane of z.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pole {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

impl Pole {
    /// Distance from zero: below 1 it is stable.
    pub fn size(&self) -> f64 {
        self.re.hypot(self.im)
    }

    /// Time in s in which what it carries falls to 1/e; none where it does not fall.
    pub fn time_constant_s(&self, sample_time_s: f64) -> Option<f64> {
        let size = self.size();
        (size > 0.0 && size < 1.0).then(|| -sample_time_s / size.ln())
    }

    /// Frequency in Hz with which it swings; none on the positive real axis.
    pub fn frequency_hz(&self, sample_time_s: f64) -> Option<f64> {
        let angle = self.im.atan2(self.re).abs();
        (angle > 1e-9).then(|| angle / (TAU * sample_time_s))
    }
}

/// Most iterations.
const ITERATIONS: usize = 500;
/// Most poles that are looked for: beyond, they are as uncertain as they are many.
const MOST: usize = 60;

/// Poles of a model with parameters `theta` about its rest `rest` under the inputs `row`, slowest first; none without memory of
/// its output, or where they cannot be told.
pub(super) fn poles(model: &dyn Model, theta: &[f64], row: &[f64], rest: f64) -> Vec<Pole> {
    let (lag, n) = (model.max_lag(), model.output_lag());
    if n == 0 || n > MOST {
        return Vec::new();
    }
    let u: Vec<f64> = row.iter().copied().cycle().take(row.len() * (lag + 1)).collect();
    let y = vec![rest; lag + 1];
    let mut a = vec![0.0; n];
    model.output_derivatives(theta, &Run { u: &u, y: &y, start: lag }, lag, &mut a);
    // From the constant on: -a_n, .., -a_1, 1.
    let coefficients: Vec<f64> = a.iter().rev().map(|v| -v).chain([1.0]).collect();
    let mut found = roots(&coefficients).unwrap_or_default();
    found.sort_by(|a, b| b.size().total_cmp(&a.size()).then(b.im.total_cmp(&a.im)));
    found
}

/// Roots of `sum_k c_k z^k` with a leading coefficient of 1; none where a number is not finite or the iteration does not end.
fn roots(c: &[f64]) -> Option<Vec<Pole>> {
    if c.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let zeros = c.iter().take_while(|v| **v == 0.0).count();
    let c = &c[zeros..];
    let n = c.len() - 1;
    // Starts on a circle about zero with the mean size of the roots, none on the axis.
    let radius = c[0].abs().powf(1.0 / n.max(1) as f64);
    let first = |k: usize| Complex::from_polar(radius, TAU * k as f64 / n as f64 + 0.4);
    let mut z: Vec<Complex<f64>> = (0..n).map(first).collect();
    let mut moved = if n == 0 { 0.0 } else { f64::INFINITY };
    for _ in 0..ITERATIONS {
        if moved < 1e-13 {
            break;
        }
        moved = 0.0;
        for k in 0..n {
            let (p, slope) = values(c, z[k]);
            if p == Complex::new(0.0, 0.0) {
                continue;
            }
            let newton = p / slope;
            let others: Complex<f64> = (0..n).filter(|j| *j != k).map(|j| (z[k] - z[j]).inv()).sum();
            let step = newton / (1.0 - newton * others);
            if !(step.re.is_finite() && step.im.is_finite()) {
                return None;
            }
            z[k] -= step;
            moved = moved.max(step.norm() / z[k].norm().max(1e-300));
        }
    }
    // Roots that lie on each other creep: what is left of the steps is their uncertainty.
    if moved > 1e-3 {
        return None;
    }
    // The coefficients are real: what is imaginary by rounding is not.
    let pole = |z: Complex<f64>| {
        let im = if z.im.abs() < 1e-9 * z.norm().max(1e-3) { 0.0 } else { z.im };
        Pole { re: z.re, im }
    };
    let zero = std::iter::repeat_n(Pole { re: 0.0, im: 0.0 }, zeros);
    Some(z.into_iter().map(pole).chain(zero).collect())
}

/// Polynomial and its slope.
fn values(c: &[f64], z: Complex<f64>) -> (Complex<f64>, Complex<f64>) {
    let zero = Complex::new(0.0, 0.0);
    c.iter().rev().fold((zero, zero), |(p, d), v| (p * z + v, d * z + p))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::model::poly::PolyNarx;
    use dynocal_numerics::rng::Rng64;

    /// Polynomials of drawn roots give them back.
    #[test]
    fn roots_of_known_polynomials_are_found() {
        let mut rng = Rng64::new(4);
        for trial in 0..200 {
            let mut known: Vec<Pole> = Vec::new();
            for _ in 0..1 + rng.below(3) {
                let (size, angle) = (rng.uniform_in(0.1, 0.99), rng.uniform_in(0.3, 2.8));
                known
                    .extend([1.0, -1.0].map(|s| Pole { re: size * angle.cos(), im: s * size * angle.sin() }));
            }
            (0..rng.below(3)).for_each(|k| known.push(Pole { re: 0.35 * k as f64 - 0.2, im: 0.0 }));
            let mut c = vec![Complex::new(1.0, 0.0)];
            for r in &known {
                let mut next = vec![Complex::new(0.0, 0.0); c.len() + 1];
                for (k, v) in c.iter().enumerate() {
                    next[k + 1] += v;
                    next[k] -= v * Complex::new(r.re, r.im);
                }
                c = next;
            }
            let c: Vec<f64> = c.iter().map(|v| v.re).collect();
            let found = roots(&c).unwrap();
            assert_eq!(found.len(), known.len());
            for k in &known {
                let near =
                    found.iter().map(|f| (f.re - k.re).hypot(f.im - k.im)).fold(f64::INFINITY, f64::min);
                assert!(near < 1e-5, "trial {trial}: {k:?} of {known:?}, found {found:?}");
            }
        }
    }

    /// (1 - 0.95 q)(1 - 1.2 q + 0.72 q^2): time constant -0.1 / ln 0.95 s, an angle of 45 deg a sample.
    #[test]
    fn poles_of_a_model_have_their_time_constants_and_frequencies() {
        let terms = ["u(t-1)", "y(t-1)", "y(t-2)", "y(t-3)"];
        let model = PolyNarx::parse(&["u"], "y", &terms).unwrap();
        let theta = [1.0, 2.15, -1.86, 0.684];
        let found = poles(&model, &theta, &[0.0], 0.0);
        assert_eq!(found.len(), 3);
        let slow = found[0];
        assert!((slow.re - 0.95).abs() < 1e-9 && slow.im == 0.0, "{found:?}");
        assert!((slow.time_constant_s(0.1).unwrap() + 0.1 / 0.95f64.ln()).abs() < 1e-6);
        assert_eq!(slow.frequency_hz(0.1), None);
        assert!((found[1].frequency_hz(0.1).unwrap() - 45.0 / 360.0 / 0.1).abs() < 1e-6, "{found:?}");
        assert!((found[1].size() - 0.72f64.sqrt()).abs() < 1e-9 && found[1].im == -found[2].im);
    }
}
