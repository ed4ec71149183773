//! The page.

use super::contest::{OURS, Row};
use super::measures::Measures;
use super::scenario::SCENARIOS;
use super::{Case, boost, cases, cycles, heating};
use crate::TaskResult;
use dynocal_report::{Block, Cell, Column, Details, Report, Section, Table};

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let all = cases(results);
    let mut report = report;
    for scenario in &SCENARIOS {
        let title = scenario.title;
        let of_it: Vec<&Case> = all.iter().filter(|c| c.scenario == scenario.number).collect();
        if of_it.is_empty() {
            continue;
        }
        let words = "Means over the cases, each controller as its line searches tuned it on the records of the case. Integral: of \
            |lambda - 1| per step of 6 s; spike: the largest |lambda - 1|; offset: the largest mean error over the last 1.5 s of a step. What is possible \
            is no controller: its fuel was learned by 14 trials on the judged course itself (with the delay that did best in four), by the true mixture, without preparing for \
            a demand that has not come, and with it. From that with preview to that without is the price of causality, from there to \
            ours that of not knowing.";
        let mut section = Section::new(title).text(words).block(table(&mean_rows(&of_it), &of_it));
        for case in &of_it {
            let summary = format!("{}, seed {}", case.engine, case.seed);
            let details = Details::new(summary).block(Block::Paragraph { text: found(case) });
            section = section.block(details.block(table(&case.rows, &[case])));
        }
        report = report.section(section);
    }
    cycles::section(heating::section(boost::section(report, results), results), results)
}

/// Controllers that every case has, with means over the cases.
fn mean_rows(cases: &[&Case]) -> Vec<Row> {
    let full: Vec<&&Case> = cases.iter().filter(|c| !c.rows.is_empty()).collect();
    let Some(first) = full.first() else {
        return Vec::new();
    };
    let mean = |row: &Row| {
        let same: Vec<&Row> =
            full.iter().filter_map(|c| c.rows.iter().find(|r| r.name == row.name)).collect();
        let courses = (0..row.courses.len())
            .map(|k| Measures::mean(&same.iter().filter_map(|r| r.courses.get(k)).collect::<Vec<_>>()))
            .collect();
        let setting = if row.setting == "-" { "-" } else { "tuned" };
        Row { setting: setting.into(), courses, ..row.clone() }
    };
    first.rows.iter().map(mean).collect()
}

fn table(rows: &[Row], cases: &[&Case]) -> Table {
    let mut head = vec![
        Column::text("Fuel by"),
        Column::text("Line search"),
        Column::number("its bed time", "s").digits(4),
    ];
    let names = cases.iter().map(|c| &c.courses).find(|c| !c.is_empty());
    for name in names.into_iter().flatten() {
        head.push(Column::number(format!("{name}: integral"), "s").digits(3));
        head.push(Column::number("spike", "").digits(3));
        head.push(Column::number("offset", "").digits(2));
        head.push(Column::number("t90", "s").digits(3));
    }
    rows.iter().fold(Table::new(head), |t, r| {
        let mut cells = vec![r.name.as_str().into(), r.setting.as_str().into(), r.search_s.into()];
        for m in &r.courses {
            cells.extend([m.integral_s, m.spike(), m.offset, m.t90_s].map(Cell::from));
        }
        if r.name == OURS { t.stressed_row(cells) } else { t.row(cells) }
    })
}

/// What was identified, or why nothing was.
fn found(case: &Case) -> String {
    let Some(f) = &case.fuelling else {
        return case.failed.clone().unwrap_or_default();
    };
    let mut text =
        format!("Identified from {:.0} s: film {:.3} and {:.3} s", case.record_s, f.film.share, f.film.tau_s);
    if let Some(l) = &f.coolant {
        let [cold, warm] = l.range_c.map(|t| (t, f.film_at(t)));
        let factor = l.charge_factor(l.range_c[0]) / l.charge_factor(l.range_c[1]);
        text = format!(
            "Identified from {:.0} s: film {:.3} and {:.3} s at {:.0} degC, {:.3} and {:.3} s at {:.0} degC; charge there {:.1} % of that in the middle of speed and pressure",
            case.record_s,
            warm.1.share,
            warm.1.tau_s,
            warm.0,
            cold.1.share,
            cold.1.tau_s,
            cold.0,
            100.0 * factor
        );
    }
    if f.film_ends.is_some() {
        text += "; film in the middle of speed and pressure, it changes over both";
    }
    let trim = f.trim.map_or("no trim".into(), |t| format!("trim in {:.1} s", t.time_s));
    format!(
        "{text}; throttle lag {:.3} s, mixing {:.1} mg of fuel, sensor lag {:.3} s, air {:.0} ms after the command at 2000 rpm, {trim}; 1 / lambda within {:.4}, pressure within {:.2} kPa (root mean square).",
        f.filling.throttle_lag_s,
        f.timing.mixing_fuel,
        f.timing.sensor_lag_s,
        1e3 * f.timing.ahead_s(2000.0),
        f.rms,
        f.pressure_rms_kpa
    )
}
