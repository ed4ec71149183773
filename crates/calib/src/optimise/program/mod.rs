//! A calibration problem over a whole record as one sparse program (thesis eqs. 7.11 to 7.14, for any channels).
//!
//! ```text
//! minimise    sum_j P_j(x)  +  sum_c w_c mean_t (x_c(t) - x_c(t-1))^2  +  soft
//! subject to  model equations, one per output and sample             (`row`)
//!             x_c(t) - x_c(t-1) = s,     |s| <= rate_c
//!             sum_t P_k(t) + s = upper_k,       s >= 0                means with a limit
//!             x_c(t) - p + q = upper,           p, q >= 0             soft limits, price p
//!             lower_c <= x_c(t) <= upper_c
//! ```
//!
//! Where a demand may give way (`ModelRow::give`), what it gives is a variable of each sample and its square has a price.
//!
//! x are the columns: inputs that may move, and outputs that are not demanded. Because a demand is met exactly, the past
//! outputs that its model reads are the demand itself: the recursion drops out, and each sample adds one equation in a
//! short window of inputs. An output with limits keeps its recursion: it is a variable of each sample, tied to those
//! before by its model. Either way the program is sparse and banded along time, which is what makes the batch over all
//! samples the fastest way as well as the best.

mod columns;
mod hessian;
mod product;
mod row;
mod sum;

pub use columns::{Column, Columns, FIXED};
pub use product::{Product, Reading};
pub use row::{ModelRow, Target};
pub use sum::{SoftLimit, Sum, SumLimit};

use columns::Increment;
use dynocal_numerics::nlp::SparseNlp;
use hessian::{NOWHERE, Places};
use row::Rows;

/// What makes up a program.
pub struct Parts<'a> {
    /// Columns.
    pub columns: Vec<Column>,
    /// Start values and history, samples x columns.
    pub values: Vec<f64>,
    /// Models.
    pub rows: Vec<ModelRow<'a>>,
    /// Objective beside increments and prices.
    pub objective: Vec<Sum>,
    /// Limits of sums.
    pub sums: Vec<SumLimit>,
    /// Soft limits.
    pub soft: Vec<SoftLimit>,
    /// Samples that means are taken over.
    pub divisor: f64,
}

/// The program in the form of the interior point.
pub struct Program<'a> {
    /// Columns with their values at the last point.
    pub columns: Columns,
    rows: Vec<Rows<'a>>,
    objective: Vec<Sum>,
    sums: Vec<SumLimit>,
    soft: Vec<SoftLimit>,
    divisor: f64,
    /// Increments of the columns with a rate limit, each with its column.
    rates: Vec<(usize, Increment)>,
    /// (soft limit, sample, variable).
    soft_at: Vec<(usize, usize, usize)>,
    hessian_structure: Vec<(usize, usize)>,
    /// Places of (now, now), (now, before), (before, before) of each weighted increment.
    increment_places: Vec<(usize, Increment, [usize; 3])>,
    objective_places: Vec<Vec<usize>>,
    sum_places: Vec<Vec<usize>>,
    from: usize,
    /// Columns that the caller gave.
    width: usize,
    /// Size of each column for the search.
    sizes: Vec<f64>,
    /// Where derivatives were taken: one pass gives first and second, and the interior point asks for both.
    derived_at: Vec<f64>,
}

impl<'a> Program<'a> {
    /// Lays the structure out.
    pub fn new(parts: Parts<'a>) -> Self {
        let width = parts.columns.len();
        let (columns, gives, objective) = give_way(&parts);
        let sizes = sizes(&parts, &columns);
        let rows = parts.rows.into_iter().zip(gives).map(|(r, give)| Rows::new(r, give, &columns)).collect();
        let limited = (0..columns.width()).filter(|c| columns.columns[*c].rate.is_finite());
        let rates = limited.flat_map(|c| columns.increments(c).map(move |i| (c, i))).collect();
        let mut soft_at = Vec::new();
        for (k, s) in parts.soft.iter().enumerate() {
            let of = (0..columns.samples).map(|t| (k, t, columns.variable(t, s.column)));
            soft_at.extend(of.filter(|(_, _, v)| *v != FIXED));
        }
        let from = (0..columns.samples)
            .find(|&t| (0..columns.width()).any(|c| columns.variable(t, c) != FIXED))
            .unwrap_or(0);
        let mut program = Self {
            columns,
            rows,
            objective,
            sums: parts.sums,
            soft: parts.soft,
            divisor: parts.divisor,
            rates,
            soft_at,
            hessian_structure: Vec::new(),
            increment_places: Vec::new(),
            objective_places: Vec::new(),
            sum_places: Vec::new(),
            from,
            width,
            sizes,
            derived_at: Vec::new(),
        };
        program.lay_out_hessian();
        program
    }

    /// Values at the last point, samples x columns, without what demands gave way.
    pub fn values(&self) -> Vec<f64> {
        let width = self.columns.width();
        self.columns.all().chunks_exact(width.max(1)).flat_map(|row| &row[..self.width]).copied().collect()
    }

    /// Number of equations of the models.
    pub fn model_equations(&self) -> usize {
        self.rows.iter().map(|r| r.samples.len()).sum()
    }

    /// The models with the samples that have an equation, in the order of the equations.
    pub fn model_rows(&self) -> impl Iterator<Item = (&ModelRow<'a>, &[usize])> + '_ {
        self.rows.iter().map(|r| (&r.row, r.samples.as_slice()))
    }

    /// Columns of the rate limits in the order of their equations, which follow those of the models, and the number of
    /// limits of sums, which follow them.
    pub fn inequalities(&self) -> (Vec<usize>, usize) {
        (self.rates.iter().map(|r| r.0).collect(), self.sums.len())
    }

    /// Derivative of `multipliers' equations` of model `k` with respect to its demand (N), in the model's output.
    pub fn demand_slopes(&self, k: usize, multipliers: &[f64]) -> Vec<f64> {
        self.rows[k].demand_slopes(multipliers)
    }

    /// Takes the point `x`.
    pub fn load(&mut self, x: &[f64]) {
        self.columns.load(&x[..self.slacks()]);
        for row in &mut self.rows {
            row.load(&self.columns, self.from);
        }
    }

    fn lay_out_hessian(&mut self) {
        let mut places = Places::default();
        let wishes: Vec<Vec<usize>> = self.rows.iter().map(|r| r.wish(&self.columns, &mut places)).collect();
        let mut increments = Vec::new();
        for c in (0..self.columns.width()).filter(|c| self.columns.columns[*c].increment_weight > 0.0) {
            for i in self.columns.increments(c) {
                let at = [(i.now, i.now), (i.now, i.before), (i.before, i.before)];
                increments.push((c, i, at.map(|(a, b)| places.wish(a, b))));
            }
        }
        let sums: Vec<&Sum> = self.objective.iter().chain(self.sums.iter().map(|s| &s.sum)).collect();
        let of_sums: Vec<Vec<usize>> =
            sums.iter().map(|s| product_wishes(s, &self.columns, &mut places)).collect();
        let (structure, merged) = places.merge();
        for (row, wishes) in self.rows.iter_mut().zip(&wishes) {
            row.settle(wishes, &merged, &self.columns);
        }
        self.increment_places =
            increments.into_iter().map(|(c, i, at)| (c, i, at.map(|w| merged.place(w)))).collect();
        let mut of_sums: Vec<Vec<usize>> =
            of_sums.into_iter().map(|v| v.into_iter().map(|w| merged.place(w)).collect()).collect();
        self.sum_places = of_sums.split_off(self.objective.len());
        self.objective_places = of_sums;
        self.hessian_structure = structure;
    }

    /// First and second derivatives of the models at `x`.
    fn differentiate(&mut self, x: &[f64]) {
        let x = &x[..self.slacks()];
        self.load(x);
        if self.derived_at == x {
            return;
        }
        self.derived_at.clear();
        self.derived_at.extend_from_slice(x);
        for row in &mut self.rows {
            row.differentiate(&self.columns);
        }
    }

    /// First slack: of the rates, of the sums, then two of each soft limit.
    fn slacks(&self) -> usize {
        self.columns.count()
    }

    fn step(&self, i: &Increment, c: usize) -> f64 {
        self.columns.value(i.t, c) - self.columns.value(i.t - 1, c)
    }
}

/// The columns with one more for each demand that may give way, those columns by row, and the objective with their prices.
fn give_way(parts: &Parts<'_>) -> (Columns, Vec<Option<usize>>, Vec<Sum>) {
    let (mut columns, mut objective) = (parts.columns.clone(), parts.objective.clone());
    let width = columns.len();
    let samples = parts.values.len() / width.max(1);
    let give = |row: &ModelRow<'_>| {
        if row.give.is_empty() {
            return None;
        }
        let c = columns.len();
        columns.push(Column {
            decided: row.from..samples,
            held: false,
            bounds: (f64::NEG_INFINITY, f64::INFINITY),
            local: Vec::new(),
            rate: f64::INFINITY,
            increment_weight: 0.0,
        });
        let product = Product { gain: row.give.clone(), powers: vec![(c, 2)] };
        objective.push(Sum { product, from: row.from, to: samples });
        Some(c)
    };
    let gives = parts.rows.iter().map(give).collect();
    let more = vec![0.0; columns.len() - width];
    let values =
        parts.values.chunks_exact(width.max(1)).flat_map(|row| row.iter().chain(&more).copied()).collect();
    (Columns::new(columns, values), gives, objective)
}

/// A steepest derivative of the objective below this is a matter of its unit.
const LEAST_STEEP: f64 = 1e-5;
/// Least size of an output relative to its magnitude: a start at rest spreads by rounding alone.
const SIZE_OF_REST: f64 = 0.01;

/// Outputs have the units of their users (a concentration in ppm, a flow in kg/s): the size of one is the spread of its start, or
/// [`SIZE_OF_REST`] of its magnitude where that is more, to a power of two. Inputs and what a demand gives are taken as they are.
fn sizes(parts: &Parts<'_>, columns: &Columns) -> Vec<f64> {
    let width = parts.columns.len().max(1);
    let mut out = vec![1.0; columns.width()];
    for row in &parts.rows {
        let Target::Column(reading) = &row.target else { continue };
        let c = reading.columns()[0];
        let of = parts.values.iter().skip(c).step_by(width).filter(|v| v.is_finite());
        let (low, high) = of.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let size = (high - low).max(SIZE_OF_REST * high.abs().max(low.abs()));
        if size.is_normal() {
            out[c] = size.log2().round().exp2();
        }
    }
    out
}

/// Pairs of columns of a product whose second derivative is not zero.
fn bent_pairs(product: &Product) -> impl Iterator<Item = (usize, usize)> + '_ {
    let k = product.powers.len();
    (0..k).flat_map(move |a| (0..=a).map(move |b| (a, b))).filter(|&(a, b)| !product.is_straight(a, b))
}

fn product_wishes(sum: &Sum, columns: &Columns, places: &mut Places) -> Vec<usize> {
    let mut wishes = Vec::new();
    for t in sum.samples() {
        for (a, b) in bent_pairs(&sum.product) {
            let at = |k: usize| columns.variable(t, sum.product.powers[k].0);
            wishes.push(places.wish(at(a), at(b)));
        }
    }
    wishes
}

fn add_product_hessian(sum: &Sum, columns: &Columns, places: &[usize], factor: f64, values: &mut [f64]) {
    let mut place = places.iter();
    for t in sum.samples() {
        for ((a, b), &to) in bent_pairs(&sum.product).zip(place.by_ref()) {
            if to != NOWHERE {
                values[to] += factor * sum.product.second(t, columns.row(t), a, b);
            }
        }
    }
}

impl SparseNlp for Program<'_> {
    fn n(&self) -> usize {
        self.slacks() + self.rates.len() + self.sums.len() + 2 * self.soft_at.len()
    }

    fn m(&self) -> usize {
        self.model_equations() + self.rates.len() + self.sums.len() + self.soft_at.len()
    }

    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        let s = self.slacks();
        for v in 0..s {
            (lower[v], upper[v]) = self.columns.bounds_of(v);
        }
        for (k, (c, _)) in self.rates.iter().enumerate() {
            let rate = self.columns.columns[*c].rate;
            (lower[s + k], upper[s + k]) = (-rate, rate);
        }
        lower[s + self.rates.len()..].fill(0.0);
    }

    fn start(&self, x: &mut [f64]) {
        let s = self.slacks();
        self.columns.store(&mut x[..s]);
        for (k, (c, i)) in self.rates.iter().enumerate() {
            x[s + k] = self.step(i, *c);
        }
        let s = s + self.rates.len();
        for (k, limit) in self.sums.iter().enumerate() {
            x[s + k] = (limit.upper - limit.sum.value(&self.columns)).max(0.0);
        }
        let s = s + self.sums.len();
        for (k, &(l, t, _)) in self.soft_at.iter().enumerate() {
            let limit = &self.soft[l];
            let beyond = self.columns.value(t, limit.column) - limit.limit[t];
            let beyond = if limit.above { beyond } else { -beyond };
            (x[s + 2 * k], x[s + 2 * k + 1]) = (beyond.max(0.0), (-beyond).max(0.0));
        }
    }

    fn sizes(&self, size: &mut [f64]) {
        for (v, s) in size.iter_mut().enumerate().take(self.slacks()) {
            *s = self.sizes[self.columns.column_of(v)];
        }
    }

    /// The steepest derivative by a column where that is beyond 1 (prices of what is soft stand apart: they shall stay large beside it),
    /// or what lifts the steepest of all to 0.01 where it is nearly nothing.
    fn objective_unit(&mut self) -> f64 {
        let n = self.n();
        let (mut x, mut grad, mut sizes) = (vec![0.0; n], vec![0.0; n], vec![1.0; n]);
        self.start(&mut x);
        self.sizes(&mut sizes);
        self.gradient(&x, &mut grad);
        let steepest = |of: &[f64]| of.iter().zip(&sizes).map(|(g, s)| (g * s).abs()).fold(0.0, f64::max);
        let (columns, all) = (steepest(&grad[..self.slacks()]), steepest(&grad));
        let unit = match (columns, all) {
            (c, _) if c > 1.0 => c,
            (_, a) if a > 0.0 && a < LEAST_STEEP => 100.0 * a,
            _ => 1.0,
        };
        // A power of two keeps every bit.
        if unit.is_normal() { unit.log2().round().exp2() } else { 1.0 }
    }

    fn objective(&mut self, x: &[f64]) -> f64 {
        self.columns.load(&x[..self.slacks()]);
        let channels: f64 = self.objective.iter().map(|s| s.value(&self.columns)).sum();
        let increments: f64 = self
            .increment_places
            .iter()
            .map(|(c, i, _)| self.columns.columns[*c].increment_weight * self.step(i, *c).powi(2))
            .sum();
        let s = self.n() - 2 * self.soft_at.len();
        let soft: f64 =
            self.soft_at.iter().enumerate().map(|(k, (l, ..))| self.soft[*l].price * x[s + 2 * k]).sum();
        channels + increments / self.divisor + soft
    }

    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        self.columns.load(&x[..self.slacks()]);
        grad.fill(0.0);
        let columns = &self.columns;
        for sum in &self.objective {
            for t in sum.samples() {
                for (k, (c, _)) in sum.product.powers.iter().enumerate() {
                    let v = columns.variable(t, *c);
                    if v != FIXED {
                        grad[v] += sum.product.slope(t, columns.row(t), k);
                    }
                }
            }
        }
        for (c, i, _) in &self.increment_places {
            let d = 2.0 * columns.columns[*c].increment_weight / self.divisor * self.step(i, *c);
            for (v, sign) in [(i.now, 1.0), (i.before, -1.0)] {
                if v != FIXED {
                    grad[v] += sign * d;
                }
            }
        }
        let s = self.n() - 2 * self.soft_at.len();
        for (k, (l, ..)) in self.soft_at.iter().enumerate() {
            grad[s + 2 * k] = self.soft[*l].price;
        }
    }

    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        self.load(x);
        let mut e = 0;
        for row in &mut self.rows {
            let n = row.samples.len();
            row.residuals(&self.columns, &mut c[e..e + n]);
            e += n;
        }
        let s = self.slacks();
        for (k, (column, i)) in self.rates.iter().enumerate() {
            c[e + k] = self.step(i, *column) - x[s + k];
        }
        let (e, s) = (e + self.rates.len(), s + self.rates.len());
        for (k, limit) in self.sums.iter().enumerate() {
            c[e + k] = limit.sum.value(&self.columns) + x[s + k] - limit.upper;
        }
        let (e, s) = (e + self.sums.len(), s + self.sums.len());
        for (k, &(l, t, _)) in self.soft_at.iter().enumerate() {
            let limit = &self.soft[l];
            let beyond = self.columns.value(t, limit.column) - limit.limit[t];
            let sign = if limit.above { 1.0 } else { -1.0 };
            c[e + k] = sign * beyond - x[s + 2 * k] + x[s + 2 * k + 1];
        }
    }

    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let mut entries = Vec::new();
        let mut e = 0;
        for row in &self.rows {
            for &t in &row.samples {
                entries.extend(row.variables(t, &self.columns).map(|v| (e, v)));
                e += 1;
            }
        }
        let mut s = self.slacks();
        for (_, i) in &self.rates {
            entries.extend([i.now, i.before].into_iter().filter(|v| *v != FIXED).map(|v| (e, v)));
            entries.push((e, s));
            (e, s) = (e + 1, s + 1);
        }
        for limit in &self.sums {
            let product = &limit.sum.product;
            for t in limit.sum.samples() {
                let all = product.powers.iter().map(|(c, _)| self.columns.variable(t, *c));
                entries.extend(all.filter(|v| *v != FIXED).map(|v| (e, v)));
            }
            entries.push((e, s));
            (e, s) = (e + 1, s + 1);
        }
        for (_, _, v) in &self.soft_at {
            entries.extend([(e, *v), (e, s), (e, s + 1)]);
            (e, s) = (e + 1, s + 2);
        }
        entries
    }

    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        self.differentiate(x);
        let mut e = 0;
        let mut put = |v: f64| {
            values[e] = v;
            e += 1;
        };
        for row in &self.rows {
            row.gradients.iter().for_each(|g| put(*g));
        }
        for (_, i) in &self.rates {
            for (v, sign) in [(i.now, 1.0), (i.before, -1.0)] {
                if v != FIXED {
                    put(sign);
                }
            }
            put(-1.0);
        }
        for limit in &self.sums {
            let product = &limit.sum.product;
            for t in limit.sum.samples() {
                for (k, (c, _)) in product.powers.iter().enumerate() {
                    if self.columns.variable(t, *c) != FIXED {
                        put(product.slope(t, self.columns.row(t), k));
                    }
                }
            }
            put(1.0);
        }
        for (l, ..) in &self.soft_at {
            put(if self.soft[*l].above { 1.0 } else { -1.0 });
            put(-1.0);
            put(1.0);
        }
    }

    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        self.hessian_structure.clone()
    }

    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        self.differentiate(x);
        values.fill(0.0);
        let mut e = 0;
        for row in &self.rows {
            let n = row.samples.len();
            row.add_hessian(&multipliers[e..e + n], values);
            e += n;
        }
        e += self.rates.len();
        for (k, (limit, places)) in self.sums.iter().zip(&self.sum_places).enumerate() {
            add_product_hessian(&limit.sum, &self.columns, places, multipliers[e + k], values);
        }
        for (sum, places) in self.objective.iter().zip(&self.objective_places) {
            add_product_hessian(sum, &self.columns, places, sigma, values);
        }
        for (c, _, places) in &self.increment_places {
            let weight = 2.0 * sigma * self.columns.columns[*c].increment_weight / self.divisor;
            for (place, sign) in places.iter().zip([1.0, -1.0, 1.0]) {
                if *place != NOWHERE {
                    values[*place] += sign * weight;
                }
            }
        }
    }
}
