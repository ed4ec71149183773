//! Step 5: from measured optimal records to the dynamic map that is delivered, moved onto points at rest, with dynamics that the
//! models like best; and other structures beside it where they are made for the problem.

use super::at_rest::{self, AtRest};
use super::context::Context;
use super::error::ChainError;
use super::fuel_plant::as_played;
use super::fuelled::Fuelled;
use super::lag::OnModels;
use super::optimise_plan::END_EFFECT;
use super::records::RecordRef;
use super::refine;
use dynocal_calib::map::structures::{self, FitTask, InverseScore, MapError, Pairs, StoredMap};
use dynocal_calib::map::{FeedforwardMap, Rows};
use dynocal_ident::data::Dataset;
use dynocal_ident::stored::StoredModel;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What step 5 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InvertResult {
    /// The map that is delivered.
    pub dynamic: StoredMap,
    /// Other structures, for comparison, as far as they are made for the problem and a fit that can be run was found.
    pub rivals: Vec<StoredMap>,
    /// The delivered map with the plainest dynamics, one lag of all actuators but the leading one: what its own have to beat. None where
    /// its structure has none or no model tells.
    #[serde(default)]
    pub one_lag: Option<StoredMap>,
    /// Points at rest that the delivered map was moved onto; none where the spec wants none.
    pub at_rest: Option<AtRest>,
    /// Fits.
    pub scores: Vec<InverseScore>,
    /// Whether pairs came from measured or simulated responses.
    pub pairs: String,
    /// Records used.
    pub records: Vec<String>,
    /// Records of passes that were left out because their optimum must not be used.
    pub left_out: Vec<String>,
    /// Records that the map itself drove, after each of which it was fitted again.
    #[serde(default)]
    pub refined: Vec<RecordRef>,
    /// Their bed time in s.
    #[serde(default)]
    pub refine_s: f64,
    /// The map before them, where there are some.
    #[serde(default)]
    pub before: Option<StoredMap>,
}

/// Response and actuators of one record.
type Record = (Rows, Rows);

/// Fits the maps on the optimal records; `models` by output, in the order of the demands first.
///
/// # Errors
/// [`ChainError`].
pub fn invert(
    ctx: &Context,
    optima: &[Dataset],
    left_out: Vec<String>,
    models: &[&StoredModel],
) -> Result<InvertResult, ChainError> {
    let spec = &ctx.spec.invert;
    let simulated = match spec.pairs.as_str() {
        "measured" => false,
        "simulated" => true,
        _ => ctx.noisy(),
    };
    let data: Vec<Record> =
        optima.iter().map(|d| pairs_of(ctx, d, simulated, models)).collect::<Result<_, _>>()?;
    let pairs: Vec<Pairs> = data.iter().map(|(r, a)| Pairs { response: r, actuators: a }).collect();
    let ports = &ctx.channels.ports;
    let interrupt = || ctx.watch.interrupted();
    let task = FitTask { ports, pairs: &pairs, seed: ctx.spec.seed, interrupt: &interrupt };
    let first = spec.built().map_err(MapError::from)?.fit(&task)?;
    let dynamic = first.map.ok_or_else(|| MapError::Unstable(spec.structure.clone()))?;
    let (mut scores, mut rivals) = (first.scores, Vec::new());
    for name in spec.rivals.iter().filter(|r| **r != spec.structure) {
        ctx.check_interrupt()?;
        let row = structures::row(name).map_err(MapError::from)?;
        if (row.fits)(ports) {
            let fitted = (row.build)(&toml::Table::new()).map_err(MapError::from)?.fit(&task)?;
            rivals.extend(fitted.map);
            scores.extend(fitted.scores);
        }
    }
    Ok(InvertResult {
        dynamic,
        rivals,
        one_lag: None,
        at_rest: None,
        scores,
        pairs: match (simulated, ctx.governs()) {
            (true, _) => "simulated".into(),
            (false, None) => "measured".into(),
            (false, Some(by)) => format!("measured (of {}: demanded)", by.lambda),
        },
        records: optima.iter().map(|d| d.name.clone()).collect(),
        left_out,
        refined: Vec::new(),
        refine_s: 0.0,
        before: None,
    })
}

/// Fits as [`invert`] does, then `invert.refine` times again with one more record that the map of then drives.
///
/// # Errors
/// [`ChainError`].
pub fn invert_refined(
    ctx: &Context,
    folder: &Path,
    mut optima: Vec<Dataset>,
    left_out: &[String],
    models: &[&StoredModel],
) -> Result<InvertResult, ChainError> {
    let mut found = invert(ctx, &optima, left_out.to_vec(), models)?;
    let before = (ctx.spec.invert.refine > 0).then(|| found.dynamic.clone());
    let (mut refined, mut refine_s) = (Vec::new(), 0.0);
    for k in 1..=ctx.spec.invert.refine {
        ctx.check_interrupt()?;
        let (record, kept) = refine::driven(ctx, folder, k, &*found.dynamic)?;
        refine_s += record.len() as f64 * record.sample_time_s + ctx.spec.excite.lead_in_s;
        refined.push(kept);
        optima.push(record);
        found = invert(ctx, &optima, left_out.to_vec(), models)?;
    }
    Ok(InvertResult { refined, refine_s, before, ..found })
}

/// The maps as they are delivered: with the dynamics that the models like best, and moved onto points at rest that the fitted one
/// drives on the plant. What the plant has told of points at rest is told to all of them.
///
/// # Errors
/// [`ChainError`].
pub fn finished(
    ctx: &Context,
    folder: &Path,
    fitted: InvertResult,
    models: &[&StoredModel],
) -> Result<InvertResult, ChainError> {
    let judge = OnModels::new(ctx, models);
    let cost = |map: &dyn FeedforwardMap| match ctx.watch.interrupted() {
        true => f64::INFINITY,
        false => judge.cost(map),
    };
    let leader = ctx.channels.driven.first().copied().unwrap_or(0);
    let tuned = |map: StoredMap| {
        let tuned = judge.tells().then(|| map.tuned(&cost, leader)).flatten();
        tuned.unwrap_or(map)
    };
    let one_lag = judge.tells().then(|| fitted.dynamic.lagged(&cost, leader)).flatten();
    let dynamic = tuned(fitted.dynamic);
    let mut points = at_rest::measured(ctx, folder, &*dynamic)?;
    let dynamic = led(ctx, at_rest::anchored(dynamic, points.as_mut()), models, leader)?;
    // Rounded last, and so as it is compared: what is delivered is what was judged.
    let rounded = |m: StoredMap| m.rounded().unwrap_or(m);
    let dynamic = rounded(dynamic);
    let one_lag = one_lag.map(|m| rounded(at_rest::anchored(m, points.clone().as_mut())));
    let rivals = fitted.rivals.into_iter();
    let rivals = rivals.map(|m| at_rest::anchored(tuned(m), points.clone().as_mut())).collect();
    Ok(InvertResult { dynamic, rivals, one_lag, at_rest: points, ..fitted })
}

/// Where fuel is given by measured states no lambda waits for the throttle: where it is asked for it goes ahead of its rest, so that the
/// manifold is filled sooner, within the openings that the identification saw. As the models say, with the injection that the identified
/// manifold makes of it.
fn led(
    ctx: &Context,
    map: StoredMap,
    models: &[&StoredModel],
    leader: usize,
) -> Result<StoredMap, ChainError> {
    if !ctx.spec.fuelling.as_ref().is_some_and(|f| f.lead) {
        return Ok(map);
    }
    let fuelled = Fuelled::of(ctx)?;
    let Some(fuelled) = fuelled.as_ref() else { return Ok(map) };
    let judge = OnModels::new(ctx, models);
    let judge = match fuelled.on_model() {
        // Models of engine and fuelling as one plant know what boost and cams do.
        _ if ctx.governs().is_some() => judge,
        Some(fuel) => judge.fuelled(fuel),
        None => {
            ctx.watch.note(
                "fuelling.lead: the throttle acts at once, as no model of the manifold knows boost or cams",
            );
            return Ok(map);
        }
    };
    let within = fuelled.seen_deg();
    let cost = |map: &dyn FeedforwardMap| match ctx.watch.interrupted() {
        true => f64::INFINITY,
        false => judge.cost(map),
    };
    Ok(map.led(&cost, leader, within).unwrap_or(map))
}

fn pairs_of(
    ctx: &Context,
    record: &Dataset,
    simulated: bool,
    models: &[&StoredModel],
) -> Result<Record, ChainError> {
    let (mut response, mut actuators) = (ctx.channels.references(record)?, ctx.channels.actuators(record)?);
    if simulated {
        // Noise in the regressors biases an inverse towards zero; the model's free run has none.
        for (k, demand) in ctx.channels.demands.iter().enumerate() {
            let Some(model) = models.iter().find(|m| m.user_output().name == *demand) else { continue };
            let played = ctx.governs().map(|by| as_played(record, by));
            let record = played.as_ref().unwrap_or(record);
            if let Some(run) = model.simulate(record, None)?.into_iter().next() {
                response.set_column(k, &run.y);
            }
        }
    }
    let n = response.len().saturating_sub(END_EFFECT);
    response.truncate(n);
    actuators.truncate(n);
    Ok((response, actuators))
}
