//! Guard: an optimum stays where its models were identified.
//!
//! Each model's distance d from what it was identified on ([`BoundaryModel`], an ellipsoid of lagged inputs and outputs)
//! becomes an output of the program like any other, with a limit at every sample:
//!
//! ```text
//! d(t)^2 = z'Az,    z the lagged channels of sample t in units of the boundary,    d(t) <= max(distance, d of the start)
//! ```
//!
//! Where the start itself lies further out (the demand may ask for it), the optimum goes no further. The equation is a quadratic
//! polynomial, so its derivatives are exact; price, soft limit and what is said of a problem without solution are those of limits.

use super::error::OptimiseError;
use super::model::{OutputModel, OutputWay, Source};
use crate::problem::{CalibrationProblem, LimitChannel};
use dynocal_files::spec::Faults;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::derived::Monomial;
use dynocal_ident::model::poly::{PolyNarx, Regressor, StructureError};
use dynocal_ident::validate::boundary::{BoundaryModel, Quadratic, Space};
use serde::{Deserialize, Serialize};

/// How far an optimum may go from what its models were identified on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Guard {
    /// Largest distance; 1 is the boundary.
    pub distance: f64,
    /// Makes it soft: price of a violation, mean over samples of its size, objective unit per unit of distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub soft_weight: Option<f64>,
}

impl Guard {
    /// Checks its keys.
    pub(super) fn check(&self, key: &str, faults: &mut Faults) {
        faults.positive(
            &format!("{key}.distance"),
            self.distance,
            "in units of the boundary of what was identified",
        );
        if let Some(weight) = self.soft_weight {
            faults.positive(&format!("{key}.soft_weight"), weight, "objective unit per unit of distance");
        }
    }
}

/// Name of the channel that is the distance of the model of `output` from what it was identified on.
pub fn distance_name(output: &str) -> String {
    format!("{output}_distance")
}

/// A problem with the distances of its models as outputs.
pub(super) struct Guarded {
    pub(super) problem: CalibrationProblem,
    pub(super) start: Dataset,
    distances: Vec<Distance>,
}

/// The distance of one model.
struct Distance {
    name: String,
    structure: PolyNarx,
    theta: Vec<f64>,
    inputs: Vec<Source>,
}

impl Guarded {
    pub(super) fn new(
        problem: &CalibrationProblem,
        models: &[OutputModel<'_>],
        start: &Dataset,
        guard: Guard,
    ) -> Result<Self, OptimiseError> {
        let distances = models.iter().map(Distance::new).collect::<Result<Vec<_>, _>>()?;
        let (mut problem, mut start) = (problem.clone(), start.clone());
        for d in &distances {
            problem.limits.push(LimitChannel {
                output: d.name.clone(),
                unit: "-".into(),
                lower: Some(0.0),
                upper: Some(guard.distance),
                mean_upper: None,
                soft_weight: guard.soft_weight,
            });
            let (name, values) = (d.name.clone(), vec![0.0; start.len()]);
            start.channels.push(Channel { name, unit: "-".into(), role: Role::Output, values });
        }
        Ok(Self { problem, start, distances })
    }

    /// Names of the distances.
    pub(super) fn names(&self) -> Vec<String> {
        self.distances.iter().map(|d| d.name.clone()).collect()
    }

    /// The distances as models.
    pub(super) fn models(&self) -> impl Iterator<Item = OutputModel<'_>> {
        self.distances.iter().map(|d| OutputModel {
            output: d.name.clone(),
            model: &d.structure,
            theta: &d.theta,
            inputs: d.inputs.clone(),
            way: OutputWay { factor: 1.0, power: 2, offset: 0.0, scale: 1.0 },
            boundary: None,
            draws: Vec::new(),
        })
    }
}

impl Distance {
    fn new(m: &OutputModel<'_>) -> Result<Self, OptimiseError> {
        let refused = |found| OptimiseError::Guard { output: m.output.clone(), found };
        let boundary = m.boundary.ok_or_else(|| refused("none"))?;
        let quadratic = boundary.quadratic().ok_or_else(|| refused("one of another kind"))?;
        // A file may hold any space beside any model.
        let other = "one that is not of its inputs and outputs";
        let (d, space) = (boundary.space.dim(), &boundary.space);
        let fits = quadratic.centre.len() == d && quadratic.scale.len() == d;
        if !fits || space.inputs.iter().any(|(i, _)| *i >= m.inputs.len()) {
            return Err(refused(other));
        }
        let inputs = sources(m, boundary, &quadratic);
        let (structure, theta) = polynomial(space, &quadratic).map_err(|_| refused(other))?;
        Ok(Self { name: distance_name(&m.output), structure, theta, inputs })
    }
}

/// One channel for each coordinate, centred and scaled as the quadratic form has it.
fn sources(m: &OutputModel<'_>, boundary: &BoundaryModel, q: &Quadratic) -> Vec<Source> {
    let own = Source {
        monomial: Monomial { factor: m.way.factor, powers: vec![(m.output.clone(), m.way.power)] },
        offset: m.way.offset,
        scale: m.way.scale,
    };
    let of_inputs = boundary.space.inputs.iter().map(|(i, _)| &m.inputs[*i]);
    let all = of_inputs.chain(boundary.space.outputs.iter().map(|_| &own));
    all.zip(q.centre.iter().zip(&q.scale))
        .map(|(s, (centre, scale))| Source {
            monomial: s.monomial.clone(),
            offset: s.offset + s.scale * centre,
            scale: s.scale * scale,
        })
        .collect()
}

/// `z'Az` as a polynomial of one input for each coordinate.
fn polynomial(space: &Space, q: &Quadratic) -> Result<(PolyNarx, Vec<f64>), StructureError> {
    let lags: Vec<usize> = space.inputs.iter().map(|i| i.1).chain(space.outputs.iter().copied()).collect();
    let d = lags.len();
    let at = |k: usize| Regressor::input(k, lags[k]);
    let (mut regressors, mut theta) = (Vec::new(), Vec::new());
    for a in 0..d {
        for b in a..d {
            let twice = if a == b { 1.0 } else { 2.0 };
            regressors.push(at(a).times(&at(b)));
            theta.push(twice * q.matrix[a * d + b]);
        }
    }
    let names = (0..d).map(|k| format!("z{k}")).collect();
    Ok((PolyNarx::new(names, "distance_squared".into(), regressors)?, theta))
}
