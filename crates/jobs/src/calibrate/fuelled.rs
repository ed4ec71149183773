//! The delivered map with its fuel by measured states in place of its own (docs/fuelling.md), beside an ECU that is tuned on the same
//! plant.

use super::context::{Context, FuelledFrom, Governs, Identified, SETTLED_S};
use super::error::ChainError;
use super::fuel_driven::{Fuel, FuelDriven, FuelSetting};
use super::fuel_on_model::FuelOnModel;
use super::fuel_plant::FuelledPlant;
use crate::fuelling::places::Places;
use crate::fuelling::spec::{Channels, Job, Source};
use crate::fuelling::stored::{FUELLING_FILE, FUELLING_SCHEMA, FUELLING_VERSION, StoredFuelling};
use crate::fuelling::work::{AHEADS_S, CLOSED_S};
use crate::fuelling::{self, FuellingJobError};
use crate::place::Overrides;
use dynocal_calib::fuelling::{Feedback, FuelPolicy, SpeedDensity, SpeedDensityState};
use dynocal_calib::map::FeedforwardMap;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::validate::{Scenario, random_points, score};
use dynocal_files::json;
use dynocal_ident::data::Dataset;
use dynocal_ident::plan::Plan;
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Shortest interval in which fuel is given, in s: that of `dynocal fuelling`.
const SHORTEST_S: f64 = 1e-3;
/// Stream of the random points that the ECU is tuned on; those of the comparison are others.
const STREAM: u64 = 402;

/// How the fuel of the comparison was given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FuelledBy {
    /// Identified fuelling: its file, or the spec of the job that identified it.
    pub file: String,
    /// Bed time of the records that identified it, in s; 0 where it came as a file.
    pub identification_bed_s: f64,
    /// Interval in which fuel is given, in s.
    pub interval_s: f64,
    /// Extrapolation of the pressure by the ECU in s, from a line search on points of its own.
    pub ecu_ahead_s: f64,
    /// Time constant of its lambda loop in s, from a second line search; none where no loop is better.
    pub ecu_closed_s: Option<f64>,
    /// Bed time of the tuning in s.
    pub ecu_bed_s: f64,
    /// Share of the samples of the comparison whose speed or throttle lies outside of what the identification saw.
    pub outside: f64,
}

/// What a campaign knows of fuelling before any of it is there: names of channels, and what lambda is demanded.
struct Asked {
    channels: Channels,
    /// Place of lambda among the demands, and its value in all scenarios.
    demand: (usize, f64),
    /// Range and unit of the injection.
    range: (f64, f64),
    unit: String,
    /// The job that identifies; none where a file is given.
    job: Option<Job>,
}

fn fault(key: &str, found: impl Into<String>, expected: impl Into<String>) -> ChainError {
    let key = format!("fuelling{key}");
    ChainError::Spec { key, found: found.into(), expected: expected.into() }
}

impl Asked {
    /// None where the spec names no fuelling. A job works in `folder`.
    fn of(ctx: &Context, folder: &Path) -> Result<Option<Self>, ChainError> {
        let Some(spec) = &ctx.spec.fuelling else { return Ok(None) };
        let job = spec.spec.as_deref().map(|path| job(ctx, path, folder)).transpose()?;
        let channels = match &job {
            Some(job) => job.channels.clone(),
            None => spec.channels.clone().unwrap_or_default(),
        };
        let (problem, c) = (&ctx.spec.problem, &channels);
        let demand = problem.demands.iter().position(|d| d.output == c.lambda).filter(|k| *k > 0);
        let Some(k) = demand else {
            let known = problem.demand_names().into_iter().skip(1).collect::<Vec<_>>().join(", ");
            let expected = format!("a demand beside the leading one ({known})");
            return Err(fault(".channels.lambda", format!("`{}`", c.lambda), expected));
        };
        let Some(input) = problem.inputs.iter().find(|i| i.name == c.injection) else {
            let expected = format!("an input of the problem ({})", problem.input_names().join(", "));
            return Err(fault(".channels.injection", format!("`{}`", c.injection), expected));
        };
        let (range, unit, d) = ((input.lower, input.upper), input.unit.clone(), &problem.demands[k]);
        // Scenarios hold every demand but the leading one in the middle of its range.
        Ok(Some(Self { demand: (k, 0.5 * (d.lower + d.upper)), range, unit, channels, job }))
    }

    /// What it holds, where engine and fuelling are one plant.
    fn governs(&self, ctx: &Context) -> Result<Option<Governs>, ChainError> {
        if !ctx.spec.fuelling.as_ref().is_some_and(|f| f.plant) {
            return Ok(None);
        }
        let Channels { injection, lambda, boost, .. } = &self.channels;
        match ctx.spec.loops.iter().find(|l| l.output == *lambda) {
            Some(l) if l.input == *injection => {
                let (injection, lambda) = (injection.clone(), lambda.clone());
                Ok(Some(Governs { injection, lambda, boost: boost.clone() }))
            }
            found => {
                let found = found.map_or("none".into(), |l| format!("by `{}`", l.input));
                let expected = format!("a loop of `{lambda}` by `{injection}`, which the fuelling replaces");
                Err(fault(".plant", format!("a loop {found}"), expected))
            }
        }
    }

    /// Places of the channels on the plant.
    fn places(&self, ctx: &Context) -> Result<Places, ChainError> {
        let plant = ctx.plant(false)?;
        Places::of(plant.as_ref(), &self.channels)
            .map_err(|found| fault(".channels", found, "channels of the plant"))
    }

    /// Whether fuel that is given every `interval_s` fits.
    fn interval(&self, ctx: &Context, source: &str, interval_s: f64) -> Result<(), ChainError> {
        let dt = ctx.spec.sample_time_s;
        let count = (dt / interval_s).round();
        // What is not a number, or none that a controller could have, is no interval.
        if !(interval_s >= SHORTEST_S && count >= 1.0 && (count * interval_s - dt).abs() <= 1e-9) {
            let expected =
                format!("an interval from {SHORTEST_S} s that divides that of the campaign, {dt} s");
            return Err(fault("", format!("`{source}`, identified at {interval_s} s"), expected));
        }
        Ok(())
    }
}

/// What the fuelling of a spec holds, where engine and fuelling are one plant.
///
/// # Errors
/// [`ChainError`]: as [`check`].
pub(super) fn governs(ctx: &Context) -> Result<Option<Governs>, ChainError> {
    match Asked::of(ctx, Path::new(""))? {
        Some(asked) => asked.governs(ctx),
        None => Ok(None),
    }
}

/// The job of a spec, which works in `folder`: what it drives is the plant of the campaign.
fn job(ctx: &Context, path: &Path, folder: &Path) -> Result<Job, ChainError> {
    let over = Overrides { seed: Some(ctx.spec.seed), out: Some(folder.join(FOLDER)) };
    let mut job = fuelling::spec::read(path, &over).map_err(|e| ChainError::Fuelling(e.to_string()))?;
    if let Source::Plant { plant, .. } = &mut job.source {
        plant.clone_from(&ctx.spec.plant);
    }
    Ok(job)
}

/// Folder of the run that identifies, inside that of the step.
const FOLDER: &str = "fuelling";

/// What can be known of the fuelling of a spec before anything runs.
///
/// # Errors
/// [`ChainError`]: a file or spec, what must not be used, channels, units, an interval.
pub(super) fn check(ctx: &Context) -> Result<(), ChainError> {
    let Some(asked) = Asked::of(ctx, Path::new(""))? else { return Ok(()) };
    if ctx.plants.is_some() {
        asked.places(ctx)?;
    }
    if let Some(Job { source: Source::Plant { test, .. }, name, .. }) = &asked.job {
        return asked.interval(ctx, name, test.sample_time_s);
    }
    match &ctx.spec.fuelling.as_ref().and_then(|f| f.file.clone()) {
        Some(file) => usable(ctx, &asked, &file.display().to_string(), &read(file)?),
        None => Ok(()),
    }
}

/// Files that tell what the fuelling of a spec is.
pub(super) fn files(ctx: &Context) -> Vec<PathBuf> {
    let Some(spec) = &ctx.spec.fuelling else { return Vec::new() };
    let mut out: Vec<PathBuf> = spec.file.iter().chain(&spec.spec).cloned().collect();
    let job = spec.spec.as_deref().and_then(|path| job(ctx, path, Path::new("")).ok());
    if let Some(Job { source: Source::Files { identification, unseen }, .. }) = job {
        out.extend(identification.into_iter().chain(unseen));
    }
    out
}

fn read(file: &Path) -> Result<StoredFuelling, ChainError> {
    Ok(json::read_versioned(file, FUELLING_SCHEMA, FUELLING_VERSION)?)
}

fn usable(ctx: &Context, asked: &Asked, source: &str, stored: &StoredFuelling) -> Result<(), ChainError> {
    if !stored.valid {
        let expected = "identified fuelling that may be used (its report says what it lacks)";
        return Err(fault("", format!("`{source}`, which must not be used"), expected));
    }
    stored.check().map_err(|e| ChainError::Fuelling(format!("`{source}`: {e}")))?;
    if asked.unit != stored.injection_unit {
        let found = format!("`{source}`, whose injection is in {}", stored.injection_unit);
        return Err(fault("", found, format!("{} as in the problem", asked.unit)));
    }
    asked.interval(ctx, source, stored.fuelling.sample_time_s)
}

/// Reads or identifies what the spec names, before the first step, and keeps it in `folder`. None where it names none.
///
/// # Errors
/// [`ChainError`]: as [`check`], and what the identification ends with.
pub(super) fn identified(ctx: &Context, folder: &Path) -> Result<Option<FuelledFrom>, ChainError> {
    let (Some(asked), Some(spec)) = (Asked::of(ctx, folder)?, &ctx.spec.fuelling) else {
        return Ok(None);
    };
    let governs = asked.governs(ctx)?;
    let (from, stored) = match (&asked.job, &spec.file) {
        (Some(job), _) => {
            ctx.watch.note("identifying fuel by measured states");
            // How far the job is, is not how far the campaign is.
            let watch = Watch { fraction: &|_| (), ..ctx.watch };
            let (found, _) = fuelling::run(job, watch).map_err(|e| match e {
                FuellingJobError::Interrupted => ChainError::Interrupted,
                e => ChainError::Fuelling(e.to_string()),
            })?;
            let bed_s = match &job.source {
                Source::Plant { test, .. } => 2.0 * test.record_s,
                Source::Files { .. } => 0.0,
            };
            let file = spec.spec.iter().map(|p| p.display().to_string()).collect();
            (FuelledFrom { file, bed_s, governs }, found.stored())
        }
        (None, Some(file)) => {
            (FuelledFrom { file: file.display().to_string(), bed_s: 0.0, governs }, read(file)?)
        }
        (None, None) => return Ok(None),
    };
    usable(ctx, &asked, &from.file, &stored)?;
    json::write_versioned(&folder.join(FUELLING_FILE), FUELLING_SCHEMA, FUELLING_VERSION, &stored)?;
    Ok(Some(from))
}

/// From now on what was identified in the step of `folder` injects.
///
/// # Errors
/// [`ChainError`]: the file.
pub(super) fn inject(ctx: &Context, folder: &Path, from: Option<&FuelledFrom>) -> Result<(), ChainError> {
    if let Some(from) = from {
        let stored = read(&folder.join(FUELLING_FILE))?;
        // Set once: what a finished step has found is what it would find again.
        drop(ctx.fuelling.set(Identified { stored, from: from.clone() }));
    }
    Ok(())
}

/// A record of the excitation: with its fuel by measured states where the campaign has them, and lambda as the plan demands it.
///
/// # Errors
/// [`ChainError`].
pub(super) fn excited(ctx: &Context, folder: &Path, plan: &Plan) -> Result<Dataset, ChainError> {
    let asked = ctx.spec.fuelling.as_ref().is_some_and(|f| f.excite);
    let Some(fuelled) = Fuelled::of(ctx)?.filter(|_| asked) else {
        return ctx.measure(folder, plan, true);
    };
    let mut plan = plan.clone();
    let c = &fuelled.asked.channels;
    for l in plan.loops.iter_mut().filter(|l| l.input == c.injection) {
        l.closed = false;
    }
    let lambda = plan.demand(&c.lambda).map_or_else(Vec::new, |d| d.values.clone());
    fuelled.play(folder, &plan, (fuelled.policy(), lambda), true)
}

/// Engine and fuelling as one plant, once the fuelling is identified.
///
/// # Errors
/// [`PlantError`]: before it is, or a plant without its channels.
pub(super) fn plant(ctx: &Context, noise: bool) -> Result<Box<dyn Plant>, PlantError> {
    let call = |e: ChainError| PlantError::Call(e.to_string());
    match Fuelled::of(ctx).map_err(call)? {
        Some(fuelled) => Ok(Box::new(fuelled.plant(noise).map_err(call)?)),
        None => Err(PlantError::Call("engine and fuelling are one plant once that is identified".into())),
    }
}

/// Identified fuelling with its places on the plant of a campaign.
pub(super) struct Fuelled<'a, 'c> {
    ctx: &'a Context<'c>,
    asked: Asked,
    stored: &'a StoredFuelling,
    from: &'a FuelledFrom,
}

impl<'a, 'c> Fuelled<'a, 'c> {
    /// None where the campaign has none.
    ///
    /// # Errors
    /// [`ChainError`]: a spec that cannot be read any more.
    pub(super) fn of(ctx: &'a Context<'c>) -> Result<Option<Self>, ChainError> {
        let asked = Asked::of(ctx, Path::new(""))?;
        let there = ctx.fuelling.get();
        let with =
            |(asked, i): (Asked, &'a Identified)| Self { ctx, asked, stored: &i.stored, from: &i.from };
        Ok(asked.zip(there).map(with))
    }

    /// What would inject behind a map, by the identified model alone. None where the model of the manifold does not know all that moves
    /// it: the pressure before the throttle, or cams.
    pub(super) fn on_model(&self) -> Option<FuelOnModel<'_>> {
        let (problem, c) = (&self.ctx.spec.problem, &self.asked.channels);
        if c.boost.is_some() || self.stored.fuelling.charge.cams.is_some() {
            return None;
        }
        let input = |name: &str| problem.inputs.iter().position(|i| i.name == name);
        let given = problem.given.iter().position(|g| g.name == c.speed)?;
        Some(FuelOnModel {
            fuelling: &self.stored.fuelling,
            throttle: input(&c.throttle)?,
            injection: input(&c.injection)?,
            speed: problem.demands.len() + given,
            lambda: self.asked.demand.0,
            most: self.asked.range.1,
        })
    }

    /// Fuel of the identified model.
    pub(super) fn policy(&self) -> Fuel {
        Fuel::Policy(Box::new(FuelPolicy::new(self.stored.fuelling.clone(), self.asked.range.1)))
    }

    /// A map through a scenario, with its fuel by `fuel`; the record has what was injected.
    ///
    /// # Errors
    /// [`ChainError`].
    pub(super) fn run(
        &self,
        folder: &Path,
        (map, name): (&dyn FeedforwardMap, &str),
        scenario: &Scenario,
        fuel: Fuel,
    ) -> Result<Dataset, ChainError> {
        let plan = self.ctx.scenario_plan(map, name, scenario);
        self.play(folder, &plan, (fuel, vec![self.asked.demand.1]), false)
    }

    /// Plays a plan with fuel by `fuel` at a demanded lambda; the record has what was injected.
    fn play(
        &self,
        folder: &Path,
        plan: &Plan,
        (fuel, lambda): (Fuel, Vec<f64>),
        noise: bool,
    ) -> Result<Dataset, ChainError> {
        let setting = FuelSetting {
            fuel,
            interval_s: self.stored.fuelling.sample_time_s,
            lambda,
            lead: plan.settling_samples().max(1),
            range: self.asked.range,
        };
        let mut plant = self.driven(noise, setting)?;
        let mut record = self.ctx.measure_on(folder, plan, &mut plant)?;
        let injection = record.channels.iter_mut().find(|c| c.name == self.asked.channels.injection);
        if let Some(c) = injection {
            let given = plant.given(c.values.len());
            c.values.copy_from_slice(given);
        }
        Ok(record)
    }

    fn driven(&self, noise: bool, setting: FuelSetting) -> Result<FuelDriven, ChainError> {
        Ok(FuelDriven::new(self.ctx.plant(noise)?, self.asked.places(self.ctx)?, setting))
    }

    /// Whether engine and fuelling are one plant.
    pub(super) fn is_plant(&self) -> bool {
        self.from.governs.is_some()
    }

    /// Openings of the throttle in deg that the identification saw.
    pub(super) fn seen_deg(&self) -> Interval {
        let [lower, upper] = self.stored.seen.throttle_deg;
        Interval { lower, upper }
    }

    /// Engine and fuelling as one plant.
    fn plant(&self, noise: bool) -> Result<FuelledPlant, ChainError> {
        let (c, d) = (&self.asked.channels, self.asked.demand);
        let setting = FuelSetting {
            fuel: self.policy(),
            interval_s: self.stored.fuelling.sample_time_s,
            lambda: vec![d.1],
            lead: 0,
            range: self.asked.range,
        };
        Ok(FuelledPlant::new(self.driven(noise, setting)?, &c.injection, &c.lambda, d.1)?)
    }

    /// The ECU on the static map, tuned on points of its own: extrapolation first, then a lambda loop where one pays.
    ///
    /// # Errors
    /// [`ChainError`].
    pub(super) fn ecu(
        &self,
        folder: &Path,
        map: &StaticMap,
    ) -> Result<(SpeedDensity, FuelledBy), ChainError> {
        let (ctx, f) = (self.ctx, &self.stored.fuelling);
        let (spec, problem, dt) = (&ctx.spec.validate.scenario, &ctx.spec.problem, ctx.spec.sample_time_s);
        let points = random_points(spec, problem, dt, &mut Rng64::stream(ctx.spec.seed, STREAM));
        let plain = SpeedDensity {
            sample_time_s: f.sample_time_s,
            charge: f.charge.clone(),
            law: f.coolant,
            most_kpa: self.stored.seen.map_kpa[1].max(f.filling.upstream_kpa),
            ahead_s: 0.0,
            film: Some(f.coat()),
            feedback: None,
        };
        let cost = |ecu: &SpeedDensity| -> Result<f64, ChainError> {
            let run = self.run(folder, (map, "tuning of an ECU"), &points, self.ecu_fuel(ecu))?;
            let scores = score(spec, problem, &points, &["ECU"], &[&run])?;
            Ok(scores[0].demands[self.asked.demand.0].mean_error)
        };
        let best = |all: Vec<SpeedDensity>| -> Result<(f64, SpeedDensity), ChainError> {
            let costs: Vec<Result<f64, ChainError>> = all.par_iter().map(&cost).collect();
            let mut best = (f64::INFINITY, plain.clone());
            for (ecu, cost) in all.into_iter().zip(costs) {
                let cost = cost?;
                if cost < best.0 {
                    best = (cost, ecu);
                }
            }
            Ok(best)
        };
        let open = best(AHEADS_S.iter().map(|s| SpeedDensity { ahead_s: *s, ..plain.clone() }).collect())?;
        let closed = |s: &f64| SpeedDensity {
            feedback: Some(Feedback { timing: f.timing, closed_s: *s }),
            ..open.1.clone()
        };
        let closed = best(CLOSED_S.iter().map(closed).collect())?;
        let ecu = if closed.0 < open.0 { closed.1 } else { open.1 };
        let runs = (AHEADS_S.len() + CLOSED_S.len()) as f64;
        let by = FuelledBy {
            file: self.from.file.clone(),
            identification_bed_s: self.from.bed_s,
            interval_s: f.sample_time_s,
            ecu_ahead_s: ecu.ahead_s,
            ecu_closed_s: ecu.feedback.map(|f| f.closed_s),
            ecu_bed_s: runs * (points.reference.len() as f64 * dt + SETTLED_S),
            outside: 0.0,
        };
        Ok((ecu, by))
    }

    /// Fuel of an ECU.
    pub(super) fn ecu_fuel(&self, ecu: &SpeedDensity) -> Fuel {
        Fuel::Ecu(Box::new(SpeedDensityState::new(ecu.clone(), self.asked.range.1)))
    }

    /// Share of the samples whose speed or throttle lies outside of what the identification saw.
    ///
    /// # Errors
    /// [`ChainError`]: a record without the channels.
    pub(super) fn outside(&self, records: &[&Dataset]) -> Result<f64, ChainError> {
        let (c, seen) = (&self.asked.channels, &self.stored.seen);
        let (mut outside, mut all) = (0, 0);
        for r in records {
            let within = |v: &f64, [low, high]: [f64; 2]| (low..=high).contains(v);
            let pairs = r.values(&c.speed)?.iter().zip(r.values(&c.throttle)?);
            all += r.len();
            outside +=
                pairs.filter(|(n, a)| !(within(n, seen.speed_rpm) && within(a, seen.throttle_deg))).count();
        }
        Ok(outside as f64 / all.max(1) as f64)
    }
}
