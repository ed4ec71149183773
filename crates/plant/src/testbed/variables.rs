//! Variables of a bed.

use super::dynamometer::DynoMode;
use super::inputs::EXTRA;
use super::quantity::QUANTITIES;
use super::start::{BedSettings, LAMBDAS};
use dynocal_ident::plant::{Causality, Variable};

/// Inputs, then outputs with the values that they start from.
pub(crate) fn variables(
    settings: &BedSettings,
    extra: &[usize],
    outputs: &[usize],
    values: &[f64],
) -> Vec<Variable> {
    let o = &settings.options;
    let mut u = settings.start;
    let input = |name: &str, unit: &str, (min, max): (f64, f64), start: f64| Variable {
        name: name.to_owned(),
        unit: unit.to_owned(),
        causality: Causality::Input,
        min,
        max,
        start: start.clamp(min, max),
    };
    let limit = o.dynamometer.torque_limit_nm;
    let mut all = vec![
        match o.loops.lambda {
            true => input("lambda_demand", "-", LAMBDAS, values[1]),
            false => input("inj", "mg", (0.0, 120.0), u.injection_mg),
        },
        input("spark", "deg", (-10.0, 55.0), u.spark_deg),
        match o.loops.torque {
            true => input("torque_demand", "Nm", (-100.0, 500.0), values[0]),
            false => input("throttle", "deg", (0.0, 90.0), u.throttle_deg),
        },
        match o.dynamometer.mode {
            DynoMode::Load => input("load", "Nm", (-limit, limit), values[0]),
            DynoMode::InertialSpeed => {
                input("speed", "rpm", (o.dynamometer.least_rpm, o.dynamometer.most_rpm), u.speed_rpm)
            }
            DynoMode::Speed => input("speed", "rpm", (600.0, 6500.0), u.speed_rpm),
        },
    ];
    for &row in extra {
        let e = &EXTRA[row];
        all.push(input(e.name, e.unit, e.range, *(e.field)(&mut u)));
    }
    if let Some(b) = &o.air_bleed {
        all.push(input("air_bleed", "-", (0.0, 1.0), b.start));
    }
    for (&row, &start) in outputs.iter().zip(values) {
        let q = &QUANTITIES[row];
        all.push(Variable { causality: Causality::Output, ..input(q.name, q.unit, q.range, start) });
    }
    all
}
