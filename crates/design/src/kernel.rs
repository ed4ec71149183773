//! Small dense kernels of the design loop: plain slices, row-major, no allocation.
//!
//! The matrices here are tall and thin (100 to 2000 rows, 20 to 60 columns) and are factored a hundred thousand
//! times in one design, so that the call overhead of a general library is larger than the work itself.

mod tiles;

pub(crate) use tiles::{gram_add, multiply};

/// Dot product with four independent sums, so that it vectorises.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let mut sum = [0.0; 4];
    let (ca, cb) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in ca.zip(cb) {
        for k in 0..4 {
            sum[k] += x[k] * y[k];
        }
    }
    (sum[0] + sum[2]) + (sum[1] + sum[3]) + tail
}

/// `y += a x`.
#[inline(always)]
pub(crate) fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    for (yi, xi) in y.iter_mut().zip(x) {
        *yi += a * xi;
    }
}

/// Copies the lower triangle of `g` (p x p) to the upper one.
pub(crate) fn mirror(g: &mut [f64], p: usize) {
    for i in 0..p {
        for j in 0..i {
            g[j * p + i] = g[i * p + j];
        }
    }
}

/// Cholesky factor L of the symmetric matrix `a` (p x p, lower triangle read): `a = l l'`, upper triangle zero.
/// Returns the smallest pivot relative to its diagonal entry; at or below zero: not positive definite (`l` unusable).
pub(crate) fn cholesky(a: &[f64], p: usize, l: &mut [f64]) -> f64 {
    pulp::Arch::new().dispatch(Cholesky { a, p, l })
}

struct Cholesky<'a> {
    a: &'a [f64],
    p: usize,
    l: &'a mut [f64],
}

impl pulp::WithSimd for Cholesky<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> f64 {
        cholesky_kernel(self.a, self.p, self.l)
    }
}

/// Right-looking on the rows of L', which are long where the work is, and transposed at the end.
#[inline(always)]
fn cholesky_kernel(a: &[f64], p: usize, l: &mut [f64]) -> f64 {
    for i in 0..p {
        for j in 0..=i {
            l[j * p + i] = a[i * p + j];
        }
    }
    let mut least = f64::INFINITY;
    for k in 0..p {
        let (done, rest) = l.split_at_mut((k + 1) * p);
        let row = &mut done[k * p + k..];
        let pivot = row[0];
        // A NaN pivot must count as a failure too, so it is turned into one here.
        let relative = if pivot > 0.0 { pivot / a[k * p + k] } else { -1.0 };
        least = least.min(relative);
        if least <= 0.0 {
            return least;
        }
        let root = 1.0 / pivot.sqrt();
        row.iter_mut().for_each(|v| *v *= root);
        for (i, target) in (k + 1..p).zip(rest.chunks_exact_mut(p)) {
            axpy(-row[i - k], &row[i - k..], &mut target[i..]);
        }
    }
    for i in 0..p {
        for j in 0..i {
            l[i * p + j] = l[j * p + i];
            l[j * p + i] = 0.0;
        }
    }
    least
}

/// Inverse of the lower triangular `l` (p x p), lower triangular.
pub(crate) fn invert_lower(l: &[f64], p: usize, inv: &mut [f64]) {
    pulp::Arch::new().dispatch(InvertLower { l, p, inv });
}

struct InvertLower<'a> {
    l: &'a [f64],
    p: usize,
    inv: &'a mut [f64],
}

impl pulp::WithSimd for InvertLower<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        invert_lower_kernel(self.l, self.p, self.inv);
    }
}

#[inline(always)]
fn invert_lower_kernel(l: &[f64], p: usize, inv: &mut [f64]) {
    for i in 0..p {
        let (done, rest) = inv.split_at_mut(i * p);
        let row = &mut rest[..p];
        row.fill(0.0);
        for k in 0..i {
            axpy(l[i * p + k], &done[k * p..k * p + k + 1], &mut row[..=k]);
        }
        let d = 1.0 / l[i * p + i];
        for v in &mut row[..i] {
            *v *= -d;
        }
        row[i] = d;
    }
}

/// `out = l' l` (p x p, symmetric, complete): with `l = L^-1` this is `(L L')^-1`.
pub(crate) fn lower_gram(l: &[f64], p: usize, out: &mut [f64]) {
    out.fill(0.0);
    gram_add(l, p, out);
    mirror(out, p);
}

/// Triangular factor of a tall matrix by Householder reflections: `a` (n x p **column**-major, overwritten) = Q R;
/// `l` receives R' (lower triangular, p x p row-major) with non-negative diagonal. Needs no n >= p: missing rows
/// count as zeros.
pub(crate) fn qr_factor(a: &mut [f64], n: usize, p: usize, l: &mut [f64]) {
    l.fill(0.0);
    for k in 0..p {
        let (head, tail) = a.split_at_mut((k + 1) * n);
        let v = &mut head[k * n..];
        let top = k.min(n);
        let norm = dot(&v[top..], &v[top..]).sqrt();
        if norm > 0.0 {
            let alpha = if v[k] > 0.0 { -norm } else { norm };
            v[k] -= alpha;
            let beta = 2.0 / dot(&v[k..], &v[k..]);
            for c in tail.chunks_exact_mut(n) {
                let w = beta * dot(&v[k..], &c[k..]);
                axpy(-w, &v[k..], &mut c[k..]);
            }
            l[k * p + k] = alpha;
        }
        for (j, c) in tail.chunks_exact(n).enumerate() {
            l[(k + 1 + j) * p + k] = if k < n { c[k] } else { 0.0 };
        }
    }
    for k in 0..p {
        if l[k * p + k] < 0.0 {
            for i in k..p {
                l[i * p + k] = -l[i * p + k];
            }
        }
    }
}

/// Singular values (descending) and right singular vectors of the square matrix whose **columns** are the rows of
/// `l` (so of R for `l = R'`), by one-sided Jacobi rotations: small singular values keep their relative accuracy.
///
/// `columns` (p x p) is work space; row k of `v` is the vector that belongs to `sigma[k]`.
pub(crate) fn svd(l: &[f64], p: usize, columns: &mut [f64], sigma: &mut [f64], v: &mut [f64]) {
    columns.copy_from_slice(l);
    v.fill(0.0);
    for k in 0..p {
        v[k * p + k] = 1.0;
    }
    for _sweep in 0..60 {
        let mut rotated = false;
        for i in 0..p {
            for j in i + 1..p {
                rotated |= rotate(columns, v, p, i, j);
            }
        }
        if !rotated {
            break;
        }
    }
    for k in 0..p {
        let c = &columns[k * p..(k + 1) * p];
        sigma[k] = dot(c, c).sqrt();
    }
    sort_descending(sigma, v, p);
}

fn rotate(columns: &mut [f64], v: &mut [f64], p: usize, i: usize, j: usize) -> bool {
    let (ci, cj) = pair(columns, p, i, j);
    let (a, b, c) = (dot(ci, ci), dot(cj, cj), dot(ci, cj));
    if c.abs() <= 1e-15 * (a * b).sqrt() {
        return false;
    }
    let zeta = (b - a) / (2.0 * c);
    // Where the square overflows, t is zero and the columns are orthogonal already.
    let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let cs = 1.0 / (1.0 + t * t).sqrt();
    turn(ci, cj, cs, cs * t);
    let (vi, vj) = pair(v, p, i, j);
    turn(vi, vj, cs, cs * t);
    true
}

fn pair(m: &mut [f64], p: usize, i: usize, j: usize) -> (&mut [f64], &mut [f64]) {
    let (a, b) = m.split_at_mut(j * p);
    (&mut a[i * p..(i + 1) * p], &mut b[..p])
}

fn turn(a: &mut [f64], b: &mut [f64], cs: f64, sn: f64) {
    for (x, y) in a.iter_mut().zip(b) {
        let (u, w) = (*x, *y);
        *x = cs * u - sn * w;
        *y = sn * u + cs * w;
    }
}

fn sort_descending(sigma: &mut [f64], v: &mut [f64], p: usize) {
    for k in 0..p {
        let largest = (k..p).fold(k, |m, i| if sigma[i] > sigma[m] { i } else { m });
        if largest != k {
            sigma.swap(k, largest);
            let (a, b) = pair(v, p, k, largest);
            a.swap_with_slice(b);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn random(n: usize, seed: u64) -> Vec<f64> {
        let mut g = Rng64::new(seed);
        (0..n).map(|_| g.normal()).collect()
    }

    /// Plain triple loop.
    fn product(a: &[f64], b: &[f64], n: usize, k: usize, m: usize) -> Vec<f64> {
        let mut c = vec![0.0; n * m];
        for i in 0..n {
            for j in 0..m {
                c[i * m + j] = (0..k).map(|l| a[i * k + l] * b[l * m + j]).sum();
            }
        }
        c
    }

    fn transpose(a: &[f64], n: usize, m: usize) -> Vec<f64> {
        let mut t = vec![0.0; n * m];
        for i in 0..n {
            for j in 0..m {
                t[j * n + i] = a[i * m + j];
            }
        }
        t
    }

    fn close(a: &[f64], b: &[f64], tolerance: f64) {
        assert_eq!(a.len(), b.len());
        for (x, y) in a.iter().zip(b) {
            assert!((x - y).abs() <= tolerance * (1.0 + y.abs()), "{x} {y}");
        }
    }

    #[test]
    fn products_equal_the_plain_loops() {
        for (n, p) in [(1, 1), (7, 3), (13, 4), (30, 7), (9, 9), (3, 23), (90, 17), (41, 23), (8, 32)] {
            let (s, b) = (random(n * p, 1), random(p * p, 2));
            let mut g = vec![0.0; p * p];
            gram_add(&s, p, &mut g);
            mirror(&mut g, p);
            close(&g, &product(&transpose(&s, n, p), &s, p, n, p), 1e-13);
            let mut out = vec![f64::NAN; n * p];
            multiply(&s, &b, p, &mut out);
            close(&out, &product(&s, &b, n, p, p), 1e-13);
        }
    }

    #[test]
    fn factors_reproduce_their_matrix_and_agree() {
        let (n, p) = (20, 6);
        let s = random(n * p, 3);
        let mut a = vec![0.0; p * p];
        gram_add(&s, p, &mut a);
        mirror(&mut a, p);
        let (mut l, mut q, mut inv, mut ainv) =
            (vec![0.0; p * p], vec![0.0; p * p], vec![0.0; p * p], vec![0.0; p * p]);
        assert!(cholesky(&a, p, &mut l) > 0.0);
        qr_factor(&mut transpose(&s, n, p), n, p, &mut q);
        close(&l, &q, 1e-12);
        invert_lower(&l, p, &mut inv);
        lower_gram(&inv, p, &mut ainv);
        let eye: Vec<f64> = (0..p * p).map(|i| f64::from(u8::from(i / p == i % p))).collect();
        close(&product(&l, &inv, p, p, p), &eye, 1e-12);
        close(&product(&a, &ainv, p, p, p), &eye, 1e-10);
    }

    #[test]
    fn an_indefinite_or_nan_matrix_is_refused() {
        let mut l = vec![0.0; 4];
        assert!(cholesky(&[1.0, 2.0, 2.0, 1.0], 2, &mut l) <= 0.0);
        assert!(cholesky(&[1.0, 0.0, f64::NAN, 1.0], 2, &mut l) <= 0.0);
    }

    #[test]
    fn singular_values_of_a_graded_matrix() {
        // R = U diag(1, 1e-4, 1e-8) V' with rotations U, V known: the small value must not drown in the large one.
        let (c, s) = (0.6, 0.8);
        let v = [c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0];
        let d = [1.0, 1e-4, 1e-8];
        // `l` rows are columns of R; with U = I, R = diag(d) V' has columns d .* V[row].
        let l: Vec<f64> = (0..9).map(|i| v[i] * d[i % 3]).collect();
        let (mut w, mut sigma, mut vec_) = (vec![0.0; 9], vec![0.0; 3], vec![0.0; 9]);
        svd(&l, 3, &mut w, &mut sigma, &mut vec_);
        for k in 0..3 {
            assert!((sigma[k] / d[k] - 1.0).abs() < 1e-10, "{} {}", sigma[k], d[k]);
            let along: f64 = (0..3).map(|i| vec_[k * 3 + i] * v[i * 3 + k]).sum();
            assert!((along.abs() - 1.0).abs() < 1e-10);
        }
    }
}
