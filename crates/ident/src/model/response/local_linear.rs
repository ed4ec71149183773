//! Local linear (or quadratic) models under a tree of smooth axis-oblique splits.
//!
//! ```text
//! f(z) = sum_l Phi_l(z) (w_l'x(z)),   x = [1, z] or [1, z, z_i z_j],   sum_l Phi_l = 1
//! Phi_l = product over its path of psi or 1 - psi,   psi = 1 / (1 + exp(-(v0 + v'z)))
//! ```
//!
//! Each local model is fitted alone, by least squares weighted with its validity Phi_l. With the validities held, the
//! left-out residual is exact:
//!
//! ```text
//! y_i - yhat_(i) = sum_l Phi_l(i) e_l(i) / (1 - h_l(i)),   h_l(i) = Phi_l(i) x_i'(X'Phi_l X)^-1 x_i
//! ```
//!
//! A split is placed where the sum of its squares is least; the tree grows as long as that sum decreases. What trees that are
//! grown anew without each fold show to be too much is taken back (`prune`).
//!
//! Splits that were chosen with the same points make residuals too small, so the bands are calibrated with the same trees
//! (`super::bands`).
//!
//! Sources: O. Nelles, Axes-oblique partitioning strategies for local model networks, Proc. IEEE ISIC (2006), 2378-2383;
//! B. Hartmann, O. Banfer, O. Nelles, A. Sodja, L. Teslic, I. Skrjanc, Supervised hierarchical clustering in fuzzy model
//! identification, IEEE Trans. Fuzzy Systems 19 (2011); O. Nelles, Nonlinear System Identification (2001), chapters 12 to 14.

mod grow;
mod prune;
mod tree;

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

use super::bands::{self, Bands, Refit};
use super::features::{self, Coefficients};
use super::formula::{Part, Product};
use super::points::counted;
use super::{Ask, Learn, Learnt, Points, Prediction, Response, ResponseError, ResponseModel, Scaling};
use grow::Grown;
use prune::Regrown;
pub use tree::{Leaf, Split, Tree};

pub(super) const MEMBER: Member<dyn Learn> = Member {
    doc: MemberDoc {
        name: "local_linear",
        what: "local linear models under smooth axis-oblique splits, as many as the left-out error asks for",
        params: &[
            ParamDoc {
                name: "quadratic",
                unit: "-",
                default: "false",
                what: "whether the local models are of second degree",
            },
            ParamDoc { name: "most", unit: "-", default: "40", what: "most local models" },
            ParamDoc {
                name: "steepness",
                unit: "-",
                default: "[2, 4, 8, 16]",
                what: "slopes of the splits that are tried, per standard deviation of the points that are split",
            },
        ],
    },
    build: |keys| Ok(Box::new(registry::keys::<LocalLinear>("local_linear", keys)?)),
};

/// Keys of local linear models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalLinear {
    /// Whether the local models are of second degree.
    pub quadratic: bool,
    /// Most local models.
    pub most: usize,
    /// Slopes of the splits that are tried, per standard deviation of the points that are split.
    pub steepness: Vec<f64>,
}

impl Default for LocalLinear {
    fn default() -> Self {
        Self { quadratic: false, most: 40, steepness: vec![2.0, 4.0, 8.0, 16.0] }
    }
}

/// Local linear models that were learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocalLinearModel {
    /// Scaling of inputs and output.
    pub scaling: Scaling,
    /// Splits and paths, in scaled inputs.
    pub tree: Tree,
    coefficients: Coefficients,
}

impl Learn for LocalLinear {
    fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
        points.check(points.dim() + 4, "local linear models")?;
        if self.steepness.is_empty() || self.steepness.iter().any(|s| !(*s > 0.0 && s.is_finite())) {
            let (found, expected) = (format!("{:?}", self.steepness), "one or more positive numbers".into());
            return Err(ResponseError::Key { model: "local_linear", key: "steepness", found, expected });
        }
        let scaling = Scaling::of(points);
        let (z, y) = (scaling.inputs(points), scaling.outputs(points));
        let none = || ResponseError::NoStart { model: "local_linear", output: points.output.clone() };
        let grown: Grown = grow::best(self, &z, &y, points.dim(), interrupt).ok_or_else(none)?;
        let (asked, d) = (grown.tree.leaves.len(), points.dim());
        let regrown = if interrupt() { None } else { Some(Regrown::new(self, &grown, &z, &y, d)) };
        let kept = regrown.as_ref().map_or(asked, |r| r.leaves(&grown, &z, &y, d));
        let grown = if kept < asked {
            Grown::of(&grown.path[kept - 1], grown.slope, &z, &y).ok_or_else(none)?
        } else {
            grown
        };
        let left_out = grown.left_out(scaling.output_std);
        let refit = |fold: usize, z: &[f64], y: &[f64]| {
            let again = Grown::of(regrown.as_ref()?.tree(fold, kept)?, grown.slope, z, y)?;
            let coefficients = again.coefficients(Bands::UNIT);
            Some(Refit { coefficients, features: Box::new(again.tree), noise: 1.0 })
        };
        let bands = bands::calibrate(grown.noise(), (&z, &y), &refit, interrupt);
        let coefficients = grown.coefficients(bands);
        let model = LocalLinearModel { scaling, tree: grown.tree, coefficients };
        let mut notes = points.notes();
        notes.push(format!("{} of `{}`", model.describe(), points.output));
        if kept < asked {
            notes.push(format!(
                "the left-out error asked for {asked} local models; trees that were grown without each fold predict it better with {kept}"
            ));
        }
        notes.extend(bands.note());
        Ok(Learnt::new(ResponseModel::LocalLinear(model), left_out, notes))
    }
}

impl LocalLinearModel {
    /// Coefficients of local model `leaf` over `[1, z]` (or `[1, z, z_i z_j]`, i <= j), for the scaled output.
    pub fn local(&self, leaf: usize) -> &[f64] {
        let k = self.tree.local_terms();
        &self.coefficients.values[leaf * k..(leaf + 1) * k]
    }

    /// The mean of the scaled output.
    pub(super) fn part(&self) -> Part {
        let d = self.tree.dim;
        let mut factors: Vec<Vec<usize>> = std::iter::once(vec![]).chain((0..d).map(|j| vec![j])).collect();
        if self.tree.quadratic {
            factors.extend((0..d).flat_map(|i| (i..d).map(move |j| vec![i, j])));
        }
        let model = |leaf: usize| {
            self.local(leaf).iter().zip(&factors).map(|(c, f)| Product::new(*c, d, f)).collect()
        };
        Part::Local { tree: self.tree.clone(), models: (0..self.tree.leaves.len()).map(model).collect() }
    }
}

impl Response for LocalLinearModel {
    fn dim(&self) -> usize {
        self.tree.dim
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        features::predict(&self.tree, &self.coefficients, &self.scaling, x, ask, out);
    }

    fn describe(&self) -> String {
        let kind = if self.tree.quadratic { "quadratic" } else { "linear" };
        counted(self.tree.leaves.len(), &format!("local {kind} model"))
    }
}
