//! Which value of which sample is a variable of the program.
//!
//! The channels that the program may choose are columns: inputs, and outputs whose recursion stays in the program. Variables
//! are numbered sample by sample, so that coupled ones stand near each other.

use std::ops::Range;

/// No variable: the value stays as it is.
pub const FIXED: usize = usize::MAX;

/// One column over all samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Samples that are decided.
    pub decided: Range<usize>,
    /// Whether the samples after them follow the last decided one; else they stay as they are.
    pub held: bool,
    /// Least and greatest value.
    pub bounds: (f64, f64),
    /// Least and greatest value of each sample (N), within these; empty where they are the same for all.
    pub local: Vec<(f64, f64)>,
    /// Largest change from sample to sample; infinite for none.
    pub rate: f64,
    /// Weight of squared increments, mean over samples.
    pub increment_weight: f64,
}

/// Columns, their values and their variables.
#[derive(Clone, Debug)]
pub struct Columns {
    pub(super) columns: Vec<Column>,
    pub(super) samples: usize,
    /// Values at the present point, samples x columns.
    pub(super) values: Vec<f64>,
    /// Variable of each value, or [`FIXED`].
    at: Vec<usize>,
    /// Place in `values` of each variable.
    places: Vec<usize>,
}

impl Columns {
    pub(super) fn new(columns: Vec<Column>, values: Vec<f64>) -> Self {
        let width = columns.len();
        let samples = values.len() / width.max(1);
        let (mut at, mut places) = (vec![FIXED; values.len()], Vec::new());
        for t in 0..samples {
            for (c, column) in columns.iter().enumerate() {
                if column.decided.contains(&t) {
                    at[t * width + c] = places.len();
                    places.push(t * width + c);
                } else if column.held && t >= column.decided.end && !column.decided.is_empty() {
                    at[t * width + c] = at[(column.decided.end - 1) * width + c];
                }
            }
        }
        Self { columns, samples, values, at, places }
    }

    /// Bounds of column `c`.
    pub fn bounds(&self, c: usize) -> (f64, f64) {
        self.columns[c].bounds
    }

    pub(super) fn width(&self) -> usize {
        self.columns.len()
    }

    /// Values at the present point, samples x columns.
    pub fn all(&self) -> &[f64] {
        &self.values
    }

    /// Number of variables.
    pub(super) fn count(&self) -> usize {
        self.places.len()
    }

    /// Variable of column `c` at sample `t`, or [`FIXED`].
    pub fn variable(&self, t: usize, c: usize) -> usize {
        self.at[t * self.width() + c]
    }

    pub(super) fn value(&self, t: usize, c: usize) -> f64 {
        self.values[t * self.width() + c]
    }

    /// The columns of sample `t`.
    pub(super) fn row(&self, t: usize) -> &[f64] {
        &self.values[t * self.width()..(t + 1) * self.width()]
    }

    /// Column of variable `v`.
    pub(super) fn column_of(&self, v: usize) -> usize {
        self.places[v] % self.width()
    }

    /// Bounds of variable `v`.
    pub(super) fn bounds_of(&self, v: usize) -> (f64, f64) {
        let (t, c) = (self.places[v] / self.width(), self.places[v] % self.width());
        self.columns[c].local.get(t).copied().unwrap_or(self.columns[c].bounds)
    }

    /// Takes the variables from `values` (samples x columns).
    pub(in crate::optimise) fn begin_at(&mut self, values: &[f64]) {
        self.places.iter().for_each(|&place| self.values[place] = values[place]);
    }

    /// Sets all variables of column `c` to `value`.
    pub fn level(&mut self, c: usize, value: f64) {
        for v in 0..self.count() {
            if self.column_of(v) == c {
                self.values[self.places[v]] = value;
            }
        }
    }

    /// Takes the values of the variables (as many as there are).
    pub(super) fn load(&mut self, x: &[f64]) {
        let width = self.width();
        for (&place, v) in self.places.iter().zip(x) {
            self.values[place] = *v;
        }
        for (c, column) in self.columns.iter().enumerate() {
            if column.held && !column.decided.is_empty() {
                let last = self.values[(column.decided.end - 1) * width + c];
                (column.decided.end..self.samples).for_each(|t| self.values[t * width + c] = last);
            }
        }
    }

    /// The values of the variables at the present point.
    pub(super) fn store(&self, x: &mut [f64]) {
        self.places.iter().zip(x).for_each(|(&place, v)| *v = self.values[place]);
    }

    /// Samples at which a column changes by its variables: (sample, variable there, variable before), one of which may be
    /// [`FIXED`].
    pub(super) fn increments(&self, c: usize) -> impl Iterator<Item = Increment> + '_ {
        (1..self.samples).filter_map(move |t| {
            let (now, before) = (self.variable(t, c), self.variable(t - 1, c));
            (now != before).then_some(Increment { t, now, before })
        })
    }
}

/// A change from sample `t - 1` to `t`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Increment {
    pub(super) t: usize,
    pub(super) now: usize,
    pub(super) before: usize,
}
