//! What fourteen trials reach with the air path of ours: fuel learned on the judged tip-in itself, by the true mixture. No controller: it
//! says what mixture and emissions come to where lambda is all but held at 1; it bounds nothing.

use dynocal_calib::fuelling::{FuelPolicy, Learning};
use rayon::prelude::*;

use super::super::bed::SAMPLE_S;
use super::super::learned::{GAIN, HALF, LATE_CYCLES, SHORT, TRIALS};
use super::bed::{Course, MOST_MG};
use super::contest::{Contest, Known, Row, TIPS, tip};
use super::control::{Fuel, Setting};
use super::measures::TipIn;

/// Name of the row.
pub(super) const POSSIBLE: &str = "learned on the tip-in itself";

/// Learned fuel in all tip-ins; of the delays that are tried the one with the least integral counts.
pub(super) fn row(of: &Contest, known: &Known, setting: Setting) -> Result<Row, String> {
    let late = if of.reduced { &LATE_CYCLES[1..2] } else { &LATE_CYCLES[..] };
    let trials = if of.reduced { SHORT } else { TRIALS };
    let tries: Vec<(usize, f64)> =
        (0..TIPS.len()).flat_map(|k| late.iter().map(move |cycles| (k, *cycles))).collect();
    let one =
        |(k, cycles): &(usize, f64)| Ok((*k, learned(of, known, setting, &tip(TIPS[*k]), *cycles, trials)?));
    let found: Vec<(usize, TipIn)> = tries.par_iter().map(one).collect::<Result<_, String>>()?;
    let best = |k: usize| {
        let of_it = found.iter().filter(|f| f.0 == k).map(|f| f.1);
        let least = of_it.min_by(|a, b| a.integral_s.total_cmp(&b.integral_s));
        least.ok_or_else(|| "no delay was tried".to_string())
    };
    let tips = (0..TIPS.len()).map(best).collect::<Result<_, _>>()?;
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
