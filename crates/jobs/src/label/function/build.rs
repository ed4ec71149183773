//! From names to numbers: the graph of a spec.

use std::path::Path;

use dynocal_files::spec::Faults;
use dynocal_files::units::normalise;
use dynocal_label::graph::{FittedAxis, Graph, Node, Op};
use dynocal_label::label::{Axis, Label};

use super::axes::{self, Wanted};
use super::outside;
use super::spec::{AxisKeys, LabelKeys, NodeKeys, Placed, Typed};

/// What a node may be, with what it takes.
const OPS: [&str; 20] = [
    "channel",
    "constant",
    "label",
    "inverse",
    "add",
    "subtract",
    "multiply",
    "divide",
    "min",
    "max",
    "clip",
    "delay",
    "delay_flow",
    "lag",
    "integrator",
    "hysteresis",
    "film",
    "switch",
    "scale",
    "model",
];

/// A function with what belongs to it.
pub(super) struct Built {
    pub(super) graph: Graph,
    pub(super) channels: Vec<String>,
    pub(super) units: Vec<Option<String>>,
    pub(super) placed: Vec<Placed>,
    pub(super) fitted: Vec<FittedAxis>,
}

/// The function, and the channels that it reads; files are relative to `folder`; faults are told where there are some.
pub(super) fn graph(t: &Typed, folder: &Path, faults: &mut Faults) -> Option<Built> {
    let mut placed: Vec<Placed> = Vec::new();
    let labels: Vec<Option<Label>> =
        t.labels.iter().enumerate().map(|(k, l)| label(t, l, k, &mut placed, faults)).collect();
    placement(&labels, &placed, faults);
    let mut build = Build {
        nodes: Vec::new(),
        channels: Vec::new(),
        channel_units: Vec::new(),
        units: Vec::new(),
        labels: &t.labels,
        folder,
    };
    let mut good = true;
    if t.nodes.is_empty() {
        faults.push("nodes", "nothing", "one [[nodes]] table or more, the last one the output");
        good = false;
    }
    for (k, n) in t.nodes.iter().enumerate() {
        if t.nodes[..k].iter().any(|o| o.name == n.name) {
            faults.push(&format!("nodes[{k}].name"), format!("`{}` again", n.name), "a name of its own");
            good = false;
        }
        if build.node(n, &format!("nodes[{k}]"), faults).is_none() {
            good = false;
            // Nodes that use it have no fault of their own.
            build.push(&n.name, Op::Constant(0.0));
        }
        build.unit(n, &format!("nodes[{k}]"), &labels, faults);
    }
    let labels: Option<Vec<Label>> = labels.into_iter().collect();
    let labels = labels?;
    let graph = Graph { nodes: build.nodes, labels };
    if !good {
        return None;
    }
    let (graph, fitted) = axes::fitted(graph, &wanted(t), &placed, faults);
    Some(Built { graph, channels: build.channels, units: build.channel_units, placed, fitted })
}

/// An axis as it is written, or the shared one that it names.
fn axis(
    t: &Typed,
    a: &AxisKeys,
    key: &str,
    at: (usize, usize),
    placed: &mut Vec<Placed>,
    faults: &mut Faults,
) -> Option<Axis> {
    let (unit, points, place, moves, shared) = match &a.points {
        Some(points) => (a.unit.clone().unwrap_or_else(|| "-".into()), points, a.place, a.moves, false),
        None => {
            let Some(own) = t.axes.iter().find(|s| s.name == a.name) else {
                let known: Vec<String> = t.axes.iter().map(|s| s.name.clone()).collect();
                faults.unknown(&format!("{key}.name"), &a.name, &known);
                return None;
            };
            if let Some(place) = a.place {
                faults.push(&format!("{key}.place"), place, "`place` beside the points of the shared axis");
            }
            if a.fit {
                faults.push(&format!("{key}.fit"), "true", "`fit` beside the points of the shared axis");
            }
            (own.unit.clone(), &own.points, own.place, own.moves, true)
        }
    };
    if let Some(count) = place {
        if !(2..=points.len()).contains(&count) {
            faults.push(&format!("{key}.place"), count, format!("a number from 2 to {}", points.len()));
            return None;
        }
        match placed.iter_mut().find(|p| p.name == a.name) {
            Some(p) if shared => p.of.push(at),
            Some(_) => {
                let wanted = "a name of its own, or an axis of [[axes]] that labels share";
                faults.push(&format!("{key}.name"), format!("`{}`, placed twice", a.name), wanted);
            }
            None => placed.push(Placed { name: a.name.clone(), count, moves, of: vec![at] }),
        }
    }
    if place.is_none() && moves {
        faults.push(&format!("{key}.move"), "true", "`place` beside it: how many breakpoints there are");
    }
    let mut axis = Axis::new(&a.name, &unit, points);
    axis.smooth = a.smooth.unwrap_or(1.0);
    axis.gradient =
        [a.least_gradient.unwrap_or(f64::NEG_INFINITY), a.greatest_gradient.unwrap_or(f64::INFINITY)];
    axis.convex = a.convex;
    Some(axis)
}

/// Axes of which the spec says `fit = true`, with the labels on them.
fn wanted(t: &Typed) -> Vec<Wanted> {
    let mut out: Vec<Wanted> = Vec::new();
    for (l, label) in t.labels.iter().enumerate() {
        for (k, a) in label.axes.iter().enumerate() {
            let shared = t.axes.iter().position(|s| a.points.is_none() && s.name == a.name);
            let key = match shared {
                Some(s) if t.axes[s].fit => format!("axes[{s}].fit"),
                None if a.fit => format!("labels[{l}].axes[{k}].fit"),
                _ => continue,
            };
            match out.iter_mut().find(|w| shared.is_some() && w.key == key) {
                Some(w) => w.of.push((l, k)),
                None => out.push(Wanted { name: a.name.clone(), key, of: vec![(l, k)] }),
            }
        }
    }
    out
}

/// Axes that are placed: labels on one of them span two axes in all, which is what is searched in turns.
fn placement(labels: &[Option<Label>], placed: &[Placed], faults: &mut Faults) {
    for p in placed {
        let mut others: Vec<&str> = Vec::new();
        for (l, k) in &p.of {
            let Some(label) = &labels[*l] else { continue };
            for (_, a) in label.axes.iter().enumerate().filter(|(i, _)| i != k) {
                if !others.contains(&a.name.as_str()) {
                    others.push(&a.name);
                }
            }
        }
        if others.len() > 1 {
            faults.push(
                "axes",
                format!("`{}` is placed for labels that also have {}", p.name, others.join(", ")),
                "labels with one other axis at most, the same for all",
            );
        }
    }
}

fn label(
    t: &Typed,
    l: &LabelKeys,
    number: usize,
    placed: &mut Vec<Placed>,
    faults: &mut Faults,
) -> Option<Label> {
    let key = format!("labels[{number}]");
    let axes: Option<Vec<Axis>> = l
        .axes
        .iter()
        .enumerate()
        .map(|(k, a)| axis(t, a, &format!("{key}.axes[{k}]"), (number, k), placed, faults))
        .collect();
    let axes = axes?;
    let cells: usize = axes.iter().map(|a| a.points.len()).product();
    let base = if l.base.len() == 1 { vec![l.base[0]; cells] } else { l.base.clone() };
    let mut out = Label::new(&l.name, &l.unit, axes, &base);
    out.lower = l.least.unwrap_or(f64::NEG_INFINITY);
    out.upper = l.greatest.unwrap_or(f64::INFINITY);
    if let (Some(least), Some(greatest)) = (l.least, l.greatest) {
        if least >= greatest {
            let expected = "a value below `greatest`; cells that are known are `locked`";
            faults.push(&format!("{key}.least"), least, expected);
            return None;
        }
        if let Some(step) = l.step.filter(|step| *step > greatest - least) {
            faults.push(&format!("{key}.step"), step, format!("a step within {least} to {greatest}"));
            return None;
        }
    }
    out.step = l.step;
    out.base_weight = l.base_weight;
    for &cell in &l.locked {
        match out.locked.get_mut(cell) {
            Some(locked) => *locked = true,
            None => {
                faults.push(
                    &format!("{key}.locked"),
                    cell,
                    format!("numbers of cells from 0 to {}", base.len().max(1) - 1),
                );
                return None;
            }
        }
    }
    match out.check() {
        Ok(()) => Some(out),
        Err(e) => {
            faults.push(&key, "a label that contradicts itself", e);
            None
        }
    }
}

struct Build<'a> {
    nodes: Vec<Node>,
    channels: Vec<String>,
    /// Unit of each channel, where the spec says one.
    channel_units: Vec<Option<String>>,
    /// Unit of each node, where it is known.
    units: Vec<Option<String>>,
    labels: &'a [LabelKeys],
    /// Folder that files are relative to.
    folder: &'a Path,
}

impl Build<'_> {
    fn node(&mut self, n: &NodeKeys, key: &str, faults: &mut Faults) -> Option<()> {
        let known: Vec<String> = self.nodes.iter().map(|o| o.name.clone()).collect();
        let mut inputs = Vec::new();
        for name in &n.inputs {
            // The last node of a name: a node of more than one step has it at its end.
            match known.iter().rposition(|k| k == name) {
                Some(i) => inputs.push(i),
                None => {
                    faults.unknown(&format!("{key}.in"), name, &known);
                    return None;
                }
            }
        }
        let count = |wanted: usize, what: &str, faults: &mut Faults| -> Option<()> {
            if inputs.len() == wanted {
                return Some(());
            }
            faults.push(&format!("{key}.in"), format!("{} nodes", inputs.len()), format!("{wanted}: {what}"));
            None
        };
        let pair = |faults: &mut Faults, what: &str| -> Option<(usize, usize)> {
            count(2, what, faults)?;
            Some((inputs[0], inputs[1]))
        };
        let triple = |faults: &mut Faults, what: &str| -> Option<(usize, usize, usize)> {
            count(3, what, faults)?;
            Some((inputs[0], inputs[1], inputs[2]))
        };
        let op = match n.op.as_str() {
            "channel" => {
                let name = faults.required(&format!("{key}.channel"), &n.channel, "the name of a channel")?;
                let at = self.channels.iter().position(|c| *c == name).unwrap_or_else(|| {
                    self.channels.push(name.clone());
                    self.channel_units.push(n.unit.as_deref().map(normalise));
                    self.channels.len() - 1
                });
                Op::Channel(at)
            }
            "constant" => Op::Constant(faults.required(&format!("{key}.value"), &n.value, "a number")?),
            "scale" => {
                count(1, "what is multiplied with `value`", faults)?;
                let value = faults.required(&format!("{key}.value"), &n.value, "a number")?;
                let factor = self.push(&n.name, Op::Constant(value));
                Op::Multiply(vec![inputs[0], factor])
            }
            "label" => Op::Label(self.named(n, key, faults)?, inputs),
            "inverse" => {
                let label = self.named(n, key, faults)?;
                count(1, "the value of the curve", faults)?;
                Op::Inverse(label, inputs[0])
            }
            "add" => Op::Add(inputs),
            "multiply" => Op::Multiply(inputs),
            "subtract" => pair(faults, "first less second").map(|(a, b)| Op::Subtract(a, b))?,
            "divide" => pair(faults, "first over second").map(|(a, b)| Op::Divide(a, b))?,
            "min" => pair(faults, "the lesser of two").map(|(a, b)| Op::Min(a, b))?,
            "max" => pair(faults, "the greater of two").map(|(a, b)| Op::Max(a, b))?,
            "delay" => pair(faults, "what is delayed, the delay in s").map(|(a, b)| Op::Delay(a, b))?,
            "lag" => pair(faults, "what lags, the time constant in s").map(|(a, b)| Op::Lag(a, b))?,
            "delay_flow" => {
                triple(faults, "what moves, the flow, the volume").map(|(a, b, c)| Op::DelayFlow(a, b, c))?
            }
            "film" => triple(faults, "fuel, share on the wall, time constant in s")
                .map(|(a, b, c)| Op::Film(a, b, c))?,
            "switch" => {
                triple(faults, "condition, value above 0, value else").map(|(a, b, c)| Op::Switch(a, b, c))?
            }
            "clip" => {
                count(1, "what is limited", faults)?;
                let least = faults.required(&format!("{key}.least"), &n.least, "a number")?;
                let greatest = faults.required(&format!("{key}.greatest"), &n.greatest, "a number")?;
                if !(least <= greatest) {
                    faults.push(&format!("{key}.least"), least, "a value not above `greatest`");
                    return None;
                }
                let (lo, hi) =
                    (self.push(&n.name, Op::Constant(least)), self.push(&n.name, Op::Constant(greatest)));
                let above = self.push(&n.name, Op::Max(inputs[0], lo));
                Op::Min(above, hi)
            }
            "integrator" => {
                count(1, "what is integrated", faults)?;
                let (lo, hi) = (n.least.unwrap_or(f64::NEG_INFINITY), n.greatest.unwrap_or(f64::INFINITY));
                Op::Integrator(inputs[0], lo, hi, n.start.unwrap_or(0.0))
            }
            "hysteresis" => {
                count(1, "what switches", faults)?;
                let low =
                    faults.required(&format!("{key}.least"), &n.least, "the value below which it is 0")?;
                let high = faults.required(
                    &format!("{key}.greatest"),
                    &n.greatest,
                    "the value above which it is 1",
                )?;
                Op::Hysteresis(inputs[0], low, high)
            }
            "model" => {
                let file = faults.required(
                    &format!("{key}.file"),
                    &n.file,
                    "the path of a stored model or an FMU",
                )?;
                match outside::read(&self.folder.join(file), n.output.as_deref()) {
                    Ok(model) => {
                        let names: Vec<&str> = model.inputs.iter().map(|i| i.0.as_str()).collect();
                        count(names.len(), &names.join(", "), faults)?;
                        Op::Model(model, inputs)
                    }
                    Err((found, expected)) => {
                        faults.push(&format!("{key}.file"), found, expected);
                        return None;
                    }
                }
            }
            other => {
                faults.unknown(&format!("{key}.op"), other, &OPS.map(String::from));
                return None;
            }
        };
        self.push(&n.name, op);
        Some(())
    }

    /// Number of the label that a node names.
    fn named(&self, n: &NodeKeys, key: &str, faults: &mut Faults) -> Option<usize> {
        let name = faults.required(&format!("{key}.label"), &n.label, "the name of a label")?;
        let known: Vec<String> = self.labels.iter().map(|l| l.name.clone()).collect();
        let at = known.iter().position(|l| *l == name);
        if at.is_none() {
            faults.unknown(&format!("{key}.label"), &name, &known);
        }
        at
    }

    /// The unit of the node that was built last: said by the spec or the label, or kept from what enters; what is added, chosen or
    /// looked up must agree.
    fn unit(&mut self, n: &NodeKeys, key: &str, labels: &[Option<Label>], faults: &mut Faults) {
        // A node of the spec may be several of the graph; the inputs of each are known.
        while self.units.len() < self.nodes.len() {
            let known = self.units.len();
            let op = self.nodes[known].op.clone();
            let of = |i: usize| self.units.get(i).cloned().flatten();
            let found = match &op {
                Op::Label(l, at) => {
                    let Some(label) = labels.get(*l).and_then(Option::as_ref) else {
                        self.units.push(None);
                        continue;
                    };
                    for (i, a) in at.iter().zip(&label.axes) {
                        if let Some(unit) = of(*i).filter(|u| *u != normalise(&a.unit)) {
                            let wanted = format!(
                                "`{}`, the unit of the axis `{}` of `{}`",
                                a.unit, a.name, label.name
                            );
                            faults.push(&format!("{key}.in"), format!("a node in `{unit}`"), wanted);
                        }
                    }
                    Some(normalise(&label.unit))
                }
                Op::Inverse(l, a) => {
                    let Some(label) = labels.get(*l).and_then(Option::as_ref) else {
                        self.units.push(None);
                        continue;
                    };
                    if let Some(unit) = of(*a).filter(|u| *u != normalise(&label.unit)) {
                        let wanted = format!("`{}`, the unit of `{}`", label.unit, label.name);
                        faults.push(&format!("{key}.in"), format!("a node in `{unit}`"), wanted);
                    }
                    label.axes.first().map(|a| normalise(&a.unit))
                }
                Op::Add(_) | Op::Subtract(..) | Op::Min(..) | Op::Max(..) => {
                    let units: Vec<String> = op.inputs().into_iter().filter_map(of).collect();
                    if let Some(other) = units.iter().find(|u| **u != units[0]) {
                        faults.push(
                            &format!("{key}.in"),
                            format!("nodes in `{}` and `{other}`", units[0]),
                            "nodes in one unit",
                        );
                    }
                    units.first().cloned()
                }
                Op::Model(model, at) => {
                    for (i, (name, wanted)) in at.iter().zip(&model.inputs) {
                        if let Some(unit) = of(*i).filter(|u| *u != normalise(wanted)) {
                            let wanted = format!("`{wanted}`, the unit of `{name}` of `{}`", model.name);
                            faults.push(&format!("{key}.in"), format!("a node in `{unit}`"), wanted);
                        }
                    }
                    Some(normalise(&model.unit))
                }
                Op::Delay(a, time) | Op::Lag(a, time) | Op::Film(a, _, time) => {
                    if let Some(unit) = of(*time).filter(|u| u != "s") {
                        let wanted = "a time in `s`: base, limits and axes are not converted";
                        faults.push(&format!("{key}.in"), format!("a time in `{unit}`"), wanted);
                    }
                    of(*a)
                }
                Op::Switch(_, a, b) => of(*a).or_else(|| of(*b)),
                Op::DelayFlow(a, ..) => of(*a),
                _ => None,
            };
            let last = known + 1 == self.nodes.len();
            let said = n.unit.as_deref().filter(|_| last).map(normalise);
            if let (Some(said), Some(found)) = (&said, &found)
                && said != found
            {
                faults.push(
                    &format!("{key}.unit"),
                    format!("`{said}`"),
                    format!("`{found}`, which is what it gives"),
                );
            }
            self.units.push(said.or(found));
        }
    }

    fn push(&mut self, name: &str, op: Op) -> usize {
        self.nodes.push(Node { name: name.into(), op });
        self.nodes.len() - 1
    }
}
