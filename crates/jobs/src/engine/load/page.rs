//! The page of a map or of full load.

use dynocal_plant::full_load::LoadPoint;
use dynocal_report::{Axis, Block, HeatMap, Report, Section, XyPlot};

use super::{Loaded, Spec, What, point};
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
    let section = Section::new("Maps").text(
        "Cells are empty where the limits do not allow the torque. Spark, boost and mixture as a controller holds them.",
    );
    let maps = MAPS.iter().filter_map(|(title, name)| Some(heat_map(title, find(name)?, found)));
    report
        .fact("Torques that the limits do not allow", missed as f64)
        .section(maps.fold(section, Section::block))
}

/// A quantity of the table over speed and torque; points out of reach are left empty.
fn heat_map(title: &str, q: &Quantity, found: &Loaded) -> Block {
    let value = |p: &LoadPoint| if p.reached { (q.value)(&point(p)) } else { f64::NAN };
    let z = (0..found.torques_nm.len()).flat_map(|j| found.rows.iter().map(move |r| value(&r[j])));
    HeatMap::new(
        title,
        (Axis::new("Speed", "rpm"), found.speeds_rpm.clone()),
        (Axis::new("Torque", "Nm"), found.torques_nm.clone()),
        (Axis::new(title, q.unit), z.collect()),
    )
    .contours()
    .into()
}

fn full_load(set: &str, found: &Loaded) -> Section {
    let points = found.points();
    let curve = |name: &&str| {
        let q = find(name)?;
        let y: Vec<f64> = points.iter().map(q.value).collect();
        let plot = XyPlot::new(q.name, Axis::new("Speed", "rpm"), Axis::new(q.name, q.unit));
        Some(Block::from(plot.line(set, found.speeds_rpm.clone(), y)))
    };
    CURVES.iter().filter_map(curve).fold(Section::new("Full load"), Section::block)
}
