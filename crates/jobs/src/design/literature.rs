//! Models of the literature as models of a design.

use std::sync::Arc;

use dynocal_ident::model::literature::{self, LiteratureModel};
use dynocal_numerics::registry::BuildError;

use super::error::DesignJobError;
use super::loaded::{Loaded, over_channels, same_time};

/// A model of the literature: name, unit of its output, parameters.
type Known = (&'static str, &'static str, fn() -> LiteratureModel);

/// Models of the literature that have parameters.
pub(super) static LITERATURE: &[Known] = &[
    ("torque_4_17", "Nm", literature::torque_4_17),
    ("lambda_4_53", "-", literature::lambda_4_53),
    ("torque_5_3", "Nm", literature::torque_5_3),
    ("torque_7_8", "Nm", literature::torque_7_8),
    ("lambda_7_8", "-", literature::lambda_7_8),
];

/// The model `name` over all channels of the plan.
pub(super) fn loaded(name: &str, channels: &[String], dt_s: f64) -> Result<Loaded, DesignJobError> {
    let known = LITERATURE.iter().find(|l| l.0 == name);
    let Some((_, unit, make)) = known else {
        let known = LITERATURE.iter().map(|l| l.0.to_string()).collect();
        return Err(
            BuildError::UnknownMember { family: "model", found: name.into(), known, nearest: None }.into()
        );
    };
    let found = make();
    same_time(name, dt_s, found.sample_time_s)?;
    let model = over_channels(&found.model, found.model.inputs(), found.model.output(), channels)?;
    // A model that is printed without a noise level has none to design for.
    let noise = if found.noise_variance > 0.0 { found.noise_variance } else { f64::NAN };
    Ok(Loaded::bare(found.model.output(), unit, Arc::new(model), found.theta, noise, found.source.into()))
}
