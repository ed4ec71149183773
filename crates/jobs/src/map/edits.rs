//! Edits of a user that outlive a new run: values that stand in cells of the maps whatever the optimum is.
//!
//! A table with the axes of the maps and any of the free inputs (CSV and its dialects, as any measurement), a row for each edited cell; an
//! input that is empty there keeps its optimum. An edit is judged like any setting: what it costs, and which limits it breaks, is said.

use std::path::Path;

use dynocal_calib::steady::cell::{KEPT, Setting};
use dynocal_calib::steady::grid::{Cell, CellState};
use dynocal_calib::steady::layout::Layout;
use dynocal_files::{dataset, units};
use dynocal_ident::data::UnitAfter;

use super::error::MapError;
use super::reach::channel;
use super::result::{Edit, Edited, MapAxis, Passed};

/// What a table asks for: number of the cell, and of each edited factor with its value.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Asked {
    cell: usize,
    values: Vec<(usize, f64)>,
}

/// Distance of a row from a cell, as a share of the range of the axis, that is rounding.
const ROUNDING: f64 = 1e-6;

/// Reads the edits at `path`.
///
/// # Errors
/// [`MapError::Files`]; [`MapError::Edits`] with file, line and column of what does not fit the maps.
pub(super) fn read(path: &Path, layout: &Layout, axes: &[MapAxis]) -> Result<Vec<Asked>, MapError> {
    let table = dataset::read_table(path, None)?;
    let refused = |row: usize, column: &str, found: f64, expected: String| {
        let place = table.place(row);
        Err(MapError::Edits(format!(
            "{}, {place}, column `{column}`: found {found}, expected {expected}",
            table.file
        )))
    };
    let free = &layout.factors[layout.axes..];
    let known: Vec<&str> =
        axes.iter().map(|a| a.name.as_str()).chain(free.iter().map(|f| f.name.as_str())).collect();
    if let Some(c) = table.columns.iter().find(|c| !known.contains(&c.name.as_str())) {
        return Err(MapError::Edits(format!(
            "{}: found column `{}`, expected the axes of the maps and inputs that no loop drives: {}",
            table.file,
            c.name,
            known.join(", ")
        )));
    }
    // Values in the unit of the maps, whatever that of the column is.
    let in_unit = |name: &str, unit: &str| -> Result<(f64, f64), MapError> {
        let Some((found, _)) = &table.column(name)?.unit else { return Ok((1.0, 0.0)) };
        units::conversion(found, unit).ok_or_else(|| {
            MapError::Edits(format!(
                "{}, column `{name}`: found the unit {found}, expected {unit} or one that converts to it",
                table.file
            ))
        })
    };
    let n = table.rows();
    let mut all: Vec<Asked> = Vec::new();
    for row in 0..n {
        let mut cell = 0;
        for a in axes {
            let (factor, offset) = in_unit(&a.name, &a.unit)?;
            let v = factor * table.numbers(&a.name, row, row + 1)?[0] + offset;
            let width = a.points[a.points.len() - 1] - a.points[0];
            let Some(i) = a.points.iter().position(|p| (p - v).abs() <= ROUNDING * width) else {
                let values: Vec<String> = a.points.iter().map(f64::to_string).collect();
                return refused(row, &a.name, v, format!("a value of the axis: {}", values.join(", ")));
            };
            cell = cell * a.points.len() + i;
        }
        let mut values = Vec::new();
        for (i, f) in free.iter().enumerate().filter(|(_, f)| table.column(&f.name).is_ok()) {
            let (factor, offset) = in_unit(&f.name, &f.unit)?;
            let v = factor * table.numbers_or_missing(&f.name, row, row + 1)?[0] + offset;
            if v < f.lower || v > f.upper {
                return refused(row, &f.name, v, format!("{} to {} {}", f.lower, f.upper, f.unit));
            }
            if v.is_finite() {
                values.push((layout.axes + i, v));
            }
        }
        if all.iter().any(|a| a.cell == cell) {
            let first = &axes[0];
            let at = table.numbers(&first.name, row, row + 1)?[0];
            return refused(row, &first.name, at, "each cell once".into());
        }
        if !values.is_empty() {
            all.push(Asked { cell, values });
        }
    }
    Ok(all)
}

/// Puts the edits into the cells: nothing moves them after this. A cell that breaks a limit is no optimum any more, and marked.
pub(super) fn hold(asked: &[Asked], setting: &Setting, layout: &Layout, cells: &mut [Cell]) -> Vec<Edit> {
    let one = |a: &Asked| {
        let cell = &mut cells[a.cell];
        let mut x = cell.optimum.x.clone();
        let mut values = Vec::new();
        for (k, v) in &a.values {
            let f = &layout.factors[*k];
            values.push(Edited { input: f.name.clone(), unit: f.unit.clone(), optimum: x[*k], edit: *v });
            x[*k] = *v;
        }
        let found = setting.judge(&x, cell.optimum.status, None);
        let costs = found.objective - cell.optimum.objective;
        let broken = found.prices.iter().zip(&setting.sides).filter(|(p, s)| p.passed > KEPT * s.scale);
        let passed = broken.map(|(p, _)| {
            let r = channel(layout, p.response);
            Passed { response: r.name.clone(), unit: r.unit.clone(), by: p.passed }
        });
        let passed: Vec<Passed> = passed.collect();
        let reached = cell.state != CellState::Filled;
        if reached {
            cell.state = if found.feasible { CellState::Optimal } else { CellState::Edited };
        }
        cell.best = setting.cost(&found);
        cell.optimum = found;
        Edit { at: cell.at.clone(), values, costs, passed, reached }
    };
    asked.iter().map(one).collect()
}

impl Edit {
    /// What was edited, in words.
    pub fn words(&self) -> String {
        let one = |e: &Edited| {
            let n = |v: f64| dynocal_report::significant(v, 4);
            format!("`{}` {}{} where the optimum is {}", e.input, n(e.edit), UnitAfter(&e.unit), n(e.optimum))
        };
        self.values.iter().map(one).collect::<Vec<_>>().join(", ")
    }

    /// Limits that it breaks, in words; empty where it breaks none.
    pub fn broken(&self) -> String {
        let one = |p: &Passed| {
            format!("`{}` by {}{}", p.response, dynocal_report::significant(p.by, 2), UnitAfter(&p.unit))
        };
        self.passed.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}
