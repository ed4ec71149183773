//! All cells of a map as one program.
//!
//! ```text
//! minimise    sum_k w_k [m_k(x_k) + caution sd_k(x_k)] / |m_k|  +  rho / 2  sum_pairs sum_i (u_ki - u_ji)^2
//! subject to  limits of every cell, as in `cell`
//!             |x_ki - x_ji| <= step_i          neighbouring cells k, j; inputs with a limited step
//!             x_ki <= x_ji or x_ki >= x_ji     neighbours along an axis over which input i is to rise or to fall
//!             lower_i <= x_ki <= upper_i,      u = (x - lower) / (upper - lower)
//! ```
//!
//! w is the share of time that a cycle spends in a cell. Every cell has its block of variables; only neighbours are coupled, so
//! that the KKT matrix is sparse and its factorisation grows hardly faster than the number of cells. Gradients and Hessians are
//! exact.

use dynocal_numerics::nlp::{NlpOptions, SparseNlp, solve};
use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cell::{CellOptimum, Local, Program, Setting};

/// What couples the cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Coupling {
    /// Weight of each cell; they need no sum.
    pub weights: Vec<f64>,
    /// Neighbouring cells.
    pub pairs: Vec<(usize, usize)>,
    /// rho: what a step of a whole range costs, as twice a share of what is minimised.
    pub smooth: f64,
    /// Largest step of each free factor between neighbours, in its unit.
    pub steps: Vec<Option<f64>>,
    /// Free factors that rise or fall from the first cell of a pair to the second: number of the pair, of the factor, way.
    pub monotone: Vec<(usize, usize, Way)>,
}

/// How an input goes along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// It does not fall.
    Rising,
    /// It does not rise.
    Falling,
}

/// What the program gave.
#[derive(Clone, Debug, PartialEq)]
pub struct WholeMap {
    /// The cells, with the prices of their limits.
    pub cells: Vec<CellOptimum>,
    /// How the search ended.
    pub status: Status,
    /// Iterations.
    pub iterations: usize,
    /// Value of the whole objective.
    pub objective: f64,
}

/// Solves all cells together from `starts` (all factors of each cell; the axes stay as they are there).
pub fn solve_whole(
    setting: &Setting,
    starts: &[Vec<f64>],
    coupling: &Coupling,
    interrupt: &dyn Fn() -> bool,
) -> WholeMap {
    let mut program = Whole::new(setting, starts, coupling);
    let options = NlpOptions { tolerance: 1e-7, ..NlpOptions::default() };
    let found = solve(&mut program, &options, interrupt);
    let (nf, ns) = (program.nf, setting.sides.len());
    let cells = program.cells.iter().enumerate().map(|(k, cell)| {
        let at = k * (nf + ns);
        let x = cell.factors(&found.x[at..at + nf]);
        let weight = program.share[k].max(f64::MIN_POSITIVE);
        let saves: Vec<f64> = setting
            .sides
            .iter()
            .zip(&found.multipliers[k * ns..])
            .map(|(s, l)| (l * cell.size / (s.scale * weight)).max(0.0))
            .collect();
        setting.judge(&x, found.status, Some(&saves))
    });
    WholeMap {
        cells: cells.collect(),
        status: found.status,
        iterations: found.history.len(),
        objective: found.objective,
    }
}

/// Variables: of each cell its free factors as shares of their ranges and a slack for each limit; then a slack for each limited
/// step.
struct Whole<'a, 'b> {
    cells: Vec<Program<'a, 'b>>,
    /// Weights with sum one.
    share: Vec<f64>,
    coupling: &'a Coupling,
    nf: usize,
    ns: usize,
    /// Limited steps: cells, factor, least and greatest of what it is at the first less at the second, as shares of the range.
    steps: Vec<(usize, usize, usize, f64, f64)>,
}

impl<'a, 'b> Whole<'a, 'b> {
    fn new(setting: &'a Setting<'b>, starts: &[Vec<f64>], coupling: &'a Coupling) -> Self {
        let nf = setting.dim() - setting.axes;
        let total: f64 = coupling.weights.iter().sum();
        let spans = setting.ranges[setting.axes..].iter().map(|r| r.width());
        let limited: Vec<(usize, f64)> = spans
            .zip(&coupling.steps)
            .enumerate()
            .filter_map(|(i, (span, s))| Some((i, (*s)? / span)))
            .collect();
        let steps =
            coupling.pairs.iter().flat_map(|(k, j)| limited.iter().map(|(i, s)| (*k, *j, *i, -s, *s)));
        let ways = coupling.monotone.iter().map(|(pair, i, way)| {
            let (k, j) = coupling.pairs[*pair];
            match way {
                Way::Rising => (k, j, *i, -1.0, 0.0),
                Way::Falling => (k, j, *i, 0.0, 1.0),
            }
        });
        Self {
            cells: starts.iter().map(|x| Program::new(setting, x, false)).collect(),
            share: coupling.weights.iter().map(|w| w / total).collect(),
            coupling,
            nf,
            ns: setting.sides.len(),
            steps: steps.chain(ways).collect(),
        }
    }

    fn block(&self) -> usize {
        self.nf + self.ns
    }

    fn refresh(&mut self, v: &[f64], derivatives: bool) {
        let (block, nf) = (self.block(), self.nf);
        let each = self.cells.par_iter_mut().enumerate();
        each.for_each(|(k, c)| c.refresh(&v[k * block..k * block + nf], derivatives));
    }

    /// Difference of factor i between two cells, as a share of its range.
    fn difference(&self, v: &[f64], k: usize, j: usize, i: usize) -> f64 {
        v[k * self.block() + i] - v[j * self.block() + i]
    }

    /// Derivatives of the objective of each cell with its weight.
    fn objectives(&self) -> Vec<Local> {
        let weighted = |(c, w): (&Program, &f64)| {
            let (mut l, w) = (c.objective_local(), w / c.size);
            l.gradient.iter_mut().for_each(|g| *g *= w);
            l.hessian.iter_mut().for_each(|h| *h *= w);
            l
        };
        self.cells.par_iter().zip(&self.share).map(weighted).collect()
    }

    /// Weight of a squared difference: pairs count together as much as the cells do.
    fn rho(&self) -> f64 {
        self.coupling.smooth / self.coupling.pairs.len().max(1) as f64
    }
}

impl SparseNlp for Whole<'_, '_> {
    fn n(&self) -> usize {
        self.cells.len() * self.block() + self.steps.len()
    }

    fn m(&self) -> usize {
        self.cells.len() * self.ns + self.steps.len()
    }

    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        lower.fill(0.0);
        let block = self.block();
        for k in 0..self.cells.len() {
            upper[k * block..k * block + self.nf].fill(1.0);
        }
        let from = self.cells.len() * block;
        for (t, (.., least, most)) in self.steps.iter().enumerate() {
            (lower[from + t], upper[from + t]) = (*least, *most);
        }
    }

    fn start(&self, v: &mut [f64]) {
        let block = self.block();
        for (k, c) in self.cells.iter().enumerate() {
            c.start(&mut v[k * block..(k + 1) * block]);
        }
        let from = self.cells.len() * block;
        for (t, (k, j, i, least, most)) in self.steps.iter().enumerate() {
            v[from + t] = self.difference(v, *k, *j, *i).clamp(*least, *most);
        }
    }

    fn objective(&mut self, v: &[f64]) -> f64 {
        self.refresh(v, false);
        let of = |(c, w): (&Program, &f64)| c.objective_value() * w / c.size;
        let own: f64 = self.cells.iter().zip(&self.share).map(of).sum();
        let squares = |(k, j): &(usize, usize)| -> f64 {
            (0..self.nf).map(|i| self.difference(v, *k, *j, i).powi(2)).sum()
        };
        own + 0.5 * self.rho() * self.coupling.pairs.iter().map(squares).sum::<f64>()
    }

    fn gradient(&mut self, v: &[f64], grad: &mut [f64]) {
        self.refresh(v, true);
        grad.fill(0.0);
        let (block, rho) = (self.block(), self.rho());
        for (k, l) in self.objectives().iter().enumerate() {
            grad[k * block..k * block + self.nf].copy_from_slice(&l.gradient);
        }
        for (k, j) in &self.coupling.pairs {
            for i in 0..self.nf {
                let d = rho * self.difference(v, *k, *j, i);
                grad[k * block + i] += d;
                grad[j * block + i] -= d;
            }
        }
    }

    fn constraints(&mut self, v: &[f64], c: &mut [f64]) {
        self.refresh(v, false);
        let (block, nf, ns) = (self.block(), self.nf, self.ns);
        for (k, cell) in self.cells.iter().enumerate() {
            for (l, s) in cell.setting.sides.iter().enumerate() {
                c[k * ns + l] = cell.side_value(s) + v[k * block + nf + l];
            }
        }
        let (from, rows) = (self.cells.len() * block, self.cells.len() * ns);
        for (t, (k, j, i, ..)) in self.steps.iter().enumerate() {
            c[rows + t] = self.difference(v, *k, *j, *i) - v[from + t];
        }
    }

    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let (block, nf, ns) = (self.block(), self.nf, self.ns);
        let mut all = Vec::new();
        for k in 0..self.cells.len() {
            for l in 0..ns {
                all.extend((0..nf).map(|i| (k * ns + l, k * block + i)));
                all.push((k * ns + l, k * block + nf + l));
            }
        }
        let (from, rows) = (self.cells.len() * block, self.cells.len() * ns);
        for (t, (k, j, i, ..)) in self.steps.iter().enumerate() {
            all.extend([(rows + t, k * block + i), (rows + t, j * block + i), (rows + t, from + t)]);
        }
        all
    }

    fn jacobian(&mut self, v: &[f64], values: &mut [f64]) {
        self.refresh(v, true);
        let width = self.nf + 1;
        let ns = self.ns;
        let of_cells = self.cells.len() * ns * width;
        let (own, steps) = values.split_at_mut(of_cells);
        if ns > 0 {
            own.par_chunks_mut(ns * width).zip(&self.cells).for_each(|(rows, cell)| {
                for (row, s) in rows.chunks_mut(width).zip(&cell.setting.sides) {
                    row[..width - 1].copy_from_slice(&cell.side_local(s).gradient);
                    row[width - 1] = 1.0;
                }
            });
        }
        for row in steps.chunks_mut(3) {
            row.copy_from_slice(&[1.0, -1.0, -1.0]);
        }
    }

    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        let (block, nf) = (self.block(), self.nf);
        let mut all = Vec::new();
        for k in 0..self.cells.len() {
            all.extend((0..nf).flat_map(|i| (0..=i).map(move |j| (k * block + i, k * block + j))));
        }
        for (k, j) in &self.coupling.pairs {
            let (low, high) = (k.min(j), k.max(j));
            for i in 0..nf {
                all.extend([
                    (low * block + i, low * block + i),
                    (high * block + i, high * block + i),
                    (high * block + i, low * block + i),
                ]);
            }
        }
        all
    }

    fn hessian(&mut self, v: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        self.refresh(v, true);
        let (nf, ns) = (self.nf, self.ns);
        let each = nf * (nf + 1) / 2;
        let (own, pairs) = values.split_at_mut(self.cells.len() * each);
        let objectives = self.objectives();
        own.par_chunks_mut(each).enumerate().for_each(|(k, triangle)| {
            let cell = &self.cells[k];
            let mut sum: Vec<f64> = objectives[k].hessian.iter().map(|h| sigma * h).collect();
            for (s, w) in cell.setting.sides.iter().zip(&multipliers[k * ns..]).filter(|(_, w)| **w != 0.0) {
                let l = cell.side_local(s);
                sum.iter_mut().zip(&l.hessian).for_each(|(t, h)| *t += w * h);
            }
            let lower = (0..nf).flat_map(|i| (0..=i).map(move |j| i * nf + j));
            triangle.iter_mut().zip(lower).for_each(|(t, place)| *t = sum[place]);
        });
        let rho = sigma * self.rho();
        for three in pairs.chunks_mut(3) {
            three.copy_from_slice(&[rho, rho, -rho]);
        }
    }
}
