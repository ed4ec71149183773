//! Products with a lower triangular matrix whose rows stand one after the other: row i has i + 1 entries.
//!
//! Four rows go together, so that the vector beside them is read and written once for four; what is done twice with a row is
//! done while it is near.

/// Rows that go together.
const ROWS: usize = 4;
/// Partial sums of a scalar product.
const LANES: usize = 8;

/// `out = W x`.
pub(super) fn times(matrix: &[f64], x: &[f64], out: &mut [f64]) {
    pulp::Arch::new().dispatch(Pass { matrix, x, products: Some(out), sums: None });
}

/// `out = W'x`.
pub(super) fn times_transposed(matrix: &[f64], x: &[f64], out: &mut [f64]) {
    pulp::Arch::new().dispatch(Pass { matrix, x, products: None, sums: Some(out) });
}

/// `v = W x` and `p = W'v` in one pass over W.
pub(super) fn both(matrix: &[f64], x: &[f64], v: &mut [f64], p: &mut [f64]) {
    pulp::Arch::new().dispatch(Pass { matrix, x, products: Some(v), sums: Some(p) });
}

/// One pass over the rows: their products with x, and the sum of the rows times those products (or times x where the products
/// are not asked for).
struct Pass<'a> {
    matrix: &'a [f64],
    x: &'a [f64],
    products: Option<&'a mut [f64]>,
    sums: Option<&'a mut [f64]>,
}

impl pulp::WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { matrix, x, mut products, mut sums } = self;
        let n = x.len();
        if let Some(sums) = sums.as_deref_mut() {
            sums.fill(0.0);
        }
        let mut i = 0;
        while i + ROWS <= n {
            // Row i + r begins with the i + 1 columns that all four have.
            let row = |r: usize| {
                let from = (i + r) * (i + r + 1) / 2;
                &matrix[from..from + i + r + 1]
            };
            let rows = [row(0), row(1), row(2), row(3)];
            let heads = [&rows[0][..=i], &rows[1][..=i], &rows[2][..=i], &rows[3][..=i]];
            let mut values = [x[i], x[i + 1], x[i + 2], x[i + 3]];
            if let Some(products) = products.as_deref_mut() {
                values = dots(heads, &x[..=i]);
                for r in 1..ROWS {
                    for c in i + 1..=i + r {
                        values[r] += rows[r][c] * x[c];
                    }
                }
                products[i..i + ROWS].copy_from_slice(&values);
            }
            if let Some(sums) = sums.as_deref_mut() {
                add(values, heads, &mut sums[..=i]);
                for r in 1..ROWS {
                    for c in i + 1..=i + r {
                        sums[c] += values[r] * rows[r][c];
                    }
                }
            }
            i += ROWS;
        }
        for i in i..n {
            let row = &matrix[i * (i + 1) / 2..(i + 1) * (i + 2) / 2];
            let mut value = x[i];
            if let Some(products) = products.as_deref_mut() {
                value = sum_of(row, &x[..=i], |w, x| w * x);
                products[i] = value;
            }
            if let Some(sums) = sums.as_deref_mut() {
                sums[..=i].iter_mut().zip(row).for_each(|(s, w)| *s += value * w);
            }
        }
    }
}

/// Scalar products of four rows with x.
#[inline(always)]
fn dots(rows: [&[f64]; ROWS], x: &[f64]) -> [f64; ROWS] {
    let mut partial = [[0.0; LANES]; ROWS];
    let whole = x.len() / LANES * LANES;
    let chunk = |r: usize| rows[r][..whole].chunks_exact(LANES);
    let four = chunk(0).zip(chunk(1)).zip(chunk(2)).zip(chunk(3));
    for (x, (((a, b), c), d)) in x.chunks_exact(LANES).zip(four) {
        for k in 0..LANES {
            partial[0][k] = a[k].mul_add(x[k], partial[0][k]);
            partial[1][k] = b[k].mul_add(x[k], partial[1][k]);
            partial[2][k] = c[k].mul_add(x[k], partial[2][k]);
            partial[3][k] = d[k].mul_add(x[k], partial[3][k]);
        }
    }
    let mut sums = [0.0; ROWS];
    for r in 0..ROWS {
        for c in whole..x.len() {
            partial[r][c - whole] += rows[r][c] * x[c];
        }
        let p = &partial[r];
        sums[r] = ((p[0] + p[4]) + (p[1] + p[5])) + ((p[2] + p[6]) + (p[3] + p[7]));
    }
    sums
}

/// Adds four rows times their values.
#[inline(always)]
fn add(values: [f64; ROWS], rows: [&[f64]; ROWS], sums: &mut [f64]) {
    let n = sums.len();
    let (a, b, c, d) = (&rows[0][..n], &rows[1][..n], &rows[2][..n], &rows[3][..n]);
    for k in 0..n {
        let first = values[1].mul_add(b[k], values[0] * a[k]);
        sums[k] += values[3].mul_add(d[k], values[2].mul_add(c[k], first));
    }
}

/// `sum_i f(a_i, b_i)` in sixteen partial sums that are added in pairs: no addition waits for the one before.
#[inline(always)]
pub(super) fn sum_of(a: &[f64], b: &[f64], f: impl Fn(f64, f64) -> f64) -> f64 {
    let mut partial = [0.0; 16];
    let (ca, cb) = (a.chunks_exact(16), b.chunks_exact(16));
    let rest = ca.remainder().iter().zip(cb.remainder());
    rest.zip(&mut partial).for_each(|((a, b), p)| *p = f(*a, *b));
    for (a, b) in ca.zip(cb) {
        for k in 0..16 {
            partial[k] += f(a[k], b[k]);
        }
    }
    for half in [8, 4, 2, 1] {
        for k in 0..half {
            partial[k] += partial[k + half];
        }
    }
    partial[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    #[test]
    fn products_are_those_of_the_whole_matrix() {
        for n in [0, 1, 3, 4, 5, 17, 64, 101] {
            let mut rng = Rng64::new(n as u64);
            let matrix: Vec<f64> = (0..n * (n + 1) / 2).map(|_| rng.normal()).collect();
            let x: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
            let at = |i: usize, k: usize| if k <= i { matrix[i * (i + 1) / 2 + k] } else { 0.0 };
            let plain = |x: &[f64], transposed: bool| -> Vec<f64> {
                let entry = |i: usize, k: usize| if transposed { at(k, i) } else { at(i, k) };
                (0..n).map(|i| (0..n).map(|k| entry(i, k) * x[k]).sum()).collect()
            };
            let (mut v, mut p) = (vec![f64::NAN; n], vec![f64::NAN; n]);
            let close = |found: &[f64], expected: &[f64]| {
                found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12 * (1.0 + b.abs()))
            };
            times(&matrix, &x, &mut v);
            assert!(close(&v, &plain(&x, false)), "{n}");
            times_transposed(&matrix, &x, &mut p);
            assert!(close(&p, &plain(&x, true)), "{n}");
            let expected = plain(&v, true);
            v.fill(f64::NAN);
            both(&matrix, &x, &mut v, &mut p);
            assert!(close(&v, &plain(&x, false)) && close(&p, &expected), "{n}");
        }
    }
}
