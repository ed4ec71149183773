//! A trim learnt from lines whose windows do not all weigh alike.

use dynocal_calib::steady::trim::{Along, Choice, Trim, Way, finer};
use dynocal_numerics::rng::Rng64;

/// Measurements that scatter ten times as much where they weigh a hundredth do not disturb the others: the scatter is that of weight 1,
/// and the correction is better than with equal weights.
#[test]
fn what_weighs_little_does_not_disturb() {
    let mut rng = Rng64::new(8);
    let axes = finer(&[vec![0.0, 1.0, 2.0, 3.0]], 1);
    let mut weighed = Along::default();
    for k in 0..400 {
        let x = 3.0 * rng.uniform();
        let (size, weight) = if x > 2.0 { (0.1, 0.01) } else { (0.01, 1.0) };
        let up = if k % 2 == 0 { 1.0 } else { -1.0 };
        let way = Way { up, since_s: 1e6, before: [(0.0, 0.0); 2], window_s: 1.0 };
        weighed.push(vec![x], way, 0.1 * (1.5 * x).sin() + size * rng.normal(), weight);
    }
    let equal = Along { weight: vec![1.0; 400], ..weighed.clone() };
    let error = |t: &Trim| {
        let each = (0..20).map(|k| f64::from(k) / 10.0).map(|x| (t.at(&[x]) - 0.1 * (1.5 * x).sin()).powi(2));
        (each.sum::<f64>() / 20.0).sqrt()
    };
    let (a, b) = (Trim::learn(&axes, &weighed).unwrap(), Trim::learn(&axes, &equal).unwrap());
    assert!((a.scatter / 0.01 - 1.0).abs() < 0.15 && a.rest > 0.04, "{} {}", a.scatter, a.rest);
    assert!(error(&a) < error(&b), "{} {}", error(&a), error(&b));
}

/// Measured long after the begin of the way.
fn along(at: &[Vec<f64>], up: &[f64], r: &[f64]) -> Along {
    let way = |up: &f64| Way { up: *up, since_s: 1e6, before: [(0.0, 0.0); 2], window_s: 1.0 };
    Along { at: at.to_vec(), way: up.iter().map(way).collect(), r: r.to_vec(), weight: vec![1.0; r.len()] }
}

/// Rests at five places of an axis, each still on its way from where it came: what it tends to is found, and not the mean of what was seen.
#[test]
fn what_a_rest_tends_to_is_found() {
    let (tau_s, window_s) = (2.0, 2.0);
    let truth = |x: f64| 0.02 * (x - 1.0).powi(2);
    let (mut rng, mut all) = (Rng64::new(4), Along::default());
    for x in [0.0, 1.0, 2.0, 3.0, 4.0] {
        for k in 0..4 {
            let way = Way {
                up: 0.0,
                since_s: window_s * f64::from(k),
                before: [(0.0, 8.0), (if x > 0.0 { 1.0 } else { 0.0 }, 2.0)],
                window_s,
            };
            all.push(vec![x], way, truth(x) + 0.03 * way.developed(tau_s) + 2e-4 * rng.normal(), 1.0);
        }
    }
    let trim = Trim::learn(&[vec![0.0, 1.0, 2.0, 3.0, 4.0]], &all).unwrap();
    // Half of the rest at most, which is what is right here or next to it.
    assert!((1.0..=4.0).contains(&trim.choice.tau_s), "{:?}", trim.choice);
    for x in [0.0, 1.0, 2.0, 3.0, 4.0] {
        assert!((trim.at(&[x]) - truth(x)).abs() < 2e-3, "{x}: {} {}", trim.at(&[x]), truth(x));
    }
}

/// Where one way alone was measured and the correction bends, a lag that may bend as freely takes some of that: a stiffer one errs less.
#[test]
fn a_stiff_lag_leaves_bends_to_the_correction() {
    let axes = finer(&[vec![0.0, 1.0, 2.0, 3.0]], 1);
    let truth = |x: f64| 0.1 * (x - 2.0).max(0.0).powi(2);
    let day = |seed: u64| {
        let (mut rng, mut at, mut ways, mut r) = (Rng64::new(seed), Vec::new(), Vec::new(), Vec::new());
        let there = (0..30).map(|k| (0.1 * f64::from(k), 1.0));
        for (x, way) in there.chain((0..20).map(|k| (0.1 * f64::from(k), -1.0))) {
            at.push(vec![x]);
            ways.push(way);
            r.push(truth(x) - 0.01 * way + 1e-3 * rng.normal());
        }
        along(&at, &ways, &r)
    };
    let error = |t: &Trim| {
        (0..31).map(|k| 0.1 * f64::from(k)).map(|x| (t.at(&[x]) - truth(x)).abs()).fold(0.0, f64::max)
    };
    let mean = |of: &dyn Fn(&Along) -> Option<Trim>| {
        (1..=10).map(|s| error(&of(&day(s)).unwrap())).sum::<f64>() / 10.0
    };
    let chosen = mean(&|a| Trim::learn(&axes, a));
    let free = mean(&|a| {
        let choice = Trim::learn(&axes, a)?.choice;
        Trim::with(&axes, a, Choice { kappa: choice.lambda, ..choice })
    });
    assert!(chosen < 0.8 * free, "{chosen} {free}");
}
