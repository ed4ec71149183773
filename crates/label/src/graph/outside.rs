//! A node that is no graph: a stored model, an FMU, anything that answers inputs over a whole record.

use std::fmt::Debug;
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

/// Step of the differences, as a share of the size of what enters: a unit may compute in single precision.
const STEP: f64 = 1e-4;

/// What answers.
pub trait Response: Send + Sync + Debug {
    /// Its output at each of the stamps in s; `inputs` have one value at each of them.
    ///
    /// # Errors
    /// Why it has no answer, in words.
    fn values(&self, time_s: &[f64], inputs: &[&[f64]]) -> Result<Vec<f64>, String>;
}

/// A response with its name and units.
#[derive(Clone, Debug)]
pub struct Outside {
    /// Name, for messages and summaries.
    pub name: String,
    /// Names and units of what enters, in their order.
    pub inputs: Vec<(String, String)>,
    /// Unit of what it gives.
    pub unit: String,
    /// What answers.
    pub response: Arc<dyn Response>,
}

impl PartialEq for Outside {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name && Arc::ptr_eq(&self.response, &other.response)
    }
}

impl Serialize for Outside {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(&self.name)
    }
}

impl<'de> Deserialize<'de> for Outside {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        let name = String::deserialize(d)?;
        Err(D::Error::custom(format!("the model `{name}` cannot be read back: it is a file of its own")))
    }
}

impl Outside {
    /// What it answers; no numbers where it has no answer.
    pub(super) fn answer(&self, time_s: &[f64], inputs: &[&[f64]]) -> Vec<f64> {
        match self.response.values(time_s, inputs) {
            Ok(y) if y.len() == time_s.len() => y,
            _ => vec![f64::NAN; time_s.len()],
        }
    }

    /// Derivative in the direction `d` of its inputs `x`, by central differences over the whole record:
    /// `(f(x + h d) - f(x - h d)) / 2 h`, h so that no input moves by more than a small share of its size.
    pub(super) fn tangent(&self, time_s: &[f64], x: &[&[f64]], d: &[&[f64]]) -> Vec<f64> {
        let size = |v: &[f64]| v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let each = x.iter().zip(d).filter(|(_, d)| size(d) > 0.0);
        let h = each.fold(f64::INFINITY, |h, (x, d)| {
            let own = if size(x) > 0.0 { size(x) } else { 1.0 };
            h.min(STEP * own / size(d))
        });
        if !h.is_finite() {
            return vec![0.0; time_s.len()];
        }
        let at = |h: f64| {
            let moved: Vec<Vec<f64>> =
                x.iter().zip(d).map(|(x, d)| x.iter().zip(*d).map(|(x, d)| x + h * d).collect()).collect();
            self.answer(time_s, &moved.iter().map(Vec::as_slice).collect::<Vec<_>>())
        };
        at(h).iter().zip(at(-h)).map(|(a, b)| (a - b) / (2.0 * h)).collect()
    }
}
