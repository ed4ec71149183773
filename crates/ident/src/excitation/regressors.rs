//! Rank of a regressor matrix, with the terms that depend on others named.

use dynocal_numerics::linalg::{LinalgError, pivoted_r, solve_upper};
use serde::Serialize;

use crate::estimate::EstimateError;
use crate::estimate::ols::regression;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::usable_samples;

/// A term with its coefficient in a combination.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summand {
    /// Coefficient.
    pub coefficient: f64,
    /// Term.
    pub term: String,
}

/// A term that is a combination of others.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Dependency {
    /// The term.
    pub term: String,
    /// `term = sum coefficient * other` on these records; empty for a term that is zero throughout.
    pub combination: Vec<Summand>,
}

impl Dependency {
    /// `u(t-2) = 2 u(t-1) - 1 u(t-3)`.
    pub fn sentence(&self) -> String {
        let Some((first, rest)) = self.combination.split_first() else {
            return format!("{} = 0", self.term);
        };
        // The constant term is called 1.
        let product = |c: f64, name: &str| match name {
            "1" => digits(c),
            name => format!("{} {name}", digits(c)),
        };
        let mut text = format!("{} = {}", self.term, product(first.coefficient, &first.term));
        for s in rest {
            let sign = if s.coefficient < 0.0 { '-' } else { '+' };
            text += &format!(" {sign} {}", product(s.coefficient.abs(), &s.term));
        }
        text
    }
}

/// Six significant digits at most.
fn digits(x: f64) -> String {
    let rounded: f64 = format!("{x:.5e}").parse().unwrap_or(x);
    rounded.to_string()
}

/// What the regressors of a model can tell.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rank {
    /// Number of terms.
    pub terms: usize,
    /// How many of them are independent.
    pub rank: usize,
    /// Condition of the independent ones in unit scaling: ratio of the largest to the smallest pivot.
    pub condition: f64,
    /// The others.
    pub dependencies: Vec<Dependency>,
}

/// Rank of `phi` (rows x names, row-major). A term is dependent when its part outside the span of the others is less
/// than `tolerance` of it (0 for the rounding errors of the matrix).
///
/// # Errors
/// [`LinalgError`]: wrong shape or an entry that is not finite.
///
/// ```
/// use dynocal_ident::excitation::regressors::rank;
/// let names = ["u1", "u2", "u1 + u2"].map(String::from);
/// let phi = [1.0, 0.0, 1.0, 0.0, 2.0, 2.0, 1.0, 1.0, 2.0, 3.0, -1.0, 2.0];
/// let found = rank(&phi, &names, 0.0).unwrap();
/// assert_eq!((found.rank, found.dependencies.len()), (2, 1));
/// ```
pub fn rank(phi: &[f64], names: &[String], tolerance: f64) -> Result<Rank, LinalgError> {
    let n = names.len();
    let rows = phi.len().checked_div(n).unwrap_or(0);
    let p = pivoted_r(phi, rows, n, tolerance)?;
    let pivot = |k: usize| p.r[k * n + k].abs();
    let mut square = vec![0.0; p.rank * p.rank];
    for i in 0..p.rank {
        square[i * p.rank..(i + 1) * p.rank].copy_from_slice(&p.r[i * n..i * n + p.rank]);
    }
    let mut dependencies = Vec::new();
    for k in p.rank..n {
        let column = p.order[k];
        let mut x: Vec<f64> = (0..p.rank).map(|i| p.r[i * n + k]).collect();
        solve_upper(&square, p.rank, &mut x)?;
        // In unit scaling a part below this is rounding of a nearly dependent set.
        let combination = (0..p.rank).filter(|i| x[*i].abs() > 1e-6);
        let named = combination.map(|i| Summand {
            coefficient: x[i] * p.scale[column] / p.scale[p.order[i]],
            term: names[p.order[i]].clone(),
        });
        dependencies.push(Dependency { term: names[column].clone(), combination: named.collect() });
    }
    dependencies.sort_by_key(|d| names.iter().position(|n| *n == d.term));
    let condition = if p.rank == 0 { f64::NAN } else { pivot(0) / pivot(p.rank - 1) };
    Ok(Rank { terms: n, rank: p.rank, condition, dependencies })
}

/// The same for the regressors of `model`, linear in its parameters, on its records.
///
/// # Errors
/// [`EstimateError`]: not linear, records too short, samples missing.
pub fn model_rank(model: &dyn Model, data: &[Experiment], tolerance: f64) -> Result<Rank, EstimateError> {
    if !model.is_linear_in_params() {
        let params = model.n_params();
        return Err(EstimateError::NotLinear { estimator: "rank check", params });
    }
    let samples = usable_samples(model, data)?;
    let (phi, _) = regression(model, data, samples);
    let names: Vec<String> = (0..model.n_params()).map(|k| model.param_name(k)).collect();
    rank(&phi, &names, tolerance).map_err(|source| EstimateError::Numeric { estimator: "rank check", source })
}
