//! Polynomials with ascending coefficients: `p(x) = c_0 + c_1 x + c_2 x^2 + ..`

use std::f64::consts::TAU;

use dynocal_numerics::fft::Complex;

/// Most iterations of the search for roots.
const ITERATIONS: usize = 800;

/// Value at a complex number.
pub fn value(c: &[f64], x: Complex<f64>) -> Complex<f64> {
    c.iter().rev().fold(Complex::new(0.0, 0.0), |p, v| p * x + v)
}

/// Product.
pub fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    if a.is_empty() || b.is_empty() {
        return vec![0.0];
    }
    let mut out = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

/// Sum.
pub fn add(a: &[f64], b: &[f64]) -> Vec<f64> {
    let at = |c: &[f64], k: usize| c.get(k).copied().unwrap_or(0.0);
    (0..a.len().max(b.len())).map(|k| at(a, k) + at(b, k)).collect()
}

/// Highest power with a coefficient that is not zero.
pub fn degree(c: &[f64]) -> usize {
    c.iter().rposition(|v| *v != 0.0).unwrap_or(0)
}

/// Roots of a real polynomial; none where the iteration does not end.
///
/// Iteration of Ehrlich and Aberth: O. Aberth, Mathematics of Computation 27 (1973) 339-344.
pub fn roots(c: &[f64]) -> Option<Vec<Complex<f64>>> {
    let c: Vec<Complex<f64>> = c[..=degree(c)].iter().map(|v| Complex::new(*v, 0.0)).collect();
    complex_roots(&c)
}

/// Roots of a complex polynomial whose last coefficient is not zero.
pub fn complex_roots(c: &[Complex<f64>]) -> Option<Vec<Complex<f64>>> {
    if c.iter().any(|v| !(v.re.is_finite() && v.im.is_finite())) {
        return None;
    }
    let zeros = c.iter().take_while(|v| v.norm() == 0.0).count();
    if zeros == c.len() {
        return Some(Vec::new());
    }
    let c = &c[zeros..];
    let n = c.len() - 1;
    let radius = (c[0].norm() / c[n].norm()).powf(1.0 / n.max(1) as f64);
    let first = |k: usize| Complex::from_polar(radius, TAU * k as f64 / n as f64 + 0.4);
    let mut z: Vec<Complex<f64>> = (0..n).map(first).collect();
    let mut moved = if n == 0 { 0.0 } else { f64::INFINITY };
    for _ in 0..ITERATIONS {
        if moved < 1e-14 {
            break;
        }
        moved = 0.0;
        for k in 0..n {
            let step = step(c, &z, k)?;
            z[k] -= step;
            moved = moved.max(step.norm() / z[k].norm().max(1e-300));
        }
    }
    // Roots that lie on each other creep: what is left of the steps is their uncertainty.
    (moved < 1e-3).then(|| z.into_iter().chain(std::iter::repeat_n(Complex::new(0.0, 0.0), zeros)).collect())
}

fn step(c: &[Complex<f64>], z: &[Complex<f64>], k: usize) -> Option<Complex<f64>> {
    let zero = Complex::new(0.0, 0.0);
    // Far from zero the reversed polynomial does not overflow.
    let (p, slope) = c.iter().rev().fold((zero, zero), |(p, d), v| (p * z[k] + v, d * z[k] + p));
    if p == zero {
        return Some(zero);
    }
    let newton = p / slope;
    let others: Complex<f64> = (0..z.len()).filter(|j| *j != k).map(|j| (z[k] - z[j]).inv()).sum();
    let step = newton / (1.0 - newton * others);
    (step.re.is_finite() && step.im.is_finite()).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_of_a_product_are_those_of_its_factors() {
        // (x + 1)(x + 1000)(x^2 + 0.02 x + 1)
        let c = multiply(&multiply(&[1.0, 1.0], &[1000.0, 1.0]), &[1.0, 0.02, 1.0]);
        let found = roots(&c).unwrap();
        for known in
            [Complex::new(-1.0, 0.0), Complex::new(-1000.0, 0.0), Complex::new(-0.01, 0.9999f64.sqrt())]
        {
            assert!(found.iter().any(|z| (z - known).norm() < 1e-4 * known.norm()), "{known} {found:?}");
        }
    }
}
