//! The mean of a response model as a formula, for exports: sums of products, of kernels about points, and of local models under
//! their validities.
//!
//! ```text
//! z_j = (w_j(x_j) - mean_j) / std_j, w: the warp,     m = output_mean + output_std * sum of the parts at z,     y = G(m)
//! y of several = sum of share y
//! ```

use super::gp::Kernel;
use super::local_linear::Tree;
use super::transform::Transform;
use super::{ResponseModel, Scaling};

/// A summand of the scaled output.
#[derive(Clone, Debug, PartialEq)]
pub enum Part {
    /// `sum_k c_k prod_j z_j^e_kj`.
    Polynomial(Vec<Product>),
    /// `sum_k w_k k(r_k^2)`, `r_k^2 = sum_j q_j (z_j - c_kj)^2`.
    Kernels {
        /// Correlation function.
        kernel: Kernel,
        /// q (d).
        inverse_squares: Vec<f64>,
        /// Centres, row by row (d each).
        centres: Vec<f64>,
        /// w, one a centre.
        weights: Vec<f64>,
    },
    /// `sum_l Phi_l sum_k c_lk x_k`, x the products of a local model.
    Local {
        /// Splits and paths.
        tree: Tree,
        /// Local models, one a leaf.
        models: Vec<Vec<Product>>,
    },
}

/// A coefficient times powers of the scaled inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Product {
    /// Coefficient.
    pub coefficient: f64,
    /// Exponents (d).
    pub exponents: Vec<u32>,
}

impl Product {
    /// `c z_i z_j ..` over d inputs.
    pub(super) fn new(coefficient: f64, d: usize, factors: &[usize]) -> Self {
        let mut exponents = vec![0; d];
        factors.iter().for_each(|j| exponents[*j] += 1);
        Self { coefficient, exponents }
    }

    fn value(&self, z: &[f64]) -> f64 {
        self.coefficient * z.iter().zip(&self.exponents).map(|(z, e)| z.powi(*e as i32)).product::<f64>()
    }
}

/// The mean of one model.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    /// Scaling of inputs and output.
    pub scaling: Scaling,
    /// Summands.
    pub parts: Vec<Part>,
    /// Whose inverse G is.
    pub transform: Transform,
    /// Share in the mean of several; 1 alone.
    pub share: f64,
}

impl Formula {
    /// y at x (d).
    pub fn value(&self, x: &[f64]) -> f64 {
        let mut z = vec![0.0; x.len()];
        self.scaling.input(x, &mut z);
        let sum: f64 = self.parts.iter().map(|p| p.value(&z)).sum();
        self.transform.inverse(self.scaling.output_mean + self.scaling.output_std * sum)[0]
    }
}

impl Part {
    fn value(&self, z: &[f64]) -> f64 {
        match self {
            Self::Polynomial(products) => products.iter().map(|p| p.value(z)).sum(),
            Self::Kernels { kernel, inverse_squares, centres, weights } => {
                let each = centres.chunks_exact(z.len().max(1)).zip(weights).map(|(c, w)| {
                    let r2: f64 = (0..z.len()).map(|j| inverse_squares[j] * (z[j] - c[j]).powi(2)).sum();
                    w * kernel.value_slope(r2).0
                });
                each.sum()
            }
            Self::Local { tree, models } => {
                let side = |(split, side): &(usize, bool)| {
                    let psi = tree.splits[*split].psi(z);
                    if *side { psi } else { 1.0 - psi }
                };
                let each = tree.leaves.iter().zip(models).map(|(leaf, model)| {
                    let validity: f64 = leaf.path.iter().map(side).product();
                    validity * model.iter().map(|p| p.value(z)).sum::<f64>()
                });
                each.sum()
            }
        }
    }
}

impl ResponseModel {
    /// The mean as formulas whose values times their shares are added; one for every kind but the mean of several.
    ///
    /// ```
    /// use dynocal_ident::model::response::{Ask, Points, Prediction, Response, learner};
    ///
    /// let x: Vec<f64> = (0..20).map(f64::from).collect();
    /// let y = x.iter().map(|x| 3.0 + 2.0 * x).collect();
    /// let points = Points { inputs: vec!["load".into()], output: "torque".into(), x, y };
    /// let learnt = learner("stepwise_polynomial", &Default::default()).unwrap().learn(&points, &|| false).unwrap();
    /// let formulas = learnt.model.formulas();
    /// assert!(formulas.len() == 1 && (formulas[0].value(&[4.5]) - 12.0).abs() < 1e-9);
    /// ```
    pub fn formulas(&self) -> Vec<Formula> {
        let of = |scaling: &Scaling, parts, transform| Formula {
            scaling: scaling.clone(),
            parts,
            transform,
            share: 1.0,
        };
        let plain = |scaling: &Scaling, parts| of(scaling, parts, Transform::None);
        match self {
            Self::Polynomial(model) => vec![model.formula()],
            Self::GaussianProcess(model) => vec![of(model.scaling(), model.parts(), model.transform())],
            Self::SparseGaussianProcess(model) => vec![of(model.scaling(), model.parts(), model.transform())],
            Self::LocalLinear(model) => vec![plain(&model.scaling, vec![model.part()])],
            Self::Rbf(model) => vec![plain(model.scaling(), model.parts())],
            Self::MeanOf(model) => {
                // A member that is a mean itself weighs as one.
                let share = 1.0 / model.models.len() as f64;
                let each = model.models.iter().flat_map(Self::formulas);
                each.map(|f| Formula { share: share * f.share, ..f }).collect()
            }
        }
    }
}
