//! The restricted likelihood of a Gaussian process, its gradient, and leave-one-out in closed form.
//!
//! ```text
//! y = H b + f + e,   cov f = s^2 R(l),   var e_i = s^2 g_i,   V = R + diag g
//! P = V^-1 - V^-1 H (H'V^-1 H)^-1 H'V^-1,   a = P y
//! 2 log L = -(n-q) log s^2 - y'a / s^2 - log|V| - log|H'V^-1 H| - (n-q) log 2 pi
//! 2 d log L = sum_ik (a_i a_k / s^2 - P_ik) dV_ik
//! s^2 = y'a / (n-q)                            where it is not given
//! y_i - yhat_i = a_i / P_ii,   var = s^2 / P_ii        without point i (b estimated again, l, g, s^2 kept)
//! ```
//!
//! The coefficients b have a flat prior; without mean functions (q = 0) this is the ordinary likelihood.
//!
//! Sources: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), eqs. (2.30), (5.9),
//! (5.12) and section 2.7; O. Dubrule, Cross validation of kriging in a unique neighborhood, Math. Geology 15 (1983).

use dynocal_numerics::linalg::{
    cholesky, cholesky_inverse, dot, invert_upper, log_det_gram, solve_upper_many,
    solve_upper_transposed_many, symmetric_update,
};

use super::factors::{Factors, sum_of};
use super::kernel::Kernel;

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

/// Buffers for n points: four matrices of n x n.
pub struct Work {
    factor: Vec<f64>,
    slope: Vec<f64>,
    inverse: Vec<f64>,
    scratch: Vec<f64>,
}

impl Work {
    /// For n points.
    pub fn new(n: usize) -> Self {
        let matrix = || vec![0.0; n * n];
        Self { factor: matrix(), slope: matrix(), inverse: matrix(), scratch: matrix() }
    }

    /// Bytes for n points.
    pub fn bytes(n: usize) -> usize {
        4 * 8 * n * n
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

impl Problem<'_> {
    /// Number of points.
    pub fn n(&self) -> usize {
        self.y.len()
    }

    /// Number of inputs.
    pub fn dim(&self) -> usize {
        self.columns.len() / self.n().max(1)
    }

    fn q(&self) -> usize {
        self.basis.len() / self.n().max(1)
    }

    fn noise(&self, ratio: f64, i: usize) -> f64 {
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
        let (n, q) = (self.n(), self.q());
        self.correlations(log_lengths, noise_ratio, work);
        cholesky(&mut work.factor, n).ok()?;
        let projection = self.project(&work.factor)?;
        let free = (n - q) as f64;
        let s2 = signal_variance.unwrap_or(projection.quadratic / free).max(f64::MIN_POSITIVE);
        let log_dets = log_det_gram(&work.factor, n) + projection.log_det_basis;
        let value = -0.5
            * (free * s2.ln()
                + projection.quadratic / s2
                + log_dets
                + free * (2.0 * std::f64::consts::PI).ln());
        let gradient = if with_gradient {
            self.projector(&projection, work)?;
            // The upper triangle becomes P - a a'/s^2.
            symmetric_update(-1.0 / s2, &projection.weights, 1, n, &mut work.inverse).ok()?;
            let mut gradient = self.contract(log_lengths, noise_ratio, work);
            let by_scale = -0.5 * (free - projection.quadratic / s2);
            gradient.push(if signal_variance.is_some() { by_scale } else { 0.0 });
            gradient
        } else {
            Vec::new()
        };
        value.is_finite().then_some(Likelihood {
            value,
            signal_variance: s2,
            gradient,
            weights: projection.weights,
            coefficients: projection.coefficients,
        })
    }

    /// Leave-one-out residuals at fixed lengths, noise ratio and signal variance.
    pub fn leave_one_out(
        &self,
        log_lengths: &[f64],
        noise_ratio: f64,
        signal_variance: f64,
        work: &mut Work,
    ) -> Option<LeaveOneOut> {
        let n = self.n();
        self.correlations(log_lengths, noise_ratio, work);
        cholesky(&mut work.factor, n).ok()?;
        let projection = self.project(&work.factor)?;
        self.projector(&projection, work)?;
        let diagonal = |i: usize| work.inverse[i * n + i];
        Some(LeaveOneOut {
            residuals: (0..n).map(|i| projection.weights[i] / diagonal(i)).collect(),
            variance: (0..n).map(|i| signal_variance / diagonal(i)).collect(),
        })
    }

    /// What predictions need at fixed lengths and noise ratio.
    pub fn factors(&self, log_lengths: &[f64], noise_ratio: f64, work: &mut Work) -> Option<Factors> {
        let n = self.n();
        self.correlations(log_lengths, noise_ratio, work);
        cholesky(&mut work.factor, n).ok()?;
        invert_upper(&work.factor, n, &mut work.scratch).ok()?;
        let mut lower = Vec::with_capacity(n * (n + 1) / 2);
        for i in 0..n {
            lower.extend((0..=i).map(|k| work.scratch[k * n + i]));
        }
        Factors::new(lower, self.basis, self.y)
    }

    /// Upper triangle of V into `work.factor`, slopes dk/d(r^2) into `work.slope`.
    fn correlations(&self, log_lengths: &[f64], noise_ratio: f64, work: &mut Work) {
        let n = self.n();
        let inverse_squares: Vec<f64> = log_lengths.iter().map(|l| (-2.0 * l).exp()).collect();
        pulp::Arch::new().dispatch(Fill {
            kernel: self.kernel,
            columns: self.columns,
            inverse_squares: &inverse_squares,
            n,
            values: &mut work.factor,
            slopes: &mut work.slope,
        });
        for i in 0..n {
            work.factor[i * n + i] = 1.0 + self.noise(noise_ratio, i);
        }
    }

    /// What follows from the factor of V by solves.
    fn project(&self, factor: &[f64]) -> Option<Projection> {
        let (n, q) = (self.n(), self.q());
        // Z = R^-T [H, y].
        let width = q + 1;
        let mut z = Vec::with_capacity(n * width);
        for i in 0..n {
            z.extend_from_slice(&self.basis[i * q..(i + 1) * q]);
            z.push(self.y[i]);
        }
        solve_upper_transposed_many(factor, n, &mut z, width).ok()?;
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
        solve_upper_transposed_many(&root, q, &mut coefficients, 1).ok()?;
        solve_upper_many(&root, q, &mut coefficients, 1).ok()?;
        // The residual before the last solve: its square sum is y'a without cancellation.
        let mut weights: Vec<f64> =
            z.chunks_exact(width).map(|row| row[q] - dot(&row[..q], &coefficients)).collect();
        let quadratic = dot(&weights, &weights);
        solve_upper_many(factor, n, &mut weights, 1).ok()?;
        // U' = R_A^-T (R^-1 Z_H)', q x n, so that V^-1 H (H'V^-1H)^-1 H'V^-1 = U U'.
        let mut solved: Vec<f64> = z.chunks_exact(width).flat_map(|row| row[..q].iter().copied()).collect();
        solve_upper_many(factor, n, &mut solved, q).ok()?;
        let mut u = vec![0.0; q * n];
        for i in 0..n {
            for j in 0..q {
                u[j * n + i] = solved[i * q + j];
            }
        }
        solve_upper_transposed_many(&root, q, &mut u, n).ok()?;
        let log_det_basis = log_det_gram(&root, q);
        Some(Projection { weights, coefficients, quadratic, u, log_det_basis })
    }

    /// Upper triangle of P into `work.inverse`.
    fn projector(&self, projection: &Projection, work: &mut Work) -> Option<()> {
        let n = self.n();
        cholesky_inverse(&work.factor, n, &mut work.scratch, &mut work.inverse).ok()?;
        symmetric_update(-1.0, &projection.u, self.q(), n, &mut work.inverse).ok()
    }

    /// `sum_ik M_ik dV_ik / 2` for all parameters, with -M in the upper triangle of `work.inverse`.
    fn contract(&self, log_lengths: &[f64], noise_ratio: f64, work: &mut Work) -> Vec<f64> {
        let (n, d) = (self.n(), self.dim());
        let by_noise: f64 = (0..n).map(|i| -0.5 * work.inverse[i * n + i] * self.noise(noise_ratio, i)).sum();
        let mut sums = vec![0.0; d];
        pulp::Arch::new().dispatch(Contract {
            columns: self.columns,
            n,
            weights: &work.inverse,
            slopes: &work.slope,
            row: &mut work.scratch,
            sums: &mut sums,
        });
        // dr^2/dlog l_j = -2 (x_j - x'_j)^2 / l_j^2; the two triangles cancel the half.
        let mut gradient: Vec<f64> =
            sums.iter().zip(log_lengths).map(|(s, l)| 2.0 * s * (-2.0 * l).exp()).collect();
        gradient.push(by_noise);
        gradient
    }
}

struct Projection {
    weights: Vec<f64>,
    coefficients: Vec<f64>,
    quadratic: f64,
    u: Vec<f64>,
    log_det_basis: f64,
}

/// Correlations and slopes of all pairs i < k.
struct Fill<'a> {
    kernel: Kernel,
    columns: &'a [f64],
    inverse_squares: &'a [f64],
    n: usize,
    values: &'a mut [f64],
    slopes: &'a mut [f64],
}

impl pulp::WithSimd for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let n = self.n;
        for i in 0..n {
            let values = &mut self.values[i * n + i..(i + 1) * n];
            values.fill(0.0);
            for (column, w) in self.columns.chunks_exact(n).zip(self.inverse_squares) {
                let own = column[i];
                for (r2, other) in values.iter_mut().zip(&column[i..]) {
                    *r2 += w * (own - other) * (own - other);
                }
            }
            self.kernel.apply(values, &mut self.slopes[i * n + i..(i + 1) * n]);
        }
    }
}

/// `sums_j = sum_{i<k} W_ik slope_ik (x_ij - x_kj)^2`.
struct Contract<'a> {
    columns: &'a [f64],
    n: usize,
    weights: &'a [f64],
    slopes: &'a [f64],
    row: &'a mut [f64],
    sums: &'a mut [f64],
}

impl pulp::WithSimd for Contract<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let n = self.n;
        for i in 0..n {
            let row = &mut self.row[i + 1..n];
            let (w, s) =
                (&self.weights[i * n + i + 1..(i + 1) * n], &self.slopes[i * n + i + 1..(i + 1) * n]);
            for ((r, w), s) in row.iter_mut().zip(w).zip(s) {
                *r = w * s;
            }
            for (column, sum) in self.columns.chunks_exact(n).zip(self.sums.iter_mut()) {
                let own = column[i];
                *sum += sum_of(row, &column[i + 1..], |w, x| w * (own - x) * (own - x));
            }
        }
    }
}
