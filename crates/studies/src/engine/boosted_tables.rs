//! Report of the study `engine`: sections of the parameter set `gtdi_2l`.

use dynocal_report::{Axis, Block, HeatMap, Report, Section, XyPlot};
use serde_json::Value;

use super::boosted::{CAMS, FULL_LOAD, MAP, MIXTURE, SPARK, points};
use super::checks::of;
use super::tables::numbers;
use crate::TaskResult;

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let text = "Parameter set gtdi_2l as a controller holds it: boost, knock limit, peak pressure, exhaust temperature.";
    report
        .section(Section::new("Full load of gtdi_2l").text(text).columns(full_load(results)))
        .section(Section::new("Maps of gtdi_2l").columns(maps(results)))
        .section(Section::new("Sweeps of gtdi_2l").columns(sweeps(results)))
}

fn series(all: &[&Value], part: &str, key: &str) -> Vec<f64> {
    let value = |p: &&Value| if part.is_empty() { p[key].as_f64() } else { p[part][key].as_f64() };
    all.iter().map(|p| value(p).unwrap_or(f64::NAN)).collect()
}

fn full_load(results: &[TaskResult]) -> Vec<Block> {
    let all = points(results, FULL_LOAD);
    let speed = || series(&all, "request", "speed_rpm");
    let plot = |name: &str, unit: &str, lines: &[(&str, &str, &str)]| -> Block {
        let empty = XyPlot::new(name, Axis::new("Speed", "rpm"), Axis::new(name, unit));
        lines
            .iter()
            .fold(empty, |p, (label, part, key)| p.line(*label, speed(), series(&all, part, key)))
            .into()
    };
    let celsius: Vec<f64> = series(&all, "outputs", "egt_k").iter().map(|t| t - 273.15).collect();
    vec![
        plot("Torque", "Nm", &[("Torque", "outputs", "torque_nm")]),
        plot(
            "Pressure",
            "kPa",
            &[("Intake manifold", "outputs", "map_kpa"), ("Exhaust manifold", "outputs", "exhaust_kpa")],
        ),
        plot(
            "Spark",
            "deg",
            &[
                ("Spark advance", "inputs", "spark_deg"),
                ("50 % burned, after dead centre", "outputs", "ca50_deg"),
            ],
        ),
        plot("Knock integral", "", &[("Knock", "outputs", "knock")]),
        plot("Lambda", "", &[("Held", "", "lambda")]),
        XyPlot::new("Exhaust temperature", Axis::new("Speed", "rpm"), Axis::new("Temperature", "deg C"))
            .line("Manifold", speed(), celsius)
            .into(),
        plot("Turbocharger", "rpm", &[("Shaft", "outputs", "turbo_rpm")]),
        plot("Specific consumption", "g/kWh", &[("BSFC", "outputs", "bsfc_g_kwh")]),
    ]
}

fn maps(results: &[TaskResult]) -> Vec<Block> {
    let map = of(results, MAP);
    let (speeds, torques) = (numbers(&map["speed_rpm"]), numbers(&map["torque_nm"]));
    if speeds.len() < 2 || torques.len() < 2 {
        return vec![];
    }
    [
        ("BSFC", "g/kWh", "outputs", "bsfc_g_kwh", 0.0),
        ("Spark", "deg", "inputs", "spark_deg", 0.0),
        ("Knock integral", "", "outputs", "knock", 0.0),
        ("Exhaust temperature", "deg C", "outputs", "egt_k", 273.15),
        ("Residual fraction", "", "outputs", "residual", 0.0),
        ("NO", "ppm", "outputs", "no_ppm", 0.0),
    ]
    .into_iter()
    .map(|(title, unit, part, key, offset)| {
        let at = |j: usize, i: usize| {
            let p = &map["rows"][i][j];
            if p["reached"] == true { p[part][key].as_f64().unwrap_or(f64::NAN) - offset } else { f64::NAN }
        };
        let z =
            (0..torques.len()).flat_map(|j| (0..speeds.len()).map(move |i| (j, i))).map(|(j, i)| at(j, i));
        HeatMap::new(
            title,
            (Axis::new("Speed", "rpm"), speeds.clone()),
            (Axis::new("Torque", "Nm"), torques.clone()),
            (Axis::new(title, unit), z.collect()),
        )
        .contours()
        .into()
    })
    .collect()
}

fn sweeps(results: &[TaskResult]) -> Vec<Block> {
    let mut out = Vec::new();
    for s in of(results, SPARK).as_array().into_iter().flatten() {
        let name = format!("Torque ratio at {} rpm, {} Nm", s["speed_rpm"], s["torque_nm"]);
        let off = || numbers(&s["sweep"]["off_deg"]);
        out.push(
            XyPlot::new(name, Axis::new("Spark from best", "deg"), Axis::new("Torque over best torque", ""))
                .line("This engine", off(), numbers(&s["sweep"]["ratio"]))
                .line("Crossley and Cook", off(), numbers(&s["sweep"]["published"]))
                .into(),
        );
    }
    let mixture = of(results, MIXTURE);
    let all: Vec<&Value> = mixture["outputs"].as_array().into_iter().flatten().collect();
    for (title, unit, key, offset) in [
        ("Torque", "Nm", "torque_nm", 0.0),
        ("Exhaust temperature", "deg C", "egt_k", 273.15),
        ("NO", "ppm", "no_ppm", 0.0),
        ("CO", "%", "co_pct", 0.0),
        ("HC", "ppm C1", "hc_ppm", 0.0),
        ("Burn 10 to 90 %", "deg", "burn_deg", 0.0),
    ] {
        let y: Vec<f64> = series(&all, "", key).iter().map(|v| v - offset).collect();
        out.push(
            XyPlot::new(format!("{title} against lambda"), Axis::new("Lambda", ""), Axis::new(title, unit))
                .line("2000 rpm, constant air", numbers(&mixture["lambda"]), y)
                .into(),
        );
    }
    let cams = of(results, CAMS);
    let all: Vec<&Value> = cams["outputs"].as_array().into_iter().flatten().collect();
    for (title, unit, key) in [
        ("Residual fraction", "", "residual"),
        ("Pumping", "bar", "pmep_bar"),
        ("BSFC", "g/kWh", "bsfc_g_kwh"),
    ] {
        out.push(
            XyPlot::new(
                format!("{title} against the intake cam"),
                Axis::new("Maximum opening point", "deg BTDC firing"),
                Axis::new(title, unit),
            )
            .line("2000 rpm, throttle of 40 Nm", numbers(&cams["intake_deg"]), series(&all, "", key))
            .into(),
        );
    }
    out
}
