//! The statement of a design problem.

mod evaluate;
mod term;

pub use evaluate::Evaluator;
pub(crate) use evaluate::Multipliers;

use crate::channel::{Channel, Layout};
use crate::criterion::Criterion;
use crate::error::DesignError;
pub use crate::information::Convention;
use dynocal_ident::model::Model;
use dynocal_numerics::interval::Interval;

/// Limits on a predicted output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputLimits {
    /// Least output, in the output's unit.
    pub lower: f64,
    /// Largest output.
    pub upper: f64,
    /// Distance that the prediction keeps from both limits (for the error of the model).
    pub margin: f64,
}

impl OutputLimits {
    /// Least and largest output that a record may have: the limits with the margin taken off. Everything that keeps or
    /// judges a limit compares with these two numbers.
    pub fn kept(&self) -> Interval {
        Interval::new(self.lower + self.margin, self.upper - self.margin)
    }
}

/// One model of a design: what it contributes to the criterion and which limits its output has.
#[derive(Clone, Copy)]
pub struct Term<'a> {
    /// Name of the output, e.g. `torque`.
    pub name: &'a str,
    /// Model; its inputs are the channels of the problem, in the same order.
    pub model: &'a dyn Model,
    /// The same parameters with the sensitivities of the free run, where `model` has those of prediction errors
    /// ([`crate::noise_model`]): what predictions over the objective signal depend on. None: those of `model`.
    pub predictor: Option<&'a dyn Model>,
    /// Parameters (p) at which the information is taken.
    pub theta: &'a [f64],
    /// Variance sigma^2 of the output noise.
    pub noise_variance: f64,
    /// Output before the record (an operating point); initial samples of the free run.
    pub initial_output: f64,
    /// Criterion, or none for a model that only limits.
    pub criterion: Option<&'a dyn Criterion>,
    /// Weight of the criterion in the sum (thesis eq. 4.54).
    pub weight: f64,
    /// Objective signal U0 (N0 x m), empty where the criterion needs none.
    pub objective_signal: &'a [f64],
    /// Reference scales c (p) of the parameters, used by criterion `e`; empty: ones.
    pub reference_scale: &'a [f64],
    /// Raw sensitivities of earlier records (rows x p, or their triangular factor): the design adds to what they
    /// tell already. Empty: none.
    pub prior: &'a [f64],
    /// Limits on the predicted output.
    pub limits: Option<OutputLimits>,
}

impl<'a> Term<'a> {
    /// A term of one model and one criterion with weight 1, no limits and nothing known before.
    pub fn new(
        name: &'a str,
        model: &'a dyn Model,
        theta: &'a [f64],
        noise_variance: f64,
        criterion: &'a dyn Criterion,
    ) -> Self {
        Self {
            name,
            model,
            predictor: None,
            theta,
            noise_variance,
            initial_output: 0.0,
            criterion: Some(criterion),
            weight: 1.0,
            objective_signal: &[],
            reference_scale: &[],
            prior: &[],
            limits: None,
        }
    }
}

/// A design problem: find input samples within limits that minimise `sum_i w_i J_i`.
#[derive(Clone)]
pub struct DesignProblem<'a> {
    /// Input channels (m).
    pub channels: Vec<Channel>,
    /// Samples N of the record.
    pub n_samples: usize,
    /// What happens before the first sample.
    pub convention: Convention,
    /// First sample that counts under [`Convention::Trim`]; the longest lag of the models where it is smaller.
    pub start: usize,
    /// Models with their criteria and limits.
    pub terms: Vec<Term<'a>>,
}

impl DesignProblem<'_> {
    /// Longest lag of all models: samples that only initialise.
    pub fn max_lag(&self) -> usize {
        self.terms.iter().map(|t| t.model.max_lag()).max().unwrap_or(0)
    }

    /// Rows put before the record and the first row that is computed.
    pub(crate) fn padding(&self) -> (usize, usize) {
        match self.convention {
            Convention::Trim => (0, self.max_lag().max(self.start)),
            Convention::Hold | Convention::Zero => (self.max_lag(), self.max_lag()),
        }
    }

    /// Checks the problem as a whole and lays out its free variables.
    ///
    /// # Errors
    /// The first fault, with names and numbers; contradicting limits as [`DesignError::Conflict`].
    pub fn check(&self) -> Result<Layout, DesignError> {
        let (_, start) = self.padding();
        if self.convention == Convention::Trim && self.n_samples <= start || self.n_samples == 0 {
            return Err(DesignError::Shape {
                what: "samples of the record (longest lag or start + 1 at least)".into(),
                found: self.n_samples,
                expected: start + 1,
            });
        }
        for term in &self.terms {
            self.check_term(term)?;
        }
        if !self.terms.iter().any(|t| t.criterion.is_some()) {
            return Err(DesignError::NoCriterion);
        }
        Layout::new(&self.channels, self.n_samples)
    }

    fn check_term(&self, term: &Term) -> Result<(), DesignError> {
        let (m, p) = (self.channels.len(), term.model.n_params());
        let shape = |what: &str, found, expected| {
            Err(DesignError::Shape { what: format!("{}: {what}", term.name), found, expected })
        };
        let number = |what: &str, found: f64, expected: &str| {
            Err(DesignError::Number {
                what: format!("{}: {what}", term.name),
                found,
                expected: expected.into(),
            })
        };
        if term.model.n_inputs() != m {
            return shape("inputs of the model against channels", term.model.n_inputs(), m);
        }
        if let Some(predictor) = term.predictor.filter(|x| (x.n_inputs(), x.n_params()) != (m, p)) {
            return shape("parameters of the predictor against those of the model", predictor.n_params(), p);
        }
        if term.theta.len() != p {
            return shape("parameters", term.theta.len(), p);
        }
        if !(term.noise_variance > 0.0 && term.noise_variance.is_finite()) {
            return number("noise variance", term.noise_variance, "a positive number");
        }
        if !term.reference_scale.is_empty() && term.reference_scale.len() != p {
            return shape("reference scales", term.reference_scale.len(), p);
        }
        if let Some(c) = term.reference_scale.iter().find(|c| c.is_nan() || **c <= 0.0) {
            return number("reference scale", *c, "a positive number");
        }
        if !term.prior.len().is_multiple_of(p) {
            return shape("prior rows", term.prior.len(), p * term.prior.len().div_ceil(p));
        }
        if !term.objective_signal.len().is_multiple_of(m) {
            return shape(
                "objective signal",
                term.objective_signal.len(),
                m * term.objective_signal.len() / m,
            );
        }
        if !(term.weight >= 0.0 && term.weight.is_finite()) {
            return number("weight", term.weight, "a number that is not negative");
        }
        if let Some(l) = term.limits
            && (l.lower + l.margin).partial_cmp(&(l.upper - l.margin)) != Some(std::cmp::Ordering::Less)
        {
            return Err(DesignError::Conflict {
                first: format!("{} lower limit {} with margin {}", term.name, l.lower, l.margin),
                second: format!("upper limit {} with margin {}", l.upper, l.margin),
                by: l.lower + l.margin - (l.upper - l.margin),
                sample: None,
            });
        }
        match term.criterion {
            Some(c) if c.needs_objective_signal() && term.objective_signal.is_empty() => {
                Err(DesignError::NoObjectiveSignal { term: term.name.into() })
            }
            _ => Ok(()),
        }
    }
}
