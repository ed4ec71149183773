//! Step 4: the promised and the measured fuel.

use crate::calibrate::context::ChainError;
use crate::calibrate::optimise_step::{OptimiseResult, Pass};
use crate::calibrate::validate_step::BestSpark;
use dynocal_files::run_folder::Done;
use dynocal_report::{Axis, Bars, Cell, Column, Details, KeyValue, Section, Table};

use super::models::{table, terms};
use super::parts::{Simulated, change, plot, record};
use crate::calibrate::verdict::word;

/// The whole step.
pub(super) fn section(
    o: &Done<OptimiseResult>,
    best: Option<&BestSpark>,
    dt: f64,
) -> Result<Section, ChainError> {
    let passes = &o.result.passes;
    let mut section = Section::new("Fuel optimisation").id("optimise").text(
        "Fuel of a record at equal torque and lambda at every sample. The demand is the models' response to a feasible start; start and optimum are measured with small loops that hold it.",
    );
    section = section.block(fuel(passes, best));
    if let Some(b) = best {
        section = section.key_values(vec![
            KeyValue::new(
                "Fuel with the spark of the static map on the record of the last pass",
                b.fuel_kg_h,
                "kg/h",
            ),
            KeyValue::new(
                "Share of its saving that the optimum realised",
                b.share_of_saving.map_or(f64::NAN, |v| 100.0 * v),
                "%",
            ),
        ]);
    }
    section = section.block(bars(passes, best)).block(convergence(passes));
    for p in passes {
        let simulated = Simulated { torque: &p.torque.best().model, lambda: &p.lambda.best().model };
        section = section.heading(format!("Pass {}", p.pass));
        let titles = [
            format!("Pass {}, optimum: demand, measured and re-identified models", p.pass),
            format!("Pass {}, start: demand, measured and re-identified models", p.pass),
        ];
        // The optimum is what the pass is about; it comes before its start.
        for (reference, title) in p.records.iter().rev().zip(titles) {
            section = section.block(plot(title, &record(&o.folder, reference, dt)?, Some(simulated))?);
        }
    }
    if let Some(last) = passes.last() {
        let mut details = Details::new("Models after the last pass: candidates and terms");
        for m in [&last.torque, &last.lambda] {
            details =
                details.block(table(m, &format!("Candidates for {}", m.output))).block(terms(m, m.best()));
        }
        section = section.block(details);
    }
    Ok(section)
}

fn fuel(passes: &[Pass], best: Option<&BestSpark>) -> Table {
    let mut table = Table::new(vec![
        Column::text("Record"),
        Column::number("Start", "kg/h").digits(5),
        Column::number("Optimum", "kg/h").digits(5),
        Column::number("Promised", "%").digits(3),
        Column::number("Measured", "%").digits(3),
        Column::number("Gap", "points").digits(2),
        Column::number("Fuel per work", "%").digits(3),
        Column::number("Torque error", "Nm").digits(3),
        Column::number("Lambda error", "").digits(3),
    ])
    .caption("Promised against measured fuel, change from start to optimum (measured kg/h; errors are RMS against the demand). Fuel per torque work is biased by friction where torque differs.");
    for p in passes {
        table = table.row([
            format!("pass {}", p.pass).into(),
            p.measured_start_fuel_kg_h.into(),
            p.measured_fuel_kg_h.into(),
            change(p.promised_ratio).into(),
            change(p.measured_ratio).into(),
            (100.0 * (p.promised_ratio - p.measured_ratio).abs()).into(),
            change(p.fuel_per_work_ratio).into(),
            p.torque_rms_nm.into(),
            Cell::from(p.lambda_rms),
        ]);
    }
    if let (Some(b), Some(last)) = (best, passes.last()) {
        table = table.row([
            Cell::from("best-spark map"),
            last.measured_start_fuel_kg_h.into(),
            b.fuel_kg_h.into(),
            Cell::Empty,
            change(b.ratio).into(),
            Cell::Empty,
            Cell::Empty,
            Cell::Empty,
            Cell::Empty,
        ]);
    }
    table
}

fn bars(passes: &[Pass], best: Option<&BestSpark>) -> Bars {
    let mut names = Vec::new();
    let mut changes = Vec::new();
    for p in passes {
        names.extend([format!("pass {}, promised", p.pass), format!("pass {}, measured", p.pass)]);
        changes.extend([change(p.promised_ratio), change(p.measured_ratio)]);
    }
    if let Some(b) = best {
        names.push("best-spark map, measured".into());
        changes.push(change(b.ratio));
    }
    Bars::new("Fuel against the start record", Axis::new("Change", "%"), names).series("fuel", changes)
}

fn convergence(passes: &[Pass]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Pass"),
        Column::text("Ended"),
        Column::number("Iterations", ""),
        Column::number("Torque", "Nm").digits(2),
        Column::number("Lambda", "").digits(2),
    ])
    .caption("Convergence, and the largest violation of the demands by the models' free run");
    for p in passes {
        table = table.row([
            p.pass.into(),
            word(p.status).into(),
            p.iterations.into(),
            p.torque_violation_nm.into(),
            Cell::from(p.lambda_violation),
        ]);
    }
    table
}
