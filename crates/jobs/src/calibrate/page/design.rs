//! Step 3: the designed test signal, its safety and what it gained.

use super::super::context::Context;
use super::super::design_step::DesignResult;
use super::super::error::ChainError;
use super::super::verdict::how_it_ended;
use super::models::table;
use super::parts::{percent, plot, record, unit};
use dynocal_files::run_folder::Done;
use dynocal_numerics::interval::Interval;
use dynocal_report::{Cell, Column, Section, Table, capital};

/// The whole step.
pub(super) fn section(ctx: &Context, d: &Done<DesignResult>) -> Result<Section, ChainError> {
    let r = &d.result;
    let mut section = Section::new("Test signal design").id("design");
    if r.records.is_empty() {
        return Ok(section.text(format!("{}.", capital(r.left_out.trim_end_matches('.')))));
    }
    section = match r.status {
        Some(status) => section.text(format!(
            "The record is designed by `dynocal design` (spec: steps/03-design/design.toml), {}-optimal for the identified models within the limits; the search {} after {} evaluations. It is played with trimming loops about the predicted outputs.",
            r.criteria.first().map_or(String::new(), |c| c.criterion.to_uppercase()),
            how_it_ended(status),
            r.evaluations
        )),
        None if !r.choice.is_empty() => section.text("The record has the levels of an excitation, which are chosen and not drawn; it is played as those are."),
        None => section.text("The record was designed and measured elsewhere."),
    };
    if !r.choice.is_empty() {
        section = section.text(format!(
            "What the first records leave decided about it. {}.",
            capital(&r.choice.join("; "))
        ));
    }
    section = section.block(gains(r));
    if !r.criteria.is_empty() {
        section = section.block(criteria(r));
    }
    if !r.safety.is_empty() {
        section = section.block(safety(r));
    }
    let models = r.models.chosen();
    for reference in &r.records {
        let title = format!("{}: measured over the re-identified models", reference.name);
        section = section.block(plot(ctx, title, &record(ctx, &d.folder, reference)?, &models)?);
    }
    for output in &r.models.outputs {
        section = section
            .block(table(output, &format!("Candidates for {} with the designed record", output.output)));
    }
    Ok(section)
}

fn criteria(r: &DesignResult) -> Table {
    let mut table = Table::new(vec![
        Column::text("Model"),
        Column::text("Criterion"),
        Column::number("Design", "").digits(6),
    ])
    .caption("Criterion of the design, smaller is better");
    for c in &r.criteria {
        table = table.row([c.model.as_str().into(), c.criterion.to_uppercase().into(), Cell::from(c.value)]);
    }
    table
}

fn gains(r: &DesignResult) -> Table {
    let outputs: Vec<&String> = r.gains.first().map_or(Vec::new(), |g| g.r2.iter().map(|(n, _)| n).collect());
    let head = outputs.iter().map(|o| Column::number(format!("R2 {o}"), "%").digits(4));
    let mut table = Table::new([Column::text("Identification data")].into_iter().chain(head).collect())
        .caption("What it gained: mean free-run R2 on unseen records");
    for g in &r.gains {
        let numbers = g.r2.iter().map(|(_, v)| Cell::from(percent(*v)));
        table = table.row([Cell::from(g.data.as_str())].into_iter().chain(numbers).collect::<Vec<_>>());
    }
    table
}

fn safety(r: &DesignResult) -> Table {
    let range = |r: Interval| format!("{:.3} to {:.3}", r.lower, r.upper);
    let mut table = Table::new(vec![
        Column::text("Output"),
        Column::text("Limits"),
        Column::text("Predicted"),
        Column::number("Band to limit", "").digits(3),
        Column::number("at time", "s").digits(4),
        Column::text("Measured"),
    ])
    .caption("Predicted and measured outputs against the limits of the design (negative distance: the band leaves them)");
    for s in &r.safety {
        let u = unit(&s.output.unit);
        let name = if u.is_empty() { s.output.name.clone() } else { format!("{} [{u}]", s.output.name) };
        let measured =
            r.measured.iter().find(|m| m.0 == s.output.name).map(|m| range(Interval::new(m.1, m.2)));
        table = table.row([
            name.into(),
            s.limits.map_or(String::new(), range).into(),
            range(s.predicted).into(),
            s.least_distance_of_band.map(|d| d.distance).into(),
            s.least_distance_of_band.map(|d| d.at_s).into(),
            Cell::from(measured.unwrap_or_default()),
        ]);
    }
    table
}
