//! The map: the optimum of every cell, neighbours as starts, smoothed within a tolerance, unreachable cells filled and marked.

use std::collections::BTreeMap;

use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cell::{CellOptimum, Setting};
use super::front::FrontSpec;
use super::valleys;
use super::whole::{Coupling, Way, solve_whole};

/// How a map is made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GridSpec {
    /// Probability with which each limit is kept in each cell, as far as the models know themselves.
    pub probability: f64,
    /// Standard deviations of the models that are added to what is minimised: what they do not know is no gain.
    pub caution: f64,
    /// Starts of each cell.
    pub starts: usize,
    /// Share of what is minimised that a smoother map may cost in a cell; 0: it is left as it is.
    pub smooth: f64,
    /// What a jump of an input through its whole range from one cell to the next costs, as a share of what is minimised in a cell: nothing is known of
    /// what lies between two valleys, and the maps go through it. On `gtdi_2l` the intake cam costs 1.5 % of fuel half way, and on two days maps alone missed two to three of torque beside such a jump.
    pub jump: f64,
    /// All cells as one program, where it is there; the map is then not smoothed cell by cell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub whole: Option<WholeSpec>,
    /// What is minimised against another response, where it is there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub front: Option<FrontSpec>,
    /// Number of breakpoints that are kept of an axis, by channel; all where it is not there.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub breakpoints: BTreeMap<String, usize>,
    /// Error of interpolation of the inputs that loops drive, as a share of them, above which the maps get values between those of the
    /// axes; 0: they keep the axes as they are.
    pub between: f64,
    /// Steps of free inputs in an ECU, in their unit: their values are multiples of it.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub resolution: BTreeMap<String, f64>,
}

/// What couples the cells of a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WholeSpec {
    /// What inputs that jump by their whole range between all neighbours would cost, as twice a share of what is minimised.
    pub smooth: f64,
    /// Largest step between neighbouring cells by free input, in its unit.
    pub steps: BTreeMap<String, f64>,
    /// Weight of each cell, the last axis fastest; equal where it is empty.
    pub residence: Vec<f64>,
    /// Free inputs that rise or fall along axes of the maps: by input, then by axis.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub monotone: BTreeMap<String, BTreeMap<String, Way>>,
}

impl Default for WholeSpec {
    fn default() -> Self {
        Self { smooth: 0.01, steps: BTreeMap::new(), residence: Vec::new(), monotone: BTreeMap::new() }
    }
}

impl Default for GridSpec {
    fn default() -> Self {
        Self {
            probability: 0.9,
            caution: 0.5,
            starts: 4,
            smooth: 0.001,
            jump: 0.03,
            whole: None,
            front: None,
            breakpoints: BTreeMap::new(),
            between: 0.0,
            resolution: BTreeMap::new(),
        }
    }
}

/// What is known of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CellState {
    /// Its optimum keeps all limits.
    Optimal,
    /// No setting keeps all limits with the asked probability: the least violation stands there.
    Infeasible,
    /// Outside of what was reached on the bed: filled from its neighbours.
    Filled,
    /// Held as a user has edited it, where that breaks a limit.
    Edited,
}

/// A cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Values of the axes.
    pub at: Vec<f64>,
    /// What it is.
    pub state: CellState,
    /// What stands in the map.
    pub optimum: CellOptimum,
    /// What is minimised before the map was smoothed, caution included.
    pub best: f64,
}

/// Sweeps of the smoothing.
const SWEEPS: usize = 12;
/// Shares of the way to the mean of the neighbours that are tried.
const STEPS: [f64; 4] = [1.0, 0.5, 0.25, 0.1];

/// Places of the neighbours of cell `k` along each axis.
pub fn neighbours(axes: &[Vec<f64>], k: usize) -> Vec<usize> {
    let (mut all, mut stride) = (Vec::new(), 1);
    for axis in axes.iter().rev() {
        let i = (k / stride) % axis.len();
        if i > 0 {
            all.push(k - stride);
        }
        if i + 1 < axis.len() {
            all.push(k + stride);
        }
        stride *= axis.len();
    }
    all
}

/// Values of the axes at cell `k`, the last axis fastest.
pub fn place(axes: &[Vec<f64>], k: usize) -> Vec<f64> {
    let mut rest = k;
    let mut at: Vec<f64> = axes
        .iter()
        .rev()
        .map(|axis| {
            let v = axis[rest % axis.len()];
            rest /= axis.len();
            v
        })
        .collect();
    at.reverse();
    at
}

/// The cells of a map over `axes`, the last axis fastest. `reached` tells where the bed has been.
pub fn solve(
    setting: &Setting,
    axes: &[Vec<f64>],
    spec: &GridSpec,
    reached: &(dyn Fn(&[f64]) -> bool + Sync),
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Vec<Cell> {
    let n: usize = axes.iter().map(Vec::len).product();
    let first: Vec<CellOptimum> = (0..n)
        .into_par_iter()
        .map(|k| setting.optimise(&place(axes, k), spec.starts, &[], seed, &|| interrupt()))
        .collect();
    let agree = spec.smooth > 0.0 && spec.whole.is_none();
    // A neighbour may have found a better valley. Cells that have to agree on their valleys are sought from their neighbours there, and
    // the pass is theirs only where they keep no limits.
    let second: Vec<CellOptimum> = (0..n)
        .into_par_iter()
        .map(|k| {
            if agree && first[k].feasible {
                return first[k].clone();
            }
            let warm: Vec<Vec<f64>> = neighbours(axes, k).into_iter().map(|j| first[j].x.clone()).collect();
            let found = setting.optimise(&place(axes, k), 1, &warm, seed, &|| interrupt());
            if setting.better(&found, &first[k]) { found } else { first[k].clone() }
        })
        .collect();
    let mut cells: Vec<Cell> = second
        .into_iter()
        .enumerate()
        .map(|(k, optimum)| {
            let at = place(axes, k);
            let state = match (reached(&at), optimum.feasible) {
                (false, _) => CellState::Filled,
                (true, true) => CellState::Optimal,
                (true, false) => CellState::Infeasible,
            };
            Cell { at, state, best: setting.cost(&optimum), optimum }
        })
        .collect();
    if agree {
        valleys::agree(setting, axes, spec, &mut cells, interrupt);
    }
    smooth(setting, axes, spec, &mut cells);
    fill(setting, axes, &mut cells);
    cells
}

/// Moves optimal cells towards the mean of their optimal neighbours as far as limits and tolerance allow.
fn smooth(setting: &Setting, axes: &[Vec<f64>], spec: &GridSpec, cells: &mut [Cell]) {
    if spec.smooth <= 0.0 || spec.whole.is_some() {
        return;
    }
    let went_over: Vec<f64> = cells.iter().map(|c| setting.cost(&c.optimum)).collect();
    for _ in 0..SWEEPS {
        let mut moved = false;
        for k in 0..cells.len() {
            if cells[k].state != CellState::Optimal {
                continue;
            }
            let around: Vec<usize> =
                neighbours(axes, k).into_iter().filter(|j| cells[*j].state == CellState::Optimal).collect();
            if around.is_empty() {
                continue;
            }
            let x = cells[k].optimum.x.clone();
            let mean =
                |i: usize| around.iter().map(|j| cells[*j].optimum.x[i]).sum::<f64>() / around.len() as f64;
            let target: Vec<f64> =
                (0..x.len()).map(|i| if i < setting.axes { x[i] } else { mean(i) }).collect();
            // One that went over into the valley of its neighbours may cost what it does.
            let allowed = (cells[k].best + spec.smooth * cells[k].optimum.objective.abs()).max(went_over[k]);
            for step in STEPS {
                let trial: Vec<f64> = x.iter().zip(&target).map(|(a, b)| a + step * (b - a)).collect();
                let mut o = setting.judge(&trial, cells[k].optimum.status, None);
                if o.feasible && setting.cost(&o) <= allowed {
                    // The prices are those of the optimum that was smoothed.
                    for (new, old) in o.prices.iter_mut().zip(&cells[k].optimum.prices) {
                        new.saves = old.saves;
                    }
                    cells[k].optimum = o;
                    moved = true;
                    break;
                }
            }
        }
        if !moved {
            break;
        }
    }
}

/// All optimal cells as one program, `names` of all factors, axes first, for its steps and ways; the others are filled again. How it ended and its
/// iterations; where it found nothing that keeps all limits the cells stay as they were.
pub fn couple(
    setting: &Setting,
    axes: &[Vec<f64>],
    spec: &WholeSpec,
    names: &[String],
    cells: &mut [Cell],
    interrupt: &dyn Fn() -> bool,
) -> (Status, usize) {
    let optimal: Vec<usize> = (0..cells.len()).filter(|k| cells[*k].state == CellState::Optimal).collect();
    let order = |k: usize| optimal.iter().position(|o| *o == k);
    let forward = |(a, k): (usize, &usize)| -> Vec<(usize, usize)> {
        let later = neighbours(axes, *k).into_iter().filter(|j| j > k);
        later.filter_map(order).map(|b| (a, b)).collect()
    };
    let pairs: Vec<(usize, usize)> = optimal.iter().enumerate().flat_map(forward).collect();
    let (of_axes, free) = names.split_at(setting.axes);
    // A pair goes up one axis: the one along which its cells differ.
    let ways = |(pair, (a, b)): (usize, &(usize, usize))| {
        let (from, to) = (&cells[optimal[*a]].at, &cells[optimal[*b]].at);
        let along = (0..of_axes.len()).find(|k| from[*k] != to[*k]);
        let way = |(i, name): (usize, &String)| {
            let way = spec.monotone.get(name)?.get(&of_axes[along?])?;
            Some((pair, i, *way))
        };
        free.iter().enumerate().filter_map(way).collect::<Vec<_>>()
    };
    let coupling = Coupling {
        weights: optimal.iter().map(|k| spec.residence.get(*k).copied().unwrap_or(1.0)).collect(),
        smooth: spec.smooth,
        steps: free.iter().map(|n| spec.steps.get(n).copied()).collect(),
        monotone: pairs.iter().enumerate().flat_map(ways).collect(),
        pairs: pairs.clone(),
    };
    let starts: Vec<Vec<f64>> = optimal.iter().map(|k| cells[*k].optimum.x.clone()).collect();
    let found = solve_whole(setting, &starts, &coupling, interrupt);
    if found.status.is_success() && found.cells.iter().all(|c| c.feasible) {
        optimal.iter().zip(found.cells).for_each(|(k, o)| cells[*k].optimum = o);
        fill(setting, axes, cells);
    }
    (found.status, found.iterations)
}

/// Puts other optima into the cells `which`; those that the bed has not reached are filled again.
pub fn replace(
    setting: &Setting,
    axes: &[Vec<f64>],
    which: &[usize],
    optima: Vec<CellOptimum>,
    cells: &mut [Cell],
) {
    for (k, o) in which.iter().zip(optima) {
        (cells[*k].best, cells[*k].optimum) = (setting.cost(&o), o);
    }
    fill(setting, axes, cells);
}

/// Marks the cells `which` as not reached after all, and fills them.
pub fn unreached(setting: &Setting, axes: &[Vec<f64>], which: &[usize], cells: &mut [Cell]) {
    which.iter().for_each(|k| cells[*k].state = CellState::Filled);
    fill(setting, axes, cells);
}

/// Fills cells that the bed has not reached from those next to them, ring by ring.
fn fill(setting: &Setting, axes: &[Vec<f64>], cells: &mut [Cell]) {
    let mut known: Vec<bool> = cells.iter().map(|c| c.state != CellState::Filled).collect();
    while known.iter().any(|k| *k) && !known.iter().all(|k| *k) {
        let mut next = known.clone();
        for k in 0..cells.len() {
            if known[k] {
                continue;
            }
            let around: Vec<usize> = neighbours(axes, k).into_iter().filter(|j| known[*j]).collect();
            if around.is_empty() {
                continue;
            }
            let mut x = cells[k].at.clone();
            for i in setting.axes..setting.dim() {
                x.push(around.iter().map(|j| cells[*j].optimum.x[i]).sum::<f64>() / around.len() as f64);
            }
            let mut o = setting.judge(&x, cells[k].optimum.status, None);
            // What the models say out there is worth nothing: all responses are those of the neighbours.
            for (r, value) in o.responses.iter_mut().enumerate() {
                let sum: f64 = around.iter().map(|j| cells[*j].optimum.responses[r]).sum();
                *value = sum / around.len() as f64;
            }
            cells[k].optimum = o;
            next[k] = true;
        }
        known = next;
    }
}

/// Interpolates the factors of a map (all of them, axes included) at the axes `at`: multilinear, held at the edges.
pub fn interpolate(axes: &[Vec<f64>], cells: &[Cell], at: &[f64]) -> Vec<f64> {
    let corners: Vec<(usize, f64)> = corners(axes, at);
    let d = cells.first().map_or(0, |c| c.optimum.x.len());
    let mut x: Vec<f64> =
        (0..d).map(|i| corners.iter().map(|(k, w)| w * cells[*k].optimum.x[i]).sum()).collect();
    x[..at.len()].copy_from_slice(at);
    x
}

/// Cells around a point with their weights.
pub fn corners(axes: &[Vec<f64>], at: &[f64]) -> Vec<(usize, f64)> {
    let mut all = vec![(0, 1.0)];
    for (axis, v) in axes.iter().zip(at) {
        let last = axis.len() - 1;
        let (i, share) = if last == 0 || *v <= axis[0] {
            (0, 0.0)
        } else if *v >= axis[last] {
            (last, 0.0)
        } else {
            let i = axis.partition_point(|a| a <= v) - 1;
            (i, (v - axis[i]) / (axis[i + 1] - axis[i]))
        };
        all = all
            .into_iter()
            .flat_map(|(k, w)| {
                let base = k * axis.len();
                [(base + i, w * (1.0 - share)), (base + (i + 1).min(last), w * share)]
            })
            .filter(|(_, w)| *w > 0.0)
            .collect();
    }
    all
}
