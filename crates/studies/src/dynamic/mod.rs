//! Study `dynamic`: controllers of transients on real beds, ours beside rivals that are tuned on the same record.
//!
//! Seven scenarios of the table of rivals: three with fuel alone, here; the boosted engine in `boost`, the cold catalyst in `heating`,
//! drive cycles in `cycles`. On the port-injection engine the first two: warm, steps of 30 and 70 Nm at 2000 rpm
//! and random points; and the steps with the coolant at 20, 50 and 90 degC at the start. On the engine of the thesis and its ideal bed
//! the sixth: random points and steps over the range that the thesis gives. All controllers take throttle and spark
//! from the same static map, made by the job `map` on the same bed, so that only the fuel differs. Records of held random points,
//! driven by that map, identify all that needs identification: one of 180 s, in the second scenario three of 120 s that start at
//! 20, 50 and 90 degC. What a rival has to tune it tunes by line searches on the bed over those records, by the
//! lambda that the sensor shows. What was identified drives as many records again (twice as many where there is one), where the mixture
//! is near its demand and small errors of the model show, with fuel that is moved in the middle of each hold, and is identified from all of them; rivals tune on all of them too. All are judged by the lambda of the gas
//! in the exhaust manifold. Beside them stands what is possible: fuel that is learned by trials on the judged record itself.

mod bed;
mod boost;
mod contest;
mod cycles;
mod engines;
mod heating;
mod judge;
mod learned;
mod measures;
mod page;
mod rivals;
mod scenario;

use dynocal_calib::fuelling::Fuelling;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_files::json;
use dynocal_jobs::map;
use dynocal_jobs::place::Overrides;
use dynocal_numerics::registry::MemberDoc;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{Options, Study, StudyError, Surroundings, Task, TaskResult};
use bed::exact_film;
use contest::{Contest, Ended, Row};
use scenario::{SCENARIOS, STARTS_C, Scenario};

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
/// Seeds of the engine as it is, and engines like it; engines of another kind are in [`engines`].
const SEEDS: u64 = 10;
const OTHERS: u64 = 5;

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
    let engines_of = |number: usize, engine: &str| {
        let own = (0..seeds).map(|k| (engine.to_string(), o.seed + k));
        let like = (1..=others).map(|k| (format!("perturbed:{engine}:{k}"), o.seed));
        let boosted = engine == boost::ENGINE && !o.reduced;
        let unlike = engines::UNLIKE.iter().filter(|_| boosted).map(|e| (e.to_string(), o.seed));
        own.chain(like).chain(unlike).map(|(engine, seed)| (number, engine, seed)).collect::<Vec<_>>()
    };
    let reduced = o.reduced;
    let task = |(scenario, engine, seed): (usize, String, u64)| {
        let name = format!("{scenario}-{}-{seed}", engine.replace(':', "-"));
        let tried =
            json!([contest::LAGS_S, contest::AHEADS_S, contest::CLOSED_S, learned::PROBED, bed::MOVED]);
        Task {
            name: name.clone(),
            inputs: json!([scenario, engine, seed, reduced, MAP, STARTS_C, tried]),
            run: Box::new(move |around: &Surroundings| {
                let case = case(scenario, &engine, seed, reduced, around)?;
                serde_json::to_value(case).map_err(|e| refused(&name, e.to_string()))
            }),
        }
    };
    let boosted = |(_, engine, seed): (usize, String, u64)| {
        let name = format!("3-{}-{seed}", engine.replace(':', "-"));
        Task {
            name: name.clone(),
            inputs: json!([3, engine, seed, reduced, contest::AHEADS_S, contest::CLOSED_S, boost::TRIED]),
            run: Box::new(move |around: &Surroundings| {
                let watch = around.watch;
                watch.note(&format!("{engine}, seed {seed}, scenarios 3 and 4: records, searches, tip-ins"));
                boost::case(&name, &engine, seed, reduced, &|| watch.interrupted())
            }),
        }
    };
    let tips = engines_of(3, boost::ENGINE).into_iter().map(boosted);
    let heated = |(_, engine, seed): (usize, String, u64)| {
        let name = format!("5-{}-{seed}", engine.replace(':', "-"));
        Task {
            name: name.clone(),
            inputs: json!([5, engine, seed, reduced, heating::TRIED]),
            run: Box::new(move |around: &Surroundings| {
                let watch = around.watch;
                watch.note(&format!("{engine}, seed {seed}, scenario 5: retards from cold"));
                heating::case(&name, &engine, seed, reduced, &|| watch.interrupted())
            }),
        }
    };
    let tips = tips.chain(engines_of(5, heating::ENGINE).into_iter().map(heated));
    let fuelled = SCENARIOS.iter().flat_map(|s| engines_of(s.number, s.engine)).map(task);
    tips.chain(fuelled).chain(cycles::tasks(o)).collect()
}

fn refused(what: &str, reason: String) -> StudyError {
    StudyError::Task { what: what.into(), reason }
}

/// A case; what fails in it is its result, and not the end of the study.
fn case(
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
    match filled(&mut case, reduced, around) {
        Ok(()) => {}
        Err(Ended::Interrupted) => return Err(StudyError::Interrupted),
        Err(Ended::Failed(reason)) => case.failed = Some(reason),
    }
    Ok(case)
}

fn filled(case: &mut Case, reduced: bool, around: &Surroundings) -> Result<(), Ended> {
    let scenario = Scenario::of(case.scenario).ok_or_else(|| "no such scenario".to_string())?;
    let (map, map_s) = static_map(scenario, case, around)?;
    case.map_s = map_s;
    let [records, repeated, judged] = scenario.drives(&case.engine, case.seed, reduced)?;
    let exact = exact_film(&case.engine).map_err(|e| e.to_string())?;
    let contest = Contest {
        map: &map,
        records: &records,
        repeated: &repeated,
        judged: &judged,
        seed: case.seed,
        exact,
        plain: case.scenario != 2,
        stride: if reduced { 2 } else { 1 },
    };
    case.record_s = contest.record_s();
    let watch = around.watch;
    watch.note(&format!(
        "{}, seed {}, scenario {}: records, line searches, courses",
        case.engine, case.seed, case.scenario
    ));
    let (fuelling, rows) = contest.run(&|| watch.interrupted())?;
    case.courses = scenario.courses().into_iter().map(|c| c.1).collect();
    (case.fuelling, case.rows) = (Some(fuelling), rows);
    Ok(())
}

/// The static map of the job `map`, over the range of the scenario. The first two share engine and range, and so the run.
fn static_map(scenario: &Scenario, case: &Case, around: &Surroundings) -> Result<(StaticMap, f64), Ended> {
    let fail = Ended::Failed;
    let real = if scenario.real { "-real" } else { "" };
    let out = around.runs.join(format!("map-{}-{}{real}", case.engine.replace(':', "-"), case.seed));
    let over = Overrides { seed: Some(case.seed), out: Some(out.clone()) };
    let mut job = map::job::parse("map.toml", MAP, &over).map_err(|e| fail(e.to_string()))?;
    scenario.range(&case.engine, &mut job.spec);
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
