//! Report of the study `engine`: sections of the parameter set `gtdi_2l`.

use dynocal_plant::full_load::LoadPoint;
use dynocal_plant::outputs::Outputs;
use dynocal_report::{Axis, Block, HeatMap, Report, Section, XyPlot};

use super::boosted::{CAMS, FULL_LOAD, MAP, MIXTURE, SPARK, points};
use super::results::{Cams, Grid, GridPoint, Mixture, SparkSweepAt};
use crate::{TaskResult, result};

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let text = "Parameter set gtdi_2l as a controller holds it: boost, knock limit, peak pressure, exhaust temperature.";
    report
        .section(Section::new("Full load of gtdi_2l").text(text).columns(full_load(results)))
        .section(Section::new("Maps of gtdi_2l").columns(maps(results)))
        .section(Section::new("Load sweeps of gtdi_2l").columns(load_sweeps(results)))
        .section(Section::new("Sweeps of gtdi_2l").columns(sweeps(results)))
}

/// A name and what it is of a point.
type Line = (&'static str, fn(&LoadPoint) -> f64);

/// A value of every point; NaN where one failed.
fn series(all: &[GridPoint], of: impl Fn(&LoadPoint) -> f64) -> Vec<f64> {
    all.iter().map(|p| p.point.as_ref().map_or(f64::NAN, &of)).collect()
}

fn full_load(results: &[TaskResult]) -> Vec<Block> {
    let all = points(results, FULL_LOAD);
    let speed = || series(&all, |p| p.request.speed_rpm);
    let plot = |name: &str, unit: &str, lines: &[Line]| -> Block {
        let empty = XyPlot::new(name, Axis::new("Speed", "rpm"), Axis::new(name, unit));
        lines.iter().fold(empty, |p, (label, of)| p.line(*label, speed(), series(&all, of))).into()
    };
    let celsius = series(&all, |p| p.outputs.egt_k - 273.15);
    vec![
        plot("Torque", "Nm", &[("Torque", |p| p.outputs.torque_nm)]),
        plot(
            "Pressure",
            "kPa",
            &[("Intake manifold", |p| p.outputs.map_kpa), ("Exhaust manifold", |p| p.outputs.exhaust_kpa)],
        ),
        plot(
            "Spark",
            "deg",
            &[
                ("Spark advance", |p| p.inputs.spark_deg),
                ("50 % burned, after dead centre", |p| p.outputs.ca50_deg),
            ],
        ),
        plot("Knock integral", "", &[("Knock", |p| p.outputs.knock)]),
        plot("Lambda", "", &[("Held", |p| p.lambda)]),
        XyPlot::new("Exhaust temperature", Axis::new("Speed", "rpm"), Axis::new("Temperature", "deg C"))
            .line("Manifold", speed(), celsius)
            .into(),
        plot("Turbocharger", "rpm", &[("Shaft", |p| p.outputs.turbo_rpm)]),
        plot("Specific consumption", "g/kWh", &[("BSFC", |p| p.outputs.bsfc_g_kwh)]),
    ]
}

/// A quantity of a map: name, unit, value.
type Mapped = (&'static str, &'static str, fn(&LoadPoint) -> f64);

fn maps(results: &[TaskResult]) -> Vec<Block> {
    let Some(map) = result::<Grid>(results, MAP) else { return vec![] };
    let (speeds, torques) = (&map.speed_rpm, &map.torque_nm);
    if speeds.len() < 2 || torques.len() < 2 {
        return vec![];
    }
    let inside =
        |p: &&LoadPoint| p.request.speed_rpm >= speeds[0] && p.request.speed_rpm <= speeds[speeds.len() - 1];
    let full = points(results, FULL_LOAD);
    let line: (Vec<f64>, Vec<f64>) = full
        .iter()
        .filter_map(|p| p.point.as_ref())
        .filter(inside)
        .map(|p| (p.request.speed_rpm, p.outputs.torque_nm))
        .unzip();
    let quantities: [Mapped; 6] = [
        ("BSFC", "g/kWh", |p| p.outputs.bsfc_g_kwh),
        ("Spark", "deg", |p| p.inputs.spark_deg),
        ("Knock integral", "", |p| p.outputs.knock),
        ("Exhaust temperature", "deg C", |p| p.outputs.egt_k - 273.15),
        ("Residual fraction", "", |p| p.outputs.residual),
        ("NO", "ppm", |p| p.outputs.no_ppm),
    ];
    let heat = |(title, unit, of): Mapped| {
        let at =
            |j: usize, i: usize| map.rows[i][j].point.as_ref().filter(|p| p.reached).map_or(f64::NAN, of);
        let z =
            (0..torques.len()).flat_map(|j| (0..speeds.len()).map(move |i| (j, i))).map(|(j, i)| at(j, i));
        let mut map = HeatMap::new(
            title,
            (Axis::new("Speed", "rpm"), speeds.clone()),
            (Axis::new("Torque", "Nm"), torques.clone()),
            (Axis::new(title, unit), z.collect()),
        )
        .contours();
        if !line.0.is_empty() {
            map = map.overlay_line("full load", line.0.clone(), line.1.clone());
        }
        map.into()
    };
    quantities.into_iter().map(heat).collect()
}

/// Over torque, a line for each of three speeds; points that are not reached are left out.
fn load_sweeps(results: &[TaskResult]) -> Vec<Block> {
    let Some(map) = result::<Grid>(results, MAP) else { return vec![] };
    let quantities: [Mapped; 4] = [
        ("50 % burned, after dead centre", "deg", |p| p.outputs.ca50_deg),
        ("Knock integral", "", |p| p.outputs.knock),
        ("Spark advance", "deg", |p| p.inputs.spark_deg),
        ("Lambda held", "", |p| p.lambda),
    ];
    let plot = |(title, unit, of): Mapped| {
        let empty = XyPlot::new(title, Axis::new("Torque", "Nm"), Axis::new(title, unit));
        let rows = map.speed_rpm.iter().zip(&map.rows).filter(|(n, _)| [1500.0, 2000.0, 3000.0].contains(n));
        rows.fold(empty, |plot, (speed_rpm, row)| {
            let held = row.iter().filter_map(|p| p.point.as_ref()).filter(|p| p.reached);
            let (x, y): (Vec<f64>, Vec<f64>) = held.map(|p| (p.outputs.torque_nm, of(p))).unzip();
            plot.line(format!("{speed_rpm} rpm"), x, y)
        })
        .into()
    };
    quantities.into_iter().map(plot).collect()
}

fn sweeps(results: &[TaskResult]) -> Vec<Block> {
    let mut out = Vec::new();
    for s in result::<Vec<SparkSweepAt>>(results, SPARK).unwrap_or_default() {
        let name = format!("Torque ratio at {} rpm, {} Nm", s.speed_rpm, s.torque_nm);
        out.push(
            XyPlot::new(name, Axis::new("Spark from best", "deg"), Axis::new("Torque over best torque", ""))
                .line("This engine", s.sweep.off_deg.clone(), s.sweep.ratio)
                .line("Crossley and Cook", s.sweep.off_deg, s.sweep.published)
                .into(),
        );
    }
    if let Some(mixture) = result::<Mixture>(results, MIXTURE) {
        out.extend(over_lambda(&mixture));
    }
    if let Some(cams) = result::<Cams>(results, CAMS) {
        out.extend(over_cam(&cams));
    }
    out
}

/// A quantity of a sweep: name, unit, value.
type Swept = (&'static str, &'static str, fn(&Outputs) -> f64);

fn over_lambda(mixture: &Mixture) -> Vec<Block> {
    let swept: [Swept; 6] = [
        ("Torque", "Nm", |y| y.torque_nm),
        ("Exhaust temperature", "deg C", |y| y.egt_k - 273.15),
        ("NO", "ppm", |y| y.no_ppm),
        ("CO", "%", |y| y.co_pct),
        ("HC", "ppm C1", |y| y.hc_ppm),
        ("Burn 10 to 90 %", "deg", |y| y.burn_deg),
    ];
    let plot = |(title, unit, of): Swept| {
        let y: Vec<f64> = mixture.outputs.iter().map(of).collect();
        XyPlot::new(format!("{title} against lambda"), Axis::new("Lambda", ""), Axis::new(title, unit))
            .line("2000 rpm, constant air", mixture.lambda.clone(), y)
            .into()
    };
    swept.into_iter().map(plot).collect()
}

fn over_cam(cams: &Cams) -> Vec<Block> {
    let swept: [Swept; 3] = [
        ("Residual fraction", "", |y| y.residual),
        ("Pumping", "bar", |y| y.pmep_bar),
        ("BSFC", "g/kWh", |y| y.bsfc_g_kwh),
    ];
    let plot = |(title, unit, of): Swept| {
        let y: Vec<f64> = cams.outputs.iter().map(of).collect();
        let opening = Axis::new("Maximum opening point", "deg BTDC firing");
        XyPlot::new(format!("{title} against the intake cam"), opening, Axis::new(title, unit))
            .line("2000 rpm, throttle of 40 Nm", cams.intake_deg.clone(), y)
            .into()
    };
    swept.into_iter().map(plot).collect()
}
