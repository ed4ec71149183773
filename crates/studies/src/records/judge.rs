//! Checks and page.

use dynocal_report::{Cell, Column, Report, Section, Table};

use super::arms::{ARMS, Arm, ENGINES, Engine, RANDOM};
use super::{Case, cases};
use crate::asked::Asked;
use crate::loops::shown::paired::Paired;
use crate::{Check, TaskResult, check};

const WORDS: &str = "An error is the geometric mean over the outputs of the root mean square error of free runs on records that neither \
    estimated nor chose, and over the seeds. Minutes of random levels are those that records of random levels, fitted by models of one \
    size, need for the same error, by straight lines between the logarithms of both. Beyond their last record its time is shown, and the \
    ratio is at least that; before their first one it is at most that. The judging records have random levels of the same ranges: that is \
    what chosen levels and I-optimal records are told to predict, too. Noise of the sensors is part of every error.";

/// Error of random levels over bed time, which falls.
pub(super) struct Curve {
    /// Logarithms of bed time in s and of the error, by rising time.
    points: Vec<(f64, f64)>,
}

impl Curve {
    fn of(all: &[&Case]) -> Self {
        let mut points: Vec<(f64, f64)> = RANDOM
            .iter()
            .filter_map(|name| Some((mean_bed_s(all, name)?.ln(), mean_error(all, name)?)))
            .collect();
        // More of the same is never worth less: what rises is scatter.
        for k in 1..points.len() {
            points[k].1 = points[k].1.min(points[k - 1].1);
        }
        Self { points }
    }

    /// Bed time in s at which it has the error of this logarithm; the last one where it never does.
    fn time_s(&self, error: f64) -> Option<f64> {
        let first = self.points.first()?;
        if error >= first.1 {
            return Some(first.0.exp());
        }
        for w in self.points.windows(2) {
            if error >= w[1].1 {
                // On a flat piece the earlier end has it, which the piece before has told.
                let share = if w[0].1 > w[1].1 { (w[0].1 - error) / (w[0].1 - w[1].1) } else { 0.0 };
                return Some((w[0].0 + share * (w[1].0 - w[0].0)).exp());
            }
        }
        self.points.last().map(|p| p.0.exp())
    }

    /// What its time leaves out, in words.
    fn beyond(&self, error: f64) -> &'static str {
        if self.points.last().is_some_and(|p| error < p.1) {
            "at least: no record of random levels was as good; "
        } else if self.points.first().is_some_and(|p| error > p.1) {
            "at most: one record of random levels was better; "
        } else {
            ""
        }
    }
}

/// Mean over the seeds of the logarithm of the error; none where a seed has none.
fn mean_error(all: &[&Case], arm: &str) -> Option<f64> {
    mean(all.iter().map(|c| c.arm(arm)?.log_error()).collect::<Option<Vec<f64>>>()?)
}

fn mean_bed_s(all: &[&Case], arm: &str) -> Option<f64> {
    mean(all.iter().map(|c| Some(c.arm(arm)?.bed_s)).collect::<Option<Vec<f64>>>()?)
}

fn mean(v: Vec<f64>) -> Option<f64> {
    (!v.is_empty()).then(|| v.iter().sum::<f64>() / v.len() as f64)
}

/// The rival of as many records.
fn rival(arm: &Arm) -> &'static str {
    match arm.name {
        name if name.ends_with("-2") => "random-2",
        name if name.ends_with("-4") => "random-4",
        _ => "random-3",
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
    let mut failed: Vec<String> = Vec::new();
    for c in &all {
        let name = format!("{}, seed {}", c.engine, c.seed);
        failed.extend(c.failed.iter().map(|(arm, why)| format!("{name}, {arm}: {why}")));
        // What is counted in has to be there.
        let diverged = c.arms.iter().filter(|a| RANDOM.contains(&a.arm.as_str()) && a.log_error().is_none());
        failed.extend(diverged.map(|a| format!("{name}, {}: a model diverged", a.arm)));
    }
    let count = (failed.len() + results.len() - all.len()) as f64;
    out.push(check(
        "failed",
        "arms that did not end",
        Asked::AtMost(0.0),
        Some(count),
        "-",
        failed.join("; "),
    ));
    out
}

fn checks(engine: &Engine, all: &[&Case]) -> Vec<Check> {
    let curve = Curve::of(all);
    let compared = |arm: &&Arm| !RANDOM.contains(&arm.name) && all.iter().any(|c| c.arm(arm.name).is_some());
    let row = |arm: &Arm| {
        let error = mean_error(all, arm.name);
        let minutes = error.and_then(|e| Some(curve.time_s(e)? / mean_bed_s(all, arm.name)?));
        let beyond = error.map_or("", |e| curve.beyond(e));
        let (engine_name, what) = (engine.name, engine.what);
        // What a calibration does where it is to decide for itself is asked to be worth its time.
        let asked = if arm.name == DECIDED { Asked::AtLeast(1.0) } else { Asked::Reported };
        check(
            format!("{engine_name}-{}", arm.name),
            format!(
                "{what}: {}: bed time that random levels need for the same error, over its own",
                arm.what
            ),
            asked,
            minutes,
            "-",
            format!("{beyond}{}{}", beside(all, arm), branches(all, arm)),
        )
    };
    let mut out: Vec<Check> = ARMS.iter().filter(compared).map(row).collect();
    if let Some(p) = paired(all, DECIDED, "design-d") {
        let (low, high) = (p.low.exp(), p.high.exp());
        out.push(check(
            format!("{}-auto-over-d", engine.name),
            format!(
                "{}: error of a record as the lack of fit asks over that of a D-optimal one, upper end of the 95 % interval",
                engine.what
            ),
            Asked::AtMost(1.0),
            Some(high),
            "-",
            format!("mean {:.3}, {low:.3} to {high:.3}", p.mean.exp()),
        ));
    }
    out
}

/// What a calibration does where it decides.
const DECIDED: &str = "design-auto";

/// Logarithms of the errors of two arms, seed by seed.
fn paired(all: &[&Case], a: &str, b: &str) -> Option<Paired> {
    let of = |name: &str| -> Option<Vec<f64>> { all.iter().map(|c| c.arm(name)?.log_error()).collect() };
    Paired::of(&of(a)?, &of(b)?)
}

/// How often the lack of fit asked for what.
fn branches(all: &[&Case], arm: &Arm) -> String {
    if arm.name != DECIDED {
        return String::new();
    }
    let levels = |c: &&&Case| {
        c.arm(arm.name).is_some_and(|a| a.choice.iter().any(|t| t.contains("levels of the record")))
    };
    format!("; it asked for chosen levels in {} of {}", all.iter().filter(levels).count(), all.len())
}

/// Error over that of as many records of random levels, seed by seed.
fn beside(all: &[&Case], arm: &Arm) -> String {
    let of = |name: &str| -> Option<Vec<f64>> { all.iter().map(|c| c.arm(name)?.log_error()).collect() };
    let (Some(own), Some(random)) = (of(arm.name), of(rival(arm))) else {
        return "there is no pair: a model diverged, or an arm did not end or was not run".into();
    };
    let each: Vec<String> = own.iter().zip(&random).map(|(a, b)| format!("{:.3}", (a - b).exp())).collect();
    let interval = paired(all, arm.name, rival(arm)).map_or(String::new(), |p| {
        format!("{:.3} ({:.3} to {:.3}, 95 %); ", p.mean.exp(), p.low.exp(), p.high.exp())
    });
    format!("error over that of as many random records: {interval}each: {}", each.join(", "))
}

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let all = cases(results);
    let mut section = Section::new("Errors").text(WORDS);
    for engine in &ENGINES {
        let of_it: Vec<&Case> = all.iter().filter(|c| c.engine == engine.name).collect();
        if !of_it.is_empty() {
            section = section.block(table(engine, &of_it));
        }
    }
    for case in &all {
        let choice = case.arm(DECIDED).map_or(&[][..], |a| &a.choice);
        if case.seed == all.iter().filter(|c| c.engine == case.engine).map(|c| c.seed).min().unwrap_or(0)
            && !choice.is_empty()
        {
            section = section.text(format!(
                "{}, seed {}, lack of fit: {}.",
                case.engine,
                case.seed,
                choice.join("; ")
            ));
        }
    }
    report.section(section)
}

fn table(engine: &Engine, all: &[&Case]) -> Table {
    let outputs: Vec<String> = all
        .iter()
        .find_map(|c| c.arms.first())
        .map_or(Vec::new(), |a| a.rmse.iter().map(|(o, _)| o.clone()).collect());
    let mut head = vec![Column::text("Records and models"), Column::number("Bed time", "s").digits(4)];
    head.extend(outputs.iter().map(|o| Column::number(format!("Error of {o}"), "").digits(3)));
    head.push(Column::number("Minutes of random levels", "min").digits(3));
    let curve = Curve::of(all);
    let mut table = Table::new(head).caption(format!("{}: {} seeds", engine.what, all.len()));
    for arm in ARMS.iter().filter(|a| all.iter().any(|c| c.arm(a.name).is_some())) {
        let output = |o: &String| {
            let logs: Option<Vec<f64>> = all
                .iter()
                .map(|c| c.arm(arm.name)?.rmse.iter().find(|r| r.0 == *o)?.1.map(f64::ln))
                .collect();
            Cell::from(logs.and_then(mean).map(f64::exp))
        };
        let minutes = mean_error(all, arm.name).and_then(|e| curve.time_s(e)).map(|s| s / 60.0);
        let mut row: Vec<Cell> = vec![arm.what.into(), mean_bed_s(all, arm.name).into()];
        row.extend(outputs.iter().map(output));
        row.push(minutes.into());
        table = table.row(row);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_worth_the_time_at_which_the_curve_has_it() {
        // Error falls with the root of time.
        let points = [60.0f64, 120.0, 240.0].map(|t| (t.ln(), -0.5 * t.ln())).to_vec();
        let curve = Curve { points };
        for t in [60.0f64, 90.0, 120.0, 200.0, 240.0] {
            let found = curve.time_s(-0.5 * t.ln()).unwrap();
            assert!((found / t - 1.0).abs() < 1e-9, "{t}: {found}");
        }
        assert_eq!(curve.time_s(1.0).map(f64::round), Some(60.0));
        assert!(curve.beyond(-0.5 * 300f64.ln()).starts_with("at least"));
        assert!(curve.beyond(-0.5 * 200f64.ln()).is_empty() && curve.beyond(1.0).starts_with("at most"));
        assert!((curve.time_s(-9.0).unwrap() - 240.0).abs() < 1e-9);
        assert_eq!(Curve { points: vec![] }.time_s(0.0), None);
        // A flat piece is worth its beginning.
        let flat = Curve { points: vec![(0.0, 1.0), (1.0, 0.5), (2.0, 0.5), (3.0, 0.2)] };
        assert!((flat.time_s(0.5).unwrap().ln() - 1.0).abs() < 1e-12);
        assert!(flat.time_s(0.499).unwrap().ln() > 2.0);
    }
}
