//! One stage: what is remembered before it, what inputs make of that, and what they cost.

use super::GridValue;
use super::grid::{Axis, Grid};
use crate::optimise::error::OptimiseError;
use crate::optimise::program::{Column, ModelRow, Parts, Sum, Target};
use crate::optimise::setup::Setup;
use dynocal_ident::model::Run;

/// Levels of each input that a search begins with, by the number of inputs; more inputs cannot be gone through.
const LEVELS: [usize; 3] = [21, 9, 5];
/// Smallest step of the search, as a share of an input's range.
const SMALLEST: f64 = 1e-5;

/// A value that later samples read: column, and how many samples before the stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Remembered {
    column: usize,
    back: usize,
}

/// The stages of a program whose outputs are all columns.
pub(super) struct Stages<'a> {
    parts: Parts<'a>,
    pub(super) memory: Vec<Remembered>,
    from: usize,
    to: usize,
    width: usize,
    inputs: usize,
    lag: usize,
    /// Samples x columns of the start: history, and what no memory holds.
    start: Vec<f64>,
}

/// Buffers of one evaluation.
pub(super) struct Work {
    /// Samples t - lag to t + 1, by columns.
    rows: Vec<f64>,
    u: Vec<f64>,
    y: Vec<f64>,
    predicted: Vec<f64>,
    next: Vec<f64>,
}

impl<'a> Stages<'a> {
    pub(super) fn new(setup: &Setup<'a>) -> Result<Self, OptimiseError> {
        let parts = setup.parts();
        let (width, inputs) = (setup.columns.len(), setup.problem.inputs.len());
        let refuse = |found: String, expected: &str| OptimiseError::Grid { found, expected: expected.into() };
        if setup.to == setup.samples {
            return Err(refuse(
                "a model that reads an input without delay".into(),
                "a delay of at least one sample",
            ));
        }
        if setup.from < setup.lag {
            return Err(refuse("a free history".into(), "the history of the record"));
        }
        if !parts.sums.is_empty() {
            return Err(refuse(
                "a limit of a mean, which remembers all samples".into(),
                "limits of single samples",
            ));
        }
        if inputs > LEVELS.len() {
            return Err(refuse(format!("{inputs} inputs"), &format!("at most {}", LEVELS.len())));
        }
        let memory = remembered(&parts, inputs);
        let name = |m: &Remembered| match m.back {
            0 => format!("{}(t)", setup.columns[m.column]),
            k => format!("{}(t-{k})", setup.columns[m.column]),
        };
        if !(1..=2).contains(&memory.len()) {
            let names: Vec<String> = memory.iter().map(name).collect();
            let found = format!("{} remembered values: {}", memory.len(), names.join(", "));
            return Err(refuse(found, "one or two"));
        }
        let (from, to, lag, start) = (setup.from, setup.to, setup.lag.max(1), setup.start.clone());
        Ok(Self { parts, memory, from, to, width, inputs, lag, start })
    }

    pub(super) fn count(&self) -> usize {
        self.to - self.from
    }

    pub(super) fn work(&self) -> Work {
        let most = self.parts.rows.iter().map(|r| r.model.n_inputs()).max().unwrap_or(0);
        Work {
            rows: vec![0.0; (self.lag + 2) * self.width],
            u: vec![0.0; (self.lag + 1) * most],
            y: vec![0.0; self.lag + 1],
            predicted: vec![0.0; self.lag + 1],
            next: vec![0.0; self.memory.len()],
        }
    }

    /// Axes of the grid: inputs within their bounds, outputs within what constant inputs at the corners of their box and the
    /// start give, wider by `share`.
    pub(super) fn axes(&self, setup: &Setup<'_>, cells: usize, share: f64) -> Vec<Axis> {
        let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); self.width];
        for corner in 0..=1usize << self.inputs {
            let mut values = self.start.clone();
            for row in values.chunks_exact_mut(self.width).skip(self.from) {
                for c in 0..self.inputs {
                    let (low, high) = self.parts.columns[c].bounds;
                    // Beyond the corners: the start itself.
                    if corner < 1 << self.inputs {
                        row[c] = if (corner >> c) & 1 == 0 { low } else { high };
                    }
                }
            }
            setup.answer(&mut values);
            for row in values.chunks_exact(self.width) {
                for (r, v) in ranges.iter_mut().zip(row) {
                    *r = (r.0.min(*v), r.1.max(*v));
                }
            }
        }
        let axis = |m: &Remembered| {
            let closed = m.column < self.inputs;
            let (low, high) = if closed { self.parts.columns[m.column].bounds } else { ranges[m.column] };
            let high = if high > low { high } else { low + 1.0 };
            let mut axis = Axis { low, high, cells, closed };
            if !closed {
                axis.widen(share);
            }
            axis
        };
        self.memory.iter().map(axis).collect()
    }

    /// Puts what is remembered at stage `k` into the rows of its samples.
    fn recall(&self, t: usize, state: &[f64], work: &mut Work) {
        let w = self.width;
        for i in 0..=self.lag + 1 {
            let s = (t + i).saturating_sub(self.lag);
            work.rows[i * w..(i + 1) * w].copy_from_slice(&self.start[s * w..(s + 1) * w]);
        }
        for (m, v) in self.memory.iter().zip(state) {
            work.rows[(self.lag - m.back) * w + m.column] = *v;
        }
    }

    /// Cost of stage `k` with inputs `u`, and what is remembered after it in `work.next`. After [`Stages::recall`].
    fn cost(&self, t: usize, u: &[f64], work: &mut Work) -> f64 {
        let (w, now) = (self.width, self.lag * self.width);
        work.rows[now..now + self.inputs].copy_from_slice(u);
        for row in &self.parts.rows {
            self.answer(row, t, work);
        }
        for (m, next) in self.memory.iter().zip(&mut work.next) {
            *next = work.rows[(self.lag + 1 - m.back) * w + m.column];
        }
        let (here, after) = work.rows[now..].split_at(w);
        let of_sum = |sum: &Sum| {
            let outputs_only =
                !sum.product.powers.is_empty() && sum.product.powers.iter().all(|p| p.0 >= self.inputs);
            let (s, row) = if outputs_only { (t + 1, after) } else { (t, here) };
            if (sum.from..sum.to).contains(&s) { sum.product.value(s, row) } else { 0.0 }
        };
        let objective: f64 = self.parts.objective.iter().map(of_sum).sum();
        let soft: f64 = self
            .parts
            .soft
            .iter()
            .map(|l| {
                let beyond = after[l.column] - l.limit[t + 1];
                l.price * if l.above { beyond } else { -beyond }.max(0.0)
            })
            .sum();
        let before = &work.rows[now - w..now];
        let moves = |c: usize| self.parts.columns[c].increment_weight * (here[c] - before[c]).powi(2);
        objective + soft + (0..self.inputs).map(moves).sum::<f64>() / self.parts.divisor
    }

    /// The output of `row` at sample t + 1.
    fn answer(&self, row: &ModelRow<'_>, t: usize, work: &mut Work) {
        let Target::Column(target) = &row.target else { return };
        let (w, m) = (self.width, row.readings.len());
        for i in 0..=self.lag {
            // Samples t + 1 - lag to t + 1.
            let s = t + 1 + i - self.lag;
            let values = &work.rows[(i + 1) * w..(i + 2) * w];
            for (k, reading) in row.readings.iter().enumerate() {
                work.u[i * m + k] = reading.value(s, values);
            }
            work.y[i] = target.value(s, values);
        }
        let run = Run { u: &work.u[..(self.lag + 1) * m], y: &work.y, start: self.lag };
        row.model.predict(row.theta, &run, &mut work.predicted);
        let y = target.invert(t + 1, work.predicted[self.lag]);
        work.rows[(self.lag + 1) * w + target.columns()[0]] = y;
    }

    /// Least value of stage `k` from `state` on, and the inputs that give it: the best of a lattice, then steps along each input that
    /// are halved where none of them is better.
    pub(super) fn best(&self, k: usize, state: &[f64], grid: &Grid, work: &mut Work) -> (f64, Vec<f64>) {
        let t = self.from + k;
        self.recall(t, state, work);
        let limits: Vec<(f64, f64)> = (0..self.inputs).map(|c| self.limits(c, t, work)).collect();
        let mut value = |u: &[f64]| {
            let cost = self.cost(t, u, work);
            let v = cost + grid.value(k + 1, &work.next);
            if v.is_finite() { v } else { f64::INFINITY }
        };
        let levels = LEVELS[self.inputs - 1];
        let (mut best, mut at) = (f64::INFINITY, limits.iter().map(|l| l.0).collect::<Vec<f64>>());
        for point in 0..levels.pow(self.inputs as u32) {
            let level = |c: usize| (point / levels.pow(c as u32)) % levels;
            let on = |c: usize, l: &(f64, f64)| l.0 + (l.1 - l.0) * level(c) as f64 / (levels - 1) as f64;
            let u: Vec<f64> = limits.iter().enumerate().map(|(c, l)| on(c, l)).collect();
            let v = value(&u);
            if v < best {
                (best, at) = (v, u);
            }
        }
        let mut share = 0.5 / (levels - 1) as f64;
        while share > SMALLEST {
            let mut better = false;
            for c in 0..self.inputs {
                for sign in [1.0, -1.0] {
                    let (low, high) = limits[c];
                    let mut u = at.clone();
                    u[c] = (u[c] + sign * share * (high - low)).clamp(low, high);
                    let v = value(&u);
                    if v < best {
                        (best, at, better) = (v, u, true);
                    }
                }
            }
            if !better {
                share *= 0.5;
            }
        }
        (best, at)
    }

    /// Bounds of input `c` at sample `t`, within reach of the value before.
    fn limits(&self, c: usize, t: usize, work: &Work) -> (f64, f64) {
        let column: &Column = &self.parts.columns[c];
        let (low, high) = column.local.get(t).copied().unwrap_or(column.bounds);
        let before = work.rows[(self.lag - 1) * self.width + c];
        if column.rate.is_finite() {
            ((before - column.rate).clamp(low, high), (before + column.rate).clamp(low, high))
        } else {
            (low, high)
        }
    }

    /// The best way from the start: samples x columns, and the axes that it leaves.
    pub(super) fn follow(&self, setup: &Setup<'_>, grid: &Grid) -> (Vec<f64>, Vec<usize>) {
        let (mut values, mut work, w) = (self.start.clone(), self.work(), self.width);
        let mut left: Vec<usize> = Vec::new();
        for k in 0..self.count() {
            let t = self.from + k;
            let state = self.state(&values, t);
            let out = (0..state.len()).filter(|&i| !grid.axes[i].holds(state[i]));
            left.extend(out);
            let (_, u) = self.best(k, &state, grid, &mut work);
            self.cost(t, &u, &mut work);
            values[t * w..t * w + self.inputs].copy_from_slice(&u);
            let after = &work.rows[(self.lag + 1) * w + self.inputs..];
            values[(t + 1) * w + self.inputs..(t + 2) * w].copy_from_slice(after);
        }
        // What comes after the last decided sample acts on nothing.
        let last = values[(self.to - 1) * w..(self.to - 1) * w + self.inputs].to_vec();
        (self.to..setup.samples).for_each(|t| values[t * w..t * w + self.inputs].copy_from_slice(&last));
        left.sort_unstable();
        left.dedup();
        (values, left)
    }

    fn state(&self, values: &[f64], t: usize) -> Vec<f64> {
        self.memory.iter().map(|m| values[(t - m.back) * self.width + m.column]).collect()
    }

    /// Value of the first stage on both grids.
    pub(super) fn judged(&self, setup: &Setup<'_>, fine: &Grid, coarse: &Grid, cells: usize) -> GridValue {
        let state = self.state(&self.start, self.from);
        let (objective, other) = (fine.value(0, &state), coarse.value(0, &state));
        let name = |m: &Remembered| match m.back {
            0 => format!("{}(t)", setup.columns[m.column]),
            k => format!("{}(t-{k})", setup.columns[m.column]),
        };
        GridValue {
            remembered: self.memory.iter().map(name).collect(),
            ranges: fine.axes.iter().map(|a| [a.low, a.high]).collect(),
            cells,
            objective,
            error: (objective - other).abs(),
        }
    }
}

/// What equations, rates, weights on increments and the objective read of samples before a stage: inputs from one sample back on,
/// outputs from its own sample on.
fn remembered(parts: &Parts<'_>, inputs: usize) -> Vec<Remembered> {
    let mut reach = vec![0usize; parts.columns.len()];
    for row in &parts.rows {
        for &(input, lag) in row.model.window() {
            for c in row.readings[input].columns() {
                reach[c] = reach[c].max(lag);
            }
        }
        if let Target::Column(target) = &row.target {
            let c = target.columns()[0];
            reach[c] = reach[c].max(row.model.output_lag());
        }
    }
    for (c, column) in parts.columns.iter().enumerate().take(inputs) {
        if column.rate.is_finite() || column.increment_weight > 0.0 {
            reach[c] = reach[c].max(2);
        }
    }
    for sum in &parts.objective {
        let powers = &sum.product.powers;
        if powers.iter().any(|p| p.0 < inputs) {
            powers.iter().filter(|p| p.0 >= inputs).for_each(|p| reach[p.0] = reach[p.0].max(1));
        }
    }
    let of = |(c, reach): (usize, &usize)| {
        let back = usize::from(c < inputs);
        (back..*reach).map(move |back| Remembered { column: c, back })
    };
    reach.iter().enumerate().flat_map(of).collect()
}
