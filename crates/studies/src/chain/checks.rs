//! Checks of the study `chain`, all computed from the summaries of its runs.

use dynocal_jobs::calibrate::validate_step::DYNAMIC;
use serde_json::Value;

use super::{INTERRUPTION, NOISE, SEED};
use crate::asked::Asked;
use crate::{Check, TaskResult};

/// A number of a calibration.
type Measure = fn(&Value) -> Option<f64>;

/// A check over all seeds: id, what, unit, asked, number, note.
struct Row(&'static str, &'static str, &'static str, Asked, Measure, &'static str);

static ROWS: &[Row] = &[
    Row(
        "excite-lambda-low",
        "Lambda that 1 % of the identification samples lie below",
        "",
        Asked::AtLeast(0.5),
        |v| v["lambda_1_99"][0].as_f64(),
        "closed loop keeps lambda where it can be measured and burnt",
    ),
    Row(
        "excite-lambda-high",
        "Lambda that 99 % of the identification samples lie below",
        "",
        Asked::AtMost(1.6),
        |v| v["lambda_1_99"][1].as_f64(),
        "",
    ),
    Row(
        "identify-selected",
        "Selected structure against the published one, free-run R2 on unseen records, smaller gain of torque and lambda",
        "points",
        Asked::Above(0.0),
        over_published,
        "",
    ),
    Row(
        "fit-torque",
        "Free-run R2 of torque, mean over the unseen records, after the last pass",
        "%",
        Asked::AtLeast(99.0),
        |v| final_r2(v, "torque"),
        "wanted: 99.5",
    ),
    Row(
        "fit-lambda",
        "Free-run R2 of lambda, mean over the unseen records, after the last pass",
        "%",
        Asked::AtLeast(96.0),
        |v| final_r2(v, "lambda"),
        "wanted: 99",
    ),
    Row(
        "design-criterion",
        "Criterion of the designed record minus that of its start",
        "",
        Asked::Below(0.0),
        criterion_change,
        "criterion that the spec asks for",
    ),
    Row(
        "design-limits",
        "Least distance of the designed demand (torque, lambda, spark, speed) to its limits, as share of the range",
        "%",
        Asked::AtLeast(0.0),
        |v| v["design"]["least_distance"].as_f64().map(|d| 100.0 * d),
        "",
    ),
    Row(
        "design-lambda-low",
        "Lambda that 1 % of the samples of the designed record lie below",
        "",
        Asked::AtLeast(0.5),
        |v| v["design"]["lambda_1_99"][0].as_f64(),
        "the loops hold lambda while the design runs",
    ),
    Row(
        "design-lambda-high",
        "Lambda that 99 % of the samples of the designed record lie below",
        "",
        Asked::AtMost(1.6),
        |v| v["design"]["lambda_1_99"][1].as_f64(),
        "",
    ),
    Row(
        "design-gain-torque",
        "Unseen R2 of torque gained by the designed record",
        "points",
        Asked::Reported,
        |v| gain(v, "torque_r2", 0),
        "",
    ),
    Row(
        "design-gain-lambda",
        "Unseen R2 of lambda gained by the designed record",
        "points",
        Asked::Reported,
        |v| gain(v, "lambda_r2", 0),
        "",
    ),
    Row(
        "design-rival-torque",
        "Unseen R2 of torque: designed record minus one more record of the first recipe",
        "points",
        Asked::Reported,
        |v| gain(v, "torque_r2", 2),
        "",
    ),
    Row(
        "design-rival-lambda",
        "Unseen R2 of lambda: designed record minus one more record of the first recipe",
        "points",
        Asked::Reported,
        |v| gain(v, "lambda_r2", 2),
        "",
    ),
    Row(
        "optimise-converged",
        "Passes whose optimisation did not converge",
        "",
        Asked::AtMost(0.0),
        |v| passes(v).map(|p| count(p, |q| q["status"] != "converged")),
        "",
    ),
    Row(
        "optimise-torque-violation",
        "Largest violation of the torque demand by the optimum",
        "Nm",
        Asked::Below(1e-6),
        |v| worst_pass(v, "torque_violation_nm"),
        "",
    ),
    Row(
        "optimise-lambda-violation",
        "Largest violation of the lambda demand by the optimum",
        "",
        Asked::Below(1e-6),
        |v| worst_pass(v, "lambda_violation"),
        "",
    ),
    Row(
        "optimise-passes",
        "Passes that ran",
        "",
        Asked::AtLeast(2.0),
        |v| passes(v).map(|p| p.len() as f64),
        "optimise, measure, identify again, repeat",
    ),
    Row(
        "optimise-promise",
        "Promised against measured fuel ratio, last pass",
        "points",
        Asked::AtMost(1.5),
        |v| last_pass(v, "promise_gap_points"),
        "wanted: 0.4",
    ),
    Row(
        "optimise-saving",
        "Fuel saved by the optimum, measured",
        "%",
        Asked::Reported,
        |v| last_pass(v, "measured_ratio").map(|r| 100.0 * (1.0 - r)),
        "",
    ),
    Row(
        "optimise-best-spark",
        "Fuel saved by a perfect spark on the same record",
        "%",
        Asked::Reported,
        |v| v["summary"]["best_spark"]["ratio"].as_f64().map(|r| 100.0 * (1.0 - r)),
        "",
    ),
    Row(
        "optimise-share",
        "Share of the saving of a perfect spark",
        "%",
        Asked::Reported,
        |v| v["summary"]["best_spark"]["share_of_saving"].as_f64().map(|s| 100.0 * s),
        "",
    ),
    Row(
        "invert-rest",
        "Dynamic map at rest minus its static part, share of the actuator's range",
        "",
        Asked::AtMost(1e-6),
        |v| v["rest_difference"].as_f64(),
        "window differences vanish in steady state",
    ),
    Row(
        "offset-torque",
        "Worst steady torque offset of the dynamic map",
        "Nm",
        Asked::AtMost(1.5),
        |v| map(v, POINTS, DYNAMIC, "torque_offset_nm"),
        "random points; wanted: 0.8",
    ),
    Row(
        "offset-lambda",
        "Worst steady lambda offset of the dynamic map",
        "",
        Asked::AtMost(0.03),
        |v| map(v, POINTS, DYNAMIC, "lambda_offset"),
        "random points; wanted: 0.010",
    ),
    Row(
        "spike",
        "Lambda spike of the dynamic map on torque steps",
        "",
        Asked::AtMost(0.10),
        |v| map(v, STEPS, DYNAMIC, "lambda_spike"),
        "wanted: 0.035",
    ),
    Row(
        "spike-static",
        "The same of the static map",
        "",
        Asked::Reported,
        |v| map(v, STEPS, "static map", "lambda_spike"),
        "",
    ),
    Row(
        "settling",
        "Worst torque settling of the dynamic map, random points",
        "s",
        Asked::AtMost(1.5),
        |v| map(v, POINTS, DYNAMIC, "torque_settling_s"),
        "counted from the raw demand, look-ahead included",
    ),
    Row(
        "settling-static",
        "The same of the static map",
        "s",
        Asked::Reported,
        |v| map(v, POINTS, "static map", "torque_settling_s"),
        "",
    ),
    Row(
        "rival-ran",
        "Scenarios in which the lagged static map was run",
        "",
        Asked::AtLeast(2.0),
        |v| v["summary"]["maps"].as_array().map(|m| count(m, |s| s["map"] == LAGGED)),
        "the strong simple rival",
    ),
    Row(
        "rival-spike",
        "Lambda spike of the lagged static map on torque steps",
        "",
        Asked::Reported,
        |v| map(v, STEPS, LAGGED, "lambda_spike"),
        "",
    ),
    Row(
        "rival-offset",
        "Worst steady torque offset of the lagged static map",
        "Nm",
        Asked::Reported,
        |v| map(v, POINTS, LAGGED, "torque_offset_nm"),
        "",
    ),
    Row(
        "rival-settling",
        "Worst torque settling of the lagged static map, random points",
        "s",
        Asked::Reported,
        |v| map(v, POINTS, LAGGED, "torque_settling_s"),
        "",
    ),
    Row(
        "report",
        "Sections that the report lacks",
        "",
        Asked::AtMost(0.0),
        report,
        "written whole, with all sections",
    ),
    Row(
        "bed-time",
        "Bed time of identification, design and optimisation records",
        "s",
        Asked::AtMost(600.0),
        |v| v["summary"]["bed"]["total_s"].as_f64(),
        "",
    ),
    Row(
        "bed-time-static",
        "Bed time of the static map",
        "s",
        Asked::Reported,
        |v| v["summary"]["bed"]["static_map_s"].as_f64(),
        "",
    ),
    Row(
        "bed-time-validation",
        "Bed time of the validation records",
        "s",
        Asked::Reported,
        |v| v["summary"]["bed"]["validation_records_s"].as_f64(),
        "",
    ),
];

const LAGGED: &str = "static map with lag";
/// Position of the scenarios among those that a map is scored in.
const POINTS: usize = 0;
const STEPS: usize = 1;

/// All checks.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let seeds: Vec<&TaskResult> = results.iter().filter(|r| r.name.starts_with(SEED)).collect();
    let mut out: Vec<Check> = ROWS.iter().map(|r| over_seeds(r, &seeds)).collect();
    if let Some(noisy) = results.iter().find(|r| r.name == NOISE) {
        out.extend(ROWS.iter().filter(|r| NOISY.contains(&r.0)).map(|r| Check {
            id: format!("noise-{}", r.0),
            what: format!("With sensor noise: {}", r.1),
            asked: None,
            measured: (r.4)(&noisy.value),
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
pub(super) fn row(v: &Value) -> Vec<(&'static str, &'static str, Option<f64>)> {
    ROWS.iter().map(|r| (r.1, r.2, (r.4)(v))).collect()
}

fn over_seeds(r: &Row, seeds: &[&TaskResult]) -> Check {
    let values: Vec<Option<f64>> = seeds.iter().map(|s| (r.4)(&s.value)).collect();
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

fn count(values: &[Value], is: impl Fn(&Value) -> bool) -> f64 {
    values.iter().filter(|v| is(v)).count() as f64
}

fn passes(v: &Value) -> Option<&Vec<Value>> {
    v["summary"]["passes"].as_array()
}

fn last_pass(v: &Value, key: &str) -> Option<f64> {
    passes(v)?.last()?[key].as_f64()
}

fn worst_pass(v: &Value, key: &str) -> Option<f64> {
    let all: Option<Vec<f64>> = passes(v)?.iter().map(|p| p[key].as_f64()).collect();
    all?.into_iter().reduce(f64::max)
}

/// The chosen candidate of the last step that identified `output`, in percent.
fn final_r2(v: &Value, output: &str) -> Option<f64> {
    let models = v["summary"]["models"].as_array()?.iter().rfind(|m| m["output"] == output)?;
    let chosen = models["candidates"].as_array()?.iter().find(|c| c["name"] == models["chosen"])?;
    chosen["unseen_r2"].as_f64().map(|r2| 100.0 * r2)
}

/// Best selected minus best published candidate of the first identification, the smaller one of both outputs.
fn over_published(v: &Value) -> Option<f64> {
    let of_step = v["summary"]["models"].as_array()?.iter().filter(|m| m["step"] == "identify");
    let gains: Option<Vec<f64>> = of_step
        .map(|m| {
            let candidates = m["candidates"].as_array()?;
            let best = |kind: &str| {
                let of_kind =
                    candidates.iter().filter(|c| c["name"].as_str().is_some_and(|n| n.starts_with(kind)));
                // A free run that diverged explains nothing.
                of_kind.map(|c| c["unseen_r2"].as_f64().unwrap_or(f64::NEG_INFINITY)).reduce(f64::max)
            };
            Some(100.0 * (best("selected")? - best("published")?))
        })
        .collect();
    gains?.into_iter().reduce(f64::min)
}

fn criterion_change(v: &Value) -> Option<f64> {
    let wanted = &v["summary"]["spec"]["design"]["criterion"];
    let c = v["summary"]["design"]["criteria"].as_array()?.iter().find(|c| c["criterion"] == *wanted)?;
    Some(c["design"].as_f64()? - c["start"].as_f64()?)
}

/// What the designed record gained over the identification data number `base`, in points.
fn gain(v: &Value, key: &str, base: usize) -> Option<f64> {
    let gains = v["summary"]["design"]["gains"].as_array()?;
    Some(100.0 * (gains.get(1)?[key].as_f64()? - gains.get(base)?[key].as_f64()?))
}

/// A score of one map in scenario number `scenario`.
fn map(v: &Value, scenario: usize, map: &str, key: &str) -> Option<f64> {
    v["summary"]["maps"].as_array()?.iter().filter(|s| s["map"] == map).nth(scenario)?[key].as_f64()
}

fn report(v: &Value) -> Option<f64> {
    let missing = v["report_missing"].as_array()?.len() as f64;
    Some(if v["report_ends"].as_bool()? { missing } else { missing + 1.0 })
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
