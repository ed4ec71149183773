//! What is asked.

use dynocal_calib::validate::{DemandScore, MapScore};
use dynocal_jobs::calibrate::validate_step::{DYNAMIC, NOT_REFINED};

use super::CALIBRATION;
use super::work::Found;
use crate::asked::Asked;
use crate::{Check, TaskResult, check, result};

/// Static map, and what the thesis saw on the bed for it in s.
pub(super) const STATIC: &str = "static map";
pub(super) const STATIC_BED_S: f64 = 43_560.0;

/// A score of a map for a demand in scenario number `scenario`.
pub(super) fn of(
    f: &Found,
    scenario: usize,
    map: &str,
    demand: &str,
    number: fn(&DemandScore) -> f64,
) -> Option<f64> {
    f.maps.iter().filter(|s| s.map == map).nth(scenario)?.demand(demand).map(number)
}

pub(super) fn map<'a>(f: &'a Found, scenario: usize, name: &str) -> Option<&'a MapScore> {
    f.maps.iter().filter(|s| s.map == name).nth(scenario)
}

/// R2 of an actuator by a map and an estimator in percent.
pub(super) fn inverse(f: &Found, map: &str, estimator: &str, actuator: &str) -> Option<f64> {
    let has = |text: &str, part: &str| text.to_lowercase().contains(part);
    let row =
        f.inverse.iter().find(|s| has(&s.map, map) && has(&s.estimator, estimator) && s.actuator == actuator);
    row?.r2.map(|r| 100.0 * r)
}

/// Share of the leading output per injection of the delivered map over the static map's, where both hold lambda alike.
pub(super) fn economy(f: &Found, name: &str) -> Option<f64> {
    map(f, 0, name)?.economy_equal
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let found: Option<Found> = result(results, CALIBRATION);
    let f = found.as_ref();
    let mut out = models(results);
    let mut row =
        |id: &str, what: &str, unit: &'static str, asked: Asked, measured: Option<f64>, note: &str| {
            out.push(check(id, what, asked, measured, unit, note));
        };
    let last = f.and_then(|f| f.passes.last());
    let percent = |v: Option<f64>| v.map(|v| 100.0 * v);
    row(
        "fuel-promised",
        "(7.15): fuel of the optimum over that of its start, promised, last pass",
        "%",
        Asked::Reported,
        percent(last.map(|p| p.promised)),
        "thesis 86.17 from random spark; the start here is made by a map, so that little is left to save",
    );
    row(
        "fuel-measured",
        "the same, measured",
        "%",
        Asked::Reported,
        percent(last.map(|p| p.measured)),
        "not in the thesis",
    );
    row(
        "promise",
        "Promised against measured, last pass",
        "points",
        Asked::AtMost(1.0),
        last.map(|p| 100.0 * (p.promised - p.measured).abs()),
        "wanted: 0.4",
    );
    for (actuator, asked, thesis) in [
        ("inj", 97.0, "79.29, after (7.8.1) 93.06"),
        ("spark", 75.0, "26.94, 70.65"),
        ("throttle", 85.0, "40.26, 58.66"),
    ] {
        row(
            &format!("published-{actuator}"),
            &format!("(7.18) by simulation error on its optimal records, R2 of {actuator}"),
            "%",
            Asked::AtLeast(asked),
            f.and_then(|f| inverse(f, "7.18", "simulation", actuator)),
            &format!("thesis {thesis}; wanted 99, 93, 93"),
        );
    }
    for (actuator, asked) in [("inj", 99.0), ("throttle", 98.0)] {
        row(
            &format!("inverse-{actuator}"),
            &format!("Delivered map on the records that it learned from, R2 of {actuator}"),
            "%",
            Asked::Reported,
            f.and_then(|f| inverse(f, "structured", "", actuator)),
            "",
        );
        let unseen = f.and_then(|f| f.unseen.iter().find(|u| u.0 == actuator)?.1);
        row(
            &format!("unseen-{actuator}"),
            &format!("Delivered map on an optimal record of another campaign, R2 of {actuator}"),
            "%",
            Asked::AtLeast(asked),
            percent(unseen),
            "wanted 99.9, 99.5; before the refinement nothing of that campaign was seen either",
        );
    }
    for (demand, unit, asked, thesis) in [("torque", "Nm", 1.0, "2 Nm"), ("lambda", "", 0.015, "0.1")] {
        let offset = |name: &str| f.and_then(|f| of(f, 0, name, demand, |d| d.offset));
        row(
            &format!("offset-{demand}-before"),
            &format!("Worst steady offset of {demand} on random points before the refinement"),
            unit,
            Asked::Reported,
            offset(NOT_REFINED),
            &format!("thesis {thesis}"),
        );
        row(
            &format!("offset-{demand}"),
            &format!("The same after it (section 7.8.2), {demand}"),
            unit,
            Asked::AtMost(asked),
            offset(DYNAMIC),
            "wanted 0.5 Nm, 0.006",
        );
        row(
            &format!("offset-{demand}-static"),
            &format!("The same of the static map, {demand}"),
            unit,
            Asked::Reported,
            offset(STATIC),
            "thesis 1 Nm, 0.01",
        );
        row(
            &format!("models-offset-{demand}"),
            &format!("Map driven on the models (section 7.6.3): steady offset of {demand}"),
            unit,
            Asked::Reported,
            f.and_then(|f| f.on_models.as_ref()?.demand(demand).map(|d| d.offset)),
            "thesis about 5 % of torque, 2 % of lambda",
        );
    }
    row(
        "economy",
        "(6.4): torque per injection of the dynamic map over the static map's, where all maps hold lambda alike",
        "",
        Asked::AtLeast(0.995),
        f.and_then(|f| Some(economy(f, DYNAMIC)? / economy(f, STATIC)?)),
        "thesis 4.15 Nm/mg for both (static map in chapter 6: 4.13)",
    );
    row(
        "bed-time",
        "Bed time of the dynamic map beyond the static map's, refinement included",
        "s",
        Asked::AtMost(600.0),
        f.map(|f| f.bed_s),
        &format!(
            "thesis 60 s of data against {STATIC_BED_S} s; identification, design, optimisation counted here; the gains of the loops are those of the static map"
        ),
    );
    row("bed-time-refinement", "of it for the refinement", "s", Asked::Reported, f.map(|f| f.refine_s), "");
    row(
        "bed-time-static",
        "Bed time of the static map",
        "s",
        Asked::Reported,
        f.and_then(|f| f.static_bed_s),
        "thesis 43 560 s",
    );
    out
}

/// Tables 7.4 and 7.5, asked as section 5 of the feasibility of this chain has it.
fn models(results: &[TaskResult]) -> Vec<Check> {
    let fits = crate::chapter5::fits_7_4(results);
    let asked = [[94.0, 84.0], [99.3, 98.5]];
    let named = [("torque", "M_T"), ("lambda", "M_lambda")];
    let mut out = Vec::new();
    for (kind, words) in ["polynomial (7.8) by simulation error", "network"].into_iter().enumerate() {
        for (k, (output, symbol)) in named.into_iter().enumerate() {
            let fit = &fits[kind][k];
            out.push(check(
                format!("table-7-5-{}-{output}", ["polynomial", "network"][kind]),
                format!("Table 7.5: {words}, {symbol}, mean R2 on unseen records"),
                Asked::AtLeast(asked[kind][k]),
                fit.unseen_pct,
                "%",
                format!("thesis {}", fit.thesis_unseen_pct),
            ));
        }
    }
    out
}
