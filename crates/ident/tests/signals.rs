//! What every signal must do, and the defining property of each.

use std::collections::BTreeMap;

use dynocal_ident::signal::{SIGNALS, signal};
use dynocal_numerics::rng::Rng64;

const DT_S: f64 = 0.03;

/// Keys of every member; a member without an entry fails the tests.
fn keys() -> BTreeMap<&'static str, &'static str> {
    BTreeMap::from([
        ("aprbs", "lo = -1.0\nhi = 3.0\nlevels = 5\nhold_s = 0.9\nphase_s = 0.3"),
        ("prbs", "lo = -1.0\nhi = 3.0\norder = 7\nhold_s = 0.06"),
        ("rbs", "lo = -1.0\nhi = 3.0\nhold_s = 0.06\nchange = 0.3"),
        ("band_noise", "lo = -1.0\nhi = 3.0\nf_max_hz = 4.0"),
        ("ramp_hold", "lo = -1.0\nhi = 3.0\nrate_per_s = 2.0\nhold_s = 0.6"),
        ("space_filling", "lo = -1.0\nhi = 3.0\nhold_s = 0.3\nramp_s = 0.3\nchannel = 2\nchannels = 3"),
        ("udrn", "lo = -1.0\nhi = 3.0\nhold_s = 0.3\nphase_s = 0.15"),
        ("random_walk", "lo = -1.0\nhi = 3.0\nstep = 0.5\nhold_s = 0.06"),
        ("multisine", "lo = -1.0\nhi = 3.0\nf_min_hz = 0.2\nf_max_hz = 4.0"),
        ("staircase", "lo = -1.0\nhi = 3.0\nlevels = 9\nhold_s = 0.6"),
        ("sweep", "lo = -1.0\nhi = 3.0\nperiod_s = 6.0\ndwell_s = 1.0"),
        ("chirp", "lo = -1.0\nhi = 3.0\nf_start_hz = 0.1\nf_end_hz = 5.0"),
    ])
}

fn fill(name: &str, text: &str, n: usize, seed: u64) -> Vec<f64> {
    let mut u = vec![f64::NAN; n];
    signal(name, &toml::from_str(text).unwrap()).unwrap().fill(&mut u, DT_S, &mut Rng64::new(seed)).unwrap();
    u
}

fn member(name: &str, n: usize, seed: u64) -> Vec<f64> {
    fill(name, keys()[name], n, seed)
}

fn fault(name: &str, text: &str, n: usize) -> String {
    let built = signal(name, &toml::from_str(text).unwrap());
    match built {
        Err(e) => e.to_string(),
        Ok(s) => s.fill(&mut vec![0.0; n], DT_S, &mut Rng64::new(1)).unwrap_err().to_string(),
    }
}

#[test]
fn every_member_respects_its_limits_and_repeats_for_a_seed() {
    for m in SIGNALS {
        let name = m.doc.name;
        for seed in 0..5 {
            let u = member(name, 2000, seed);
            assert!(u.iter().all(|v| (-1.0..=3.0).contains(v)), "{name}");
            assert_eq!(u, member(name, 2000, seed), "{name}");
        }
        assert!(member(name, 0, 1).is_empty(), "{name}: an empty record is no fault");
    }
}

#[test]
fn every_member_refuses_bad_keys() {
    for m in SIGNALS {
        let (name, good) = (m.doc.name, keys()[m.doc.name]);
        assert!(fault(name, &format!("{good}\nwrong = 1"), 100).contains("wrong"), "{name}");
        let swapped = good.replace("lo = -1.0", "lo = 5.0");
        assert!(fault(name, &swapped, 100).contains("lo < hi"), "{name}");
        assert!(fault(name, &good.replace("hi = 3.0", ""), 100).contains("hi"), "{name}");
        for p in m.doc.params {
            assert!(!p.what.is_empty() && !p.unit.is_empty(), "{name}.{}", p.name);
        }
    }
    assert!(fault("aprbs", "lo = 0\nhi = 1\nhold_s = 0.001", 9).contains("at least one sample of 0.03 s"));
    assert!(fault("prbs", "lo = 0\nhi = 1\nhold_s = 1\norder = 40", 9).contains("expected 2 to 31"));
    assert!(fault("multisine", "lo = 0\nhi = 1\nf_min_hz = 1\nf_max_hz = 50", 100).contains("below"));
    assert!(fault("chirp", "lo = 0\nhi = 1\nf_start_hz = 1\nf_end_hz = 50", 100).contains("below"));
    assert!(fault("sweep", "lo = 0\nhi = 1\nperiod_s = 2\ndwell_s = 1", 100).contains("half the period"));
    assert!(fault("random_walk", "lo = 0\nhi = 1\nstep = 2\nhold_s = 1", 100).contains("at most 1"));
    assert!(fault("rbs", "lo = 0\nhi = 1\nhold_s = 1\nchange = 1.5", 9).contains("probability"));
    assert!(fault("band_noise", "lo = 0\nhi = 1\nf_max_hz = 50", 100).contains("below"));
    assert!(fault("ramp_hold", "lo = 0\nhi = 1\nhold_s = 1\nrate_per_s = 0", 9).contains("positive"));
    assert!(
        fault("space_filling", "lo = 0\nhi = 1\nhold_s = 1\nchannel = 2", 9)
            .contains("channel = 2 of channels = 1")
    );
    assert!(fault("aprbs", "lo = 0\nhi = 1\nhold_s = 1\nhold_max_s = 0.5", 9).contains("at least hold_s"));
    assert!(fault("aprb", "lo = 0\nhi = 1", 9).contains("did you mean `aprbs`"));
}

/// Switches exactly every hold, never to the same level, uses all levels, displaced by the phase.
#[test]
fn aprbs_switches_every_hold_and_never_repeats_a_level() {
    for seed in 0..20 {
        let u = member("aprbs", 3000, seed);
        let (hold, phase) = (30, 10);
        let mut used = [false; 5];
        for t in 0..u.len() {
            let switches = (t + phase) % hold == 0;
            if t > 0 {
                assert_eq!(u[t] != u[t - 1], switches, "seed {seed}, sample {t}");
            }
            let level = u[t] + 1.0;
            assert_eq!(level, level.round());
            used[level as usize] = true;
        }
        assert_eq!(used, [true; 5]);
    }
}

/// Each of the other levels follows equally often (chi-square with 3 degrees of freedom, 99.9 % point 16.27).
#[test]
fn aprbs_draws_the_other_levels_evenly() {
    let u = fill("aprbs", "lo = 0\nhi = 4\nhold_s = 0.03", 40_000, 4);
    let mut counts = [[0.0f64; 5]; 5];
    for t in 1..u.len() {
        counts[u[t - 1] as usize][u[t] as usize] += 1.0;
    }
    for (i, row) in counts.iter().enumerate() {
        let expected = row.iter().sum::<f64>() / 4.0;
        let chi: f64 = (0..5).filter(|j| *j != i).map(|j| (row[j] - expected).powi(2) / expected).sum();
        assert!(chi < 16.27 && row[i] == 0.0, "{row:?}");
    }
}

#[test]
fn prbs_holds_each_bit_and_repeats_after_a_period() {
    let u = member("prbs", 2 * 127 * 2, 3);
    assert!(u.chunks(2).all(|c| c[0] == c[1]));
    assert_eq!(u[..254], u[254..]);
    // A period has one more high bit than low bits.
    assert_eq!(u[..254].iter().filter(|v| **v == 3.0).count(), 128);
}

/// Kolmogorov distance of the held values to the uniform distribution (99.9 % point 1.95 / sqrt n).
#[test]
fn udrn_is_uniform_and_held() {
    let u = fill("udrn", "lo = -1\nhi = 3\nhold_s = 0.3", 50_000, 2);
    assert!(u.chunks(10).all(|c| c.iter().all(|v| *v == c[0])));
    let mut values: Vec<f64> = u.iter().step_by(10).map(|v| (v + 1.0) / 4.0).collect();
    values.sort_by(f64::total_cmp);
    let n = values.len() as f64;
    let distance = values
        .iter()
        .enumerate()
        .fold(0.0f64, |d, (i, v)| d.max((v - i as f64 / n).abs()).max(((i + 1) as f64 / n - v).abs()));
    assert!(distance < 1.95 / n.sqrt(), "{distance}");
    // A phase moves the switching instants.
    let displaced = member("udrn", 100, 2);
    assert!((1..100).all(|t| (displaced[t] != displaced[t - 1]) == ((t + 5) % 10 == 0)));
}

#[test]
fn random_walk_steps_by_its_step_or_reflects() {
    let u = member("random_walk", 20_000, 1);
    let mut reflections = 0;
    for t in 1..u.len() {
        if t % 2 != 0 {
            assert_eq!(u[t], u[t - 1]);
            continue;
        }
        let (from, step) = (u[t - 1], (u[t] - u[t - 1]).abs());
        if (step - 0.5).abs() > 1e-12 {
            // Reflected: what is missing on the way out comes back.
            let out = if from > 1.0 { 3.0 - from } else { from + 1.0 };
            assert!(out < 0.5 && (step - (0.5 - 2.0 * out).abs()).abs() < 1e-12, "{from} {step}");
            reflections += 1;
        }
    }
    assert!(reflections > 0);
}

/// Amplitude of the line `k` of a record, by the defining sum.
fn amplitude(u: &[f64], k: usize) -> f64 {
    let n = u.len();
    let (mut re, mut im) = (0.0, 0.0);
    for (t, v) in u.iter().enumerate() {
        let a = std::f64::consts::TAU * ((k * t) % n) as f64 / n as f64;
        re += v * a.cos();
        im += v * a.sin();
    }
    (re * re + im * im).sqrt() * 2.0 / n as f64
}

/// Peak over rms about the middle of the limits -1 and 3.
fn crest(u: &[f64]) -> f64 {
    let rms = (u.iter().map(|v| (v - 1.0).powi(2)).sum::<f64>() / u.len() as f64).sqrt();
    u.iter().fold(0.0f64, |m, v| m.max((v - 1.0).abs())) / rms
}

/// Flat spectrum on the lines of the band, nothing elsewhere, and a crest factor far below that of one phase.
#[test]
fn multisine_has_a_flat_band_and_nothing_else() {
    let n = 1000;
    let u = member("multisine", n, 1);
    let mean = u.iter().sum::<f64>() / n as f64;
    assert!((mean - 1.0).abs() < 1e-12);
    let amplitude = |k: usize| amplitude(&u, k);
    // Lines are 1 / 30 s apart: 0.2 Hz is number 6, 4 Hz is number 120.
    let level = amplitude(6);
    for k in 1..n / 2 {
        let expected = if (6..=120).contains(&k) { level } else { 0.0 };
        assert!((amplitude(k) - expected).abs() < 1e-10, "line {k}");
    }
    let rms = (u.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
    let crest = 2.0 / rms;
    assert!(crest < 2.0, "crest factor {crest}"); // sqrt(2 * 115) = 15 with equal phases
}

#[test]
fn staircase_visits_all_levels_up_and_down() {
    let u = member("staircase", 20 * 16, 1);
    let levels: Vec<f64> = u.iter().step_by(20).copied().collect();
    let up: Vec<f64> = (0..9).map(|k| -1.0 + 0.5 * f64::from(k)).collect();
    assert_eq!(levels[..9], up);
    assert!((9..16).all(|i| levels[i] == up[16 - i]));
    assert!(u.chunks(20).all(|c| c.iter().all(|v| *v == c[0])));
}

#[test]
fn sweep_has_one_slope_its_dwell_and_its_period() {
    let u = member("sweep", 800, 1);
    assert!((0..600).all(|t| (u[t] - u[t + 200]).abs() < 1e-12), "period of 6 s is 200 samples");
    // 1 s of dwell at each end, 2 s for a range of 4: 2 per second.
    let slope = |t: usize| (u[t + 1] - u[t]) / DT_S;
    for t in 0..199 {
        let (from_s, to_s) = (t as f64 * DT_S, (t + 1) as f64 * DT_S);
        if to_s <= 1.0 || (from_s >= 3.0 && to_s <= 4.0) {
            assert!(slope(t).abs() < 1e-9, "dwell at {from_s}");
        } else if from_s >= 1.0 && to_s <= 3.0 {
            assert!((slope(t) - 2.0).abs() < 1e-9, "up at {from_s}");
        } else if from_s >= 4.0 {
            assert!((slope(t) + 2.0).abs() < 1e-9, "down at {from_s}");
        }
    }
    assert_eq!((u[0], u[101]), (-1.0, 3.0));
}

/// Upward crossings of the middle come where the phase is a whole number: f0 t + (f1 - f0) t^2 / 2T = k.
#[test]
fn chirp_crosses_its_middle_where_the_phase_says() {
    let n = 4000;
    let u = member("chirp", n, 1);
    let record_s = n as f64 * DT_S;
    let (f0, f1) = (0.1, 5.0);
    let crossings: Vec<f64> = (1..n)
        .filter(|&t| u[t - 1] < 1.0 && u[t] >= 1.0)
        .map(|t| (t as f64 - (u[t] - 1.0) / (u[t] - u[t - 1])) * DT_S)
        .collect();
    // 306 cycles in 120 s; the crossing at t = 0 is not seen.
    assert!((crossings.len() as f64 - 305.0).abs() <= 1.0, "{}", crossings.len());
    for (k, t) in crossings.iter().enumerate() {
        let cycles = f0 * t + (f1 - f0) * t * t / (2.0 * record_s);
        assert!((cycles - (k + 1) as f64).abs() < 0.01, "crossing {k}: {cycles}");
    }
}

/// Clipping keeps the flat band and brings the crest factor below that of Schroeder's phases, near the 1.4 to 1.5 that
/// the literature gives for many lines.
#[test]
fn optimised_phases_lower_the_crest_factor() {
    for (f_min, f_max) in [(0.2, 4.0), (0.034, 1.0), (1.0, 12.0)] {
        let band = format!("lo = -1.0\nhi = 3.0\nf_min_hz = {f_min}\nf_max_hz = {f_max}\n");
        let schroeder = fill("multisine", &band, 1000, 1);
        let best = fill("multisine", &format!("{band}phases = \"optimised\""), 1000, 1);
        assert!(
            crest(&best) < crest(&schroeder) && crest(&best) < 1.6,
            "{}, {}",
            crest(&schroeder),
            crest(&best)
        );
        let (first, last) = ((f_min * 30.0_f64).ceil() as usize, (f_max * 30.0_f64) as usize);
        let level = amplitude(&best, first);
        for k in 1..500 {
            let expected = if (first..=last).contains(&k) { level } else { 0.0 };
            assert!((amplitude(&best, k) - expected).abs() < 1e-10, "line {k}");
        }
    }
}

/// Flat below 4 Hz, nothing above; other seeds, other phases; moments of a normal distribution within the sampling error
/// of 120 lines (a sum of F random-phase sines has kurtosis 3 - 1.5 / F).
#[test]
fn band_noise_is_flat_and_normal() {
    let n = 1000;
    let u = member("band_noise", n, 1);
    let level = amplitude(&u, 1);
    for k in 1..n / 2 {
        let expected = if k <= 120 { level } else { 0.0 };
        assert!((amplitude(&u, k) - expected).abs() < 1e-10, "line {k}");
    }
    assert!(u != member("band_noise", n, 2));
    let mut kurtosis = 0.0;
    for seed in 0..40 {
        let u = member("band_noise", n, seed);
        let moment = |p: i32| u.iter().map(|v| (v - 1.0).powi(p)).sum::<f64>() / n as f64;
        kurtosis += moment(4) / moment(2).powi(2) / 40.0;
    }
    assert!((kurtosis - 3.0).abs() < 0.1, "{kurtosis}");
}

/// Autocorrelation (1 - 2 p)^k over k clocks, within 4 standard errors of 200 000 clocks.
#[test]
fn rbs_has_the_autocorrelation_of_its_probability() {
    for p in [0.5f64, 0.3, 0.1] {
        let u = fill("rbs", &format!("lo = -1\nhi = 1\nhold_s = 0.03\nchange = {p}"), 200_000, 3);
        assert!(u.iter().all(|v| v.abs() == 1.0));
        for k in 1..=5 {
            let r = u.iter().zip(&u[k..]).map(|(a, b)| a * b).sum::<f64>() / (u.len() - k) as f64;
            let rho = 1.0 - 2.0 * p;
            // Bartlett's formula for a first-order process: (1 + rho^2) / (1 - rho^2) bounds it.
            let error = ((1.0 + rho * rho) / (1.0 - rho * rho) / u.len() as f64).sqrt();
            assert!((r - rho.powi(k as i32)).abs() < 4.0 * error, "p {p}, lag {k}: {r}");
        }
    }
    let held = member("rbs", 2000, 5);
    assert!(held.chunks(2).all(|c| c[0] == c[1]));
}

#[test]
fn ramp_hold_keeps_its_gradient_and_its_hold() {
    let u = member("ramp_hold", 5000, 2);
    let (step, mut run, mut holds) = (2.0 * DT_S, 0, 0);
    for t in 1..u.len() {
        let change = (u[t] - u[t - 1]).abs();
        assert!(change <= step + 1e-12);
        if change == 0.0 {
            run += 1;
        } else {
            // 20 samples at a level are 19 unchanged ones.
            assert!(run == 0 || run == 19, "sample {t}: {run}");
            holds += usize::from(run > 0);
            run = 0;
        }
    }
    assert!(holds > 50, "{holds}");
}

/// Two channels miss less than a third of the 8 x 8 cells that 128 random levels miss (64 e^-2 = 8.7 of them); the
/// largest gap of one channel is that of the three-distance theorem.
#[test]
fn space_filling_levels_fill_their_box() {
    let mut missed = 0;
    for seed in 0..20 {
        let channel = |j: u32| {
            let keys = format!("lo = 0\nhi = 1\nhold_s = 0.03\nchannel = {j}\nchannels = 2");
            fill("space_filling", &keys, 128, 2 * seed + u64::from(j))
        };
        let (a, b) = (channel(1), channel(2));
        let mut seen = [false; 64];
        a.iter().zip(&b).for_each(|(x, y)| seen[(x * 8.0) as usize * 8 + (y * 8.0) as usize] = true);
        missed += seen.iter().filter(|s| !**s).count();
        let mut one = fill("space_filling", "lo = 0\nhi = 1\nhold_s = 0.03", 128, seed);
        one.sort_by(f64::total_cmp);
        let gap = one.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
        // Golden ratio g, n from F(11) = 89 to F(12) - 1 = 143 points: gaps are g^-9, g^-10, g^-11.
        let g = 0.5 * (1.0 + 5.0f64.sqrt());
        assert!(gap <= g.powi(-9) + 1e-12, "{gap}");
    }
    assert!((missed as f64) < 20.0 * 64.0 * (-2.0f64).exp() / 3.0, "{missed} cells missed");
    let ramp = member("space_filling", 2000, 1);
    let largest = ramp.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    assert!(largest <= 4.0 / 0.3 * DT_S, "gradient above (hi - lo) / ramp_s: {largest}");
    assert!(ramp.chunks(20).all(|c| c[..c.len().min(10)].iter().all(|v| *v == c[0])));
}

#[test]
fn aprbs_draws_its_hold_between_two_times() {
    let u = fill("aprbs", "lo = 0\nhi = 1\nhold_s = 0.3\nhold_max_s = 0.6", 30_000, 1);
    let mut counts = [0usize; 32];
    let mut run = 1;
    for t in 1..u.len() {
        if u[t] == u[t - 1] {
            run += 1;
        } else {
            counts[run.min(31)] += 1;
            run = 1;
        }
    }
    // 11 holds from 10 to 20 samples, about 181 each: standard deviation 13.
    assert!((10..=20).all(|k| (120..245).contains(&counts[k])), "{counts:?}");
    assert_eq!(counts.iter().sum::<usize>(), counts[10..=20].iter().sum::<usize>());
}
