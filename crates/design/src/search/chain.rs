//! What every search shares: one evaluator, its budget, constrained local runs, the best design so far.

use super::lbfgs::{Ended, Lbfgs, Stop};
use super::{DesignOptions, Observer};
use crate::problem::{Evaluator, Multipliers};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Iterate;

/// A design in the free variables.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub(crate) x: Vec<f64>,
    /// Search objective.
    pub(crate) f: f64,
    /// Sum over all samples of what the outputs pass their limits by, in shares of the range; zero exactly where every
    /// limit is kept (rates and bounds always are).
    pub(crate) violation: f64,
    pub(crate) converged: bool,
    /// Multipliers at the end, for warm starts.
    pub(crate) multipliers: Option<Multipliers>,
}

/// State of one search from one start.
pub struct Chain<'w, 'a> {
    pub(crate) evaluator: Evaluator<'a>,
    pub(crate) rng: Rng64,
    pub(crate) best: Option<Candidate>,
    pub(crate) history: Vec<Iterate>,
    solver: Lbfgs,
    budget: usize,
    decrease: f64,
    gradient: f64,
    extreme: bool,
    constrained: bool,
    observer: Observer<'w>,
    sink: Vec<f64>,
    /// Constrained runs whose Lagrangian stays above this value are given up.
    pub(crate) give_up: f64,
}

/// First penalty of a constraint violation in units of its range: small, so that the search first finds a good record
/// and then moves it into the limits; large ones freeze the constraints that the start happens to meet.
const FIRST_PENALTY: f64 = 1.0;

/// Orders of the p-norms when the search is over: from the smooth landscape to the maximum itself.
const FINAL_SHARPNESS: [f64; 4] = [120.0, 400.0, 1500.0, 6000.0];

/// Order of the p-norms at the end of a search, and on the way to it.
const SHARPNESS: [f64; 3] = [8.0, 30.0, 120.0];

/// Precision of a local run after a kick under output limits, as a multiple of that of others.
const STEPPED_PRECISION: f64 = 30.0;
/// Penalties of such a run, one after the other.
const STEPPED_PENALTIES: [f64; 6] = [5.0, 25.0, 125.0, 625.0, 3125.0, 15_625.0];
/// Sum of violations (in ranges) below which the end of a local run is moved into its limits, and evaluations for it.
const RESTORED: f64 = 0.05;
const RESTORATION: usize = 60;

/// Order at which a p-norm is the maximum but for the last digits.
const EXACT: f64 = 1e6;

/// Evaluations that a search leaves for [`Chain::sharpen`].
pub(super) fn sharpening(options: &DesignOptions) -> usize {
    options.evaluations / 8
}

impl<'w, 'a> Chain<'w, 'a> {
    pub(crate) fn new(
        mut evaluator: Evaluator<'a>,
        options: &DesignOptions,
        stream: u64,
        observer: Observer<'w>,
    ) -> Self {
        let n = evaluator.layout().len();
        evaluator.aim_inside(options.output_tolerance);
        let constrained = evaluator.multipliers(1.0).is_some();
        let extreme = evaluator.has_extreme();
        Self {
            evaluator,
            rng: Rng64::stream(options.seed, stream),
            best: None,
            history: Vec::new(),
            solver: Lbfgs::new(n),
            budget: options.evaluations - if extreme { sharpening(options) } else { 0 },
            decrease: options.value_tolerance,
            gradient: options.gradient_tolerance,
            extreme,
            constrained,
            observer,
            sink: Vec::new(),
            give_up: f64::INFINITY,
        }
    }

    /// Evaluations left.
    pub(crate) fn left(&self) -> usize {
        if self.interrupted() { 0 } else { self.budget.saturating_sub(self.evaluator.count()) }
    }

    /// A budget of `evaluations` more from here.
    pub(crate) fn grant(&mut self, evaluations: usize) {
        self.budget = self.evaluator.count() + evaluations;
    }

    pub(crate) fn interrupted(&self) -> bool {
        (self.observer.interrupt)()
    }

    pub(crate) fn is_constrained(&self) -> bool {
        self.constrained
    }

    fn last_sharpness(&self) -> f64 {
        SHARPNESS[SHARPNESS.len() - 1]
    }

    /// Objective and output violation at `x` without derivatives.
    pub(crate) fn value(&mut self, x: &[f64]) -> (f64, f64) {
        let sharpness = self.last_sharpness();
        let f = self.evaluator.objective(x, sharpness, None, &mut []);
        if !f.is_finite() {
            return (f, f64::INFINITY);
        }
        // A region that is not kept is worse than any output.
        let region = self.evaluator.layout().region_violation(x);
        let region = if region > 0.0 { 1e6 + region } else { 0.0 };
        (f, self.evaluator.output_violation().1 + region)
    }

    /// Largest violation of the limits themselves, without what the search aims inside of them, by the record `x` that was
    /// evaluated last: zero exactly where all are kept.
    pub(crate) fn violation(&self, x: &[f64]) -> f64 {
        self.evaluator.output_violation().0.max(self.evaluator.layout().coupling_violation(x))
    }

    /// Local run from `x` with at most `budget` evaluations; `warm` multipliers spare the outer iterations.
    ///
    /// `rough` stops early: enough to tell whether a kick leads anywhere.
    pub(crate) fn refine(
        &mut self,
        x: &[f64],
        budget: usize,
        rough: bool,
        warm: Option<Multipliers>,
    ) -> Candidate {
        let end = self.evaluator.count() + budget.min(self.left());
        let mut x = x.to_vec();
        self.evaluator.layout().repair(&mut x);
        let factor = if rough { 30.0 } else { 1.0 };
        let first = if self.extreme && !rough { 0 } else { SHARPNESS.len() - 1 };
        let mut multipliers = warm;
        let mut ended = Ended { value: f64::INFINITY, converged: false, optimality: f64::INFINITY };
        for q in &SHARPNESS[first..] {
            let stages = SHARPNESS.len() - first;
            let left = end.saturating_sub(self.evaluator.count());
            let share = if *q == self.last_sharpness() { left } else { left / stages };
            ended = if self.constrained {
                self.constrained_run(&mut x, *q, share, factor, &mut multipliers)
            } else {
                self.smooth_run(&mut x, *q, share, factor, None)
            };
        }
        self.ended(x, ended, multipliers)
    }

    /// The same after a kick: `multipliers` are those of the design before it, and the penalty rises in fixed steps.
    pub(crate) fn refine_kicked(
        &mut self,
        x: &[f64],
        budget: usize,
        multipliers: Option<Multipliers>,
    ) -> Candidate {
        let (mut x, mut warm) = (x.to_vec(), multipliers);
        let ended = self.stepped_run(&mut x, budget.min(self.left()), &mut warm);
        self.ended(x, ended, warm)
    }

    /// The end of a local run as a design: moved into bounds, rates and regions, then into the output limits.
    fn ended(&mut self, mut x: Vec<f64>, ended: Ended, multipliers: Option<Multipliers>) -> Candidate {
        self.evaluator.layout().repair(&mut x);
        let (mut f, mut violation) = self.value(&x);
        if violation > 0.0 && violation < RESTORED {
            self.restore(&mut x);
            (f, violation) = self.value(&x);
        }
        self.note(f, violation, ended.optimality);
        Candidate { x, f, violation, converged: ended.converged, multipliers }
    }

    /// Moves `x` by least squares of the violations to where the search aims, a little inside of all limits.
    fn restore(&mut self, x: &mut [f64]) {
        let layout = self.evaluator.layout();
        let (lower, upper) = (layout.bounds().0.to_vec(), layout.bounds().1.to_vec());
        let stop = Stop { evaluations: RESTORATION.min(self.left()), gradient: 0.0, decrease: 0.0 };
        let evaluator = &mut self.evaluator;
        let mut tried = x.to_vec();
        let mut f = |x: &[f64], g: &mut [f64]| evaluator.shortfall(x, g);
        self.solver.minimise(&mut f, &lower, &upper, &mut tried, &stop);
        self.evaluator.layout().repair(&mut tried);
        x.copy_from_slice(&tried);
    }

    /// Local runs from the best design towards the maximum itself, kept where its exact value falls and limits hold.
    pub(crate) fn sharpen(&mut self, budget: usize) {
        let Some(best) = self.best.clone().filter(|_| self.extreme) else { return };
        self.budget += budget;
        let exact = |chain: &mut Self, x: &[f64]| chain.evaluator.objective(x, EXACT, None, &mut []);
        let mut value = exact(self, &best.x);
        let (mut x, mut multipliers) = (best.x.clone(), best.multipliers.clone());
        for (k, q) in FINAL_SHARPNESS.into_iter().enumerate() {
            let share = self.left().saturating_sub(2) / (FINAL_SHARPNESS.len() - k);
            let ended = match self.constrained {
                true => self.constrained_run(&mut x, q, share, 1.0, &mut multipliers),
                false => self.smooth_run(&mut x, q, share, 1.0, None),
            };
            self.evaluator.layout().repair(&mut x);
            let found = exact(self, &x);
            let violation = self.evaluator.output_violation().1;
            if found < value && self.feasible(violation) >= self.feasible(best.violation) {
                value = found;
                let (f, _) = self.value(&x);
                self.best = Some(Candidate {
                    x: x.clone(),
                    f,
                    violation,
                    converged: ended.converged,
                    multipliers: multipliers.clone(),
                });
            }
        }
    }

    fn smooth_run(
        &mut self,
        x: &mut [f64],
        q: f64,
        budget: usize,
        factor: f64,
        multipliers: Option<&Multipliers>,
    ) -> Ended {
        let layout = self.evaluator.layout();
        let (lower, upper) = (layout.bounds().0.to_vec(), layout.bounds().1.to_vec());
        let stop =
            Stop { evaluations: budget, gradient: self.gradient * factor, decrease: self.decrease * factor };
        let (evaluator, interrupt) = (&mut self.evaluator, self.observer.interrupt);
        let mut f = |x: &[f64], g: &mut [f64]| {
            // An interrupted run meets bad trials only and ends at its best point.
            if interrupt() { f64::NAN } else { evaluator.objective(x, q, multipliers, g) }
        };
        self.solver.minimise(&mut f, &lower, &upper, x, &stop)
    }

    /// Augmented Lagrangian: local runs on the box with multipliers for rates and outputs in between.
    fn constrained_run(
        &mut self,
        x: &mut [f64],
        q: f64,
        budget: usize,
        factor: f64,
        warm: &mut Option<Multipliers>,
    ) -> Ended {
        let end = self.evaluator.count() + budget;
        let warmed = warm.is_some();
        let mut mu = match warm.take().or_else(|| self.evaluator.multipliers(FIRST_PENALTY)) {
            Some(mu) => mu,
            None => return self.smooth_run(x, q, budget, factor, None),
        };
        let (mut before, mut value_before) = (f64::INFINITY, f64::INFINITY);
        let mut ended = Ended { value: f64::INFINITY, converged: false, optimality: f64::INFINITY };
        for outer in 0..40 {
            let left = end.saturating_sub(self.evaluator.count());
            if left < 3 || self.interrupted() {
                break;
            }
            // Early multipliers are guesses, so that early runs need no precision.
            let loose = if warmed { factor } else { factor * f64::max(1.0, 100.0 * 0.2f64.powi(outer)) };
            ended = self.smooth_run(x, q, (left / 3).clamp(2, 150).min(left - 1), loose, Some(&mu));
            let f = self.evaluator.objective(x, q, Some(&mu), &mut []);
            let violation = self.violation(x);
            self.evaluator.update(x, &mut mu);
            if violation > 0.3 * before && violation > 0.0 {
                mu.penalty = (3.0 * mu.penalty).min(1e7);
            }
            let settled = (f - value_before).abs() <= 10.0 * self.decrease * factor;
            // The Lagrangian approaches the constrained optimum from below: a run that is above the best already will
            // not come back.
            if outer > 0 && f > self.give_up {
                break;
            }
            if violation == 0.0 && (settled || outer > 15) {
                *warm = Some(mu);
                return ended;
            }
            (before, value_before) = (violation.min(before), f);
        }
        *warm = Some(mu);
        Ended { converged: false, ..ended }
    }

    /// The augmented Lagrangian with a penalty that rises in fixed steps: what a kick has moved away from its limits has
    /// first to find a good place, and what is left of violations is for the restoration.
    fn stepped_run(&mut self, x: &mut [f64], budget: usize, warm: &mut Option<Multipliers>) -> Ended {
        let mut ended = Ended { value: f64::INFINITY, converged: false, optimality: f64::INFINITY };
        let Some(mut mu) = warm.take().or_else(|| self.evaluator.multipliers(FIRST_PENALTY)) else {
            return ended;
        };
        let (end, q) = (self.evaluator.count() + budget, self.last_sharpness());
        for (k, penalty) in STEPPED_PENALTIES.into_iter().enumerate() {
            let left = end.saturating_sub(self.evaluator.count());
            if left < 3 || self.interrupted() {
                break;
            }
            mu.penalty = penalty;
            let share = (left / (STEPPED_PENALTIES.len() - k)).max(2);
            ended = self.smooth_run(x, q, share, STEPPED_PRECISION, Some(&mu));
            let f = self.evaluator.objective(x, q, Some(&mu), &mut []);
            self.evaluator.update(x, &mut mu);
            if f > self.give_up {
                break;
            }
        }
        *warm = Some(mu);
        ended
    }

    /// Whether the output limits hold.
    pub(crate) fn feasible(&self, violation: f64) -> bool {
        violation <= 0.0
    }

    /// Whether `a` is better than `b`: feasible before infeasible, then by violation or objective.
    pub(crate) fn better(&self, a: (f64, f64), b: (f64, f64)) -> bool {
        match (self.feasible(a.1), self.feasible(b.1)) {
            (true, true) => a.0 < b.0,
            (false, false) => a.1 < b.1,
            (feasible, _) => feasible && a.0.is_finite(),
        }
    }

    /// Takes `candidate` as the best design if it is better than the present one.
    pub(crate) fn offer(&mut self, candidate: Candidate) -> bool {
        let better = match &self.best {
            None => candidate.f.is_finite(),
            Some(b) => self.better((candidate.f, candidate.violation), (b.f, b.violation)),
        };
        if better {
            self.best = Some(candidate);
        }
        better
    }

    /// One line of history.
    pub(crate) fn note(&mut self, f: f64, violation: f64, optimality: f64) {
        let best = self.best.as_ref().map_or(f, |b| b.f);
        let improved = self.history.is_empty() || f < best;
        let objective = self.evaluator.undo_logarithm(f);
        let line = Iterate { evaluations: self.evaluator.count(), objective, violation, optimality };
        if improved {
            self.history.push(line);
        }
        (self.observer.progress)(&line);
    }

    /// Scratch of the length of the variables.
    pub(crate) fn scratch(&mut self) -> Vec<f64> {
        self.sink.resize(self.evaluator.layout().len(), 0.0);
        self.sink.clone()
    }
}
