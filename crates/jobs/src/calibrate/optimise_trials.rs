//! Iterative learning on the plant: an optimum that the plant does not follow as demanded is corrected by what was missed, and played
//! again over the same record.
//!
//! With r the references, e = demand - measured and R the rule that start records are driven by, which is an approximate inverse of the
//! plant, the inputs of the loops become
//!
//! ```text
//! u  +  what the loops added, smoothed  +  g (R(r + smoothed(e)) - R(r)),        g = 0.6
//! ```
//!
//! smoothed forwards and backwards, so that nothing is shifted and what the rule does not know of fast dynamics is left alone (S. Arimoto,
//! S. Kawamura, F. Miyazaki, J. Robot. Syst. 1, 1984, 123-140, with the filter of no phase that makes learning robust). Inputs that no loop
//! drives stay those of the optimum, and so does what was promised. Taking what the models lack into the search itself was tried: demands
//! that no smooth input gives are met by inputs that jump from limit to limit.

use super::context::Context;
use super::error::ChainError;
use super::optimise_miss::{Miss, misses, share};
use super::optimise_start::{smoothed, start_rule};
use super::records::{RecordRef, save_records};
use dynocal_calib::map::Rows;
use dynocal_calib::map::start::{StartRule, rate_limited};
use dynocal_calib::optimise::Optimum;
use dynocal_ident::data::Dataset;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Share of what was missed that a trial takes back.
const GAIN: f64 = 0.6;

/// An optimum as it was played: inputs that were asked for, and what the plant made of them.
pub(super) struct Played {
    pub(super) inputs: Vec<Vec<f64>>,
    pub(super) run: Dataset,
    pub(super) kept: RecordRef,
    pub(super) misses: Vec<Miss>,
}

/// A record of an optimum, and how far from its demands it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// The record.
    pub record: RecordRef,
    /// By output.
    pub misses: Vec<Miss>,
    /// Largest distance from a demand as a share of the one from which on a pass must not be used.
    pub share: f64,
}

impl Trial {
    fn of(ctx: &Context, played: &Played) -> Self {
        let (record, misses) = (played.kept.clone(), played.misses.clone());
        Self { share: share(ctx, &misses), record, misses }
    }
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

/// Learns as long as the plant is too far from what is demanded and the spec allows one more trial. The nearest record, and all of them in
/// order with the first one before them; none where there was no need.
///
/// # Errors
/// [`ChainError`]; a trial that had to be stopped, or in which a loop swung, ends the learning alone.
pub(super) fn learned(
    ctx: &Context,
    folder: &Path,
    asked: &Asked<'_>,
    first: Played,
) -> Result<(Played, Vec<Trial>), ChainError> {
    let (mut best, mut last) = (first, None);
    let mut trials = vec![Trial::of(ctx, &best)];
    let mut least = trials[0].share;
    if ctx.spec.optimise.trials == 0 || !too_far(least) {
        return Ok((best, Vec::new()));
    }
    let rule = start_rule(ctx, asked.data)?;
    while trials.len() <= ctx.spec.optimise.trials && too_far(least) {
        ctx.check_interrupt()?;
        let inputs = asked.corrected(ctx, &rule, last.as_ref().unwrap_or(&best))?;
        let name = format!("pass{}_trial{}", asked.pass, trials.len());
        let run = match (asked.hold)(name, inputs.clone()) {
            Ok(run) => run,
            Err(e @ (ChainError::Stopped { .. } | ChainError::Oscillates { .. })) => {
                ctx.watch.note(&format!("optimise.trials: no further trial of pass {}: {e}", asked.pass));
                break;
            }
            Err(e) => return Err(e),
        };
        let kept = save_records(folder, std::slice::from_ref(&run))?.remove(0);
        let misses = misses(ctx, asked.optimum, &run)?;
        let tried = Played { inputs, run, kept, misses };
        let trial = Trial::of(ctx, &tried);
        // What is no number is no nearer.
        let nearer = trial.share < least || least.is_nan();
        least = if nearer { trial.share } else { least };
        trials.push(trial);
        if nearer {
            (best, last) = (tried, None);
        } else {
            last = Some(tried);
        }
    }
    Ok((best, trials))
}

/// Whether a pass whose measured distance is so much must not be used.
pub(super) fn too_far(share: f64) -> bool {
    share.is_nan() || share > 1.0
}

impl Asked<'_> {
    /// The inputs of the next trial.
    fn corrected(&self, ctx: &Context, rule: &StartRule, last: &Played) -> Result<Vec<Vec<f64>>, ChainError> {
        let (channels, problem, dt) = (&ctx.channels, &ctx.spec.problem, ctx.spec.sample_time_s);
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
            let by_rule = after.column(c).into_iter().zip(before.column(c)).map(|(a, b)| GAIN * (a - b));
            let values = inputs[i].iter().zip(added).zip(by_rule);
            let values: Vec<f64> =
                values.map(|((u, a), r)| (u + a + r).clamp(input.lower, input.upper)).collect();
            inputs[i] = rate_limited(&values, input.rate_per_s.map_or(f64::INFINITY, |r| r * dt));
        }
        Ok(inputs)
    }
}
