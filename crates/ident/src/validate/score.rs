//! Scores that say what they are.

use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

use crate::experiment::Experiment;
use crate::model::form::Form;
use crate::model::poly::StructureError;
use crate::model::{Kind, Model, output};

/// Whether the parameters have seen the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Seen {
    /// Data of the estimation.
    Identification,
    /// Data that chose between candidates (early stopping, the best of several starts): no test any more.
    Selection,
    /// Other data.
    Unseen,
}

/// What the model output is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// Measured output.
    Noisy,
    /// True output without noise (simulated studies only).
    NoiseFree,
}

/// How much of the error lies inside a band around zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// Half width, in the unit of the output.
    pub half_width: f64,
    /// Share of the scored samples with `|e| <= half_width`; 0 for a run that diverged.
    pub share: f64,
}

/// Fit numbers of one model on one or several experiments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// How the outputs were computed.
    pub kind: Kind,
    /// Whether the data were used for estimation.
    pub data: Seen,
    /// What it is compared with.
    pub reference: Reference,
    /// Scored samples.
    pub samples: usize,
    /// Mean squared error.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub mse: f64,
    /// Root of it.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub rmse: f64,
    /// `1 - sum e^2 / sum (z - mean z)^2` (thesis eq. 2.48), the mean over all scored samples.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub r2: f64,
    /// `1 - |e| / |z - mean z|`, the NRMSE fit.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub nrmse_fit: f64,
    /// 95 % of the absolute errors are at most this.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub error_95: f64,
    /// Largest absolute error.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub error_max: f64,
    /// Share of the errors inside a band, where one was given.
    #[serde(default)]
    pub inside: Option<Band>,
    /// `Diverged` when a free run did not stay finite; the numbers are then NaN.
    pub status: Status,
}

/// Scores of `z` against `zhat`; samples without a measured value (NaN in `z`) are left out.
///
/// ```
/// use dynocal_ident::validate::{Kind, Reference, Seen, score_values};
/// let s = score_values(&[1.0, 2.0, 3.0], &[1.0, 2.0, 4.0], Kind::OneStep, Seen::Unseen, Reference::Noisy);
/// assert_eq!((s.r2, s.mse), (0.5, 1.0 / 3.0));
/// ```
pub fn score_values(z: &[f64], zhat: &[f64], kind: Kind, data: Seen, reference: Reference) -> Score {
    let measured: Vec<(f64, f64)> =
        z.iter().zip(zhat).map(|(a, b)| (*a, *b)).filter(|(a, _)| !a.is_nan()).collect();
    let n = measured.len();
    let mean = measured.iter().map(|(a, _)| a).sum::<f64>() / n as f64;
    let spread: f64 = measured.iter().map(|(a, _)| (a - mean).powi(2)).sum();
    let mut errors: Vec<f64> = measured.iter().map(|(a, b)| (a - b).abs()).collect();
    let sum: f64 = errors.iter().map(|e| e * e).sum();
    errors.sort_by(f64::total_cmp);
    let rank = ((0.95 * n as f64).ceil() as usize).clamp(1, n.max(1));
    Score {
        kind,
        data,
        reference,
        samples: n,
        mse: sum / n as f64,
        rmse: (sum / n as f64).sqrt(),
        r2: 1.0 - sum / spread,
        nrmse_fit: 1.0 - (sum / spread).sqrt(),
        error_95: errors.get(rank - 1).copied().unwrap_or(f64::NAN),
        error_max: errors.last().copied().unwrap_or(f64::NAN),
        inside: None,
        status: if sum.is_finite() { Status::Converged } else { Status::Diverged },
    }
}

/// The same with the share of errors inside `+- half_width`.
///
/// ```
/// use dynocal_ident::validate::{Kind, Reference, Seen, score_in_band};
/// let s = score_in_band(&[1.0, 2.0, 3.0, 4.0], &[1.1, 2.0, 3.4, 4.0], 0.2, Kind::OneStep, Seen::Unseen, Reference::Noisy);
/// assert_eq!(s.inside.unwrap().share, 0.75);
/// ```
pub fn score_in_band(
    z: &[f64],
    zhat: &[f64],
    half_width: f64,
    kind: Kind,
    data: Seen,
    reference: Reference,
) -> Score {
    let measured = || z.iter().zip(zhat).filter(|(a, _)| !a.is_nan());
    // A NaN of a diverged run is in no band.
    let inside = measured().filter(|(a, b)| (*a - *b).abs() <= half_width).count();
    let share = inside as f64 / measured().count().max(1) as f64;
    Score { inside: Some(Band { half_width, share }), ..score_values(z, zhat, kind, data, reference) }
}

/// Scores the model on all experiments together, against their measured outputs.
pub fn score(model: &dyn Model, theta: &[f64], data: &[Experiment], kind: Kind, seen: Seen) -> Score {
    let (mut z, mut zhat) = (Vec::new(), Vec::new());
    for e in data {
        let first = e.first(model).min(e.len());
        z.extend_from_slice(&e.y[first..]);
        zhat.extend_from_slice(&output(model, theta, e, kind)[first..]);
    }
    score_values(&z, &zhat, kind, seen, Reference::Noisy)
}

/// The same against outputs without noise, one slice per experiment.
pub fn score_noise_free(
    model: &dyn Model,
    theta: &[f64],
    data: &[Experiment],
    noise_free: &[&[f64]],
    kind: Kind,
    seen: Seen,
) -> Score {
    let (mut z, mut zhat) = (Vec::new(), Vec::new());
    for (e, truth) in data.iter().zip(noise_free) {
        let first = e.first(model).min(e.len());
        z.extend_from_slice(&truth[first..]);
        zhat.extend_from_slice(&output(model, theta, e, kind)[first..]);
    }
    score_values(&z, &zhat, kind, seen, Reference::NoiseFree)
}

/// Scores of any form, its free runs starting as is usual for it. None where it has no such output.
///
/// # Errors
/// [`StructureError`] where what its inputs drive cannot be written as a NARX model.
pub fn score_form(
    form: &dyn Form,
    theta: &[f64],
    data: &[Experiment],
    kind: Kind,
    seen: Seen,
) -> Result<Option<Score>, StructureError> {
    let (driven, initial) = (form.driven(theta)?, form.row().initial);
    let (mut z, mut zhat) = (Vec::new(), Vec::new());
    for e in data {
        let Some(y) = form.computed(theta, driven.as_ref(), e, kind, initial) else { return Ok(None) };
        let first = e.init_samples.max(form.memory()).min(e.len());
        z.extend_from_slice(&e.y[first..]);
        zhat.extend_from_slice(&y[first..]);
    }
    Ok(Some(score_values(&z, &zhat, kind, seen, Reference::Noisy)))
}
