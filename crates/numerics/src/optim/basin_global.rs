//! Searches of the crate basin that stay out of the table of optimisers, because they need a box and a seed: a genetic
//! algorithm and simulated annealing. (Its SLSQP, dense, takes 0.1 s per step at 300 bounded variables.)

use super::basin_members::{Bridge, run, status};
use super::probe::{BudgetUsed, Probe};
use super::{Bounds, Budget, Objective, Optimiser, Outcome};
use crate::rng::Rng64;
use basin::core::rng::{ChaCha8Rng, RngExt};
use basin::solver::simulated_annealing::Neighbor;
use basin::solver::{SimulatedAnnealing, Ssga, simulated_annealing::TemperatureSchedule};
use basin::{Executor, PopulationProgress, ProposalState};
use std::cell::RefCell;

/// Steady-state genetic algorithm with real genes (Molina, Lozano, Garcia-Martinez & Herrera 2010, section 4.4): blend
/// crossover of parents that differ, breeder's mutation, the worst member replaced. Values only.
///
/// The first population is the start and uniform points of the box. Where a bound is infinite the box reaches one unit
/// of the start's size to both sides.
#[derive(Clone, Copy, Debug)]
pub struct Genetic {
    /// Members of the population (at least 4 are used).
    pub population: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Simulated annealing (Kirkpatrick, Gelatt & Vecchi 1983) with Metropolis acceptance and reannealing. Values only.
///
/// A proposal moves one variable by a normal step whose width falls with the root of the temperature, from one third of
/// the box on, reflected into it.
#[derive(Clone, Copy, Debug)]
pub struct Annealing {
    /// Temperature at the start, in units of the objective.
    pub temperature: f64,
    /// Factor from one temperature to the next, between 0 and 1.
    pub cooling: f64,
    /// Proposals at each temperature.
    pub steps: usize,
    /// Temperatures after which the annealing begins again.
    pub levels: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Optimiser for Genetic {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let probe = RefCell::new(Probe::new(problem, bounds, x0, budget));
        let (mut bridge, y0) = Bridge::new(&probe, bounds, true);
        bridge.close_box(&y0);
        let mut rng = Rng64::new(self.seed);
        let n = self.population.max(4);
        let mut members = vec![y0];
        members.resize_with(n, || {
            bridge.lower.iter().zip(&bridge.upper).map(|(l, u)| rng.uniform_in(*l, *u)).collect()
        });
        let solver = Ssga::new(self.seed).with_pop_size(n);
        let (ended, converged) =
            run!(Executor::new(bridge, solver, PopulationProgress::from_population(members)));
        probe.into_inner().outcome(status(ended, converged))
    }
}

/// Moves one variable within the box.
#[derive(Clone)]
struct OneVariable {
    lower: Vec<f64>,
    upper: Vec<f64>,
    hottest: f64,
}

impl Neighbor<Vec<f64>> for OneVariable {
    type Error = BudgetUsed;
    fn propose(
        &mut self,
        y: &Vec<f64>,
        temperature: f64,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<f64>, BudgetUsed> {
        let mut to = y.clone();
        let k = rng.random_range(0..y.len());
        let (l, range) = (self.lower[k], self.upper[k] - self.lower[k]);
        if range > 0.0 {
            // Sum of twelve uniform numbers: normal enough for a step, and bounded.
            let normal: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            let width = (temperature / self.hottest).sqrt().max(1e-4) / 3.0;
            // Reflection: fold onto [0, 2) and back.
            let z = ((y[k] - l) / range + width * normal).rem_euclid(2.0);
            to[k] = l + range * if z > 1.0 { 2.0 - z } else { z };
        }
        Ok(to)
    }
}

impl Optimiser for Annealing {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let probe = RefCell::new(Probe::new(problem, bounds, x0, budget));
        let (mut bridge, y0) = Bridge::new(&probe, bounds, true);
        bridge.close_box(&y0);
        let hottest =
            if self.temperature > 0.0 && self.temperature.is_finite() { self.temperature } else { 1.0 };
        let cooling = if self.cooling > 0.0 && self.cooling < 1.0 { self.cooling } else { 0.95 };
        let steps = self.steps.max(1) as u64;
        let neighbour = OneVariable { lower: bridge.lower.clone(), upper: bridge.upper.clone(), hottest };
        let schedule = TemperatureSchedule::geometric(cooling).with_steps_per_temperature(steps);
        let solver = SimulatedAnnealing::new(neighbour, hottest, schedule, self.seed)
            .with_reannealing_fixed(steps * self.levels.max(1) as u64);
        let (ended, converged) = run!(Executor::new(bridge, solver, ProposalState::new(y0)));
        probe.into_inner().outcome(status(ended, converged))
    }
}
