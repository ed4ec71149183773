//! The page of a steady calibration.

use std::path::Path;

use dynocal_calib::steady::day::{DayPoint, Purpose};
use dynocal_calib::steady::front::{Front, FrontPoint};
use dynocal_calib::steady::grid::CellState;
use dynocal_files::atomic;
use dynocal_report::{
    Axis, Block, Cell as TableCell, Column, Details, HeatMap, Report, Section, Table, XyPlot, XySeries,
    capital, render,
};

use super::cells::{actuators, missed, objective_unit};
use super::error::MapError;
use super::job::Job;
use super::learn::Learned;
use super::reach::channel;
use super::result::{Delivered, Mapped};

mod extras;
mod limits;
use crate::page::PageError;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`MapError::Page`].
pub fn write(found: &Mapped, job: &Job, folder: &Path) -> Result<(), MapError> {
    let html = render(&report(found, job)).map_err(PageError::from)?;
    atomic::write(&folder.join("report.html"), html.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(found: &Mapped, job: &Job) -> Report {
    let minutes = |s: f64| format!("{:.1}", s / 60.0);
    let mut report = Report::new(format!("{}: {}", job.spec.title, found.name))
        .fact("Plant", job.plant())
        .fact("Seed", job.spec.seed.to_string())
        .fact("Bed time [min]", minutes(found.bed.all_s()))
        .verdict(found.verdict.as_str());
    for w in &found.warnings {
        report = report.warning(w.as_str());
    }
    for c in &found.checks {
        report = report.check(c.clone());
    }
    let report = report.section(maps(found)).section(responses(found)).section(cells(found));
    let report = extras::sections(found).into_iter().fold(report, Report::section);
    let traced = found.front.iter().map(|f| front(found, f));
    traced
        .fold(report, Report::section)
        .section(verification(found))
        .section(models(found))
        .section(day(found))
}

/// Grid of the maps: x is the given channel or the only axis, y the demand.
struct Plane {
    x: (Axis, Vec<f64>),
    y: Option<(Axis, Vec<f64>)>,
}

fn plane(found: &Mapped) -> Option<Plane> {
    let axis = |k: usize| {
        let a = found.axes.get(k)?;
        Some((Axis::new(capital(&a.name), a.unit.as_str()), a.points.clone()))
    };
    match found.axes.len() {
        1 => Some(Plane { x: axis(0)?, y: None }),
        _ => Some(Plane { x: axis(1)?, y: axis(0) }),
    }
}

/// A quantity over the cells, those that are no optimum marked.
fn drawn(found: &Mapped, title: &str, z: Axis, values: Vec<f64>) -> Option<Block> {
    let plane = plane(found)?;
    let Some(y) = plane.y else {
        let plot = XyPlot::new(title, plane.x.0, z).line(title, plane.x.1, values);
        return Some(plot.into());
    };
    let mut map = HeatMap::new(title, plane.x, y, (z, values)).contours();
    for (state, label) in [
        (CellState::Filled, "filled"),
        (CellState::Infeasible, "limits conflict"),
        (CellState::Edited, "edited, breaks limits"),
    ] {
        let marked = found.cells.iter().filter(|c| c.state == state);
        let (y, x): (Vec<f64>, Vec<f64>) = marked.map(|c| (c.at[0], c.at[1])).unzip();
        if !x.is_empty() {
            map = map.overlay(label, x, y);
        }
    }
    Some(map.into())
}

fn maps(found: &Mapped) -> Section {
    let mut section = Section::new("Maps").text(
        "Values of the inputs in every cell. Those of inputs that a loop drives are what holds the demand alone, as far as is known:",
    );
    for d in &found.drives {
        section = section.text(d.words());
    }
    if let Some(rest) = &found.rest {
        section = section.text(rest.words());
    }
    section = swept(found, section);
    let all: Vec<Vec<f64>> = found.cells.iter().map(|c| actuators(&found.layout, c)).collect();
    let mut blocks = Vec::new();
    for (k, i) in found.layout.problem.inputs.iter().enumerate() {
        let values = all.iter().map(|v| v[k]).collect();
        blocks.extend(drawn(found, &capital(&i.name), Axis::new(i.name.as_str(), i.unit.as_str()), values));
    }
    for pair in blocks.chunks(2) {
        section = section.columns(pair.to_vec());
    }
    if let Some(d) = &found.delivered {
        section = section.text(delivered(found, d));
    }
    section
}

/// What was measured along the maps, and where they have values between the cells.
fn swept(found: &Mapped, mut section: Section) -> Section {
    if let Some(s) = &found.sweeps {
        section = section.text(format!(
            "{} of {} lines of the maps were gone along on the bed, loops closed: {} windows in {:.1} min.",
            s.whole,
            s.planned,
            s.rows,
            s.bed_s / 60.0
        ));
        if s.again > 0 {
            section = section.text(format!(
                "Parts of {} lines were gone along again, as their maps had become others by what lines showed.",
                s.again
            ));
        }
        if s.at_ends > 0 {
            section = section.text(format!(
                "In {} of the windows an input that a loop drives stood at the end of its range, so that the demand may not have been reached: what was reached there bounds the cells around.",
                s.at_ends
            ));
        }
    }
    let values = |a: &[f64]| a.len();
    let map = &found.map;
    if values(&map.demand) * values(&map.given) > found.cells.len() {
        section = section.text(format!(
            "The maps have {} x {} values: more than cells, where straight lines between these would miss the inputs that loops drive.",
            values(&map.demand),
            values(&map.given)
        ));
    }
    section
}

/// What breakpoints and steps cost, in words.
fn delivered(found: &Mapped, d: &Delivered) -> String {
    let percent = |v: f64| dynocal_report::significant(100.0 * v, 2);
    let mut words = format!(
        "Breakpoints and steps of the ECU: {} of {} cells are kept. At the full cells, between the kept ones, the models expect {} % of change in what is minimised in the mean (less is negative), {} % more at most",
        found.cells.len(),
        d.full_cells,
        percent(d.mean_loss),
        percent(d.largest_loss)
    );
    match &d.passed {
        Some(p) => {
            let by = dynocal_report::significant(p.by, 2);
            words += &format!(
                ", and `{}` passes its limit by {by} {} (the uncertainty of the models counted in).",
                p.response, p.unit
            );
        }
        None => words += ", and all limits are kept.",
    }
    if d.lost_cells > 0 {
        words += &format!(" In {} cells no setting in steps keeps all limits.", d.lost_cells);
    }
    words
}

/// Expected responses over the map with their limits.
fn responses(found: &Mapped) -> Section {
    let mut section = Section::new("Expected responses");
    let mut blocks = Vec::new();
    for (k, r) in found.layout.responses.iter().enumerate() {
        // What is slow had not come to rest in the points: its model expects nothing.
        if r.slow || found.layout.driven().iter().any(|d| found.layout.problem.inputs[*d].name == r.name) {
            continue;
        }
        let values = found.cells.iter().map(|c| c.optimum.responses[k]).collect();
        let limit = match (r.lower, r.upper) {
            (Some(l), Some(u)) => format!(" (limits {l} and {u})"),
            (None, Some(u)) => format!(" (limit {u})"),
            (Some(l), None) => format!(" (at least {l})"),
            (None, None) => String::new(),
        };
        let title = format!("{}{limit}", capital(&r.name));
        let mut block = drawn(found, &title, Axis::new(r.name.as_str(), r.unit.as_str()), values);
        if let Some(Block::HeatMap(map)) = &mut block {
            *map = limits::drawn(found, k, std::mem::take(map));
        }
        blocks.extend(block);
    }
    for pair in blocks.chunks(2) {
        section = section.columns(pair.to_vec());
    }
    section
}

/// Cells with the prices of their limits.
fn cells(found: &Mapped) -> Section {
    let mut head: Vec<Column> =
        found.axes.iter().map(|a| Column::number(capital(&a.name), a.unit.as_str()).digits(4)).collect();
    head.push(Column::text("Cell"));
    head.push(Column::text("Verification next to it"));
    head.push(Column::number("Minimised", objective_unit(found)).digits(4));
    head.push(Column::number("Standard deviation", objective_unit(found)).digits(2));
    head.push(Column::text("Limits that cost, and what one unit of room would save"));
    let mut table = Table::new(head);
    for (c, verified) in found.cells.iter().zip(&found.verified_cells) {
        let mut row: Vec<TableCell> = c.at.iter().map(|v| (*v).into()).collect();
        row.push(match c.state {
            CellState::Optimal if found.edits.iter().any(|e| e.at == c.at) => "held as edited".into(),
            CellState::Optimal => "optimum".into(),
            _ => missed(&found.layout, c).into(),
        });
        row.push(match verified {
            Some(true) => "kept".into(),
            Some(false) => "missed".into(),
            None => TableCell::Empty,
        });
        row.push(c.optimum.objective.into());
        row.push(c.optimum.objective_deviation.into());
        let prices = c.optimum.prices.iter().filter(|p| p.saves > 1e-6 * c.optimum.objective.abs());
        let words: Vec<String> = prices
            .map(|p| {
                let r = channel(&found.layout, p.response);
                let saves = dynocal_report::significant(p.saves, 2);
                format!("{}: {saves} {} per {}", r.name, objective_unit(found), r.unit)
            })
            .collect();
        row.push(if c.state == CellState::Filled { TableCell::Empty } else { words.join("; ").into() });
        table = table.row(row);
    }
    Section::new("Cells")
        .text("A price says what is saved at this cell if the limit is moved by one unit; a limit without one does not act. Verification: whether all verification points that lie next to a cell keep limits and promise.")
        .block(Details::new(format!("{} cells", found.cells.len())).block(table))
}

/// What is minimised against another response.
fn front(found: &Mapped, f: &Front) -> Section {
    let axis = |name: &str, unit: &str| Axis::new(capital(name), unit);
    let unit = objective_unit(found);
    let (x, y): (Vec<f64>, Vec<f64>) = f.points.iter().map(|p| (p.other, p.minimised)).unzip();
    let mut plot = XyPlot::new(
        format!("What is minimised against {}", f.against),
        axis(&f.against, &f.unit),
        axis("minimised", &unit),
    )
    .line("front", x.clone(), y.clone())
    .points("maps", x, y);
    if let Some(t) = &f.taken {
        plot = plot.points("taken", vec![t.other], vec![t.minimised]);
    }
    let head = vec![
        Column::number(capital(&f.against), f.unit.as_str()).digits(4),
        Column::number("Minimised", unit.as_str()).digits(4),
        Column::number("Price", format!("{unit} per {}", f.unit)).digits(3),
    ];
    let cells = |p: &FrontPoint, price: Option<f64>| -> Vec<TableCell> {
        vec![p.other.into(), p.minimised.into(), price.into()]
    };
    // At its end only the other response is minimised: there is no price.
    let n = f.points.len();
    let row = |t: Table, (k, p): (usize, &FrontPoint)| t.row(cells(p, (k + 1 < n).then_some(p.price)));
    let mut table = f.points.iter().enumerate().fold(Table::new(head), row);
    if let Some(t) = &f.taken {
        table = table
            .stressed_row(cells(t, Some(t.price)))
            .caption("The last row is the one that the maps are taken from");
    }
    Section::new("Trade-off")
        .text(format!(
            "Whole maps, means over the cells that hold an optimum. Each keeps all limits; the price says what one {} less of {} costs there, in every cell the same. The models know the neighbourhood of the least objective best: what is far from it is a promise.",
            f.unit, f.against
        ))
        .block(plot)
        .block(table)
}

fn verification(found: &Mapped) -> Section {
    let mut head: Vec<Column> =
        found.axes.iter().map(|a| Column::number(capital(&a.name), a.unit.as_str()).digits(4)).collect();
    head.push(Column::text("Response"));
    head.push(Column::number("Promised", "").digits(4));
    head.push(Column::number("95 % of measurements within +-", "").digits(2));
    head.push(Column::number("Measured", "").digits(4));
    head.push(Column::number("Past its limit", "").digits(2));
    let mut table = Table::new(head);
    let mut notes = Vec::new();
    for v in &found.verified {
        if !v.note.is_empty() {
            notes.push(format!("{:?}: {}", v.at, v.note));
        }
        for d in &v.deviations {
            let mut row: Vec<TableCell> = v.at.iter().map(|x| (*x).into()).collect();
            row.extend([
                d.response.as_str().into(),
                d.promised.into(),
                d.half_width.into(),
                d.measured.into(),
                d.passed.into(),
            ]);
            let out = (d.measured - d.promised).abs() > d.half_width;
            table = if out { table.stressed_row(row) } else { table.row(row) };
        }
    }
    let mut section = Section::new("Verification").text(
        "The maps at operating points between their cells that no model has seen, measured on the bed. What lies outside of its interval stands out; past its limit: negative is room.",
    );
    if !notes.is_empty() {
        section = section.text(notes.join("\n"));
    }
    section.block(table)
}

fn models(found: &Mapped) -> Section {
    let head = vec![
        Column::text("Response"),
        Column::text("Unit"),
        Column::text("Model"),
        Column::number("Error on unseen points (rms)", "").digits(3),
        Column::number("Scatter of the points", "").digits(3),
        Column::number("Explained", "%").digits(4),
    ];
    let mut table = Table::new(head).caption("Each model was chosen and judged by nested folds: the error is that of the whole procedure on points that had no part in it");
    for m in &found.models {
        let row: Vec<TableCell> = vec![
            m.response.as_str().into(),
            m.unit.as_str().into(),
            m.what.as_str().into(),
            m.rmse.into(),
            m.spread.into(),
            (100.0 * m.explained()).into(),
        ];
        table = table.row(row);
    }
    let mut section = Section::new("Response models").block(table);
    for m in &found.models {
        let mut details = Details::new(format!("{}: residuals and sections", m.response)).block(residuals(m));
        for i in &m.page.intersections {
            details = details.block(intersection(m, i));
        }
        if !m.choice.is_empty() {
            details = details.block(Block::Paragraph { text: m.choice.clone() });
        }
        section = section.block(details);
    }
    section
}

fn residuals(m: &Learned) -> XyPlot {
    let axis = |label: &str| Axis::new(label, m.unit.as_str());
    let caption = "Each point predicted from the others (structure and hyperparameters kept).";
    XyPlot::new(
        format!("{}: predicted from the other points", m.response),
        axis("Predicted"),
        axis("Measured"),
    )
    .points("points", m.page.predicted.clone(), m.page.measured.clone())
    .caption(caption)
}

fn intersection(m: &Learned, i: &dynocal_ident::model::response::score::Intersection) -> XyPlot {
    let low: Vec<f64> = i.mean.iter().zip(&i.half_width).map(|(m, h)| m - h).collect();
    let high: Vec<f64> = i.mean.iter().zip(&i.half_width).map(|(m, h)| m + h).collect();
    XyPlot::new(
        format!("{} over {}", m.response, i.input),
        Axis::new(i.input.as_str(), ""),
        Axis::new(m.response.as_str(), m.unit.as_str()),
    )
    .band("95 %", i.x.clone(), low, high)
    .line("model", i.x.clone(), i.mean.clone())
    .caption("Everything else at the median of the points.")
}

/// The day: coverage of the axes, repeats and drift, limits that were touched.
fn day(found: &Mapped) -> Section {
    let minutes = |s: f64| format!("{:.1} min", s / 60.0);
    let mut section = Section::new("The day on the bed").text(format!(
        "Bed time: {} for the gains, {} for the points, {} along the maps, {} for the verification. {} points were measured, {} of them can be used.",
        minutes(found.bed.gains_s),
        minutes(found.bed.points_s),
        minutes(found.bed.sweeps_s),
        minutes(found.bed.verify_s),
        found.points.len(),
        found.points.iter().filter(|p| p.point.usable).count(),
    ));
    if found.axes.len() == 2 {
        section = section.block(coverage(found));
    }
    if !found.drift.is_empty() {
        let head = vec![
            Column::text("Response"),
            Column::text("Unit"),
            Column::number("Mean", "").digits(4),
            Column::number("Scatter of a point", "").digits(2),
            Column::number("Drift per hour", "").digits(2),
            Column::number("Standard error", "").digits(2),
            Column::text("Corrected"),
        ];
        let mut table = Table::new(head).caption("The repeated point");
        for d in &found.drift {
            let row: Vec<TableCell> = vec![
                d.response.as_str().into(),
                d.unit.as_str().into(),
                d.mean.into(),
                d.noise.into(),
                d.per_hour.into(),
                d.per_hour_error.into(),
                (if d.corrected { "yes" } else { "no: not told from scatter" }).into(),
            ];
            table = table.row(row);
        }
        section = section.block(table);
    }
    if !found.rounds.is_empty() {
        section = section
            .text("After the planned points the day follows the expected optimum, batch after batch; each batch first tests what was promised for it.")
            .block(rounds(found));
    }
    section.block(Details::new("Points that were not measured as asked").block(odd(found)))
}

fn coverage(found: &Mapped) -> XyPlot {
    let planned = |p: &DayPoint| matches!(p.purpose, Purpose::Plan | Purpose::Repeat);
    let axis = |k: usize| Axis::new(capital(&found.axes[k].name), found.axes[k].unit.as_str());
    let cloud = |label: &str, keep: &dyn Fn(&&DayPoint) -> bool| {
        let points = found.points.iter().filter(|p| p.point.factors[0].is_finite()).filter(keep);
        let (y, x): (Vec<f64>, Vec<f64>) = points.map(|p| (p.point.factors[0], p.point.factors[1])).unzip();
        XySeries { points: true, ..XySeries::new(label, x, y) }
    };
    let touched = found.points.iter().flat_map(|p| &p.point.touched);
    let (y, x): (Vec<f64>, Vec<f64>) = touched.map(|t| (t.factors[0], t.factors[1])).unzip();
    XyPlot::new("Coverage of the axes", axis(1), axis(0))
        .series(cloud("planned", &|p| planned(p) && p.point.usable))
        .series(cloud("at the expected optimum", &|p| p.purpose == Purpose::Optimum && p.point.usable))
        .series(cloud("not used", &|p| !p.point.usable))
        .series(cloud("verification", &|p| p.purpose == Purpose::Verify && p.point.usable))
        .series(XySeries { points: true, ..XySeries::new("a limit was touched on the way", x, y) })
}

fn rounds(found: &Mapped) -> Table {
    let head = vec![
        Column::number("Bed time", "min").digits(3),
        Column::number("Points", "").digits(4),
        Column::number("Usable", "").digits(4),
        Column::number("Cells to be reached yet", "").digits(4),
        Column::number("Error of the promise, rms", "%").digits(2),
        Column::number("Mean", "%").digits(2),
        Column::number("The optimum may lie below the map by", objective_unit(found)).digits(2),
        Column::number("Interval of the map", objective_unit(found)).digits(2),
    ];
    found.rounds.iter().fold(Table::new(head).caption("Batches at the expected optimum"), |t, r| {
        t.row(vec![
            (r.at_s / 60.0).into(),
            (r.points as f64).into(),
            (r.usable as f64).into(),
            (r.untried as f64).into(),
            r.error.map(|e| 100.0 * e).into(),
            r.bias.map(|e| 100.0 * e).into(),
            r.left.map(|l| l.gain).into(),
            r.left.map(|l| l.interval).into(),
        ])
    })
}

fn odd(found: &Mapped) -> Table {
    let head = vec![
        Column::number("Bed time", "s").digits(5),
        Column::text("Used"),
        Column::text("Note"),
        Column::text("Limits on the way"),
        Column::text("At the end of its range"),
    ];
    let strange = |p: &&DayPoint| !p.point.note.is_empty() || !p.point.saturated.is_empty();
    found.points.iter().filter(strange).fold(Table::new(head), |t, p| {
        let touched: Vec<&str> = p.point.touched.iter().map(|t| t.output.as_str()).collect();
        let row: Vec<TableCell> = vec![
            p.point.at_s.into(),
            (if p.point.usable { "yes" } else { "no" }).into(),
            p.point.note.as_str().into(),
            touched.join(", ").into(),
            p.point.saturated.join(", ").into(),
        ];
        t.row(row)
    })
}
