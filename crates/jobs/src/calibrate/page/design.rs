//! Step 3: the designed test signal, its safety and what it gained.

use crate::calibrate::context::ChainError;
use crate::calibrate::design_step::DesignResult;
use dynocal_files::run_folder::Done;
use dynocal_report::{Cell, Column, Section, Table};

use super::models::table;
use super::parts::{Simulated, percent, plot, record, unit};
use crate::calibrate::verdict::word;

/// The whole step.
pub(super) fn section(d: &Done<DesignResult>, dt: f64) -> Result<Section, ChainError> {
    let r = &d.result;
    let section = Section::new("Test signal design").id("design");
    let Some(status) = r.status else {
        return Ok(section.text("No design was asked for (design.enabled = false)."));
    };
    let mut section = section
        .text(format!(
            "The record is designed to tell most about the parameters of the identified models within the limits of the spec; the search ended as \"{}\" after {} evaluations.",
            word(status),
            r.evaluations
        ))
        .columns(vec![criteria(r).into(), gains(r).into()])
        .block(safety(r));
    let simulated = Simulated { torque: &r.torque.best().model, lambda: &r.lambda.best().model };
    for reference in &r.records {
        let title = format!("{}: measured over the re-identified models", reference.name);
        section = section.block(plot(title, &record(&d.folder, reference, dt)?, Some(simulated))?);
    }
    for output in [&r.torque, &r.lambda] {
        section = section
            .block(table(output, &format!("Candidates for {} with the designed record", output.output)));
    }
    Ok(section)
}

fn criteria(r: &DesignResult) -> Table {
    let mut table = Table::new(vec![
        Column::text("Criterion"),
        Column::number("Start", "").digits(6),
        Column::number("Design", "").digits(6),
        Column::number("Change", "").digits(4),
    ])
    .caption("Criteria, smaller is better (torque and lambda model together)");
    for c in &r.criteria {
        let change = c.design.zip(c.start).map(|(d, s)| d - s);
        table = table.row([
            c.criterion.to_uppercase().into(),
            c.start.into(),
            c.design.into(),
            Cell::from(change),
        ]);
    }
    table
}

fn gains(r: &DesignResult) -> Table {
    let mut table = Table::new(vec![
        Column::text("Identification data"),
        Column::number("R2 torque", "%").digits(4),
        Column::number("R2 lambda", "%").digits(4),
    ])
    .caption("What it gained: mean free-run R2 on unseen records");
    for g in &r.gains {
        table = table.row([
            g.data.as_str().into(),
            percent(g.torque_r2).into(),
            Cell::from(percent(g.lambda_r2)),
        ]);
    }
    table
}

fn safety(r: &DesignResult) -> Table {
    let range = |(a, b): (f64, f64)| format!("{a:.3} to {b:.3}");
    let mut table = Table::new(vec![
        Column::text("Output"),
        Column::text("Demanded range"),
        Column::number("2 x model error", "").digits(3),
        Column::text("Predicted"),
        Column::number("Least distance", "").digits(3),
        Column::number("at time", "s").digits(4),
        Column::text("Measured"),
    ])
    .caption("Safety: predicted and measured outputs against the range that is demanded (negative distance: a transient leaves it)");
    for s in &r.safety {
        let u = if s.output == "torque" { unit("Nm") } else { "" };
        let name = if u.is_empty() { s.output.clone() } else { format!("{} [{u}]", s.output) };
        table = table.row([
            name.into(),
            format!("{} to {}", s.limits.0, s.limits.1).into(),
            s.margin.into(),
            range(s.range).into(),
            s.worst_distance.into(),
            s.worst_time_s.into(),
            Cell::from(range(s.measured_range)),
        ]);
    }
    table
}
