//! Regions made of regions.
//!
//! ```text
//! and   max_k d_k        or   min_k d_k        not   2 - d
//! ```
//!
//! As for every boundary, 1 is the border; the gradient is that of the region that decides.

use super::{Boundary, BoundaryModel};
use serde::{Deserialize, Serialize};

/// Steps of the bisection towards the centre.
const STEPS: usize = 60;

/// A region, or several of the same coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Combined {
    /// One that was learnt.
    Learnt {
        /// It.
        region: BoundaryModel,
    },
    /// One whose limits depend on the operating point.
    Operating {
        /// It.
        region: super::operating::OperatingBoundary,
    },
    /// Inside all.
    And {
        /// Them; at least one.
        regions: Vec<Combined>,
    },
    /// Inside any.
    Or {
        /// Them; at least one.
        regions: Vec<Combined>,
    },
    /// Outside.
    Not {
        /// Of this one.
        region: Box<Combined>,
    },
}

impl Combined {
    fn deciding(&self, point: &[f64]) -> Option<&Combined> {
        let by = |a: &&Combined, b: &&Combined| a.distance(point).total_cmp(&b.distance(point));
        match self {
            Self::And { regions } => regions.iter().max_by(by),
            Self::Or { regions } => regions.iter().min_by(by),
            _ => None,
        }
    }
}

impl Boundary for Combined {
    fn dim(&self) -> usize {
        match self {
            Self::Learnt { region } => region.dim(),
            Self::Operating { region } => region.dim(),
            Self::And { regions } | Self::Or { regions } => regions.first().map_or(0, Combined::dim),
            Self::Not { region } => region.dim(),
        }
    }

    fn centre(&self) -> &[f64] {
        match self {
            Self::Learnt { region } => region.centre(),
            Self::Operating { region } => region.centre(),
            // A centre of the first region that lies inside; the first one where none does.
            Self::And { regions } | Self::Or { regions } => {
                let inside = regions.iter().find(|r| self.distance(r.centre()) <= 1.0);
                inside.or(regions.first()).map_or(&[], Combined::centre)
            }
            Self::Not { region } => region.centre(),
        }
    }

    fn distance(&self, point: &[f64]) -> f64 {
        match self {
            Self::Learnt { region } => region.distance(point),
            Self::Operating { region } => region.distance(point),
            Self::Not { region } => 2.0 - region.distance(point),
            Self::And { .. } | Self::Or { .. } => {
                self.deciding(point).map_or(f64::INFINITY, |r| r.distance(point))
            }
        }
    }

    fn distance_gradient(&self, point: &[f64], gradient: &mut [f64]) -> f64 {
        match self {
            Self::Learnt { region } => region.distance_gradient(point, gradient),
            Self::Operating { region } => region.distance_gradient(point, gradient),
            Self::Not { region } => {
                let distance = region.distance_gradient(point, gradient);
                gradient.iter_mut().for_each(|g| *g = -*g);
                2.0 - distance
            }
            Self::And { .. } | Self::Or { .. } => match self.deciding(point) {
                Some(region) => region.distance_gradient(point, gradient),
                None => {
                    gradient.fill(0.0);
                    f64::INFINITY
                }
            },
        }
    }

    fn clamp(&self, point: &mut [f64]) -> f64 {
        clamp_by_bisection(self, point)
    }
}

/// Pulls a point outside towards the centre up to the first border by bisection, for regions whose distance does not grow
/// in proportion; a point whose centre lies outside too stays where it is.
pub(super) fn clamp_by_bisection(boundary: &dyn Boundary, point: &mut [f64]) -> f64 {
    let distance = boundary.distance(point);
    let centre = boundary.centre().to_vec();
    if !(distance > 1.0) || !distance.is_finite() || boundary.distance(&centre) > 1.0 {
        return distance;
    }
    let start = point.to_vec();
    let (mut inside, mut outside) = (0.0, 1.0);
    let mut trial = start.clone();
    for _ in 0..STEPS {
        let share = 0.5 * (inside + outside);
        trial.iter_mut().zip(&start).zip(&centre).for_each(|((t, s), c)| *t = c + share * (s - c));
        if boundary.distance(&trial) <= 1.0 {
            inside = share;
            point.copy_from_slice(&trial);
        } else {
            outside = share;
        }
    }
    if inside == 0.0 {
        point.copy_from_slice(&centre);
    }
    distance
}
