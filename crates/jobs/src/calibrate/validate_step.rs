//! Step 6: the delivered map against its rivals on the plant.

use super::context::{Context, Tone};
use super::error::ChainError;
use super::fuel_plant::as_asked;
use super::fuelled::{Fuelled, FuelledBy};
use super::invert_step::InvertResult;
use super::lag::{OnModels, best_lag};
use super::optimise_step::Pass;
use super::records::{RecordRef, save_records};
use super::static_search::calibrate_static;
use dynocal_calib::map::lagged::LaggedStaticMap;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::map::{FeedforwardMap, Rows};
use dynocal_calib::validate::{MapScore, Scenario, demand_steps, random_points, score};
use dynocal_ident::data::Dataset;
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The objective with the static map's free inputs on the record of the last pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticOnRecord {
    /// Mean objective with the demands of the pass held and the static map's values of the inputs that no loop drives.
    pub objective: f64,
    /// Its ratio to the start record.
    pub ratio: f64,
    /// Saving of the optimum over that of the static map's values: (1 - measured) / (1 - this ratio). None when they save
    /// nothing.
    pub share_of_saving: Option<f64>,
}

/// The price of causality: the demands of the last pass three times on the plant, by inputs that no loop drives. Each number is the mean
/// objective over that of the start record, loops holding the demands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Causality {
    /// The optimum of the pass, which knew the whole record beforehand.
    pub preview: f64,
    /// A policy without that: the form with most freedom that was fitted to the optima ([`FULL`]). None where none was.
    pub policy: Option<f64>,
    /// The map that is delivered.
    pub delivered: f64,
}

/// Structure of the policy without preview: terms over all demands and their past.
pub const FULL: &str = "structured";

/// What step 6 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValidateResult {
    /// The static map.
    pub static_map: StaticMap,
    /// Time constant of the lagged static map in s, from a line search on the identified models; 0 where there is none.
    pub lag_s: f64,
    /// Scores of all maps in all scenarios, the delivered map first.
    pub scores: Vec<MapScore>,
    /// The static map's free inputs on the record of the last pass.
    pub static_on_record: Option<StaticOnRecord>,
    /// The price of causality; none where no input is free of loops.
    #[serde(default)]
    pub causality: Option<Causality>,
    /// How fuel was given where the map does not inject.
    #[serde(default)]
    pub fuelled: Option<FuelledBy>,
    /// Measured records of all runs.
    pub records: Vec<RecordRef>,
    /// Bed time of the comparison in s (the static map's stands with it).
    pub bed_s: f64,
}

/// Name of the map that is delivered.
pub const DYNAMIC: &str = "dynamic map";

/// Name of the same before it was refined.
pub const NOT_REFINED: &str = "dynamic map before refinement";

/// Name of the same with one lag in the place of its dynamics.
pub const ONE_LAG: &str = "same map with one lag";

/// Name of the same with its own fuel, where fuel is given by measured states.
pub const OWN_FUEL: &str = "same map with its own fuel";

/// Name of the static map with the fuel of a production ECU.
pub const ECU_FUEL: &str = "static map with the fuel of an ECU";

/// Name of the static map with the fuel of the delivered one, where engine and fuelling are one plant: what the dynamics are worth.
pub const SAME_FUEL: &str = "static map with the same fuel";

/// A map with the name that it has in the comparison.
type NamedMap<'a> = (&'a dyn FeedforwardMap, &'a str);

/// Runs the step.
///
/// # Errors
/// [`ChainError`].
pub fn validate(
    (ctx, on): (&Context, &Context),
    folder: &Path,
    inverse: &InvertResult,
    (last, optimise_folder): (&Pass, &Path),
    models: &[&StoredModel],
) -> Result<ValidateResult, ChainError> {
    let static_map = calibrate_static(ctx)?;
    let (spec, problem, dt) = (&ctx.spec.validate.scenario, &ctx.spec.problem, ctx.spec.sample_time_s);
    let leader = ctx.channels.driven.first().copied().unwrap_or(0);
    let steps = demand_steps(spec, problem, dt);
    // Models of engine and fuelling as one plant do not say how the map's own fuel should wait.
    let lag_s = match ctx.governs() {
        Some(_) => 0.0,
        None => best_lag((&static_map, leader), &OnModels::new(ctx, models)),
    };
    let lagged = LaggedStaticMap { map: &static_map, tau_s: lag_s, leader };
    let on_record = OnRecord::of((ctx, on), folder, last, optimise_folder)?;
    let static_on_record = on_record.as_ref().map(|r| r.static_map(&static_map)).transpose()?;
    let causality = on_record.as_ref().map(|r| r.causality(inverse)).transpose()?;
    let fuelled = Fuelled::of(ctx)?;
    // What is delivered is called so, whatever its structure and whoever injects.
    let own = if fuelled.is_some() { OWN_FUEL } else { DYNAMIC };
    let mut maps: Vec<NamedMap> = vec![(&*inverse.dynamic, own), (&static_map, static_map.name())];
    if ctx.governs().is_none() {
        maps.push((&lagged, lagged.name()));
    }
    maps.extend(inverse.one_lag.as_ref().map(|m| -> NamedMap { (&**m, ONE_LAG) }));
    maps.extend(inverse.before.as_ref().map(|m| -> NamedMap { (&**m, NOT_REFINED) }));
    maps.extend(inverse.rivals.iter().map(|m| -> NamedMap { (&**m, m.name()) }));
    let mut names: Vec<&str> = maps.iter().map(|m| m.1).collect();
    let mut rng = Rng64::stream(ctx.spec.seed, 400);
    let scenarios = [random_points(spec, problem, dt, &mut rng), steps];
    let mut runs = run_all(ctx, folder, &maps, &scenarios)?;
    let by = match &fuelled {
        Some(f) => {
            names.insert(0, DYNAMIC);
            names.push(ECU_FUEL);
            names.extend(ctx.governs().map(|_| SAME_FUEL));
            Some(run_fuelled(f, folder, (&*inverse.dynamic, &static_map), (&scenarios, &mut runs))?)
        }
        None => None,
    };
    let mut scores = Vec::new();
    for (scenario, records) in scenarios.iter().zip(&runs) {
        scores.extend(score(spec, problem, scenario, &names, &records.iter().collect::<Vec<_>>())?);
    }
    let all: Vec<Dataset> = runs.into_iter().flatten().collect();
    let driven_s: f64 = all.iter().map(|r| r.len() as f64 * dt + ctx.spec.excite.lead_in_s).sum();
    let records = save_records(folder, &all)?;
    let bed_s = driven_s + by.as_ref().map_or(0.0, |b| b.ecu_bed_s);
    Ok(ValidateResult { static_map, lag_s, scores, static_on_record, causality, fuelled: by, records, bed_s })
}

/// The record of the last pass again and again, with other values of the inputs that no loop drives.
struct OnRecord<'a, 'c> {
    /// What maps give and read.
    ctx: &'a Context<'c>,
    /// What is played: the same, or engine and fuelling as one plant.
    on: &'a Context<'c>,
    folder: &'a Path,
    last: &'a Pass,
    optimum: Dataset,
}

impl<'a, 'c> OnRecord<'a, 'c> {
    /// None where loops drive every input, or the pass has no record.
    fn of(
        (ctx, on): (&'a Context<'c>, &'a Context<'c>),
        folder: &'a Path,
        last: &'a Pass,
        optimise_folder: &Path,
    ) -> Result<Option<Self>, ChainError> {
        if on.channels.free.is_empty() {
            return Ok(None);
        }
        let optimum = on.load_records(optimise_folder, &last.records)?.into_iter().nth(1);
        Ok(optimum.map(|optimum| Self { ctx, on, folder, last, optimum }))
    }

    /// Mean objective with the free inputs of `by`, which is told the references.
    fn objective(&self, name: &str, by: impl Fn(&Rows) -> Rows) -> Result<f64, ChainError> {
        let (ctx, optimum) = (self.on, &self.optimum);
        // A map is asked what it was taught: lambda as it was demanded.
        let mut asked = optimum.clone();
        self.ctx.governs().iter().for_each(|by| as_asked(&mut asked, by));
        let drive = by(&self.ctx.channels.references(&asked)?);
        let mut actuators = ctx.channels.actuators(optimum)?;
        for &k in &ctx.channels.free {
            // What loops drive stays as optimised: they trim what the other inputs need.
            let given = self.ctx.channels.inputs.iter().position(|n| *n == ctx.channels.inputs[k]);
            given.into_iter().for_each(|g| actuators.set_column(k, &drive.column(g)));
        }
        let inputs = (0..actuators.width()).map(|k| actuators.column(k)).collect();
        let given = ctx
            .channels
            .given
            .iter()
            .map(|g| Ok(optimum.values(g)?.to_vec()))
            .collect::<Result<_, ChainError>>()?;
        let demands = self.last.demands.clone();
        debug_assert!(demands.iter().all(|d| d.len() == actuators.len()));
        let plan = ctx.plan(name, inputs, given, demands, Tone::Trim);
        let run = ctx.measure(self.folder, &plan, true)?;
        save_records(self.folder, std::slice::from_ref(&run))?;
        super::optimise_step::mean_objective(ctx, &run, self.last.first)
    }

    fn static_map(&self, map: &StaticMap) -> Result<StaticOnRecord, ChainError> {
        let steady = |references: &Rows| {
            let width = self.ctx.channels.inputs.len();
            let mut out = Rows::from_values(width, vec![0.0; width * references.len()]);
            (0..references.len()).for_each(|t| map.at(references.row(t), out.row_mut(t)));
            out
        };
        let objective = self.objective("static_on_record", steady)?;
        let ratio = objective / self.last.measured_start;
        let share_of_saving =
            Some((1.0 - self.last.measured_ratio) / (1.0 - ratio)).filter(|v| v.is_finite() && ratio < 1.0);
        Ok(StaticOnRecord { objective, ratio, share_of_saving })
    }

    fn causality(&self, inverse: &InvertResult) -> Result<Causality, ChainError> {
        let ratio = |name: &str, map: &dyn FeedforwardMap| {
            let drive = |r: &Rows| map.drive(r, self.ctx.spec.sample_time_s);
            Ok::<f64, ChainError>(self.objective(name, drive)? / self.last.measured_start)
        };
        let full = inverse.rivals.iter().find(|m| m.structure() == FULL);
        // A structured map may be what is delivered: then it is its own full form.
        let delivered = ratio("delivered_on_record", &*inverse.dynamic)?;
        let policy = match full {
            Some(map) => Some(ratio("policy_on_record", &**map)?),
            None => (inverse.dynamic.structure() == FULL).then_some(delivered),
        };
        Ok(Causality { preview: self.last.measured_ratio, policy, delivered })
    }
}

fn run_all(
    ctx: &Context,
    folder: &Path,
    maps: &[NamedMap],
    scenarios: &[Scenario],
) -> Result<Vec<Vec<Dataset>>, ChainError> {
    let jobs: Vec<(usize, usize)> =
        (0..scenarios.len()).flat_map(|s| (0..maps.len()).map(move |m| (s, m))).collect();
    let done = AtomicUsize::new(0);
    let records = jobs
        .par_iter()
        .map(|&(s, m)| {
            let record = run_map(ctx, folder, maps[m], &scenarios[s])?;
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            ctx.fraction(0.7 + 0.3 * done as f64 / jobs.len() as f64);
            Ok(record)
        })
        .collect::<Vec<Result<Dataset, ChainError>>>()
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let mut records = records.into_iter();
    Ok(scenarios.iter().map(|_| records.by_ref().take(maps.len()).collect()).collect())
}

/// Runs a map through a scenario open loop; the raw demands are recorded beside.
fn run_map(
    ctx: &Context,
    folder: &Path,
    (map, name): NamedMap,
    scenario: &Scenario,
) -> Result<Dataset, ChainError> {
    ctx.measure(folder, &ctx.scenario_plan(map, name, scenario), false)
}

/// The delivered map with its fuel by measured states before, and the static map with the fuel of an ECU behind the runs of each
/// scenario.
fn run_fuelled(
    fuelled: &Fuelled,
    folder: &Path,
    (delivered, static_map): (&dyn FeedforwardMap, &StaticMap),
    (scenarios, runs): (&[Scenario], &mut [Vec<Dataset>]),
) -> Result<FuelledBy, ChainError> {
    let (ecu, by) = fuelled.ecu(folder, static_map)?;
    for (scenario, runs) in scenarios.iter().zip(&mut *runs) {
        runs.insert(0, fuelled.run(folder, (delivered, DYNAMIC), scenario, fuelled.policy())?);
        runs.push(fuelled.run(folder, (static_map, ECU_FUEL), scenario, fuelled.ecu_fuel(&ecu))?);
        if fuelled.is_plant() {
            runs.push(fuelled.run(folder, (static_map, SAME_FUEL), scenario, fuelled.policy())?);
        }
    }
    let own: Vec<&Dataset> = runs.iter().filter_map(|r| r.first()).collect();
    Ok(FuelledBy { outside: fuelled.outside(&own)?, ..by })
}
