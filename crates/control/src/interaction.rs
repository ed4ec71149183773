//! How loops act on each other: relative gain array, and the static decoupler.
//!
//! `RGA = G(0) .* (G(0)^-1)'` (E. H. Bristol, IEEE Trans. Automatic Control 11 (1966) 133-134): 1 where a loop sees the same gain
//! with the others open and closed, negative where it changes its sign.

use crate::error::ControlError;
use crate::matrix::Matrix;
use crate::system::{System, Time};

/// Relative gains at an angular frequency (0: at rest), outputs by inputs, row-major: real parts.
///
/// # Errors
/// [`ControlError::Shape`] for a plant that is not square, [`ControlError::Singular`] for one without inverse.
pub fn relative_gains(plant: &System, w_rad_s: f64) -> Result<Vec<f64>, ControlError> {
    let g = response(plant, w_rad_s)?;
    let inverse = inverse(&g, w_rad_s)?;
    let n = g.rows;
    Ok((0..n * n).map(|k| (g.data[k] * inverse.at(k % n, k / n)).re).collect())
}

/// `D = G(0)^-1 diag(G(0))`: before the plant it leaves each output its own input at rest, row-major.
///
/// # Errors
/// As of [`relative_gains`].
pub fn decoupler(plant: &System) -> Result<Vec<f64>, ControlError> {
    let g = response(plant, 0.0)?;
    let n = g.rows;
    let own: Vec<_> = (0..n).map(|k| g.at(k, k)).collect();
    Ok(inverse(&g, 0.0)?.times(&Matrix::diagonal(&own)).data.iter().map(|v| v.re).collect())
}

fn response(plant: &System, w_rad_s: f64) -> Result<Matrix, ControlError> {
    if plant.outputs != plant.inputs {
        let found = format!("{} x {}", plant.outputs, plant.inputs);
        return Err(ControlError::shape("the plant", found, "as many outputs as inputs"));
    }
    let g = match plant.time {
        _ if w_rad_s != 0.0 => plant.at(w_rad_s),
        Time::Continuous | Time::Sampled { .. } => plant.at(0.0),
    };
    match g.data.iter().find(|v| !v.norm().is_finite()) {
        Some(v) => Err(ControlError::number(
            "a gain at rest (the plant integrates: give a frequency)",
            v.norm(),
            "a finite number",
        )),
        None => Ok(g),
    }
}

fn inverse(g: &Matrix, w: f64) -> Result<Matrix, ControlError> {
    let singular = || ControlError::Singular { what: "the plant".into(), frequency_rad_s: w };
    let scale = g.data.iter().map(|v| v.norm()).fold(0.0, f64::max);
    // What rounding leaves of a determinant is no gain.
    let (det, inverse) = g.solved();
    if det.norm() <= 1e-12 * scale.powi(g.rows as i32) {
        return Err(singular());
    }
    inverse.ok_or_else(singular)
}
