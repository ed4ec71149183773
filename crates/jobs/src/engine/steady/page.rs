//! The page of steady points.

use dynocal_plant::trace::CylinderTrace;
use dynocal_report::{Axis, Block, Report, Section, XyPlot};

use super::{Input, Spec, Steady};
use crate::engine::quantities::{Point, QUANTITIES, find};

/// What a sweep draws over its input.
const SWEPT: [&str; 8] = ["torque", "lambda", "bsfc", "egt", "pmax", "ca50", "map", "residual"];

fn title(spec: &Spec) -> &'static str {
    match spec {
        Spec::Point(_) => "Engine: steady point",
        Spec::Sweep { .. } => "Engine: sweep",
        Spec::Motored { .. } => "Engine: motored",
    }
}

/// Quantities over the input that moves.
fn sweep(input: Input, points: &[Point]) -> Section {
    let Some(x) = find(input.name()) else { return Section::new("Sweep") };
    let along: Vec<f64> = points.iter().map(x.value).collect();
    let plot = |name: &&str| {
        let q = find(name)?;
        let y: Vec<f64> = points.iter().map(q.value).collect();
        let plot = XyPlot::new(q.name, Axis::new(x.name, x.unit), Axis::new(q.name, q.unit));
        Some(Block::from(plot.line(q.name, along.clone(), y)))
    };
    SWEPT.iter().filter_map(plot).fold(Section::new("Sweep"), Section::block)
}

/// The page: the last point in numbers, the sweep as curves, pressure and traces of the first cylinder at the last point.
pub fn report(spec: &Spec, set: &str, found: &Steady) -> Report {
    let t = &found.trace;
    let mut report = Report::new(title(spec)).subtitle(format!("Virtual engine, parameter set {set}"));
    report = found.warnings.iter().fold(report, |r, w| r.warning(w.as_str()));
    match (spec, &found.points[..]) {
        (Spec::Sweep { input, .. }, points) => report = report.section(sweep(*input, points)),
        (_, [p]) => report = QUANTITIES.iter().fold(report, |r, q| r.fact(q.title(), q.text(p))),
        _ => {}
    }
    let litre: Vec<f64> = t.volume_m3.iter().map(|v| 1e3 * v).collect();
    let bar: Vec<f64> = t.pressure_pa.iter().map(|p| 1e-5 * p).collect();
    let log = |v: &[f64]| v.iter().map(|x| x.log10()).collect::<Vec<f64>>();
    let pressure = || Axis::new("Pressure", "bar");
    let angle = || Axis::new("Angle after firing dead centre", "deg");
    let pv: Vec<Block> = vec![
        XyPlot::new("p-V diagram", Axis::new("Volume", "l"), pressure())
            .line("Cylinder 1", litre.clone(), bar.clone())
            .into(),
        XyPlot::new(
            "Logarithmic",
            Axis::new("log10 of volume in l", ""),
            Axis::new("log10 of pressure in bar", ""),
        )
        .line("Cylinder 1", log(&litre), log(&bar))
        .into(),
    ];
    let curve = |name: &str, axis: Axis, y: Vec<f64>| -> Block {
        XyPlot::new(name, angle(), axis).line("Cylinder 1", t.angle_deg.clone(), y).into()
    };
    let mg = t.mass_kg.iter().map(|m| 1e6 * m).collect();
    let traces = vec![
        curve("Pressure", pressure(), bar),
        curve("Temperature", Axis::new("Temperature", "K"), t.temperature_k.clone()),
        curve("Gas in the cylinder", Axis::new("Mass", "mg"), mg),
        curve("Burned share", Axis::new("Share", ""), t.burned.clone()),
        heat_release(t),
    ];
    let text = "First cylinder, one cycle at the last point.";
    let traces = traces.into_iter().fold(Section::new("Traces").text(text), Section::block);
    report.section(Section::new("Pressure and volume").text(text).columns(pv)).section(traces)
}

/// Apparent heat release between intake closing and exhaust opening.
fn heat_release(t: &CylinderTrace) -> Block {
    const GAMMA: f64 = 1.3;
    let rate = t.heat_release_j_deg(GAMMA);
    let closed = t.angle_deg.iter().zip(rate).filter(|(a, _)| (-60.0..100.0).contains(*a));
    let (angle, rate): (Vec<f64>, Vec<f64>) = closed.map(|(a, q)| (*a, q)).unzip();
    XyPlot::new(
        "Apparent heat release",
        Axis::new("Angle after firing dead centre", "deg"),
        Axis::new("Rate", "J/deg"),
    )
    .line("Cylinder 1", angle, rate)
    .caption("From pressure and volume with a constant ratio of heat capacities of 1.3: net of wall heat.")
    .into()
}
