//! Structured singular value for diagonal complex uncertainty, from both sides.
//!
//! ```text
//! 1 / mu(M) = least size of a diagonal Delta with det(I - M Delta) = 0
//! upper:  min over diagonal D > 0 of sigma_max(D M D^-1)        convex; what is returned holds for the D that was found
//! lower:  rho(U M) for a diagonal U of size 1                   with Delta = U e^(-j arg) / rho: det(I - M Delta) = 0 exactly
//! ```
//!
//! Upper bound: balance by norms (E. E. Osborne, J. ACM 7 (1960) 338-345), then the method of centres on `M^H X M < b X`
//! (S. Boyd, L. El Ghaoui, Linear Algebra Appl. 188/189 (1993) 63-111). Lower bound: power iteration (A. Packard, M. K. H. Fan,
//! J. Doyle, Proc. 27th CDC (1988) 2132-2137). For up to three blocks the two are equal.

use crate::matrix::{C, Matrix, ONE, ZERO};

/// Rounds of the balance.
const BALANCE: usize = 40;
/// Rounds of the method of centres.
const CENTRES: usize = 120;
/// Relative gap at which it ends.
const GAP: f64 = 1e-10;
/// Steps of the power iteration, and its starts.
const POWER: (usize, usize) = (300, 4);

/// A lower bound with what it found.
#[derive(Clone, Debug, PartialEq)]
pub struct Lower {
    /// Lower bound of mu.
    pub value: f64,
    /// The diagonal perturbation, each entry of size `1 / value`.
    pub perturbation: Vec<C>,
}

/// Scaling of rows and columns that balances their norms, as `x = d^2`.
pub fn balance(m: &Matrix) -> Vec<f64> {
    let n = m.rows;
    let mut d = vec![1.0f64; n];
    for _ in 0..BALANCE {
        let mut moved: f64 = 0.0;
        for k in 0..n {
            let (mut row, mut col) = (0.0f64, 0.0f64);
            for j in (0..n).filter(|j| *j != k) {
                row += (d[k] / d[j]).powi(2) * m.at(k, j).norm_sqr();
                col += (d[j] / d[k]).powi(2) * m.at(j, k).norm_sqr();
            }
            if row > 1e-300 && col > 1e-300 {
                let factor = (col / row).powf(0.25);
                d[k] *= factor;
                moved = moved.max((factor - 1.0).abs());
            }
        }
        if moved < 1e-6 {
            break;
        }
    }
    d.iter().map(|v| v * v).collect()
}

/// `sigma_max(D M D^-1)` for `x = d^2`: an upper bound of mu for any positive x.
pub fn scaled_norm(m: &Matrix, x: &[f64]) -> f64 {
    let n = m.rows;
    let mut scaled = m.clone();
    for i in 0..n {
        for j in 0..n {
            *scaled.at_mut(i, j) *= (x[i] / x[j]).sqrt();
        }
    }
    scaled.norm()
}

/// Upper bound of mu from the balance alone: cheap, and a few percent above the best.
pub fn upper_quick(m: &Matrix) -> f64 {
    scaled_norm(m, &balance(m))
}

/// Upper bound of mu with the best diagonal scaling.
pub fn upper(m: &Matrix) -> f64 {
    let n = m.rows;
    if n == 1 {
        return m.data[0].norm();
    }
    let mut x = balance(m);
    let mut best = scaled_norm(m, &x);
    // Of two blocks the norm grows with the sum of squares, the determinant being what it is: the balance is the best.
    if n == 2 {
        return best;
    }
    let mut level = best * best * 1.05;
    if !(level > 0.0 && level.is_finite()) {
        return best;
    }
    for _ in 0..CENTRES {
        if !centre(m, level, &mut x) {
            break;
        }
        let now = scaled_norm(m, &x);
        best = best.min(now);
        let next = 0.9 * now * now + 0.1 * level;
        if !(next < level * (1.0 - GAP)) {
            break;
        }
        level = next;
    }
    best
}

/// Analytic centre of `b X - M^H X M > 0`, x_n = 1, from a point within; false where there is none to be had.
fn centre(m: &Matrix, b: f64, x: &mut [f64]) -> bool {
    let n = x.len();
    let free = n - 1;
    for _ in 0..30 {
        let Some((_, p)) = barrier(m, b, x) else { return false };
        // Rows of M as m_i, P m_j^H.
        let pm: Vec<Vec<C>> =
            (0..n).map(|j| p.apply(&(0..n).map(|c| m.at(j, c).conj()).collect::<Vec<_>>())).collect();
        let mpm = |i: usize, j: usize| -> C { (0..n).map(|c| m.at(i, c) * pm[j][c]).sum() };
        let mut g = vec![0.0; free];
        let mut h = vec![0.0; free * free];
        for i in 0..free {
            g[i] = -(b * p.at(i, i).re - mpm(i, i).re);
            for j in 0..free {
                let cross = pm[j][i].norm_sqr() + pm[i][j].norm_sqr();
                h[i * free + j] = b * b * p.at(i, j).norm_sqr() - b * cross + mpm(i, j).norm_sqr();
            }
        }
        // In units of x the Hessian is well scaled.
        for i in 0..free {
            g[i] *= x[i];
            (0..free).for_each(|j| h[i * free + j] *= x[i] * x[j]);
        }
        let Some(step) = solve(&h, &g, free) else { return true };
        let decrement: f64 = step.iter().zip(&g).map(|(s, g)| s * g).sum();
        if !(decrement > 1e-12) {
            return true;
        }
        let mut share = 1.0 / (1.0 + decrement.sqrt()).max(1.0);
        if decrement < 0.05 {
            share = 1.0;
        }
        let before = x.to_vec();
        loop {
            for i in 0..free {
                x[i] = before[i] * (1.0 - share * step[i]);
            }
            if x.iter().all(|v| *v > 0.0) && barrier(m, b, x).is_some() {
                break;
            }
            share *= 0.5;
            if share < 1e-8 {
                x.copy_from_slice(&before);
                return true;
            }
        }
    }
    true
}

/// Log determinant and inverse of `b X - M^H X M`; none where it is not positive definite.
fn barrier(m: &Matrix, b: f64, x: &[f64]) -> Option<(f64, Matrix)> {
    let n = x.len();
    let mut f = Matrix::zeros(n, n);
    for i in 0..n {
        for j in 0..n {
            let sum: C = (0..n).map(|r| m.at(r, i).conj() * m.at(r, j) * x[r]).sum();
            *f.at_mut(i, j) = -sum;
        }
        *f.at_mut(i, i) += b * x[i];
    }
    // Positive definite where all pivots of the Cholesky factor are.
    let mut l = f.clone();
    let mut log_det = 0.0;
    for k in 0..n {
        let pivot = l.at(k, k).re;
        if !(pivot > 1e-15 * b * x[k]) {
            return None;
        }
        log_det += pivot.ln();
        for i in k + 1..n {
            let share = l.at(i, k) / pivot;
            for j in k + 1..n {
                let v = l.at(k, j);
                *l.at_mut(i, j) -= share * v;
            }
        }
    }
    Some((log_det, f.inverse()?))
}

/// Positive definite system by elimination with a little damping.
fn solve(h: &[f64], g: &[f64], n: usize) -> Option<Vec<f64>> {
    let mut a = Matrix::zeros(n, n);
    for i in 0..n {
        for j in 0..n {
            *a.at_mut(i, j) = C::new(h[i * n + j], 0.0);
        }
        *a.at_mut(i, i) += 1e-14 * h[i * n + i].abs();
    }
    let inverse = a.inverse()?;
    let g: Vec<C> = g.iter().map(|v| C::new(*v, 0.0)).collect();
    let out: Vec<f64> = inverse.apply(&g).iter().map(|v| v.re).collect();
    out.iter().all(|v| v.is_finite()).then_some(out)
}

/// Lower bound of mu with the perturbation that reaches it.
pub fn lower(m: &Matrix) -> Lower {
    let n = m.rows;
    let mut best = Lower { value: 0.0, perturbation: vec![ZERO; n] };
    for start in 0..POWER.1 {
        let Some(u) = power(m, start) else { continue };
        let turned = Matrix::diagonal(&u).times(m);
        let Some(eigen) = turned.eigenvalues() else { continue };
        let Some(l) = eigen.into_iter().max_by(|a, b| a.norm().total_cmp(&b.norm())) else { continue };
        if l.norm() > best.value {
            // det(I - M Delta) = det(I - Delta M) with Delta = U / l.
            best = Lower { value: l.norm(), perturbation: u.iter().map(|v| v / l).collect() };
        }
    }
    best
}

/// Directions of size 1 at which the power iteration settles.
fn power(m: &Matrix, start: usize) -> Option<Vec<C>> {
    let n = m.rows;
    let size = |x: &[C]| x.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt();
    let turn = |k: usize| C::from_polar(1.0, (start * (k + 1)) as f64 * 2.399_963);
    let mut b: Vec<C> = (0..n).map(turn).collect();
    let mut w = b.clone();
    let mh = m.adjoint();
    let direction = |v: C| if v.norm() > 1e-300 { v / v.norm() } else { ONE };
    let mut last = 0.0;
    for _ in 0..POWER.0 {
        let mut a = m.apply(&b);
        let beta = size(&a);
        if !(beta > 0.0 && beta.is_finite()) {
            return None;
        }
        a.iter_mut().for_each(|v| *v /= beta);
        let z: Vec<C> = (0..n).map(|k| direction(a[k]) * w[k].norm()).collect();
        w = mh.apply(&z);
        let gamma = size(&w);
        if !(gamma > 0.0) {
            return None;
        }
        w.iter_mut().for_each(|v| *v /= gamma);
        b = (0..n).map(|k| direction(w[k]) * a[k].norm()).collect();
        let settled = (beta - last).abs() < 1e-13 * beta;
        last = beta;
        if settled {
            break;
        }
    }
    // Delta a = b: entries that take what comes out to what goes in.
    let a = m.apply(&b);
    Some((0..n).map(|k| direction(direction(b[k]) * direction(a[k]).conj())).collect())
}
