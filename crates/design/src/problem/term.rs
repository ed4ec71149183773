//! One model of a design with its buffers: record in, criterion and its adjoint out.

use super::{DesignProblem, Term};
use crate::criterion::{Active, Information, Moments, Scratch};
use crate::error::DesignError;
use crate::kernel;
use dynocal_ident::model::Run;
use dynocal_numerics::status::Status;

/// Below this relative pivot of the Gram matrix its Cholesky factor has lost half of the digits, and the factor
/// is taken from a QR decomposition of the sensitivities instead.
const SAFE_PIVOT: f64 = 1e-8;

/// Buffers of one term, allocated once.
#[derive(Clone)]
pub(crate) struct TermWork<'a> {
    pub(crate) term: Term<'a>,
    start: usize,
    initial: Vec<f64>,
    /// Predicted output of the padded record.
    pub(crate) y: Vec<f64>,
    s: Vec<f64>,
    s_bar: Vec<f64>,
    pub(crate) y_bar: Vec<f64>,
    moments: Option<Moments>,
    reference_scale: Vec<f64>,
    prior_gram: Vec<f64>,
    gram: Vec<f64>,
    scale: Vec<f64>,
    factor: Vec<f64>,
    factor_inverse: Vec<f64>,
    inverse: Vec<f64>,
    gram_bar: Vec<f64>,
    tall: Vec<f64>,
    scratch: Scratch,
}

impl<'a> TermWork<'a> {
    pub(crate) fn new(problem: &DesignProblem<'a>, term: Term<'a>) -> Result<Self, DesignError> {
        let p = term.model.n_params();
        let (pad, start) = problem.padding();
        let rows = problem.n_samples + pad;
        let mut prior_gram = vec![0.0; p * p];
        kernel::gram_add(term.prior, p, &mut prior_gram);
        let moments = objective_moments(problem, &term)?;
        let n0 = moments.as_ref().map_or(0, |m| m.s0.len() / p);
        let mut scratch = Scratch::default();
        scratch.fit(p, n0);
        let square = vec![0.0; p * p];
        let reference =
            if term.reference_scale.is_empty() { vec![1.0; p] } else { term.reference_scale.to_vec() };
        Ok(Self {
            term,
            start,
            initial: vec![term.initial_output; rows],
            y: vec![0.0; rows],
            s: vec![0.0; rows * p],
            s_bar: vec![0.0; rows * p],
            y_bar: vec![0.0; rows],
            moments,
            reference_scale: reference,
            prior_gram,
            gram: square.clone(),
            scale: vec![1.0; p],
            factor: square.clone(),
            factor_inverse: square.clone(),
            inverse: square.clone(),
            gram_bar: square,
            tall: Vec::new(),
            scratch,
        })
    }

    fn run<'b>(&'b self, u: &'b [f64]) -> Run<'b> {
        Run { u, y: &self.initial, start: self.start }
    }

    /// Free run over the padded record `u`, with sensitivities where there is a criterion.
    pub(crate) fn simulate(&mut self, u: &[f64]) -> Status {
        let run = Run { u, y: &self.initial, start: self.start };
        match self.term.criterion {
            Some(_) => self.term.model.sensitivities(self.term.theta, &run, &mut self.y, &mut self.s),
            None => self.term.model.simulate(self.term.theta, &run, &mut self.y),
        }
    }

    /// Free run alone; `false` where it diverges.
    pub(crate) fn simulate_only(&mut self, u: &[f64]) -> bool {
        let run = Run { u, y: &self.initial, start: self.start };
        self.term.model.simulate(self.term.theta, &run, &mut self.y) == Status::Converged
    }

    /// Adds to `u_bar` the gradient of `y_bar' y` with respect to the padded record.
    pub(crate) fn output_adjoint(&self, u: &[f64], u_bar: &mut [f64]) {
        let run = self.run(u);
        self.term.model.sensitivity_adjoint(self.term.theta, &run, &self.y, &[], &self.y_bar, &[], u_bar);
    }

    /// Raw sensitivities of the rows that count.
    pub(crate) fn counted(&self) -> &[f64] {
        &self.s[self.start * self.scale.len()..]
    }

    /// Factors the information of the simulated record; `exact` asks for QR without trying the Gram matrix.
    /// `false`: singular to working precision.
    pub(crate) fn factor(&mut self, exact: bool) -> bool {
        let p = self.scale.len();
        self.gram.copy_from_slice(&self.prior_gram);
        kernel::gram_add(&self.s[self.start * p..], p, &mut self.gram);
        for k in 0..p {
            self.scale[k] = self.gram[k * p + k].sqrt();
            if !(self.scale[k] > 0.0 && self.scale[k].is_finite()) {
                return false;
            }
        }
        for i in 0..p {
            for j in 0..=i {
                self.gram[i * p + j] /= self.scale[i] * self.scale[j];
            }
        }
        let regular = if !exact && kernel::cholesky(&self.gram, p, &mut self.factor) > SAFE_PIVOT {
            true
        } else {
            self.factor_by_qr()
        };
        if regular {
            kernel::invert_lower(&self.factor, p, &mut self.factor_inverse);
            kernel::lower_gram(&self.factor_inverse, p, &mut self.inverse);
        }
        regular
    }

    fn factor_by_qr(&mut self) -> bool {
        let p = self.scale.len();
        let s = &self.s[self.start * p..];
        let (n, n_prior) = (s.len() / p, self.term.prior.len() / p);
        let rows = n + n_prior;
        self.tall.resize(rows * p, 0.0);
        for k in 0..p {
            for t in 0..rows {
                let v = if t < n { s[t * p + k] } else { self.term.prior[(t - n) * p + k] };
                self.tall[k * rows + t] = v / self.scale[k];
            }
        }
        kernel::qr_factor(&mut self.tall, rows, p, &mut self.factor);
        // Columns have unit norm, so a diagonal entry is the part of a column that the earlier ones do not explain.
        (0..p).all(|k| self.factor[k * p + k] > 1e-12)
    }

    /// Lower factor and scales of the last record.
    pub(crate) fn factors(&self) -> (&[f64], &[f64]) {
        (&self.factor, &self.scale)
    }

    /// Exact criterion of the factored information.
    pub(crate) fn exact_value(&mut self) -> f64 {
        let Some(criterion) = self.term.criterion else { return 0.0 };
        let info = information(
            &self.term,
            &self.scale,
            &self.reference_scale,
            &self.factor,
            &self.factor_inverse,
            &self.inverse,
            self.moments.as_ref(),
        );
        criterion.value(&info, &mut self.scratch)
    }

    /// Pieces of the factored criterion near the worst.
    pub(crate) fn active(&mut self, band: f64) -> Option<Active> {
        let info = information(
            &self.term,
            &self.scale,
            &self.reference_scale,
            &self.factor,
            &self.factor_inverse,
            &self.inverse,
            self.moments.as_ref(),
        );
        self.term.criterion?.active(&info, band, &mut self.scratch)
    }

    /// Sets the gradient in the Gram matrix for [`TermWork::adjoint`].
    pub(crate) fn set_gram_bar(&mut self, gram_bar: &[f64]) {
        self.gram_bar.copy_from_slice(gram_bar);
    }

    /// Criterion (p-norm of order `sharpness` where it is an extreme) and its gradient in the Gram matrix, which is
    /// kept for [`TermWork::adjoint`].
    pub(crate) fn value_gradient(&mut self, sharpness: f64) -> f64 {
        let Some(criterion) = self.term.criterion else { return 0.0 };
        let info = information(
            &self.term,
            &self.scale,
            &self.reference_scale,
            &self.factor,
            &self.factor_inverse,
            &self.inverse,
            self.moments.as_ref(),
        );
        criterion.value_gradient(&info, sharpness, &mut self.scratch, &mut self.gram_bar)
    }

    /// Adds to `u_bar` the gradient of `weight * criterion + y_bar' y` with respect to the padded record.
    pub(crate) fn adjoint(&mut self, u: &[f64], weight: f64, u_bar: &mut [f64]) {
        let p = self.scale.len();
        if self.term.criterion.is_some() && weight != 0.0 {
            for i in 0..p {
                for j in 0..p {
                    self.gram_bar[i * p + j] *= 2.0 * weight / (self.scale[i] * self.scale[j]);
                }
            }
            let rows = self.start * p..;
            kernel::multiply(&self.s[rows.clone()], &self.gram_bar, p, &mut self.s_bar[rows]);
        } else if self.y_bar.iter().all(|v| *v == 0.0) {
            return;
        } else {
            self.s_bar.fill(0.0);
        }
        let empty: &[f64] = &[];
        let (s, s_bar) = match self.term.criterion {
            Some(_) => (&self.s[..], &self.s_bar[..]),
            None => (empty, empty),
        };
        let run = self.run(u);
        self.term.model.sensitivity_adjoint(self.term.theta, &run, &self.y, s, &self.y_bar, s_bar, u_bar);
    }
}

fn information<'b>(
    term: &Term,
    scale: &'b [f64],
    reference_scale: &'b [f64],
    factor: &'b [f64],
    factor_inverse: &'b [f64],
    inverse: &'b [f64],
    objective: Option<&'b Moments>,
) -> Information<'b> {
    Information {
        p: scale.len(),
        factor,
        factor_inverse,
        inverse,
        scale,
        reference_scale,
        noise_variance: term.noise_variance,
        objective,
    }
}

/// Sensitivities of the objective signal under the convention of the problem, rows that count only.
fn objective_moments(problem: &DesignProblem, term: &Term) -> Result<Option<Moments>, DesignError> {
    let m = problem.channels.len();
    if term.objective_signal.is_empty() {
        return Ok(None);
    }
    let s0 = crate::information::sensitivities(
        term.predictor.unwrap_or(term.model),
        term.theta,
        term.objective_signal,
        m,
        problem.convention,
        problem.padding().1,
        term.initial_output,
    )
    .map_err(|_| DesignError::Diverged { term: term.name.into(), record: "the objective signal".into() })?;
    Ok(Some(Moments::new(s0, term.model.n_params())))
}
