//! A stored model as a program: measured channels, derived channels, offsets and scales, the structure as a free run, and the
//! way back to the user's output.
//!
//! It starts at rest at its nominal point: every input in the middle of what the estimation saw, the output where the model
//! settles there.

use std::path::Path;

use dynocal_export::evaluate::Machine;
use dynocal_export::package::{Package, Provenance, ValidRange};
use dynocal_export::program::{Factor, Layer, NodeId, Op, Shape, Start, Term};
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::narmax::Narmax;
use dynocal_ident::model::neural::{Activation, NeuralNarx};
use dynocal_ident::model::poly::{PolyNarx, Shape as PolyShape, Source};
use dynocal_ident::model::response::form::ResponseForm;
use dynocal_ident::stored::{Pointwise, StoredError, StoredModel};
use dynocal_numerics::interval::Interval;

use super::build::Build;
use super::{ExportJobError, Made};

/// Why a model is no program.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelFault {
    /// It cannot be used sample by sample.
    #[error(transparent)]
    Stored(#[from] StoredError),
    /// A part that the neutral form does not hold.
    #[error("the model of `{output}`: {reason}")]
    Unfit {
        /// Output.
        output: String,
        /// What, and what can.
        reason: String,
    },
}

impl ModelFault {
    pub(super) fn at(self, path: &Path) -> ExportJobError {
        match self {
            Self::Stored(source) => ExportJobError::Model { path: path.display().to_string(), source },
            unfit => ExportJobError::source(path, unfit.to_string()),
        }
    }
}

/// A structure that becomes nodes.
enum Structure {
    Polynomial(PolyNarx, Vec<f64>),
    Neural(NeuralNarx, Vec<f64>),
    Response(ResponseForm),
}

/// The model as a package.
///
/// # Errors
/// `ModelFault`: nothing drives it, its preparation does not act sample by sample, a kind or a derived output that the
/// neutral form does not hold.
pub fn model(stored: &StoredModel) -> Result<Made, ModelFault> {
    stored.check()?;
    let pointwise = stored.pointwise()?;
    let structure = structure(stored)?;
    let mut growing = Growing::new(stored, &pointwise);
    let node = match &structure {
        Structure::Polynomial(m, theta) => growing.polynomial(m, theta),
        Structure::Neural(m, theta) => growing.neural(m, theta),
        Structure::Response(m) => growing.response(m)?,
    };
    growing.feed_back(node);
    growing.user_output(node)?;
    let user = stored.user_output();
    let validity = stored.seen.iter().map(|s| ValidRange {
        channel: s.name.clone(),
        unit: s.unit.clone(),
        lower: s.minimum,
        upper: s.maximum,
    });
    let mut package = Package {
        name: format!("{}_model", dynocal_export::characteristic::identifier(&user.name)),
        description: if stored.is_steady() {
            format!("Steady model of {} from its present inputs", user.name)
        } else {
            format!("Model of {} as a free run", user.name)
        },
        provenance: Provenance { validity: validity.collect(), ..Default::default() },
        program: Some(growing.build.program),
        ..Default::default()
    };
    let mut notes = Vec::new();
    if stored.seen.is_empty() {
        notes.push(format!(
            "model of {}: the ranges of its channels are not known, its inputs start at 0",
            user.name
        ));
    }
    match settled(&package, &pointwise) {
        Some(rest) => start_at(&mut package, rest),
        None => notes.push(format!(
            "model of {}: it does not settle with its inputs in the middle of their ranges and starts from the middle of \
             the measured output",
            user.name
        )),
    }
    Ok(Made { package, notes })
}

/// What the inputs drive.
fn structure(stored: &StoredModel) -> Result<Structure, ModelFault> {
    let (form, theta) = (stored.structure.form(), stored.theta());
    let not_driven = || StoredError::NotDriven { output: stored.output.name.clone() };
    if let Some(m) = form.is_a::<PolyNarx>() {
        return Ok(Structure::Polynomial(m.clone(), theta));
    }
    if let Some(m) = form.is_a::<NeuralNarx>() {
        return Ok(Structure::Neural(m.clone(), theta));
    }
    if let Some(m) = form.is_a::<ResponseForm>() {
        return Ok(Structure::Response(m.clone()));
    }
    if let Some(m) = form.is_a::<Narmax>() {
        let (m, theta) = m.without_innovations(&theta).map_err(StoredError::from)?.ok_or_else(not_driven)?;
        return Ok(Structure::Polynomial(m, theta));
    }
    if let Some(m) = form.is_a::<LinearModel>() {
        if form.inputs().is_empty() {
            return Err(not_driven().into());
        }
        let (m, theta) = m.deterministic(&theta).map_err(StoredError::from)?;
        return Ok(Structure::Polynomial(m, theta));
    }
    if !form.goes_on_from_outputs() {
        return Err(StoredError::Mean { output: stored.output.name.clone() }.into());
    }
    let (output, found) = (stored.output.name.clone(), form.row().name);
    Err(ModelFault::Unfit { output, reason: format!("found a form `{found}`, which is not exported yet") })
}

/// The program while it grows: nodes of measured channels and of the structure's inputs are made when they are needed.
pub(super) struct Growing<'a> {
    pub(super) stored: &'a StoredModel,
    pointwise: &'a Pointwise,
    pub(super) build: Build,
    channels: Vec<(String, NodeId)>,
    inputs: Vec<Option<NodeId>>,
    delays: Vec<(Source, usize, NodeId)>,
}

/// Stands in delays of the output until its node is known.
const OUTPUT: NodeId = NodeId::MAX;

impl<'a> Growing<'a> {
    fn new(stored: &'a StoredModel, pointwise: &'a Pointwise) -> Self {
        let inputs = vec![None; pointwise.inputs.len()];
        let build = Build::new(stored.sample_time_s);
        Self { stored, pointwise, build, channels: Vec::new(), inputs, delays: Vec::new() }
    }

    /// Middle of what the estimation saw of a measured channel; 0 where that is not known.
    fn nominal(&self, name: &str) -> f64 {
        self.stored.seen.iter().find(|s| s.name == name).map_or(0.0, |s| 0.5 * (s.minimum + s.maximum))
    }

    /// A measured or derived channel.
    fn channel(&mut self, name: &str) -> NodeId {
        if let Some(c) = self.channels.iter().find(|c| c.0 == name) {
            return c.1;
        }
        let stored = self.stored;
        let node = match stored.derived.iter().find(|d| d.name == name) {
            Some(d) => {
                let mut factors = Vec::new();
                for (source, power) in &d.powers {
                    let of = self.channel(source);
                    let node = if *power > 0 {
                        of
                    } else {
                        self.build.node(&format!("one_by_{source}"), Op::Reciprocal { of, numerator: 1.0 })
                    };
                    factors.push(Factor { node, power: power.unsigned_abs() });
                }
                let terms = vec![Term { coefficient: d.factor, factors }];
                self.build.node(name, Op::Polynomial { terms })
            }
            None => {
                let unit = self.stored.measured().into_iter().find(|q| q.name == name).map(|q| q.unit);
                let range = self
                    .stored
                    .seen
                    .iter()
                    .find(|s| s.name == name)
                    .map(|s| Interval::new(s.minimum, s.maximum));
                let start = self.nominal(name);
                self.build.input(name, &unit.unwrap_or_else(|| "-".into()), start, range)
            }
        };
        self.channels.push((name.into(), node));
        node
    }

    /// Input `i` of the structure, in its units.
    fn input(&mut self, i: usize) -> NodeId {
        if let Some(node) = self.inputs[i] {
            return node;
        }
        let (name, affine) = self.pointwise.inputs[i].clone();
        let of = self.channel(&name);
        let plain = (affine.offset, affine.scale) == (0.0, 1.0);
        let op = Op::Scale { of, gain: 1.0 / affine.scale, offset: -affine.offset / affine.scale };
        let node = if plain { of } else { self.build.node(&format!("{name}_prepared"), op) };
        self.inputs[i] = Some(node);
        node
    }

    /// What a regressor reads.
    pub(super) fn read(&mut self, source: Source, lag: usize) -> NodeId {
        if let (Source::Input(i), 0) = (source, lag) {
            return self.input(i);
        }
        if let Some(d) = self.delays.iter().find(|d| d.0 == source && d.1 == lag) {
            return d.2;
        }
        let (of, start, name) = match source {
            Source::Input(i) => {
                let channels: Vec<String> =
                    self.stored.measured_inputs().into_iter().map(|q| q.name).collect();
                let row: Vec<f64> = channels.iter().map(|name| self.nominal(name)).collect();
                let start = self.pointwise.paths(&channels).map_or(0.0, |paths| paths[i].value(&row));
                (self.input(i), start, self.pointwise.inputs[i].0.clone())
            }
            Source::Output => {
                let user = self.nominal(&self.stored.user_output().name);
                (OUTPUT, self.pointwise.from_user(user), self.stored.output.name.clone())
            }
        };
        let start = Start::Value(if start.is_finite() { start } else { 0.0 });
        let node = self.build.node(&format!("{name}_{lag}"), Op::Delay { of, samples: lag, start });
        self.delays.push((source, lag, node));
        node
    }

    fn polynomial(&mut self, m: &PolyNarx, theta: &[f64]) -> NodeId {
        let mut terms = Vec::new();
        for (k, (r, coefficient)) in m.regressors().iter().zip(theta).enumerate() {
            let mut factors: Vec<Factor> = Vec::new();
            for f in r.factors() {
                factors.push(Factor { node: self.read(f.source, f.lag), power: f.power });
            }
            for (i, f) in r.functions().iter().enumerate() {
                let mut sum = vec![Term { coefficient: f.offset.get(), factors: Vec::new() }];
                for x in &f.reads {
                    let factor = Factor { node: self.read(x.source, x.lag), power: 1 };
                    sum.push(Term { coefficient: x.gain.get(), factors: vec![factor] });
                }
                let of = self.build.node(&format!("z_{k}_{i}"), Op::Polynomial { terms: sum });
                let node = self.build.node(&format!("g_{k}_{i}"), Op::Function { of, shape: shape(f.shape) });
                factors.push(Factor { node, power: f.power });
            }
            terms.push(Term { coefficient: *coefficient, factors });
        }
        self.build.node(&format!("{}_computed", m.output()), Op::Polynomial { terms })
    }

    fn neural(&mut self, m: &NeuralNarx, theta: &[f64]) -> NodeId {
        let layout = m.layout();
        let (ranges, own) = m.ranges();
        let mut reads = Vec::new();
        for (i, [first, last]) in layout.input_lags.iter().enumerate() {
            reads.extend((*first..=*last).map(|lag| (Source::Input(i), lag)));
        }
        reads.extend((1..=layout.output_lags).map(|lag| (Source::Output, lag)));
        let mut scaled = Vec::new();
        for (k, (source, lag)) in reads.iter().enumerate() {
            let (centre, half) = centre(if let Source::Input(i) = source { ranges[*i] } else { own });
            let of = self.read(*source, *lag);
            let op = Op::Scale { of, gain: 1.0 / half, offset: -centre / half };
            scaled.push(self.build.node(&format!("z_{k}"), op));
        }
        let (mut layers, mut at, mut width) = (Vec::new(), 0, scaled.len());
        for (l, neurons) in layout.hidden.iter().copied().chain([1]).enumerate() {
            let (weights, offsets) = (at + neurons * width, at + neurons * width + neurons);
            let last = l == layout.hidden.len();
            layers.push(Layer {
                weights: theta[at..weights].to_vec(),
                offsets: theta[weights..offsets].to_vec(),
                activation: if last { Shape::Linear } else { activation(layout.activation) },
            });
            (at, width) = (offsets, neurons);
        }
        let mut of = self.build.node("network", Op::Network { inputs: scaled.clone(), layers });
        if layout.direct {
            let term = |node, coefficient| Term { coefficient, factors: vec![Factor { node, power: 1 }] };
            let direct = scaled.iter().zip(&theta[at..]).map(|(z, d)| term(*z, *d));
            let terms = [term(of, 1.0)].into_iter().chain(direct).collect();
            of = self.build.node("with_direct_path", Op::Polynomial { terms });
        }
        let (centre, half) = centre(own);
        let name = format!("{}_computed", self.stored.output.name);
        self.build.node(&name, Op::Scale { of, gain: half, offset: centre })
    }

    /// Delays of the output read `node`.
    fn feed_back(&mut self, node: NodeId) {
        for n in &mut self.build.program.nodes {
            if let Op::Delay { of, .. } = &mut n.op
                && *of == OUTPUT
            {
                *of = node;
            }
        }
    }

    /// From the structure's output to the user's.
    fn user_output(&mut self, mut node: NodeId) -> Result<(), ModelFault> {
        let (offset, scale) = (self.pointwise.output.offset, self.pointwise.output.scale);
        let user = self.stored.user_output();
        if (offset, scale) != (0.0, 1.0) {
            let op = Op::Scale { of: node, gain: scale, offset };
            node = self.build.node(&format!("{}_restored", self.stored.output.name), op);
        }
        if let Some(t) = self.stored.output_transform() {
            let op = match t.powers.values().next() {
                Some(1) => Op::Scale { of: node, gain: 1.0 / t.factor, offset: 0.0 },
                Some(-1) => Op::Reciprocal { of: node, numerator: t.factor },
                other => {
                    let power = other.copied().unwrap_or(0);
                    let reason = format!(
                        "its output `{}` is the power {power} of `{}`; only 1 and -1 are exported",
                        t.name, user.name
                    );
                    return Err(ModelFault::Unfit { output: self.stored.output.name.clone(), reason });
                }
            };
            node = self.build.node(&format!("{}_back", user.name), op);
        }
        self.build.output(&user.name, &user.unit, node);
        Ok(())
    }
}

/// Centre and half width as the network computes them.
fn centre([lower, upper]: [f64; 2]) -> (f64, f64) {
    (0.5 * (lower + upper), if upper > lower { 0.5 * (upper - lower) } else { 1.0 })
}

fn shape(s: PolyShape) -> Shape {
    match s {
        PolyShape::Abs => Shape::Abs,
        PolyShape::Cos => Shape::Cos,
        PolyShape::Exp => Shape::Exp,
        PolyShape::Pos => Shape::Relu,
        PolyShape::Sin => Shape::Sin,
        PolyShape::Sqrt => Shape::Sqrt,
        PolyShape::Tanh => Shape::Tanh,
    }
}

fn activation(a: Activation) -> Shape {
    match a {
        Activation::Tanh => Shape::Tanh,
        Activation::Sigmoid => Shape::Sigmoid,
        Activation::Relu => Shape::Relu,
        Activation::Softplus => Shape::Softplus,
    }
}

/// Samples within which a model settles or does not.
const LONGEST: usize = 100_000;
/// Samples in a row without a change.
const QUIET: usize = 100;
/// Relative change that the rounding of a sum of kernels may leave for ever: what changes by less in the last half of the samples
/// counts as settled.
const ROUNDING: f64 = 1e-9;

/// The structure's output where the program settles under the start values of its inputs; none where it does not.
fn settled(package: &Package, pointwise: &Pointwise) -> Option<f64> {
    let program = package.program.as_ref()?;
    let inputs: Vec<f64> = program.inputs.iter().map(|i| i.start).collect();
    let mut machine = Machine::<f64>::new(package).ok()?;
    let (mut last, mut quiet, mut near) = (f64::NAN, 0, 0);
    for _ in 0..LONGEST {
        let y = machine.step(&inputs)[0];
        if !y.is_finite() {
            return None;
        }
        let moved = (y - last).abs() / (1.0 + y.abs());
        quiet = if moved <= 1e-13 { quiet + 1 } else { 0 };
        near = if moved <= ROUNDING { near + 1 } else { 0 };
        last = y;
        if quiet == QUIET {
            let rest = pointwise.from_user(y);
            return rest.is_finite().then_some(rest);
        }
    }
    let rest = pointwise.from_user(last);
    (near >= LONGEST / 2 && rest.is_finite()).then_some(rest)
}

/// Starts the delays of the output at `rest`.
fn start_at(package: &mut Package, rest: f64) {
    let Some(program) = &mut package.program else { return };
    // Delays that read a node after themselves are those of the output.
    for (k, node) in program.nodes.iter_mut().enumerate() {
        if let Op::Delay { of, start, .. } = &mut node.op
            && *of > k
        {
            *start = Start::Value(rest);
        }
    }
}
