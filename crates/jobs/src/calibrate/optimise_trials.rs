//! Iterative learning on the plant: an optimum that the plant does not follow as demanded is corrected by what was missed, and played
//! again over the same record; so is the start that it is compared with, or what it saves would be torque that is not made.
//!
//! With r the references, e = demand - measured and R the rule that start records are driven by, which is an approximate inverse of the
//! plant, the inputs of the loops become
//!
//! ```text
//! u  +  what the loops added, smoothed  +  g (R(r + smoothed(e)) - R(r)),        g = 0.6
//! ```
//!
//! smoothed forwards and backwards, so that nothing is shifted and what the rule does not know of fast dynamics is left alone (S. Arimoto,
//! S. Kawamura, F. Miyazaki, J. Robot. Syst. 1, 1984, 123-140, with the filter of no phase that makes learning robust). Each trial begins
//! at the nearest record so far, with half of g after one that was no nearer. Inputs that no loop drives stay those of the optimum, and so
//! does what was promised. Taking what the models lack into the search itself was tried: demands that no smooth input gives are met by
//! inputs that jump from limit to limit.

use super::context::Context;
use super::error::ChainError;
use super::optimise_miss::{Miss, misses, share};
use super::optimise_start::{smoothed, start_rule};
use super::records::{RecordRef, all_measured, save_records};
use dynocal_calib::map::Rows;
use dynocal_calib::map::start::{StartRule, rate_limited};
use dynocal_calib::optimise::Optimum;
use dynocal_ident::data::Dataset;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Share of what was missed that a trial takes back.
const GAIN: f64 = 0.6;

/// Inputs that were asked for, and what the plant made of them.
pub(super) struct Played {
    pub(super) inputs: Vec<Vec<f64>>,
    pub(super) run: Dataset,
    pub(super) kept: RecordRef,
    pub(super) misses: Vec<Miss>,
}

/// A record and how far from its demands it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tried {
    /// The record.
    pub record: RecordRef,
    /// By output.
    pub misses: Vec<Miss>,
    /// Largest distance from a demand as a share of the one from which on a pass must not be used.
    pub share: f64,
}

/// The same record once more.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// With the inputs of the start.
    pub start: Tried,
    /// With those of the optimum.
    pub optimum: Tried,
}

impl Trial {
    /// What the models say of an optimum says nothing of its start.
    fn of(mut start: Tried, optimum: Tried) -> Self {
        start.misses.iter_mut().for_each(|m| m.violation = None);
        Self { start, optimum }
    }
}

/// What learning on the plant came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Learned {
    /// All trials in order, what was played before them as the first one; none where there was no need.
    pub trials: Vec<Trial>,
    /// Why it ended before its time; empty where it did not.
    pub ended: String,
}

/// What a pass asks for, over all of its trials.
pub(super) struct Asked<'a> {
    pub(super) pass: usize,
    pub(super) optimum: &'a Optimum,
    /// Given channels.
    pub(super) given: &'a [Vec<f64>],
    /// Records that the rule is fitted to.
    pub(super) data: &'a [(Dataset, PathBuf)],
    /// Plays inputs under a name, with the demands as the loops are asked to hold them.
    pub(super) hold: &'a (dyn Fn(String, Vec<Vec<f64>>) -> Result<Dataset, ChainError> + Sync),
}

/// One of the two that are learned: the nearest record so far, and the share of the next correction.
struct Side {
    best: Played,
    share: f64,
    gain: f64,
}

impl Side {
    fn new(ctx: &Context, best: Played) -> Self {
        Self { share: share(ctx, &best.misses), best, gain: GAIN }
    }

    fn tried(ctx: &Context, played: &Played) -> Tried {
        let (record, misses) = (played.kept.clone(), played.misses.clone());
        Tried { share: share(ctx, &misses), record, misses }
    }

    fn take(&mut self, ctx: &Context, played: Played) {
        let found = share(ctx, &played.misses);
        if found < self.share {
            (self.best, self.share) = (played, found);
        } else {
            self.gain *= 0.5;
        }
    }
}

/// Learns as long as the plant is too far from what is demanded of the optimum and the spec allows one more trial. The nearest records of
/// start and optimum, and all that was tried.
///
/// # Errors
/// [`ChainError`]; a trial that had to be stopped, or in which a loop swung, ends the learning alone.
pub(super) fn learned(
    ctx: &Context,
    folder: &Path,
    asked: &Asked<'_>,
    [start, optimum]: [Played; 2],
) -> Result<([Played; 2], Learned), ChainError> {
    let (mut start, mut optimum) = (Side::new(ctx, start), Side::new(ctx, optimum));
    let mut out = Learned::default();
    let most = ctx.spec.optimise.trials;
    if most > 0 && asked.worth(ctx, &optimum) && start.share.is_finite() {
        let first = [&start, &optimum].map(|s| Side::tried(ctx, &s.best));
        let [s, o] = first;
        out.trials.push(Trial::of(s, o));
        let rule = start_rule(ctx, asked.data)?;
        while out.trials.len() <= most && optimum.share > 1.0 {
            ctx.check_interrupt()?;
            let played = match asked.again(ctx, folder, &rule, [&start, &optimum], out.trials.len()) {
                Ok(played) => played,
                Err(e @ (ChainError::Stopped { .. } | ChainError::Oscillates { .. })) => {
                    out.ended = e.to_string();
                    break;
                }
                Err(e) => return Err(e),
            };
            let [s, o] = [&played[0], &played[1]].map(|p| Side::tried(ctx, p));
            if !(s.share.is_finite() && o.share.is_finite()) {
                out.ended = "what was measured is no number".into();
                break;
            }
            out.trials.push(Trial::of(s, o));
            let [s, o] = played;
            start.take(ctx, s);
            optimum.take(ctx, o);
        }
    }
    Ok(([start.best, optimum.best], out))
}

impl Asked<'_> {
    /// Whether learning could make an optimum usable: it is too far from a demand that the loops hold, and nothing that was measured could
    /// mend the rest.
    fn worth(&self, ctx: &Context, optimum: &Side) -> bool {
        let held = |m: &Miss| m.share(ctx) > 1.0 && !ctx.channels.demands.contains(&m.output);
        let misses = &optimum.best.misses;
        let lost = misses.iter().any(|m| m.missed_on_models(ctx) || held(m));
        optimum.share.is_finite() && optimum.share > 1.0 && !lost && self.optimum.objective.is_finite()
    }

    /// Trial number `k` of both.
    fn again(
        &self,
        ctx: &Context,
        folder: &Path,
        rule: &StartRule,
        sides: [&Side; 2],
        k: usize,
    ) -> Result<[Played; 2], ChainError> {
        let inputs = [self.corrected(ctx, rule, sides[0])?, self.corrected(ctx, rule, sides[1])?];
        let play = |of: &str, inputs: &Vec<Vec<f64>>| {
            (self.hold)(format!("pass{}_trial{k}_{of}", self.pass), inputs.clone())
        };
        let (start, optimum) = rayon::join(|| play("start", &inputs[0]), || play("optimum", &inputs[1]));
        let runs = all_measured(vec![start, optimum])?;
        let kept = save_records(folder, &runs)?;
        let mut played = Vec::new();
        for (((inputs, run), kept), side) in inputs.into_iter().zip(runs).zip(kept).zip(sides) {
            unlike(ctx, &run, &side.best.run)?;
            let misses = misses(ctx, self.optimum, &run)?;
            played.push(Played { inputs, run, kept, misses });
        }
        <[Played; 2]>::try_from(played).map_err(|_| ChainError::Design("a trial has two records".into()))
    }

    /// The inputs of the next trial.
    fn corrected(&self, ctx: &Context, rule: &StartRule, side: &Side) -> Result<Vec<Vec<f64>>, ChainError> {
        let (channels, problem, dt) = (&ctx.channels, &ctx.spec.problem, ctx.spec.sample_time_s);
        let last = &side.best;
        let free: Vec<&[f64]> = channels.free.iter().map(|&i| last.inputs[i].as_slice()).collect();
        let demands: Vec<&[f64]> = self.optimum.demands.iter().map(|d| d.values.as_slice()).collect();
        let wanted: Vec<Vec<f64>> = demands
            .iter()
            .zip(&self.optimum.demands)
            .map(|(asked, d)| {
                let missed = asked.iter().zip(last.run.values(&d.name)?).map(|(a, y)| a - y).collect();
                Ok(asked.iter().zip(smoothed(missed, dt)).map(|(a, e)| a + e).collect())
            })
            .collect::<Result<_, ChainError>>()?;
        let driven = |demands: &[&[f64]]| {
            let given = self.given.iter().map(Vec::as_slice);
            let all: Vec<&[f64]> = demands.iter().copied().chain(given).chain(free.iter().copied()).collect();
            rule.drive(&Rows::from_columns(&all))
        };
        let moved: Vec<&[f64]> = wanted.iter().map(Vec::as_slice).collect();
        let (before, after) = (driven(&demands), driven(&moved));
        let mut inputs = last.inputs.clone();
        for (c, &i) in channels.driven.iter().enumerate() {
            let input = &problem.inputs[i];
            let applied = last.run.values(&input.name)?;
            let added = smoothed(applied.iter().zip(&inputs[i]).map(|(a, u)| a - u).collect(), dt);
            let by_rule = after.column(c).into_iter().zip(before.column(c)).map(|(a, b)| side.gain * (a - b));
            let values = inputs[i].iter().zip(added).zip(by_rule);
            let values: Vec<f64> =
                values.map(|((u, a), r)| (u + a + r).clamp(input.lower, input.upper)).collect();
            inputs[i] = rate_limited(&values, input.rate_per_s.map_or(f64::INFINITY, |r| r * dt));
        }
        Ok(inputs)
    }
}

/// A bed's file that is the record before it, sample by sample, was never measured.
fn unlike(ctx: &Context, run: &Dataset, before: &Dataset) -> Result<(), ChainError> {
    if ctx.plants.is_some() || !same(&ctx.channels.demands, run, before) {
        return Ok(());
    }
    let outputs = ctx.channels.demands.join(", ");
    let fault = format!("it says of {outputs} what `{}` says: it was not measured anew", before.name);
    Err(ChainError::Record { measured: run.origin.clone(), plan: run.name.clone(), faults: vec![fault] })
}

/// Whether two records have the same values of all of these channels.
fn same(names: &[String], a: &Dataset, b: &Dataset) -> bool {
    names.iter().all(|n| matches!((a.values(n), b.values(n)), (Ok(a), Ok(b)) if a == b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::data::{Channel, Role};

    /// A copy is one in all demands; one sample in one of them makes it a record of its own.
    #[test]
    fn a_copied_record_is_told() {
        let channel = |name: &str, values: &[f64]| Channel {
            name: name.into(),
            unit: "-".into(),
            role: Role::Output,
            values: values.to_vec(),
        };
        let record = |lambda: &[f64]| Dataset {
            name: "record".into(),
            sample_time_s: 0.1,
            channels: vec![channel("torque", &[50.0, 51.0]), channel("lambda", lambda)],
            init_samples: 0,
            origin: "test".into(),
        };
        let names = ["torque".to_string(), "lambda".to_string()];
        assert!(same(&names, &record(&[1.0, 1.01]), &record(&[1.0, 1.01])));
        assert!(!same(&names, &record(&[1.0, 1.01]), &record(&[1.0, 1.02])));
    }
}
