//! Stored models sample by sample: for designs, optimisation and control, which have signals and no records.
//!
//! ```text
//! u_i = (d_i - offset_i) / scale_i,      d_i a measured or derived channel        y = offset + scale f(u, y)
//! ```

use super::{Path, StoredError, StoredModel};
use crate::data::Dataset;
use crate::derived::{Derived, Monomial};
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
    /// Inputs of the structure as functions of rows of `channels`; the name of the first one that is missing as an error.
    ///
    /// # Errors
    /// That name.
    pub fn paths(&self, channels: &[String]) -> Result<Vec<Path>, String> {
        let path = |(name, affine): &(String, Affine)| {
            Path::new(Monomial::of(name, &self.derived), *affine, channels)
        };
        self.inputs.iter().map(path).collect()
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
}
