//! The page of identified fuelling.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_report::{Axis, Cell, Column, HeatMap, Panel, Report, Section, Table, TimePlot, XyPlot, render};

use super::result::{Fuelled, Shown, best_rival};
use super::store;
use crate::page::PageError;

/// Most samples of a plot.
const DRAWN: usize = 4000;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(found: &Fuelled, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(found))?.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(found: &Fuelled) -> Report {
    let mut report = Report::new(format!("Fuel by measured states: {}", found.name));
    for line in &found.verdict {
        report = report.verdict(line.as_str());
    }
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    if !found.driven.is_empty() {
        report = report.section(driven(found));
    }
    report = report.section(scores(found)).section(identified(found));
    for shown in found.records.iter().filter(|s| s.role == "unseen") {
        report = report.section(record(shown));
    }
    report
}

fn driven(found: &Fuelled) -> Section {
    let head = vec![
        Column::text("Who gave the fuel"),
        Column::text("Tuned"),
        Column::number("Mean |lambda - 1|", "%").digits(3),
        Column::number("Leanest", "%").digits(3),
        Column::number("Richest", "%").digits(3),
    ];
    let rows = found.driven.iter().fold(Table::new(head), |t, d| {
        let share = |v: f64| Cell::from(100.0 * v);
        t.row(vec![
            d.name.as_str().into(),
            d.setting.as_str().into(),
            share(d.mean),
            share(d.lean),
            share(d.rich),
        ])
    });
    let mut section = Section::new("Driven on the plant")
        .text("The same course of throttle and speed for all; nobody was tuned on it. Lambda is what the sensor shows, behind its lag. The ECU compensates the film that was identified here and tunes its extrapolation and its loop by line searches on the second record.")
        .block(rows);
    let of = |name: &str| found.records.iter().find(|s| s.role == name);
    let best = best_rival(&found.driven);
    let pair = (found.driven.first().and_then(|d| of(&d.name)), best.and_then(|d| of(&d.name)));
    if let (Some(ours), Some(rival)) = pair {
        let n = ours.record.lambda.len().min(DRAWN);
        let cut = |v: &[f64]| v[..n].to_vec();
        let lambda = Panel::new("lambda", "-")
            .line(ours.role.as_str(), cut(&ours.record.lambda))
            .line(rival.role.as_str(), cut(&rival.record.lambda));
        let plot = TimePlot::sampled("Ours beside the best rival", ours.record.sample_time_s, n)
            .panel(lambda)
            .panel(Panel::new("throttle", "deg").held("throttle", cut(&ours.record.throttle_deg)))
            .panel(Panel::new("speed", "rpm").line("speed", cut(&ours.record.speed_rpm)));
        section = section.block(cut_words(plot, n, ours.record.lambda.len()));
    }
    section
}

fn cut_words(plot: TimePlot, n: usize, all: usize) -> TimePlot {
    if n < all { plot.caption(format!("The first {n} of {all} samples.")) } else { plot }
}

fn scores(found: &Fuelled) -> Section {
    let head = vec![
        Column::text("Record"),
        Column::text("Role"),
        Column::number("Length", "s").digits(3),
        Column::number("Error of 1 / lambda", "%").digits(3),
        Column::number("without a film", "%").digits(3),
        Column::number("of the mixture from 1", "%").digits(3),
        Column::number("Outside", "%").digits(3),
    ];
    let table = found.scores.iter().fold(Table::new(head), |t, s| {
        let share = |v: f64| Cell::from(100.0 * v);
        t.row(vec![
            s.record.as_str().into(),
            s.role.into(),
            s.length_s.into(),
            share(s.rms),
            share(s.rms_without_film),
            share(s.rms_of_mixture),
            share(s.outside),
        ])
    });
    Section::new("What the model shows of the records")
        .text("Root mean squares. The model runs free: it sees speed, throttle, pressure and fuel, and no lambda. The model without a film was identified from the same records. Outside: samples beyond the speeds and pressures that identified.")
        .block(table)
}

fn identified(found: &Fuelled) -> Section {
    let f = &found.fuelling;
    let head = vec![Column::text("What"), Column::number("Value", "").digits(4), Column::text("Unit")];
    let mut rows = vec![
        ("share of the fuel that wets the wall, middle of speed and pressure", f.film.share, "-"),
        ("time constant of its evaporation, there", f.film.tau_s, "s"),
        ("from injection to its air, constant part", f.timing.charge_s, "s"),
        ("and in cycles", f.timing.charge_cycles, "cycles"),
        ("transport to the sensor", f.timing.transport_cycles, "cycles"),
        ("transport through volumes, as fuel at lambda 1", f.timing.transport_fuel, "unit of the injection"),
        (
            "mixing in a volume, as fuel at lambda 1 in its time constant",
            f.timing.mixing_fuel,
            "unit of the injection",
        ),
        ("lag of the sensor", f.timing.sensor_lag_s, "s"),
        (
            "lag of the pressure channel beside its mean over a cycle, 0 or a sample",
            f.filling.sensor_lag_s,
            "s",
        ),
        ("lag of the throttle", f.filling.throttle_lag_s, "s"),
        ("error of the manifold pressure", f.pressure_rms_kpa, "kPa"),
    ];
    if let Some(rate) = f.filling.throttle_rate_deg_s {
        rows.push(("greatest rate of the throttle", rate, "deg/s"));
    }
    if let Some(law) = &f.coolant {
        rows.push(("time constant of the film at the coldest coolant", f.film_at(law.range_c[0]).tau_s, "s"));
        rows.push(("and at the warmest", f.film_at(law.range_c[1]).tau_s, "s"));
    }
    if let Some(e) = &f.film_ends {
        for (what, [speed, pressure]) in [
            ("share over one minus share, logarithm for half the range of the speed", e.share),
            ("time constant of the film, logarithm for half the range of the speed", e.tau),
        ] {
            rows.push((what, speed, "-"));
            rows.push(("the same for half the range of the pressure", pressure, "-"));
        }
    }
    if let Some([_, [intake, exhaust]]) = f.charge.cams_at(f.charge.speed_rpm[0], f.charge.pressure_kpa[0]) {
        rows.push((
            "charge for one degree of the intake cam, middle of the records",
            100.0 * intake,
            "%/deg",
        ));
        rows.push(("and of the exhaust cam", 100.0 * exhaust, "%/deg"));
    }
    if let Some(trim) = &f.trim {
        rows.push(("time constant of the lambda trim", trim.time_s, "s"));
    }
    let table = rows
        .into_iter()
        .fold(Table::new(head), |t, (what, v, unit)| t.row(vec![what.into(), Cell::from(v), unit.into()]));
    let unit = found.records.first().map_or("-", |s| s.record.injection_unit.as_str());
    let (speeds, pressures) = (&found.tables.speed_rpm, &found.tables.map_kpa);
    let z = pressures.iter().flat_map(|p| speeds.iter().map(|n| f.charge.at(*n, *p))).collect();
    let map = HeatMap::new(
        "Fuel per cycle that makes lambda 1",
        (Axis::new("speed", "rpm"), speeds.clone()),
        (Axis::new("manifold pressure", "kPa"), pressures.clone()),
        (Axis::new("fuel", unit), z),
    )
    .contours()
    .caption("Every breakpoint is a cell. At the coolant of reference, where the coolant counts.");
    let throttle = store::throttle(f, &found.seen);
    let curve = XyPlot::new(
        "Throttle",
        Axis::new("throttle", "deg"),
        Axis::new("choked flow as fuel at lambda 1", format!("{unit}/s")),
    )
    .line(
        "identified",
        throttle.iter().map(|r| r[0]).collect::<Vec<_>>(),
        throttle.iter().map(|r| r[1]).collect::<Vec<_>>(),
    );
    Section::new("What was identified").block(table).block(map).block(curve)
}

fn record(shown: &Shown) -> Section {
    let r = &shown.record;
    let n = r.lambda.len().min(DRAWN);
    let cut = |v: &[f64]| v[..n].to_vec();
    let measured: Vec<f64> = r.lambda[..n].iter().map(|l| 1.0 / l).collect();
    let plot = TimePlot::sampled("What the sensor shows, and what the model says of it", r.sample_time_s, n)
        .panel(Panel::new("1 / lambda", "-").measured(measured).simulated(cut(&shown.richness)))
        .panel(Panel::new("injection", r.injection_unit.as_str()).held("injection", cut(&r.injection)))
        .panel(Panel::new("manifold pressure", "kPa").line("pressure", cut(&r.map_kpa)))
        .panel(Panel::new("throttle", "deg").held("throttle", cut(&r.throttle_deg)))
        .panel(Panel::new("speed", "rpm").line("speed", cut(&r.speed_rpm)));
    Section::new(format!("Unseen record {}", r.name)).block(cut_words(plot, n, r.lambda.len()))
}
