//! Orthogonal forward regression over a pool whose columns are never stored.
//!
//! ```text
//! w_i = phi_i - sum_k (q_k' phi_i / q_k' q_k) q_k        candidate i outside the chosen terms q_1 .. q_m
//! gain_i = (w_i' e)^2 / w_i' w_i                         what it takes from the residual sum of squares
//! w_i' w_i = phi_i' phi_i - sum_k (q_k' phi_i)^2 / q_k' q_k,    w_i' e = phi_i' e
//! ```
//!
//! (thesis eqs. 2.42 to 2.44). The two running numbers of each candidate need one moment `q_k' phi_i` per term that is
//! taken (see [`super::tree`]). They carry the rounding of long sums; each step therefore bounds every gain from above,
//! forms the most promising columns themselves, orthogonalises them twice, and takes the best of these exact ones once
//! no bound lies above it. The answer is that of Gram-Schmidt on the stored matrix.

use std::collections::BTreeSet;

use dynocal_numerics::linalg::{axpy, dot, invert_upper};

use super::SelectError;
use super::pool::Pool;
use super::tree::Tree;
use crate::data::DataError;
use crate::estimate::EstimateError;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::poly::function::Function;
use crate::model::poly::{Factor, PolyNarx, Regressor};

/// A candidate whose part outside the chosen ones is shorter than this (relative to its length) is dependent.
const DEPENDENT: f64 = 1e-7;
/// Bound on the rounding of a moment, relative to the product of the norms.
const ROUNDING: f64 = 32.0 * f64::EPSILON;
/// The products with the residual are formed anew when it has become this much shorter.
const REFRESH: f64 = 1e-3;

/// A candidate made orthogonal to the chosen terms.
#[derive(Clone, Debug)]
pub(crate) struct Column {
    /// Place in the pool.
    pub(crate) candidate: usize,
    /// Orthogonal part w (n) and its w'w, w'e.
    pub(crate) w: Vec<f64>,
    pub(crate) norm: f64,
    pub(crate) with_residual: f64,
    /// Its coefficients on the chosen terms.
    coefficients: Vec<f64>,
}

impl Column {
    /// Decrease of the residual sum of squares when it is taken.
    pub(crate) fn gain(&self) -> f64 {
        self.with_residual * self.with_residual / self.norm
    }
}

/// Scored samples of all experiments: the variables of a pool (one column each) and the weighted output.
#[derive(Clone, Debug)]
struct Samples {
    n: usize,
    columns: Vec<f64>,
    /// Square roots of the weights; empty for all one.
    root_weights: Vec<f64>,
    y: Vec<f64>,
}

/// The chosen terms as an orthogonal basis, and what each candidate would add.
#[derive(Clone, Debug)]
pub(crate) struct Basis {
    tree: Tree,
    products: Vec<Vec<usize>>,
    samples: Samples,
    /// phi'phi, w'w and phi'e of every candidate.
    length: Vec<f64>,
    norm: Vec<f64>,
    with_residual: Vec<f64>,
    /// Norm of the residual when `with_residual` was last formed anew.
    residual_then: f64,
    /// e: weighted output without what the chosen terms explain.
    residual: Vec<f64>,
    chosen: Vec<Column>,
    /// sum_k q_k(t)^2 / q_k'q_k: the leverage of every sample.
    leverage: Vec<f64>,
    /// y'y of the weighted output.
    total: f64,
}

impl Basis {
    /// No term chosen yet. Samples with a missing value (NaN) are left out.
    ///
    /// # Errors
    /// [`SelectError`] when a record is too short, or fewer than `least` samples are there.
    pub(crate) fn new(pool: &Pool, data: &[Experiment], least: usize) -> Result<Self, SelectError> {
        let (variables, products) = variables_and_products(pool);
        let samples = Samples::new(pool, &variables, data)?;
        if samples.n < least {
            let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
            let why = format!("{least} terms asked for");
            let fault = DataError::TooShort { record, found: samples.n, expected: least, why };
            return Err(EstimateError::from(fault).into());
        }
        let tree = Tree::new(variables.len(), &products);
        let squares: Vec<f64> = match samples.root_weights.as_slice() {
            [] => vec![1.0; samples.n],
            w => w.iter().map(|w| w * w).collect(),
        };
        let length = tree.moments(&samples.columns, &squares, true);
        if let Some(k) = length.iter().position(|v| !v.is_finite()) {
            let message = format!("candidate `{}` overflows on this data: scale the channels", pool.text(k));
            return Err(SelectError::Pool { message });
        }
        let mut basis = Self {
            norm: length.clone(),
            with_residual: Vec::new(),
            residual_then: 0.0,
            residual: samples.y.clone(),
            chosen: Vec::new(),
            leverage: vec![0.0; samples.n],
            total: dot(&samples.y, &samples.y),
            length,
            tree,
            products,
            samples,
        };
        basis.refresh();
        Ok(basis)
    }

    /// Scored samples.
    pub(crate) fn n(&self) -> usize {
        self.samples.n
    }

    /// y'y of the weighted output.
    pub(crate) fn total(&self) -> f64 {
        self.total
    }

    /// e'e.
    pub(crate) fn residual_sum_squares(&self) -> f64 {
        dot(&self.residual, &self.residual)
    }

    /// Chosen terms, in the order in which they were taken.
    pub(crate) fn chosen(&self) -> impl Iterator<Item = usize> + '_ {
        self.chosen.iter().map(|c| c.candidate)
    }

    /// Mean square of the leave-one-out residuals `e(t) / (1 - h(t))`.
    pub(crate) fn press(&self) -> f64 {
        let sum: f64 =
            self.residual.iter().zip(&self.leverage).map(|(e, h)| (e / (1.0 - h).max(1e-12)).powi(2)).sum();
        sum / self.n() as f64
    }

    /// Moments of all candidates with a weighted column.
    fn moments(&self, q: &[f64]) -> Vec<f64> {
        match self.samples.root_weights.as_slice() {
            [] => self.tree.moments(&self.samples.columns, q, false),
            w => {
                let v: Vec<f64> = w.iter().zip(q).map(|(w, q)| w * q).collect();
                self.tree.moments(&self.samples.columns, &v, false)
            }
        }
    }

    fn refresh(&mut self) {
        self.with_residual = self.moments(&self.residual);
        self.residual_then = self.residual_sum_squares().sqrt();
    }

    /// Centred correlation of every candidate (as it is, not orthogonalised) with the residual, squared (thesis
    /// eq. 2.34). Zero for one that is constant.
    pub(crate) fn squared_correlations(&self) -> Vec<f64> {
        let ones: Vec<f64> = match self.samples.root_weights.as_slice() {
            [] => vec![1.0; self.n()],
            w => w.to_vec(),
        };
        let weight = dot(&ones, &ones);
        let mean = dot(&ones, &self.residual) / weight;
        let spread = self.residual_sum_squares() - weight * mean * mean;
        let sums = self.moments(&ones);
        (0..self.products.len())
            .map(|i| {
                let centre = sums[i] / weight;
                let own = self.length[i] - weight * centre * centre;
                if own <= DEPENDENT * DEPENDENT * self.length[i] || spread <= 0.0 {
                    return 0.0;
                }
                (self.with_residual[i] - weight * centre * mean).powi(2) / (own * spread)
            })
            .collect()
    }

    /// Weighted output (n).
    pub(crate) fn output(&self) -> &[f64] {
        &self.samples.y
    }

    /// Column i of the pool, weighted.
    pub(crate) fn plain(&self, i: usize) -> Vec<f64> {
        let n = self.n();
        let mut w = match self.samples.root_weights.as_slice() {
            [] => vec![1.0; n],
            w => w.to_vec(),
        };
        for &x in &self.products[i] {
            let x = &self.samples.columns[x * n..(x + 1) * n];
            w.iter_mut().zip(x).for_each(|(w, x)| *w *= x);
        }
        w
    }

    /// Candidate i made orthogonal to the chosen terms, twice; `None` when nothing is left of it.
    pub(crate) fn column(&self, i: usize) -> Option<Column> {
        if self.chosen.iter().any(|c| c.candidate == i) {
            return None;
        }
        let mut w = self.plain(i);
        let length = dot(&w, &w);
        let mut coefficients = vec![0.0; self.chosen.len()];
        for _ in 0..2 {
            for (a, q) in coefficients.iter_mut().zip(&self.chosen) {
                let part = dot(&w, &q.w) / q.norm;
                axpy(-part, &q.w, &mut w);
                *a += part;
            }
        }
        let norm = dot(&w, &w);
        let with_residual = dot(&w, &self.residual);
        (norm > DEPENDENT * DEPENDENT * length).then_some(Column {
            candidate: i,
            w,
            norm,
            with_residual,
            coefficients,
        })
    }

    /// The candidates with the largest gains, exact, the largest first; at most `count` (at least 1).
    pub(crate) fn best(&self, count: usize) -> Vec<Column> {
        let count = count.max(1);
        let mut bounds: Vec<(f64, usize)> =
            (0..self.products.len()).filter_map(|i| self.bound(i).map(|b| (b, i))).collect();
        bounds.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut found: Vec<Column> = Vec::new();
        for (bound, i) in bounds {
            if found.len() >= count && bound <= found[count - 1].gain() {
                break;
            }
            let Some(column) = self.column(i) else { continue };
            let place = found.partition_point(|f| f.gain() >= column.gain());
            found.insert(place, column);
            found.truncate(count);
        }
        found
    }

    /// Upper bound of the gain of candidate i; `None` for one that is surely dependent.
    fn bound(&self, i: usize) -> Option<f64> {
        let slack = ROUNDING * self.length[i];
        let least = DEPENDENT * DEPENDENT * self.length[i];
        if self.norm[i] + slack <= least {
            return None;
        }
        let product = self.with_residual[i].abs() + ROUNDING * self.length[i].sqrt() * self.residual_then;
        let whole = self.residual_sum_squares_bound();
        Some((product * product / (self.norm[i] - slack).max(least)).min(whole))
    }

    fn residual_sum_squares_bound(&self) -> f64 {
        self.residual_then * self.residual_then
    }

    /// Takes a column that [`Basis::column`] or [`Basis::best`] gave for the present basis.
    pub(crate) fn take(&mut self, column: Column) {
        let g = column.with_residual / column.norm;
        axpy(-g, &column.w, &mut self.residual);
        for (h, w) in self.leverage.iter_mut().zip(&column.w) {
            *h += w * w / column.norm;
        }
        let products = self.moments(&column.w);
        for (i, c) in products.iter().enumerate() {
            self.norm[i] -= c * c / column.norm;
            self.with_residual[i] -= g * c;
        }
        self.norm[column.candidate] = 0.0;
        self.chosen.push(column);
        if self.residual_sum_squares().sqrt() < REFRESH * self.residual_then {
            self.refresh();
        }
    }

    /// Starts again with these terms; one that depends on those before it is left out.
    pub(crate) fn restart(&mut self, terms: &[usize]) {
        self.norm.clone_from(&self.length);
        self.residual.clone_from(&self.samples.y);
        self.leverage.fill(0.0);
        self.chosen.clear();
        self.refresh();
        for &i in terms {
            if let Some(column) = self.column(i) {
                self.take(column);
            }
        }
    }

    /// Least-squares parameters of the chosen terms, and of one more if given, in the order of taking.
    pub(crate) fn theta(&self, more: Option<&Column>) -> Vec<f64> {
        let columns: Vec<&Column> = self.chosen.iter().chain(more).collect();
        // g of an earlier term was formed with the residual of its time: unchanged by later ones.
        let mut theta: Vec<f64> = columns.iter().map(|c| c.with_residual / c.norm).collect();
        for k in (0..columns.len()).rev() {
            for j in k + 1..columns.len() {
                theta[k] -= columns[j].coefficients[k] * theta[j];
            }
        }
        theta
    }

    /// Partial F of every chosen term, `theta_k^2 / (s^2 [(X'X)^-1]_kk)` (thesis eq. 2.41).
    pub(crate) fn partial_f(&self) -> Vec<f64> {
        let m = self.chosen.len();
        let theta = self.theta(None);
        let s2 = self.residual_sum_squares() / (self.n() - m).max(1) as f64;
        // X = Q A with unit upper triangular A: (X'X)^-1 = A^-1 D^-1 A^-T, D = diag(q'q).
        let (mut a, mut inverse) = (vec![0.0; m * m], vec![0.0; m * m]);
        for (j, c) in self.chosen.iter().enumerate() {
            a[j * m + j] = 1.0;
            c.coefficients.iter().enumerate().for_each(|(i, v)| a[i * m + j] = *v);
        }
        // A unit diagonal has no zero pivot.
        let _ = invert_upper(&a, m, &mut inverse);
        (0..m)
            .map(|k| {
                let own: f64 = (k..m).map(|j| inverse[k * m + j].powi(2) / self.chosen[j].norm).sum();
                theta[k] * theta[k] / (s2 * own)
            })
            .collect()
    }
}

/// What products are made of: a lagged channel or a function of some, to the power one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Variable {
    Plain(Factor),
    Function(Function),
}

impl Variable {
    /// Those of a regressor, powers repeated, in their order.
    fn all(r: &Regressor) -> Vec<Self> {
        let plain = r
            .factors()
            .iter()
            .flat_map(|f| std::iter::repeat_n(Variable::Plain(Factor { power: 1, ..*f }), f.power as usize));
        let functions = r.functions().iter().flat_map(|f| {
            std::iter::repeat_n(Variable::Function(Function { power: 1, ..f.clone() }), f.power as usize)
        });
        plain.chain(functions).collect()
    }

    fn regressor(&self) -> Regressor {
        match self {
            Variable::Plain(f) => Regressor::new(vec![*f]),
            Variable::Function(f) => Regressor::constant().with_functions(std::slice::from_ref(f)),
        }
    }
}

/// The distinct variables of a pool, and each candidate as a sorted list of them.
fn variables_and_products(pool: &Pool) -> (Vec<Regressor>, Vec<Vec<usize>>) {
    let candidates: Vec<Vec<Variable>> = pool.candidates().iter().map(Variable::all).collect();
    let variables: BTreeSet<&Variable> = candidates.iter().flatten().collect();
    let variables: Vec<&Variable> = variables.into_iter().collect();
    let place = |v: &Variable| variables.partition_point(|other| *other < v);
    let products = candidates.iter().map(|c| c.iter().map(place).collect()).collect();
    (variables.iter().map(|v| v.regressor()).collect(), products)
}

impl Samples {
    fn new(pool: &Pool, variables: &[Regressor], data: &[Experiment]) -> Result<Self, SelectError> {
        let mut regressors = vec![Regressor::constant()];
        regressors.extend_from_slice(variables);
        let model = PolyNarx::new(pool.inputs().to_vec(), pool.output().into(), regressors)
            .map_err(EstimateError::from)?;
        usable_records(&model, data)?;
        let (p, zeros) = (model.n_params(), vec![0.0; model.n_params()]);
        let (mut y, mut weights) = (Vec::new(), Vec::new());
        let mut values = vec![Vec::new(); variables.len()];
        for e in data {
            let run = e.run(&model);
            let mut rows = vec![0.0; e.len() * p];
            model.one_step_jacobian(&zeros, &run, &mut rows);
            for t in run.start..e.len() {
                let row = &rows[t * p..(t + 1) * p];
                if !e.y[t].is_finite() || row.iter().any(|v| !v.is_finite()) {
                    continue;
                }
                let w = e.weight(t).sqrt();
                y.push(w * e.y[t]);
                weights.push(w);
                values.iter_mut().zip(&row[1..]).for_each(|(column, v)| column.push(*v));
            }
        }
        let n = y.len();
        let root_weights = if weights.iter().all(|w| *w == 1.0) { Vec::new() } else { weights };
        Ok(Self { n, columns: values.concat(), root_weights, y })
    }
}

/// Records that hold something to score, of the right shape; fewer samples than candidates are no fault here.
fn usable_records(model: &PolyNarx, data: &[Experiment]) -> Result<(), SelectError> {
    let some = !data.is_empty() && data.iter().all(|e| e.len() > e.first(model));
    match crate::model::usable_samples(model, data) {
        Err(DataError::TooShort { .. }) if some => Ok(()),
        Err(e) => Err(EstimateError::from(e).into()),
        Ok(_) => Ok(()),
    }
}
