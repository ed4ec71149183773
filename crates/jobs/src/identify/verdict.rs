//! The result of an identification in words: what came out, against what, what to do next.

use dynocal_ident::data::UnitAfter;
use dynocal_ident::validate::{Kind, Seen};

use super::finding::{Grade, Topic};
use super::points::PointsPage;
use super::result::{Identified, Modelled, Score};

/// A share of the variance below which a free run is called poor, and above which it is called close, in percent.
const POOR: f64 = 50.0;
const CLOSE: f64 = 90.0;
/// A ratio of errors beyond which one of them is of rounding.
const MOST_TIMES: f64 = 1e9;
/// A linear model this much better, or at most this much worse, is the better choice.
const AS_GOOD: f64 = 1.02;

/// Structures that are linear themselves.
const LINEAR: [&str; 7] = ["arx", "linear_arx", "armax", "oe", "bj", "fir_arma", "linear"];

/// Sentences for every target, then what to do next.
pub fn verdict(found: &Identified) -> Vec<String> {
    let mut out: Vec<String> = found.models.iter().map(|m| target(found, m)).collect();
    out.push(next(found));
    out
}

/// The score that says most: the free run on the last unseen part, else on the estimation.
fn telling<'a>(found: &'a Identified, m: &Modelled) -> Option<&'a Score> {
    let of = |seen: Option<Seen>| {
        let own = found.scores.iter().rev().filter(|s| s.output == m.target);
        own.filter(|s| seen.is_none_or(|seen| s.data == seen)).find(|s| s.kind == Kind::FreeRun)
    };
    of(Some(Seen::Unseen))
        .or_else(|| of(None))
        .or_else(|| found.scores.iter().rev().find(|s| s.output == m.target))
}

/// A response model without unseen points: those that were held out say more than those that it was learnt from.
fn held_out(m: &Modelled, p: &PointsPage, s: &Score) -> String {
    let (unit, number) = (UnitAfter(&m.unit), |v: f64| dynocal_report::significant(v, 3));
    let ((rmse, how), r2) = (p.held_out(), p.held_out_r2_percent());
    let mut text = format!(
        "The model of {} {} on points that were held out {how}: RMSE {}{unit}, which explains {} % of their variance; there are no \
         unseen ones.",
        m.target,
        size(r2),
        number(rmse),
        percent(r2)
    );
    if let Some(own) = s.rmse {
        text += &format!(" On the points that it was learnt from: RMSE {}{unit}.", number(own));
    }
    text + &bands(p, &m.unit)
}

fn size(r2: f64) -> &'static str {
    if r2 < POOR {
        "is poor"
    } else if r2 < CLOSE {
        "follows"
    } else {
        "is close"
    }
}

/// A share of the variance, with as many digits as it takes to tell it from all of it and from nothing.
fn percent(r2: f64) -> String {
    let rest = 100.0 - r2;
    if (1e-4..0.5).contains(&rest) {
        return format!("{r2:.*}", (-rest.log10().floor()).max(1.0) as usize);
    }
    if rest < 1e-4 {
        return if rest > 0.0 { "more than 99.9999".into() } else { "100".into() };
    }
    if r2.abs() < 0.01 { "0".into() } else { dynocal_report::significant(r2, 3) }
}

fn target(found: &Identified, m: &Modelled) -> String {
    let Some(s) = telling(found, m) else { return format!("The model of {} has no score.", m.target) };
    if let (Some(p), true) = (&m.points, s.data == Seen::Identification) {
        return held_out(m, p, s);
    }
    let things = if found.steady { "points" } else { "records" };
    let on = match s.data {
        Seen::Unseen => format!("the unseen {things} ({})", s.part),
        Seen::Selection => format!("the {things} that chose it ({}); there are no unseen ones", s.part),
        Seen::Identification => format!("the {things} that it was estimated from; there are no unseen ones"),
    };
    let how = match s.kind {
        _ if found.steady => "from its inputs",
        Kind::FreeRun => "in free run",
        _ => "one step ahead",
    };
    let (Some(rmse), Some(r2)) = (s.rmse, s.r2_percent) else {
        let what = if found.steady { "has no finite value" } else { "diverges" };
        return format!("The model of {} {what} on {on}.", m.target);
    };
    let number = |v: f64| dynocal_report::significant(v, 3);
    let size = if s.outside { "is useless" } else { size(r2) };
    let mut text = format!(
        "The model of {} {size} on {on}: {how} it explains {} % of the variance, RMSE {}{}",
        m.target,
        percent(r2),
        number(rmse),
        UnitAfter(&m.unit)
    );
    if let Some(e) = s.error_95 {
        text += &format!(", 95 % of the errors within {}{}", number(e), UnitAfter(&m.unit));
    }
    text += ".";
    match m.baseline.as_ref().filter(|b| b.part == s.part).map(|b| (b, b.rmse)) {
        Some((b, Some(linear))) => {
            // Of an exact model nothing is a multiple.
            let times = Some(linear / rmse).filter(|r| *r < MOST_TIMES && rmse > 0.0);
            let times = times.map(|r| format!(" ({} times as much)", number(r))).unwrap_or_default();
            text += &format!(
                " A {} from the same {things} has an RMSE of {}{} there{times}.",
                b.structure,
                number(linear),
                UnitAfter(&m.unit),
            );
        }
        Some((b, None)) => text += &format!(" A {} from the same {things} diverges there.", b.structure),
        None => {}
    }
    if let Some(p) = &m.points {
        text += &bands(p, &m.unit);
    }
    text
}

/// What the points say of the bands, and of each point from the others.
fn bands(p: &PointsPage, unit: &str) -> String {
    let (left, number) = (&p.scores.left_out, |v: f64| dynocal_report::significant(v, 3));
    let mut text =
        format!(" Each point predicted from the others: RMSE {}{}", number(left.rmse), UnitAfter(unit));
    match &p.scores.unseen {
        Some(u) => {
            text += &format!("; the 95 % band holds {} % of the unseen points.", number(100.0 * u.coverage))
        }
        None => text += &format!(", {} % of them in the 95 % band.", number(100.0 * left.coverage)),
    }
    if let Some(choice) = &p.choice {
        text += &format!(" {}", choice.words);
    }
    text
}

fn next(found: &Identified) -> String {
    let values = found.findings.iter().find(|f| f.topic == Topic::Values);
    let fault = found.findings.iter().find(|f| f.grade == Grade::Fault);
    if let Some(f) = fault {
        // What is wrong with the records explains what is wrong with the model.
        return format!("Do not use it as it is. First: {}", values.unwrap_or(f).sentence());
    }
    if let Some(f) = values {
        return format!("Next: see to the values first. {}", f.sentence());
    }
    if let Some(m) = found.models.iter().find(|m| beaten(found, m)) {
        return format!("Next: for {} {}", m.target, instead(m));
    }
    if !found.scores.iter().any(|s| s.data == Seen::Unseen) {
        let things = if found.steady { "points" } else { "records" };
        if found.models.iter().all(|m| m.status.is_none()) {
            return format!("Next: score it on {things} of another measurement; these have estimated it.");
        }
        return format!(
            "Next: keep {things} apart that nothing sees before the scores (table split, or [[test]])."
        );
    }
    let poor =
        found.models.iter().find(|m| telling(found, m).and_then(|s| s.r2_percent).is_some_and(|r| r < POOR));
    if let Some(m) = poor {
        if found.steady {
            return format!(
                "Next: {} needs more than this: inputs that are missing, or points where it bends.",
                m.target
            );
        }
        return format!(
            "Next: {} needs more than this: inputs that are missing, longer lags, products of inputs, or records that excite it \
             (residual correlations and the excitation below say which).",
            m.target
        );
    }
    match found.findings.iter().find(|f| f.grade == Grade::Warning) {
        Some(f) => format!("Use it with care: {}", f.sentence()),
        None if found.steady => "It may be used within the boundary of its points.".into(),
        None => "It may be used within the ranges of its records.".into(),
    }
}

/// Whether the linear model beside it is as good; one that is linear itself must be worse.
fn beaten(found: &Identified, m: &Modelled) -> bool {
    let own = telling(found, m).and_then(|s| s.rmse);
    let linear = m.baseline.as_ref().and_then(|b| b.rmse);
    let (Some(own), Some(linear)) = (own, linear) else { return false };
    if is_linear(m) { AS_GOOD * linear < own } else { linear <= AS_GOOD * own }
}

fn is_linear(m: &Modelled) -> bool {
    LINEAR.contains(&m.structure.as_str())
}

fn instead(m: &Modelled) -> &'static str {
    if is_linear(m) {
        "the linear ARX by least squares beside it, which does better (structure `arx`, estimator `ols`), or other orders."
    } else {
        "take the linear model, or another structure: this one is not worth its terms."
    }
}
