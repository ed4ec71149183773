//! Step 3: an optimal test signal for the identified models, run on the plant, and what it gained.
//!
//! The record is designed in the inputs with limits on the predicted torque and lambda (an open-loop design lets
//! lambda run wild), and is run with the small loops holding the prediction.

use super::context::{ChainError, Context, Event, RecordRef, save_records};
use super::excite_step::{LEAD_IN_S, extra_record};
use super::models::{OutputModels, identify_pair};
use super::optimise_step::{hold, response_and_actuators};
use super::run::ModelsResult;
use crate::engine_model::{CYCLE, EngineModel, cycle_s};
use crate::excite::references;
use crate::map::start::StartRule;
use crate::map::{Reference, filter_torque};
use crate::record::Demand;
use dynocal_design::channel::{Channel, Shape};
use dynocal_design::criterion::{self, Criterion};
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, OutputLimits, Term};
use dynocal_design::search::{DesignOptions, DesignOutcome, design as search};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::linalg::QrWork;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A criterion before and after the search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CriterionValue {
    /// Criterion.
    pub criterion: String,
    /// Value of the start record (torque and lambda model added up).
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
    /// Limits.
    pub limits: (f64, f64),
    /// Margin kept, from the error on unseen records.
    pub margin: f64,
    /// Worst distance to a limit beyond the margin.
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
        || hold(ctx, folder, "design01", &plan.feedforward, &plan.demand),
        || extra_record(ctx, folder, "comparison01", 0),
    );
    let (designed, rival) = (designed?, rival?);
    (ctx.tell)(Event::Fraction(0.7));
    let with = |extra: &Dataset| -> Vec<Dataset> {
        identification.iter().chain([extra]).cloned().collect()
    };
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
        status: Some(plan.outcome.status),
        evaluations: plan.outcome.evaluations,
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
    outcome: DesignOutcome,
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
    let spec = &ctx.spec.design;
    let start = start_inputs(ctx, identification)?;
    let n = start.len();
    let first = reference_start(ctx);
    let known = [
        known(&models.torque, spec.torque_nm, identification, first.torque_nm)?,
        known(&models.lambda, spec.lambda, identification, first.lambda)?,
    ];
    let build = |e: &dyn std::fmt::Display| ChainError::Design(e.to_string());
    let d = criterion::criterion(&spec.criterion, &toml::Table::new())?;
    let channels = channels(ctx, &start);
    let objective: Vec<f64> = rows(&start);
    let main = problem(&channels, n, &known, d.as_ref(), &objective);
    let options = DesignOptions {
        search: "local".into(),
        evaluations: spec.max_evaluations,
        starts: 1,
        seed: ctx.spec.seed,
        start: Some(objective.clone()),
        output_tolerance: 0.01,
        ..DesignOptions::default()
    };
    let outcome = search(&main, &options, ctx.interrupt, &|_| ()).map_err(|e| build(&e))?;
    ctx.check_interrupt()?;
    let mut criteria = Vec::new();
    for name in ["d", "ai"] {
        let c = criterion::criterion(name, &toml::Table::new())?;
        let p = problem(&channels, n, &known, c.as_ref(), &objective);
        let mut evaluator = Evaluator::new(&p).map_err(|e| build(&e))?;
        let mut value = |u: &[f64]| Some(evaluator.value(u)).filter(|v: &f64| v.is_finite());
        criteria.push(CriterionValue {
            criterion: name.into(),
            start: value(&objective),
            design: value(&outcome.u),
        });
    }
    let dt = ctx.spec.sample_time_s;
    let safety = safety_lines(&known, &outcome, dt);
    let m = channels.len();
    let feedforward =
        (0..n).map(|t| std::array::from_fn(|c| outcome.u[t * m + c])).collect::<Vec<[f64; 4]>>();
    let predicted = |k: usize| -> Vec<f64> {
        outcome.safety[k].predicted.iter().map(|v| known[k].model.transform.apply(*v)).collect()
    };
    let (torque, lambda) = (predicted(0), predicted(1));
    let demand = torque.iter().zip(&lambda).map(|(t, l)| Demand { torque_nm: *t, lambda: *l }).collect();
    Ok(Planned { feedforward, demand, outcome, criteria, safety })
}

/// The same record seen by one criterion.
fn problem<'a>(
    channels: &[Channel],
    n_samples: usize,
    known: &'a [Known<'a>; 2],
    c: &'a dyn Criterion,
    objective: &'a [f64],
) -> DesignProblem<'a> {
    let terms = known
        .iter()
        .map(|k| {
            let apply = |v: f64| k.model.transform.apply(v);
            let (a, b) = (apply(k.limits.0), apply(k.limits.1));
            // Error level in the model's own output: near lambda 1 an error of phi is one of lambda.
            let variance = k.rmse * k.rmse;
            let mut term = Term::new(&k.model.output, &k.model.structure, &k.model.theta, variance, c);
            term.initial_output = apply(k.initial);
            term.prior = &k.prior;
            term.objective_signal = objective;
            term.limits = Some(OutputLimits { lower: a.min(b), upper: a.max(b), margin: margin(k) });
            term
        })
        .collect();
    DesignProblem { channels: channels.to_vec(), n_samples, convention: Convention::Trim, start: 0, terms }
}

/// Distance kept to the limits: twice the error on unseen records, because model error dominates.
fn margin(k: &Known) -> f64 {
    (2.0 * k.rmse).min(0.2 * (k.limits.1 - k.limits.0))
}

fn known<'a>(
    models: &'a OutputModels,
    limits: (f64, f64),
    identification: &[Dataset],
    initial: f64,
) -> Result<Known<'a>, ChainError> {
    let best = models.best();
    let unseen: Vec<f64> = best
        .scores
        .iter()
        .filter(|s| s.data == dynocal_ident::validate::Seen::Unseen)
        .filter_map(|s| s.rmse)
        .collect();
    let rmse = unseen.iter().fold(0.0f64, |m, v| m.max(*v)).max(1e-6);
    Ok(Known { model: &best.model, rmse, limits, prior: prior(&best.model, identification)?, initial })
}

/// Triangular factor of the free-run sensitivities of earlier records: what they tell already.
fn prior(model: &EngineModel, records: &[Dataset]) -> Result<Vec<f64>, ChainError> {
    let p = model.structure.n_params();
    let mut all = Vec::new();
    for record in records {
        let u = model.input_rows(record)?;
        let y: Vec<f64> =
            record.values(&model.output)?.iter().map(|v| model.transform.apply(*v)).collect();
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

fn reference_start(ctx: &Context) -> Reference {
    let d = &ctx.spec.design;
    let speed = ctx.spec.excite.speed_rpm.0;
    Reference { torque_nm: 0.5 * (d.torque_nm.0 + d.torque_nm.1), lambda: 1.0, speed_rpm: speed }
}

/// A feasible start: the start rule along an excitation-like reference, one row (INJ, spark, throttle, speed) a sample.
fn start_inputs(ctx: &Context, identification: &[Dataset]) -> Result<Vec<[f64; 4]>, ChainError> {
    let (d, dt) = (&ctx.spec.design, ctx.spec.sample_time_s);
    let mut e = ctx.spec.excite.clone();
    e.record_s = d.record_s;
    let shrink = |(a, b): (f64, f64), by: f64| (a + by * (b - a), b - by * (b - a));
    e.torque_nm = shrink(d.torque_nm, 0.12);
    e.lambda = shrink(d.lambda, 0.3);
    e.spark_deg = shrink(d.spark_deg, 0.02);
    let mut rng = Rng64::stream(ctx.spec.seed, 250);
    let r = references(&e, e.sweep_s + 0.7, dt, &mut rng)?;
    let torque = filter_torque(&r.demand.iter().map(|d| d.torque_nm).collect::<Vec<_>>(), dt);
    let reference: Vec<Reference> = (0..torque.len())
        .map(|t| Reference { torque_nm: torque[t], lambda: r.demand[t].lambda, speed_rpm: r.speed_rpm[t] })
        .collect();
    let pairs = identification.iter().map(response_and_actuators).collect::<Result<Vec<_>, DataError>>()?;
    let rule = StartRule::fit(&pairs, ctx.map_limits())?;
    let u = rule.drive(&reference, &r.spark_deg);
    Ok(u.iter().zip(&r.speed_rpm).map(|(u, s)| [u[0], u[1], u[2], *s]).collect())
}

/// Model inputs of a record of actuators: the four actuators and the derived cycle duration.
fn rows(u: &[[f64; 4]]) -> Vec<f64> {
    u.iter().flat_map(|u| [u[0], u[1], u[2], u[3], cycle_s(u[3])]).collect()
}

fn channels(ctx: &Context, start: &[[f64; 4]]) -> Vec<Channel> {
    let spec = &ctx.spec.design;
    let hold = (spec.hold_s / ctx.spec.sample_time_s).round().max(1.0) as usize;
    let bounds = [("inj", spec.inj_mg), ("spark", spec.spark_deg), ("throttle", spec.throttle_deg)];
    let mut channels: Vec<Channel> = bounds
        .iter()
        .zip(spec.rate)
        .map(|((name, (lower, upper)), rate)| Channel {
            hold,
            // Ramps between the free values: a bed's actuators do not jump, and torque and lambda stay together.
            shape: Shape::Linear,
            rate_per_sample: Some(rate / hold as f64),
            ..Channel::free(name, *lower, *upper)
        })
        .collect();
    channels.push(Channel::given("speed", start.iter().map(|u| u[3]).collect()));
    channels.push(Channel::given(CYCLE, start.iter().map(|u| cycle_s(u[3])).collect()));
    channels
}

fn safety_lines(known: &[Known; 2], outcome: &DesignOutcome, dt: f64) -> Vec<SafetyLine> {
    known
        .iter()
        .zip(&outcome.safety)
        .map(|(k, s)| {
            let apply = |v: f64| k.model.transform.apply(v);
            let (a, b) = (apply(s.range.0), apply(s.range.1));
            let worst = s.worst.as_ref();
            SafetyLine {
                output: k.model.output.clone(),
                range: (a.min(b), a.max(b)),
                limits: k.limits,
                margin: margin(k),
                worst_distance: worst.map_or(f64::MAX, |w| w.distance),
                worst_time_s: worst.map_or(0.0, |w| w.sample as f64 * dt),
                measured_range: (0.0, 0.0),
            }
        })
        .collect()
}
