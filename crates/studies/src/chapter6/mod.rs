//! Study `chapter6`: steady calibration on the engine as published, and quicker ways to the same map.
//!
//! The engine of the thesis with the loops of eq. (6.1): spark sweeps over the grids of 6.6.2, validation over random points as in
//! 6.7, Table 6.1 and the economies of eq. (6.4). Eq. (6.2) prints the sparks as 5, 6, .., 29, 40; read as 5 to 40 in steps of 1,
//! which gives the 36 settings of 10 s at 121 points that make 43 560 s. The quicker ways are judged by the maps that they give:
//! injected fuel against that of the published way, and torque when the actuators alone drive the engine.

mod bed;
mod smooth;
mod validate;
mod ways;

use dynocal_numerics::registry::MemberDoc;
use dynocal_report::{Column, Report, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::asked::Asked;
use crate::{Check, Options, Study, StudyError, Surroundings, Task, TaskResult, check, result};
use bed::Bed;
use validate::Validated;
use ways::{Made, Way};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "chapter6",
        what: "Steady calibration on the engine as published (Table 6.1, economies) and quicker ways to the same map",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

/// Reduced region of 6.6.2, Nm and rpm.
const SMALL: [&[f64]; 2] = [&[30.0, 40.0, 50.0, 60.0, 70.0], &[1600.0, 1800.0, 2000.0, 2200.0, 2400.0]];
/// Region of eq. (6.2).
const WHOLE: [&[f64]; 2] = [
    &[0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0],
    &[1000.0, 1200.0, 1400.0, 1600.0, 1800.0, 2000.0, 2200.0, 2400.0, 2600.0, 2800.0, 3000.0],
];
/// For a look at reduced length.
const TINY: [&[f64]; 2] = [&[40.0, 70.0], &[1800.0, 2000.0]];
/// Holds of the validation, and seeds.
const HOLDS: usize = 30;
const SEEDS: u64 = 3;
/// Seconds that the actuators alone drive the engine before their torque is taken.
const ALONE_S: f64 = 6.0;

/// Ways beside the published one.
const OTHERS: [(Way, &str, &str); 4] = [
    (Way::Settled, "settled", "the same sparks, each until its means rest"),
    (Way::Bracketed, "bracketed", "from the neighbour's best by parabolas"),
    (Way::Scattered, "scattered", "the same in an arbitrary order of points"),
    (Way::Ramped, "ramped", "a slow ramp up and down"),
];

/// A map, what the engine gives for its actuators alone, and its validations.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Mapped {
    made: Made,
    /// Torque in Nm and lambda of every cell with its actuators alone.
    alone: Vec<[f64; 2]>,
    validated: Vec<Validated>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let (small, holds, seeds) = if o.reduced { (TINY, 4, 1) } else { (SMALL, HOLDS, SEEDS) };
    let mut wanted = vec![("published".to_string(), Way::Published, small, true)];
    wanted.extend(OTHERS.map(|(way, name, _)| (name.to_string(), way, small, false)));
    if !o.reduced {
        wanted.push(("published-whole".into(), Way::Published, WHOLE, true));
        wanted.push(("bracketed-whole".into(), Way::Bracketed, WHOLE, true));
    }
    let seed = o.seed;
    let task = |(name, way, grid, validated): (String, Way, [&'static [f64]; 2], bool)| Task {
        inputs: json!([way, grid, if validated { json!([holds, seeds, seed]) } else { json!(null) }]),
        run: Box::new({
            let name = name.clone();
            move |around: &Surroundings| {
                let refused = |reason: String| StudyError::Task { what: name.clone(), reason };
                let made = ways::make(way, grid[0], grid[1], around.watch).map_err(refused)?;
                let made = made.ok_or(StudyError::Interrupted)?;
                let alone = alone(&made).map_err(refused)?;
                let validations = if validated { seeds } else { 0 };
                let validated = (0..validations).map(|k| validate::validate(&made, holds, seed + k));
                let validated = validated.collect::<Result<Vec<_>, _>>().map_err(refused)?;
                serde_json::to_value(Mapped { made, alone, validated }).map_err(|e| refused(e.to_string()))
            }
        }),
        name,
    };
    wanted.into_iter().map(task).collect()
}

fn alone(made: &Made) -> Result<Vec<[f64; 2]>, String> {
    let mut bed = Bed::new()?;
    made.cells.iter().map(|c| bed.alone(c.at, c.u, ALONE_S)).collect()
}

impl Mapped {
    /// Cells on their demands.
    fn reached(&self) -> usize {
        self.made.cells.iter().filter(|c| c.reached).count()
    }

    /// Worst torque of the actuators alone against the demand in Nm, over the cells on their demands.
    fn torque_error_nm(&self) -> f64 {
        let cells = self.made.cells.iter().zip(&self.alone).filter(|(c, _)| c.reached);
        cells.map(|(c, a)| (a[0] - c.at.torque_nm).abs()).fold(0.0, f64::max)
    }

    /// Worst injected fuel above that of `other` in percent, over cells that both reached.
    fn fuel_above_percent(&self, other: &Mapped) -> Option<f64> {
        let both = self.made.cells.iter().zip(&other.made.cells).filter(|(a, b)| a.reached && b.reached);
        both.map(|(a, b)| 100.0 * (a.u.inj_mg / b.u.inj_mg - 1.0)).reduce(f64::max)
    }

    /// Greatest of all validations.
    fn worst(&self, f: &dyn Fn(&Validated) -> f64) -> Option<f64> {
        self.validated.iter().map(f).reduce(f64::max)
    }

    fn mean(&self, f: &dyn Fn(&Validated) -> f64) -> Option<f64> {
        let n = self.validated.len() as f64;
        (n > 0.0).then(|| self.validated.iter().map(f).sum::<f64>() / n)
    }
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let published: Option<Mapped> = result(results, "published");
    let mut checks = as_published("5 x 5", "", published.as_ref());
    checks.extend(figure_6_4(published.as_ref()));
    for (_, name, how) in OTHERS {
        let other: Option<Mapped> = result(results, name);
        checks.extend(quicker(name, how, other.as_ref(), published.as_ref()));
    }
    // Length: the whole region is not part of a reduced run.
    if results.iter().any(|r| r.name == "published-whole") {
        let whole: Option<Mapped> = result(results, "published-whole");
        checks.extend(as_published("11 x 11", "whole-", whole.as_ref()));
        checks.push(check(
            "whole-bed",
            "bed time of the published way over 11 x 11 points (thesis 43 560 s), relative difference",
            Asked::AtMost(0.002),
            whole.as_ref().map(|w| (w.made.bed_s / 43_560.0 - 1.0).abs()),
            "-",
            whole.as_ref().map_or(String::new(), |w| format!("{:.0} s", w.made.bed_s)),
        ));
        let other: Option<Mapped> = result(results, "bracketed-whole");
        checks.extend(quicker("bracketed-whole", "bracketed over 11 x 11", other.as_ref(), whole.as_ref()));
    }
    checks
}

/// Table 6.1 and the economies, thesis beside ours.
fn as_published(grid: &str, prefix: &str, found: Option<&Mapped>) -> Vec<Check> {
    let worst = |f: &dyn Fn(&Validated) -> f64| found.and_then(|m| m.worst(f));
    let mean = |f: &dyn Fn(&Validated) -> f64| found.and_then(|m| m.mean(f));
    let row = |id: &str, what: &str, asked: Asked, measured: Option<f64>, unit: &'static str, note: &str| {
        check(format!("{prefix}{id}"), format!("{grid}: {what}"), asked, measured, unit, note)
    };
    let cells = found.map_or(0, |m| m.made.cells.len());
    let reported = Asked::Reported;
    vec![
        row(
            "unreached",
            "points of the grid that were not on torque and lambda",
            reported,
            found.map(|m| (cells - m.reached()) as f64),
            "-",
            "the settings that are left stand in the map as they are",
        ),
        row(
            "torque-settling",
            "torque, settling to 1 Nm",
            reported,
            worst(&|v| v.torque.settling_s),
            "s",
            "Table 6.1: 1.5 s",
        ),
        row(
            "torque-overshoot",
            "torque beyond its final value",
            reported,
            worst(&|v| v.torque.overshoot),
            "Nm",
            "Table 6.1: 0",
        ),
        row(
            "torque-offset",
            "torque, final less demanded",
            Asked::AtMost(1.0),
            worst(&|v| v.torque.offset),
            "Nm",
            "Table 6.1: 1 Nm",
        ),
        row(
            "lambda-settling",
            "lambda, settling to 0.01",
            reported,
            worst(&|v| v.lambda.settling_s),
            "s",
            "Table 6.1: 2 s",
        ),
        row(
            "lambda-spike",
            "lambda, distance from 1",
            reported,
            worst(&|v| v.lambda.overshoot),
            "-",
            "Table 6.1: 0.36",
        ),
        row(
            "lambda-offset",
            "lambda, final less 1",
            Asked::AtMost(0.01),
            worst(&|v| v.lambda.offset),
            "-",
            "Table 6.1: 0.01",
        ),
        row(
            "economy",
            "economy (6.4), sparks of the map",
            reported,
            mean(&|v| v.economy),
            "Nm/mg",
            "thesis: 4.13",
        ),
        row(
            "economy-random",
            "economy (6.4), random sparks",
            reported,
            mean(&|v| v.economy_random),
            "Nm/mg",
            "thesis: 3.97",
        ),
        row(
            "economy-ratio",
            "economy of the map over that of random sparks",
            Asked::Above(1.0),
            mean(&|v| v.economy / v.economy_random),
            "-",
            "thesis: 1.04",
        ),
        row(
            "random-better",
            "holds in which a random spark gave more torque at equal fuel and throttle (Figure 6.8)",
            Asked::AtMost(0.0),
            worst(&|v| v.random_better as f64),
            "-",
            "thesis: none",
        ),
        row(
            "random-lambda",
            "lambda with random sparks less that with those of the map",
            Asked::AtMost(0.01),
            worst(&|v| v.lambda_apart),
            "-",
            "thesis: almost identical",
        ),
    ]
}

/// The sweep at 70 Nm and 2000 rpm.
fn figure_6_4(found: Option<&Mapped>) -> [Check; 2] {
    let cell =
        found.and_then(|m| m.made.cells.iter().find(|c| c.at.torque_nm == 70.0 && c.at.speed_rpm == 2000.0));
    [
        check(
            "best-spark",
            "best spark at 70 Nm and 2000 rpm",
            Asked::Reported,
            cell.map(|c| c.u.spark_deg),
            "deg",
            "Figure 6.4: 19 deg",
        ),
        check(
            "three-degrees",
            "fuel that 3 deg beside the best spark cost there",
            Asked::Reported,
            cell.and_then(|c| c.rise_percent),
            "%",
            "6.6.1: 1 %",
        ),
    ]
}

/// A quicker way against the published one: the same map for a tenth of the bed time.
fn quicker(name: &str, how: &str, other: Option<&Mapped>, published: Option<&Mapped>) -> [Check; 4] {
    let both = other.zip(published);
    let id = |what: &str| format!("{name}-{what}");
    [
        check(
            id("bed"),
            format!("{how}: share of the published way's bed time"),
            Asked::AtMost(0.1),
            both.map(|(o, p)| o.made.bed_s / p.made.bed_s),
            "-",
            other.map_or(String::new(), |o| {
                let side = o.made.longest_row_s;
                format!("{:.0} s; {side:.0} s with a copy of the bed for every torque", o.made.bed_s)
            }),
        ),
        check(
            id("fuel"),
            format!("{how}: injected fuel above the published way's, worst cell"),
            Asked::AtMost(0.3),
            both.and_then(|(o, p)| o.fuel_above_percent(p)),
            "%",
            "",
        ),
        check(
            id("torque"),
            format!("{how}: torque of the actuators alone against the demand, worst cell"),
            Asked::AtMost(0.3),
            other.map(Mapped::torque_error_nm),
            "Nm",
            published.map_or(String::new(), |p| format!("the published way: {:.3} Nm", p.torque_error_nm())),
        ),
        check(
            id("unreached"),
            format!("{how}: points that the published way reached and this one did not"),
            Asked::AtMost(0.0),
            both.map(|(o, p)| {
                let pairs = o.made.cells.iter().zip(&p.made.cells);
                pairs.filter(|(o, p)| p.reached && !o.reached).count() as f64
            }),
            "-",
            "",
        ),
    ]
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    results.iter().fold(report, |report, r| {
        let Some(found) = result::<Mapped>(results, &r.name) else { return report };
        let words = format!(
            "{} of {} points on their demands, {:.0} s of bed time.",
            found.reached(),
            found.made.cells.len(),
            found.made.bed_s
        );
        let head = vec![
            Column::number("Torque", "Nm").digits(3),
            Column::number("Speed", "rpm").digits(4),
            Column::number("Injected", "mg").digits(4),
            Column::number("Spark", "deg").digits(3),
            Column::number("Throttle", "deg").digits(4),
            Column::number("Settings held", "").digits(2),
            Column::number("Torque, actuators alone", "Nm").digits(4),
            Column::number("Lambda, actuators alone", "").digits(4),
        ];
        let table = found.made.cells.iter().zip(&found.alone).fold(Table::new(head), |t, (c, alone)| {
            t.row(vec![
                c.at.torque_nm.into(),
                c.at.speed_rpm.into(),
                c.u.inj_mg.into(),
                c.u.spark_deg.into(),
                c.u.throttle_deg.into(),
                (c.settings as f64).into(),
                alone[0].into(),
                alone[1].into(),
            ])
        });
        report.section(Section::new(r.name.as_str()).text(words).block(table))
    })
}
