//! The equations of one modelled output, one per sample.
//!
//! ```text
//! demanded          f(r(t-k), .. ; d(t-j), ..) - d(t) + s(t) = 0   past outputs are the demand: no recursion
//! free, limited     f(r(t-k), .. ; g(y(t-j)), ..) - g(y(t)) = 0    outputs y are variables
//! ```
//!
//! r readings of the model's inputs, s what a demand gives way (0 where it must be met exactly), g the way from the user's output
//! to the model's. An *atom* is one column at one lag that an equation reads through one entry of the model's window.

use super::columns::{Columns, FIXED};
use super::hessian::{Merged, NOWHERE, Places};
use super::product::Reading;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;

/// A model of one output and what it reads.
pub struct ModelRow<'a> {
    /// Structure.
    pub model: &'a dyn Model,
    /// Parameters.
    pub theta: &'a [f64],
    /// One reading per model input.
    pub readings: Vec<Reading>,
    /// What the output is held to.
    pub target: Target,
    /// Model outputs (N): the demand, or the start of a free output, whose samples before `from` stay.
    pub output: Vec<f64>,
    /// First sample with an equation.
    pub from: usize,
    /// Price (N) of the square of what the demand gives way, in the model's output; empty where it is met exactly.
    pub give: Vec<f64>,
}

/// What the output of a model is to the program.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// It equals [`ModelRow::output`].
    Demand,
    /// It is a column, in the user's unit, which this reading turns into the model's output.
    Column(Reading),
}

/// One column at one lag, read through one entry of the window.
#[derive(Clone, Copy, Debug)]
struct Atom {
    entry: usize,
    column: usize,
    lag: usize,
    /// Model input, or `PAST`; and which column of its reading.
    input: usize,
    part: usize,
}

const PAST: usize = usize::MAX;

/// A row with its place in the program.
pub(super) struct Rows<'a> {
    pub(super) row: ModelRow<'a>,
    /// Samples that have an equation.
    pub(super) samples: Vec<usize>,
    /// Column of what the demand gives way.
    give: Option<usize>,
    atoms: Vec<Atom>,
    /// Pairs of atoms (a, b), b <= a, whose second derivative can be non-zero.
    pairs: Vec<(usize, usize)>,
    /// Hessian place of each pair in each equation, and whether both are the same variable: then it counts twice.
    places: Vec<(usize, bool)>,
    /// Hessian places of the target's own curvature.
    target_places: Vec<usize>,
    /// Inputs and outputs of the model at the present point.
    u: Vec<f64>,
    y: Vec<f64>,
    predicted: Vec<f64>,
    grad: Vec<f64>,
    hess: Vec<f64>,
    slopes: Vec<f64>,
    /// Jacobian entries and second derivatives of all equations at the point of the last [`Rows::differentiate`].
    pub(super) gradients: Vec<f64>,
    seconds: Vec<f64>,
    target_seconds: Vec<f64>,
}

impl<'a> Rows<'a> {
    /// `give` is the column of what the demand gives way, where it may.
    pub(super) fn new(row: ModelRow<'a>, give: Option<usize>, columns: &Columns) -> Self {
        let (m, n) = (row.model.n_inputs(), columns.samples);
        let recursive = matches!(row.target, Target::Column(_));
        let past = if recursive { row.model.output_lag() } else { 0 };
        let mut atoms = Vec::new();
        for (entry, &(input, lag)) in row.model.window().iter().enumerate() {
            let read = row.readings[input].columns();
            atoms.extend(read.into_iter().enumerate().map(|(part, column)| Atom {
                entry,
                column,
                lag,
                input,
                part,
            }));
        }
        if let Target::Column(reading) = &row.target {
            let (column, w) = (reading.columns()[0], row.model.window().len());
            atoms.extend((1..=past).map(|lag| Atom {
                entry: w + lag - 1,
                column,
                lag,
                input: PAST,
                part: 0,
            }));
        }
        let width = row.model.window().len() + row.model.output_lag();
        let reads = |t: usize| atoms.iter().any(|a| columns.variable(t - a.lag, a.column) != FIXED);
        let samples = (row.from..n).filter(|&t| recursive || reads(t)).collect();
        let mut rows = Self {
            u: vec![0.0; n * m],
            y: row.output.clone(),
            predicted: vec![0.0; n],
            grad: vec![0.0; width],
            hess: vec![0.0; width * width],
            slopes: vec![0.0; atoms.len()],
            samples,
            give,
            atoms,
            pairs: Vec::new(),
            places: Vec::new(),
            target_places: Vec::new(),
            gradients: Vec::new(),
            seconds: Vec::new(),
            target_seconds: Vec::new(),
            row,
        };
        rows.load(columns, 0);
        rows.find_pairs();
        rows
    }

    /// The target, where it is a column.
    pub(super) fn target(&self) -> Option<&Reading> {
        match &self.row.target {
            Target::Demand => None,
            Target::Column(reading) => Some(reading),
        }
    }

    /// Variables of the Jacobian entries of equation `t`, in the order of [`Rows::gradients`].
    pub(super) fn variables<'b>(
        &'b self,
        t: usize,
        columns: &'b Columns,
    ) -> impl Iterator<Item = usize> + 'b {
        let of_atoms = self.atoms.iter().map(move |a| columns.variable(t - a.lag, a.column));
        let own = self.target().map(|r| columns.variable(t, r.columns()[0]));
        let give = self.give.map(|c| columns.variable(t, c));
        of_atoms.chain(own).chain(give).filter(|v| *v != FIXED)
    }

    /// Asks for the places of all second derivatives; gives the numbers of the wishes.
    pub(super) fn wish(&self, columns: &Columns, places: &mut Places) -> Vec<usize> {
        let mut wishes = Vec::with_capacity(self.samples.len() * self.pairs.len());
        for &t in &self.samples {
            for &(a, b) in &self.pairs {
                let at = |k: usize| columns.variable(t - self.atoms[k].lag, self.atoms[k].column);
                wishes.push(places.wish(at(a), at(b)));
            }
        }
        if let Some(reading) = self.target().filter(|r| !r.is_straight(0, 0)) {
            let column = reading.columns()[0];
            wishes.extend(self.samples.iter().map(|&t| {
                let v = columns.variable(t, column);
                places.wish(v, v)
            }));
        }
        wishes
    }

    pub(super) fn settle(&mut self, wishes: &[usize], merged: &Merged, columns: &Columns) {
        let (of_pairs, of_target) = wishes.split_at(self.samples.len() * self.pairs.len());
        let mut wish = of_pairs.iter();
        for &t in &self.samples {
            for (&(a, b), w) in self.pairs.iter().zip(wish.by_ref()) {
                let at = |k: usize| columns.variable(t - self.atoms[k].lag, self.atoms[k].column);
                self.places.push((merged.place(*w), a != b && at(a) == at(b)));
            }
        }
        self.target_places = of_target.iter().map(|w| merged.place(*w)).collect();
    }

    /// Model inputs and outputs at the present point, from sample `from` on.
    pub(super) fn load(&mut self, columns: &Columns, from: usize) {
        let m = self.row.model.n_inputs();
        for (i, reading) in self.row.readings.iter().enumerate() {
            if from > 0 && matches!(reading, Reading::Given(_)) {
                continue;
            }
            for t in from..columns.samples {
                self.u[t * m + i] = reading.value(t, columns.row(t));
            }
        }
        if let Target::Column(reading) = &self.row.target {
            for t in from..columns.samples {
                self.y[t] = reading.value(t, columns.row(t));
            }
        }
    }

    /// Left sides of the equations.
    pub(super) fn residuals(&mut self, columns: &Columns, out: &mut [f64]) {
        let run = Run { u: &self.u, y: &self.y, start: self.row.from };
        self.row.model.predict(self.row.theta, &run, &mut self.predicted);
        for (r, &t) in out.iter_mut().zip(&self.samples) {
            *r = self.predicted[t] - self.y[t] + self.give.map_or(0.0, |c| columns.value(t, c));
        }
    }

    /// First and second derivatives of all equations.
    pub(super) fn differentiate(&mut self, columns: &Columns) {
        self.gradients.clear();
        self.seconds.clear();
        self.target_seconds.clear();
        for k in 0..self.samples.len() {
            let t = self.samples[k];
            self.differentiate_one(t, columns);
        }
    }

    fn differentiate_one(&mut self, t: usize, columns: &Columns) {
        let width = self.model_derivatives(t);
        for (k, a) in self.atoms.iter().enumerate() {
            let reading = if a.input == PAST { self.target() } else { Some(&self.row.readings[a.input]) };
            let slope = reading.map_or(0.0, |r| r.slope(t - a.lag, columns.row(t - a.lag), a.part));
            self.slopes[k] = slope;
            if columns.variable(t - a.lag, a.column) != FIXED {
                self.gradients.push(self.grad[a.entry] * slope);
            }
        }
        for &(p, q) in &self.pairs {
            let (a, b) = (self.atoms[p], self.atoms[q]);
            let mut second = self.hess[a.entry * width + b.entry] * self.slopes[p] * self.slopes[q];
            if a.entry == b.entry {
                let reading = if a.input == PAST { self.target() } else { Some(&self.row.readings[a.input]) };
                let curvature =
                    reading.map_or(0.0, |r| r.second(t - a.lag, columns.row(t - a.lag), a.part, b.part));
                second += self.grad[a.entry] * curvature;
            }
            self.seconds.push(second);
        }
        if let Target::Column(r) = &self.row.target {
            let row = columns.row(t);
            if columns.variable(t, r.columns()[0]) != FIXED {
                self.gradients.push(-r.slope(t, row, 0));
            }
            if !r.is_straight(0, 0) {
                self.target_seconds.push(-r.second(t, row, 0, 0));
            }
        }
        if self.give.is_some_and(|c| columns.variable(t, c) != FIXED) {
            self.gradients.push(1.0);
        }
    }

    /// Derivatives of the prediction at sample `t` with respect to the window; gives their width.
    fn model_derivatives(&mut self, t: usize) -> usize {
        let run = Run { u: &self.u, y: &self.y, start: self.row.from };
        let (model, theta) = (self.row.model, self.row.theta);
        let w = model.window().len();
        match self.row.target {
            Target::Demand => {
                model.window_derivatives(theta, &run, t, &mut self.grad[..w], &mut self.hess[..w * w]);
                w
            }
            Target::Column(_) => {
                model.joint_derivatives(theta, &run, t, &mut self.grad, &mut self.hess);
                self.grad.len()
            }
        }
    }

    /// Adds `multipliers' second derivatives` to the Hessian's entries.
    pub(super) fn add_hessian(&self, multipliers: &[f64], values: &mut [f64]) {
        let pairs = self.pairs.len();
        for (k, m) in multipliers.iter().enumerate() {
            let range = k * pairs..(k + 1) * pairs;
            for (&(place, twice), second) in self.places[range.clone()].iter().zip(&self.seconds[range]) {
                if place != NOWHERE {
                    values[place] += m * second * if twice { 2.0 } else { 1.0 };
                }
            }
        }
        for ((m, &place), second) in multipliers.iter().zip(&self.target_places).zip(&self.target_seconds) {
            if place != NOWHERE {
                values[place] += m * second;
            }
        }
    }

    /// Derivative of `multipliers' equations` with respect to the output (N) at the present point.
    pub(super) fn demand_slopes(&self, multipliers: &[f64]) -> Vec<f64> {
        let mut slopes = vec![0.0; self.y.len()];
        let mut of_past = vec![0.0; self.row.model.output_lag()];
        let run = Run { u: &self.u, y: &self.y, start: self.row.from };
        for (&t, l) in self.samples.iter().zip(multipliers) {
            self.row.model.output_derivatives(self.row.theta, &run, t, &mut of_past);
            slopes[t] -= l;
            for (lag, slope) in (1..).zip(&of_past) {
                slopes[t - lag] += l * slope;
            }
        }
        slopes
    }

    /// Which second derivatives exist at all: a structural zero of a polynomial is zero at every point, a structural
    /// non-zero almost nowhere, so a few random points decide.
    fn find_pairs(&mut self) {
        let Some((&first, &last)) = self.samples.first().zip(self.samples.last()) else { return };
        let mut seen = vec![false; self.hess.len()];
        let mut rng = Rng64::new(1);
        let keep = (self.u.clone(), self.y.clone());
        let mut width = 0;
        for _ in 0..4 {
            for v in self.u.iter_mut().chain(&mut self.y) {
                *v = *v * rng.uniform_in(0.7, 1.3) + rng.uniform_in(0.01, 0.1);
            }
            width = self.model_derivatives(first + rng.below(last - first + 1));
            seen.iter_mut().zip(&self.hess).for_each(|(s, h)| *s |= *h != 0.0);
        }
        (self.u, self.y) = keep;
        for a in 0..self.atoms.len() {
            for b in 0..=a {
                let (p, q) = (self.atoms[a], self.atoms[b]);
                let reading = if p.input == PAST { self.target() } else { Some(&self.row.readings[p.input]) };
                let bent = p.entry == q.entry && reading.is_some_and(|r| !r.is_straight(p.part, q.part));
                if seen[p.entry * width + q.entry] || bent {
                    self.pairs.push((a, b));
                }
            }
        }
    }
}
