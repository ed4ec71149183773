//! What is possible: fuel learned by trials on the judged record itself, by the true mixture.
//!
//! No controller: it is told what no sensor says, and it repeats the record that is judged. It says which ratios can be had.

use dynocal_calib::fuelling::{FuelPolicy, Learning};
use rayon::prelude::*;

use super::bed::{Course, MOST_MG, SAMPLE_S, Trace, play};
use super::contest::{Contest, Drive, Known, Row};
use super::measures::Measures;
use super::rivals::{Ours, Played};

/// Trials, and what the learning of the table of rivals does in each: gain, and samples on either side of a mean over 50 ms.
pub(super) const TRIALS: u64 = 14;
/// Trials at reduced length.
pub(super) const SHORT: u64 = 3;
pub(super) const GAIN: f64 = 0.6;
pub(super) const HALF: usize = 2;
/// Cycles from the command of an injection until its gas is in the exhaust manifold that are tried; the best one counts, by the
/// judged record: what is sought is the best that there is.
const LATE_CYCLES: [f64; 4] = [0.75, 1.0, 1.5, 2.0];
/// Trials after which the best of them goes on alone.
pub(super) const PROBED: u64 = 4;

/// What is learned on each of `count` records: with each delay over a few trials, then with the one of the least integral of lambda over all.
/// `one` learns on a record with a delay in cycles over so many trials. At reduced length one delay is tried.
pub(super) fn by_delay<T: Send>(
    count: usize,
    reduced: bool,
    one: impl Fn(usize, f64, u64) -> Result<T, String> + Sync,
    integral_s: impl Fn(&T) -> f64 + Sync,
) -> Result<Vec<T>, String> {
    if reduced {
        return (0..count).into_par_iter().map(|k| one(k, LATE_CYCLES[1], SHORT)).collect();
    }
    let tries: Vec<(usize, f64)> =
        (0..count).flat_map(|k| LATE_CYCLES.iter().map(move |cycles| (k, *cycles))).collect();
    let probed = |(k, cycles): &(usize, f64)| Ok(integral_s(&one(*k, *cycles, PROBED)?));
    let shown: Vec<f64> = tries.par_iter().map(probed).collect::<Result<_, String>>()?;
    let best = |k: usize| {
        let of_it = tries.iter().zip(&shown).filter(|((of, _), _)| *of == k);
        of_it.min_by(|a, b| a.1.total_cmp(b.1)).map_or(LATE_CYCLES[0], |(t, _)| t.1)
    };
    (0..count).into_par_iter().map(|k| one(k, best(k), TRIALS)).collect()
}

/// Learned fuel in all courses.
pub(super) fn row(of: &Contest<'_>, known: &Known, name: &str, preview: bool) -> Result<Row, String> {
    let one =
        |k: usize, cycles: f64, trials: u64| learned(of, known, &of.judged[k], preview, (cycles, trials));
    let courses = by_delay(of.judged.len(), of.stride > 1, one, |m: &Measures| m.integral_s)?;
    Ok(Row { name: name.into(), setting: format!("{} trials", trials(of)), search_s: 0.0, courses })
}

fn trials(of: &Contest<'_>) -> u64 {
    if of.stride > 1 { SHORT } else { TRIALS }
}

/// Begins with our fuel, and repeats the course with other disturbances each time; judged with those of all.
fn learned(
    of: &Contest<'_>,
    known: &Known,
    d: &Drive,
    preview: bool,
    (cycles, trials): (f64, u64),
) -> Result<Measures, String> {
    let learning = Learning { gain: GAIN, half: HALF, preview };
    let changes: Vec<usize> = std::iter::once(0).chain(d.course.switches.iter().copied()).collect();
    let late = |course: &Course, t: usize| (cycles * 120.0 / course.speed_rpm[t] / SAMPLE_S).round() as usize;
    let policy = FuelPolicy::new(known.fuelling.clone(), MOST_MG);
    let mut ours = Ours::new(of.base(0.0)?, policy, false);
    let seed = of.judged_seed();
    let mut trace: Trace = play(&d.bed, seed, &d.course, &mut ours).map_err(|e| e.to_string())?;
    let mut fuel = trace.injection_mg.clone();
    for trial in 1..=trials {
        let error: Vec<f64> = trace.true_lambda.iter().map(|l| l - 1.0).collect();
        learning.correct(&mut fuel, &error, |t| late(&d.course, t), &changes);
        fuel.iter_mut().for_each(|q| *q = q.clamp(0.0, MOST_MG));
        // The last one is judged, so it has the disturbances of all controllers.
        let seed = if trial < trials { seed + 1000 * trial } else { seed };
        let mut played = Played { base: of.base(0.0)?, injection_mg: &fuel, at: 0 };
        trace = play(&d.bed, seed, &d.course, &mut played).map_err(|e| e.to_string())?;
    }
    Ok(Measures::of(&trace, &d.course))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The delay whose few trials leave least goes on alone, for each record its own; at reduced length one is tried.
    #[test]
    fn the_best_delay_goes_on() {
        let wanted = [1.5, 0.75];
        let one = |k: usize, cycles: f64, trials: u64| Ok((k, cycles, trials));
        let left = |t: &(usize, f64, u64)| (t.1 - wanted[t.0]).abs();
        let full = by_delay(2, false, one, left).unwrap();
        assert_eq!(full, [(0, 1.5, TRIALS), (1, 0.75, TRIALS)]);
        assert_eq!(by_delay(1, true, one, left).unwrap(), [(0, LATE_CYCLES[1], SHORT)]);
        let failed = by_delay(1, false, |_, _, _| Err::<(usize, f64, u64), _>("stalled".to_string()), left);
        assert_eq!(failed.unwrap_err(), "stalled");
    }
}
