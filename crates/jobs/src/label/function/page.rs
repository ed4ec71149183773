//! The page of a fitted function.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_label::label::Label;
use dynocal_label::linear::Verdict;
use dynocal_label::ve::judge::Decision;
use dynocal_report::{Axis, Cell, Check, Column, HeatMap, Report, Section, Table, XyPlot, render};

use super::work::Fitted;
use crate::page::PageError;

/// Most points of a plot.
const DRAWN: usize = 4000;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(found: &Fitted, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(found))?.as_bytes())?;
    Ok(())
}

fn report(found: &Fitted) -> Report {
    let mut report = Report::new(format!("Labels: {}", found.name));
    for text in &found.verdict {
        report = report.verdict(text.as_str());
    }
    for text in &found.warnings {
        report = report.warning(text.as_str());
    }
    report = report.check(
        Check::new("unseen", "what the labels leave of later, unseen samples (root mean square)")
            .asked(format!("not above {:.4}", found.unseen_rms[0]))
            .measured(found.unseen_rms[1])
            .unit("")
            .holds(found.decision != Decision::Refuse)
            .note("the demand is the base; a loss counts where it is more than its standard error explains"),
    );
    report = report.section(cells(found));
    if found.labels.iter().any(|l| !l.axes.is_empty()) {
        report = report.section(shapes(found));
    }
    if !found.chosen.is_empty() {
        report = report.section(chosen(found));
    }
    report.section(rows(found)).section(plot(found)).section(left(found))
}

/// Curves and maps before and after.
fn shapes(found: &Fitted) -> Section {
    let mut section = Section::new("Curves and maps");
    if !found.fitted_axes.is_empty() {
        section = section.text(
            "Breakpoints that were fitted with the labels are shown as a curve over what they were; labels on them stand over the new ones, \
             with what the base has there as \"before\".",
        );
    }
    let mut from = 0;
    for l in &found.labels {
        let cells = from..from + l.len();
        let (values, half) = (&found.fit.values[cells.clone()], &found.half_width[cells]);
        section = match l.axes.len() {
            1 => section.block(curve(l, values, half)),
            2 => maps(section, l, values, half),
            _ => section,
        };
        from += l.len();
    }
    section
}

fn curve(l: &Label, values: &[f64], half: &[Option<f64>]) -> XyPlot {
    let (x, a) = (l.axes[0].points.clone(), &l.axes[0]);
    let band = |s: f64| values.iter().zip(half).map(|(v, h)| v + s * h.unwrap_or(0.0)).collect::<Vec<f64>>();
    XyPlot::new(
        l.name.as_str(),
        Axis::new(a.name.as_str(), a.unit.as_str()),
        Axis::new(l.name.as_str(), l.unit.as_str()),
    )
    .band("95 % interval", x.clone(), band(-1.0), band(1.0))
    .line("before", x.clone(), l.base.clone())
    .line("fitted", x, values.to_vec())
}

fn maps(section: Section, l: &Label, values: &[f64], half: &[Option<f64>]) -> Section {
    let map = |title: String, unit: &str, v: Vec<f64>| {
        let axis = |k: usize| {
            let a = &l.axes[k];
            (Axis::new(a.name.as_str(), a.unit.as_str()), a.points.clone())
        };
        // Three digits can be read in a cell.
        let short = |x: f64| format!("{x:.2e}").parse().unwrap_or(x);
        let v: Vec<f64> = v.into_iter().map(short).collect();
        HeatMap::new(title.clone(), axis(0), axis(1), (Axis::new(title, unit), v)).cell_values()
    };
    let both = || l.base.iter().chain(values).copied();
    let (low, high) = (both().fold(f64::INFINITY, f64::min), both().fold(f64::NEG_INFINITY, f64::max));
    let change: Vec<f64> = values.iter().zip(&l.base).map(|(a, b)| a - b).collect();
    let half = half.iter().map(|h| h.unwrap_or(f64::NAN)).collect();
    section
        .block(map(format!("{}, before", l.name), &l.unit, l.base.clone()).range(low, high))
        .block(map(format!("{}, fitted", l.name), &l.unit, values.to_vec()).range(low, high))
        .block(map(format!("{}, difference", l.name), &l.unit, change).diverging())
        .block(map(format!("{}, half width of the 95 % interval", l.name), &l.unit, half))
}

/// Axes that were placed, with what fewer breakpoints would lose.
fn chosen(found: &Fitted) -> Section {
    let text = "Of all choices of so many of the breakpoints, the one between which straight lines lose least (dynamic programming; \
                two axes in turns), in shares of the range of each label. The values there were fitted anew.";
    let mut section = Section::new("Axes").text(text);
    for c in &found.chosen {
        let points = c.points.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        section = section.text(format!(
            "{}: {} of {} breakpoints ({points}), for {}.",
            c.name,
            c.points.len(),
            c.had,
            c.labels.join(", ")
        ));
        if let Some([before, after]) = c.moved {
            section = section.text(format!(
                "Moved between their neighbours they lose {:.3} % in place of {:.3} %.",
                100.0 * after,
                100.0 * before
            ));
        }
        let (x, y): (Vec<f64>, Vec<f64>) = c.loss.iter().map(|(n, e)| (*n as f64, 100.0 * e)).unzip();
        section = section.block(
            XyPlot::new(
                format!("{}: loss of coarser axes", c.name),
                Axis::new("Breakpoints", "-"),
                Axis::new("Lost, root mean square", "%"),
            )
            .line("best choice", x, y),
        );
    }
    section
}

/// Rows of the criterion on unseen samples.
fn rows(found: &Fitted) -> Section {
    let mut table = Table::new(vec![
        Column::text("Node"),
        Column::text("Channel"),
        Column::number("Base, unseen rms", "").digits(4),
        Column::number("Fitted, unseen rms", "").digits(4),
    ]);
    for (node, channel, before, after) in &found.rows {
        table =
            table.row(vec![node.as_str().into(), channel.as_str().into(), (*before).into(), (*after).into()]);
    }
    Section::new("Rows of the criterion").block(table)
}

/// What is left over time and over each quantity that enters a label.
fn left(found: &Fitted) -> Section {
    let all = &found.left;
    let every = all.residual.len().div_ceil(DRAWN).max(1);
    let thin = |v: &[f64]| v.iter().copied().step_by(every).collect::<Vec<f64>>();
    let time = ("Time".to_string(), "s".to_string());
    let mut section = Section::new("What is left")
        .text("Measured less function, on the samples of the first record that count.");
    for ((name, unit), column) in std::iter::once(&time).chain(&all.over).zip(&all.columns) {
        section = section.block(
            XyPlot::new(
                format!("over {name}"),
                Axis::new(name.as_str(), unit.as_str()),
                Axis::new("left", ""),
            )
            .points("samples", thin(column), thin(&all.residual)),
        );
    }
    section
}

fn cells(found: &Fitted) -> Section {
    let head = vec![
        Column::text("Label"),
        Column::text("Unit"),
        Column::text("Cell"),
        Column::text("Verdict"),
        Column::number("Before", ""),
        Column::number("Fitted", ""),
        Column::number("Half width, 95 %", ""),
        Column::number("Independent measurements", "").digits(3),
    ];
    let mut table = Table::new(head);
    let mut at = 0;
    for l in &found.labels {
        let nx = l.axes.first().map_or(1, |a| a.points.len());
        for k in 0..l.len() {
            let place = match l.axes.as_slice() {
                [] => "-".to_string(),
                [x] => format!("{}", x.points[k]),
                [x, y, ..] => format!("{}, {}", x.points[k % nx], y.points[k / nx]),
            };
            let verdict = match found.fit.verdicts[at] {
                Verdict::Determined => "determined",
                Verdict::Pulled => "pulled",
                Verdict::Untouched => "untouched",
                Verdict::Locked => "locked",
                Verdict::Open => "open",
            };
            table = table.row(vec![
                Cell::from(l.name.as_str()),
                l.unit.as_str().into(),
                place.into(),
                verdict.into(),
                l.base[k].into(),
                found.fit.values[at].into(),
                Cell::from(found.half_width[at]),
                found.fit.facts[at].into(),
            ]);
            at += 1;
        }
    }
    let text = "Determined: one independent measurement at the cell itself or more, and they outweigh what ties it to its neighbours and its \
                base. Pulled: these say more than the data. Untouched: no sample depends on it; the base stays (unless samples led away from it, which is warned of), or follows where limits between cells take it along. Open: known only together with other \
                cells. Intervals hold what noise does, and not what a smoothness that was given bends. Labels that act together may each be \
                uncertain where their sum is known: that is in the intervals.";
    Section::new("Labels").text(text).block(table)
}

fn plot(found: &Fitted) -> Section {
    let [time, target, function] = &found.drawn;
    let every = time.len().div_ceil(DRAWN).max(1);
    let thin = |v: &[f64]| v.iter().copied().step_by(every).collect::<Vec<f64>>();
    Section::new("Function").text("Of the first record, masked samples included.").block(
        XyPlot::new(found.target.as_str(), Axis::new("Time", "s"), Axis::new(found.target.as_str(), ""))
            .line("measured", thin(time), thin(target))
            .line("function", thin(time), thin(function)),
    )
}
