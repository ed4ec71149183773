//! Valleys of the cells of a map: which of several local optima a cell holds, where they are worth nearly the same.
//!
//! Least fuel may be found in two places of a cell (cams late with the wastegate closed, or early with it open) that differ by less than
//! the models know. Neighbouring cells that fall into different ones jump between them, the maps go straight through what lies
//! between, and nothing was ever measured there. So each cell is sought again from where its neighbours stand, and of what is found
//!
//! ```text
//! minimise over the choices   sum_(k,j neighbours) | (x_k - x_j) / (upper - lower) |^2
//! subject to                  J(x_k) <= J_best,k + max(smooth |J_k|, caution sigma_k)
//! ```
//!
//! J: what is minimised, caution included; sigma: its standard deviation at the best, since what differs by less than the share of it that is added for
//! caution is not known to differ; all limits kept. Cell by cell in turns (iterated conditional modes): no choice makes the sum larger, so
//! that it ends.
//!
//! Reference: J. Besag, On the statistical analysis of dirty pictures, J. R. Statist. Soc. B 48 (1986), 259.

use rayon::prelude::*;

use super::cell::{CellOptimum, Setting};
use super::grid::{Cell, CellState, neighbours};

/// Most times that cells are sought again from neighbours that have moved: what one of them found goes on by one cell each time.
const ROUNDS: usize = 12;
/// Turns of the choice in a round.
const TURNS: usize = 20;

/// Moves optimal cells into the valleys of their neighbours where that costs no more than the share `smooth` of what is minimised and
/// neighbouring cells come nearer to each other. Whether any was moved.
pub fn agree(
    setting: &Setting,
    axes: &[Vec<f64>],
    smooth: f64,
    cells: &mut [Cell],
    interrupt: &(dyn Fn() -> bool + Sync),
) -> bool {
    let optimal = |cells: &[Cell], k: usize| cells[k].state == CellState::Optimal;
    let around: Vec<Vec<usize>> = (0..cells.len())
        .map(|k| neighbours(axes, k).into_iter().filter(|j| optimal(cells, *j)).collect())
        .collect();
    let mut moved = false;
    let mut choices: Vec<Vec<CellOptimum>> = vec![Vec::new(); cells.len()];
    // Where each cell stood when its neighbours were sought from there.
    let mut sought: Vec<Option<Vec<f64>>> = vec![None; cells.len()];
    for round in 0..ROUNDS {
        let now: &[Cell] = cells;
        let stays = |j: usize| sought[j].as_ref() == Some(&now[j].optimum.x);
        choices.par_iter_mut().enumerate().filter(|(k, _)| optimal(now, *k)).for_each(|(k, choices)| {
            let news = around[k].iter().filter(|j| !stays(**j)).map(|j| &now[*j]);
            choices.extend(found(setting, &now[k], news, interrupt));
        });
        sought = now.iter().map(|c| Some(c.optimum.x.clone())).collect();
        let mut changed = false;
        for (cell, found) in cells.iter_mut().zip(&mut choices) {
            changed |= good_enough(setting, cell, found, smooth, round == 0);
        }
        changed |= choose(setting, &around, &choices, cells);
        moved |= changed;
        if !changed || interrupt() {
            break;
        }
    }
    moved
}

/// What a cell may hold: what it holds, and the optima that are found from where neighbours stand that have moved.
fn found<'a>(
    setting: &Setting,
    cell: &Cell,
    moved: impl Iterator<Item = &'a Cell>,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Vec<CellOptimum> {
    let from = |c: &Cell| setting.local(&cell.at, &c.optimum.x, &|| interrupt());
    let feasible = |o: &CellOptimum| o.feasible;
    std::iter::once(cell.optimum.clone()).chain(moved.map(from).filter(feasible)).collect()
}

/// Of what a cell may hold that which is good enough beside the best that is known of it by now; what it holds itself may have become too
/// dear, and then it holds the best, with which all begin (`first`). Whether it moved.
fn good_enough(
    setting: &Setting,
    cell: &mut Cell,
    found: &mut Vec<CellOptimum>,
    smooth: f64,
    first: bool,
) -> bool {
    let Some(best) = found.iter().min_by(|a, b| setting.cost(a).total_cmp(&setting.cost(b))).cloned() else {
        return false;
    };
    cell.best = cell.best.min(setting.cost(&best));
    let allowed = cell.best + (smooth * best.objective.abs()).max(setting.caution * best.objective_deviation);
    found.retain(|o| setting.cost(o) <= allowed);
    let dear = setting.cost(&cell.optimum) > if first { setting.cost(&best) } else { allowed };
    if dear {
        cell.optimum = best;
    }
    dear
}

/// Squared distance of two settings, free inputs in shares of their ranges.
fn apart(setting: &Setting, a: &[f64], b: &[f64]) -> f64 {
    let free = setting.axes..setting.dim();
    free.map(|i| ((a[i] - b[i]) / setting.ranges[i].width().max(f64::MIN_POSITIVE)).powi(2)).sum()
}

/// Each cell in turn takes the choice that is nearest to its neighbours, until none changes.
fn choose(
    setting: &Setting,
    around: &[Vec<usize>],
    choices: &[Vec<CellOptimum>],
    cells: &mut [Cell],
) -> bool {
    let mut moved = false;
    for _ in 0..TURNS {
        let mut changed = false;
        for k in 0..cells.len() {
            let jump = |x: &[f64]| -> f64 {
                around[k].iter().map(|j| apart(setting, x, &cells[*j].optimum.x)).sum()
            };
            let each = choices[k].iter().map(|o| (jump(&o.x), o));
            let Some((least, o)) = each.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            // What is the same but for the last digits is no other valley.
            if least < (1.0 - SAME) * jump(&cells[k].optimum.x) {
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

/// Share of the jumps to its neighbours by which a choice has to be nearer.
const SAME: f64 = 1e-3;
