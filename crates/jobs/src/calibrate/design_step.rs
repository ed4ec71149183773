//! Step 3: an optimal test signal for the identified models, run on the plant, and what it gained.
//!
//! The record is designed in the reference space (demanded torque, demanded lambda, spark, speed) and run through
//! the loops, because an open-loop design in the inputs lets lambda run wild.

use super::context::{ChainError, Context, Event, RecordRef, gains, save_records};
use super::excite_step::{LEAD_IN_S, extra_record, through_loops};
use super::models::{ModelsResult, OutputModels, identify_pair};
use super::optimise_step::response_and_actuators;
use super::reference_design::{ReferenceLayout, ReferenceObjective, model_inputs};
use dynocal_calib::engine_model::EngineModel;
use dynocal_calib::map::start::StartRule;
use dynocal_calib::record::Demand;
use dynocal_design::channel::Channel;
use dynocal_design::criterion::{self, Criterion};
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::linalg::QrWork;
use dynocal_numerics::optim::{Bounds, Budget, Optimiser, Outcome, QuasiNewton};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A criterion before and after the search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CriterionValue {
    /// Criterion.
    pub criterion: String,
    /// Value of the start record: D added up over both models, others relative (both models count one half).
    pub start: Option<f64>,
    /// Value of the design.
    pub design: Option<f64>,
}

/// Predicted output of the design against its limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SafetyLine {
    /// Output.
    pub output: String,
    /// Least and largest prediction.
    pub range: (f64, f64),
    /// Demanded range.
    pub limits: (f64, f64),
    /// Twice the model's error on unseen records: what the prediction is good for.
    pub margin: f64,
    /// Least distance of the prediction to the ends of the demanded range; negative where a transient leaves it.
    pub worst_distance: f64,
    /// When, in s.
    pub worst_time_s: f64,
    /// Least and largest measured value when the design was run.
    pub measured_range: (f64, f64),
}

/// Mean R2 on the unseen records with different identification data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gain {
    /// Identification data.
    pub data: String,
    /// Torque.
    pub torque_r2: Option<f64>,
    /// Lambda.
    pub lambda_r2: Option<f64>,
}

/// What step 3 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DesignResult {
    /// How the search ended; none when no design was asked for.
    pub status: Option<Status>,
    /// Evaluations of criterion and gradient.
    pub evaluations: usize,
    /// Criteria.
    pub criteria: Vec<CriterionValue>,
    /// Safety report.
    pub safety: Vec<SafetyLine>,
    /// What it gained, beside a further record of the first recipe.
    pub gains: Vec<Gain>,
    /// Measured record of the design.
    pub records: Vec<RecordRef>,
    /// Torque models from all records including the design.
    pub torque: OutputModels,
    /// Lambda models.
    pub lambda: OutputModels,
    /// Bed time of the designed record in s.
    pub bed_s: f64,
    /// Bed time of the comparison record in s.
    pub comparison_bed_s: f64,
}

/// Designs, measures, identifies again.
///
/// # Errors
/// [`ChainError`].
pub fn design(
    ctx: &Context,
    folder: &Path,
    models: &ModelsResult,
    identification: &[Dataset],
    validation: &[Dataset],
) -> Result<DesignResult, ChainError> {
    let gain = |data: &str, t: &OutputModels, l: &OutputModels| Gain {
        data: data.into(),
        torque_r2: t.best().unseen_r2,
        lambda_r2: l.best().unseen_r2,
    };
    let before = gain("identification records", &models.torque, &models.lambda);
    if !ctx.spec.design.enabled {
        return Ok(DesignResult {
            status: None,
            evaluations: 0,
            criteria: Vec::new(),
            safety: Vec::new(),
            gains: vec![before],
            records: Vec::new(),
            torque: models.torque.clone(),
            lambda: models.lambda.clone(),
            bed_s: 0.0,
            comparison_bed_s: 0.0,
        });
    }
    let plan = planned(ctx, models, identification)?;
    (ctx.tell)(Event::Fraction(0.5));
    let (designed, rival) = rayon::join(
        || {
            through_loops(
                ctx,
                folder,
                "design01",
                &plan.feedforward,
                &plan.demand,
                gains(&ctx.spec.excite.gains)?,
            )
        },
        || extra_record(ctx, folder, "comparison01", 0),
    );
    let (designed, rival) = (designed?, rival?);
    (ctx.tell)(Event::Fraction(0.7));
    let with = |extra: &Dataset| -> Vec<Dataset> { identification.iter().chain([extra]).cloned().collect() };
    let (torque, lambda) = identify_pair(ctx, &with(&designed), validation)?;
    (ctx.tell)(Event::Fraction(0.85));
    let (torque_rival, lambda_rival) = identify_pair(ctx, &with(&rival), validation)?;
    let gains = vec![
        before,
        gain("with the designed record", &torque, &lambda),
        gain("with one more APRBS record instead", &torque_rival, &lambda_rival),
    ];
    let mut safety = plan.safety;
    for line in &mut safety {
        let measured = designed.values(&line.output)?;
        line.measured_range = range(measured);
    }
    let spec = &ctx.spec.design;
    Ok(DesignResult {
        status: Some(plan.status),
        evaluations: plan.evaluations,
        criteria: plan.criteria,
        safety,
        gains,
        records: save_records(folder, std::slice::from_ref(&designed))?,
        torque,
        lambda,
        bed_s: spec.record_s + LEAD_IN_S,
        comparison_bed_s: ctx.spec.excite.record_s + LEAD_IN_S,
    })
}

fn range(y: &[f64]) -> (f64, f64) {
    y.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)))
}

/// A designed record ready for the bed.
struct Planned {
    feedforward: Vec<[f64; 4]>,
    demand: Vec<Demand>,
    status: Status,
    evaluations: usize,
    criteria: Vec<CriterionValue>,
    safety: Vec<SafetyLine>,
}

/// One output of the design: model, error level, earlier information.
struct Known<'a> {
    model: &'a EngineModel,
    rmse: f64,
    limits: (f64, f64),
    prior: Vec<f64>,
    initial: f64,
}

fn planned(ctx: &Context, models: &ModelsResult, identification: &[Dataset]) -> Result<Planned, ChainError> {
    let (spec, dt) = (&ctx.spec.design, ctx.spec.sample_time_s);
    let n = (spec.record_s / dt).round() as usize;
    let known = [
        known(&models.torque, spec.torque_nm, identification)?,
        known(&models.lambda, spec.lambda, identification)?,
    ];
    let pairs = identification.iter().map(response_and_actuators).collect::<Result<Vec<_>, DataError>>()?;
    let rule = StartRule::fit(&pairs, ctx.map_limits())?.without_look_ahead();
    let layout = ReferenceLayout::new(spec, n, dt);
    let start = start_variables(ctx, &layout);
    let start_inputs = model_inputs(&rule, &layout.reference(&start));
    let fault = |e: &dyn std::fmt::Display| ChainError::Design(e.to_string());
    let c = criterion::criterion(&spec.criterion, &toml::Table::new())?;
    let weights = weights(n, &known, &spec.criterion, c.as_ref(), &start_inputs)?;
    let main = problem(n, &known, weights, c.as_ref(), &start_inputs);
    let evaluator = Evaluator::new(&main).map_err(|e| fault(&e))?;
    let mut objective = ReferenceObjective::new(&layout, &rule, evaluator, layout.bounds(spec));
    let outcome = search(ctx, &mut objective, &start);
    ctx.check_interrupt()?;
    let best = objective.unscaled(&outcome.x);
    let reference = layout.reference(&best);
    let inputs = model_inputs(&rule, &reference);
    let criteria = criteria(n, &known, &start_inputs, &inputs)?;
    let safety = safety_lines(&known, &inputs, n, dt);
    let demand = reference.iter().map(|r| Demand { torque_nm: r[0], lambda: r[1] }).collect();
    let feedforward = inputs.chunks_exact(5).map(|u| [u[0], u[1], u[2], u[3]]).collect();
    let evaluations = outcome.history.last().map_or(0, |h| h.evaluations);
    Ok(Planned { feedforward, demand, status: outcome.status, evaluations, criteria, safety })
}

/// Bounded quasi-Newton on the criterion's logarithm-free value: D is already one, and it is the default.
fn search(ctx: &Context, objective: &mut ReferenceObjective, start: &[f64]) -> Outcome {
    let (lower, upper) = objective.bounds.clone();
    let z: Vec<f64> =
        start.iter().zip(lower.iter().zip(&upper)).map(|(x, (a, b))| (x - a) / (b - a)).collect();
    let bounds = Bounds { lower: vec![0.0; z.len()], upper: vec![1.0; z.len()] };
    let budget = Budget {
        evaluations: ctx.spec.design.max_evaluations,
        gradient_tolerance: 1e-3,
        value_tolerance: 1e-7,
    };
    QuasiNewton::default().minimise(objective, &bounds, &z, &budget)
}

/// D and AI of the start and of the design, on top of what the earlier records tell.
fn criteria(
    n: usize,
    known: &[Known; 2],
    start: &[f64],
    design: &[f64],
) -> Result<Vec<CriterionValue>, ChainError> {
    ["d", "ai"]
        .iter()
        .map(|name| {
            let c = criterion::criterion(name, &toml::Table::new())?;
            let p = problem(n, known, weights(n, known, name, c.as_ref(), start)?, c.as_ref(), start);
            let mut evaluator = Evaluator::new(&p).map_err(|e| ChainError::Design(e.to_string()))?;
            let mut value = |u: &[f64]| Some(evaluator.value(u)).filter(|v: &f64| v.is_finite());
            Ok(CriterionValue { criterion: (*name).into(), start: value(start), design: value(design) })
        })
        .collect()
}

/// A start by the first recipe: random levels of an APRBS, speed up and down.
fn start_variables(ctx: &Context, layout: &ReferenceLayout) -> Vec<f64> {
    let (lower, upper) = layout.bounds(&ctx.spec.design);
    let mut rng = Rng64::stream(ctx.spec.seed, 250);
    let levels = ctx.spec.excite.levels.max(2);
    // Strictly inside the box: a variable that starts at a bound may see no way back.
    let level = |k: usize| 0.05 + 0.9 * k as f64 / (levels - 1) as f64;
    lower.iter().zip(&upper).map(|(a, b)| a + level(rng.below(levels)) * (b - a)).collect()
}

/// Weights that make both models count alike (in the spirit of eq. 4.54): each criterion relative to its value at the
/// start. D is a logarithm and needs none.
fn weights(
    n: usize,
    known: &[Known; 2],
    name: &str,
    c: &dyn Criterion,
    start: &[f64],
) -> Result<[f64; 2], ChainError> {
    if name == "d" {
        return Ok([1.0, 1.0]);
    }
    let value = |weights: [f64; 2]| -> Result<f64, ChainError> {
        let p = problem(n, known, weights, c, start);
        let mut evaluator = Evaluator::new(&p).map_err(|e| ChainError::Design(e.to_string()))?;
        Ok(evaluator.value(start))
    };
    let scale = |v: f64| if v.is_finite() && v != 0.0 { 0.5 / v.abs() } else { 1.0 };
    Ok([scale(value([1.0, 0.0])?), scale(value([0.0, 1.0])?)])
}

/// The same record seen by one criterion.
fn problem<'a>(
    n_samples: usize,
    known: &'a [Known<'a>; 2],
    weights: [f64; 2],
    c: &'a dyn Criterion,
    objective: &'a [f64],
) -> DesignProblem<'a> {
    let terms = known
        .iter()
        .zip(weights)
        .map(|(k, weight)| {
            // Error level in the model's own output: near lambda 1 an error of phi is one of lambda.
            let variance = k.rmse * k.rmse;
            let mut term = Term::new(&k.model.output, &k.model.structure, &k.model.theta, variance, c);
            term.initial_output = k.model.transform.apply(k.initial);
            term.prior = &k.prior;
            term.objective_signal = objective;
            term.weight = weight;
            term
        })
        .collect();
    // The references bound the inputs, so the channels themselves are free.
    let free = |name: &str| Channel::free(name, -1e9, 1e9);
    let channels = ["inj", "spark", "throttle", "speed", "cycle"].map(free).to_vec();
    DesignProblem { channels, n_samples, convention: Convention::Trim, start: 0, terms }
}

fn known<'a>(
    models: &'a OutputModels,
    limits: (f64, f64),
    identification: &[Dataset],
) -> Result<Known<'a>, ChainError> {
    let best = models.best();
    let unseen: Vec<f64> = best
        .scores
        .iter()
        .filter(|s| s.data == dynocal_ident::validate::Seen::Unseen)
        .filter_map(|s| s.rmse)
        .collect();
    let rmse = unseen.iter().fold(0.0f64, |m, v| m.max(*v)).max(1e-6);
    let initial = 0.5 * (limits.0 + limits.1);
    Ok(Known { model: &best.model, rmse, limits, prior: prior(&best.model, identification)?, initial })
}

/// Triangular factor of the free-run sensitivities of earlier records: what they tell already.
fn prior(model: &EngineModel, records: &[Dataset]) -> Result<Vec<f64>, ChainError> {
    let p = model.structure.n_params();
    let mut all = Vec::new();
    for record in records {
        let u = model.input_rows(record)?;
        let y: Vec<f64> = record.values(&model.output)?.iter().map(|v| model.transform.apply(*v)).collect();
        let n = y.len();
        let (mut out, mut s) = (vec![0.0; n], vec![0.0; n * p]);
        let start = model.structure.max_lag();
        model.structure.sensitivities(&model.theta, &Run { u: &u, y: &y, start }, &mut out, &mut s);
        all.extend_from_slice(&s[start * p..]);
    }
    let rows = all.len() / p;
    let mut r = vec![0.0; p * p];
    QrWork::new(rows, p).r_factor(&all, &mut r).map_err(|e| ChainError::Design(e.to_string()))?;
    Ok(r)
}

/// Free run of the models over the design: how far outputs are predicted to leave the demanded range in transients.
fn safety_lines(known: &[Known; 2], inputs: &[f64], n: usize, dt: f64) -> Vec<SafetyLine> {
    known
        .iter()
        .map(|k| {
            let y0 = vec![k.model.transform.apply(k.initial); n];
            let mut y = vec![0.0; n];
            // The record starts from rest, so the first two seconds only bring the model there.
            let skip = ((2.0 / dt) as usize).min(n - 1);
            let run = Run { u: inputs, y: &y0, start: k.model.structure.max_lag() };
            k.model.structure.simulate(&k.model.theta, &run, &mut y);
            let predicted: Vec<f64> = y.iter().map(|v| k.model.transform.apply(*v)).collect();
            let beyond = |v: f64| (k.limits.0 - v).max(v - k.limits.1);
            let worst = (skip..n).max_by(|a, b| beyond(predicted[*a]).total_cmp(&beyond(predicted[*b])));
            SafetyLine {
                output: k.model.output.clone(),
                range: range(&predicted[skip..]),
                limits: k.limits,
                margin: 2.0 * k.rmse,
                worst_distance: worst.map_or(0.0, |t| -beyond(predicted[t])),
                worst_time_s: worst.map_or(0.0, |t| t as f64 * dt),
                measured_range: (0.0, 0.0),
            }
        })
        .collect()
}
