//! Stored models sample by sample: for designs, optimisation and control, which have signals and no records.
//!
//! ```text
//! u_i = (d_i - offset_i) / scale_i,      d_i a measured or derived channel        y = offset + scale f(u, y)
//! ```

use super::{StoredError, StoredModel};
use crate::data::Dataset;
use crate::derived::Derived;
use crate::prepare::{Effect, Note};

/// Offset and scale of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    /// Subtracted.
    pub offset: f64,
    /// Divided by.
    pub scale: f64,
}

/// The way from measured channels to the inputs of the structure and from its output back, for one sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Pointwise {
    /// Names of the structure's inputs, with offset and scale.
    pub inputs: Vec<(String, Affine)>,
    /// Offset and scale of the structure's output.
    pub output: Affine,
    /// Derived channels.
    derived: Vec<Derived>,
    /// The derived channel that the structure computes, where it can be inverted.
    transform: Option<Derived>,
}

/// Steps that clean or sample a record and leave the meaning of a sample as it is.
const CLEANING: [&str; 5] = ["window", "missing", "hampel", "resample", "decimate"];

impl StoredModel {
    /// The way of a single sample.
    ///
    /// # Errors
    /// [`StoredError::Step`]: the stored preparation has a step that does not act sample by sample (a filter, a delay, a
    /// trend in time, means of single records).
    pub fn pointwise(&self) -> Result<Pointwise, StoredError> {
        for note in &self.preparation {
            let acts =
                note.step == "offset" || note.step == "scale" || CLEANING.contains(&note.step.as_str());
            if !acts {
                return Err(self.not_pointwise(note, "does not act sample by sample"));
            }
        }
        let affine = |name: &str| self.affine(name);
        Ok(Pointwise {
            inputs: self
                .inputs
                .iter()
                .map(|q| Ok((q.name.clone(), affine(&q.name)?)))
                .collect::<Result<_, StoredError>>()?,
            output: affine(&self.output.name)?,
            derived: self.derived.clone(),
            transform: self.output_transform().cloned(),
        })
    }

    fn affine(&self, channel: &str) -> Result<Affine, StoredError> {
        let mut out = Affine { offset: 0.0, scale: 1.0 };
        for note in &self.preparation {
            let mine = note.changes.iter().filter(|c| c.channel.as_deref() == Some(channel));
            let mut effects = mine
                .map(|c| &c.effect)
                .filter(|e| matches!(e, Effect::Subtracted { .. } | Effect::Divided { .. }));
            let Some(first) = effects.next() else { continue };
            if effects.any(|other| other != first) {
                return Err(self.not_pointwise(note, "has a level of its own for each record"));
            }
            match first {
                Effect::Subtracted { slope_per_s, .. } if *slope_per_s != 0.0 => {
                    return Err(self.not_pointwise(note, "subtracts a trend in time"));
                }
                // In units of what is there by now.
                Effect::Subtracted { level, .. } => out.offset += level * out.scale,
                Effect::Divided { by, .. } => out.scale *= by,
                _ => {}
            }
        }
        Ok(out)
    }

    fn not_pointwise(&self, note: &Note, why: &str) -> StoredError {
        StoredError::Step {
            output: self.output.name.clone(),
            message: format!(
                "the step `{}` {why}, so the model can be simulated on records but not used sample by sample (design, optimisation)",
                note.step
            ),
        }
    }
}

impl Pointwise {
    /// Inputs of the structure (m) where `of` says what the measured channels are.
    pub fn row(&self, of: &dyn Fn(&str) -> f64, row: &mut [f64]) {
        for (into, (name, affine)) in row.iter_mut().zip(&self.inputs) {
            *into = (self.channel(name, of) - affine.offset) / affine.scale;
        }
    }

    /// Derivative of input `i` of the structure with respect to a measured channel there.
    pub fn derivative(&self, i: usize, channel: &str, of: &dyn Fn(&str) -> f64) -> f64 {
        let (name, affine) = &self.inputs[i];
        self.slope(name, channel, of) / affine.scale
    }

    /// Inputs of the structure over a record of measured channels, N x m row-major.
    ///
    /// # Errors
    /// [`crate::data::DataError::NoChannel`], or a derived value that is not finite.
    pub fn rows(&self, record: &Dataset) -> Result<Vec<f64>, StoredError> {
        let mut columns = Vec::new();
        let mut d = record.clone();
        for derived in &self.derived {
            let there = |name: &String| d.channels.iter().any(|c| c.name == *name);
            if !there(&derived.name) && derived.powers.keys().all(there) {
                derived.add_to(&mut d, crate::data::Role::Input)?;
            }
        }
        for (name, affine) in &self.inputs {
            columns.push((d.values(name)?, affine));
        }
        let mut rows = Vec::with_capacity(d.len() * columns.len());
        for t in 0..d.len() {
            rows.extend(columns.iter().map(|(v, a)| (v[t] - a.offset) / a.scale));
        }
        Ok(rows)
    }

    /// Channels that are not what was measured: derived, shifted or scaled.
    pub fn changed(&self) -> Vec<String> {
        let plain = Affine { offset: 0.0, scale: 1.0 };
        let own = |(name, affine): &(String, Affine)| {
            (*affine != plain || self.derived.iter().any(|d| d.name == *name)).then(|| name.clone())
        };
        let output = (self.output != plain || self.transform.is_some()).then(|| "the output".to_string());
        self.inputs.iter().filter_map(own).chain(output).collect()
    }

    /// The user's output for a value of the structure's.
    pub fn to_user(&self, value: f64) -> f64 {
        let value = self.output.offset + self.output.scale * value;
        self.transform.as_ref().and_then(|t| t.inverted(value)).unwrap_or(value)
    }

    /// The structure's output for a value of the user's.
    pub fn from_user(&self, value: f64) -> f64 {
        let value = self.transform.as_ref().map_or(value, |t| t.value(|_| value));
        (value - self.output.offset) / self.output.scale
    }

    /// Whether an input of the structure follows from a measured channel.
    pub fn reads(&self, input: &str, measured: &str) -> bool {
        match self.derived.iter().find(|d| d.name == input) {
            Some(d) => d.powers.keys().any(|source| self.reads(source, measured)),
            None => input == measured,
        }
    }

    /// Second derivative of input `i` of the structure with respect to two measured channels there.
    pub fn curvature(&self, i: usize, a: &str, b: &str, of: &dyn Fn(&str) -> f64) -> f64 {
        let (name, affine) = &self.inputs[i];
        self.bend(name, a, b, of) / affine.scale
    }

    /// Whether the user's output is a straight line over the structure's.
    pub fn output_is_affine(&self) -> bool {
        self.transform.as_ref().is_none_or(|t| t.powers.values().all(|p| *p == 1))
    }

    /// First and second derivative of the user's output with respect to the structure's at the value `z`.
    ///
    /// `y = (v/f)^(1/p)`, `v = offset + scale z`: `y' = scale y / (p v)`, `y'' = scale^2 (1 - p) y / (p v)^2`.
    pub fn output_slopes(&self, z: f64) -> (f64, f64) {
        let scale = self.output.scale;
        let Some((t, power)) = self.transform.as_ref().and_then(|t| Some((t, *t.powers.values().next()?)))
        else {
            return (scale, 0.0);
        };
        let v = self.output.offset + scale * z;
        let (y, p) = (t.inverted(v).unwrap_or(v), f64::from(power));
        (scale * y / (p * v), scale * scale * (1.0 - p) * y / (p * v).powi(2))
    }

    fn channel(&self, name: &str, of: &dyn Fn(&str) -> f64) -> f64 {
        match self.derived.iter().find(|d| d.name == name) {
            Some(d) => d.value(|source| self.channel(source, of)),
            None => of(name),
        }
    }

    /// Derivative of a channel with respect to a measured one.
    fn slope(&self, name: &str, measured: &str, of: &dyn Fn(&str) -> f64) -> f64 {
        match self.derived.iter().find(|d| d.name == name) {
            None => f64::from(u8::from(name == measured)),
            Some(d) => {
                let at = |source: &str| self.channel(source, of);
                d.powers.keys().map(|s| d.derivative(s, at) * self.slope(s, measured, of)).sum()
            }
        }
    }

    /// Second derivative of a channel with respect to two measured ones. A monomial of measured channels has
    /// `p_a p_b d/(c_a c_b)` and, on the diagonal, `p (p - 1) d/c^2`.
    fn bend(&self, name: &str, a: &str, b: &str, of: &dyn Fn(&str) -> f64) -> f64 {
        let Some(d) = self.derived.iter().find(|d| d.name == name) else { return 0.0 };
        let at = |source: &str| self.channel(source, of);
        let value = d.value(at);
        let mut sum = 0.0;
        for (s, p) in &d.powers {
            let (x, power) = (at(s), f64::from(*p));
            sum += d.derivative(s, at) * self.bend(s, a, b, of);
            for (r, q) in &d.powers {
                let second = if s == r {
                    power * (power - 1.0) * value / (x * x)
                } else {
                    power * f64::from(*q) * value / (x * at(r))
                };
                sum += second * self.slope(s, a, of) * self.slope(r, b, of);
            }
        }
        sum
    }
}
