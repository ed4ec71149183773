//! Identification inside a loop: parameters, what earlier records tell, errors on unseen records.

use dynocal_ident::estimate::{Estimator, Fit, ols::Ols, sem::Sem};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::validate::{Kind, output};
use dynocal_numerics::linalg::QrWork;
use dynocal_numerics::status::Status;

use super::LoopError;

/// Ridge that gives the model of least norm where the records do not determine all parameters.
const LEAST_NORM_RIDGE: f64 = 1e-10;

/// Parameters of `model` from all `records` together: by least squares without output terms, else by the simulation
/// error, which is the estimate that output sensitivities speak of.
///
/// Where the records do not determine all parameters ([`Fit::rank`] below their number), the parameters are those of
/// least norm in units of the regressors' rms.
///
/// # Errors
/// [`LoopError::Estimate`] for records that do not fit the model.
pub fn identify(model: &dyn Model, records: &[Experiment]) -> Result<Fit, LoopError> {
    if model.output_lag() > 0 {
        let fit = Sem { cost_tolerance: 1e-9, ..Sem::default() }.estimate(model, records, None, &|| false)?;
        return Ok(fit);
    }
    let fit = Ols::default().estimate(model, records, None, &|| false)?;
    if fit.rank == model.n_params() {
        return Ok(fit);
    }
    let rank = fit.rank;
    let fit = Ols { ridge: LEAST_NORM_RIDGE, ..Ols::default() }.estimate(model, records, None, &|| false)?;
    Ok(Fit { rank, ..fit })
}

/// Triangular factor (p x p) of the output sensitivities of all `records`: what they tell about the parameters, as
/// [`dynocal_design::problem::Term::prior`] takes it.
///
/// # Errors
/// [`LoopError::Model`] when the model diverges over a record.
pub fn information(model: &dyn Model, theta: &[f64], records: &[Experiment]) -> Result<Vec<f64>, LoopError> {
    let p = model.n_params();
    let mut rows = Vec::new();
    for e in records {
        rows.extend(sensitivities(model, theta, e)?);
    }
    rows.resize(rows.len().max(p * p), 0.0);
    let mut factor = vec![0.0; p * p];
    let fault = |e: dynocal_numerics::linalg::LinalgError| LoopError::Model {
        what: "information of the records".into(),
        reason: e.to_string(),
    };
    QrWork::new(rows.len() / p, p).r_factor(&rows, &mut factor).map_err(fault)?;
    Ok(factor)
}

/// Output sensitivities (scored rows x p) of a record in free run.
///
/// # Errors
/// [`LoopError::Model`] when the model diverges.
pub fn sensitivities(model: &dyn Model, theta: &[f64], e: &Experiment) -> Result<Vec<f64>, LoopError> {
    let p = model.n_params();
    let run = e.run(model);
    let (mut y, mut s) = (vec![0.0; e.len()], vec![0.0; e.len() * p]);
    match model.sensitivities(theta, &run, &mut y, &mut s) {
        Status::Converged => Ok(s.split_off(run.start * p)),
        _ => Err(LoopError::Model { what: e.name.clone(), reason: "the free run is not finite".into() }),
    }
}

/// Free-run errors (measured minus simulated) of the scored samples of all `records`.
pub fn errors(model: &dyn Model, theta: &[f64], records: &[Experiment]) -> Vec<f64> {
    let one = |e: &Experiment| {
        let first = e.first(model);
        let y = output(model, theta, e, Kind::FreeRun);
        e.y[first..].iter().zip(&y[first..]).map(|(z, y)| z - y).collect::<Vec<_>>()
    };
    records.iter().flat_map(one).collect()
}

/// Mean squared free-run error over all `records`.
pub fn mean_square(model: &dyn Model, theta: &[f64], records: &[Experiment]) -> f64 {
    let e = errors(model, theta, records);
    e.iter().map(|v| v * v).sum::<f64>() / e.len() as f64
}

/// Lack of fit of the model `kept` beside `full`, which has further terms: how much larger its mean squared error is, in
/// units of the variance of `full`, without what further parameters explain by chance.
///
/// # Errors
/// [`LoopError::Estimate`] for records that do not fit the models.
pub fn lack_of_fit(kept: &dyn Model, full: &dyn Model, records: &[Experiment]) -> Result<f64, LoopError> {
    let (small, large) = (identify(kept, records)?, identify(full, records)?);
    let chance = (full.n_params() as f64 - kept.n_params() as f64) / large.samples as f64;
    Ok(((small.mse - large.mse) / large.noise_variance - chance).max(0.0))
}
