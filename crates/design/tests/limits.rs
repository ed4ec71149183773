//! Regions, levels, start and end: what a record that comes out of a design keeps, and what is said when it cannot.

use dynocal_design::channel::limits::Region;
use dynocal_design::channel::{Channel, Layout, Shape};
use dynocal_design::criterion::{Criterion, criterion};
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};
use dynocal_design::search::{DesignOptions, DesignOutcome, Failure, design, random_record};
use dynocal_ident::model::literature::{LiteratureModel, torque_4_17};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

const N: usize = 100;

/// The box of thesis eq. (4.16).
fn channels() -> Vec<Channel> {
    vec![
        Channel::free("fpw", 2000.0, 6000.0),
        Channel::free("abv", 0.4, 0.6),
        Channel::free("speed", 1000.0, 2000.0),
    ]
}

fn problem<'a>(
    channels: Vec<Channel>,
    torque: &'a LiteratureModel,
    c: &'a dyn Criterion,
) -> DesignProblem<'a> {
    let term = Term::new("torque", &torque.model, &torque.theta, torque.noise_variance, c);
    DesignProblem { channels, n_samples: N, convention: Convention::Trim, start: 10, terms: vec![term] }
}

fn designed(channels: Vec<Channel>, evaluations: usize, seed: u64) -> Result<DesignOutcome, Failure> {
    let (torque, d) = (torque_4_17(), criterion("d", &Default::default()).unwrap());
    let options = DesignOptions { evaluations, seed, ..Default::default() };
    design(&problem(channels, &torque, d.as_ref()), &options, &|| false, &|_| {})
}

fn column(u: &[f64], i: usize) -> Vec<f64> {
    u.iter().skip(i).step_by(3).copied().collect()
}

/// Largest violation of the regions of `channels` by the samples, as the regions themselves say it.
fn violation(channels: &[Channel], u: &[f64]) -> f64 {
    let mut worst = f64::NEG_INFINITY;
    for r in channels.iter().flat_map(|c| &c.regions) {
        let index: Vec<usize> =
            r.channels().iter().map(|n| channels.iter().position(|c| c.name == *n).unwrap()).collect();
        for row in u.chunks_exact(channels.len()) {
            let at: Vec<f64> = index.iter().map(|i| row[*i]).collect();
            worst = worst.max(r.violation(&at));
        }
    }
    worst
}

/// Fuel and speed together at most so much, no low fuel at high speed, and a forbidden box in the middle.
fn regions() -> Vec<Region> {
    let corners =
        vec![[2000.0, 1000.0], [6000.0, 1000.0], [6000.0, 1800.0], [4500.0, 2000.0], [3000.0, 2000.0]];
    vec![
        Region::AtMost {
            name: "power".into(),
            coefficients: vec![("fpw".into(), 1.0), ("speed".into(), 2.0)],
            bound: 8500.0,
        },
        Region::Inside { name: "map".into(), channels: ["fpw".into(), "speed".into()], corners },
        Region::forbidden_box("resonance", ("abv", [0.47, 0.53]), ("speed", [1300.0, 1600.0])),
    ]
}

fn with_regions() -> Vec<Channel> {
    let mut c = channels();
    c[0].regions = regions();
    c
}

#[test]
fn a_design_keeps_convex_and_forbidden_regions_to_rounding() {
    let c = with_regions();
    let found = designed(c.clone(), 3000, 1).unwrap();
    // Distances in the plane: fpw is in thousands.
    assert!(violation(&c, &found.u) <= 1e-9, "{}", violation(&c, &found.u));
    assert_ne!(found.status, Status::Infeasible);
    assert!(found.value < found.start_value - 10.0, "{} {}", found.value, found.start_value);
    // The free design of the same budget uses what is forbidden, so that the regions were active.
    let free = designed(channels(), 3000, 1).unwrap();
    assert!(violation(&c, &free.u) > 50.0 && free.value < found.value);
    // More information than the best of many random records within the same regions.
    let (torque, d) = (torque_4_17(), criterion("d", &Default::default()).unwrap());
    let p = problem(c.clone(), &torque, d.as_ref());
    let mut e = Evaluator::new(&p).unwrap();
    for seed in 0..20 {
        let u = random_record(&p, seed).unwrap();
        assert!(violation(&c, &u) <= 1e-9);
        assert!(e.value(&u) > found.value + 5.0);
    }
}

#[test]
fn regions_rates_holds_ramps_start_and_end_hold_together() {
    let mut c = with_regions();
    c[0] = Channel { rate_per_sample: Some(300.0), start: Some(3000.0), end: Some(2500.0), ..c[0].clone() };
    c[1] = Channel { hold: 4, ..c[1].clone() };
    c[2] = Channel {
        hold: 5,
        shape: Shape::Linear,
        rate_per_sample: Some(60.0),
        before: Some(1000.0),
        start: Some(1050.0),
        end: Some(1100.0),
        ..c[2].clone()
    };
    let found = designed(c.clone(), 2500, 3).unwrap();
    assert!(violation(&c, &found.u) <= 1e-9, "{}", violation(&c, &found.u));
    let (fpw, abv, speed) = (column(&found.u, 0), column(&found.u, 1), column(&found.u, 2));
    assert!(fpw.windows(2).all(|w| (w[1] - w[0]).abs() <= 300.0 + 1e-9));
    assert!(speed.windows(2).all(|w| (w[1] - w[0]).abs() <= 60.0 + 1e-9));
    assert!(abv.chunks(4).all(|h| h.iter().all(|v| v == &h[0])));
    for (found, asked) in [(fpw[0], 3000.0), (fpw[N - 1], 2500.0), (speed[0], 1050.0), (speed[N - 1], 1100.0)]
    {
        assert!((found - asked).abs() <= 1e-9, "{found} {asked}");
    }
    assert!(found.value < found.start_value);
}

/// Any record at all is moved into all limits, from far outside and for many seeds.
#[test]
fn repair_keeps_all_limits_from_anywhere() {
    let mut c = with_regions();
    c[0].rate_per_sample = Some(250.0);
    c[0].end = Some(2600.0);
    c[2] = Channel { hold: 3, shape: Shape::Linear, rate_per_sample: Some(90.0), ..c[2].clone() };
    let l = Layout::new(&c, N).unwrap();
    for seed in 0..60 {
        let mut g = Rng64::new(seed);
        let mut x: Vec<f64> = (0..l.len()).map(|_| g.uniform_in(-0.5, 1.5)).collect();
        l.repair(&mut x);
        let mut u = vec![0.0; N * 3];
        l.fill(&x, &mut u);
        assert!(violation(&c, &u) <= 1e-9, "seed {seed}: {}", violation(&c, &u));
        assert!(l.rate_violation(&x) <= 1e-12);
        assert!((column(&u, 0)[N - 1] - 2600.0).abs() < 1e-9);
        // What keeps the limits stays as it is.
        let before = x.clone();
        l.repair(&mut x);
        assert!(x.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-11));
    }
}

#[test]
fn a_design_on_levels_is_on_levels_and_cannot_be_improved_by_one_exchange() {
    let mut c = channels();
    c[0] = Channel { levels: vec![6000.0, 2000.0, 3500.0], ..c[0].clone() };
    c[1] = Channel { levels: vec![0.4, 0.45, 0.5, 0.55, 0.6], hold: 2, ..c[1].clone() };
    c[2] = Channel { levels: vec![1000.0, 1250.0, 1500.0, 2000.0], start: Some(1250.0), ..c[2].clone() };
    let (torque, d) = (torque_4_17(), criterion("d", &Default::default()).unwrap());
    let p = problem(c.clone(), &torque, d.as_ref());
    let options = DesignOptions { evaluations: 15_000, ..Default::default() };
    let found = design(&p, &options, &|| false, &|_| {}).unwrap();
    for i in 0..3 {
        assert!(column(&found.u, i).iter().all(|v| c[i].levels.contains(v)), "channel {i}");
    }
    assert_eq!(found.u[2], 1250.0);
    let mut e = Evaluator::new(&p).unwrap();
    assert!((e.value(&found.u) - found.value).abs() < 1e-9 * found.value.abs());
    // Every single exchange, tried one by one.
    assert_eq!(found.status, Status::Converged);
    let mut u = found.u.clone();
    for t in (1..N).step_by(7) {
        for (i, hold) in [(0, 1), (2, 1), (1, 2)] {
            let from = t / hold * hold;
            let before = u[from * 3 + i];
            for l in &c[i].levels {
                (from..from + hold).for_each(|s| u[s * 3 + i] = *l);
                assert!(e.value(&u) > found.value - 1e-6, "sample {t}, channel {i}: {l}");
            }
            (from..from + hold).for_each(|s| u[s * 3 + i] = before);
        }
    }
    let random = random_record(&p, 5).unwrap();
    assert!(column(&random, 0).iter().all(|v| c[0].levels.contains(v)));
    assert!(found.value < e.value(&random) - 10.0);
}

/// The nearest record on the levels under a rate limit, against trying all records.
#[test]
fn rounding_to_levels_is_the_nearest_record_that_keeps_the_rate() {
    let levels = [0.0, 0.3, 0.6, 1.0];
    let c = Channel { levels: levels.to_vec(), rate_per_sample: Some(0.4), ..Channel::free("a", 0.0, 1.0) };
    let l = Layout::new(&[c], 5).unwrap();
    for seed in 0..20 {
        let mut g = Rng64::new(seed);
        let wanted: Vec<f64> = (0..5).map(|_| g.uniform()).collect();
        let mut x = wanted.clone();
        assert!(l.round(&mut x));
        let cost = |v: &[f64]| v.iter().zip(&wanted).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let mut best = f64::INFINITY;
        for k in 0..4usize.pow(5) {
            let v: Vec<f64> = (0..5).map(|j| levels[k / 4usize.pow(j) % 4]).collect();
            if v.windows(2).all(|w| (w[1] - w[0]).abs() <= 0.4 + 1e-12) {
                best = best.min(cost(&v));
            }
        }
        assert!((cost(&x) - best).abs() < 1e-12, "seed {seed}: {} {best}", cost(&x));
    }
}

#[test]
fn limits_that_cannot_be_kept_are_explained() {
    let refused = |change: &dyn Fn(&mut Vec<Channel>), parts: &[&str]| {
        let mut c = channels();
        change(&mut c);
        let text = match designed(c, 50, 1) {
            Err(e) => e.to_string(),
            Ok(_) => panic!("must be refused: {parts:?}"),
        };
        for part in parts {
            assert!(text.contains(part), "no `{part}` in: {text}");
        }
    };
    // Which limits, by how much, and where.
    refused(&|c| c[0].end = Some(7000.0), &["fpw end 7000", "bounds 2000 to 6000", "by 1000", "sample 99"]);
    refused(
        &|c| {
            c[0] = Channel {
                start: Some(2000.0),
                end: Some(6000.0),
                rate_per_sample: Some(10.0),
                ..c[0].clone()
            }
        },
        &["fpw start 2000 and end 6000", "rate limit 10 per sample in 99 changes", "by 3010"],
    );
    refused(
        &|c| {
            let (before, start) = (Some(0.4), Some(0.5));
            c[1] = Channel { before, start, rate_per_sample: Some(0.025), ..c[1].clone() }
        },
        &["abv start 0.5", "rate limit 0.025 per sample from 0.4", "by 0.07", "sample 0"],
    );
    refused(&|c| c[2].hold = 120, &["speed hold of 120 samples", "record of 100 samples", "by 20"]);
    refused(&|c| c[0].lower = 7000.0, &["fpw lower bound 7000", "upper bound 6000", "by 1000"]);
    refused(&|c| c[0].levels = vec![3000.0, 6500.0], &["fpw level 6500", "bounds 2000 to 6000", "by 500"]);
    refused(
        &|c| c[0] = Channel { levels: vec![3000.0, 4000.0], start: Some(3200.0), ..c[0].clone() },
        &["fpw start 3200", "the nearest of which is 3000", "by 200"],
    );
    refused(
        &|c| {
            let (start, end) = (Some(2000.0), Some(4000.0));
            let levels = vec![2000.0, 4000.0];
            c[0] = Channel { levels, start, end, rate_per_sample: Some(500.0), ..c[0].clone() }
        },
        &["fpw levels (the nearest two are 2000 apart)", "rate limit 500", "by 1500"],
    );
    let box_of = |a: [f64; 2], b: [f64; 2]| vec![Region::forbidden_box("surge", ("fpw", a), ("speed", b))];
    refused(
        &|c| {
            c[0].start = Some(3000.0);
            c[2].start = Some(1500.0);
            c[0].regions = box_of([2900.0, 3300.0], [1400.0, 1600.0]);
        },
        &["region `surge`", "fpw 3000 to 3000, speed 1500 to 1500", "by 100", "sample 0"],
    );
    refused(
        &|c| c[0].regions = box_of([0.0, 9000.0], [0.0, 9000.0]),
        &["region `surge`", "fpw 2000 to 6000"],
    );
    let sum = |name: &str, sign: f64, bound: f64| Region::AtMost {
        name: name.into(),
        coefficients: vec![("fpw".into(), sign), ("speed".into(), sign)],
        bound,
    };
    // Each can be kept alone, both together cannot.
    refused(
        &|c| c[0].regions = vec![sum("most", 1.0, 4000.0), sum("least", -1.0, -5000.0)],
        &["region `", "the other regions, bounds, rate limits, start and end"],
    );
    refused(&|c| c[0].regions = vec![sum("s", 0.0, 1.0)], &["region `s`", "zero or not finite"]);
    refused(
        &|c| {
            let corners = vec![[0.0, 0.0], [1.0, 0.0], [0.2, 0.2], [0.0, 1.0]];
            let channels = ["fpw".into(), "abv".into()];
            c[0].regions = vec![Region::Outside { name: "dent".into(), channels, corners }];
        },
        &["region `dent`", "turn both ways", "convex"],
    );
    refused(
        &|c| c[0].regions = vec![Region::forbidden_box("b", ("fpv", [0.0, 1.0]), ("abv", [0.0, 1.0]))],
        &["region `b`", "`fpv`", "one of fpw, abv, speed"],
    );
    refused(&|c| c[0].start = Some(f64::NAN), &["fpw: start", "NaN", "finite"]);
}
