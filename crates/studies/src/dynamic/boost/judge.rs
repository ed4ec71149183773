//! What scenarios 3 and 4 ask.

use super::super::engines::Group;
use super::super::judge::judged;
use super::contest::{OURS, PREPARED, Row, TIPS, UNTRIMMED, WAITS};
use super::learned::POSSIBLE;
use super::measures::TipIn;
use super::{ENGINE, TipCase, cases};
use crate::asked::Asked;
use crate::{Check, TaskResult};

type Of = fn(&TipIn) -> f64;

/// Which rivals count: those of the table, or also those that rest as ours.
#[derive(Clone, Copy, PartialEq)]
enum Rivals {
    Table,
    Prepared,
}

fn value(case: &TipCase, name: &str, tip: usize, of: Of) -> Option<f64> {
    case.found.as_ref()?.rows.iter().find(|r| r.name == name)?.tips.get(tip).map(of)
}

/// The rival of least `by` among those that count.
fn best_by(rows: &[Row], tip: usize, by: Of, rivals: Rivals) -> Option<&Row> {
    let counts = |name: &str| {
        ![OURS, UNTRIMMED, WAITS, POSSIBLE].contains(&name)
            && name.ends_with(PREPARED) == (rivals == Rivals::Prepared)
    };
    let known = rows.iter().filter(|r| counts(&r.name) && r.tips.get(tip).is_some());
    known.min_by(|a, b| by(&a.tips[tip]).total_cmp(&by(&b.tips[tip])))
}

/// A row over the rival that is best in `by`.
fn over(case: &TipCase, name: &str, tip: usize, of: Of, by: Of, rivals: Rivals) -> Option<f64> {
    let best = best_by(&case.found.as_ref()?.rows, tip, by, rivals)?;
    Some(value(case, name, tip, of)? / of(&best.tips[tip]))
}

/// Ours over the best rival's.
fn ratio(case: &TipCase, tip: usize, of: Of, rivals: Rivals) -> Option<f64> {
    over(case, OURS, tip, of, of, rivals)
}

/// Reads a number from a case.
type Reads = Box<dyn Fn(&TipCase) -> Option<f64>>;

/// A number of a case that is asked.
struct Number {
    id: String,
    what: String,
    asked: Asked,
    of: Reads,
}

fn numbers() -> Vec<Number> {
    use Asked::{AtMost, Reported};
    use Rivals::{Prepared, Table};
    let ratios: [(&str, &str, Asked, Of, Rivals); 9] = [
        ("3", "t90: time until 90 % of the torque", AtMost(0.8), |t| t.t90_s, Table),
        (
            "3",
            "t90-prepared: the same beside a rival whose wastegate rests as ours",
            Reported,
            |t| t.t90_s,
            Prepared,
        ),
        ("3", "fuel-per-work: fuel per work of the first 3 s", AtMost(1.02), |t| t.fuel_g_kwh, Table),
        ("3", "fuel-at-rest: fuel per work before the tip-in", Reported, |t| t.rest_g_kwh, Table),
        (
            "4",
            "integral: integral of |lambda - 1|, mean of tip-in and tip-out",
            AtMost(0.75),
            |t| t.integral_s,
            Table,
        ),
        (
            "4",
            "integral-prepared: the same beside a rival whose wastegate rests as ours",
            Reported,
            |t| t.integral_s,
            Prepared,
        ),
        ("4", "co-hc: CO and HC of the first 4 s of both", AtMost(0.9), |t| t.co_hc_g, Table),
        ("4", "no: NO of the same time", Reported, |t| t.no_g, Table),
        ("4", "fuel: fuel of the same time", Reported, |t| t.fuel_g, Table),
    ];
    let values: [(&str, &str, Asked, Of); 4] = [
        ("3", "knock: largest knock index", AtMost(1.0), |t| t.knock),
        ("3", "overshoot: largest torque over its demand, less 1", AtMost(0.05), |t| t.overshoot),
        ("3", "lambda: largest distance of lambda from its demand", AtMost(0.05), |t| t.lambda),
        ("3", "offset: torque at the end less its demand in Nm", Reported, |t| t.offset_nm),
    ];
    let mut out = Vec::new();
    for (tip, (speed, [low, high])) in TIPS.iter().enumerate() {
        let named = |scenario: &str, words: &str| {
            let (id, what) = words.split_once(": ").unwrap_or((words, words));
            (format!("{scenario}-{speed}-{id}"), format!("{low} to {high} Nm at {speed} rpm: {what}"))
        };
        for (scenario, words, asked, of, rivals) in ratios {
            let (id, what) = named(scenario, words);
            let what = format!("{what}, over the best rival's");
            out.push(Number { id, what, asked, of: Box::new(move |c| ratio(c, tip, of, rivals)) });
        }
        // What fuel can have that holds lambda at 1 with the same air, and what ours has beside the one rival that holds lambda best.
        let (integral, co_hc): (Of, Of) = (|t| t.integral_s, |t| t.co_hc_g);
        let beside: [(&str, &str, Of, Of); 4] = [
            (
                "integral-possible: integral of |lambda - 1| of what is possible, over the best rival's",
                POSSIBLE,
                integral,
                integral,
            ),
            ("co-hc-possible: CO and HC of what is possible, over the best rival's", POSSIBLE, co_hc, co_hc),
            (
                "co-hc-lambda: CO and HC beside the rival with the least integral of |lambda - 1|",
                OURS,
                co_hc,
                integral,
            ),
            (
                "co-hc-lambda-possible: that of what is possible beside the same rival",
                POSSIBLE,
                co_hc,
                integral,
            ),
        ];
        for (words, row, of, by) in beside {
            let (id, what) = named("4", words);
            out.push(Number {
                id,
                what,
                asked: Reported,
                of: Box::new(move |c| over(c, row, tip, of, by, Table)),
            });
        }
        // What it is worth to hold the throttle back until its fuel is there, and what it costs.
        let waiting: [(&str, Of); 3] = [
            ("waits-t90: time until 90 % where the throttle waits for the fuel, in s", |t| t.t90_s),
            ("waits-lambda: largest distance of lambda from its demand there", |t| t.lambda),
            ("waits-integral: integral of |lambda - 1| there, in s", |t| t.integral_s),
        ];
        for (words, of) in waiting {
            let (id, what) = named("3", words);
            out.push(Number { id, what, asked: Reported, of: Box::new(move |c| value(c, WAITS, tip, of)) });
        }
        for (scenario, words, asked, of) in values {
            let (id, what) = named(scenario, words);
            out.push(Number { id, what, asked, of: Box::new(move |c| value(c, OURS, tip, of)) });
        }
    }
    out
}

/// The checks; none where no case was run.
pub(in super::super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let mut checks = Vec::new();
    for group in Group::ALL {
        let (own, (suffix, words)) = (group == Group::Own, group.words());
        for n in numbers() {
            let found: Vec<Option<f64>> =
                all.iter().filter(|c| Group::of(ENGINE, &c.boosted) == group).map(|c| (n.of)(c)).collect();
            if own || !found.is_empty() {
                let (id, what) = (format!("{}{suffix}", n.id), format!("{}, {words}", n.what));
                checks.push(judged(&id, &what, n.asked, &found, !own));
            }
        }
    }
    let time = |of: fn(&super::Found) -> f64| {
        Asked::Reported.worst(&all.iter().map(|c| c.found.as_ref().map(of)).collect::<Vec<_>>())
    };
    for (id, what, of) in [
        (
            "3-bed-time",
            "bed time of ours beyond the steady points: records and searches",
            (|f| f.record_s + f.search_s[1]) as fn(&super::Found) -> f64,
        ),
        ("3-bed-time-rival", "bed time of the searches of the rival's retard", |f| f.search_s[0]),
    ] {
        checks.push(crate::check(
            id,
            what,
            Asked::Reported,
            time(of),
            "s",
            "six inputs; the line searches of the rivals' fuel took more, which is not counted against them",
        ));
    }
    checks
}
