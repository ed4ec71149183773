//! Steps that look at samples: offsets, scales, outliers, missing samples, windows; the driver and the way back.

use dynocal_ident::data::{Channel, DataError, Dataset, Gap, Role};
use dynocal_ident::experiment::{experiments, experiments_marked};
use dynocal_ident::prepare::residual::residual_outliers;
use dynocal_ident::prepare::{
    Became, Effect, Note, Planned, PrepareError, STEPS, docs, prepare, repeat, restore,
};
use dynocal_numerics::rng::Rng64;

fn channel(name: &str, role: Role, values: Vec<f64>) -> Channel {
    Channel { name: name.into(), unit: "Nm".into(), role, values }
}

fn record(name: &str, channels: Vec<Channel>) -> Dataset {
    Dataset { name: name.into(), sample_time_s: 0.1, channels, init_samples: 0, origin: "test".into() }
}

fn plan(steps: &[(&str, &str)]) -> Vec<Planned> {
    steps.iter().map(|(name, keys)| Planned::new(name, &toml::from_str(keys).unwrap()).unwrap()).collect()
}

fn run(steps: &[(&str, &str)], records: &[Dataset]) -> (Vec<Dataset>, Vec<Note>) {
    prepare(&plan(steps), records.to_vec(), &mut |_, _| ()).unwrap()
}

fn noise(n: usize, seed: u64) -> Vec<f64> {
    let mut rng = Rng64::new(seed);
    (0..n).map(|_| rng.normal()).collect()
}

fn runs_of(note: &Note, became: Became) -> Vec<Gap> {
    let of = |e: &Effect| match e {
        Effect::Samples { runs, became: b } if *b == became => runs.clone(),
        _ => Vec::new(),
    };
    note.changes.iter().flat_map(|c| of(&c.effect)).collect()
}

/// The mean of all samples of all records goes, one number for all; what was taken off comes back.
#[test]
fn one_mean_over_all_records_is_removed_and_comes_back() {
    let a = record("a", vec![channel("y", Role::Output, vec![1.0, 2.0, f64::NAN, 3.0])]);
    let b = record("b", vec![channel("y", Role::Output, vec![10.0, 9.0])]);
    let given = [a.clone(), b.clone()];
    let (out, notes) = run(&[("offset", "")], &given);
    assert_eq!(out[1].channels[0].values, [5.0, 4.0]);
    assert_eq!(out[0].channels[0].values[0], -4.0);
    assert!(out[0].channels[0].values[2].is_nan());
    assert_eq!(given[1], b, "the caller's records stay");
    let mut back = out[1].channels[0].values.clone();
    restore(&notes, "b", "y", 0.1, &mut back).unwrap();
    assert_eq!(back, b.channels[0].values);
    let (each, _) = run(&[("offset", "per_record = true")], &given);
    assert_eq!(each[1].channels[0].values, [0.5, -0.5]);
    let (point, _) = run(&[("offset", "at = { y = 8.0 }")], &given);
    assert_eq!(point[1].channels[0].values, [2.0, 1.0]);
}

/// A straight line is all trend; it comes back also on a part that was cut later, delayed and decimated.
#[test]
fn a_trend_is_removed_and_comes_back_on_a_part() {
    let line = |t: usize| 5.0 + 0.3 * t as f64;
    let wave = |t: usize| (0.05 * t as f64).sin();
    let y: Vec<f64> = (0..400).map(|t| line(t) + if t == 77 { f64::NAN } else { 0.0 }).collect();
    let (out, notes) =
        run(&[("offset", "remove = 'trend'")], &[record("a", vec![channel("y", Role::Output, y)])]);
    assert!(out[0].channels[0].values.iter().filter(|v| !v.is_nan()).all(|v| v.abs() < 1e-11));
    assert!(matches!(notes[0].changes[0].effect, Effect::Subtracted { level, slope_per_s }
        if (level - 5.0).abs() < 1e-11 && (slope_per_s - 3.0).abs() < 1e-11));

    let y: Vec<f64> = (0..400).map(|t| line(t) + wave(t)).collect();
    let steps = [
        ("offset", "remove = 'trend'"),
        ("window", "from_s = 10.0\nto_s = 12.0\ncut = true"),
        ("delay", "channels = ['y']\nseconds = 0.3"),
        ("decimate", "factor = 4\nlow_pass = false"),
        ("scale", "by = { y = 7.0 }"),
    ];
    let (out, notes) = run(&steps, &[record("a", vec![channel("y", Role::Output, y.clone())])]);
    assert_eq!(out.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["a.1", "a.2"]);
    let mut back = out[1].channels[0].values.clone();
    restore(&notes, "a.2", "y", out[1].sample_time_s, &mut back).unwrap();
    assert_eq!(back.len(), (400 - 120 - 3usize).div_ceil(4));
    for (k, v) in back.iter().enumerate() {
        assert!((v - y[120 + 3 + 4 * k]).abs() < 1e-10, "{k}: {v}");
    }
}

/// What is learnt on one record is applied to another, not learnt anew.
#[test]
fn test_records_get_the_numbers_of_the_estimation_records() {
    let make = |seed, level: f64, spread: f64| {
        let y = noise(500, seed).iter().map(|v| level + spread * v).collect();
        record("r", vec![channel("y", Role::Output, y)])
    };
    let (estimation, test) = (make(1, 50.0, 4.0), make(2, 60.0, 8.0));
    let plan = plan(&[("offset", ""), ("scale", "")]);
    let (out, notes) = prepare(&plan, vec![estimation.clone()], &mut |_, _| ()).unwrap();
    let y = &out[0].channels[0].values;
    let mean = y.iter().sum::<f64>() / 500.0;
    let power = y.iter().map(|v| v * v).sum::<f64>() / 500.0;
    assert!(mean.abs() < 1e-12 && (power - 1.0).abs() < 1e-12);
    let again = repeat(&plan, &notes).unwrap();
    let (out, again_notes) = prepare(&again, vec![test.clone()], &mut |_, _| ()).unwrap();
    let x = &estimation.channels[0].values;
    let mean = x.iter().sum::<f64>() / 500.0;
    let sigma = (x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 500.0).sqrt();
    for (found, y) in out[0].channels[0].values.iter().zip(&test.channels[0].values) {
        assert!((found - (y - mean) / sigma).abs() < 1e-11);
    }
    let mut back = out[0].channels[0].values.clone();
    restore(&again_notes, "r", "y", 0.1, &mut back).unwrap();
    assert!(back.iter().zip(&test.channels[0].values).all(|(a, b)| (a - b).abs() < 1e-11));
}

/// Exactly the planted spikes are found: the signal is smooth, so that no honest sample is far from its median.
#[test]
fn hampel_finds_the_planted_spikes_and_nothing_else() {
    let clean: Vec<f64> = (0..600).map(|t| 40.0 + 0.05 * t as f64 + noise_free_wave(t)).collect();
    let spikes = [0, 57, 58, 200, 321, 599];
    let mut y = clean.clone();
    for (k, t) in spikes.iter().enumerate() {
        y[*t] += if k % 2 == 0 { 25.0 } else { -30.0 };
    }
    y[450] = f64::NAN;
    let given = record("a", vec![channel("u", Role::Input, vec![1.0; 600]), channel("y", Role::Output, y)]);
    let expected: Vec<Gap> =
        [(0, 1), (57, 59), (200, 201), (321, 322), (599, 600)].map(|(from, to)| Gap { from, to }).to_vec();
    let keys = |action: &str| format!("half_width = 7\nn_sigma = 4\naction = '{action}'");
    let (out, notes) = run(&[("hampel", &keys("interpolate"))], std::slice::from_ref(&given));
    assert_eq!(runs_of(&notes[0], Became::Interpolated), expected);
    let y = &out[0].channels[1].values;
    // Between neighbours of a smooth signal: the error is that of a chord, at most h^2/8 max |y''|.
    for t in [57, 58, 200, 321] {
        assert!(
            (y[t] - clean[t]).abs() < 9.0 / 8.0 * 2.0 * 0.15f64.powi(2),
            "{t}: {} for {}",
            y[t],
            clean[t]
        );
    }
    assert_eq!(y[0], y[1], "an end takes the only neighbour");
    assert!(y[450].is_nan(), "missing samples stay missing");
    let (out, notes) = run(&[("hampel", &keys("mark"))], std::slice::from_ref(&given));
    assert_eq!(runs_of(&notes[0], Became::Missing), expected);
    assert!(spikes.iter().all(|t| out[0].channels[1].values[*t].is_nan()));
    let (out, _) = run(&[("hampel", &keys("hold"))], std::slice::from_ref(&given));
    assert_eq!(out[0].channels[1].values[58], clean[56]);
    let (out, notes) = run(&[("hampel", &keys("split"))], std::slice::from_ref(&given));
    assert_eq!(out.iter().map(Dataset::len).collect::<Vec<_>>(), [56, 141, 120, 277]);
    assert_eq!(notes[0].after.samples, 600 - spikes.len());
    assert_eq!(out[1].channels[1].values[0], clean[59]);
    assert!(out.iter().all(|r| r.channels[0].values.len() == r.len()), "all channels are split alike");
    let (out, _) = run(&[("hampel", &keys("replace"))], std::slice::from_ref(&given));
    let mut window: Vec<f64> = (193..=207).map(|t| given.channels[1].values[t]).collect();
    window.sort_by(f64::total_cmp);
    assert_eq!(out[0].channels[1].values[200], window[7]);
}

fn noise_free_wave(t: usize) -> f64 {
    2.0 * (0.15 * t as f64).sin()
}

/// Over normal noise the share of false alarms is that of the limit: 0.27 % at three sigma, more for a short window
/// whose robust deviation varies itself.
#[test]
fn hampel_on_normal_noise_has_few_false_alarms() {
    let y = noise(20_000, 11);
    let given = record("a", vec![channel("y", Role::Output, y)]);
    let share = |half: usize| {
        let keys = format!("half_width = {half}\naction = 'mark'");
        let (_, notes) = run(&[("hampel", &keys)], std::slice::from_ref(&given));
        runs_of(&notes[0], Became::Missing).iter().map(Gap::samples).sum::<usize>() as f64 / 20_000.0
    };
    let sigma = (0.0027f64 / 20_000.0).sqrt();
    let long = share(500);
    assert!((long - 0.0027).abs() < 4.0 * sigma, "{long}");
    assert!(share(5) < 0.05);
}

/// A signal of few levels: one step of the quantisation is no outlier although half the window is one value.
#[test]
fn quantised_signals_keep_their_steps() {
    let y: Vec<f64> = (0..300).map(|t| if t % 13 == 5 { 2.5 } else { 2.0 }).collect();
    let mut spiked = y.clone();
    spiked[100] = 9.0;
    let given = record("a", vec![channel("y", Role::Output, spiked)]);
    let (_, notes) = run(&[("hampel", "")], &[given]);
    assert_eq!(runs_of(&notes[0], Became::Interpolated), [Gap { from: 100, to: 101 }]);
    let (_, notes) = run(&[("hampel", "least = 0")], &[record("a", vec![channel("y", Role::Output, y)])]);
    assert!(!notes[0].remarks.is_empty(), "many outliers are questioned: {:?}", notes[0].changes);
}

/// Residuals of the true model: the planted errors and no others; the model fills them where asked.
#[test]
fn residual_outliers_are_the_planted_ones() {
    let model: Vec<f64> = (0..500).map(|t| 30.0 * (0.1 * t as f64).sin()).collect();
    let mut rng = Rng64::new(5);
    let mut y: Vec<f64> = model.iter().map(|m| m + rng.uniform_in(-1.0, 1.0)).collect();
    y[40] = model[40] + 8.0;
    y[300] = model[300] - 6.0;
    let mut e: Vec<f64> = y.iter().zip(&model).map(|(y, m)| y - m).collect();
    e[0] = f64::NAN;
    let given = record("a", vec![channel("y", Role::Output, y)]);
    let step = residual_outliers(&toml::from_str("action = 'replace'").unwrap()).unwrap();
    let (out, note) = step.apply(vec![given.clone()], "y", std::slice::from_ref(&e)).unwrap();
    let places = [Gap { from: 40, to: 41 }, Gap { from: 300, to: 301 }];
    assert_eq!(runs_of(&note, Became::Replaced), places);
    assert!((out[0].channels[0].values[40] - model[40]).abs() < 1e-12);
    assert!(step.apply(vec![given], "y", &[e[1..].to_vec()]).is_err());
}

#[test]
fn gaps_are_listed_filled_when_short_and_split_when_long() {
    let mut y: Vec<f64> = (0..100).map(f64::from).collect();
    let mut u: Vec<f64> = (0..100).map(|t| if t < 50 { 1.0 } else { 2.0 }).collect();
    y[10..12].fill(f64::NAN);
    y[40..48].fill(f64::NAN);
    y[0] = f64::NAN;
    u[46..52].fill(f64::NAN);
    let given = record("a", vec![channel("u", Role::Input, u), channel("y", Role::Output, y)]);
    assert_eq!(given.channels[1].gaps(), [(0, 1), (10, 12), (40, 48)].map(|(from, to)| Gap { from, to }));

    let (out, notes) = run(&[("missing", "")], std::slice::from_ref(&given));
    assert_eq!(runs_of(&notes[0], Became::Interpolated), [Gap { from: 10, to: 12 }]);
    assert_eq!(
        runs_of(&notes[0], Became::CutOut),
        [(46, 52), (0, 1), (40, 48)].map(|(from, to)| Gap { from, to })
    );
    let expected: Vec<Vec<f64>> = vec![(1..40).map(f64::from).collect(), (52..100).map(f64::from).collect()];
    assert_eq!(out.iter().map(|r| r.channels[1].values.clone()).collect::<Vec<_>>(), expected);

    let (out, notes) =
        run(&[("missing", "longer = 'mark'\nby = 'hold'\nlongest = 6")], std::slice::from_ref(&given));
    assert_eq!(out[0].channels[0].values[46..52], [1.0; 6]);
    assert_eq!(out[0].channels[1].values[11], 9.0);
    assert_eq!(runs_of(&notes[0], Became::Missing), [(0, 1), (40, 48)].map(|(from, to)| Gap { from, to }));

    // Every part begins with samples that initialise: 39 and 48 samples are left, 45 are needed.
    let slow = Dataset { init_samples: 35, ..given.clone() };
    let (out, notes) = run(&[("missing", "")], &[slow]);
    assert_eq!((out.len(), out[0].len(), out[0].init_samples), (1, 48, 35));
    let told = notes[0].sentences().join("\n");
    assert!(
        told.contains("a: samples 1 to 39 given up: 39 samples, 35 initialise and at least 10 more"),
        "{told}"
    );

    let all = plan(&[("missing", "longer = 'refuse'")]);
    let message = prepare(&all, vec![given], &mut |_, _| ()).unwrap_err().to_string();
    assert!(message.contains("`u`") && message.contains("46 to 51"), "{message}");
}

/// Marked samples go into experiments that allow them, and into no others.
#[test]
fn marked_samples_reach_only_those_who_ask_for_them() {
    let mut given = record(
        "a",
        vec![
            channel("u", Role::Input, vec![0.0, f64::NAN, 2.0]),
            channel("y", Role::Output, vec![1.0, 2.0, f64::NAN]),
            channel("dead", Role::Auxiliary, vec![f64::NAN; 3]),
        ],
    );
    let inputs = ["u".to_string()];
    assert!(matches!(
        experiments(std::slice::from_ref(&given), &inputs, "y"),
        Err(DataError::NonFinite { sample: 1, .. })
    ));
    let e = experiments_marked(std::slice::from_ref(&given), &inputs, "y").unwrap();
    assert!(e[0].u[1].is_nan() && e[0].y[2].is_nan() && e[0].u[2] == 2.0);
    let refused = experiments_marked(std::slice::from_ref(&given), &inputs, "dead").unwrap_err();
    assert_eq!(
        refused.to_string(),
        "a: channel `dead` is missing in all 3 samples: leave it out or record it"
    );
    given.channels[1].values[0] = f64::INFINITY;
    assert!(experiments_marked(std::slice::from_ref(&given), &inputs, "y").is_err());
    assert!(prepare(&[], vec![given.clone()], &mut |_, _| ()).is_err());
    given.sample_time_s = f64::NAN;
    let message = experiments(&[given], &inputs, "y").unwrap_err().to_string();
    assert!(message.contains("resample"), "{message}");
}

#[test]
fn windows_keep_or_cut_their_stretch() {
    let given = [
        record("a", vec![channel("y", Role::Output, (0..100).map(f64::from).collect())]),
        record("b", vec![channel("y", Role::Output, (0..50).map(f64::from).collect())]),
    ];
    let (out, _) = run(&[("window", "from_s = 2.0\nto_s = 4.5\nrecords = ['a']")], &given);
    assert_eq!(out[0].channels[0].values, (20..45).map(f64::from).collect::<Vec<_>>());
    assert_eq!(out[1], given[1]);
    let gone = prepare(&plan(&[("window", "from_s = 6.0")]), given.to_vec(), &mut |_, _| ()).unwrap_err();
    assert!(gone.to_string().contains("step window, b: no sample between 6 s"), "{gone}");
    let gone = prepare(&plan(&[("window", "to_s = 0.3")]), given.to_vec(), &mut |_, _| ()).unwrap_err();
    assert!(matches!(gone, PrepareError::NothingLeft { .. }), "{gone}");
    assert!(prepare(&plan(&[("window", "records = ['c']")]), given.to_vec(), &mut |_, _| ()).is_err());
}

/// Every stage is seen, notes survive the file they are written to, and every step documents its keys.
#[test]
fn stages_are_watched_and_notes_survive_a_file() {
    let mut y = noise(200, 3);
    y[50] = 80.0;
    y[120..140].fill(f64::NAN);
    let given = record("a", vec![channel("y", Role::Output, y)]);
    let steps = [
        ("hampel", ""),
        ("missing", ""),
        ("offset", "remove = 'trend'"),
        ("decimate", "factor = 2\nlow_pass = false"),
    ];
    let mut seen = Vec::new();
    let (_, notes) =
        prepare(&plan(&steps), vec![given], &mut |k, r| seen.push((k, r.len(), r[0].len()))).unwrap();
    assert_eq!(seen, [(0, 1, 200), (1, 1, 200), (2, 2, 120), (3, 2, 120), (4, 2, 60)]);
    let text = serde_json::to_string(&notes).unwrap();
    let back: Vec<Note> = serde_json::from_str(&text).unwrap();
    assert_eq!(back, notes);
    assert!(notes.iter().all(|n| !n.sentences().is_empty()));
    assert_eq!(docs().len(), STEPS.len());
    for doc in docs() {
        assert!(doc.params.iter().all(|p| !p.what.is_empty() && !p.unit.is_empty()), "{}", doc.name);
    }
    let nearest = Planned::new("hample", &toml::Table::new()).err().unwrap().to_string();
    assert!(nearest.contains("hampel"), "{nearest}");
}
