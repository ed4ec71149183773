//! Study `engine`: the set that differs from `gtdi_2l` in structure, beside sets that differ in constants.

use super::checks::check;
use super::task;
use crate::asked::Asked;
use crate::{Check, StudyError, Task, TaskResult, result};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{LoadLimits, LoadRequest, hold_load};
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::steady;
use dynocal_plant::testbed::settings::BedOptions;
use dynocal_report::{Cell, Column, Report, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

const OTHER: &str = "engine-other-set";
const BASE: &str = "gtdi_2l";
const SET: &str = "other_1_8l";
/// Sets of the same structure with constants up to 20 % apart.
const PERTURBED: [&str; 3] = ["perturbed:gtdi_2l:1", "perturbed:gtdi_2l:2", "perturbed:gtdi_2l:3"];
/// Points whose inputs are carried over: speed \[rpm\], torque \[Nm\].
const POINTS: [(f64, f64); 4] = [(1500.0, 40.0), (2000.0, 60.0), (2500.0, 100.0), (3000.0, 120.0)];

/// One thing in which two sets differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// What.
    pub what: String,
    /// Of `gtdi_2l`.
    pub base: String,
    /// Of the other set.
    pub other: String,
}

/// What inputs of `gtdi_2l` do on another engine, largest of the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CarriedOver {
    /// Set.
    pub set: String,
    /// Torque off \[%\].
    pub torque_pct: f64,
    /// Lambda off \[%\].
    pub lambda_pct: f64,
    /// 50 % burned off \[deg\].
    pub ca50_deg: f64,
    /// 10 to 90 % burned off \[%\].
    pub burn_pct: f64,
    /// Exhaust temperature off \[K\].
    pub egt_k: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Found {
    differences: Vec<Difference>,
    carried: Vec<CarriedOver>,
}

pub(super) fn tasks() -> Vec<Task> {
    vec![task(OTHER.into(), json!([SET, PERTURBED, POINTS]), || {
        let failed = |e: PlantError| StudyError::Task { what: "other set".into(), reason: e.to_string() };
        let sets = [&[SET][..], &PERTURBED[..]].concat();
        let carried = sets.into_iter().map(carried_over).collect::<Result<_, _>>().map_err(failed)?;
        Ok(Found { differences: differences().map_err(failed)?, carried })
    })]
}

/// In what the other set and its bed differ from `gtdi_2l`: only what is not the same is listed.
///
/// # Errors
/// [`PlantError`] of a set that cannot be read.
///
/// ```
/// use dynocal_studies::engine::other::differences;
/// let all = differences()?;
/// assert!(all.iter().any(|d| d.what == "heat law"));
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn differences() -> Result<Vec<Difference>, PlantError> {
    let sets = [EngineParams::named(BASE)?, EngineParams::named(SET)?];
    let beds = [BedOptions::of_set(BASE), BedOptions::of_set(SET)];
    let of = |what: &str, value: &dyn Fn(&EngineParams) -> String| Difference {
        what: what.into(),
        base: value(&sets[0]),
        other: value(&sets[1]),
    };
    let lag = |k: usize, sensor: &str| {
        let s = beds[k].sensors.get(sensor).copied().unwrap_or_default();
        format!("{} s, {} g", s.lag_s, s.transport_g)
    };
    let sensor = |name: &str| Difference {
        what: format!("lag and transport of the sensor of {name}"),
        base: lag(0, name),
        other: lag(1, name),
    };
    let all = vec![
        of("burn law: share of the fuel in a slow tail", &|p| format!("{}", p.burn.tail_share)),
        of("burn law: exponent of the state", &|p| format!("{}", p.burn.state_exponent)),
        of("heat law", &|p| format!("{:?}", p.heat.law)),
        of("valve timing: opening of the intake valves, deg", &|p| {
            format!("{}", p.intake_valve.duration_deg)
        }),
        of("valve timing: opening of the exhaust valves, deg", &|p| {
            format!("{}", p.exhaust_valve.duration_deg)
        }),
        of("bore, mm", &|p| format!("{:.1}", 1e3 * p.geometry.bore_m)),
        of("stroke, mm", &|p| format!("{:.1}", 1e3 * p.geometry.stroke_m)),
        of("compression ratio", &|p| format!("{}", p.geometry.compression_ratio)),
        of("fuel: octane", &|p| p.knock.map_or("none".into(), |k| k.octane.to_string())),
        of("fuel: stoichiometric air", &|p| format!("{}", p.gas.afr_stoich)),
        of("fuel: heating value, MJ/kg", &|p| format!("{:.1}", 1e-6 * p.gas.lhv_j_kg)),
        of("exhaust manifold: ports apart from a wall of its own", &|p| {
            if p.exhaust_wall.is_some() { "yes" } else { "no" }.into()
        }),
        of("lag of the torque sensor, s", &|p| format!("{}", p.torque_lag_s)),
        sensor("lambda"),
        sensor("egt"),
    ];
    Ok(all.into_iter().filter(|d| d.base != d.other).collect())
}

/// Throttle, fuel and spark of `gtdi_2l` at rest on the engine `set`.
///
/// # Errors
/// As [`hold_load`].
pub fn carried_over(set: &str) -> Result<CarriedOver, PlantError> {
    let (base, other) = (EngineParams::named(BASE)?, EngineParams::named(set)?);
    let mut worst = CarriedOver {
        set: set.into(),
        torque_pct: 0.0,
        lambda_pct: 0.0,
        ca50_deg: 0.0,
        burn_pct: 0.0,
        egt_k: 0.0,
    };
    for (speed_rpm, torque_nm) in POINTS {
        let limits = LoadLimits::default();
        let mut engine = VirtualEngine::new(&base)?;
        let held = hold_load(&mut engine, LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits })?;
        let (a, b) =
            (held.outputs, steady(&mut VirtualEngine::new(&other)?, held.inputs, 4.0, 1200.0 / speed_rpm)?);
        let off = |a: f64, b: f64| 100.0 * (b / a - 1.0).abs();
        worst.torque_pct = worst.torque_pct.max(off(a.torque_nm, b.torque_nm));
        worst.lambda_pct = worst.lambda_pct.max(off(a.lambda, b.lambda));
        worst.ca50_deg = worst.ca50_deg.max((a.ca50_deg - b.ca50_deg).abs());
        worst.burn_pct = worst.burn_pct.max(off(a.burn_deg, b.burn_deg));
        worst.egt_k = worst.egt_k.max((a.egt_k - b.egt_k).abs());
    }
    Ok(worst)
}

/// The checks.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let found: Option<Found> = result(results, OTHER);
    // The six that are asked for: burn law, heat law, valve timing, bore, sensor lags, fuel.
    let asked = ["burn law", "heat law", "valve timing", "bore", "lag", "fuel"];
    let missing = found.as_ref().map(|f| {
        let there = |a: &&str| f.differences.iter().any(|d| d.what.starts_with(*a));
        asked.iter().filter(|a| !there(a)).count() as f64
    });
    let of = |set: &dyn Fn(&str) -> bool, value: fn(&CarriedOver) -> f64| {
        found.as_ref()?.carried.iter().filter(|c| set(&c.set)).map(value).reduce(f64::max)
    };
    let (other, near) = (|s: &str| s == SET, |s: &str| s != SET);
    let row = |id: &str, what: &str, unit: &'static str, value: Option<f64>, perturbed: Option<f64>| {
        let beside = perturbed.map_or("none".into(), |v| format!("{v:.3}"));
        let note =
            format!("inputs of gtdi_2l at four points, 1500 to 3000 rpm; perturbed:gtdi_2l:1 to 3: {beside}");
        check(id, &format!("{what} on {SET} with the inputs of gtdi_2l"), unit, Asked::Reported, value, &note)
    };
    vec![
        check(
            "other-structure",
            "Of burn law, heat law, valve timing, bore, sensor lags, fuel: how many are the same in other_1_8l as in gtdi_2l",
            "",
            Asked::AtMost(0.0),
            missing,
            "what differs is listed on the page",
        ),
        row(
            "other-torque",
            "Largest error of torque",
            "%",
            of(&other, |c| c.torque_pct),
            of(&near, |c| c.torque_pct),
        ),
        row(
            "other-lambda",
            "Largest error of lambda",
            "%",
            of(&other, |c| c.lambda_pct),
            of(&near, |c| c.lambda_pct),
        ),
        row(
            "other-burn",
            "Largest change of 10 to 90 % burned",
            "%",
            of(&other, |c| c.burn_pct),
            of(&near, |c| c.burn_pct),
        ),
    ]
}

/// Tables of what differs and of what it does.
pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let Some(found) = result::<Found>(results, OTHER) else { return report };
    let head = vec![Column::text("What"), Column::text(BASE), Column::text(SET)];
    let table = found.differences.iter().fold(Table::new(head), |t, d| {
        t.row(vec![Cell::from(d.what.as_str()), d.base.as_str().into(), d.other.as_str().into()])
    });
    let head = vec![
        Column::text("Set"),
        Column::number("Torque off", "%").digits(3),
        Column::number("Lambda off", "%").digits(3),
        Column::number("50 % burned off", "deg").digits(3),
        Column::number("10 to 90 % off", "%").digits(3),
        Column::number("Exhaust off", "K").digits(3),
    ];
    let carried = found.carried.iter().fold(Table::new(head), |t, c| {
        t.row(vec![
            Cell::from(c.set.as_str()),
            c.torque_pct.into(),
            c.lambda_pct.into(),
            c.ca50_deg.into(),
            c.burn_pct.into(),
            c.egt_k.into(),
        ])
    });
    let text = "What is tuned on gtdi_2l can be tried on other_1_8l, which differs in structure. Below: throttle, fuel and spark of gtdi_2l at four points, on other engines; the largest error.";
    report.section(Section::new("Another structure").text(text).block(table).block(carried))
}
