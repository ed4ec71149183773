//! A model with all that is needed to run it again: what `identify` writes, and what design, calibration, simulation and
//! export read.
//!
//! The channels of a record go this way, and the output back again:
//!
//! ```text
//! channels in the user's units -> derived channels -> preparation (offsets, scales, ..) -> structure with parameters
//! ```
//!
//! ```
//! use dynocal_ident::data::{Channel, Dataset, Role};
//! use dynocal_ident::model::initial::Initial;
//! use dynocal_ident::model::poly::PolyNarx;
//! use dynocal_ident::stored::{Quantity, StoredModel};
//!
//! let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
//! let structure = PolyNarx::parse(&["inj"], "torque", &["inj(t-1)", "torque(t-1)"])?;
//! let mut model = StoredModel::new(structure, &[2.0, 0.5], vec![quantity("inj", "mg")], quantity("torque", "Nm"), 0.03)?;
//! model.initial = Some(Initial::Rest);
//!
//! let inj = Channel { name: "inj".into(), unit: "mg".into(), role: Role::Input, values: vec![10.0; 4] };
//! let (name, origin) = ("step".into(), "example".into());
//! let record = Dataset { name, sample_time_s: 0.03, channels: vec![inj], init_samples: 0, origin };
//! assert_eq!(model.simulate(&record, None)?[0].y, [0.0, 20.0, 30.0, 35.0]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod measured;
mod path;
pub mod pieces;
mod pointwise;
mod run;

use serde::{Deserialize, Serialize};

pub use measured::MeasuredModel;
pub use path::Path;
pub use pieces::Pieces;
pub use pointwise::Pointwise;
pub use run::{Computed, Outside};

use crate::data::{DataError, Dataset};
use crate::derived::{Derived, DerivedError};
use crate::model::fitted::Fitted;
use crate::model::form::{AnyForm, Driven};
use crate::model::initial::Initial;
use crate::model::poly::StructureError;
use crate::prepare::{Effect, Note, PrepareError};
use crate::validate;
use crate::validate::boundary::BoundaryModel;

/// Schema name of a model file.
pub const MODEL_SCHEMA: &str = "dynocal/model";
/// Version of the model file. Files of version 2 (without derived channels, ranges, start) are read.
pub const MODEL_VERSION: u32 = 3;
/// Most parameters whose correlations are stored.
pub const MOST_CORRELATED: usize = 100;

/// A channel of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quantity {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
}

/// One estimated parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name that the structure gives it, e.g. the regressor that it multiplies.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard error; absent where the data do not determine the parameter.
    pub std_error: Option<f64>,
}

/// A measured channel as the estimation saw it, in its own unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Least value.
    pub minimum: f64,
    /// Greatest value.
    pub maximum: f64,
}

/// A model with everything that is needed to run it elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredModel {
    /// Kind of model, channels and structure; networks with their scaling.
    pub structure: AnyForm,
    /// Channels that the structure reads, derived ones among them, with their units before the preparation.
    pub inputs: Vec<Quantity>,
    /// Channel that the structure computes.
    pub output: Quantity,
    /// Sample time in s; without meaning for a model of present values alone ([`StoredModel::is_steady`]).
    pub sample_time_s: f64,
    /// Parameters theta with names and standard errors, in the order of the structure.
    pub parameters: Vec<Parameter>,
    /// Correlations of the estimates: below the diagonal, row by row (p (p - 1) / 2); absent where they are not known, or for more
    /// than [`MOST_CORRELATED`] parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correlation: Option<Vec<f64>>,
    /// Estimator.
    pub estimator: String,
    /// Variance of the errors that the estimator made small, in squared units of the prepared output.
    pub noise_variance: Option<f64>,
    /// What of the space of lagged inputs and outputs was identified, in prepared units; absent where it could not be
    /// learnt.
    #[serde(default)]
    pub boundary: Option<BoundaryModel>,
    /// Channels that follow from measured ones, in the order in which they are computed.
    #[serde(default)]
    pub derived: Vec<Derived>,
    /// What was done to the records before the estimate, and is done to others before the model sees them.
    #[serde(default)]
    pub preparation: Vec<Note>,
    /// How a free run starts where nothing else is asked for; absent: as is usual for the kind.
    #[serde(default)]
    pub initial: Option<Initial>,
    /// The measured channels of the estimation; empty where they are not known.
    #[serde(default)]
    pub seen: Vec<Seen>,
    /// Where the data came from.
    pub origin: String,
    /// Digests of those files: a record out of one of them is not unseen.
    #[serde(default)]
    pub files: Vec<String>,
    /// Pieces of the records that it was estimated from: a record that holds them is not unseen. Absent in files that were written
    /// before there were any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estimated_on: Option<Pieces>,
    /// The same of the records that chose between its candidates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selected_on: Option<Pieces>,
}

/// A stored model that cannot be used as asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StoredError {
    /// Structure and parameters do not belong together.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// A record does not fit.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A derived channel cannot be computed.
    #[error(transparent)]
    Derived(#[from] DerivedError),
    /// The stored preparation does not go with a record.
    #[error("the preparation that is stored with the model of `{output}`: {source}")]
    Prepare {
        /// Output of the model.
        output: String,
        /// What is wrong.
        source: PrepareError,
    },
    /// The stored preparation cannot be done.
    #[error("the preparation that is stored with the model of `{output}`: {message}")]
    Step {
        /// Output of the model.
        output: String,
        /// What is wrong.
        message: String,
    },
    /// A parameter has another name than the structure gives it.
    #[error(
        "the model of `{output}`: parameter {place} is called `{found}`, its structure calls it `{expected}`: the parameters belong to another structure"
    )]
    Parameter {
        /// Output of the model.
        output: String,
        /// Place, one-based.
        place: usize,
        /// Name found.
        found: String,
        /// Name expected.
        expected: String,
    },
    /// Channels of the file and of its structure differ.
    #[error("the model of `{output}`: its channels are {found}, those of its structure {expected}")]
    Channels {
        /// Output of the model.
        output: String,
        /// Channels of the file.
        found: String,
        /// Channels of the structure.
        expected: String,
    },
    /// A channel is in another unit.
    #[error("{record}: `{channel}` is in `{found}`, the model of `{output}` takes it in `{expected}`")]
    Unit {
        /// Record.
        record: String,
        /// Channel.
        channel: String,
        /// Its unit.
        found: String,
        /// Unit of the model.
        expected: String,
        /// Output of the model.
        output: String,
    },
    /// A number that cannot be.
    #[error("the model of `{output}`: {what} is {found}, expected {expected}")]
    Number {
        /// Output of the model.
        output: String,
        /// Which number.
        what: String,
        /// Its value.
        found: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// Nothing drives the model.
    #[error("the model of `{output}` has no inputs (a time series): there is nothing to simulate")]
    NotDriven {
        /// Output of the model.
        output: String,
    },
    /// A form with several states where one model is needed.
    #[error(
        "the model of `{output}` is a mean of several networks, each run with its own output: it simulates and predicts, but here \
         one network is needed (estimate it without `mean`)"
    )]
    Mean {
        /// Output of the model.
        output: String,
    },
    /// A start that needs the output.
    #[error(
        "{record}: no channel `{channel}`: without measured outputs the model starts from rest (`initial = \"rest\"`)"
    )]
    NoOutput {
        /// Record.
        record: String,
        /// Output channel.
        channel: String,
    },
}

impl StoredModel {
    /// A model of plain channels without preparation; everything else is set afterwards.
    ///
    /// # Errors
    /// [`StoredError`] as of [`StoredModel::check`].
    pub fn new(
        structure: impl Into<AnyForm>,
        theta: &[f64],
        inputs: Vec<Quantity>,
        output: Quantity,
        sample_time_s: f64,
    ) -> Result<Self, StoredError> {
        let structure = structure.into();
        let names = structure.form().parameter_names();
        if names.len() != theta.len() {
            let (output, inputs) = (output.name, inputs.into_iter().map(|q| q.name).collect());
            let (found, expected) = (theta.len(), names.len());
            return Err(StructureError::Parameters { output, found, expected, inputs }.into());
        }
        let parameter = |(name, value): (String, &f64)| Parameter { name, value: *value, std_error: None };
        let model = Self {
            parameters: names.into_iter().zip(theta).map(parameter).collect(),
            structure,
            inputs,
            output,
            sample_time_s,
            correlation: None,
            estimator: String::new(),
            noise_variance: None,
            boundary: None,
            derived: Vec::new(),
            preparation: Vec::new(),
            initial: None,
            seen: Vec::new(),
            origin: String::new(),
            files: Vec::new(),
            estimated_on: None,
            selected_on: None,
        };
        model.check()?;
        Ok(model)
    }

    /// Checks that structure, parameters, channels and numbers belong together: a file may come from anywhere.
    ///
    /// # Errors
    /// [`StoredError`] naming what does not fit.
    pub fn check(&self) -> Result<(), StoredError> {
        let (form, output) = (self.structure.form(), self.output.name.clone());
        let names = form.parameter_names();
        if names.len() != self.parameters.len() {
            let inputs = self.inputs.iter().map(|q| q.name.clone()).collect();
            let (found, expected) = (self.parameters.len(), names.len());
            return Err(StructureError::Parameters { output, found, expected, inputs }.into());
        }
        if let Some(k) = (0..names.len()).find(|k| names[*k] != self.parameters[*k].name) {
            let (found, expected) = (self.parameters[k].name.clone(), names[k].clone());
            return Err(StoredError::Parameter { output, place: k + 1, found, expected });
        }
        let own: Vec<&str> = self.inputs.iter().map(|q| q.name.as_str()).collect();
        // A time series may stand beside channels that do not drive it.
        let fits =
            form.inputs().is_empty() || own.iter().copied().eq(form.inputs().iter().map(String::as_str));
        if !fits || form.output() != output {
            let found = format!("{} -> {output}", own.join(", "));
            let expected = format!("{} -> {}", form.inputs().join(", "), form.output());
            return Err(StoredError::Channels { output, found, expected });
        }
        let number = |what: &str, found: f64, expected| {
            Err(StoredError::Number { output: output.clone(), what: what.into(), found, expected })
        };
        if let Some(p) = self.parameters.iter().find(|p| !p.value.is_finite()) {
            return number(&format!("parameter `{}`", p.name), p.value, "a finite number");
        }
        if let Some(r) = &self.correlation {
            let expected = self.parameters.len() * self.parameters.len().saturating_sub(1) / 2;
            if r.len() != expected {
                return number("number of correlations", r.len() as f64, "p (p - 1) / 2 for p parameters");
            }
            if let Some(r) = r.iter().find(|r| !(-1.0..=1.0).contains(*r)) {
                return number("correlation", *r, "a number from -1 to 1");
            }
        }
        if !(self.sample_time_s > 0.0 && self.sample_time_s.is_finite()) {
            return number("sample_time_s", self.sample_time_s, "a positive number of seconds");
        }
        let mut known: Vec<String> = self.measured().into_iter().map(|q| q.name).collect();
        for d in &self.derived {
            d.check(&known)?;
            known.push(d.name.clone());
        }
        Ok(())
    }

    /// Parameters theta (p).
    pub fn theta(&self) -> Vec<f64> {
        self.parameters.iter().map(|p| p.value).collect()
    }

    /// Covariance of the parameters (p x p row-major) from standard errors and correlations; zero rows for parameters that the data do not
    /// determine. None where the correlations are not known.
    pub fn covariance(&self) -> Option<Vec<f64>> {
        let correlation = self.correlation.as_ref()?;
        let p = self.parameters.len();
        let deviation = |k: usize| self.parameters[k].std_error.unwrap_or(0.0);
        let mut out = vec![0.0; p * p];
        let mut below = correlation.iter();
        for i in 0..p {
            out[i * p + i] = deviation(i).powi(2);
            for (j, r) in (0..i).zip(&mut below) {
                let c = r * deviation(i) * deviation(j);
                (out[i * p + j], out[j * p + i]) = (c, c);
            }
        }
        Some(out)
    }

    /// Takes over the correlations of a covariance (p x p row-major) where there are not too many parameters.
    pub fn correlate(&mut self, covariance: &[f64]) {
        let p = self.parameters.len();
        if covariance.len() != p * p || p > MOST_CORRELATED {
            return;
        }
        let of = |i: usize, j: usize| {
            let size = (covariance[i * p + i] * covariance[j * p + j]).sqrt();
            if size > 0.0 { (covariance[i * p + j] / size).clamp(-1.0, 1.0) } else { 0.0 }
        };
        self.correlation = Some((0..p).flat_map(|i| (0..i).map(move |j| of(i, j))).collect());
    }

    /// Whether the model reads present values alone: it then goes with records of any sample time, and with tables that have
    /// none.
    pub fn is_steady(&self) -> bool {
        self.structure.form().memory() == 0
    }

    /// How a free run starts where nothing else is asked for.
    pub fn initial(&self) -> Initial {
        self.initial.unwrap_or(self.structure.form().row().initial)
    }

    /// The structure with its parameters, in prepared units.
    ///
    /// # Errors
    /// [`StoredError`] as of [`StoredModel::check`].
    pub fn fitted(&self) -> Result<Fitted, StoredError> {
        self.check()?;
        Ok(Fitted::new(self.structure.clone(), self.theta())?.starting(self.initial()))
    }

    /// What the inputs drive, as a NARX model with its parameters, in prepared units ([`StoredModel::pointwise`] has the way
    /// there and back).
    ///
    /// # Errors
    /// [`StoredError`] as of [`StoredModel::check`]; [`StoredError::NotDriven`] for a time series, [`StoredError::Mean`] for a
    /// mean of several networks, which has more states than its outputs.
    pub fn driven(&self) -> Result<Driven, StoredError> {
        if !self.structure.form().goes_on_from_outputs() {
            return Err(StoredError::Mean { output: self.output.name.clone() });
        }
        let driven = self.fitted()?.driven().cloned();
        driven.ok_or_else(|| StoredError::NotDriven { output: self.output.name.clone() })
    }

    /// The measured channels behind inputs and output, each once, with their units: what a record must have.
    pub fn measured(&self) -> Vec<Quantity> {
        let mut out: Vec<Quantity> = Vec::new();
        for q in self.inputs.iter().chain([&self.output]) {
            self.behind(q, &mut out);
        }
        out
    }

    /// Whether its parameters have seen a record as it was measured, or its choice has: by pieces of it, whatever stands around
    /// them. Pieces too few to be among those that are kept, resampled or converted ones are not recognised.
    pub fn has_seen(&self, record: &Dataset) -> validate::Seen {
        let channels: Vec<String> = self.measured().into_iter().map(|q| q.name).collect();
        let knows =
            |p: &Option<Pieces>| p.as_ref().is_some_and(|p| p.know(record, &channels, self.is_steady()));
        if knows(&self.estimated_on) {
            validate::Seen::Identification
        } else if knows(&self.selected_on) {
            validate::Seen::Selection
        } else {
            validate::Seen::Unseen
        }
    }

    /// The measured channels behind the inputs alone.
    pub fn measured_inputs(&self) -> Vec<Quantity> {
        let mut out = Vec::new();
        self.inputs.iter().for_each(|q| self.behind(q, &mut out));
        out
    }

    /// The channel that the user calls the output: where the model computes a monomial of one channel, that one.
    pub fn user_output(&self) -> Quantity {
        match self.output_transform().and_then(Derived::source) {
            Some(source) => self.quantity(source),
            None => self.output.clone(),
        }
    }

    /// The derived channel that the model computes, where its output is one that can be inverted.
    pub fn output_transform(&self) -> Option<&Derived> {
        self.derived.iter().find(|d| d.name == self.output.name && d.source().is_some())
    }

    fn behind(&self, q: &Quantity, out: &mut Vec<Quantity>) {
        match self.derived.iter().find(|d| d.name == q.name) {
            Some(d) => d.powers.keys().for_each(|name| self.behind(&self.quantity(name), out)),
            None if out.iter().any(|o| o.name == q.name) => {}
            None => out.push(Quantity { name: q.name.clone(), unit: self.own_unit(q) }),
        }
    }

    /// Unit of a channel before the preparation; files of version 2 have that after it.
    fn own_unit(&self, q: &Quantity) -> String {
        let before = self.preparation.iter().flat_map(|n| &n.changes).find_map(|c| match &c.effect {
            Effect::Divided { unit, .. } if c.channel.as_ref() == Some(&q.name) => Some(unit.clone()),
            _ => None,
        });
        before.unwrap_or_else(|| q.unit.clone())
    }

    /// A channel with the unit that is known of it; `-` where none is.
    fn quantity(&self, name: &str) -> Quantity {
        let known = self.inputs.iter().chain([&self.output]).find(|q| q.name == name);
        let seen = || self.seen.iter().find(|s| s.name == name).map(|s| s.unit.clone());
        let unit = known.map(|q| q.unit.clone()).or_else(seen).unwrap_or_else(|| "-".into());
        Quantity { name: name.into(), unit }
    }
}
