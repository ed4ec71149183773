//! Factors that are functions of an affine combination of lagged channels.
//!
//! ```text
//! g(z(t))^q,   z(t) = c0 + sum_i c_i x_i(t - l_i)
//! ```
//!
//! with numbers c that belong to the structure and are not estimated, so that the model stays linear in its
//! parameters. They carry what powers approximate badly: friction (`tanh` of a velocity that is a difference of two
//! positions), outflow (`sqrt` of a level), limits (`pos`), hysteresis (`abs` of a velocity).

use super::regressor::Source;

/// A function of one variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Shape {
    /// Absolute value.
    Abs,
    /// Cosine.
    Cos,
    /// Exponential.
    Exp,
    /// Positive part, max(z, 0).
    Pos,
    /// Sine.
    Sin,
    /// Square root of the positive part.
    Sqrt,
    /// Hyperbolic tangent.
    Tanh,
}

/// Names in the text form.
pub const SHAPES: &[(&str, Shape)] = &[
    ("abs", Shape::Abs),
    ("cos", Shape::Cos),
    ("exp", Shape::Exp),
    ("pos", Shape::Pos),
    ("sin", Shape::Sin),
    ("sqrt", Shape::Sqrt),
    ("tanh", Shape::Tanh),
];

impl Shape {
    /// Its name in the text form.
    pub fn name(self) -> &'static str {
        SHAPES.iter().find(|(_, s)| *s == self).map_or("", |(n, _)| n)
    }

    /// (g, g', g'') at z. At a kink the derivatives are those from below.
    pub fn derivatives(self, z: f64) -> (f64, f64, f64) {
        match self {
            Shape::Abs => (z.abs(), if z > 0.0 { 1.0 } else { -1.0 }, 0.0),
            Shape::Cos => (z.cos(), -z.sin(), -z.cos()),
            Shape::Exp => (z.exp(), z.exp(), z.exp()),
            Shape::Pos if z > 0.0 => (z, 1.0, 0.0),
            Shape::Sin => (z.sin(), z.cos(), -z.sin()),
            Shape::Sqrt if z > 0.0 => {
                let root = z.sqrt();
                (root, 0.5 / root, -0.25 / (root * z))
            }
            Shape::Pos | Shape::Sqrt => (0.0, 0.0, 0.0),
            Shape::Tanh => {
                let v = z.tanh();
                (v, 1.0 - v * v, -2.0 * v * (1.0 - v * v))
            }
        }
    }

    /// g at z.
    pub fn value(self, z: f64) -> f64 {
        match self {
            Shape::Abs => z.abs(),
            Shape::Cos => z.cos(),
            Shape::Exp => z.exp(),
            Shape::Pos => z.max(0.0),
            Shape::Sin => z.sin(),
            Shape::Sqrt => z.max(0.0).sqrt(),
            Shape::Tanh => z.tanh(),
        }
    }
}

/// A finite number that can be compared and sorted.
#[derive(Clone, Copy, Debug)]
pub struct Real(f64);

impl Real {
    /// The number; `None` when it is not finite.
    pub fn new(value: f64) -> Option<Self> {
        // Both zeros are one.
        value.is_finite().then_some(Self(value + 0.0))
    }

    /// Its value.
    pub fn get(self) -> f64 {
        self.0
    }
}

impl PartialEq for Real {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Real {}

impl PartialOrd for Real {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Real {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// One summand of the argument: `gain * source(t - lag)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Read {
    /// What is read.
    pub source: Source,
    /// Delay in samples; at least 1 for the output.
    pub lag: usize,
    /// Its gain; never zero.
    pub gain: Real,
}

/// A factor `shape(offset + sum of reads)^power`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Function {
    /// The function.
    pub shape: Shape,
    /// Reads, sorted by source and lag, each of them once.
    pub reads: Vec<Read>,
    /// Constant part of the argument.
    pub offset: Real,
    /// Power, at least 1.
    pub power: u32,
}

impl Function {
    /// A function with its reads sorted and merged; `None` when a sum is not finite or nothing is left to read.
    pub fn new(shape: Shape, offset: f64, reads: &[(Source, usize, f64)], power: u32) -> Option<Self> {
        let mut sorted = reads.to_vec();
        sorted.sort_by_key(|r| (r.0, r.1));
        let mut merged: Vec<(Source, usize, f64)> = Vec::with_capacity(sorted.len());
        for (source, lag, gain) in sorted {
            match merged.last_mut() {
                Some(last) if (last.0, last.1) == (source, lag) => last.2 += gain,
                _ => merged.push((source, lag, gain)),
            }
        }
        merged.retain(|r| r.2 != 0.0);
        let reads: Option<Vec<Read>> = merged
            .into_iter()
            .map(|(source, lag, gain)| Some(Read { source, lag, gain: Real::new(gain)? }))
            .collect();
        let reads = reads.filter(|r| !r.is_empty())?;
        Some(Self { shape, reads, offset: Real::new(offset)?, power })
    }

    /// Whether it reads the output.
    pub fn reads_output(&self) -> bool {
        self.reads.iter().any(|r| r.source == Source::Output)
    }

    /// Text form, e.g. `tanh(2000*x(t-1) - 2000*x(t-2))^2`.
    pub fn format(&self, name: impl Fn(Source) -> String) -> String {
        let mut text = format!("{}(", self.shape.name());
        let mut first = true;
        let mut sign = |text: &mut String, value: f64| {
            text.push_str(match (first, value < 0.0) {
                (true, false) => "",
                (true, true) => "-",
                (false, false) => " + ",
                (false, true) => " - ",
            });
            first = false;
        };
        for r in &self.reads {
            let gain = r.gain.get();
            sign(&mut text, gain);
            if gain.abs() != 1.0 {
                text.push_str(&format!("{}*", number(gain.abs())));
            }
            text.push_str(&format!("{}({})", name(r.source), delay(r.lag)));
        }
        let offset = self.offset.get();
        if offset != 0.0 {
            sign(&mut text, offset);
            text.push_str(&number(offset.abs()));
        }
        text.push(')');
        if self.power != 1 {
            text.push_str(&format!("^{}", self.power));
        }
        text
    }
}

/// `t` or `t-lag`.
pub(super) fn delay(lag: usize) -> String {
    if lag == 0 { "t".into() } else { format!("t-{lag}") }
}

/// The shortest digits that give the same number back.
fn number(value: f64) -> String {
    if (1e-4..1e6).contains(&value) { format!("{value}") } else { format!("{value:e}") }
}
