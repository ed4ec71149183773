//! Study `engine`: points that an engine cannot reach say which actuator stands at its limit, and a boosted point is held alike
//! whichever verb asks for it.
//!
//! The reason is not taken at its word: the limit that it names is moved, and the torque must follow; an actuator that it names
//! must stand at its end.

use super::checks::check;
use super::task;
use crate::asked::Asked;
use crate::{Check, StudyError, Task, TaskResult, result};
use dynocal_jobs::engine::load::{self, Grid, What};
use dynocal_jobs::engine::steady::{self, At};
use dynocal_jobs::engine::{Engine, EngineJobError};
use dynocal_numerics::watch::Watch;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{Barrier, LoadLimits, LoadPoint, LoadRequest, hold_load};
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::steady as run_to_rest;
use dynocal_report::{Cell, Column, Report, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

const REACH: &str = "engine-reach";
/// Set, speed \[rpm\] and torque \[Nm\] that it cannot have: surge, knock and boost at low speed, boost, choke, closed throttle.
const BEYOND: [(&str, f64, f64); 7] = [
    ("thesis", 2000.0, 200.0),
    ("gtdi_2l", 1000.0, 250.0),
    ("gtdi_2l", 1250.0, 320.0),
    ("gtdi_2l", 2000.0, 420.0),
    ("gtdi_2l", 4000.0, 420.0),
    ("gtdi_2l", 5500.0, 400.0),
    ("gtdi_2l", 2000.0, -60.0),
];
/// Boosted points within reach of `gtdi_2l`: speed \[rpm\], torque \[Nm\].
const BOOSTED: [(f64, f64); 3] = [(1500.0, 200.0), (2000.0, 240.0), (3000.0, 300.0)];
/// By how much a wastegate closes that is said to move nothing any more \[mm\].
const SPENT_MM: f64 = 2.0;
/// Torque that a moved limit must set free \[Nm\].
const FREED_NM: f64 = 2.0;

/// A point that cannot be had.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beyond {
    /// Set.
    pub set: String,
    /// What was asked: speed \[rpm\], torque \[Nm\].
    pub asked: (f64, f64),
    /// Torque that was held \[Nm\].
    pub held_nm: f64,
    /// Why not more; none where no reason is given.
    pub barrier: Option<Barrier>,
    /// Whether the limit or actuator that the reason names is what stands in the way.
    pub borne_out: bool,
    /// Whether the job of `dynocal engine map` leaves the point out and says the reason.
    pub said: bool,
}

/// What the task found.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Reach {
    beyond: Vec<Beyond>,
    /// Torque \[Nm\] and spark \[deg\] of `engine point` less those of `engine map`, largest of [`BOOSTED`].
    point_less_map: [f64; 2],
}

pub(super) fn tasks() -> Vec<Task> {
    vec![task(REACH.into(), json!([BEYOND, BOOSTED]), || {
        let failed = |e: EngineJobError| StudyError::Task {
            what: "points out of reach".into(),
            reason: e.to_string(),
        };
        let beyond = BEYOND.iter().map(|(set, n, t)| beyond(set, *n, *t)).collect::<Result<_, _>>();
        Ok(Reach { beyond: beyond.map_err(failed)?, point_less_map: boosted().map_err(failed)? })
    })]
}

fn hold(
    p: &EngineParams,
    speed_rpm: f64,
    torque_nm: f64,
    limits: LoadLimits,
) -> Result<LoadPoint, PlantError> {
    hold_load(&mut VirtualEngine::new(p)?, LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits })
}

/// One point beyond reach, its reason tried.
///
/// # Errors
/// As [`hold_load`], and those of the job.
pub fn beyond(set: &str, speed_rpm: f64, torque_nm: f64) -> Result<Beyond, EngineJobError> {
    let engine = Engine::named(set)?;
    let limits = LoadLimits::default();
    let found = hold(&engine.params, speed_rpm, torque_nm, limits)?;
    let borne_out = match found.barrier {
        Some(barrier) => stands(&engine.params, &found, barrier, limits)?,
        None => false,
    };
    let one = |v: f64| Grid { from: v, to: v, count: 1.0 };
    let what = What::Map { torque_nm: one(torque_nm) };
    let map = load::run(&engine, &load::Spec { what, speed_rpm: one(speed_rpm), limits }, Watch::silent())?;
    let reason = found.barrier.map_or("", Barrier::reason);
    let said = map.points().is_empty() && map.warnings.len() == 1 && map.warnings[0].ends_with(reason);
    let asked = (speed_rpm, torque_nm);
    let (held_nm, barrier) = (found.outputs.torque_nm, found.barrier);
    Ok(Beyond { set: set.into(), asked, held_nm, barrier, borne_out, said })
}

/// Whether what a reason names stands in the way: an actuator at its end, or a limit that sets torque free when it is moved.
fn stands(
    p: &EngineParams,
    at: &LoadPoint,
    barrier: Barrier,
    limits: LoadLimits,
) -> Result<bool, PlantError> {
    let u = &at.inputs;
    let frees = |moved: LoadLimits| -> Result<bool, PlantError> {
        let more = hold(p, at.request.speed_rpm, at.request.torque_nm, moved)?;
        Ok(more.outputs.torque_nm > at.outputs.torque_nm + FREED_NM)
    };
    match barrier {
        Barrier::IntakePressure => frees(LoadLimits { map_kpa: limits.map_kpa + 15.0, ..limits }),
        Barrier::TurboSpeed => frees(LoadLimits { turbo_rpm: 1.1 * limits.turbo_rpm, ..limits }),
        Barrier::Surge => frees(LoadLimits { surge_margin: limits.surge_margin - 0.1, ..limits }),
        Barrier::WastegateClosed => Ok(u.throttle_deg >= 89.9 && u.wastegate_mm <= 0.05),
        Barrier::ThrottleOpen => Ok(u.throttle_deg >= 89.9),
        Barrier::ThrottleClosed => Ok(u.throttle_deg <= 0.01),
        Barrier::Injection => Ok(u.injection_mg >= 119.9),
        Barrier::Spark => Ok(u.spark_deg <= -9.9),
        Barrier::Mixture | Barrier::Heat => frees(LoadLimits { egt_k: limits.egt_k + 30.0, ..limits }),
        Barrier::Spent => {
            let mut engine = VirtualEngine::new(p)?;
            run_to_rest(&mut engine, *u, 30.0, 0.6)?;
            let closer = Inputs { wastegate_mm: (u.wastegate_mm - SPENT_MM).max(0.0), ..*u };
            let more = run_to_rest(&mut engine, closer, 30.0, 0.6)?;
            Ok(u.throttle_deg >= 89.9 && more.torque_nm <= at.outputs.torque_nm + FREED_NM)
        }
        Barrier::Time => Ok(false),
    }
}

/// Largest differences of torque \[Nm\] and spark \[deg\] between a boosted point of `engine point` and of `engine map`.
fn boosted() -> Result<[f64; 2], EngineJobError> {
    let engine = Engine::named("gtdi_2l")?;
    let mut worst = [0.0f64; 2];
    for (speed_rpm, torque_nm) in BOOSTED {
        let map = hold(&engine.params, speed_rpm, torque_nm, LoadLimits::default())?;
        let at = At {
            speed_rpm,
            torque_nm: Some(torque_nm),
            lambda: 1.0,
            injection_mg: None,
            throttle_deg: None,
            intake_cam_deg: None,
            exhaust_cam_deg: None,
            wastegate_mm: None,
            egr_mm: None,
            spark_deg: None,
        };
        let found = steady::run(&engine, &steady::Spec::Point(at), Watch::silent())?;
        let differences = found.points.iter().map(|p| {
            [
                (p.outputs.torque_nm - map.outputs.torque_nm).abs(),
                (p.inputs.spark_deg - map.inputs.spark_deg).abs(),
            ]
        });
        for d in differences {
            worst = [worst[0].max(d[0]), worst[1].max(d[1])];
        }
    }
    Ok(worst)
}

/// The checks.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let found: Option<Reach> = result(results, REACH);
    let count =
        |of: fn(&Beyond) -> bool| found.as_ref().map(|r| r.beyond.iter().filter(|b| !of(b)).count() as f64);
    let largest = |k: usize| found.as_ref().map(|r| r.point_less_map[k]);
    let note = "seven points of thesis and gtdi_2l: more torque than there is from 1000 to 5500 rpm, less than with the throttle closed";
    let boosted = "gtdi_2l, 1500 rpm 200 Nm, 2000 rpm 240 Nm, 3000 rpm 300 Nm";
    vec![
        check(
            "reach-said",
            "Points out of reach that the map does not leave out with their reason",
            "",
            Asked::AtMost(0.0),
            count(|b| b.said),
            note,
        ),
        check(
            "reach-borne-out",
            "Points out of reach whose reason does not hold: the limit it names sets no torque free, the actuator is not at its end",
            "",
            Asked::AtMost(0.0),
            count(|b| b.borne_out),
            note,
        ),
        check(
            "reach-point-torque",
            "Largest difference of torque between engine point and engine map under boost",
            "Nm",
            Asked::AtMost(1.0),
            largest(0),
            boosted,
        ),
        check(
            "reach-point-spark",
            "Largest difference of spark between engine point and engine map under boost",
            "deg",
            Asked::AtMost(0.5),
            largest(1),
            boosted,
        ),
    ]
}

/// The table of points out of reach.
pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let Some(found) = result::<Reach>(results, REACH) else { return report };
    let head = vec![
        Column::text("Set"),
        Column::number("Speed", "rpm").digits(4),
        Column::number("Asked", "Nm").digits(4),
        Column::number("Held", "Nm").digits(4),
        Column::text("Reason"),
        Column::text("Borne out"),
    ];
    let table = found.beyond.iter().fold(Table::new(head), |t, b| {
        t.row(vec![
            Cell::from(b.set.as_str()),
            b.asked.0.into(),
            b.asked.1.into(),
            b.held_nm.into(),
            b.barrier.map_or("none given", Barrier::reason).into(),
            if b.borne_out { "yes" } else { "no" }.into(),
        ])
    });
    let text = "More torque than there is, or less than a closed throttle leaves. Borne out: the limit that the reason names sets torque free when it is moved, the actuator that it names stands at its end.";
    report.section(Section::new("Points out of reach").text(text).block(table))
}
