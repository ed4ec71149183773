//! Study `dynamic`: controllers of transients on real beds, ours beside rivals that are tuned on the same record.
//!
//! So far the first scenario of the table of rivals: the port-injection engine, warm, steps of 30 and 70 Nm at 2000 rpm and random
//! points. All controllers take throttle and spark from the same static map, made by the job `map` on the same bed, so that only
//! the fuel differs. One record of held random points, driven by that map, identifies all that needs identification; what a rival
//! has to tune it tunes by a line search on the bed over that record, by the lambda that the sensor shows. All are judged by the
//! lambda of the gas in the exhaust manifold.

mod bed;
mod measures;
mod rivals;

use dynocal_calib::fuelling::{self, Charge, Film, FuelPolicy, Fuelling, TransientRecord};
use dynocal_calib::map::static_map::StaticMap;
use dynocal_files::json;
use dynocal_jobs::map;
use dynocal_jobs::place::Overrides;
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::EngineBed;
use dynocal_report::{Column, Report, Section, Table};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::asked::Asked;
use crate::{Check, Options, Study, StudyError, Surroundings, Task, TaskResult, check};
use bed::{Controller, Course, MOST_MG, SAMPLE_S, Trace, bed, play};
use measures::{Measures, integral_s};
use rivals::{Ecu, Mapped, Ours};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "dynamic",
        what: "Fuel in transients on real beds: by an identified air and film model, beside static maps, lags and an ECU",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

const MAP: &str = include_str!("../../../../examples/pfi_1_6l/map.toml");
/// Seeds of the engine as it is, and engines like it.
const SEEDS: u64 = 10;
const OTHERS: u64 = 5;
/// Pressure before the throttle in kPa.
const AMBIENT_KPA: f64 = 101.325;
/// What the line searches of the rivals try: lag at 2000 rpm, time of the extrapolation, in s.
const LAGS_S: [f64; 8] = [0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2];
const AHEADS_S: [f64; 7] = [0.02, 0.04, 0.05, 0.06, 0.08, 0.1, 0.12];
/// Name of ours.
const OURS: &str = "identified air and film";

/// A controller in both courses.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Row {
    name: String,
    /// What its line search chose.
    setting: String,
    steps: Measures,
    random: Measures,
}

/// An engine with a seed.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Case {
    engine: String,
    seed: u64,
    /// Why there is nothing, where there is nothing.
    failed: Option<String>,
    fuelling: Option<Fuelling>,
    /// Bed time of the static map, of the record, and of each rival's line search, in s.
    map_s: f64,
    record_s: f64,
    search_s: f64,
    rows: Vec<Row>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let (seeds, others) = if o.reduced { (1, 0) } else { (SEEDS, OTHERS) };
    let own = (0..seeds).map(|k| ("pfi_1_6l".to_string(), o.seed + k));
    let like = (1..=others).map(|k| (format!("perturbed:pfi_1_6l:{k}"), o.seed));
    let reduced = o.reduced;
    let task = |(engine, seed): (String, u64)| {
        let name = format!("{}-{seed}", engine.replace(':', "-"));
        Task {
            name: name.clone(),
            inputs: json!([engine, seed, reduced, MAP, LAGS_S, AHEADS_S]),
            run: Box::new(move |around: &Surroundings| {
                let case = case(&name, &engine, seed, reduced, around)?;
                serde_json::to_value(case).map_err(|e| refused(&name, e.to_string()))
            }),
        }
    };
    own.chain(like).map(task).collect()
}

fn refused(what: &str, reason: String) -> StudyError {
    StudyError::Task { what: what.into(), reason }
}

/// What all controllers of a case share.
struct Shared<'a> {
    bed: &'a EngineBed,
    map: &'a StaticMap,
    fuelling: &'a Fuelling,
    steady: &'a Charge,
    record: &'a Course,
    courses: [&'a Course; 2],
    seed: u64,
}

fn case(
    name: &str,
    engine: &str,
    seed: u64,
    reduced: bool,
    around: &Surroundings,
) -> Result<Case, StudyError> {
    let fail = |reason: String| refused(name, reason);
    let (bed, params) = bed(engine).map_err(|e| fail(e.to_string()))?;
    let (map, map_s) = static_map(name, engine, seed, around)?;
    let mut rng = Rng64::stream(seed, 1);
    let record = Course::random(if reduced { 40 } else { 60 }, 3.0, &mut rng);
    let mut case = Case {
        engine: engine.into(),
        seed,
        failed: None,
        fuelling: None,
        map_s,
        record_s: record.length_s(),
        search_s: LAGS_S.len().max(AHEADS_S.len()) as f64 * record.length_s(),
        rows: Vec::new(),
    };
    let mut plain = Mapped::new(&map, 0.0).ok_or_else(|| fail("the map lacks an actuator".into()))?;
    let played = play(&bed, seed, &record, &mut plain).map_err(|e| fail(e.to_string()))?;
    around.watch.note(&format!("{engine}, seed {seed}: identifying air, film and sensor"));
    let watch = around.watch;
    let fuelling = match fuelling::identify(&view(&record, &played), &|| watch.interrupted()) {
        Err(fuelling::FuellingError::Interrupted) => return Err(StudyError::Interrupted),
        Err(e) => return Ok(Case { failed: Some(e.to_string()), ..case }),
        Ok(found) => found,
    };
    let steady_charge = fuelling::steady_charge(&view(&record, &played)).map_err(|e| fail(e.to_string()))?;
    let (steps, points) = if reduced { (2, 6) } else { (4, 40) };
    let (steps, random) = (Course::steps(steps), Course::random(points, 6.0, &mut rng));
    let shared = Shared {
        bed: &bed,
        map: &map,
        fuelling: &fuelling,
        steady: &steady_charge,
        record: &record,
        courses: [&steps, &random],
        seed: seed + 1000,
    };
    let exact = params.port.map(|f| Film { share: f.share, tau_s: f.tau_s });
    case.rows = shared.rows(exact).map_err(fail)?;
    if watch.interrupted() {
        return Err(StudyError::Interrupted);
    }
    case.fuelling = Some(fuelling);
    Ok(case)
}

/// The static map of the job `map`, over the range of the scenario.
fn static_map(
    name: &str,
    engine: &str,
    seed: u64,
    around: &Surroundings,
) -> Result<(StaticMap, f64), StudyError> {
    let fail = |reason: String| refused(name, reason);
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
        Err(map::MapError::Interrupted) => return Err(StudyError::Interrupted),
        Err(e) => return Err(fail(e.to_string())),
    };
    let path = out.join("steps/01-map/static_map.json");
    Ok((json::read_versioned(&path, "dynocal/static-map", 2)?, found.bed.all_s()))
}

/// A record as the identification takes it.
fn view<'a>(course: &'a Course, trace: &'a Trace) -> TransientRecord<'a> {
    TransientRecord {
        sample_time_s: SAMPLE_S,
        speed_rpm: &course.speed_rpm,
        throttle_deg: &trace.throttle_deg,
        injection: &trace.injection_mg,
        map_kpa: &trace.map_kpa,
        lambda: &trace.lambda,
        upstream_kpa: AMBIENT_KPA,
    }
}

/// A rival with what it tunes.
enum Rival {
    Map {
        searched: bool,
    },
    /// With the charge from the steady ends of the record, or with that which ours has.
    Ecu {
        searched: bool,
        film: Option<Film>,
        steady: bool,
    },
    Ours,
}

impl Shared<'_> {
    fn rows(&self, exact: Option<Film>) -> Result<Vec<Row>, String> {
        let fitted = Some(self.fuelling.film);
        let mut all = vec![
            ("static map".to_string(), Rival::Map { searched: false }),
            ("static map, lag".into(), Rival::Map { searched: true }),
            (OURS.into(), Rival::Ours),
        ];
        let films = [("", None), (", film from the record", fitted), (", film of the engine itself", exact)];
        let ecu = |searched, film, steady| Rival::Ecu { searched, film, steady };
        all.push(("ECU".into(), ecu(false, None, true)));
        for (words, film) in films.iter().filter(|(words, film)| words.is_empty() || film.is_some()) {
            all.push((format!("ECU, extrapolated{words}"), ecu(true, *film, true)));
            all.push((format!("ECU, extrapolated{words}, charge of ours"), ecu(true, *film, false)));
        }
        all.par_iter().map(|(name, rival)| self.row(name, rival)).collect()
    }

    fn controller(&self, rival: &Rival, value_s: f64) -> Option<Box<dyn Controller + '_>> {
        let base = |lag_s: f64| Mapped::new(self.map, lag_s);
        Some(match rival {
            Rival::Map { .. } => Box::new(base(value_s)?),
            Rival::Ecu { film, steady, .. } => {
                let charge = if *steady { self.steady } else { &self.fuelling.charge };
                Box::new(Ecu::new(base(0.0)?, charge, value_s, *film))
            }
            Rival::Ours => {
                let policy = FuelPolicy::new(self.fuelling.clone(), MOST_MG);
                Box::new(Ours { base: base(0.0)?, policy })
            }
        })
    }

    fn played(&self, course: &Course, rival: &Rival, value_s: f64) -> Result<Trace, String> {
        let mut controller = self.controller(rival, value_s).ok_or("the map lacks an actuator")?;
        play(self.bed, self.seed, course, controller.as_mut()).map_err(|e| e.to_string())
    }

    fn row(&self, name: &str, rival: &Rival) -> Result<Row, String> {
        let tried: &[f64] = match rival {
            Rival::Map { searched: true } => &LAGS_S,
            Rival::Ecu { searched: true, .. } => &AHEADS_S,
            _ => &[],
        };
        let mut best: Option<(f64, f64)> = None;
        for value in tried {
            let shown = integral_s(&self.played(self.record, rival, *value)?.lambda);
            if best.is_none_or(|b| shown < b.0) {
                best = Some((shown, *value));
            }
        }
        let value_s = best.map_or(0.0, |b| b.1);
        let measured =
            |course: &Course| Ok::<_, String>(Measures::of(&self.played(course, rival, value_s)?, course));
        let [steps, random] = [measured(self.courses[0])?, measured(self.courses[1])?];
        let setting = if tried.is_empty() { "-".into() } else { format!("{value_s} s") };
        Ok(Row { name: name.into(), setting, steps, random })
    }
}

fn cases(results: &[TaskResult]) -> Vec<Case> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}

/// Ours over the best rival, whichever that is for this measure.
fn ratio(case: &Case, of: &dyn Fn(&Row) -> f64) -> Option<f64> {
    let ours = case.rows.iter().find(|r| r.name == OURS).map(of)?;
    let best = case.rows.iter().filter(|r| r.name != OURS).map(of).reduce(f64::min)?;
    Some(ours / best)
}

/// Mean of the seeds with its standard error in words; the worst of engines.
fn judged(id: &str, what: &str, asked: Asked, ratios: &[Option<f64>], worst: bool) -> Check {
    let all: Option<Vec<f64>> = ratios.iter().copied().collect();
    let all = all.filter(|a| !a.is_empty());
    let mean = all.as_ref().map(|a| a.iter().sum::<f64>() / a.len() as f64);
    let measured = if worst { asked.worst(ratios) } else { mean };
    let note = match (&all, mean) {
        (Some(a), Some(m)) if a.len() > 1 => {
            let variance = a.iter().map(|x| (x - m).powi(2)).sum::<f64>() / (a.len() - 1) as f64;
            let error = (variance / a.len() as f64).sqrt();
            let each: Vec<String> = a.iter().map(|x| format!("{x:.3}")).collect();
            format!("mean {m:.3}, standard error {error:.3}; each: {}", each.join(", "))
        }
        _ => String::new(),
    };
    check(id, what, asked, measured, "-", note)
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let (own, like): (Vec<&Case>, Vec<&Case>) = all.iter().partition(|c| c.engine == "pfi_1_6l");
    type Of = fn(&Row) -> f64;
    let measures: [(&str, &str, f64, Of); 4] = [
        ("steps-integral", "steps of 30 and 70 Nm: integral of |lambda - 1|", 1.0 / 3.0, |r| {
            r.steps.integral_s
        }),
        ("steps-spike", "steps of 30 and 70 Nm: largest spike of lambda", 0.5, |r| r.steps.spike()),
        ("random-integral", "random points: integral of |lambda - 1|", 1.0 / 3.0, |r| r.random.integral_s),
        ("random-spike", "random points: largest spike of lambda", 0.5, |r| r.random.spike()),
    ];
    let mut checks = Vec::new();
    for (engines, suffix, words, worst) in [
        (&own, "", "over the best rival's, mean of seeds", false),
        (&like, "-others", "over the best rival's, worst of engines like it", true),
    ] {
        if engines.is_empty() && worst {
            continue;
        }
        for (id, what, most, of) in measures {
            let ratios: Vec<Option<f64>> = engines.iter().map(|c| ratio(c, &of)).collect();
            let asked = Asked::AtMost((most * 1e4_f64).round() / 1e4);
            checks.push(judged(
                &format!("1-{id}{suffix}"),
                &format!("{what}, {words}"),
                asked,
                &ratios,
                worst,
            ));
        }
    }
    let t90: Vec<Option<f64>> = all.iter().map(|c| ratio(c, &|r| r.steps.t90_s)).collect();
    checks.push(judged(
        "1-t90",
        "steps: time until 90 % of the torque, over the fastest rival's",
        Asked::Reported,
        &t90,
        false,
    ));
    let bed = all.iter().map(|c| Some(c.record_s)).collect::<Vec<_>>();
    // The length of the record is the study's own: nothing to hold.
    checks.push(check(
        "1-bed-time",
        "bed time of ours beyond the static map's",
        Asked::Reported,
        Asked::Reported.worst(&bed),
        "s",
        "the line searches of the rivals took more, which is not counted against them",
    ));
    let failed: Vec<String> = all
        .iter()
        .filter_map(|c| c.failed.as_ref().map(|f| format!("{}, seed {}: {f}", c.engine, c.seed)))
        .collect();
    let count = failed.len() + results.len() - all.len();
    checks.push(check(
        "1-failed",
        "cases without a controller",
        Asked::AtMost(0.0),
        Some(count as f64),
        "-",
        failed.join("; "),
    ));
    checks
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    let mut report = report;
    for case in cases(results) {
        let head = vec![
            Column::text("Fuel by"),
            Column::text("Line search"),
            Column::number("Steps: integral", "s").digits(3),
            Column::number("lean", "").digits(3),
            Column::number("rich", "").digits(3),
            Column::number("t90", "s").digits(3),
            Column::number("Random: integral", "s").digits(3),
            Column::number("lean", "").digits(3),
            Column::number("rich", "").digits(3),
            Column::number("Largest offset", "").digits(2),
        ];
        let table = case.rows.iter().fold(Table::new(head), |t, r| {
            let (s, p) = (&r.steps, &r.random);
            let cells = vec![
                r.name.as_str().into(),
                r.setting.as_str().into(),
                s.integral_s.into(),
                s.lean.into(),
                s.rich.into(),
                s.t90_s.into(),
                p.integral_s.into(),
                p.lean.into(),
                p.rich.into(),
                p.offset.into(),
            ];
            if r.name == OURS { t.stressed_row(cells) } else { t.row(cells) }
        });
        let found = case.fuelling.as_ref().map_or(case.failed.clone().unwrap_or_default(), |f| {
            format!(
                "Identified from {:.0} s: film {:.3} and {:.3} s, throttle lag {:.3} s, sensor lag {:.3} s, air {:.0} ms after the command at 2000 rpm; 1 / lambda within {:.4}, pressure within {:.2} kPa (root mean square).",
                case.record_s,
                f.film.share,
                f.film.tau_s,
                f.filling.throttle_lag_s,
                f.timing.sensor_lag_s,
                1e3 * f.timing.ahead_s(2000.0),
                f.rms,
                f.pressure_rms_kpa
            )
        });
        let title = format!("{}, seed {}", case.engine, case.seed);
        report = report.section(Section::new(title.as_str()).text(found.as_str()).block(table));
    }
    report
}
