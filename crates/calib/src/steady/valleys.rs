//! Valleys of the cells of a map: which of several local optima a cell holds, where they are worth nearly the same.
//!
//! Least fuel may be found in two places of a cell (cams late with the wastegate closed, or early with it open) that differ by less than
//! the models know. Neighbouring cells that fall into different ones jump between them, the maps go straight through what lies
//! between, and nothing was ever measured there: on a ridge between two places that are worth the same, it is worth less than either. So each cell is
//! sought again from where its neighbours stand, and of what is found
//!
//! ```text
//! minimise over the choices   sum_k e_k + jump sum_(k,j neighbours) | (x_k - x_j) / (upper - lower) |^2
//! e_k = max(0, J(x_k) - J_best,k - max(smooth |J_k|, caution sigma_k)) / |J_k|
//! ```
//!
//! J: what is minimised, caution included; sigma: its standard deviation at the best, since what differs by less than the share of it that is added for
//! caution is not known to differ; all limits kept. Cell by cell in turns (iterated conditional modes), then whole regions of cells that stand alike:
//! at the edge of one a cell gains nothing by going over alone. No move makes the sum larger as far as the best of each cell is known by then, and the
//! number of turns is bounded.
//!
//! Reference: J. Besag, On the statistical analysis of dirty pictures, J. R. Statist. Soc. B 48 (1986), 259.

use rayon::prelude::*;

use super::cell::{CellOptimum, Setting};
use super::grid::{Cell, CellState, GridSpec, neighbours};

/// Most times that cells are sought again from neighbours that have moved: what one of them found goes on by one cell each time.
const ROUNDS: usize = 12;
/// Turns of the choice in a round.
const TURNS: usize = 20;
/// Share of its sum by which a choice has to be better: what is the same but for the last digits is no other valley.
const SAME: f64 = 1e-3;
/// Squared distance of two settings, free inputs in shares of their ranges, from which on neighbours stand in two valleys: a third of the range of one.
const APART: f64 = 0.1;
/// Regions that go over one after the other.
const REGIONS: usize = 16;
/// What a jump costs where nothing is asked: choices that are free are told apart by it.
const LEAST: f64 = 1e-9;

/// Moves optimal cells into the valleys of their neighbours where that costs less than the jumps between them. Whether any was moved.
pub fn agree(
    setting: &Setting,
    axes: &[Vec<f64>],
    spec: &GridSpec,
    cells: &mut [Cell],
    interrupt: &(dyn Fn() -> bool + Sync),
) -> bool {
    let optimal = |k: &usize| cells[*k].state == CellState::Optimal;
    let around = (0..cells.len()).map(|k| neighbours(axes, k).into_iter().filter(optimal).collect());
    let around = around.collect();
    let best = cells.iter().map(|c| Best::of(setting, spec.smooth, &c.optimum)).collect();
    let (choices, sought, stayed) = (vec![Vec::new(); cells.len()], vec![None; cells.len()], Vec::new());
    let (smooth, jump) = (spec.smooth, spec.jump);
    let mut valleys = Valleys { setting, smooth, jump, around, best, choices, sought, stayed, interrupt };
    let mut moved = valleys.cell_by_cell(cells, true);
    // Where jumps cost nothing no region gains by them.
    for _ in 0..if jump > 0.0 { REGIONS } else { 0 } {
        if interrupt() || !valleys.by_region(cells) {
            break;
        }
        moved = true;
        valleys.cell_by_cell(cells, false);
    }
    moved
}

/// The best that is known of a cell.
struct Best {
    cost: f64,
    /// What another choice may cost more without counting.
    free: f64,
    /// Size of what is minimised.
    size: f64,
}

impl Best {
    fn of(setting: &Setting, smooth: f64, o: &CellOptimum) -> Self {
        let size = o.objective.abs().max(f64::MIN_POSITIVE);
        Self {
            cost: setting.cost(o),
            free: (smooth * size).max(setting.caution * o.objective_deviation),
            size,
        }
    }

    /// What a cost is beyond what is free, as a share.
    fn excess(&self, cost: f64) -> f64 {
        ((cost - self.cost - self.free) / self.size).max(0.0)
    }
}

/// Optimal cells with their optimal neighbours.
struct Valleys<'a, 'b> {
    setting: &'a Setting<'b>,
    smooth: f64,
    /// What a jump of an input through its whole range costs, as a share.
    jump: f64,
    around: Vec<Vec<usize>>,
    best: Vec<Best>,
    /// What each cell may hold.
    choices: Vec<Vec<CellOptimum>>,
    /// Where each cell stood when its neighbours were sought from there.
    sought: Vec<Option<Vec<f64>>>,
    /// Cells of regions that stayed where they were, and those on the other side.
    stayed: Vec<[Vec<usize>; 2]>,
    interrupt: &'a (dyn Fn() -> bool + Sync),
}

impl Valleys<'_, '_> {
    /// Cells are sought again from where their neighbours stand, until none takes another choice. Whether any did.
    fn cell_by_cell(&mut self, cells: &mut [Cell], first: bool) -> bool {
        let mut moved = false;
        for round in 0..ROUNDS {
            let now: &[Cell] = cells;
            let stays = |j: usize| self.sought[j].as_ref() == Some(&now[j].optimum.x);
            let optimal = |k: usize| now[k].state == CellState::Optimal;
            let mut choices = std::mem::take(&mut self.choices);
            choices.par_iter_mut().enumerate().filter(|(k, _)| optimal(*k)).for_each(|(k, choices)| {
                let news = self.around[k].iter().filter(|j| !stays(**j)).map(|j| &now[*j]);
                choices.extend(news.filter_map(|j| self.local(&now[k], &j.optimum.x)));
                if !choices.iter().any(|o| o.x == now[k].optimum.x) {
                    choices.push(now[k].optimum.clone());
                }
            });
            self.sought = now.iter().map(|c| Some(c.optimum.x.clone())).collect();
            let mut changed = false;
            for (k, found) in choices.iter_mut().enumerate() {
                changed |= self.good_enough(k, &mut cells[k], found, first && round == 0);
            }
            changed |= self.choose(&choices, cells);
            self.choices = choices;
            moved |= changed;
            if !changed || (self.interrupt)() {
                break;
            }
        }
        moved
    }

    /// The optimum of a cell that is found from the free inputs of `x`, where it keeps all limits.
    fn local(&self, cell: &Cell, x: &[f64]) -> Option<CellOptimum> {
        let found = self.setting.local(&cell.at, x, &|| (self.interrupt)());
        Some(found).filter(|o| o.feasible && self.setting.cost(o).is_finite())
    }

    /// Of what cell `k` may hold that which jumps may be worth, beside the best that is known of it by now; what it holds itself may have become too
    /// dear, and then it holds the best, with which all begin (`first`). Whether it moved.
    fn good_enough(&mut self, k: usize, cell: &mut Cell, found: &mut Vec<CellOptimum>, first: bool) -> bool {
        let cost = |o: &CellOptimum| self.setting.cost(o);
        let Some(least) = found.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).cloned() else {
            return false;
        };
        if cost(&least) <= self.best[k].cost {
            self.best[k] = Best::of(self.setting, self.smooth, &least);
        }
        cell.best = cell.best.min(self.best[k].cost);
        // Jumps of all inputs to all neighbours: more no choice wins back.
        let most = self.jump * (self.around[k].len() * (self.setting.dim() - self.setting.axes)) as f64;
        found.retain(|o| self.best[k].excess(cost(o)) <= most);
        let dear = if first {
            cost(&cell.optimum) > cost(&least)
        } else {
            self.best[k].excess(cost(&cell.optimum)) > most
        };
        if dear {
            cell.optimum = least;
        }
        dear
    }

    /// Each cell in turn takes the choice with the least sum of what it costs and of the jumps to its neighbours, until none changes.
    fn choose(&self, choices: &[Vec<CellOptimum>], cells: &mut [Cell]) -> bool {
        let mut moved = false;
        for _ in 0..TURNS {
            let mut changed = false;
            for k in 0..cells.len() {
                let sum = |o: &CellOptimum| {
                    let jumps: f64 =
                        self.around[k].iter().map(|j| self.apart(&o.x, &cells[*j].optimum.x)).sum();
                    self.best[k].excess(self.setting.cost(o)) + self.jump.max(LEAST) * jumps
                };
                let each = choices[k].iter().map(|o| (sum(o), o));
                let Some((least, o)) = each.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
                if least < (1.0 - SAME) * sum(&cells[k].optimum) {
                    cells[k].optimum = o.clone();
                    changed = true;
                }
            }
            moved |= changed;
            if !changed {
                break;
            }
        }
        moved
    }

    /// Squared distance of two settings, free inputs in shares of their ranges.
    fn apart(&self, a: &[f64], b: &[f64]) -> f64 {
        let free = self.setting.axes..self.setting.dim();
        free.map(|i| ((a[i] - b[i]) / self.setting.ranges[i].width().max(f64::MIN_POSITIVE)).powi(2)).sum()
    }

    /// The first region, beside the largest jump, that goes over to the valley on the other side and makes the sum of the map less; whether there was one.
    fn by_region(&mut self, cells: &mut [Cell]) -> bool {
        let region = self.regions(cells);
        let of = |r: usize| -> Vec<usize> { (0..cells.len()).filter(|k| region[*k] == r).collect() };
        let distance = |k: usize, j: usize| self.apart(&cells[k].optimum.x, &cells[j].optimum.x);
        let optimal = |k: &usize| cells[*k].state == CellState::Optimal;
        let all: Vec<usize> = (0..cells.len()).filter(optimal).collect();
        let sides = all
            .iter()
            .flat_map(|k| self.around[*k].iter().map(|j| (distance(*k, *j), region[*k], region[*j])));
        let mut sides: Vec<_> = sides.filter(|(_, from, to)| from != to).collect();
        sides.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        for (_, from, to) in sides {
            let both = [of(from), of(to)];
            // What most of a map holds it does not leave for the rest.
            if 2 * both[0].len() > all.len() || self.stayed.contains(&both) {
                continue;
            }
            let over = self.gone_over(cells, &region, (from, to));
            let mut trial = cells.to_vec();
            over.into_iter().for_each(|(k, o)| trial[k].optimum = o);
            if self.sum(&trial) < self.sum(cells) - LEAST {
                cells.clone_from_slice(&trial);
                return true;
            }
            self.stayed.push(both);
            if (self.interrupt)() {
                break;
            }
        }
        false
    }

    /// For each cell the least number of those that stand alike, from neighbour to neighbour.
    fn regions(&self, cells: &[Cell]) -> Vec<usize> {
        let mut region: Vec<usize> = (0..cells.len()).collect();
        for first in 0..cells.len() {
            if region[first] != first || cells[first].state != CellState::Optimal {
                continue;
            }
            let mut left = vec![first];
            while let Some(k) = left.pop() {
                for &j in &self.around[k] {
                    let alike = self.apart(&cells[k].optimum.x, &cells[j].optimum.x) <= APART;
                    if alike && region[j] > first {
                        region[j] = first;
                        left.push(j);
                    }
                }
            }
        }
        region
    }

    /// Cells of the region `from` with what is found from the region `to`, cell after cell from the side that they share. One that falls back to where
    /// it stood goes no farther.
    fn gone_over(
        &self,
        cells: &[Cell],
        region: &[usize],
        (from, to): (usize, usize),
    ) -> Vec<(usize, CellOptimum)> {
        let mut over: Vec<(usize, CellOptimum)> = Vec::new();
        let mut seen: Vec<bool> = region.iter().map(|r| *r != from).collect();
        let beside = |k: usize| self.around[k].iter().find(|j| region[**j] == to);
        let mut next: Vec<(usize, Vec<f64>)> = (0..cells.len())
            .filter(|k| region[*k] == from)
            .filter_map(|k| Some((k, cells[*beside(k)?].optimum.x.clone())))
            .collect();
        while !next.is_empty() && !(self.interrupt)() {
            next.iter().for_each(|(k, _)| seen[*k] = true);
            let found = next.par_iter().filter_map(|(k, x)| {
                let o = self.local(&cells[*k], x)?;
                let stays = self.apart(&o.x, x) >= self.apart(&o.x, &cells[*k].optimum.x);
                (!stays).then_some((*k, o))
            });
            let found: Vec<(usize, CellOptimum)> = found.collect();
            next = Vec::new();
            for (k, o) in &found {
                for &j in &self.around[*k] {
                    if !seen[j] {
                        seen[j] = true;
                        next.push((j, o.x.clone()));
                    }
                }
            }
            over.extend(found);
        }
        over
    }

    /// What the map costs: that of its cells beyond what is free, and its jumps.
    fn sum(&self, cells: &[Cell]) -> f64 {
        let optimal = (0..cells.len()).filter(|k| cells[*k].state == CellState::Optimal);
        let one = |k: usize| {
            let jumps = self.around[k].iter().map(|j| self.apart(&cells[k].optimum.x, &cells[*j].optimum.x));
            // Each pair is met twice.
            self.best[k].excess(self.setting.cost(&cells[k].optimum)) + 0.5 * self.jump * jumps.sum::<f64>()
        };
        optimal.map(one).sum()
    }
}
