//! Study `engine`: the set `twin_2l` beside the measured engine that it is fitted to.
//!
//! The points lie outside the project (no licence to ship them); without the folder of the environment nothing is compared.

use super::checks::check;
use super::task;
use crate::asked::Asked;
use crate::{Check, StudyError, Task, TaskResult, result};
use dynocal_jobs::engine::fit::{self, Compare, Score};
use dynocal_jobs::engine::{Engine, EngineJobError};
use dynocal_numerics::watch::Watch;
use dynocal_report::{Axis, Block, Report, Section, XyPlot};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};

const MAP: &str = "twin-map";
const SET: &str = "twin_2l";
/// Where the measured points lie below the folder that the environment names.
const POINTS: &str = "data/engine_maps/turbo_stationary/map_2l_turbo.csv";
/// Name, least error that is asked for, unit; in the order of the comparison.
const ROWS: [(&str, f64, &str); 4] = [
    ("torque", 5.0, "Nm"),
    ("air", 3.0, "%"),
    ("exhaust temperature", 20.0, "K"),
    ("exhaust pressure", 6.0, "%"),
];

/// One measured point beside its answer.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Row {
    judged: bool,
    torque_nm: [f64; 2],
    air_g_s: [f64; 2],
    exhaust_k: [f64; 2],
    exhaust_kpa: [f64; 2],
}

/// Judged errors and all rows.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Twin {
    judged: Vec<(String, f64, usize)>,
    rows: Vec<Row>,
}

fn points() -> Option<PathBuf> {
    Some(Path::new(&std::env::var_os("DYNOCAL_REFERENCE_DIR")?).join(POINTS)).filter(|p| p.exists())
}

pub(super) fn tasks() -> Vec<Task> {
    let Some(path) = points() else { return Vec::new() };
    vec![task(MAP.into(), json!(POINTS), move || {
        run(&path).map_err(|e| StudyError::Task {
            what: "twin of the measured engine".into(),
            reason: e.to_string(),
        })
    })]
}

fn run(path: &Path) -> Result<Twin, EngineJobError> {
    let (scores, points) = fit::judge(&Engine::named(SET)?, path, Watch::silent())?;
    let judged = scores.iter().map(|s: &Score| (s.quantity.to_owned(), s.judged, s.points)).collect();
    let row = |c: &Compare| {
        let (m, y) = (&c.measured, &c.answer);
        let pair = |m: Option<f64>, y: f64, factor: f64| [factor * m.unwrap_or(y), factor * y];
        Row {
            judged: c.judged,
            torque_nm: pair(m.torque_nm, y.torque_nm, 1.0),
            air_g_s: pair(m.air_kg_s, y.air_kg_s, 1e3),
            exhaust_k: pair(m.exhaust_k, y.exhaust_k, 1.0),
            exhaust_kpa: pair(m.exhaust_pa, y.exhaust_pa, 1e-3),
        }
    };
    Ok(Twin { judged, rows: points.iter().map(row).collect() })
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let found: Option<Twin> = result(results, MAP);
    let row = |(name, asked, unit): (&str, f64, &'static str)| {
        let id = format!("twin-{}", name.replace(' ', "-"));
        let what =
            format!("Root mean square error of {name} on every third measured point, which was not fitted");
        let Some(twin) = &found else {
            return check(&id, &what, unit, Asked::Reported, None, "not compared: set DYNOCAL_REFERENCE_DIR");
        };
        let judged = twin.judged.iter().find(|j| j.0 == name);
        let note =
            "measured 2.0 l turbo engine, 306 points; driven at speed, charge and intake pressure, lambda";
        check(&id, &what, unit, Asked::AtMost(asked), judged.map(|j| j.1), note)
    };
    ROWS.into_iter().map(row).collect()
}

/// Plots.
pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let Some(twin) = result::<Twin>(results, MAP) else { return report };
    let plot = |name: &str, unit: &str, of: fn(&Row) -> [f64; 2]| -> Block {
        let side = |judged: bool| -> (Vec<f64>, Vec<f64>) {
            twin.rows.iter().filter(|r| r.judged == judged).map(of).map(|[m, y]| (m, y)).unzip()
        };
        let ((x0, y0), (x1, y1)) = (side(false), side(true));
        let ends =
            x0.iter().chain(&x1).fold((f64::INFINITY, f64::NEG_INFINITY), |e, v| (e.0.min(*v), e.1.max(*v)));
        XyPlot::new(name, Axis::new("measured", unit), Axis::new("twin_2l", unit))
            .line("equal", vec![ends.0, ends.1], vec![ends.0, ends.1])
            .points("fitted", x0, y0)
            .points("judged", x1, y1)
            .into()
    };
    let text = "Every point driven at its speed, charge and intake pressure and lambda; two thirds were fitted, a third judges. Cams and spark were not recorded: the cam schedule is inferred, the spark is best spark less a production table.";
    let blocks = vec![
        plot("Torque", "Nm", |r| r.torque_nm),
        plot("Air", "g/s", |r| r.air_g_s),
        plot("Exhaust temperature", "K", |r| r.exhaust_k),
        plot("Exhaust pressure", "kPa", |r| r.exhaust_kpa),
    ];
    report.section(Section::new("Twin of a measured engine").text(text).columns(blocks))
}
