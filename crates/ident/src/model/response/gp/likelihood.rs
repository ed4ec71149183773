//! The restricted likelihood of a Gaussian process, its gradient, and leave-one-out in closed form.
//!
//! ```text
//! y = H b + f + e,   cov f = s^2 R(l),   var e_i = s^2 g_i,   V = R + diag g
//! P = V^-1 - V^-1 H (H'V^-1 H)^-1 H'V^-1,   a = P y
//! 2 log L = -(n-q) log s^2 - y'a / s^2 - log|V| - log|H'V^-1 H| - (n-q) log 2 pi
//! 2 d log L = sum_ik (a_i a_k / s^2 - P_ik) dV_ik
//! s^2 = y'a / (n-q)                            where it is not given
//! J_jk = (f_j'P f_k - a'f_j a'f_k / ((n-q) s^2)) / (2 s^2),   f_j = dV/dtheta_j a
//! y_i - yhat_i = a_i / P_ii,   var = s^2 / P_ii        without point i (b estimated again, l, g, s^2 kept)
//! ```
//!
//! The coefficients b have a flat prior; without mean functions (q = 0) this is the ordinary likelihood. J is the average of
//! observed and expected information at the best s^2: it needs no product of matrices (`newton`). V stands in tiles (`tiles`),
//! and the sums over them are taken tile by tile without V^-1 as a whole.
//!
//! Sources: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), eqs. (2.30), (5.9),
//! (5.12) and section 2.7; O. Dubrule, Cross validation of kriging in a unique neighborhood, Math. Geology 15 (1983);
//! A. R. Gilmour, R. Thompson, B. R. Cullis, Average information REML, Biometrics 51 (1995), 1440-1450.

use dynocal_numerics::linalg::{
    cholesky, dot, log_det_gram, solve_upper, solve_upper_transposed, solve_upper_transposed_many,
};
use rayon::prelude::*;

use super::factors::Factors;
use super::kernel::Kernel;
use super::slopes::{self, Slopes};
use super::tiles::Tiles;

/// What a likelihood is computed from. Inputs and output are scaled.
#[derive(Clone, Debug)]
pub struct Problem<'a> {
    /// Correlation function.
    pub kernel: Kernel,
    /// Inputs column by column (d x n).
    pub columns: &'a [f64],
    /// Output (n).
    pub y: &'a [f64],
    /// Mean functions at the points, n x q row-major.
    pub basis: &'a [f64],
    /// Factor of the noise variance of each point (n), or empty for equal noise.
    pub noise_shape: &'a [f64],
}

/// Buffers for n points: three upper triangles.
pub struct Work {
    /// V, then its factor R.
    pub(super) factor: Tiles,
    /// dk/d(r^2).
    pub(super) slope: Tiles,
    /// R^-1.
    pub(super) root: Tiles,
}

impl Work {
    /// For n points.
    pub fn new(n: usize) -> Self {
        Self { factor: Tiles::new(n), slope: Tiles::new(n), root: Tiles::new(n) }
    }

    /// Bytes for n points.
    pub fn bytes(n: usize) -> usize {
        3 * 8 * Tiles::len(n)
    }
}

/// A likelihood with what comes along.
#[derive(Clone, Debug, Default)]
pub struct Likelihood {
    /// log L.
    pub value: f64,
    /// Signal variance s^2: given, or the best one.
    pub signal_variance: f64,
    /// Gradient with respect to `log l_j` (d), `log g` at constant s^2, and `log s^2` at constant g (zero where s^2 was
    /// the best one); empty where not asked for.
    pub gradient: Vec<f64>,
    /// a = P y (n).
    pub weights: Vec<f64>,
    /// Coefficients b of the mean functions (q).
    pub coefficients: Vec<f64>,
}

/// Leave-one-out prediction of each point.
#[derive(Clone, Debug, PartialEq)]
pub struct LeaveOneOut {
    /// `y_i - yhat_i`, in the unit of y.
    pub residuals: Vec<f64>,
    /// Variance of that residual: of the response without point i and of its noise.
    pub variance: Vec<f64>,
}

/// A likelihood whose factor stands in the buffers that it was computed in.
pub(super) struct Factored {
    pub(super) value: f64,
    pub(super) signal_variance: f64,
    pub(super) projection: Projection,
}

/// What follows from the factor of V by solves.
pub(super) struct Projection {
    /// a (n).
    pub(super) weights: Vec<f64>,
    coefficients: Vec<f64>,
    quadratic: f64,
    /// U (n x q) with `V^-1 H (H'V^-1H)^-1 H'V^-1 = U U'`.
    pub(super) u: Vec<f64>,
    log_det_basis: f64,
}

impl Problem<'_> {
    /// Number of points.
    pub fn n(&self) -> usize {
        self.y.len()
    }

    /// Number of inputs.
    pub fn dim(&self) -> usize {
        self.columns.len() / self.n().max(1)
    }

    pub(super) fn q(&self) -> usize {
        self.basis.len() / self.n().max(1)
    }

    pub(super) fn noise(&self, ratio: f64, i: usize) -> f64 {
        ratio * self.noise_shape.get(i).copied().unwrap_or(1.0)
    }

    /// log L at `log_lengths` (d) and noise ratio g, with s^2 given or the best one. `None` where V is not numerically
    /// positive definite.
    pub fn likelihood(
        &self,
        log_lengths: &[f64],
        noise_ratio: f64,
        signal_variance: Option<f64>,
        with_gradient: bool,
        work: &mut Work,
    ) -> Option<Likelihood> {
        let at = self.factored(log_lengths, noise_ratio, signal_variance, work)?;
        let gradient = if with_gradient {
            let mut gradient = self.slopes(log_lengths, noise_ratio, &at, work)?.gradient;
            let free = (self.n() - self.q()) as f64;
            let by_scale = -0.5 * (free - at.projection.quadratic / at.signal_variance);
            gradient.push(if signal_variance.is_some() { by_scale } else { 0.0 });
            gradient
        } else {
            Vec::new()
        };
        Some(Likelihood {
            value: at.value,
            signal_variance: at.signal_variance,
            gradient,
            weights: at.projection.weights,
            coefficients: at.projection.coefficients,
        })
    }

    /// The value alone; leaves the factor of V and the slopes of the correlations in `work`.
    pub(super) fn factored(
        &self,
        log_lengths: &[f64],
        noise_ratio: f64,
        signal_variance: Option<f64>,
        work: &mut Work,
    ) -> Option<Factored> {
        let (n, q) = (self.n(), self.q());
        self.correlations(log_lengths, noise_ratio, work);
        work.factor.cholesky().ok()?;
        let projection = self.project(&work.factor)?;
        let free = (n - q) as f64;
        let s2 = signal_variance.unwrap_or(projection.quadratic / free).max(f64::MIN_POSITIVE);
        let log_det = 2.0 * (0..n).map(|i| work.factor.diagonal(i).ln()).sum::<f64>();
        let value = -0.5
            * (free * s2.ln()
                + projection.quadratic / s2
                + log_det
                + projection.log_det_basis
                + free * (2.0 * std::f64::consts::PI).ln());
        value.is_finite().then_some(Factored { value, signal_variance: s2, projection })
    }

    /// Gradient with respect to log lengths and log noise ratio at constant s^2 (d + 1) and the average information, from
    /// what [`Problem::factored`] left in `work`.
    pub(super) fn slopes(
        &self,
        log_lengths: &[f64],
        noise_ratio: f64,
        at: &Factored,
        work: &mut Work,
    ) -> Option<Slopes> {
        work.factor.inverse_into(&mut work.root).ok()?;
        slopes::of(self, log_lengths, noise_ratio, at, work)
    }

    /// Leave-one-out residuals at fixed lengths, noise ratio and signal variance.
    pub fn leave_one_out(
        &self,
        log_lengths: &[f64],
        noise_ratio: f64,
        signal_variance: f64,
        work: &mut Work,
    ) -> Option<LeaveOneOut> {
        let (n, q) = (self.n(), self.q());
        let at = self.factored(log_lengths, noise_ratio, Some(signal_variance), work)?;
        work.factor.inverse_into(&mut work.root).ok()?;
        let mut diagonal = work.root.square_diagonal();
        if q > 0 {
            diagonal.iter_mut().zip(at.projection.u.chunks_exact(q)).for_each(|(v, u)| *v -= dot(u, u));
        }
        Some(LeaveOneOut {
            residuals: (0..n).map(|i| at.projection.weights[i] / diagonal[i]).collect(),
            variance: diagonal.iter().map(|v| signal_variance / v).collect(),
        })
    }

    /// What predictions need at fixed lengths and noise ratio.
    pub fn factors(&self, log_lengths: &[f64], noise_ratio: f64, work: &mut Work) -> Option<Factors> {
        self.correlations(log_lengths, noise_ratio, work);
        work.factor.cholesky().ok()?;
        work.factor.inverse_into(&mut work.root).ok()?;
        Factors::new(work.root.packed_transposed(), self.basis, self.y)
    }

    /// V into `work.factor`, slopes dk/d(r^2) into `work.slope`.
    fn correlations(&self, log_lengths: &[f64], noise_ratio: f64, work: &mut Work) {
        let n = self.n();
        let inverse_squares: Vec<f64> = log_lengths.iter().map(|l| (-2.0 * l).exp()).collect();
        let pairs = work.factor.pairs();
        let ranges: Vec<_> = (0..work.factor.count()).map(|i| work.factor.rows(i)).collect();
        let (values, slopes) = (work.factor.all_mut(), work.slope.all_mut());
        values.par_iter_mut().zip(slopes.par_iter_mut()).zip(pairs).for_each(|((values, slopes), (i, j))| {
            let (rows, cols) = (&ranges[i], &ranges[j]);
            pulp::Arch::new().dispatch(Fill {
                kernel: self.kernel,
                columns: self.columns,
                inverse_squares: &inverse_squares,
                n,
                rows: rows.clone(),
                cols: cols.clone(),
                values,
                slopes,
            });
            if i == j {
                for (at, row) in rows.clone().enumerate() {
                    values[at * cols.len() + at] = 1.0 + self.noise(noise_ratio, row);
                }
            }
        });
    }

    /// What follows from the factor of V by solves.
    fn project(&self, factor: &Tiles) -> Option<Projection> {
        let (n, q) = (self.n(), self.q());
        // Z = R^-T [H, y].
        let width = q + 1;
        let mut z = Vec::with_capacity(n * width);
        for i in 0..n {
            z.extend_from_slice(&self.basis[i * q..(i + 1) * q]);
            z.push(self.y[i]);
        }
        factor.solve_transposed(&mut z, width).ok()?;
        let mut root = vec![0.0; q * q];
        let mut coefficients = vec![0.0; q];
        for row in z.chunks_exact(width) {
            for i in 0..q {
                coefficients[i] += row[i] * row[q];
                for j in i..q {
                    root[i * q + j] += row[i] * row[j];
                }
            }
        }
        cholesky(&mut root, q).ok()?;
        solve_upper_transposed(&root, q, &mut coefficients).ok()?;
        solve_upper(&root, q, &mut coefficients).ok()?;
        // The residual before the last solve: its square sum is y'a without cancellation.
        let mut quadratic = 0.0;
        for row in z.chunks_exact_mut(width) {
            row[q] -= dot(&row[..q], &coefficients);
            quadratic += row[q] * row[q];
        }
        // R^-1 [Z_H, residual] = [V^-1 H, a].
        factor.solve(&mut z, width).ok()?;
        let weights = z.chunks_exact(width).map(|row| row[q]).collect();
        // U' = R_A^-T (V^-1 H)'.
        let mut transposed = vec![0.0; q * n];
        for (i, row) in z.chunks_exact(width).enumerate() {
            (0..q).for_each(|j| transposed[j * n + i] = row[j]);
        }
        solve_upper_transposed_many(&root, q, &mut transposed, n).ok()?;
        let u =
            (0..n).flat_map(|i| (0..q).map(move |j| (i, j))).map(|(i, j)| transposed[j * n + i]).collect();
        let log_det_basis = log_det_gram(&root, q);
        Some(Projection { weights, coefficients, quadratic, u, log_det_basis })
    }
}

/// Correlations and slopes of the pairs of a tile; on the diagonal those of the upper triangle.
struct Fill<'a> {
    kernel: Kernel,
    columns: &'a [f64],
    inverse_squares: &'a [f64],
    n: usize,
    rows: std::ops::Range<usize>,
    cols: std::ops::Range<usize>,
    values: &'a mut [f64],
    slopes: &'a mut [f64],
}

impl pulp::WithSimd for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let width = self.cols.len();
        for (at, i) in self.rows.enumerate() {
            let from = i.max(self.cols.start);
            let part = at * width + from - self.cols.start..(at + 1) * width;
            let values = &mut self.values[part.clone()];
            values.fill(0.0);
            for (column, w) in self.columns.chunks_exact(self.n).zip(self.inverse_squares) {
                let own = column[i];
                for (r2, other) in values.iter_mut().zip(&column[from..self.cols.end]) {
                    *r2 += w * (own - other) * (own - other);
                }
            }
            self.kernel.apply(values, &mut self.slopes[part]);
        }
    }
}
