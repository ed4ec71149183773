//! Runs a program in `f64` or `f32`, operation by operation as the generated C does, so that both agree to the last bit.

use crate::characteristic::Characteristic;
use crate::error::ExportError;
use crate::package::{Extrapolation, Package};
use crate::program::{Layer, Line, Op, Program, Shape, Start, Tau};

/// Floating-point arithmetic of a target.
pub trait Real: Copy + PartialOrd {
    /// From a number of the package.
    fn from(x: f64) -> Self;
    /// Back.
    fn to(self) -> f64;
    /// Sum.
    fn add(self, o: Self) -> Self;
    /// Difference.
    fn sub(self, o: Self) -> Self;
    /// Product.
    fn mul(self, o: Self) -> Self;
    /// Quotient.
    fn div(self, o: Self) -> Self;
    /// A function of the C library.
    fn call(self, f: fn(f64) -> f64, g: fn(f32) -> f32) -> Self;
}

macro_rules! real {
    ($t:ty, $pick:expr) => {
        impl Real for $t {
            fn from(x: f64) -> Self {
                x as $t
            }
            fn to(self) -> f64 {
                self as f64
            }
            fn add(self, o: Self) -> Self {
                self + o
            }
            fn sub(self, o: Self) -> Self {
                self - o
            }
            fn mul(self, o: Self) -> Self {
                self * o
            }
            fn div(self, o: Self) -> Self {
                self / o
            }
            fn call(self, f: fn(f64) -> f64, g: fn(f32) -> f32) -> Self {
                ($pick)(f, g)(self)
            }
        }
    };
}
real!(f64, |f: fn(f64) -> f64, _: fn(f32) -> f32| f);
real!(f32, |_: fn(f64) -> f64, g: fn(f32) -> f32| g);

/// Interval and fraction of `u` on `points`; clipped, or beyond 0 to 1 where the edges are continued. A NaN takes the
/// first breakpoint.
pub fn prelookup<R: Real>(points: &[f64], u: R, extrapolation: Extrapolation) -> (usize, R) {
    let n = points.len();
    let at = |k: usize| R::from(points[k]);
    let linear = extrapolation == Extrapolation::Linear;
    let fraction = |lo: usize| u.sub(at(lo)).div(at(lo + 1).sub(at(lo)));
    if u >= at(n - 1) {
        (n - 2, if linear { fraction(n - 2) } else { R::from(1.0) })
    } else if u > at(0) {
        let (mut lo, mut hi) = (0, n - 1);
        while hi - lo > 1 {
            let mid = (lo + hi) / 2;
            if u < at(mid) { hi = mid } else { lo = mid }
        }
        (lo, fraction(lo))
    } else if linear && u <= at(0) {
        (0, fraction(0))
    } else {
        (0, R::from(0.0))
    }
}

/// Linear interpolation in a curve or map; the value of a scalar.
pub fn lookup<R: Real>(c: &Characteristic, u: &[R], extrapolation: Extrapolation) -> R {
    let v = |k: usize| R::from(c.values[k]);
    let blend = |a: R, b: R, f: R| a.add(f.mul(b.sub(a)));
    match c.axes.as_slice() {
        [x] => {
            let (i, f) = prelookup(&x.points, u[0], extrapolation);
            blend(v(i), v(i + 1), f)
        }
        [x, y] => {
            let (i, fx) = prelookup(&x.points, u[0], extrapolation);
            let (j, fy) = prelookup(&y.points, u[1], extrapolation);
            let k = j * x.points.len() + i;
            let n = x.points.len();
            let a = blend(v(k), v(k + 1), fx);
            let b = blend(v(k + n), v(k + n + 1), fx);
            blend(a, b, fy)
        }
        _ => v(0),
    }
}

/// x moved into lower to upper; NaN becomes lower.
fn clamp<R: Real>(x: R, lower: R, upper: R) -> R {
    if x > lower { if x < upper { x } else { upper } } else { lower }
}

fn shape<R: Real>(shape: Shape, x: R) -> R {
    let zero = R::from(0.0);
    let one = R::from(1.0);
    let positive = if x > zero { x } else { zero };
    let size = if x < zero { zero.sub(x) } else { x };
    match shape {
        Shape::Linear => x,
        Shape::Tanh => x.call(f64::tanh, f32::tanh),
        Shape::Sigmoid => one.div(one.add(zero.sub(x).call(f64::exp, f32::exp))),
        Shape::Relu => positive,
        Shape::Softplus => positive.add(zero.sub(size).call(f64::exp, f32::exp).call(f64::ln_1p, f32::ln_1p)),
        Shape::Abs => size,
        Shape::Sqrt => positive.call(f64::sqrt, f32::sqrt),
        Shape::Exp => x.call(f64::exp, f32::exp),
        Shape::Asinh => x.call(f64::asinh, f32::asinh),
        Shape::Sin => x.call(f64::sin, f32::sin),
        Shape::Cos => x.call(f64::cos, f32::cos),
        Shape::Matern32 => {
            let a = R::from(3.0).mul(positive).call(f64::sqrt, f32::sqrt);
            one.add(a).mul(zero.sub(a).call(f64::exp, f32::exp))
        }
        Shape::Matern52 => {
            let a = R::from(5.0).mul(positive).call(f64::sqrt, f32::sqrt);
            let near = one.add(a).add(a.mul(a).div(R::from(3.0)));
            near.mul(zero.sub(a).call(f64::exp, f32::exp))
        }
    }
}

fn network<R: Real>(values: Vec<R>, layers: &[Layer]) -> R {
    let out = layers.iter().fold(values, |a, layer| {
        let width = a.len();
        let neuron = |(k, b): (usize, &f64)| {
            let row = &layer.weights[k * width..(k + 1) * width];
            let sum = row.iter().zip(&a).fold(R::from(*b), |s, (w, x)| s.add(R::from(*w).mul(*x)));
            shape(layer.activation, sum)
        };
        layer.offsets.iter().enumerate().map(neuron).collect()
    });
    out.first().copied().unwrap_or(R::from(f64::NAN))
}

/// A program at work: its delay lines and lags.
pub struct Machine<'a, R> {
    package: &'a Package,
    program: &'a Program,
    lines: Vec<Line>,
    history: Vec<Vec<R>>,
    lags: Vec<R>,
    values: Vec<R>,
    started: bool,
}

impl<'a, R: Real> Machine<'a, R> {
    /// At its start.
    ///
    /// # Errors
    /// [`ExportError::Form`] where the package has no program or a faulty one.
    pub fn new(package: &'a Package) -> Result<Self, ExportError> {
        package.check()?;
        let none = || ExportError::form(&package.name, "found no program, expected one");
        let program = package.program.as_ref().ok_or_else(none)?;
        let lines = program.lines();
        let first = |l: &Line| vec![R::from(if let Start::Value(v) = l.start { v } else { 0.0 }); l.length];
        Ok(Self {
            package,
            program,
            history: lines.iter().map(first).collect(),
            lines,
            lags: vec![R::from(0.0); program.lags().len()],
            values: vec![R::from(0.0); program.nodes.len()],
            started: false,
        })
    }

    /// One sample: inputs in their order to outputs in theirs.
    pub fn step(&mut self, inputs: &[R]) -> Vec<R> {
        let dt = R::from(self.program.sample_time_s);
        let mut lag = 0;
        for (k, node) in self.program.nodes.iter().enumerate() {
            let v = &self.values;
            let value = match &node.op {
                Op::Input(i) => inputs[*i],
                Op::Constant(x) => R::from(*x),
                Op::Delay { of, samples, start } => match self.lines.iter().position(|l| l.of == *of) {
                    Some(line) => {
                        if !self.started && *start == Start::First {
                            let first = v[*of];
                            self.history[line].fill(first);
                        }
                        self.history[line][samples - 1]
                    }
                    None => R::from(f64::NAN),
                },
                Op::Scale { of, gain, offset } => R::from(*gain).mul(v[*of]).add(R::from(*offset)),
                Op::Difference { a, b } => v[*a].sub(v[*b]),
                Op::Reciprocal { of, numerator } => R::from(*numerator).div(v[*of]),
                Op::Clamp { of, lower, upper } => clamp(v[*of], R::from(*lower), R::from(*upper)),
                Op::Lag { of, tau } => {
                    let u = v[*of];
                    let gain = lag_gain(self.program.sample_time_s, tau, v, dt);
                    let x = if self.started { self.lags[lag] } else { u };
                    self.lags[lag] = x.add(gain.mul(u.sub(x)));
                    lag += 1;
                    self.lags[lag - 1]
                }
                Op::Polynomial { terms } => terms
                    .iter()
                    .map(|t| {
                        t.factors.iter().fold(R::from(t.coefficient), |p, f| {
                            (0..f.power).fold(p, |p, _| p.mul(v[f.node]))
                        })
                    })
                    .reduce(R::add)
                    .unwrap_or(R::from(0.0)),
                Op::Function { of, shape: s } => shape(*s, v[*of]),
                Op::Network { inputs, layers } => network(inputs.iter().map(|i| v[*i]).collect(), layers),
                Op::Lookup { characteristic, inputs } => {
                    let u: Vec<R> = inputs.iter().map(|i| v[*i]).collect();
                    match self.package.characteristics.iter().find(|c| c.name == *characteristic) {
                        Some(c) => lookup(c, &u, self.package.extrapolation),
                        None => R::from(f64::NAN),
                    }
                }
            };
            self.values[k] = value;
        }
        for (line, history) in self.lines.iter().zip(&mut self.history) {
            history.rotate_right(1);
            history[0] = self.values[line.of];
        }
        self.started = true;
        self.program.outputs.iter().map(|o| self.values[o.node]).collect()
    }
}

/// 1 - exp(-dt/tau); 1 for a time constant that is not positive.
fn lag_gain<R: Real>(sample_time_s: f64, tau: &Tau, v: &[R], dt: R) -> R {
    match tau {
        // Computed once in f64 where the constant is known, as the generator does.
        Tau::Fixed(t) => R::from(fixed_gain(sample_time_s, *t)),
        Tau::Node(n) if v[*n] > R::from(0.0) => {
            let x = R::from(0.0).sub(dt).div(v[*n]);
            R::from(1.0).sub(x.call(f64::exp, f32::exp))
        }
        Tau::Node(_) => R::from(1.0),
    }
}

/// Gain of a lag with a fixed time constant.
pub(crate) fn fixed_gain(sample_time_s: f64, tau_s: f64) -> f64 {
    if tau_s > 0.0 { 1.0 - (-sample_time_s / tau_s).exp() } else { 1.0 }
}
