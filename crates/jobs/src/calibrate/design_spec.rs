//! The spec of the job `design` that a campaign writes, and what its plan is on the models.

use super::context::Context;
use super::error::ChainError;
use super::models::ModelsResult;
use crate::design::result::Curves;
use dynocal_calib::problem::DemandChannel;
use dynocal_calib::validate::inner;
use dynocal_design::criterion;
use dynocal_files::json;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};
use dynocal_numerics::watch::Watch;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

fn table<const N: usize>(pairs: [(&str, Value); N]) -> Table {
    pairs.into_iter().map(|(k, v)| (k.to_string(), v)).collect()
}

/// Spec of the design, written beside its result; the models are copied into `folder`.
///
/// # Errors
/// [`ChainError`].
pub(super) fn design_text(
    ctx: &Context,
    folder: &Path,
    models: &ModelsResult,
    identification: &[(Dataset, PathBuf)],
    (wanted, richest): (&str, bool),
) -> Result<String, ChainError> {
    let (spec, problem, channels) = (&ctx.spec.design, &ctx.spec.problem, &ctx.channels);
    let mut list = Vec::new();
    for (k, i) in problem.inputs.iter().enumerate() {
        // What a loop drives moves the plant as a whole: it goes through its excited range in the time of a ramp.
        let range = if channels.driven.contains(&k) {
            excited(identification, &i.name).unwrap_or((i.lower, i.upper))
        } else {
            ctx.spec.excite.ranges.get(&i.name).copied().unwrap_or((i.lower, i.upper))
        };
        let mut t = table([
            ("name", Value::String(i.name.clone())),
            ("unit", Value::String(i.unit.clone())),
            ("lower", Value::Float(range.0)),
            ("upper", Value::Float(range.1)),
            ("hold_s", Value::Float(spec.hold_s)),
        ]);
        if channels.driven.contains(&k) && spec.ramp_s > 0.0 {
            t.insert("shape".into(), Value::String("linear".into()));
        }
        if let Some(rate) = i.rate_per_s.filter(|_| ctx.spec.excite.keep_rates) {
            t.insert("rate_per_s".into(), Value::Float(rate));
        }
        list.push(Value::Table(t));
    }
    for g in &problem.given {
        let range = ctx.spec.excite.ranges.get(&g.name).copied().unwrap_or((g.lower, g.upper));
        list.push(Value::Table(table([
            ("name", Value::String(g.name.clone())),
            ("unit", Value::String(g.unit.clone())),
            ("lower", Value::Float(range.0)),
            ("upper", Value::Float(range.1)),
            ("hold_s", Value::Float(spec.given_point_s)),
            ("shape", Value::String("linear".into())),
        ])));
    }
    let mut model_tables = Vec::new();
    for o in &models.outputs {
        let file = format!("design_{}.json", o.output);
        let one = if richest { o.richest() } else { o.best() };
        json::write_versioned(&folder.join(&file), MODEL_SCHEMA, MODEL_VERSION, &one.model)?;
        let rmse = one.scores.iter().filter_map(|s| s.rmse).fold(0.0, f64::max);
        let mut t = table([
            ("file", Value::String(file)),
            ("noise_std", Value::Float(rmse.max(1e-9))),
            ("criterion", Value::String(wanted.into())),
        ]);
        if let Some(d) = problem.demands.iter().find(|d| d.output == o.output) {
            let (lower, upper) = inner((d.lower, d.upper), -spec.excess);
            let limits = table([
                ("lower", Value::Float(lower)),
                ("upper", Value::Float(upper)),
                ("margin", Value::Float((2.0 * rmse).min(0.2 * (upper - lower)))),
            ]);
            t.insert("limits".into(), Value::Table(limits));
            t.insert("initial_output".into(), Value::Float(middle(d)));
        } else if let Some((lower, upper)) = limited(ctx, identification, &o.output) {
            let limits = table([
                ("lower", Value::Float(lower)),
                ("upper", Value::Float(upper)),
                ("margin", Value::Float((2.0 * rmse).min(0.2 * (upper - lower)))),
            ]);
            t.insert("limits".into(), Value::Table(limits));
        }
        let prior = identification
            .iter()
            .map(|(_, p)| Value::String(super::model_spec::relative(p, folder)))
            .collect();
        t.insert("prior".into(), Value::Array(prior));
        model_tables.push(Value::Table(t));
    }
    let search = table([
        ("name", Value::String("kicks".into())),
        ("starts", Value::Integer(spec.starts as i64)),
        ("evaluations", Value::Integer(spec.max_evaluations as i64)),
    ]);
    // The job finds fault with a criterion that there is not.
    let predicts = criterion::criterion(wanted, &Table::new()).is_ok_and(|c| c.needs_objective_signal());
    let objective = if predicts { Some(objective(folder, &list, identification)?) } else { None };
    let mut all = table([
        ("name", Value::String("design01".into())),
        ("length_s", Value::Float(spec.record_s)),
        ("sample_time_s", Value::Float(ctx.spec.sample_time_s)),
        ("rivals", Value::Integer(0)),
        ("certificate", Value::Boolean(false)),
        // Values of `d` are logarithms, and add up as they are.
        ("efficiencies", Value::Boolean(wanted != "d")),
        ("channels", Value::Array(list)),
        ("models", Value::Array(model_tables)),
        ("search", Value::Table(search)),
    ]);
    if let Some(file) = objective {
        all.insert("objective".into(), Value::Table(table([("file", Value::String(file))])));
    }
    toml::to_string(&all).map_err(|e| ChainError::Design(e.to_string()))
}

/// What predictions are wanted for: the channels of the records so far, within the limits of the design. Returns the name of the file.
fn objective(
    folder: &Path,
    channels: &[Value],
    records: &[(Dataset, PathBuf)],
) -> Result<String, ChainError> {
    let Some((first, _)) = records.first() else {
        return Err(ChainError::Design("there is no record of the excitation".into()));
    };
    let mut all = Dataset { name: "objective".into(), channels: Vec::new(), ..first.clone() };
    for table in channels {
        let text = |key| table.get(key).and_then(Value::as_str).unwrap_or_default().to_string();
        let limit = |key, none| table.get(key).and_then(Value::as_float).unwrap_or(none);
        let (lower, upper) = (limit("lower", f64::NEG_INFINITY), limit("upper", f64::INFINITY));
        let (name, unit) = (text("name"), text("unit"));
        let mut values = Vec::new();
        for (record, _) in records {
            values.extend(record.values(&name)?.iter().map(|v| v.clamp(lower, upper)));
        }
        all.channels.push(Channel { name, unit, role: Role::Input, values });
    }
    let saved = super::records::save_records(folder, &[all])?;
    Ok(saved[0].file.clone())
}

/// Limits of an output that is not demanded; a side without one lies far beyond what was seen. None where there is no limit, or
/// where the records do not keep it anywhere.
fn limited(ctx: &Context, records: &[(Dataset, PathBuf)], output: &str) -> Option<(f64, f64)> {
    let limit = ctx.spec.problem.limits.iter().find(|l| l.output == output)?;
    let (least, greatest) = excited(records, output)?;
    match (limit.lower, limit.upper) {
        (Some(lower), Some(upper)) => Some((lower, upper)),
        (None, Some(upper)) if least < upper => Some((upper - FAR * (upper - least), upper)),
        (Some(lower), None) if greatest > lower => Some((lower, lower + FAR * (greatest - lower))),
        _ => None,
    }
}

/// How far away the side is that has no limit, in widths of what was seen.
const FAR: f64 = 10.0;

/// Range of a channel over the records, 1 % cut off at either end.
fn excited(records: &[(Dataset, PathBuf)], name: &str) -> Option<(f64, f64)> {
    let mut all: Vec<f64> =
        records.iter().filter_map(|(d, _)| d.values(name).ok()).flat_map(|v| v.iter().copied()).collect();
    all.sort_by(f64::total_cmp);
    let at = |share: f64| all.get((share * (all.len().max(1) - 1) as f64) as usize).copied();
    at(0.01).zip(at(0.99)).filter(|(a, b)| a < b)
}

/// The plan as a record of inputs.
pub(super) fn as_record(ctx: &Context, curves: &Curves) -> Dataset {
    let problem = &ctx.spec.problem;
    let unit = |name: &str| problem.unit(name).unwrap_or("-").to_string();
    let names = ctx.channels.plant_inputs();
    let m = names.len();
    let column = |k: usize| curves.u.iter().skip(k).step_by(m).copied().collect::<Vec<f64>>();
    Dataset {
        name: "design01".into(),
        sample_time_s: ctx.spec.sample_time_s,
        channels: names
            .iter()
            .enumerate()
            .map(|(k, name)| Channel {
                name: name.clone(),
                unit: unit(name),
                role: Role::Input,
                values: column(k),
            })
            .collect(),
        init_samples: 0,
        origin: "design".into(),
    }
}

/// Where an output stands before the first sample of a design.
fn middle(d: &DemandChannel) -> f64 {
    0.5 * (d.lower + d.upper)
}

/// Demands of the plan: what the models answer to it, from where the design begins, inside the ranges that loops can hold.
///
/// # Errors
/// [`ChainError`].
pub(super) fn predicted(
    ctx: &Context,
    record: &Dataset,
    models: &[&StoredModel],
) -> Result<Vec<Vec<f64>>, ChainError> {
    let mut record = record.clone();
    let n = record.len();
    for d in &ctx.spec.problem.demands {
        let unit = ctx.spec.problem.unit(&d.output).unwrap_or("-").into();
        let values = vec![middle(d); n];
        record.channels.push(Channel { name: d.output.clone(), unit, role: Role::Output, values });
    }
    let mut out = Vec::new();
    for d in &ctx.spec.problem.demands {
        let model = models.iter().find(|m| m.user_output().name == d.output);
        let run = model.map(|m| m.simulate(&record, None)).transpose()?.and_then(|r| r.into_iter().next());
        let Some(run) = run else { return Err(ChainError::Design(format!("no model of `{}`", d.output))) };
        let (lower, upper) = inner((d.lower, d.upper), -ctx.spec.design.excess);
        out.push(run.y.iter().map(|y| y.clamp(lower, upper)).collect());
    }
    Ok(out)
}

/// What listens to the design.
pub(super) fn watch<'a>(ctx: &'a Context) -> Watch<'a> {
    Watch { interrupt: ctx.watch.interrupt, ..Watch::silent() }
}
