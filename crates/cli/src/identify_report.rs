//! The report of an identification: it arranges what the run folder holds and computes nothing.

use std::path::Path;

use dynocal_calib::identify::result::Identified;
use dynocal_deliver::{Cell, Column, Panel, Report, Section, Table, TimePlot, render};
use dynocal_files::table::Table as Record;
use dynocal_files::{atomic, csv_io};
use dynocal_ident::validate::{Kind, Seen};

use crate::failure::Failure;

/// Most records that are drawn: the others are in the run folder, and a page must stay light.
const DRAWN: usize = 6;

/// Writes `report.html` into the run folder.
pub(crate) fn write(found: &Identified, folder: &Path) -> Result<(), Failure> {
    let subtitle = format!(
        "{} from {}: {} with {} parameters, estimated by {}",
        found.target,
        found.inputs.join(", "),
        found.structure,
        found.parameters,
        found.estimator
    );
    let mut report = Report::new(format!("Identification: {}", found.name)).subtitle(subtitle);
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    report = report.section(Section::new("Fit").block(scores(found)));
    let is_test = |f: &&String| f.contains("/test-");
    let unseen = found.files.iter().any(|f| is_test(&f));
    let drawn = found.files.iter().filter(|f| f.ends_with(".csv") && is_test(f) == unseen).take(DRAWN);
    let mut section = Section::new(if unseen { "Unseen records" } else { "Records of the estimation" })
        .text("Measured output and free run, started from measured values only.");
    for file in drawn {
        section = section.block(plot(found, &csv_io::read(&folder.join(file))?, file)?);
    }
    atomic::write(&folder.join("report.html"), render(&report.section(section))?.as_bytes())?;
    Ok(())
}

fn scores(found: &Identified) -> Table {
    let unit = found.scores.first().map_or("-", |s| s.unit.as_str());
    let mut table = Table::new(vec![
        Column::text("Data"),
        Column::text("Output"),
        Column::number("Samples", "-"),
        Column::number("RMSE", unit),
        Column::number("R2", "%"),
        Column::number("NRMSE fit", "%"),
    ]);
    for s in &found.scores {
        let number = |x: Option<f64>| x.map_or(Cell::from("diverged"), Cell::from);
        let data = if s.data == Seen::Unseen { "unseen" } else { "estimation" };
        let kind = if s.kind == Kind::FreeRun { "free run" } else { "one step" };
        table = table.row([
            data.into(),
            kind.into(),
            s.samples.into(),
            number(s.rmse),
            number(s.r2_percent),
            number(s.nrmse_fit_percent),
        ]);
    }
    table
}

fn plot(found: &Identified, record: &Record, file: &str) -> Result<TimePlot, Failure> {
    let column = |name: &str| -> Result<Vec<f64>, Failure> {
        let cells = &record.column(name)?.cells;
        // A free run that diverged is drawn as far as it goes.
        Ok(match cells {
            dynocal_files::table::Cells::Number(v) => v.clone(),
            dynocal_files::table::Cells::Text(_) => Vec::new(),
        })
    };
    let unit = |name: &str| -> Result<String, Failure> {
        Ok(record.column(name)?.unit.as_ref().map_or_else(|| "-".to_string(), |u| u.0.clone()))
    };
    let measured = format!("{}_measured", found.target);
    let mut plot = TimePlot::new(record_name(file), column("time")?).panel(
        Panel::new(found.target.as_str(), unit(&measured)?)
            .measured(column(&measured)?)
            .simulated(column(&format!("{}_free_run", found.target))?),
    );
    for input in found.inputs.iter().take(2) {
        plot = plot.panel(Panel::new(input.as_str(), unit(input)?).line(input.as_str(), column(input)?));
    }
    Ok(plot)
}

fn record_name(file: &str) -> String {
    Path::new(file).file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}
