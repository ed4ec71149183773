//! Report of the study `engine`: thesis beside this engine beside the prototype, sweeps, responses, the map.

use crate::engine::results::{
    SparkAt70, StaticRow, Transient, fuel_line, rows_at_2000, static_rows, transients,
};
use crate::engine::transients::{Moments, RECORD_S};
use dynocal_plant::inputs::Inputs;
use dynocal_plant::outputs::Outputs;
use dynocal_plant::statics::StaticPoint;
use dynocal_report::{
    Axis, Block, Cell, Column, Panel, Report, Section, Table, TimePlot, XyPlot, significant,
};

use super::checks::range;
use super::{OPEN, RANDOM, SPARK};
use crate::{TaskResult, result};

/// The static map; empty when it cannot be read.
fn rows(results: &[TaskResult]) -> Vec<StaticRow> {
    static_rows(results).map_or_else(Vec::new, |r| r.points)
}

/// Sections below the checks.
pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let report = report
        .section(Section::new("Thesis and prototype").block(comparison(results)))
        .section(Section::new("Static map").block(fuel_plot(results)).block(map_table(results)))
        .section(Section::new("Spark at 2000 rpm, 70 Nm").columns(spark_plots(results)))
        .section(responses(results))
        .section(Section::new("Open throttle").block(open_table(results)));
    let report = super::row_plots::sections(super::boosted_tables::sections(report, results), results);
    let report = super::as_measured_rows::sections(report, results);
    let report = super::light_off::sections(super::twin::sections(report, results), results);
    super::other::sections(super::reach::sections(report, results), results)
}

fn text(values: &[Option<f64>], digits: usize) -> String {
    let each = values.iter().map(|v| v.map_or("none".to_string(), |v| significant(v, digits)));
    each.collect::<Vec<_>>().join(" / ")
}

fn span(r: Option<(f64, f64)>, digits: usize) -> String {
    r.map_or("none".into(), |(a, b)| format!("{} to {}", significant(a, digits), significant(b, digits)))
}

/// Mean torque per fuel \[Nm/mg\] at best and at random spark, over the points that both can reach.
fn economy(results: &[TaskResult]) -> Option<(f64, f64)> {
    let pairs: Vec<(f64, f64)> = rows(results)
        .iter()
        .filter_map(|r| {
            let torque = Some(r.target.torque_nm).filter(|t| *t > 0.0)?;
            let random = r.point.as_ref()?.random_injection_mg?;
            Some((torque / r.best(|p| p.inputs.injection_mg)?, torque / random))
        })
        .collect();
    let n = pairs.len() as f64;
    (n > 0.0)
        .then(|| (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n))
}

fn comparison(results: &[TaskResult]) -> Table {
    let at_2000 = rows_at_2000(results);
    let row = |torque_nm: f64| at_2000.iter().find(|r| r.target.torque_nm == torque_nm);
    let point =
        |torque_nm: f64, of: fn(&Inputs) -> f64| row(torque_nm)?.best(|p: &StaticPoint| of(&p.inputs));
    let penalty = |r: &StaticRow| r.point.as_ref().map(|p| p.penalty_pct);
    let responses = transients(results);
    let t = |name: &str, of: fn(&Transient) -> Option<f64>| {
        responses.iter().find(|t| t.name == name).and_then(of)
    };
    let rise = |name: &str| t(name, |r| r.rise_s);
    let e = economy(results);
    let random: Option<Moments> = result(results, RANDOM);
    let throttles = text(&[0.0, 30.0, 70.0, 100.0].map(|q| point(q, |u| u.throttle_deg)), 3);
    let spark = range(rows(results).iter().map(|r| r.best(|p| p.inputs.spark_deg)));
    let (fuel_0, slope) = line(results);
    let ratio = e.map(|(a, b)| a / b);
    let lambda =
        |a: &str, b: &str| text(&[t(a, |r| Some(1.0 - r.lambda_min)), t(b, |r| Some(r.lambda_max - 1.0))], 2);
    let settle = |name: &str| text(&[t(name, |r| r.torque_settling_s), t(name, |r| r.lambda_settling_s)], 3);
    let table = Table::new(vec![
        Column::text("Quantity"),
        Column::text("Thesis"),
        Column::text("This engine"),
        Column::text("Prototype"),
    ])
    .caption("2000 rpm unless stated. Thesis values from chapters 3, 6 and 7; the prototype is the compiled-Python program that the specification was written from. A dash: not stated.");
    let rows = [
        ("Best spark at 70 Nm, deg BTDC", "19", text(&[point(70.0, |u| u.spark_deg)], 4), "18.95"),
        ("Fuel there, mg", "about 17", text(&[point(70.0, |u| u.injection_mg)], 4), "16.75"),
        ("Throttle there, deg", "12 to 16.4", text(&[point(70.0, |u| u.throttle_deg)], 4), "15.9"),
        ("Fuel penalty 3 deg off there, %", "only 1", text(&[row(70.0).and_then(penalty)], 2), "0.31"),
        (
            "The same over the map, %",
            "-",
            span(range(self::rows(results).iter().map(penalty)), 2),
            "0.25 to 0.67",
        ),
        (
            "Economy over the map above 0 Nm: best / random spark, Nm/mg",
            "4.13 / 3.97",
            text(&[e.map(|e| e.0), e.map(|e| e.1)], 4),
            "3.91 / 3.73 (six points)",
        ),
        ("Their ratio", "1.040", text(&[ratio], 4), "1.048"),
        ("Best spark over the map, deg", "-", span(spark, 3), "10.1 to 38.8"),
        (
            "Fuel at 0 / 30 Nm, mg",
            "4.0 / 9.9",
            text(&[point(0.0, |u| u.injection_mg), point(30.0, |u| u.injection_mg)], 3),
            "3.9 / 9.46",
        ),
        ("Fuel line: at 0 Nm, mg / slope, mg/Nm", "proportional", text(&[fuel_0, slope], 3), "3.9 / 0.183"),
        (
            "Throttle at 0 / 30 / 70 / 100 Nm, deg",
            "5.1 / 9.9 / 16.1 / 21.0",
            throttles,
            "4.6 / 10.4 / 15.9 / 20.1",
        ),
        ("Torque rise to a step of fuel, s", "0.45", text(&[rise("INJ -3 mg")], 2), "0.38"),
        ("of spark, s", "0.36", text(&[rise("SA -10 deg")], 2), "0.34"),
        (
            "of throttle (+3 / -3 deg), s",
            "0.51",
            text(&[rise("throttle +3 deg"), rise("throttle -3 deg")], 2),
            "0.49 / 0.57",
        ),
        ("Settling 30 to 70 Nm: torque / lambda, s", "1.5 / 2 at most", settle("30->70 Nm"), "0.96 / 0.72"),
        ("Settling 70 to 30 Nm: torque / lambda, s", "1.5 / 2 at most", settle("70->30 Nm"), "0.85 / 0.95"),
        ("Lambda spike rich / lean, 30 and 70 Nm", "0.36", lambda("30->70 Nm", "70->30 Nm"), "0.20 / 0.29"),
        ("Lambda spike rich / lean, 10 and 90 Nm", "-", lambda("10->90 Nm", "90->10 Nm"), "0.34 / 0.74"),
        (
            "PI eq. 6.1, 70 to 50 Nm: torque / lambda settle, s",
            "9 allowed",
            settle("PI eq. 6.1"),
            "1.7 / 3.0",
        ),
        ("PI eq. 7.5, the same, s", "-", settle("PI eq. 7.5"), "3.0 / 2.8"),
        (
            "Random inputs: deviation of torque, Nm",
            "22.6",
            text(&[random.map(|r| r.torque_std_nm)], 3),
            "22.9",
        ),
        ("Random inputs: variance of lambda", "0.75", text(&[random.map(|r| r.lambda_var)], 2), "0.74"),
    ];
    rows.into_iter().fold(table, |t, (q, thesis, own, proto)| {
        t.row([Cell::from(q), Cell::from(thesis), Cell::from(own), Cell::from(proto)])
    })
}

/// Fuel at 0 Nm \[mg\] and slope up to 70 Nm \[mg/Nm\].
fn line(results: &[TaskResult]) -> (Option<f64>, Option<f64>) {
    let rows = rows_at_2000(results);
    let fuel = |torque_nm: f64| {
        rows.iter().find(|r| r.target.torque_nm == torque_nm)?.best(|p| p.inputs.injection_mg)
    };
    let (a, b) = (fuel(0.0), fuel(70.0));
    (a, a.zip(b).map(|(a, b)| (b - a) / 70.0))
}

fn fuel_plot(results: &[TaskResult]) -> XyPlot {
    let (torque, fuel) = fuel_line(results);
    XyPlot::new("Fuel at 2000 rpm", Axis::new("Torque", "Nm"), Axis::new("Fuel per cycle and cylinder", "mg"))
        .line("Best spark, lambda 1", torque, fuel)
}

fn map_table(results: &[TaskResult]) -> dynocal_report::Details {
    let mut table = Table::new(vec![
        Column::number("Speed", "rpm").digits(4),
        Column::number("Torque", "Nm").digits(3),
        Column::number("Spark", "deg").digits(4),
        Column::number("Fuel", "mg").digits(4),
        Column::number("Throttle", "deg").digits(4),
        Column::number("MAP", "kPa").digits(4),
        Column::number("EGT", "deg C").digits(3),
        Column::number("Residual", "").digits(3),
        Column::number("CA50", "deg").digits(3),
        Column::number("3 deg off", "%").digits(2),
    ]);
    for r in rows(results) {
        let u = |of: fn(&Inputs) -> f64| Cell::from(r.best(|p: &StaticPoint| of(&p.inputs)));
        let y = |of: fn(&Outputs) -> f64| Cell::from(r.best(|p: &StaticPoint| of(&p.outputs)));
        table = table.row([
            r.target.speed_rpm.into(),
            r.target.torque_nm.into(),
            u(|u| u.spark_deg),
            u(|u| u.injection_mg),
            u(|u| u.throttle_deg),
            y(|y| y.map_kpa),
            y(|y| y.egt_k - 273.15),
            y(|y| y.residual),
            y(|y| y.ca50_deg),
            r.point.as_ref().map(|p| p.penalty_pct).into(),
        ]);
    }
    dynocal_report::Details::new("All points of the static map").block(table)
}

fn spark_plots(results: &[TaskResult]) -> Vec<Block> {
    let Some(run) = result::<SparkAt70>(results, SPARK) else { return Vec::new() };
    let spark = || run.spark_deg.clone();
    let axis = || Axis::new("Spark advance", "deg BTDC");
    vec![
        XyPlot::new("Torque at constant air and fuel", axis(), Axis::new("Torque", "Nm"))
            .line("Torque", spark(), run.torque_nm.clone())
            .into(),
        XyPlot::new("Fuel at constant torque", axis(), Axis::new("Fuel", "mg"))
            .line("Fuel", spark(), run.fuel_mg.clone())
            .into(),
    ]
}

fn responses(results: &[TaskResult]) -> Section {
    let mut section = Section::new("Responses");
    for r in transients(results) {
        let samples = r.torque_nm.len();
        section = section.block(
            TimePlot::sampled(&r.name, RECORD_S, samples)
                .panel(Panel::new("Torque", "Nm").line("Torque sensor", r.torque_nm))
                .panel(Panel::new("Lambda", "").line("Lambda", r.lambda)),
        );
    }
    section
}

fn open_table(results: &[TaskResult]) -> Table {
    let columns = vec![
        Column::number("Speed", "rpm").digits(4),
        Column::number("Torque", "Nm").digits(4),
        Column::number("Spark", "deg").digits(3),
        Column::number("Fuel", "mg").digits(4),
        Column::number("Vol. eff.", "").digits(4),
        Column::number("BSFC", "g/kWh").digits(4),
        Column::number("Peak", "bar").digits(3),
        Column::number("EGT", "deg C").digits(3),
    ];
    let caption = "Lambda 1, spark of most torque, no charging, knock ignored";
    let runs: Vec<StaticPoint> = result(results, OPEN).unwrap_or_default();
    runs.iter().fold(Table::new(columns).caption(caption), |t, p| {
        let (u, y) = (&p.inputs, &p.outputs);
        t.row([
            Cell::from(u.speed_rpm),
            Cell::from(y.torque_nm),
            Cell::from(u.spark_deg),
            Cell::from(u.injection_mg),
            Cell::from(y.volumetric_efficiency),
            Cell::from(y.bsfc_g_kwh),
            Cell::from(y.pmax_bar),
            Cell::from(y.egt_k - 273.15),
        ])
    })
}
