//! The form in which a structure over named channels is kept, whatever its family: what a file holds, what estimators are
//! given, what computes outputs.
//!
//! A form with its parameters is a [`super::fitted::Fitted`]. Most forms are NARX models ([`super::Model`]); one with a
//! noise model is not, but what its inputs drive is ([`Form::driven`]).

use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::initial::{Initial, free_run};
use super::poly::{PolyNarx, StructureError};
use super::{Kind, Model, kinds, output};
use crate::experiment::Experiment;

/// A form as the tables know it.
#[derive(Debug)]
pub struct FormRow {
    /// Name in files, under `kind`.
    pub name: &'static str,
    /// Whether it is a NARX model, [`Form::dynamics`]: estimators for all of them then fit.
    pub narx: bool,
    /// How a free run starts where nothing else is asked for.
    pub initial: Initial,
    /// Reads what [`Form::text`] wrote.
    pub read: fn(serde_json::Value) -> Result<Arc<dyn Form>, serde_json::Error>,
}

/// The part of a model that its inputs drive, as a NARX model.
#[derive(Clone, Debug)]
pub struct Driven {
    /// Structure.
    pub model: Arc<dyn Model>,
    /// Its parameters.
    pub theta: Vec<f64>,
}

/// A model structure over named channels.
pub trait Form: Any + Debug + Send + Sync {
    /// Its row.
    fn row(&self) -> &'static FormRow;

    /// Names of the inputs, in the order of the columns of `u`.
    fn inputs(&self) -> &[String];

    /// Name of the output.
    fn output(&self) -> &str;

    /// Names of the parameters (p).
    fn parameter_names(&self) -> Vec<String>;

    /// Samples that a record must have before the first one that is scored.
    fn memory(&self) -> usize;

    /// The form as a NARX model; none where its prediction remembers more than lagged inputs and outputs.
    fn dynamics(&self) -> Option<&dyn Model> {
        None
    }

    /// Whether its free run goes on from its last outputs: a mean of several networks has the outputs of each as state. What
    /// steps, linearises or starts from outputs alone must refuse a form that does not.
    fn goes_on_from_outputs(&self) -> bool {
        true
    }

    /// What the inputs drive for parameters `theta` (p): what a free run simulates. None for a time series.
    ///
    /// # Errors
    /// [`StructureError`] where that part cannot be written as a NARX model.
    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError>;

    /// Output on one record (N) as `kind` and `initial` say, `driven` being [`Form::driven`]; samples before
    /// [`Form::memory`] and before the initialising ones are the measured ones unless the run starts at rest. None where
    /// the form has no such output.
    fn computed(
        &self,
        theta: &[f64],
        driven: Option<&Driven>,
        e: &Experiment,
        kind: Kind,
        initial: Initial,
    ) -> Option<Vec<f64>> {
        match (kind, driven) {
            (Kind::FreeRun, Some(d)) => {
                let first = e.init_samples.max(self.memory()).min(e.len());
                Some(free_run(d.model.as_ref(), &d.theta, e, first, initial).y)
            }
            _ => Some(output(self.dynamics()?, theta, e, kind)),
        }
    }

    /// What a file keeps of it, without its name.
    ///
    /// # Errors
    /// Of the serialiser; none for forms of this crate.
    fn text(&self) -> Result<serde_json::Value, serde_json::Error>;
}

impl dyn Form {
    /// The form as a certain one; what is made for that one only asks for it.
    pub fn is_a<T: Form>(&self) -> Option<&T> {
        let any: &dyn Any = self;
        any.downcast_ref()
    }

    /// Number of parameters p.
    pub fn parameters(&self) -> usize {
        self.dynamics().map_or_else(|| self.parameter_names().len(), Model::n_params)
    }

    /// The polynomial NARX structure, where it is one: what follows from the degrees of its regressors needs to see them.
    pub fn polynomial(&self) -> Option<&PolyNarx> {
        self.is_a()
    }
}

/// A form of any family, in a file as `{ "kind": name, .. }`.
#[derive(Clone, Debug)]
pub struct AnyForm(pub Arc<dyn Form>);

impl AnyForm {
    /// The form.
    pub fn form(&self) -> &dyn Form {
        self.0.as_ref()
    }
}

impl<T: Form> From<T> for AnyForm {
    fn from(form: T) -> Self {
        Self(Arc::new(form))
    }
}

impl PartialEq for AnyForm {
    fn eq(&self, other: &Self) -> bool {
        let text = |f: &Self| f.0.text().ok();
        self.0.row().name == other.0.row().name && text(self) == text(other)
    }
}

impl Serialize for AnyForm {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::{Error, SerializeMap};
        let text = self.0.text().map_err(S::Error::custom)?;
        let serde_json::Value::Object(keys) = text else {
            return Err(S::Error::custom(format!("the form `{}` is no table of keys", self.0.row().name)));
        };
        let mut map = serializer.serialize_map(Some(keys.len() + 1))?;
        map.serialize_entry("kind", self.0.row().name)?;
        for (key, value) in &keys {
            map.serialize_entry(key, value)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for AnyForm {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut keys = serde_json::Map::deserialize(deserializer)?;
        let kind = keys.remove("kind").and_then(|v| v.as_str().map(str::to_string));
        let row = kinds::forms().find(|row| kind.as_deref() == Some(row.name));
        let Some(row) = row else {
            let known: Vec<&str> = kinds::forms().map(|row| row.name).collect();
            let found = kind.unwrap_or_else(|| "nothing".into());
            let text = format!("kind: found `{found}`, expected one of {}", known.join(", "));
            return Err(D::Error::custom(text));
        };
        (row.read)(serde_json::Value::Object(keys)).map(Self).map_err(D::Error::custom)
    }
}
