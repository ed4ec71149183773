//! What is said of a response model of a steady table: each point from the others, folds, sections, effects.

use dynocal_ident::estimate::EstimateError;
use dynocal_ident::estimate::LearntForm;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::form::Form;
use dynocal_ident::model::response::choose::Choice;
use dynocal_ident::model::response::form::ResponseForm;
use dynocal_ident::model::response::score::{FoldKind, ScorePage, by_folds, score_learnt};
use dynocal_ident::model::response::{Points, ResponseError, learner};
use dynocal_ident::validate::Seen;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};

use super::error::IdentifyError;
use super::fit::Estimated;
use super::load::Part;
use super::set::shape;
use super::spec::{Job, Target};

/// The score page of one model, with the choice behind it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointsPage {
    /// Scores, residuals, sections, effects. Inputs and output are in the units of the table.
    pub scores: ScorePage,
    /// Candidates side by side, where there were several.
    pub choice: Option<Choice>,
    /// What an engineer should look at: points that do not fit the others, copies, inputs that follow from each other, folds that
    /// could not be learnt.
    #[serde(default)]
    pub warnings: Vec<String>,
}

impl PointsPage {
    /// Root mean square error of points that had no part in the fit, and how they were held out: by the folds of a choice, by folds,
    /// or one at a time with the structure kept.
    pub fn held_out(&self) -> (f64, &'static str) {
        match (&self.choice, &self.scores.folds) {
            (Some(c), _) => (c.nested_rmse, "in folds (the choice included)"),
            (None, Some(f)) => (f.rmse, "in folds"),
            (None, None) => (self.scores.left_out.rmse, "one at a time"),
        }
    }

    /// Root mean square error of each point predicted by the mean of the others.
    pub fn of_the_mean(&self) -> f64 {
        let y = &self.scores.measured;
        let n = y.len() as f64;
        let mean = y.iter().sum::<f64>() / n;
        let squares = y.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        (squares / n).sqrt() * n / (n - 1.0)
    }

    /// `1 - mean squared error held out / variance`, in percent.
    pub fn held_out_r2_percent(&self) -> f64 {
        let n = self.scores.measured.len() as f64;
        100.0 * (1.0 - (self.held_out().0 / self.of_the_mean() * n / (n - 1.0)).powi(2))
    }
}

/// The page of a model that has just been learnt; none for other structures and for models from a file.
///
/// # Errors
/// [`IdentifyError`]: a fold cannot be learnt.
pub fn points(
    job: &Job,
    t: &Target,
    e: &Estimated,
    parts: &[Part],
    watch: Watch,
) -> Result<Option<PointsPage>, IdentifyError> {
    let Some(learnt) = e.fit.as_ref().and_then(|f| f.learnt.as_ref()) else { return Ok(None) };
    let form: &dyn Form = learnt.form.form();
    let Some(form) = form.is_a::<ResponseForm>() else { return Ok(None) };
    let table = |part: &Part| -> Result<Points, IdentifyError> {
        let of = |d| shape(d, &t.inputs, &t.target);
        let records: Vec<Experiment> = part.records.iter().map(of).collect::<Result<_, _>>()?;
        Ok(form.points(&records).map_err(learning)?)
    };
    let own = table(&parts[0])?;
    let unseen = parts.iter().rev().find(|p| p.seen == Seen::Unseen).map(table).transpose()?;
    page(job, t, (form, learnt), &own, unseen.as_ref(), watch)
}

fn page(
    job: &Job,
    t: &Target,
    (form, learnt): (&ResponseForm, &LearntForm),
    own: &Points,
    unseen: Option<&Points>,
    watch: Watch,
) -> Result<Option<PointsPage>, IdentifyError> {
    let Some(model) = form.response() else { return Ok(None) };
    // A choice has been validated by outer folds of its own.
    let folds = if learnt.choice.is_none() && job.validate.folds > 1 {
        watch.note(&format!("{}: {} folds", t.target, job.validate.folds));
        let kind = learner(&form.learner().name, &form.learner().keys)?;
        let count = job.validate.folds;
        Some(by_folds(&*kind, own, count, FoldKind::Shuffled, watch.interrupt))
    } else {
        None
    };
    let mut warnings = own.warnings(&learnt.left_out);
    // What folds cannot tell is no reason to give no model.
    let folds = match folds {
        Some(Err(e)) => {
            warnings.push(format!("nothing is known of held-out points, as the folds cannot be learnt: {e}"));
            None
        }
        Some(Ok(folds)) => Some(folds),
        None => None,
    };
    let scores = score_learnt(model, &learnt.left_out, own, unseen, folds, Vec::new());
    Ok(Some(PointsPage { scores, choice: learnt.choice.clone(), warnings }))
}

fn learning(e: impl Into<ResponseError>) -> EstimateError {
    EstimateError::from(e.into())
}
