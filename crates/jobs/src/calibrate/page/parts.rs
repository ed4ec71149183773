//! Pieces that several sections use: records, panels, numbers.

use std::path::Path;

use super::super::context::Context;
use super::super::error::ChainError;
use super::super::records::RecordRef;
use dynocal_ident::data::Dataset;
use dynocal_ident::stored::StoredModel;
use dynocal_report::{Panel, Role, Series, TimePlot};

/// The record that `reference` names.
pub(super) fn record(ctx: &Context, folder: &Path, reference: &RecordRef) -> Result<Dataset, ChainError> {
    let one = ctx.load_records(folder, std::slice::from_ref(reference))?.pop();
    one.ok_or_else(|| ChainError::Identify { what: reference.name.clone(), reason: "no such record".into() })
}

/// A record: outputs with demand, measurement and free run of `models`, then actuators and given channels.
pub(super) fn plot(
    ctx: &Context,
    title: impl Into<String>,
    record: &Dataset,
    models: &[&StoredModel],
) -> Result<TimePlot, ChainError> {
    let mut plot = TimePlot::sampled(title, record.sample_time_s, record.len());
    for name in ctx.channels.outputs() {
        let mut panel = Panel::new(label(&name), unit(ctx.spec.problem.unit(&name).unwrap_or("-")));
        if let Ok(demand) = record.values(&format!("{name}_demand")) {
            panel = panel.series(Series::new("demand", demand.to_vec()).role(Role::Demand));
        }
        panel = panel.measured(record.values(&name)?.to_vec());
        if let Some(m) = models.iter().find(|m| m.user_output().name == name) {
            panel = panel.simulated(free_run(m, record)?);
        }
        plot = plot.panel(panel);
    }
    actuators(ctx, plot, record)
}

/// Adds the panels of the actuators and of given channels.
pub(super) fn actuators(ctx: &Context, mut plot: TimePlot, record: &Dataset) -> Result<TimePlot, ChainError> {
    for name in ctx.channels.plant_inputs() {
        let u = unit(ctx.spec.problem.unit(&name).unwrap_or("-"));
        plot = plot.panel(Panel::new(label(&name), u).held(name.clone(), record.values(&name)?.to_vec()));
    }
    Ok(plot)
}

/// Free run of a model over a record; a sample that is not finite is drawn as a gap.
pub(super) fn free_run(model: &StoredModel, record: &Dataset) -> Result<Vec<f64>, ChainError> {
    Ok(model.simulate(record, None)?.into_iter().flat_map(|r| r.y).collect())
}

/// Name of a channel as a label: words, the first letter large.
pub(super) fn label(name: &str) -> String {
    let words = name.replace('_', " ");
    let mut letters = words.chars();
    letters.next().map_or_else(String::new, |c| c.to_uppercase().chain(letters).collect())
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
