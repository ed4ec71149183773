//! Breakpoints that are fitted with the values on them.

use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::Options;
use dynocal_label::nonlinear::{Target, fit};
use dynocal_numerics::rng::Rng64;

fn node(name: &str, op: Op) -> Node {
    Node { name: name.into(), op }
}

fn plain() -> Options {
    Options { smooth: Some(0.0), ..Options::default() }
}

const KNOTS: [f64; 5] = [0.0, 1.2, 4.1, 6.8, 10.0];
const VALUES: [f64; 5] = [1.0, 5.0, 2.0, 6.0, 4.0];

/// A curve on evenly spaced breakpoints, with a truth on others.
fn curve() -> (Graph, Vec<f64>, Vec<f64>) {
    let label = Label::curve("CURVE", "Nm", "x", "rpm", &[0.0, 2.5, 5.0, 7.5, 10.0], &[3.0; 5]);
    let nodes = vec![node("x", Op::Channel(0)), node("y", Op::Label(0, vec![0]))];
    let x: Vec<f64> = (0..2000).map(|k| 10.0 * (f64::from(k) * 0.618_033_988_75).fract()).collect();
    let truth = Label::curve("TRUTH", "Nm", "x", "rpm", &KNOTS, &VALUES);
    let y = x.iter().map(|x| truth.value(&VALUES, &[*x])).collect();
    (Graph { nodes, labels: vec![label] }, x, y)
}

#[test]
fn breakpoints_of_a_curve_are_found_and_the_ends_stay() {
    let (graph, x, y) = curve();
    let (graph, axis) = graph.with_fitted_axis("POINTS", &[(0, 0)], 0.1).unwrap();
    let time_s: Vec<f64> = (0..x.len()).map(|k| 0.1 * k as f64).collect();
    let record = Record { time_s: &time_s, channels: vec![&x] };
    // At the start nothing has changed.
    let base = graph.base();
    assert_eq!(graph.values(&base, &record), vec![3.0; x.len()]);
    let weights = vec![1.0; x.len()];
    let target = Target { record, node: None, y: &y, weights: &weights };
    let found = fit(&graph, &[target], &plain(), &|| false).unwrap();
    assert!(found.converged);
    let labels = graph.labels_on(&[axis], &found.fit.exact);
    let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(near(&labels[0].axes[0].points, &KNOTS), "{:?}", labels[0].axes[0].points);
    assert!(near(&found.fit.exact[..5], &VALUES), "{:?}", &found.fit.exact[..5]);
}

/// Intervals of breakpoints and values hold what was planted, as often as they say.
#[test]
fn intervals_of_breakpoints_hold_what_is_there() {
    let (graph, x, y) = curve();
    let (graph, _) = graph.with_fitted_axis("POINTS", &[(0, 0)], 0.1).unwrap();
    let time_s: Vec<f64> = (0..x.len()).map(|k| 0.1 * k as f64).collect();
    let weights = vec![1.0; x.len()];
    let truth: Vec<f64> = VALUES.iter().chain(&KNOTS).copied().collect();
    let (mut held, mut all) = (0, 0);
    for seed in 0..40 {
        let mut rng = Rng64::new(seed);
        let noisy: Vec<f64> = y.iter().map(|y| y + 0.3 * rng.normal()).collect();
        let record = Record { time_s: &time_s, channels: vec![&x] };
        let target = Target { record, node: None, y: &noisy, weights: &weights };
        let found = fit(&graph, &[target], &plain(), &|| false).unwrap().fit;
        for k in (0..truth.len()).filter(|k| ![5, 9].contains(k)) {
            all += 1;
            held += usize::from((found.exact[k] - truth[k]).abs() <= found.half_width[k]);
        }
    }
    let share = held as f64 / all as f64;
    assert!((0.90..=0.99).contains(&share), "{share}");
}

/// Samples that breakpoints cross are corners of the sum: with noise, and with a smoothness that is searched as well, each search ends.
#[test]
fn noisy_breakpoints_come_to_a_minimum_with_any_smoothness() {
    let (graph, x, y) = curve();
    let (graph, _) = graph.with_fitted_axis("POINTS", &[(0, 0)], 0.1).unwrap();
    let time_s: Vec<f64> = (0..x.len()).map(|k| 0.1 * k as f64).collect();
    let weights = vec![1.0; x.len()];
    for options in [Options::default(), Options { robust: true, ..plain() }] {
        for seed in 100..130 {
            let mut rng = Rng64::new(seed);
            let noisy: Vec<f64> = y.iter().map(|y| y + 0.5 * rng.normal()).collect();
            let record = Record { time_s: &time_s, channels: vec![&x] };
            let target = Target { record, node: None, y: &noisy, weights: &weights };
            let found = fit(&graph, &[target], &options, &|| false).unwrap();
            assert!(found.converged, "seed {seed}, robust {}: {} steps", options.robust, found.steps);
        }
    }
}

/// An axis that two maps share moves for both; a breakpoint at a locked cell stays, intervals keep their least share.
#[test]
fn a_shared_axis_moves_for_all_labels_and_keeps_what_is_given() {
    let speed = [1000.0, 2000.0, 3000.0, 4000.0];
    let load = [0.0, 1.0];
    let axes = || vec![Axis::new("speed", "rpm", &speed), Axis::new("load", "-", &load)];
    let one = Label::new("ONE", "Nm", axes(), &[1.0; 8]);
    let mut two = Label::new("TWO", "Nm", vec![Axis::new("speed", "rpm", &speed)], &[1.0, 1.0, 1.0, 1.0]);
    two.locked[1] = true;
    let nodes = vec![
        node("n", Op::Channel(0)),
        node("load", Op::Channel(1)),
        node("one", Op::Label(0, vec![0, 1])),
        node("two", Op::Label(1, vec![0])),
        node("product", Op::Multiply(vec![2, 3])),
    ];
    let plain_graph = Graph { nodes, labels: vec![one, two] };
    let (graph, axis) = plain_graph.with_fitted_axis("POINTS", &[(0, 0), (1, 0)], 0.2).unwrap();
    assert_eq!(graph.nodes.iter().filter(|n| matches!(n.op, Op::Inverse(..))).count(), 1);
    assert_eq!(graph.labels[2].locked, [true, true, false, true]);
    let n = 3000;
    let channel = |step: f64, from: f64, range: f64| -> Vec<f64> {
        (0..n).map(|k| from + range * (f64::from(k) * step).fract()).collect()
    };
    let (x, l) = (channel(0.618_033_988_75, 1000.0, 3000.0), channel(0.414_213_562_37, 0.0, 1.0));
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * f64::from(k)).collect();
    // The truth has its third breakpoint nearer to the second than intervals may come: 2100 rpm, the least is 2200.
    let mut truth = plain_graph.clone();
    truth.labels.iter_mut().for_each(|l| l.axes[0].points[2] = 2100.0);
    let values = [1.0, 4.0, 9.0, 2.0, 2.0, 5.0, 8.0, 3.0, 0.8, 1.0, 1.5, 0.9];
    let record = Record { time_s: &time_s, channels: vec![&x, &l] };
    let y = truth.values(&values, &record);
    let weights = vec![1.0; y.len()];
    let found =
        fit(&graph, &[Target { record, node: None, y: &y, weights: &weights }], &plain(), &|| false).unwrap();
    let labels = graph.labels_on(&[axis], &found.fit.exact);
    assert_eq!(labels[0].axes[0].points, labels[1].axes[0].points);
    assert_eq!(labels[0].axes[0].points[1], 2000.0);
    assert!((labels[0].axes[0].points[2] - 2200.0).abs() < 1e-6, "{:?}", labels[0].axes[0].points);
}

#[test]
fn an_axis_without_an_inverse_is_refused() {
    let (graph, ..) = curve();
    let why =
        |of: &[(usize, usize)], least| graph.with_fitted_axis("POINTS", of, least).unwrap_err().to_string();
    assert!(why(&[], 0.1).contains("no axis"), "{}", why(&[], 0.1));
    assert!(why(&[(0, 1)], 0.1).contains("no axis"));
    assert!(why(&[(0, 0)], 0.0).contains("share"));
    // A limit that would hold over the breakpoints as they were, and a label that is read both ways.
    let limited = |convex: i8, gradient: [f64; 2]| {
        let mut graph = graph.clone();
        (graph.labels[0].axes[0].convex, graph.labels[0].axes[0].gradient) = (convex, gradient);
        graph.with_fitted_axis("POINTS", &[(0, 0)], 0.1).map(|_| ()).map_err(|e| e.to_string())
    };
    assert!(limited(0, [0.0, f64::INFINITY]).is_ok());
    assert!(limited(1, [f64::NEG_INFINITY, f64::INFINITY]).unwrap_err().contains("curvature"));
    assert!(limited(0, [f64::NEG_INFINITY, 2.0]).unwrap_err().contains("gradient"));
    let mut both = graph.clone();
    both.labels[0].axes[0].gradient[0] = 0.0;
    both.nodes.push(node("back", Op::Inverse(0, 1)));
    let said = both.with_fitted_axis("POINTS", &[(0, 0)], 0.1).unwrap_err().to_string();
    assert!(said.contains("inverse"), "{said}");
    let falling = Label::curve("FALLING", "-", "x", "-", &[0.0, 1.0], &[1.0, 0.0]);
    let nodes = vec![node("x", Op::Channel(0)), node("y", Op::Inverse(0, 0))];
    let said = Graph { nodes, labels: vec![falling] }.check(1).unwrap_err().to_string();
    assert!(said.contains("does not increase"), "{said}");
}
