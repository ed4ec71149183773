//! Faults of a calibration spec that its types cannot show.

use dynocal_calib::chain::context::gains;
use dynocal_calib::chain::spec::CalibrateSpec;
use dynocal_design::criterion::CRITERIA;
use dynocal_files::spec::Faults;

use crate::plants;

/// Reports every fault of `s`.
pub(crate) fn check(s: &CalibrateSpec, faults: &mut Faults) {
    faults.range("sample_time_s", s.sample_time_s, 0.005, 0.5, "s");
    plants::check(&s.plant, faults);
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
    durations(s, faults);
    ranges(s, faults);
    counts(s, faults);
    for (key, axis) in [
        ("validate.static_map.torque_nm", &s.validate.static_map.torque_nm),
        ("validate.static_map.speed_rpm", &s.validate.static_map.speed_rpm),
    ] {
        if axis.is_empty() || axis.windows(2).any(|w| w[0] >= w[1]) || axis.iter().any(|v| !v.is_finite()) {
            faults.push(key, format!("{axis:?}"), "increasing numbers");
        }
    }
}

fn durations(s: &CalibrateSpec, faults: &mut Faults) {
    let v = &s.validate;
    for (key, value) in [
        ("excite.record_s", s.excite.record_s),
        ("excite.hold_s", s.excite.hold_s),
        ("excite.sweep_s", s.excite.sweep_s),
        ("design.record_s", s.design.record_s),
        ("design.hold_s", s.design.hold_s),
        ("optimise.record_s", s.optimise.record_s),
        ("optimise.hold_s", s.optimise.hold_s),
        ("validate.scenario.point_s", v.scenario.point_s),
        ("validate.scenario.step_s", v.scenario.step_s),
        ("validate.static_map.settle_s", v.static_map.settle_s),
        ("validate.static_map.average_s", v.static_map.average_s),
    ] {
        faults.positive(key, value, "s");
    }
    // A lag of zero is the static map itself, and a sweep may turn without a dwell.
    faults.range("validate.lag_s", v.lag_s, 0.0, 10.0, "s");
    faults.range("excite.dwell_s", s.excite.dwell_s, 0.0, 1e4, "s");
}

fn ranges(s: &CalibrateSpec, faults: &mut Faults) {
    let (e, d, o, v) = (&s.excite, &s.design, &s.optimise, &s.validate.scenario);
    for (key, (lower, upper), unit) in [
        ("excite.torque_nm", e.torque_nm, "Nm"),
        ("excite.lambda", e.lambda, "-"),
        ("excite.spark_deg", e.spark_deg, "deg"),
        ("excite.speed_rpm", e.speed_rpm, "rpm"),
        ("design.inj_mg", d.inj_mg, "mg"),
        ("design.spark_deg", d.spark_deg, "deg"),
        ("design.throttle_deg", d.throttle_deg, "deg"),
        ("design.torque_nm", d.torque_nm, "Nm"),
        ("design.lambda", d.lambda, "-"),
        ("optimise.torque_nm", o.torque_nm, "Nm"),
        ("optimise.lambda", o.lambda, "-"),
        ("optimise.program.inj_mg", o.program.inj_mg, "mg"),
        ("optimise.program.spark_deg", o.program.spark_deg, "deg"),
        ("optimise.program.throttle_deg", o.program.throttle_deg, "deg"),
        ("validate.scenario.torque_nm", v.torque_nm, "Nm"),
        ("validate.scenario.speed_rpm", v.speed_rpm, "rpm"),
    ] {
        // NaN fails too.
        let ordered = lower < upper && lower.is_finite() && upper.is_finite();
        if !ordered {
            faults.push(
                key,
                format!("[{lower}, {upper}]"),
                format!("[lower, upper] with lower < upper, {unit}"),
            );
        }
    }
    faults.positive("optimise.program.spark_rate_deg", o.program.spark_rate_deg, "deg per sample");
    let rate = o.start_spark_rate_deg;
    if !(rate > 0.0 && rate <= o.program.spark_rate_deg) {
        faults.push(
            "optimise.start_spark_rate_deg",
            rate,
            format!(
                "a positive number, deg per sample, at most optimise.program.spark_rate_deg = {} (else the start is not feasible)",
                o.program.spark_rate_deg
            ),
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
