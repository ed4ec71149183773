//! Checks before a fit, against signals whose answer is known.

use std::f64::consts::TAU;

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::excitation::bla::{Realisation, bla};
use dynocal_ident::excitation::correlation::correlation;
use dynocal_ident::excitation::coverage::{coverage, pair_coverage};
use dynocal_ident::excitation::persistence::persistence;
use dynocal_ident::excitation::regressors::rank;
use dynocal_ident::excitation::sample_time::Verdict;
use dynocal_ident::excitation::{Settings, excitation};
use dynocal_ident::signal::signal;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;

fn record(name: &str, dt_s: f64, channels: &[(&str, Role, &[f64])]) -> Dataset {
    let channel = |(name, role, values): &(&str, Role, &[f64])| Channel {
        name: (*name).into(),
        unit: "-".into(),
        role: *role,
        values: values.to_vec(),
    };
    let channels = channels.iter().map(channel).collect();
    Dataset { name: name.into(), sample_time_s: dt_s, channels, init_samples: 0, origin: "test".into() }
}

/// A sum of k sines is persistently exciting of order 2 k, with any mean beside a constant term.
#[test]
fn k_sines_have_order_2k() {
    for k in [1, 3, 5] {
        for mean in [0.0, 40.0] {
            let u: Vec<f64> = (0..500)
                .map(|t| {
                    mean + (0..k).map(|i| (0.5 * (i + 1) as f64 * t as f64 + i as f64).sin()).sum::<f64>()
                })
                .collect();
            assert_eq!(persistence(&[&u], 25, 1e-6, true).unwrap().order, 2 * k, "{k} sines, mean {mean}");
            let alone = persistence(&[&u], 25, 1e-6, false).unwrap();
            assert_eq!(alone.order, 2 * k + usize::from(mean != 0.0), "{k} sines, mean {mean}, no constant");
            assert_eq!((alone.tested, alone.shares.len()), (25, 25));
        }
    }
}

/// A maximum-length sequence of period 2^n - 1 has that order, one less beside a constant term.
#[test]
fn a_prbs_has_the_order_of_its_period() {
    let mut u = vec![0.0; 31 * 5];
    let keys = toml::from_str("lo = -1\nhi = 1\norder = 5\nhold_s = 0.1").unwrap();
    signal("prbs", &keys).unwrap().fill(&mut u, 0.1, &mut Rng64::new(1)).unwrap();
    assert_eq!(persistence(&[&u], 45, 1e-9, false).unwrap().order, 31);
    assert_eq!(persistence(&[&u], 45, 1e-9, true).unwrap().order, 30);
    let constant = vec![3.0; 100];
    assert_eq!(persistence(&[&constant], 10, 1e-9, true).unwrap().order, 0);
    assert_eq!(persistence(&[&constant], 10, 1e-9, false).unwrap().order, 1);
}

/// Noise excites every order; two records are not joined: each sine alone has order 2, so has the pair of records.
#[test]
fn records_are_not_joined() {
    let mut rng = Rng64::new(2);
    let noise: Vec<f64> = (0..3000).map(|_| rng.normal()).collect();
    assert_eq!(persistence(&[&noise], 40, 1e-6, true).unwrap().order, 40);
    let sine = |shift: f64| -> Vec<f64> { (0..200).map(|t| (0.7 * t as f64 + shift).sin()).collect() };
    assert_eq!(persistence(&[&sine(0.0), &sine(1.3)], 20, 1e-6, true).unwrap().order, 2);
    assert_eq!(persistence(&[&[1.0, 2.0, 4.0]], 20, 1e-6, true).unwrap().tested, 0);
}

#[test]
fn dependent_terms_are_named_with_their_combination() {
    let mut rng = Rng64::new(3);
    let names = ["a", "b", "c", "twice", "none"].map(String::from);
    let phi: Vec<f64> = (0..200)
        .flat_map(|_| {
            let (a, b, c) = (rng.normal(), 100.0 * rng.normal(), 1e-3 * rng.normal());
            [a, b, c, 2.0 * a - 0.5 * b, 0.0]
        })
        .collect();
    let found = rank(&phi, &names, 0.0).unwrap();
    assert_eq!((found.terms, found.rank, found.dependencies.len()), (5, 3, 2));
    assert_eq!(found.dependencies[1].sentence(), "none = 0");
    // Which of the three dependent terms is named is free; the relation is not.
    let d = &found.dependencies[0];
    let mut relation = std::collections::BTreeMap::from([(d.term.clone(), -1.0)]);
    d.combination.iter().for_each(|s| assert!(relation.insert(s.term.clone(), s.coefficient).is_none()));
    let unit = relation["twice"];
    assert_eq!(relation.keys().collect::<Vec<_>>(), ["a", "b", "twice"]);
    assert!((relation["a"] / unit + 2.0).abs() < 1e-9 && (relation["b"] / unit - 0.5).abs() < 1e-9);
}

#[test]
fn coverage_counts_cells() {
    let mut rng = Rng64::new(4);
    let a: Vec<f64> = (0..5000).map(|_| rng.uniform_in(10.0, 60.0)).collect();
    let b: Vec<f64> = (0..5000).map(|_| rng.uniform_in(0.0, 1.0)).collect();
    let (ca, cb) =
        (coverage("a", &a, Some(Interval::new(10.0, 110.0))).unwrap(), coverage("b", &b, None).unwrap());
    assert_eq!((ca.occupied, cb.occupied, cb.span, ca.outside), (0.5, 1.0, 1.0, 0.0));
    assert!((ca.span - 0.5).abs() < 0.01);
    let apart = pair_coverage(&ca, &cb, &a, &b);
    assert_eq!((apart.occupied, apart.of_reachable, apart.counts.iter().sum::<usize>()), (1.0, 1.0, 5000));
    let together = pair_coverage(&cb, &cb, &b, &b);
    assert_eq!((together.occupied, together.of_reachable), (0.1, 0.1));
    assert!(coverage("a", &[f64::NAN], None).is_none());
}

/// Equation 2.45 itself, and a bound that holds for slow inputs: 5 % of independent pairs are outside.
#[test]
fn correlations_and_their_bound() {
    let a = [1.0, 2.0, f64::NAN, 4.0, 7.0];
    let b = [2.0, 1.0, 50.0, 5.0, 6.0];
    let c = correlation(("a", &a), ("b", &b), 0).unwrap();
    // Over the rows 0, 1, 3, 4: E(ab) = 16.5, E(a) = E(b) = 3.5, E(a^2) = 17.5, E(b^2) = 16.5.
    let expected = (16.5 - 12.25) / ((17.5f64 - 12.25) * (16.5 - 12.25)).sqrt();
    assert!((c.r - expected).abs() < 1e-12, "{}", c.r);
    assert!(correlation(("a", &[1e6 + 0.1; 50]), ("b", &[2.0; 50]), 3).is_none());

    let slow = |rng: &mut Rng64| -> Vec<f64> {
        let mut x = 0.0;
        let mut next = || {
            x = 0.9 * x + rng.normal();
            x
        };
        (0..50).for_each(|_| {
            next();
        });
        (0..1500).map(|_| next()).collect()
    };
    let mut outside = 0;
    let mut outside_white = 0;
    for seed in 0..400 {
        let mut rng = Rng64::stream(9, seed);
        let (a, b) = (slow(&mut rng), slow(&mut rng));
        let c = correlation(("a", &a), ("b", &b), 0).unwrap();
        outside += usize::from(c.r.abs() > c.bound);
        outside_white += usize::from(c.r.abs() > 1.96 / 1500f64.sqrt());
    }
    // 20 expected of 400; four standard deviations of the count are 17.
    assert!((4..=37).contains(&outside), "{outside}");
    assert!(outside_white > 100, "{outside_white}");
}

/// First-order lag of time constant tau: the rise time is tau ln 9. Two inputs, noise on the output.
#[test]
fn the_sample_time_is_judged_by_the_rise_time() {
    let cases = [(0.3, Verdict::TooSlow), (0.1, Verdict::Fits), (0.02, Verdict::TooFast)];
    let tau = 0.5 / 9f64.ln();
    for (dt, verdict) in cases {
        let mut rng = Rng64::new(6);
        let (pole, slow) = ((-dt / tau).exp(), (-dt / (3.0 * tau)).exp());
        let mut hold = |every: f64| -> Vec<f64> {
            let n = (every / dt).round() as usize;
            let mut level = 0.0;
            (0..6000)
                .map(|t| {
                    if t % n == 0 {
                        level = rng.uniform_in(-1.0, 1.0);
                    }
                    level
                })
                .collect()
        };
        let (u, v) = (hold(0.6), hold(0.9));
        let (mut fast, mut late) = (0.0, 0.0);
        let y: Vec<f64> = (0..6000)
            .map(|t| {
                let now = 3.0 + 2.0 * fast + late;
                fast = pole * fast + (1.0 - pole) * u[t];
                late = slow * late + (1.0 - slow) * v[t];
                now + 0.01 * rng.normal()
            })
            .collect();
        let given =
            record("a", dt, &[("u", Role::Input, &u), ("v", Role::Input, &v), ("y", Role::Output, &y)]);
        let names = ["u".to_string(), "v".to_string()];
        let report = excitation(&[given], &names, &["y".into()], &Settings::default()).unwrap();
        let check = &report.sample_time[0];
        let (u, v) = (&check.rises[0], &check.rises[1]);
        assert_eq!(check.verdict, verdict, "{}", check.sentence());
        // The line between samples that are far apart on an exponential costs some of a sample.
        assert!((u.rise_s - 0.5).abs() < 0.02 + 0.15 * dt, "dt {dt}: {}", u.rise_s);
        assert!((v.rise_s - 1.5).abs() < 0.06 + 0.15 * dt, "dt {dt}: {}", v.rise_s);
        assert!((u.gain - 2.0).abs() < 0.05 && (v.gain - 1.0).abs() < 0.05);
        assert_eq!(report.warnings.iter().any(|w| w.contains("samples of")), verdict != Verdict::Fits);
    }
}

/// What is wrong with a record is said in the channels' names.
#[test]
fn warnings_name_what_is_wrong() {
    let mut rng = Rng64::new(8);
    let spark: Vec<f64> = (0..2000).map(|_| rng.uniform_in(10.0, 20.0)).collect();
    let inj: Vec<f64> = spark.iter().map(|s| 4.0 * s - 5.0).collect();
    let y: Vec<f64> = (0..2000).map(|t| if t == 0 { 0.0 } else { spark[t - 1] + rng.normal() }).collect();
    let channels = [("inj", Role::Input, &inj[..]), ("spark", Role::Input, &spark), ("y", Role::Output, &y)];
    let names = ["inj".to_string(), "spark".to_string()];
    let mut settings = Settings::default();
    settings.ranges.insert("spark".into(), Interval::new(0.0, 40.0));
    let report = excitation(&[record("a", 0.1, &channels)], &names, &["y".into()], &settings).unwrap();
    let text = report.warnings.join("\n");
    for part in [
        "inputs depend on each other",
        "move together (correlation 1.00",
        "25 % of its range",
        "together visit",
    ] {
        assert!(text.contains(part), "`{part}` in:\n{text}");
    }
    assert!(excitation(&[record("a", 0.1, &channels)], &[], &["y".into()], &settings).is_err());
    assert!(serde_json::to_string(&report).is_ok());
}

/// Odd lines with random phases, one of every four left out: what is even and what is odd can be seen apart.
fn odd_random(n: usize, highest: usize, rng: &mut Rng64) -> (Vec<f64>, Vec<usize>) {
    let mut lines: Vec<usize> = Vec::new();
    for group in (1..=highest).step_by(8) {
        let out = group + 2 * rng.below(4);
        lines.extend((group..group + 8).step_by(2).filter(|k| *k != out && *k <= highest));
    }
    let phases: Vec<f64> = lines.iter().map(|_| rng.uniform_in(0.0, TAU)).collect();
    let one = |t: usize| -> f64 {
        lines.iter().zip(&phases).map(|(k, p)| (TAU * (k * t % n) as f64 / n as f64 + p).cos()).sum()
    };
    let gain = (2.0 / lines.len() as f64).sqrt();
    ((0..n).map(|t| gain * one(t)).collect(), lines)
}

fn periodic(u: &[f64], y: &[f64], periods: usize, sigma: f64, rng: &mut Rng64) -> (Vec<f64>, Vec<f64>) {
    let n = u.len();
    (
        (0..periods * n).map(|t| u[t % n]).collect(),
        (0..periods * n).map(|t| y[t % n] + sigma * rng.normal()).collect(),
    )
}

/// Amplitude of line k.
fn line(x: &[f64], k: usize) -> f64 {
    let n = x.len();
    let sum = |f: fn(f64) -> f64| -> f64 {
        x.iter().enumerate().map(|(t, v)| v * f(TAU * (k * t % n) as f64 / n as f64)).sum()
    };
    2.0 / n as f64 * sum(f64::cos).hypot(sum(f64::sin))
}

/// A FIR filter under noise: G is its transfer function within the stated deviations, the noise is that of the record,
/// and no distortion stands out.
#[test]
fn the_bla_of_a_fir_filter_is_its_transfer_function() {
    let (n, periods, sigma) = (512, 6, 0.2);
    let h = [0.0, 0.5, 0.9, -0.3];
    let mut rng = Rng64::new(21);
    let mut records = Vec::new();
    let mut lines = Vec::new();
    for m in 0..5 {
        let (u, l) = odd_random(n, 121, &mut Rng64::stream(77, 0));
        let shift = 37 * m;
        let u: Vec<f64> = (0..n).map(|t| u[(t + shift) % n]).collect();
        let y: Vec<f64> = (0..n).map(|t| (0..4).map(|k| h[k] * u[(t + n - k) % n]).sum()).collect();
        records.push(periodic(&u, &y, periods, sigma, &mut rng));
        lines = l;
    }
    let parts: Vec<Realisation> = records.iter().map(|(u, y)| Realisation { u, y }).collect();
    let found = bla(&parts, n, 0.01).unwrap();
    assert_eq!(found.lines, lines);
    assert_eq!((found.periods, found.realisations), (periods, 5));
    let mut chi = 0.0;
    for (i, k) in lines.iter().enumerate() {
        let w = TAU * *k as f64 / n as f64;
        let re: f64 = (0..4).map(|j| h[j] * (w * j as f64).cos()).sum();
        let im: f64 = (0..4).map(|j| -h[j] * (w * j as f64).sin()).sum();
        let error = (found.gain[i].0 - re).hypot(found.gain[i].1 - im);
        chi += (error / found.noise_std[i]).powi(2);
        assert!((found.frequency_hz[i] - *k as f64 / (n as f64 * 0.01)).abs() < 1e-12);
        assert!(error < 6.0 * found.noise_std[i], "line {k}: {error} with {}", found.noise_std[i]);
    }
    // E |error|^2 is the stated variance; with 25 degrees of freedom per line the quotient is 1.04 in the mean.
    let count = lines.len() as f64;
    assert!((chi / count - 1.04).abs() < 4.0 / count.sqrt(), "{}", chi / count);
    let power = |s: &[f64]| s.iter().map(|v| v * v).sum::<f64>() / s.len() as f64;
    let quotient = power(&found.total_std) / power(&found.noise_std);
    assert!((quotient - 1.0).abs() < 4.0 * (1.0 / (4.0 * count)).sqrt(), "{quotient}");
    let amplitude = (2.0 * sigma * sigma * 2.0 / (n * periods) as f64).sqrt();
    for level in [found.odd.as_ref().unwrap(), found.even.as_ref().unwrap()] {
        assert!(!level.stands_out(), "{} over {}", level.rms, level.noise_rms);
        assert!((level.noise_rms / amplitude - 1.0).abs() < 0.15, "{} for {amplitude}", level.noise_rms);
    }
}

/// A square shows on even lines only, a cube on odd lines only, with the amplitudes of their own spectra.
#[test]
fn distortion_levels_are_where_they_belong() {
    let n = 512;
    let (u, lines) = odd_random(n, 121, &mut Rng64::new(5));
    let powers = [(0.1, 0.0), (0.0, 0.05)];
    for (square, cube) in powers {
        let bent: Vec<f64> = u.iter().map(|v| square * v * v + cube * v.powi(3)).collect();
        let y: Vec<f64> = u.iter().zip(&bent).map(|(v, b)| 3.0 * v + b).collect();
        let (uu, yy) = periodic(&u, &y, 3, 1e-4, &mut Rng64::new(1));
        let found = bla(&[Realisation { u: &uu, y: &yy }], n, 0.01).unwrap();
        let (odd, even) = (found.odd.as_ref().unwrap(), found.even.as_ref().unwrap());
        let shown = if square != 0.0 { even } else { odd };
        let (parity, silent) = if square != 0.0 { (0, odd) } else { (1, even) };
        assert!(shown.stands_out() && !silent.stands_out(), "{} {}", odd.rms, even.rms);
        let set: Vec<usize> = (1..=found.lines[found.lines.len() - 1])
            .filter(|k| k % 2 == parity && lines.binary_search(k).is_err())
            .collect();
        for (k, amplitude) in set.iter().zip(&shown.amplitude) {
            assert!((amplitude - line(&bent, *k)).abs() < 1e-4, "line {k}: {amplitude}");
        }
        assert!(silent.rms < 1e-4);
    }
}

/// A cube of a signal that is normal in the limit: G = 1 + 3 c sigma^2 (Bussgang), and the stochastic part makes the
/// deviation over realisations larger than that of noise.
#[test]
fn a_cube_adds_to_the_gain_and_to_its_deviation() {
    let (n, c) = (512, 0.1);
    let records: Vec<(Vec<f64>, Vec<f64>)> = (0..30)
        .map(|m| {
            let mut rng = Rng64::stream(31, m);
            let (u, _) = odd_random(n, 201, &mut Rng64::stream(31, 1000));
            // New phases on the same lines: the phase of line k changes, its amplitude stays.
            let (_, lines) = odd_random(n, 201, &mut Rng64::stream(31, 1000));
            let phases: Vec<f64> = lines.iter().map(|_| rng.uniform_in(0.0, TAU)).collect();
            let gain = line(&u, lines[0]);
            let u: Vec<f64> = (0..n)
                .map(|t| {
                    let terms = lines.iter().zip(&phases);
                    gain * terms.map(|(k, p)| (TAU * (k * t % n) as f64 / n as f64 + p).cos()).sum::<f64>()
                })
                .collect();
            let y: Vec<f64> = u.iter().map(|v| v + c * v.powi(3)).collect();
            periodic(&u, &y, 2, 1e-3, &mut rng)
        })
        .collect();
    let parts: Vec<Realisation> = records.iter().map(|(u, y)| Realisation { u, y }).collect();
    let found = bla(&parts, n, 0.01).unwrap();
    let count = found.lines.len() as f64;
    let mean = found.gain.iter().map(|g| g.0).sum::<f64>() / count;
    let spread = found.total_std.iter().map(|s| s * s).sum::<f64>().sqrt() / count;
    // sigma^2 = 1; of the F lines a line meets itself less often: 3 c sigma^2 (1 - 1/(2 F)).
    let expected = 1.0 + 3.0 * c * (1.0 - 0.5 / count);
    assert!((mean - expected).abs() < 5.0 * spread, "{mean}, expected {expected} within {spread}");
    assert!(found.total_std.iter().zip(&found.noise_std).all(|(t, n)| t > &(3.0 * n)));
}

#[test]
fn records_that_are_not_periodic_as_said_are_refused() {
    let u = vec![1.0; 100];
    let part = |u, y| [Realisation { u, y }];
    assert!(bla(&part(&u, &u), 30, 0.1).unwrap_err().to_string().contains("whole periods of 30"));
    assert!(bla(&part(&u, &u[..90]), 10, 0.1).is_err());
    assert!(bla(&part(&u, &u), 10, 0.1).unwrap_err().to_string().contains("no line"));
    let mut gap = u.clone();
    gap[7] = f64::NAN;
    assert!(bla(&part(&u, &gap), 10, 0.1).unwrap_err().to_string().contains("sample 7"));
    assert!(bla(&[], 10, 0.1).is_err());
}
