//! The equations of a step, as products.

mod band;
mod levels;
mod near;
mod order;
mod pairs;
mod tiles;

use std::sync::Arc;

use dynocal_numerics::linalg::{self, axpy, dot};
use dynocal_numerics::rng::Rng64;

use super::timing::spans;
use crate::error::LabelError;
use crate::graph::Graph;
use crate::graph::products::Products;
use crate::linear::Options;
use crate::nonlinear::Target;
pub(super) use levels::Levels;
use near::Near;
pub(super) use pairs::Pairs;

/// Draws of random signs for the diagonal.
const SIGNS: u64 = 8;
/// Scalars whose part of the diagonal is computed.
const MOST_SCALARS: usize = 16;
/// Damping, as a share of the diagonal, from which the diagonal is as near.
const DAMPED_MUCH: f64 = 0.1;
/// Weight of the base where nothing else holds a cell, as a share of the mean of the diagonal.
const TIE: f64 = 1e-12;

/// How far equations are solved: the part of them that may be left, and most steps of the conjugate gradients.
#[derive(Clone, Copy)]
pub(super) struct Exact {
    pub(super) left: f64,
    pub(super) most: usize,
}

/// Cells with factors, and the weight of the square.
type RoughRow = (Vec<(usize, f64)>, f64);

/// The equations at a point.
pub(super) struct System<'a> {
    products: Vec<Products<'a>>,
    targets: &'a [Target<'a>],
    pub(super) weights: Vec<Vec<f64>>,
    pub(super) residuals: Vec<Vec<f64>>,
    rough: Vec<RoughRow>,
    rough_to_base: bool,
    base: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    base_weight: Vec<f64>,
    /// Cells that are fitted.
    pub(super) free: Vec<bool>,
    /// Diagonal of `J'WJ`, estimated.
    pub(super) diagonal: Vec<f64>,
    /// Samples at each cell by their interpolation weights, and the sum of the squares of these.
    pub(super) visits: Vec<f64>,
    pub(super) facts: Vec<f64>,
    /// Pairs of scalars with their entries of `J'WJ`.
    scalars: Vec<((usize, usize), f64)>,
    /// Scalars, and the factor of the part of the equations among them.
    block: (Vec<usize>, Vec<f64>),
    /// `J'sqrt(W) e` for draws of random signs e.
    draws: Vec<Vec<f64>>,
    /// Matrices near that of the step.
    levels: Option<Arc<Levels>>,
    spans: Vec<std::ops::Range<usize>>,
}

impl<'a> System<'a> {
    pub(super) fn new(
        graph: &Graph,
        products: Vec<Products<'a>>,
        targets: &'a [Target<'a>],
        weights: &[Vec<f64>],
        options: &Options,
        smooth: f64,
    ) -> Self {
        let of = |f: &dyn Fn(&crate::label::Label) -> f64| -> Vec<f64> {
            graph.labels.iter().flat_map(|l| vec![f(l); l.len()]).collect()
        };
        let base = graph.base();
        let mut out = Self {
            products,
            targets,
            weights: weights.to_vec(),
            residuals: Vec::new(),
            rough: Vec::new(),
            rough_to_base: options.smooth_change,
            lower: of(&|l| l.lower),
            upper: of(&|l| l.upper),
            base_weight: of(&|l| l.base_weight),
            free: vec![false; base.len()],
            diagonal: vec![0.0; base.len()],
            visits: vec![0.0; base.len()],
            facts: vec![0.0; base.len()],
            base,
            scalars: Vec::new(),
            block: (Vec::new(), Vec::new()),
            draws: Vec::new(),
            levels: None,
            spans: spans(graph),
        };
        out.residuals = out.left();
        out.visit();
        out.draws = out.signs();
        out.diagonal = squares(&out.draws);
        out.find_scalars();
        let locked = graph.labels.iter().flat_map(|l| l.locked.iter().copied());
        for (k, locked) in locked.enumerate() {
            let seen = out.visits[k] >= options.least_visits.max(1e-9);
            out.free[k] = !locked && (seen || options.extrapolate);
        }
        out.roughen(graph, options, smooth);
        let mean = out.diagonal.iter().sum::<f64>() / out.diagonal.len().max(1) as f64;
        out.base_weight.iter_mut().for_each(|w| *w += TIE * mean);
        out
    }

    /// Of scalars the numbers themselves cost no more, and a film or a lag deserves them.
    fn find_scalars(&mut self) {
        let scalars = self.spans.iter().filter(|s| s.len() == 1).map(|s| s.start);
        let columns: Vec<(usize, Vec<Vec<f64>>)> = scalars
            .take(MOST_SCALARS)
            .map(|k| {
                let mut unit = vec![0.0; self.diagonal.len()];
                unit[k] = 1.0;
                (k, self.products.iter().map(|p| p.forward(&unit)).collect())
            })
            .collect();
        for (n, (i, a)) in columns.iter().enumerate() {
            for (j, b) in &columns[n..] {
                let of = |((a, b), w): ((&Vec<f64>, &Vec<f64>), &Vec<f64>)| -> f64 {
                    a.iter().zip(b).zip(w).map(|((a, b), w)| w * a * b).sum()
                };
                let v = a.iter().zip(b).zip(&self.weights).map(of).sum();
                self.scalars.push(((*i, *j), v));
                if i == j {
                    self.diagonal[*i] = v;
                }
            }
        }
    }

    /// Holds matrices near that of the step: the known ones where the sizes are still nearly their own, else new ones.
    pub(super) fn near_to(&mut self, graph: &Graph, known: Option<&Arc<Levels>>) -> Result<(), LabelError> {
        self.block = self.scalar_block()?;
        let sizes = self.sizes();
        self.levels = Some(match known.filter(|k| k.fits(&sizes)) {
            Some(known) => known.clone(),
            None => Arc::new(Levels::new(graph, self, sizes)?),
        });
        Ok(())
    }

    /// Size of the data on each label.
    fn sizes(&self) -> Vec<f64> {
        self.spans.iter().map(|s| self.diagonal[s.clone()].iter().sum()).collect()
    }

    /// Factor of the part of the equations among scalars.
    fn scalar_block(&self) -> Result<(Vec<usize>, Vec<f64>), LabelError> {
        let cells: Vec<usize> = self.spans.iter().filter(|s| s.len() == 1).map(|s| s.start).collect();
        let n = cells.len();
        let mean = self.diagonal.iter().sum::<f64>() / self.diagonal.len().max(1) as f64;
        let mut h = vec![0.0; n * n];
        for ((i, j), v) in self.scalars.iter().filter(|((i, j), _)| self.free[*i] && self.free[*j]) {
            let at = |k: &usize| cells.binary_search(k).unwrap_or_default();
            h[at(i) * n + at(j)] = *v;
        }
        for (at, k) in cells.iter().enumerate() {
            let own = self.diagonal[*k];
            // What nothing depends on yet must not seem easy to move.
            let more =
                if self.free[*k] && own > 1e-9 * mean { 1e-9 * own } else { mean.max(f64::MIN_POSITIVE) };
            h[at * n + at] =
                h[at * n + at].max(if self.free[*k] { own } else { 0.0 }) + more + self.base_weight[*k];
        }
        linalg::cholesky(&mut h, n).map_err(|e| LabelError::Singular(e.to_string()))?;
        Ok((cells, h))
    }

    /// Solves with the matrices near that of the step, scalars apart.
    fn near_all(&self, levels: &Levels, r: &[f64], moves: &[bool]) -> Result<Vec<f64>, LabelError> {
        let mut z = levels.solve(r, moves)?;
        let (cells, factor) = &self.block;
        let mut own: Vec<f64> = cells.iter().map(|k| if moves[*k] { r[*k] } else { 0.0 }).collect();
        let singular = |e: linalg::LinalgError| LabelError::Singular(e.to_string());
        linalg::solve_upper_transposed(factor, own.len(), &mut own).map_err(singular)?;
        linalg::solve_upper(factor, own.len(), &mut own).map_err(singular)?;
        cells.iter().zip(own).for_each(|(k, v)| z[*k] = if moves[*k] { v } else { 0.0 });
        Ok(z)
    }

    /// The matrices near that of the step.
    pub(super) fn levels(&self) -> Option<&Arc<Levels>> {
        self.levels.as_ref()
    }

    /// Size of the data on each label at another point, over that from which the sizes were taken: the greatest change, as a share.
    pub(super) fn grown(&self) -> f64 {
        let now = squares(&self.signs());
        let size = |d: &[f64], s: &std::ops::Range<usize>| d[s.clone()].iter().sum::<f64>();
        let rough = self.spans.iter().filter(|s| s.len() > 2);
        let change = |s: &std::ops::Range<usize>| {
            let before = size(&self.diagonal, s);
            if before > 0.0 { (size(&now, s) / before - 1.0).abs() } else { 0.0 }
        };
        rough.map(change).fold(0.0, f64::max)
    }

    /// Target less function, 0 where a sample does not count.
    fn left(&self) -> Vec<Vec<f64>> {
        let one = |((p, t), w): ((&Products, &Target), &Vec<f64>)| -> Vec<f64> {
            let counted = p.values().iter().zip(t.y).zip(w);
            counted.map(|((f, y), w)| if *w > 0.0 { y - f } else { 0.0 }).collect()
        };
        self.products.iter().zip(self.targets).zip(&self.weights).map(one).collect()
    }

    fn visit(&mut self) {
        let (visits, facts) = (&mut self.visits, &mut self.facts);
        for (p, w) in self.products.iter().zip(&self.weights) {
            let counts: Vec<bool> = w.iter().map(|w| *w > 0.0).collect();
            p.visits(&counts, &mut |cell, [sum, squares]| {
                visits[cell] += sum;
                facts[cell] += squares;
            });
        }
    }

    /// `J'sqrt(W) e` for draws of random signs e.
    fn signs(&self) -> Vec<Vec<f64>> {
        let one = |draw: u64| {
            let mut rng = Rng64::stream(0, draw);
            let mut sum = vec![0.0; self.base.len()];
            for (p, w) in self.products.iter().zip(&self.weights) {
                let u: Vec<f64> =
                    w.iter().map(|w| if rng.uniform() < 0.5 { w.sqrt() } else { -w.sqrt() }).collect();
                axpy(1.0, &p.backward(&u), &mut sum);
            }
            sum
        };
        (0..SIGNS).map(one).collect()
    }

    /// The roughness of each label in the size that the data have on it.
    fn roughen(&mut self, graph: &Graph, options: &Options, smooth: f64) {
        for (l, span) in graph.labels.iter().zip(&self.spans) {
            let from = span.start;
            // A change that is not known is none; of a value nothing is known.
            let unknown = |k: usize| !self.free[from + k] && !l.locked[k];
            let known =
                |row: &Vec<(usize, f64)>| options.smooth_change || !row.iter().any(|(k, _)| unknown(*k));
            let rows: Vec<Vec<(usize, f64)>> = l.roughness().into_iter().filter(known).collect();
            let own: f64 =
                rows.iter().flatten().filter(|(k, _)| self.free[from + k]).map(|(_, d)| d * d).sum();
            let data: f64 = span.clone().filter(|k| self.free[*k]).map(|k| self.diagonal[k]).sum();
            if !(smooth > 0.0 && own > 0.0 && data > 0.0) {
                continue;
            }
            let rows = rows.into_iter().map(|r| r.into_iter().map(|(k, d)| (from + k, d)).collect());
            self.rough.extend(rows.map(|r| (r, smooth * data / own)));
        }
    }

    /// `theta` with the base where a cell is not fitted.
    pub(super) fn known(&self, theta: &[f64]) -> Vec<f64> {
        (0..theta.len()).map(|k| if self.free[k] { theta[k] } else { self.base[k] }).collect()
    }

    /// The equations at another point.
    pub(super) fn move_to(&mut self, products: Vec<Products<'a>>) {
        self.products = products;
        self.residuals = self.left();
    }

    fn bends(&self, row: &[(usize, f64)], theta: &[f64]) -> f64 {
        let of = |k: usize| theta[k] - if self.rough_to_base { self.base[k] } else { 0.0 };
        row.iter().map(|(k, d)| d * of(*k)).sum()
    }

    /// What roughness and base cost at `theta`.
    pub(super) fn cost_of_base(&self, theta: &[f64]) -> f64 {
        let rough: f64 = self.rough.iter().map(|(row, w)| w * self.bends(row, theta).powi(2)).sum();
        let tied = (0..theta.len()).map(|k| self.base_weight[k] * (theta[k] - self.base[k]).powi(2));
        rough + tied.sum::<f64>()
    }

    /// Half of the negative gradient of the cost.
    pub(super) fn gradient(&self, theta: &[f64]) -> Vec<f64> {
        let mut g = self.back(&self.residuals, &self.weights);
        for (row, w) in &self.rough {
            let bend = self.bends(row, theta);
            row.iter().for_each(|(k, d)| g[*k] -= w * d * bend);
        }
        (0..g.len()).for_each(|k| g[k] -= self.base_weight[k] * (theta[k] - self.base[k]));
        g
    }

    /// `J'Wr`.
    pub(super) fn back(&self, r: &[Vec<f64>], weights: &[Vec<f64>]) -> Vec<f64> {
        let mut out = vec![0.0; self.base.len()];
        for ((p, r), w) in self.products.iter().zip(r).zip(weights) {
            let u: Vec<f64> = r.iter().zip(w).map(|(r, w)| r * w).collect();
            axpy(1.0, &p.backward(&u), &mut out);
        }
        out
    }

    /// `v'J'WJv`.
    pub(super) fn square(&self, v: &[f64]) -> f64 {
        let of =
            |(p, w): (&Products, &Vec<f64>)| p.forward(v).iter().zip(w).map(|(d, w)| w * d * d).sum::<f64>();
        self.products.iter().zip(&self.weights).map(of).sum()
    }

    /// The matrix of the step times `v`, over the cells that move.
    fn times(&self, v: &[f64], moves: &[bool], mu: f64) -> Vec<f64> {
        let d: Vec<Vec<f64>> = self.products.iter().map(|p| p.forward(v)).collect();
        let mut out = self.back(&d, &self.weights);
        for (row, w) in &self.rough {
            let bend: f64 = row.iter().map(|(k, d)| d * v[*k]).sum();
            row.iter().for_each(|(k, d)| out[*k] += w * d * bend);
        }
        for k in 0..v.len() {
            out[k] =
                if moves[k] { out[k] + (self.base_weight[k] + mu * self.diagonal[k]) * v[k] } else { 0.0 };
        }
        out
    }

    /// The step from `theta` with the gradient `g`, of the cells that are not held, as exact as is said.
    pub(super) fn step(
        &self,
        g: &[f64],
        theta: &[f64],
        held: &[bool],
        mu: f64,
        exact: Exact,
        pairs: &mut Pairs,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Vec<f64>, LabelError> {
        let moves: Vec<bool> = (0..g.len())
            .map(|k| {
                let low = theta[k] <= self.lower[k] && g[k] < 0.0;
                let high = theta[k] >= self.upper[k] && g[k] > 0.0;
                self.free[k] && !held[k] && !low && !high
            })
            .collect();
        self.solve(g, &moves, mu, exact, pairs, interrupt)
    }

    /// Conjugate gradients over the cells that move.
    pub(super) fn solve(
        &self,
        g: &[f64],
        moves: &[bool],
        mu: f64,
        exact: Exact,
        pairs: &mut Pairs,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Vec<f64>, LabelError> {
        let levels = self.levels.as_ref().filter(|_| mu <= DAMPED_MUCH);
        let diagonal = Near::new(self, moves, mu);
        let known = pairs.len();
        let near = |r: &[f64], pairs: &Pairs| match levels {
            Some(levels) => pairs.solve(known, r, moves, |r| self.near_all(levels, r, moves)),
            None => Ok(diagonal.solve(r)),
        };
        let mut x = vec![0.0; g.len()];
        let mut r: Vec<f64> = g.iter().zip(moves).map(|(g, m)| if *m { *g } else { 0.0 }).collect();
        let mut z = near(&r, pairs)?;
        let (mut p, mut rz) = (z.clone(), dot(&r, &z));
        let goal = exact.left * exact.left * rz;
        for _ in 0..exact.most {
            if !(rz > goal) || interrupt() {
                break;
            }
            let q = self.times(&p, moves, mu);
            let curvature = dot(&p, &q);
            if !(curvature > 0.0) {
                break;
            }
            if levels.is_some() {
                pairs.push(&p, &q, curvature);
            }
            let a = rz / curvature;
            axpy(a, &p, &mut x);
            axpy(-a, &q, &mut r);
            z = near(&r, pairs)?;
            let next = dot(&r, &z);
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + next / rz * *p);
            rz = next;
        }
        pairs.trim();
        Ok(x)
    }

    /// Diagonal of the roughness and the weight of the base.
    pub(super) fn ties(&self) -> Vec<f64> {
        let mut out = self.base_weight.clone();
        self.rough.iter().for_each(|(row, w)| row.iter().for_each(|(k, d)| out[*k] += w * d * d));
        out
    }

    /// `J'sqrt(W) e + D'sqrt(R) f + sqrt(V) h` for standard normal e, f, h: its covariance is the matrix of the equations.
    pub(super) fn noise(&self, draw: u64) -> Vec<f64> {
        let mut rng = Rng64::stream(1, draw);
        let e: Vec<Vec<f64>> =
            self.weights.iter().map(|w| w.iter().map(|w| w.sqrt() * rng.normal()).collect()).collect();
        let ones: Vec<Vec<f64>> = e.iter().map(|e| vec![1.0; e.len()]).collect();
        let mut out = self.back(&e, &ones);
        for (row, w) in &self.rough {
            let f = w.sqrt() * rng.normal();
            row.iter().for_each(|(k, d)| out[*k] += f * d);
        }
        out.iter_mut().zip(&self.base_weight).for_each(|(o, w)| *o += w.sqrt() * rng.normal());
        out
    }
}

/// Mean squares over draws.
fn squares(draws: &[Vec<f64>]) -> Vec<f64> {
    let mut out = vec![0.0; draws.first().map_or(0, Vec::len)];
    for draw in draws {
        out.iter_mut().zip(draw).for_each(|(o, s)| *o += s * s / draws.len() as f64);
    }
    out
}
