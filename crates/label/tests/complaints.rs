//! What users of tuning tools complain about: parts of a log that spoil a table, planted, must not.

mod planted;

use dynocal_label::label::Label;
use dynocal_label::linear::Verdict;
use dynocal_label::ve::sensor::Sensor;
use dynocal_label::ve::{Keys, Log, run};
use planted::planted;

/// Root mean square of the table less the truth, in counts, over cells that data reach, and how many these are.
fn off(label: &Label, truth: &[f64], log: &Log) -> (f64, usize) {
    // The sensor of the planted log: what is compared is the table.
    let sensor = Sensor { delay_s: 0.2, flow_delay_s: 0.15, lag_s: 0.25 };
    let found =
        run(label, std::slice::from_ref(log), &Keys { sensor: Some(sensor), ..Keys::default() }, &|_| ());
    let t = found.unwrap().table;
    let told: Vec<usize> = (0..truth.len()).filter(|k| t.verdicts[*k] != Verdict::Untouched).collect();
    let square: f64 = told.iter().map(|k| (t.exact[*k] - truth[*k]).powi(2)).sum();
    ((square / told.len() as f64).sqrt(), told.len())
}

/// What is done to a log.
type Spoil = fn(&mut Log);

/// Stretches of `length` samples, every `every`.
fn stretches(log: &Log, every: usize, length: usize) -> Vec<std::ops::Range<usize>> {
    (200..log.time_s.len() - length).step_by(every).map(|k| k..k + length).collect()
}

/// Fuel is cut for 1.5 s; the sensor sees air 0.4 s later, and for 1 s after fuel is back.
fn cut(log: &mut Log) {
    for s in stretches(log, 400, 22) {
        log.pulse_ms[s.clone()].fill(0.0);
        log.lambda[s.start + 6..s.end + 15].fill(1.9);
    }
}

/// The ECU enriches by 20 % for 4 s, and says so.
fn enrichment(log: &mut Log) {
    let mut flags = vec![false; log.time_s.len()];
    for s in stretches(log, 500, 60) {
        flags[s.clone()].fill(true);
        log.lambda[s.start + 6..s.end].iter_mut().for_each(|l| *l *= 0.8);
    }
    log.enriching = Some(flags);
}

/// The sensor warms up for a minute and says 0.
fn warm_up(log: &mut Log) {
    log.lambda[..900].fill(0.0);
}

/// The sensor is stuck for half a minute, four times.
fn stuck(log: &mut Log) {
    stretches(log, 3000, 450).into_iter().for_each(|s| log.lambda[s].fill(0.75));
}

/// The sensor is at its rail for two seconds, often.
fn rail(log: &mut Log) {
    stretches(log, 300, 30).into_iter().for_each(|s| log.lambda[s].fill(1.735));
}

/// The engine is cold, and rich, for two minutes.
fn cold(log: &mut Log) {
    log.coolant_c = Some((0..log.time_s.len()).map(|k| if k < 1800 { 40.0 } else { 90.0 }).collect());
    log.lambda[..1790].iter_mut().for_each(|l| *l *= 0.8);
}

#[test]
fn what_spoils_a_table_is_left_out() {
    let (label, truth, log) = planted(1, 0.15);
    let (clean, cells) = off(&label, &truth, &log);
    println!("as it is: {clean:.3} counts in {cells} cells");
    let spoils: [(&str, Spoil); 6] = [
        ("fuel cut", cut),
        ("enrichment", enrichment),
        ("sensor warms up", warm_up),
        ("sensor stuck", stuck),
        ("sensor at its rail", rail),
        ("engine cold", cold),
    ];
    for (name, spoil) in spoils {
        let mut spoilt = log.clone();
        spoil(&mut spoilt);
        let (found, told) = off(&label, &truth, &spoilt);
        println!("{name}: {found:.3} counts in {told} cells");
        assert!(found < 1.5 * clean && told as f64 > 0.7 * cells as f64, "{name}: {found} in {told} cells");
    }
    // Without what the log says of them the same samples do spoil it.
    for (name, spoil) in &spoils[1..2] {
        let mut spoilt = log.clone();
        spoil(&mut spoilt);
        spoilt.enriching = None;
        let (found, _) = off(&label, &truth, &spoilt);
        println!("{name}, not said: {found:.3} counts");
        assert!(found > 2.0 * clean, "{name}: {found}");
    }
}
