//! Scenarios 3 and 4: the boosted engine, tip-in and tip-out.
//!
//! All controllers share the steady points of the engine (held by its own load controller, with its own values and no sensor's; base of
//! the ECU's charge and of ours), the throttle that was identified, and the rules of a production ECU: throttle by the charge of the
//! demanded torque, wastegate shut while the measured load is below 90 % of the demand and by its map with feedback of boost after
//! that, cams by the load schedule, spark by the measured load less a retard that repeated tip-ins find. Ours has two more rules that repeated tip-ins on the bed set: the wastegate while no boost is asked
//! for, and cams while boost is missing. Its fuel is that of the identified air and sensor; a rival's that of an ECU whose
//! extrapolation and lambda loop are tuned on the same records.

mod bed;
mod contest;
mod control;
mod judge;
mod learned;
mod measures;
mod page;
mod search;
mod steady;

use serde::{Deserialize, Serialize};

pub(super) use judge::checks;
pub(super) use page::section;

use super::contest::Ended;
use crate::{StudyError, TaskResult};
use contest::{Contest, Found};

/// Parameter set of both scenarios.
pub(super) const ENGINE: &str = "gtdi_2l";

/// How a case is made: another number with every change of the procedure, so that results of another one are not taken over.
const METHOD: usize = 6;
/// What its result depends on beside engine, seed and length: records, the one whose cams are moved, halvings of the retard, the procedure.
pub(super) const TRIED: [usize; 4] = [contest::RECORDS, contest::MOVES, search::HALVINGS, METHOD];

/// An engine with a seed.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct TipCase {
    boosted: String,
    seed: u64,
    failed: Option<String>,
    found: Option<Found>,
}

/// A case; what fails in it is its result, and not the end of the study.
pub(super) fn case(
    name: &str,
    engine: &str,
    seed: u64,
    reduced: bool,
    interrupted: &(dyn Fn() -> bool + Sync),
) -> Result<serde_json::Value, StudyError> {
    let mut case = TipCase { boosted: engine.into(), seed, failed: None, found: None };
    let contest = Contest::new(engine, seed, reduced).map_err(Ended::Failed);
    match contest.and_then(|c| c.run(interrupted)) {
        Ok(found) => case.found = Some(found),
        Err(Ended::Interrupted) => return Err(StudyError::Interrupted),
        Err(Ended::Failed(reason)) => case.failed = Some(reason),
    }
    serde_json::to_value(case).map_err(|e| StudyError::Task { what: name.into(), reason: e.to_string() })
}

fn cases(results: &[TaskResult]) -> Vec<TipCase> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}

/// Number of results that are cases of these scenarios, and those without a controller.
pub(super) fn counted(results: &[TaskResult]) -> (usize, Vec<String>) {
    let all = cases(results);
    let failed = |c: &TipCase| c.failed.as_ref().map(|f| format!("{}, seed {}: {f}", c.boosted, c.seed));
    (all.len(), all.iter().filter_map(failed).collect())
}
