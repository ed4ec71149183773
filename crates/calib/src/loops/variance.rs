//! Relative variance of predictions: what is known before a record is measured.

use dynocal_design::information::sensitivities;
use dynocal_design::problem::Convention;
use dynocal_ident::model::Model;
use dynocal_numerics::linalg::{QrWork, dot, solve_upper_transposed};

use super::LoopError;
use super::plan::Known;

/// `v = tr(M^-1 W) / N0`: mean variance of the predictions over the objective signal (N0 x m) per unit of noise
/// variance, with `M = R'R` from the triangular `factor` R (p x p) of the records' sensitivities.
///
/// # Errors
/// [`LoopError::Model`] when the model diverges over the objective signal or R is singular.
pub fn relative_variance(
    model: &dyn Model,
    known: &Known,
    factor: &[f64],
    objective: &[f64],
) -> Result<f64, LoopError> {
    let p = model.n_params();
    let rows = standing(model, known, objective)?;
    let singular = |e: dynocal_numerics::linalg::LinalgError| LoopError::Model {
        what: "variance of predictions".into(),
        reason: e.to_string(),
    };
    let mut sum = 0.0;
    let mut x = vec![0.0; p];
    for row in rows.chunks_exact(p) {
        x.copy_from_slice(row);
        solve_upper_transposed(factor, p, &mut x).map_err(singular)?;
        sum += dot(&x, &x);
    }
    Ok(sum / (rows.len() / p).max(1) as f64)
}

/// Triangular factor (p x p) of the information so far and that of a planned record `u` (N x m).
///
/// # Errors
/// [`LoopError::Model`] when the model diverges over the record.
pub fn with_record(model: &dyn Model, known: &Known, u: &[f64]) -> Result<Vec<f64>, LoopError> {
    let p = model.n_params();
    let mut rows = known.information.clone();
    rows.extend(standing(model, known, u)?);
    let mut factor = vec![0.0; p * p];
    QrWork::new(rows.len() / p, p)
        .r_factor(&rows, &mut factor)
        .map_err(|e| LoopError::Model { what: "information of a plan".into(), reason: e.to_string() })?;
    Ok(factor)
}

/// Sensitivities of all samples of `u`, inputs standing at their first values before.
fn standing(model: &dyn Model, known: &Known, u: &[f64]) -> Result<Vec<f64>, LoopError> {
    let m = model.n_inputs();
    sensitivities(model, &known.fit.theta, u, m, Convention::Hold, model.max_lag(), known.mean_output)
        .map_err(|e| LoopError::Model { what: "a planned record".into(), reason: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loops::model::{identify, information};
    use dynocal_ident::experiment::Experiment;
    use dynocal_ident::model::poly::PolyNarx;

    /// A line through points: the variance over the objective points is the textbook `1/n + (x - mean)^2 / Sxx`.
    #[test]
    fn a_line_has_its_textbook_variance_and_a_further_record_adds() {
        let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)"]).unwrap();
        let record = |u: &[f64]| Experiment {
            name: "r".into(),
            u: u.to_vec(),
            y: u.iter().map(|v| 2.0 * v).collect(),
            init_samples: 1,
            weights: Vec::new(),
        };
        // y(t) reads u(t-1): the last sample tells nothing.
        let x = [0.0, 1.0, 2.0, 5.0, 9.0];
        let data = [record(&x)];
        let fit = identify(&model, &data).unwrap();
        let information = information(&model, &fit.theta, &data).unwrap();
        let known = Known { fit, information, mean_output: 0.0 };
        let textbook = |x: &[f64], at: &[f64]| {
            let n = x.len() as f64;
            let mean = x.iter().sum::<f64>() / n;
            let sxx: f64 = x.iter().map(|v| (v - mean).powi(2)).sum();
            at.iter().map(|v| 1.0 / n + (v - mean).powi(2) / sxx).sum::<f64>() / at.len() as f64
        };
        // Inputs stand at the first value before: the points seen are 3, 3, 4.
        let found = relative_variance(&model, &known, &known.information, &[3.0, 4.0, 7.0]).unwrap();
        assert!((found - textbook(&[0.0, 1.0, 2.0, 5.0], &[3.0, 3.0, 4.0])).abs() < 1e-12, "{found}");
        let factor = with_record(&model, &known, &[6.0, 8.0]).unwrap();
        let more = relative_variance(&model, &known, &factor, &[3.0, 4.0, 7.0]).unwrap();
        let all = [0.0, 1.0, 2.0, 5.0, 6.0, 6.0];
        assert!((more - textbook(&all, &[3.0, 3.0, 4.0])).abs() < 1e-12, "{more}");
    }
}
