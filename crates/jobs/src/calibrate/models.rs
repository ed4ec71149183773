//! Steps 2 and 4: identification of the torque and lambda models of an engine from closed-loop records.

use super::context::{ChainError, Context};
use super::spec::IdentifySpec;
use dynocal_calib::engine_model::{CYCLE, EngineModel, Transform, with_derived};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::estimate::{Estimator, Fit, ols::Ols, sem::Sem};
use dynocal_ident::experiment::{Experiment, experiments};
use dynocal_ident::model::Model as _;
use dynocal_ident::model::literature;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::select::frols::{Stop, frols};
use dynocal_ident::select::pool::PoolSpec;
use dynocal_ident::select::prune::prune;
use dynocal_ident::validate::{Kind, Seen, score_values};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Free-run fit of one model on one record, in the user's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FreeRunScore {
    /// Record.
    pub record: String,
    /// Identification or unseen data.
    pub data: Seen,
    /// Root mean square error in the output's unit; none when the free run diverged.
    pub rmse: Option<f64>,
    /// 95th percentile of |error|.
    pub p95: Option<f64>,
    /// R2 of eq. 2.48.
    pub r2: Option<f64>,
}

/// One candidate model with its free-run scores.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Candidate {
    /// Name, e.g. `selected, simulation error`.
    pub name: String,
    /// The model.
    pub model: EngineModel,
    /// How the estimator ended.
    pub status: Status,
    /// Cost evaluations.
    pub evaluations: usize,
    /// Standard errors of the parameters (valid for white errors only).
    pub std_errors: Vec<Option<f64>>,
    /// Scores on every record.
    pub scores: Vec<FreeRunScore>,
    /// Mean R2 over the unseen records; none when one diverged.
    pub unseen_r2: Option<f64>,
    /// Warnings of the estimator.
    pub warnings: Vec<String>,
}

/// All candidates of one output; the chosen one goes on.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct OutputModels {
    /// Output.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Candidates.
    pub candidates: Vec<Candidate>,
    /// Index of the candidate with the best mean R2 on unseen records.
    pub chosen: usize,
}

impl OutputModels {
    /// The candidate that goes on.
    pub fn best(&self) -> &Candidate {
        &self.candidates[self.chosen]
    }
}

/// Models of one step.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ModelsResult {
    /// Torque.
    pub torque: OutputModels,
    /// Lambda.
    pub lambda: OutputModels,
}

/// Identifies both outputs.
///
/// # Errors
/// [`ChainError`].
pub fn identify_pair(
    ctx: &Context,
    identification: &[Dataset],
    validation: &[Dataset],
) -> Result<(OutputModels, OutputModels), ChainError> {
    let derive = |set: &[Dataset]| set.iter().map(with_derived).collect::<Result<Vec<_>, DataError>>();
    let (ident, val) = (derive(identification)?, derive(validation)?);
    let job = |output: &str| identify_output(ctx, output, &ident, &val);
    let (torque, lambda) = rayon::join(|| job("torque"), || job("lambda"));
    Ok((torque?, lambda?))
}

/// Estimates the chosen structures again on more records, starting from their last parameters.
///
/// # Errors
/// [`ChainError`].
pub fn estimate_again(
    ctx: &Context,
    previous: (&OutputModels, &OutputModels),
    identification: &[Dataset],
    validation: &[Dataset],
) -> Result<(OutputModels, OutputModels), ChainError> {
    let derive = |set: &[Dataset]| set.iter().map(with_derived).collect::<Result<Vec<_>, DataError>>();
    let (ident, val) = (derive(identification)?, derive(validation)?);
    let job = |models: &OutputModels| -> Result<OutputModels, ChainError> {
        let old = &models.best().model;
        let sem = simulation_error(&ctx.spec.identify);
        let task = Task { output: &models.output, transform: old.transform, ident: &ident, val: &val };
        let name = format!("{}, all records", models.best().name.trim_end_matches(", all records"));
        let candidate = task.estimate(ctx, &name, &old.structure, &sem, Some(&old.theta))?;
        Ok(OutputModels { candidates: vec![candidate], chosen: 0, ..models.clone() })
    };
    let (torque, lambda) = rayon::join(|| job(previous.0), || job(previous.1));
    Ok((torque?, lambda?))
}

fn identify_output(
    ctx: &Context,
    output: &str,
    ident: &[Dataset],
    val: &[Dataset],
) -> Result<OutputModels, ChainError> {
    let spec = &ctx.spec.identify;
    let published = published_structure(output)?;
    let (structure, transform) = select(ctx, output, ident)?;
    let mut candidates = Vec::new();
    for (structure, transform, kind) in [
        (&published, Transform::Identity, "published structure (7.8)"),
        (&structure, transform, "selected structure"),
    ] {
        let task = Task { output, transform, ident, val };
        for (estimator, label) in estimators(spec) {
            let name = format!("{kind}, {label}");
            candidates.push(task.estimate(ctx, &name, structure, estimator.as_ref(), None)?);
        }
    }
    let score = |c: &Candidate| c.unseen_r2.unwrap_or(f64::NEG_INFINITY);
    let best = candidates.iter().map(score).fold(f64::NEG_INFINITY, f64::max);
    let chosen = candidates.iter().position(|c| score(c) == best).unwrap_or(0);
    let unit = if output == "torque" { "Nm" } else { "-" };
    Ok(OutputModels { output: output.into(), unit: unit.into(), candidates, chosen })
}

fn estimators(spec: &IdentifySpec) -> [(Box<dyn Estimator>, &'static str); 2] {
    [(Box::new(Ols::default()), "one-step error"), (Box::new(simulation_error(spec)), "simulation error")]
}

fn simulation_error(spec: &IdentifySpec) -> Sem {
    Sem { max_evaluations: spec.max_evaluations, cost_tolerance: 1e-6, ridge: spec.ridge, ..Sem::default() }
}

/// Inputs of every engine model, in this order: the actuators and the derived cycle duration.
pub fn model_inputs() -> Vec<String> {
    dynocal_calib::record::INPUTS.iter().map(|s| (*s).to_string()).chain([CYCLE.to_string()]).collect()
}

/// The published structure over [`model_inputs`], so that all models of a campaign share their inputs.
fn published_structure(output: &str) -> Result<PolyNarx, ChainError> {
    let model = if output == "torque" { literature::torque_7_8() } else { literature::lambda_7_8() }.model;
    PolyNarx::parse(&model_inputs(), output, &model.regressor_texts()).map_err(|e| ChainError::Identify {
        what: format!("published {output} model"),
        reason: e.to_string(),
    })
}

/// Structure by forward selection (FROLS) from the pool of the feasibility study.
fn select(ctx: &Context, output: &str, ident: &[Dataset]) -> Result<(PolyNarx, Transform), ChainError> {
    let spec = &ctx.spec.identify;
    let inputs = model_inputs();
    let (pool, terms, transform, name) = if output == "torque" {
        (torque_pool(), spec.torque_terms, Transform::Identity, "torque")
    } else {
        (lambda_pool(), spec.lambda_terms, Transform::Reciprocal, "phi")
    };
    let data = experiments(ident, &inputs, name)?;
    let fault = |reason: String| ChainError::Identify { what: format!("structure of {output}"), reason };
    let pool =
        PolyNarx::new(inputs.clone(), name.into(), pool.candidates()).map_err(|e| fault(e.to_string()))?;
    // One-step prediction says little about the free run: forward selection takes more terms than wanted, backward
    // elimination on the simulation error brings them down.
    let wide = Stop::Terms(terms + spec.surplus_terms);
    let selection = frols(&pool, &data, wide).map_err(|e| fault(e.to_string()))?;
    let mut data = data;
    if transform == Transform::Reciprocal {
        weigh_as_measured(&mut data);
    }
    let sem = simulation_error(&IdentifySpec { max_evaluations: 12, ..spec.clone() });
    let path = prune(&selection.model, &data, &sem, terms, &|| (ctx.interrupt)())
        .map_err(|e| fault(e.to_string()))?;
    Ok((path.last().map_or(selection.model, |p| p.model.clone()), transform))
}

// Input numbers in the pools: INJ, spark, throttle, speed, cycle.
const INJ: usize = 0;
const SPARK: usize = 1;
const THROTTLE: usize = 2;
const SPEED: usize = 3;
const CYCLE_S: usize = 4;

fn lags(input: usize, lags: std::ops::RangeInclusive<usize>) -> impl Iterator<Item = (usize, usize)> {
    lags.map(move |l| (input, l))
}

fn torque_pool() -> PoolSpec {
    PoolSpec {
        lagged: lags(INJ, 1..=5)
            .chain(lags(SPARK, 1..=3))
            .chain(lags(THROTTLE, 1..=5))
            .chain([(SPEED, 1), (SPEED, 3), (CYCLE_S, 1)])
            .collect(),
        cubic: vec![(INJ, 2), (SPARK, 1), (THROTTLE, 2), (CYCLE_S, 1)],
        output_lags: vec![1, 2],
        output_times: vec![(SPEED, 1), (CYCLE_S, 1), (INJ, 1), (THROTTLE, 1)],
    }
}

fn lambda_pool() -> PoolSpec {
    PoolSpec {
        lagged: lags(INJ, 1..=8)
            .chain(lags(THROTTLE, 1..=6))
            .chain([(SPEED, 1), (SPEED, 3), (CYCLE_S, 1)])
            .collect(),
        cubic: vec![(INJ, 3), (THROTTLE, 2), (CYCLE_S, 1)],
        output_lags: vec![1, 2],
        output_times: vec![(SPEED, 1), (CYCLE_S, 1), (INJ, 1), (THROTTLE, 1)],
    }
}

/// One output on one set of records.
struct Task<'a> {
    output: &'a str,
    transform: Transform,
    ident: &'a [Dataset],
    val: &'a [Dataset],
}

impl Task<'_> {
    fn estimate(
        &self,
        ctx: &Context,
        name: &str,
        structure: &PolyNarx,
        estimator: &dyn Estimator,
        start: Option<&[f64]>,
    ) -> Result<Candidate, ChainError> {
        ctx.check_interrupt()?;
        let (output, transform) = (self.output, self.transform);
        let column = if transform == Transform::Reciprocal { "phi" } else { output };
        let mut data = experiments(self.ident, structure.inputs(), column)?;
        if transform == Transform::Reciprocal {
            weigh_as_measured(&mut data);
        }
        let fit = estimator.estimate(structure, &data, start, &|| (ctx.interrupt)()).map_err(|e| {
            ChainError::Identify { what: format!("{output} model, {name}"), reason: e.to_string() }
        })?;
        let model = EngineModel {
            schema_version: 1,
            output: output.into(),
            transform,
            sample_time_s: self.ident[0].sample_time_s,
            origin: name.into(),
            structure: structure.clone(),
            theta: fit.theta.clone(),
        };
        let mut scores = Vec::new();
        for (set, data) in [(self.ident, Seen::Identification), (self.val, Seen::Unseen)] {
            for record in set {
                scores.push(free_run_score(&model, record, data)?);
            }
        }
        Ok(Candidate {
            name: name.into(),
            status: fit.status,
            evaluations: fit.evaluations,
            std_errors: finite(&fit),
            unseen_r2: mean_r2(&scores),
            scores,
            model,
            warnings: fit.warnings,
        })
    }
}

fn finite(fit: &Fit) -> Vec<Option<f64>> {
    fit.std_errors.iter().map(|v| v.is_finite().then_some(*v)).collect()
}

/// An error in `phi = 1/lambda` is one of `lambda^2` times its size in lambda: weights that make the fit count
/// errors of lambda itself.
fn weigh_as_measured(data: &mut [Experiment]) {
    for e in data {
        e.weights = e.y.iter().map(|phi| phi.abs().max(0.3).powi(-4)).collect();
    }
}

fn mean_r2(scores: &[FreeRunScore]) -> Option<f64> {
    let unseen: Vec<&FreeRunScore> = scores.iter().filter(|s| s.data == Seen::Unseen).collect();
    let sum: Option<f64> = unseen.iter().map(|s| s.r2).sum();
    sum.filter(|_| !unseen.is_empty()).map(|s| s / unseen.len() as f64)
}

/// Free run of `model` on `record`, scored in the measured unit after the initialisation window.
///
/// # Errors
/// [`DataError`] when a channel is missing.
pub fn free_run_score(model: &EngineModel, record: &Dataset, data: Seen) -> Result<FreeRunScore, DataError> {
    let (y, status) = model.simulate(record)?;
    let measured = record.values(&model.output)?;
    let first = record.init_samples.max(model.structure.max_lag());
    let reference = dynocal_ident::validate::Reference::Noisy;
    let score = score_values(&measured[first..], &y[first..], Kind::FreeRun, data, reference);
    let value = |v: f64| (status == Status::Converged && v.is_finite()).then_some(v);
    Ok(FreeRunScore {
        record: record.name.clone(),
        data,
        rmse: value(score.rmse),
        p95: value(score.error_95),
        r2: value(score.r2),
    })
}
