//! Step 4: optimise over a record made for it, measure the promise on the plant, identify again, repeat.

use super::context::{ChainError, Context, RecordRef, Tone, all_measured, save_records};
use super::models::{ModelData, ModelsResult, identify_again};
use super::signals::{aprbs, sweep};
use super::start_maps::start_maps;
use dynocal_calib::map::filter::filtered;
use dynocal_calib::map::start::{StartRule, rate_limited};
use dynocal_calib::map::structured::StructuredShape;
use dynocal_calib::map::{Port, Rows};
use dynocal_calib::optimise::{OptimiseOptions, Optimum, optimise_record};
use dynocal_calib::problem::{CalibrationProblem, Metered, meter_name};
use dynocal_calib::validate::{inner, objective};
use dynocal_ident::data::{Channel, Dataset, Role, UnitAfter};
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use dynocal_report::with_unit;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// By how much a demand was missed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Miss {
    /// Output.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Largest violation of the demand, or of the limits, by the free run of the model.
    pub violation: f64,
    /// Root mean square of (measured - demanded) of the measured optimum; none for an output without a demand.
    pub measured_rms: Option<f64>,
    /// Mean of (measured - demanded).
    pub measured_mean: Option<f64>,
}

/// One pass: the promise and the measurement, and the models that were identified with it.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pass {
    /// Number from 1.
    pub pass: usize,
    /// How the optimisation ended.
    pub status: Status,
    /// Iterations.
    pub iterations: usize,
    /// Mean objective of the start, by the start inputs.
    pub start: f64,
    /// Mean objective of the optimum, by its inputs and the models.
    pub promised: f64,
    /// Promised ratio.
    pub promised_ratio: f64,
    /// Mean objective of the start, measured with the loops holding the demand.
    pub measured_start: f64,
    /// Mean objective of the optimum, measured the same way.
    pub measured: f64,
    /// Measured ratio.
    pub measured_ratio: f64,
    /// What meters said of derived channels; of those that are not here the objective follows from the recorded inputs.
    pub meters: Vec<Metered>,
    /// By output.
    pub misses: Vec<Miss>,
    /// First decided sample.
    pub first: usize,
    /// Demands, one column each.
    pub demands: Vec<Vec<f64>>,
    /// Measured records: start, optimum.
    pub records: Vec<RecordRef>,
    /// Whether the optimum may be used for the map and the next models.
    pub usable: bool,
    /// Why not, in a sentence; empty when it is.
    pub reason: String,
    /// Models identified from all usable records so far.
    pub models: ModelsResult,
}

/// What step 4 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimiseResult {
    /// Passes in order.
    pub passes: Vec<Pass>,
    /// Bed time in s.
    pub bed_s: f64,
}

/// Largest violation of a demand at which an optimum counts as feasible, as a share of its range.
pub const VIOLATION: f64 = 1e-6;

/// Runs all passes.
///
/// # Errors
/// [`ChainError`].
pub fn optimise(
    ctx: &Context,
    folder: &Path,
    models: &ModelsResult,
    identification: &[(Dataset, PathBuf)],
    validation: &[Dataset],
) -> Result<OptimiseResult, ChainError> {
    let spec = &ctx.spec.optimise;
    let mut models = models.clone();
    let mut data = identification.to_vec();
    let mut passes = Vec::new();
    for k in 1..=spec.passes {
        let pass = one_pass(ctx, folder, k, &models, &mut data, validation)?;
        models = pass.models.clone();
        ctx.fraction(k as f64 / spec.passes as f64);
        passes.push(pass);
    }
    let bed_s = 2.0 * spec.passes as f64 * (spec.record_s + ctx.spec.excite.lead_in_s);
    Ok(OptimiseResult { passes, bed_s })
}

fn one_pass(
    ctx: &Context,
    folder: &Path,
    k: usize,
    models: &ModelsResult,
    data: &mut Vec<(Dataset, PathBuf)>,
    validation: &[Dataset],
) -> Result<Pass, ChainError> {
    ctx.check_interrupt()?;
    let chosen = models.chosen();
    let start = start_record(ctx, k, &chosen, data)?;
    let options = OptimiseOptions {
        max_iterations: ctx.spec.optimise.max_iterations,
        tolerance: ctx.spec.optimise.tolerance,
        smoothing: ctx.spec.optimise.smoothing,
        // What an optimum does because nobody looks beyond its end it does out of sight.
        extend_s: END_EFFECT as f64 * ctx.spec.sample_time_s,
        ..OptimiseOptions::default()
    };
    let optimum = optimise_record(&ctx.spec.problem, &chosen, &start, &options, &|| ctx.watch.interrupted())?;
    ctx.check_interrupt()?;
    let start_inputs = columns(&start, &ctx.channels.inputs)?;
    let given = columns(&start, &ctx.channels.given)?;
    let values = |channels: &[Channel]| channels.iter().map(|c| c.values.clone()).collect::<Vec<_>>();
    let (demands, optimal) = (values(&optimum.demands), values(&optimum.inputs));
    let hold = |name: String, inputs: Vec<Vec<f64>>| {
        let plan = ctx.plan(&name, inputs, given.clone(), demands.clone(), Tone::Trim);
        ctx.measure_with(folder, &plan, true, &chosen)
    };
    let (start_run, optimum_run) = rayon::join(
        || hold(format!("pass{k}_start"), start_inputs.clone()),
        || hold(format!("pass{k}_optimum"), optimal.clone()),
    );
    let runs = all_measured(vec![start_run, optimum_run])?;
    let records = save_records(folder, &runs)?;
    let [start_run, optimum_run] =
        <[Dataset; 2]>::try_from(runs).map_err(|_| ChainError::Design("a pass has two records".into()))?;
    same_meters(ctx, &start_run, &optimum_run)?;
    let first = optimum.first;
    let (measured_start, measured) =
        (mean_objective(ctx, &start_run, first)?, mean_objective(ctx, &optimum_run, first)?);
    let mut pass = Pass {
        pass: k,
        status: optimum.status,
        iterations: optimum.iterations,
        start: optimum.start_objective,
        promised: optimum.objective,
        promised_ratio: optimum.objective / optimum.start_objective,
        measured_start,
        measured,
        measured_ratio: measured / measured_start,
        meters: ctx.spec.problem.meters(&optimum_run)?,
        misses: misses(ctx, &optimum, &optimum_run)?,
        first,
        demands: demands.clone(),
        records,
        usable: true,
        reason: String::new(),
        models: models.clone(),
    };
    pass.judge(ctx);
    // What the plant answered to the start is a record like any other; a bad optimum must not teach the next model.
    data.push((start_run, folder.join(&pass.records[0].file)));
    if pass.usable {
        data.push((optimum_run, folder.join(&pass.records[1].file)));
    }
    let place = folder.join(format!("pass{k}"));
    std::fs::create_dir_all(&place)
        .map_err(|e| ChainError::Identify { what: place.display().to_string(), reason: e.to_string() })?;
    pass.models = identify_again(ctx, &place, models, &ModelData { identification: data, validation })?;
    Ok(pass)
}

/// Start and optimum are compared: what one of them metered the other has to have metered, too.
fn same_meters(ctx: &Context, start: &Dataset, optimum: &Dataset) -> Result<(), ChainError> {
    let has = |d: &Dataset, m: &Port| d.channel(&meter_name(&m.name)).is_ok();
    for m in &ctx.channels.meters {
        let (lacking, other) = match (has(start, m), has(optimum, m)) {
            (false, true) => (start, optimum),
            (true, false) => (optimum, start),
            _ => continue,
        };
        let fault = format!(
            "no channel `{}`, which `{}` has: they are compared, so that both need it or none",
            m.name, other.name
        );
        let (measured, plan) = (lacking.origin.clone(), lacking.name.clone());
        return Err(ChainError::Record { measured, plan, faults: vec![fault] });
    }
    Ok(())
}

impl Pass {
    /// Derived channels of the objective that no meter gave: they follow from the recorded inputs.
    pub fn unmetered(&self, problem: &CalibrationProblem) -> Vec<String> {
        let metered = |name: &String| self.meters.iter().any(|m| m.channel == *name);
        problem.meterable().into_iter().map(|d| d.name.clone()).filter(|name| !metered(name)).collect()
    }

    /// Decides whether the optimum may be used: the search ended well, demands are met on the models, something promised to
    /// save saved, and what was measured is near what was demanded.
    fn judge(&mut self, ctx: &Context) {
        let range = |output: &str| {
            let d = ctx.spec.problem.demands.iter().find(|d| d.output == output);
            d.map_or(1.0, |d| d.upper - d.lower)
        };
        let missed =
            self.misses.iter().find(|m| m.violation.is_nan() || m.violation > VIOLATION * range(&m.output));
        let lead = ctx.channels.demands.first();
        let most_rms = |m: &Miss| range(&m.output) * if Some(&m.output) == lead { FAR_LEAD } else { FAR };
        let beyond = |v: Option<f64>, most: f64| v.is_some_and(|v| v.is_nan() || v.abs() > most);
        let is_far = |m: &&Miss| {
            beyond(m.measured_rms, most_rms(m)) || beyond(m.measured_mean, OFFSET * range(&m.output))
        };
        let far = self.misses.iter().find(is_far);
        self.reason = if let Some(m) = missed {
            format!(
                "its {} misses the demand by {:.2e}{} on the models",
                m.output,
                m.violation,
                UnitAfter(&m.unit)
            )
        } else if !(self.measured_ratio.is_finite() && self.promised_ratio.is_finite()) {
            "what it costs is not a finite number".into()
        } else if self.promised_ratio < 1.0 && self.measured_ratio >= 1.0 {
            format!(
                "it promised to save {:.1} % and measured {:+.1} %",
                100.0 * (1.0 - self.promised_ratio),
                100.0 * (self.measured_ratio - 1.0)
            )
        } else if let Some(m) = far {
            let (rms, mean) = (m.measured_rms.unwrap_or(f64::NAN), m.measured_mean.unwrap_or(f64::NAN));
            format!(
                "its measured {} is {} (RMS) from the demand, {mean:+.3} in the mean",
                m.output,
                with_unit(rms, 3, &m.unit)
            )
        } else {
            String::new()
        };
        self.usable = self.reason.is_empty();
    }
}

/// RMS of the measured leading demand from which on a pass must not be used, as a share of the demand's range.
const FAR_LEAD: f64 = 0.08;
/// The same of further demands, whose range is narrow beside what transients do.
const FAR: f64 = 0.3;
/// Mean distance of a measured demand from which on a pass must not be used, as a share of its range.
const OFFSET: f64 = 0.03;

/// Samples at the end of a record that count for nothing: what is applied there acts after the end, so that the optimum
/// leaves it out.
pub const END_EFFECT: usize = 12;

/// Samples at the head of the start record in which everything is held: the models' histories are then at rest.
const HELD_HEAD: usize = 12;

/// Share of a rate limit that the start uses, so that it is inside.
const START_RATE: f64 = 0.8;

fn columns(record: &Dataset, names: &[String]) -> Result<Vec<Vec<f64>>, ChainError> {
    Ok(names.iter().map(|n| record.values(n).map(<[f64]>::to_vec)).collect::<Result<_, _>>()?)
}

/// A record of references that the plant can follow, with start inputs that roughly give them.
fn start_record(
    ctx: &Context,
    k: usize,
    models: &[&StoredModel],
    data: &[(Dataset, PathBuf)],
) -> Result<Dataset, ChainError> {
    let (spec, problem, channels) = (&ctx.spec.optimise, &ctx.spec.problem, &ctx.channels);
    let dt = ctx.spec.sample_time_s;
    let n = (spec.record_s / dt).round() as usize;
    let mut rng = Rng64::stream(ctx.spec.seed, 300 + k as u64);
    let mut demands = Vec::new();
    for (j, d) in problem.demands.iter().enumerate() {
        // The leading demand goes through nearly all of its range, the others stay about their middles.
        let own = inner((d.lower, d.upper), if j == 0 { 0.025 } else { 0.25 });
        let range = spec.ranges.get(&d.output).copied().unwrap_or(own);
        let (levels, hold_s) = if j == 0 { (9, spec.hold_s) } else { (5, 2.3 * spec.hold_s) };
        let raw = aprbs(range, levels, hold_s, 0.0, n, dt, &mut rng)?;
        let lags = if j == 0 {
            ctx.spec.invert.shape.filter_of(&d.output, 0).to_vec()
        } else {
            vec![StructuredShape::FILTER_S[1]]
        };
        demands.push(held_head(filtered(&raw, &lags, dt)));
    }
    let mut free = Vec::new();
    for &i in &channels.free {
        let c = &problem.inputs[i];
        let range = ctx.spec.excite.ranges.get(&c.name).copied().unwrap_or((c.lower, c.upper));
        let levels = aprbs(range, ctx.spec.excite.levels, ctx.spec.excite.hold_s, 0.0, n, dt, &mut rng)?;
        let rate = c.rate_per_s.map_or(f64::INFINITY, |r| START_RATE * r * dt);
        free.push(rate_limited(&held_head(levels), rate));
    }
    let mut given = Vec::new();
    for (j, g) in problem.given.iter().enumerate() {
        let e = &ctx.spec.excite;
        let period = (e.sweep_s + 1.3 * k as f64) * (1.0 + 0.37 * j as f64);
        let range = e.ranges.get(&g.name).copied().unwrap_or((g.lower, g.upper));
        given.push(held_head(sweep(range, period, e.dwell_s, n, dt)?));
    }
    let all: Vec<&[f64]> = demands.iter().chain(&given).chain(&free).map(Vec::as_slice).collect();
    let driven = start_rule(ctx, data)?.drive(&Rows::from_columns(&all));
    let mut inputs = vec![Vec::new(); channels.inputs.len()];
    for (c, &i) in channels.driven.iter().enumerate() {
        let rate = problem.inputs[i].rate_per_s.map_or(f64::INFINITY, |r| START_RATE * r * dt);
        inputs[i] = rate_limited(&held_head(driven.column(c)), rate);
    }
    for (values, &i) in free.into_iter().zip(&channels.free) {
        inputs[i] = values;
    }
    let references: Vec<&[f64]> = demands.iter().chain(&given).map(Vec::as_slice).collect();
    for map in start_maps(ctx)? {
        let rate = problem.inputs[map.input].rate_per_s.map_or(f64::INFINITY, |r| START_RATE * r * dt);
        inputs[map.input] = rate_limited(&held_head(map.along(&references, n)), rate);
    }
    Ok(record_of(ctx, k, inputs, given, &demands, models))
}

/// The first samples held at their first value.
fn held_head(mut values: Vec<f64>) -> Vec<f64> {
    let n = HELD_HEAD.min(values.len());
    let first = values.first().copied().unwrap_or(0.0);
    values[..n].fill(first);
    values
}

fn start_rule(ctx: &Context, data: &[(Dataset, PathBuf)]) -> Result<StartRule, ChainError> {
    let (problem, channels) = (&ctx.spec.problem, &ctx.channels);
    let ports = &channels.ports;
    let free: Vec<Port> = channels
        .free
        .iter()
        .map(|&i| Port { name: problem.inputs[i].name.clone(), unit: problem.inputs[i].unit.clone() })
        .collect();
    let driven: Vec<_> = channels.driven.iter().map(|&i| ports.actuators[i].clone()).collect();
    let names = |list: &[Port]| list.iter().map(|p| p.name.clone()).collect::<Vec<_>>();
    let references = [names(&ports.demands), names(&ports.given), names(&free)].concat();
    let actuators: Vec<String> = driven.iter().map(|p| p.name.clone()).collect();
    let records = data
        .iter()
        .map(|(d, _)| Ok((channels.rows(d, &references)?, channels.rows(d, &actuators)?)))
        .collect::<Result<Vec<_>, ChainError>>()?;
    Ok(StartRule::fit(&ports.demands, &ports.given, &free, &driven, &records)?)
}

/// The start as a record; outputs stand at the models' rest under the first inputs.
fn record_of(
    ctx: &Context,
    k: usize,
    inputs: Vec<Vec<f64>>,
    given: Vec<Vec<f64>>,
    demands: &[Vec<f64>],
    models: &[&StoredModel],
) -> Dataset {
    let problem = &ctx.spec.problem;
    let n = demands.first().map_or(0, Vec::len);
    let channel = |name: &str, unit: &str, role: Role, values: Vec<f64>| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values,
    };
    let mut channels: Vec<Channel> = problem
        .inputs
        .iter()
        .zip(inputs)
        .map(|(i, v)| channel(&i.name, &i.unit, Role::Input, v))
        .chain(problem.given.iter().zip(given).map(|(g, v)| channel(&g.name, &g.unit, Role::Input, v)))
        .collect();
    let mut record = Dataset {
        name: format!("pass{k}_start"),
        sample_time_s: ctx.spec.sample_time_s,
        channels: channels.clone(),
        init_samples: 0,
        origin: "start rule".into(),
    };
    for output in ctx.channels.outputs() {
        let guess = problem.demands.iter().position(|d| d.output == output).map(|j| demands[j][0]);
        let model = models.iter().find(|m| m.user_output().name == output);
        let at_rest = model.and_then(|m| rest_of(m, &record));
        let value = at_rest.or(guess).unwrap_or(0.0);
        let unit = problem.unit(&output).unwrap_or("-").to_string();
        channels.push(channel(&output, &unit, Role::Output, vec![value; n]));
    }
    record.channels = channels;
    record
}

/// Where a model rests under the first inputs of a record, in the user's unit; none where it does not.
fn rest_of(model: &StoredModel, record: &Dataset) -> Option<f64> {
    let n = 400;
    let mut held = record.clone();
    for c in &mut held.channels {
        c.values = vec![c.values.first().copied()?; n];
    }
    let y = model.simulate(&held, None).ok()?.into_iter().next()?.y;
    y.last().copied().filter(|v| v.is_finite())
}

/// Mean objective from sample `first` to the end effect.
///
/// # Errors
/// [`ChainError`] when the record lacks a channel.
pub fn mean_objective(ctx: &Context, run: &Dataset, first: usize) -> Result<f64, ChainError> {
    let values = objective(&ctx.spec.problem, run)?;
    let range = first..values.len().saturating_sub(END_EFFECT);
    let n = range.len().max(1) as f64;
    Ok(values[range].iter().sum::<f64>() / n)
}

fn misses(ctx: &Context, optimum: &Optimum, run: &Dataset) -> Result<Vec<Miss>, ChainError> {
    let unit = |name: &str| ctx.spec.problem.unit(name).unwrap_or("-").to_string();
    ctx.channels
        .outputs()
        .into_iter()
        .map(|output| {
            let demand = optimum.demands.iter().find(|d| d.name == output);
            let errors: Option<Vec<f64>> = match demand {
                Some(d) => {
                    let pairs = run.values(&output)?.iter().zip(&d.values).skip(optimum.first);
                    Some(pairs.map(|(y, d)| y - d).collect())
                }
                None => None,
            };
            let mean = |f: &dyn Fn(f64) -> f64| {
                errors.as_ref().map(|e| e.iter().map(|v| f(*v)).sum::<f64>() / e.len().max(1) as f64)
            };
            Ok(Miss {
                unit: unit(&output),
                violation: optimum.violation(&output),
                measured_rms: mean(&|e| e * e).map(f64::sqrt),
                measured_mean: mean(&|e| e),
                output,
            })
        })
        .collect()
}
