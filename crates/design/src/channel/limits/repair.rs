//! Moves a record into its regions.

use super::ROUNDING;
use super::region::Regions;
use crate::channel::{Layout, SAFE};
use crate::error::DesignError;
use dynocal_numerics::rng::Rng64;

/// Rows are kept with this distance (in ranges of the channels) while a record is moved, so that it arrives after
/// finitely many projections.
const CLEARANCE: f64 = 1e-9;
/// Sweeps of projections before the way back to the known record is taken, and those in search of that record.
const SWEEPS: usize = 60;
const ANCHOR_SWEEPS: usize = 3000;
/// Records that are tried in search of one that keeps everything.
const ANCHORS: u64 = 40;

impl Layout {
    /// Largest violation of a region by `x`, in ranges of the channels; what rounding leaves counts as none.
    pub(crate) fn region_violation(&self, x: &[f64]) -> f64 {
        let worst = (0..self.regions.len()).map(|g| self.regions.condition(g, x).0).fold(0.0, f64::max);
        if worst <= ROUNDING { 0.0 } else { worst }
    }

    /// Moves `x`, which keeps bounds and rates, into the regions; it keeps bounds and rates.
    pub(crate) fn repair_regions(&self, x: &mut [f64]) {
        if self.region_violation(x) == 0.0 || self.project(x, SWEEPS) {
            return;
        }
        // On the straight way to the anchor bounds and rates hold, and at its end the regions do. Of a region to stay
        // out of the way may cross several parts, hence the search from the far end in steps before the bisection.
        let anchor = self.anchor();
        let at = |s: f64| -> Vec<f64> { x.iter().zip(anchor).map(|(x, a)| a + s * (x - a)).collect() };
        let keeps = |s: f64| self.region_violation(&at(s)) == 0.0;
        const STEPS: usize = 16;
        let first = (1..STEPS).rev().map(|k| k as f64 / STEPS as f64).find(|s| keeps(*s)).unwrap_or(0.0);
        let (mut inside, mut outside) = (first, first + 1.0 / STEPS as f64);
        for _ in 0..30 {
            let middle = 0.5 * (inside + outside);
            if keeps(middle) { inside = middle } else { outside = middle }
        }
        let found = at(inside);
        x.copy_from_slice(&found);
    }

    /// Projections in turn on the conditions that are violated, on rates and bounds; `true` when all are kept.
    pub(super) fn project(&self, x: &mut [f64], sweeps: usize) -> bool {
        let regions = &self.regions;
        for sweep in 0..sweeps {
            for k in 0..regions.len() {
                // To and fro, so that a move travels along the record in one sweep.
                let g = if sweep % 2 == 0 { k } else { regions.len() - 1 - k };
                self.project_one(regions, g, x);
            }
            for k in 0..self.rates().len() {
                let r = self.rates()[if sweep % 2 == 0 { k } else { self.rates().len() - 1 - k }];
                let (step, limit) = (x[r.j] - x[r.j - 1], r.limit * SAFE);
                let over = step - step.clamp(-limit, limit);
                x[r.j] -= 0.5 * over;
                x[r.j - 1] += 0.5 * over;
            }
            let mut tried = x.to_vec();
            self.repair_rates(&mut tried);
            if self.region_violation(&tried) == 0.0 {
                x.copy_from_slice(&tried);
                return true;
            }
        }
        false
    }

    /// The nearest point that keeps condition `g` among the free variables of its row that bounds do not stop.
    fn project_one(&self, regions: &Regions, g: usize, x: &mut [f64]) {
        let (lower, upper) = self.bounds();
        // Each pass stops one variable at a bound at least, and a row has few of them.
        for _ in 0..4 {
            let (passed, terms) = regions.condition(g, x);
            let over = passed + CLEARANCE;
            if over <= 0.0 {
                return;
            }
            let moves = |j: usize, a: f64| if a > 0.0 { x[j] > lower[j] } else { x[j] < upper[j] };
            let size: f64 = terms.iter().filter(|(j, a)| moves(*j, *a)).map(|(_, a)| a * a).sum();
            if size <= 1e-12 {
                return;
            }
            let step: Vec<(usize, f64)> =
                terms.iter().filter(|(j, a)| moves(*j, *a)).map(|(j, a)| (*j, over * a / size)).collect();
            for (j, d) in step {
                x[j] = (x[j] - d).clamp(lower[j], upper[j]);
            }
        }
    }

    /// A record that keeps all limits.
    pub(crate) fn anchor(&self) -> &[f64] {
        &self.regions.anchor
    }

    /// Finds the record that [`Layout::repair`] falls back to.
    ///
    /// # Errors
    /// [`DesignError::Conflict`] with the region and the sample that stay violated when none is found.
    pub(crate) fn find_anchor(&mut self) -> Result<(), DesignError> {
        let (lower, upper) = (self.bounds().0.to_vec(), self.bounds().1.to_vec());
        let middle: Vec<f64> = lower.iter().zip(&upper).map(|(l, u)| 0.5 * (l + u)).collect();
        let mut best: Option<(f64, Vec<f64>)> = None;
        for k in 0..ANCHORS {
            let mut x = middle.clone();
            if k > 0 {
                // Constant shares of the ranges first, then anything.
                let mut rng = Rng64::stream(0x0a6c, k);
                let shares: Vec<f64> = (0..self.n_channels()).map(|_| rng.uniform()).collect();
                for i in 0..self.n_channels() {
                    for j in self.variables(i) {
                        let share = if k < ANCHORS / 2 { shares[i] } else { rng.uniform() };
                        x[j] = lower[j] + share * (upper[j] - lower[j]);
                    }
                }
            }
            self.repair_rates(&mut x);
            if self.region_violation(&x) == 0.0 || self.project(&mut x, ANCHOR_SWEEPS) {
                self.regions.anchor = x;
                return Ok(());
            }
            self.repair_rates(&mut x);
            let violation = self.region_violation(&x);
            if best.as_ref().is_none_or(|b| violation < b.0) {
                best = Some((violation, x));
            }
        }
        let (by, x) = best.unwrap_or_default();
        let worst = (0..self.regions.len())
            .max_by(|a, b| self.regions.condition(*a, &x).0.total_cmp(&self.regions.condition(*b, &x).0));
        let (sample, name) = worst.map_or((0, ""), |g| self.regions.describe(g));
        Err(DesignError::Conflict {
            first: format!("region `{name}`"),
            second: "the other regions, bounds, rate limits, start and end (in ranges of the channels)"
                .into(),
            by,
            sample: Some(sample),
        })
    }
}
