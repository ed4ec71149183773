//! The page of a fit of labels.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_label::linear::Verdict;
use dynocal_report::{Axis, Block, Cell, Check, Column, HeatMap, Report, Section, Table, XyPlot, render};

use super::result::Labelled;
use crate::page::PageError;

/// Most points of a cloud.
const DRAWN: usize = 4000;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(found: &Labelled, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(found))?.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(found: &Labelled) -> Report {
    let j = &found.found.judgement;
    let mut report = Report::new(format!("Label {}: {}", found.label.name, found.name));
    for text in &found.verdict {
        report = report.verdict(text.as_str());
    }
    for text in &found.warnings {
        report = report.warning(text.as_str());
    }
    let percent = |v: f64| 100.0 * v;
    // What nothing judges is no check.
    if j.samples > 0 {
        report = report.check(
            Check::new("unseen", "lambda on later, unseen samples with the fitted table (root mean square)")
                .asked(format!("not above {:.2}", percent(j.rms_before)))
                .measured(percent(j.rms_after))
                .unit("%")
                .holds(found.valid)
                .note("the demand is the table as it was; a loss counts where it is more than chance gives"),
        );
    }
    report
        .section(maps(found))
        .section(intersections(found))
        .section(residuals(found))
        .section(samples(found))
}

fn map(found: &Labelled, title: &str, unit: &str, values: Vec<f64>) -> HeatMap {
    let axis = |k: usize| {
        let a = &found.label.axes[k];
        (Axis::new(a.name.as_str(), a.unit.as_str()), a.points.clone())
    };
    HeatMap::new(title, axis(0), axis(1), (Axis::new(title, unit), values)).cell_values()
}

fn maps(found: &Labelled) -> Section {
    let (label, t) = (&found.label, &found.found.table);
    let both = || label.base.iter().chain(&t.values).copied();
    let (low, high) = (both().fold(f64::INFINITY, f64::min), both().fold(f64::NEG_INFINITY, f64::max));
    let unit = label.unit.as_str();
    let difference: Vec<f64> = t.values.iter().zip(&label.base).map(|(a, b)| a - b).collect();
    let half: Vec<f64> = found.half_width.iter().map(|h| h.unwrap_or(f64::NAN)).collect();
    let verdict: Vec<f64> = t
        .verdicts
        .iter()
        .map(|v| match v {
            Verdict::Untouched => f64::NAN,
            Verdict::Pulled => 1.0,
            Verdict::Determined => 2.0,
            Verdict::Locked | Verdict::Open => 0.0,
        })
        .collect();
    let visits: Vec<f64> = t.visits.iter().map(|v| if *v > 0.0 { v.round() } else { f64::NAN }).collect();
    // The colours of counts: a state of hours would leave all others white.
    // A cell without a visit stays empty: the greater of nothing and 1 would be 1.
    let log: Vec<f64> =
        visits.iter().map(|v| if v.is_nan() { f64::NAN } else { v.max(1.0).log10() }).collect();
    let text = "Rows from the lowest load up, as in the tune. Before and after have the same colours. An untouched cell keeps \
                its value and has no interval.";
    Section::new("Maps")
        .text(text)
        .block(map(found, "Before", unit, label.base.clone()).range(low, high))
        .block(map(found, "Fitted to all samples", unit, t.values.clone()).range(low, high))
        .block(map(found, "Difference", unit, difference).diverging())
        .block(map(
            found,
            "Half width of the 95 % interval",
            unit,
            half.iter().map(|h| (h * 100.0).round() / 100.0).collect(),
        ))
        .block(map(
            found,
            "Visits, powers of ten of samples",
            "-",
            log.iter().map(|v| (v * 10.0).round() / 10.0).collect(),
        ))
        .block(
            map(found, "Verdict", "-", verdict)
                .range(0.0, 2.0)
                .caption("2: determined by data; 1: pulled by neighbours; empty: untouched; 0: locked."),
        )
}

/// The table along speed and along load, where it was visited most.
fn intersections(found: &Labelled) -> Section {
    let (label, t) = (&found.label, &found.found.table);
    let (nx, ny) = (label.axes[0].points.len(), label.axes[1].points.len());
    let most = (0..label.len()).max_by(|a, b| t.visits[*a].total_cmp(&t.visits[*b])).unwrap_or(0);
    let mut section = Section::new("Intersections").text("Through the cell that was visited most.");
    for k in 0..2 {
        let other = 1 - k;
        let line: Vec<usize> = match k {
            0 => (0..nx).map(|i| (most / nx) * nx + i).collect(),
            _ => (0..ny).map(|j| j * nx + most % nx).collect(),
        };
        let of = |v: &[f64]| line.iter().map(|c| v[*c]).collect::<Vec<f64>>();
        let (axis, fixed) = (&label.axes[k], &label.axes[other]);
        let at = fixed.points[if other == 0 { most % nx } else { most / nx }];
        let x = axis.points.clone();
        // Where nothing is known there is no band.
        let half: Vec<f64> = line.iter().map(|c| found.half_width[*c].unwrap_or(0.0)).collect();
        let fitted = of(&t.values);
        let shift = |s: f64| fitted.iter().zip(&half).map(|(v, h)| v + s * h).collect::<Vec<f64>>();
        let plot = XyPlot::new(
            format!("{} {at} {}", fixed.name, fixed.unit),
            Axis::new(axis.name.as_str(), axis.unit.as_str()),
            Axis::new(label.name.as_str(), label.unit.as_str()),
        )
        .band("95 % interval", x.clone(), shift(-1.0), shift(1.0))
        .line("before", x.clone(), of(&label.base))
        .line("fitted", x, fitted.clone());
        section = section.block(plot);
    }
    section
}

fn residuals(found: &Labelled) -> Section {
    let all = &found.found.residuals;
    let every = all.len().div_ceil(DRAWN).max(1);
    let mut section = Section::new("What is left")
        .text("Measured over expected lambda, less 1, of the table that was fitted to the first part of the samples.");
    for (k, name) in found.logs.iter().enumerate() {
        let own: Vec<&(usize, f64, f64)> = all.iter().filter(|r| r.0 == k).step_by(every).collect();
        if own.is_empty() {
            continue;
        }
        let x: Vec<f64> = own.iter().map(|r| r.1).collect();
        let y: Vec<f64> = own.iter().map(|r| 100.0 * r.2).collect();
        section = section.block(
            XyPlot::new(name.as_str(), Axis::new("Time", "s"), Axis::new("lambda, share left", "%"))
                .points("samples", x, y),
        );
    }
    // Over the axes a lack of structure shows as a slope that the table cannot follow.
    let every = all.len().div_ceil(DRAWN).max(1);
    let y: Vec<f64> = all.iter().step_by(every).map(|r| 100.0 * r.2).collect();
    for (k, a) in found.label.axes.iter().enumerate() {
        let x: Vec<f64> = found.found.states.iter().step_by(every).map(|s| s[k]).collect();
        section = section.block(
            XyPlot::new(
                format!("over {}", a.name),
                Axis::new(a.name.as_str(), a.unit.as_str()),
                Axis::new("lambda, share left", "%"),
            )
            .points("samples", x, y.clone()),
        );
    }
    section
}

fn samples(found: &Labelled) -> Section {
    let f = &found.found;
    let mut table = Table::new(vec![Column::text("Samples"), Column::number("Number", "")])
        .row(vec![Cell::from("in the logs"), f.samples[0].into()])
        .stressed_row(vec![Cell::from("that count"), f.samples[1].into()]);
    for (reason, count) in f.left_out.iter().filter(|r| r.1 > 0) {
        table = table.row(vec![Cell::from(format!("left out: {reason}")), (*count).into()]);
    }
    let text = format!(
        "{:.0} samples in a row say as much as one independent measurement, and intervals count them so. The weight of the smoothness is {:.2e} (1 gives it as much as the data), by generalised cross-validation unless it was given; the table then has {:.0} effective parameters.",
        f.table.correlation_samples, f.table.smooth, f.table.effective_parameters
    );
    Section::new("Samples").block(Block::from(table)).text(text)
}
