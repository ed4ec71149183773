//! Report of the study `engine`: plots of boost, steps and knock of `gtdi_2l`.

use super::air_path::{StepRecord, SweepPoint};
use super::class_rows::Retard;
use super::rows::{AIR_PATH, KNOCK, STEPS, Steps};
use crate::{TaskResult, result};
use dynocal_report::{Axis, Block, Report, Section, XyPlot};

/// Plots.
pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let text = "Wastegate swept closed and open again; steps of wastegate and throttle; tip-in from 30 Nm; retard from best spark beside a production table.";
    let mut all: Vec<Block> = sweep(results);
    all.extend(steps(results));
    all.extend(retard(results));
    report.section(Section::new("Boost and knock of gtdi_2l").text(text).columns(all))
}

/// Speeds in one plot of boost: two colours each, and no colour twice.
const SPEEDS: usize = 3;

fn sweep(results: &[TaskResult]) -> Vec<Block> {
    let Some(all) = result::<Vec<SweepPoint>>(results, AIR_PATH) else { return vec![] };
    let mut speeds: Vec<f64> = all.iter().map(|p| p.speed_rpm).collect();
    speeds.dedup();
    let plot =
        |speeds: &[f64]| {
            let axes = (Axis::new("Wastegate", "mm"), Axis::new("Intake pressure", "kPa"));
            let plot = XyPlot::new("Boost against the wastegate", axes.0, axes.1);
            speeds.iter().fold(plot, |plot, speed| {
                let of = |y: fn(&SweepPoint) -> f64| -> Vec<f64> {
                    all.iter().filter(|p| p.speed_rpm == *speed).map(y).collect()
                };
                plot.line(format!("{speed} rpm closing"), of(|p| p.wastegate_mm), of(|p| p.closing_kpa))
                    .points(format!("{speed} rpm opening"), of(|p| p.wastegate_mm), of(|p| p.opening_kpa))
            })
        };
    speeds.chunks(SPEEDS).map(|s| plot(s).into()).collect()
}

/// A quantity of step records over time: title, unit, value; a name for each record.
fn over_time(
    title: &str,
    (name, unit): (&str, &str),
    of: fn(&StepRecord) -> &[f64],
    records: &[(String, &StepRecord)],
) -> Block {
    let plot = XyPlot::new(title, Axis::new("Time", "s"), Axis::new(name, unit));
    records.iter().fold(plot, |p, (label, r)| p.line(label.as_str(), r.time_s.clone(), of(r).to_vec())).into()
}

fn steps(results: &[TaskResult]) -> Vec<Block> {
    let Some(steps) = result::<Steps>(results, STEPS) else { return vec![] };
    let tips: Vec<_> = steps.tip_in.iter().map(|r| (format!("{} rpm", r.speed_rpm), r)).collect();
    let gates: Vec<_> =
        ["16 to 13 mm", "13 to 16 mm"].into_iter().map(String::from).zip(&steps.wastegate).collect();
    let shaft = [("66 to 86 kPa".to_owned(), &steps.throttle)];
    vec![
        over_time("Tip-in", ("Torque", "Nm"), |r| &r.torque_nm, &tips),
        over_time("Tip-in: boost", ("Intake pressure", "kPa"), |r| &r.map_kpa, &tips),
        over_time("Step of the wastegate at 2000 rpm", ("Intake pressure", "kPa"), |r| &r.map_kpa, &gates),
        over_time("Step of the throttle at 1500 rpm", ("Shaft", "rpm"), |r| &r.turbo_rpm, &shaft),
    ]
}

fn retard(results: &[TaskResult]) -> Vec<Block> {
    let Some(all) = result::<Vec<Retard>>(results, KNOCK) else { return vec![] };
    let mut speeds: Vec<f64> = all.iter().map(|r| r.speed_rpm).collect();
    speeds.dedup();
    let plot = |speed: f64| {
        let of = |y: fn(&Retard) -> f64| -> Vec<f64> {
            all.iter().filter(|r| r.speed_rpm == speed).map(y).collect()
        };
        let title = format!("Retard against a production table, {speed} rpm");
        XyPlot::new(
            title,
            Axis::new("Mean effective pressure", "bar"),
            Axis::new("Retard from best spark", "deg"),
        )
        .line("production", of(|r| r.bmep_bar), of(|r| r.production_deg))
        .line("twin_2l", of(|r| r.bmep_bar), of(|r| r.like_deg))
        .line("gtdi_2l", of(|r| r.bmep_bar), of(|r| r.own_deg))
    };
    speeds.into_iter().map(|s| plot(s).into()).collect()
}
