//! The fuel table: on the logs of a real car, and on planted ones.

mod planted;

use std::path::Path;

use dynocal_export::tune::msq::Tune;
use dynocal_files::measurement::mlg::Mlg;
use dynocal_files::measurement::recording;
use dynocal_files::table::Cells;
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::Verdict;
use dynocal_label::ve::judge::{Decision, Reason};
use dynocal_label::ve::mask;
use dynocal_label::ve::sensor::Sensor;
use dynocal_label::ve::{Found, Keys, Log, run};
use planted::{planted, planted_with};

/// A log of the real car with the table that it carries.
fn real(name: &str) -> Option<(Label, Log)> {
    let Ok(dir) = std::env::var("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return None;
    };
    let path = Path::new(&dir).join("data/open_ecu").join(format!("{name}.mlg"));
    let mlg = Mlg::open(&path).unwrap();
    let tune = Tune::parse(name, mlg.tune().unwrap().to_vec()).unwrap();
    let of = |label: &str| tune.constant(label).unwrap().values.clone();
    let axes =
        vec![Axis::new("RPM", "rpm", &of("rpmBins")), Axis::new("FuelLoad", "kPa", &of("fuelLoadBins"))];
    let mut label = Label::new("veTable", "%", axes, &of("veTable"));
    (label.lower, label.upper, label.step) = (0.0, 255.0, Some(1.0));
    let raster = recording(&mlg).unwrap().rasters.remove(0);
    let column = |name: &str| -> Vec<f64> {
        match &raster.columns.iter().find(|c| c.name == name).unwrap().cells {
            Cells::Number(v) => v.clone(),
            Cells::Text(_) => panic!("numbers"),
        }
    };
    let engine = column("Engine");
    let log = Log {
        name: name.into(),
        speed_rpm: column("RPM"),
        load: column("FuelLoad"),
        ve: column("VE1"),
        enrichment: column("Gammae").iter().map(|g| g / 100.0).collect(),
        lambda: column("AFR").iter().map(|a| a / 14.7).collect(),
        target: vec![1.0; raster.time_s.len()],
        pulse_ms: column("PW"),
        coolant_c: Some(column("CLT")),
        throttle_rate: Some(column("TPS DOT")),
        enriching: Some(engine.iter().map(|e| (*e as u32) & (4 | 8 | 16) != 0).collect()),
        time_s: raster.time_s.clone(),
    };
    Some((label, log))
}

fn say(name: &str, f: &Found) {
    let j = &f.judgement;
    println!(
        "{name}: {:?}; sensor {:?}; as it was {:.2} %, nearest cell {:.2} %, fitted {:.2} % on {} unseen samples ({} unknown), z {:.1}, drift {:.3} +- {:.3}",
        j.decision,
        f.sensor,
        100.0 * j.rms_before,
        100.0 * j.rms_nearest,
        100.0 * j.rms_after,
        j.samples,
        j.unknown,
        j.improvement,
        j.drift[0],
        j.drift[1]
    );
    let count = |v: Verdict| f.judged.verdicts.iter().filter(|x| **x == v).count();
    println!(
        "   samples {:?}, left out {:?}; determined {}, pulled {}, untouched {}; tau {:.1}, smooth {:.2e}, train rms {:.2} %, proven {:?}, {} sensors",
        f.samples,
        f.left_out,
        count(Verdict::Determined),
        count(Verdict::Pulled),
        count(Verdict::Untouched),
        f.judged.correlation_samples,
        f.judged.smooth,
        100.0 * f.judged.rms[1],
        f.judged.proven,
        f.tried.len()
    );
}

/// Later parts of the same drives, in shares of lambda: the specification has 8.0, 7.9 and 1.9 % for its least squares on its own choice
/// of samples. On the third drive ours are other samples (the tune as it was is at 18.8 %, there at 21.0 %): only the rivals judge.
#[test]
fn later_parts_of_real_drives_are_explained_better() {
    let drives = [
        ("2025-12-02_10.08.37", Some(0.080)),
        ("2025-12-02_10.58.15o", Some(0.079)),
        ("2026-02-28_17.53.41", None),
    ];
    let mut bad = false;
    for (name, asked) in drives {
        let Some((label, log)) = real(name) else { return };
        let found = run(&label, &[log], &Keys::default(), &|_| ()).unwrap();
        say(name, &found);
        let j = &found.judgement;
        println!("   {:?}, worth {:.1}", j.reason, j.facts);
        // The third drive idles: its later samples hang together for so long that they are worth five.
        let few = j.reason == Reason::TooFew && asked.is_none();
        bad |= j.decision != Decision::Change && !few;
        bad |= !(j.rms_after < j.rms_before && j.rms_after < j.rms_nearest);
        bad |= !(asked.is_none_or(|a| j.rms_after <= a));
        let moved = |k: &usize| found.table.values[*k] != label.base[*k];
        let untouched = (0..label.len()).filter(|k| found.table.verdicts[*k] == Verdict::Untouched);
        assert_eq!(untouched.filter(moved).count(), 0, "{name}: an untouched cell moved");
    }
    assert!(!bad);
}

#[test]
fn a_planted_table_and_its_sensor_come_back() {
    let (label, truth, log) = planted(1, 0.15);
    let found = run(&label, &[log], &Keys::default(), &|_| ()).unwrap();
    say("planted", &found);
    assert_eq!(found.judgement.decision, Decision::Change);
    let s = found.sensor;
    assert!((s.delay_s - 0.2).abs() <= 0.1 && (s.lag_s - 0.25).abs() <= 0.1, "{s:?}");
    let t = &found.table;
    let told: Vec<usize> = (0..truth.len()).filter(|k| t.verdicts[*k] == Verdict::Determined).collect();
    let near = told.iter().filter(|k| (t.values[**k] - truth[**k]).abs() <= 1.0).count();
    let inside = told.iter().filter(|k| (t.exact[**k] - truth[**k]).abs() <= t.half_width[**k]).count();
    println!("{} determined, {near} within one step, {inside} within their interval", told.len());
    assert!(told.len() > 40 && near as f64 >= 0.9 * told.len() as f64);
}

#[test]
fn a_true_table_stays() {
    for seed in 2..7 {
        let (label, _, log) = planted(seed, 0.0);
        let found = run(&label, &[log], &Keys::default(), &|_| ()).unwrap();
        say("true", &found);
        assert_eq!(found.judgement.decision, Decision::Keep, "seed {seed}: {:?}", found.judgement.evidence);
    }
}

/// The log shows an engine that is 1 % lean on average, which is the half count that the ECU cuts off and no fault of the table.
#[test]
fn a_true_table_stays_where_the_ecu_cuts_its_look_ups() {
    for seed in 300..305 {
        let (label, _, log) = planted_with(seed, 0.0, true);
        let found = run(&label, &[log], &Keys::default(), &|_| ()).unwrap();
        say("cut", &found);
        assert_eq!(found.judgement.decision, Decision::Keep, "seed {seed}: {:?}", found.judgement.evidence);
    }
}

/// Over seeds that nothing was set by: truth within the stated interval, of the cells that are called determined.
#[test]
fn intervals_of_planted_tables_hold_the_truth() {
    let (mut inside, mut all) = (0usize, 0usize);
    for seed in 200..240 {
        let (label, truth, log) = planted(seed, 0.15);
        // The sensor is the planted one: what is judged are the intervals of the table.
        let sensor = Sensor { delay_s: 0.2, flow_delay_s: 0.15, lag_s: 0.25 };
        let keys = Keys { sensor: Some(sensor), ..Keys::default() };
        let found = run(&label, &[log], &keys, &|_| ()).unwrap();
        let t = &found.table;
        let told = (0..truth.len()).filter(|k| t.verdicts[*k] == Verdict::Determined);
        for k in told {
            all += 1;
            inside += usize::from((t.exact[k] - truth[k]).abs() <= t.half_width[k]);
        }
    }
    let share = inside as f64 / all as f64;
    println!("{inside} of {all} determined cells within their interval, {:.1} %", 100.0 * share);
    assert!(all > 1000 && (0.9..=0.995).contains(&share), "{share} of {all}");
}

/// A log of which every tenth sample has no speed or no load is a log with nine tenths of its samples: no hole of it is a fuel cut.
#[test]
fn scattered_samples_without_a_value_cost_only_themselves() {
    let (label, _, log) = planted(1, 0.15);
    let keys =
        Keys { sensor: Some(Sensor { delay_s: 0.2, flow_delay_s: 0.15, lag_s: 0.25 }), ..Keys::default() };
    let whole = run(&label, std::slice::from_ref(&log), &keys, &|_| ()).unwrap();
    let mut holes = log;
    for k in (5..holes.time_s.len()).step_by(10) {
        if k % 20 == 5 { holes.speed_rpm[k] = f64::NAN } else { holes.load[k] = f64::NAN }
    }
    let found = run(&label, &[holes], &keys, &|_| ()).unwrap();
    println!("{:?} samples without holes, {:?} with: {:?}", whole.samples, found.samples, found.left_out);
    assert_eq!(found.left_out[0].1, 1200);
    assert!(found.samples[1] as f64 > 0.88 * whole.samples[1] as f64, "{:?}", found.samples);
    assert_eq!(found.judgement.decision, Decision::Change);
    let told = |f: &Found| f.table.verdicts.iter().filter(|v| **v == Verdict::Determined).count();
    assert!(told(&found) as f64 > 0.9 * told(&whole) as f64, "{} and {}", told(&found), told(&whole));
}

/// After a hole of seconds nobody knows whether fuel was cut in it: what follows counts after the time of an echo only.
#[test]
fn a_long_hole_is_a_cut_that_is_not_known() {
    let (_, _, mut log) = planted(1, 0.0);
    let keys = mask::Keys::default();
    let echo = (keys.after_cut_s / 0.0667).ceil() as usize;
    let before = mask::of(&log, &keys).use_at;
    let hole = (1000..).find(|k| before[k - 1..k + echo + 2].iter().all(|u| *u)).unwrap();
    log.time_s[hole..].iter_mut().for_each(|t| *t += 5.0);
    let after = mask::of(&log, &keys).use_at;
    assert!(after[hole - 1] && after[hole + echo + 1]);
    assert!(after[hole..hole + echo - 1].iter().all(|u| !*u), "{:?}", &after[hole..hole + echo]);
}
