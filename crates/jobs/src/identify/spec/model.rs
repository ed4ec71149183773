//! What is identified and how: table `model`.

use dynocal_files::dataset::ChannelSpec;
use dynocal_files::spec::Faults;
use dynocal_ident::data::Role;
use dynocal_ident::estimate::{self, narmax, pem};
use dynocal_ident::model::{linear, structures};
use dynocal_ident::select::{self, pool::PoolKeys};
use serde::{Deserialize, Serialize};

use super::member::{built, member, member_of};
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
    /// Samples of a first, cheap estimate that the full one starts from; 0 for none.
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
    /// Which table it stands in.
    pub family: Family,
}

impl Target {
    /// A linear ARX by least squares over the same channels instead: what every other model has to beat.
    pub fn linear(&mut self, na: usize, nb: usize, nk: usize) {
        let number = |n: usize| toml::Value::Integer(i64::try_from(n).unwrap_or(i64::MAX));
        let keys = [("na", na), ("nb", nb), ("nk", nk)].map(|(k, n)| (k.to_string(), number(n)));
        let keys = keys.into_iter().collect();
        self.structure = StructureSpec { name: "arx".into(), keys, family: Family::Narx };
        self.select = None;
        self.warm_start_samples = 0;
        (self.estimator, self.estimator_keys) = ("ols".into(), toml::Table::new());
    }
}

/// Kinds of structures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Family {
    /// NARX: polynomial or neural.
    Narx,
    /// Linear with a noise model, estimated by prediction errors.
    Linear,
    /// Polynomial with innovations, estimated by extended least squares.
    Narmax,
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

/// Name of the prediction-error estimator of linear models with noise models.
pub const PEM: &str = pem::PEM.name;

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
    let estimator = estimator(m, seed, faults);
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
        let family = family(&structure, estimator);
        let inputs = inputs(m, channels, name, &keys);
        let spec = StructureSpec { name: structure, keys, family };
        let Some(()) = fits(&key, &spec, &inputs, name, pool.as_ref(), faults) else { continue };
        agree(&spec, estimator, faults);
        if m.select.is_some() && family != Family::Narx {
            let expected = "no selection: terms are selected from NARX structures";
            faults.push("model.select", format!("the structure `{}`", spec.name), expected);
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

/// `arx` stands in both tables: the estimator decides.
fn family(structure: &str, estimator: &str) -> Family {
    if structure == narmax::STRUCTURE.name {
        return Family::Narmax;
    }
    let in_linear = linear::structures::LINEAR_STRUCTURES.iter().any(|m| m.doc.name == structure);
    let in_narx = structures::MODEL_STRUCTURES.iter().any(|m| m.doc.name == structure);
    if in_linear && (estimator == PEM || !in_narx) { Family::Linear } else { Family::Narx }
}

/// Whether the structure can be built over these channels.
fn fits(
    key: &str,
    s: &StructureSpec,
    inputs: &[String],
    target: &str,
    pool: Option<&PoolKeys>,
    faults: &mut Faults,
) -> Option<()> {
    if let Some(pool) = pool {
        let expected = "a pool over the inputs and the target";
        pool.pool(inputs, target).map_err(|e| faults.push("model.select.pool", e, expected)).ok()?;
        if s.name == POOL {
            return Some(());
        }
        let expected = "either a pool or a structure that is the pool";
        faults.push(key, "a pool in model.select as well", expected);
        return None;
    }
    let result = match s.family {
        Family::Linear => {
            let built = built(key, "name", linear::structures::linear_structure(&s.name, &s.keys), faults)?;
            built.model(inputs, target).map(|_| ())
        }
        Family::Narmax => {
            return built(key, "name", crate::identify::fit::narmax(&s.keys, inputs, target), faults)
                .map(|_| ());
        }
        Family::Narx => {
            let known = structures::MODEL_STRUCTURES.iter().any(|m| m.doc.name == s.name);
            if !known {
                let names = structures::MODEL_STRUCTURES.iter().map(|m| m.doc.name);
                let linear = linear::structures::LINEAR_STRUCTURES.iter().map(|m| m.doc.name);
                let linear = linear.chain([narmax::STRUCTURE.name]);
                let mut all: Vec<String> = names.map(str::to_string).collect();
                for name in linear.map(str::to_string) {
                    if !all.contains(&name) {
                        all.push(name);
                    }
                }
                faults.unknown(&format!("{key}.name"), &s.name, &all);
                return None;
            }
            built(key, "name", structures::structure(&s.name, &s.keys), faults)?
                .model(inputs, target)
                .map(|_| ())
        }
    };
    result.map_err(|e| faults.push(key, e, "a structure over the inputs and the target")).ok()
}

/// A structure with a noise model needs the estimator that knows noise models, and the other way round.
fn agree(s: &StructureSpec, estimator: &str, faults: &mut Faults) {
    match s.family {
        Family::Linear if estimator != PEM => {
            let expected = format!("`{PEM}` for the structure `{}`, which has a noise model", s.name);
            faults.push("model.estimator.name", format!("`{estimator}`"), expected);
        }
        Family::Narmax if estimator != narmax::ELS.name => {
            let expected = "`els` for the structure `narmax`, which has innovations";
            faults.push("model.estimator.name", format!("`{estimator}`"), expected);
        }
        Family::Narx | Family::Linear if estimator == narmax::ELS.name => {
            let expected = "`narmax` for the estimator `els`";
            faults.push("model.structure.name", format!("`{}`", s.name), expected);
        }
        Family::Narx if estimator == PEM => {
            let linear: Vec<&str> =
                linear::structures::LINEAR_STRUCTURES.iter().map(|m| m.doc.name).collect();
            let expected = format!("one of {} for the estimator `{PEM}`", linear.join(", "));
            faults.push("model.structure.name", format!("`{}`", s.name), expected);
        }
        _ => {}
    }
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
    if name == narmax::ELS.name {
        built("model.estimator", "name", crate::identify::fit::els(&keys), faults)?;
        return Some((name, keys));
    }
    if name == PEM {
        built("model.estimator", "name", crate::identify::fit::pem(&keys), faults)?;
        return Some((name, keys));
    }
    let doc = estimate::docs().into_iter().find(|d| d.name == name);
    if let (Some(seed), true) = (seed, doc.is_some_and(|d| d.params.iter().any(|p| p.name == "seed"))) {
        keys.insert("seed".into(), toml::Value::Integer(i64::try_from(seed).unwrap_or(i64::MAX)));
    }
    if doc.is_none() {
        let known = estimate::docs()
            .into_iter()
            .map(|d| d.name.to_string())
            .chain([PEM.to_string(), narmax::ELS.name.into()]);
        faults.unknown("model.estimator.name", &name, &known.collect::<Vec<_>>());
        return None;
    }
    built("model.estimator", "name", estimate::estimator(&name, &keys), faults)?;
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
    built(key, "name", select::selection(&method, &keys), faults)?;
    Some(Selecting { method, keys, pool: pool?, max_samples: max_samples? })
}

/// Samples that a selection looks at where the spec does not say: more change no choice, but take their time.
const MAX_SAMPLES: usize = 50_000;
