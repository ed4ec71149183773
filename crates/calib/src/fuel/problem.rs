//! Fuel over a whole transient as one sparse program (thesis eqs. 7.11 to 7.14).
//!
//! ```text
//! minimise    mean_t 1.2e-4 INJ(t) N(t)  +  mean_t sum_c w_c (u_c(t) - u_c(t-1))^2
//! subject to  f_i(u(t-1), u(t-2), ...; d_i(t-1), ...) = d_i(t)      torque and lambda, every sample
//!             lower_c <= u_c(t) <= upper_c                           (7.14)
//!             |SA(t) - SA(t-1)| <= rate
//! ```
//!
//! Because equality is exact, the past outputs that the models read are the demands themselves: the recursion
//! drops out and each sample adds two equations in a short window of inputs. The program is sparse and banded,
//! which is what makes the batch over all samples the fastest way as well as the best.

use dynocal_ident::model::{Model, Run};
use dynocal_numerics::nlp::SparseNlp;
use dynocal_numerics::rng::Rng64;

/// One equality: a model, its parameters and the record that it must follow exactly.
pub struct Equality<'a> {
    /// Model structure.
    pub model: &'a dyn Model,
    /// Parameters.
    pub theta: &'a [f64],
    /// Column of the decision matrix that drives each model input, or `Err(k)` for given column k of `given`.
    pub inputs: Vec<Source>,
    /// Demand in the model's own output, one value per sample.
    pub demand: &'a [f64],
}

/// Where a model input comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Decision channel.
    Decision(usize),
    /// Given (not decided) channel.
    Given(usize),
}

/// Data of the program. Decisions are the channels INJ, SA, throttle (0, 1, 2) of samples `first..last`.
pub struct FuelSpec<'a> {
    /// Start values of the decision channels, N x 3 row-major; rows before `first` are history and stay.
    pub start: &'a [f64],
    /// Given channels, N x g row-major (speed first).
    pub given: &'a [f64],
    /// Number of given channels g.
    pub n_given: usize,
    /// First decided sample: no less than the longest lag of any model.
    pub first: usize,
    /// Lower and upper bounds of the decision channels.
    pub bounds: [(f64, f64); 3],
    /// Largest |SA(t) - SA(t-1)| in deg per sample; infinite for none.
    pub spark_rate_deg: f64,
    /// Weights on squared increments of the decision channels, kg/h per unit^2.
    pub increment_weight: [f64; 3],
}

/// Number of decision channels.
pub const CHANNELS: usize = 3;

/// The program in the form of the interior point.
pub struct FuelProblem<'a> {
    spec: FuelSpec<'a>,
    equalities: Vec<EqualityRows<'a>>,
    n_samples: usize,
    decisions: usize,
    rate_rows: usize,
    hessian_structure: Vec<(usize, usize)>,
    increment_slots: Vec<[usize; 3]>,
    /// Where `gradients` and each equality's `seconds` were taken: one pass gives both, and the interior point
    /// asks for both at the same point.
    derived_at: Vec<f64>,
    /// Entries of the Jacobian's equality rows.
    gradients: Vec<f64>,
}

struct EqualityRows<'a> {
    eq: Equality<'a>,
    /// Model inputs at the current point, N x m.
    u: Vec<f64>,
    /// For each entry of the model's window: the decision channel, or none when given.
    window: Vec<Option<(usize, usize)>>,
    /// Pairs (a, b) of window entries, both decided, whose second derivative can be non-zero.
    pairs: Vec<(usize, usize)>,
    /// Hessian slot of each pair at each sample, `[row * pairs + pair]`; `usize::MAX` for history samples.
    slots: Vec<usize>,
    predicted: Vec<f64>,
    grad: Vec<f64>,
    hess: Vec<f64>,
    /// Second derivatives of all rows at `derived_at`, `[row * pairs + pair]`.
    seconds: Vec<f64>,
}

impl<'a> FuelProblem<'a> {
    /// Lays the structure out; the last sample's inputs influence nothing and are not decided.
    pub fn new(spec: FuelSpec<'a>, equalities: Vec<Equality<'a>>) -> Self {
        let n_samples = spec.start.len() / CHANNELS;
        let decided = n_samples - 1 - spec.first;
        let decisions = decided * CHANNELS;
        let rate_rows = if spec.spark_rate_deg.is_finite() { decided } else { 0 };
        let mut rows: Vec<EqualityRows> = equalities
            .into_iter()
            .map(|eq| {
                let m = eq.model.n_inputs();
                let w = eq.model.window().len();
                let window = eq
                    .model
                    .window()
                    .iter()
                    .map(|&(i, lag)| match eq.inputs[i] {
                        Source::Decision(c) => Some((c, lag)),
                        Source::Given(_) => None,
                    })
                    .collect();
                EqualityRows {
                    u: vec![0.0; n_samples * m],
                    window,
                    pairs: Vec::new(),
                    slots: Vec::new(),
                    predicted: vec![0.0; n_samples],
                    grad: vec![0.0; w],
                    hess: vec![0.0; w * w],
                    seconds: Vec::new(),
                    eq,
                }
            })
            .collect();
        for row in &mut rows {
            row.load(&spec, spec.start, true);
            row.find_pairs(spec.first);
        }
        let mut problem = Self {
            spec,
            equalities: rows,
            n_samples,
            decisions,
            rate_rows,
            hessian_structure: Vec::new(),
            increment_slots: Vec::new(),
            derived_at: Vec::new(),
            gradients: Vec::new(),
        };
        problem.lay_out_hessian();
        problem
    }

    /// Index of decision (sample, channel); none before the first decided or after the last decided sample.
    fn variable(&self, t: usize, channel: usize) -> Option<usize> {
        (t >= self.spec.first && t + 1 < self.n_samples).then(|| (t - self.spec.first) * CHANNELS + channel)
    }

    fn lay_out_hessian(&mut self) {
        let mut entries: Vec<(usize, usize)> = Vec::new();
        let mut position = |r: usize, c: usize| {
            entries.push((r.max(c), r.min(c)));
            entries.len() - 1
        };
        // First every wish, then sorted and merged: positions are looked up again through the merge.
        let first = self.spec.first;
        let mut wishes: Vec<Vec<usize>> = Vec::new();
        for row in &self.equalities {
            let mut slots = Vec::with_capacity((self.n_samples - first) * row.pairs.len());
            for t in first + 1..self.n_samples {
                for &(a, b) in &row.pairs {
                    let va = row.window[a].and_then(|(c, l)| self.variable(t - l, c));
                    let vb = row.window[b].and_then(|(c, l)| self.variable(t - l, c));
                    slots.push(match (va, vb) {
                        (Some(i), Some(j)) => position(i, j),
                        _ => usize::MAX,
                    });
                }
            }
            wishes.push(slots);
        }
        let mut increments = Vec::new();
        for t in first..self.n_samples - 1 {
            for c in 0..CHANNELS {
                let v = (t - first) * CHANNELS + c;
                let previous = (t > first).then(|| v - CHANNELS);
                increments.push([
                    position(v, v),
                    previous.map_or(usize::MAX, |p| position(v, p)),
                    previous.map_or(usize::MAX, |p| position(p, p)),
                ]);
            }
        }
        let mut order: Vec<usize> = (0..entries.len()).collect();
        order.sort_by_key(|&k| (entries[k].1, entries[k].0));
        let mut merged: Vec<(usize, usize)> = Vec::new();
        let mut to = vec![0; entries.len()];
        for k in order {
            if merged.last() != Some(&entries[k]) {
                merged.push(entries[k]);
            }
            to[k] = merged.len() - 1;
        }
        let find = |k: usize| if k == usize::MAX { k } else { to[k] };
        for (row, slots) in self.equalities.iter_mut().zip(wishes) {
            row.slots = slots.into_iter().map(find).collect();
        }
        self.increment_slots = increments.into_iter().map(|s| s.map(find)).collect();
        self.hessian_structure = merged;
    }

    /// Decision channels over all samples (N x 3): history, `x`, and the last row held.
    pub fn inputs(&self, x: &[f64]) -> Vec<f64> {
        let mut u = self.spec.start.to_vec();
        let from = self.spec.first * CHANNELS;
        u[from..from + self.decisions].copy_from_slice(&x[..self.decisions]);
        let last = (self.n_samples - 1) * CHANNELS;
        u.copy_within(last - CHANNELS..last, last);
        u
    }

    /// Mean fuel flow in kg/h over the decided samples, the increments weight left out.
    pub fn fuel_kg_h(&self, x: &[f64]) -> f64 {
        let decided = self.decisions / CHANNELS;
        let sum: f64 = (0..decided).map(|k| self.fuel_slope(k) * x[k * CHANNELS]).sum();
        sum / decided as f64
    }

    fn fuel_slope(&self, k: usize) -> f64 {
        1.2e-4 * self.spec.given[(self.spec.first + k) * self.spec.n_given]
    }

    /// Value of channel `c` at sample `t - 1` seen from decided sample `k` of `x`.
    fn previous(&self, x: &[f64], k: usize, c: usize) -> f64 {
        if k > 0 { x[(k - 1) * CHANNELS + c] } else { self.spec.start[(self.spec.first - 1) * CHANNELS + c] }
    }

    fn load(&mut self, x: &[f64]) {
        for row in &mut self.equalities {
            row.load(&self.spec, x, false);
        }
    }

    /// First and second derivatives of the models at `x`.
    fn differentiate(&mut self, x: &[f64]) {
        let x = &x[..self.decisions];
        if self.derived_at == x {
            return;
        }
        self.load(x);
        self.derived_at.clear();
        self.derived_at.extend_from_slice(x);
        self.gradients.clear();
        let (first, n) = (self.spec.first, self.n_samples);
        let decided = |t: usize| t >= first && t + 1 < n;
        for row in &mut self.equalities {
            let w = row.window.len();
            let run = Run { u: &row.u, y: row.eq.demand, start: first };
            row.seconds.clear();
            for t in first + 1..n {
                row.eq.model.window_derivatives(row.eq.theta, &run, t, &mut row.grad, &mut row.hess);
                for (entry, g) in row.window.iter().zip(&row.grad) {
                    if entry.is_some_and(|(_, lag)| decided(t - lag)) {
                        self.gradients.push(*g);
                    }
                }
                row.seconds.extend(row.pairs.iter().map(|&(a, b)| row.hess[a * w + b]));
            }
        }
    }
}

impl EqualityRows<'_> {
    /// Writes the model inputs: from the start matrix (`whole`) or, for decided samples only, from `x`.
    fn load(&mut self, spec: &FuelSpec, x: &[f64], whole: bool) {
        let m = self.eq.model.n_inputs();
        let n = self.u.len() / m;
        let range = if whole { 0..n } else { spec.first..n - 1 };
        for t in range {
            for (i, source) in self.eq.inputs.iter().enumerate() {
                let value = match *source {
                    Source::Decision(c) if whole => x[t * CHANNELS + c],
                    Source::Decision(c) => x[(t - spec.first) * CHANNELS + c],
                    Source::Given(_) if !whole => continue,
                    Source::Given(k) => spec.given[t * spec.n_given + k],
                };
                self.u[t * m + i] = value;
            }
        }
    }

    /// Which second derivatives exist at all: a structural zero of a polynomial is zero at every point, a
    /// structural non-zero almost nowhere, so a few random points decide.
    fn find_pairs(&mut self, first: usize) {
        let w = self.window.len();
        let mut seen = vec![false; w * w];
        let mut rng = Rng64::new(1);
        let keep = self.u.clone();
        let n = self.eq.demand.len();
        for _ in 0..4 {
            for v in &mut self.u {
                *v = *v * rng.uniform_in(0.7, 1.3) + rng.uniform_in(0.01, 0.1);
            }
            let t = first + 1 + rng.below(n - first - 1);
            let run = Run { u: &self.u, y: self.eq.demand, start: first };
            self.eq.model.window_derivatives(self.eq.theta, &run, t, &mut self.grad, &mut self.hess);
            for (s, h) in seen.iter_mut().zip(&self.hess) {
                *s |= *h != 0.0;
            }
        }
        self.u = keep;
        for a in 0..w {
            for b in 0..=a {
                if seen[a * w + b] && self.window[a].is_some() && self.window[b].is_some() {
                    self.pairs.push((a, b));
                }
            }
        }
    }
}

impl SparseNlp for FuelProblem<'_> {
    fn n(&self) -> usize {
        self.decisions + self.rate_rows
    }

    fn m(&self) -> usize {
        self.equalities.len() * (self.n_samples - 1 - self.spec.first) + self.rate_rows
    }

    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        for k in 0..self.decisions {
            (lower[k], upper[k]) = self.spec.bounds[k % CHANNELS];
        }
        lower[self.decisions..].fill(-self.spec.spark_rate_deg);
        upper[self.decisions..].fill(self.spec.spark_rate_deg);
    }

    fn start(&self, x: &mut [f64]) {
        let from = self.spec.first * CHANNELS;
        x[..self.decisions].copy_from_slice(&self.spec.start[from..from + self.decisions]);
        for k in 0..self.rate_rows {
            x[self.decisions + k] = x[k * CHANNELS + 1] - self.previous(x, k, 1);
        }
    }

    fn objective(&mut self, x: &[f64]) -> f64 {
        let decided = self.decisions / CHANNELS;
        let mut increments = 0.0;
        for k in 0..decided {
            for c in 0..CHANNELS {
                let d = x[k * CHANNELS + c] - self.previous(x, k, c);
                increments += self.spec.increment_weight[c] * d * d;
            }
        }
        self.fuel_kg_h(x) + increments / decided as f64
    }

    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        let decided = self.decisions / CHANNELS;
        let mean = 1.0 / decided as f64;
        grad.fill(0.0);
        for k in 0..decided {
            grad[k * CHANNELS] += self.fuel_slope(k) * mean;
            for c in 0..CHANNELS {
                let d = 2.0
                    * mean
                    * self.spec.increment_weight[c]
                    * (x[k * CHANNELS + c] - self.previous(x, k, c));
                grad[k * CHANNELS + c] += d;
                if k > 0 {
                    grad[(k - 1) * CHANNELS + c] -= d;
                }
            }
        }
    }

    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        self.load(x);
        let mut k = 0;
        for row in &mut self.equalities {
            let run = Run { u: &row.u, y: row.eq.demand, start: self.spec.first };
            // One-step prediction from the demand is the free run, because equality is exact.
            row.eq.model.predict(row.eq.theta, &run, &mut row.predicted);
            for t in self.spec.first + 1..self.n_samples {
                c[k] = row.predicted[t] - row.eq.demand[t];
                k += 1;
            }
        }
        for r in 0..self.rate_rows {
            c[k + r] = x[r * CHANNELS + 1] - self.previous(x, r, 1) - x[self.decisions + r];
        }
    }

    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let mut entries = Vec::new();
        let mut k = 0;
        for row in &self.equalities {
            for t in self.spec.first + 1..self.n_samples {
                for (c, lag) in row.window.iter().flatten() {
                    entries.extend(self.variable(t - lag, *c).map(|v| (k, v)));
                }
                k += 1;
            }
        }
        for r in 0..self.rate_rows {
            entries.push((k + r, r * CHANNELS + 1));
            if r > 0 {
                entries.push((k + r, (r - 1) * CHANNELS + 1));
            }
            entries.push((k + r, self.decisions + r));
        }
        entries
    }

    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        self.differentiate(x);
        let mut e = self.gradients.len();
        values[..e].copy_from_slice(&self.gradients);
        for r in 0..self.rate_rows {
            values[e] = 1.0;
            e += 1;
            if r > 0 {
                values[e] = -1.0;
                e += 1;
            }
            values[e] = -1.0;
            e += 1;
        }
    }

    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        self.hessian_structure.clone()
    }

    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        self.differentiate(x);
        values.fill(0.0);
        let mut multiplier = multipliers.iter();
        for row in &self.equalities {
            let samples = self.n_samples - 1 - self.spec.first;
            let pairs = row.pairs.len();
            for (k, m) in multiplier.by_ref().take(samples).enumerate() {
                let range = k * pairs..(k + 1) * pairs;
                for (&slot, second) in row.slots[range.clone()].iter().zip(&row.seconds[range]) {
                    if slot != usize::MAX {
                        values[slot] += m * second;
                    }
                }
            }
        }
        let mean = 2.0 * sigma / (self.decisions / CHANNELS) as f64;
        for (i, slots) in self.increment_slots.iter().enumerate() {
            let weight = mean * self.spec.increment_weight[i % CHANNELS];
            values[slots[0]] += weight;
            if slots[1] != usize::MAX {
                values[slots[1]] -= weight;
                values[slots[2]] += weight;
            }
        }
    }
}
