//! Fuel optimisation over a whole record (thesis section 7.5).

pub mod problem;

use crate::engine_model::EngineModel;
use crate::record::{INJ, INPUTS, SPARK, THROTTLE};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::nlp::{self, NlpOptions, SparseNlp};
use dynocal_numerics::status::Status;
use problem::{CHANNELS, Equality, FuelProblem, FuelSpec, Source};
use serde::{Deserialize, Serialize};

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

/// Why an optimisation could not be set up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FuelError {
    /// The record lacks something.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The demand cannot be formed.
    #[error(
        "the {output} model is unstable in free run on the start inputs of `{record}`: no demand can be formed from it"
    )]
    Unstable {
        /// Output.
        output: String,
        /// Record.
        record: String,
    },
    /// The start itself breaks a limit.
    #[error(
        "start inputs of `{record}` break the limits: {channel} is {found} {unit} at sample {sample}, allowed {lower} to {upper}"
    )]
    Start {
        /// Record.
        record: String,
        /// Channel.
        channel: String,
        /// Value.
        found: f64,
        /// Unit.
        unit: String,
        /// Sample.
        sample: usize,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// An input of a model that the record cannot give.
    #[error("model input `{found}` is neither an actuator nor derived from the speed; known: {known}")]
    Input {
        /// Name.
        found: String,
        /// Known names.
        known: String,
    },
}

/// Minimises fuel on the inputs of `start` (a record with actuators, speed, and first samples of the outputs).
///
/// The demand of both outputs is the models' own free-run response to the start inputs, so the program is feasible
/// by construction.
///
/// # Errors
/// [`FuelError`].
pub fn minimise_fuel(
    spec: &OptimiseSpec,
    torque: &EngineModel,
    lambda: &EngineModel,
    start: &Dataset,
    interrupt: &dyn Fn() -> bool,
) -> Result<FuelOutcome, FuelError> {
    let n = start.len();
    let names: Vec<String> = [INJ, SPARK, THROTTLE].map(|i| INPUTS[i].to_string()).to_vec();
    let decisions = start.matrix(&names)?;
    check_start(spec, start, &names)?;
    let first = torque.structure.max_lag().max(lambda.structure.max_lag());
    let speed = start.values("speed")?;
    let given: Vec<f64> = speed.iter().flat_map(|s| [*s, crate::engine_model::cycle_s(*s)]).collect();
    let torque_run = ModelRun::new(torque, start, first)?;
    let lambda_run = ModelRun::new(lambda, start, first)?;
    let fuel_spec = FuelSpec {
        start: &decisions,
        given: &given,
        n_given: 2,
        first,
        bounds: [spec.inj_mg, spec.spark_deg, spec.throttle_deg],
        spark_rate_deg: spec.spark_rate_deg,
        increment_weight: spec.increment_weight,
    };
    let mut problem = FuelProblem::new(fuel_spec, vec![torque_run.equality(), lambda_run.equality()]);
    let mut x0 = vec![0.0; problem.n()];
    problem.start(&mut x0);
    let start_fuel_kg_h = problem.fuel_kg_h(&x0);
    let options = NlpOptions { tolerance: spec.tolerance, max_iterations: spec.max_iterations };
    let outcome = nlp::solve(&mut problem, &options, interrupt);
    let inputs = problem.inputs(&outcome.x);
    let torque_violation_nm = torque_run.violation(&inputs, &given, n);
    let lambda_violation = lambda_run.violation(&inputs, &given, n);
    Ok(FuelOutcome {
        status: outcome.status,
        iterations: outcome.history.len().saturating_sub(1),
        fuel_kg_h: problem.fuel_kg_h(&outcome.x),
        start_fuel_kg_h,
        torque_demand_nm: torque_run.measured_demand(),
        lambda_demand: lambda_run.measured_demand(),
        torque_violation_nm,
        lambda_violation,
        inputs,
        first,
    })
}

fn check_start(spec: &OptimiseSpec, start: &Dataset, names: &[String]) -> Result<(), FuelError> {
    for (name, (lower, upper)) in names.iter().zip([spec.inj_mg, spec.spark_deg, spec.throttle_deg]) {
        let channel = start.channel(name)?;
        let outside = |v: &f64| !(lower - 1e-9..=upper + 1e-9).contains(v);
        if let Some(sample) = channel.values.iter().position(outside) {
            return Err(FuelError::Start {
                record: start.name.clone(),
                channel: name.clone(),
                found: channel.values[sample],
                unit: channel.unit.clone(),
                sample,
                lower,
                upper,
            });
        }
    }
    Ok(())
}

/// A model with its demand on one record.
struct ModelRun<'a> {
    model: &'a EngineModel,
    demand: Vec<f64>,
    sources: Vec<Source>,
    first: usize,
}

impl<'a> ModelRun<'a> {
    fn new(model: &'a EngineModel, start: &Dataset, first: usize) -> Result<Self, FuelError> {
        let sources = model.structure.inputs().iter().map(|name| source(name)).collect::<Result<_, _>>()?;
        let u = model.input_rows(start)?;
        let y: Vec<f64> = start.values(&model.output)?.iter().map(|v| model.transform.apply(*v)).collect();
        let mut demand = vec![0.0; y.len()];
        let status = model.structure.simulate(&model.theta, &Run { u: &u, y: &y, start: first }, &mut demand);
        if status == Status::Diverged {
            return Err(FuelError::Unstable { output: model.output.clone(), record: start.name.clone() });
        }
        Ok(Self { model, demand, sources, first })
    }

    fn equality(&self) -> Equality<'_> {
        Equality {
            model: &self.model.structure,
            theta: &self.model.theta,
            inputs: self.sources.clone(),
            demand: &self.demand,
        }
    }

    fn measured_demand(&self) -> Vec<f64> {
        self.demand.iter().map(|v| self.model.transform.apply(*v)).collect()
    }

    /// Largest difference between the demand and a free run on `inputs`, in the user's unit.
    fn violation(&self, inputs: &[f64], given: &[f64], n: usize) -> f64 {
        let u: Vec<f64> = (0..n)
            .flat_map(|t| {
                self.sources.iter().map(move |s| match s {
                    Source::Decision(c) => inputs[t * CHANNELS + c],
                    Source::Given(k) => given[t * 2 + k],
                })
            })
            .collect();
        let mut y = vec![0.0; n];
        let run = Run { u: &u, y: &self.demand, start: self.first + 1 };
        self.model.structure.simulate(&self.model.theta, &run, &mut y);
        let apply = |v: f64| self.model.transform.apply(v);
        let worst = y.iter().zip(&self.demand).map(|(a, b)| (apply(*a) - apply(*b)).abs());
        worst.fold(0.0, |m, e| if e > m || e.is_nan() { e } else { m })
    }
}

fn source(name: &str) -> Result<Source, FuelError> {
    match name {
        "inj" => Ok(Source::Decision(0)),
        "spark" => Ok(Source::Decision(1)),
        "throttle" => Ok(Source::Decision(2)),
        "speed" => Ok(Source::Given(0)),
        crate::engine_model::CYCLE => Ok(Source::Given(1)),
        _ => Err(FuelError::Input {
            found: name.into(),
            known: format!("{}, {}", INPUTS.join(", "), crate::engine_model::CYCLE),
        }),
    }
}
