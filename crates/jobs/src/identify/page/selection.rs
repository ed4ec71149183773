//! The way of a selection of terms.

use crate::identify::result::Path;
use dynocal_ident::select::{Action, Step};
use dynocal_report::{Axis, Cell, Column, Section, Table, XyPlot};

/// Adds table and plot of the path.
pub(super) fn add(section: Section, path: &Path) -> Section {
    let text = format!(
        "Terms were selected from {} candidates; {} of {} steps were kept (stressed). F is the partial F of the term; AIC, \
         BIC and FPE are of the one-step errors (thesis eqs. 2.49 to 2.51), PRESS their leave-one-out mean square.",
        path.pool,
        path.kept,
        path.steps.len()
    );
    section.text(text).block(table(path)).columns(vec![errors(path).into(), criteria(path).into()])
}

fn table(path: &Path) -> Table {
    let free = path.steps.iter().any(|s| s.free_run.is_some());
    let mut columns = vec![
        Column::number("Step", "-"),
        Column::text("Term"),
        Column::number("Terms", "-"),
        Column::number("Error reduction", "%").digits(4),
        Column::number("F", "-").digits(4),
        Column::number("One-step MSE", ""),
        Column::number("AIC", "-"),
        Column::number("BIC", "-"),
        Column::number("PRESS", ""),
    ];
    if free {
        columns.push(Column::number("Free-run MSE", ""));
    }
    let mut table = Table::new(columns).caption("Path of the selection");
    for (k, s) in path.steps.iter().enumerate() {
        let sign = if s.action == Action::Entered { "+" } else { "-" };
        let mut row: Vec<Cell> = vec![
            (k + 1).into(),
            format!("{sign} {}", s.regressor).into(),
            s.terms.into(),
            (100.0 * s.err).into(),
            s.f.into(),
            s.mse.into(),
            s.aic.into(),
            s.bic.into(),
            s.press.into(),
        ];
        if free {
            row.push(s.free_run.into());
        }
        table = if k < path.kept { table.stressed_row(row) } else { table.row(row) };
    }
    table
}

fn over_steps(path: &Path, f: impl Fn(&Step) -> f64) -> (Vec<f64>, Vec<f64>) {
    let pairs = path.steps.iter().enumerate().map(|(k, s)| ((k + 1) as f64, f(s)));
    pairs.filter(|(_, v)| v.is_finite()).unzip()
}

fn errors(path: &Path) -> XyPlot {
    let root = |v: f64| if v >= 0.0 { v.sqrt() } else { f64::NAN };
    let (x, y) = over_steps(path, |s| root(s.mse));
    let mut plot = XyPlot::new("Errors along the path", Axis::new("Step", "-"), Axis::new("RMSE", ""))
        .line("one step", x, y);
    let (x, y) = over_steps(path, |s| root(s.free_run.unwrap_or(f64::NAN)));
    if !x.is_empty() {
        plot = plot.line("free run", x, y);
    }
    plot
}

fn criteria(path: &Path) -> XyPlot {
    let mut plot =
        XyPlot::new("Criteria along the path", Axis::new("Step", "-"), Axis::new("Criterion", "-"));
    for name in ["AIC", "BIC", "FPE"] {
        let value = |s: &Step| match name {
            "AIC" => s.aic,
            "BIC" => s.bic,
            _ => s.fpe,
        };
        let (x, y) = over_steps(path, value);
        plot = plot.line(name, x, y);
    }
    plot
}
