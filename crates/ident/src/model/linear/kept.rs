//! Linear models as a form: what they compute on a record, whatever the noise model.
//!
//! ```text
//! w = response to the inputs        v = y - w        yhat(t|t-k) = w(t) + vhat(t|t-k)        (A = 1)
//! ```
//!
//! Without a noise model vhat is zero: predictions and free run of an output-error model are the same.

use super::structures::FORM;
use super::{LinearModel, Polynomials};
use crate::experiment::Experiment;
use crate::model::form::{Driven, Form, FormRow};
use crate::model::initial::{Initial, free_run};
use crate::model::poly::StructureError;
use crate::model::{Kind, Run};
use std::sync::Arc;

impl Form for LinearModel {
    fn row(&self) -> &'static FormRow {
        &FORM
    }

    fn inputs(&self) -> &[String] {
        &self.inputs
    }

    fn output(&self) -> &str {
        &self.output
    }

    fn parameter_names(&self) -> Vec<String> {
        self.param_names()
    }

    /// Of the equation, and of the response to the inputs over its common denominator.
    fn memory(&self) -> usize {
        let poles: usize = self.orders.iter().map(|o| o.nf).sum();
        let numerators = self.orders.iter().map(|o| (o.nk + o.nb).saturating_sub(1) + poles - o.nf);
        numerators
            .chain([self.max_lag(), if self.orders.is_empty() { 0 } else { self.na + poles }])
            .max()
            .unwrap_or(0)
    }

    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        if self.inputs.is_empty() {
            return Ok(None);
        }
        let (model, theta) = self.deterministic(theta)?;
        Ok(Some(Driven { model: Arc::new(model), theta }))
    }

    fn computed(
        &self,
        theta: &[f64],
        driven: Option<&Driven>,
        e: &Experiment,
        kind: Kind,
        initial: Initial,
    ) -> Option<Vec<f64>> {
        let first = e.init_samples.max(self.memory()).min(e.len());
        let response = |d: &Driven| free_run(d.model.as_ref(), &d.theta, e, first, initial).y;
        let steps = match kind {
            Kind::FreeRun => return driven.map(response),
            Kind::OneStep => 1,
            Kind::KStep(k) => k.max(1),
        };
        let mut y = vec![0.0; e.len()];
        match driven.filter(|_| self.na == 0) {
            // Past outputs are regressors, or there are no inputs: nothing of a free run enters.
            None => {
                let start = if self.inputs.is_empty() || initial == Initial::Rest { 0 } else { first };
                self.predict(theta, &Run { u: &e.u, y: &e.y, start }, steps, &mut y);
            }
            Some(d) => {
                let w = response(d);
                self.with_noise(theta, e, &w, first, steps, &mut y);
            }
        }
        y[..first].copy_from_slice(&e.y[..first]);
        Some(y)
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

impl LinearModel {
    /// `w` and the prediction of what it leaves, `steps` ahead, from sample `first` on.
    fn with_noise(
        &self,
        theta: &[f64],
        e: &Experiment,
        w: &[f64],
        first: usize,
        steps: usize,
        y: &mut [f64],
    ) {
        y.copy_from_slice(w);
        if self.nc + self.nd == 0 {
            return;
        }
        let Polynomials { c, d, .. } = self.polynomials(theta);
        let noise = LinearModel {
            inputs: Vec::new(),
            output: self.output.clone(),
            na: 0,
            orders: Vec::new(),
            nc: self.nc,
            nd: self.nd,
        };
        let theta: Vec<f64> = c[1..].iter().chain(&d[1..]).copied().collect();
        let v: Vec<f64> = e.y.iter().zip(w).map(|(y, w)| y - w).collect();
        let mut predicted = vec![0.0; v.len()];
        noise.predict(&theta, &Run { u: &[], y: &v, start: first }, steps, &mut predicted);
        y[first..].iter_mut().zip(&predicted[first..]).for_each(|(y, v)| *y += v);
    }
}
