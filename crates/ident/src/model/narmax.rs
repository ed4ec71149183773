//! Polynomial NARMAX models.
//!
//! ```text
//! y(t) = sum_k theta_k phi_k(u, y, e) + e(t)        phi_k a product of lagged inputs, outputs and innovations
//! ```
//!
//! The innovations are not measured: a prediction computes them from the errors before, a free run has none.
//!
//! Reference: S. A. Billings, Nonlinear System Identification (2013), section 3.3.

use std::sync::Arc;

use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

use super::form::{Driven, Form, FormRow};
use super::initial::Initial;
use super::kinds::{ModelKind, Structure};
use super::poly::{PolyNarx, Source, StructureError};
use super::{Kind, Model, Run};
use crate::experiment::Experiment;

/// Row of the table.
pub(super) const KIND: ModelKind = ModelKind {
    doc: MemberDoc {
        name: "narmax",
        what: "polynomial with products of lagged inputs, outputs and innovations `e(t-k)`; estimator els",
        params: &[ParamDoc {
            name: "regressors",
            unit: "-",
            default: "",
            what: "terms as text, e.g. [\"y(t-1)\", \"inj(t-1)^2\", \"e(t-1)\"]",
        }],
    },
    form: &FORM,
    build: |keys| Ok(Box::new(registry::keys::<Listed>("narmax", keys)?)),
};

/// The form in a file.
pub(super) static FORM: FormRow = FormRow {
    name: "narmax",
    narx: false,
    initial: Initial::Measured,
    read: |text| Ok(Arc::new(serde_json::from_value::<Narmax>(text)?)),
};

/// Keys of the structure.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Listed {
    regressors: Vec<String>,
}

impl Structure for Listed {
    fn form(
        &self,
        inputs: &[String],
        output: &str,
        _data: &[Experiment],
    ) -> Result<Arc<dyn Form>, StructureError> {
        Ok(Arc::new(Narmax::parse(inputs, output, &self.regressors)?))
    }
}

/// Name of the innovations in regressors.
pub const INNOVATION: &str = "e";

/// A polynomial NARMAX structure: a polynomial NARX model with the innovations as its last input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Narmax {
    with_innovations: PolyNarx,
}

impl Narmax {
    /// A structure from regressors in text form, `e(t-1)` being the innovation of the sample before.
    ///
    /// ```
    /// use dynocal_ident::model::narmax::Narmax;
    /// let model = Narmax::parse(&["inj"], "torque", &["inj(t-1)", "torque(t-1)", "e(t-1)", "inj(t-1)*e(t-2)"])?;
    /// assert_eq!(model.regressor_texts()[3], "inj(t-1)*e(t-2)");
    /// assert!(Narmax::parse(&["inj"], "torque", &["e(t)"]).is_err());
    /// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
    /// ```
    ///
    /// # Errors
    /// [`StructureError`]: as of [`PolyNarx::parse`]; an innovation without lag; a channel that is named `e`.
    pub fn parse<A: AsRef<str>, B: AsRef<str>>(
        inputs: &[A],
        output: &str,
        regressors: &[B],
    ) -> Result<Self, StructureError> {
        let mut names: Vec<&str> = inputs.iter().map(AsRef::as_ref).collect();
        if names.contains(&INNOVATION) || output == INNOVATION {
            return Err(StructureError::Name {
                found: INNOVATION.into(),
                expected: "another name: in this structure `e` is the innovation",
            });
        }
        names.push(INNOVATION);
        let with_innovations = PolyNarx::parse(&names, output, regressors)?;
        let now = (names.len() - 1, 0);
        if with_innovations.window().contains(&now) {
            return Err(StructureError::Range {
                text: "e(t)".into(),
                what: "lag",
                found: 0,
                expected: "1 or more: the innovation of a sample is not known before it".into(),
            });
        }
        Ok(Self { with_innovations })
    }

    /// Regressors in text form.
    pub fn regressor_texts(&self) -> Vec<String> {
        self.with_innovations.regressor_texts()
    }

    /// Names of the measured inputs.
    pub fn inputs(&self) -> &[String] {
        let all = self.with_innovations.inputs();
        &all[..all.len() - 1]
    }

    /// The model as a NARX model whose last input is the innovation: with zeros there its free run is that of this model.
    pub fn with_innovations(&self) -> &PolyNarx {
        &self.with_innovations
    }

    /// What the free run simulates, where innovations are zero: the terms without them, with their parameters. None where
    /// every term has one.
    ///
    /// # Errors
    /// [`StructureError`] of the smaller structure.
    pub fn without_innovations(&self, theta: &[f64]) -> Result<Option<(PolyNarx, Vec<f64>)>, StructureError> {
        let innovation = Source::Input(self.inputs().len());
        let own = self.with_innovations.regressors().iter().zip(theta);
        let left = own.filter(|(r, _)| r.reads().all(|(source, _)| source != innovation));
        let (terms, theta): (Vec<_>, Vec<f64>) = left.map(|(r, v)| (r.clone(), *v)).unzip();
        if terms.is_empty() {
            return Ok(None);
        }
        let output = self.with_innovations.output().to_string();
        Ok(Some((PolyNarx::new(self.inputs().to_vec(), output, terms)?, theta)))
    }

    /// Longest lag.
    pub fn max_lag(&self) -> usize {
        self.with_innovations.max_lag()
    }

    /// First sample of a record that is scored.
    pub fn first(&self, e: &Experiment) -> usize {
        e.init_samples.max(self.max_lag()).min(e.len())
    }

    /// Output of the model on a record (N): one step and k steps use the innovations up to then, the free run has none.
    pub fn outputs(&self, theta: &[f64], e: &Experiment, kind: Kind) -> Vec<f64> {
        let mut u = padded(e, self.inputs().len());
        let first = self.first(e);
        let mut y = e.y.clone();
        match kind {
            Kind::FreeRun => {
                let run = Run { u: &u, y: &e.y, start: first };
                self.with_innovations.simulate(theta, &run, &mut y);
            }
            Kind::OneStep => self.innovations(theta, e, &mut u, Some(&mut y)),
            Kind::KStep(k) => {
                self.innovations(theta, e, &mut u, None);
                self.k_step(theta, e, &u, k.max(1), &mut y);
            }
        }
        y
    }

    /// Fills the innovations into the last column of `u`, and the predictions that they are the errors of.
    pub(crate) fn innovations(
        &self,
        theta: &[f64],
        e: &Experiment,
        u: &mut [f64],
        mut predicted: Option<&mut [f64]>,
    ) {
        let (width, lag) = (self.inputs().len() + 1, self.max_lag());
        let mut tail = vec![0.0; lag + 1];
        for t in self.first(e)..e.len() {
            let from = t - lag;
            let run = Run { u: &u[from * width..(t + 1) * width], y: &e.y[from..=t], start: lag };
            self.with_innovations.predict(theta, &run, &mut tail);
            u[(t + 1) * width - 1] = e.y[t] - tail[lag];
            if let Some(p) = &mut predicted {
                p[t] = tail[lag];
            }
        }
    }

    /// For every t a free run over the last k samples, in which no innovation is known.
    fn k_step(&self, theta: &[f64], e: &Experiment, u: &[f64], k: usize, y: &mut [f64]) {
        let (width, lag, first) = (self.inputs().len() + 1, self.max_lag(), self.first(e));
        let mut tail = vec![0.0; lag + k];
        for t in first..e.len() {
            let free = k.min(t + 1 - first);
            let from = t + 1 - free - lag;
            let mut part = u[from * width..(t + 1) * width].to_vec();
            (lag..lag + free).for_each(|i| part[(i + 1) * width - 1] = 0.0);
            let run = Run { u: &part, y: &e.y[from..=t], start: lag };
            let tail = &mut tail[..lag + free];
            self.with_innovations.simulate(theta, &run, tail);
            y[t] = tail[lag + free - 1];
        }
    }
}

impl Form for Narmax {
    fn row(&self) -> &'static FormRow {
        &FORM
    }

    fn inputs(&self) -> &[String] {
        self.inputs()
    }

    fn output(&self) -> &str {
        self.with_innovations.output()
    }

    fn parameter_names(&self) -> Vec<String> {
        self.regressor_texts()
    }

    fn memory(&self) -> usize {
        self.max_lag()
    }

    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        let of = |(model, theta)| Driven { model: Arc::new(model), theta };
        Ok(self.without_innovations(theta)?.map(of))
    }

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
                Some(super::initial::free_run(d.model.as_ref(), &d.theta, e, self.first(e), initial).y)
            }
            _ => Some(self.outputs(theta, e, kind)),
        }
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

/// The inputs with a last column of zeros.
pub(crate) fn padded(e: &Experiment, m: usize) -> Vec<f64> {
    let mut u = Vec::with_capacity(e.len() * (m + 1));
    for t in 0..e.len() {
        u.extend_from_slice(&e.u[t * m..(t + 1) * m]);
        u.push(0.0);
    }
    u
}
