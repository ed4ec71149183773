//! What a pass of the optimisation plays: a record of references and the optimum over it, as the models have it.

use super::context::Context;
use super::error::ChainError;
use super::optimise_start::start_record;
use dynocal_calib::optimise::{DemandFrom, OptimiseOptions, Optimum, optimise_record};
use dynocal_calib::validate::inner;
use dynocal_ident::data::{Channel, Dataset};
use dynocal_ident::stored::StoredModel;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Largest violation of a demand at which an optimum counts as feasible, as a share of its range. It
/// is small beside what models and sensors are off by.
pub const VIOLATION: f64 = 1e-3;

/// Samples at the end of a record that count for nothing: what is applied there acts after the end, so that the optimum
/// leaves it out.
pub const END_EFFECT: usize = 12;

/// Records of references that are searched side by side, whatever the number of threads.
const ABREAST: usize = 2;
/// Rounds of quick searches before a long one.
const ROUNDS: usize = 3;
/// Steps (iterations, and those of restorations) of a quick search. Over most records a search ends within 30 to 70 of them, or not
/// in hundreds.
const QUICK_STEPS: usize = 150;

/// A record with its optimum.
pub(super) struct Planned {
    pub(super) start: Dataset,
    pub(super) optimum: Optimum,
    /// Records that were drawn.
    pub(super) draws: usize,
    /// What demands gave way; empty where they are met exactly.
    pub(super) gave_way: Vec<GaveWay>,
}

/// What a demand gave way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaveWay {
    /// Output.
    pub output: String,
    /// Root of the mean square of the change.
    pub rms: f64,
    /// Largest change.
    pub largest: f64,
}

/// The optimum over a record of references, with demands that give way where an exact search finds no end. The references only have
/// to lead through the operating range: one that the models do not reach is no loss, so that records are searched two by two and the
/// one whose search ends first is taken.
pub(super) fn planned(
    ctx: &Context,
    k: usize,
    models: &[&StoredModel],
    data: &[(Dataset, PathBuf)],
) -> Result<Planned, ChainError> {
    let spec = &ctx.spec.optimise;
    let options = OptimiseOptions {
        demand: DemandFrom::Within,
        max_iterations: spec.max_iterations,
        tolerance: spec.tolerance,
        smoothing: spec.smoothing,
        // What is missing where no way is found is not asked: another record is tried.
        explain: false,
        // What an optimum does because nobody looks beyond its end it does out of sight.
        extend_s: END_EFFECT as f64 * ctx.spec.sample_time_s,
        ..OptimiseOptions::default()
    };
    for round in 0..ROUNDS {
        let exact = Search { first: round * ABREAST, most_steps: QUICK_STEPS, options };
        if let Ended::Solved(found) = exact.run(ctx, k, models, data)? {
            return Ok(*found);
        }
    }
    let options = OptimiseOptions { give: spec.give, ..options };
    match (Search { first: 0, most_steps: usize::MAX, options }).run(ctx, k, models, data)? {
        Ended::Solved(found) => Ok(*found),
        Ended::Best(found) => Ok(Planned { draws: ROUNDS * ABREAST, ..*found }),
    }
}

/// Records that are searched side by side.
#[derive(Clone, Copy)]
struct Search {
    /// The first of [`ABREAST`] draws.
    first: usize,
    /// Steps after which a search ends.
    most_steps: usize,
    options: OptimiseOptions,
}

/// How searches side by side ended.
enum Ended {
    /// One of them holds its demands and limits on the models.
    Solved(Box<Planned>),
    /// None does; this one misses least.
    Best(Box<Planned>),
}

impl Search {
    fn run(
        &self,
        ctx: &Context,
        k: usize,
        models: &[&StoredModel],
        data: &[(Dataset, PathBuf)],
    ) -> Result<Ended, ChainError> {
        let race = Race::new();
        let mut found: Vec<Result<Planned, ChainError>> = (0..ABREAST)
            .into_par_iter()
            .map(|place| {
                let runner = race.runner(place, self.most_steps);
                let draw = self.first + place;
                let start = start_record(ctx, k, draw, models, data)?;
                let stop = || runner.step() || ctx.watch.interrupted();
                let mut optimum = optimise_record(&ctx.spec.problem, models, &start, &self.options, &stop)?;
                let gave_way = take_what_was_given(ctx, &mut optimum);
                if solved(ctx, &optimum) {
                    runner.arrived();
                }
                Ok(Planned { start, optimum, draws: draw + 1, gave_way })
            })
            .collect();
        ctx.check_interrupt()?;
        if let Some(first) = race.first() {
            return Ok(Ended::Solved(Box::new(found.swap_remove(first)?)));
        }
        let better = |a: Result<Planned, ChainError>, b: Result<Planned, ChainError>| match (&a, &b) {
            (Ok(p), Ok(q)) if worst(ctx, &q.optimum) < worst(ctx, &p.optimum) => b,
            (Err(_), Ok(_)) => b,
            _ => a,
        };
        Ok(Ended::Best(Box::new(found.into_iter().reduce(better).unwrap_or_else(nothing)?)))
    }
}

/// Largest change of a demand by what it gave way (RMS), as a share of its range: more is another task than the one that was set.
const MOST_GIVEN: f64 = 0.01;

/// Where demands gave way to a search that ended, what the models give at the optimum is demanded: references only have to lead
/// through the range, and start and optimum are measured about the same. What that changed; nothing where more gave way than may.
fn take_what_was_given(ctx: &Context, optimum: &mut Optimum) -> Vec<GaveWay> {
    if !optimum.status.is_success() {
        return Vec::new();
    }
    let gave = |d: &Channel| {
        let response = optimum.responses.iter().find(|r| r.name == d.name)?;
        let errors = || response.values.iter().zip(&d.values).skip(optimum.first).map(|(y, d)| y - d);
        let rms = (errors().map(|e| e * e).sum::<f64>() / errors().count().max(1) as f64).sqrt();
        let largest = errors().fold(0.0, |m: f64, e| m.max(e.abs()));
        (rms.is_finite() && largest > VIOLATION * range_of(ctx, &d.name)).then(|| GaveWay {
            output: d.name.clone(),
            rms,
            largest,
        })
    };
    let given: Vec<GaveWay> = optimum.demands.iter().filter_map(gave).collect();
    if given.iter().any(|g| g.rms > MOST_GIVEN * range_of(ctx, &g.output)) {
        return Vec::new();
    }
    for g in &given {
        let response = optimum.responses.iter().find(|r| r.name == g.output);
        let demand = optimum.demands.iter_mut().find(|d| d.name == g.output);
        if let (Some(response), Some(demand)) = (response, demand) {
            demand.values.clone_from(&response.values);
        }
        optimum.violations.retain(|v| v.channel != g.output || v.of != "demand");
    }
    given
}

fn nothing() -> Result<Planned, ChainError> {
    Err(ChainError::Design("no record of references was drawn".into()))
}

/// Whether a search ended, at a point that holds its demands and limits on the models.
fn solved(ctx: &Context, optimum: &Optimum) -> bool {
    optimum.status.is_success() && missed(ctx, optimum).is_none()
}

/// Searches side by side, of which the one that needs the fewest steps counts, the first of equals: the winner does not depend on
/// which of them happens to be computed sooner, and the others end once they have taken more steps than it.
struct Race {
    /// Steps of the fastest so far, and its place in the low digits.
    best: AtomicUsize,
}

/// Searches that a race tells apart.
const PLACES: usize = 16;

impl Race {
    fn new() -> Self {
        Self { best: AtomicUsize::new(usize::MAX) }
    }

    fn runner(&self, place: usize, most_steps: usize) -> Runner<'_> {
        debug_assert!(place < PLACES);
        Runner { race: self, place, most_steps, steps: AtomicUsize::new(0) }
    }

    /// Who won; none where nobody arrived.
    fn first(&self) -> Option<usize> {
        let best = self.best.load(Ordering::SeqCst);
        (best != usize::MAX).then_some(best % PLACES)
    }
}

/// One of a race.
struct Runner<'a> {
    race: &'a Race,
    place: usize,
    most_steps: usize,
    steps: AtomicUsize,
}

impl Runner<'_> {
    fn rank(&self) -> usize {
        self.steps.load(Ordering::SeqCst) * PLACES + self.place
    }

    /// Takes a step; whether it was one too many, or somebody has won already.
    fn step(&self) -> bool {
        let before = self.steps.fetch_add(1, Ordering::SeqCst);
        before >= self.most_steps || self.rank() > self.race.best.load(Ordering::SeqCst)
    }

    fn arrived(&self) {
        self.race.best.fetch_min(self.rank(), Ordering::SeqCst);
    }
}

/// The first output that misses its demand, or a limit, on the models.
fn missed(ctx: &Context, optimum: &Optimum) -> Option<String> {
    let soft = |output: &String| {
        ctx.spec.problem.limits.iter().any(|l| l.output == *output && l.soft_weight.is_some())
    };
    let of =
        |output: &String| !soft(output) && !(optimum.violation(output) <= VIOLATION * range_of(ctx, output));
    ctx.channels.outputs().into_iter().find(of)
}

/// The largest miss, as a share of the range of its demand.
fn worst(ctx: &Context, optimum: &Optimum) -> f64 {
    let outputs = ctx.channels.outputs();
    outputs.iter().map(|o| optimum.violation(o) / range_of(ctx, o)).fold(0.0, f64::max)
}

/// Range of the demand of an output, else the distance of its limits or the size of the one that it has; 1 where it has neither.
pub(super) fn range_of(ctx: &Context, output: &str) -> f64 {
    let problem = &ctx.spec.problem;
    let limit = problem.limits.iter().find(|l| l.output == output).map(|l| (l.lower, l.upper));
    let demanded = problem.demands.iter().find(|d| d.output == output).map(|d| d.upper - d.lower);
    let held = ctx.held().find(|h| h.0 == output).map(|(_, g)| g.upper - g.lower);
    match (demanded.or(held), limit) {
        (Some(range), _) => range,
        (None, Some((Some(lower), Some(upper)))) => upper - lower,
        (None, Some((lower, upper))) => {
            lower.or(upper).map(f64::abs).filter(|size| *size > 0.0).unwrap_or(1.0)
        }
        (None, None) => 1.0,
    }
}

/// Demands of an optimum as loops are asked to hold them: a search that found no way may end with short peaks far outside, which
/// nobody wants a plant to follow.
pub(super) fn within_reach(ctx: &Context, optimum: &Optimum) -> Vec<Vec<f64>> {
    let ranges = ctx.spec.problem.demands.iter().map(|d| inner((d.lower, d.upper), -BEYOND));
    let one = |(c, (lower, upper)): (&Channel, (f64, f64))| {
        c.values.iter().map(|v| v.clamp(lower, upper)).collect()
    };
    optimum.demands.iter().zip(ranges).map(one).collect()
}

/// Share of its range by which a demand may lie outside of it when it is played: as far as the optimisation lets it.
const BEYOND: f64 = 0.5;

#[cfg(test)]
mod tests {
    use super::*;

    /// Whoever is computed first: the least steps win, the first of equals, and who took more is told to stop.
    #[test]
    fn the_fewest_steps_win_in_any_order() {
        for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0], [0, 2, 1]] {
            let race = Race::new();
            for place in order {
                let runner = race.runner(place, 100);
                let needed = [30, 7, 7][place];
                if !(0..needed).any(|_| runner.step()) {
                    runner.arrived();
                }
            }
            assert_eq!(race.first(), Some(1), "{order:?}");
        }
        assert_eq!(Race::new().first(), None);
    }
}
