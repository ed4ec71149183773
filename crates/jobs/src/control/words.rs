//! The verdict in words.

use dynocal_control::margin::Margins;

use super::gains::PI_ALONE;
use super::result::{Controlled, LoopResult, StepResult, Together};

/// Relative gains outside of which loops are another plant once the others are closed (E. H. Bristol, IEEE Trans. Automatic Control 11 (1966)
/// 133-134; S. Skogestad, I. Postlethwaite, Multivariable Feedback Control (2005), section 3.4, on large ones).
const APART: std::ops::Range<f64> = 0.2..5.0;

/// Fills verdict, warnings and whether the gains may be used.
pub(super) fn say(found: &mut Controlled) {
    let together = found.together.iter().all(|t| t.violation.is_some_and(|v| v <= 1.0));
    let checked = found.checks.iter().all(|c| c.holds);
    let in_time = (0..found.loops.len()).all(|k| in_time(found, k));
    found.valid = together && checked && in_time && found.contradicted.is_empty();
    let mut verdict = vec![head(found, together)];
    if !found.beyond.is_empty() {
        verdict.push(format!(
            "At {} the models are outside of what they were identified on: what is said of it is what they would have it, and no record was there.",
            found.beyond.join(", ")
        ));
    }
    verdict.extend((0..found.loops.len()).map(|k| gains(found, k)));
    verdict.extend((0..found.loops.len()).filter_map(|k| predicted(found, k)));
    verdict.push(kept(found));
    let failed: Vec<&str> = found.checks.iter().filter(|c| !c.holds).map(|c| c.what.as_str()).collect();
    if found.checks.is_empty() {
        verdict.push(match (found.unchecked.first(), found.together.iter().any(|t| t.loops.is_empty())) {
            (Some(why), _) => {
                format!("No margin was checked by a run: they stand on frequencies alone. {why}.")
            }
            (None, true) => "No margin was checked by a run.".into(),
            (None, false) => "No margin was checked by a run: none of them is ever used up.".into(),
        });
    } else if failed.is_empty() {
        let left = match found.unchecked.first() {
            Some(why) => format!(" {} more could not be run. {why}.", found.unchecked.len()),
            None => String::new(),
        };
        verdict.push(format!(
            "{} runs at and beyond the margins of the tightest set point do as the margins say.{left}",
            found.checks.len()
        ));
    } else {
        verdict.push(format!("These runs do not do as the margins say: {}.", failed.join("; ")));
    }
    // The first stands at the head, where nothing worse does.
    let told = verdict[0].clone();
    let beside = found.contradicted.iter().filter(|c| !told.contains(c.as_str()));
    verdict.extend(beside.map(|c| format!("{c}.")));
    found.verdict = verdict;
    warn(found);
}

/// How a loop follows a step of its demand at the slowest set point, and whether all loops were closed for it. A single loop without a predictor
/// is judged as it was searched: on a channel that integrates by a load as well.
fn step(found: &Controlled, k: usize) -> Option<(StepResult, bool)> {
    let l = &found.loops[k];
    let alone = l.rules.first().map(|t| StepResult { settling_s: t.settling_s, overshoot: t.overshoot });
    if (found.loops.len() == 1 && l.predictor.is_none()) || found.together.iter().any(|t| t.steps.is_empty())
    {
        return alone.map(|s| (s, false));
    }
    let each = found.together.iter().map(|t| t.steps[k]);
    let slower = |a: StepResult, b: StepResult| StepResult {
        settling_s: a.settling_s.zip(b.settling_s).map(|(a, b)| a.max(b)),
        overshoot: a.overshoot.max(b.overshoot),
    };
    each.reduce(slower).map(|s| (s, true))
}

fn in_time(found: &Controlled, k: usize) -> bool {
    let Some((own, _)) = step(found, k) else { return found.asked.settling_s.is_none() };
    match found.asked.settling_s {
        Some(most) => own.settling_s.is_some_and(|s| s <= most),
        // Any margins are kept by a controller that does nothing: what a search found must act.
        None => given(&found.loops[k]) || own.settling_s.is_some(),
    }
}

fn given(l: &LoopResult) -> bool {
    l.rules.first().is_some_and(|t| t.rule == "given")
}

/// The loops that do not settle in time, and what they take.
fn late(found: &Controlled) -> String {
    let one = |k: usize| {
        let (own, closed) = step(found, k)?;
        let how = match (closed && found.loops.len() > 1, found.loops.len() > 1) {
            (true, _) => " with all loops closed",
            (false, true) => " with the other loops open",
            (false, false) => "",
        };
        let output = &found.loops[k].output;
        Some(match own.settling_s {
            Some(s) => format!("`{output}` takes {} s{how}", digits(s)),
            None => format!("`{output}` does not settle within the run{how}"),
        })
    };
    let all: Vec<String> = (0..found.loops.len()).filter(|k| !in_time(found, *k)).filter_map(one).collect();
    all.join(", ")
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
        let unstable = found.together.iter().filter(|t| t.violation.is_none()).count();
        let (what, failed) = match unstable {
            0 => (
                "do not keep what is asked",
                found.together.iter().filter(|t| t.violation > Some(1.0)).count(),
            ),
            n => ("are not stable", n),
        };
        let points = match found.points.len() {
            1 => points,
            n => format!("at {failed} of {n} set points"),
        };
        let with = if draws.is_empty() { "" } else { ", draws of the model included" };
        format!("The gains must not be used: they {what} {points}{with}. {}", worst(found)).trim_end().into()
    } else if !found.checks.iter().all(|c| c.holds) {
        "The gains must not be used: a run contradicts a margin.".into()
    } else if let Some(first) = found.contradicted.first() {
        format!("The gains must not be used: {first}.")
    } else {
        let late = late(found);
        let searched = found.loops.len() == 1 && !given(&found.loops[0]);
        let kind = if found.loops.iter().any(|l| l.kd != 0.0) { "PID" } else { "PI" };
        match found.asked.settling_s {
            Some(asked) if searched => format!(
                "The gains keep the margins that are asked {points}{draws}, but no {kind} that does was found to settle within {asked} s: {late}."
            ),
            Some(asked) => format!(
                "The gains keep the margins that are asked {points}{draws}, but do not settle within {asked} s: {late}."
            ),
            None => format!(
                "The gains must not be used: they keep the margins that are asked {points}{draws}, but only by doing next to nothing: a step of the demand does not settle within the run ({late})."
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

fn gains(found: &Controlled, k: usize) -> String {
    let l = &found.loops[k];
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
            digits(l.ki * found.detuned * if l.predictor.is_some() { 1.0 } else { found.detuned })
        );
    }
    if let Some((t, closed)) = step(found, k) {
        let alone = match (found.loops.len() > 1, closed) {
            (false, _) => "",
            (true, true) => ", all loops closed,",
            (true, false) => ", the other loops open,",
        };
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
fn predicted(found: &Controlled, k: usize) -> Option<String> {
    let l = &found.loops[k];
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
        }) + &plain(found, k).unwrap_or_default(),
    )
}

/// A PI without the predictor that keeps what is asked and is no slower, which needs no model.
fn plain(found: &Controlled, k: usize) -> Option<String> {
    let l = &found.loops[k];
    let pi = l.rules.iter().find(|t| t.rule == PI_ALONE && t.violation.is_some_and(|v| v <= 1.0))?;
    // Beside others, that PI was judged alone: so is the predictor here.
    let own = if found.loops.len() == 1 { step(found, k)?.0.settling_s } else { l.rules.first()?.settling_s };
    let (plain_s, own_s) = (pi.settling_s?, own.unwrap_or(f64::INFINITY));
    (plain_s <= own_s).then(|| {
        let own = own.map_or("does not settle within the run".to_string(), |s| format!("takes {} s", digits(s)));
        format!(
            " It is of no use here: a PI without it (kp = {}, ki = {} 1/s) keeps what is asked and settles within {} s where the predictor {own}.",
            digits(pi.kp * l.sign),
            digits(pi.ki * l.sign),
            digits(plain_s)
        )
    })
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
            let Some(g) = r.as_ref().map(|r| r[k * n + k]).filter(|g| n > 1 && !APART.contains(g)) else {
                continue;
            };
            let l = &found.loops[k];
            let advice = match (g.abs() >= APART.end, found.decoupler.is_some()) {
                (true, false) => {
                    "the outputs nearly move together, and to hold them apart takes large and slow movements of the inputs; other inputs would do better"
                }
                (true, true) => {
                    "the outputs nearly move together, and the decoupler stands on small differences of gains that a model must know; other inputs would do better"
                }
                (false, false) => "another pairing or a decoupler would do better",
                // What it is there for.
                (false, true) => continue,
            };
            first.push(format!(
                "{point}: the relative gain of `{}` by `{}` is {g:.2}: with the other loops closed it is another plant; {advice}",
                l.output, l.input
            ));
        }
    }
    first.extend(found.unchecked.iter().cloned());
    first.append(&mut found.warnings);
    found.warnings = first;
}

pub(super) fn digits(v: f64) -> String {
    dynocal_report::significant(v, 4)
}
