//! The mean of several networks of one layout, each run with its own output.
//!
//! ```text
//! y(t) = 1/k sum_i y_i(t),   y_i(t) = f(u(t-l), y_i(t-j); theta_i)          free run
//! y(t) = 1/k sum_i f(u(t-l), y(t-j); theta_i)                               one step, from measured outputs
//! ```
//!
//! Parameters: theta_1, .., theta_k one after the other, the best member first. The error of the mean is never more than the
//! members' errors in the mean of squares, as `(sum e_i / k)^2 <= sum e_i^2 / k`.
//!
//! The free run has one state per member: it cannot go on from its last outputs, and who needs that refuses the form
//! ([`Form::goes_on_from_outputs`]).
//!
//! Reference: O. Nelles, Nonlinear System Identification (2001), section 7.2 (committees).

use std::sync::Arc;

use dynocal_numerics::linalg::axpy;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

use super::NeuralNarx;
use crate::experiment::Experiment;
use crate::model::form::{Driven, Form, FormRow};
use crate::model::initial::{Initial, free_run};
use crate::model::poly::StructureError;
use crate::model::{Kind, Model, Run, output};

/// Several networks of one layout whose free runs are averaged.
///
/// ```
/// use dynocal_ident::model::neural::{MeanOfNetworks, NeuralNarx};
/// use dynocal_ident::model::{Model, Run};
///
/// let net = NeuralNarx::new(&["u"], "y", 1, 1, 1)?;
/// let mean = MeanOfNetworks::new(net.clone(), 2)?;
/// let (a, b) = ([1.0, 0.5, 0.0, 0.8, 0.1], [0.7, 0.9, 0.2, 0.6, 0.0]);
/// let run = Run { u: &[0.5, 1.0, 0.0, -1.0], y: &[0.1; 4], start: 1 };
/// let free = |model: &dyn Model, theta: &[f64]| {
///     let mut y = [0.0; 4];
///     model.simulate(theta, &run, &mut y);
///     y
/// };
/// let (ya, yb, y) = (free(&net, &a), free(&net, &b), free(&mean, &[a, b].concat()));
/// assert!((0..4).all(|t| (y[t] - 0.5 * (ya[t] + yb[t])).abs() < 1e-15));
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "MeanText")]
pub struct MeanOfNetworks {
    /// What the members have in common.
    network: NeuralNarx,
    /// Number of members k.
    members: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MeanText {
    network: NeuralNarx,
    members: usize,
}

impl TryFrom<MeanText> for MeanOfNetworks {
    type Error = StructureError;

    fn try_from(t: MeanText) -> Result<Self, StructureError> {
        Self::new(t.network, t.members)
    }
}

/// The form in a file.
pub(in crate::model) static FORM: FormRow = FormRow {
    name: "mean_of_networks",
    narx: false,
    initial: Initial::Measured,
    read: |text| Ok(Arc::new(serde_json::from_value::<MeanOfNetworks>(text)?)),
};

impl MeanOfNetworks {
    /// Most members.
    pub const MOST: usize = 64;

    /// `members` networks like `network`.
    ///
    /// # Errors
    /// [`StructureError::Range`]: none or more members than a file may hold.
    pub fn new(network: NeuralNarx, members: usize) -> Result<Self, StructureError> {
        if !(1..=Self::MOST).contains(&members) {
            return Err(StructureError::Range {
                text: format!("mean of networks of `{}`", network.output()),
                what: "number of networks",
                found: members,
                expected: format!("1 to {}", Self::MOST),
            });
        }
        Ok(Self { network, members })
    }

    /// What the members have in common.
    pub fn network(&self) -> &NeuralNarx {
        &self.network
    }

    /// The parameters of each member.
    pub fn each<'a>(&self, theta: &'a [f64]) -> impl Iterator<Item = &'a [f64]> {
        theta.chunks_exact(self.network.n_params()).take(self.members)
    }

    fn share(&self) -> f64 {
        1.0 / self.members as f64
    }

    /// Mean of value, gradient and Hessian that `of` gives for each member.
    fn derivatives(
        &self,
        theta: &[f64],
        grad: &mut [f64],
        hess: &mut [f64],
        of: impl Fn(&[f64], &mut [f64], &mut [f64]) -> f64,
    ) -> f64 {
        let (mut one, mut square, mut value) = (vec![0.0; grad.len()], vec![0.0; hess.len()], 0.0);
        grad.fill(0.0);
        hess.fill(0.0);
        for member in self.each(theta) {
            value += self.share() * of(member, &mut one, &mut square);
            axpy(self.share(), &one, grad);
            axpy(self.share(), &square, hess);
        }
        value
    }

    /// Mean of what `of` gives for each member (N).
    fn averaged(&self, theta: &[f64], n: usize, mut of: impl FnMut(&[f64]) -> Vec<f64>) -> Vec<f64> {
        let mut mean = vec![0.0; n];
        self.each(theta).for_each(|member| axpy(self.share(), &of(member), &mut mean));
        mean
    }
}

impl Form for MeanOfNetworks {
    fn row(&self) -> &'static FormRow {
        &FORM
    }

    fn inputs(&self) -> &[String] {
        self.network.inputs()
    }

    fn output(&self) -> &str {
        self.network.output()
    }

    fn parameter_names(&self) -> Vec<String> {
        (0..self.n_params()).map(|k| self.param_name(k)).collect()
    }

    fn memory(&self) -> usize {
        self.max_lag()
    }

    fn goes_on_from_outputs(&self) -> bool {
        false
    }

    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        Ok(Some(Driven { model: Arc::new(self.clone()), theta: theta.to_vec() }))
    }

    /// Every member starts as `initial` says: from its own rest, the measured outputs, or its own estimated ones.
    fn computed(
        &self,
        theta: &[f64],
        _: Option<&Driven>,
        e: &Experiment,
        kind: Kind,
        initial: Initial,
    ) -> Option<Vec<f64>> {
        let first = e.init_samples.max(self.memory()).min(e.len());
        Some(self.averaged(theta, e.len(), |member| match kind {
            Kind::FreeRun => free_run(&self.network, member, e, first, initial).y,
            _ => output(&self.network, member, e, kind),
        }))
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

impl Model for MeanOfNetworks {
    fn n_inputs(&self) -> usize {
        self.network.n_inputs()
    }

    fn n_params(&self) -> usize {
        self.members * self.network.n_params()
    }

    fn max_lag(&self) -> usize {
        self.network.max_lag()
    }

    fn output_lag(&self) -> usize {
        self.network.output_lag()
    }

    fn param_name(&self, k: usize) -> String {
        let p = self.network.n_params();
        format!("network {}: {}", k / p + 1, self.network.param_name(k % p))
    }

    fn is_linear_in_params(&self) -> bool {
        false
    }

    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        let (mut one, mut status) = (vec![0.0; run.len()], Status::Converged);
        y.fill(0.0);
        for member in self.each(theta) {
            if self.network.simulate(member, run, &mut one) != Status::Converged {
                status = Status::Diverged;
            }
            axpy(self.share(), &one, y);
        }
        status
    }

    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]) {
        let mut one = vec![0.0; run.len()];
        yhat.fill(0.0);
        for member in self.each(theta) {
            self.network.predict(member, run, &mut one);
            axpy(self.share(), &one, yhat);
        }
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status {
        let (p, all) = (self.network.n_params(), self.n_params());
        let (mut one, mut rows) = (vec![0.0; run.len()], vec![0.0; run.len() * p]);
        let mut status = Status::Converged;
        y.fill(0.0);
        for (i, member) in self.each(theta).enumerate() {
            if self.network.sensitivities(member, run, &mut one, &mut rows) != Status::Converged {
                status = Status::Diverged;
            }
            axpy(self.share(), &one, y);
            for (to, from) in s.chunks_exact_mut(all).zip(rows.chunks_exact(p)) {
                to[i * p..(i + 1) * p].iter_mut().zip(from).for_each(|(s, v)| *s = self.share() * v);
            }
        }
        status
    }

    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]) {
        let (p, all) = (self.network.n_params(), self.n_params());
        let mut rows = vec![0.0; run.len() * p];
        for (i, member) in self.each(theta).enumerate() {
            self.network.one_step_jacobian(member, run, &mut rows);
            for (to, from) in s.chunks_exact_mut(all).zip(rows.chunks_exact(p)) {
                to[i * p..(i + 1) * p].iter_mut().zip(from).for_each(|(s, v)| *s = self.share() * v);
            }
        }
    }

    fn sensitivity_adjoint(
        &self,
        theta: &[f64],
        run: &Run,
        _y: &[f64],
        _s: &[f64],
        y_bar: &[f64],
        s_bar: &[f64],
        u_bar: &mut [f64],
    ) {
        let (n, p, all) = (run.len(), self.network.n_params(), self.n_params());
        let scaled = |v: &[f64]| v.iter().map(|w| self.share() * w).collect::<Vec<f64>>();
        let y_bar = scaled(y_bar);
        for (i, member) in self.each(theta).enumerate() {
            // The mean has forgotten what each member did.
            let (mut y, mut s, mut weights) = (vec![0.0; n], Vec::new(), Vec::new());
            if s_bar.is_empty() {
                self.network.simulate(member, run, &mut y);
            } else {
                s = vec![0.0; n * p];
                self.network.sensitivities(member, run, &mut y, &mut s);
                weights = s_bar.chunks_exact(all).flat_map(|row| scaled(&row[i * p..(i + 1) * p])).collect();
            }
            self.network.sensitivity_adjoint(member, run, &y, &s, &y_bar, &weights, u_bar);
        }
    }

    fn window(&self) -> &[(usize, usize)] {
        self.network.window()
    }

    fn window_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        self.derivatives(theta, grad, hess, |m, g, h| self.network.window_derivatives(m, run, t, g, h))
    }

    fn joint_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        self.derivatives(theta, grad, hess, |m, g, h| self.network.joint_derivatives(m, run, t, g, h))
    }
}
