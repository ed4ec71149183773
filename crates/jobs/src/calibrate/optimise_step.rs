//! Step 4: optimise fuel over a record made for it, measure the promise on the plant, re-identify, repeat.

use super::context::{ChainError, Context, Event, RecordRef, save_records};
use super::excite_step::{LEAD_IN_S, through_loops};
use super::models::{OutputModels, estimate_again};
use dynocal_calib::control::LoopGains;
use dynocal_calib::engine_model::{EngineModel, cycle_s};
use dynocal_calib::excite::{aprbs, speed_sweep};
use dynocal_calib::fuel::{self, FuelOutcome};
use dynocal_calib::map::start::{StartRule, rate_limited};
use dynocal_calib::map::{Actuators, FirstOrder, REFERENCE_FILTER_S, Reference, filter_torque};
use dynocal_calib::record::{Demand, INPUTS, fuel_kg_h};
use dynocal_ident::data::{Channel, DataError, Dataset, Role};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// One pass: the promise and the measurement, and the models that were identified with it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Pass {
    /// Number from 1.
    pub pass: usize,
    /// How the optimisation ended.
    pub status: Status,
    /// Iterations.
    pub iterations: usize,
    /// Model fuel of the start in kg/h.
    pub start_fuel_kg_h: f64,
    /// Model fuel of the optimum in kg/h.
    pub promised_fuel_kg_h: f64,
    /// Promised ratio.
    pub promised_ratio: f64,
    /// Largest violation of the torque demand by the free run of the model, in Nm.
    pub torque_violation_nm: f64,
    /// Largest violation of the lambda demand.
    pub lambda_violation: f64,
    /// Fuel of the start, measured with the loops holding the demand, in kg/h.
    pub measured_start_fuel_kg_h: f64,
    /// Fuel of the optimum, measured the same way, in kg/h.
    pub measured_fuel_kg_h: f64,
    /// Measured ratio.
    pub measured_ratio: f64,
    /// Ratio of fuel per torque work, optimum over start (biased by friction where torque differs).
    pub fuel_per_work_ratio: f64,
    /// Root mean square torque error of the measured optimum against the demand, in Nm.
    pub torque_rms_nm: f64,
    /// Root mean square lambda error of the measured optimum.
    pub lambda_rms: f64,
    /// First decided sample.
    pub first: usize,
    /// Measured records: start, optimum.
    pub records: Vec<RecordRef>,
    /// Models identified from all records so far, this pass included.
    pub torque: OutputModels,
    /// The same for lambda.
    pub lambda: OutputModels,
}

/// What step 4 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct OptimiseResult {
    /// Passes in order.
    pub passes: Vec<Pass>,
    /// Bed time in s.
    pub bed_s: f64,
}

/// Runs all passes.
///
/// # Errors
/// [`ChainError`].
pub fn optimise(
    ctx: &Context,
    folder: &Path,
    models: (&OutputModels, &OutputModels),
    identification: &[Dataset],
    validation: &[Dataset],
) -> Result<OptimiseResult, ChainError> {
    let spec = &ctx.spec.optimise;
    let mut models = (models.0.clone(), models.1.clone());
    let mut data = identification.to_vec();
    let mut passes = Vec::new();
    for k in 1..=spec.passes {
        let pass = one_pass(ctx, folder, k, (&models.0, &models.1), &mut data, validation)?;
        models = (pass.torque.clone(), pass.lambda.clone());
        (ctx.tell)(Event::Fraction(k as f64 / spec.passes as f64));
        passes.push(pass);
    }
    let bed_s = 2.0 * spec.passes as f64 * (spec.record_s + LEAD_IN_S);
    Ok(OptimiseResult { passes, bed_s })
}

fn one_pass(
    ctx: &Context,
    folder: &Path,
    k: usize,
    models: (&OutputModels, &OutputModels),
    data: &mut Vec<Dataset>,
    validation: &[Dataset],
) -> Result<Pass, ChainError> {
    ctx.check_interrupt()?;
    let (torque, lambda) = (&models.0.best().model, &models.1.best().model);
    let start = start_record(ctx, k, torque, lambda, data)?;
    let outcome =
        fuel::minimise_fuel(&ctx.spec.optimise.program, torque, lambda, &start, &|| (ctx.interrupt)())?;
    ctx.check_interrupt()?;
    let start_inputs = start.matrix(&INPUTS[..3].iter().map(|s| (*s).to_string()).collect::<Vec<_>>())?;
    let speed = start.values("speed")?;
    let (start_run, optimum_run) = rayon::join(
        || held(ctx, folder, &format!("pass{k}_start"), &start_inputs, speed, &outcome),
        || held(ctx, folder, &format!("pass{k}_optimum"), &outcome.inputs, speed, &outcome),
    );
    let (start_run, optimum_run) = (start_run?, optimum_run?);
    let records = save_records(folder, &[start_run.clone(), optimum_run.clone()])?;
    let first = outcome.first;
    let error = errors(&optimum_run, &outcome)?;
    let start_fuel_kg_h = mean_fuel_of(&start_inputs, 3, speed, first);
    let promised_fuel_kg_h = mean_fuel_of(&outcome.inputs, 3, speed, first);
    let measured_start_fuel_kg_h = mean_fuel(&start_run, first)?;
    let measured_fuel_kg_h = mean_fuel(&optimum_run, first)?;
    let fuel_per_work_ratio = fuel_per_work(&optimum_run, first)? / fuel_per_work(&start_run, first)?;
    data.extend([start_run, optimum_run]);
    let (torque_models, lambda_models) = estimate_again(ctx, models, data, validation)?;
    Ok(Pass {
        pass: k,
        status: outcome.status,
        iterations: outcome.iterations,
        start_fuel_kg_h,
        promised_fuel_kg_h,
        promised_ratio: promised_fuel_kg_h / start_fuel_kg_h,
        torque_violation_nm: outcome.torque_violation_nm,
        lambda_violation: outcome.lambda_violation,
        measured_start_fuel_kg_h,
        measured_fuel_kg_h,
        measured_ratio: measured_fuel_kg_h / measured_start_fuel_kg_h,
        fuel_per_work_ratio,
        torque_rms_nm: error.0,
        lambda_rms: error.1,
        first,
        records,
        torque: torque_models,
        lambda: lambda_models,
    })
}

/// A reference that the engine can follow: filtered torque levels, lambda near 1, spark at random.
struct Wish {
    reference: Vec<Reference>,
    spark_deg: Vec<f64>,
}

fn wish(ctx: &Context, k: usize) -> Result<Wish, ChainError> {
    let (spec, dt) = (&ctx.spec.optimise, ctx.spec.sample_time_s);
    let n = (spec.record_s / dt).round() as usize;
    let mut rng = Rng64::stream(ctx.spec.seed, 300 + k as u64);
    let mut level = |range, levels, hold_s| aprbs(range, levels, hold_s, 0.0, n, dt, &mut rng);
    let torque = filter_torque(&level(spec.torque_nm, 9, spec.hold_s)?, dt);
    let mut lag = FirstOrder::new(1.0);
    let lambda: Vec<f64> = level(spec.lambda, 5, 2.3 * spec.hold_s)?
        .iter()
        .map(|l| lag.step(*l, dt, REFERENCE_FILTER_S[1]))
        .collect();
    let spark = level(ctx.spec.excite.spark_deg, 5, 3.0)?;
    let e = &ctx.spec.excite;
    let speed = speed_sweep(e, e.sweep_s + 1.3 * k as f64, n, dt)?;
    let reference =
        (0..n).map(|t| Reference { torque_nm: torque[t], lambda: lambda[t], speed_rpm: speed[t] }).collect();
    Ok(Wish { reference, spark_deg: rate_limited(&spark, spec.start_spark_rate_deg) })
}

/// Samples at the end of a record that count for nothing: what is injected there acts after the end, so that the
/// optimum leaves it out.
pub const END_EFFECT: usize = 12;

/// Samples at the head of the start record in which everything is held: the models' histories are then at rest.
const HELD_HEAD: usize = 12;

fn start_record(
    ctx: &Context,
    k: usize,
    torque: &EngineModel,
    lambda: &EngineModel,
    data: &[Dataset],
) -> Result<Dataset, ChainError> {
    let mut wish = wish(ctx, k)?;
    let (r0, s0) = (wish.reference[0], wish.spark_deg[0]);
    wish.reference[..HELD_HEAD].fill(r0);
    wish.spark_deg[..HELD_HEAD].fill(s0);
    wish.spark_deg = rate_limited(&wish.spark_deg, ctx.spec.optimise.start_spark_rate_deg);
    let pairs = data.iter().map(response_and_actuators).collect::<Result<Vec<_>, _>>()?;
    let rule = StartRule::fit(&pairs, ctx.map_limits())?;
    let mut inputs = rule.drive(&wish.reference, &wish.spark_deg);
    let u0 = inputs[0];
    inputs[..HELD_HEAD].fill(u0);
    let n = inputs.len();
    let column = |c: usize| inputs.iter().map(|u| u[c]).collect::<Vec<f64>>();
    let speed: Vec<f64> = wish.reference.iter().map(|r| r.speed_rpm).collect();
    let at_rest = |m: &EngineModel, guess: f64| vec![steady_output(m, u0, speed[0], guess); n];
    let channel = |name: &str, unit: &str, role: Role, values: Vec<f64>| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values,
    };
    Ok(Dataset {
        name: format!("pass{k}_start"),
        sample_time_s: ctx.spec.sample_time_s,
        channels: vec![
            channel("inj", "mg", Role::Input, column(0)),
            channel("spark", "deg", Role::Input, column(1)),
            channel("throttle", "deg", Role::Input, column(2)),
            channel("torque", "Nm", Role::Output, at_rest(torque, r0.torque_nm)),
            channel("lambda", "-", Role::Output, at_rest(lambda, r0.lambda)),
            channel("speed", "rpm", Role::Input, speed),
        ],
        init_samples: 0,
        origin: "start rule".into(),
    })
}

/// Where a model comes to rest under held inputs, in the user's unit; `guess` when it does not.
fn steady_output(model: &EngineModel, u: Actuators, speed_rpm: f64, guess: f64) -> f64 {
    let n = 400;
    let row: Vec<f64> = model
        .structure
        .inputs()
        .iter()
        .map(|name| match name.as_str() {
            "inj" => u[0],
            "spark" => u[1],
            "throttle" => u[2],
            "speed" => speed_rpm,
            _ => cycle_s(speed_rpm),
        })
        .collect();
    let inputs = row.repeat(n);
    let y0 = vec![model.transform.apply(guess); n];
    let mut y = vec![0.0; n];
    let run = Run { u: &inputs, y: &y0, start: model.structure.max_lag() };
    model.structure.simulate(&model.theta, &run, &mut y);
    if y[n - 1].is_finite() { model.transform.apply(y[n - 1]) } else { guess }
}

/// Measured response and applied actuators of a record.
///
/// # Errors
/// [`DataError`].
pub fn response_and_actuators(record: &Dataset) -> Result<(Vec<Reference>, Vec<Actuators>), DataError> {
    let get = |name: &str| record.values(name);
    let (t, l, s) = (get("torque")?, get("lambda")?, get("speed")?);
    let (i, a, h) = (get("inj")?, get("spark")?, get("throttle")?);
    Ok((0..record.len())
        .map(|k| (Reference { torque_nm: t[k], lambda: l[k], speed_rpm: s[k] }, [i[k], a[k], h[k]]))
        .unzip())
}

/// Runs actuators as feedforward with the small loops holding the promised torque and lambda.
fn held(
    ctx: &Context,
    folder: &Path,
    name: &str,
    inputs: &[f64],
    speed: &[f64],
    outcome: &FuelOutcome,
) -> Result<Dataset, ChainError> {
    let feedforward: Vec<[f64; 4]> =
        inputs.chunks_exact(3).zip(speed).map(|(u, s)| [u[0], u[1], u[2], *s]).collect();
    let demand = demands(outcome);
    hold(ctx, folder, name, &feedforward, &demand)
}

/// Torque and lambda demand of an outcome, sample by sample.
pub fn demands(outcome: &FuelOutcome) -> Vec<Demand> {
    outcome
        .torque_demand_nm
        .iter()
        .zip(&outcome.lambda_demand)
        .map(|(t, l)| Demand { torque_nm: *t, lambda: *l })
        .collect()
}

/// Runs a feedforward with the trim loops holding `demand`.
///
/// # Errors
/// [`ChainError`].
pub fn hold(
    ctx: &Context,
    folder: &Path,
    name: &str,
    feedforward: &[[f64; 4]],
    demand: &[Demand],
) -> Result<Dataset, ChainError> {
    through_loops(ctx, folder, name, feedforward, demand, LoopGains::TRIM)
}

/// Mean fuel in kg/h from sample `first` to the end effect.
///
/// # Errors
/// [`DataError`].
pub fn mean_fuel(run: &Dataset, first: usize) -> Result<f64, DataError> {
    Ok(mean_fuel_of(run.values("inj")?, 1, run.values("speed")?, first))
}

/// The same for every `stride`-th entry of `inj_mg`.
fn mean_fuel_of(inj_mg: &[f64], stride: usize, speed_rpm: &[f64], first: usize) -> f64 {
    let range = first..speed_rpm.len().saturating_sub(END_EFFECT);
    let n = range.len() as f64;
    range.map(|t| fuel_kg_h(inj_mg[t * stride], speed_rpm[t])).sum::<f64>() / n
}

fn fuel_per_work(run: &Dataset, first: usize) -> Result<f64, DataError> {
    let (torque, speed) = (run.values("torque")?, run.values("speed")?);
    let work: f64 = (first..torque.len().saturating_sub(END_EFFECT)).map(|t| torque[t] * speed[t]).sum();
    Ok(mean_fuel(run, first)? / work)
}

fn errors(run: &Dataset, outcome: &FuelOutcome) -> Result<(f64, f64), DataError> {
    let rms = |y: &[f64], d: &[f64]| {
        let e = y.iter().zip(d).skip(outcome.first).map(|(a, b)| (a - b).powi(2));
        (e.sum::<f64>() / (y.len() - outcome.first) as f64).sqrt()
    };
    Ok((
        rms(run.values("torque")?, &outcome.torque_demand_nm),
        rms(run.values("lambda")?, &outcome.lambda_demand),
    ))
}
