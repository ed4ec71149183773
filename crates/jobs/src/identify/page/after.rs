//! How far a model can be trusted beyond its scores.

use crate::identify::after::After;
use crate::identify::result::{Identified, Modelled};
use dynocal_report::{Axis, Bars, Cell, Column, KeyValue, Section, Table};

/// The section.
pub(super) fn section(found: &Identified) -> Section {
    let mut section = Section::new("Trust").text(if found.steady {
        "How far each unseen part is from what was identified (distance 1 is the boundary that holds most of the points of the \
         estimation: beyond it the model extrapolates)."
    } else {
        "Spread of the free-run error over records and blocks with the confidence interval of its mean; free runs on random \
         inputs within the limits of the estimation records; and how far each unseen part is from what was identified \
         (distance 1 is the boundary that holds most of the estimation samples: beyond it the model extrapolates)."
    });
    for m in &found.models {
        section = model(section, m);
    }
    section
}

fn model(section: Section, m: &Modelled) -> Section {
    let a = &m.after;
    let mut section = section.heading(m.target.as_str());
    if !a.pools.is_empty() || a.folds.is_some() {
        section.push(spread(m, a));
        for p in a.pools.iter().filter(|p| p.scores.records.len() <= 40) {
            let names: Vec<String> = p.scores.records.iter().map(|r| r.0.clone()).collect();
            let errors: Vec<f64> = p.scores.records.iter().map(|r| r.1.rmse).collect();
            section.push(
                Bars::new(
                    format!("Free-run RMSE of each record, {}", p.part),
                    Axis::new("RMSE", m.unit.as_str()),
                    names,
                )
                .series("RMSE", errors),
            );
        }
    }
    if let Some(s) = &a.stability {
        section = section.key_values(vec![
            KeyValue::new("Random free runs", s.runs, ""),
            KeyValue::new("of them diverged", 100.0 * s.share_diverged, "%"),
            KeyValue::new("Largest excursion beyond the range of the output", s.largest_excursion, "ranges"),
            KeyValue::new("Unseen records whose free run diverged", s.diverged_records.len(), ""),
            KeyValue::new("Largest excursion on unseen records", s.records_excursion, "ranges"),
        ]);
    }
    if !a.coverage.is_empty() {
        section.push(coverage(a));
    }
    if a.remarks.is_empty() { section } else { section.text(a.remarks.join("\n")) }
}

fn spread(m: &Modelled, a: &After) -> Table {
    let mut table = Table::new(vec![
        Column::text("Free-run RMSE over"),
        Column::number("Number", "-"),
        Column::number("Diverged", "-"),
        Column::number("Mean", m.unit.as_str()),
        Column::number("Standard deviation", m.unit.as_str()).digits(3),
        Column::number("Interval of the mean from", m.unit.as_str()),
        Column::number("to", m.unit.as_str()),
        Column::number("Worst", m.unit.as_str()),
    ]);
    let pools = a.pools.iter().map(|p| (format!("records, {}", p.part), &p.scores));
    let folds = a.folds.iter().map(|f| (format!("{} blocks held out in turn", f.folds), &f.free_run));
    for (name, pool) in pools.chain(folds) {
        let r = &pool.rmse;
        let number = |v: f64| if v.is_finite() { Cell::from(v) } else { Cell::Empty };
        table = table.row([
            name.into(),
            r.count.into(),
            pool.diverged.into(),
            number(r.mean),
            number(r.std),
            number(r.low),
            number(r.high),
            number(r.max),
        ]);
    }
    table
}

fn coverage(a: &After) -> Table {
    let mut table = Table::new(vec![
        Column::text("Part"),
        Column::number("Outside the boundary", "%").digits(3),
        Column::number("Largest distance", "-").digits(3),
        Column::text("In record"),
        Column::number("At sample", "-"),
    ]);
    for c in &a.coverage {
        table = table.row([
            c.part.as_str().into(),
            c.outside_percent.into(),
            c.worst.into(),
            c.record.as_str().into(),
            c.sample.into(),
        ]);
    }
    table
}
