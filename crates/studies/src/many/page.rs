//! The page of a job over seeds and points.

use std::path::Path;

use dynocal_report::{Column, Report, Section, Table, render};

use super::end::Count;
use super::spec::JobStudy;
use super::table::Spread;
use crate::StudyError;

/// Most numbers that are shown; all are in summary.json.
const MOST_SHOWN: usize = 120;

pub(super) fn write(
    study: &JobStudy,
    count: &Count,
    verdict: &[String],
    warnings: &[String],
    results: &[Spread],
    folder: &Path,
) -> Result<(), StudyError> {
    let mut report = Report::new(format!("Study: {}", study.name))
        .subtitle(verdict.join(" "))
        .fact("Job", study.job.as_str())
        .fact("Tasks", count.tasks)
        .fact("Points", study.points.len())
        .fact("Seeds of each point", study.seeds.len().max(1));
    for w in warnings {
        report = report.warning(w.as_str());
    }
    if !count.bad.is_empty() {
        report = report.section(bad(count));
    }
    report = report.section(spreads(results));
    let html = render(&report)
        .map_err(|e| StudyError::Task { what: "report of the study".into(), reason: e.to_string() })?;
    Ok(dynocal_files::atomic::write(&folder.join("report.html"), html.as_bytes())?)
}

fn bad(count: &Count) -> Section {
    let mut table = Table::new(vec![Column::number("Task", ""), Column::text("What it says")]);
    for (task, said) in &count.bad {
        table = table.row([(*task as f64).into(), said.as_str().into()]);
    }
    let all = count.failed + count.not_valid + count.waiting;
    let text = format!("The first {} of {all} in the order of the tasks.", count.bad.len());
    Section::new("Tasks without a usable result").text(text).block(table)
}

fn spreads(results: &[Spread]) -> Section {
    let mut table = Table::new(vec![
        Column::text("Number"),
        Column::number("Tasks", ""),
        Column::number("Mean", "").digits(4),
        Column::number("Standard deviation", "").digits(3),
        Column::number("Least", "").digits(4),
        Column::number("Greatest", "").digits(4),
    ]);
    // What never varies says nothing about the study.
    let varying = results.iter().filter(|s| s.least < s.greatest || s.name == "valid");
    let (total, shown) = (varying.clone().count(), varying.take(MOST_SHOWN));
    for s in shown {
        table = table.row([
            s.name.as_str().into(),
            (s.tasks as f64).into(),
            s.mean.into(),
            s.sd.into(),
            s.least.into(),
            s.greatest.into(),
        ]);
    }
    let more =
        if total > MOST_SHOWN { format!(" The first {MOST_SHOWN} of {total}.") } else { String::new() };
    let text = format!(
        "Numbers of the runs' summaries that are not the same in all of them, over all points and seeds, in the unit that the key has \
         there.{more} Every task's own are in results.parquet and, with all words, in chunks."
    );
    Section::new("Numbers over all tasks").text(text).block(table)
}
