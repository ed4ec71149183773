//! Linear fits against other solvers, against exhaustive search, and on planted truths.

use dynocal_label::label::{Axis, Label, Limit};
use dynocal_label::linear::{Options, Problem, Verdict, fit};
use dynocal_label::quantise::{Steps, nearest};
use dynocal_label::rows::Rows;
use dynocal_label::{LabelError, qp};
use dynocal_numerics::rng::Rng64;
use serde_json::Value;

fn reference() -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/reference/labels.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn rows_of(label: &Label, at: &[Vec<f64>]) -> Rows {
    let mut rows = Rows::default();
    for point in at {
        rows.start();
        label.enter(&mut rows, 0, 1.0, point);
    }
    rows
}

/// Without smoothness.
fn plain() -> Options {
    Options { smooth: Some(0.0), ..Options::default() }
}

#[test]
fn a_monotone_curve_is_isotonic_regression() {
    let r = &reference()["isotonic"];
    let (cells, y, wanted) = (numbers(&r["cell"]), numbers(&r["y"]), numbers(&r["values"]));
    let points: Vec<f64> = (0..wanted.len()).map(|k| k as f64).collect();
    let mut label = Label::curve("C", "-", "x", "-", &points, &vec![0.0; points.len()]);
    label.axes[0].gradient = [0.0, f64::INFINITY];
    let at: Vec<Vec<f64>> = cells.iter().map(|c| vec![*c]).collect();
    let rows = rows_of(&label, &at);
    let found = fit(&Problem::new(std::slice::from_ref(&label), &rows, &y), &plain()).unwrap();
    for (a, b) in found.values.iter().zip(&wanted) {
        // The tie to the base (1e-9 of a mean cell) is all that differs.
        assert!((a - b).abs() < 1e-7, "{a} {b}");
    }
    assert!(!found.held.is_empty());
}

#[test]
fn monotone_maps_and_convex_curves_are_those_of_another_solver() {
    let r = &reference()["map"];
    let (x, y, z) = (numbers(&r["x"]), numbers(&r["y"]), numbers(&r["z"]));
    let mut label = Label::new(
        "M",
        "-",
        vec![Axis::new("x", "-", &x), Axis::new("y", "-", &y)],
        &vec![0.0; x.len() * y.len()],
    );
    label.axes.iter_mut().for_each(|a| a.gradient = [0.0, f64::INFINITY]);
    let at: Vec<Vec<f64>> =
        numbers(&r["sx"]).iter().zip(numbers(&r["sy"])).map(|(a, b)| vec![*a, b]).collect();
    let rows = rows_of(&label, &at);
    let found = fit(&Problem::new(std::slice::from_ref(&label), &rows, &z), &plain()).unwrap();
    for (a, b) in found.values.iter().zip(numbers(&r["monotone"])) {
        assert!((a - b).abs() < 1e-8 * b.abs().max(1.0), "{a} {b}");
    }
    let r = &reference()["curve"];
    let mut label = Label::curve("C", "-", "x", "-", &numbers(&r["points"]), &[0.0; 8]);
    label.axes[0].convex = 1;
    let at: Vec<Vec<f64>> = numbers(&r["s"]).iter().map(|s| vec![*s]).collect();
    let rows = rows_of(&label, &at);
    let found = fit(&Problem::new(std::slice::from_ref(&label), &rows, &numbers(&r["v"])), &plain()).unwrap();
    for (a, b) in found.values.iter().zip(numbers(&r["convex"])) {
        assert!((a - b).abs() < 1e-8 * b.abs().max(1.0), "{a} {b}");
    }
}

/// Bounds, gradient windows and dependent limits, checked by the conditions of optimality.
#[test]
fn quadratic_programs_keep_the_conditions_of_optimality() {
    let mut rng = Rng64::new(11);
    let mut held = 0;
    for _ in 0..200 {
        let n = 2 + rng.below(12);
        let a: Vec<f64> = (0..2 * n * n).map(|_| rng.normal()).collect();
        let h: Vec<f64> = (0..n * n)
            .map(|k| {
                (0..2 * n).map(|r| a[r * n + k / n] * a[r * n + k % n]).sum::<f64>()
                    + f64::from(u8::from(k / n == k % n))
            })
            .collect();
        let g: Vec<f64> = (0..n).map(|_| 10.0 * rng.normal()).collect();
        let feasible: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let limits: Vec<Limit> = (0..3 * n)
            .map(|_| {
                let terms: Vec<(usize, f64)> =
                    (0..1 + rng.below(3)).map(|_| (rng.below(n), rng.normal())).collect();
                let at: f64 = terms.iter().map(|(k, c)| c * feasible[*k]).sum();
                Limit {
                    terms,
                    least: at - if rng.below(2) == 0 { 0.0 } else { rng.uniform() },
                    what: "l".into(),
                }
            })
            .collect();
        let found = qp::solve(&h, &g, &limits).unwrap();
        let mut gradient: Vec<f64> =
            (0..n).map(|i| (0..n).map(|j| h[i * n + j] * found.x[j]).sum::<f64>() - g[i]).collect();
        for (k, u) in &found.active {
            assert!(*u >= -1e-9, "a multiplier of {u}");
            limits[*k].terms.iter().for_each(|(i, c)| gradient[*i] -= u * c);
            held += 1;
        }
        let size = g.iter().map(|v| v.abs()).fold(1.0, f64::max);
        assert!(gradient.iter().all(|v| v.abs() < 1e-8 * size), "{gradient:?}");
        for l in &limits {
            assert!(l.terms.iter().map(|(k, c)| c * found.x[*k]).sum::<f64>() >= l.least - 1e-9);
        }
    }
    assert!(held > 300, "{held} active limits");
    let one = |c: f64, least: f64| Limit { terms: vec![(0, c)], least, what: format!("{c}") };
    let refused = qp::solve(&[1.0], &[0.0], &[one(1.0, 2.0), one(-1.0, -1.0)]).unwrap_err();
    assert!(matches!(refused, LabelError::Contradiction { .. }), "{refused}");
}

#[test]
fn whole_steps_of_a_3_x_3_map_are_those_of_an_exhaustive_search() {
    let mut rng = Rng64::new(5);
    let mut differs = 0;
    for _ in 0..30 {
        let a: Vec<f64> = (0..12 * 9).map(|_| rng.normal()).collect();
        let h: Vec<f64> =
            (0..81).map(|k| (0..12).map(|r| a[r * 9 + k / 9] * a[r * 9 + k % 9]).sum::<f64>()).collect();
        let free: Vec<f64> = (0..9).map(|_| rng.uniform_in(0.0, 2.0)).collect();
        // Along x it must not fall.
        let limits: Vec<Limit> = (0..9usize)
            .filter(|k| k % 3 < 2)
            .map(|k| Limit { terms: vec![(k + 1, 1.0), (k, -1.0)], least: 0.0, what: "rises".into() })
            .collect();
        let right: Vec<f64> = (0..9).map(|i| (0..9).map(|j| h[i * 9 + j] * free[j]).sum()).collect();
        let limited = qp::solve(&h, &right, &limits).unwrap().x;
        let steps = vec![Some(Steps { step: 1.0, origin: 0.0 }); 9];
        let cost = |x: &[f64]| -> f64 {
            let d: Vec<f64> = x.iter().zip(&free).map(|(a, b)| a - b).collect();
            (0..9).map(|i| (0..9).map(|j| d[i] * h[i * 9 + j] * d[j]).sum::<f64>()).sum()
        };
        let (x, proven) = nearest(&h, &free, &limited, &steps, &limits).unwrap();
        assert!(proven && x.iter().all(|v| v.fract() == 0.0));
        // Every map of values -1 to 3.
        let mut best = f64::INFINITY;
        let mut trial = [0.0; 9];
        for code in 0..5usize.pow(9) {
            let mut c = code;
            for v in &mut trial {
                *v = (c % 5) as f64 - 1.0;
                c /= 5;
            }
            if (0..9).all(|k| k % 3 == 2 || trial[k + 1] >= trial[k]) {
                best = best.min(cost(&trial));
            }
        }
        // The tree also looks beyond the box of the exhaustive search.
        assert!(cost(&x) <= best * (1.0 + 1e-9), "{} {best}", cost(&x));
        if x.iter().all(|v| (-1.0..=3.0).contains(v)) {
            assert!((cost(&x) - best).abs() <= 1e-9 * best);
        }
        let rounded: Vec<f64> = free.iter().map(|v| v.round()).collect();
        let falls = (0..9).any(|k| k % 3 < 2 && rounded[k + 1] < rounded[k]);
        differs += usize::from(falls || cost(&rounded) > best * (1.0 + 1e-9));
    }
    assert!(differs > 10, "plain rounding was as good in most cases: the problems say nothing");
}

/// Noise of a first-order process, correlation `rho` from sample to sample.
fn noise(rng: &mut Rng64, n: usize, rho: f64, sigma: f64) -> Vec<f64> {
    let mut v = 0.0;
    (0..n)
        .map(|_| {
            v = rho * v + (1.0 - rho * rho).sqrt() * rng.normal();
            sigma * v
        })
        .collect()
}

/// A drive over a map whose truth is smooth: the visited cells whose interval holds the truth.
fn coverage(seed: u64, rho: f64) -> (usize, usize) {
    let mut rng = Rng64::new(seed);
    let axis: Vec<f64> = (0..8).map(f64::from).collect();
    let truth = |x: f64, y: f64| 50.0 + 10.0 * (0.4 * x).sin() + 2.0 * y;
    let base: Vec<f64> = (0..64)
        .map(|k| truth(f64::from(k % 8), f64::from(k / 8)) + 3.0 * (f64::from(k) * 0.05).cos())
        .collect();
    let label = Label::new("M", "%", vec![Axis::new("x", "-", &axis), Axis::new("y", "-", &axis)], &base);
    let cells: Vec<f64> = (0..64).map(|k| truth(f64::from(k % 8), f64::from(k / 8))).collect();
    let n = 4000;
    let (wx, wy) = (noise(&mut rng, n, 0.98, 2.5), noise(&mut rng, n, 0.98, 2.5));
    let at: Vec<Vec<f64>> = (0..n).map(|k| vec![3.5 + wx[k], 3.5 + wy[k]]).collect();
    let e = noise(&mut rng, n, rho, 2.0);
    let y: Vec<f64> = at.iter().zip(&e).map(|(p, e)| label.value(&cells, p) + e).collect();
    let rows = rows_of(&label, &at);
    let problem = Problem {
        segments: std::iter::once(0..n).collect(),
        ..Problem::new(std::slice::from_ref(&label), &rows, &y)
    };
    let found = fit(&problem, &Options::default()).unwrap();
    if seed == 0 {
        println!(
            "correlation time {} samples, sigma {}, smooth {}, parameters {}",
            found.correlation_samples, found.sigma, found.smooth, found.effective_parameters
        );
    }
    let told: Vec<usize> = (0..64).filter(|k| found.half_width[*k].is_finite()).collect();
    let inside =
        told.iter().filter(|k| (found.values[**k] - cells[**k]).abs() <= found.half_width[**k]).count();
    (inside, told.len())
}

#[test]
fn intervals_hold_the_truth_as_often_as_they_say() {
    for (rho, most) in [(0.0, 0.995), (0.8, 0.995)] {
        let (mut inside, mut all) = (0, 0);
        for seed in 0..100 {
            let (a, b) = coverage(seed, rho);
            (inside, all) = (inside + a, all + b);
        }
        let share = inside as f64 / all as f64;
        println!("correlation {rho}: {inside} of {all} visited cells, {:.1} %", 100.0 * share);
        assert!(all > 1000 && (0.90..=most).contains(&share), "correlation {rho}: {share} of {all}");
    }
}

/// A value that goes to new places at a rate and stays there for a while, in samples of 0.05 s.
fn wander(rng: &mut Rng64, n: usize, [low, high]: [f64; 2], rate: f64, hold_s: [f64; 2]) -> Vec<f64> {
    let (mut goal, mut left_s) = (0.5 * (low + high), 0.0);
    let mut value = goal;
    (0..n)
        .map(|_| {
            left_s -= if value == goal { 0.05 } else { 0.0 };
            if left_s <= 0.0 {
                goal = rng.uniform_in(low, high);
                left_s = rng.uniform_in(hold_s[0], hold_s[1]);
            }
            value += (goal - value).clamp(-0.05 * rate, 0.05 * rate);
            value
        })
        .collect()
}

/// Labels of a pulse width that is rounded to 1 us: the same state gives the same error, however long it is held. What was planted lies
/// within the intervals as often as they say.
#[test]
fn intervals_hold_where_states_are_held_and_errors_are_those_of_rounding() {
    let volts = [12.0, 13.0, 14.6];
    let labels =
        [Label::scalar("FACTOR", "-", 1.0), Label::curve("DEAD", "ms", "battery", "V", &volts, &[0.5; 3])];
    let mut labels = labels.to_vec();
    labels[1].axes[0].smooth = 0.0;
    let (seeds, n) = (400, 3360);
    let mut inside = [0; 4];
    for seed in 0..seeds {
        let mut rng = Rng64::new(1000 + seed);
        let throttle = wander(&mut rng, n, [8.0, 26.0], 4.0, [0.5, 3.0]);
        let speed = wander(&mut rng, n, [1250.0, 2750.0], 200.0, [1.0, 4.0]);
        let battery = wander(&mut rng, n, [12.1, 14.5], 0.5, [0.5, 5.0]);
        let truth = [
            0.5 * (1.0 + rng.uniform_in(-0.02, 0.02)),
            1.06 + rng.uniform_in(-0.02, 0.02),
            1.03 + rng.uniform_in(-0.02, 0.02),
            1.0 + rng.uniform_in(-0.02, 0.02),
        ];
        let more = rng.uniform_in(0.0, 1.0);
        let (mut rows, mut y, mut pressure) = (Rows::default(), Vec::new(), None);
        for k in 0..n {
            let still = 20.0 + 80.0 * (1.0 - (-(throttle[k] - 5.0) / (speed[k] / 200.0)).exp());
            let kpa = pressure.map_or(still, |p: f64| p + 0.3 * (still - p));
            pressure = Some(kpa);
            let (kpa, rpm) = (kpa.round(), speed[k].round());
            let ve = (60.0 + 15.0 * (rpm / 900.0).sin() + 0.2 * kpa + more).floor();
            let (fuel, u) = (9.7e-4 * ve * kpa, (10.0 * battery[k]).round() / 10.0);
            rows.start();
            rows.push(0, fuel);
            labels[1].enter(&mut rows, 1, 1.0, &[u]);
            let pulse = truth[0] * fuel + labels[1].value(&truth[1..], &[u]);
            y.push((1e3 * pulse).round() * 1e-3);
        }
        let problem =
            Problem { segments: std::iter::once(0..n).collect(), ..Problem::new(&labels, &rows, &y) };
        let found = fit(&problem, &Options { smooth: Some(0.0), ..Options::default() }).unwrap();
        for (k, truth) in truth.iter().enumerate() {
            inside[k] += u32::from((found.exact[k] - truth).abs() <= found.half_width[k]);
        }
    }
    let share = inside.map(|i| 100.0 * f64::from(i) / seeds as f64);
    println!("within the intervals: {share:.1?} % of {seeds} seeds");
    assert!(share.iter().all(|s| (92.0..=98.0).contains(s)), "{share:?}");
}

#[test]
fn untouched_cells_keep_their_base_and_locked_ones_theirs() {
    let axis = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
    let mut label = Label::curve("C", "%", "x", "-", &axis, &[10.0; 6]);
    label.locked[1] = true;
    let at: Vec<Vec<f64>> = (0..60).map(|k| vec![0.05 * f64::from(k)]).collect();
    let rows = rows_of(&label, &at);
    let y: Vec<f64> = at.iter().map(|p| 12.0 + p[0]).collect();
    let problem = Problem::new(std::slice::from_ref(&label), &rows, &y);
    let found = fit(&problem, &Options { smooth: Some(1e-6), ..Options::default() }).unwrap();
    assert_eq!(found.values[1], 10.0);
    assert_eq!(found.verdicts[1], Verdict::Locked);
    assert_eq!((found.values[4], found.values[5]), (10.0, 10.0));
    assert_eq!(found.verdicts[5], Verdict::Untouched);
    assert!(found.half_width[5].is_infinite() && (found.visits.iter().sum::<f64>() - 60.0).abs() < 1e-9);
    let on = Options { extrapolate: true, smooth: Some(1e-3), ..Options::default() };
    label.locked[1] = false;
    let found = fit(&Problem::new(std::slice::from_ref(&label), &rows, &y), &on).unwrap();
    for (k, v) in found.values.iter().enumerate() {
        assert!((v - 12.0 - k as f64).abs() < 1e-3, "a straight change goes on straight: {k} {v}");
    }
}

/// The nearest-cell mean spoils neighbours; interpolation gives the truth back without noise.
#[test]
fn without_noise_the_truth_comes_back() {
    let mut rng = Rng64::new(3);
    let x = [500.0, 700.0, 1300.0, 2500.0, 6200.0];
    let y = [16.0, 30.0, 90.0];
    let truth: Vec<f64> = (0..15).map(|_| rng.uniform_in(30.0, 90.0)).collect();
    let label =
        Label::new("VE", "%", vec![Axis::new("n", "rpm", &x), Axis::new("p", "kPa", &y)], &[50.0; 15]);
    let at: Vec<Vec<f64>> =
        (0..2000).map(|_| vec![rng.uniform_in(400.0, 6400.0), rng.uniform_in(10.0, 100.0)]).collect();
    let values: Vec<f64> = at.iter().map(|p| label.value(&truth, p)).collect();
    let rows = rows_of(&label, &at);
    let found =
        fit(&Problem::new(std::slice::from_ref(&label), &rows, &values), &Options::default()).unwrap();
    for (a, b) in found.values.iter().zip(&truth) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
}

/// One sample in ten is twenty standard deviations off, to either side: the intervals of Huber's fit hold the truth as often as they say, and
/// are as wide as its values scatter.
#[test]
fn robust_intervals_are_as_wide_as_values_scatter() {
    let x = [0.0, 1.0, 2.0, 3.0];
    let truth = [5.0, 4.0, 6.0, 5.5];
    let label = Label::new("C", "-", vec![Axis::new("x", "-", &x)], &[0.0; 4]);
    let options = Options { robust: true, ..plain() };
    let (mut inside, mut square, mut width, seeds) = (0usize, 0.0, 0.0, 200);
    for seed in 0..seeds {
        let mut rng = Rng64::new(seed);
        let at: Vec<Vec<f64>> = (0..400).map(|_| vec![rng.uniform_in(0.0, 3.0)]).collect();
        let y: Vec<f64> = at
            .iter()
            .enumerate()
            .map(|(k, p)| {
                let scale = if k % 10 == 0 { 2.0 } else { 0.1 };
                label.value(&truth, p) + scale * rng.normal()
            })
            .collect();
        let rows = rows_of(&label, &at);
        let found = fit(&Problem::new(std::slice::from_ref(&label), &rows, &y), &options).unwrap();
        for k in 0..4 {
            let off = found.exact[k] - truth[k];
            inside += usize::from(off.abs() <= found.half_width[k]);
            square += off * off / (4 * seeds) as f64;
            width += found.half_width[k] / (4 * seeds) as f64;
        }
    }
    let (share, ratio) = (inside as f64 / (4 * seeds) as f64, width / (1.96 * square.sqrt()));
    println!("{:.1} % inside, {ratio:.3} times as wide as 95 % of what values scatter", 100.0 * share);
    assert!((0.92..=0.98).contains(&share) && (0.9..=1.15).contains(&ratio), "{share} {ratio}");
}

#[test]
fn samples_far_outside_count_less() {
    let label = Label::scalar("S", "-", 0.0);
    let mut rng = Rng64::new(4);
    let y: Vec<f64> =
        (0..500).map(|k| 5.0 + 0.1 * rng.normal() + if k % 10 == 0 { 20.0 } else { 0.0 }).collect();
    let rows = rows_of(&label, &vec![Vec::new(); 500]);
    let problem = Problem::new(std::slice::from_ref(&label), &rows, &y);
    let plain = fit(&problem, &Options::default()).unwrap().values[0];
    let robust = fit(&problem, &Options { robust: true, ..Options::default() }).unwrap().values[0];
    assert!((plain - 7.0).abs() < 0.1 && (robust - 5.0).abs() < 0.05, "{plain} {robust}");
}

#[test]
fn bad_input_is_named() {
    let mut label = Label::curve("C", "-", "x", "-", &[0.0, 1.0], &[0.0, 0.0]);
    let rows = rows_of(&label, &[vec![0.0], vec![1.0], vec![0.5]]);
    let message = |label: &Label, y: &[f64]| {
        fit(&Problem::new(std::slice::from_ref(label), &rows, y), &Options::default())
            .unwrap_err()
            .to_string()
    };
    assert!(message(&label, &[f64::NAN, 1.0, 1.0]).contains("not a finite number"));
    assert!(message(&label, &[]).contains("found 0 samples"));
    label.axes[0].points = vec![1.0, 1.0];
    assert!(message(&label, &[1.0, 1.0, 1.0]).contains("breakpoints that increase"));
    label.axes[0].points = vec![0.0, 1.0];
    label.axes[0].gradient = [2.0, 3.0];
    (label.lower, label.upper) = (0.0, 1.0);
    assert!(message(&label, &[1.0, 1.0, 1.0]).contains("contradict"));
}
