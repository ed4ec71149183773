//! The page of a map or of full load.

use dynocal_plant::full_load::LoadPoint;
use dynocal_report::{Axis, Block, Cell, Column, HeatMap, Report, Section, Table, XyPlot, with_unit};

use super::{Loaded, Spec, What, held_by, point};
use crate::engine::quantities::{Quantity, find};

/// What a map shows: title and column.
const MAPS: [(&str, &str); 6] = [
    ("BSFC", "bsfc"),
    ("Spark", "spark"),
    ("Exhaust temperature", "egt"),
    ("Residual", "residual"),
    ("NO", "no"),
    ("Knock integral", "knock"),
];
/// What full load shows over speed.
const CURVES: [&str; 11] =
    ["torque", "map", "exhaust", "turbo", "spark", "ca50", "knock", "lambda", "egt", "bsfc", "pmax"];

/// The page.
pub fn report(spec: &Spec, set: &str, found: &Loaded) -> Report {
    let title = match spec.what {
        What::Map { .. } => "Engine: map",
        What::FullLoad { .. } => "Engine: full load",
    };
    let report = Report::new(title).subtitle(format!("Virtual engine, parameter set {set}"));
    let report = found.warnings.iter().fold(report, |r, w| r.warning(w.as_str()));
    match spec.what {
        What::Map { .. } => map(report, found),
        What::FullLoad { .. } => report.section(full_load(set, found)),
    }
}

fn map(report: Report, found: &Loaded) -> Report {
    let missed = found.rows.iter().flatten().filter(|p| !p.reached).count();
    let mut section = Section::new("Maps").text(
        "Cells are empty where the limits do not allow the torque, those of BSFC also where there is no brake power; the line of full load is the torque that was held where more was asked. Spark, boost and mixture as a controller holds them.",
    );
    let (mut flat, mut none) = (Vec::new(), Vec::new());
    for (title, name) in MAPS {
        let Some(q) = find(name) else { continue };
        if found.points().iter().all(|p| (q.value)(p).is_nan()) {
            none.push(title);
            continue;
        }
        match same_everywhere(q, found) {
            Some(value) => flat.push(format!("{title} is {}", with_unit(value, 0, q.unit))),
            None => section = section.block(heat_map(title, q, found)),
        }
    }
    if !flat.is_empty() {
        section = section.text(format!("Not drawn, the same at all points: {}.", flat.join(", ")));
    }
    if !none.is_empty() && missed < found.rows.iter().map(Vec::len).sum() {
        section = section.text(format!("This engine has no model of: {}.", none.join(", ")));
    }
    report.fact("Torques that the limits do not allow", missed as f64).section(section)
}

/// The only value of a quantity.
fn same_everywhere(q: &Quantity, found: &Loaded) -> Option<f64> {
    let points = found.points();
    let mut values = points.iter().map(q.value).filter(|v| v.is_finite());
    let first = values.next()?;
    values.all(|v| v == first).then_some(first)
}

/// A quantity of the table over speed and torque; points out of reach are left empty.
fn heat_map(title: &str, q: &Quantity, found: &Loaded) -> Block {
    let value = |p: &LoadPoint| if p.reached { (q.value)(&point(p)) } else { f64::NAN };
    let z = (0..found.torques_nm.len()).flat_map(|j| found.rows.iter().map(move |r| value(&r[j])));
    let mut map = HeatMap::new(
        title,
        (Axis::new("Speed", "rpm"), found.speeds_rpm.clone()),
        (Axis::new("Torque", "Nm"), found.torques_nm.clone()),
        (Axis::new(title, q.unit), z.collect()),
    )
    .contours();
    let full = full_load_line(found);
    if !full.0.is_empty() {
        map = map.overlay_line("full load", full.0, full.1);
    }
    let restless = found.rows.iter().flatten().filter(|p| p.reached && !p.settled);
    let (x, y): (Vec<f64>, Vec<f64>) = restless.map(|p| (p.request.speed_rpm, p.request.torque_nm)).unzip();
    if !x.is_empty() {
        map = map.overlay("did not come to rest", x, y);
    }
    map.into()
}

/// Most torque that was held at each speed at which more was asked for.
fn full_load_line(found: &Loaded) -> (Vec<f64>, Vec<f64>) {
    let most = |row: &Vec<LoadPoint>| {
        let missed = row.iter().filter(|p| !p.reached);
        missed.map(|p| (p.request.speed_rpm, p.outputs.torque_nm)).max_by(|a, b| a.1.total_cmp(&b.1))
    };
    found.rows.iter().filter_map(most).unzip()
}

fn full_load(set: &str, found: &Loaded) -> Section {
    let points = found.points();
    let curve = |name: &&str| {
        let q = find(name)?;
        let y: Vec<f64> = points.iter().map(q.value).collect();
        if y.iter().all(|v| v.is_nan()) {
            return None;
        }
        let plot = XyPlot::new(q.name, Axis::new("Speed", "rpm"), Axis::new(q.name, q.unit));
        Some(Block::from(plot.line(set, found.speeds_rpm.clone(), y)))
    };
    let head = vec![
        Column::number("Speed", "rpm"),
        Column::number("Torque", "Nm").digits(4),
        Column::text("Held by"),
    ];
    let held = found.rows.iter().flatten().fold(Table::new(head), |t, p| {
        t.row(vec![p.request.speed_rpm.into(), p.outputs.torque_nm.into(), Cell::from(held_by(p))])
    });
    CURVES.iter().filter_map(curve).fold(Section::new("Full load"), Section::block).block(held)
}
