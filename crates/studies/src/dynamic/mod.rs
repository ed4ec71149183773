//! Study `dynamic`: controllers of transients on real beds, ours beside rivals that are tuned on the same record.
//!
//! So far the first two scenarios of the table of rivals, on the port-injection engine: warm, steps of 30 and 70 Nm at 2000 rpm
//! and random points; and the steps with the coolant at 20, 50 and 90 degC at the start. All controllers take throttle and spark
//! from the same static map, made by the job `map` on the same bed, so that only the fuel differs. Records of held random points,
//! driven by that map, identify all that needs identification: one of 180 s for the first scenario, three of 120 s that start at
//! 20, 50 and 90 degC for the second. What a rival has to tune it tunes by line searches on the bed over those records, by the
//! lambda that the sensor shows. All are judged by the lambda of the gas in the exhaust manifold.

mod bed;
mod contest;
mod judge;
mod measures;
mod page;
mod rivals;

use dynocal_calib::fuelling::Fuelling;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_files::json;
use dynocal_jobs::map;
use dynocal_jobs::place::Overrides;
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{Options, Study, StudyError, Surroundings, Task, TaskResult};
use bed::{Course, bed, exact_film};
use contest::{Contest, Drive, Ended, Row};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "dynamic",
        what: "Fuel in transients on real beds: by an identified air and film model, beside static maps, lags and an ECU",
        params: &[],
    },
    tasks,
    reduce: judge::reduce,
    sections: page::sections,
};

const MAP: &str = include_str!("../../../../examples/pfi_1_6l/map.toml");
/// The engine of the first two scenarios.
const ENGINE: &str = "pfi_1_6l";
/// Seeds of the engine as it is, and engines like it.
const SEEDS: u64 = 10;
const OTHERS: u64 = 5;
/// Coolant at the start in the second scenario, in degC.
const STARTS_C: [f64; 3] = [20.0, 50.0, 90.0];

/// An engine with a seed in a scenario.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Case {
    scenario: usize,
    engine: String,
    seed: u64,
    /// Why there is nothing, where there is nothing.
    failed: Option<String>,
    fuelling: Option<Fuelling>,
    /// Bed time of the static map and of the records in s.
    map_s: f64,
    record_s: f64,
    /// Names of the judged courses.
    courses: Vec<String>,
    rows: Vec<Row>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let (seeds, others) = if o.reduced { (1, 0) } else { (SEEDS, OTHERS) };
    let own = (0..seeds).map(|k| (ENGINE.to_string(), o.seed + k));
    let like = (1..=others).map(|k| (format!("perturbed:{ENGINE}:{k}"), o.seed));
    let engines: Vec<(String, u64)> = own.chain(like).collect();
    let reduced = o.reduced;
    let task = |(scenario, (engine, seed)): (usize, (String, u64))| {
        let name = format!("{scenario}-{}-{seed}", engine.replace(':', "-"));
        let tried = json!([contest::LAGS_S, contest::AHEADS_S, contest::CLOSED_S]);
        Task {
            name: name.clone(),
            inputs: json!([scenario, engine, seed, reduced, MAP, STARTS_C, tried]),
            run: Box::new(move |around: &Surroundings| {
                let case = case(&name, scenario, &engine, seed, reduced, around)?;
                serde_json::to_value(case).map_err(|e| refused(&name, e.to_string()))
            }),
        }
    };
    [1, 2].into_iter().flat_map(|s| engines.iter().cloned().map(move |e| (s, e))).map(task).collect()
}

fn refused(what: &str, reason: String) -> StudyError {
    StudyError::Task { what: what.into(), reason }
}

/// A case; what fails in it is its result, and not the end of the study.
fn case(
    name: &str,
    scenario: usize,
    engine: &str,
    seed: u64,
    reduced: bool,
    around: &Surroundings,
) -> Result<Case, StudyError> {
    let mut case = Case {
        scenario,
        engine: engine.into(),
        seed,
        failed: None,
        fuelling: None,
        map_s: 0.0,
        record_s: 0.0,
        courses: Vec::new(),
        rows: Vec::new(),
    };
    match filled(&mut case, name, reduced, around) {
        Ok(()) => {}
        Err(Ended::Interrupted) => return Err(StudyError::Interrupted),
        Err(Ended::Failed(reason)) => case.failed = Some(reason),
    }
    Ok(case)
}

fn filled(case: &mut Case, name: &str, reduced: bool, around: &Surroundings) -> Result<(), Ended> {
    let (map, map_s) = static_map(name, &case.engine, case.seed, around)?;
    case.map_s = map_s;
    let (courses, records, judged) = drives(case.scenario, &case.engine, case.seed, reduced)?;
    let exact = exact_film(&case.engine).map_err(|e| e.to_string())?;
    let contest = Contest {
        map: &map,
        records: &records,
        judged: &judged,
        seed: case.seed,
        exact,
        plain: case.scenario == 1,
        stride: if reduced { 2 } else { 1 },
    };
    case.record_s = contest.record_s();
    let watch = around.watch;
    watch.note(&format!(
        "{}, seed {}, scenario {}: records, line searches, courses",
        case.engine, case.seed, case.scenario
    ));
    let (fuelling, rows) = contest.run(&|| watch.interrupted())?;
    (case.fuelling, case.rows, case.courses) = (Some(fuelling), rows, courses);
    Ok(())
}

/// Names of the judged courses, the records, and the judged courses.
type Drives = (Vec<String>, Vec<Drive>, Vec<Drive>);

/// Those of a scenario.
fn drives(scenario: usize, engine: &str, seed: u64, reduced: bool) -> Result<Drives, String> {
    let mut rng = Rng64::stream(seed, scenario as u64);
    let on = |start_c: Option<f64>, course: Course| {
        bed(engine, start_c).map(|bed| Drive { bed, course }).map_err(|e| e.to_string())
    };
    if scenario == 1 {
        let record = Course::random(if reduced { 40 } else { 60 }, 3.0, &mut rng);
        let (steps, points) = if reduced { (2, 6) } else { (4, 40) };
        let (steps, random) = (Course::steps(steps), Course::random(points, 6.0, &mut rng));
        let names = vec!["steps".to_string(), "random points".into()];
        return Ok((names, vec![on(None, record)?], vec![on(None, steps)?, on(None, random)?]));
    }
    let (mut names, mut records, mut judged) = (Vec::new(), Vec::new(), Vec::new());
    for start_c in STARTS_C {
        names.push(format!("{start_c} degC"));
        records.push(on(Some(start_c), Course::random(if reduced { 20 } else { 40 }, 3.0, &mut rng))?);
        judged.push(on(Some(start_c), Course::steps(if reduced { 2 } else { 4 }))?);
    }
    Ok((names, records, judged))
}

/// The static map of the job `map`, over the range of the scenario.
fn static_map(name: &str, engine: &str, seed: u64, around: &Surroundings) -> Result<(StaticMap, f64), Ended> {
    let fail = Ended::Failed;
    let out = around.runs.join(name);
    let over = Overrides { seed: Some(seed), out: Some(out.clone()) };
    let mut job = map::job::parse("map.toml", MAP, &over).map_err(|e| fail(e.to_string()))?;
    job.spec.plant.parameters = engine.into();
    job.spec.axes.insert("torque".into(), vec![20.0, 35.0, 50.0, 65.0, 80.0]);
    job.spec.axes.insert("speed".into(), vec![1100.0, 1550.0, 2000.0, 2450.0, 2900.0]);
    for d in job.spec.problem.demands.iter_mut().filter(|d| d.output == "torque") {
        (d.lower, d.upper) = (17.0, 85.0);
    }
    for g in job.spec.problem.given.iter_mut().filter(|g| g.name == "speed") {
        (g.lower, g.upper) = (1050.0, 3000.0);
    }
    let found = match map::run(&job, around.watch) {
        Ok((found, _)) => found,
        Err(map::MapError::Interrupted) => return Err(Ended::Interrupted),
        Err(e) => return Err(fail(format!("static map: {e}"))),
    };
    let path = out.join("steps/01-map/static_map.json");
    let map = json::read_versioned(&path, "dynocal/static-map", 2).map_err(|e| fail(e.to_string()))?;
    Ok((map, found.bed.all_s()))
}

fn cases(results: &[TaskResult]) -> Vec<Case> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}
