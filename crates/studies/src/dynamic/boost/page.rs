//! The section of the page.

use super::contest::{OURS, Row, TIPS};
use super::control::Setting;
use super::{TipCase, cases};
use crate::TaskResult;
use dynocal_report::{Block, Column, Details, Report, Section, Table};

const WORDS: &str = "Tip-in and tip-out on the real bed. All controllers share steady points, throttle and the rules of a production ECU; \
    ours also sets the wastegate while no boost is asked for and the cams while boost is missing, by repeated tip-ins. t90: until 90 % of the \
    way of the true torque; integral: of |lambda - 1| over 6 s, mean of tip-in and tip-out; CO, HC and NO before the catalyst, first 4 s of both.";

pub(in super::super) fn section(report: Report, results: &[TaskResult]) -> Report {
    let all = cases(results);
    if all.is_empty() {
        return report;
    }
    let mut section = Section::new("Boosted engine: tip-in and tip-out").text(WORDS);
    for (k, case) in all.iter().enumerate() {
        let mut details = Details::new(format!("{}, seed {}", case.boosted, case.seed));
        details = details.block(Block::Paragraph { text: found(case) });
        if let Some(f) = &case.found {
            if k == 0 {
                section = section.block(table(&f.rows));
            } else {
                details = details.block(table(&f.rows));
            }
        }
        section = section.block(details);
    }
    report.section(section)
}

fn table(rows: &[Row]) -> Table {
    let mut head = vec![Column::text("Controller"), Column::text("Line search")];
    for (speed, _) in TIPS {
        head.push(Column::number(format!("{speed} rpm: t90"), "s").digits(3));
        head.push(Column::number("overshoot", "").digits(2));
        head.push(Column::number("knock", "").digits(3));
        head.push(Column::number("largest |lambda - 1|", "").digits(2));
        head.push(Column::number("integral", "s").digits(3));
        head.push(Column::number("CO + HC", "g").digits(3));
        head.push(Column::number("fuel per work", "g/kWh").digits(4));
    }
    rows.iter().fold(Table::new(head), |t, r| {
        let mut cells = vec![r.name.as_str().into(), r.words.as_str().into()];
        for m in &r.tips {
            let values = [m.t90_s, m.overshoot, m.knock, m.lambda, m.integral_s, m.co_hc_g, m.fuel_g_kwh];
            cells.extend(values.map(Into::into));
        }
        if r.name == OURS { t.stressed_row(cells) } else { t.row(cells) }
    })
}

fn set(s: &Setting) -> String {
    let rest = s.rest_mm.map_or("by its map".into(), |mm| format!("{mm} mm"));
    let [intake, exhaust] = s.build_deg;
    format!(
        "retard {} deg, wastegate at rest {rest}, cams moved by {intake} and {exhaust} deg while boost is missing",
        s.retard_deg
    )
}

fn found(case: &TipCase) -> String {
    let Some(f) = &case.found else {
        return case.failed.clone().unwrap_or_default();
    };
    format!(
        "Steady points {:.0} s of bed, records {:.0} s, searches of ours {:.0} s, of the rivals' retard {:.0} s. Rivals: {}. Ours: {}. Identified: 1 / lambda within {:.4}, pressure within {:.2} kPa (root mean square).",
        f.steady_s,
        f.record_s,
        f.search_s[1],
        f.search_s[0],
        set(&f.production),
        set(&f.ours),
        f.fuelling.rms,
        f.fuelling.pressure_rms_kpa
    )
}
