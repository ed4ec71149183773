//! The record with which an optimisation begins: demands that the plant can follow, and inputs that roughly give them.

use super::chain::with_read;
use super::context::Context;
use super::error::ChainError;
use super::excited::bounded;
use super::signals::{aprbs, sweep};
use super::start_maps::start_maps;
use dynocal_calib::map::filter::filtered;
use dynocal_calib::map::start::{StartRule, rate_limited};
use dynocal_calib::map::structured::StructuredShape;
use dynocal_calib::map::structures::MapError;
use dynocal_calib::map::{Port, Rows};
use dynocal_calib::validate::inner;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::rng::Rng64;
use std::path::PathBuf;

/// Share of a rate limit that the start uses, so that it is inside.
const START_RATE: f64 = 0.8;

/// Samples at the head of the start record in which everything is held: the models' histories are then at rest.
const HELD_HEAD: usize = 12;

/// A record of references that the plant can follow, with start inputs that roughly give them, for pass `k`; every `draw` is another.
pub(super) fn start_record(
    ctx: &Context,
    k: usize,
    draw: usize,
    models: &[&StoredModel],
    data: &[(Dataset, PathBuf)],
) -> Result<Dataset, ChainError> {
    let (spec, problem, channels) = (&ctx.spec.optimise, &ctx.spec.problem, &ctx.channels);
    let dt = ctx.spec.sample_time_s;
    let n = (spec.record_s / dt).round() as usize;
    let mut rng = Rng64::stream(ctx.spec.seed, (300 + k + 1000 * draw) as u64);
    let mut demands = Vec::new();
    for (j, d) in problem.demands.iter().enumerate() {
        // The leading demand goes through nearly all of its range, the others stay about their middles.
        let own = inner((d.lower, d.upper), if j == 0 { 0.025 } else { 0.25 });
        let range = spec.ranges.get(&d.output).copied().unwrap_or(own);
        let (levels, hold_s) = if j == 0 { (9, spec.hold_s) } else { (5, 2.3 * spec.hold_s) };
        let raw = aprbs(range, levels, hold_s, 0.0, n, dt, &mut rng)?;
        let lags = if j == 0 {
            ctx.spec.invert.built().map_err(MapError::from)?.filter_s(&d.output, 0)
        } else {
            vec![StructuredShape::FILTER_S[1]]
        };
        demands.push(held_head(filtered(&raw, &lags, dt)));
    }
    let mut free = Vec::new();
    for &i in &channels.free {
        let c = &problem.inputs[i];
        let range = ctx.spec.excite.ranges.get(&c.name).copied().unwrap_or((c.lower, c.upper));
        let levels = aprbs(range, ctx.spec.excite.levels, ctx.spec.excite.hold_s, 0.0, n, dt, &mut rng)?;
        let rate = c.rate_per_s.map_or(f64::INFINITY, |r| START_RATE * r * dt);
        free.push(rate_limited(&held_head(levels), rate));
    }
    let mut given = Vec::new();
    for (j, g) in problem.given.iter().enumerate() {
        let e = &ctx.spec.excite;
        let period = (e.sweep_s + 1.3 * k as f64) * (1.0 + 0.37 * j as f64);
        let range = e.ranges.get(&g.name).copied().unwrap_or((g.lower, g.upper));
        given.push(held_head(sweep(range, period, e.dwell_s, n, dt)?));
    }
    let rule = start_rule(ctx, data)?;
    let references: Vec<&[f64]> = demands.iter().chain(&given).map(Vec::as_slice).collect();
    let mapped = start_maps(ctx)?.into_iter().map(|m| (m.input, m.along(&references, n))).collect();
    let begin = Begin { ctx, k, models, demands, given, free, mapped };
    let mut reference = begin.demands.clone();
    let mut best: Option<(f64, Dataset)> = None;
    for _ in 0..=CORRECTIONS {
        let record = begin.driven(&rule, &reference);
        let Some(response) = begin.response(&record) else { break };
        let cost = begin.correct(&response, &mut reference);
        if best.as_ref().is_none_or(|b| cost < b.0) {
            best = Some((cost, record));
        }
    }
    // Where a model runs away the optimisation says which.
    let mut record = best.map_or_else(|| begin.driven(&rule, &begin.demands), |b| b.1);
    bounded(ctx, &mut record, &begin.demands, data)?;
    Ok(record)
}

/// Times that the start is corrected by what the models say of it, and the share of the miss that each takes back.
const CORRECTIONS: usize = 8;
const SHARE: f64 = 0.6;
/// Time constant of the smoothing of a correction in s, that of a demand.
const SMOOTH_S: f64 = StructuredShape::FILTER_S[1];

/// What a start is made of.
struct Begin<'a> {
    ctx: &'a Context<'a>,
    k: usize,
    models: &'a [&'a StoredModel],
    demands: Vec<Vec<f64>>,
    given: Vec<Vec<f64>>,
    free: Vec<Vec<f64>>,
    /// Inputs that maps of the user give, which stay as they are.
    mapped: Vec<(usize, Vec<f64>)>,
}

impl Begin<'_> {
    /// The record in which the rule drives the inputs of the loops towards `reference`.
    fn driven(&self, rule: &StartRule, reference: &[Vec<f64>]) -> Dataset {
        let (problem, channels) = (&self.ctx.spec.problem, &self.ctx.channels);
        let all: Vec<&[f64]> =
            reference.iter().chain(&self.given).chain(&self.free).map(Vec::as_slice).collect();
        let driven = rule.drive(&Rows::from_columns(&all));
        let limited = |i: usize, values: Vec<f64>| {
            let rate = problem.inputs[i].rate_per_s;
            let rate = rate.map_or(f64::INFINITY, |r| START_RATE * r * self.ctx.spec.sample_time_s);
            rate_limited(&held_head(values), rate)
        };
        let mut inputs = vec![Vec::new(); channels.inputs.len()];
        for (c, &i) in channels.driven.iter().enumerate() {
            inputs[i] = limited(i, driven.column(c));
        }
        for (values, &i) in self.free.iter().zip(&channels.free) {
            inputs[i].clone_from(values);
        }
        for (i, values) in &self.mapped {
            inputs[*i] = limited(*i, values.clone());
        }
        record_of(self.ctx, self.k, inputs, &self.given, &self.demands, self.models)
    }

    /// What the models say of the demanded outputs; none where one has no model, or runs away.
    fn response(&self, record: &Dataset) -> Option<Vec<Vec<f64>>> {
        let channels = &self.ctx.channels;
        let record = with_read(channels, self.models, record).ok()?;
        let of = |d: &String| {
            let model = self.models.iter().find(|m| m.user_output().name == *d)?;
            let y = model.simulate(&record, None).ok()?.into_iter().next()?.y;
            y.iter().all(|v| v.is_finite()).then_some(y)
        };
        channels.demands.iter().map(of).collect()
    }

    /// Moves the reference against the miss of the response, by one range of the demand beyond it at most; mean square of the miss
    /// in units of that range. The rule is an approximate inverse of the models: the iteration is that of internal model control
    /// over a record.
    fn correct(&self, response: &[Vec<f64>], reference: &mut [Vec<f64>]) -> f64 {
        let mut cost = 0.0;
        let ranges = self.ctx.spec.problem.demands.iter().map(|d| (d.lower, d.upper));
        for (((y, wanted), r), (lower, upper)) in
            response.iter().zip(&self.demands).zip(reference).zip(ranges)
        {
            let miss: Vec<f64> = wanted.iter().zip(y).map(|(w, y)| w - y).collect();
            cost += miss.iter().map(|m| (m / (upper - lower)).powi(2)).sum::<f64>() / y.len() as f64;
            for (r, m) in r.iter_mut().zip(smoothed(miss, self.ctx.spec.sample_time_s)) {
                *r = (*r + SHARE * m).clamp(2.0 * lower - upper, 2.0 * upper - lower);
            }
        }
        cost
    }
}

/// Filtered forwards and backwards: what the rule does not know of fast dynamics would be taken back too late, and grow.
pub(super) fn smoothed(values: Vec<f64>, sample_time_s: f64) -> Vec<f64> {
    let mut there = filtered(&values, &[SMOOTH_S], sample_time_s);
    there.reverse();
    let mut back = filtered(&there, &[SMOOTH_S], sample_time_s);
    back.reverse();
    back
}

/// The first samples held at their first value.
fn held_head(mut values: Vec<f64>) -> Vec<f64> {
    let n = HELD_HEAD.min(values.len());
    let first = values.first().copied().unwrap_or(0.0);
    values[..n].fill(first);
    values
}

/// The rule that drives start records, fitted to measured ones.
///
/// # Errors
/// [`ChainError`].
pub(super) fn start_rule(ctx: &Context, data: &[(Dataset, PathBuf)]) -> Result<StartRule, ChainError> {
    let (problem, channels) = (&ctx.spec.problem, &ctx.channels);
    let ports = &channels.ports;
    let free: Vec<Port> = channels
        .free
        .iter()
        .map(|&i| Port { name: problem.inputs[i].name.clone(), unit: problem.inputs[i].unit.clone() })
        .collect();
    let driven: Vec<_> = channels.driven.iter().map(|&i| ports.actuators[i].clone()).collect();
    let names = |list: &[Port]| list.iter().map(|p| p.name.clone()).collect::<Vec<_>>();
    let references = [names(&ports.demands), names(&ports.given), names(&free)].concat();
    let actuators: Vec<String> = driven.iter().map(|p| p.name.clone()).collect();
    let records = data
        .iter()
        .map(|(d, _)| Ok((channels.rows(d, &references)?, channels.rows(d, &actuators)?)))
        .collect::<Result<Vec<_>, ChainError>>()?;
    Ok(StartRule::fit(&ports.demands, &ports.given, &free, &driven, &records)?)
}

/// The start as a record; outputs stand at the models' rest under the first inputs.
fn record_of(
    ctx: &Context,
    k: usize,
    inputs: Vec<Vec<f64>>,
    given: &[Vec<f64>],
    demands: &[Vec<f64>],
    models: &[&StoredModel],
) -> Dataset {
    let problem = &ctx.spec.problem;
    let n = demands.first().map_or(0, Vec::len);
    let channel = |name: &str, unit: &str, role: Role, values: Vec<f64>| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values,
    };
    let mut channels: Vec<Channel> = problem
        .inputs
        .iter()
        .zip(inputs)
        .map(|(i, v)| channel(&i.name, &i.unit, Role::Input, v))
        .chain(
            problem.given.iter().zip(given).map(|(g, v)| channel(&g.name, &g.unit, Role::Input, v.clone())),
        )
        .collect();
    let mut record = Dataset {
        name: format!("pass{k}_start"),
        sample_time_s: ctx.spec.sample_time_s,
        channels: channels.clone(),
        init_samples: 0,
        origin: "start rule".into(),
    };
    // What others read rests first.
    let read = &ctx.channels.read;
    let others = ctx.channels.outputs().into_iter().filter(|o| !read.contains(o));
    for output in read.iter().cloned().chain(others) {
        let guess = problem.demands.iter().position(|d| d.output == output).map(|j| demands[j][0]);
        let model = models.iter().find(|m| m.user_output().name == output);
        let at_rest = model.and_then(|m| rest_of(m, &record));
        let value = at_rest.or(guess).unwrap_or(0.0);
        let unit = problem.unit(&output).unwrap_or("-").to_string();
        let rests = channel(&output, &unit, Role::Output, vec![value; n]);
        if read.contains(&output) {
            record.channels.push(rests.clone());
        }
        channels.push(rests);
    }
    record.channels = channels;
    record
}

/// Where a model rests under the first inputs of a record, in the user's unit; none where it does not.
fn rest_of(model: &StoredModel, record: &Dataset) -> Option<f64> {
    let n = 400;
    let mut held = record.clone();
    for c in &mut held.channels {
        c.values = vec![c.values.first().copied()?; n];
    }
    let y = model.simulate(&held, None).ok()?.into_iter().next()?.y;
    y.last().copied().filter(|v| v.is_finite())
}
