//! The verdict in words.

use dynocal_control::margin::Margins;

use super::result::{Controlled, LoopResult, Together};

/// Fills verdict, warnings and whether the gains may be used.
pub(super) fn say(found: &mut Controlled) {
    let together = found.together.iter().all(|t| t.violation.is_some_and(|v| v <= 1.0));
    let checked = found.checks.iter().all(|c| c.holds);
    let in_time = found.loops.iter().all(|l| in_time(found, l));
    found.valid = together && checked && in_time;
    let mut verdict = vec![head(found, together)];
    verdict.extend(found.loops.iter().map(|l| gains(found, l)));
    verdict.extend(found.loops.iter().filter_map(predicted));
    verdict.push(kept(found));
    let failed: Vec<&str> = found.checks.iter().filter(|c| !c.holds).map(|c| c.what.as_str()).collect();
    if found.checks.is_empty() {
        verdict.push("No margin was checked by a run.".into());
    } else if failed.is_empty() {
        verdict.push(format!(
            "{} runs at and beyond the margins of the tightest set point do as the margins say.",
            found.checks.len()
        ));
    } else {
        verdict.push(format!("These runs do not do as the margins say: {}.", failed.join("; ")));
    }
    found.verdict = verdict;
    warn(found);
}

fn in_time(found: &Controlled, l: &LoopResult) -> bool {
    let Some(own) = l.rules.first() else { return found.asked.settling_s.is_none() };
    match found.asked.settling_s {
        Some(most) => own.settling_s.is_some_and(|s| s <= most),
        // Any margins are kept by a controller that does nothing: what a search found must act.
        None => own.rule == "given" || own.settling_s.is_some(),
    }
}

fn head(found: &Controlled, together: bool) -> String {
    let draws = judged_draws(found);
    let points = match found.points.len() {
        1 => "at the set point".to_string(),
        n => format!("at all {n} set points"),
    };
    if found.valid {
        format!("The gains keep the margins that are asked {points}{draws}.")
    } else if !together {
        let stable = found.together.iter().all(|t| t.violation.is_some());
        let what = if stable { "do not keep what is asked" } else { "are not stable" };
        format!("The gains must not be used: they {what} {points}{draws}. {}", worst(found)).trim_end().into()
    } else if !found.checks.iter().all(|c| c.holds) {
        "The gains must not be used: a run contradicts a margin.".into()
    } else {
        match found.asked.settling_s {
            Some(asked) => format!(
                "The gains keep the margins that are asked {points}{draws}, but no PI that does settles within {asked} s."
            ),
            None => format!(
                "The gains must not be used: they keep the margins that are asked {points}{draws}, but only by doing next to nothing: a step of the demand does not settle within the run."
            ),
        }
    }
}

/// The draws that were judged, where any were asked for.
fn judged_draws(found: &Controlled) -> String {
    let each = || found.together.iter().map(|t| t.draws);
    let (least, most) = (each().min().unwrap_or(0), each().max().unwrap_or(0));
    match (found.draws, least == most) {
        (0, _) => String::new(),
        (_, true) if most == 0 => " (no draw of the model could be judged)".into(),
        (_, true) => format!(" and for {most} draws of the model at each"),
        (_, false) => format!(" and for {least} to {most} draws of the model at each"),
    }
}

/// Where it fails, and the best that there is.
fn worst(found: &Controlled) -> String {
    let size = |t: &Together| t.violation.unwrap_or(f64::INFINITY);
    let Some(t) = found.together.iter().max_by(|a, b| size(a).total_cmp(&size(b))) else {
        return String::new();
    };
    match (t.violation, t.violation_nominal) {
        (Some(v), _) => {
            let searched = found.loops.iter().all(|l| l.rules.first().is_some_and(|t| t.rule != "given"));
            let best = if searched { " These are the best that were found." } else { "" };
            format!("The worst is {}: asked is {v:.3} times what there is.{best}", t.point)
        }
        (None, None) => format!("At {} the loop has {}.", t.point, t.stable),
        (None, Some(_)) => {
            format!("At {} {} of {} draws are not stable.", t.point, t.unstable_draws, t.draws)
        }
    }
}

fn gains(found: &Controlled, l: &LoopResult) -> String {
    let mut text =
        format!("`{}` by `{}`: kp = {}, ki = {} 1/s", l.output, l.input, digits(l.kp), digits(l.ki));
    if l.kd != 0.0 {
        text += &format!(", kd = {} s with a filter of {} s", digits(l.kd), digits(l.derivative_filter_s));
    }
    if !l.by_point.is_empty() {
        let range = |of: &dyn Fn(&(f64, f64)) -> f64| {
            let all = l.by_point.iter().map(of);
            let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            format!("{} to {}", digits(low), digits(high))
        };
        let shared = if l.kd == 0.0 {
            String::new()
        } else {
            let (kd, filter_s) = (digits(l.kd), digits(l.derivative_filter_s));
            format!(", kd = {kd} s with a filter of {filter_s} s at all of them")
        };
        return format!(
            "`{}` by `{}`: gains over {}, kp {}, ki {} 1/s{shared}; each set point is judged with its own.",
            l.output,
            l.input,
            found.schedule.join(" and "),
            range(&|g| g.0),
            range(&|g| g.1)
        );
    }
    if found.detuned > 1.0 {
        text += &format!(
            " (made smaller by F = {:.3} because {}, alone {} and {})",
            found.detuned,
            if found.loops.len() > 1 {
                "the loops act on each other"
            } else {
                "the predictor's loop keeps less than its undelayed one"
            },
            digits(l.kp * found.detuned),
            digits(l.ki * found.detuned * found.detuned)
        );
    }
    if let Some(t) = l.rules.first() {
        let alone = if found.loops.len() > 1 { ", the other loops open," } else { "" };
        match t.settling_s {
            Some(s) => {
                text += &format!(
                    "; a step of the demand{alone} settles within {} s, overshoot {:.0} %",
                    digits(s),
                    100.0 * t.overshoot.max(0.0)
                )
            }
            None => text += &format!("; a step of the demand{alone} does not settle within the run"),
        }
    }
    text + "."
}

/// How wrong the delay of a predictor may be.
fn predicted(l: &LoopResult) -> Option<String> {
    let p = l.predictor.as_ref()?;
    let end = |v: Option<f64>, what: &str| {
        v.map_or(format!("any time {what}"), |d| format!("{} s {what}", digits(d.abs())))
    };
    Some(
        format!(
            "The Smith predictor of `{}` stands while the delay is less than {} or {} than its {} s; gains of the plant from {} to {} times that of its model.",
            l.output,
            end(p.above_s, "longer"),
            end(p.below_s, "shorter"),
            digits(p.delay_s),
            digits(p.gain.0),
            digits(p.gain.1)
        ) + &p.flow.as_ref().map_or(String::new(), |f| {
            let unit = if f.unit == "-" { String::new() } else { format!(" {}", f.unit) };
            format!(
                " Its delay goes with one over `{}`; it is judged at {}{unit}.",
                f.channel,
                digits(f.nominal)
            )
        }),
    )
}

fn kept(found: &Controlled) -> String {
    let all: Vec<&Margins> = found.together.iter().flat_map(|t| &t.loops).collect();
    if all.is_empty() {
        return "There are no margins: no set point has a stable loop.".into();
    }
    let least =
        |of: &dyn Fn(&Margins) -> Option<f64>| all.iter().filter_map(|m| of(m)).fold(f64::INFINITY, f64::min);
    let most = all.iter().map(|m| m.sensitivity).fold(0.0, f64::max);
    let number =
        |v: f64, unit: &str| if v.is_finite() { format!("{}{unit}", digits(v)) } else { "any".into() };
    let disk = found
        .together
        .iter()
        .filter_map(|t| t.outputs.as_ref().map(|d| d.alpha))
        .fold(f64::INFINITY, f64::min);
    let others = if found.loops.len() > 1 { ", each loop with the others closed" } else { "" };
    format!(
        "Least margins of the nominal models{others}: gain {}, phase {}, delay {}, Ms {}, disk margin of all outputs {}.",
        number(least(&|m| m.gain_up), ""),
        number(least(&|m| m.phase_deg), " deg"),
        number(least(&|m| m.delay_s), " s"),
        digits(most),
        number(disk, "")
    )
}

fn warn(found: &mut Controlled) {
    let mut first = Vec::new();
    for t in &found.together {
        if t.loops.is_empty() {
            first.push(format!("{}: the closed loop has {}", t.point, t.stable));
        } else if t.unstable_draws > 0 {
            first.push(format!("{}: {} of {} draws are not stable", t.point, t.unstable_draws, t.draws));
        }
    }
    for (point, r) in found.points.iter().zip(&found.relative_gains) {
        let n = found.loops.len();
        for k in 0..n {
            if let Some(g) = r.as_ref().map(|r| r[k * n + k]).filter(|g| *g < 0.2) {
                let l = &found.loops[k];
                first.push(format!(
                    "{point}: the relative gain of `{}` by `{}` is {g:.2}: with the other loops closed it is another plant; another pairing or a decoupler would do better",
                    l.output, l.input
                ));
            }
        }
    }
    first.append(&mut found.warnings);
    found.warnings = first;
}

pub(super) fn digits(v: f64) -> String {
    dynocal_report::significant(v, 4)
}
