//! The work: tune each loop in the plane, close all together, judge nominal models and draws, run what is promised.

use dynocal_control::closed::Closed;
use dynocal_control::disk::{DiskMargin, Place, disk, of_loop};
use dynocal_control::interaction::relative_gains;
use dynocal_control::margin::{Side, margins};
use dynocal_control::runtime::PidGains;
use dynocal_control::system::System;
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;

use super::gains::{one_loop, smaller_rules};
use super::load::{AtPoint, Loaded, load};
use super::loops::{apart_at_rest, controller};
use super::picture::{Picture, drawn};
use super::result::{ControlJobError, Controlled, LoopResult, RunCheck, Together};
use super::spec::{Job, Plants};
use super::trials::{DiskAt, checks, other_places};
use super::{decouple, deliver, words};
use crate::estimate::Estimate;

/// Growth of F from one look to the next, and most looks.
const DETUNE: (f64, usize) = (1.06, 80);

/// What the job will do, and what it takes.
///
/// # Errors
/// [`ControlJobError`]: models that cannot be read or do not fit.
pub fn estimate(job: &Job) -> Result<Estimate, ControlJobError> {
    deliver::grid(job)?;
    // Records are identified by the work itself: what it takes is told without.
    if let Plants::Records { .. } | Plants::Bed { .. } = &job.plants {
        let plan = Estimate::new(&job.name).line("run folder", job.out.display().to_string());
        let records = match &job.plants {
            Plants::Bed { plant, test, points } => format!(
                "tests of {} s about {} set points of `{}`, {} draws of each model",
                test.length_s,
                points.len(),
                plant.name,
                job.draws
            ),
            Plants::Records { files, .. } => {
                format!("{} records, {} draws of each model", files.len(), job.draws)
            }
            _ => String::new(),
        };
        return Ok(plan.line("plants", records).line("loops", job.loops.len().to_string()));
    }
    let loaded = load(&Job { draws: 0, ..job.clone() }, Watch::silent())?;
    let (loops, points) = (job.loops.len(), loaded.points.len());
    let kind = match &job.plants {
        Plants::Models { files, .. } => format!("{} stored models, {} draws", files.len(), job.draws),
        Plants::Given { .. } => "transfer functions".into(),
        Plants::Records { .. } | Plants::Bed { .. } => String::new(),
    };
    let frequencies: usize = loaded.points.iter().map(|p| frequencies(&p.nominal)).max().unwrap_or(0);
    let plan = Estimate::new(&job.name)
        .line("run folder", job.out.display().to_string())
        .line("plants", format!("{points} set points, {kind}"))
        .line("loops", format!("{loops}, about {frequencies} frequencies each"));
    let looks = 1000.0 * (loops * points * frequencies) as f64
        + 200.0 * (points * (job.draws + 1) * frequencies) as f64;
    let states = (points * (job.draws + 1) * loops * loops * frequencies * 64) as f64;
    Ok(plan.memory(states).work(60.0 * looks))
}

fn frequencies(plant: &System) -> usize {
    let pi = vec![PidGains::pi(1.0, 1.0).transfer(plant.time); plant.outputs];
    System::diagonal(plant.time, &pi).map_or(0, |c| dynocal_control::grid::frequencies(plant, &c).len())
}

/// Tunes and judges in memory.
///
/// # Errors
/// [`ControlJobError`]: models, set points, loops that no PI makes stable, an interruption.
pub fn control(job: &Job, watch: Watch) -> Result<Controlled, ControlJobError> {
    deliver::grid(job)?;
    watch.note("linear models of the set points");
    let loaded = load(job, watch)?;
    apart_at_rest(&loaded)?;
    let mut loops = Vec::new();
    let mut choices = Vec::new();
    for (k, l) in job.loops.iter().enumerate() {
        if watch.interrupted() {
            return Err(ControlJobError::Interrupted);
        }
        watch.fraction(0.1 + 0.6 * k as f64 / job.loops.len() as f64);
        watch.note(&format!("gains of the loop that holds `{}` by `{}`", l.output, l.input));
        let (found, choice) = one_loop(job, &loaded, k, l)?;
        loops.push(found);
        choices.push(choice);
    }
    watch.fraction(0.7);
    watch.note("all loops closed together");
    let (detuned, mut together) = close(job, &loaded, &mut loops, watch)?;
    if detuned > 1.0 {
        smaller_rules(&loaded, job, &mut loops)?;
    }
    super::settle::steps(job, &loaded, &loops, &mut together)?;
    watch.fraction(0.9);
    watch.note("runs that check the margins");
    let (checks, unchecked) = checks(job, &loaded, &loops, &together, watch)?;
    let picture = drawn(job, &loaded, &loops, choices)?;
    Ok(result(job, loaded, loops, detuned, together, (checks, unchecked), picture))
}

fn result(
    job: &Job,
    loaded: Loaded,
    loops: Vec<LoopResult>,
    detuned: f64,
    together: Vec<Together>,
    (checks, unchecked): (Vec<RunCheck>, Vec<String>),
    picture: Picture,
) -> Controlled {
    let relative =
        |p: &AtPoint| if job.loops.len() > 1 { relative_gains(&p.nominal, 0.0).ok() } else { None };
    let mut found = Controlled {
        verb: "control",
        name: job.name.clone(),
        valid: false,
        verdict: Vec::new(),
        warnings: loaded.warnings.clone(),
        asked: job.asked,
        disk_margin_asked: job.disk_margin,
        sample_time_s: loaded.time.sample_time_s(),
        points: loaded.points.iter().map(|p| p.name.clone()).collect(),
        beyond: loaded.beyond.clone(),
        draws: job.draws,
        detuned,
        schedule: job.schedule.clone(),
        decoupler: decouple::told(job, &loaded),
        measured: deliver::measured(job, &loaded, &loops),
        contradicted: Vec::new(),
        controller: deliver::controller(job, &loaded, &loops),
        relative_gains: loaded.points.iter().map(relative).collect(),
        loops,
        together,
        checks,
        unchecked,
        files: Vec::new(),
        picture,
    };
    found.contradicted = super::against::measured(&found);
    words::say(&mut found);
    found
}

/// Closes all loops; where they act on each other, gains that were searched shrink until everything is kept.
fn close(
    job: &Job,
    loaded: &Loaded,
    loops: &mut [LoopResult],
    watch: Watch,
) -> Result<(f64, Vec<Together>), ControlJobError> {
    let alone = loops.to_vec();
    let given = job.loops.iter().any(|l| l.gains.is_some());
    let mut detuned = 1.0;
    let mut first: Option<Vec<Together>> = None;
    for _ in 0..DETUNE.1 {
        if watch.interrupted() {
            return Err(ControlJobError::Interrupted);
        }
        for (l, a) in loops.iter_mut().zip(&alone) {
            // A predictor's PI cancels the pole of its model: both gains by the same factor go on doing so.
            let smaller = |(kp, ki): (f64, f64)| {
                (kp / detuned, ki / if l.predictor.is_some() { detuned } else { detuned * detuned })
            };
            (l.kp, l.ki) = smaller((a.kp, a.ki));
            l.kd = a.kd / detuned;
            l.by_point = a.by_point.iter().copied().map(smaller).collect();
        }
        let together = judge(job, loaded, loops)?;
        let kept = together.iter().all(|t| t.violation.is_some_and(|v| v <= 1.0));
        // One loop without a predictor is judged as it was searched; a predictor's margins at its output are not those of its undelayed loop.
        let as_searched = loops.len() == 1 && job.disk_margin == 0.0 && loops[0].predictor.is_none();
        if kept || given || as_searched {
            return Ok((detuned, together));
        }
        first.get_or_insert(together);
        detuned *= DETUNE.0;
    }
    // No smaller gains keep it: what the search gave stands, with what it keeps.
    loops.clone_from_slice(&alone);
    Ok((1.0, first.unwrap_or_default()))
}

/// All loops together at every set point, for the nominal model and the draws.
fn judge(job: &Job, loaded: &Loaded, loops: &[LoopResult]) -> Result<Vec<Together>, ControlJobError> {
    loaded
        .points
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let refused = |source| ControlJobError::Point { point: p.name.clone(), source };
            let c = controller(job, loaded, loops, k).map_err(refused)?;
            let each: Vec<Option<f64>> = p
                .draws
                .par_iter()
                .map(|s| violation(job, &Closed::new(s.clone(), c.clone()).ok()?))
                .collect();
            let closed = Closed::new(p.nominal.clone(), c).map_err(refused)?;
            Ok(at_point(job, &p.name, &closed, &each))
        })
        .collect()
}

fn at_point(job: &Job, name: &str, closed: &Closed, draws: &[Option<f64>]) -> Together {
    let state = closed.unstable();
    let own = violation(job, closed);
    let disk_at = |place| disk(closed, place, 0.0).ok();
    let all = draws.iter().copied().fold(own, |w, v| Some(w?.max(v?)));
    Together {
        point: name.into(),
        stable: state.words(),
        loops: (0..closed.plant.outputs).filter_map(|k| margins(closed, Side::Outputs, k).ok()).collect(),
        inputs: disk_at(Place::Inputs),
        outputs: disk_at(Place::Outputs),
        both: disk_at(Place::Both),
        other_disks: other_disks(job, closed),
        steps: Vec::new(),
        violation: all,
        violation_nominal: own,
        draws: draws.len(),
        unstable_draws: draws.iter().filter(|d| d.is_none()).count(),
    }
}

/// Skewed disk margins, and those of each loop alone; none where the loop is not stable.
fn other_disks(job: &Job, closed: &Closed) -> Vec<(String, DiskMargin)> {
    let of = |at, skew| match at {
        DiskAt::All(place) => disk(closed, place, skew),
        DiskAt::One(side, k) => of_loop(closed, side, k, skew),
    };
    other_places(job).into_iter().filter_map(|(name, at, skew)| Some((name, of(at, skew).ok()?))).collect()
}

/// Largest ratio of asked to had: each loop with the others closed, and the disk margin at inputs and outputs where one is asked.
fn violation(job: &Job, closed: &Closed) -> Option<f64> {
    let mut worst: f64 = 0.0;
    for k in 0..closed.plant.outputs {
        worst = worst.max(job.asked.violation(&margins(closed, Side::Outputs, k).ok()?));
    }
    if job.disk_margin > 0.0 {
        for place in [Place::Inputs, Place::Outputs] {
            worst = worst.max(job.disk_margin / disk(closed, place, 0.0).ok()?.alpha);
        }
    }
    Some(worst)
}
