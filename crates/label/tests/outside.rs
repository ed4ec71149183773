//! A model as a node: what is no graph, with differences in place of a derivative.

use std::sync::Arc;

use dynocal_label::graph::outside::{Outside, Response};
use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::Label;
use dynocal_label::linear::Options;
use dynocal_label::nonlinear::{Target, fit, large};
use dynocal_numerics::rng::Rng64;

/// The lag of a graph, written down once more, of the product of its inputs.
#[derive(Debug)]
struct Lag {
    tau_s: f64,
}

impl Response for Lag {
    fn values(&self, time_s: &[f64], inputs: &[&[f64]]) -> Result<Vec<f64>, String> {
        if let Some(k) = inputs[1].iter().position(|v| *v > 100.0) {
            return Err(format!("found a gain of {} at sample {k}, expected at most 100", inputs[1][k]));
        }
        let x = |t: usize| inputs[0][t] * inputs[1][t];
        let mut y = vec![x(0)];
        for t in 1..time_s.len() {
            let a = (-(time_s[t] - time_s[t - 1]) / self.tau_s).exp();
            y.push(a * y[t - 1] + (1.0 - a) * x(t - 1));
        }
        Ok(y)
    }
}

const TAU_S: f64 = 0.4;

/// `out = lag(curve(x) gain) + offset`, the lag and the product a model, or nodes.
fn function(as_model: bool) -> Graph {
    let labels = vec![
        Label::curve("CURVE", "-", "x", "-", &[0.0, 0.5, 1.0], &[1.0; 3]),
        Label::scalar("GAIN", "-", 1.0),
        Label::scalar("OFFSET", "-", 0.0),
    ];
    let node = |name: &str, op: Op| Node { name: name.into(), op };
    let mut nodes = vec![
        node("x", Op::Channel(0)),
        node("curve", Op::Label(0, vec![0])),
        node("gain", Op::Label(1, vec![])),
        node("offset", Op::Label(2, vec![])),
    ];
    let lag = if as_model {
        let named = |n: &str| (n.to_string(), "-".to_string());
        let model = Outside {
            name: "lag".into(),
            inputs: vec![named("fuel"), named("gain")],
            unit: "-".into(),
            response: Arc::new(Lag { tau_s: TAU_S }),
        };
        nodes.push(node("model", Op::Model(model, vec![1, 2])));
        4
    } else {
        nodes.push(node("product", Op::Multiply(vec![1, 2])));
        nodes.push(node("tau", Op::Constant(TAU_S)));
        nodes.push(node("lag", Op::Lag(4, 5)));
        6
    };
    nodes.push(node("out", Op::Add(vec![lag, 3])));
    let mut graph = Graph { nodes, labels };
    // Gain and offset say what the curve says as well: two of its cells are given.
    graph.labels[0].base[1] = 1.6;
    graph.labels[0].locked[..2].fill(true);
    graph
}

fn drive() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let mut rng = Rng64::new(1);
    let time_s: Vec<f64> = (0..800).map(|k| 0.05 * k as f64).collect();
    let mut v = 0.5;
    let x: Vec<f64> = (0..800)
        .map(|k| {
            if k % 9 == 0 {
                v = rng.uniform();
            }
            v
        })
        .collect();
    let record = Record { time_s: &time_s, channels: vec![&x] };
    let y = function(false).values(&[1.0, 1.6, 0.7, 2.5, 0.3], &record);
    let y = y.iter().map(|v| v + 0.02 * rng.normal()).collect();
    (time_s, x, y)
}

#[test]
fn a_model_as_a_node_is_fitted_as_the_nodes_that_it_is() {
    let (time_s, x, y) = drive();
    let record = Record { time_s: &time_s, channels: vec![&x] };
    let (model, nodes) = (function(true), function(false));
    let theta = [1.0, 1.3, 0.8, 2.0, 0.1];
    let direction = [0.0, 0.3, -0.2, 0.7, 0.4];
    // Values the same, derivatives forward and backward to the accuracy of differences.
    let ((a, da), (b, db)) =
        (model.forward(&theta, &record, &direction), nodes.forward(&theta, &record, &direction));
    let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off(&a, &b) < 1e-14 && off(&da, &db) < 1e-8, "{:e}", off(&da, &db));
    let (ga, gb) = (model.gradient(&theta, &record, &y), nodes.gradient(&theta, &record, &y));
    let size = gb.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    assert!(off(&ga, &gb) < 1e-8 * size, "{ga:?} {gb:?}");
    let weights = vec![1.0; y.len()];
    let found = |graph: &Graph| {
        let target = Target { record: record.clone(), node: None, y: &y, weights: &weights };
        fit(graph, &[target], &Options { smooth: Some(0.0), ..Options::default() }, &|| false).unwrap()
    };
    let (a, b) = (found(&model), found(&nodes));
    assert!(a.converged && b.converged);
    assert!(off(&a.fit.exact, &b.fit.exact) < 1e-6, "{:?} {:?}", a.fit.exact, b.fit.exact);
    assert!((a.fit.exact[3] - 2.5).abs() < 0.05, "{:?}", a.fit.exact);
}

#[test]
fn what_a_model_refuses_is_told_with_its_node() {
    let (time_s, x, y) = drive();
    let record = Record { time_s: &time_s, channels: vec![&x] };
    let weights = vec![1.0; y.len()];
    let target = || Target { record: record.clone(), node: None, y: &y, weights: &weights };
    let mut graph = function(true);
    graph.labels[1].base[0] = 200.0;
    let message = fit(&graph, &[target()], &Options::default(), &|| false).unwrap_err().to_string();
    assert!(message.contains("model") && message.contains("found a gain of 200 at sample 0"), "{message}");
    // The way without J needs a derivative backward in time.
    let graph = function(true);
    let found = large::fit(&graph, &graph.base(), &[target()], &Options::default(), &|| false);
    assert!(found.unwrap_err().to_string().contains("at most 500 cells"));
    let mut wrong = function(true);
    if let Op::Model(_, at) = &mut wrong.nodes[4].op {
        at.pop();
    }
    assert!(wrong.check(1).unwrap_err().to_string().contains("found 1 inputs, expected fuel, gain"));
}
