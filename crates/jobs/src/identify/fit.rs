//! The estimate of one target: structure, selection of terms, start, estimator.

use dynocal_ident::estimate::narmax::{Els, Narmax};
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::estimate::train::Train;
use dynocal_ident::estimate::{self, Fit};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::StructureError;
use dynocal_ident::model::{Model, linear, structures};
use dynocal_ident::select::pool::Pool;
use dynocal_ident::select::{self, Selection};
use dynocal_numerics::registry::{self, BuildError};
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use serde::Deserialize;

use super::gaps::bridge;
use super::job::IdentifyError;
use super::result::{ModelFile, Parameter};
use super::spec::{Family, Selecting, Target};
use super::stored::{Fitted, Stored};

/// An estimated model of one target.
#[derive(Clone, Debug)]
pub struct Estimated {
    /// The model.
    pub model: Fitted,
    /// What the estimator says; none for a model that was read from a file.
    pub fit: Option<Fit>,
    /// Parameters with standard errors.
    pub parameters: Vec<Parameter>,
    /// How the terms were selected; none where they were given.
    pub selection: Option<Selection>,
}

/// The prediction-error estimator from its keys.
///
/// # Errors
/// [`BuildError`].
pub fn pem(keys: &toml::Table) -> Result<Pem, BuildError> {
    registry::keys("pem", keys)
}

/// Extended least squares from its keys.
///
/// # Errors
/// [`BuildError`].
pub fn els(keys: &toml::Table) -> Result<Els, BuildError> {
    registry::keys("els", keys)
}

/// Keys of the structure with innovations.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NarmaxKeys {
    regressors: Vec<String>,
}

/// The structure with innovations from its keys.
///
/// # Errors
/// [`BuildError`]: keys, or regressors that do not fit the channels.
pub fn narmax(keys: &toml::Table, inputs: &[String], target: &str) -> Result<Narmax, BuildError> {
    let read: NarmaxKeys = registry::keys("narmax", keys)?;
    let refused = |e: StructureError| BuildError::Keys { member: "narmax".into(), message: e.to_string() };
    Narmax::parse(inputs, target, &read.regressors).map_err(refused)
}

/// Estimates one target from `data`; `selecting` are records that choose between candidates, where the spec has some.
///
/// # Errors
/// [`IdentifyError`].
pub fn estimate(
    t: &Target,
    data: &[Experiment],
    selecting: &[Experiment],
    watch: Watch,
) -> Result<Estimated, IdentifyError> {
    let (stored, selection) = structure(t, data, watch)?;
    watch.note(&format!(
        "{}: estimating {} parameters by {} from {} records, {} samples",
        t.target,
        stored.n_params(),
        t.estimator,
        data.len(),
        data.iter().map(Experiment::len).sum::<usize>()
    ));
    let fit = match &stored {
        Stored::Linear(m) => pem(&t.estimator_keys)?.estimate(m, data, None, watch.interrupt)?,
        Stored::Narmax(m) => {
            let whole = bridge(t, m.with_innovations(), data, false);
            let mut fit = els(&t.estimator_keys)?.estimate(m, &whole.data, watch.interrupt)?;
            fit.warnings.extend(whole.remarks);
            fit
        }
        other => {
            let Some(m) = other.narx() else { return Err(IdentifyError::Interrupted) };
            let whole = bridge(t, m, data, t.estimator != "ols");
            let mut fit = narx(t, m, &whole.data, selecting, watch)?;
            fit.warnings.extend(whole.remarks);
            fit
        }
    };
    if fit.status == Status::Interrupted {
        return Err(IdentifyError::Interrupted);
    }
    let model = Fitted::new(stored, fit.theta.clone()).map_err(estimate::EstimateError::from)?;
    let parameters = parameters(&fit);
    Ok(Estimated { model, fit: Some(fit), parameters, selection })
}

fn parameters(fit: &Fit) -> Vec<Parameter> {
    let known = |s: &f64| s.is_finite().then_some(*s);
    let all = fit.names.iter().zip(&fit.theta).zip(&fit.std_errors);
    all.map(|((n, v), s)| Parameter { name: n.clone(), value: *v, std_error: known(s) }).collect()
}

/// The model of a file, as if it had just been estimated.
///
/// # Errors
/// [`IdentifyError`]: parameters and structure do not belong together.
pub fn saved(file: &ModelFile) -> Result<Estimated, IdentifyError> {
    let model = file.fitted().map_err(estimate::EstimateError::from)?;
    Ok(Estimated { model, fit: None, parameters: file.parameters.clone(), selection: None })
}

/// The structure of the spec over the data, or the terms selected from it.
fn structure(
    t: &Target,
    data: &[Experiment],
    watch: Watch,
) -> Result<(Stored, Option<Selection>), IdentifyError> {
    if let Some(select) = &t.select
        && let Some(pool) = &select.pool
    {
        return selected(&pool.pool(&t.inputs, &t.target)?, select, data, watch);
    }
    let (name, keys) = (&t.structure.name, &t.structure.keys);
    let failed = estimate::EstimateError::from;
    if t.structure.family == Family::Linear {
        let model = linear::structures::linear_structure(name, keys)?.model(&t.inputs, &t.target);
        return Ok((Stored::Linear(model.map_err(failed)?), None));
    }
    if t.structure.family == Family::Narmax {
        return Ok((Stored::Narmax(narmax(keys, &t.inputs, &t.target)?), None));
    }
    let built = structures::structure(name, keys)?;
    if let Some(network) = built.network(&t.inputs, &t.target, data).map_err(failed)? {
        return Ok((Stored::Neural(network), None));
    }
    let Some(pool) = built.polynomial(&t.inputs, &t.target).map_err(failed)? else {
        let message = format!("the structure `{name}` has no form that a model file can hold");
        return Err(BuildError::Keys { member: name.clone(), message }.into());
    };
    match &t.select {
        None => Ok((Stored::Polynomial(pool), None)),
        Some(select) => selected(&Pool::from(&pool), select, data, watch),
    }
}

fn selected(
    pool: &Pool,
    select: &Selecting,
    data: &[Experiment],
    watch: Watch,
) -> Result<(Stored, Option<Selection>), IdentifyError> {
    watch.note(&format!("selecting terms from a pool of {}", pool.candidates().len()));
    let method = select::selection(&select.method, &select.keys)?;
    let found = method.select(pool, &share(data, select.max_samples, pool.max_lag()), watch.interrupt)?;
    watch.note(&format!("selected {}", found.model.regressor_texts().join(", ")));
    Ok((Stored::Polynomial(found.model.clone()), Some(found)))
}

/// The same share of the start of every record, so that all together hold about `samples` samples.
fn share(data: &[Experiment], samples: usize, lag: usize) -> Vec<Experiment> {
    let total: usize = data.iter().map(Experiment::len).sum();
    if samples >= total {
        return data.to_vec();
    }
    data.iter()
        .map(|e| {
            let first = e.init_samples.max(lag);
            let n = (e.len() * samples / total).clamp((first + 1).min(e.len()), e.len());
            let m = e.u.len() / e.len().max(1);
            let weights = e.weights.iter().take(n).copied().collect();
            Experiment { u: e.u[..n * m].to_vec(), y: e.y[..n].to_vec(), weights, ..e.clone() }
        })
        .collect()
}

fn narx(
    t: &Target,
    model: &dyn Model,
    data: &[Experiment],
    selecting: &[Experiment],
    watch: Watch,
) -> Result<Fit, IdentifyError> {
    // Early stopping watches the selection records of the spec instead of an end cut off the estimation records.
    if t.estimator == "train" && !selecting.is_empty() {
        let train: Train = registry::keys("train", &t.estimator_keys)?;
        return Ok(train.train(model, data, selecting, None, watch.interrupt)?.fit);
    }
    let estimator = estimate::estimator(&t.estimator, &t.estimator_keys)?;
    let rows: usize = data.iter().map(Experiment::len).sum();
    let mut start = None;
    if t.warm_start_samples > 0 && t.warm_start_samples < rows {
        let part = share(data, t.warm_start_samples, model.max_lag());
        let samples: usize = part.iter().map(Experiment::len).sum();
        watch.note(&format!("first estimate from {samples} samples"));
        let first = estimator.estimate(model, &part, None, watch.interrupt)?;
        start = (first.status != Status::Interrupted).then_some(first.theta);
    }
    Ok(estimator.estimate(model, data, start.as_deref(), watch.interrupt)?)
}
