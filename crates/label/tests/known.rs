//! Functions of a real ECU whose labels are known, because the log carries its tune.

use std::path::Path;

use dynocal_export::tune::msq::Tune;
use dynocal_files::measurement::mlg::Mlg;
use dynocal_files::measurement::recording;
use dynocal_files::table::Cells;
use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{Options, Problem, Verdict, fit};
use dynocal_label::nonlinear::{self, Target};
use dynocal_label::rows::Rows;
use dynocal_label::truncated;

struct Drive {
    tune: Tune,
    time_s: Vec<f64>,
    columns: Vec<(String, Vec<f64>)>,
}

impl Drive {
    fn read(name: &str) -> Option<Self> {
        let Ok(dir) = std::env::var("DYNOCAL_REFERENCE_DIR") else {
            println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
            return None;
        };
        let mlg = Mlg::open(&Path::new(&dir).join("data/open_ecu").join(format!("{name}.mlg"))).unwrap();
        let tune = Tune::parse(name, mlg.tune().unwrap().to_vec()).unwrap();
        let raster = recording(&mlg).unwrap().rasters.remove(0);
        let numbers = |c: &Cells| match c {
            Cells::Number(v) => v.clone(),
            Cells::Text(_) => Vec::new(),
        };
        let columns = raster.columns.iter().map(|c| (c.name.clone(), numbers(&c.cells))).collect();
        Some(Self { tune, time_s: raster.time_s, columns })
    }

    fn channel(&self, name: &str) -> &[f64] {
        &self.columns.iter().find(|c| c.0 == name).unwrap().1
    }

    fn label(&self, name: &str) -> Vec<f64> {
        self.tune.constant(name).unwrap().values.clone()
    }
}

/// Pulse width = factor x reqFuel x VE x MAP x correction + dead time(battery).
#[test]
fn the_pulse_width_gives_factor_and_dead_time_back() {
    let Some(d) = Drive::read("2025-12-02_10.58.15o") else { return };
    let required = d.label("reqFuel")[0];
    let labels = vec![Label::scalar("FACTOR", "-", 1.0), Label::scalar("DEAD", "ms", 0.5)];
    let node = |name: &str, op| Node { name: name.into(), op };
    let graph = Graph {
        nodes: vec![
            node("ve", Op::Channel(0)),
            node("map", Op::Channel(1)),
            node("gamma", Op::Channel(2)),
            node("percent", Op::Constant(1e-6 * required)),
            node("factor", Op::Label(0, vec![])),
            node("dead", Op::Label(1, vec![])),
            node("fuel", Op::Multiply(vec![0, 1, 2, 3, 4])),
            node("pulse", Op::Add(vec![6, 5])),
        ],
        labels,
    };
    let (pw, gamma, clt) = (d.channel("PW"), d.channel("Gammae"), d.channel("CLT"));
    let transient = d.channel("Accel Enrich");
    // Warm, no enrichment, fuel injected.
    let weights: Vec<f64> = (0..pw.len())
        .map(|k| {
            f64::from(u8::from(pw[k] > 0.0 && gamma[k] == 100.0 && transient[k] == 100.0 && clt[k] >= 71.0))
        })
        .collect();
    let record = Record { time_s: &d.time_s, channels: vec![d.channel("VE1"), d.channel("MAP"), gamma] };
    let target = Target { record, node: None, y: pw, weights: &weights };
    let found = nonlinear::fit(&graph, &[target], &Options::default(), &|| false).unwrap();
    let v = &found.fit.values;
    // What the tune says: half of the required fuel in each of two squirts, the dead time with its battery curve.
    let (bins, rates) = (d.label("brvBins"), d.label("injBatRates"));
    let curve = Label::curve("c", "%", "V", "V", &bins, &rates);
    let volts: Vec<f64> =
        (0..pw.len()).filter(|k| weights[*k] > 0.0).map(|k| d.channel("Battery V")[k]).collect();
    let mean: f64 = volts.iter().map(|u| curve.value(&rates, &[*u])).sum::<f64>() / volts.len() as f64;
    let dead = d.label("injOpen")[0] * mean / 100.0;
    println!(
        "{} samples: factor {:.5} (0.5), dead time {:.4} ms ({dead:.4}), rms {:.2} us",
        volts.len(),
        v[0],
        v[1],
        1000.0 * found.fit.rms[1]
    );
    assert!((v[0] / 0.5 - 1.0).abs() < 0.005, "factor {}", v[0]);
    assert!((v[1] - dead).abs() < 0.03, "dead time {} for {dead}", v[1]);
    assert!(found.fit.rms[1] <= 0.004, "rms {} ms", found.fit.rms[1]);
}

/// The fuel table of a drive, of which nothing is known before; what the tune says; rows and values of its look-ups, cut to whole numbers:
/// rows of the ECU's own arithmetic, or of plain interpolation.
fn look_ups(d: &Drive, eight_bits: bool) -> (Label, Vec<f64>, Rows, Vec<f64>) {
    let base = d.label("veTable");
    let axes = vec![
        Axis::new("RPM", "rpm", &d.label("rpmBins")),
        Axis::new("load", "kPa", &d.label("fuelLoadBins")),
    ];
    let label = Label::new("veTable", "%", axes, &vec![50.0; base.len()]);
    let (rpm, load, ve) = (d.channel("RPM"), d.channel("FuelLoad"), d.channel("VE1"));
    let (mut rows, mut cut) = (Rows::default(), Vec::new());
    for k in (0..ve.len()).filter(|k| ve[*k] > 0.0 && rpm[*k] > 0.0) {
        rows.start();
        match eight_bits {
            true => truncated::enter_eight_bits(&label, &mut rows, 0, &[rpm[k], load[k]]),
            false => label.enter(&mut rows, 0, 1.0, &[rpm[k], load[k]]),
        }
        cut.push(ve[k]);
    }
    (label, base, rows, cut)
}

/// All logs with a tune, and whether it is the one in use: where it is not, cells differ by whole counts from the first minute to the last.
const LOGS: [(&str, bool); 5] = [
    ("2025-12-02_10.08.37", true),
    ("2025-12-02_10.54.12", false),
    ("2025-12-02_10.58.15o", false),
    ("2025-12-08_15.52.00", true),
    ("2026-02-28_17.53.41", true),
];

/// Samples that a table explains: the look-up lies in the interval that the logged value leaves.
fn explained(rows: &Rows, cut: &[f64], table: &[f64]) -> usize {
    let off = |k: &usize| rows.times(*k, table) - cut[*k];
    (0..cut.len()).filter(|k| (-1e-6..1.0 + 1e-6).contains(&off(k))).count()
}

/// VE1 is the look-up of the ECU's own arithmetic cut to a whole number: one table explains every sample of every log. Where the tune in
/// the log explains them too it comes back; where it does not, the table in use was another one, and for each determined cell that is
/// more than one count off no table with the tune's value explains the log.
#[test]
fn a_known_table_comes_back_from_its_look_ups() {
    let by = truncated::Cut { step: 1.0, slack: 0.0 };
    let mut all = [0; 2];
    for (name, in_use) in LOGS {
        let Some(d) = Drive::read(name) else { return };
        let (label, tune, rows, cut) = look_ups(&d, true);
        let table = truncated::fit(&label, &rows, &cut, by).unwrap();
        assert_eq!(explained(&rows, &cut, &table), cut.len(), "{name}");
        let by_tune = explained(&rows, &cut, &tune);
        assert_eq!(by_tune == cut.len(), in_use, "{name}: {by_tune} of {}", cut.len());
        let y: Vec<f64> = cut.iter().map(|c| c + 0.5).collect();
        let problem = Problem::new(std::slice::from_ref(&label), &rows, &y);
        let plain = fit(&problem, &Options { smooth: Some(1e-9), ..Options::default() }).unwrap();
        let told: Vec<usize> = (0..256)
            .filter(|k| plain.verdicts[*k] == Verdict::Determined && plain.half_width[*k] < 0.5)
            .collect();
        let (near, far): (Vec<usize>, Vec<usize>) =
            told.iter().partition(|k| (table[**k] - tune[**k]).abs() <= 1.0);
        let ruled_out = |k: &&usize| {
            let mut label = label.clone();
            (label.base[**k], label.locked[**k]) = (tune[**k], true);
            truncated::fit(&label, &rows, &cut, by).map_or(true, |t| explained(&rows, &cut, &t) < cut.len())
        };
        let out = far.iter().filter(ruled_out).count();
        println!(
            "{name}: the tune explains {by_tune} of {} samples, one table all; {} of {} determined cells within one count, {out} ruled out",
            cut.len(),
            near.len(),
            told.len()
        );
        assert!(!in_use || out == 0, "{name}");
        all = [all[0] + near.len(), all[1] + told.len() - out];
    }
    println!("{} of {} cells of which the tune may be the truth", all[0], all[1]);
    assert!(all[1] >= 100 && all[0] as f64 >= 0.95 * all[1] as f64, "{all:?}");
}

/// With weights that are not cut to eight bits no table explains a whole log: its first part, as far as one does, ends early.
#[test]
fn without_the_arithmetic_of_the_ecu_one_table_does_not_explain_a_log() {
    for (name, _) in LOGS.iter().filter(|l| l.1) {
        let Some(d) = Drive::read(name) else { return };
        let (label, tune, rows, cut) = look_ups(&d, false);
        let by = truncated::Cut { step: 1.0, slack: 0.0 };
        let (samples, table) = truncated::longest(&label, &rows, &cut, by).unwrap();
        println!("{name}: {samples} of {} samples; the tune {}", cut.len(), explained(&rows, &cut, &tune));
        assert!(samples < cut.len() && explained(&rows, &cut, &tune) < cut.len(), "{name}");
        let kept =
            (0..samples).filter(|k| (-0.01..=1.01).contains(&(rows.times(*k, &table) - cut[*k]))).count();
        assert_eq!(kept, samples, "{name}");
    }
}

/// Look-ups of a planted table, cut: least squares take what was cut off for noise.
#[test]
fn a_planted_table_comes_back_from_cut_look_ups() {
    let axis = [0.0, 1.0, 2.0, 3.0, 4.0];
    let truth: Vec<f64> = (0..25).map(|k| 40.0 + 3.7 * (k % 5) as f64 + 2.3 * (k / 5) as f64).collect();
    let label =
        Label::new("T", "%", vec![Axis::new("x", "-", &axis), Axis::new("y", "-", &axis)], &[50.0; 25]);
    let mut rng = dynocal_numerics::rng::Rng64::new(1);
    let (mut rows, mut cut) = (Rows::default(), Vec::new());
    for _ in 0..1500 {
        let at = [rng.uniform_in(0.0, 4.0), rng.uniform_in(0.0, 4.0)];
        rows.start();
        label.enter(&mut rows, 0, 1.0, &at);
        cut.push(label.value(&truth, &at).floor());
    }
    let by = truncated::Cut { step: 1.0, slack: 0.0 };
    let found = truncated::fit(&label, &rows, &cut, by).unwrap();
    let middle: Vec<f64> = cut.iter().map(|c| c + 0.5).collect();
    let problem = Problem::new(std::slice::from_ref(&label), &rows, &middle);
    let plain = fit(&problem, &Options { smooth: Some(0.0), ..Options::default() }).unwrap();
    let worst = |v: &[f64]| v.iter().zip(&truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let outside = |v: &[f64]| {
        let off = |k: usize| rows.times(k, v) - cut[k];
        (0..cut.len()).filter(|k| !(-1e-9..=1.0 + 1e-9).contains(&off(*k))).count()
    };
    println!("{} of {} samples outside with least squares", outside(&plain.exact), cut.len());
    // Both are near; only one is a table that the ECU can have had.
    assert!(worst(&found) < 0.3 && worst(&plain.exact) < 0.3, "{} {}", worst(&found), worst(&plain.exact));
    assert!(outside(&found) == 0 && outside(&plain.exact) > 10);
    // A cell that changes half way: as many samples as before the first that shows it.
    let mut edited = cut.clone();
    edited[900..].iter_mut().for_each(|c| *c += 5.0);
    assert!(truncated::fit(&label, &rows, &edited, by).unwrap_err().to_string().contains("cut to"));
    let (samples, _) = truncated::longest(&label, &rows, &edited, by).unwrap();
    assert!((900..=905).contains(&samples), "{samples}");
}
