//! Polynomial NARMAX models.
//!
//! With terms in past innovations that are linear, `eps(t) = y(t) - f(u, y) - sum_j c_j eps(t-j)`, the prediction errors
//! have the sensitivities
//!
//! ```text
//! psi(t) = phi(t) - sum_j c_j psi(t-j)
//! ```
//!
//! of the terms phi without innovations, taken at the response to the inputs: past outputs are measured and no
//! recursion. What the noise adds through the outputs is left out.

use super::{VIEW, filter_back, filter_from};
use dynocal_ident::model::form::{Driven, Form, FormRow};
use dynocal_ident::model::narmax::Narmax;
use dynocal_ident::model::poly::{PolyNarx, Source, StructureError};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;

/// There are no such sensitivities.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoInformation {
    /// A term multiplies an innovation with something else.
    #[error("the term `{term}` multiplies an innovation, expected terms e(t-k) alone")]
    Product {
        /// Its text.
        term: String,
    },
    /// Every term has an innovation.
    #[error("no term is driven by an input")]
    NotDriven,
    /// Names or terms.
    #[error(transparent)]
    Structure(#[from] StructureError),
}

/// A NARMAX model whose sensitivities are those of its prediction errors in the parameters of the terms without
/// innovations (see the module).
#[derive(Clone, Debug)]
pub struct NarmaxInformation {
    driven: PolyNarx,
    /// The same terms with the output as one more input: nothing feeds back.
    open: PolyNarx,
    /// 1 and the coefficients of past innovations.
    c: Vec<f64>,
}

impl NarmaxInformation {
    /// For `model` with all its parameters `theta`; the parameters of the design follow.
    ///
    /// # Errors
    /// [`NoInformation`].
    pub fn new(model: &Narmax, theta: &[f64]) -> Result<(Self, Vec<f64>), NoInformation> {
        let (driven, own) = model.without_innovations(theta)?.ok_or(NoInformation::NotDriven)?;
        let innovation = Source::Input(model.inputs().len());
        let all = model.with_innovations();
        let mut c = vec![1.0];
        for ((r, text), value) in all.regressors().iter().zip(all.regressor_texts()).zip(theta) {
            if r.reads().all(|(source, _)| source != innovation) {
                continue;
            }
            let alone = r.functions().is_empty() && r.factors().len() == 1 && r.degree() == 1;
            let Some(lag) = r.factors().first().map(|f| f.lag).filter(|_| alone) else {
                return Err(NoInformation::Product { term: text });
            };
            c.resize(c.len().max(lag + 1), 0.0);
            c[lag] += value;
        }
        let mut names = driven.inputs().to_vec();
        names.push(driven.output().to_string());
        // As text, because a regressor does not let its sources be exchanged.
        let texts: Vec<String> = driven.regressor_texts();
        let mut free = String::from("predicted");
        while names.contains(&free) {
            free.push('_');
        }
        let open = PolyNarx::parse(&names, &free, &texts)?;
        Ok((Self { driven, open, c }, own))
    }

    /// Inputs with the response beside them, N x (m + 1).
    fn beside(&self, run: &Run, y: &[f64]) -> Vec<f64> {
        let m = self.driven.n_inputs();
        let mut out = Vec::with_capacity(run.len() * (m + 1));
        for (row, y) in run.u.chunks_exact(m).zip(y) {
            out.extend_from_slice(row);
            out.push(*y);
        }
        out
    }
}

impl Form for NarmaxInformation {
    fn row(&self) -> &'static FormRow {
        self.driven.row()
    }

    fn inputs(&self) -> &[String] {
        self.driven.inputs()
    }

    fn output(&self) -> &str {
        self.driven.output()
    }

    fn parameter_names(&self) -> Vec<String> {
        self.driven.parameter_names()
    }

    fn memory(&self) -> usize {
        self.driven.memory()
    }

    fn dynamics(&self) -> Option<&dyn Model> {
        Some(self)
    }

    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        Form::driven(&self.driven, theta)
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        Err(<serde_json::Error as serde::ser::Error>::custom(VIEW))
    }
}

impl Model for NarmaxInformation {
    fn n_inputs(&self) -> usize {
        self.driven.n_inputs()
    }

    fn n_params(&self) -> usize {
        self.driven.n_params()
    }

    fn max_lag(&self) -> usize {
        self.driven.max_lag()
    }

    fn output_lag(&self) -> usize {
        self.driven.output_lag()
    }

    fn param_name(&self, k: usize) -> String {
        self.driven.param_name(k)
    }

    fn is_linear_in_params(&self) -> bool {
        false
    }

    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        self.driven.simulate(theta, run, y)
    }

    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]) {
        self.driven.predict(theta, run, yhat);
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status {
        if self.simulate(theta, run, y) != Status::Converged {
            return Status::Diverged;
        }
        let (n, p) = (run.len(), self.n_params());
        let u = self.beside(run, y);
        let mut predicted = vec![0.0; n];
        let open = Run { u: &u, y: run.y, start: run.start };
        if self.open.sensitivities(theta, &open, &mut predicted, s) != Status::Converged {
            return Status::Diverged;
        }
        let (mut x, mut work) = (vec![0.0; n], Vec::new());
        for k in 0..p {
            x.iter_mut().zip(s.iter().skip(k).step_by(p)).for_each(|(x, s)| *x = *s);
            filter_from(&[1.0], &self.c, run.start, &mut x, &mut work);
            s.iter_mut().skip(k).step_by(p).zip(&x).for_each(|(s, x)| *s = *x);
        }
        if s.iter().all(|v| v.is_finite()) { Status::Converged } else { Status::Diverged }
    }

    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]) {
        self.driven.one_step_jacobian(theta, run, s);
    }

    fn sensitivity_adjoint(
        &self,
        theta: &[f64],
        run: &Run,
        y: &[f64],
        _s: &[f64],
        y_bar: &[f64],
        s_bar: &[f64],
        u_bar: &mut [f64],
    ) {
        let (m, n, p) = (self.n_inputs(), run.len(), self.n_params());
        let mut of_y = y_bar.to_vec();
        if !s_bar.is_empty() {
            let mut of_terms = vec![0.0; n * p];
            let (mut x, mut work) = (vec![0.0; n], Vec::new());
            for k in 0..p {
                x.iter_mut().zip(s_bar.iter().skip(k).step_by(p)).for_each(|(x, s)| *x = *s);
                filter_back(&[1.0], &self.c, run.start, &mut x, &mut work);
                of_terms.iter_mut().skip(k).step_by(p).zip(&x).for_each(|(s, x)| *s = *x);
            }
            let u = self.beside(run, y);
            let open = Run { u: &u, y: run.y, start: run.start };
            let (mut predicted, mut terms) = (vec![0.0; n], vec![0.0; n * p]);
            self.open.sensitivities(theta, &open, &mut predicted, &mut terms);
            let (zero, mut beside) = (vec![0.0; n], vec![0.0; n * (m + 1)]);
            self.open.sensitivity_adjoint(theta, &open, &predicted, &terms, &zero, &of_terms, &mut beside);
            for (t, row) in beside.chunks_exact(m + 1).enumerate() {
                u_bar[t * m..(t + 1) * m].iter_mut().zip(row).for_each(|(u, b)| *u += b);
                of_y[t] += row[m];
            }
        }
        self.driven.sensitivity_adjoint(theta, run, y, &[], &of_y, &[], u_bar);
    }

    fn window(&self) -> &[(usize, usize)] {
        self.driven.window()
    }

    fn window_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        self.driven.window_derivatives(theta, run, t, grad, hess)
    }
}
