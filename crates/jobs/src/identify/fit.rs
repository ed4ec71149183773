//! The estimate of one target: structure, selection of terms, start, estimator.

use dynocal_ident::estimate::{self, Fit, Gaps};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::fitted::Fitted;
use dynocal_ident::model::form::{AnyForm, Form};
use dynocal_ident::model::initial::Initial;
use dynocal_ident::model::kinds;
use dynocal_ident::select::pool::Pool;
use dynocal_ident::select::{self, Selection};
use dynocal_ident::stored::{Parameter, StoredModel};
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;

use super::error::IdentifyError;
use super::gaps::bridge;
use super::spec::{Selecting, Target};

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

impl Estimated {
    /// The same with free runs that start as `rule` says; none: as is usual for the kind of model.
    pub fn starting(mut self, rule: Option<Initial>) -> Self {
        if let Some(rule) = rule {
            self.model = self.model.starting(rule);
        }
        self
    }
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
    let (form, selection) = structure(t, data, watch)?;
    let samples = data.iter().map(Experiment::len).sum::<usize>();
    watch.note(&match form.form().parameters() {
        0 => format!("{}: {} from {samples} samples by {}", t.target, t.structure.name, t.estimator),
        p => format!(
            "{}: estimating {p} parameters by {} from {} records, {samples} samples",
            t.target,
            t.estimator,
            data.len(),
        ),
    });
    let (whole, remarks) = match estimate::row(&t.estimator)?.gaps {
        Gaps::Estimated => (data.to_vec(), Vec::new()),
        Gaps::Bridged { free_run } => {
            let whole = bridge(t, form.form(), data, free_run);
            (whole.data, whole.remarks)
        }
    };
    let mut fit = fit(t, form.form(), &whole, selecting, watch)?;
    fit.warnings.extend(remarks);
    if fit.status == Status::Stalled && fit.mse <= ROUNDING * mean_square(&whole) {
        // Nothing is better than the digits of the data: a tolerance below them is met by no search.
        fit.status = Status::Converged;
    }
    if fit.status == Status::Interrupted {
        return Err(IdentifyError::Interrupted);
    }
    // What an estimator learns into the structure takes its place.
    let form = fit.learnt.as_ref().map_or(form, |l| l.form.clone());
    let model = Fitted::new(form, fit.theta.clone())?;
    let parameters = parameters(&fit);
    Ok(Estimated { model, fit: Some(fit), parameters, selection })
}

/// Mean squared error over mean squared output of a fit that is exact but for the digits of a file (six are usual).
const ROUNDING: f64 = 1e-12;

/// Mean square of all outputs.
fn mean_square(data: &[Experiment]) -> f64 {
    let values = || data.iter().flat_map(|e| &e.y).filter(|v| v.is_finite());
    values().map(|v| v * v).sum::<f64>() / values().count().max(1) as f64
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
pub fn saved(file: &StoredModel) -> Result<Estimated, IdentifyError> {
    let model = file.fitted()?;
    Ok(Estimated { model, fit: None, parameters: file.parameters.clone(), selection: None })
}

/// The structure of the spec over the data, or the terms selected from it.
fn structure(
    t: &Target,
    data: &[Experiment],
    watch: Watch,
) -> Result<(AnyForm, Option<Selection>), IdentifyError> {
    if let Some(select) = &t.select
        && let Some(pool) = &select.pool
    {
        return selected(&pool.pool(&t.inputs, &t.target)?, select, data, watch);
    }
    let built = kinds::kind(&t.structure.name, &t.structure.keys)?;
    let form = AnyForm(built.form(&t.inputs, &t.target, data)?);
    match (&t.select, form.form().polynomial()) {
        (Some(select), Some(pool)) => selected(&Pool::from(pool), select, data, watch),
        _ => Ok((form, None)),
    }
}

fn selected(
    pool: &Pool,
    select: &Selecting,
    data: &[Experiment],
    watch: Watch,
) -> Result<(AnyForm, Option<Selection>), IdentifyError> {
    watch.note(&format!("selecting terms from a pool of {}", pool.candidates().len()));
    let method = select::selection(&select.method, &select.keys)?;
    let found = method.select(pool, &share(data, select.max_samples, pool.max_lag()), watch.interrupt)?;
    watch.note(&format!("selected {}", found.model.regressor_texts().join(", ")));
    Ok((found.model.clone().into(), Some(found)))
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

fn fit(
    t: &Target,
    model: &dyn Form,
    data: &[Experiment],
    selecting: &[Experiment],
    watch: Watch,
) -> Result<Fit, IdentifyError> {
    let estimator = estimate::estimator(&t.estimator, &t.estimator_keys)?;
    let rows: usize = data.iter().map(Experiment::len).sum();
    let mut start = None;
    if t.warm_start_samples > 0 && t.warm_start_samples < rows {
        let part = share(data, t.warm_start_samples, model.memory());
        let samples: usize = part.iter().map(Experiment::len).sum();
        watch.note(&format!("first estimate from {samples} samples"));
        let first = estimator.estimate_selecting(model, &part, selecting, None, watch.interrupt)?;
        start = (first.status != Status::Interrupted).then_some(first.theta);
    }
    Ok(estimator.estimate_selecting(model, data, selecting, start.as_deref(), watch.interrupt)?)
}
