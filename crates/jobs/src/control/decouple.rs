//! What stands between controllers and plant, and what the loops see behind it.

use dynocal_control::error::ControlError;
use dynocal_control::interaction::{behind, dynamic_decoupler, static_decoupler};
use dynocal_control::system::{System, Transfer};
use serde::Serialize;

use super::load::Loaded;
use super::result::ControlJobError;
use super::spec::{Decoupler, Job};

/// A decoupler as the summary has it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decoupled {
    /// Static or dynamic.
    pub kind: Decoupler,
    /// Set point whose nominal plant it is made for.
    pub point: String,
    /// From the controllers (columns) to the inputs (rows), row-major: coefficients in z^-1.
    pub filters: Vec<Vec<f64>>,
    /// For each set point: largest part of another output's steady answer to a demand, over its own, without and with it.
    pub left: Vec<(f64, f64)>,
}

/// The decoupler of the first set point.
pub(super) fn made(job: &Job, loaded: &Loaded) -> Result<Option<System>, ControlJobError> {
    let (Some(kind), Some(first)) = (job.decoupler, loaded.points.first()) else { return Ok(None) };
    let found = match kind {
        Decoupler::Static => static_decoupler(&first.nominal),
        Decoupler::Dynamic => dynamic_decoupler(&first.nominal, job.taps),
    };
    found.map(Some).map_err(|source| ControlJobError::Point { point: first.name.clone(), source })
}

/// Channel `k` as its controller sees it with the other loops open.
pub(super) fn channel(loaded: &Loaded, plant: &System, k: usize) -> Result<Transfer, ControlError> {
    match &loaded.decoupler {
        Some(d) => behind(plant, d, k),
        None => Ok(plant.channel(k, k).clone()),
    }
}

/// For the summary and the page.
pub(super) fn told(job: &Job, loaded: &Loaded) -> Option<Decoupled> {
    let (kind, d) = (job.decoupler?, loaded.decoupler.as_ref()?);
    let left = loaded.points.iter().map(|p| {
        let g = p.nominal.at(0.0);
        (apart(&g), apart(&g.times(&d.at(0.0))))
    });
    Some(Decoupled {
        kind,
        point: loaded.points.first()?.name.clone(),
        filters: d.channels.iter().map(|c| c.num.clone()).collect(),
        left: left.collect(),
    })
}

/// Largest entry of a column beside the diagonal, over that on it.
fn apart(g: &dynocal_control::matrix::Matrix) -> f64 {
    let one = |k: usize| g.data[k].norm() / g.at(k % g.cols, k % g.cols).norm();
    (0..g.data.len()).filter(|k| k / g.cols != k % g.cols).map(one).fold(0.0, f64::max)
}
