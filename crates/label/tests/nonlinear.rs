//! Functions fitted with smoothness, outliers and several rows of the criterion, on planted truths.

use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{self, Options, Problem};
use dynocal_label::nonlinear::{Target, fit, fit_from};
use dynocal_label::rows::Rows;
use dynocal_numerics::rng::Rng64;

fn node(name: &str, op: Op) -> Node {
    Node { name: name.into(), op }
}

/// `out = curve(x) * gain`, and the curve alone as a node.
fn product(points: &[f64]) -> Graph {
    let labels = vec![
        Label::curve("CURVE", "-", "x", "-", points, &vec![1.0; points.len()]),
        Label::scalar("GAIN", "-", 1.0),
    ];
    let nodes = vec![
        node("x", Op::Channel(0)),
        node("curve", Op::Label(0, vec![0])),
        node("gain", Op::Label(1, vec![])),
        node("out", Op::Multiply(vec![1, 2])),
    ];
    Graph { nodes, labels }
}

struct Planted {
    time_s: Vec<f64>,
    x: Vec<f64>,
    truth: Vec<f64>,
    y: Vec<f64>,
}

/// A smooth curve with white noise of 0.05.
fn planted(seed: u64, n: usize) -> Planted {
    let mut rng = Rng64::new(seed);
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let x: Vec<f64> = (0..n).map(|_| rng.uniform()).collect();
    let truth: Vec<f64> = x.iter().map(|x| 2.0 + (3.0 * x).sin()).collect();
    let y = truth.iter().map(|v| v + 0.05 * rng.normal()).collect();
    Planted { time_s, x, truth, y }
}

fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

/// Where the function is linear in its labels the search must be the linear fit, smoothness by cross-validation included.
#[test]
fn a_function_that_is_linear_is_the_linear_fit() {
    let points: Vec<f64> = (0..21).map(|k| 0.05 * f64::from(k)).collect();
    let p = planted(3, 300);
    let mut graph = product(&points);
    graph.labels[1].locked[0] = true;
    let weights = vec![1.0; p.y.len()];
    let record = Record { time_s: &p.time_s, channels: vec![&p.x] };
    let target = Target { record, node: None, y: &p.y, weights: &weights };
    let found = fit(&graph, &[target], &Options::default(), &|| false).unwrap();
    assert!(found.converged);
    let label = graph.labels[0].clone();
    let mut rows = Rows::default();
    for x in &p.x {
        rows.start();
        label.enter(&mut rows, 0, 1.0, &[*x]);
    }
    let segments = std::iter::once(0..p.y.len()).collect();
    let problem = Problem {
        labels: std::slice::from_ref(&label),
        rows: &rows,
        target: &p.y,
        weights: None,
        segments,
        ..Problem::new(&[], &rows, &p.y)
    };
    let wanted = linear::fit(&problem, &Options::default()).unwrap();
    assert_eq!(found.fit.smooth, wanted.smooth);
    assert!(wanted.smooth > 0.0);
    for (a, b) in found.fit.exact.iter().zip(&wanted.exact) {
        assert!((a - b).abs() < 1e-7, "{a} {b}");
    }
}

/// Smoothness by cross-validation is nearer to the truth than none, on seeds that nothing was set by.
#[test]
fn smoothness_by_cross_validation_helps_a_noisy_function() {
    let points: Vec<f64> = (0..41).map(|k| 0.025 * f64::from(k)).collect();
    let mut better = 0;
    for seed in 100..110 {
        let p = planted(seed, 600);
        let mut graph = product(&points);
        graph.labels[1].locked[0] = true;
        let weights = vec![1.0; p.y.len()];
        let error = |options: &Options| {
            let record = Record { time_s: &p.time_s, channels: vec![&p.x] };
            let target = Target { record: record.clone(), node: None, y: &p.y, weights: &weights };
            let found = fit(&graph, &[target], options, &|| false).unwrap();
            rms(&graph.values(&found.fit.values, &record), &p.truth)
        };
        let (smooth, none) =
            (error(&Options::default()), error(&Options { smooth: Some(0.0), ..Options::default() }));
        println!("seed {seed}: off the truth by {smooth:.4} with smoothness, {none:.4} without");
        better += usize::from(smooth < none);
    }
    assert!(better >= 9, "{better} of 10");
}

/// One sample in twenty is off by a hundred standard deviations, always to one side.
#[test]
fn outliers_count_less_with_the_robust_loss() {
    let points = [0.0, 0.25, 0.5, 0.75, 1.0];
    let mut p = planted(5, 400);
    for k in (0..p.y.len()).step_by(20) {
        p.y[k] += 5.0;
    }
    let mut graph = product(&points);
    graph.labels[1].locked[0] = true;
    let weights = vec![1.0; p.y.len()];
    let error = |robust: bool| {
        let record = Record { time_s: &p.time_s, channels: vec![&p.x] };
        let target = Target { record: record.clone(), node: None, y: &p.y, weights: &weights };
        let found = fit(&graph, &[target], &Options { robust, ..Options::default() }, &|| false).unwrap();
        rms(&graph.values(&found.fit.values, &record), &p.truth)
    };
    let (plain, robust) = (error(false), error(true));
    assert!(plain > 0.15 && robust < 0.25 * plain, "{plain} {robust}");
}

/// `curve * gain` alone leaves the size of both open; a second row on the curve settles it.
#[test]
fn a_second_row_of_the_criterion_settles_what_the_first_leaves_open() {
    let points = [0.0, 0.5, 1.0];
    let graph = product(&points);
    let time_s: Vec<f64> = (0..60).map(f64::from).collect();
    let x: Vec<f64> = (0..60).map(|k| f64::from(k % 11) / 10.0).collect();
    let curve: Vec<f64> = x.iter().map(|x| 1.0 + 2.0 * x).collect();
    let out: Vec<f64> = curve.iter().map(|v| 3.0 * v).collect();
    let weights = vec![1.0; 60];
    let record = || Record { time_s: &time_s, channels: vec![&x] };
    let targets = [
        Target { record: record(), node: None, y: &out, weights: &weights },
        Target { record: record(), node: Some(1), y: &curve, weights: &weights },
    ];
    let options = Options { smooth: Some(0.0), ..Options::default() };
    let found = fit(&graph, &targets, &options, &|| false).unwrap();
    for (a, b) in found.fit.values.iter().zip([1.0, 2.0, 3.0, 3.0]) {
        assert!((a - b).abs() < 1e-6, "{:?}", found.fit.values);
    }
    // Another start gives the same.
    let other = fit_from(&graph, &[2.0, 2.0, 2.0, 2.0], &targets, &options, &|| false).unwrap();
    for (a, b) in found.fit.values.iter().zip(&other.fit.values) {
        assert!((a - b).abs() < 1e-6);
    }
    // A locked cell is its base, whatever the start.
    let mut locked = graph.clone();
    locked.labels[1].locked[0] = true;
    let other = fit_from(&locked, &[2.0, 2.0, 2.0, 7.0], &targets, &options, &|| false).unwrap();
    assert_eq!(other.fit.values[3], 1.0);
    let bad = Target { record: record(), node: Some(9), y: &curve, weights: &weights };
    let message = fit(&graph, &[bad], &options, &|| false).unwrap_err().to_string();
    assert!(message.contains("there are 4 nodes"), "{message}");
}

/// A cell that few samples reach stays near its neighbours, of which the one beyond keeps its base.
#[test]
fn a_cell_with_little_data_beside_an_untouched_one_does_not_run_away() {
    let axis = Axis::new("x", "-", &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let label = Label::new("CURVE", "%", vec![axis], &[50.0; 7]);
    let (mut square, mut alone) = (0.0, 0.0);
    for seed in 0..50 {
        let mut rng = Rng64::new(1000 + seed);
        let (mut rows, mut y) = (Rows::default(), Vec::new());
        // The table is right; many samples up to cell 3, five near the foot of cell 4, none beyond.
        for k in 0..405 {
            let x = if k < 400 { 3.0 * rng.uniform() } else { 3.0 + 0.3 * rng.uniform() };
            rows.start();
            label.enter(&mut rows, 0, 1.0, &[x]);
            y.push(50.0 + 3.0 * rng.normal());
        }
        let problem = Problem::new(std::slice::from_ref(&label), &rows, &y);
        let found = linear::fit(&problem, &Options::default()).unwrap();
        square += (found.values[4] - 50.0).powi(2) / 50.0;
        let free = linear::fit(&problem, &Options { smooth: Some(0.0), ..Options::default() }).unwrap();
        alone += (free.values[4] - 50.0).powi(2) / 50.0;
    }
    println!("cell with little data: off by {:.2}, without smoothness by {:.2}", square.sqrt(), alone.sqrt());
    assert!(square.sqrt() < 0.5 * alone.sqrt(), "{} {}", square.sqrt(), alone.sqrt());
}

/// A lag is found from wherever the search starts, far too fast and far too slow.
#[test]
fn a_lag_comes_back_from_any_start() {
    let mut rng = Rng64::new(11);
    let time_s: Vec<f64> = (0..2000).map(|k| 0.05 * f64::from(k)).collect();
    let mut level = 0.0;
    let x: Vec<f64> = (0..2000)
        .map(|k| {
            if k % 25 == 0 {
                level = rng.uniform();
            }
            level
        })
        .collect();
    let graph = |start: f64| {
        let mut tau = Label::scalar("TAU", "s", start);
        (tau.lower, tau.upper) = (0.001, 100.0);
        let nodes = vec![
            node("x", Op::Channel(0)),
            node("gain", Op::Label(0, vec![])),
            node("in", Op::Multiply(vec![0, 1])),
            node("tau", Op::Label(1, vec![])),
            node("out", Op::Lag(2, 3)),
        ];
        Graph { nodes, labels: vec![Label::scalar("GAIN", "-", 1.0), tau] }
    };
    let record = Record { time_s: &time_s, channels: vec![&x] };
    let planted = graph(1.0).values(&[3.0, 0.4], &record);
    let y: Vec<f64> = planted.iter().map(|v| v + 0.05 * rng.normal()).collect();
    let weights = vec![1.0; y.len()];
    for start in [0.001, 0.01, 0.1, 2.0, 10.0, 100.0] {
        let target = Target { record: record.clone(), node: None, y: &y, weights: &weights };
        let found = fit(&graph(start), &[target], &Options::default(), &|| false).unwrap();
        assert!(found.converged, "from {start} s");
        for (k, truth) in [3.0, 0.4].into_iter().enumerate() {
            let (value, half) = (found.fit.exact[k], found.fit.half_width[k]);
            assert!(
                (value - truth).abs() < 2.0 * half && half < 0.1 * truth,
                "from {start} s: {value} +- {half}"
            );
        }
    }
}

/// A function that ends where one of its labels has no effect: a lag that is none, a floor that nothing reaches. What the samples have led there
/// stays there.
#[test]
fn labels_that_end_where_nothing_depends_on_them_stay_there() {
    let mut rng = Rng64::new(5);
    let time_s: Vec<f64> = (0..1500).map(|k| 0.05 * f64::from(k)).collect();
    let mut level = 0.0;
    let x: Vec<f64> = (0..1500)
        .map(|k| {
            if k % 20 == 0 {
                level = rng.uniform_in(1.0, 5.0);
            }
            level
        })
        .collect();
    let y: Vec<f64> = x.iter().map(|x| 2.0 * x + 0.05 * rng.normal()).collect();
    let weights = vec![1.0; y.len()];
    let record = Record { time_s: &time_s, channels: vec![&x] };
    let mut lag = Label::scalar("T", "s", 0.3);
    (lag.lower, lag.upper) = (0.0, 5.0);
    let floor = Label::scalar("FLOOR", "-", 3.0);
    for (label, last) in [(lag, Op::Lag(2, 3)), (floor, Op::Max(2, 3))] {
        // A lag acts from the next sample on; what has none is a delay of one sample there.
        let shift = usize::from(matches!(last, Op::Lag(..)));
        let planted: Vec<f64> = (0..y.len()).map(|k| y[k.saturating_sub(shift)]).collect();
        let nodes = vec![
            node("x", Op::Channel(0)),
            node("k", Op::Label(0, vec![])),
            node("in", Op::Multiply(vec![0, 1])),
            node("label", Op::Label(1, vec![])),
            node("out", last),
        ];
        let graph = Graph { nodes, labels: vec![Label::scalar("K", "-", 1.0), label] };
        let target = Target { record: record.clone(), node: None, y: &planted, weights: &weights };
        for robust in [false, true] {
            let options = Options { robust, ..Options::default() };
            let found = fit(&graph, std::slice::from_ref(&target), &options, &|| false).unwrap();
            let left = rms(&graph.values(&found.fit.values, &record)[1..], &planted[1..]);
            assert!(
                found.converged && left < 0.07,
                "{}: {left}, {:?}",
                graph.labels[1].name,
                found.fit.values
            );
        }
    }
}

/// Two samples in a hundred are off by a hundred standard deviations: the lag is not led away by them.
#[test]
fn a_lag_survives_outliers() {
    for seed in 0..8 {
        let mut rng = Rng64::new(seed);
        let time_s: Vec<f64> = (0..1500).map(|k| 0.05 * f64::from(k)).collect();
        let x: Vec<f64> = (0..1500).map(|_| rng.uniform()).collect();
        let points: Vec<f64> = (0..11).map(|k| 0.1 * f64::from(k)).collect();
        let nodes = vec![
            node("x", Op::Channel(0)),
            node("c", Op::Label(0, vec![0])),
            node("t", Op::Label(1, vec![])),
            node("out", Op::Lag(1, 2)),
        ];
        let mut lag = Label::scalar("T", "s", 0.2);
        (lag.lower, lag.upper) = (0.001, 5.0);
        let graph = Graph { nodes, labels: vec![Label::curve("C", "-", "x", "-", &points, &[1.5; 11]), lag] };
        let record = Record { time_s: &time_s, channels: vec![&x] };
        let mut truth: Vec<f64> = points.iter().map(|p| 2.5 + (6.0 * p).sin()).collect();
        truth.push(0.2);
        let y: Vec<f64> = graph
            .values(&truth, &record)
            .into_iter()
            .map(|v| v + 0.1 * rng.normal() * if rng.uniform() < 0.02 { 100.0 } else { 1.0 })
            .collect();
        let weights = vec![1.0; y.len()];
        let target = Target { record, node: None, y: &y, weights: &weights };
        let options = Options { robust: true, ..Options::default() };
        let found = fit(&graph, &[target], &options, &|| false).unwrap();
        let (t, half) = (found.fit.exact[11], found.fit.half_width[11]);
        assert!(found.converged && (t - 0.2).abs() < 2.0 * half && half < 0.05, "seed {seed}: {t} +- {half}");
    }
}

/// A product of two curves, none of them locked: what is known stands, and the search ends with it.
#[test]
fn a_product_without_a_lock_ends_where_the_product_stands() {
    let points = [0.0, 0.25, 0.5, 0.75, 1.0];
    for (seed, options) in
        (0..6).flat_map(|s| [(s, Options::default()), (s, Options { robust: true, ..Options::default() })])
    {
        let p = planted(seed, 600);
        let mut graph = product(&points);
        graph.labels[1].locked.fill(false);
        let weights = vec![1.0; p.y.len()];
        let record = Record { time_s: &p.time_s, channels: vec![&p.x] };
        let target = Target { record: record.clone(), node: None, y: &p.y, weights: &weights };
        let found = fit(&graph, &[target], &options, &|| false).unwrap();
        let left = rms(&graph.values(&found.fit.values, &record), &p.truth);
        println!("seed {seed}: {} steps, left {left:.4}, {:.3?}", found.steps, found.fit.exact);
        assert!(found.converged && found.steps < 200, "{} steps", found.steps);
        let largest = found.fit.exact.iter().fold(0.0f64, |a, b| a.max(b.abs()));
        assert!(left < 0.1 && largest < 50.0, "{left} {largest}");
    }
}

/// Two rows in units whose scatter differs by five hundred, each weighed by one over its variance: one knee serves both.
#[test]
fn rows_of_different_units_have_their_own_outliers() {
    let mut rng = Rng64::new(3);
    let time_s: Vec<f64> = (0..2000).map(f64::from).collect();
    let x = vec![0.0; 2000];
    let nodes =
        vec![node("x", Op::Channel(0)), node("a", Op::Label(0, vec![])), node("b", Op::Label(1, vec![]))];
    let graph = Graph { nodes, labels: vec![Label::scalar("A", "Nm", 50.0), Label::scalar("B", "-", 0.9)] };
    let torque: Vec<f64> = (0..2000).map(|_| 90.0 + 5.0 * rng.normal()).collect();
    let lambda: Vec<f64> =
        (0..2000).map(|k| 1.0 + 0.01 * rng.normal() + if k % 10 == 0 { 0.3 } else { 0.0 }).collect();
    let (wide, narrow) = (vec![1.0 / 25.0; 2000], vec![1.0 / 1e-4; 2000]);
    let record = Record { time_s: &time_s, channels: vec![&x] };
    let targets = [
        Target { record: record.clone(), node: Some(1), y: &torque, weights: &wide },
        Target { record, node: Some(2), y: &lambda, weights: &narrow },
    ];
    let options = Options { robust: true, ..Options::default() };
    let found = fit(&graph, &targets, &options, &|| false).unwrap().fit;
    println!("{:.5?} +- {:.5?}", found.exact, found.half_width);
    assert!((found.exact[0] - 90.0).abs() < 0.5 && found.half_width[0] < 0.5, "{:?}", found.exact);
    // Huber's loss has a bias of a fifth of a standard deviation where a tenth of the samples lie to one side.
    assert!((found.exact[1] - 1.0).abs() < 0.004, "{:?}", found.exact);
}
