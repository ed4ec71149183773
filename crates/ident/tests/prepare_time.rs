//! Steps that change the time base or the spectrum: filters, decimation, resampling, events, delays.

use std::f64::consts::{PI, TAU};

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::prepare::filter::{Band, ZeroPhase};
use dynocal_ident::prepare::{Effect, Note, Planned, prepare};

fn channel(name: &str, unit: &str, role: Role, values: Vec<f64>) -> Channel {
    Channel { name: name.into(), unit: unit.into(), role, values }
}

fn record(dt_s: f64, channels: Vec<Channel>) -> Dataset {
    Dataset { name: "a".into(), sample_time_s: dt_s, channels, init_samples: 0, origin: "test".into() }
}

fn attempt(steps: &[(&str, &str)], given: &Dataset) -> Result<(Dataset, Vec<Note>), String> {
    let one = |(name, keys): &(&str, &str)| Planned::new(name, &toml::from_str(keys).unwrap());
    let plan = steps.iter().map(one).collect::<Result<Vec<_>, _>>().map_err(|e| e.to_string())?;
    let (mut out, notes) = prepare(&plan, vec![given.clone()], &mut |_, _| ()).map_err(|e| e.to_string())?;
    Ok((out.remove(0), notes))
}

fn run(steps: &[(&str, &str)], given: &Dataset) -> (Dataset, Vec<Note>) {
    attempt(steps, given).unwrap()
}

fn values<'a>(d: &'a Dataset, name: &str) -> &'a [f64] {
    d.values(name).unwrap()
}

/// Sines come out in phase with the amplitude of the formula, away from the ends.
#[test]
fn sines_leave_the_filter_with_the_gain_of_the_formula_and_no_phase() {
    let (dt, n) = (0.01, 6000);
    let w = |f: f64| (PI * f * dt).tan();
    type Ratio = fn(f64, f64, f64) -> f64;
    let cases: [(Band, usize, Ratio); 8] = [
        (Band::Low(5.0), 4, |w, a, _| w / a),
        (Band::Low(5.0), 3, |w, a, _| w / a),
        (Band::High(5.0), 4, |w, a, _| a / w),
        (Band::High(5.0), 1, |w, a, _| a / w),
        (Band::Pass(4.0, 9.0), 2, |w, a, b| (w * w - a * b) / (w * (b - a))),
        (Band::Pass(1.0, 30.0), 3, |w, a, b| (w * w - a * b) / (w * (b - a))),
        (Band::Stop(4.0, 9.0), 2, |w, a, b| w * (b - a) / (w * w - a * b)),
        (Band::Stop(2.0, 20.0), 5, |w, a, b| w * (b - a) / (w * w - a * b)),
    ];
    for (band, order, ratio) in cases {
        let (a, b) = match band {
            Band::Low(a) | Band::High(a) => (a, a),
            Band::Pass(a, b) | Band::Stop(a, b) => (a, b),
        };
        let filter = ZeroPhase::butterworth(band, order, dt).unwrap();
        for f in [0.7, 3.0, 4.0, 5.0, 6.1, 9.0, 14.0, 31.0, 45.0] {
            let gain = 1.0 / (1.0 + ratio(w(f), w(a), w(b)).abs().powi(2 * order as i32));
            assert!(
                (filter.gain(f, dt) - gain).abs() < 1e-9,
                "{band:?} {order} {f} Hz: gain {}",
                filter.gain(f, dt)
            );
            let x: Vec<f64> = (0..n).map(|t| (TAU * f * dt * t as f64 + 0.4).sin()).collect();
            let y = filter.apply(&x).unwrap();
            for t in n / 2 - 200..n / 2 + 200 {
                assert!((y[t] - gain * x[t]).abs() < 1e-6, "{band:?} {order} {f} Hz, sample {t}: {}", y[t]);
            }
        }
    }
}

/// The answer to an impulse is symmetric in time: no phase at any frequency.
#[test]
fn the_impulse_response_is_symmetric() {
    for band in [Band::Low(3.0), Band::High(3.0), Band::Pass(2.0, 8.0), Band::Stop(2.0, 8.0)] {
        let filter = ZeroPhase::butterworth(band, 4, 0.01).unwrap();
        let mut x = vec![0.0; 4001];
        x[2000] = 1.0;
        let y = filter.apply(&x).unwrap();
        let worst = (0..2000).map(|k| (y[2000 - k] - y[2000 + k]).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-10, "{band:?}: {worst}");
    }
}

/// Polynomials of the first degree pass a low pass, and are stopped by a high pass, up to the ends; the filter treats
/// inputs and outputs alike and says so where it does not.
#[test]
fn ends_inputs_and_outputs_are_treated_properly() {
    let ramp: Vec<f64> = (0..2000).map(|t| 80.0 - 0.03 * t as f64).collect();
    let wave: Vec<f64> = (0..2000).map(|t| (0.2 * t as f64).sin()).collect();
    let channels = vec![
        channel("u", "-", Role::Input, ramp.clone()),
        channel("y", "Nm", Role::Output, ramp.clone()),
        channel("aux", "-", Role::Auxiliary, wave.clone()),
    ];
    let given = record(0.01, channels);
    let (low, notes) = run(&[("filter", "pass = 'low'\nedge_hz = 2.0")], &given);
    for name in ["u", "y"] {
        assert!(values(&low, name).iter().zip(&ramp).all(|(a, b)| (a - b).abs() < 1e-8));
    }
    assert_eq!(values(&low, "aux"), wave);
    assert!(notes[0].remarks.is_empty());
    let (high, notes) = run(&[("filter", "pass = 'high'\nedge_hz = 2.0\nchannels = ['y']")], &given);
    assert!(values(&high, "y").iter().all(|v| v.abs() < 1e-6));
    assert_eq!(notes[0].remarks.len(), 1);
    let refused = attempt(&[("filter", "pass = 'low'\nedge_hz = 60.0")], &given).unwrap_err();
    assert!(refused.contains("60 Hz") && refused.contains("50 Hz"), "{refused}");
    assert!(attempt(&[("filter", "pass = 'band'\nedge_hz = 6.0")], &given).is_err());
    let mut gappy = given.clone();
    gappy.channels[1].values[7] = f64::NAN;
    let refused = attempt(&[("filter", "pass = 'low'\nedge_hz = 2.0")], &gappy).unwrap_err();
    assert!(refused.contains("`y` is missing at sample 7"), "{refused}");
}

/// A sine in the pass band keeps its amplitude, one that would be folded back is gone (80 dB); without the low pass it
/// comes back at the folded frequency.
#[test]
fn decimation_suppresses_aliases() {
    let (dt, q, n) = (0.01, 5, 10_000);
    let sine = |f: f64| -> Vec<f64> { (0..n).map(|t| (TAU * f * dt * t as f64).sin()).collect() };
    let make = |f: f64| record(dt, vec![channel("y", "-", Role::Output, sine(f))]);
    let inner = 100..n / q - 100;
    for f in [0.3, 4.0, 7.9] {
        let (out, _) = run(&[("decimate", "factor = 5")], &make(f));
        assert_eq!((out.len(), out.sample_time_s), (n / q, 0.05));
        let expected = sine(f);
        let worst = inner.clone().map(|k| (values(&out, "y")[k] - expected[q * k]).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-4, "{f} Hz: {worst}");
    }
    for f in [10.1, 13.0, 27.0, 49.0] {
        let (out, _) = run(&[("decimate", "factor = 5")], &make(f));
        let worst = inner.clone().map(|k| values(&out, "y")[k].abs()).fold(0.0, f64::max);
        assert!(worst < 2e-4, "{f} Hz: {worst}");
    }
    let (raw, notes) = run(&[("decimate", "factor = 5\nlow_pass = false")], &make(13.0));
    let folded = |k: usize| -(TAU * 7.0 * 0.05 * k as f64).sin();
    assert!(inner.clone().all(|k| (values(&raw, "y")[k] - folded(k)).abs() < 1e-9));
    assert_eq!(notes[0].remarks.len(), 1);
    let line: Vec<f64> = (0..1000).map(|t| 3.0 + 0.01 * t as f64).collect();
    let (out, _) =
        run(&[("decimate", "factor = 4")], &record(dt, vec![channel("y", "-", Role::Output, line)]));
    assert!(values(&out, "y").iter().enumerate().all(|(k, v)| (v - 3.0 - 0.04 * k as f64).abs() < 1e-11));
}

/// Irregular stamps of a straight line give the line; a held input keeps its levels; the mean keeps the integral.
#[test]
fn irregular_stamps_become_uniform() {
    let stamps: Vec<f64> = (0..400).map(|k| 100.0 + 0.1 * k as f64 + 0.03 * (k as f64 * 1.7).sin()).collect();
    let line = |t: f64| 5.0 - 2.0 * (t - 100.0);
    let level = |t: f64| if t < 120.0 { 1.0 } else { 4.0 };
    let given = record(
        f64::NAN,
        vec![
            channel("time", "s", Role::Auxiliary, stamps.clone()),
            channel("u", "-", Role::Input, stamps.iter().map(|t| level(*t)).collect()),
            channel("y", "-", Role::Output, stamps.iter().map(|t| line(*t)).collect()),
        ],
    );
    let (out, notes) = run(&[("resample", "sample_time_s = 0.08\ninputs = 'previous'")], &given);
    let t0 = stamps[0];
    for k in 0..out.len() {
        let t = t0 + 0.08 * k as f64;
        assert!((values(&out, "time")[k] - t).abs() < 1e-9);
        assert!((values(&out, "y")[k] - line(t)).abs() < 1e-9);
        let last = stamps.iter().rposition(|s| *s <= t + 1e-9).unwrap();
        assert_eq!(values(&out, "u")[k], level(stamps[last]), "{k}");
    }
    assert!(out.check().is_ok() && notes[0].remarks.is_empty());
    assert_eq!(out.len(), ((stamps[399] - t0) / 0.08).floor() as usize + 1);

    // The mean over the intervals of a signal that lives in the middle of the record keeps its integral.
    let bump: Vec<f64> =
        stamps.iter().map(|t| if (105.0..135.0).contains(t) { (0.9 * t).sin() + 2.0 } else { 0.0 }).collect();
    let integral: f64 = (1..400).map(|k| 0.5 * (bump[k] + bump[k - 1]) * (stamps[k] - stamps[k - 1])).sum();
    let mut with_bump = given.clone();
    with_bump.channels[2].values = bump;
    let (out, _) = run(&[("resample", "sample_time_s = 0.7\nby = 'mean'")], &with_bump);
    let sum: f64 = values(&out, "y").iter().map(|v| 0.7 * v).sum();
    assert!((sum - integral).abs() < 1e-9 * integral, "{sum} for {integral}");

    let (_, notes) = run(&[("resample", "sample_time_s = 0.7")], &with_bump);
    assert_eq!(notes[0].remarks.len(), 1, "folding back is told");
    let mut faulty = given.clone();
    faulty.channels[0].values[30] = faulty.channels[0].values[29];
    let refused = attempt(&[("resample", "sample_time_s = 0.1")], &faulty).unwrap_err();
    assert!(refused.contains("do not rise at sample 30"), "{refused}");
    let refused = attempt(&[("resample", "sample_time_s = 1e-9")], &given).unwrap_err();
    assert!(refused.contains("thousandth"), "{refused}");
}

/// A polynomial of the second degree through the line between stamps: the error is that of the chord, (t - a)(b - t).
#[test]
fn the_line_between_stamps_is_exact_to_its_formula() {
    let stamps: Vec<f64> = (0..50).map(|k| (k as f64).powf(1.1)).collect();
    let given = record(
        f64::NAN,
        vec![
            channel("clock", "ms", Role::Auxiliary, stamps.iter().map(|t| 1000.0 * t).collect()),
            channel("y", "-", Role::Output, stamps.iter().map(|t| t * t).collect()),
        ],
    );
    let (out, _) = run(&[("resample", "sample_time_s = 0.25\ntime = 'clock'")], &given);
    for (k, v) in values(&out, "y").iter().enumerate() {
        let t = 0.25 * k as f64;
        let i = stamps.iter().rposition(|s| *s <= t + 1e-9).unwrap();
        let chord = stamps.get(i + 1).map_or(0.0, |b| (t - stamps[i]) * (b - t));
        assert!((v - t * t - chord).abs() < 1e-9, "{t}: {v}");
    }
}

/// Nothing is invented in a gap of the stamps or of a channel.
#[test]
fn gaps_stay_gaps_when_resampled() {
    let stamps: Vec<f64> = (0..100).filter(|k| !(40..60).contains(k)).map(|k| 0.1 * f64::from(k)).collect();
    let y: Vec<f64> = stamps.iter().enumerate().map(|(k, t)| if k == 5 { f64::NAN } else { *t }).collect();
    let given = record(
        f64::NAN,
        vec![channel("time", "s", Role::Auxiliary, stamps), channel("y", "-", Role::Output, y)],
    );
    let (out, _) = run(&[("resample", "sample_time_s = 0.05\nmax_gap_s = 0.15")], &given);
    let unknown: Vec<usize> =
        values(&out, "y").iter().enumerate().filter(|(_, v)| v.is_nan()).map(|(k, _)| k).collect();
    let expected: Vec<usize> = (9..12).chain(79..120).collect();
    assert_eq!(unknown, expected);
    assert!(values(&out, "time").iter().all(|t| t.is_finite()));
}

fn turning(speed_rpm: impl Fn(f64) -> f64, y: impl Fn(f64) -> f64, dt: f64, n: usize) -> Dataset {
    let t: Vec<f64> = (0..n).map(|k| dt * k as f64).collect();
    let over = |f: &dyn Fn(f64) -> f64| t.iter().map(|t| f(*t)).collect();
    record(
        dt,
        vec![
            channel("speed", "rpm", Role::Input, over(&speed_rpm)),
            channel("y", "Nm", Role::Output, over(&y)),
            channel("angle", "deg", Role::Auxiliary, t.iter().map(|t| 9000.0 * t % 720.0).collect()),
        ],
    )
}

/// 1500 rpm: a stroke takes 20 ms. Means over strokes of a line are its values in the middle, from speed and from a
/// wrapped angle alike, and the way back gives the line again.
#[test]
fn strokes_at_constant_speed_and_back() {
    let line = |t: f64| 10.0 + 3.0 * t;
    let given = turning(|_| 1500.0, line, 0.007, 1000);
    for source in ["speed = 'speed'", "angle = 'angle'"] {
        let (out, notes) = run(&[("event", &format!("per = 'stroke'\n{source}"))], &given);
        assert_eq!(out.len(), (999.0 * 0.007_f64 / 0.02 + 1e-9).floor() as usize);
        assert!((out.sample_time_s - 0.02).abs() < 1e-12, "{}", out.sample_time_s);
        for k in 0..out.len() {
            let middle = 0.02 * (k as f64 + 0.5);
            assert!((values(&out, "event_time")[k] - middle).abs() < 1e-10);
            assert!((values(&out, "y")[k] - line(middle)).abs() < 1e-9, "{source} {k}");
        }
        assert!(matches!(notes[0].changes[0].effect, Effect::PerEvent { nominal_rpm, .. }
            if (nominal_rpm - 1500.0).abs() < 1e-6));
        let both = [
            ("event", format!("per = 'stroke'\n{source}")),
            ("event", "per = 'time'\nsample_time_s = 0.007".into()),
        ];
        let both: Vec<(&str, &str)> = both.iter().map(|(a, b)| (*a, b.as_str())).collect();
        let (back, _) = run(&both, &given);
        // 10 ms is the middle of the first stroke; the first instant of the old base after it is 14 ms.
        for (k, v) in values(&back, "y").iter().enumerate() {
            assert!((v - line(0.007 * (k + 2) as f64)).abs() < 1e-9, "{k}: {v}");
        }
        assert!((back.sample_time_s - 0.007).abs() < 1e-15);
    }
}

/// A ramp from 1000 rpm up by 500 rpm/s: phi(t) = 6000 t + 1500 t^2 deg. Instants from the root of that, means over
/// time and over angle from their integrals.
#[test]
fn cycles_on_a_speed_ramp_have_their_exact_instants_and_means() {
    let speed = |t: f64| 1000.0 + 500.0 * t;
    let y = |t: f64| 4.0 - 0.5 * t;
    let given = turning(speed, y, 0.013, 900);
    let phi = |t: f64| 6000.0 * t + 1500.0 * t * t;
    let when = |phi: f64| 2.0 * phi / (6000.0 + (36e6f64 + 4.0 * 1500.0 * phi).sqrt());
    let (points, _) = run(&[("event", "per = 'cycle'\nspeed = 'speed'\nby = 'point'")], &given);
    let (mean, _) = run(&[("event", "per = 'cycle'\nspeed = 'speed'")], &given);
    let (angle, _) = run(&[("event", "per = 'cycle'\nspeed = 'speed'\nby = 'angle_mean'")], &given);
    assert_eq!(points.len(), (phi(899.0 * 0.013) / 720.0).floor() as usize);
    for k in 0..points.len() {
        let (a, b) = (when(720.0 * k as f64), when(720.0 * (k + 1) as f64));
        assert!((values(&points, "event_start")[k] - a).abs() < 1e-9, "{k}");
        assert!((values(&points, "y")[k] - y(a)).abs() < 1e-9);
        assert!((values(&mean, "y")[k] - y(0.5 * (a + b))).abs() < 1e-9);
        // integral of (4 - t/2)(6000 + 3000 t) dt
        let f = |t: f64| 24_000.0 * t + 4500.0 * t * t - 500.0 * t.powi(3);
        assert!((values(&angle, "y")[k] - (f(b) - f(a)) / 720.0).abs() < 1e-8, "{k}");
    }
    let (back, _) = run(
        &[
            ("event", "per = 'degree'\ndegrees = 90\nspeed = 'speed'"),
            ("event", "per = 'time'\nsample_time_s = 0.013"),
        ],
        &given,
    );
    let first = (values(&back, "y")[0] - 4.0) / -0.5;
    for (k, v) in values(&back, "y").iter().enumerate() {
        assert!((v - y(first + 0.013 * k as f64)).abs() < 1e-9);
    }
    assert!((first - 0.013).abs() < 1e-9, "{first}");
    let refused = attempt(&[("event", "per = 'cycle'\nspeed = 'y'")], &given).unwrap_err();
    assert!(refused.contains("`y` is in `Nm`, expected rpm"), "{refused}");
    assert!(attempt(&[("event", "per = 'cycle'")], &given).is_err());
}

/// A record of a combustion analyser has one row per cycle and knows the mean speed of each: its time follows.
#[test]
fn a_record_per_cycle_comes_to_time() {
    let line = |t: f64| 20.0 + 1.5 * t;
    let when =
        |k: usize| 2.0 * 720.0 * k as f64 / (6000.0 + (36e6f64 + 4.0 * 1500.0 * 720.0 * k as f64).sqrt());
    let each = |f: &dyn Fn(f64, f64) -> f64| (0..80).map(|k| f(when(k), when(k + 1))).collect::<Vec<_>>();
    let given = record(
        0.1,
        vec![
            channel("speed", "rpm", Role::Input, each(&|a, b| 120.0 / (b - a))),
            channel("y", "bar", Role::Output, each(&|a, b| line(0.5 * (a + b)))),
        ],
    );
    let keys = "per = 'time'\nsample_time_s = 0.02\nfrom = 'cycle'\nspeed = 'speed'";
    let (out, _) = run(&[("event", keys)], &given);
    let first = (0.5 * (when(0) + when(1)) / 0.02).ceil() * 0.02;
    for (k, v) in values(&out, "y").iter().enumerate() {
        assert!((v - line(first + 0.02 * k as f64)).abs() < 1e-9, "{k}: {v}");
    }
    assert!(out.check().is_ok() && out.channels.len() == 2);
    let refused = attempt(&[("event", "per = 'time'\nsample_time_s = 0.02")], &given).unwrap_err();
    assert!(refused.contains("from"), "{refused}");
    assert!(attempt(&[("event", "per = 'time'\nsample_time_s = 0.02\nfrom = 'cycle'")], &given).is_err());
}

/// Held inputs come back as they were held: a level that changes at events only.
#[test]
fn held_levels_survive_the_way_to_events_and_back() {
    let level = |t: f64| ((t + 1e-9) / 0.08).floor() % 5.0;
    let given = turning(|_| 1500.0, level, 0.005, 2000);
    let steps = [
        ("event", "per = 'cycle'\nspeed = 'speed'\nby = 'point'"),
        ("event", "per = 'time'\nsample_time_s = 0.005\nby = 'point'"),
    ];
    let (back, _) = run(&steps, &given);
    let wrong = (0..back.len()).filter(|k| values(&back, "y")[*k] != values(&given, "y")[*k]).count();
    // 124 whole cycles of 80 ms in 9.995 s; the last one begins at 9.84 s.
    assert_eq!((wrong, back.len()), (0, 1969));
}

/// Whole samples are moved exactly; parts of a sample by a line or a cubic, exact for polynomials of that degree.
#[test]
fn delays_are_exact() {
    let cubic = |t: f64| 1.0 + t - 0.3 * t * t + 0.02 * t.powi(3);
    let line = |t: f64| 2.0 - 0.7 * t;
    let t = |k: usize| 0.1 * k as f64;
    let given = record(
        0.1,
        vec![
            channel("u", "-", Role::Input, (0..100).map(t).collect()),
            channel("a", "-", Role::Output, (0..100).map(|k| cubic(t(k))).collect()),
            channel("b", "-", Role::Output, (0..100).map(|k| line(t(k))).collect()),
        ],
    );
    let (out, _) = run(&[("delay", "channels = ['a']\nseconds = 0.3")], &given);
    assert_eq!(values(&out, "a"), &values(&given, "a")[3..]);
    assert_eq!(values(&out, "u"), &values(&given, "u")[..97]);
    let (out, _) = run(&[("delay", "channels = ['b']\nseconds = -0.25")], &given);
    assert_eq!(values(&out, "u"), &values(&given, "u")[3..]);
    for k in 0..out.len() {
        assert!((values(&out, "b")[k] - line(t(k + 3) - 0.25)).abs() < 1e-12);
    }
    let (out, _) = run(&[("delay", "channels = ['a']\nseconds = 0.137\nby = 'cubic'")], &given);
    for k in 0..out.len() - 1 {
        assert!((values(&out, "a")[k] - cubic(t(k) + 0.137)).abs() < 1e-11, "{k}");
    }
    let gone = attempt(&[("delay", "channels = ['a']\nseconds = 30")], &given).unwrap_err();
    assert!(gone.contains("out of the record"), "{gone}");
}

/// Four strokes after t on a speed ramp: the instant where the crank has turned 720 deg more.
#[test]
fn a_delay_in_strokes_goes_with_the_speed() {
    let line = |t: f64| 7.0 + 2.0 * t;
    let given = turning(|t| 1000.0 + 500.0 * t, line, 0.01, 800);
    let (out, _) = run(&[("delay", "channels = ['y']\nstrokes = 4\nseconds = 0.05")], &given);
    let phi = |t: f64| 6000.0 * t + 1500.0 * t * t;
    let when = |phi: f64| 2.0 * phi / (6000.0 + (36e6f64 + 4.0 * 1500.0 * phi).sqrt());
    for (k, v) in values(&out, "y").iter().enumerate() {
        let expected = line(when(phi(0.01 * k as f64) + 720.0) + 0.05);
        assert!((v - expected).abs() < 1e-9, "{k}: {v}, expected {expected}");
    }
    let last = 0.01 * (out.len() - 1) as f64;
    let end = |t: f64| when(phi(t) + 720.0) + 0.05;
    assert!(end(last) <= 7.99 && end(last + 0.01) > 7.99);
}
