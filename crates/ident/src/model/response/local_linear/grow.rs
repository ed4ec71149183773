//! Growth of the tree: where to split, and when to stop.

use dynocal_numerics::linalg::{axpy, dot};
use dynocal_numerics::optim::{Bounds, Budget, Objective, Optimiser, QuasiNewton};
use rayon::prelude::*;

use super::super::LeftOut;
use super::super::bands::Bands;
use super::super::features::Coefficients;
use super::super::stepwise::weighted;
use super::LocalLinear;
use super::tree::{Leaf, Split, Tree};

/// Splits in a row that may fail to improve before the best tree is taken.
const PATIENCE: usize = 2;
/// Leaves with the largest errors that are tried for the next split.
const TRIED: usize = 3;
/// Relative improvement of the left-out squares that counts.
const DECREASE: f64 = 1e-3;
/// A split is never steeper than over points that spread by this share of the standard deviation of all.
const NARROWEST: f64 = 0.1;
/// Step of the differences that place a split: the loss is smooth and exact to some 1e-15.
const STEP: f64 = 1e-6;
/// No point may carry its own local prediction by more than this.
const LEVERAGE: f64 = 1.0 - 1e-9;

/// A tree with its local models at the points.
#[derive(Clone)]
pub(super) struct Grown {
    pub(super) tree: Tree,
    /// Slope of its splits.
    pub(super) slope: f64,
    /// Trees on the way to it, one leaf more each, itself last.
    pub(super) path: Vec<Tree>,
    x: Vec<f64>,
    y: Vec<f64>,
    locals: Vec<Local>,
}

/// A local model at the points.
#[derive(Clone)]
struct Local {
    /// Validity (n).
    validity: Vec<f64>,
    /// Coefficients (k).
    w: Vec<f64>,
    /// (X'Phi X)^-1 (k x k).
    inverse: Vec<f64>,
    /// Phi e and Phi e / (1 - h) (n).
    error: Vec<f64>,
    left_out: Vec<f64>,
    /// Phi h summed: its share of the degrees of freedom, point by point (n).
    own: Vec<f64>,
}

impl Local {
    fn fit(x: &[f64], k: usize, y: &[f64], validity: Vec<f64>) -> Option<Self> {
        let (w, inverse) = weighted(x, k, &validity, y)?;
        let n = y.len();
        let (mut error, mut left_out, mut own) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        let mut product = vec![0.0; k];
        for i in 0..n {
            let phi = validity[i];
            if phi < 1e-12 {
                continue;
            }
            let row = &x[i * k..(i + 1) * k];
            product.fill(0.0);
            row.iter().zip(inverse.chunks_exact(k)).for_each(|(r, line)| axpy(*r, line, &mut product));
            let h = phi * dot(row, &product);
            let e = phi * (y[i] - dot(row, &w));
            error[i] = e;
            left_out[i] = if h < LEVERAGE { e / (1.0 - h) } else { f64::INFINITY };
            own[i] = phi * h;
        }
        Some(Self { validity, w, inverse, error, left_out, own })
    }
}

/// The best tree over the slopes that are tried. They grow side by side, which is not interrupted; after an interrupt only the
/// first grows.
pub(super) fn best(
    keys: &LocalLinear,
    z: &[f64],
    y: &[f64],
    d: usize,
    interrupt: &dyn Fn() -> bool,
) -> Option<Grown> {
    let slopes = if interrupt() { &keys.steepness[..1] } else { &keys.steepness[..] };
    let grown: Vec<Option<Grown>> = slopes.par_iter().map(|slope| grow(keys, *slope, z, y, d)).collect();
    grown.into_iter().flatten().min_by(|a, b| a.press().total_cmp(&b.press()))
}

fn grow(keys: &LocalLinear, slope: f64, z: &[f64], y: &[f64], d: usize) -> Option<Grown> {
    let tree = Tree::root(d, keys.quadratic);
    let k = tree.local_terms();
    let mut x = vec![0.0; y.len() * k];
    z.chunks_exact(d).zip(x.chunks_exact_mut(k)).for_each(|(z, x)| tree.regressors(z, x));
    let first = Local::fit(&x, k, y, vec![1.0; y.len()])?;
    let mut path = vec![tree.clone()];
    let mut now = Grown { tree, slope, path: Vec::new(), x, y: y.to_vec(), locals: vec![first] };
    let mut best = now.clone();
    let mut idle = 0;
    while now.tree.leaves.len() < keys.most && idle < PATIENCE {
        let Some(next) = now.split_once(slope, z, d) else { break };
        path.push(next.tree.clone());
        if next.press() < (1.0 - DECREASE) * best.press() {
            best = next.clone();
            idle = 0;
        } else {
            idle += 1;
        }
        now = next;
    }
    path.truncate(best.tree.leaves.len());
    best.path = path;
    Some(best)
}

impl Grown {
    /// The local models of a tree that stands; `None` where they have too few points.
    pub(super) fn of(tree: &Tree, slope: f64, z: &[f64], y: &[f64]) -> Option<Self> {
        let k = tree.local_terms();
        let mut x = vec![0.0; y.len() * k];
        z.chunks_exact(tree.dim).zip(x.chunks_exact_mut(k)).for_each(|(z, x)| tree.regressors(z, x));
        let local = |leaf: &Leaf| {
            Local::fit(&x, k, y, z.chunks_exact(tree.dim).map(|z| tree.validity(leaf, z, None)).collect())
        };
        let locals = tree.leaves.iter().map(local).collect::<Option<Vec<Local>>>()?;
        Some(Self { tree: tree.clone(), slope, path: Vec::new(), x, y: y.to_vec(), locals })
    }

    /// Coefficients of the local models, leaf by leaf.
    pub(super) fn values(&self) -> Vec<f64> {
        self.locals.iter().flat_map(|l| l.w.iter().copied()).collect()
    }

    /// Sum of squares of left-out residuals.
    fn press(&self) -> f64 {
        self.sum(|l| &l.left_out).iter().map(|e| e * e).sum()
    }

    fn sum(&self, of: impl Fn(&Local) -> &Vec<f64>) -> Vec<f64> {
        let mut sum = vec![0.0; self.y.len()];
        self.locals.iter().for_each(|l| axpy(1.0, of(l), &mut sum));
        sum
    }

    /// The best split of the leaves with the largest errors.
    fn split_once(&self, slope: f64, z: &[f64], d: usize) -> Option<Self> {
        let k = self.tree.local_terms();
        let error = self.sum(|l| &l.error);
        let loss = |l: &Local| -> f64 { l.validity.iter().zip(&error).map(|(p, e)| p * e * e).sum() };
        let mut order: Vec<usize> = (0..self.locals.len()).collect();
        // A leaf with fewer points than its two children have coefficients cannot be split.
        order.retain(|l| self.locals[*l].validity.iter().sum::<f64>() > 2.0 * (k as f64 + 0.5));
        order.sort_by(|a, b| loss(&self.locals[*b]).total_cmp(&loss(&self.locals[*a])).then(a.cmp(b)));
        let tried = order.into_iter().take(TRIED).filter_map(|leaf| self.split_leaf(leaf, slope, z, d));
        tried.min_by(|a, b| a.press().total_cmp(&b.press()))
    }

    fn split_leaf(&self, leaf: usize, slope: f64, z: &[f64], d: usize) -> Option<Self> {
        let mut others = self.sum(|l| &l.left_out);
        axpy(-1.0, &self.locals[leaf].left_out, &mut others);
        let mut place = Placement::new(self, leaf, slope, z, d, &others);
        let parent = self.tree.leaves[leaf].path.last().map(|(s, _)| self.tree.splits[*s].normal.clone());
        let axes = (0..d).map(|j| (0..d).map(|i| f64::from(u8::from(i == j))).collect::<Vec<f64>>());
        let starts = axes.chain(parent.map(|v| {
            let length = dot(&v, &v).sqrt();
            v.iter().map(|v| v / length).collect()
        }));
        let start = starts
            .map(|mut direction: Vec<f64>| {
                direction.push(0.0);
                (place.loss(&direction), direction)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        let bounds = Bounds { lower: vec![-2.0; d + 1], upper: vec![2.0; d + 1] };
        let budget = Budget { evaluations: 25, gradient_tolerance: 1e-4, value_tolerance: 1e-4 };
        let found = QuasiNewton::default().minimise(&mut place, &bounds, &start.1, &budget);
        let split = place.split(&found.x)?;
        let (a, b) = place.children(&split)?;
        let mut next = self.clone();
        let number = next.tree.splits.len();
        next.tree.splits.push(split);
        let mut other: Leaf = next.tree.leaves[leaf].clone();
        next.tree.leaves[leaf].path.push((number, true));
        other.path.push((number, false));
        next.tree.leaves.push(other);
        next.locals[leaf] = a;
        next.locals.push(b);
        Some(next)
    }

    /// Leverage of each point: the derivative of its prediction with respect to its measurement.
    fn leverage(&self) -> Vec<f64> {
        self.sum(|l| &l.own)
    }

    /// Variance of the noise as it would be if the splits had been known: too small, as they follow the noise as well.
    pub(super) fn noise(&self) -> f64 {
        let squares: f64 = self.sum(|l| &l.error).iter().map(|e| e * e).sum();
        let free = self.y.len() as f64 - self.leverage().iter().sum::<f64>();
        squares / free.max(1.0)
    }

    /// Left-out residuals with their variance, times a unit.
    pub(super) fn left_out(&self, unit: f64) -> LeftOut {
        let noise = self.noise() * unit * unit;
        LeftOut {
            residuals: self.sum(|l| &l.left_out).iter().map(|e| unit * e).collect(),
            variance: self.leverage().iter().map(|h| noise / (1.0 - h.min(0.99))).collect(),
        }
    }

    /// Coefficients of all local models with their common covariance:
    ///
    /// ```text
    /// cov(w_l, w_m) = s^2 (X'Phi_l X)^-1 X' Phi_l Phi_m X (X'Phi_m X)^-1
    /// ```
    ///
    /// with s^2 = `bands.response`.
    pub(super) fn coefficients(&self, bands: Bands) -> Coefficients {
        let (k, n) = (self.tree.local_terms(), self.y.len());
        let p = k * self.locals.len();
        // One row per coefficient: its derivative with respect to the measurements.
        let mut rows = vec![0.0; p * n];
        for (l, local) in self.locals.iter().enumerate() {
            for i in 0..n {
                for a in 0..k {
                    let line = &local.inverse[a * k..(a + 1) * k];
                    rows[(l * k + a) * n + i] = local.validity[i] * dot(line, &self.x[i * k..(i + 1) * k]);
                }
            }
        }
        let row = |a: usize| &rows[a * n..(a + 1) * n];
        let mut covariance = vec![0.0; p * p];
        for a in 0..p {
            for b in a..p {
                covariance[a * p + b] = bands.response * dot(row(a), row(b));
                covariance[b * p + a] = covariance[a * p + b];
            }
        }
        Coefficients { values: self.values(), covariance, noise: bands.noise }
    }
}

/// Where a leaf is split: direction (d) and position, the slope follows from the spread of the points along it.
struct Placement<'a> {
    grown: &'a Grown,
    leaf: usize,
    slope: f64,
    z: &'a [f64],
    d: usize,
    /// Left-out errors of the other leaves.
    others: &'a [f64],
    centre: Vec<f64>,
    covariance: Vec<f64>,
}

impl<'a> Placement<'a> {
    fn new(grown: &'a Grown, leaf: usize, slope: f64, z: &'a [f64], d: usize, others: &'a [f64]) -> Self {
        let validity = &grown.locals[leaf].validity;
        let total: f64 = validity.iter().sum();
        let mut centre = vec![0.0; d];
        z.chunks_exact(d).zip(validity).for_each(|(z, p)| axpy(p / total, z, &mut centre));
        let mut covariance = vec![0.0; d * d];
        for (z, p) in z.chunks_exact(d).zip(validity) {
            for i in 0..d {
                for j in 0..d {
                    covariance[i * d + j] += p / total * (z[i] - centre[i]) * (z[j] - centre[j]);
                }
            }
        }
        Self { grown, leaf, slope, z, d, others, centre, covariance }
    }

    /// Position is in standard deviations from the centre.
    fn split(&self, parameters: &[f64]) -> Option<Split> {
        let (direction, position) = (&parameters[..self.d], parameters[self.d]);
        let spread: f64 = (0..self.d)
            .map(|i| direction[i] * dot(&self.covariance[i * self.d..(i + 1) * self.d], direction))
            .sum();
        if !(spread > 1e-12) {
            return None;
        }
        let factor = self.slope / spread.sqrt().max(NARROWEST);
        let normal: Vec<f64> = direction.iter().map(|v| factor * v).collect();
        Some(Split { offset: -dot(&normal, &self.centre) - self.slope * position, normal })
    }

    fn children(&self, split: &Split) -> Option<(Local, Local)> {
        let k = self.grown.tree.local_terms();
        let psi: Vec<f64> = self.z.chunks_exact(self.d).map(|z| split.psi(z)).collect();
        let parent = &self.grown.locals[self.leaf].validity;
        let side =
            |of: &dyn Fn(f64) -> f64| parent.iter().zip(&psi).map(|(p, s)| p * of(*s)).collect::<Vec<f64>>();
        let (left, right) = (side(&|s| s), side(&|s| 1.0 - s));
        // Both need more weight than they have coefficients.
        if left.iter().sum::<f64>().min(right.iter().sum()) < k as f64 + 0.5 {
            return None;
        }
        let (x, y) = (&self.grown.x, &self.grown.y);
        Some((Local::fit(x, k, y, left)?, Local::fit(x, k, y, right)?))
    }

    fn loss(&self, parameters: &[f64]) -> f64 {
        let Some((a, b)) = self.split(parameters).and_then(|s| self.children(&s)) else {
            return f64::INFINITY;
        };
        let each = self.others.iter().zip(&a.left_out).zip(&b.left_out);
        each.map(|((o, a), b)| (o + a + b).powi(2)).sum()
    }
}

impl Objective for Placement<'_> {
    fn n(&self) -> usize {
        self.d + 1
    }

    fn value_gradient(&mut self, x: &[f64], grad: &mut [f64]) -> f64 {
        let value = self.loss(x);
        let mut at = x.to_vec();
        for (j, g) in grad.iter_mut().enumerate() {
            let mut slope = |h: f64| {
                at[j] = x[j] + h;
                let moved = self.loss(&at);
                at[j] = x[j];
                (moved - value) / h
            };
            // A side on which the split is not allowed has no slope.
            *g = [STEP, -STEP].into_iter().map(&mut slope).find(|s| s.is_finite()).unwrap_or(0.0);
        }
        value
    }
}
