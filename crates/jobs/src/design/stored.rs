//! Model files as models of a design: over the channels of the plan, in the user's units, with the information that their
//! noise model leaves.

use std::path::Path;
use std::sync::Arc;

use dynocal_design::noise_model::{LinearInformation, NarmaxInformation};
use dynocal_files::{json, units};

use dynocal_ident::model::Model;
use dynocal_ident::model::form::Driven;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::narmax::Narmax;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Pointwise, StoredError, StoredModel};
use dynocal_ident::validate::boundary::BoundaryModel;

use super::Job;
use super::error::DesignJobError;
use super::loaded::{Loaded, over_channels, same_time};

/// A model with the sensitivities of its prediction errors, and what else its noise model says.
struct Informed {
    model: Arc<dyn Model>,
    theta: Vec<f64>,
    /// With the sensitivities of the free run, where they are others.
    predictor: Option<Arc<dyn Model>>,
    linear: Option<LinearInformation>,
    note: Option<String>,
}

/// The model of a file, and the noise model of a linear one, which tells about the parameters of A by itself.
pub(super) fn of_file(
    path: &Path,
    job: &Job,
    channels: &[String],
) -> Result<(Loaded, Option<LinearInformation>), DesignJobError> {
    let file: StoredModel = json::read_versioned(path, MODEL_SCHEMA, MODEL_VERSION)?;
    let shown = path.display().to_string();
    let fault = |source: StoredError| DesignJobError::Stored { file: shown.clone(), source };
    file.check().map_err(fault)?;
    if file.is_steady() {
        return Err(DesignJobError::Steady { model: shown });
    }
    same_time(&shown, job.sample_time_s, file.sample_time_s)?;
    same_units(&shown, job, &file)?;
    let way = file.pointwise().map_err(fault)?;
    let own: Vec<String> = file.inputs.iter().map(|q| q.name.clone()).collect();
    let polynomial = file.structure.form().polynomial().is_some();
    let plain = way.changed().is_empty();
    let mut informed = informed(&file, &shown)?;
    if plain && polynomial {
        // The same regressors over all channels: nothing stands between.
        informed.model = Arc::new(over_channels(informed.model.as_ref(), &own, &file.output.name, channels)?);
    } else if !plain || own != channels {
        let theta = informed.theta.clone();
        let measured = |model: Arc<dyn Model>| {
            let inner = Driven { model, theta: theta.clone() };
            file.over_with(channels, inner).map(|m| Arc::new(m) as Arc<dyn Model>).map_err(fault)
        };
        informed.model = measured(informed.model)?;
        informed.predictor = informed.predictor.map(measured).transpose()?;
    }
    // Prediction errors are of one variance in the user's output only where it is a straight line over the model's.
    let noise = match way.output_is_affine() {
        true => file.noise_variance.map_or(f64::NAN, |v| v * way.output.scale.powi(2)),
        false => f64::NAN,
    };
    let output = file.user_output();
    let mut out =
        Loaded::bare(&output.name, &output.unit, informed.model, informed.theta, noise, shown.clone());
    out.predictor = informed.predictor;
    out.note = informed.note;
    out.boundary = file.boundary.as_ref().and_then(|b| in_units(b, &file, &way, channels));
    // In another scale than that of its errors, the noise model says nothing that could be added.
    Ok((out, informed.linear.filter(|_| way.output_is_affine())))
}

/// The model over its own inputs, in prepared units.
fn informed(file: &StoredModel, shown: &str) -> Result<Informed, DesignJobError> {
    let structure = |source| DesignJobError::Structure { file: shown.into(), source };
    let stored = |source| DesignJobError::Stored { file: shown.into(), source };
    let form = file.structure.form();
    let driven = match file.driven() {
        Ok(driven) => driven,
        Err(StoredError::NotDriven { .. }) => {
            return Err(DesignJobError::NotDriven { model: shown.into(), kind: "time series".into() });
        }
        Err(e) => return Err(stored(e)),
    };
    let free_run = |note| Informed {
        model: driven.model.clone(),
        theta: driven.theta.clone(),
        predictor: None,
        linear: None,
        note,
    };
    if let Some(m) = form.is_a::<LinearModel>() {
        let (information, theta) = LinearInformation::new(m, &file.theta()).map_err(structure)?;
        let predictor: Option<Arc<dyn Model>> = Some(Arc::new(information.prediction()));
        let model = Arc::new(information.clone());
        return Ok(Informed { model, theta, predictor, linear: Some(information), note: None });
    }
    if let Some(m) = form.is_a::<Narmax>() {
        return Ok(match NarmaxInformation::new(m, &file.theta()) {
            Ok((information, theta)) => Informed {
                model: Arc::new(information),
                theta,
                predictor: Some(driven.model.clone()),
                linear: None,
                note: None,
            },
            Err(why) => free_run(Some(format!(
                "the information about `{}` is that of its free run under white noise, without its noise model: {why}",
                file.output.name
            ))),
        });
    }
    Ok(free_run(None))
}

/// What was identified, in the user's units over the channels of the plan; none where a channel is no straight line over a
/// measured one.
fn in_units(
    boundary: &BoundaryModel,
    file: &StoredModel,
    way: &Pointwise,
    channels: &[String],
) -> Option<BoundaryModel> {
    let mut inputs = Vec::new();
    let mut lines = Vec::new();
    for &(i, lag) in &boundary.space.inputs {
        let (name, affine) = way.inputs.get(i)?;
        let measured = file.derived.iter().all(|d| d.name != *name);
        let place = channels.iter().position(|c| c == name).filter(|_| measured)?;
        inputs.push((place, lag));
        lines.push((affine.offset, affine.scale));
    }
    if file.output_transform().is_some() {
        return None;
    }
    lines.extend(boundary.space.outputs.iter().map(|_| (way.output.offset, way.output.scale)));
    let mut out = boundary.stretched(&lines);
    out.space.inputs = inputs;
    Some(out)
}

/// Refuses a plan whose channels are not in the units of the model, as far as it knows them.
fn same_units(model: &str, job: &Job, file: &StoredModel) -> Result<(), DesignJobError> {
    let known =
        |name: &str| file.inputs.iter().any(|q| q.name == name) || file.seen.iter().any(|s| s.name == name);
    for q in file.measured_inputs().iter().filter(|q| known(&q.name)) {
        let Some(c) = job.channels.iter().find(|c| c.channel.name == q.name) else { continue };
        if units::normalise(&c.unit) != units::normalise(&q.unit) {
            return Err(DesignJobError::Unit {
                model: model.into(),
                channel: q.name.clone(),
                found: c.unit.clone(),
                expected: q.unit.clone(),
            });
        }
    }
    Ok(())
}
