//! Functions with many labels or samples: Gauss-Newton steps by conjugate gradients on the products `J v` and `J'u`, J never held.
//!
//! ```text
//! step     (J'WJ + R + V + mu diag) p = J'Wr - R (theta - base) - V (theta - base)     over the cells that are free and off their bounds
//! then     theta+ = theta + p, back within the bounds
//! ```
//!
//! R is the roughness, V the weight of the base. The conjugate gradients are preconditioned on two levels (`system::Levels`): by bands
//! within labels that are read at one place, and by a matrix between coarse functions of all labels, both of J'WJ as if the function had
//! no memory, in the size of the diagonal, with the roughness. The diagonal is the mean square of `J'sqrt(W) e` over random signs e (M. F. Hutchinson, A stochastic estimator of the
//! trace of the influence matrix, Commun. Stat. Simul. 19 (1990), 433-450). A step's equations are solved only as far as the step is right
//! (R. S. Dembo, S. C. Eisenstat, T. Steihaug, Inexact Newton methods, SIAM J. Numer. Anal. 19 (1982), 400-408). Cells at a bound that
//! the gradient points beyond stay there (D. P. Bertsekas, Projected Newton methods, SIAM J. Control Optim. 20 (1982), 221-246).
//! Intervals come from draws of the posterior, each the solution for one draw of the noise.
//!
//! What times a memory (delays, time constants, shares of a film) is held until the other labels fit, and changes by half of itself a
//! step at most (`timing.rs`). Where samples are many the search begins with the first quarter of each record.

mod system;
pub(super) mod timing;
mod told;

use std::sync::Arc;

use super::{FIRST_SMOOTH, Found, Target, not_finite};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::graph::forward::Run;
use crate::graph::products::Products;
use crate::graph::products::front::Front;
use crate::linear::{Options, huber};
use dynocal_numerics::linalg::{dot, norm2};
use system::{Exact, Levels, Pairs, System};
use timing::Timing;

/// Cells that a delay, lag or film is timed by, and shares of a film.
pub(super) fn times_a_memory(graph: &Graph) -> Vec<bool> {
    timing::timing(graph)
}

/// Most steps of a round.
const MOST_STEPS: usize = 60;
/// Most times that sizes are taken, and the change of one, as a share, up to which they need not be.
const MOST_ROUNDS: usize = 4;
const NEAR: f64 = 1e-2;
/// A search begins with one in so many samples, where these are at least so many for each cell and so many in all, and until a step
/// gains less than this share. With fewer for each cell it would fit their noise, and the equations would be the harder for it.
const PART: usize = 4;
const PART_SAMPLES_A_CELL: usize = 16;
const LEAST_PART: usize = 1 << 14;
const ENOUGH: f64 = 0.1;
/// Change of the labels, as a share of their size, below which they stand.
const STANDS: f64 = 1e-6;
/// Square of a step in standard errors, as the mean over all labels, below which they stand.
const SURE: f64 = 1e-8;
/// How exact steps are at most, and the first ones, which are far from where they lead.
const LATER: Exact = Exact { left: 1e-2, most: 100 };
const FIRST: Exact = Exact { left: 0.1, most: 12 };
/// Damping below which a step is as long as the equations have it.
const DAMPED: f64 = 1e-3;
/// Share of the cost that a step may promise and rounding take.
const ROUNDING: f64 = 1e-10;
/// Rounds of the robust loss.
const ROUNDS: usize = 10;

/// Numbers of J beyond which it is not held: 1 GiB of them.
const MOST_HELD: usize = 1 << 27;

/// Whether a function of so many cells and samples goes this way.
pub(super) fn is_large(cells: usize, samples: usize) -> bool {
    cells > super::MOST_CELLS || cells.saturating_mul(samples) > MOST_HELD
}

/// The function at a point.
struct State {
    runs: Vec<Run>,
    cost: f64,
}

/// What no label changes, of each target.
fn fronts(graph: &Graph, targets: &[Target]) -> Vec<Arc<Front>> {
    targets.iter().map(|t| Arc::new(Front::new(graph, &t.record, t.node_of(graph)))).collect()
}

/// Weighted squares and the runs of all targets; none where a sample is no number.
fn evaluate(
    graph: &Graph,
    theta: &[f64],
    targets: &[Target],
    fronts: &[Arc<Front>],
    weights: &[Vec<f64>],
) -> Option<State> {
    let (mut runs, mut cost) = (Vec::new(), 0.0);
    for ((t, front), w) in targets.iter().zip(fronts).zip(weights) {
        let run = front.run(graph, theta, &t.record);
        let y = &run.values[t.node_of(graph)];
        for k in (0..t.y.len()).filter(|k| w[*k] > 0.0) {
            cost += w[k] * (t.y[k] - y[k]).powi(2);
        }
        runs.push(run);
    }
    cost.is_finite().then_some(State { runs, cost })
}

/// Fits without holding J, whatever the size: as [`super::fit_from`], but for what [`crate::nonlinear`] says of it.
///
/// # Errors
/// As [`super::fit_from`]; a label with limits on gradients or curvature.
pub fn fit(
    graph: &Graph,
    start: &[f64],
    targets: &[Target],
    options: &Options,
    interrupt: &dyn Fn() -> bool,
) -> Result<Found, LabelError> {
    let channels = targets.first().map_or(0, |t| t.record.channels.len());
    graph.check(channels)?;
    if let Some(l) = graph.labels.iter().find(|l| !l.limits().is_empty()) {
        let reason = format!(
            "gradients and curvature are limited in functions of at most {} cells and of at most {MOST_HELD} for cells times samples; found {} cells and {} samples",
            super::MOST_CELLS,
            start.len(),
            targets.iter().map(|t| t.counts().count()).sum::<usize>()
        );
        return Err(LabelError::label(&l.name, reason));
    }
    if let Some(node) = graph.model() {
        let reason = format!(
            "a model is a node of functions of at most {} cells and {MOST_HELD} cells times samples, found {} cells",
            super::MOST_CELLS,
            start.len()
        );
        return Err(LabelError::Node { node: node.name.clone(), reason });
    }
    let mut weights: Vec<Vec<f64>> = targets.iter().map(|t| t.weights.to_vec()).collect();
    if !weights.iter().flatten().any(|w| *w > 0.0) {
        return Err(LabelError::TooFew { found: 0, expected: start.len() });
    }
    let sample_s = timing::sample_s(targets);
    let mut theta = within(graph, &timing::seen(graph, start, sample_s));
    let held = vec![false; start.len()];
    let timing = Arc::new(Timing::new(graph, &theta, sample_s));
    let mut search = Search {
        graph,
        targets,
        fronts: fronts(graph, targets),
        options,
        interrupt,
        levels: None,
        held,
        timing,
        promised: [0.0; 2],
        pairs: Pairs::default(),
        steps: 0,
        converged: false,
    };
    let mut system = search.run(&mut theta, &weights)?;
    let plain = weights.clone();
    for _ in 0..if options.robust { ROUNDS } else { 0 } {
        let before = theta.clone();
        weights = weighed(&system, &plain);
        drop(system);
        system = search.run(&mut theta, &weights)?;
        if stands(&theta, &before) || interrupt() {
            break;
        }
    }
    let fit = told::tell(graph, &theta, targets, &system, options)?;
    Ok(Found { fit, steps: search.steps, converged: search.converged })
}

/// Within the bounds; a locked cell is its base.
fn within(graph: &Graph, theta: &[f64]) -> Vec<f64> {
    let cells = graph.labels.iter().flat_map(|l| (0..l.len()).map(move |k| (l, k)));
    let held = |(l, k): (&crate::label::Label, usize), v: f64| {
        if l.locked[k] { l.base[k] } else { v.clamp(l.lower, l.upper) }
    };
    cells.zip(theta).map(|(at, v)| held(at, *v)).collect()
}

fn stands(a: &[f64], b: &[f64]) -> bool {
    let change: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    norm2(&change) <= STANDS * (STANDS + norm2(a))
}

/// Weights of the robust loss, from what is left of all samples.
fn weighed(system: &System, plain: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let (left, all) = (system.residuals.concat(), plain.concat());
    let knee = Some(huber::knee(&left, &all));
    let one = |(r, w): (&Vec<f64>, &Vec<f64>)| {
        r.iter().zip(w).map(|(r, w)| w * huber::share(*r, *w, knee)).collect()
    };
    system.residuals.iter().zip(plain).map(one).collect()
}

struct Search<'a> {
    graph: &'a Graph,
    targets: &'a [Target<'a>],
    fronts: Vec<Arc<Front>>,
    options: &'a Options,
    interrupt: &'a dyn Fn() -> bool,
    levels: Option<Arc<Levels>>,
    /// Cells that do not move.
    held: Vec<bool>,
    timing: Arc<Timing>,
    /// What the last two steps promised to take from the cost.
    promised: [f64; 2],
    /// What the equations of earlier steps have told of the matrix.
    pairs: Pairs,
    steps: usize,
    converged: bool,
}

/// How far a round goes: most steps, how exact they are, and the share of the cost that a step must take away for another one.
struct Reach {
    steps: usize,
    exact: Exact,
    gain: f64,
}

impl<'a> Search<'a> {
    /// Moves `theta` to a minimum; the equations there. Sizes are taken anew where they have changed since.
    fn run(&mut self, theta: &mut Vec<f64>, weights: &[Vec<f64>]) -> Result<System<'a>, LabelError> {
        if self.steps == 0 {
            self.begin(theta, weights)?;
        }
        let mut round = 1;
        loop {
            let system = self.round(theta, weights, &Reach { steps: MOST_STEPS, exact: LATER, gain: 0.0 })?;
            if round == MOST_ROUNDS || (self.interrupt)() || !self.converged {
                return Ok(system);
            }
            let grown = system.grown();
            if grown <= NEAR {
                return Ok(system);
            }
            round += 1;
        }
    }

    /// The way from the start to where steps may be long. First what times a memory is held and the others are fitted: a film that sees
    /// nothing but the start's mistakes goes anywhere. Where samples are many, one in some of them is enough for a start.
    fn begin(&mut self, theta: &mut Vec<f64>, weights: &[Vec<f64>]) -> Result<(), LabelError> {
        let samples: usize = self.targets.iter().map(|t| t.y.len()).sum();
        let part = |n: usize| match samples < PART * (PART_SAMPLES_A_CELL * theta.len()).max(LEAST_PART) {
            true => n,
            false => n.div_ceil(PART),
        };
        let targets: Vec<Target> = self.targets.iter().map(|t| t.first(part(t.y.len()))).collect();
        let weights_of_part: Vec<Vec<f64>> = weights.iter().map(|w| w[..part(w.len())].to_vec()).collect();
        if !weights_of_part.iter().flatten().any(|w| *w > 0.0) {
            return Ok(());
        }
        if part(samples) < samples && self.levels.is_none() {
            // The matrices are those of all samples.
            self.round(theta, weights, &Reach { steps: 0, exact: FIRST, gain: 0.0 })?;
        }
        let (graph, options, interrupt) = (self.graph, self.options, self.interrupt);
        let (levels, timing) = (self.levels.take(), self.timing.clone());
        let targets = &targets;
        let mut search = Search {
            graph,
            targets,
            fronts: fronts(graph, targets),
            options,
            interrupt,
            levels,
            held: timing.times.clone(),
            timing,
            promised: [0.0; 2],
            pairs: Pairs::default(),
            steps: 0,
            converged: false,
        };
        let reach = Reach { steps: MOST_STEPS, exact: FIRST, gain: ENOUGH };
        if search.held.contains(&true) {
            search.round(theta, &weights_of_part, &reach)?;
            search.held.fill(false);
        }
        search.round(theta, &weights_of_part, &reach)?;
        self.steps += search.steps;
        self.levels = search.levels;
        Ok(())
    }

    fn round(
        &mut self,
        theta: &mut Vec<f64>,
        weights: &[Vec<f64>],
        reach: &Reach,
    ) -> Result<System<'a>, LabelError> {
        let (graph, targets) = (self.graph, self.targets);
        let wrong = |theta: &[f64]| not_finite(graph, theta, targets);
        let state = evaluate(graph, theta, targets, &self.fronts, weights).ok_or_else(|| wrong(theta))?;
        let smooth = self.options.smooth.unwrap_or(FIRST_SMOOTH);
        let products = self.products(theta, state.runs);
        let mut system = System::new(graph, products, targets, weights, self.options, smooth);
        let mut cost = state.cost;
        // A cell without data has its base, wherever the search starts.
        let known = system.known(theta);
        if known != *theta {
            *theta = known;
            let state = evaluate(graph, theta, targets, &self.fronts, weights).ok_or_else(|| wrong(theta))?;
            cost = state.cost;
            system.move_to(self.products(theta, state.runs));
        }
        system.near_to(graph, self.levels.as_ref())?;
        self.levels = system.levels().cloned();
        cost += system.cost_of_base(theta);
        let mut mu = DAMPED;
        (self.converged, self.promised) = (false, [0.0; 2]);
        for _ in 0..reach.steps {
            if self.converged || (self.interrupt)() {
                break;
            }
            self.steps += 1;
            let before = cost;
            if !self.step(theta, &mut cost, &mut mu, reach.exact, &mut system, weights)?
                || before - cost < reach.gain * before
            {
                break;
            }
        }
        Ok(system)
    }

    /// One step that lowers the cost; whether there was one.
    fn step(
        &mut self,
        theta: &mut Vec<f64>,
        cost: &mut f64,
        mu: &mut f64,
        exact: Exact,
        system: &mut System<'a>,
        weights: &[Vec<f64>],
    ) -> Result<bool, LabelError> {
        let g = system.gradient(theta);
        let (mut tried, mut promised) = (0, f64::INFINITY);
        let samples = weights.iter().flatten().filter(|w| **w > 0.0).count() as f64;
        let sure = SURE * theta.len() as f64 / samples;
        let exact = self.exact(exact);
        loop {
            let p = system.step(&g, theta, &self.held, *mu, exact, &mut self.pairs, self.interrupt)?;
            let mut moved: Vec<f64> = theta.iter().zip(&p).map(|(a, b)| a + b).collect();
            // Far away a film or a lag may be none, and then nothing leads back.
            let short = self.timing.shorten(theta, &mut moved);
            let next = within(self.graph, &moved);
            let own = dot(&g, &p);
            let small = *mu <= DAMPED && !short && (stands(&next, theta) || own <= sure * *cost);
            if tried == 0 {
                promised = own;
                self.promised = [own, self.promised[0]];
            }
            let new = evaluate(self.graph, &next, self.targets, &self.fronts, weights);
            let better = new.map(|s| (s.cost + system.cost_of_base(&next), s)).filter(|(c, _)| *c < *cost);
            if let Some((c, found)) = better {
                self.converged = small || (*mu <= DAMPED && *cost - c <= 1e-14 * *cost);
                (*theta, *cost) = (next, c);
                system.move_to(self.products(theta, found.runs));
                *mu = (*mu * 0.1).max(1e-12);
                return Ok(true);
            }
            (*mu, tried) = (*mu * 10.0, tried + 1);
            // No direction is better to rounding.
            if small || tried > 15 || (self.interrupt)() {
                self.converged = small || promised <= ROUNDING * *cost;
                return Ok(false);
            }
        }
    }

    /// How exact the next step is: as much as the last one was right (S. C. Eisenstat, H. F. Walker, Choosing the forcing terms in an
    /// inexact Newton method, SIAM J. Sci. Comput. 17 (1996), 16-32, choice 2).
    fn exact(&self, most: Exact) -> Exact {
        let [last, before] = self.promised;
        let left = if before > 0.0 { 0.9 * last / before } else { FIRST.left };
        Exact { left: left.clamp(most.left, FIRST.left), most: most.most }
    }

    fn products(&self, theta: &[f64], runs: Vec<Run>) -> Vec<Products<'a>> {
        let one = |((t, front), run): ((&'a Target<'a>, &Arc<Front>), Run)| {
            Products::new(self.graph, &t.record, theta, run, t.node_of(self.graph), front.clone())
        };
        self.targets.iter().zip(&self.fronts).zip(runs).map(one).collect()
    }
}
