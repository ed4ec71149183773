//! Checks and page.

use dynocal_report::{Cell, Column, Report, Section, Table};

use super::{Case, ENGINES, Engine, cases};
use crate::asked::Asked;
use crate::{Check, TaskResult, check};

/// Points between promise and measurement that are asked, and that are wanted.
const POINTS: f64 = 1.0;
const WANTED: f64 = 0.4;
/// Share of the seeds in which the promise has to hold.
const SHARE: f64 = 0.9;

const WORDS: &str = "Promise and measurement are means of what is minimised over that of the start record, in the last pass, \
    whether it may be used or not. Integral and spike are those of lambda's error, the delivered map over its best rival, as the sensor of the bed shows it; usable is the map by its own verdict, which stands in \
    its report.";

impl Case {
    /// Points by which the last pass missed its promise, whether it may be used or not: that is judged by what was measured, too.
    fn gap(&self) -> Option<f64> {
        self.passes.last().map(super::Promised::gap)
    }

    /// Rivals that hold lambda better both in the mean and at worst, beside a map that may be used.
    fn beaten(&self) -> Vec<String> {
        let rivals = self.lambda.iter().filter_map(|b| Some((&b.scenario, b.beaten_by.as_ref()?)));
        rivals.filter(|_| self.valid).map(|(s, r)| format!("seed {}, {s}: {r}", self.seed)).collect()
    }
}

pub(super) fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let mut out = Vec::new();
    for engine in &ENGINES {
        let of_it: Vec<&Case> = all.iter().filter(|c| c.engine == engine.name).collect();
        if !of_it.is_empty() {
            out.extend(checks(engine, &of_it));
        }
    }
    let failed: Vec<String> = all
        .iter()
        .filter_map(|c| c.failed.as_ref().map(|f| format!("{}, seed {}: {f}", c.engine, c.seed)))
        .collect();
    let count = (failed.len() + results.len() - all.len()) as f64;
    let what = "calibrations that did not end";
    out.push(check("failed", what, Asked::AtMost(0.0), Some(count), "-", failed.join("; ")));
    out
}

fn checks(engine: &Engine, of_it: &[&Case]) -> Vec<Check> {
    let name = engine.name;
    let share = |held: &dyn Fn(&Case) -> bool| {
        Some(of_it.iter().filter(|c| held(c)).count() as f64 / of_it.len() as f64)
    };
    let within = |most: f64| share(&|c: &Case| c.gap().is_some_and(|g| g.abs() <= most));
    let each: Vec<String> =
        of_it.iter().map(|c| c.gap().map_or("none".into(), |g| format!("{g:+.2}"))).collect();
    let passes: Vec<f64> = of_it.iter().flat_map(|c| c.passes.iter().map(|p| p.gap().abs())).collect();
    let ended = || of_it.iter().filter(|c| c.failed.is_none());
    let bed = |of: fn(&Case) -> f64| ended().map(|c| of(c)).fold(0.0, f64::max);
    let valid = of_it.iter().any(|c| c.valid);
    let beaten: Vec<String> = of_it.iter().flat_map(|c| c.beaten()).collect();
    let mean = |of: fn(&super::Beside) -> f64| {
        let all: Vec<f64> = of_it.iter().flat_map(|c| c.lambda.iter().map(of)).collect();
        (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
    };
    let row = |id: &str, what: String, asked, measured, unit, note: String| {
        check(format!("{name}-{id}"), format!("{name}: {what}"), asked, measured, unit, note)
    };
    let reported = Asked::Reported;
    vec![
        row(
            "promise",
            format!("share of the seeds whose measured saving is within {POINTS} point of what was promised"),
            Asked::AtLeast(SHARE),
            within(POINTS),
            "-",
            format!("measured less promised, in points, by seed: {}", each.join(", ")),
        ),
        row("promise-wanted", format!("the same within {WANTED} points"), reported, within(WANTED), "-", String::new()),
        row(
            "promise-worst",
            "largest distance of promise and measurement of all passes".into(),
            reported,
            passes.into_iter().reduce(f64::max),
            "points",
            String::new(),
        ),
        row(
            "usable",
            "share of the seeds whose map may be used".into(),
            Asked::AtLeast(SHARE),
            share(&|c: &Case| c.valid),
            "-",
            String::new(),
        ),
        row(
            "beaten",
            "scenarios in which a map that may be used is worse than one rival in both integral and spike of lambda".into(),
            Asked::AtMost(0.0),
            valid.then_some(beaten.len() as f64),
            "-",
            beaten.join("; "),
        ),
        row("integral", "integral of lambda's error over the best rival's, mean".into(), reported, mean(|b| b.integral), "-", String::new()),
        row(
            "torque",
            "integral of torque's error over the best rival's, mean".into(),
            reported,
            mean(|b| b.torque),
            "-",
            String::new(),
        ),
        row("spike", "spike of lambda over the best rival's, mean".into(), reported, mean(|b| b.spike), "-", String::new()),
        row(
            "bed-time",
            "bed time beyond that of the static map, at most".into(),
            Asked::AtMost(engine.most_bed_s),
            ended().next().map(|_| bed(|c| c.bed_s)),
            "s",
            format!(
                "gains of the loops ({:.0} s) are not counted: the static map ({:.0} s) is held with the same",
                bed(|c| c.loops_s),
                bed(|c| c.static_s)
            ),
        ),
    ]
}

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let head = vec![
        Column::text("Engine"),
        Column::text("Seed"),
        Column::number("Promised", "%").digits(3),
        Column::number("Measured", "%").digits(3),
        Column::text("Usable"),
        Column::number("Integral", "").digits(2),
        Column::number("Spike", "").digits(2),
        Column::number("Bed time", "s").digits(4),
        Column::text("Did not end"),
    ];
    let mut table = Table::new(head).caption("The calibrations; of several scenarios the worst one");
    for c in cases(results) {
        let last = c.passes.last();
        let saved = |ratio: Option<f64>| Cell::from(ratio.map(|r| 100.0 * (r - 1.0)));
        let worst = |of: fn(&super::Beside) -> f64| Cell::from(c.lambda.iter().map(of).reduce(f64::max));
        table = table.row(vec![
            c.engine.as_str().into(),
            c.seed.to_string().into(),
            saved(last.map(|p| p.promised)),
            saved(last.map(|p| p.measured)),
            if c.valid { "yes" } else { "no" }.into(),
            worst(|b| b.integral),
            worst(|b| b.spike),
            c.bed_s.into(),
            c.failed.as_deref().unwrap_or("").into(),
        ]);
    }
    report.section(Section::new("Calibrations").text(WORDS).block(table))
}
