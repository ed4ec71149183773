//! From models and what is known already to the next record.

use dynocal_design::criterion::{Criterion, criterion};
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, OutputLimits, Term};
use dynocal_design::search::{DesignOptions, DesignOutcome, design, random_record};
use dynocal_ident::data::Dataset;
use dynocal_ident::estimate::Fit;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::{Model, Run};

use super::LoopError;
use super::bed::TestBed;
use super::model::{identify, information};
use super::robust::{Ensemble, Risk, Stable, draws};

/// One structure for one output: what a loop identifies.
#[derive(Clone, Copy)]
pub struct Structure<'a> {
    /// Output of the plant.
    pub output: &'a str,
    /// Model; its inputs are the channels of the bed, in their order.
    pub model: &'a dyn Model,
    /// How much it counts among the structures.
    pub weight: f64,
    /// The model that is used in the end, where `model` has further terms that are only in doubt (criterion `mse`);
    /// otherwise `model` itself.
    pub kept: Option<&'a dyn Model>,
}

impl<'a> Structure<'a> {
    /// A structure with weight 1 and nothing in doubt.
    pub fn new(output: &'a str, model: &'a dyn Model) -> Self {
        Self { output, model, weight: 1.0, kept: None }
    }

    /// The model that is used in the end.
    pub fn used(&self) -> &'a dyn Model {
        self.kept.unwrap_or(self.model)
    }
}

/// A structure with its parameters.
#[derive(Clone, Debug)]
pub struct Known {
    /// Estimate from the records so far.
    pub fit: Fit,
    /// Triangular factor of what they tell (p x p).
    pub information: Vec<f64>,
    /// Mean of the measured output: where a free run starts.
    pub mean_output: f64,
}

/// Identifies every structure from all `records`.
///
/// # Errors
/// [`LoopError`] of a record or an estimation.
pub fn know(bed: &TestBed, structures: &[Structure], records: &[Dataset]) -> Result<Vec<Known>, LoopError> {
    structures
        .iter()
        .map(|s| {
            let data = bed.experiments(records, s.output)?;
            let fit = identify(s.model, &data)?;
            let information = information(s.model, &fit.theta, &data)?;
            Ok(Known { fit, information, mean_output: mean_output(&data) })
        })
        .collect()
}

fn mean_output(data: &[Experiment]) -> f64 {
    let n: usize = data.iter().map(Experiment::len).sum();
    data.iter().flat_map(|e| &e.y).sum::<f64>() / n.max(1) as f64
}

/// What the next record is designed for.
#[derive(Clone, Debug, PartialEq)]
pub struct Aim {
    /// Name of a criterion of [`dynocal_design::criterion::CRITERIA`].
    pub criterion: String,
    /// Its keys.
    pub keys: toml::Table,
    /// Objective signal U0 (N0 x m): where predictions shall be good.
    pub objective: Vec<f64>,
    /// Whether the record adds to what the records so far tell; otherwise it is designed for itself.
    pub adds: bool,
    /// How to search.
    pub search: DesignOptions,
    /// Whether the record shall be good over the distribution of the estimate, not only at it; for one structure.
    pub robust: Option<RobustAim>,
}

/// A record that is good over the distribution of the estimate ([`super::robust`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobustAim {
    /// Draws of the parameters.
    pub draws: usize,
    /// What it makes small over them.
    pub risk: Risk,
}

/// Limits of predicted outputs, by output.
pub type Limits<'a> = &'a [(&'a str, OutputLimits)];

/// Terms of a design problem: the structures at their estimates.
pub fn terms<'a>(
    structures: &[Structure<'a>],
    known: &'a [Known],
    aim: &'a Aim,
    criterion: &'a dyn Criterion,
    limits: Limits,
) -> Vec<Term<'a>> {
    structures
        .iter()
        .zip(known)
        .map(|(s, k)| Term {
            initial_output: k.mean_output,
            weight: s.weight,
            objective_signal: &aim.objective,
            prior: if aim.adds { &k.information } else { &[] },
            limits: limits.iter().find(|l| l.0 == s.output).map(|l| l.1),
            ..Term::new(s.output, s.model, &k.fit.theta, k.fit.noise_variance, criterion)
        })
        .collect()
}

/// The design problem of `samples` samples on the bed: inputs stand at their first values before the record.
pub fn problem<'a>(bed: &TestBed, samples: usize, terms: Vec<Term<'a>>) -> DesignProblem<'a> {
    DesignProblem {
        channels: bed.channels.clone(),
        n_samples: samples,
        convention: Convention::Hold,
        start: 0,
        terms,
    }
}

/// Gives every term the weight `w_i / J_i` of a common random record, so that structures and outputs count alike
/// whatever their units (thesis eq. 4.54 in relative form); D, a logarithm, is divided by the number of parameters.
///
/// # Errors
/// [`LoopError::Problem`] for a wrong problem.
pub fn balance(problem: &mut DesignProblem, seed: u64) -> Result<(), LoopError> {
    let record = random_record(problem, seed)?;
    let terms = std::mem::take(&mut problem.terms);
    let mut balanced = Vec::with_capacity(terms.len());
    for term in terms {
        let scale = match term.criterion {
            None => 1.0,
            Some(c) if !c.is_positive() => term.model.n_params() as f64,
            Some(_) => {
                problem.terms = vec![Term { weight: 1.0, limits: None, ..term }];
                let value = Evaluator::new(problem)?.value(&record);
                if value.is_finite() && value > 0.0 { value } else { 1.0 }
            }
        };
        balanced.push(Term { weight: term.weight / scale, ..term });
    }
    problem.terms = balanced;
    Ok(())
}

/// Designs the next record of `samples` samples for the structures at what is known of them.
///
/// # Errors
/// [`LoopError`] for a wrong problem, limits that contradict each other, or a design that failed.
pub fn next_record(
    bed: &TestBed,
    structures: &[Structure],
    known: &[Known],
    aim: &Aim,
    samples: usize,
    limits: Limits,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<DesignOutcome, LoopError> {
    let c = criterion(&aim.criterion, &aim.keys)?;
    let mut posed = problem(bed, samples, terms(structures, known, aim, c.as_ref(), limits));
    if structures.len() > 1 {
        balance(&mut posed, aim.search.seed)?;
    }
    let mut found = design(&posed, &aim.search, interrupt, &|_| {})?;
    if let Some(robust) = aim.robust {
        found.u = over_draws(&posed, &known[0], aim, robust, found.u, interrupt)?;
    }
    if interrupt() { Err(LoopError::Interrupted) } else { Ok(found) }
}

/// Predictions further away than this multiple of the nominal ones belong to no engine: such a draw does not count.
const DRAWN_RANGE: f64 = 10.0;

/// The record of least risk over draws of the estimate, from the one that is best at the estimate.
fn over_draws(
    posed: &DesignProblem,
    known: &Known,
    aim: &Aim,
    robust: RobustAim,
    nominal: Vec<f64>,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<f64>, LoopError> {
    let [term] = &posed.terms[..] else {
        return Err(LoopError::Shape {
            what: "structures of a robust design",
            found: posed.terms.len(),
            expected: 1,
        });
    };
    let n = posed.n_samples;
    let mut y = vec![0.0; n];
    let before = vec![known.mean_output; n];
    let start = term.model.max_lag().min(n);
    term.model.simulate(&known.fit.theta, &Run { u: &nominal, y: &before, start }, &mut y);
    let most = y.iter().fold(known.mean_output.abs(), |m, v| m.max(v.abs()));
    let stable = Stable { u: &nominal, initial_output: known.mean_output, bound: DRAWN_RANGE * most };
    let fit = &known.fit;
    let drawn = draws(term.model, &fit.theta, &fit.covariance, robust.draws, aim.search.seed, stable)?;
    let ensemble = Ensemble::new(posed, &drawn, &aim.search, interrupt)?;
    Ok(ensemble.design(robust.risk, &nominal, &aim.search, interrupt)?.u)
}
