//! What is identified and how: table `model`.

use std::sync::Arc;

use dynocal_files::dataset::ChannelSpec;
use dynocal_files::spec::Faults;
use dynocal_ident::data::Role;
use dynocal_ident::estimate;
use dynocal_ident::model::form::Form;
use dynocal_ident::model::kinds;
use dynocal_ident::select::{self, pool::PoolKeys};
use serde::{Deserialize, Serialize};

use super::member::{built, built_with, member, member_of};
use super::typed::TypedModel;

/// One output that is modelled.
#[derive(Clone, Debug, Serialize)]
pub struct Target {
    /// Channel that is modelled.
    pub target: String,
    /// Channels that drive it; other targets among them are its regressors.
    pub inputs: Vec<String>,
    /// Structure.
    pub structure: StructureSpec,
    /// Selection of terms from the structure, which then is the pool.
    pub select: Option<Selecting>,
    /// Samples of a first, cheap estimate that gives the full one a further start; 0 for none.
    pub warm_start_samples: usize,
    /// Name of the estimator.
    pub estimator: String,
    /// Its keys.
    pub estimator_keys: toml::Table,
}

/// A structure with its keys.
#[derive(Clone, Debug, Serialize)]
pub struct StructureSpec {
    /// Name.
    pub name: String,
    /// Keys.
    pub keys: toml::Table,
}

impl Target {
    /// A linear ARX by least squares over the same channels instead: what every other model has to beat.
    pub fn linear(&mut self, na: usize, nb: usize, nk: usize) {
        let number = |n: usize| toml::Value::Integer(i64::try_from(n).unwrap_or(i64::MAX));
        let keys = [("na", na), ("nb", nb), ("nk", nk)].map(|(k, n)| (k.to_string(), number(n)));
        let keys = keys.into_iter().collect();
        self.structure = StructureSpec { name: "arx".into(), keys };
        self.select = None;
        self.warm_start_samples = 0;
        (self.estimator, self.estimator_keys) = ("ols".into(), toml::Table::new());
    }
}

/// How terms are selected.
#[derive(Clone, Debug, Serialize)]
pub struct Selecting {
    /// Name of the method.
    pub method: String,
    /// Its keys.
    pub keys: toml::Table,
    /// Candidates; none where the structure is the pool.
    pub pool: Option<PoolKeys>,
    /// Most samples that are looked at (the same share of the start of every record).
    pub max_samples: usize,
}

/// Name of the structure that only a pool describes.
pub(super) const POOL: &str = "pool";

/// All targets of the table; `seed` replaces that of estimators which have one.
pub(super) fn targets(
    typed: Option<&TypedModel>,
    channels: &[ChannelSpec],
    seed: Option<u64>,
    faults: &mut Faults,
) -> Option<Vec<Target>> {
    let Some(m) = typed else {
        faults.push("model", "nothing", "a table [model] with target, structure and estimator");
        return None;
    };
    let all: Vec<String> = channels.iter().map(|c| c.name.clone()).collect();
    let names = target_names(m, channels, faults)?;
    for name in m.inputs.iter().flatten().filter(|n| !all.contains(n)) {
        faults.unknown("model.inputs", name, &all);
    }
    for name in m.structures.iter().flat_map(|s| s.keys()).filter(|n| !names.contains(n)) {
        faults.unknown("model.structures", name, &names);
    }
    // Response models have one way to be learnt, which need not be named.
    let estimator = if m.estimator.is_none() && m.select.is_none() && all_responses(m) {
        Some(("learn".to_string(), toml::Table::new()))
    } else if m.estimator.is_none() && unknown_structure(m, faults) {
        None
    } else {
        estimator(m, seed, faults)
    };
    let select = m.select.as_ref().map(|s| selecting(s, faults));
    // Where a pool is described, it stands for the structure.
    let pool = select.as_ref().and_then(|s| s.as_ref()?.pool.clone());
    let mut out = Vec::new();
    for name in &names {
        let own = m.structures.as_ref().and_then(|s| s.get(name));
        let key = own.map_or("model.structure".to_string(), |_| format!("model.structures.{name}"));
        let table = own.cloned().or_else(|| m.structure.clone());
        let found = match (&pool, &table) {
            (Some(_), None) => Some((POOL.to_string(), toml::Table::new())),
            _ => member(&key, &table, faults),
        };
        let Some((structure, mut keys)) = found else { continue };
        let Some((estimator, estimator_keys)) = &estimator else { continue };
        if select.as_ref().is_some_and(Option::is_none) {
            continue;
        }
        localise(&mut keys, name, &all);
        if let (Some(seed), true) = (seed, has_seed(&structure)) {
            keys.insert("seed".into(), toml::Value::Integer(i64::try_from(seed).unwrap_or(i64::MAX)));
        }
        let inputs = inputs(m, channels, name, &keys);
        let spec = StructureSpec { name: structure, keys };
        match &pool {
            Some(pool) => selected_from(&key, &spec, &inputs, name, pool, faults),
            None => {
                let Some(form) = built_over(&key, &spec, &inputs, name, faults) else { continue };
                agree(&spec, estimator, faults);
                if m.select.is_some() && form.polynomial().is_none() {
                    let expected = "no selection: terms are selected from polynomial structures";
                    faults.push("model.select", format!("the structure `{}`", spec.name), expected);
                }
            }
        }
        out.push(Target {
            target: name.clone(),
            inputs,
            structure: spec,
            select: select.clone().flatten(),
            warm_start_samples: m.warm_start_samples.unwrap_or(0),
            estimator: estimator.clone(),
            estimator_keys: estimator_keys.clone(),
        });
    }
    (out.len() == names.len()).then_some(out)
}

/// Whether every structure of the table is a response model.
fn all_responses(m: &TypedModel) -> bool {
    let of = |table: &toml::Table| {
        let name = table.get("name").and_then(toml::Value::as_str).unwrap_or_default();
        kinds::row(name).is_ok_and(|k| k.form.name == "response")
    };
    let mut tables = m.structure.iter().chain(m.structures.iter().flat_map(|s| s.values())).peekable();
    tables.peek().is_some() && tables.all(of)
}

/// Names the structures that there are not: which estimator is missing cannot be said then.
fn unknown_structure(m: &TypedModel, faults: &mut Faults) -> bool {
    let own =
        m.structures.iter().flatten().map(|(target, table)| (format!("model.structures.{target}"), table));
    let all = m.structure.iter().map(|table| ("model.structure".to_string(), table)).chain(own);
    let mut unknown = false;
    for (key, table) in all {
        if let Some(name) = table.get("name").and_then(toml::Value::as_str) {
            unknown |= built(&key, "name", kinds::row(name), faults).is_none();
        }
    }
    unknown
}

fn has_seed(structure: &str) -> bool {
    kinds::row(structure).is_ok_and(|k| k.doc.params.iter().any(|p| p.name == "seed"))
}

fn target_names(m: &TypedModel, channels: &[ChannelSpec], faults: &mut Faults) -> Option<Vec<String>> {
    let all: Vec<String> = channels.iter().map(|c| c.name.clone()).collect();
    let outputs: Vec<String> =
        channels.iter().filter(|c| c.role == Role::Output).map(|c| c.name.clone()).collect();
    let (key, names) = match (&m.target, &m.targets) {
        (Some(_), Some(_)) => {
            faults.push("model.targets", "target as well", "either target or targets");
            return None;
        }
        (Some(t), None) => ("model.target", vec![t.clone()]),
        (None, Some(t)) if !t.is_empty() => ("model.targets", t.clone()),
        (None, None) if outputs.len() == 1 => ("model.target", outputs),
        _ => {
            faults.push(
                "model.target",
                "nothing",
                format!("one of {} (or targets = [..])", outputs.join(", ")),
            );
            return None;
        }
    };
    let mut fine = true;
    for (k, name) in names.iter().enumerate() {
        if !all.contains(name) {
            faults.unknown(key, name, &all);
            fine = false;
        }
        if names[..k].contains(name) {
            faults.push(key, format!("`{name}` twice"), "each target once");
            fine = false;
        }
    }
    fine.then_some(names)
}

/// Inputs of one target: those of the spec without itself, and every other channel that its regressors name.
fn inputs(m: &TypedModel, channels: &[ChannelSpec], target: &str, keys: &toml::Table) -> Vec<String> {
    let of_role = || channels.iter().filter(|c| c.role == Role::Input).map(|c| c.name.clone()).collect();
    let mut inputs: Vec<String> = m.inputs.clone().unwrap_or_else(of_role);
    inputs.retain(|n| n != target && channels.iter().any(|c| c.name == *n));
    for text in texts(keys) {
        for c in channels.iter().filter(|c| c.name != target && !inputs.contains(&c.name)).collect::<Vec<_>>()
        {
            if words(text).any(|w| w == c.name) {
                inputs.push(c.name.clone());
            }
        }
    }
    inputs
}

/// Regressors that the keys of a structure list as text.
fn texts(keys: &toml::Table) -> impl Iterator<Item = &str> {
    keys.get("regressors")
        .and_then(toml::Value::as_array)
        .into_iter()
        .flatten()
        .filter_map(toml::Value::as_str)
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !(c.is_alphanumeric() || c == '_')).filter(|w| !w.is_empty())
}

/// `y` stands for the target where no channel has that name: one list of regressors then serves several targets.
fn localise(keys: &mut toml::Table, target: &str, channels: &[String]) {
    if channels.iter().any(|c| c == "y") {
        return;
    }
    let Some(toml::Value::Array(list)) = keys.get_mut("regressors") else { return };
    for item in list {
        let toml::Value::String(text) = item else { continue };
        let mut out = String::with_capacity(text.len());
        let mut word = String::new();
        for c in text.chars().chain([' ']) {
            if c.is_alphanumeric() || c == '_' {
                word.push(c);
                continue;
            }
            out.push_str(if word == "y" && c == '(' { target } else { &word });
            word.clear();
            out.push(c);
        }
        *text = out.trim_end().to_string();
    }
}

/// The structure over these channels.
fn built_over(
    key: &str,
    s: &StructureSpec,
    inputs: &[String],
    target: &str,
    faults: &mut Faults,
) -> Option<Arc<dyn Form>> {
    let built = built_with(key, "name", &s.keys, |keys| kinds::kind(&s.name, keys), faults)?;
    let form = built.form(inputs, target, &[]);
    form.map_err(|e| faults.push(key, e, "a structure over the inputs and the target")).ok()
}

/// The pool over these channels, in place of a structure.
fn selected_from(
    key: &str,
    s: &StructureSpec,
    inputs: &[String],
    target: &str,
    pool: &PoolKeys,
    faults: &mut Faults,
) {
    if let Err(e) = pool.pool(inputs, target) {
        faults.push("model.select.pool", e, "a pool over the inputs and the target");
    }
    if s.name != POOL {
        faults.push(key, "a pool in model.select as well", "either a pool or a structure that is the pool");
    }
}

/// Which estimators fit which kinds of models stands in their rows.
fn agree(s: &StructureSpec, estimator: &str, faults: &mut Faults) {
    let (Ok(kind), Ok(row)) = (kinds::row(&s.name), estimate::row(estimator)) else { return };
    if row.fits.covers(kind.form) {
        return;
    }
    let others = estimate::ESTIMATORS.iter().filter(|r| r.fits.covers(kind.form)).map(|r| r.doc.name);
    let kinds = row.fits.kinds().map(|k| k.doc.name);
    let expected = format!(
        "for the structure `{}` one of the estimators {}; `{estimator}` fits {}",
        s.name,
        others.collect::<Vec<_>>().join(", "),
        kinds.collect::<Vec<_>>().join(", ")
    );
    faults.push("model.estimator.name", format!("`{estimator}`"), expected);
}

fn estimator(m: &TypedModel, seed: Option<u64>, faults: &mut Faults) -> Option<(String, toml::Table)> {
    let (name, mut keys) = member("model.estimator", &m.estimator, faults)?;
    // Keys of the estimator that may stand beside it.
    let beside =
        [("initial", &m.initial), ("cost", &m.cost), ("search", &m.search), ("covariance", &m.covariance)];
    for (key, value) in beside {
        if let Some(value) = value
            && keys.insert(key.into(), value.clone()).is_some()
        {
            faults.push(&format!("model.{key}"), "the same key in model.estimator", "it in one place");
        }
    }
    let row = built("model.estimator", "name", estimate::row(&name), faults)?;
    if let (Some(seed), true) = (seed, row.doc.params.iter().any(|p| p.name == "seed")) {
        keys.insert("seed".into(), toml::Value::Integer(i64::try_from(seed).unwrap_or(i64::MAX)));
    }
    built_with("model.estimator", "name", &keys, row.build, faults)?;
    Some((name, keys))
}

fn selecting(table: &toml::Table, faults: &mut Faults) -> Option<Selecting> {
    let key = "model.select";
    let mut keys = table.clone();
    let max_samples = match keys.remove("max_samples") {
        None => Some(MAX_SAMPLES),
        Some(v) => v.as_integer().and_then(|n| usize::try_from(n).ok()).filter(|n| *n > 0),
    };
    if max_samples.is_none() {
        faults.push("model.select.max_samples", "another value", "a whole number, 1 or more");
    }
    let pool = match keys.remove("pool") {
        None => Some(None),
        Some(v) => match PoolKeys::deserialize(v) {
            Ok(pool) => Some(Some(pool)),
            Err(e) => {
                faults.push("model.select.pool", e.message(), "{ ny, nu, nk, degree, cross, constant }");
                None
            }
        },
    };
    let (method, keys) = member_of(key, "name", &keys, "see `dynocal list selections`", faults)?;
    built_with(key, "name", &keys, |keys| select::selection(&method, keys), faults)?;
    Some(Selecting { method, keys, pool: pool?, max_samples: max_samples? })
}

/// Samples that a selection looks at where the spec does not say: more change no choice, but take their time.
const MAX_SAMPLES: usize = 50_000;
