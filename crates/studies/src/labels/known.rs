//! Rows of logs whose truth lies beside them: the tune that a log carries, and the CSV that the tool which wrote it exported.

use std::io::Read;
use std::path::Path;

use dynocal_files::measurement::Source;
use dynocal_files::measurement::mlg::Mlg;
use dynocal_files::table::Cells;
use dynocal_jobs::label::known::{Known, compare};
use dynocal_report::{Column, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{folder, log, refused, value};
use crate::asked::Asked;
use crate::{Check, Options, StudyError, Task, TaskResult, check, result};

/// All logs with a tune.
const LOGS: [&str; 5] = [
    "2025-12-02_10.08.37",
    "2025-12-02_10.54.12",
    "2025-12-02_10.58.15o",
    "2025-12-08_15.52.00",
    "2026-02-28_17.53.41",
];
/// Logs with what the tool exported of them.
const EXPORTED: [&str; 2] = ["2025-12-02_10.54.12", "2025-12-08_15.52.00"];

/// Numbers of a log against those that the tool printed.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Printed {
    compared: usize,
    unequal: usize,
}

pub(super) fn tasks(o: &Options) -> Vec<Task> {
    let data = folder(o);
    let mut out = Vec::new();
    for name in if o.reduced { &LOGS[..1] } else { &LOGS[..] } {
        let data = data.clone();
        out.push(Task {
            name: format!("known-{name}"),
            inputs: json!([name]),
            run: Box::new(move |_| {
                value(name, compare(&log(data.as_deref(), name)?).map_err(|e| refused(name, e))?)
            }),
        });
    }
    out.push(Task {
        name: "printed".into(),
        inputs: json!(EXPORTED),
        run: Box::new(move |_| {
            let mut sum = Printed { compared: 0, unequal: 0 };
            for name in EXPORTED {
                let one = printed(&log(data.as_deref(), name)?)?;
                sum = Printed { compared: sum.compared + one.compared, unequal: sum.unequal + one.unequal };
            }
            value("printed", sum)
        }),
    });
    out
}

/// Every number of a log against the CSV beside it, to the last digit that is printed there.
fn printed(path: &Path) -> Result<Printed, StudyError> {
    let fail = |e: &dyn std::fmt::Display| refused("printed", e);
    let mlg = Mlg::open(path).map_err(|e| fail(&e))?;
    let channels: Vec<usize> = (1..=mlg.fields.len()).collect();
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); channels.len()];
    let mut take = |chunk: &[Cells]| {
        for (column, cells) in columns.iter_mut().zip(chunk) {
            if let Cells::Number(v) = cells {
                column.extend_from_slice(v);
            }
        }
        Ok(())
    };
    mlg.chunks(0, &channels, &mut |chunk| take(chunk)).map_err(|e| fail(&e))?;
    let packed = std::fs::read(path.with_extension("csv.gz")).map_err(|e| fail(&e))?;
    let mut text = String::new();
    flate2::read::MultiGzDecoder::new(&packed[..]).read_to_string(&mut text).map_err(|e| fail(&e))?;
    let mut out = Printed { compared: 0, unequal: 0 };
    // A line of names and one of units come first.
    for (k, row) in text.lines().skip(2).enumerate() {
        for (c, cell) in row.split(';').enumerate() {
            let digits = cell.split_once('.').map_or(0, |(_, after)| after.len());
            // The tool prints 0 where a record of before the trigger has no number.
            let ours = columns.get(c).and_then(|v| v.get(k)).map(|v| if v.is_nan() { 0.0 } else { *v });
            let near = |ours: f64| {
                let most = 0.5 * 10f64.powi(-(digits as i32)) + 1e-7 * ours.abs();
                cell.parse::<f64>().is_ok_and(|printed| (ours - printed).abs() <= most)
            };
            out.compared += 1;
            out.unequal += usize::from(!ours.is_some_and(near));
        }
    }
    Ok(out)
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let mut out = Vec::new();
    for name in LOGS.iter().filter(|n| results.iter().any(|r| r.name == format!("known-{n}"))) {
        let k: Option<Known> = result(results, &format!("known-{name}"));
        let share = |part: usize, all: usize| (all > 0).then(|| 100.0 * part as f64 / all as f64);
        out.push(check(
            format!("known-{name}-explained"),
            "Known table: look-ups that the one table found explains, by the ECU's own arithmetic",
            Asked::AtLeast(100.0),
            k.as_ref().and_then(|k| share(k.by_found, k.samples)),
            "%",
            k.as_ref().map_or(String::new(), |k| {
                format!("the tune in the log explains {} of {}", k.by_tune, k.samples)
            }),
        ));
        let note = k.as_ref().map_or(String::new(), |k| {
            format!(
                "{} of {} determined cells; of {} others the log rules out the tune's value: no table with it explains all look-ups",
                k.near, k.determined, k.ruled_out
            )
        });
        // A log may be too short to determine a cell; then it says nothing, and the row has no number.
        let near = k.as_ref().and_then(|k| share(k.near, k.determined - k.ruled_out));
        let asked = match &k {
            Some(k) if k.determined == k.ruled_out => Asked::Reported,
            _ => Asked::AtLeast(95.0),
        };
        out.push(check(
            format!("known-{name}-cells"),
            "Known table: determined cells within one count of the tune, but for those of which the log rules it out",
            asked,
            near,
            "%",
            note,
        ));
    }
    let p: Option<Printed> = result(results, "printed");
    if results.iter().any(|r| r.name == "printed") {
        out.push(check(
            "printed",
            "Numbers of two logs that differ from those which the tool exported, on the digits that it printed",
            Asked::AtMost(0.0),
            p.as_ref().map(|p| p.unequal as f64),
            "",
            p.as_ref().map_or(String::new(), |p| format!("of {}", p.compared)),
        ));
    }
    out
}

pub(super) fn section(results: &[TaskResult]) -> Option<Section> {
    let head = vec![
        Column::text("Log"),
        Column::number("Look-ups", ""),
        Column::number("Explained by its tune", ""),
        Column::number("By the table found", ""),
        Column::number("Cells determined", ""),
        Column::number("Within one count", ""),
        Column::number("Tune ruled out", ""),
    ];
    let mut table = Table::new(head);
    let mut any = false;
    for name in LOGS {
        let Some(k) = result::<Known>(results, &format!("known-{name}")) else { continue };
        any = true;
        table = table.row(vec![
            name.into(),
            k.samples.into(),
            k.by_tune.into(),
            k.by_found.into(),
            k.determined.into(),
            k.near.into(),
            k.ruled_out.into(),
        ]);
    }
    let text = "The value in use is a look-up in the table that the ECU has cut to whole counts, with shares and weights of eight bits: each \
                sample is an interval, and one table must explain them all. Where the tune in a log does not, it was another table's: the \
                last column counts determined cells whose value in the tune no table may have that explains the log.";
    any.then(|| Section::new("Known tables from their look-ups").text(text).block(table))
}
