//! Checks of the study `engine`: the verification cases of the engine's specification, from the runs.

use crate::engine::verification::{ReferencePoint, nonlinearity_pct};
use serde_json::Value;

use super::tasks::{MOTORED_RPM, OPEN_RPM};
use super::{MOTORED, OPEN, SPARK, STATIC, TRANSIENTS};
use crate::asked::Asked;
use crate::{Check, TaskResult};

/// Case 8: peak pressure \[bar\] and brake torque \[Nm\] at [`MOTORED_RPM`].
const MOTORED_EXPECTED: [(f64, f64); 3] = [(18.2, -7.1), (19.2, -10.3), (19.8, -14.3)];
/// Case 9: volumetric efficiency at [`OPEN_RPM`].
const VOLUMETRIC: [f64; 5] = [0.77, 0.79, 0.81, 0.82, 0.81];
/// Case 11: fuel \[mg\] at 2000 rpm and 70 Nm for some sparks \[deg\].
const FUEL_OF_SPARK: [(f64, f64); 5] =
    [(5.0, 18.82), (11.0, 17.29), (19.0, 16.76), (23.0, 16.85), (35.0, 17.80)];

/// The result of a task, null when there is none.
pub(super) fn of<'a>(results: &'a [TaskResult], name: &str) -> &'a Value {
    results.iter().find(|r| r.name == name).map_or(&Value::Null, |r| &r.value)
}

/// All rows of the static map.
pub(super) fn rows(results: &[TaskResult]) -> Vec<&Value> {
    let tasks = results.iter().filter(|r| r.name.starts_with(STATIC));
    tasks.filter_map(|r| r.value["points"].as_array()).flatten().collect()
}

/// An input or output of a row of the static map.
pub(super) fn best(row: &Value, part: &str, key: &str) -> Option<f64> {
    row["point"]["best"][part][key].as_f64()
}

/// The row of a torque at 2000 rpm.
pub(super) fn at_2000(results: &[TaskResult], torque_nm: f64) -> &Value {
    let points = of(results, &format!("{STATIC}2000"))["points"].as_array();
    let found = points.into_iter().flatten().find(|r| r["target"]["torque_nm"] == torque_nm);
    found.unwrap_or(&Value::Null)
}

/// Lowest and highest of some numbers; none when there are none or one is missing.
pub(super) fn range(values: impl Iterator<Item = Option<f64>>) -> Option<(f64, f64)> {
    let all: Vec<f64> = values.collect::<Option<_>>()?;
    let low = all.iter().copied().reduce(f64::min)?;
    all.iter().copied().reduce(f64::max).map(|high| (low, high))
}

/// The number `key` of the transient `name`.
pub(super) fn transient(results: &[TaskResult], name: &str, key: &str) -> Option<f64> {
    let found = of(results, TRANSIENTS).as_array()?.iter().find(|t| t["name"] == name)?;
    found["numbers"][key].as_f64().or_else(|| found[key].as_f64())
}

pub(super) fn check(
    id: &str,
    what: &str,
    unit: &'static str,
    asked: Asked,
    measured: Option<f64>,
    note: &str,
) -> Check {
    Check {
        id: id.into(),
        what: what.into(),
        asked: asked.text(),
        measured,
        unit,
        holds: asked.holds(measured),
        note: note.into(),
    }
}

/// The checks.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let mut out = static_map(results);
    out.extend(reference(results));
    out.extend(motored(results));
    out.extend(open_throttle(results));
    out.extend(spark(results));
    out.extend(thesis(results));
    out.extend(super::boosted::checks(results));
    out
}

fn largest(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    range(values).map(|r| r.1)
}

fn static_map(results: &[TaskResult]) -> Vec<Check> {
    let rows = rows(results);
    let missed = rows.iter().filter(|r| r["point"].is_null()).count() as f64;
    let of_output = |key: &'static str| range(rows.iter().map(|r| best(r, "outputs", key)));
    let residual = of_output("residual");
    let egt = of_output("egt_k").map(|(a, b)| (a - 273.15, b - 273.15));
    let ca50 = of_output("ca50_deg");
    let growth = largest(
        rows.windows(2)
            .filter(|w| w[0]["target"]["speed_rpm"] == w[1]["target"]["speed_rpm"])
            .map(|w| Some(best(w[1], "outputs", "residual")? - best(w[0], "outputs", "residual")?)),
    );
    let low = |r: Option<(f64, f64)>| r.map(|r| r.0);
    let high = |r: Option<(f64, f64)>| r.map(|r| r.1);
    let map = "1000 to 3000 rpm, 0 to 100 Nm, best spark, lambda 1";
    vec![
        check(
            "map-reached",
            "Points of the map that cannot be reached",
            "",
            Asked::AtMost(0.0),
            Some(missed),
            map,
        ),
        check(
            "residual-low",
            "Least residual fraction (case 10)",
            "",
            Asked::AtLeast(0.05),
            low(residual),
            map,
        ),
        check(
            "residual-high",
            "Largest residual fraction (case 10)",
            "",
            Asked::AtMost(0.33),
            high(residual),
            map,
        ),
        check(
            "residual-falls",
            "Largest growth of the residual fraction from one load to the next (case 10)",
            "",
            Asked::Below(0.0),
            growth,
            "at constant speed",
        ),
        check(
            "egt-low",
            "Lowest exhaust temperature (case 10)",
            "deg C",
            Asked::AtLeast(420.0),
            low(egt),
            map,
        ),
        check(
            "egt-high",
            "Highest exhaust temperature (case 10)",
            "deg C",
            Asked::AtMost(815.0),
            high(egt),
            map,
        ),
        check(
            "ca50-low",
            "Earliest 50 % burned at best spark (case 10)",
            "deg",
            Asked::AtLeast(6.5),
            low(ca50),
            map,
        ),
        check(
            "ca50-high",
            "Latest 50 % burned at best spark (case 10)",
            "deg",
            Asked::AtMost(12.0),
            high(ca50),
            map,
        ),
    ]
}

/// Case 12.
fn reference(results: &[TaskResult]) -> Vec<Check> {
    let compared = results.iter().any(|r| r.value["compared"] == true);
    if !compared {
        let note = "not compared (case 12): give --reference FILE or set DYNOCAL_REFERENCE_DIR";
        let what = "Points of the reference table within the tolerances (case 12)";
        return vec![check("reference", what, "points", Asked::Reported, None, note)];
    }
    // A point that the reference has and the engine cannot reach has no difference, and so never holds.
    let rows: Vec<&Value> = rows(results).into_iter().filter(|r| r["referenced"] == true).collect();
    let column = |k: usize| rows.iter().map(move |r| r["difference"][k].as_f64().map(f64::abs));
    let inside = |r: &&Value| {
        (0..5).all(|k| r["difference"][k].as_f64().is_some_and(|d| d.abs() <= ReferencePoint::TOLERANCES[k]))
    };
    let held = rows.iter().copied().filter(inside).count() as f64;
    let mut out = vec![check(
        "reference",
        "Points of the reference table within the tolerances (case 12)",
        "points",
        Asked::AtLeast(rows.len().max(1) as f64),
        Some(held),
        "",
    )];
    let names = [
        ("reference-fuel", "fuel", "%"),
        ("reference-throttle", "throttle", "deg"),
        ("reference-map", "intake pressure", "%"),
        ("reference-egt", "exhaust temperature", "K"),
        ("reference-spark", "spark", "deg"),
    ];
    for (k, (id, name, unit)) in names.into_iter().enumerate() {
        let what = format!("Largest difference of {name} from the reference table (case 12)");
        out.push(check(
            id,
            &what,
            unit,
            Asked::AtMost(ReferencePoint::TOLERANCES[k]),
            largest(column(k)),
            "",
        ));
    }
    out
}

/// Case 8.
fn motored(results: &[TaskResult]) -> Vec<Check> {
    let runs = of(results, MOTORED);
    let off = |key: &'static str, expected: fn(&(f64, f64)) -> f64| {
        let all = MOTORED_EXPECTED.iter().enumerate();
        largest(all.map(|(k, e)| runs[k][key].as_f64().map(|v| (v - expected(e)).abs())))
    };
    let peak = largest((0..MOTORED_RPM.len()).map(|k| runs[k]["peak_deg"].as_f64().map(f64::abs)));
    let note = "1000, 2000, 3000 rpm; expected values have one decimal";
    vec![
        check(
            "motored-pressure",
            "Motored peak pressure, largest difference from 18.2, 19.2, 19.8 bar (case 8)",
            "bar",
            Asked::AtMost(0.05),
            off("pmax_bar", |e| e.0),
            note,
        ),
        check(
            "motored-torque",
            "Motored torque, largest difference from -7.1, -10.3, -14.3 Nm (case 8)",
            "Nm",
            Asked::AtMost(0.05),
            off("torque_nm", |e| e.1),
            note,
        ),
        check(
            "motored-peak",
            "Angle between motored peak pressure and dead centre (case 8)",
            "deg",
            Asked::AtMost(1.0),
            peak,
            "",
        ),
    ]
}

/// Cases 9 and 13.
fn open_throttle(results: &[TaskResult]) -> Vec<Check> {
    let runs = of(results, OPEN);
    let output = |k: usize, key: &str| runs[k]["outputs"][key].as_f64();
    let off = largest(
        VOLUMETRIC.iter().enumerate().map(|(k, e)| output(k, "volumetric_efficiency").map(|v| (v - e).abs())),
    );
    let bsfc = range((0..OPEN_RPM.len()).map(|k| output(k, "bsfc_g_kwh")));
    let best = bsfc.map(|b| b.0);
    let note = "open throttle, lambda 1, spark of most torque, no charging, knock ignored";
    vec![
        check(
            "volumetric",
            "Volumetric efficiency, largest difference from 0.77 0.79 0.81 0.82 0.81 (case 9)",
            "",
            Asked::AtMost(0.01),
            off,
            "1000 to 5000 rpm, open throttle; expected values have two decimals",
        ),
        check(
            "bsfc-low",
            "Best specific consumption (case 13, lower end)",
            "g/kWh",
            Asked::AtLeast(230.0),
            best,
            note,
        ),
        check(
            "bsfc-high",
            "Best specific consumption (case 13, upper end)",
            "g/kWh",
            Asked::AtMost(245.0),
            best,
            note,
        ),
    ]
}

/// Case 11.
fn spark(results: &[TaskResult]) -> Vec<Check> {
    let run = of(results, SPARK);
    let fuel = |spark: f64| {
        let k = run["spark_deg"].as_array()?.iter().position(|s| *s == spark)?;
        run["fuel_mg"][k].as_f64()
    };
    let off = largest(FUEL_OF_SPARK.iter().map(|(s, e)| fuel(*s).map(|v| 100.0 * (v / e - 1.0).abs())));
    let maxima = run["maxima"].as_f64().map(|m| (m - 1.0).abs());
    vec![
        check(
            "spark-fuel",
            "Fuel against spark at 2000 rpm, 70 Nm, largest difference at 5 sparks (case 11)",
            "%",
            Asked::AtMost(0.5),
            off,
            "",
        ),
        check(
            "spark-maximum",
            "Maxima of torque against spark at constant air and fuel, beside one (case 11)",
            "",
            Asked::AtMost(0.0),
            maxima,
            "sparks of 5 to 35 deg in steps of 2 deg",
        ),
        check(
            "spark-concave",
            "Largest second difference of torque against spark (case 11)",
            "Nm",
            Asked::Below(0.0),
            run["largest_second_difference_nm"].as_f64(),
            "",
        ),
    ]
}

/// What the thesis states and a number can decide.
fn thesis(results: &[TaskResult]) -> Vec<Check> {
    let steps = ["30->70 Nm", "70->30 Nm"];
    let settling = |key: &'static str| largest(steps.iter().map(|s| transient(results, s, key)));
    let lean = transient(results, "throttle +3 deg", "lambda_end");
    let (torques, fuel) = fuel_line(results);
    let bend = (fuel.len() > 2).then(|| nonlinearity_pct(&torques, &fuel));
    let note = "steps of the static map between 30 and 70 Nm at 2000 rpm";
    vec![
        check(
            "torque-settling",
            "Torque settles to 1 Nm",
            "s",
            Asked::AtMost(1.5),
            settling("torque_settling_s"),
            note,
        ),
        check(
            "lambda-settling",
            "Lambda settles to 0.01",
            "s",
            Asked::AtMost(2.0),
            settling("lambda_settling_s"),
            note,
        ),
        check(
            "throttle-lean",
            "Lambda after the throttle opens alone by 3 deg",
            "",
            Asked::Above(1.0),
            lean,
            "thesis: lean",
        ),
        check(
            "fuel-line",
            "Largest distance of fuel against torque from a straight line",
            "%",
            Asked::Reported,
            bend,
            "2000 rpm; thesis: flat and linear",
        ),
    ]
}

/// Torque \[Nm\] and fuel \[mg\] at 2000 rpm.
pub(super) fn fuel_line(results: &[TaskResult]) -> (Vec<f64>, Vec<f64>) {
    let points = of(results, &format!("{STATIC}2000"))["points"].as_array();
    let pairs = points
        .into_iter()
        .flatten()
        .filter_map(|r| Some((r["target"]["torque_nm"].as_f64()?, best(r, "inputs", "injection_mg")?)));
    pairs.unzip()
}
