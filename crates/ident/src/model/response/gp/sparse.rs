//! Sparse Gaussian process by variational inducing points, for more points than an exact one can take.
//!
//! ```text
//! m points z_k of the data;  K = K_mm + jitter,  C = cov(points, z),  Q = C K^-1 C'
//! bound = log N(y; 0, s^2 (Q + g I)) - tr(R - Q) / (2 g)                    never above the exact likelihood
//! L'L = K,  A = L^-T C' / sqrt(g) (m x n),  B = I + A A',  U'U = B,  c = U^-T A y / sqrt(g)
//! mean = k'L^-1 U^-1 c,   variance / s^2 = 1 - |L^-T k|^2 + |U^-T L^-T k|^2
//! ```
//!
//! Cost n m^2, memory n m. The trend (constant or slopes) is taken out by least squares before. The inducing points are
//! chosen where the variance that the others leave is largest (pivoted Cholesky of R), the hyperparameters on a part of
//! the data by the exact likelihood and then on all of it by the bound.
//!
//! Sources: M. Titsias, Variational learning of inducing variables in sparse Gaussian processes, AISTATS (2009); D. Burt,
//! C. E. Rasmussen, M. van der Wilk, Convergence of sparse variational inference in Gaussian processes regression, JMLR 21
//! (2020), section 4 (choice of the points).

use dynocal_numerics::linalg::{
    Factor, cholesky, dot, gram_upper, log_det_gram, product, solve_upper, solve_upper_many,
    solve_upper_transposed, solve_upper_transposed_many,
};
use serde::{Deserialize, Serialize};

use super::super::formula::{Part, Product};
use super::super::transform::Transform;
use super::super::{Ask, Prediction, Response, Scaling};
use super::kernel::Kernel;
use super::mean::Mean;

/// Added to the diagonal of K_mm.
const JITTER: f64 = 1e-8;

/// Scaled points for the bound.
pub(super) struct Bound<'a> {
    pub(super) kernel: Kernel,
    /// Inputs, n x d.
    pub(super) z: &'a [f64],
    /// Output without its trend (n).
    pub(super) y: &'a [f64],
    /// Inducing points, m x d.
    pub(super) inducing: &'a [f64],
    pub(super) d: usize,
}

/// Value and gradient of the bound.
#[derive(Clone, Debug)]
pub(super) struct BoundValue {
    pub(super) value: f64,
    /// With respect to the log lengths (d) and the log noise ratio.
    pub(super) gradient: Vec<f64>,
}

/// Correlations and slopes of rows `a` (k x d) with rows `b` (l x d), k x l.
fn cross(kernel: Kernel, w: &[f64], a: &[f64], b: &[f64], d: usize) -> (Vec<f64>, Vec<f64>) {
    let l = b.len() / d;
    let columns: Vec<f64> = (0..d).flat_map(|j| b.iter().skip(j).step_by(d).copied()).collect();
    let mut values = vec![0.0; a.len() / d * l];
    let mut slopes = vec![0.0; values.len()];
    pulp::Arch::new().dispatch(Cross {
        kernel,
        w,
        a,
        columns: &columns,
        l,
        values: &mut values,
        slopes: &mut slopes,
    });
    (values, slopes)
}

struct Cross<'a> {
    kernel: Kernel,
    w: &'a [f64],
    a: &'a [f64],
    columns: &'a [f64],
    l: usize,
    values: &'a mut [f64],
    slopes: &'a mut [f64],
}

impl pulp::WithSimd for Cross<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let rows = self.values.chunks_exact_mut(self.l).zip(self.slopes.chunks_exact_mut(self.l));
        for ((values, slopes), a) in rows.zip(self.a.chunks_exact(self.w.len())) {
            for ((column, w), x) in self.columns.chunks_exact(self.l).zip(self.w).zip(a) {
                for (r2, other) in values.iter_mut().zip(column) {
                    *r2 += w * (x - other) * (x - other);
                }
            }
            self.kernel.apply(values, slopes);
        }
    }
}

/// The factors for given hyperparameters.
struct Factors {
    /// L (m x m) and U (m x m), upper triangular.
    l: Vec<f64>,
    u: Vec<f64>,
    /// A', n x m.
    a: Vec<f64>,
    /// c (m).
    c: Vec<f64>,
    /// Slopes of C (n x m) and of K_mm (m x m), with C itself.
    cross_slopes: Vec<f64>,
    inner_slopes: Vec<f64>,
    quadratic: f64,
    trace: f64,
}

impl Bound<'_> {
    fn factors(&self, log_lengths: &[f64], g: f64) -> Option<Factors> {
        let (n, m) = (self.y.len(), self.inducing.len() / self.d);
        let w: Vec<f64> = log_lengths.iter().map(|l| (-2.0 * l).exp()).collect();
        let (mut l, inner_slopes) = cross(self.kernel, &w, self.inducing, self.inducing, self.d);
        (0..m).for_each(|i| l[i * m + i] = 1.0 + JITTER);
        cholesky(&mut l, m).ok()?;
        let (a, cross_slopes) = cross(self.kernel, &w, self.z, self.inducing, self.d);
        // L^-T C' / sqrt g: rows of C are right-hand sides, so C is transposed around the solve.
        let mut t = transpose(&a, n, m);
        solve_upper_transposed_many(&l, m, &mut t, n).ok()?;
        let a = transpose(&t, m, n);
        let root = g.sqrt();
        let a: Vec<f64> = a.into_iter().map(|v| v / root).collect();
        let mut u = vec![0.0; m * m];
        gram_upper(&a, n, m, &mut u).ok()?;
        let trace = (0..m).map(|i| u[i * m + i]).sum();
        (0..m).for_each(|i| u[i * m + i] += 1.0);
        cholesky(&mut u, m).ok()?;
        let mut c = vec![0.0; m];
        product(1.0 / root, Factor::transposed(&a, n, m), Factor::new(self.y, n, 1), false, &mut c).ok()?;
        solve_upper_transposed(&u, m, &mut c).ok()?;
        let quadratic = dot(self.y, self.y) / g - dot(&c, &c);
        Some(Factors { l, u, a, c, cross_slopes, inner_slopes, quadratic, trace })
    }

    /// The bound at its best signal variance. `None` where a matrix is not numerically positive definite.
    ///
    /// With `W = (Q + g)^-1`, `a = W y`, `2 d bound = tr((a a'/s^2 - W) dQ) - tr(dR - dQ)/g` and the same for g; dQ comes
    /// back to dC and dK_mm through `P = K^-1 C'`.
    pub(super) fn value(&self, log_lengths: &[f64], g: f64, with_gradient: bool) -> Option<BoundValue> {
        let (n, m, d) = (self.y.len(), self.inducing.len() / self.d, self.d);
        let f = self.factors(log_lengths, g)?;
        let size = n as f64;
        let s2 = (f.quadratic / size).max(f64::MIN_POSITIVE);
        let rest = size - g * f.trace;
        let log_det = size * g.ln() + log_det_gram(&f.u, m);
        let two_pi = (2.0 * std::f64::consts::PI).ln();
        // The trace term is of the scaled process: s^2 (R - Q) over the noise s^2 g.
        let value = -0.5 * (size * (two_pi + s2.ln() + 1.0) + log_det + rest / g);
        if !value.is_finite() {
            return None;
        }
        if !with_gradient {
            return Some(BoundValue { value, gradient: Vec::new() });
        }
        let root = g.sqrt();
        // a = (y - A' U^-1 c sqrt(g)... ) / g = (y/g - A'(U^-1 c) / sqrt g).
        let mut half = f.c.clone();
        solve_upper(&f.u, m, &mut half).ok()?;
        let mut alpha = vec![0.0; n];
        product(-1.0 / root, Factor::new(&f.a, n, m), Factor::new(&half, m, 1), false, &mut alpha).ok()?;
        alpha.iter_mut().zip(self.y).for_each(|(a, y)| *a += y / g);
        // P = K^-1 C' as n x m: sqrt g A' L^-T.
        let mut p = transpose(&f.a, n, m);
        solve_upper_many(&f.l, m, &mut p, n).ok()?;
        let p: Vec<f64> = transpose(&p, m, n).into_iter().map(|v| v * root).collect();
        // W P with W = (I - A' B^-1 A) / g; A P' = sqrt g (B - I) L^-T, so W P = A' B^-1 L^-T / sqrt g.
        let mut wp = transpose(&f.a, n, m);
        solve_upper_transposed_many(&f.u, m, &mut wp, n).ok()?;
        solve_upper_many(&f.u, m, &mut wp, n).ok()?;
        solve_upper_many(&f.l, m, &mut wp, n).ok()?;
        let wp = transpose(&wp, m, n);
        // 2 d bound = sum G_C dC + sum G_K dK, with M = a a'/s^2 - W + I/g: G_C = 2 M P, G_K = -P'M P.
        let mut ap = vec![0.0; m];
        product(1.0, Factor::transposed(&p, n, m), Factor::new(&alpha, n, 1), false, &mut ap).ok()?;
        let mut mp: Vec<f64> = vec![0.0; n * m];
        for i in 0..n {
            for k in 0..m {
                mp[i * m + k] = alpha[i] * ap[k] / s2 - wp[i * m + k] / root + p[i * m + k] / g;
            }
        }
        let mut pmp = vec![0.0; m * m];
        product(1.0, Factor::transposed(&p, n, m), Factor::new(&mp, n, m), false, &mut pmp).ok()?;
        let mut gradient = vec![0.0; d + 1];
        let mut add = |gi: f64, slope: f64, a: &[f64], b: &[f64]| {
            let weight = gi * slope;
            for j in 0..d {
                gradient[j] += weight * (a[j] - b[j]) * (a[j] - b[j]);
            }
        };
        let row = |v: &'_ [f64], i: usize| -> Vec<f64> { v[i * d..(i + 1) * d].to_vec() };
        for (i, zi) in self.z.chunks_exact(d).enumerate() {
            for (k, zk) in self.inducing.chunks_exact(d).enumerate() {
                add(2.0 * mp[i * m + k], f.cross_slopes[i * m + k], zi, zk);
            }
        }
        for i in 0..m {
            let zi = row(self.inducing, i);
            for (k, zk) in self.inducing.chunks_exact(d).enumerate() {
                add(-pmp[i * m + k], f.inner_slopes[i * m + k], &zi, zk);
            }
        }
        // dr^2 / dlog l_j = -2 (..)^2 / l_j^2, and the half in front.
        for j in 0..d {
            gradient[j] *= -(-2.0 * log_lengths[j]).exp();
        }
        // dV/dlog g = g I: a'a g / s^2 - g tr W, and the trace term over g. tr W = (n - m + tr B^-1) / g.
        let mut inverse: Vec<f64> = (0..m * m).map(|q| f64::from(u8::from(q / m == q % m))).collect();
        solve_upper_transposed_many(&f.u, m, &mut inverse, m).ok()?;
        let trace_inverse = dot(&inverse, &inverse);
        gradient[d] = 0.5 * (g * dot(&alpha, &alpha) / s2 - (size - m as f64 + trace_inverse) + rest / g);
        Some(BoundValue { value, gradient })
    }
}

impl Bound<'_> {
    /// Rows U^-T a_i (n x m), c (m), and the best signal variance.
    pub(super) fn rotated(&self, log_lengths: &[f64], g: f64) -> Option<(Vec<f64>, Vec<f64>, f64)> {
        let (n, m) = (self.y.len(), self.inducing.len() / self.d);
        let f = self.factors(log_lengths, g)?;
        let mut t = transpose(&f.a, n, m);
        solve_upper_transposed_many(&f.u, m, &mut t, n).ok()?;
        Some((transpose(&t, m, n), f.c, f.quadratic / n as f64))
    }
}

fn transpose(a: &[f64], rows: usize, cols: usize) -> Vec<f64> {
    let mut out = vec![0.0; rows * cols];
    // In squares, so that neither side strides through memory.
    for i0 in (0..rows).step_by(32) {
        for j0 in (0..cols).step_by(32) {
            for i in i0..(i0 + 32).min(rows) {
                for j in j0..(j0 + 32).min(cols) {
                    out[j * rows + i] = a[i * cols + j];
                }
            }
        }
    }
    out
}

/// Rows with the largest variance left by those before (pivoted Cholesky of the correlations), at most `count`; ends where
/// less than `least` of the variance is left everywhere.
pub(super) fn choose(
    kernel: Kernel,
    log_lengths: &[f64],
    z: &[f64],
    d: usize,
    count: usize,
    least: f64,
) -> Vec<usize> {
    let n = z.len() / d;
    let w: Vec<f64> = log_lengths.iter().map(|l| (-2.0 * l).exp()).collect();
    let mut left: Vec<f64> = vec![1.0; n];
    let mut rows: Vec<Vec<f64>> = Vec::new();
    let mut chosen = Vec::new();
    while chosen.len() < count.min(n) {
        let next = (0..n).max_by(|a, b| left[*a].total_cmp(&left[*b]).then(b.cmp(a))).unwrap_or(0);
        if left[next] < least {
            break;
        }
        let (mut row, _) = cross(kernel, &w, &z[next * d..(next + 1) * d], z, d);
        for other in &rows {
            dynocal_numerics::linalg::axpy(-other[next], other, &mut row);
        }
        let pivot = left[next].sqrt();
        for (r, l) in row.iter_mut().zip(left.iter_mut()) {
            *r /= pivot;
            *l = (*l - *r * *r).max(0.0);
        }
        left[next] = 0.0;
        rows.push(row);
        chosen.push(next);
    }
    chosen
}

/// A sparse process that was learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SparseGpModel {
    scaling: Scaling,
    /// Of the output, before it is scaled.
    #[serde(default, skip_serializing_if = "Transform::is_none")]
    transform: Transform,
    kernel: Kernel,
    log_lengths: Vec<f64>,
    noise_ratio: f64,
    signal_variance: f64,
    /// Trend: constant and slopes (1 + d).
    trend: Vec<f64>,
    /// Inducing points, m x d, scaled.
    inducing: Vec<f64>,
    /// L^-1 U^-1 c (m).
    weights: Vec<f64>,
    /// `K^-1 - L^-1 B^-1 L^-T` (m x m): variance = 1 - k'(.)k.
    reduction: Vec<f64>,
    points: usize,
}

impl SparseGpModel {
    /// Builds the predictor from the bound's factors.
    pub(super) fn build(
        bound: &Bound<'_>,
        (scaling, transform): (Scaling, Transform),
        log_lengths: &[f64],
        g: f64,
        trend: Vec<f64>,
    ) -> Option<Self> {
        let m = bound.inducing.len() / bound.d;
        let f = bound.factors(log_lengths, g)?;
        let s2 = f.quadratic / bound.y.len() as f64;
        let mut weights = f.c.clone();
        solve_upper(&f.u, m, &mut weights).ok()?;
        solve_upper(&f.l, m, &mut weights).ok()?;
        let identity = || (0..m * m).map(|q| f64::from(u8::from(q / m == q % m))).collect::<Vec<f64>>();
        let (mut li, mut ui) = (identity(), identity());
        // L^-T, and U^-T L^-T.
        solve_upper_transposed_many(&f.l, m, &mut li, m).ok()?;
        solve_upper_transposed_many(&f.l, m, &mut ui, m).ok()?;
        solve_upper_transposed_many(&f.u, m, &mut ui, m).ok()?;
        let mut reduction = vec![0.0; m * m];
        product(1.0, Factor::transposed(&li, m, m), Factor::new(&li, m, m), false, &mut reduction).ok()?;
        product(-1.0, Factor::transposed(&ui, m, m), Factor::new(&ui, m, m), true, &mut reduction).ok()?;
        Some(Self {
            scaling,
            transform,
            kernel: bound.kernel,
            log_lengths: log_lengths.to_vec(),
            noise_ratio: g,
            signal_variance: s2,
            trend,
            inducing: bound.inducing.to_vec(),
            weights,
            reduction,
            points: bound.y.len(),
        })
    }

    /// Transform of the output.
    pub fn transform(&self) -> Transform {
        self.transform
    }

    /// Scaling of inputs and output.
    pub(in super::super) fn scaling(&self) -> &Scaling {
        &self.scaling
    }

    /// Summands of the mean of the scaled output.
    pub(in super::super) fn parts(&self) -> Vec<Part> {
        let d = self.log_lengths.len();
        let products = Mean::Linear.products(d).into_iter().zip(&self.trend);
        let kernels = Part::Kernels {
            kernel: self.kernel,
            inverse_squares: self.log_lengths.iter().map(|l| (-2.0 * l).exp()).collect(),
            centres: self.inducing.clone(),
            weights: self.weights.clone(),
        };
        vec![Part::Polynomial(products.map(|(f, c)| Product::new(*c, d, &f)).collect()), kernels]
    }

    /// Number of inducing points m.
    pub fn inducing_points(&self) -> usize {
        self.weights.len()
    }
}

impl Response for SparseGpModel {
    fn dim(&self) -> usize {
        self.scaling.mean.len()
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        let (d, m) = (x.len(), self.weights.len());
        let mut work = out.take_work(2 * d + 3 * m + d * m);
        let (z, rest) = work.split_at_mut(d);
        let (w, rest) = rest.split_at_mut(d);
        let (k, rest) = rest.split_at_mut(m);
        let (slopes, rest) = rest.split_at_mut(m);
        let (p, jacobian) = rest.split_at_mut(m);
        self.scaling.input(x, z);
        w.iter_mut().zip(&self.log_lengths).for_each(|(w, l)| *w = (-2.0 * l).exp());
        let distance =
            |c: &[f64]| c.iter().zip(&*z).zip(&*w).map(|((c, z), w)| w * (z - c) * (z - c)).sum::<f64>();
        for (i, c) in self.inducing.chunks_exact(d).enumerate() {
            (k[i], slopes[i]) = self.kernel.value_slope(distance(c));
        }
        let (unit, std) = (self.scaling.output_std, &self.scaling.std);
        let s2 = self.signal_variance * unit * unit;
        let trend = self.trend[0] + dot(&self.trend[1..], z);
        out.mean = self.scaling.output_mean + unit * (trend + dot(&self.weights, k));
        if ask >= Ask::Variance {
            self.reduction.chunks_exact(m).zip(p.iter_mut()).for_each(|(row, p)| *p = dot(row, k));
            out.variance = (s2 * (1.0 - dot(k, p))).max(0.0);
            out.noise = s2 * self.noise_ratio;
        }
        if ask >= Ask::Gradient {
            for j in 0..d {
                let column = &mut jacobian[j * m..(j + 1) * m];
                for (i, c) in self.inducing.chunks_exact(d).enumerate() {
                    column[i] = 2.0 * slopes[i] * (z[j] - c[j]) * w[j];
                }
                out.gradient[j] = unit * (self.trend[1 + j] + dot(&self.weights, column)) / std[j];
                out.variance_gradient[j] = -2.0 * s2 * dot(p, column) / std[j];
            }
        }
        if ask == Ask::Hessian {
            out.hessian.fill(0.0);
            out.variance_hessian.fill(0.0);
            for (i, c) in self.inducing.chunks_exact(d).enumerate() {
                let at = self.kernel.correlation(distance(c));
                for j in 0..d {
                    for l in 0..d {
                        let own = if j == l { 2.0 * at.slope * w[j] } else { 0.0 };
                        let second = 4.0 * at.curvature * (z[j] - c[j]) * (z[l] - c[l]) * w[j] * w[l] + own;
                        out.hessian[j * d + l] += self.weights[i] * second;
                        out.variance_hessian[j * d + l] += p[i] * second;
                    }
                }
            }
            for j in 0..d {
                self.reduction
                    .chunks_exact(m)
                    .zip(k.iter_mut())
                    .for_each(|(row, k)| *k = dot(row, &jacobian[j * m..(j + 1) * m]));
                for l in 0..d {
                    let at = j * d + l;
                    let cross = dot(k, &jacobian[l * m..(l + 1) * m]);
                    out.hessian[at] *= unit / (std[j] * std[l]);
                    out.variance_hessian[at] =
                        -2.0 * s2 * (out.variance_hessian[at] + cross) / (std[j] * std[l]);
                }
            }
        }
        out.work = work;
        self.scaling.warp.back(x, ask, out);
        self.transform.back(ask, out);
    }

    fn describe(&self) -> String {
        let of = if self.transform.is_none() { "" } else { " of the logarithm" };
        let over = self.scaling.warp.words();
        format!(
            "sparse Gaussian process{of}{over}, {} kernel, {} inducing points for {} points",
            self.kernel.words(),
            self.weights.len(),
            self.points
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::likelihood::{Problem, Work};
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn case(n: usize, d: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut rng = Rng64::new(seed);
        let z: Vec<f64> = (0..n * d).map(|_| rng.normal()).collect();
        let y = z.chunks_exact(d).map(|z| z[0].sin() + z[1] * z[0].cos() + 0.1 * rng.normal()).collect();
        (z, y)
    }

    #[test]
    fn with_all_points_the_bound_is_the_likelihood_and_with_fewer_it_lies_below() {
        for kernel in Kernel::ALL {
            let (z, y) = case(40, 2, 3);
            let columns = transpose(&z, 40, 2);
            let problem = Problem { kernel, columns: &columns, y: &y, basis: &[], noise_shape: &[] };
            let (logs, g) = ([0.1, 0.6], 0.02);
            let exact = problem.likelihood(&logs, g, None, false, &mut Work::new(40)).unwrap();
            let of = |m: usize| Bound { kernel, z: &z, y: &y, inducing: &z[..2 * m], d: 2 };
            let all = of(40).value(&logs, g, false).unwrap();
            assert!((all.value - exact.value).abs() < 1e-3, "{kernel:?}: {} {}", all.value, exact.value);
            let mut last = all.value;
            for m in [30, 20, 10] {
                let value = of(m).value(&logs, g, false).unwrap().value;
                assert!(value < last + 1e-9, "{kernel:?} {m}");
                last = value;
            }
        }
    }

    #[test]
    fn gradient_of_the_bound_is_that_of_differences() {
        for kernel in Kernel::ALL {
            let (z, y) = case(60, 2, 4);
            let bound = Bound { kernel, z: &z, y: &y, inducing: &z[..24], d: 2 };
            let theta = [0.2, -0.3, -3.0];
            let at = |t: &[f64], g: bool| bound.value(&t[..2], t[2].exp(), g).unwrap();
            let gradient = at(&theta, true).gradient;
            for k in 0..3 {
                let (mut up, mut down) = (theta, theta);
                up[k] += 1e-5;
                down[k] -= 1e-5;
                let difference = (at(&up, false).value - at(&down, false).value) / 2e-5;
                let close = (gradient[k] - difference).abs() < 1e-5 * (1.0 + difference.abs());
                assert!(close, "{kernel:?} {k}: {} {difference}", gradient[k]);
            }
        }
    }
}
