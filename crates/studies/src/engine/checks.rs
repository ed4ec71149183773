//! Checks of the study `engine`: the verification cases of the engine's specification, from the runs.

use crate::engine::results::{SparkAt70, StaticRow, Transient, fuel_line, static_rows, transients};
use crate::engine::verification::{Motored, ReferencePoint, nonlinearity_pct};
use dynocal_plant::outputs::Outputs;
use dynocal_plant::statics::StaticPoint;

use super::tasks::{MOTORED_RPM, OPEN_RPM};
use super::{MOTORED, OPEN, SPARK};
use crate::asked::Asked;
use crate::{Check, TaskResult, result};

/// Case 8: peak pressure \[bar\] and brake torque \[Nm\] at [`MOTORED_RPM`].
const MOTORED_EXPECTED: [(f64, f64); 3] = [(18.2, -7.1), (19.2, -10.3), (19.8, -14.3)];
/// Case 9: volumetric efficiency at [`OPEN_RPM`].
const VOLUMETRIC: [f64; 5] = [0.77, 0.79, 0.81, 0.82, 0.81];
/// Case 11: fuel \[mg\] at 2000 rpm and 70 Nm for some sparks \[deg\].
const FUEL_OF_SPARK: [(f64, f64); 5] =
    [(5.0, 18.82), (11.0, 17.29), (19.0, 16.76), (23.0, 16.85), (35.0, 17.80)];

/// Lowest and highest of some numbers; none when there are none or one is missing.
pub(super) fn range(values: impl Iterator<Item = Option<f64>>) -> Option<(f64, f64)> {
    let all: Vec<f64> = values.collect::<Option<_>>()?;
    let low = all.iter().copied().reduce(f64::min)?;
    all.iter().copied().reduce(f64::max).map(|high| (low, high))
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
    out.extend(super::rows::checks(results));
    out.extend(super::as_measured_rows::checks(results));
    out.extend(super::reach::checks(results));
    out.extend(super::other::checks(results));
    out.extend(super::twin::checks(results));
    out.extend(super::light_off::checks(results));
    out
}

fn largest(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    range(values).map(|r| r.1)
}

fn static_map(results: &[TaskResult]) -> Vec<Check> {
    let all = static_rows(results).map(|r| r.points);
    let missed = all.as_ref().map(|rows| rows.iter().filter(|r| r.point.is_none()).count() as f64);
    let rows: Vec<StaticRow> = all.unwrap_or_default();
    let of_output =
        |of: fn(&Outputs) -> f64| range(rows.iter().map(|r| r.best(|p: &StaticPoint| of(&p.outputs))));
    let residual = of_output(|y| y.residual);
    let egt = of_output(|y| y.egt_k).map(|(a, b)| (a - 273.15, b - 273.15));
    let ca50 = of_output(|y| y.ca50_deg);
    let residual_of = |r: &StaticRow| r.best(|p| p.outputs.residual);
    let growth = largest(
        rows.windows(2)
            .filter(|w| w[0].target.speed_rpm == w[1].target.speed_rpm)
            .map(|w| Some(residual_of(&w[1])? - residual_of(&w[0])?)),
    );
    let low = |r: Option<(f64, f64)>| r.map(|r| r.0);
    let high = |r: Option<(f64, f64)>| r.map(|r| r.1);
    let map = "1000 to 3000 rpm, 0 to 100 Nm, best spark, lambda 1";
    vec![
        check("map-reached", "Points of the map that cannot be reached", "", Asked::AtMost(0.0), missed, map),
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
    let all = static_rows(results);
    if all.as_ref().is_some_and(|r| !r.compared) {
        let note = "not compared (case 12): give --reference FILE or set DYNOCAL_REFERENCE_DIR";
        let what = "Points of the reference table within the tolerances (case 12)";
        return vec![check("reference", what, "points", Asked::Reported, None, note)];
    }
    // A point that the reference has and the engine cannot reach has no difference, and so never holds.
    let points = all.map_or_else(Vec::new, |r| r.points);
    let rows: Vec<&StaticRow> = points.iter().filter(|r| r.referenced).collect();
    let column = |k: usize| rows.iter().map(move |r| r.difference.map(|d| d[k].abs()));
    let inside = |r: &&StaticRow| {
        r.difference
            .is_some_and(|d| d.iter().zip(ReferencePoint::TOLERANCES).all(|(d, most)| d.abs() <= most))
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
    let runs: Vec<Motored> = result(results, MOTORED).unwrap_or_default();
    let off = |of: fn(&Motored) -> f64, expected: fn(&(f64, f64)) -> f64| {
        let all = MOTORED_EXPECTED.iter().enumerate();
        largest(all.map(|(k, e)| runs.get(k).map(|r| (of(r) - expected(e)).abs())))
    };
    let peak = largest((0..MOTORED_RPM.len()).map(|k| runs.get(k).map(|r| r.peak_deg.abs())));
    let note = "1000, 2000, 3000 rpm; expected values have one decimal";
    vec![
        check(
            "motored-pressure",
            "Motored peak pressure, largest difference from 18.2, 19.2, 19.8 bar (case 8)",
            "bar",
            Asked::AtMost(0.05),
            off(|r| r.pmax_bar, |e| e.0),
            note,
        ),
        check(
            "motored-torque",
            "Motored torque, largest difference from -7.1, -10.3, -14.3 Nm (case 8)",
            "Nm",
            Asked::AtMost(0.05),
            off(|r| r.torque_nm, |e| e.1),
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
    let runs: Vec<StaticPoint> = result(results, OPEN).unwrap_or_default();
    let output = |k: usize, of: fn(&Outputs) -> f64| runs.get(k).map(|p| of(&p.outputs));
    let off = largest(
        VOLUMETRIC
            .iter()
            .enumerate()
            .map(|(k, e)| output(k, |y| y.volumetric_efficiency).map(|v| (v - e).abs())),
    );
    let bsfc = range((0..OPEN_RPM.len()).map(|k| output(k, |y| y.bsfc_g_kwh)));
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
    let run: Option<SparkAt70> = result(results, SPARK);
    let fuel = |spark: f64| {
        let run = run.as_ref()?;
        let k = run.spark_deg.iter().position(|s| *s == spark)?;
        run.fuel_mg.get(k).copied()
    };
    let off = largest(FUEL_OF_SPARK.iter().map(|(s, e)| fuel(*s).map(|v| 100.0 * (v / e - 1.0).abs())));
    let maxima = run.as_ref().map(|r| r.maxima.abs_diff(1) as f64);
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
            run.as_ref().map(|r| r.largest_second_difference_nm),
            "",
        ),
    ]
}

/// What the thesis states and a number can decide.
fn thesis(results: &[TaskResult]) -> Vec<Check> {
    let steps = ["30->70 Nm", "70->30 Nm"];
    let all = transients(results);
    let named = |name: &str| all.iter().find(|t| t.name == name);
    let settling = |of: fn(&Transient) -> Option<f64>| largest(steps.iter().map(|s| named(s).and_then(of)));
    let lean = named("throttle +3 deg").and_then(|t| t.lambda_end);
    let (torques, fuel) = fuel_line(results);
    let bend = (fuel.len() > 2).then(|| nonlinearity_pct(&torques, &fuel));
    let note = "steps of the static map between 30 and 70 Nm at 2000 rpm";
    vec![
        check(
            "torque-settling",
            "Torque settles to 1 Nm",
            "s",
            Asked::AtMost(1.5),
            settling(|t| t.torque_settling_s),
            note,
        ),
        check(
            "lambda-settling",
            "Lambda settles to 0.01",
            "s",
            Asked::AtMost(2.0),
            settling(|t| t.lambda_settling_s),
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
