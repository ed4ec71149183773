//! Functions: derivatives against differences and against each other, dynamic labels against SciPy.

use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::Options;
use dynocal_label::nonlinear::{Target, fit, large};
use dynocal_numerics::rng::Rng64;
use serde_json::Value;

fn graph(ops: Vec<(&str, Op)>, labels: Vec<Label>) -> Graph {
    Graph { nodes: ops.into_iter().map(|(n, op)| Node { name: n.into(), op }).collect(), labels }
}

/// Every node with a derivative in one function.
fn everything() -> Graph {
    let map = Label::new(
        "MAP",
        "-",
        vec![Axis::new("a", "-", &[-1.0, 0.0, 1.5]), Axis::new("b", "-", &[-1.0, 0.5, 2.0])],
        &[1.0, 1.4, 0.8, 1.1, 1.3, 0.7, 0.9, 1.6, 1.2],
    );
    let curve = Label::curve("CURVE", "-", "a", "-", &[-1.0, 0.0, 1.0], &[0.3, 0.5, 0.45]);
    let mut breakpoints = Label::curve("POINTS", "-", "a", "-", &[-1.0, 0.0, 1.5], &[-1.0, 0.2, 1.5]);
    breakpoints.axes[0].gradient[0] = 0.1;
    let labels = vec![
        map,
        curve,
        Label::scalar("TAU", "s", 0.31),
        Label::scalar("DELAY", "s", 0.137),
        Label::scalar("VOLUME", "-", 0.61),
        Label::scalar("SHARE", "-", 0.3),
        breakpoints,
    ];
    graph(
        vec![
            ("a", Op::Channel(0)),
            ("b", Op::Channel(1)),
            ("flow", Op::Channel(2)),
            ("tau", Op::Label(2, vec![])),
            ("delay", Op::Label(3, vec![])),
            ("volume", Op::Label(4, vec![])),
            ("share", Op::Label(5, vec![])),
            ("map", Op::Label(0, vec![0, 1])),
            ("film", Op::Film(7, 6, 3)),
            ("late", Op::Delay(8, 4)),
            ("pipe", Op::DelayFlow(9, 2, 5)),
            ("slow", Op::Lag(10, 3)),
            ("curve", Op::Label(1, vec![11])),
            ("product", Op::Multiply(vec![11, 12, 7])),
            ("ratio", Op::Divide(13, 2)),
            ("least", Op::Min(14, 7)),
            ("most", Op::Max(15, 12)),
            ("sum", Op::Integrator(16, -1.0, 3.0, 0.0)),
            ("on", Op::Hysteresis(0, -0.2, 0.2)),
            ("choice", Op::Switch(18, 17, 16)),
            ("two", Op::Constant(2.0)),
            ("warped", Op::Inverse(6, 0)),
            ("map on other points", Op::Label(0, vec![21, 1])),
            ("more", Op::Add(vec![19, 20, 22])),
            ("out", Op::Subtract(23, 11)),
        ],
        labels,
    )
}

fn channels() -> (Vec<f64>, Vec<Vec<f64>>) {
    let time_s: Vec<f64> =
        (0..160).map(|k| 0.066 * f64::from(k) + 0.004 * (f64::from(k) * 1.7).sin()).collect();
    let a = time_s.iter().map(|t| 0.9 * (1.3 * t).sin()).collect();
    let b = time_s.iter().map(|t| 0.6 + 0.9 * (0.7 * t + 1.0).cos()).collect();
    let flow = time_s.iter().map(|t| 2.0 + (0.9 * t).sin()).collect();
    (time_s, vec![a, b, flow])
}

#[test]
fn derivatives_forward_are_differences_and_backward_are_forward() {
    let g = everything();
    g.check(3).unwrap();
    let (time_s, c) = channels();
    let record = Record { time_s: &time_s, channels: c.iter().map(Vec::as_slice).collect() };
    let theta = g.base();
    let mut rng = Rng64::new(1);
    let u: Vec<f64> = (0..time_s.len()).map(|_| rng.normal()).collect();
    let back = g.gradient(&theta, &record, &u);
    for k in 0..theta.len() {
        let mut unit = vec![0.0; theta.len()];
        unit[k] = 1.0;
        let (_, d) = g.forward(&theta, &record, &unit);
        let along: f64 = d.iter().zip(&u).map(|(a, b)| a * b).sum();
        assert!((along - back[k]).abs() < 1e-9 * along.abs().max(1.0), "cell {k}: {along} {}", back[k]);
        let h = 1e-6;
        let shifted = |s: f64| {
            let mut t = theta.clone();
            t[k] += s * h;
            g.values(&t, &record)
        };
        let (up, down) = (shifted(1.0), shifted(-1.0));
        // A sample at which an edge lies between the two has no derivative.
        let wrong = (0..d.len())
            .filter(|t| {
                let slope = (up[*t] - down[*t]) / (2.0 * h);
                (slope - d[*t]).abs() > 1e-5 * slope.abs().max(1.0)
            })
            .count();
        assert!(wrong <= 2, "cell {k}: {wrong} samples");
    }
}

/// Over all processors, for the output and for nodes before it.
#[test]
fn products_are_those_of_the_derivatives_one_by_one() {
    let mut g = everything();
    // A node that no label reaches beside one that two do, and one behind the output.
    let behind = g.nodes.len() - 1;
    g.nodes.push(Node { name: "quotient".into(), op: Op::Divide(2, 7) });
    g.nodes.push(Node { name: "end".into(), op: Op::Multiply(vec![behind, behind + 1]) });
    let mut rng = Rng64::new(2);
    let n = 5000;
    let time_s: Vec<f64> = (0..n).map(|k| 0.066 * k as f64).collect();
    let channel = |f: &dyn Fn(f64) -> f64| time_s.iter().map(|t| f(*t)).collect::<Vec<f64>>();
    let c = [
        channel(&|t| 0.9 * (1.3 * t).sin()),
        channel(&|t| 0.6 + 0.9 * (0.7 * t + 1.0).cos()),
        channel(&|t| 2.0 + (0.9 * t).sin()),
    ];
    let record = Record { time_s: &time_s, channels: c.iter().map(Vec::as_slice).collect() };
    let theta = g.base();
    let u: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
    let v: Vec<f64> = (0..theta.len()).map(|_| rng.normal()).collect();
    let near = |a: &[f64], b: &[f64]| {
        let size = b.iter().fold(1e-9f64, |s, v| s.max(v.abs()));
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-12 * size)
    };
    for output in [7, 11, 19, 22, 24, 26] {
        let products = g.products(&theta, &record, output);
        let mut part = g.clone();
        part.nodes.truncate(output + 1);
        assert!(near(&products.forward(&v), &part.forward(&theta, &record, &v).1), "J v of node {output}");
        assert!(near(&products.backward(&u), &part.gradient(&theta, &record, &u)), "J'u of node {output}");
    }
}

/// Delay: a step comes d later. Pipe: the delay is volume over flow. Lag and film against their closed forms.
/// Labels that a sum takes at one place, alone or times a gain, are taken together: several sums, curves and maps, gains that other
/// members share or lack, one label twice, a product that is used elsewhere as well.
#[test]
fn products_of_labels_that_are_taken_together_are_those_one_by_one() {
    let (time_s, data) = channels();
    let record = Record { time_s: &time_s, channels: data.iter().map(Vec::as_slice).collect() };
    let axis = || Axis::new("a", "-", &[-1.0, 0.0, 0.4, 1.5]);
    let other = || Axis::new("b", "-", &[-1.0, 0.5, 2.0]);
    let map = |k: usize| Label::new(&format!("MAP{k}"), "-", vec![axis(), other()], &[1.0; 12]);
    let curve = |k: usize| Label::new(&format!("CURVE{k}"), "-", vec![axis()], &[1.0; 4]);
    let mut labels: Vec<Label> = (0..3).map(map).collect();
    labels.extend((0..2).map(curve));
    labels.push(Label::scalar("TAU", "s", 0.3));
    let g = graph(
        vec![
            ("a", Op::Channel(0)),
            ("b", Op::Channel(1)),
            ("gain", Op::Channel(2)),
            ("map0", Op::Label(0, vec![0, 1])),
            ("map1", Op::Label(1, vec![0, 1])),
            ("map2", Op::Label(2, vec![0, 1])),
            ("curve0", Op::Label(3, vec![0])),
            ("curve1", Op::Label(4, vec![0])),
            ("again", Op::Label(0, vec![0, 1])),
            ("times1", Op::Multiply(vec![2, 4])),
            ("times2", Op::Multiply(vec![5, 1])),
            ("times3", Op::Multiply(vec![7, 2])),
            ("tau", Op::Label(5, vec![])),
            ("late", Op::Lag(10, 12)),
            ("sum", Op::Add(vec![3, 9, 10, 8, 6, 11, 13])),
            ("slow", Op::Lag(14, 12)),
            ("more", Op::Add(vec![15, 0])),
        ],
        labels,
    );
    let mut rng = Rng64::new(5);
    let mut draw = |n: usize| -> Vec<f64> { (0..n).map(|_| rng.uniform_in(0.2, 1.0)).collect() };
    let theta = draw(g.base().len());
    for output in [14, 15, 16] {
        let part = Graph { nodes: g.nodes[..=output].to_vec(), labels: g.labels.clone() };
        let (v, u) = (draw(theta.len()), draw(time_s.len()));
        let products = g.products(&theta, &record, output);
        let off = |a: &[f64], b: &[f64]| {
            a.iter().zip(b).map(|(a, b)| (a - b).abs() / b.abs().max(1.0)).fold(0.0, f64::max)
        };
        let forward = off(&products.forward(&v), &part.forward(&theta, &record, &v).1);
        let backward = off(&products.backward(&u), &part.gradient(&theta, &record, &u));
        assert!(forward < 1e-12 && backward < 1e-12, "node {output}: {forward:e} {backward:e}");
    }
}

#[test]
fn nodes_with_a_memory_are_what_their_equations_say() {
    let time_s: Vec<f64> = (0..200).map(|k| 0.05 * f64::from(k)).collect();
    let step: Vec<f64> = time_s.iter().map(|t| f64::from(u8::from(*t >= 1.0))).collect();
    let flow = vec![4.0; 200];
    let record = Record { time_s: &time_s, channels: vec![&step, &flow] };
    let at = |op: Op, values: &[f64]| {
        let labels = values.iter().map(|v| Label::scalar("L", "-", *v)).collect();
        let mut ops = vec![("u", Op::Channel(0)), ("f", Op::Channel(1)), ("p", Op::Label(0, vec![]))];
        if values.len() > 1 {
            ops.push(("q", Op::Label(1, vec![])));
        }
        ops.push(("y", op));
        let g = graph(ops, labels);
        g.values(&g.base(), &record)
    };
    let half = |y: &[f64]| time_s[y.iter().position(|v| *v >= 0.5).unwrap()];
    assert!((half(&at(Op::Delay(0, 2), &[0.5])) - 1.5).abs() < 0.051);
    assert!((half(&at(Op::DelayFlow(0, 1, 2), &[2.0])) - 1.5).abs() < 0.051);
    let lag = at(Op::Lag(0, 2), &[0.4]);
    let film = at(Op::Film(0, 2, 3), &[0.3, 0.8]);
    for (k, t) in time_s.iter().enumerate().filter(|(_, t)| **t >= 1.0) {
        assert!((lag[k] - (1.0 - (-(t - 1.0) / 0.4).exp())).abs() < 1e-9);
        // A share of 0.3 comes late: y = 1 - X exp(-t / tau).
        assert!((film[k] - (1.0 - 0.3 * (-(t - 1.0) / 0.8).exp())).abs() < 1e-9, "{k} {}", film[k]);
    }
}

#[test]
fn a_film_is_fitted_as_scipy_does() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/reference/labels.json");
    let all: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let r = &all["film"];
    let numbers =
        |v: &Value| -> Vec<f64> { v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect() };
    let (fuel, y) = (numbers(&r["fuel"]), numbers(&r["y"]));
    let dt = r["dt_s"].as_f64().unwrap();
    let time_s: Vec<f64> = (0..y.len()).map(|k| dt * k as f64).collect();
    let mut labels = vec![Label::scalar("X", "-", 0.1), Label::scalar("TAU", "s", 0.2)];
    (labels[0].lower, labels[0].upper) = (0.0, 0.9);
    (labels[1].lower, labels[1].upper) = (0.01, 10.0);
    let ops = vec![
        ("fuel", Op::Channel(0)),
        ("share", Op::Label(0, vec![])),
        ("tau", Op::Label(1, vec![])),
        ("out", Op::Film(0, 1, 2)),
    ];
    let g = graph(ops, labels);
    let weights = vec![1.0; y.len()];
    let target = Target {
        record: Record { time_s: &time_s, channels: vec![&fuel] },
        node: None,
        y: &y,
        weights: &weights,
    };
    let found = fit(&g, std::slice::from_ref(&target), &Options::default(), &|| false).unwrap();
    assert!(found.converged);
    for (a, b) in found.fit.values.iter().zip([&r["share"], &r["tau_s"]]) {
        let b = b.as_f64().unwrap();
        assert!((a - b).abs() < 1e-6 * b, "{a} {b}");
    }
    // With a bound below the optimum it stops there.
    let mut bound = g.clone();
    bound.labels[0].upper = 0.2;
    let found = fit(&bound, &[target], &Options::default(), &|| false).unwrap();
    assert!((found.fit.values[0] - 0.2).abs() < 1e-9 && !found.fit.held.is_empty(), "{:?}", found.fit.values);
}

/// Delays, by time and by flow, before a lag: labels and squares of SciPy's own simulation, on both ways of the fit.
#[test]
fn delays_and_lags_are_fitted_as_scipy_does() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/reference/labels_dynamic.json");
    let all: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let numbers =
        |v: &Value| -> Vec<f64> { v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect() };
    let (u, flow, dt) = (numbers(&all["u"]), numbers(&all["flow"]), all["dt_s"].as_f64().unwrap());
    let time_s: Vec<f64> = (0..u.len()).map(|k| dt * k as f64).collect();
    let weights = vec![1.0; u.len()];
    let label = |k: usize| Op::Label(k, vec![]);
    let delay = vec![
        ("u", Op::Channel(0)),
        ("gain", label(0)),
        ("by", label(1)),
        ("tau", label(2)),
        ("offset", label(3)),
        ("late", Op::Delay(0, 2)),
        ("slow", Op::Lag(5, 3)),
        ("more", Op::Multiply(vec![6, 1])),
        ("out", Op::Add(vec![7, 4])),
    ];
    let by_flow = vec![
        ("u", Op::Channel(0)),
        ("flow", Op::Channel(1)),
        ("volume", label(0)),
        ("tau", label(1)),
        ("late", Op::DelayFlow(0, 1, 2)),
        ("out", Op::Lag(4, 3)),
    ];
    for (name, ops) in [("by_time", delay), ("by_flow", by_flow)] {
        let r = &all[name];
        let (y, wanted) = (numbers(&r["y"]), numbers(&r["labels"]));
        let labels = numbers(&r["start"])
            .into_iter()
            .enumerate()
            .map(|(k, v)| Label::scalar(&format!("L{k}"), "-", v));
        let g = graph(ops, labels.collect());
        let record = Record { time_s: &time_s, channels: vec![&u, &flow] };
        let targets = [Target { record, node: None, y: &y, weights: &weights }];
        let options = Options::default();
        let held = fit(&g, &targets, &options, &|| false).unwrap();
        let large = large::fit(&g, &g.base(), &targets, &options, &|| false).unwrap();
        for (way, found) in [("held", &held), ("large", &large)] {
            let off =
                found.fit.exact.iter().zip(&wanted).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
            let squares = found.fit.rms[1].powi(2) * y.len() as f64 / r["squares"].as_f64().unwrap() - 1.0;
            println!(
                "{name}, {way}: labels off by {off:.1e}, squares by {squares:.1e}, {} steps",
                found.steps
            );
            assert!(
                found.converged && off < 1e-6 && squares.abs() < 1e-9,
                "{name}, {way}: {off:e} {squares:e}"
            );
        }
    }
}

#[test]
fn a_graph_that_makes_no_sense_is_refused_with_its_node() {
    let bad = |ops: Vec<(&str, Op)>| {
        graph(ops, vec![Label::scalar("S", "-", 1.0)]).check(1).unwrap_err().to_string()
    };
    assert!(bad(vec![("a", Op::Add(vec![0]))]).contains("node `a`"));
    assert!(bad(vec![("a", Op::Channel(3))]).contains("no channel 3"));
    assert!(bad(vec![("a", Op::Channel(0)), ("b", Op::Label(0, vec![0]))]).contains("0 axes, found 1"));
    assert!(bad(vec![]).contains("no node"));
}

#[test]
fn an_axis_of_too_many_breakpoints_is_refused_by_its_name() {
    let of = |n: u32| {
        let points: Vec<f64> = (0..n).map(f64::from).collect();
        let label = Label::curve("WIDE", "-", "count", "-", &points, &vec![0.0; points.len()]);
        graph(vec![("x", Op::Channel(0)), ("out", Op::Label(0, vec![0]))], vec![label])
    };
    assert!(of(1 << 16).check(1).is_ok());
    let message = of((1 << 16) + 1).check(1).unwrap_err().to_string();
    assert!(message.contains("`WIDE`") && message.contains("`count`"), "{message}");
    assert!(message.contains("65537") && message.contains("65536"), "{message}");
}

/// A curve that is read backwards where it has no value keeps its base: no sample says anything of it.
#[test]
fn an_inverse_beyond_the_ends_tells_nothing_of_its_curve() {
    let mut curve = Label::curve("CURVE", "-", "x", "-", &[0.0, 1.0, 2.0], &[0.0, 1.0, 2.0]);
    curve.axes[0].gradient[0] = 0.01;
    let ops = vec![
        ("v", Op::Channel(0)),
        ("x", Op::Inverse(0, 0)),
        ("gain", Op::Label(1, vec![])),
        ("y", Op::Multiply(vec![1, 2])),
    ];
    let g = graph(ops, vec![curve, Label::scalar("GAIN", "-", 1.0)]);
    let time_s: Vec<f64> = (0..50).map(f64::from).collect();
    let v: Vec<f64> = time_s.iter().map(|t| 5.0 + t).collect();
    let y = vec![6.0; 50];
    let weights = vec![1.0; 50];
    let record = Record { time_s: &time_s, channels: vec![&v] };
    let target = Target { record, node: None, y: &y, weights: &weights };
    let found = fit(&g, &[target], &Options::default(), &|| false).unwrap();
    assert_eq!(&found.fit.values[..3], [0.0, 1.0, 2.0]);
    assert!((found.fit.values[3] - 3.0).abs() < 1e-9, "{:?}", found.fit.values);
}
