//! The thesis' fuel problem on [`EngineModel`]s: [`crate::optimise`] with injection, spark and throttle, torque and lambda.

use crate::engine_model::EngineModel;
use crate::optimise::model::OutputModel;
use crate::optimise::{OptimiseError, OptimiseOptions, optimise_models};
use crate::problem::CalibrationProblem;
use crate::record::INPUTS;
use dynocal_ident::data::Dataset;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Why an optimisation could not be set up.
pub type FuelError = OptimiseError;

/// Settings of the optimisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiseSpec {
    /// Bounds of INJ in mg (eq. 7.14).
    pub inj_mg: (f64, f64),
    /// Bounds of spark advance in deg.
    pub spark_deg: (f64, f64),
    /// Bounds of the throttle angle in deg.
    pub throttle_deg: (f64, f64),
    /// Largest change of spark per sample in deg.
    pub spark_rate_deg: f64,
    /// Weights on squared increments of INJ, spark, throttle in kg/h per unit^2, mean over samples.
    pub increment_weight: [f64; 3],
    /// Most iterations.
    pub max_iterations: usize,
    /// Scaled KKT error at which it has converged.
    pub tolerance: f64,
}

impl Default for OptimiseSpec {
    fn default() -> Self {
        Self {
            inj_mg: (0.0, 30.0),
            spark_deg: (5.0, 30.0),
            throttle_deg: (0.0, 90.0),
            spark_rate_deg: 1.0,
            increment_weight: [2e-2, 1e-2, 2e-2],
            max_iterations: 300,
            tolerance: 1e-8,
        }
    }
}

/// Result of one optimisation.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FuelOutcome {
    /// How the search ended.
    pub status: Status,
    /// Iterations.
    pub iterations: usize,
    /// Optimal INJ, spark, throttle, N x 3 row-major.
    pub inputs: Vec<f64>,
    /// Torque demand: the torque model's response to the start inputs, in Nm.
    pub torque_demand_nm: Vec<f64>,
    /// Lambda demand: the lambda model's response to the start inputs.
    pub lambda_demand: Vec<f64>,
    /// Mean model fuel of the start over the decided samples, in kg/h.
    pub start_fuel_kg_h: f64,
    /// Mean model fuel of the optimum over the same samples, in kg/h.
    pub fuel_kg_h: f64,
    /// Largest violation of the demands when the optimum is run free through the models: torque in Nm.
    pub torque_violation_nm: f64,
    /// The same for lambda.
    pub lambda_violation: f64,
    /// First decided sample.
    pub first: usize,
}

impl OptimiseSpec {
    /// The thesis' problem with these bounds and weights, for records sampled every `sample_time_s`.
    fn problem(&self, sample_time_s: f64) -> CalibrationProblem {
        let mut problem = CalibrationProblem::thesis();
        let bounds = [self.inj_mg, self.spark_deg, self.throttle_deg];
        for ((c, bounds), weight) in problem.inputs.iter_mut().zip(bounds).zip(self.increment_weight) {
            (c.lower, c.upper) = bounds;
            c.increment_weight = weight;
        }
        let rate = self.spark_rate_deg / sample_time_s;
        problem.inputs[1].rate_per_s = rate.is_finite().then_some(rate);
        problem
    }
}

/// Minimises fuel on the inputs of `start` (a record with actuators, speed, and first samples of the outputs).
///
/// # Errors
/// [`OptimiseError`].
pub fn minimise_fuel(
    spec: &OptimiseSpec,
    torque: &EngineModel,
    lambda: &EngineModel,
    start: &Dataset,
    interrupt: &dyn Fn() -> bool,
) -> Result<FuelOutcome, FuelError> {
    let problem = spec.problem(start.sample_time_s);
    let options = OptimiseOptions {
        tolerance: spec.tolerance,
        max_iterations: spec.max_iterations,
        ..OptimiseOptions::default()
    };
    let models = [OutputModel::from(torque), OutputModel::from(lambda)];
    let found = optimise_models(&problem, &models, start, &options, interrupt)?;
    let inputs: Vec<&[f64]> = INPUTS[..3].iter().filter_map(|name| found.input(name)).collect();
    let demand = |k: usize| found.demands[k].values.clone();
    Ok(FuelOutcome {
        status: found.status,
        iterations: found.iterations,
        inputs: (0..start.len()).flat_map(|t| inputs.iter().map(move |c| c[t])).collect(),
        torque_demand_nm: demand(0),
        lambda_demand: demand(1),
        start_fuel_kg_h: found.start_objective,
        fuel_kg_h: found.objective,
        torque_violation_nm: found.violation("torque"),
        lambda_violation: found.violation("lambda"),
        first: found.first,
    })
}
