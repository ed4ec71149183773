//! The run folder of a fit of labels.

use dynocal_files::atomic;
use dynocal_files::run_folder::RunFolder;

use super::page;
use super::result::{LabelJobError, Labelled};
use crate::kept;

/// Writes table and tune (where the table is taken), cells, page and summary; what was written.
///
/// # Errors
/// [`LabelJobError::Files`], [`LabelJobError::Page`].
pub fn write(folder: &RunFolder, found: Labelled) -> Result<Labelled, LabelJobError> {
    let mut files = vec!["report.html".to_string()];
    for (name, bytes) in &found.handed {
        atomic::write(&folder.path().join(name), bytes)?;
        files.push(name.clone());
    }
    files.push(cells(folder, &found)?);
    page::write(&found, folder.path())?;
    let found = Labelled { files, ..found };
    folder.write_summary(&found)?;
    Ok(found)
}

/// One row a cell: where it is, before and after, interval, visits, verdict (0 untouched, 1 pulled, 2 determined, 3 locked).
fn cells(folder: &RunFolder, found: &Labelled) -> Result<String, LabelJobError> {
    use dynocal_label::linear::Verdict;
    let (label, t) = (&found.label, &found.found.table);
    let nx = label.axes[0].points.len();
    let of = |k: usize, axis: usize| label.axes[axis].points[if axis == 0 { k % nx } else { k / nx }];
    let all = 0..label.len();
    let x: Vec<f64> = all.clone().map(|k| of(k, 0)).collect();
    let y: Vec<f64> = all.clone().map(|k| of(k, 1)).collect();
    let half: Vec<f64> = found.half_width.iter().map(|h| h.unwrap_or(f64::NAN)).collect();
    let verdict: Vec<f64> = t
        .verdicts
        .iter()
        .map(|v| match v {
            Verdict::Untouched => 0.0,
            Verdict::Pulled => 1.0,
            Verdict::Determined => 2.0,
            Verdict::Locked => 3.0,
            Verdict::Open => 4.0,
        })
        .collect();
    let unit = label.unit.as_str();
    let columns: Vec<(&str, &str, &[f64])> = vec![
        (&label.axes[0].name, &label.axes[0].unit, &x),
        (&label.axes[1].name, &label.axes[1].unit, &y),
        ("before", unit, &label.base),
        ("fitted", unit, &t.values),
        ("half_width_95", unit, &half),
        ("visits", "-", &t.visits),
        ("independent_measurements", "-", &t.facts),
        ("verdict", "-", &verdict),
    ];
    Ok(kept::write_columns(folder.path(), "cells", &columns)?)
}
