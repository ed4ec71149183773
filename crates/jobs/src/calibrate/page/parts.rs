//! Pieces that several sections use: records, panels, numbers.

use std::path::Path;

use crate::calibrate::context::{ChainError, RecordRef, load_records};
use dynocal_calib::engine_model::EngineModel;
use dynocal_ident::data::Dataset;
use dynocal_report::{Panel, Role, Series, TimePlot};

/// The record that `reference` names.
pub(super) fn record(folder: &Path, reference: &RecordRef, dt: f64) -> Result<Dataset, ChainError> {
    load_records(folder, std::slice::from_ref(reference), dt)?
        .pop()
        .ok_or_else(|| ChainError::Identify { what: reference.name.clone(), reason: "no such record".into() })
}

/// Models whose free runs are drawn over the measured outputs.
#[derive(Clone, Copy)]
pub(super) struct Simulated<'a> {
    pub(super) torque: &'a EngineModel,
    pub(super) lambda: &'a EngineModel,
}

/// A record: outputs with demand, measurement and free run, then the actuators and speed.
pub(super) fn plot(
    title: impl Into<String>,
    record: &Dataset,
    models: Option<Simulated>,
) -> Result<TimePlot, ChainError> {
    let mut plot = TimePlot::sampled(title, record.sample_time_s, record.len());
    for (name, label, unit) in [("torque", "Torque", "Nm"), ("lambda", "Lambda", "")] {
        let mut panel = Panel::new(label, unit);
        if let Ok(demand) = record.values(&format!("{name}_demand")) {
            panel = panel.series(Series::new("demand", demand.to_vec()).role(Role::Demand));
        }
        panel = panel.measured(record.values(name)?.to_vec());
        if let Some(m) = models {
            let model = if name == "torque" { m.torque } else { m.lambda };
            panel = panel.simulated(free_run(model, record)?);
        }
        plot = plot.panel(panel);
    }
    actuators(plot, record)
}

/// Adds the panels of the actuators and of speed.
pub(super) fn actuators(mut plot: TimePlot, record: &Dataset) -> Result<TimePlot, ChainError> {
    for (name, label, unit) in [
        ("inj", "Injected mass", "mg"),
        ("spark", "Spark advance", "deg BTDC"),
        ("throttle", "Throttle", "deg"),
        ("speed", "Speed", "rpm"),
    ] {
        plot = plot.panel(Panel::new(label, unit).held(name, record.values(name)?.to_vec()));
    }
    Ok(plot)
}

/// Free run of a model over a record; a sample that is not finite is drawn as a gap.
pub(super) fn free_run(model: &EngineModel, record: &Dataset) -> Result<Vec<f64>, ChainError> {
    Ok(model.simulate(record)?.0)
}

/// `v` in percent.
pub(super) fn percent(v: Option<f64>) -> Option<f64> {
    v.map(|v| 100.0 * v)
}

/// A ratio as its difference from one, in percent.
pub(super) fn change(ratio: f64) -> f64 {
    100.0 * (ratio - 1.0)
}

/// Unit as reports write it: nothing for `-`.
pub(super) fn unit(unit: &str) -> &str {
    if unit == "-" { "" } else { unit }
}
