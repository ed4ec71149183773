//! Covariance of the parameters from the Jacobian of the errors.

use dynocal_numerics::linalg::{LinalgError, PivotedR, invert_upper};

/// `s2 (J'J)^-1` (p x p, row-major) and standard errors from a pivoted factorisation of J in unit column scaling.
///
/// Dependent parameters get zero rows and a standard error of NaN: the data do not determine them.
pub(super) fn covariance(
    factor: &PivotedR,
    p: usize,
    noise_variance: f64,
) -> Result<(Vec<f64>, Vec<f64>), LinalgError> {
    let rank = factor.rank;
    let mut r = vec![0.0; rank * rank];
    for i in 0..rank {
        r[i * rank..(i + 1) * rank].copy_from_slice(&factor.r[i * p..i * p + rank]);
    }
    let mut inverse = vec![0.0; rank * rank];
    invert_upper(&r, rank, &mut inverse)?;
    let mut covariance = vec![0.0; p * p];
    let mut std_errors = vec![f64::NAN; p];
    for i in 0..rank {
        for j in 0..rank {
            let (a, b) = (factor.order[i], factor.order[j]);
            // (R'R)^-1 = R^-1 R^-T, rows of an upper triangle.
            let sum: f64 = (i.max(j)..rank).map(|l| inverse[i * rank + l] * inverse[j * rank + l]).sum();
            covariance[a * p + b] = noise_variance * sum / (factor.scale[a] * factor.scale[b]);
        }
        let a = factor.order[i];
        std_errors[a] = covariance[a * p + a].sqrt();
    }
    Ok((covariance, std_errors))
}

/// A sentence for parameters that the data do not determine.
pub(super) fn rank_warning(factor: &PivotedR, names: &[String]) -> Option<String> {
    if factor.dependent.is_empty() {
        return None;
    }
    let which = factor.dependent.iter().map(|&k| format!("`{}`", names[k])).collect::<Vec<_>>().join(", ");
    Some(format!(
        "rank {} of {}: on these data the other regressors already span {which}; set to zero",
        factor.rank,
        names.len(),
    ))
}
