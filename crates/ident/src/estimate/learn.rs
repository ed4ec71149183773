//! Response models from their points: the learner of the structure does the work (likelihood, left-out errors).
//!
//! The result stands in [`Fit::learnt`]; theta is empty.

use dynocal_numerics::registry::{self, MemberDoc};
use dynocal_numerics::status::{Iterate, Status};
use serde::Deserialize;

use super::covariance::CovarianceKind;
use super::table::{EstimatorRow, Fits, Gaps};
use super::{EstimateError, Estimator, Fit, LearntForm, Minimised, Residuals, made_for};
use crate::experiment::Experiment;
use crate::model::form::Form;
use crate::model::response::form::ResponseForm;
use crate::model::response::score::errors;
use crate::model::response::{ResponseError, learner};

/// Row of the table.
pub(super) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
        name: "learn",
        what: "response models from their points; the keys stand in the structure",
        params: &[],
    },
    fits: Fits::Forms(&["response"]),
    gaps: Gaps::Bridged { free_run: false },
    build: |keys| Ok(Box::new(registry::keys::<LearnResponse>("learn", keys)?)),
};

/// The estimator; it has no keys of its own.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnResponse {}

impl Estimator for LearnResponse {
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        _start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let form: &ResponseForm = made_for("learn", model)?;
        let points = form.points(data).map_err(ResponseError::from)?;
        let kind = learner(&form.learner().name, &form.learner().keys)?;
        let found = kind.learn(&points, interrupt)?;
        let status = if interrupt() { Status::Interrupted } else { Status::Converged };
        let n = points.len().max(1) as f64;
        let sum: f64 = errors(&found.model, &points).0.iter().map(|e| e * e).sum();
        let left_out = found.left_out.rmse();
        let learnt = form.with(found.model)?.into();
        Ok(Fit {
            estimator: "learn".into(),
            minimised: Minimised::OneStep,
            theta: Vec::new(),
            names: Vec::new(),
            covariance: Vec::new(),
            covariance_kind: CovarianceKind::White,
            std_errors: Vec::new(),
            mse: sum / n,
            noise_variance: left_out * left_out,
            residuals: Residuals::default(),
            samples: points.len(),
            rank: 0,
            status,
            evaluations: 1,
            history: vec![Iterate { evaluations: 1, objective: sum, violation: 0.0, optimality: 0.0 }],
            warnings: Vec::new(),
            notes: found.notes,
            starts: Vec::new(),
            learnt: Some(LearntForm { form: learnt, left_out: found.left_out, choice: found.choice }),
        })
    }
}
