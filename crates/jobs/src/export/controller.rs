//! A controller as a program: each loop reads its demand, its measurement and a feedforward, and gives its actuator.
//!
//! Operation by operation it is [`dynocal_control::runtime::Pid`] and [`dynocal_control::predictor::Predictor`]: within the limits the same
//! numbers, at them the same but for rounding. A measurement that is no number holds the actuator and all that the controller remembers, as
//! in the running one: whether it is one is a number too, and what a branch would choose is a sum of products.

use dynocal_control::predictor::{PredictedModel, TransportFlow};
use dynocal_control::runtime::PidGains;
use dynocal_control::stored::{Schedule, StoredController, StoredLoop};
use dynocal_export::characteristic::{Axis, Characteristic, identifier};
use dynocal_export::package::Package;
use dynocal_export::program::{Factor, NodeId, Op, Shape, Start, Term};

use super::Made;
use super::build::Build;
use super::oxygen::observer;

pub(super) fn term(coefficient: f64, nodes: &[NodeId]) -> Term {
    Term { coefficient, factors: nodes.iter().map(|n| Factor { node: *n, power: 1 }).collect() }
}

/// The loops as one program; gains by operating point are maps beside it.
pub fn controller(stored: &StoredController) -> Made {
    let mut b = Build::new(stored.sample_time_s);
    let mut maps = Vec::new();
    let mut channels: Vec<(String, NodeId)> = Vec::new();
    for l in &stored.loops {
        let gains = l.schedule.as_ref().map(|s| scheduled(&mut b, l, s, &mut channels, &mut maps));
        one(&mut b, l, stored.sample_time_s, gains);
    }
    if let Some(c) = &stored.catalyst {
        observer(&mut b, c, stored.sample_time_s);
    }
    let notes = vec![
        "a measurement that is no number holds the actuator of the exported controller where it is".into(),
    ];
    let package = Package {
        name: "controller".into(),
        description: "Feedback controllers".into(),
        characteristics: maps,
        program: Some(b.program),
        ..Default::default()
    };
    Made { package, notes }
}

/// Nodes of kp and ki, read from maps over scheduling channels.
fn scheduled(
    b: &mut Build,
    l: &StoredLoop,
    s: &Schedule,
    channels: &mut Vec<(String, NodeId)>,
    maps: &mut Vec<Characteristic>,
) -> (NodeId, NodeId) {
    let mut inputs = Vec::new();
    for a in &s.axes {
        let node = match channels.iter().find(|(n, _)| *n == a.channel) {
            Some((_, node)) => *node,
            None => {
                let middle = 0.5 * (a.points[0] + a.points[a.points.len() - 1]);
                let node = b.input(&a.channel, &a.unit, middle, None);
                channels.push((a.channel.clone(), node));
                node
            }
        };
        inputs.push(node);
    }
    let mut map = |what: &str, unit: String, values: &[f64]| {
        let name = identifier(&format!("{}_{what}", l.output).to_uppercase());
        let axes = s
            .axes
            .iter()
            .enumerate()
            .map(|(k, a)| Axis {
                name: format!("{name}_{}", ["x", "y"][k.min(1)]),
                description: a.channel.clone(),
                unit: a.unit.clone(),
                input: a.channel.clone(),
                points: a.points.clone(),
                shared: false,
            })
            .collect();
        let description = format!("{what} of the controller of {}", l.output);
        maps.push(Characteristic {
            name: name.clone(),
            description,
            unit,
            axes,
            values: values.to_vec(),
            limits: None,
        });
        name
    };
    let unit = format!("{}/{}", l.input_unit, l.output_unit);
    let names = [map("kp", unit.clone(), &s.kp), map("ki", format!("{unit}/s"), &s.ki)];
    let nodes = names.map(|n| {
        let op = Op::Lookup { characteristic: n.clone(), inputs: inputs.clone() };
        b.node(&format!("{n}_now"), op)
    });
    (nodes[0], nodes[1])
}

fn one(b: &mut Build, l: &StoredLoop, dt_s: f64, gains: Option<(NodeId, NodeId)>) {
    let name = |what: &str| format!("{}_{what}", l.output);
    let (lower, upper) = (l.limits.lower, l.limits.upper);
    let start = l.start.clamp(lower, upper);
    let demand = b.input(&name("demand"), &l.output_unit, 0.0, None);
    let measured = b.input(&name("measured"), &l.output_unit, 0.0, None);
    let forward = b.input(&name("feedforward"), &l.input_unit, 0.0, None);
    // Nodes that read the past of later ones are made first and turned to them at the end.
    let later = |b: &mut Build, what: &str, samples: usize, start: f64| {
        b.node(&name(what), Op::Delay { of: 0, samples, start: Start::Value(start) })
    };
    let last_integral = later(b, "integral_1", 1, start);
    let last_output = later(b, "output_1", 1, start);
    let (raw, model) = match &l.predictor {
        None => (b.node(&name("error_raw"), Op::Difference { a: demand, b: measured }), None),
        Some(p) => predicted(b, &name, p, demand, measured, dt_s, start),
    };
    // Whether error and feedforward are numbers, and both as numbers in any case.
    let known = [number(b, &name("error_is"), raw), number(b, &name("feedforward_is"), forward)];
    let told = b.node(&name("told"), Op::Polynomial { terms: vec![term(1.0, &known)] });
    let error = finite(b, &name("error"), raw);
    let forward = finite(b, &name("feedforward_held"), forward);
    let g = &l.gains;
    let proportional = match gains {
        Some((kp, _)) => term(1.0, &[kp, error]),
        None => term(g.kp, &[error]),
    };
    let mut terms = vec![term(1.0, &[forward]), proportional];
    if g.kd != 0.0 {
        terms.push(term(1.0, &[derivative(b, &name, g, dt_s, told, error)]));
    }
    let base = b.node(&name("base"), Op::Polynomial { terms });
    let by_integral = match gains {
        Some((_, ki)) => term(dt_s, &[ki, error]),
        None => term(g.ki * dt_s, &[error]),
    };
    let raw = b.node(
        &name("integral_raw"),
        Op::Polynomial { terms: vec![term(1.0, &[last_integral]), by_integral] },
    );
    let sum = b.node(&name("sum"), Op::Polynomial { terms: vec![term(1.0, &[base]), term(1.0, &[raw])] });
    let mut held = sum;
    if let Some(rate) = l.limits.rate_per_s {
        let step = b.node(&name("move"), Op::Difference { a: sum, b: last_output });
        let most = rate * dt_s;
        let step = b.node(&name("move_held"), Op::Clamp { of: step, lower: -most, upper: most });
        let terms = vec![term(1.0, &[last_output]), term(1.0, &[step])];
        held = b.node(&name("rated"), Op::Polynomial { terms });
    }
    let limited = b.node(&name("limited"), Op::Clamp { of: held, lower, upper });
    // What the limits took off is taken off the integral: nothing winds up.
    let cut = b.node(&name("cut"), Op::Difference { a: limited, b: sum });
    let whole =
        b.node(&name("integral_whole"), Op::Polynomial { terms: vec![term(1.0, &[raw]), term(1.0, &[cut])] });
    let integral = chosen(b, &name("integral"), told, whole, last_integral);
    let output = chosen(b, &name("output"), told, limited, last_output);
    point(b, last_integral, integral);
    point(b, last_output, output);
    for node in model.into_iter().flatten() {
        point(b, node, output);
    }
    b.output(&l.input, &l.input_unit, output);
}

/// The filtered derivative of the error; of the first sample there is none.
fn derivative(
    b: &mut Build,
    name: &dyn Fn(&str) -> String,
    g: &PidGains,
    dt_s: f64,
    told: NodeId,
    error: NodeId,
) -> NodeId {
    let later = |b: &mut Build, what: &str| {
        b.node(&name(what), Op::Delay { of: 0, samples: 1, start: Start::Value(0.0) })
    };
    let (before, seen, last) = (later(b, "error_1"), later(b, "error_seen_1"), later(b, "derivative_1"));
    // Whether there was an error before.
    let terms = vec![term(1.0, &[seen]), term(1.0, &[told]), term(-1.0, &[seen, told])];
    let ever = b.node(&name("error_seen"), Op::Polynomial { terms });
    let terms = vec![term(1.0, &[seen, error]), term(-1.0, &[seen, before])];
    let change = b.node(&name("error_change"), Op::Polynomial { terms });
    let whole = g.filter_s + dt_s;
    let own = vec![term(g.filter_s / whole, &[last]), term(g.kd / whole, &[change])];
    let own = b.node(&name("derivative"), Op::Polynomial { terms: own });
    let kept = chosen(b, &name("derivative_kept"), told, own, last);
    let held = chosen(b, &name("error_kept"), told, error, before);
    for (past, now) in [(before, held), (seen, ever), (last, kept)] {
        point(b, past, now);
    }
    own
}

/// 1 where x is a finite number, else 0.
pub(super) fn number(b: &mut Build, name: &str, x: NodeId) -> NodeId {
    let one = b.node(&format!("{name}_one"), Op::Scale { of: x, gain: 0.0, offset: 1.0 });
    b.node(name, Op::Clamp { of: one, lower: 0.0, upper: 1.0 })
}

/// x, and 0 where it is no number.
fn finite(b: &mut Build, name: &str, x: NodeId) -> NodeId {
    let positive = b.node(&format!("{name}_above"), Op::Clamp { of: x, lower: 0.0, upper: MOST });
    let less = b.node(&format!("{name}_less"), Op::Scale { of: x, gain: -1.0, offset: 0.0 });
    let negative = b.node(&format!("{name}_below"), Op::Clamp { of: less, lower: 0.0, upper: MOST });
    b.node(name, Op::Difference { a: positive, b: negative })
}

/// Largest error that is one: what single precision holds with room for gains.
const MOST: f64 = 1e20;

/// `yes` where `told` is 1, `no` where it is 0.
pub(super) fn chosen(b: &mut Build, name: &str, told: NodeId, yes: NodeId, no: NodeId) -> NodeId {
    // Products with 0 and 1 alone: each side is exactly itself.
    let not = b.node(&format!("{name}_not"), Op::Scale { of: told, gain: -1.0, offset: 1.0 });
    b.node(name, Op::Polynomial { terms: vec![term(1.0, &[told, yes]), term(1.0, &[not, no])] })
}

/// Turns a delay to the node whose past it reads.
pub(super) fn point(b: &mut Build, delay: NodeId, to: NodeId) {
    if let Op::Delay { of, .. } = &mut b.program.nodes[delay].op {
        *of = to;
    }
}

/// A node `samples` earlier.
fn past(b: &mut Build, name: &dyn Fn(&str) -> String, of: NodeId, samples: usize) -> NodeId {
    b.node(&name(&format!("model_late_{samples}")), Op::Delay { of, samples, start: Start::Value(0.0) })
}

/// The model a transport ago that goes with one over a flow: samples d = delay nominal / flow, read on the line between two of them,
/// `sum_k max(0, 1 - |d - k|) m(t - k)`.
fn by_flow(
    b: &mut Build,
    name: &dyn Fn(&str) -> String,
    p: &PredictedModel,
    f: &TransportFlow,
    model: NodeId,
) -> NodeId {
    let flow = b.input(&name(&f.channel), &f.unit, f.nominal, None);
    // No flow, or one that is no number, is the longest delay; no flow is so large that there is none.
    let (lower, upper) = (p.least_flow(f), 1e9 * f.nominal);
    let held = b.node(&name("flow_held"), Op::Clamp { of: flow, lower, upper });
    let delay =
        b.node(&name("delay_samples"), Op::Reciprocal { of: held, numerator: p.delay_samples * f.nominal });
    let mut terms = Vec::new();
    for k in 0..=p.longest_samples {
        let away =
            b.node(&name(&format!("away_{k}")), Op::Scale { of: delay, gain: 1.0, offset: -(k as f64) });
        let size = b.node(&name(&format!("size_{k}")), Op::Function { of: away, shape: Shape::Abs });
        let near = b.node(&name(&format!("near_{k}")), Op::Scale { of: size, gain: -1.0, offset: 1.0 });
        let share = b.node(&name(&format!("share_{k}")), Op::Function { of: near, shape: Shape::Relu });
        let value = if k == 0 { model } else { past(b, name, model, k) };
        terms.push(term(1.0, &[share, value]));
    }
    b.node(&name("model_late"), Op::Polynomial { terms })
}

/// Error over the undelayed model with what it does not know, and the delays of the actuator that are to be turned to it.
fn predicted(
    b: &mut Build,
    name: &dyn Fn(&str) -> String,
    p: &PredictedModel,
    demand: NodeId,
    measured: NodeId,
    dt_s: f64,
    start: f64,
) -> (NodeId, Option<Vec<NodeId>>) {
    let first = p.model.den[0];
    let mut waiting = Vec::new();
    let mut terms = Vec::new();
    let mut offset = 0.0;
    for (k, v) in p.model.num.iter().enumerate().skip(1).filter(|(_, v)| **v != 0.0) {
        let op = Op::Delay { of: 0, samples: k, start: Start::Value(start) };
        let node = b.node(&name(&format!("actuator_{k}")), op);
        waiting.push(node);
        terms.push(term(v / first, &[node]));
        offset -= v / first * start;
    }
    if offset != 0.0 {
        terms.push(term(offset, &[]));
    }
    let mut own = Vec::new();
    for (k, v) in p.model.den.iter().enumerate().skip(1).filter(|(_, v)| **v != 0.0) {
        let op = Op::Delay { of: 0, samples: k, start: Start::Value(0.0) };
        let node = b.node(&name(&format!("model_{k}")), op);
        own.push(node);
        terms.push(term(-v / first, &[node]));
    }
    let model = b.node(&name("model"), Op::Polynomial { terms });
    own.iter().for_each(|n| point(b, *n, model));
    let late = match &p.flow {
        Some(f) => by_flow(b, name, p, f, model),
        None if p.delay_samples == 0.0 => model,
        None => past(b, name, model, p.delay_samples as usize),
    };
    let unknown = b.node(&name("unknown_raw"), Op::Difference { a: measured, b: late });
    // A measurement that is no number leaves the correction what it was.
    let told = number(b, &name("measured_is"), unknown);
    let unknown = finite(b, &name("unknown"), unknown);
    let correction = if p.filter_s > 0.0 {
        let share = -(-dt_s / p.filter_s).exp_m1();
        let op = Op::Delay { of: 0, samples: 1, start: Start::Value(0.0) };
        let last = b.node(&name("correction_1"), op);
        let terms = vec![term(1.0 - share, &[last]), term(share, &[unknown])];
        let whole = b.node(&name("correction_whole"), Op::Polynomial { terms });
        let node = chosen(b, &name("correction"), told, whole, last);
        point(b, last, node);
        node
    } else {
        let op = Op::Delay { of: 0, samples: 1, start: Start::Value(0.0) };
        let last = b.node(&name("correction_1"), op);
        let node = chosen(b, &name("correction"), told, unknown, last);
        point(b, last, node);
        node
    };
    let terms = vec![term(1.0, &[demand]), term(-1.0, &[model]), term(-1.0, &[correction])];
    (b.node(&name("error_raw"), Op::Polynomial { terms }), Some(waiting))
}
