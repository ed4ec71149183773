//! A symmetric matrix whose entries lie near its diagonal.

use dynocal_numerics::linalg::{LinalgError, axpy, dot};

/// The upper triangle, row by row from the diagonal on, or its factor R with `R'R = A`.
pub(super) struct Band {
    n: usize,
    width: usize,
    rows: Vec<f64>,
}

impl Band {
    /// A matrix of `n` rows with `width` entries beside the diagonal.
    pub(super) fn zeros(n: usize, width: usize) -> Self {
        Self { n, width, rows: vec![0.0; n * (width + 1)] }
    }

    /// Adds the outer product of a row with entries at increasing places; a pair of them beyond the width goes to the diagonal, by which
    /// the matrix grows.
    pub(super) fn add(&mut self, row: &[(usize, f64)]) {
        let width = self.width;
        for (k, (i, a)) in row.iter().enumerate() {
            let from = i * (width + 1);
            for (j, b) in &row[k..] {
                match self.rows.get_mut(from + j - i).filter(|_| j - i <= width) {
                    Some(v) => *v += a * b,
                    None => {
                        let size = (a * b).abs();
                        self.rows[from] += size;
                        self.rows[j * (width + 1)] += size;
                    }
                }
            }
        }
    }

    /// Replaces the matrix by its factor.
    pub(super) fn factor(&mut self) -> Result<(), LinalgError> {
        let step = self.width + 1;
        for i in 0..self.n {
            let (done, rest) = self.rows.split_at_mut((i + 1) * step);
            let row = &mut done[i * step..];
            let d = row[0];
            if !(d > 0.0 && d.is_finite()) {
                return Err(LinalgError::Pivot { what: "banded cholesky", index: i, value: d });
            }
            let root = d.sqrt();
            row.iter_mut().for_each(|v| *v /= root);
            for k in 1..step.min(self.n - i) {
                if row[k] != 0.0 {
                    axpy(-row[k], &row[k..], &mut rest[(k - 1) * step..k * step - k]);
                }
            }
        }
        Ok(())
    }

    /// Solves `R'R x = b` in place, of a factor.
    pub(super) fn solve(&self, x: &mut [f64]) {
        let step = self.width + 1;
        for i in 0..self.n {
            let row = &self.rows[i * step..i * step + step.min(self.n - i)];
            x[i] /= row[0];
            let v = -x[i];
            axpy(v, &row[1..], &mut x[i + 1..i + row.len()]);
        }
        for i in (0..self.n).rev() {
            let row = &self.rows[i * step..i * step + step.min(self.n - i)];
            x[i] = (x[i] - dot(&row[1..], &x[i + 1..i + row.len()])) / row[0];
        }
    }
}

#[cfg(test)]
mod tests {
    use dynocal_numerics::linalg;
    use dynocal_numerics::rng::Rng64;

    use super::*;

    /// Against the dense factor, with rows that reach beyond the width.
    #[test]
    fn a_band_is_solved_as_the_dense_matrix_is() {
        let (n, width) = (40, 5);
        let mut rng = Rng64::new(2);
        let mut band = Band::zeros(n, width);
        let mut dense = vec![0.0; n * n];
        for _ in 0..300 {
            let at = rng.below(n - width);
            let row: Vec<(usize, f64)> = (at..=at + width).map(|k| (k, rng.normal())).collect();
            band.add(&row);
            for (i, a) in &row {
                row.iter().for_each(|(j, b)| dense[i * n + j] += a * b);
            }
        }
        band.add(&[(1, 2.0), (30, -3.0)]);
        // The pair lies beyond the width: its size stands on both places of the diagonal.
        dense[n + 1] += 4.0 + 6.0;
        dense[30 * n + 30] += 9.0 + 6.0;
        let b: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let (mut x, mut wanted) = (b.clone(), b);
        band.factor().unwrap();
        band.solve(&mut x);
        linalg::cholesky(&mut dense, n).unwrap();
        linalg::solve_upper_transposed(&dense, n, &mut wanted).unwrap();
        linalg::solve_upper(&dense, n, &mut wanted).unwrap();
        let off = x.iter().zip(&wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-11, "{off:e}");
        assert!(Band::zeros(3, 1).factor().is_err());
    }
}
