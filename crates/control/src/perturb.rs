//! Perturbations as systems: what makes a disk margin's bound a loop that can be run.
//!
//! ```text
//! delta = g e^(j theta) at one frequency     continuous: +-g (s - a)/(s + a)     sampled: +-g (q - c)/(1 - c q)
//! f = (1 + (1-sigma)/2 delta) / (1 - (1+sigma)/2 delta)
//! ```
//!
//! The all-pass has size g at all frequencies and the wanted phase at one, so f stays in its disk everywhere.

use std::f64::consts::PI;

use crate::disk::{DiskMargin, Place};
use crate::error::ControlError;
use crate::margin::Side;
use crate::system::{System, Time, Transfer};

/// Imaginary share below which a perturbation is a gain: at rest and at half the sampling frequency it is one but for rounding.
const REAL: f64 = 1e-4;

/// Whether a perturbation `(re, im)` is a gain: then it is one at all frequencies.
pub fn is_gain(delta: (f64, f64)) -> bool {
    delta.1.abs() < REAL * delta.0.abs()
}

/// The stable factor f of a perturbation `(re, im)` at a frequency; none where the disk holds infinity
/// ((1+sigma)/2 |delta| >= 1) or the frequency is 0.
pub fn factor(time: Time, skew: f64, delta: (f64, f64), w_rad_s: f64) -> Option<Transfer> {
    let size = delta.0.hypot(delta.1);
    let (before, after) = ((1.0 - skew) / 2.0, (1.0 + skew) / 2.0);
    if after * size >= 1.0 || !(w_rad_s > 0.0) {
        return None;
    }
    if is_gain(delta) {
        let f = (1.0 + before * delta.0) / (1.0 - after * delta.0);
        return Some(Transfer::gain(f));
    }
    let theta = delta.1.atan2(delta.0);
    // Numerator and denominator of the all-pass, ascending, and its sign.
    let (top, bottom, sign) = match time {
        Time::Continuous => {
            let (theta, sign) = if theta >= 0.0 { (theta, 1.0) } else { (theta + PI, -1.0) };
            let a = w_rad_s * (theta / 2.0).tan();
            if !(a < 1e9 * w_rad_s) { ([-1.0, 0.0], [1.0, 0.0], sign) } else { ([-a, 1.0], [a, 1.0], sign) }
        }
        Time::Sampled { sample_time_s } => {
            let (psi, sign) = if theta <= 0.0 { (-theta, 1.0) } else { (PI - theta, -1.0) };
            let ratio = (psi / 2.0).tan() / (w_rad_s * sample_time_s / 2.0).tan();
            if !ratio.is_finite() || ratio > 1e9 {
                ([-1.0, 0.0], [1.0, 0.0], sign)
            } else {
                let c = (ratio - 1.0) / (ratio + 1.0);
                ([-c, 1.0], [1.0, -c], sign)
            }
        }
    };
    let mixed = |share: f64| -> Vec<f64> {
        bottom.iter().zip(top).map(|(b, t)| b + share * sign * size * t).collect()
    };
    Some(Transfer { num: mixed(before), den: mixed(-after), delay_s: 0.0 })
}

/// A plant with the perturbation of a disk margin, made `share` of its size; none where it cannot be made as a stable system.
///
/// # Errors
/// As of [`System::new`].
pub fn perturbed(
    plant: &System,
    place: Place,
    found: &DiskMargin,
    share: f64,
) -> Result<Option<System>, ControlError> {
    let of = |d: &(f64, f64)| factor(plant.time, found.skew, (d.0 * share, d.1 * share), found.lost_rad_s);
    let Some(factors) = found.perturbation.iter().map(of).collect::<Option<Vec<Transfer>>>() else {
        return Ok(None);
    };
    Ok(Some(match place {
        Place::Inputs => plant.before(&factors)?,
        Place::Outputs => plant.after(&factors)?,
        Place::Both => {
            let (inputs, outputs) = factors.split_at(plant.inputs);
            plant.before(inputs)?.after(outputs)?
        }
    }))
}

/// A plant with the perturbation of a disk margin of loop `k` alone ([`crate::disk::of_loop`]), made `share` of its size; none as above.
///
/// # Errors
/// As of [`System::new`].
pub fn perturbed_loop(
    plant: &System,
    (side, k): (Side, usize),
    found: &DiskMargin,
    share: f64,
) -> Result<Option<System>, ControlError> {
    let Some((re, im)) = found.perturbation.first() else { return Ok(None) };
    let own = factor(plant.time, found.skew, (re * share, im * share), found.lost_rad_s);
    own.map(|f| within(plant, (side, k), &f)).transpose()
}

/// A plant with `own` in loop `k` only.
///
/// # Errors
/// As of [`System::new`].
pub fn within(plant: &System, (side, k): (Side, usize), own: &Transfer) -> Result<System, ControlError> {
    let of = |n: usize| -> Vec<Transfer> {
        (0..n).map(|j| if j == k { own.clone() } else { Transfer::gain(1.0) }).collect()
    };
    match side {
        Side::Inputs => plant.before(&of(plant.inputs)),
        Side::Outputs => plant.after(&of(plant.outputs)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::{C, ONE};

    /// At its frequency the factor is the f of its delta.
    #[test]
    fn factors_have_the_value_of_their_perturbation() {
        for time in [Time::Continuous, Time::Sampled { sample_time_s: 0.1 }] {
            for k in 0..40 {
                let delta = C::from_polar(0.8, -3.1 + 0.155 * f64::from(k));
                for skew in [-1.0, 0.0, 1.0] {
                    let f = factor(time, skew, (delta.re, delta.im), 7.0).unwrap();
                    let expected =
                        (ONE + delta * ((1.0 - skew) / 2.0)) / (ONE - delta * ((1.0 + skew) / 2.0));
                    assert!((f.at(time, 7.0) - expected).norm() < 1e-9, "{time:?} {delta} {skew}");
                }
            }
        }
    }
}
