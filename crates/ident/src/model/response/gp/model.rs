//! An exact Gaussian process that was learnt: what is stored, and what is computed again from it.

use serde::{Deserialize, Serialize};

use super::super::ResponseError;
use super::super::formula::{Part, Product};
use super::super::scaling::Scaling;
use super::super::transform::Transform;
use super::factors::Factors;
use super::kernel::Kernel;
use super::likelihood::{Problem, Work};
use super::mean::Mean;
use super::noise::VaryingNoise;

/// What the likelihood decides, in scaled inputs and output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hyperparameters {
    /// Natural logarithm of the length of each input (d), in its standard deviations.
    pub log_lengths: Vec<f64>,
    /// Variance of the noise over that of the signal.
    pub noise_ratio: f64,
    /// Signal variance s^2, in squared standard deviations of the output.
    pub signal_variance: f64,
}

/// An exact Gaussian process. Stored are the points and the hyperparameters; the inverse factor, n (n + 1) / 2
/// numbers, is computed again where the model is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct GpModel {
    pub(super) stored: Stored,
    /// Scaled inputs column by column (d x n), with room to grow.
    pub(super) columns: Vec<Vec<f64>>,
    pub(super) factors: Factors,
}

/// The part of a model that is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Stored {
    pub(super) scaling: Scaling,
    /// Of the output, before it is scaled.
    #[serde(default, skip_serializing_if = "Transform::is_none")]
    pub(super) transform: Transform,
    pub(super) kernel: Kernel,
    pub(super) mean: Mean,
    pub(super) hyper: Hyperparameters,
    /// How the noise varies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) noise: Option<VaryingNoise>,
    /// Scaled inputs, n x d.
    pub(super) z: Vec<f64>,
    /// Scaled output.
    pub(super) y: Vec<f64>,
}

impl From<GpModel> for Stored {
    fn from(model: GpModel) -> Self {
        model.stored
    }
}

impl TryFrom<Stored> for GpModel {
    type Error = ResponseError;

    fn try_from(stored: Stored) -> Result<Self, ResponseError> {
        Self::build(stored)
    }
}

impl GpModel {
    /// Factors the matrices.
    pub(super) fn build(stored: Stored) -> Result<Self, ResponseError> {
        let (n, d) = (stored.y.len(), stored.scaling.mean.len());
        let scales = if stored.scaling.warp.fits(d) { d } else { stored.scaling.warp.scales.len() };
        let expected = [(stored.z.len(), n * d), (stored.hyper.log_lengths.len(), d), (scales, d)];
        if d == 0 || expected.iter().any(|(found, expected)| found != expected) {
            let (found, expected) = expected.into_iter().find(|(f, e)| f != e).unwrap_or((0, 1));
            let source = dynocal_numerics::linalg::LinalgError::Shape {
                what: "stored Gaussian process",
                found,
                expected,
            };
            return Err(ResponseError::Numeric { model: "gaussian_process", source });
        }
        let columns: Vec<Vec<f64>> =
            (0..d).map(|j| stored.z.iter().skip(j).step_by(d).copied().collect()).collect();
        let flat = columns.concat();
        let basis = basis(stored.mean, &stored.z, d);
        let shape: Vec<f64> = stored
            .noise
            .as_ref()
            .map_or(Vec::new(), |noise| stored.z.chunks_exact(d).map(|z| noise.log_shape(z).exp()).collect());
        let problem = Problem {
            kernel: stored.kernel,
            columns: &flat,
            y: &stored.y,
            basis: &basis,
            noise_shape: &shape,
        };
        let mut work = Work::new(n);
        let (lengths, ratio) = (&stored.hyper.log_lengths, stored.hyper.noise_ratio);
        let none = || ResponseError::NoStart { model: "gaussian_process", output: "stored model".into() };
        let factors = problem.factors(lengths, ratio, &mut work).ok_or_else(none)?;
        Ok(Self { stored, columns, factors })
    }

    /// Number of points.
    pub fn points(&self) -> usize {
        self.stored.y.len()
    }

    /// Correlation function.
    pub fn kernel(&self) -> Kernel {
        self.stored.kernel
    }

    /// Mean functions.
    pub fn mean(&self) -> Mean {
        self.stored.mean
    }

    /// Lengths, noise and signal variance, in scaled units.
    pub fn hyperparameters(&self) -> &Hyperparameters {
        &self.stored.hyper
    }

    /// Length of each input in its own unit: how far one must go for the response to change; where an input is warped, at the mean of its warp.
    pub fn lengths(&self) -> Vec<f64> {
        let Scaling { mean, std, warp, .. } = &self.stored.scaling;
        let logs = self.stored.hyper.log_lengths.iter().enumerate();
        logs.map(|(j, l)| l.exp() * std[j] / warp.slope_of(j, mean[j])).collect()
    }

    /// Standard deviation of the noise, in the unit of the output, or of what its transform gives (its geometric mean over the points
    /// where it varies).
    pub fn noise_std(&self) -> f64 {
        (self.stored.hyper.signal_variance * self.stored.hyper.noise_ratio).sqrt()
            * self.stored.scaling.output_std
    }

    /// Transform of the output.
    pub fn transform(&self) -> Transform {
        self.stored.transform
    }

    /// Scaling of inputs and output.
    pub(in super::super) fn scaling(&self) -> &Scaling {
        &self.stored.scaling
    }

    /// Summands of the mean of the scaled output.
    pub(in super::super) fn parts(&self) -> Vec<Part> {
        let d = self.columns.len();
        let products = self.stored.mean.products(d).into_iter().zip(&self.factors.coefficients);
        let products: Vec<Product> = products.map(|(f, c)| Product::new(*c, d, &f)).collect();
        let kernels = Part::Kernels {
            kernel: self.stored.kernel,
            inverse_squares: self.stored.hyper.log_lengths.iter().map(|l| (-2.0 * l).exp()).collect(),
            centres: self.stored.z.clone(),
            weights: self.factors.weights.clone(),
        };
        let polynomial = (!products.is_empty()).then_some(Part::Polynomial(products));
        polynomial.into_iter().chain([kernels]).collect()
    }

    /// Noise over signal variance at a scaled point.
    pub(super) fn noise_ratio(&self, z: &[f64]) -> f64 {
        let shape = self.stored.noise.as_ref().map_or(1.0, |noise| noise.log_shape(z).exp());
        self.stored.hyper.noise_ratio * shape
    }

    /// Bytes that the model holds while it is used.
    pub fn bytes(&self) -> usize {
        8 * (self.factors.len() + 2 * self.stored.z.len() + self.stored.y.len())
    }

    /// Takes one more measured point in, hyperparameters and scaling kept, in O(n^2): a new row of the factor.
    ///
    /// # Errors
    /// [`ResponseError::Domain`] for an output that its transform cannot take.
    pub fn add(&mut self, x: &[f64], y: f64) -> Result<(), ResponseError> {
        let (d, n) = (self.columns.len(), self.points());
        let mut point = vec![0.0; d];
        self.stored.scaling.input(x, &mut point);
        let y = self.stored.transform.apply(&[y])?[0];
        let y = (y - self.stored.scaling.output_mean) / self.stored.scaling.output_std;
        let (mut k, mut slopes) = (vec![0.0; n], vec![0.0; n]);
        let mut h = vec![0.0; self.stored.mean.count(d)];
        self.stored.mean.values(&point, &mut h);
        self.correlations(&point, &mut k, &mut slopes);
        self.factors.append(&h, &k, 1.0 + self.noise_ratio(&point), y);
        self.columns.iter_mut().zip(&point).for_each(|(column, v)| column.push(*v));
        self.stored.z.extend_from_slice(&point);
        self.stored.y.push(y);
        Ok(())
    }
}

/// Mean functions at all points, n x q.
pub(super) fn basis(mean: Mean, z: &[f64], d: usize) -> Vec<f64> {
    let q = mean.count(d);
    let mut h = vec![0.0; z.len() / d * q];
    if q > 0 {
        z.chunks_exact(d).zip(h.chunks_exact_mut(q)).for_each(|(z, h)| mean.values(z, h));
    }
    h
}
