//! The page of a control job.

use std::path::Path;

use dynocal_control::margin::Margins;
use dynocal_control::tune::Tuned;
use dynocal_files::atomic;
use dynocal_report::{
    Axis, Cell, Column, HeatMap, Panel, Report, Role, Section, Table, TimePlot, XyPlot, XySeries, render,
};

use super::picture::{Bode, LoopPicture, Plane};
use super::result::{Controlled, LoopResult};
use crate::page::PageError;

/// Most set points whose curves are drawn.
const DRAWN: usize = 8;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(found: &Controlled, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(found))?.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(found: &Controlled) -> Report {
    let mut report = Report::new(format!("Control: {}", found.name));
    for line in &found.verdict {
        report = report.verdict(line.as_str());
    }
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    report = report.section(together(found));
    if !found.measured.is_empty() {
        report = report.section(super::page_records::section(found));
    }
    for (k, (l, p)) in found.loops.iter().zip(&found.picture.loops).enumerate() {
        report = report.section(one_loop(found, k, l, p));
    }
    if found.loops.iter().any(|l| l.predictor.is_some()) {
        report = report.section(predictors(found));
    }
    if !found.schedule.is_empty() {
        report = report.section(schedule(found));
    }
    report = report.section(super::page_disks::section(found));
    if found.loops.len() > 1 {
        report = report.section(interaction(found));
        if let Some(d) = &found.decoupler {
            report = report.section(super::page_records::decoupler(found, d));
        }
    }
    report.section(runs(found))
}

/// Cells of margins.
fn cells(m: &Margins) -> Vec<Cell> {
    vec![
        Cell::from(m.gain_up),
        Cell::from(m.phase_deg),
        Cell::from(m.delay_s),
        m.sensitivity.into(),
        m.complementary.into(),
    ]
}

fn columns() -> Vec<Column> {
    vec![
        Column::number("Gain margin", "").digits(4),
        Column::number("Phase margin", "deg").digits(4),
        Column::number("Delay margin", "s").digits(4),
        Column::number("Ms", "").digits(4),
        Column::number("Mt", "").digits(4),
    ]
}

fn together(found: &Controlled) -> Section {
    let mut head = vec![Column::text("Set point"), Column::text("Loop")];
    head.extend(columns());
    head.push(Column::number("Disk margin, outputs", "").digits(4));
    head.push(Column::number("Asked over had, nominal", "").digits(3));
    head.push(Column::number("with draws", "").digits(3));
    let mut table = Table::new(head);
    for t in &found.together {
        for (m, l) in t.loops.iter().zip(&found.loops) {
            let mut row = vec![Cell::from(t.point.as_str()), l.output.as_str().into()];
            row.extend(cells(m));
            row.extend([
                Cell::from(t.outputs.as_ref().map(|d| d.alpha)),
                Cell::from(t.violation_nominal),
                Cell::from(t.violation),
            ]);
            table =
                if t.violation.is_some_and(|v| v <= 1.0) { table.row(row) } else { table.stressed_row(row) };
        }
        if t.loops.is_empty() {
            let mut row = vec![Cell::from(t.point.as_str()), t.stable.as_str().into()];
            row.extend((0..8).map(|_| Cell::from(None::<f64>)));
            table = table.stressed_row(row);
        }
    }
    let a = &found.asked;
    let others = if found.loops.len() > 1 { ", each loop with the others closed" } else { "" };
    Section::new("What the gains keep")
        .text(format!(
            "Asked: gain margin {}, phase margin {} deg, delay margin {} s, Ms at most {}{}. Margins of the nominal models{others}; an empty cell is a margin that is never used up. Asked over had is the largest ratio of all margins: 1 is just kept.",
            a.gain_margin,
            a.phase_margin_deg,
            a.delay_margin_s,
            a.sensitivity,
            if found.disk_margin_asked > 0.0 { format!(", disk margin {}", found.disk_margin_asked) } else { String::new() }
        ))
        .block(table)
}

fn one_loop(found: &Controlled, k: usize, l: &LoopResult, p: &LoopPicture) -> Section {
    let mut section = Section::new(format!("{} by {}", l.output, l.input))
        .text("The loop on its own channel, the others open. Rules give the smallest gains that they have over the set points; margins are the least over them. A row in bold misses a margin that is asked. Beside a predictor all settling times count its delay.")
        .block(rules(l));
    if let Some(plane) = &p.plane {
        section = section.block(plane_map(l, plane));
        section = section.block(loci(l, plane));
    }
    section = match steps(found, k, l) {
        Some(plot) => section.block(plot),
        None => section.text("A step of the demand is not drawn: at no set point could it be run, its delay being no whole number of samples or far shorter than its lag."),
    };
    section.block(bode(found, &p.bode, true)).block(bode(found, &p.bode, false))
}

fn rules(l: &LoopResult) -> Table {
    let mut head = vec![
        Column::text("Gains"),
        Column::number("kp", "").digits(4),
        Column::number("ki", "1/s").digits(4),
    ];
    let derivative = l.rules.iter().any(|t| t.kd != 0.0);
    if derivative {
        head.push(Column::number("kd", "s").digits(4));
        head.push(Column::number("its filter", "s").digits(4));
    }
    head.extend(columns());
    head.push(Column::number("Settles within", "s").digits(4));
    head.push(Column::number("Overshoot", "%").digits(3));
    head.push(Column::number("Asked over had", "").digits(3));
    l.rules.iter().fold(Table::new(head), |table, t| {
        let mut row = vec![Cell::from(t.rule.as_str()), (t.kp * l.sign).into(), (t.ki * l.sign).into()];
        if derivative {
            row.extend([(t.kd * l.sign).into(), t.filter_s.into()]);
        }
        row.extend(least(t));
        row.extend([Cell::from(t.settling_s), (100.0 * t.overshoot).into(), Cell::from(t.violation)]);
        if t.violation.is_some_and(|v| v <= 1.0) { table.row(row) } else { table.stressed_row(row) }
    })
}

/// The least margins over the set points; empty where one is not stable.
fn least(t: &Tuned) -> Vec<Cell> {
    if t.margins.iter().any(Option::is_none) {
        return (0..5).map(|_| Cell::from(None::<f64>)).collect();
    }
    let all: Vec<&Margins> = t.margins.iter().flatten().collect();
    let of = |part: &dyn Fn(&Margins) -> Option<f64>| {
        let v = all.iter().filter_map(|m| part(m)).fold(f64::INFINITY, f64::min);
        Cell::from(v.is_finite().then_some(v))
    };
    let most = |part: &dyn Fn(&Margins) -> f64| Cell::from(all.iter().map(|m| part(m)).fold(0.0, f64::max));
    vec![
        of(&|m| m.gain_up),
        of(&|m| m.phase_deg),
        of(&|m| m.delay_s),
        most(&|m| m.sensitivity),
        most(&|m| m.complementary),
    ]
}

fn plane_map(l: &LoopResult, p: &Plane) -> HeatMap {
    let (kp, ki) = (l.rules.first().map_or(0.0, |t| t.kp), l.rules.first().map_or(0.0, |t| t.ki));
    let most = 2.0;
    let shown: Vec<f64> = p.ratio.iter().map(|v| if v.is_nan() { *v } else { v.min(most) }).collect();
    let z = Axis::new("asked over had", "");
    HeatMap::new(
        "Plane of the gains: asked over had",
        (Axis::new(format!("kp x {}", l.sign), ""), p.kp_values.clone()),
        (Axis::new(format!("ki x {}", l.sign), "1/s"), p.ki_values.clone()),
        (z, shown),
    )
    .contours()
    .overlay("gains", [kp], [ki])
    .caption("The largest ratio over all set points that the search saw: up to 1 everything is kept; values above 2 are drawn as 2; where nothing is drawn a set point is not stable. The point is that which settles fastest among those that keep everything.")
}

fn loci(l: &LoopResult, p: &Plane) -> XyPlot {
    let plot = XyPlot::new(
        format!("Loci of constant margins at {}", p.point),
        Axis::new(format!("kp x {}", l.sign), ""),
        Axis::new(format!("ki x {}", l.sign), "1/s"),
    )
    .caption("The set point with the largest Ms, its delay exact, with the derivative part where there is one, a predictor's delay left out as the predictor does; 0 dB is the boundary of stability. Without a derivative part the region of a margin is the part below its locus; a derivative part that stays as it is while kp and ki move bends the loci of 6 and 12 dB away from that, and only the boundary of stability bounds. That of Ms is inside its own. The delay margin that is drawn is the one that is asked, else that of the gains.");
    // The first is the boundary of stability.
    let curve = |k: usize, name: &str| {
        let (_, x, y) = &p.loci[k];
        let role = if k == 0 { Role::Limit } else { Role::Other };
        XySeries { line: true, ..XySeries::new(name, x.clone(), y.clone()) }.role(role)
    };
    let plot = p.loci.iter().enumerate().fold(plot, |plot, (k, (name, _, _))| plot.series(curve(k, name)));
    let (kp, ki) = (l.rules.first().map_or(0.0, |t| t.kp), l.rules.first().map_or(0.0, |t| t.ki));
    plot.points("gains", [kp], [ki])
}

/// None where no set point has a run.
fn steps(found: &Controlled, k: usize, l: &LoopResult) -> Option<TimePlot> {
    let points = &found.picture.steps[k];
    let rows = points.iter().flatten().map(Vec::len).max().filter(|rows| *rows > 0)?;
    let mut plot =
        TimePlot::sampled(format!("Step of the demand of {}", l.output), found.picture.step_s, rows);
    for (o, other) in found.loops.iter().enumerate() {
        let mut panel = Panel::new(other.output.as_str(), "share of the step");
        if o == k {
            panel = panel.level("demand", 1.0);
        }
        for (name, y) in found.points.iter().zip(points).take(DRAWN) {
            if let Some(y) = y.get(o) {
                panel = panel.line(name.as_str(), y.clone());
            }
        }
        plot = plot.panel(panel);
    }
    if points.iter().any(Vec::is_empty) {
        plot = plot.caption("Set points whose delay is no whole number of samples have no run.");
    } else if points.len() > DRAWN {
        plot = plot.caption(format!("The first {DRAWN} of {} set points, all loops closed.", points.len()));
    } else {
        plot = plot.caption("Linear models of the set points, all loops closed, no limits of actuators.");
    }
    Some(plot)
}

fn bode(found: &Controlled, curves: &[Bode], size: bool) -> XyPlot {
    let (title, y) = if size {
        ("Size of the channel", Axis::new("size", "dB"))
    } else {
        ("Phase of the channel", Axis::new("phase", "deg"))
    };
    let plot = XyPlot::new(title, Axis::new("log10 of the frequency in rad/s", ""), y);
    found.points.iter().zip(curves).take(DRAWN).fold(plot, |plot, (name, b)| {
        let x: Vec<f64> = b.w_rad_s.iter().map(|w| w.log10()).collect();
        plot.line(name.as_str(), x, if size { b.size_db.clone() } else { b.phase_deg.clone() })
    })
}

fn predictors(found: &Controlled) -> Section {
    let head = vec![
        Column::text("Loop"),
        Column::number("Predicted delay", "s").digits(4),
        Column::number("Delay may be longer by", "s").digits(4),
        Column::number("shorter by", "s").digits(4),
        Column::number("Gain of the plant from", "").digits(3),
        Column::number("to", "").digits(3),
    ];
    let rows = found.loops.iter().filter_map(|l| Some((l, l.predictor.as_ref()?)));
    let table = rows.fold(Table::new(head), |t, (l, p)| {
        t.row(vec![
            Cell::from(l.output.as_str()),
            p.delay_s.into(),
            Cell::from(p.above_s),
            Cell::from(p.below_s.map(|d| -d)),
            p.gain.0.into(),
            p.gain.1.into(),
        ])
    });
    Section::new("Smith predictors")
        .text("The loop without the delay decides the gains; the predictor gives the same answer one delay later as long as its model is right. The intervals are the least over the set points and end where stability is first lost: beyond, there may be islands in which the loop is stable again, and they count for nothing. An empty cell is an end that was not reached. Gains are looked at from 0.1 to 10. In the table of the loop the retuned PI stands beside: it sees the whole delay, the others only what is left.")
        .block(table)
}

fn schedule(found: &Controlled) -> Section {
    let mut head = vec![Column::text("Set point")];
    for l in &found.loops {
        head.push(Column::number(format!("kp of {}", l.output), "").digits(4));
        head.push(Column::number(format!("ki of {}", l.output), "1/s").digits(4));
    }
    let table = found.points.iter().enumerate().fold(Table::new(head), |t, (k, p)| {
        let mut row = vec![Cell::from(p.as_str())];
        row.extend(found.loops.iter().flat_map(|l| {
            let g = l.by_point.get(k).copied();
            [Cell::from(g.map(|g| g.0)), Cell::from(g.map(|g| g.1))]
        }));
        t.row(row)
    });
    Section::new("Gains over the operating range")
        .text(format!(
            "Each set point has its own gains, maps over {} in controller.json and rows of gains_by_point.csv, where `point` is the place in this table. Margins are those of each point with its own gains held: between points, and while the point moves, nothing is proved.",
            found.schedule.join(" and ")
        ))
        .block(table)
}

fn interaction(found: &Controlled) -> Section {
    let mut head = vec![Column::text("Set point")];
    for o in &found.loops {
        head.extend(
            found.loops.iter().map(|i| Column::number(format!("{} by {}", o.output, i.input), "").digits(3)),
        );
    }
    let table = found.points.iter().zip(&found.relative_gains).fold(Table::new(head), |t, (p, r)| {
        let n = found.loops.len() * found.loops.len();
        let mut row = vec![Cell::from(p.as_str())];
        row.extend((0..n).map(|k| Cell::from(r.as_ref().map(|r| r[k]))));
        t.row(row)
    });
    Section::new("Relative gains at rest")
        .text("1: a loop sees the same plant whether the others are open or closed; negative: closing the others turns its sign.")
        .block(table)
}

fn runs(found: &Controlled) -> Section {
    let head = vec![
        Column::text("Set point"),
        Column::text("Run"),
        Column::text("Should be"),
        Column::number("Growth", "ln").digits(3),
        Column::text("Does"),
    ];
    let table = found.checks.iter().fold(Table::new(head), |t, c| {
        let should = if c.expected_stable { "stable" } else { "unstable" };
        let row = vec![
            Cell::from(c.point.as_str()),
            c.what.as_str().into(),
            should.into(),
            c.growth.into(),
            if c.holds { "as it should" } else { "not as it should" }.into(),
        ];
        if c.holds { t.row(row) } else { t.stressed_row(row) }
    });
    Section::new("Margins as runs")
        .text("The tightest set point in time, independent of frequencies: what a pulse leaves shrinks (negative growth) or grows over the second half of the run. Gain, phase or delay is put into one loop with the others closed; a phase as a pair of real and imaginary part, exact at all frequencies; of a delay what is less than a sample by an all-pass that is late by it at the frequency of the margin, or whole samples. Disks are run with the perturbation that was found.")
        .block(table)
}
