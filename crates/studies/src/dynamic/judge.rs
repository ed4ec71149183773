//! The checks.

use super::contest::{FEEDBACK, LAGGED, OURS, POSSIBLE, PREVIEW, STATIC, UNTRIMMED};
use super::engines::Group;
use super::measures::Measures;
use super::scenario::{SCENARIOS, SIXTH, Scenario};
use super::{Case, boost, cases, cycles, heating};
use crate::asked::Asked;
use crate::{Check, TaskResult, check};
use dynocal_ident::validate::spread::Spread;

type Of = fn(&Measures) -> f64;

/// What ours is held against.
#[derive(Clone, Copy)]
enum Against {
    /// The best rival, whichever that is for the measure.
    Best,
    /// The best of those without lambda feedback.
    Open,
    /// That one.
    One(&'static str),
}

impl Against {
    fn holds(self, name: &str) -> bool {
        match self {
            Self::One(one) => name == one,
            _ if [OURS, UNTRIMMED, POSSIBLE, PREVIEW].contains(&name) => false,
            Self::Best => true,
            Self::Open => !name.ends_with(FEEDBACK),
        }
    }
}

/// What a row of a case has in a course.
fn value(case: &Case, name: &str, course: usize, of: Of) -> Option<f64> {
    case.rows.iter().find(|r| r.name == name)?.courses.get(course).map(of)
}

/// A row over the best of what it is held against.
fn ratio(case: &Case, name: &str, course: usize, of: Of, against: Against) -> Option<f64> {
    let rivals = case.rows.iter().filter(|r| against.holds(&r.name));
    let best = rivals.filter_map(|r| r.courses.get(course).map(of)).reduce(f64::min)?;
    Some(value(case, name, course, of)? / best)
}

/// Mean of the seeds, with its interval of nineteen of twenty in words where that reaches beyond a most that the mean keeps; the worst of engines.
/// No number where one of them is none.
pub(super) fn judged(id: &str, what: &str, asked: Asked, ratios: &[Option<f64>], worst: bool) -> Check {
    let all: Option<Vec<f64>> = ratios.iter().copied().collect();
    let all = all.filter(|a| !a.is_empty());
    let finite = all.as_ref().filter(|a| a.iter().all(|v| v.is_finite()));
    let spread = finite.map(|a| Spread::of(a, 0.95));
    let measured = if worst { asked.worst(ratios) } else { spread.as_ref().map(|s| s.mean) };
    let note = match (&all, spread) {
        (Some(a), Some(s)) if a.len() > 1 => {
            let each: Vec<String> = a.iter().map(|x| format!("{x:.3}")).collect();
            let sure = match asked {
                Asked::AtMost(most) if !worst && s.mean <= most && s.high > most => {
                    ", which reaches beyond what is asked"
                }
                _ => "",
            };
            format!(
                "mean {:.3}, 95 % interval {:.3} to {:.3}{sure}; each: {}",
                s.mean,
                s.low,
                s.high,
                each.join(", ")
            )
        }
        _ => String::new(),
    };
    check(id, what, asked, measured, "-", note)
}

/// Reads a number from a case.
type Reads = Box<dyn Fn(&Case) -> Option<f64>>;

/// A number of each case that is asked.
struct Number {
    scenario: usize,
    id: String,
    what: String,
    asked: Asked,
    of: Reads,
}

fn at_most(most: f64) -> Asked {
    Asked::AtMost((most * 1e4_f64).round() / 1e4)
}

/// A measure over that of the best rival.
fn over(scenario: usize, course: usize, id: String, what: String, asked: Asked, of: Of) -> Number {
    let of = move |c: &Case| ratio(c, OURS, course, of, Against::Best);
    Number { scenario, id, what: format!("{what}, over the best rival's"), asked, of: Box::new(of) }
}

/// Ours over what learning on the judged record itself reaches without preview: what is left to be had.
fn over_possible(scenario: &Scenario, course: usize, id: &str, words: &str) -> Number {
    Number {
        scenario: scenario.number,
        id: format!("{}-{id}-integral-left", scenario.tag),
        what: format!("{words}: integral of |lambda - 1|, over that of what is possible"),
        asked: Asked::Reported,
        of: Box::new(move |c| ratio(c, OURS, course, |m| m.integral_s, Against::One(POSSIBLE))),
    }
}

fn port_numbers() -> Vec<Number> {
    let (integral, t90): (Of, Of) = (|m| m.integral_s, |m| m.t90_s);
    let third = at_most(1.0 / 3.0);
    let mut out = Vec::new();
    for scenario in SCENARIOS.iter().filter(|s| s.number < 6) {
        let number = scenario.number;
        for (course, (id, words)) in scenario.courses().into_iter().enumerate() {
            let what = format!("{words}: integral of |lambda - 1|");
            out.push(over(number, course, format!("{number}-{id}-integral"), what.clone(), third, integral));
            out.push(over_possible(scenario, course, &id, &words));
            for (row, suffix, told) in
                [(POSSIBLE, "possible", "of what is possible"), (PREVIEW, "preview", "of that with preview")]
            {
                out.push(Number {
                    scenario: number,
                    id: format!("{number}-{id}-integral-{suffix}"),
                    what: format!("{what} {told}, over the best rival's"),
                    asked: Asked::Reported,
                    of: Box::new(move |c| ratio(c, row, course, integral, Against::Best)),
                });
            }
            let torque = format!("{words}: time until 90 % of the torque");
            if number == 2 {
                out.push(over(2, course, format!("2-{id}-t90"), torque, at_most(1.07), t90));
                continue;
            }
            // The table of rivals has no feedback in this scenario, but ours has a trim.
            out.push(Number {
                scenario: number,
                id: format!("{number}-{id}-integral-open"),
                what: format!("{what}, over the best rival's, rivals with lambda feedback left out"),
                asked: Asked::Reported,
                of: Box::new(move |c| ratio(c, OURS, course, integral, Against::Open)),
            });
            let what = format!("{words}: largest spike of lambda");
            out.push(over(
                number,
                course,
                format!("{number}-{id}-spike"),
                what,
                at_most(0.5),
                Measures::spike,
            ));
            if id == "steps" {
                out.push(over(number, course, format!("{number}-t90"), torque, Asked::Reported, t90));
            }
        }
    }
    out
}

/// The sixth scenario: ours beside the tuned lag, and its offsets beside those of the static map.
fn thesis_numbers(number: usize) -> Vec<Number> {
    let measures: [(&str, &str, f64, Of); 3] = [
        ("integral", "integral of |lambda - 1|", 0.8, |m| m.integral_s),
        ("spike", "largest spike of lambda", 0.8, Measures::spike),
        ("torque-rms", "torque beside the demand behind a lag, RMS", 1.0, |m| m.torque_rms_nm),
    ];
    let offsets: [(&str, &str, f64, Of); 2] = [
        ("offset", "offset of lambda", 0.002, |m| m.offset),
        ("torque-offset", "offset of the torque in Nm", 0.1, |m| m.torque_offset_nm),
    ];
    let Some(scenario) = Scenario::of(number) else {
        return Vec::new();
    };
    let tag = scenario.tag;
    let mut out = Vec::new();
    for (course, (id, words)) in scenario.courses().into_iter().enumerate() {
        for (name, what, most, of) in measures {
            out.push(Number {
                scenario: number,
                id: format!("{tag}-{id}-{name}"),
                what: format!("{words}: {what}, over that of the static map with a tuned lag"),
                asked: at_most(most),
                of: Box::new(move |c| ratio(c, OURS, course, of, Against::One(LAGGED))),
            });
        }
        for (name, what, most, of) in offsets {
            out.push(Number {
                scenario: number,
                id: format!("{tag}-{id}-{name}"),
                what: format!("{words}: {what} beyond that of the static map"),
                asked: at_most(most),
                of: Box::new(move |c| Some(value(c, OURS, course, of)? - value(c, STATIC, course, of)?)),
            });
        }
        let integral: Of = |m| m.integral_s;
        out.push(over_possible(scenario, course, &id, &words));
        for (row, suffix, against, told) in [
            (OURS, "best", Against::Best, "integral of |lambda - 1|"),
            (POSSIBLE, "possible", Against::One(LAGGED), "integral of |lambda - 1| of what is possible"),
        ] {
            let beside =
                if suffix == "best" { "the best rival's" } else { "that of the static map with a tuned lag" };
            out.push(Number {
                scenario: number,
                id: format!("{tag}-{id}-integral-{suffix}"),
                what: format!("{words}: {told}, over {beside}"),
                asked: Asked::Reported,
                of: Box::new(move |c| ratio(c, row, course, integral, against)),
            });
        }
    }
    out
}

pub(super) fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let mut checks = Vec::new();
    let numbers: Vec<Number> =
        port_numbers().into_iter().chain(SIXTH.into_iter().flat_map(thesis_numbers)).collect();
    for group in Group::ALL {
        let (own, (suffix, words)) = (group == Group::Own, group.words());
        for n in &numbers {
            let engine = Scenario::of(n.scenario).map_or("", |s| s.engine);
            let of_it =
                all.iter().filter(|c| c.scenario == n.scenario && Group::of(engine, &c.engine) == group);
            let found: Vec<Option<f64>> = of_it.map(|c| (n.of)(c)).collect();
            if !own && found.is_empty() {
                continue;
            }
            let (id, what) = (format!("{}{suffix}", n.id), format!("{}, {words}", n.what));
            checks.push(judged(&id, &what, n.asked, &found, !own));
        }
    }
    for Scenario { number, tag, .. } in &SCENARIOS {
        let of_it = || all.iter().filter(|c| c.scenario == *number);
        // A study of one scenario says nothing of the others.
        if of_it().next().is_none() {
            continue;
        }
        let bed = of_it().map(|c| Some(c.record_s)).collect::<Vec<_>>();
        let map = of_it().map(|c| c.map_s).fold(0.0, f64::max);
        // The length of the record is the study's own: nothing to hold.
        checks.push(check(
            format!("{tag}-bed-time"),
            format!("scenario {tag}: bed time of ours beyond the static map's"),
            Asked::Reported,
            Asked::Reported.worst(&bed),
            "s",
            format!("the line searches of the rivals took more, which is not counted against them; the map took up to {map:.0} s"),
        ));
    }
    let mut failed: Vec<String> = all
        .iter()
        .filter_map(|c| {
            c.failed.as_ref().map(|f| format!("scenario {}, {}, seed {}: {f}", c.scenario, c.engine, c.seed))
        })
        .collect();
    checks.extend(boost::checks(results));
    checks.extend(heating::checks(results));
    checks.extend(cycles::checks(results));
    let mut read = all.len() + cycles::counted(results);
    for (count, of_it) in [boost::counted(results), heating::counted(results)] {
        read += count;
        failed.extend(of_it);
    }
    let count = failed.len() + results.len() - read;
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
