//! What fourteen trials reach with the air path of ours: fuel learned on the judged tip-in itself, by the true mixture. No controller: it
//! says what mixture and emissions come to where lambda is all but held at 1; it bounds nothing.

use dynocal_calib::fuelling::{FuelPolicy, Learning};

use super::super::bed::SAMPLE_S;
use super::super::learned::{GAIN, HALF, SHORT, TRIALS, by_delay};
use super::bed::{Course, MOST_MG};
use super::contest::{Contest, Known, Row, TIPS, tip};
use super::control::{Fuel, Setting};
use super::measures::TipIn;

/// Name of the row.
pub(super) const POSSIBLE: &str = "learned on the tip-in itself";

/// Learned fuel in all tip-ins.
pub(super) fn row(of: &Contest, known: &Known, setting: Setting) -> Result<Row, String> {
    let trials = if of.reduced { SHORT } else { TRIALS };
    let one = |k: usize, cycles: f64, trials: u64| learned(of, known, setting, &tip(TIPS[k]), cycles, trials);
    let tips = by_delay(TIPS.len(), of.reduced, one, |t: &TipIn| t.integral_s)?;
    Ok(Row { name: POSSIBLE.into(), words: format!("{trials} trials"), tips })
}

/// Begins with the fuel of the policy, and repeats the course with other disturbances each time; judged with those of all.
fn learned(
    of: &Contest,
    known: &Known,
    setting: Setting,
    course: &Course,
    cycles: f64,
    trials: u64,
) -> Result<TipIn, String> {
    let learning = Learning { gain: GAIN, half: HALF, preview: false };
    let changes: Vec<usize> = std::iter::once(0).chain(course.switches.iter().copied()).collect();
    let late = |t: usize| (cycles * 120.0 / course.speed_rpm[t] / SAMPLE_S).round() as usize;
    let played =
        |seed: u64, fuel: Fuel| of.played(seed, course, &mut of.driver(Some(&known.fuelling), setting, fuel));
    let policy = Box::new(FuelPolicy::new(known.fuelling.clone(), MOST_MG));
    let judged = of.judged_seed();
    let mut trace = played(judged, Fuel::Policy { policy, trimmed: false })?;
    let mut fuel = trace.injection_mg.clone();
    for trial in 1..=trials {
        let error: Vec<f64> = trace.true_lambda.iter().map(|l| l - 1.0).collect();
        learning.correct(&mut fuel, &error, late, &changes);
        fuel.iter_mut().for_each(|q| *q = q.clamp(0.0, MOST_MG));
        // The last one is judged, so it has the disturbances of all controllers.
        let seed = if trial < trials { judged + 1000 * trial } else { judged };
        trace = played(seed, Fuel::Played { injection_mg: fuel.clone(), at: 0 })?;
    }
    Ok(TipIn::of(&trace, course))
}
