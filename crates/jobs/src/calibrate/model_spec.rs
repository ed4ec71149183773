//! The specs of the job `identify` that a campaign writes: candidates from the problem where the user gives none.

use super::context::Context;
use super::error::ChainError;
use super::spec::NEURAL;
use dynocal_calib::problem::GivenChannel;
use dynocal_ident::data::Dataset;
use dynocal_ident::derived::Derived;
use dynocal_ident::stored::StoredModel;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// One candidate.
#[derive(Clone, Debug)]
pub(super) struct CandidateSpec {
    /// In words.
    pub what: String,
    /// Table `[model]`.
    pub model: Table,
}

/// Candidates of one output.
#[derive(Clone, Debug)]
pub(super) struct Candidates {
    /// In the order in which they are tried.
    pub tables: Vec<CandidateSpec>,
    /// Derived channels that they read.
    pub derive: Vec<Derived>,
}

/// Name of the reciprocal of an output.
fn reciprocal_name(output: &str) -> String {
    format!("inv_{output}")
}

/// Ratio of the ends of a positive range over which the reciprocal is no more than a straight line: within 20 % of its middle it differs
/// from one by 4 %.
const STRAIGHT: f64 = 1.5;

/// Derived channels of the pools: those of the spec, the reciprocal of every positive given channel (what delays and
/// fillings scale with is the duration of a cycle), and the reciprocal of an output that stays away from zero.
fn derived(ctx: &Context, output: &str, records: &[(Dataset, PathBuf)]) -> (Vec<Derived>, Vec<String>, bool) {
    let unit_of = |name: &str| ctx.spec.problem.unit(name).unwrap_or("-").to_string();
    let reciprocal = |name: &str, factor: f64| Derived {
        name: reciprocal_name(name),
        unit: format!("1/({})", unit_of(name)),
        factor,
        powers: BTreeMap::from([(name.to_string(), -1)]),
    };
    let positive =
        |name: &str| records.iter().all(|(d, _)| d.values(name).is_ok_and(|v| v.iter().all(|x| *x > 0.0)));
    let mut derive = ctx.spec.identify.derive.clone();
    let mut names: Vec<String> = derive.iter().map(|d| d.name.clone()).collect();
    // Pools that have one channel more for the injection do without a second lambda.
    let moves = |g: &&GivenChannel| ctx.channels.read.is_empty() || g.upper > STRAIGHT * g.lower;
    for g in ctx.spec.problem.given.iter().filter(|g| g.lower > 0.0 && positive(&g.name)).filter(moves) {
        // Scaled to the order of the channel itself in its middle, so that regressors are of one size.
        derive.push(reciprocal(&g.name, 0.5 * (g.lower + g.upper)));
        names.push(reciprocal_name(&g.name));
    }
    // Near zero a reciprocal is all noise.
    let span = |name: &str| {
        let all = records.iter().filter_map(|(d, _)| d.values(name).ok()).flatten();
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(*v), hi.max(*v)))
    };
    let (least, largest) = span(output);
    let invertible = positive(output) && least > 0.1 * largest;
    if invertible {
        derive.push(reciprocal(output, 1.0));
    }
    (derive, names, invertible)
}

/// Candidates of `output`: those of the spec, or a polynomial selected from a pool of the problem's channels, for the output
/// itself and, where it stays away from zero, for its reciprocal.
///
/// # Errors
/// [`ChainError`].
pub(super) fn candidates(
    ctx: &Context,
    output: &str,
    records: &[(Dataset, PathBuf)],
) -> Result<Candidates, ChainError> {
    let (derive, extra, invertible) = derived(ctx, output, records);
    let own = ctx.spec.identify.models.get(output);
    if let Some(own) = own.filter(|o| !o.is_empty()) {
        let tables = own
            .iter()
            .map(|t| {
                let mut model = t.clone();
                model.entry("target").or_insert_with(|| Value::String(output.into()));
                CandidateSpec { what: words(&model), model }
            })
            .collect();
        return Ok(Candidates { tables, derive });
    }
    // What flows through the engine is read by the models of all else, and reads the pressure that it flows from.
    let read = ctx.channels.read_by(output).iter().cloned();
    let inputs: Vec<String> =
        ctx.channels.plant_inputs().into_iter().chain(read).chain(extra.iter().cloned()).collect();
    let (lags, least) = (ctx.spec.identify.lags.max(1), ctx.spec.identify.terms.max(3));
    let mut tables = Vec::new();
    for terms in (0..=ctx.spec.identify.doublings).map(|k| least << k) {
        tables.push(generated(ctx, (output, Speed::Moves), &inputs, &extra, lags, terms));
        if invertible {
            // A ratio of two flows is linear in one of them as a reciprocal; its sensor lies behind a transport.
            let (name, lags) = (reciprocal_name(output), lags + lags.div_ceil(2));
            tables.push(generated(ctx, (&name, Speed::Moves), &inputs, &extra, lags, terms + terms / 3));
        }
        if ctx.channels.read.iter().any(|r| r == output) {
            // Where others stand on it one that runs away takes them with it.
            tables.push(generated(ctx, (output, Speed::Stays), &inputs, &extra, lags, terms));
        }
    }
    if ctx.spec.identify.families.iter().any(|f| f == NEURAL) {
        // It bends as it likes, and needs no reciprocal.
        tables.push(neural(ctx, output, &inputs, &extra, lags));
    }
    Ok(Candidates { tables, derive })
}

/// A network over the same lags.
fn neural(ctx: &Context, target: &str, inputs: &[String], derived: &[String], lags: usize) -> CandidateSpec {
    let one = Value::Array(vec![Value::Integer(1), Value::Integer(1)]);
    let slow = inputs.iter().filter(|i| ctx.channels.given.contains(i) || derived.contains(i));
    let structure = table([
        ("name", Value::String(NEURAL.into())),
        ("input_lags", Value::Integer(lags as i64)),
        ("output_lags", Value::Integer(2)),
        ("lags", Value::Table(slow.map(|i| (i.clone(), one.clone())).collect())),
        // A linear path beside the neurons: beyond what was seen it goes on straight.
        ("direct", Value::Boolean(true)),
    ]);
    let estimator = table([
        ("name", Value::String("train".into())),
        ("starts", Value::Integer(NEURAL_STARTS)),
        ("seed", Value::Integer(ctx.spec.seed as i64)),
    ]);
    let model = table([
        ("target", Value::String(target.into())),
        ("inputs", Value::Array(inputs.iter().cloned().map(Value::String).collect())),
        ("structure", Value::Table(structure)),
        ("estimator", Value::Table(estimator)),
    ]);
    CandidateSpec { what: format!("neural model of {target}"), model }
}

/// Starts of a network's training.
const NEURAL_STARTS: i64 = 3;
/// Terms that forward selection takes beyond those that stay.
const SURPLUS: usize = 30;

/// Whether the speed of a recursion may depend on the channels, or stays: then a model of stable poles is stable everywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Speed {
    Moves,
    Stays,
}

/// A polynomial of selected terms from products of lagged inputs.
fn generated(
    ctx: &Context,
    (target, speed): (&str, Speed),
    inputs: &[String],
    derived: &[String],
    lags: usize,
    terms: usize,
) -> CandidateSpec {
    // Operating channels move slowly: one lag says what all lags say.
    let slow: Vec<&String> =
        inputs.iter().filter(|i| ctx.channels.given.contains(i) || derived.contains(i)).collect();
    let fast: Vec<&String> = inputs.iter().filter(|i| !slow.contains(i)).collect();
    let mut nu = Table::new();
    for i in &fast {
        nu.insert((*i).clone(), Value::Integer(lags as i64));
    }
    for i in &slow {
        nu.insert((*i).clone(), Value::Integer(1));
    }
    let middle = lags.div_ceil(2);
    let cubic: Vec<String> = fast
        .iter()
        .map(|i| format!("{i}(t-{middle})"))
        .chain(slow.iter().map(|i| format!("{i}(t-1)")))
        .collect();
    let mut regressors = Vec::new();
    for (a, x) in cubic.iter().enumerate() {
        for (b, y) in cubic.iter().enumerate().skip(a) {
            regressors.extend(cubic[b..].iter().map(|z| format!("{x}*{y}*{z}")));
        }
    }
    // The recursion: its speed may depend on every channel, but not on itself.
    for k in 1..=2 {
        regressors.push(format!("{target}(t-{k})"));
    }
    for i in inputs.iter().filter(|_| speed == Speed::Moves) {
        regressors.push(format!("{target}(t-1)*{i}(t-1)"));
    }
    let pool = table([
        ("ny", Value::Integer(0)),
        ("nu", Value::Table(nu)),
        ("degree", Value::Integer(2)),
        ("regressors", Value::Array(regressors.into_iter().map(Value::String).collect())),
    ]);
    let select = table([
        ("name", Value::String("prune".into())),
        // One-step prediction says little about the free run: forward selection takes more terms than wanted, elimination on
        // the free run of all records brings them down to the number of the spec. A model that is larger than it need be
        // promises what the plant does not keep.
        ("from", Value::Integer((terms + SURPLUS) as i64)),
        ("min_terms", Value::Integer(terms as i64)),
        ("selection", Value::Float(0.0)),
        ("slack", Value::Float(1e9)),
        ("pool", Value::Table(pool)),
    ]);
    let estimator = table([("name", Value::String("sem".into())), ("ridge", Value::Float(1e-5))]);
    let model = table([
        ("target", Value::String(target.into())),
        ("inputs", Value::Array(inputs.iter().cloned().map(Value::String).collect())),
        ("select", Value::Table(select)),
        ("estimator", Value::Table(estimator)),
    ]);
    let plain = if speed == Speed::Stays { ", linear in its past" } else { "" };
    CandidateSpec { what: format!("{terms} terms of {target}{plain}, simulation error"), model }
}

/// The chosen polynomial again, with all its terms; none for other kinds of model.
pub(super) fn refit(ctx: &Context, model: &StoredModel) -> Option<Candidates> {
    let polynomial = model.structure.form().polynomial()?;
    let regressors = polynomial.regressor_texts().into_iter().map(Value::String).collect();
    let structure =
        table([("name", Value::String("polynomial".into())), ("regressors", Value::Array(regressors))]);
    let inputs = model.inputs.iter().map(|q| Value::String(q.name.clone())).collect();
    let estimator = table([("name", Value::String("sem".into())), ("ridge", Value::Float(1e-5))]);
    let _ = ctx;
    let table = table([
        ("target", Value::String(model.output.name.clone())),
        ("inputs", Value::Array(inputs)),
        ("structure", Value::Table(structure)),
        ("estimator", Value::Table(estimator)),
    ]);
    let what = format!("{} terms as before, simulation error", model.parameters.len());
    Some(Candidates { tables: vec![CandidateSpec { what, model: table }], derive: model.derived.clone() })
}

fn table<const N: usize>(pairs: [(&str, Value); N]) -> Table {
    pairs.into_iter().map(|(k, v)| (k.to_string(), v)).collect()
}

/// What a table `[model]` is, in a few words.
fn words(model: &Table) -> String {
    let name = |key: &str| model.get(key).and_then(|v| v.get("name")).and_then(Value::as_str);
    let structure = name("structure").or_else(|| name("select")).unwrap_or("model");
    format!("{structure} by {}", name("estimator").unwrap_or("estimator"))
}

/// The whole spec of one candidate; files are relative to `folder`, where the spec stands.
///
/// # Errors
/// [`ChainError::Identify`] when it cannot be written as TOML.
pub(super) fn spec_text(
    ctx: &Context,
    (output, name): (&str, &str),
    candidate: &CandidateSpec,
    derive: &[Derived],
    records: &[(Dataset, PathBuf)],
    folder: &Path,
) -> Result<String, ChainError> {
    let fault = |e: &dyn std::fmt::Display| ChainError::Identify { what: name.into(), reason: e.to_string() };
    let files = records.iter().map(|(_, path)| Value::String(relative(path, folder))).collect();
    let spec = &ctx.spec.identify;
    let data = table([
        ("files", Value::Array(files)),
        ("sample_time_s", Value::Float(ctx.spec.sample_time_s)),
        ("init_samples", Value::Integer(spec.init_samples as i64)),
    ]);
    let channel = |name: &str, role: &str| {
        let unit = ctx.spec.problem.unit(name).unwrap_or("-");
        Value::Table(table([
            ("column", Value::String(name.into())),
            ("role", Value::String(role.into())),
            ("unit", Value::String(unit.into())),
        ]))
    };
    let inputs = ctx.channels.plant_inputs();
    let outputs = ctx.channels.outputs();
    let read = ctx.channels.read_by(output);
    let role = |n: &String| if read.contains(n) { "input" } else { "output" };
    let channels: Vec<Value> = inputs
        .iter()
        .map(|n| channel(n, "input"))
        .chain(outputs.iter().map(|n| channel(n, role(n))))
        .collect();
    let derive = derive.iter().map(Value::try_from).collect::<Result<Vec<_>, _>>().map_err(|e| fault(&e))?;
    let mut validate = spec.validate.clone();
    // Every candidate is judged on the campaign's records; what is left to the job stays short.
    validate.entry("stability_runs").or_insert(Value::Integer(3));
    let mut all = table([
        ("name", Value::String(name.into())),
        ("data", Value::Table(data)),
        ("channels", Value::Array(channels)),
        ("model", Value::Table(candidate.model.clone())),
        ("validate", Value::Table(validate)),
    ]);
    if !derive.is_empty() {
        all.insert("derive".into(), Value::Array(derive));
    }
    if !spec.prepare.is_empty() {
        let steps = spec.prepare.iter().cloned().map(Value::Table).collect();
        all.insert("prepare".into(), Value::Array(steps));
    }
    toml::to_string(&all).map_err(|e| fault(&e))
}

/// `path` as seen from `folder`, both inside one run folder.
pub(super) fn relative(path: &Path, folder: &Path) -> String {
    let shared = path.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().count() - shared;
    let rest: PathBuf = path.components().skip(shared).collect();
    let mut out = "../".repeat(up);
    out.push_str(&rest.to_string_lossy());
    out
}
