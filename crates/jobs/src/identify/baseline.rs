//! A linear model with the same memory, from the same records: what every other one has to beat.

use dynocal_ident::data::DataError;
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::missing::bridged;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::fitted::Fitted;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Kind, Model};
use dynocal_ident::prepare::Note;
use dynocal_ident::validate::{Reference, Seen, score_values};

use super::curves::curves;
use super::error::IdentifyError;
use super::load::Part;
use super::prepare::restored;
use super::result::Baseline;
use super::set::shape;
use super::spec::Target;

/// Longest memory of the linear model, in samples.
const OUTPUT_LAGS: usize = 4;
const INPUT_LAGS: usize = 10;
/// Most entries of its regressors.
const ENTRIES: usize = 20_000_000;

/// A linear ARX model by least squares from the first part, scored in free run on the last unseen one. None where the model
/// is itself one, the records are too short or too long for it, or it cannot be estimated.
///
/// # Errors
/// [`IdentifyError`]: a channel is not there, or a trend cannot be added back.
pub fn baseline(
    t: &Target,
    model: &dyn Model,
    parts: &[Part],
    notes: &dyn Fn(&str) -> Vec<Note>,
) -> Result<Option<Baseline>, IdentifyError> {
    let Some(part) = parts.iter().rev().find(|p| p.seen == Seen::Unseen) else { return Ok(None) };
    if t.inputs.is_empty() || (t.structure.name == "arx" && t.estimator == "ols") {
        return Ok(None);
    }
    if model.max_lag() == 0 {
        return plane(t, parts, part);
    }
    let lags = || model.window().iter().map(|w| w.1);
    let nk = lags().min().unwrap_or(1);
    let nb = (lags().max().unwrap_or(1) + 1).saturating_sub(nk).clamp(1, INPUT_LAGS);
    let na = model.output_lag().clamp(1, OUTPUT_LAGS);
    let Ok(linear) = PolyNarx::arx(&t.inputs, &t.target, na, nb, nk, true) else { return Ok(None) };
    let whole = |p: &Part| -> Result<Vec<Experiment>, DataError> {
        p.records.iter().map(|d| Ok(bridged(&shape(d, &t.inputs, &t.target)?).0)).collect()
    };
    let data = whole(&parts[0])?;
    let samples: usize = data.iter().map(Experiment::len).sum();
    let fits = samples > 2 * linear.n_params() && samples.saturating_mul(linear.n_params()) < ENTRIES;
    if !fits {
        return Ok(None);
    }
    let Ok(fit) = Ols::default().estimate(&linear, &data, None, &|| false) else { return Ok(None) };
    let structure = format!("linear ARX by least squares (na = {na}, nb = {nb}, nk = {nk}, constant)");
    let d = &parts[0].records[0];
    let found = curves(&linear, &fit.theta, None, &t.inputs, &data, d.sample_time_s);
    let notes_of_first = notes(&parts[0].name);
    let own = |values: &mut [f64]| restored(&notes_of_first, d, &t.target, values);
    // Without covariances there is no band, whatever its level.
    let curves = found.into_iter().map(|c| c.restored(0.95, own)).collect::<Result<_, _>>()?;
    let baseline = scored(t, linear, fit.theta, structure, part, &notes(&part.name))?;
    Ok(baseline.map(|b| Baseline { curves, ..b }))
}

/// The same for models of present values: a plane.
fn plane(t: &Target, parts: &[Part], part: &Part) -> Result<Option<Baseline>, IdentifyError> {
    let present = t.inputs.iter().map(|name| format!("{name}(t)"));
    let terms: Vec<String> = ["1".to_string()].into_iter().chain(present).collect();
    let terms: Vec<&str> = terms.iter().map(String::as_str).collect();
    let inputs: Vec<&str> = t.inputs.iter().map(String::as_str).collect();
    let linear = PolyNarx::parse(&inputs, &t.target, &terms)?;
    let data: Vec<Experiment> =
        parts[0].records.iter().map(|d| shape(d, &t.inputs, &t.target)).collect::<Result<_, DataError>>()?;
    let Ok(fit) = Ols::default().estimate(&linear, &data, None, &|| false) else { return Ok(None) };
    scored(t, linear, fit.theta, "plane (linear in every input)".into(), part, &[])
}

/// The linear model on the records of a part.
fn scored(
    t: &Target,
    linear: PolyNarx,
    theta: Vec<f64>,
    structure: String,
    part: &Part,
    notes: &[Note],
) -> Result<Option<Baseline>, IdentifyError> {
    let fitted = Fitted::new(linear, theta)?;
    let (mut z, mut zhat) = (Vec::new(), Vec::new());
    for d in &part.records {
        let e = bridged(&shape(d, &t.inputs, &t.target)?).0;
        let first = fitted.first(&e).min(e.len());
        let Some(mut y) = fitted.output(&e, Kind::FreeRun) else { return Ok(None) };
        let mut measured = d.values(&t.target)?.to_vec();
        restored(notes, d, &t.target, &mut y)?;
        restored(notes, d, &t.target, &mut measured)?;
        z.extend_from_slice(&measured[first..]);
        zhat.extend_from_slice(&y[first..]);
    }
    let s = score_values(&z, &zhat, Kind::FreeRun, part.seen, Reference::Noisy);
    let finite = |v: f64| v.is_finite().then_some(v);
    Ok(Some(Baseline {
        structure,
        part: part.name.clone(),
        rmse: finite(s.rmse),
        r2_percent: finite(100.0 * s.r2),
        curves: Vec::new(),
    }))
}
