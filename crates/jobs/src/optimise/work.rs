//! The work: models and record to an optimum with its verdict, in memory.

use dynocal_calib::optimise::{Guard, Optimum, Price, Way, check_record, distance_name, optimise_record};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::stored::StoredModel;
use dynocal_ident::validate::boundary::coverage;
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;

use super::load::{Loaded, Named, load};
use super::result::{
    Asked, DecidedSamples, Left, Objective, OptimiseJobError, Optimised, PriceLine, RecordUsed, Used,
};
use super::spec::Job;
use super::words;
use crate::estimate::Estimate;

/// Distance up to which a demand or limit counts as kept, as a share of its size.
const KEPT: f64 = 1e-6;
/// Bytes that a batch takes for each variable of a sample: its derivatives, factors and iterates.
const BYTES_PER_VALUE: f64 = 12e3;
/// Operations for the same over a usual number of iterations.
const WORK_PER_VALUE: f64 = 1e6;

/// Optimises in memory.
///
/// # Errors
/// [`OptimiseJobError`]: files, channels, units, models and problem that do not belong together, a record that is too short,
/// an interruption. That the problem has no solution is a result.
pub fn optimise(job: &Job, watch: Watch) -> Result<Optimised, OptimiseJobError> {
    let loaded = load(job, watch)?;
    plan_of(job, &loaded).allowed()?;
    let models: Vec<&StoredModel> = loaded.models.iter().map(|n| &n.model).collect();
    watch.note(&format!("optimising {} samples", loaded.record.len()));
    let stop = || watch.interrupted();
    let optimum = optimise_record(&job.problem, &models, &loaded.record, &job.optimise, &stop)?;
    if optimum.status == Status::Interrupted {
        return Err(OptimiseJobError::Interrupted);
    }
    Ok(judged(job, loaded, optimum))
}

/// Reads models and record, and says what the optimisation would take.
///
/// # Errors
/// [`OptimiseJobError`] as of [`optimise`], as far as it shows before the search.
pub fn estimate(job: &Job) -> Result<Estimate, OptimiseJobError> {
    let loaded = load(job, Watch::silent())?;
    let models: Vec<&StoredModel> = loaded.models.iter().map(|n| &n.model).collect();
    check_record(&job.problem, &models, &loaded.record, &job.optimise)?;
    Ok(plan_of(job, &loaded))
}

fn plan_of(job: &Job, loaded: &Loaded) -> Estimate {
    let (p, n, dt) = (&job.problem, loaded.record.len(), loaded.record.sample_time_s);
    let total = n as f64 + (job.optimise.extend_s / dt).round();
    let copies = 1 + job.optimise.robust.map_or(0, |r| r.draws);
    let distances = job.optimise.guard.map_or(0, |_| loaded.models.len());
    let outputs = copies * p.other_outputs().len() + p.demands.len() + distances;
    let values = (p.inputs.len() + outputs) as f64;
    let (at_once, way) = match job.optimise.way {
        Way::Batch(b) => (total, format!("all samples at once, {} start(s)", b.starts)),
        Way::Segments(s) => (total.min(2.0 * s.length_s / dt), format!("segments of {} s", s.length_s)),
        Way::Horizon(h) => (total.min(2.0 * h.length_s / dt), format!("a horizon of {} s", h.length_s)),
        Way::Dynamic(_) => (total, "a grid of what the models remember".into()),
    };
    let memory = BYTES_PER_VALUE * values * at_once + 100.0 * values * total;
    let outputs: Vec<String> = loaded.models.iter().map(|n| n.model.user_output().name).collect();
    Estimate::new(&job.name)
        .line("models", outputs.join(", "))
        .line("record", format!("{n} samples of {dt} s"))
        .line("moved", p.input_names().join(", "))
        .line("way", way)
        .memory(memory)
        .work(WORK_PER_VALUE * values * total)
}

/// What came out, judged.
fn judged(job: &Job, loaded: Loaded, mut optimum: Optimum) -> Optimised {
    if !optimum.status.is_success() {
        // What a point costs that is no optimum is the price of nothing.
        optimum.prices.clear();
    }
    let p = &job.problem;
    let sizes = Sizes { problem: p, start: &loaded.record };
    let asked = asked(&sizes, job.optimise.guard, &optimum);
    let valid = optimum.status.is_success() && asked.iter().all(|a| a.kept || a.soft);
    let (start, end) = (optimum.start_objective, optimum.objective);
    let change_percent = (start != 0.0).then(|| 100.0 * (end - start) / start.abs());
    let record = RecordUsed {
        name: loaded.record.name.clone(),
        samples: loaded.record.len(),
        sample_time_s: loaded.record.sample_time_s,
        decided: DecidedSamples { first: optimum.first, end: optimum.last },
    };
    let coverage: Vec<Left> =
        loaded.models.iter().filter_map(|n| left(&n.model, &loaded.record, &optimum)).collect();
    let mut out = Optimised {
        verb: "optimise",
        name: job.name.clone(),
        valid,
        verdict: Vec::new(),
        warnings: Vec::new(),
        models: loaded.models.iter().map(used).collect(),
        record,
        status: optimum.status,
        iterations: optimum.iterations,
        objective: Objective { start, optimum: end, change_percent, minimised: optimum.minimised },
        terms: optimum.terms.clone(),
        asked,
        prices: prices(&sizes, &optimum),
        parts: optimum.parts.clone(),
        shortfalls: optimum.shortfalls.clone(),
        guard: job.optimise.guard,
        robust: job.optimise.robust,
        spreads: optimum.spreads.clone(),
        grid: optimum.grid.clone(),
        coverage,
        files: Vec::new(),
        problem: p.clone(),
        start: loaded.record,
        optimum,
    };
    out.verdict = words::verdict(&out);
    let optimal = with_optimum(&out.start, &out.optimum);
    let outside = loaded.models.iter().flat_map(|n| n.model.outside(&optimal));
    out.warnings = words::warnings(&out, &loaded.from_rest, outside.collect());
    out
}

fn used(n: &Named) -> Used {
    let output = n.model.user_output();
    Used {
        file: n.file.clone(),
        output: output.name,
        unit: output.unit,
        inputs: n.model.measured_inputs().into_iter().map(|q| q.name).collect(),
        parameters: n.model.theta().len(),
    }
}

/// The record with optimal inputs, demands met and the other outputs as at the optimum.
pub(super) fn with_optimum(record: &Dataset, optimum: &Optimum) -> Dataset {
    let mut d = record.clone();
    for c in optimum.inputs.iter().chain(&optimum.demands).chain(&optimum.outputs) {
        if let Some(own) = d.channels.iter_mut().find(|own| own.name == c.name) {
            own.values.clone_from(&c.values);
        }
    }
    d.name = "optimum".into();
    d
}

fn asked(sizes: &Sizes, guard: Option<Guard>, optimum: &Optimum) -> Vec<Asked> {
    let p = sizes.problem;
    let distances: Vec<String> =
        p.demand_names().iter().chain(&p.other_outputs()).map(|o| distance_name(o)).collect();
    let soft_guard = guard.is_some_and(|g| g.soft_weight.is_some());
    let soft = |channel: &str, of: &str| {
        let limit = p.limits.iter().find(|l| l.output == channel);
        let is =
            limit.map_or(soft_guard && distances.iter().any(|d| d == channel), |l| l.soft_weight.is_some());
        ["lower", "upper"].contains(&of) && is
    };
    let of = |v: &dynocal_calib::optimise::Violation| {
        let unit = if v.of == "rate" { format!("{}/sample", v.unit) } else { v.unit.clone() };
        let allowed = KEPT * sizes.of(&v.channel, &v.of, optimum.sample_time_s);
        Asked {
            channel: v.channel.clone(),
            unit,
            of: v.of.clone(),
            largest: Some(v.largest).filter(|l| l.is_finite()),
            allowed,
            at_s: v.at_s,
            kept: v.largest <= allowed,
            soft: soft(&v.channel, &v.of),
        }
    };
    optimum.violations.iter().map(of).collect()
}

/// How large what is asked of a channel is.
struct Sizes<'a> {
    problem: &'a CalibrationProblem,
    start: &'a Dataset,
}

impl Sizes<'_> {
    /// Size of what is asked of a channel: the range of an input or demand, the width of limits (of a single one its value, or what the
    /// channel reaches at the start where that is more: a limit of zero has a size, too), the largest step of a rate.
    fn of(&self, channel: &str, of: &str, sample_time_s: f64) -> f64 {
        let p = self.problem;
        if let Some(i) = p.inputs.iter().find(|i| i.name == channel) {
            return match (of, i.rate_per_s) {
                ("rate", Some(rate)) => rate * sample_time_s,
                _ => i.upper - i.lower,
            };
        }
        if let Some(d) = p.demands.iter().find(|d| d.output == channel) {
            return d.upper - d.lower;
        }
        let Some(l) = p.limits.iter().find(|l| l.output == channel) else { return 1.0 };
        match (of, l.lower, l.upper) {
            ("mean_upper", ..) => l.mean_upper.map_or(1.0, |v| v.abs().max(1e-3)),
            (_, Some(lower), Some(upper)) => upper - lower,
            ("lower", ..) => self.single(channel, l.lower),
            _ => self.single(channel, l.upper),
        }
    }

    fn single(&self, channel: &str, limit: Option<f64>) -> f64 {
        let values = self.start.values(channel).unwrap_or(&[]);
        let reached = values.iter().filter(|v| v.is_finite()).fold(1e-3, |m: f64, v| m.max(v.abs()));
        limit.map_or(1.0, |v| v.abs().max(reached))
    }
}

/// Prices by what one percent of each thing's size changes, the dearest first.
fn prices(sizes: &Sizes, optimum: &Optimum) -> Vec<PriceLine> {
    let of = |x: &Price| {
        // A rate is priced per second.
        let percent_of_size = 0.01 * sizes.of(&x.channel, &x.of, 1.0);
        PriceLine {
            channel: x.channel.clone(),
            of: x.of.clone(),
            unit: x.unit.clone(),
            price: x.price,
            percent_of_size,
            per_percent: x.price * percent_of_size,
        }
    };
    let mut lines: Vec<PriceLine> = optimum.prices.iter().map(of).collect();
    lines.sort_by(|a, b| b.per_percent.abs().total_cmp(&a.per_percent.abs()));
    lines
}

/// How far start and optimum are from what a model was identified on; none where it does not know, or where its preparation
/// does not keep the samples.
fn left(model: &StoredModel, record: &Dataset, optimum: &Optimum) -> Option<Left> {
    let boundary = model.boundary.as_ref()?;
    let of = |d: &Dataset| {
        let (prepared, _) = model.prepared(d).ok()?;
        let [one] = prepared.as_slice() else { return None };
        let (e, _) = model.shaped(one).ok()?;
        Some(coverage(boundary, &e.u, &e.y, optimum.first))
    };
    let mut start = record.clone();
    // The start is held against its own response, as the optimum is against the demand.
    for c in start.channels.iter_mut().filter(|c| c.role == Role::Output) {
        if let Some(demand) = optimum.demands.iter().find(|d| d.name == c.name) {
            c.values.clone_from(&demand.values);
        }
    }
    let (start, end) = (of(&start)?, of(&with_optimum(record, optimum))?);
    Some(Left {
        output: model.user_output().name,
        start_percent: 100.0 * start.share_outside,
        optimum_percent: 100.0 * end.share_outside,
        worst: end.worst,
        at_s: end.sample as f64 * optimum.sample_time_s,
    })
}
