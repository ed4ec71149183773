//! Functions with many labels or samples: Gauss-Newton steps by conjugate gradients on the products `J v` and `J'u`, J never held.
//!
//! ```text
//! step     (J'WJ + R + V + mu diag) p = J'Wr - R (theta - base) - V (theta - base)     over the cells that are free and off their bounds
//! then     theta+ = theta + p, back within the bounds
//! ```
//!
//! R is the roughness, V the weight of the base. The conjugate gradients are preconditioned label by label: by the label's own part of
//! J'WJ as if the function had no memory, in the size of the diagonal, with its roughness. The diagonal is the mean square of `J'sqrt(W) e` over random signs e (M. F. Hutchinson, A stochastic
//! estimator of the trace of the influence matrix, Commun. Stat. Simul. 19 (1990), 433-450). A step's equations are solved only as far
//! as the step is right (R. S. Dembo, S. C. Eisenstat, T. Steihaug, Inexact Newton methods, SIAM J. Numer. Anal. 19 (1982), 400-408).
//! Cells at a bound that the gradient points beyond stay there (D. P. Bertsekas, Projected Newton methods, SIAM J. Control Optim. 20
//! (1982), 221-246). Intervals come from draws of the posterior, each the solution for one draw of the noise.

mod system;
mod told;

use super::{FIRST_SMOOTH, Found, Target, not_finite};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::graph::forward::Run;
use crate::graph::products::Products;
use crate::linear::{self, Options, offsets};
use dynocal_numerics::linalg::{dot, norm2};
use system::System;

/// Most steps, and those after which sizes are taken anew.
const MOST_STEPS: usize = 60;
const FIRST_STEPS: usize = 3;
/// Most times that sizes are taken, and the change of the labels, as a share of their size, up to which they need not be.
const MOST_ROUNDS: usize = 4;
const NEAR: f64 = 1e-2;
/// Change of the labels, as a share of their size, below which they stand.
const STANDS: f64 = 1e-6;
/// Part of the equations of a step that may be left, and of the first steps, which are far from where they lead.
const LEFT: f64 = 1e-2;
const FIRST_LEFT: f64 = 0.1;
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

/// Weighted squares and the runs of all targets; none where a sample is no number.
fn evaluate(graph: &Graph, theta: &[f64], targets: &[Target], weights: &[Vec<f64>]) -> Option<State> {
    let (mut runs, mut cost) = (Vec::new(), 0.0);
    for (t, w) in targets.iter().zip(weights) {
        let run = graph.run(theta, &t.record);
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
            "gradients and curvature are limited in functions of at most {} cells and {MOST_HELD} cells times samples, found {} cells",
            super::MOST_CELLS,
            start.len()
        );
        return Err(LabelError::label(&l.name, reason));
    }
    let mut weights: Vec<Vec<f64>> = targets.iter().map(|t| t.weights.to_vec()).collect();
    if !weights.iter().flatten().any(|w| *w > 0.0) {
        return Err(LabelError::TooFew { found: 0, expected: start.len() });
    }
    let mut theta = within(graph, start);
    let mut search = Search { graph, targets, options, interrupt, steps: 0, converged: false };
    let mut system = search.run(&mut theta, &weights)?;
    let plain = weights.clone();
    for _ in 0..if options.robust { ROUNDS } else { 0 } {
        let before = theta.clone();
        weights = huber(&system, &plain);
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
fn huber(system: &System, plain: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let counts = |w: &f64| *w > 0.0;
    let left: Vec<f64> = system
        .residuals
        .iter()
        .zip(plain)
        .flat_map(|(r, w)| r.iter().zip(w).filter(|(_, w)| counts(w)).map(|(r, _)| *r))
        .collect();
    let mut factors = linear::huber(&left).into_iter();
    plain
        .iter()
        .map(|w| w.iter().map(|w| if counts(w) { w * factors.next().unwrap_or(1.0) } else { 0.0 }).collect())
        .collect()
}

struct Search<'a> {
    graph: &'a Graph,
    targets: &'a [Target<'a>],
    options: &'a Options,
    interrupt: &'a dyn Fn() -> bool,
    steps: usize,
    converged: bool,
}

impl<'a> Search<'a> {
    /// Moves `theta` to a minimum; the equations there. Where the search starts a film may see nothing that moves, so that sizes are
    /// taken anew after a few steps, and once more where the labels have gone far since.
    fn run(&mut self, theta: &mut Vec<f64>, weights: &[Vec<f64>]) -> Result<System<'a>, LabelError> {
        let mut round = 0;
        loop {
            let before = theta.clone();
            let system = self.round(theta, weights, round == 0)?;
            let change: Vec<f64> = before.iter().zip(theta.iter()).map(|(a, b)| a - b).collect();
            let near = norm2(&change) <= NEAR * norm2(theta);
            round += 1;
            if (round > 1 && (near || !self.converged)) || round == MOST_ROUNDS || (self.interrupt)() {
                return Ok(system);
            }
        }
    }

    fn round(
        &mut self,
        theta: &mut Vec<f64>,
        weights: &[Vec<f64>],
        first: bool,
    ) -> Result<System<'a>, LabelError> {
        let (graph, targets) = (self.graph, self.targets);
        let wrong = |theta: &[f64]| not_finite(graph, theta, targets);
        let state = evaluate(graph, theta, targets, weights).ok_or_else(|| wrong(theta))?;
        let smooth = self.options.smooth.unwrap_or(FIRST_SMOOTH);
        let products = self.products(theta, state.runs);
        let mut system = System::new(graph, products, targets, weights, self.options, smooth);
        let mut cost = state.cost;
        // A cell without data has its base, wherever the search starts.
        let known = system.known(theta);
        if known != *theta {
            *theta = known;
            let state = evaluate(graph, theta, targets, weights).ok_or_else(|| wrong(theta))?;
            cost = state.cost;
            system.move_to(self.products(theta, state.runs));
        }
        cost += system.cost_of_base(theta);
        let mut mu = DAMPED;
        self.converged = false;
        let (most, left) = if first { (FIRST_STEPS, FIRST_LEFT) } else { (MOST_STEPS, LEFT) };
        for _ in 0..most {
            if self.converged || (self.interrupt)() {
                break;
            }
            self.steps += 1;
            if !self.step(theta, &mut cost, &mut mu, left, &mut system, weights)? {
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
        left: f64,
        system: &mut System<'a>,
        weights: &[Vec<f64>],
    ) -> Result<bool, LabelError> {
        let g = system.gradient(theta);
        let (mut tried, mut promised) = (0, f64::INFINITY);
        loop {
            let p = system.step(&g, theta, *mu, left, self.interrupt)?;
            let moved: Vec<f64> = theta.iter().zip(&p).map(|(a, b)| a + b).collect();
            let next = within(self.graph, &moved);
            // A step that is short because it is damped says nothing.
            let small = *mu <= DAMPED && stands(&next, theta);
            if tried == 0 {
                promised = dot(&g, &p);
            }
            let new = evaluate(self.graph, &next, self.targets, weights);
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

    fn products(&self, theta: &[f64], runs: Vec<Run>) -> Vec<Products<'a>> {
        let one = |(t, run): (&'a Target<'a>, Run)| {
            Products::new(self.graph, &t.record, theta, run, t.node_of(self.graph))
        };
        self.targets.iter().zip(runs).map(one).collect()
    }
}

/// Cells of each label, one after the other.
fn spans(graph: &Graph) -> Vec<std::ops::Range<usize>> {
    let (first, _) = offsets(&graph.labels);
    graph.labels.iter().zip(first).map(|(l, from)| from..from + l.len()).collect()
}
