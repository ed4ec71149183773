//! The entry point of the crate: a problem in, a record out.

use super::chain::{Candidate, Chain, sharpening};
use super::exchange::exchange;
use super::redraw::{Redraw, Values};
use super::{Observer, Search, search};
use crate::certificate::{Certificate, NoCertificate, certify};
use crate::channel::Layout;
use crate::error::DesignError;
use crate::problem::{DesignProblem, Evaluator};
use crate::safety::{Safety, safety};
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::{Iterate, Status};
use rayon::prelude::*;

/// How to search.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignOptions {
    /// Name of a member of [`super::SEARCHES`].
    pub search: String,
    /// Its keys.
    pub keys: toml::Table,
    /// Number of starts; the first is `start` where that is given, the others are random.
    pub starts: usize,
    /// Evaluations of the criterion per start; under output limits twice the default still pays.
    pub evaluations: usize,
    /// Seed of all random numbers.
    pub seed: u64,
    /// A record (N x m) to start from; never returned worse, if it is within the limits.
    pub start: Option<Vec<f64>>,
    /// How far inside of the limits the search aims, as a share of their range: a record that it ends with keeps the limits
    /// themselves, without any tolerance.
    pub output_tolerance: f64,
    /// Largest component of the projected gradient (search objective per unit of range) of a converged design.
    pub gradient_tolerance: f64,
    /// Decrease of the search objective over eight iterations that ends a local run.
    pub value_tolerance: f64,
    /// Whether to bound what any record could reach (seconds of work for twenty regressors).
    pub certify: bool,
}

impl Default for DesignOptions {
    fn default() -> Self {
        Self {
            search: "kicks".into(),
            keys: toml::Table::new(),
            starts: 1,
            evaluations: 4000,
            seed: 1,
            start: None,
            output_tolerance: 1e-6,
            gradient_tolerance: 1e-6,
            value_tolerance: 1e-6,
            certify: false,
        }
    }
}

/// A designed record.
#[derive(Clone, Debug)]
pub struct DesignOutcome {
    /// Input samples (N x m): bounds, holds and rate limits hold exactly.
    pub u: Vec<f64>,
    /// Weighted criterion, extremes exact, factored by QR; infinite where even the best is singular.
    pub value: f64,
    /// The same of the start of the best chain.
    pub start_value: f64,
    /// Improvements of the best chain.
    pub history: Vec<Iterate>,
    /// How the best chain ended; [`Status::Infeasible`] when an output limit does not hold.
    pub status: Status,
    /// Predicted outputs against their limits.
    pub safety: Vec<Safety>,
    /// Evaluations of all chains.
    pub evaluations: usize,
    /// What no record can beat, or why there is no such bound; none where it was not asked for.
    pub certificate: Option<Result<Certificate, NoCertificate>>,
}

/// A design could not be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The problem is wrong.
    #[error(transparent)]
    Problem(#[from] DesignError),
    /// The search is unknown or its keys are wrong.
    #[error(transparent)]
    Search(#[from] BuildError),
}

/// Designs a record: minimises the criterion of `problem` within its limits.
///
/// Bounds, holds, rate and output limits hold exactly; where output limits could not be kept,
/// the status is [`Status::Infeasible`] and [`DesignOutcome::safety`] says which output, when and by how much.
///
/// # Errors
/// [`Failure`] for a wrong problem, limits that contradict each other, an unknown search, or when no start has
/// a finite criterion.
///
/// ```
/// use dynocal_design::channel::Channel;
/// use dynocal_design::criterion::criterion;
/// use dynocal_design::problem::{Convention, DesignProblem, Term};
/// use dynocal_design::search::{DesignOptions, design};
///
/// // Torque model of thesis eq. 4.17 in the box (4.16): a D-optimal record of 100 samples.
/// let torque = dynocal_ident::model::literature::torque_4_17();
/// let d = criterion("d", &Default::default()).unwrap();
/// let problem = DesignProblem {
///     channels: vec![
///         Channel::free("fpw", 2000.0, 6000.0),
///         Channel::free("abv", 0.4, 0.6),
///         Channel::free("speed", 1000.0, 2000.0),
///     ],
///     n_samples: 100,
///     convention: Convention::Trim,
///     start: 0,
///     terms: vec![Term::new("torque", &torque.model, &torque.theta, torque.noise_variance, d.as_ref())],
/// };
/// let options = DesignOptions { evaluations: 500, ..Default::default() };
/// let found = design(&problem, &options, &|| false, &|_| {}).unwrap();
/// assert!(found.value < found.start_value - 20.0);
/// ```
pub fn design(
    problem: &DesignProblem,
    options: &DesignOptions,
    interrupt: &(dyn Fn() -> bool + Sync),
    progress: &(dyn Fn(&Iterate) + Sync),
) -> Result<DesignOutcome, Failure> {
    let method = search(&options.search, &options.keys)?;
    let prototype = Evaluator::new(problem)?;
    check_start(problem, options)?;
    check_size(prototype.layout().len(), options, method.as_ref())?;
    let observer = Observer { interrupt, progress };
    let ends: Vec<Result<End, DesignError>> = (0..options.starts.max(1))
        .into_par_iter()
        .map(|k| run_one(problem, options, method.as_ref(), prototype.clone(), k, observer))
        .collect();
    let evaluations = ends.iter().flatten().map(|e| e.evaluations).sum();
    let mut best: Option<End> = None;
    let mut failure = None;
    for end in ends {
        match end {
            Err(e) => failure = Some(e),
            Ok(end) if best.as_ref().is_none_or(|b| end.rank() < b.rank()) => best = Some(end),
            Ok(_) => {}
        }
    }
    match (best, failure) {
        (Some(best), _) => {
            let mut found = finish(problem, prototype, best, evaluations, interrupt());
            if options.certify && !interrupt() {
                found.certificate = Some(certify(problem, found.value));
            }
            Ok(found)
        }
        (None, Some(e)) => Err(e.into()),
        (None, None) => Err(DesignError::NoStart { tried: 0, detail: "no start was run".into() }.into()),
    }
}

/// What one start led to.
struct End {
    best: Candidate,
    feasible: bool,
    start_value: f64,
    history: Vec<Iterate>,
    evaluations: usize,
}

impl End {
    /// Feasible first, then by objective or violation.
    fn rank(&self) -> (bool, f64) {
        (!self.feasible, if self.feasible { self.best.f } else { self.best.violation })
    }
}

fn check_start(problem: &DesignProblem, options: &DesignOptions) -> Result<(), DesignError> {
    let expected = problem.n_samples * problem.channels.len();
    match &options.start {
        Some(u) if u.len() != expected => {
            Err(DesignError::Shape { what: "start record".into(), found: u.len(), expected })
        }
        _ => Ok(()),
    }
}

fn check_size(n: usize, options: &DesignOptions, method: &dyn Search) -> Result<(), DesignError> {
    let most = method.most_variables();
    if n <= most {
        return Ok(());
    }
    Err(DesignError::Number {
        what: format!("search {}: free values", options.search),
        found: n as f64,
        expected: format!("at most {most} (dense matrices); `kicks` or `local` take more"),
    })
}

fn run_one(
    problem: &DesignProblem,
    options: &DesignOptions,
    method: &dyn Search,
    evaluator: Evaluator,
    k: usize,
    observer: Observer,
) -> Result<End, DesignError> {
    let layout = evaluator.layout().clone();
    let mut chain = Chain::new(evaluator, options, k as u64, observer);
    let mut x = vec![0.0; layout.len()];
    match &options.start {
        Some(u) if k == 0 => layout.read(u, &mut x),
        _ => draw(problem, &layout, &mut chain, &mut x)?,
    }
    let (f, violation) = chain.value(&x);
    chain.note(f, violation, f64::NAN);
    chain.offer(Candidate { x: x.clone(), f, violation, converged: false, multipliers: None });
    let start_value = chain.evaluator.undo_logarithm(f);
    method.run(&mut chain, &x);
    chain.sharpen(sharpening(options));
    exchange(&mut chain, problem, options.evaluations);
    let Some(best) = chain.best.take() else {
        return Err(no_start(problem, &mut chain, &x, 1));
    };
    let feasible = chain.feasible(best.violation);
    Ok(End { best, feasible, start_value, history: chain.history, evaluations: chain.evaluator.count() })
}

/// A random start: uniform values, or a random walk with the largest steps where a rate is limited; drawn towards
/// the middle of the box while a model diverges or leaves its limits by more than their range on average. Then blocks are
/// drawn anew until the outputs keep their limits: that record is offered, so that one is known whatever the search finds.
fn draw(
    problem: &DesignProblem,
    layout: &Layout,
    chain: &mut Chain,
    x: &mut [f64],
) -> Result<(), DesignError> {
    let (lower, upper) = layout.bounds();
    for j in 0..x.len() {
        x[j] = chain.rng.uniform_in(lower[j], upper[j]);
    }
    for r in layout.rates() {
        let step = if chain.rng.uniform() < 0.5 { r.limit } else { -r.limit };
        let there = x[r.j - 1] + step;
        x[r.j] = if there < lower[r.j] || there > upper[r.j] { x[r.j - 1] - step } else { there };
    }
    layout.repair(x);
    const HALVINGS: usize = 6;
    for _ in 0..=HALVINGS {
        let (f, violation) = chain.value(x);
        if f.is_finite() && chain.violation(x) < 1.0 {
            offer_within(problem, layout, chain, x, violation);
            return Ok(());
        }
        for j in 0..x.len() {
            x[j] = 0.5 * (x[j] + 0.5 * (lower[j] + upper[j]));
        }
        layout.repair(x);
    }
    match chain.value(x).0.is_finite() {
        true => Ok(()),
        false => Err(no_start(problem, chain, x, HALVINGS + 1)),
    }
}

/// Offers the record near `x` whose outputs keep their limits, where draws lead to one.
fn offer_within(problem: &DesignProblem, layout: &Layout, chain: &mut Chain, x: &[f64], violation: f64) {
    if violation <= 0.0 {
        return;
    }
    let mut within = x.to_vec();
    let mut rng = Rng64::new(chain.rng.below(1 << 48) as u64);
    let mut redraw = Redraw::new(problem, layout, chain.evaluator.aimed_inside(), Values::Uniform);
    if layout.round(&mut within) && redraw.settle(&mut rng, &mut within, &|| chain.interrupted()) {
        let (f, violation) = chain.value(&within);
        chain.offer(Candidate { x: within, f, violation, converged: false, multipliers: None });
    }
}

/// Says why a start has no finite criterion: a model that diverges, or parameters that cannot be seen.
fn no_start(problem: &DesignProblem, chain: &mut Chain, x: &[f64], tried: usize) -> DesignError {
    chain.value(x);
    for (i, term) in problem.terms.iter().enumerate().filter(|(_, t)| t.criterion.is_some()) {
        if chain.evaluator.output(i).iter().any(|y| !y.is_finite()) {
            return DesignError::Diverged { term: term.name.into(), record: "a random start".into() };
        }
        let mut rows = chain.evaluator.sensitivities(i).to_vec();
        rows.extend_from_slice(term.prior);
        if let crate::information::Report::Singular(s) =
            crate::information::report(term.model, &rows, term.noise_variance, &[])
        {
            return DesignError::NoStart { tried, detail: format!("{}: {s}", term.name) };
        }
    }
    DesignError::NoStart { tried, detail: "the criterion is not finite".into() }
}

fn finish(
    problem: &DesignProblem,
    mut evaluator: Evaluator,
    best: End,
    evaluations: usize,
    interrupted: bool,
) -> DesignOutcome {
    let mut u = vec![0.0; problem.n_samples * problem.channels.len()];
    evaluator.layout().fill(&best.best.x, &mut u);
    let value = evaluator.value(&u);
    let status = match (interrupted, best.feasible, best.best.converged) {
        (true, _, _) => Status::Interrupted,
        (_, false, _) => Status::Infeasible,
        (_, _, true) => Status::Converged,
        _ => Status::Limit,
    };
    DesignOutcome {
        safety: safety(problem, &evaluator),
        u,
        value,
        start_value: best.start_value,
        history: best.history,
        status,
        evaluations,
        certificate: None,
    }
}

/// Random stream numbers from this one on are free for callers that share a seed with the search.
pub const FIRST_FREE_STREAM: u64 = 1 << 32;

/// A uniformly distributed random record (UDRN) in the boxes of `problem`, within its rates and holds.
///
/// # Errors
/// What [`DesignProblem::check`] finds.
pub fn random_record(problem: &DesignProblem, seed: u64) -> Result<Vec<f64>, DesignError> {
    let layout = problem.check()?;
    let mut rng = Rng64::stream(seed, FIRST_FREE_STREAM);
    let (lower, upper) = layout.bounds();
    let mut x: Vec<f64> = (0..layout.len()).map(|j| rng.uniform_in(lower[j], upper[j])).collect();
    layout.repair(&mut x);
    layout.round(&mut x);
    let mut u = vec![0.0; problem.n_samples * problem.channels.len()];
    layout.fill(&x, &mut u);
    Ok(u)
}

/// A random record within all limits, those of the outputs too: drawn from `values`, then blocks are drawn anew where an
/// output passes its limits. The second number is the share of free values that were drawn anew; none where no record was
/// found that keeps all limits.
///
/// # Errors
/// What [`DesignProblem::check`] finds.
pub fn random_record_within(
    problem: &DesignProblem,
    values: Values,
    rng: &mut Rng64,
) -> Result<Option<(Vec<f64>, f64)>, DesignError> {
    let layout = problem.check()?;
    let mut redraw = Redraw::new(problem, &layout, 0.0, values);
    let mut x = vec![0.0; layout.len()];
    redraw.draw(rng, &mut x);
    let drawn = x.clone();
    if !redraw.is_free() && !redraw.settle(rng, &mut x, &|| false) {
        return Ok(None);
    }
    let anew = x.iter().zip(&drawn).filter(|(a, b)| a != b).count() as f64 / x.len() as f64;
    let mut u = vec![0.0; problem.n_samples * problem.channels.len()];
    layout.fill(&x, &mut u);
    Ok(Some((u, anew)))
}
