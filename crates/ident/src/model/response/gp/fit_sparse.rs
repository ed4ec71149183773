//! Search for the hyperparameters of a sparse process.

use dynocal_numerics::linalg::{Factor, dot, least_squares, product};
use dynocal_numerics::optim::{Bounds, Budget, Objective, Optimiser, QuasiNewton};

use super::super::{Learnt, LeftOut, Points, Response, ResponseError, ResponseModel, Scaling};
use super::fit::{Found, GaussianProcess, LENGTHS, NOISE, Scaled};
use super::mean::Mean;
use super::sparse::{Bound, SparseGpModel, choose};

/// Variance left by the inducing points, in units of the noise, below which no more are taken.
const LEFT: f64 = 1e-3;

impl GaussianProcess {
    /// From where the exact search on a part of the points ended.
    pub(super) fn finish_sparse(
        &self,
        points: &Points,
        scaling: Scaling,
        data: &Scaled,
        start: &Found,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Learnt, ResponseError> {
        let none = || ResponseError::NoStart { model: "gaussian_process", output: points.output.clone() };
        let (n, d) = (points.len(), data.d);
        let (trend, y) = without_trend(data, self.mean).ok_or_else(none)?;
        let g = start.theta[d].exp();
        let rows = choose(start.kernel, &start.theta[..d], &data.z, d, self.inducing_points, LEFT * g);
        let inducing: Vec<f64> =
            rows.iter().flat_map(|i| data.z[i * d..(i + 1) * d].iter().copied()).collect();
        let bound = Bound { kernel: start.kernel, z: &data.z, y: &y, inducing: &inducing, d };
        let limit = |side: usize| [vec![LENGTHS[side].ln(); d], vec![NOISE[side].ln()]].concat();
        let bounds = Bounds { lower: limit(0), upper: limit(1) };
        let budget = Budget { evaluations: 40, gradient_tolerance: 1e-4, value_tolerance: 1e-6 };
        let mut negative = Negative { bound: &bound, interrupt, evaluations: 0 };
        let found = QuasiNewton::default().minimise(&mut negative, &bounds, &start.theta, &budget);
        let evaluations = negative.evaluations;
        let (lengths, g) = (&found.x[..d], found.x[d].exp());
        let left_out = bound.left_out(lengths, g, scaling.output_std).ok_or_else(none)?;
        let lost: Vec<String> = super::fit::lost_inputs(points, lengths);
        let model = SparseGpModel::build(&bound, (scaling, self.transform.transform()), lengths, g, trend)
            .ok_or_else(none)?;
        let mut notes = points.notes();
        notes.extend(lost);
        notes.push(format!(
            "{}: more than {} points; an exact one would take {} MiB; {evaluations} bounds were computed",
            model.describe(),
            self.exact_points,
            super::likelihood::Work::bytes(n) >> 20
        ));
        Ok(Learnt::new(ResponseModel::SparseGaussianProcess(model), left_out, notes))
    }
}

/// Constant and slopes by least squares, and what they leave.
fn without_trend(data: &Scaled, mean: Mean) -> Option<(Vec<f64>, Vec<f64>)> {
    let (n, d) = (data.y.len(), data.d);
    if matches!(mean, Mean::Zero | Mean::Constant) {
        // The output is scaled to mean zero.
        return Some((vec![0.0; d + 1], data.y.clone()));
    }
    let a: Vec<f64> =
        data.z.chunks_exact(d).flat_map(|z| std::iter::once(1.0).chain(z.iter().copied())).collect();
    let fit = least_squares(&a, n, d + 1, &data.y, 0.0).ok()?;
    let rest = a.chunks_exact(d + 1).zip(&data.y).map(|(row, y)| y - dot(row, &fit.x)).collect();
    Some((fit.x, rest))
}

impl Bound<'_> {
    /// Left-out residuals of the smoother `y -> Q (Q + g)^-1 y`: e_i / (1 - h_i), h_i = a_i'B^-1 a_i.
    fn left_out(&self, log_lengths: &[f64], g: f64, unit: f64) -> Option<LeftOut> {
        let (n, m) = (self.y.len(), self.inducing.len() / self.d);
        let (rotated, c, s2) = self.rotated(log_lengths, g)?;
        let mut fitted = vec![0.0; n];
        product(g.sqrt(), Factor::new(&rotated, n, m), Factor::new(&c, m, 1), false, &mut fitted).ok()?;
        let leverage =
            |i: usize| dot(&rotated[i * m..(i + 1) * m], &rotated[i * m..(i + 1) * m]).min(0.999_999);
        Some(LeftOut {
            residuals: (0..n).map(|i| unit * (self.y[i] - fitted[i]) / (1.0 - leverage(i))).collect(),
            variance: (0..n).map(|i| unit * unit * s2 * g / (1.0 - leverage(i))).collect(),
        })
    }
}

/// The negative bound for the search.
struct Negative<'a> {
    bound: &'a Bound<'a>,
    interrupt: &'a dyn Fn() -> bool,
    evaluations: usize,
}

impl Objective for Negative<'_> {
    fn n(&self) -> usize {
        self.bound.d + 1
    }

    fn value_gradient(&mut self, x: &[f64], grad: &mut [f64]) -> f64 {
        if self.evaluations > 0 && (self.interrupt)() {
            return f64::INFINITY;
        }
        self.evaluations += 1;
        let d = self.bound.d;
        match self.bound.value(&x[..d], x[d].exp(), !grad.is_empty()) {
            Some(at) => {
                grad.iter_mut().zip(&at.gradient).for_each(|(g, b)| *g = -b);
                -at.value
            }
            None => f64::INFINITY,
        }
    }
}
