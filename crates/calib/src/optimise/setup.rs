//! From problem, models and start record to a program: names become columns, demands are formed, readings resolved.

use super::bounds::bound_channels;
use super::checks::{check_start, in_order};
use super::error::OptimiseError;
use super::model::OutputModel;
use super::program::{Column, ModelRow, Parts, Product, Reading, Sum, SumLimit, Target};
use super::within::led_back;
use super::{DemandFrom, EndCondition, Found, History, OptimiseOptions};
use crate::problem::CalibrationProblem;
use dynocal_ident::data::Dataset;
use dynocal_ident::derived::Monomial;
use dynocal_ident::model::Run;
use dynocal_numerics::status::Status;
use std::ops::Range;

/// Least increment from sample to sample by which smoothing is measured, as a share of an input's range.
const LEAST_MOVE: f64 = 1e-3;

/// Names, samples and values that a program was made from.
pub(super) struct Setup<'a> {
    pub(super) problem: &'a CalibrationProblem,
    /// Models in an order in which each reads only outputs of those before it.
    pub(super) models: Vec<OutputModel<'a>>,
    pub(super) samples: usize,
    pub(super) sample_time_s: f64,
    /// Longest lag of any model.
    pub(super) lag: usize,
    /// First decided sample, and one past the last.
    pub(super) from: usize,
    pub(super) to: usize,
    /// Names of the columns: inputs, then outputs that are not demanded.
    pub(super) columns: Vec<String>,
    /// Start values, samples x columns.
    pub(super) start: Vec<f64>,
    /// Given channels and demands by name, in the user's unit.
    pub(super) given: Vec<(String, Vec<f64>)>,
    /// Demands and limits made soft.
    elastic: Option<Elastic>,
    /// Whether demands may give way.
    gives: bool,
    /// Outputs whose limits of single samples stand in place of those of the problem.
    pub(super) loose: Vec<String>,
    /// Weights on squared increments of the inputs.
    increment_weights: Vec<f64>,
    options: OptimiseOptions,
}

/// Prices of a program whose demands and output limits are soft.
#[derive(Clone, Copy, Debug)]
struct Elastic {
    /// Price of an output's whole range, mean over samples.
    price: f64,
    /// Weight of the objective proper.
    objective: f64,
}

impl<'a> Setup<'a> {
    pub(super) fn new(
        problem: &'a CalibrationProblem,
        models: &[OutputModel<'a>],
        start: &Dataset,
        options: &OptimiseOptions,
    ) -> Result<Self, OptimiseError> {
        problem.check_record(start)?;
        let models = in_order(problem, models)?;
        check_start(problem, start)?;
        let samples = start.len();
        let lag = models.iter().map(|m| m.model.max_lag()).max().unwrap_or(0);
        let expected = 2 * lag + 2;
        if samples < expected {
            return Err(OptimiseError::Short { record: start.name.clone(), found: samples, lag, expected });
        }
        let through = |m: &OutputModel| m.model.window().iter().any(|(_, lag)| *lag == 0);
        let to = if models.iter().any(through) { samples } else { samples - 1 };
        let demands = problem.demand_names();
        let free: Vec<String> =
            models.iter().map(|m| m.output.clone()).filter(|o| !demands.contains(o)).collect();
        let columns: Vec<String> = problem.input_names().into_iter().chain(free).collect();
        let mut setup = Self {
            problem,
            models,
            samples,
            sample_time_s: start.sample_time_s,
            lag,
            from: if options.history == History::Free { 0 } else { lag },
            to,
            start: vec![0.0; samples * columns.len()],
            columns,
            given: Vec::new(),
            elastic: None,
            gives: false,
            loose: Vec::new(),
            increment_weights: Vec::new(),
            options: *options,
        };
        for name in problem.given_names() {
            let values = start.values(&name)?.to_vec();
            setup.given.push((name, values));
        }
        for name in problem.input_names() {
            setup.put_column(&name, start.values(&name)?);
        }
        for name in problem.input_names().into_iter().chain(problem.other_outputs()) {
            for bound in bound_channels(&name) {
                if let Ok(values) = start.values(&bound) {
                    setup.given.push((bound, values.to_vec()));
                }
            }
            setup.check_crossed(&name, start)?;
        }
        setup.respond(start)?;
        setup.increment_weights = setup.smoothing();
        Ok(setup)
    }

    /// Bounds of a channel over the record between which nothing lies.
    fn check_crossed(&self, name: &str, record: &Dataset) -> Result<(), OptimiseError> {
        let [lower, upper] = bound_channels(name);
        let (Some(low), Some(high)) = (self.given(&lower), self.given(&upper)) else { return Ok(()) };
        let Some(t) = (self.from..self.to).find(|&t| low[t] > high[t]) else { return Ok(()) };
        let (record, at_s) = (record.name.clone(), t as f64 * self.sample_time_s);
        Err(OptimiseError::Crossed { record, lower, upper, found: [low[t], high[t]], at_s })
    }

    /// Simulates all models on the start inputs: demands that the record does not give, starts of the other outputs.
    fn respond(&mut self, record: &Dataset) -> Result<(), OptimiseError> {
        for k in 0..self.models.len() {
            let m = self.models[k].clone();
            if self.options.demand == DemandFrom::Record && !self.columns.contains(&m.output) {
                self.given.push((m.output.clone(), record.values(&m.output)?.to_vec()));
                continue;
            }
            let measured: Vec<f64> = record.values(&m.output)?.iter().map(|y| m.way.to_model(*y)).collect();
            let y = self.free_run(&m, &self.start, &measured, self.lag);
            let Some(y) = y else {
                let (output, record) = (m.output.clone(), record.name.clone());
                return Err(OptimiseError::Unstable { output, record });
            };
            let mut values: Vec<f64> = y.iter().map(|v| m.way.to_user(*v)).collect();
            let demand = self.problem.demands.iter().find(|d| d.output == m.output);
            if let (DemandFrom::Within, Some(d)) = (self.options.demand, demand) {
                led_back(&mut values, d.lower..d.upper, self.from + self.lag, self.lag);
            }
            match self.columns.contains(&m.output) {
                true => self.put_column(&m.output, &values),
                false => self.given.push((m.output.clone(), values)),
            }
        }
        Ok(())
    }

    /// Sets the outputs among the columns `values` to what the models answer to the inputs there, from the first equation on; an
    /// answer that diverges is left out.
    pub(super) fn answer(&self, values: &mut [f64]) {
        let width = self.columns.len();
        for m in &self.models {
            let Some(c) = self.columns.iter().position(|n| *n == m.output) else { continue };
            let y: Vec<f64> = values.iter().skip(c).step_by(width).map(|y| m.way.to_model(*y)).collect();
            if let Some(run) = self.free_run(m, values, &y, self.first_equation()) {
                let places = values.iter_mut().skip(c).step_by(width);
                places.zip(run).for_each(|(v, y)| *v = m.way.to_user(y));
            }
        }
    }

    /// Free run of a model on the columns `values` from sample `first` on, in the model's output; none when it diverges.
    pub(super) fn free_run(
        &self,
        m: &OutputModel,
        values: &[f64],
        y: &[f64],
        first: usize,
    ) -> Option<Vec<f64>> {
        let width = self.columns.len();
        let readings: Vec<Reading> =
            m.inputs.iter().map(|s| self.reading(&s.monomial, s.offset, s.scale)).collect();
        let mut u = vec![0.0; self.samples * readings.len()];
        for t in 0..self.samples {
            let row = &values[t * width..(t + 1) * width];
            for (i, r) in readings.iter().enumerate() {
                u[t * readings.len() + i] = r.value(t, row);
            }
        }
        let mut out = vec![0.0; self.samples];
        let status = m.model.simulate(m.theta, &Run { u: &u, y, start: first }, &mut out);
        (status != Status::Diverged).then_some(out)
    }

    /// Samples `range` as a setup of their own, with the columns `values` (of all samples) as start and history.
    pub(super) fn slice(&self, values: &[f64], range: Range<usize>, end: EndCondition) -> Self {
        let width = self.columns.len();
        let given = self.given.iter().map(|(n, v)| (n.clone(), v[range.clone()].to_vec())).collect();
        Self {
            problem: self.problem,
            models: self.models.clone(),
            samples: range.len(),
            sample_time_s: self.sample_time_s,
            lag: self.lag,
            from: if range.start == 0 { self.from } else { self.lag },
            to: range.len() - (self.samples - self.to),
            columns: self.columns.clone(),
            start: values[range.start * width..range.end * width].to_vec(),
            given,
            elastic: self.elastic,
            gives: self.gives,
            loose: self.loose.clone(),
            increment_weights: self.increment_weights.clone(),
            options: OptimiseOptions { end, ..self.options },
        }
    }

    /// The same with demanded outputs as columns, and all that is asked of outputs soft: `price` for an output's whole
    /// range, `objective` the weight of the objective proper.
    pub(super) fn elastic(&self, price: f64, objective: f64) -> Self {
        let demands = self.problem.demand_names();
        let width = self.columns.len();
        let mut columns = self.columns.clone();
        columns.extend(demands.iter().cloned());
        let mut start = Vec::with_capacity(self.samples * columns.len());
        for t in 0..self.samples {
            start.extend_from_slice(&self.start[t * width..(t + 1) * width]);
            start.extend(demands.iter().map(|d| self.given(d).map_or(0.0, |v| v[t])));
        }
        Self {
            problem: self.problem,
            models: self.models.clone(),
            given: self.given.clone(),
            increment_weights: self.increment_weights.iter().map(|w| objective * w).collect(),
            loose: self.loose.clone(),
            elastic: Some(Elastic { price, objective }),
            columns,
            start,
            ..*self
        }
    }

    /// The same with demands that may give way.
    pub(super) fn giving(&self) -> Self {
        Self {
            gives: true,
            models: self.models.clone(),
            loose: self.loose.clone(),
            columns: self.columns.clone(),
            start: self.start.clone(),
            given: self.given.clone(),
            increment_weights: self.increment_weights.clone(),
            ..*self
        }
    }

    /// Takes the columns of `found` that `plain` has, too: the way back from [`Setup::elastic`].
    pub(super) fn narrowed(&self, plain: &Self, found: &mut Found) {
        let kept = plain.columns.len();
        found.values =
            found.values.chunks_exact(self.columns.len()).flat_map(|row| row[..kept].to_vec()).collect();
    }

    /// Weights on squared increments: those of the problem, else such that increments as large as those of the start record
    /// add the share `smoothing` to the objective of the start. An input that hardly moves there counts as if it moved by
    /// [`LEAST_MOVE`] of its range.
    fn smoothing(&self) -> Vec<f64> {
        let (width, share) = (self.columns.len(), self.options.smoothing);
        let terms = self.problem.minimise.iter().zip(self.objective_sums());
        let objective: f64 = terms.map(|(t, s)| (t.weight * s.value_of(&self.start, width)).abs()).sum();
        let mean_square = |c: usize| {
            let step = |t: usize| (self.start[t * width + c] - self.start[(t - 1) * width + c]).powi(2);
            (1..self.samples).map(step).sum::<f64>() / (self.samples.max(2) - 1) as f64
        };
        let inputs = self.problem.inputs.iter().enumerate();
        inputs
            .map(|(c, input)| {
                let least = (LEAST_MOVE * (input.upper - input.lower)).powi(2);
                input.increment_weight.unwrap_or_else(|| share * objective / mean_square(c).max(least))
            })
            .collect()
    }

    /// Objective of the start, by its terms alone.
    pub(super) fn start_objective(&self) -> f64 {
        let terms = self.problem.minimise.iter().zip(self.objective_sums());
        terms.map(|(term, sum)| term.weight * sum.value_of(&self.start, self.columns.len())).sum()
    }

    fn put_column(&mut self, name: &str, values: &[f64]) {
        let width = self.columns.len();
        if let Some(c) = self.columns.iter().position(|n| n == name) {
            for (t, v) in values.iter().enumerate() {
                self.start[t * width + c] = *v;
            }
        }
    }

    /// Given channel or demand by name.
    pub(super) fn given(&self, name: &str) -> Option<&[f64]> {
        self.given.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_slice())
    }

    /// Splits a monomial into columns and the product of what is imposed, times `factor`.
    fn product(&self, monomial: &Monomial, factor: f64) -> Product {
        let mut gain = vec![factor * monomial.factor; self.samples];
        let mut powers = Vec::new();
        for (name, p) in &monomial.powers {
            if let Some(c) = self.columns.iter().position(|n| n == name) {
                powers.push((c, *p));
            } else if let Some(values) = self.given(name) {
                gain.iter_mut().zip(values).for_each(|(g, v)| *g *= v.powi(*p));
            }
        }
        Product { gain, powers }
    }

    fn reading(&self, monomial: &Monomial, offset: f64, scale: f64) -> Reading {
        let plain = monomial.powers.len() == 1;
        let product = self.product(monomial, 1.0 / scale);
        let shift = -offset / scale;
        match product.powers[..] {
            [] => Reading::Given(product.gain.into_iter().map(|g| g + shift).collect()),
            [(column, 1)] if plain => Reading::Linear { column, gain: product.gain[0], shift },
            _ => Reading::Product { product, shift },
        }
    }

    /// The parts of the program over all samples.
    pub(super) fn parts(&self) -> Parts<'a> {
        let rows: Vec<ModelRow> = self.models.iter().map(|m| self.row(m)).collect();
        let divisor = (self.to - self.from) as f64;
        let share = self.elastic.map_or(1.0, |e| e.objective);
        Parts {
            columns: self.program_columns(&rows),
            values: self.start.clone(),
            objective: self
                .problem
                .minimise
                .iter()
                .map(|term| self.mean(&self.problem.monomial(&term.channel), term.weight * share))
                .collect(),
            sums: self.mean_limits().into_iter().map(|(_, sum, upper)| SumLimit { sum, upper }).collect(),
            soft: match self.elastic {
                Some(e) => self.all_soft(e.price / divisor, e.objective),
                None => self.problem.limits.iter().flat_map(|l| self.soft(l)).collect(),
            },
            divisor,
            rows,
        }
    }

    /// Means of the channels of the objective, without their weights.
    pub(super) fn objective_sums(&self) -> Vec<Sum> {
        let mean = |channel: &str| self.mean(&self.problem.monomial(channel), 1.0);
        self.problem.minimise.iter().map(|term| mean(&term.channel)).collect()
    }

    fn row(&self, m: &OutputModel<'a>) -> ModelRow<'a> {
        let model_of = |values: Vec<f64>| values.into_iter().map(|y| m.way.to_model(y)).collect::<Vec<f64>>();
        let (target, output) = match self.columns.iter().position(|n| *n == m.output) {
            None => (Target::Demand, model_of(self.given(&m.output).unwrap_or(&[]).to_vec())),
            Some(c) => {
                let own = Monomial { factor: m.way.factor, powers: vec![(m.output.clone(), m.way.power)] };
                let values = self.start.iter().skip(c).step_by(self.columns.len()).copied().collect();
                (Target::Column(self.reading(&own, m.way.offset, m.way.scale)), model_of(values))
            }
        };
        ModelRow {
            model: m.model,
            theta: m.theta,
            readings: m.inputs.iter().map(|s| self.reading(&s.monomial, s.offset, s.scale)).collect(),
            target,
            output,
            from: self.first_equation(),
            give: self.give(m),
        }
    }

    /// Prices of the squares of what a demand gives way: at the price of a demand that is the whole objective of the start
    /// for the whole range, it gives [`OptimiseOptions::give`] of its range.
    fn give(&self, m: &OutputModel) -> Vec<f64> {
        let demand = self.problem.demands.iter().find(|d| self.gives && d.output == m.output);
        let (Some(d), Some(values)) = (demand, self.given(&m.output)) else { return Vec::new() };
        let range = d.upper - d.lower;
        let price = self.start_objective().abs().max(1e-9) / (2.0 * self.options.give * range * range);
        let samples = (self.to - self.from) as f64;
        values.iter().map(|y| price / (samples * m.way.slope(*y).powi(2))).collect()
    }

    /// First sample whose outputs the decisions reach.
    pub(super) fn first_equation(&self) -> usize {
        let through = self.to == self.samples;
        (self.from + usize::from(!through)).max(self.lag)
    }

    fn program_columns(&self, rows: &[ModelRow]) -> Vec<Column> {
        let mut columns = Vec::new();
        for (c, input) in self.problem.inputs.iter().enumerate() {
            let lags = || rows.iter().flat_map(|r| lags(r, c));
            // Samples that only act after the end of the record follow the last one that acts within.
            let (reach, held) = match self.options.end {
                EndCondition::Free => (lags().min(), true),
                EndCondition::Start => (lags().max(), false),
            };
            let end = self.samples.saturating_sub(reach.unwrap_or(0));
            columns.push(Column {
                decided: self.from..end.max(self.from),
                held,
                bounds: (input.lower, input.upper),
                local: self.local_bounds(c),
                rate: input.rate_per_s.map_or(f64::INFINITY, |r| r * self.sample_time_s),
                increment_weight: self.increment_weights[c],
            });
        }
        let outputs = &self.columns[self.problem.inputs.len()..];
        for name in outputs {
            let limit = self.problem.limits.iter().find(|l| l.output == *name);
            let hard = limit.filter(|l| l.soft_weight.is_none() && self.elastic.is_none());
            columns.push(Column {
                decided: self.first_equation()..self.samples,
                held: false,
                local: hard.map_or(Vec::new(), |l| self.local_limits(l)),
                bounds: (
                    hard.and_then(|l| l.lower).unwrap_or(f64::NEG_INFINITY),
                    hard.and_then(|l| l.upper).unwrap_or(f64::INFINITY),
                ),
                rate: f64::INFINITY,
                increment_weight: 0.0,
            });
        }
        columns
    }

    /// Mean of `weight * monomial`: over the decided samples, and one later where outputs alone stand in it, so that the
    /// last inputs act on it.
    pub(super) fn mean(&self, monomial: &Monomial, weight: f64) -> Sum {
        let divisor = (self.to - self.from) as f64;
        let product = self.product(monomial, weight / divisor);
        let inputs = self.problem.inputs.len();
        let outputs_only = !product.powers.is_empty() && product.powers.iter().all(|(c, _)| *c >= inputs);
        let shift = usize::from(outputs_only && self.to < self.samples);
        Sum { product, from: self.from + shift, to: self.to + shift }
    }
}

/// Delays with which a row reads column `c`.
fn lags<'b>(row: &'b ModelRow, c: usize) -> impl Iterator<Item = usize> + 'b {
    let reads = move |i: usize| row.readings[i].columns().contains(&c);
    row.model.window().iter().filter(move |(i, _)| reads(*i)).map(|(_, lag)| *lag)
}
