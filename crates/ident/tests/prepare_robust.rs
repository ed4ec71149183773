//! Whatever a record is like: a step gives sound records or says why not, and so do the checks before a fit.

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::excitation::{Settings, excitation};
use dynocal_ident::prepare::{Planned, prepare, repeat, restore};
use dynocal_numerics::rng::Rng64;

const STEPS: &[(&str, &str)] = &[
    ("window", "from_s = 0.2"),
    ("window", "to_s = 0.3\ncut = true\nleast_samples = 1"),
    ("missing", ""),
    ("missing", "longest = 0\nleast_samples = 1"),
    ("missing", "longer = 'mark'\nby = 'hold'\nlongest = 1000"),
    ("missing", "longer = 'refuse'"),
    ("hampel", ""),
    ("hampel", "half_width = 50\nn_sigma = 0.01\naction = 'split'\nleast_samples = 1"),
    ("hampel", "half_width = 1\nleast = 0\naction = 'replace'"),
    ("hampel", "n_sigma = 0.1\naction = 'hold'"),
    ("resample", "sample_time_s = 0.03"),
    ("resample", "sample_time_s = 7.0\nby = 'mean'\ninputs = 'previous'"),
    ("resample", "sample_time_s = 0.05\nby = 'mean'\ntime = 'time'\nmax_gap_s = 1e-9"),
    ("event", "per = 'stroke'\nspeed = 'speed'"),
    ("event", "per = 'degree'\ndegrees = 7.3\nangle = 'angle'\nby = 'point'\noffset_deg = -500.0"),
    ("event", "per = 'cycle'\nspeed = 'speed'\nby = 'angle_mean'\ntime = 'time'"),
    ("event", "per = 'time'\nsample_time_s = 0.05\nfrom = 'cycle'\nspeed = 'speed'"),
    ("delay", "channels = ['y']\nseconds = 0.17\nby = 'cubic'"),
    ("delay", "channels = ['y', 'u']\nseconds = -0.3"),
    ("delay", "channels = ['y']\nstrokes = 3"),
    ("filter", "pass = 'low'\nedge_hz = 1.0"),
    ("filter", "pass = 'stop'\nedges_hz = [0.5, 2.0]\norder = 12"),
    ("decimate", "factor = 3"),
    ("decimate", "factor = 1000\nlow_pass = false"),
    ("offset", ""),
    ("offset", "remove = 'trend'"),
    ("offset", "per_record = true"),
    ("scale", ""),
];

/// A record of `n` samples with a share of missing ones, uniform or not.
fn record(name: &str, n: usize, missing: f64, uniform: bool, rng: &mut Rng64) -> Dataset {
    let mut t = 3.0;
    let mut draw = |role, name: &str, unit: &str, f: &mut dyn FnMut(&mut Rng64) -> f64| {
        let mut values: Vec<f64> = (0..n).map(|_| f(rng)).collect();
        if role != Role::Auxiliary {
            for v in values.iter_mut().skip(1) {
                if rng.uniform() < missing {
                    *v = f64::NAN;
                }
            }
        }
        Channel { name: name.into(), unit: unit.into(), role, values }
    };
    let mut angle = 0.0;
    let channels = vec![
        draw(Role::Input, "speed", "rpm", &mut |r| r.uniform_in(800.0, 6000.0)),
        draw(Role::Input, "u", "-", &mut |r| r.below(3) as f64),
        draw(Role::Output, "y", "Nm", &mut |r| 100.0 + r.normal()),
        draw(Role::Auxiliary, "time", "s", &mut |r| {
            t += r.uniform_in(0.01, 0.4);
            t
        }),
        draw(Role::Auxiliary, "angle", "deg", &mut |r| {
            angle += r.uniform_in(1.0, 300.0);
            angle % 720.0
        }),
    ];
    let sample_time_s = if uniform { 0.1 } else { f64::NAN };
    Dataset { name: name.into(), sample_time_s, channels, init_samples: n / 3, origin: "drawn".into() }
}

fn sound(records: &[Dataset], what: &str) {
    assert!(!records.is_empty(), "{what}");
    for r in records {
        assert!(!r.is_empty() && r.channels.iter().all(|c| c.values.len() == r.len()), "{what}: {}", r.name);
        assert!(r.channels.iter().all(|c| c.values.iter().all(|v| !v.is_infinite())), "{what}: {}", r.name);
        assert!(r.sample_time_s.is_nan() || r.sample_time_s > 0.0, "{what}");
    }
}

/// Every step alone and every pair of steps on records of all kinds.
#[test]
fn steps_give_sound_records_or_a_reason() {
    let (mut done, mut refused) = (0, 0);
    for (case, n) in [1, 2, 3, 7, 40, 200].into_iter().enumerate() {
        for (k, missing) in [0.0, 0.1, 0.9].into_iter().enumerate() {
            let mut rng = Rng64::stream(17, (3 * case + k) as u64);
            let uniform = rng.uniform() < 0.6;
            let records = vec![
                record("a", n, missing, uniform, &mut rng),
                record("b", n + 5, missing, uniform, &mut rng),
            ];
            for first in STEPS {
                for second in STEPS.iter().step_by(1 + case) {
                    let what = format!("{n} samples, {missing} missing: {first:?}, {second:?}");
                    let plan: Vec<Planned> = [first, second]
                        .iter()
                        .map(|(name, keys)| Planned::new(name, &toml::from_str(keys).unwrap()).unwrap())
                        .collect();
                    let Ok((out, notes)) = prepare(&plan, records.clone(), &mut |_, r| sound(r, &what))
                    else {
                        refused += 1;
                        continue;
                    };
                    done += 1;
                    assert!(notes.iter().all(|note| note.sentences().iter().all(|s| !s.is_empty())));
                    let last = &out[out.len() - 1];
                    let mut values = vec![0.0; last.len()];
                    let back = restore(&notes, &last.name, "y", last.sample_time_s, &mut values);
                    assert!(back.is_err() || values.iter().all(|v| v.is_finite()), "{what}");
                    assert_eq!(repeat(&plan, &notes).unwrap().len(), 2);
                }
            }
        }
    }
    assert!(done > 500 && refused > 100, "{done} prepared, {refused} refused");
}

#[test]
fn checks_before_a_fit_give_numbers_or_a_reason() {
    let names = |list: &[&str]| list.iter().map(ToString::to_string).collect::<Vec<_>>();
    let mut rng = Rng64::new(23);
    for n in [1, 2, 5, 30, 300] {
        for missing in [0.0, 0.3, 0.95] {
            let records = [record("a", n, missing, true, &mut rng), record("b", n, missing, true, &mut rng)];
            for period in [None, Some(0), Some(3), Some(10), Some(100_000)] {
                let settings = Settings { period, ..Settings::default() };
                match excitation(&records, &names(&["speed", "u"]), &names(&["y"]), &settings) {
                    Ok(report) => {
                        assert_eq!(report.persistence.len(), 2);
                        assert!(report.coverage.iter().all(|c| (0.0..=1.0).contains(&c.occupied)));
                        assert!(report.correlations.iter().all(|c| c.r.abs() <= 1.0 + 1e-9 && c.bound > 0.0));
                    }
                    Err(e) => assert!(!e.to_string().is_empty()),
                }
            }
        }
    }
}
