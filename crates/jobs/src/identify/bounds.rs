//! Confidence bounds about a free run.

use dynocal_ident::estimate::Minimised;
use dynocal_ident::estimate::bands::band;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;

use super::fit::Estimated;
use super::spec::Job;

/// Most entries of the sensitivities of a record whose bounds are computed.
const ENTRIES: usize = 20_000_000;

/// Lower and upper bound of a measurement about the free run, at the confidence of the spec; none for linear models with
/// a noise model and for records too long for their sensitivities.
pub fn free_run_bounds(
    job: &Job,
    e: &Estimated,
    data: &[Experiment],
    r: &Experiment,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let (model, fit): (&dyn Model, _) = (e.model.form().dynamics()?, e.fit.as_ref()?);
    if r.len().saturating_mul(model.n_params()) > ENTRIES {
        return None;
    }
    Some(band(model, fit, data, r, Minimised::FreeRun).of_measurement(job.validate.confidence))
}
