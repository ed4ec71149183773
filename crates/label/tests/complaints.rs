//! What users of tuning tools complain about: parts of a log that spoil a table, planted, must not.

mod planted;

use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{Options, Verdict};
use dynocal_label::nonlinear::{self, Target};
use dynocal_label::ve::sensor::Sensor;
use dynocal_label::ve::{Keys, Log, run};
use dynocal_numerics::rng::Rng64;
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

/// Two tables, the second in use where a condition holds, and a multiplier of it: a function with two labels finds both.
#[test]
fn a_second_fuel_table_comes_back_as_a_function() {
    let axes = || {
        vec![
            Axis::new("speed", "rpm", &[1000.0, 2000.0, 3000.0, 4000.0]),
            Axis::new("load", "kPa", &[30.0, 60.0, 100.0]),
        ]
    };
    let labels =
        vec![Label::new("VE1", "%", axes(), &[60.0; 12]), Label::new("VE2", "%", axes(), &[60.0; 12])];
    let node = |name: &str, op| Node { name: name.into(), op };
    let nodes = vec![
        node("speed", Op::Channel(0)),
        node("load", Op::Channel(1)),
        node("second", Op::Channel(2)),
        node("first table", Op::Label(0, vec![0, 1])),
        node("second table", Op::Label(1, vec![0, 1])),
        node("in use", Op::Switch(2, 4, 3)),
        node("fuel", Op::Multiply(vec![5, 1])),
    ];
    let graph = Graph { nodes, labels };
    let truth: Vec<f64> =
        (0..24).map(|k| 50.0 + 2.0 * (k % 12) as f64 + if k < 12 { 0.0 } else { 9.0 }).collect();
    let mut rng = Rng64::new(3);
    let n = 3000;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let mut drawn = |low: f64, high: f64| -> Vec<f64> { (0..n).map(|_| rng.uniform_in(low, high)).collect() };
    let (speed, load, second) = (drawn(1000.0, 4000.0), drawn(30.0, 100.0), drawn(-1.0, 1.0));
    let record = Record { time_s: &time_s, channels: vec![&speed, &load, &second] };
    let noise = drawn(-40.0, 40.0);
    let y: Vec<f64> = graph.values(&truth, &record).iter().zip(&noise).map(|(y, e)| y + e).collect();
    let weights = vec![1.0; n];
    let target = Target { record, node: None, y: &y, weights: &weights };
    let found = nonlinear::fit(&graph, &[target], &Options::default(), &|| false).unwrap().fit;
    let inside = (0..24).filter(|k| (found.exact[*k] - truth[*k]).abs() <= found.half_width[*k]).count();
    let worst = (0..24).map(|k| (found.exact[k] - truth[k]).abs()).fold(0.0, f64::max);
    println!("{inside} of 24 cells within their intervals, worst off by {worst:.2} counts");
    assert!(inside >= 20 && worst < 1.0, "{inside} {worst}");
}
