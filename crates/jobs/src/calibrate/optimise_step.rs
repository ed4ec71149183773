//! Step 4: optimise over a record made for it, measure the promise on the plant, identify again, repeat.

use super::context::{Context, Tone};
use super::error::ChainError;
use super::models::{ModelData, ModelsResult, identify_again, with_predecessors};
use super::optimise_miss::{Miss, misses};
use super::optimise_plan::{END_EFFECT, GaveWay, Planned, planned, within_reach};
use super::optimise_trials::{Asked, Learned, Played, learned};
use super::records::{RecordRef, all_measured, save_records};
use dynocal_calib::limits::{LimitScore, limit_scores};
use dynocal_calib::map::Port;
use dynocal_calib::problem::{CalibrationProblem, Metered, meter_name};
use dynocal_calib::validate::objective;
use dynocal_ident::data::{Channel, Dataset, UnitAfter};
use dynocal_numerics::status::Status;
use dynocal_report::with_unit;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

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
    /// Which of the records of references that were drawn is the one: over it the models found a way first. As many as were drawn
    /// where they found none.
    pub draws: usize,
    /// Demands that gave way to what the models can do; what was measured is compared with what was left of them.
    #[serde(default)]
    pub gave_way: Vec<GaveWay>,
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
    /// What learning on the plant came to, where it was too far from the demands; the nearest records of start and optimum count.
    #[serde(default)]
    pub learned: Learned,
    /// Limits of the problem against the measured optimum, from the first decided sample on.
    pub limits: Vec<LimitScore>,
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
        let enough = spec.within_points.is_some_and(|most| pass.usable && pass.missed_points().abs() <= most);
        passes.push(pass);
        if enough {
            break;
        }
    }
    let played: usize = passes.iter().map(|p: &Pass| p.learned.trials.len().max(1)).sum();
    let bed_s = 2.0 * played as f64 * (spec.record_s + ctx.spec.excite.lead_in_s);
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
    let Planned { start, optimum, draws, gave_way } = planned(ctx, k, &chosen, data)?;
    let start_inputs = columns(&start, &ctx.channels.inputs)?;
    let given = columns(&start, &ctx.channels.given)?;
    let values = |channels: &[Channel]| channels.iter().map(|c| c.values.clone()).collect::<Vec<_>>();
    let (demands, optimal) = (within_reach(ctx, &optimum), values(&optimum.inputs));
    let hold = |name: String, inputs: Vec<Vec<f64>>| {
        let plan = ctx.plan(&name, inputs, given.clone(), demands.clone(), Tone::Trim);
        ctx.measure_with(folder, &plan, true, &chosen)
    };
    let (start_run, optimum_run) = rayon::join(
        || hold(format!("pass{k}_start"), start_inputs.clone()),
        || hold(format!("pass{k}_optimum"), optimal.clone()),
    );
    let runs = all_measured(vec![start_run, optimum_run])?;
    let two = || ChainError::Design("a pass has two records".into());
    let [start_kept, kept] = <[RecordRef; 2]>::try_from(save_records(folder, &runs)?).map_err(|_| two())?;
    let [start_run, optimum_run] = <[Dataset; 2]>::try_from(runs).map_err(|_| two())?;
    let asked = Asked { pass: k, optimum: &optimum, given: &given, data, hold: &hold };
    let played = |inputs, run, kept| {
        Ok::<_, ChainError>(Played { misses: misses(ctx, &optimum, &run)?, inputs, run, kept })
    };
    let first = [played(start_inputs, start_run, start_kept)?, played(optimal, optimum_run, kept)?];
    let ([begun, reached], learned) = learned(ctx, folder, &asked, first)?;
    let (start_run, optimum_run) = (begun.run, reached.run);
    same_meters(ctx, &start_run, &optimum_run)?;
    let first = optimum.first;
    let (measured_start, measured) =
        (mean_objective(ctx, &start_run, first)?, mean_objective(ctx, &optimum_run, first)?);
    let mut pass = Pass {
        pass: k,
        status: optimum.status,
        iterations: optimum.iterations,
        draws,
        gave_way,
        start: optimum.start_objective,
        promised: optimum.objective,
        promised_ratio: optimum.objective / optimum.start_objective,
        measured_start,
        measured,
        measured_ratio: measured / measured_start,
        meters: ctx.spec.problem.meters(&optimum_run)?,
        misses: reached.misses,
        learned,
        limits: limit_scores(&ctx.spec.problem, &optimum_run, first)?,
        first,
        demands: demands.clone(),
        records: vec![begun.kept, reached.kept],
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
    let data = ModelData { identification: data, validation };
    pass.models = with_predecessors(ctx, identify_again(ctx, &place, models, &data)?, models, &data)?;
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
    /// Measured less promised ratio, in points.
    pub fn missed_points(&self) -> f64 {
        100.0 * (self.measured_ratio - self.promised_ratio)
    }

    /// Derived channels of the objective that no meter gave: they follow from the recorded inputs.
    pub fn unmetered(&self, problem: &CalibrationProblem) -> Vec<String> {
        let metered = |name: &String| self.meters.iter().any(|m| m.channel == *name);
        problem.meterable().into_iter().map(|d| d.name.clone()).filter(|name| !metered(name)).collect()
    }

    /// Decides whether the optimum may be used: the search ended well, demands are met on the models, something promised to
    /// save saved, and what was measured is near what was demanded.
    fn judge(&mut self, ctx: &Context) {
        let missed = self.misses.iter().find(|m| m.missed_on_models(ctx));
        let far = self.misses.iter().find(|m| m.is_far(ctx));
        self.reason = if let Some(m) = missed {
            let demanded = ctx.channels.demands.contains(&m.output);
            format!(
                "its {} {} by {:.2e}{} on the models",
                m.output,
                if demanded { "misses the demand" } else { "passes its limit" },
                m.violation.unwrap_or(f64::NAN),
                UnitAfter(&m.unit)
            )
        } else if !(self.measured_ratio.is_finite() && self.promised_ratio.is_finite()) {
            "what it costs is not a finite number".into()
        } else if costs_more(self.promised_ratio, self.measured_ratio) {
            format!(
                "it promised {:+.1} % against its start and measured {:+.1} %",
                100.0 * (self.promised_ratio - 1.0),
                100.0 * (self.measured_ratio - 1.0)
            )
        } else if let Some(l) = self.limits.iter().find(|l| !l.soft && l.passed()) {
            format!("measured, it passes {}", l.words())
        } else if let Some(m) = far {
            let (rms, mean) = (m.measured_rms.unwrap_or(f64::NAN), m.measured_mean.unwrap_or(f64::NAN));
            format!(
                "its measured {} is {} (RMS) from the demand, {} in the mean",
                m.output,
                with_unit(rms, 3, &m.unit),
                with_unit(mean, 2, &m.unit)
            )
        } else {
            String::new()
        };
        self.usable = self.reason.is_empty();
    }
}

/// Points between promise and measurement that are worth a warning, and from which on an optimum that costs more than its start must not be
/// used, whatever it promised.
pub(super) const MOST_GAP_POINTS: f64 = 1.5;

/// Whether an optimum costs as much as its start or more though it promised to save, or by more points than it promised to cost.
fn costs_more(promised_ratio: f64, measured_ratio: f64) -> bool {
    let points = 100.0 * (measured_ratio - promised_ratio);
    measured_ratio >= 1.0 && (promised_ratio < 1.0 || points > MOST_GAP_POINTS)
}

fn columns(record: &Dataset, names: &[String]) -> Result<Vec<Vec<f64>>, ChainError> {
    Ok(names.iter().map(|n| record.values(n).map(<[f64]>::to_vec)).collect::<Result<_, _>>()?)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// One that promised to save must; limits may make an optimum dearer than its start, but not by more than was said.
    #[test]
    fn an_optimum_that_costs_more_than_it_promised_is_none() {
        assert!(costs_more(0.95, 1.0) && costs_more(0.95, 1.2));
        assert!(!costs_more(0.95, 0.99));
        assert!(costs_more(1.001, 1.129));
        assert!(!costs_more(1.02, 1.03));
    }
}
