//! Boundary of what was identified: how far a point or a plan is from the data that a model has seen.
//!
//! A point is one sample's lagged inputs and outputs (a [`Space`]); the region is learnt from records:
//!
//! ```text
//! leverage   |R^-T (x - c)| / s       the ellipsoid of the covariance R'R about the mean c
//! hull       gauge(x - c) / s         min sum lambda: x - c = sum lambda_i (p_i - c), lambda >= 0, p_i on the hull
//! star       |x - c| / (r(direction) s)
//! one_class  sqrt(log(F / f(x)) / log(F / rho)) / s,   f a sum of kernels on the points
//! ```
//!
//! The first three grow in proportion to the distance from the centre along every ray. [`Combined`] makes regions of regions
//! (and, or, not), [`OperatingBoundary`] has limits that depend on an operating point. The scale s is the `quantile` of the same
//! number over points that had no part in the region (blocks of the records, held out in turn): new points of the same
//! distribution lie outside (distance above 1) with the probability `1 - quantile`.
//!
//! ```
//! use dynocal_ident::experiment::Experiment;
//! use dynocal_ident::model::poly::PolyNarx;
//! use dynocal_ident::validate::boundary::{Boundary, BoundaryKeys, Space, learn};
//!
//! let u: Vec<f64> = (0..400).map(|t| ((t * t * 7919) % 101) as f64 / 50.0 - 1.0).collect();
//! let mut y = vec![0.0; 400];
//! (1..400).for_each(|t| y[t] = 0.5 * y[t - 1] + u[t - 1]);
//! let data = [Experiment { name: "demo".into(), u, y, init_samples: 0, weights: vec![] }];
//! let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"])?;
//! let boundary = learn(Space::of(&model), &data, &BoundaryKeys::default())?;
//! assert!(boundary.distance(&[0.5, 0.2]) <= 1.0); // u(t-1), y(t-1)
//! assert!(boundary.distance(&[3.0, 0.2]) > 1.0);
//! let stored = serde_json::to_string(&boundary)?;
//! assert_eq!(serde_json::from_str::<dynocal_ident::validate::boundary::BoundaryModel>(&stored)?, boundary);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod combine;
mod gauge;
mod one_class;
mod operating;
mod region;
mod space;
mod star;

use dynocal_numerics::registry::ParamDoc;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::experiment::Experiment;
use crate::model::{Model, Run};

pub use combine::Combined;
pub use operating::OperatingBoundary;
use region::Region;
pub use region::{Quadratic, RegionKind};
pub use space::{Space, SpaceError};

/// A region with a distance: at most 1 inside, above 1 outside, growing along every ray from the centre.
pub trait Boundary: Send + Sync {
    /// Coordinates of a point.
    fn dim(&self) -> usize;

    /// The centre.
    fn centre(&self) -> &[f64];

    /// Distance of a point, in units of the boundary; infinite for a point that is not finite.
    fn distance(&self, point: &[f64]) -> f64;

    /// Distance and its gradient (zero at the centre; one of the subgradients where the hull has an edge).
    fn distance_gradient(&self, point: &[f64], gradient: &mut [f64]) -> f64;

    /// Distance to the border in units of the boundary: negative inside, 0 on it, positive outside; with its gradient.
    fn signed_distance(&self, point: &[f64], gradient: &mut [f64]) -> f64 {
        self.distance_gradient(point, gradient) - 1.0
    }

    /// Pulls a point outside back to the boundary along the ray to the centre; gives the distance that it had.
    fn clamp(&self, point: &mut [f64]) -> f64 {
        clamp_by_ray(self, point)
    }
}

/// For a distance that grows in proportion along every ray from the centre.
fn clamp_by_ray(boundary: &(impl Boundary + ?Sized), point: &mut [f64]) -> f64 {
    let distance = boundary.distance(point);
    if distance > 1.0 && distance.is_finite() {
        for (x, c) in point.iter_mut().zip(boundary.centre()) {
            *x = c + (*x - c) / distance;
        }
    }
    distance
}

/// How a boundary is learnt.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BoundaryKeys {
    /// Shape of the region.
    pub kind: RegionKind,
    /// Share of points of the same distribution that lie inside.
    pub quantile: f64,
    /// Most points that the hull is made of.
    pub points: usize,
}

impl Default for BoundaryKeys {
    fn default() -> Self {
        Self { kind: RegionKind::Leverage, quantile: 0.99, points: 400 }
    }
}

/// Documentation of the keys of a boundary.
pub static BOUNDARY_KEYS: &[ParamDoc] = &[
    ParamDoc {
        name: "kind",
        unit: "-",
        default: "leverage",
        what: "leverage: ellipsoid of the covariance of the lagged channels; hull: their convex hull (up to about ten of them); star: radius by direction, follows bays; one_class: kernel region, follows islands",
    },
    ParamDoc {
        name: "quantile",
        unit: "-",
        default: "0.99",
        what: "share of points of the same distribution that count as inside",
    },
    ParamDoc { name: "points", unit: "-", default: "400", what: "most points that the hull is made of" },
];

/// A boundary that was learnt: plain numbers that can be stored beside a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoundaryModel {
    /// What the coordinates are.
    pub space: Space,
    /// Share of points of the same distribution that lie inside.
    pub quantile: f64,
    /// Points that it was learnt from.
    pub samples: usize,
    region: Region,
}

impl BoundaryModel {
    /// The squared distance as a quadratic form of the coordinates, exact to second derivatives: for boundaries of the kind
    /// [`RegionKind::Leverage`], none for the others.
    pub fn quadratic(&self) -> Option<Quadratic> {
        self.region.quadratic()
    }

    /// Shape of its region.
    pub fn kind(&self) -> RegionKind {
        self.region.kind()
    }

    /// The same boundary in other units: coordinate k becomes `offset + scale x` with `lines[k] = (offset, scale)`.
    pub fn stretched(&self, lines: &[(f64, f64)]) -> Self {
        Self { region: self.region.stretched(lines), ..self.clone() }
    }
}

impl Boundary for BoundaryModel {
    fn dim(&self) -> usize {
        self.space.dim()
    }

    fn centre(&self) -> &[f64] {
        self.region.centre()
    }

    fn distance(&self, point: &[f64]) -> f64 {
        self.region.distance(point, None)
    }

    fn distance_gradient(&self, point: &[f64], gradient: &mut [f64]) -> f64 {
        self.region.distance(point, Some(gradient))
    }

    fn clamp(&self, point: &mut [f64]) -> f64 {
        if self.region.kind() == RegionKind::OneClass {
            return combine::clamp_by_bisection(self, point);
        }
        clamp_by_ray(self, point)
    }
}

/// Blocks that are held out in turn for the calibration.
const FOLDS: usize = 5;
/// Most points of each held-out block whose distance is computed.
const CALIBRATION: usize = 1000;

/// Learns a boundary from records.
///
/// # Errors
/// [`SpaceError`]: channels that the records do not have, too few samples, a quantile outside (0, 1).
pub fn learn(space: Space, data: &[Experiment], keys: &BoundaryKeys) -> Result<BoundaryModel, SpaceError> {
    if !(keys.quantile > 0.0 && keys.quantile < 1.0) {
        return Err(SpaceError::Quantile { found: keys.quantile });
    }
    let blocks = space.blocks(data, FOLDS)?;
    from_blocks(space, blocks, keys)
}

/// Learns a boundary from steady points `x` (n x d row-major). Every fifth point is held out in turn: neighbours in a
/// steady table are not alike because of time, and a block of it may be a whole corner of the region.
///
/// # Errors
/// [`SpaceError`]: too few points, a quantile outside (0, 1).
pub fn learn_steady(x: &[f64], d: usize, keys: &BoundaryKeys) -> Result<BoundaryModel, SpaceError> {
    if !(keys.quantile > 0.0 && keys.quantile < 1.0) {
        return Err(SpaceError::Quantile { found: keys.quantile });
    }
    let mut blocks = vec![Vec::new(); FOLDS];
    let finite = x.chunks_exact(d.max(1)).filter(|x| x.iter().all(|v| v.is_finite()));
    finite.enumerate().for_each(|(i, x)| blocks[i % FOLDS].extend_from_slice(x));
    from_blocks(Space::of_inputs(d), blocks, keys)
}

fn from_blocks(
    space: Space,
    blocks: Vec<Vec<f64>>,
    keys: &BoundaryKeys,
) -> Result<BoundaryModel, SpaceError> {
    let d = space.dim();
    let samples = blocks.iter().map(Vec::len).sum::<usize>() / d.max(1);
    let least = FOLDS * (d + 2);
    if d == 0 || samples < least || blocks.iter().any(Vec::is_empty) {
        return Err(SpaceError::TooFew { found: samples, expected: least, dim: d });
    }
    let distances: Vec<Vec<f64>> = (0..FOLDS)
        .into_par_iter()
        .map(|out| {
            let others: Vec<f64> = (0..FOLDS).filter(|k| *k != out).flat_map(|k| blocks[k].clone()).collect();
            let region = Region::fit(keys.kind, &others, d, keys.points, keys.quantile);
            let held = blocks[out].chunks_exact(d);
            let step = held.len().div_ceil(CALIBRATION);
            held.step_by(step.max(1)).map(|x| region.distance(x, None)).collect()
        })
        .collect();
    let mut distances = distances.concat();
    distances.sort_by(f64::total_cmp);
    // The smallest number that at least the quantile of n + 1 exchangeable points does not exceed.
    let rank = ((distances.len() + 1) as f64 * keys.quantile).ceil() as usize;
    let scale = distances[rank.clamp(1, distances.len()) - 1];
    let mut region = Region::fit(keys.kind, &blocks.concat(), d, keys.points, keys.quantile);
    region.scale_by(scale);
    Ok(BoundaryModel { space, quantile: keys.quantile, samples, region })
}

/// How a record or a plan lies to a boundary.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Largest distance.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub worst: f64,
    /// Its sample.
    pub sample: usize,
    /// Share of the samples outside.
    pub share_outside: f64,
    /// Distance of every sample; 0 for those before the first whole point.
    #[serde(deserialize_with = "crate::nullable::numbers")]
    pub distances: Vec<f64>,
}

/// Distances of the samples from `start` on (and from the longest lag on) of inputs `u` (N x m) and output `y` (N).
pub fn coverage(boundary: &BoundaryModel, u: &[f64], y: &[f64], start: usize) -> Coverage {
    let space = &boundary.space;
    let m = u.len().checked_div(y.len()).unwrap_or(0);
    let first = start.max(space.max_lag()).min(y.len());
    let later: Vec<f64> = (first..y.len())
        .into_par_iter()
        .map_init(
            || vec![0.0; space.dim()],
            |point, t| {
                space.point(u, m, y, t, point);
                boundary.distance(point)
            },
        )
        .collect();
    let outside = later.iter().filter(|d| **d > 1.0).count();
    let share_outside = outside as f64 / later.len().max(1) as f64;
    let distances: Vec<f64> = std::iter::repeat_n(0.0, first).chain(later).collect();
    let sample = (0..distances.len()).max_by(|&a, &b| distances[a].total_cmp(&distances[b])).unwrap_or(0);
    Coverage { worst: distances.get(sample).copied().unwrap_or(0.0), sample, share_outside, distances }
}

/// Distances along a plan: the outputs are those of the model in free run, from `run.y[..run.start]`.
pub fn coverage_of_plan(model: &dyn Model, theta: &[f64], boundary: &BoundaryModel, run: &Run) -> Coverage {
    let mut y = vec![0.0; run.len()];
    model.simulate(theta, run, &mut y);
    coverage(boundary, run.u, &y, run.start)
}
