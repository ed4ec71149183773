//! Faults of a calibration spec that its types cannot show.

use crate::calibrate::context::{MIN_FUEL_MG, OPEN_THROTTLE_DEG, gains};
use crate::calibrate::spec::CalibrateSpec;
use dynocal_design::criterion::CRITERIA;
use dynocal_files::spec::Faults;

use dynocal_plant::plants;

/// Reports every fault of `s`.
pub(crate) fn check(s: &CalibrateSpec, faults: &mut Faults) {
    faults.range("sample_time_s", s.sample_time_s, 0.005, 0.5, "s");
    for f in plants::check(&s.plant) {
        if f.known.is_empty() {
            faults.push(&f.key, f.found, f.expected);
        } else {
            faults.unknown(&f.key, &f.found, &f.known);
        }
    }
    if let Err(e) = gains(&s.excite.gains) {
        faults.push("excite.gains", format!("`{}`", s.excite.gains), e);
    }
    if !CRITERIA.iter().any(|m| m.doc.name == s.design.criterion) {
        let known: Vec<String> = CRITERIA.iter().map(|m| m.doc.name.to_string()).collect();
        faults.unknown("design.criterion", &s.design.criterion, &known);
    }
    const PAIRS: [&str; 3] = ["auto", "measured", "simulated"];
    if !PAIRS.contains(&s.invert.pairs.as_str()) {
        faults.unknown("invert.pairs", &s.invert.pairs, &PAIRS.map(str::to_string));
    }
    // NaN and infinity are numbers of TOML: they reach this point as well.
    if let Ok(table) = toml::Table::try_from(s) {
        numbers(&table, "", faults);
    }
    start_rate(s, faults);
    program(s, faults);
    lengths(s, faults);
    counts(s, faults);
}

/// Limits and weights of the fuel program, and the ridge of the models.
fn program(s: &CalibrateSpec, faults: &mut Faults) {
    let p = &s.optimise.program;
    if p.inj_mg.1.is_finite() && p.inj_mg.1 <= MIN_FUEL_MG {
        let expected = format!("an upper limit above {MIN_FUEL_MG} mg, the least fuel that the loops use");
        faults.push("optimise.program.inj_mg", format!("{:?}", p.inj_mg), expected);
    }
    if p.throttle_deg.0 >= OPEN_THROTTLE_DEG {
        let expected = format!("a lower limit below {OPEN_THROTTLE_DEG} deg, where the throttle is open");
        faults.push("optimise.program.throttle_deg", format!("{:?}", p.throttle_deg), expected);
    }
    faults.positive("optimise.program.tolerance", p.tolerance, "-");
    for (k, weight) in p.increment_weight.iter().enumerate() {
        faults.range(
            &format!("optimise.program.increment_weight[{k}]"),
            *weight,
            0.0,
            1e6,
            "kg/h per unit^2",
        );
    }
    faults.range("identify.ridge", s.identify.ridge, 0.0, 1.0, "-");
    faults.range("invert.shape.ridge", s.invert.shape.ridge, 0.0, 1.0, "-");
    for (key, range) in [("excite.spark_deg", s.excite.spark_deg), ("design.spark_deg", s.design.spark_deg)] {
        if range.0 < p.spark_deg.0 || range.1 > p.spark_deg.1 {
            let expected = format!("inside optimise.program.spark_deg = {:?}, deg BTDC", p.spark_deg);
            faults.push(key, format!("{range:?}"), expected);
        }
    }
    let shape = &s.invert.shape;
    let offsets = shape.torque_offsets.iter().chain(&shape.lambda_offsets).chain(&shape.speed_offsets);
    if let Some(far) = offsets.clone().find(|k| **k > shape.look_ahead as i32) {
        let expected = format!("offsets up to invert.shape.look_ahead = {} samples", shape.look_ahead);
        faults.push("invert.shape", far, expected);
    }
    if let Some(far) = offsets.clone().find(|k| **k < -MAP_MEMORY) {
        faults.push("invert.shape", far, format!("offsets from -{MAP_MEMORY} samples on"));
    }
}

/// Records that are long enough for what is done with them.
fn lengths(s: &CalibrateSpec, faults: &mut Faults) {
    for (key, value, least) in [
        ("excite.record_s", s.excite.record_s, 3.0),
        ("design.record_s", s.design.record_s, 3.0),
        ("optimise.record_s", s.optimise.record_s, 3.0),
        ("validate.scenario.point_s", s.validate.scenario.point_s, 1.0),
        ("validate.scenario.step_s", s.validate.scenario.step_s, 1.0),
    ] {
        if value < least {
            faults.push(key, value, format!("at least {least} s"));
        }
    }
}

/// Farthest past sample that the map may look at.
const MAP_MEMORY: i32 = 60;

/// Times that may be zero: a lag of zero is the static map itself, a sweep may turn without a dwell, a step may be
/// instantaneous.
const MAY_BE_ZERO: [&str; 3] = ["lag_s", "dwell_s", "ramp_s"];
/// Pairs that are levels, not limits.
const LEVELS: [&str; 1] = ["step_nm"];

/// Durations and ranges, recognised by their names, so that a new key of any step is checked too.
fn numbers(table: &toml::Table, path: &str, faults: &mut Faults) {
    for (key, value) in table {
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match value {
            toml::Value::Table(t) => numbers(t, &path, faults),
            toml::Value::Float(v) if key.ends_with("_s") => {
                let fits = v.is_finite() && (*v > 0.0 || (*v == 0.0 && MAY_BE_ZERO.contains(&key.as_str())));
                if !fits {
                    faults.push(&path, v, "a positive number, s");
                }
            }
            toml::Value::Array(items) if !LEVELS.contains(&key.as_str()) => axis(&path, key, items, faults),
            _ => {}
        }
    }
}

/// A pair `[lower, upper]` or a grid: increasing numbers.
fn axis(path: &str, key: &str, items: &[toml::Value], faults: &mut Faults) {
    let units = [("_nm", "Nm"), ("_rpm", "rpm"), ("_mg", "mg"), ("_deg", "deg"), ("lambda", "-")];
    let Some((_, unit)) = units.iter().find(|(ending, _)| key.ends_with(ending)) else { return };
    let values: Vec<f64> = items.iter().filter_map(toml::Value::as_float).collect();
    let increasing = values.windows(2).all(|w| w[0] < w[1]) && values.iter().all(|v| v.is_finite());
    if values.is_empty() || !increasing {
        faults.push(path, format!("{values:?}"), format!("increasing numbers, lower before upper, {unit}"));
    }
}

fn start_rate(s: &CalibrateSpec, faults: &mut Faults) {
    let (rate, limit) = (s.optimise.start_spark_rate_deg, s.optimise.program.spark_rate_deg);
    faults.positive("optimise.program.spark_rate_deg", limit, "deg per sample");
    if !(rate > 0.0 && rate <= limit) {
        faults.push(
            "optimise.start_spark_rate_deg",
            rate,
            format!("a positive number, deg per sample, at most optimise.program.spark_rate_deg = {limit}, else the start is not feasible"),
        );
    }
}

fn counts(s: &CalibrateSpec, faults: &mut Faults) {
    for (key, value, least) in [
        ("excite.identification_records", s.excite.identification_records, 1),
        ("excite.validation_records", s.excite.validation_records, 1),
        ("excite.levels", s.excite.levels, 2),
        ("identify.torque_terms", s.identify.torque_terms, 1),
        ("identify.lambda_terms", s.identify.lambda_terms, 1),
        ("identify.max_evaluations", s.identify.max_evaluations, 1),
        ("design.max_evaluations", s.design.max_evaluations, 1),
        ("optimise.passes", s.optimise.passes, 1),
        ("validate.scenario.points", s.validate.scenario.points, 1),
        ("validate.scenario.steps", s.validate.scenario.steps, 1),
    ] {
        if value < least {
            faults.push(key, value, format!("a whole number of at least {least}"));
        }
    }
    let samples = s.excite.record_s / s.sample_time_s * s.excite.identification_records as f64;
    let terms = s.identify.torque_terms.max(s.identify.lambda_terms) + s.identify.surplus_terms;
    if samples.is_finite() && samples < 5.0 * terms as f64 {
        faults.push(
            "excite.record_s",
            s.excite.record_s,
            format!("identification records long enough for {terms} terms (at least 5 samples for each)"),
        );
    }
}
