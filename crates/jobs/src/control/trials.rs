//! What is promised at the tightest set point, run in time: each margin at 0.98 and at 1.02 of itself.

use dynocal_control::closed::Closed;
use dynocal_control::disk::{DiskMargin, Place};
use dynocal_control::error::ControlError;
use dynocal_control::margin::{Margins, Side};
use dynocal_control::perturb::{is_gain, perturbed, perturbed_loop};
use dynocal_control::system::{System, Time};
use dynocal_control::trial::{grows, later, louder, turned};
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;

use super::load::Loaded;
use super::loops::controller;
use super::result::{ControlJobError, LoopResult, RunCheck, Together};
use super::spec::Job;

/// Shares of a margin that are run, and whether the loop stands them.
const SHARES: [(f64, bool); 2] = [(0.98, true), (1.02, false)];
/// Least frequency of a run of a gain that is lost at rest, over that of the crossover: at rest itself there is no turn to wait for.
const SLOWEST: f64 = 0.1;

/// Where a disk margin acts.
#[derive(Clone, Copy)]
pub(super) enum DiskAt {
    /// On all loops at once.
    All(Place),
    /// On one loop, the others closed.
    One(Side, usize),
}

/// Disk margins beside the balanced ones of all loops: where, how it is called, and the skew.
pub(super) fn other_places(job: &Job) -> Vec<(String, DiskAt, f64)> {
    let several = job.loops.len() > 1;
    let mut out = Vec::new();
    for (place, name) in PLACES {
        for skew in [1.0, -1.0] {
            if several || place == Place::Outputs {
                out.push((name.into(), DiskAt::All(place), skew));
            }
        }
    }
    for (k, l) in job.loops.iter().enumerate().filter(|_| several) {
        out.push((format!("`{}` alone, at its input", l.output), DiskAt::One(Side::Inputs, k), 0.0));
        out.push((format!("`{}` alone, at its output", l.output), DiskAt::One(Side::Outputs, k), 0.0));
    }
    out
}

/// Places of all loops at once, by name.
const PLACES: [(Place, &str); 3] =
    [(Place::Inputs, "inputs"), (Place::Outputs, "outputs"), (Place::Both, "inputs and outputs")];

/// A loop that is run: what is put in, the loop, its critical frequency, whether it should be stable.
struct Trial {
    what: String,
    closed: Closed,
    w_rad_s: f64,
    stable: bool,
}

/// Runs of the tightest set point, and those that could not be run, with the reason.
pub(super) fn checks(
    job: &Job,
    loaded: &Loaded,
    loops: &[LoopResult],
    together: &[Together],
    watch: Watch,
) -> Result<(Vec<RunCheck>, Vec<String>), ControlJobError> {
    let tightness = |t: &Together| t.violation_nominal.unwrap_or(f64::INFINITY);
    let tightest =
        (0..together.len()).max_by(|a, b| tightness(&together[*a]).total_cmp(&tightness(&together[*b])));
    let Some(k) = tightest.filter(|k| !together[*k].loops.is_empty()) else {
        return Ok((Vec::new(), Vec::new()));
    };
    let p = &loaded.points[k];
    let refused = |source| ControlJobError::Point { point: p.name.clone(), source };
    let c = controller(job, loaded, loops, k).map_err(refused)?;
    let base = Closed::in_time(p.nominal.clone(), c);
    let trials = all(job, &base, &together[k]).map_err(refused)?;
    let fastest = crossovers(&together[k]).fold(0.0, f64::max);
    let run = |t: &Trial| (!watch.interrupted()).then(|| grows(&t.closed, t.w_rad_s, fastest));
    let grown: Vec<Option<Result<f64, ControlError>>> = trials.par_iter().map(run).collect();
    let (mut out, mut failed) = (Vec::new(), Vec::new());
    for (t, grown) in trials.into_iter().zip(grown) {
        match grown.ok_or(ControlJobError::Interrupted)? {
            Ok(growth) => {
                // A pole may only touch the boundary, as long delays have them.
                let island = || stable_by_frequencies(&t.closed.plant, &t.closed.controller);
                let expected_stable = t.stable || (growth < 0.0 && island());
                let what = if expected_stable == t.stable {
                    t.what
                } else {
                    format!("{} (an island: stable again there by its frequencies, too)", t.what)
                };
                let holds = (growth < 0.0) == expected_stable;
                out.push(RunCheck { point: p.name.clone(), what, growth, expected_stable, holds });
            }
            // A delay that is no whole number of samples cannot be run, nor what is slow beside what is fast.
            Err(e) => failed.push(format!("{}: {}: no run ({e})", p.name, t.what)),
        }
    }
    Ok((out, failed))
}

/// Frequencies at which the loops have a gain of 1.
fn crossovers(t: &Together) -> impl Iterator<Item = f64> {
    t.loops.iter().filter_map(|m| m.phase_rad_s)
}

/// Whether a plant under a controller is stable by its frequencies.
fn stable_by_frequencies(plant: &System, controller: &System) -> bool {
    Closed::new(plant.clone(), controller.clone()).is_ok_and(|c| c.is_stable())
}

fn all(job: &Job, base: &Closed, t: &Together) -> Result<Vec<Trial>, ControlError> {
    let mut out = Vec::new();
    for (k, (m, l)) in t.loops.iter().zip(&job.loops).enumerate() {
        of_loop(base, (Side::Outputs, k), m, &l.output, &mut out)?;
    }
    let several = job.loops.len() > 1;
    let crossover = crossovers(t).fold(f64::INFINITY, f64::min);
    for ((place, name), d) in PLACES.into_iter().zip([&t.inputs, &t.outputs, &t.both]) {
        let shown = several || place == Place::Outputs;
        if let Some(d) = d.as_ref().filter(|_| shown) {
            of_disk(base, DiskAt::All(place), (d, crossover), name, &mut out)?;
        }
    }
    for (name, at, skew) in other_places(job) {
        let found = t.other_disks.iter().find(|(n, d)| *n == name && d.skew == skew);
        if let Some((_, d)) = found {
            of_disk(base, at, (d, crossover), &name, &mut out)?;
        }
    }
    Ok(out)
}

/// Gain either way, phase and delay of one loop with the others closed.
fn of_loop(
    base: &Closed,
    at: (Side, usize),
    m: &Margins,
    output: &str,
    out: &mut Vec<Trial>,
) -> Result<(), ControlError> {
    let with = |plant: System| Closed::in_time(plant, base.controller.clone());
    for (share, stable) in SHARES {
        let mut add = |margin: &str, w: f64, closed: Closed| {
            let what = format!("{margin} margin of `{output}`, {share} of it");
            out.push(Trial { what, closed, w_rad_s: w, stable });
        };
        if let (Some(gain), Some(w)) = (m.gain_up, m.gain_up_rad_s) {
            add("gain", w, with(louder(&base.plant, at, gain * share)?));
        }
        if let (Some(gain), Some(w)) = (m.gain_down, m.gain_down_rad_s) {
            add(
                "lower gain",
                w.max(SLOWEST * m.phase_rad_s.unwrap_or(w)),
                with(louder(&base.plant, at, gain / share)?),
            );
        }
        if let (Some(phase), Some(w)) = (m.phase_deg, m.phase_rad_s) {
            add("phase", w, turned(base, at, (phase * share).to_radians())?);
        }
        if let (Some(delay_s), Some(w)) = (m.delay_s, m.delay_rad_s) {
            match (base.plant.time, later(&base.plant, at, delay_s * share, w)?) {
                (Time::Sampled { sample_time_s }, plant)
                    if stable_by_frequencies(&plant, &base.controller) != stable =>
                {
                    // What stands for part of a sample is late by something else at other frequencies: whole samples are exact.
                    let samples = delay_s / sample_time_s;
                    let whole = (samples - 1e-9).ceil() - if stable { 1.0 } else { 0.0 };
                    let plant = later(&base.plant, at, whole * sample_time_s, w)?;
                    let what = format!("delay margin of `{output}`, {whole} samples of {samples:.3}");
                    out.push(Trial { what, closed: with(plant), w_rad_s: w, stable });
                }
                (_, plant) => add("delay", w, with(plant)),
            }
        }
    }
    Ok(())
}

/// The guaranteed disk at 0.98, the lost one at 1.02, with the perturbation that was found.
fn of_disk(
    base: &Closed,
    at: DiskAt,
    (d, crossover_rad_s): (&DiskMargin, f64),
    name: &str,
    out: &mut Vec<Trial>,
) -> Result<(), ControlError> {
    let of = match d.skew {
        s if s > 0.0 => "disk margin of S",
        s if s < 0.0 => "disk margin of T",
        _ => "disk margin",
    };
    let at_all = if matches!(at, DiskAt::All(_)) { "at all " } else { "of " };
    // A gain that is lost at rest, as that of T of every loop that integrates.
    let at_rest = crossover_rad_s.is_finite() && d.perturbation.iter().all(|p| is_gain(*p));
    let w_rad_s = if at_rest { d.lost_rad_s.max(SLOWEST * crossover_rad_s) } else { d.lost_rad_s };
    let [guaranteed, lost] = SHARES;
    for (share, words, stable) in [
        (
            guaranteed.0 * d.alpha / d.alpha_lost,
            format!("{} of what is guaranteed", guaranteed.0),
            guaranteed.1,
        ),
        (lost.0, format!("{} of what is lost", lost.0), lost.1),
    ] {
        let plant = match at {
            DiskAt::All(place) => perturbed(&base.plant, place, d, share)?,
            DiskAt::One(side, k) => perturbed_loop(&base.plant, (side, k), d, share)?,
        };
        if let Some(plant) = plant {
            let closed = Closed::in_time(plant, base.controller.clone());
            out.push(Trial { what: format!("{of} {at_all}{name}, {words}"), closed, w_rad_s, stable });
        }
    }
    Ok(())
}
