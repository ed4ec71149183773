//! The checks.

use super::contest::{FEEDBACK, OURS, Row, UNTRIMMED};
use super::measures::Measures;
use super::{Case, ENGINE, STARTS_C, cases};
use crate::asked::Asked;
use crate::{Check, TaskResult, check};

type Of = fn(&Measures) -> f64;

/// Ours over the best rival, whichever that is for this measure, with or without those that have lambda feedback. Ours without
/// trim is no rival.
fn ratio(case: &Case, course: usize, of: Of, feedback: bool) -> Option<f64> {
    let value = |r: &Row| r.courses.get(course).map(of);
    let ours = case.rows.iter().find(|r| r.name == OURS).and_then(value)?;
    let rivals = case.rows.iter().filter(|r| r.name != OURS && r.name != UNTRIMMED);
    let rivals = rivals.filter(|r| feedback || !r.name.ends_with(FEEDBACK));
    Some(ours / rivals.filter_map(value).reduce(f64::min)?)
}

/// Mean of the seeds with its standard error in words; the worst of engines.
fn judged(id: &str, what: &str, asked: Asked, ratios: &[Option<f64>], worst: bool) -> Check {
    let all: Option<Vec<f64>> = ratios.iter().copied().collect();
    let all = all.filter(|a| !a.is_empty());
    let mean = all.as_ref().map(|a| a.iter().sum::<f64>() / a.len() as f64);
    let measured = if worst { asked.worst(ratios) } else { mean };
    let note = match (&all, mean) {
        (Some(a), Some(m)) if a.len() > 1 => {
            let variance = a.iter().map(|x| (x - m).powi(2)).sum::<f64>() / (a.len() - 1) as f64;
            let error = (variance / a.len() as f64).sqrt();
            let each: Vec<String> = a.iter().map(|x| format!("{x:.3}")).collect();
            format!("mean {m:.3}, standard error {error:.3}; each: {}", each.join(", "))
        }
        _ => String::new(),
    };
    check(id, what, asked, measured, "-", note)
}

/// A ratio that is asked: scenario, course, id, words, most.
type Ratio = (usize, usize, String, String, Asked, Of);

fn at_most(most: f64) -> Asked {
    Asked::AtMost((most * 1e4_f64).round() / 1e4)
}

fn ratios() -> Vec<Ratio> {
    let integral: Of = |m| m.integral_s;
    let t90: Of = |m| m.t90_s;
    let mut out = Vec::new();
    for (course, id, words) in [(0, "steps", "steps of 30 and 70 Nm"), (1, "random", "random points")] {
        let what = format!("{words}: integral of |lambda - 1|");
        out.push((1, course, format!("1-{id}-integral"), what, at_most(1.0 / 3.0), integral));
        let what = format!("{words}: largest spike of lambda");
        out.push((1, course, format!("1-{id}-spike"), what, at_most(0.5), Measures::spike as Of));
    }
    let what = "steps of 30 and 70 Nm: time until 90 % of the torque".to_string();
    out.push((1, 0, "1-t90".into(), what, Asked::Reported, t90));
    for (course, start_c) in STARTS_C.iter().enumerate() {
        let words = format!("steps, coolant at {start_c} degC at the start");
        let what = format!("{words}: integral of |lambda - 1|");
        out.push((2, course, format!("2-{start_c}-integral"), what, at_most(1.0 / 3.0), integral));
        let what = format!("{words}: time until 90 % of the torque");
        out.push((2, course, format!("2-{start_c}-t90"), what, at_most(1.07), t90));
    }
    out
}

pub(super) fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let mut checks = Vec::new();
    for (own, suffix, words) in [
        (true, "", "over the best rival's, mean of seeds"),
        (false, "-others", "over the best rival's, worst of engines like it"),
    ] {
        for (scenario, course, id, what, asked, of) in ratios() {
            let of_it = all.iter().filter(|c| c.scenario == scenario && (c.engine == ENGINE) == own);
            let of_it: Vec<&Case> = of_it.collect();
            if !own && of_it.is_empty() {
                continue;
            }
            let ratios = |feedback| of_it.iter().map(|c| ratio(c, course, of, feedback)).collect::<Vec<_>>();
            let (id, what) = (format!("{id}{suffix}"), format!("{what}, {words}"));
            checks.push(judged(&id, &what, asked, &ratios(true), !own));
            // The table of rivals has no feedback in this scenario, but ours has a trim.
            if scenario == 1 && id.contains("-integral") {
                let what = format!("{what}, rivals with lambda feedback left out");
                checks.push(judged(&format!("{id}-open"), &what, Asked::Reported, &ratios(false), !own));
            }
        }
    }
    for scenario in [1, 2] {
        let of_it = || all.iter().filter(|c| c.scenario == scenario);
        let bed = of_it().map(|c| Some(c.record_s)).collect::<Vec<_>>();
        let map = of_it().map(|c| c.map_s).fold(0.0, f64::max);
        // The length of the record is the study's own: nothing to hold.
        checks.push(check(
            format!("{scenario}-bed-time"),
            format!("scenario {scenario}: bed time of ours beyond the static map's"),
            Asked::Reported,
            Asked::Reported.worst(&bed),
            "s",
            format!("the line searches of the rivals took more, which is not counted against them; the map took up to {map:.0} s"),
        ));
    }
    let failed: Vec<String> = all
        .iter()
        .filter_map(|c| {
            c.failed.as_ref().map(|f| format!("scenario {}, {}, seed {}: {f}", c.scenario, c.engine, c.seed))
        })
        .collect();
    let count = failed.len() + results.len() - all.len();
    checks.push(check(
        "failed",
        "cases without a controller",
        Asked::AtMost(0.0),
        Some(count as f64),
        "-",
        failed.join("; "),
    ));
    checks
}
