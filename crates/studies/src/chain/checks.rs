//! Checks of the study `chain`, all computed from the summaries of its runs.

use dynocal_calib::validate::DemandScore;
use dynocal_jobs::calibrate::validate_step::DYNAMIC;
use serde_json::Value;

use super::tasks::Calibrated;
use super::{INTERRUPTION, NOISE, SEED};
use crate::asked::Asked;
use crate::{Check, TaskResult};

/// A number of a calibration.
type Measure = fn(&Calibrated) -> Option<f64>;

/// A check over all seeds: id, what, unit, asked, number, note.
struct Row(&'static str, &'static str, &'static str, Asked, Measure, &'static str);

/// The number of one output.
fn of(list: &[(String, Option<f64>)], output: &str) -> Option<f64> {
    list.iter().find(|(name, _)| name == output)?.1
}

/// A score of one map for one demand in scenario number `scenario`.
fn map(
    c: &Calibrated,
    scenario: usize,
    map: &str,
    demand: &str,
    number: fn(&DemandScore) -> f64,
) -> Option<f64> {
    c.maps.iter().filter(|s| s.map == map).nth(scenario)?.demand(demand).map(number)
}

/// The delivered map's number over the least of all rivals in the same scenario: below 1 no rival is as good.
fn over_best_rival(
    c: &Calibrated,
    scenario: usize,
    demand: &str,
    number: fn(&DemandScore) -> f64,
) -> Option<f64> {
    let own = c.maps.iter().filter(|s| s.map == DYNAMIC).nth(scenario)?;
    let rivals = c.maps.iter().filter(|s| s.scenario == own.scenario && s.map != DYNAMIC);
    let best =
        rivals.filter_map(|s| s.demand(demand).map(number)).filter(|v| v.is_finite()).reduce(f64::min)?;
    Some(number(own.demand(demand)?) / best)
}

fn spike(d: &DemandScore) -> f64 {
    d.spike()
}

fn offset(d: &DemandScore) -> f64 {
    d.offset
}

fn integral(d: &DemandScore) -> f64 {
    d.integral_s
}

fn settling(d: &DemandScore) -> f64 {
    d.settling_s
}

fn percent_saved(ratio: Option<f64>) -> Option<f64> {
    ratio.map(|r| 100.0 * (1.0 - r))
}

static ROWS: &[Row] = &[
    Row(
        "valid",
        "Runs whose map may be used (1: yes)",
        "",
        Asked::AtLeast(1.0),
        |c| Some(f64::from(u8::from(c.valid))),
        "the verdict of the run itself",
    ),
    Row(
        "excite-lambda-low",
        "Lambda that 1 % of the identification samples lie below",
        "",
        Asked::AtLeast(0.5),
        |c| c.excited_lambda.map(|l| l.0),
        "closed loop keeps lambda where it can be measured and burnt",
    ),
    Row(
        "excite-lambda-high",
        "Lambda that 99 % of the identification samples lie below",
        "",
        Asked::AtMost(1.6),
        |c| c.excited_lambda.map(|l| l.1),
        "",
    ),
    Row(
        "fit-torque",
        "Free-run R2 of torque, mean over the unseen records, after the last pass",
        "%",
        Asked::AtLeast(99.0),
        |c| of(&c.final_r2, "torque").map(|v| 100.0 * v),
        "wanted: 99.5; the record that chose between candidates is not among them",
    ),
    Row(
        "fit-lambda",
        "Free-run R2 of lambda, mean over the unseen records, after the last pass",
        "%",
        Asked::AtLeast(96.0),
        |c| of(&c.final_r2, "lambda").map(|v| 100.0 * v),
        "wanted: 99",
    ),
    Row(
        "design-lambda-low",
        "Lambda that 1 % of the samples of the designed record lie below",
        "",
        Asked::AtLeast(0.5),
        |c| c.designed_lambda.map(|l| l.0),
        "trimming loops hold the predicted lambda while the design runs",
    ),
    Row(
        "design-lambda-high",
        "Lambda that 99 % of the samples of the designed record lie below",
        "",
        Asked::AtMost(1.6),
        |c| c.designed_lambda.map(|l| l.1),
        "",
    ),
    Row(
        "design-gain-torque",
        "Unseen R2 of torque gained by the designed record",
        "points",
        Asked::Reported,
        |c| of(&c.design_gain, "torque").map(|v| 100.0 * v),
        "",
    ),
    Row(
        "design-gain-lambda",
        "Unseen R2 of lambda gained by the designed record",
        "points",
        Asked::Reported,
        |c| of(&c.design_gain, "lambda").map(|v| 100.0 * v),
        "",
    ),
    Row(
        "design-rival-torque",
        "Unseen R2 of torque: designed record minus one more record of the first recipe",
        "points",
        Asked::Reported,
        |c| of(&c.design_against_rival, "torque").map(|v| 100.0 * v),
        "",
    ),
    Row(
        "design-rival-lambda",
        "Unseen R2 of lambda: designed record minus one more record of the first recipe",
        "points",
        Asked::Reported,
        |c| of(&c.design_against_rival, "lambda").map(|v| 100.0 * v),
        "",
    ),
    Row(
        "optimise-converged",
        "Passes whose optimisation did not converge",
        "",
        Asked::AtMost(0.0),
        |c| Some(c.unconverged_passes as f64),
        "",
    ),
    Row(
        "optimise-usable",
        "Passes whose optimum must not be used",
        "",
        Asked::AtMost(0.0),
        |c| Some(c.unusable_passes as f64),
        "they are left out of map and models",
    ),
    Row(
        "optimise-torque-violation",
        "Largest violation of the torque demand by the optimum",
        "Nm",
        Asked::Below(1e-6),
        |c| violation(c, "torque"),
        "",
    ),
    Row(
        "optimise-lambda-violation",
        "Largest violation of the lambda demand by the optimum",
        "",
        Asked::Below(1e-6),
        |c| violation(c, "lambda"),
        "",
    ),
    Row(
        "optimise-promise",
        "Promised against measured fuel ratio, last pass",
        "points",
        Asked::AtMost(1.5),
        |c| c.promised_ratio.zip(c.measured_ratio).map(|(p, m)| 100.0 * (p - m).abs()),
        "wanted: 0.4",
    ),
    Row(
        "optimise-saving",
        "Fuel saved by the optimum, measured",
        "%",
        Asked::Reported,
        |c| percent_saved(c.measured_ratio),
        "against random spark",
    ),
    Row(
        "optimise-best-spark",
        "Fuel saved by the static map's spark on the same record",
        "%",
        Asked::Reported,
        |c| percent_saved(c.static_ratio),
        "",
    ),
    Row(
        "optimise-share",
        "Share of the saving of the static map's spark",
        "%",
        Asked::Reported,
        |c| c.share_of_saving.map(|s| 100.0 * s),
        "",
    ),
    Row(
        "offset-torque",
        "Worst steady torque offset of the dynamic map",
        "Nm",
        Asked::AtMost(1.5),
        |c| map(c, POINTS, DYNAMIC, "torque", offset),
        "random points; wanted: 0.8",
    ),
    Row(
        "offset-lambda",
        "Worst steady lambda offset of the dynamic map",
        "",
        Asked::AtMost(0.03),
        |c| map(c, POINTS, DYNAMIC, "lambda", offset),
        "random points; wanted: 0.010",
    ),
    Row(
        "spike",
        "Lambda spike of the dynamic map on torque steps",
        "",
        Asked::AtMost(0.10),
        |c| map(c, STEPS, DYNAMIC, "lambda", spike),
        "wanted: 0.035",
    ),
    Row(
        "spike-static",
        "The same of the static map",
        "",
        Asked::Reported,
        |c| map(c, STEPS, "static map", "lambda", spike),
        "",
    ),
    Row(
        "spike-lagged",
        "The same of the lagged static map, its lag tuned on the run's own models",
        "",
        Asked::Reported,
        |c| map(c, STEPS, LAGGED, "lambda", spike),
        "",
    ),
    Row("lag", "Tuned lag of that rival", "s", Asked::Reported, |c| c.lag_s, "at the middle speed"),
    Row(
        "integral-steps",
        "Lambda integral per step of the dynamic map over that of the best rival, torque steps",
        "",
        Asked::AtMost(1.0),
        |c| over_best_rival(c, STEPS, "lambda", integral),
        "below 1: no rival is as good; offsets count, which a spike hides",
    ),
    Row(
        "integral-points",
        "The same on random points",
        "",
        Asked::AtMost(1.0),
        |c| over_best_rival(c, POINTS, "lambda", integral),
        "below 1: no rival is as good; offsets count, which a spike hides",
    ),
    Row(
        "spike-over-rival",
        "Lambda spike of the dynamic map over that of the best rival, torque steps",
        "",
        Asked::Reported,
        |c| over_best_rival(c, STEPS, "lambda", spike),
        "below 1: no rival is as good",
    ),
    Row(
        "spike-over-static",
        "Lambda spike of the dynamic map over that of the static map, torque steps",
        "",
        Asked::AtMost(0.5),
        |c| {
            map(c, STEPS, DYNAMIC, "lambda", spike)
                .zip(map(c, STEPS, "static map", "lambda", spike))
                .map(|(a, b)| a / b)
        },
        "the weakest rival; the best one is above",
    ),
    Row(
        "settling",
        "Worst torque settling of the dynamic map, random points",
        "s",
        Asked::AtMost(1.5),
        |c| map(c, POINTS, DYNAMIC, "torque", settling),
        "counted from the raw demand, look-ahead included",
    ),
    Row(
        "settling-static",
        "The same of the static map",
        "s",
        Asked::Reported,
        |c| map(c, POINTS, "static map", "torque", settling),
        "",
    ),
    Row(
        "rival-offset",
        "Worst steady torque offset of the lagged static map",
        "Nm",
        Asked::Reported,
        |c| map(c, POINTS, LAGGED, "torque", offset),
        "",
    ),
    Row(
        "report",
        "Sections that the report lacks",
        "",
        Asked::AtMost(0.0),
        |c| Some(c.report_missing.len() as f64),
        "written whole, with all sections",
    ),
    Row(
        "bed-time",
        "Bed time beyond the static map's: identification, design, optimisation, points at rest",
        "s",
        Asked::AtMost(600.0),
        |c| Some(c.bed_s),
        "",
    ),
    Row("bed-time-static", "Bed time of the static map", "s", Asked::Reported, |c| c.static_bed_s, ""),
    Row(
        "bed-time-validation",
        "Bed time of the validation records",
        "s",
        Asked::Reported,
        |c| c.validation_bed_s,
        "",
    ),
];

fn violation(c: &Calibrated, output: &str) -> Option<f64> {
    c.violations.iter().find(|(name, _)| name == output).map(|(_, v)| *v)
}

const LAGGED: &str = "static map with lag";
/// Position of the scenarios among those that a map is scored in.
const POINTS: usize = 0;
const STEPS: usize = 1;

/// All checks.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let read = |r: &TaskResult| crate::result::<Calibrated>(results, &r.name);
    let seeds: Vec<Option<Calibrated>> =
        results.iter().filter(|r| r.name.starts_with(SEED)).map(read).collect();
    let mut out: Vec<Check> = ROWS.iter().map(|r| over_seeds(r, &seeds)).collect();
    if results.iter().any(|r| r.name == NOISE) {
        let noisy = crate::result::<Calibrated>(results, NOISE);
        out.extend(ROWS.iter().filter(|r| NOISY.contains(&r.0)).map(|r| Check {
            id: format!("noise-{}", r.0),
            what: format!("With sensor noise: {}", r.1),
            asked: None,
            measured: noisy.as_ref().and_then(r.4),
            unit: r.2,
            holds: None,
            note: "torque 1 Nm, lambda 0.01, white".into(),
        }));
    }
    if let Some(i) = results.iter().find(|r| r.name == INTERRUPTION) {
        out.extend(interruption(&i.value));
    }
    out
}

/// Numbers that are reported once more with sensor noise.
const NOISY: [&str; 7] = [
    "fit-torque",
    "fit-lambda",
    "optimise-promise",
    "optimise-share",
    "offset-torque",
    "offset-lambda",
    "spike",
];

/// Name, unit and value of every number of one calibration.
pub(super) fn row(c: Option<&Calibrated>) -> Vec<(&'static str, &'static str, Option<f64>)> {
    ROWS.iter().map(|r| (r.1, r.2, c.and_then(r.4))).collect()
}

fn over_seeds(r: &Row, seeds: &[Option<Calibrated>]) -> Check {
    let values: Vec<Option<f64>> = seeds.iter().map(|c| c.as_ref().and_then(r.4)).collect();
    let measured = r.3.worst(&values);
    let shown: Vec<String> =
        values.iter().map(|v| v.map_or("none".into(), |v| dynocal_report::significant(v, 4))).collect();
    let seeds = if values.len() > 1 { format!("seeds: {}", shown.join(", ")) } else { String::new() };
    let note = [r.5, &seeds].into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join("; ");
    Check {
        id: r.0.into(),
        what: r.1.into(),
        asked: r.3.text(),
        measured,
        unit: r.2,
        holds: r.3.holds(measured),
        note,
    }
}

fn interruption(v: &Value) -> Vec<Check> {
    let yes = |key: &str| v[key].as_bool().map(|b| f64::from(u8::from(b)));
    let number = |key: &str| v[key].as_f64();
    let steps = number("steps").unwrap_or(f64::NAN);
    let rows = [
        (
            "resume-nothing",
            "Steps of a finished run that a second run takes over",
            number("resumed"),
            Asked::AtLeast(steps),
        ),
        (
            "resume-bytes",
            "The second run writes the same summary.json (1: yes)",
            yes("resume_same_bytes"),
            Asked::AtLeast(1.0),
        ),
        (
            "ctrl-c-stops",
            "A run that is interrupted in the optimisation stops (1: yes)",
            yes("interrupted"),
            Asked::AtLeast(1.0),
        ),
        ("ctrl-c-keeps", "Finished steps that it leaves behind", number("steps_kept"), Asked::AtLeast(3.0)),
        (
            "ctrl-c-resumes",
            "Steps that the next run takes over",
            number("steps_resumed"),
            Asked::AtLeast(3.0),
        ),
        (
            "ctrl-c-completes",
            "It ends with the summary.json of a run without interruption (1: yes)",
            yes("completed_same_bytes"),
            Asked::AtLeast(1.0),
        ),
        (
            "ctrl-c-report",
            "and with its report.html (1: yes)",
            yes("completed_same_report"),
            Asked::AtLeast(1.0),
        ),
    ];
    rows.into_iter()
        .map(|(id, what, measured, asked)| Check {
            id: id.into(),
            what: what.into(),
            asked: asked.text(),
            measured,
            unit: "",
            holds: asked.holds(measured),
            note: "on the shortest calibration".into(),
        })
        .collect()
}
