//! The page.

use dynocal_report::{Cell, Column, Report, Section, Table};

use super::{Case, OUTPUTS, cases, gain_error_calmer_db, gain_error_db, page_figures, phase_error_deg};
use crate::TaskResult;

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let all = cases(results);
    let mut report = report.section(promised(&all)).section(models(&all)).section(published(&all));
    for c in &all {
        if let Some(f) = &c.figures {
            report = report.section(page_figures::section(&c.engine, f));
        }
    }
    let drives = super::driven(results);
    if !drives.is_empty() {
        report = report.section(page_figures::drives(&drives));
    }
    report.section(page_figures::worth(&super::worths(results)))
}

fn promised(all: &[Case]) -> Section {
    let head = vec![
        Column::text("Bed"),
        Column::text("Loop"),
        Column::number("kp", "").digits(4),
        Column::number("ki", "1/s").digits(4),
        Column::number("Gain margin, model", "").digits(4),
        Column::number("half of its interval", "dB").digits(2),
        Column::number("engine", "").digits(4),
        Column::number("difference", "dB").digits(3),
        Column::number("with a quarter of the scatter", "dB").digits(3),
        Column::number("Delay margin, model", "s").digits(4),
        Column::number("engine", "s").digits(4),
        Column::number("difference", "deg").digits(3),
        Column::number("Ms, model", "").digits(4),
    ];
    let mut table = Table::new(head);
    for c in all {
        for (l, o) in c.loops.iter().zip(OUTPUTS) {
            table = table.row(vec![
                Cell::from(c.engine.as_str()),
                o.into(),
                l.kp.into(),
                l.ki.into(),
                Cell::from(l.promised.gain_up),
                l.half_db.into(),
                Cell::from(l.gain_measured),
                Cell::from(gain_error_db(l)),
                Cell::from(gain_error_calmer_db(l)),
                Cell::from(l.promised.delay_s),
                Cell::from(l.delay_measured_s),
                Cell::from(phase_error_deg(l)),
                l.promised.sensitivity.into(),
            ]);
        }
    }
    Section::new("Promised and measured margins")
        .text("Each loop with the other closed, about the engine behind its inverted steady gains. The model is that of a test under rough loops whose gains were raised in turns; the test grew until nine tenths of the draws of its model agreed about both gain margins to 1 dB, or to its greatest length. On the engine the gain or the delay of one loop grows until what a kick of its error does not fade within forty seconds (two runs with the same scatter, one with the kick), or its output scatters ten times as much as with the nominal loops; actuators have their limits, sensors their noise. A loop near its margin makes the scatter of the combustion large, and from some size on the engine falls into a cycle of its actuators' whole range: that ends a margin before the linear one does, and the column with a quarter of the scatter says by how much.")
        .block(table)
}

fn models(all: &[Case]) -> Section {
    let head = vec![
        Column::text("Bed"),
        Column::text("Output"),
        Column::text("Orders of A and B"),
        Column::number("Test", "s").digits(3),
        Column::number("Free run on the half that chose them", "%").digits(4),
        Column::number("Steady gain of throttle", "1/deg").digits(4),
        Column::number("of fuel", "1/mg").digits(4),
        Column::number("Relative gain", "").digits(3),
    ];
    let mut table = Table::new(head);
    for c in all {
        for (k, o) in OUTPUTS.iter().enumerate() {
            let orders = c.orders.get(k).map_or("-".into(), |(a, b)| format!("{a}, {b}"));
            table = table.row(vec![
                Cell::from(c.engine.as_str()),
                (*o).into(),
                orders.as_str().into(),
                c.test_s.into(),
                Cell::from(c.fits.get(k).copied()),
                Cell::from(c.steady.get(2 * k).copied()),
                Cell::from(c.steady.get(2 * k + 1).copied()),
                c.relative_gain.into(),
            ]);
        }
    }
    Section::new("Models")
        .text("More fuel makes lambda smaller: the gain from fuel is negative. The published gains are positive because they act on the demand of lambda before a map, which turns the sign.")
        .block(table)
}

fn published(all: &[Case]) -> Section {
    let head = vec![
        Column::text("Bed"),
        Column::text("Gains"),
        Column::text("Loop"),
        Column::text("Stable"),
        Column::number("Gain margin", "").digits(4),
        Column::number("Phase margin", "deg").digits(4),
    ];
    let mut table = Table::new(head);
    for c in all {
        for j in &c.published {
            table = table.row(vec![
                Cell::from(c.engine.as_str()),
                j.equation.as_str().into(),
                j.output.as_str().into(),
                if j.stable { "yes" } else { "no" }.into(),
                Cell::from(j.gain_margin),
                Cell::from(j.phase_deg),
            ]);
        }
    }
    Section::new("Published gains on these engines")
        .text("Gains of the thesis, each loop alone, on the identified models behind their inverted steady gains. They were made for another engine with another map.")
        .block(table)
}
