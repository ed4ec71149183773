//! Study `design`: how good the default search for test signals is, case by case, and what proves it.
//!
//! One task per case of the comparison problems of thesis chapter 4: ten single starts, two longer ones that together
//! stay below 60 CPU seconds (their length is a number of evaluations, measured once; the clock decides nothing), and
//! what can be said about the result without another search: the bound that no record passes for D, optimality
//! conditions for G and E. The interior point is CasADi with IPOPT on the same problems; best known is the lowest value
//! of all its starts and of an independent iterated local search.

mod cases;
mod tables;

use crate::StudyError;
use crate::chapter4::work::Setting;
use crate::chapter4::work::statistics::median;
use cases::{CASES, Case, Kind};
use dynocal_design::certificate::Certificate;
use dynocal_design::criterion::criterion;
use dynocal_design::search::{DesignOptions, design, random_record};
use dynocal_design::stationarity::stationarity;
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::asked::Asked;
use super::{Check, Options, Study, Surroundings, Task, TaskResult};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "design",
        what: "The default search for test signals: objectives against an interior point and best known values, bounds, optimality",
        params: &[],
    },
    tasks,
    reduce,
    sections: tables::sections,
};

/// Single starts.
const STARTS: u64 = 10;
/// Evaluations per start of the longer search, and its starts: 20 to 40 CPU seconds for most cases on the machine it was
/// measured on.
const LONG: (usize, usize) = (400_000, 2);
/// The same at reduced length.
const SHORT: (usize, usize) = (3_000, 2);
/// Pieces of G and E within this share of the worst are active.
const BAND: f64 = 0.01;

/// How long a case is searched.
#[derive(Clone, Copy, Serialize)]
struct Length {
    starts: u64,
    long: (usize, usize),
    certify: bool,
    seed: u64,
}

/// What a case gave.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Found {
    /// Criterion of every single start, as the search minimises it.
    singles: Vec<f64>,
    /// Of the longer search.
    long: f64,
    /// Evaluations of all single starts and of the longer search.
    evaluations: (usize, usize),
    /// Largest violation of an output limit in Nm, of all designs.
    violation_nm: f64,
    /// Bound of J_D and efficiency reached at least, over the longer search; the part of the feedback in the bound.
    certificate: Option<[f64; 3]>,
    /// Why there is none.
    no_certificate: Option<String>,
    /// Residuals of the optimality conditions: at the design, of its worst piece alone, at a random record; active pieces.
    stationarity: Option<([f64; 3], usize)>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let length = Length {
        starts: if o.reduced { 3 } else { STARTS },
        long: if o.reduced { SHORT } else { LONG },
        certify: !o.reduced,
        seed: o.seed,
    };
    CASES
        .iter()
        .map(|case| Task {
            name: case.name(),
            inputs: json!({ "case": case.name(), "length": length }),
            run: Box::new(move |around: &Surroundings| Ok(json!(run(case, length, around.watch.interrupt)?))),
        })
        .collect()
}

fn failed(what: &Case, e: &dyn std::fmt::Display) -> StudyError {
    StudyError::Task { what: what.name(), reason: e.to_string() }
}

fn run(case: &Case, length: Length, interrupt: &(dyn Fn() -> bool + Sync)) -> Result<Found, StudyError> {
    let setting = Setting::new().map_err(|e| failed(case, &e))?;
    let wanted = criterion(case.criterion, &Default::default()).map_err(|e| failed(case, &e))?;
    let scales = cases::scales(&setting);
    let problem = case.problem(&setting, &scales, wanted.as_ref());
    let one = |options: &DesignOptions| {
        let found = design(&problem, options, interrupt, &|_| {}).map_err(|e| failed(case, &e))?;
        match found.status {
            Status::Interrupted => Err(StudyError::Interrupted),
            _ => Ok(found),
        }
    };
    let single = |k: u64| {
        let evaluations = case.evaluations(&DesignOptions::default());
        one(&DesignOptions { seed: length.seed + k, evaluations, ..Default::default() })
    };
    let singles = (0..length.starts).into_par_iter().map(single).collect::<Result<Vec<_>, _>>()?;
    let (evaluations, starts) = length.long;
    let certify = length.certify && case.certifiable();
    let long = one(&DesignOptions { seed: length.seed, evaluations, starts, certify, ..Default::default() })?;
    let violation_nm = singles
        .iter()
        .chain([&long])
        .flat_map(|d| &d.safety)
        .filter_map(|s| s.worst)
        .map(|w| -w.distance)
        .fold(0.0, f64::max);
    let random = random_record(&problem, length.seed).map_err(|e| failed(case, &e))?;
    let conditions = stationarity(&problem, &long.u, BAND).zip(stationarity(&problem, &random, BAND));
    let numbers = |c: &Certificate| [c.bound, c.efficiency, c.feedback];
    Ok(Found {
        singles: singles.iter().map(|d| d.value).collect(),
        long: long.value,
        evaluations: (singles.iter().map(|d| d.evaluations).sum(), long.evaluations),
        violation_nm,
        certificate: long.certificate.as_ref().and_then(|c| c.as_ref().ok()).map(numbers),
        no_certificate: long.certificate.and_then(|c| c.err()).map(|e| e.to_string()),
        stationarity: conditions.map(|(at, r)| ([at.residual, at.steepest, r.residual], at.active)),
    })
}

/// What a task found.
fn of(results: &[TaskResult], case: &Case) -> Option<Found> {
    results.iter().find(|r| r.name == case.name()).and_then(|r| serde_json::from_value(r.value.clone()).ok())
}

fn best(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::min)
}

fn check(id: String, what: String, asked: Asked, measured: Option<f64>, note: String) -> Check {
    let unit = "";
    Check { id, what, asked: asked.text(), measured, unit, holds: asked.holds(measured), note }
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    CASES.iter().flat_map(|case| checks(case, of(results, case))).collect()
}

/// The checks of one case.
fn checks(case: &Case, found: Option<Found>) -> Vec<Check> {
    let id = |what: &str| format!("{}-{what}", case.name());
    let title = case.title();
    let number = |f: &dyn Fn(&Found) -> Option<f64>| found.as_ref().and_then(f).map(|v| case.shown(v));
    // E is shown as a least eigenvalue, larger being better.
    let asked = |v: f64| if case.larger_is_better() { Asked::AtLeast(v) } else { Asked::AtMost(v) };
    let mut all = vec![check(
        id("median"),
        format!("{title}: median of ten single starts"),
        case.median.map_or(Asked::Reported, asked),
        number(&|f| median(&f.singles)),
        String::new(),
    )];
    if let Some(bar) = case.best_of_ten {
        let measured = number(&|f| best(&f.singles));
        all.push(check(id("best"), format!("{title}: best of ten"), asked(bar), measured, String::new()));
    }
    all.push(check(
        id("long"),
        format!("{title}: search within 60 CPU seconds"),
        asked(case.within()),
        number(&|f| Some(f.long)),
        format!(
            "best known {}; {} evaluations",
            case.best_known,
            found.as_ref().map_or(0, |f| f.evaluations.1)
        ),
    ));
    if let (Some(f), Kind::Outputs) = (&found, case.kind) {
        all.push(check(
            id("limits"),
            format!("{title}: largest violation of an output limit, Nm"),
            Asked::AtMost(1e-4),
            Some(f.violation_nm),
            String::new(),
        ));
    }
    if let Some(f) = &found
        && let Some([bound, efficiency, feedback]) = f.certificate
    {
        all.push(check(
            id("efficiency"),
            format!("{title}: D-efficiency reached at least, by the bound that no record passes"),
            Asked::Reported,
            Some(efficiency),
            format!(
                "J_D {:.4}, no record below {bound:.4}, of which past outputs take {feedback:.3}; rate limits and shared samples are not in the bound",
                f.long
            ),
        ));
    }
    if let Some(f) = &found
        && let Some(([at, steepest, random], active)) = f.stationarity
    {
        all.push(check(
            id("stationary"),
            format!("{title}: residual of the optimality conditions over that of a random record"),
            Asked::AtMost(0.01),
            Some(at / random),
            format!("{active} active pieces; residual {at:.2e}, worst piece alone {steepest:.2e}, random {random:.2e}"),
        ));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One per cent off counts as reached, more does not; E counts the other way round.
    #[test]
    fn the_long_search_is_judged_against_best_known_values() {
        let of = |name: &str, long: f64| {
            let case = CASES.iter().find(|c| c.name() == name).unwrap();
            let found = Found {
                singles: vec![long],
                long,
                evaluations: (1, 1),
                violation_nm: 0.0,
                certificate: None,
                no_certificate: None,
                stationarity: None,
            };
            let all = checks(case, Some(found));
            all.iter().find(|c| c.id.ends_with("-long")).and_then(|c| c.holds).unwrap()
        };
        assert!(of("box-d", -438.50) && !of("box-d", -438.48));
        assert!(of("box-ai", 1.9654e5) && !of("box-ai", 1.9656e5));
        assert!(of("box-e", 332.8) && !of("box-e", 333.0));
        assert!(of("both-d", -615712.0) && !of("both-d", -615711.0));
    }
}
