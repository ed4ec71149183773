//! Prediction of an exact Gaussian process with derivatives.
//!
//! ```text
//! mean     = h'b + k'a                    d_j = h_j'b + k_j'a                     d_jl = h_jl'b + k_jl'a
//! variance = s^2 (1 - v'v + t't)          d_j = 2 s^2 (f'h_j - p'k_j)
//!                                         d_jl = 2 s^2 (f'h_jl - p'k_jl - v_j'v_l + t_j't_l)
//! k_j = 2 k' (x_j - x_ij) / l_j^2         k_jl = 4 k'' (x_j - x_ij)(x_l - x_il) / (l_j^2 l_l^2) + 2 k' [j = l] / l_j^2
//! ```
//!
//! with b, a, v, t, p, f = A^-1 t of `factors`, and v_j = W k_j, t_j = A^-T (h_j - Z'v_j).

use dynocal_numerics::linalg::dot;

use super::super::points::four;
use super::super::{Ask, Prediction, Response};
use super::model::GpModel;
use super::packed::sum_of;

impl Response for GpModel {
    fn dim(&self) -> usize {
        self.columns.len()
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        let (d, n) = (self.columns.len(), self.points());
        let q = self.stored.mean.count(d);
        let mut work = out.take_work(d + 2 * q + 6 * n + d * (n + 2 * q));
        let (point, rest) = work.split_at_mut(d);
        let (h, rest) = rest.split_at_mut(q);
        let (t, rest) = rest.split_at_mut(q);
        let (k, rest) = rest.split_at_mut(n);
        let (slopes, rest) = rest.split_at_mut(n);
        let (v, rest) = rest.split_at_mut(n);
        let (p, rest) = rest.split_at_mut(n);
        let (by_mean, rest) = rest.split_at_mut(n);
        let (by_variance, rest) = rest.split_at_mut(n);
        self.stored.scaling.input(x, point);
        self.stored.mean.values(point, h);
        self.correlations(point, k, slopes);
        let (unit, hyper) = (self.stored.scaling.output_std, &self.stored.hyper);
        let s2 = hyper.signal_variance * unit * unit;
        out.mean = self.stored.scaling.output_mean + unit * self.factors.mean(h, k);
        if ask >= Ask::Variance {
            let variance = if ask >= Ask::Gradient {
                self.factors.variance_and_slopes(h, k, v, t, p)
            } else {
                self.factors.variance(h, k, v, t)
            };
            out.variance = (s2 * variance).max(0.0);
            out.noise = s2 * self.noise_ratio(point);
        }
        if ask >= Ask::Gradient {
            let parts = Gradients { model: self, point, slopes, p, by_mean, by_variance, out };
            pulp::Arch::new().dispatch(parts);
            self.mean_functions(point, h, t, out);
            for j in 0..d {
                let per = self.stored.scaling.std[j];
                out.gradient[j] *= unit / per;
                out.variance_gradient[j] *= 2.0 * s2 / per;
            }
        }
        if ask == Ask::Hessian {
            self.hessians(point, slopes, p, t, k, rest, out);
        }
        out.work = work;
        self.stored.scaling.warp.back(x, ask, out);
        self.stored.transform.back(ask, out);
    }

    fn describe(&self) -> String {
        let of = if self.stored.transform.is_none() { "" } else { " of the logarithm" };
        let over = self.stored.scaling.warp.words();
        format!(
            "Gaussian process{of}{over}, {} kernel, {} points, noise {} of the output's standard deviation",
            self.stored.kernel.words(),
            self.points(),
            four((self.stored.hyper.signal_variance * self.stored.hyper.noise_ratio).sqrt())
        )
    }
}

impl GpModel {
    /// Covariances of the response at x (d) with that at each reference point (row by row), given the measurements:
    /// `s^2 (k(x,r) - v_x'v_r + t_x't_r)`; of a transformed output to first order.
    pub fn covariances(&self, x: &[f64], reference: &[f64]) -> Vec<f64> {
        let (d, n) = (self.columns.len(), self.points());
        let q = self.stored.mean.count(d);
        let s2 = self.stored.hyper.signal_variance * self.stored.scaling.output_std.powi(2);
        let w: Vec<f64> = self.stored.hyper.log_lengths.iter().map(|l| (-2.0 * l).exp()).collect();
        let rotated = |x: &[f64]| {
            let (mut z, mut h, mut t) = (vec![0.0; d], vec![0.0; q], vec![0.0; q]);
            let (mut k, mut slopes, mut v) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
            self.stored.scaling.input(x, &mut z);
            self.stored.mean.values(&z, &mut h);
            self.correlations(&z, &mut k, &mut slopes);
            let mut p = vec![0.0; n];
            self.factors.variance_and_slopes(&h, &k, &mut v, &mut t, &mut p);
            (z, p, t)
        };
        // As for a gradient: p and A^-1 t of x make every reference point a scalar product.
        let (z, p, of_t) = rotated(x);
        let (mut other, mut h) = (vec![0.0; d], vec![0.0; q]);
        let (mut k, mut slopes) = (vec![0.0; n], vec![0.0; n]);
        let slope = |x: &[f64]| {
            if self.stored.transform.is_none() {
                return 1.0;
            }
            let mut at = Prediction::new(d);
            self.predict(x, Ask::Mean, &mut at);
            self.stored.transform.slope_at(at.mean)
        };
        let own = slope(x);
        let each = reference.chunks_exact(d).map(|r| {
            self.stored.scaling.input(r, &mut other);
            self.stored.mean.values(&other, &mut h);
            self.correlations(&other, &mut k, &mut slopes);
            let r2 = z.iter().zip(&other).zip(&w).map(|((a, b), w)| w * (a - b) * (a - b)).sum();
            own * slope(r) * s2 * (self.stored.kernel.value_slope(r2).0 - dot(&p, &k) + dot(&of_t, &h))
        });
        each.collect()
    }

    /// k (n) at a scaled point, with dk/d(r^2) beside.
    pub(super) fn correlations(&self, point: &[f64], k: &mut [f64], slopes: &mut [f64]) {
        pulp::Arch::new().dispatch(Correlations { model: self, point, k, slopes });
    }

    /// Adds what the mean functions contribute to both gradients; f = A^-1 t.
    fn mean_functions(&self, point: &[f64], slopes: &mut [f64], f: &[f64], out: &mut Prediction) {
        for j in 0..point.len() {
            self.stored.mean.slopes(point, j, slopes);
            out.gradient[j] += dot(slopes, &self.factors.coefficients);
            out.variance_gradient[j] += dot(slopes, f);
        }
    }

    fn hessians(
        &self,
        point: &[f64],
        slopes: &[f64],
        p: &[f64],
        f: &[f64],
        column: &mut [f64],
        rest: &mut [f64],
        out: &mut Prediction,
    ) {
        let (d, n, q) = (point.len(), p.len(), f.len());
        let moving = out.moving.min(d);
        let hyper = &self.stored.hyper;
        let w: Vec<f64> = hyper.log_lengths.iter().map(|l| (-2.0 * l).exp()).collect();
        // v_j and t_j, one after the other.
        let (rows_v, rest) = rest.split_at_mut(d * n);
        let (rows_t, h) = rest.split_at_mut(d * q);
        for j in moving..d {
            for i in 0..n {
                column[i] = 2.0 * slopes[i] * (point[j] - self.columns[j][i]) * w[j];
            }
            let (v, t) = (&mut rows_v[j * n..(j + 1) * n], &mut rows_t[j * q..(j + 1) * q]);
            self.factors.times(column, v);
            self.stored.mean.slopes(point, j, &mut h[..q]);
            self.factors.rest_of_mean(&h[..q], v, t);
        }
        out.hessian.fill(0.0);
        out.variance_hessian.fill(0.0);
        pulp::Arch::new().dispatch(Seconds { model: self, point, w: &w, slopes, p, curvatures: column, out });
        let (unit, std) = (self.stored.scaling.output_std, &self.stored.scaling.std);
        let s2 = hyper.signal_variance * unit * unit;
        for j in moving..d {
            for l in j..d {
                let basis = |of: &[f64]| -> f64 {
                    (0..q).map(|k| of[k] * self.stored.mean.curvature(d, k, j, l)).sum()
                };
                let cross = dot(&rows_t[j * q..(j + 1) * q], &rows_t[l * q..(l + 1) * q])
                    - dot(&rows_v[j * n..(j + 1) * n], &rows_v[l * n..(l + 1) * n]);
                let per = std[j] * std[l];
                let mean = (out.hessian[j * d + l] + basis(&self.factors.coefficients)) * unit / per;
                let variance = 2.0 * s2 * (out.variance_hessian[j * d + l] + basis(f) + cross) / per;
                for at in [j * d + l, l * d + j] {
                    out.hessian[at] = mean;
                    out.variance_hessian[at] = variance;
                }
            }
        }
    }
}

struct Correlations<'a> {
    model: &'a GpModel,
    point: &'a [f64],
    k: &'a mut [f64],
    slopes: &'a mut [f64],
}

impl pulp::WithSimd for Correlations<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.k.fill(0.0);
        let lengths = &self.model.stored.hyper.log_lengths;
        for ((column, x), l) in self.model.columns.iter().zip(self.point).zip(lengths) {
            let w = (-2.0 * l).exp();
            for (r2, xi) in self.k.iter_mut().zip(column) {
                *r2 += w * (x - xi) * (x - xi);
            }
        }
        self.model.stored.kernel.apply(self.k, self.slopes);
    }
}

struct Gradients<'a> {
    model: &'a GpModel,
    point: &'a [f64],
    slopes: &'a [f64],
    p: &'a [f64],
    by_mean: &'a mut [f64],
    by_variance: &'a mut [f64],
    out: &'a mut Prediction,
}

impl pulp::WithSimd for Gradients<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let weights = &self.model.factors.weights;
        for i in 0..self.slopes.len() {
            self.by_mean[i] = weights[i] * self.slopes[i];
            self.by_variance[i] = -self.p[i] * self.slopes[i];
        }
        let lengths = &self.model.stored.hyper.log_lengths;
        for (j, column) in self.model.columns.iter().enumerate() {
            let (w, point) = (2.0 * (-2.0 * lengths[j]).exp(), self.point[j]);
            self.out.gradient[j] = w * sum_of(self.by_mean, column, |w, x| w * (point - x));
            self.out.variance_gradient[j] = w * sum_of(self.by_variance, column, |w, x| w * (point - x));
        }
    }
}

/// Sums of the second derivatives of the correlations over the points, for each pair of inputs that move.
struct Seconds<'a> {
    model: &'a GpModel,
    point: &'a [f64],
    w: &'a [f64],
    slopes: &'a [f64],
    p: &'a [f64],
    /// Space for k'' (n).
    curvatures: &'a mut [f64],
    out: &'a mut Prediction,
}

impl pulp::WithSimd for Seconds<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { model, point, w, slopes, p, curvatures, out } = self;
        let d = point.len();
        curvatures.fill(0.0);
        for ((column, x), w) in model.columns.iter().zip(point).zip(w) {
            for (r2, xi) in curvatures.iter_mut().zip(column) {
                *r2 += (x - xi) * (x - xi) * w;
            }
        }
        model.stored.kernel.curve(curvatures);
        let moving = out.moving.min(d);
        for (i, (curvature, slope)) in curvatures.iter().zip(slopes).enumerate() {
            let (of_mean, of_variance) = (model.factors.weights[i], p[i]);
            let apart = |j: usize| point[j] - model.columns[j][i];
            for j in moving..d {
                let by_j = 4.0 * curvature * apart(j);
                let rows = j * d + j..(j + 1) * d;
                let (means, variances) = (&mut out.hessian[rows.clone()], &mut out.variance_hessian[rows]);
                // Of one input there is a second term.
                let mut own = 2.0 * slope * w[j];
                for (l, (mean, variance)) in (j..d).zip(means.iter_mut().zip(variances)) {
                    let second = by_j * apart(l) * w[j] * w[l] + own;
                    *mean += of_mean * second;
                    *variance -= of_variance * second;
                    own = 0.0;
                }
            }
        }
    }
}
