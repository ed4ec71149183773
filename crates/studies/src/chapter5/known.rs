//! Tables 5.1 and 5.2, and the known system with noise at its output or in its equation.

use crate::chapter4::work::statistics;
use crate::chapter5::work::known::{self, Noise};
use crate::chapter5::work::published::{self, SEARCHES};
use crate::chapter5::work::repeated::{Pair, Reached, mean, repeat};
use crate::chapter5::work::searches::{Compared, Method, compare};
use crate::chapter5::work::{Chapter5Error, Fitness};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::literature::torque_5_3;
use dynocal_ident::validate::Kind;
use dynocal_report::{Axis, Cell, Column, Panel, Report, Section, Table, TimePlot, XyPlot};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::super::asked::Asked;
use super::super::{Check, Options, Task, TaskResult};
use super::{check, percent, result, task, vector};

const SEARCH: &str = "known-system";
const OUTPUT: &str = "output-noise";
const EQUATION: &str = "equation-noise";
/// Unseen records of Table 5.2.
const UNSEEN: u64 = 10;
/// Stream of the first of them: far from those of the repeated records.
const UNSEEN_STREAM: u64 = 1000;
/// Part of Figures 5.3 and 5.5 that is drawn, in samples.
const DRAWN: usize = 400;

/// Result of the searches.
#[derive(Serialize, Deserialize)]
struct Searches {
    rows: Vec<Compared>,
    truth: Fitness,
    truth_unseen: Fitness,
    measured: Vec<f64>,
    sample_time_s: f64,
}

pub(super) fn tasks(o: &Options) -> Vec<Task> {
    let (seed, reduced) = (o.seed, o.reduced);
    // The pattern search takes most of the time and does not end by itself.
    let rows: Vec<(Method, usize)> =
        SEARCHES.iter().map(|s| (s.method, if reduced { s.budget.min(2400) } else { s.budget })).collect();
    let repeats = if reduced { 6 } else { 50 };
    let mut tasks = vec![task(SEARCH, json!({ "seed": seed, "methods": rows }), move |interrupt| {
        searches(&rows, seed, interrupt)
    })];
    for (name, noise) in [(OUTPUT, Noise::Output), (EQUATION, Noise::Equation)] {
        let inputs = json!({ "seed": seed, "repeats": repeats, "noise": noise });
        tasks.push(task(name, inputs, move |interrupt| repeat(noise, repeats, seed, interrupt)));
    }
    tasks
}

fn searches(
    rows: &[(Method, usize)],
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Searches, Chapter5Error> {
    let system = torque_5_3();
    let record = known::stored()?.experiment;
    let unseen = (0..UNSEEN)
        .map(|k| Ok(known::record(Noise::Output, seed, UNSEEN_STREAM + k)?.experiment))
        .collect::<Result<Vec<Experiment>, Chapter5Error>>()?;
    Ok(Searches {
        rows: compare(rows, &system.model, &record, &unseen, interrupt)?,
        truth: Fitness::of(&system.model, &system.theta, &record, Kind::FreeRun),
        truth_unseen: Fitness::mean_over(&system.model, &system.theta, &unseen, Kind::FreeRun),
        measured: record.y,
        sample_time_s: system.sample_time_s,
    })
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let found: Option<Searches> = result(results, SEARCH);
    let mut checks: Vec<Check> = SEARCHES.iter().map(|row| search_check(found.as_ref(), row)).collect();
    let of = |method| found.as_ref().and_then(|f| f.rows.iter().find(|r| r.found.method == method));
    let (ols, sem) = (of(Method::LeastSquares), of(Method::LevenbergMarquardt));
    checks.push(check(
        "sem-evaluations",
        "Evaluations of the cost that Levenberg-Marquardt takes from least squares",
        Asked::AtMost(10.0),
        sem.map(|r| r.found.evaluations as f64),
        "",
        "reference: 9",
    ));
    checks.push(check(
        "table-5-2",
        "Table 5.2: mean MSE on ten unseen records, SEM over PEM",
        Asked::Below(1.0),
        ols.zip(sem).map(|(o, s)| s.unseen.mse / o.unseen.mse),
        "",
        "thesis 0.53 / 1.14 = 0.46; reference 0.4978 / 0.5800 = 0.858 (the noise alone is 0.492)",
    ));
    checks.extend(repeated_checks(results));
    checks
}

fn search_check(found: Option<&Searches>, row: &published::Search) -> Check {
    let ours = found.and_then(|f| f.rows.iter().find(|r| r.found.method == row.method));
    let id = row.method.name().split([',', ' ', '(']).next().unwrap_or_default().to_lowercase();
    let what = format!("MSE of the free run on the stored record: {}", row.method.name());
    let asked = Asked::AtMost(row.asked * (1.0 + 1e-9));
    let note = ours.map_or(String::new(), |r| {
        format!(
            "{:.15} in {} evaluations; reference {:.15} in {}",
            r.free_run.mse, r.found.evaluations, row.reference_mse, row.reference_evaluations
        )
    });
    let made = check(format!("search-{id}"), what, asked, ours.map(|r| r.free_run.mse), "Nm^2", note);
    Check { asked: Some(format!("<= {} (1 + 1e-9)", row.asked)), ..made }
}

fn repeated_checks(results: &[TaskResult]) -> Vec<Check> {
    let (output, equation): (Option<Vec<Pair>>, Option<Vec<Pair>>) =
        (result(results, OUTPUT), result(results, EQUATION));
    let ratio = |pairs: &Option<Vec<Pair>>, over: fn(&Pair) -> f64, under: fn(&Pair) -> f64| {
        pairs.as_ref().map(|p| mean(p, over) / mean(p, under))
    };
    let n = output.as_ref().map_or(0, Vec::len);
    vec![
        check(
            "output-noise",
            "Output noise: mean MSE against the noise-free output, OLS over SEM",
            Asked::AtLeast(7.0),
            ratio(&output, |p| p.ols.to_noise_free, |p| p.sem.to_noise_free),
            "",
            format!("{n} records; reference 0.0541 / 0.0070 = 7.8 over 50"),
        ),
        check(
            "equation-noise-one-step",
            "Equation noise: mean one-step MSE on unseen records, SEM over OLS (SEM must lose)",
            Asked::Above(1.0),
            ratio(&equation, |p| p.sem.unseen_one_step, |p| p.ols.unseen_one_step),
            "",
            "",
        ),
        check(
            "equation-noise-free-run",
            "Equation noise: mean MSE of the free run against the noise-free output of unseen records, SEM over OLS",
            Asked::Above(1.0),
            ratio(&equation, |p| p.sem.unseen_to_noise_free, |p| p.ols.unseen_to_noise_free),
            "",
            "also in free run: least squares is efficient where the noise is in the equation",
        ),
        check(
            "equation-noise-named",
            "Equation noise: share of the simulation-error fits that say so from their residuals",
            Asked::AtLeast(0.95),
            equation.as_ref().map(|p| named(p)),
            "",
            "",
        ),
        check(
            "output-noise-false-alarm",
            "Output noise: share of the simulation-error fits that say the same wrongly",
            Asked::AtMost(0.05),
            output.as_ref().map(|p| named(p)),
            "",
            "",
        ),
    ]
}

/// Share of the simulation-error fits that take their noise for that of an equation.
fn named(pairs: &[Pair]) -> f64 {
    mean(pairs, |p| f64::from(p.sem.warnings.iter().any(|w| w.contains("equation noise"))))
}

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let found: Option<Searches> = result(results, SEARCH);
    let report = match &found {
        Some(f) => report.section(known_section(f)),
        None => report,
    };
    report.section(noise_section(result(results, OUTPUT), result(results, EQUATION)))
}

fn known_section(f: &Searches) -> Section {
    let mut section = Section::new("Known system: Tables 5.1 and 5.2").id("known").text(
        "Thesis: system (5.3) with (5.4), inputs within (5.5), noise variance 0.5; OLS gives (5.6), whose free run has MSE 0.97; three searches lower it (Table 5.1), ten other records validate (Table 5.2).",
    ).text(
        "Reading: u1 as a fraction (in percent the output would vary a hundred times more); noise at the output, as printed; inputs held 10, 10 and 100 samples, which the printed R2 and MSE imply; free run from the seven measured samples that the lags need, scores over samples 7 to 999. Identification record: the one stored with the tests, on which the reference was computed; validation: ten fresh records. All searches are those of the estimator `sem` and start from least squares. Evaluations are counted instead of time.",
    );
    section.push(search_table(f));
    section.push(validation_table(f));
    section.push(parameter_table(f));
    section.push(convergence(f));
    section.push(traces(f));
    section
}

fn search_table(f: &Searches) -> Table {
    let mut table = Table::new(vec![
        Column::text("Method"),
        Column::number("Thesis MSE", "Nm^2").digits(2),
        Column::number("Thesis time", "s").digits(2),
        Column::number("MSE", "Nm^2").digits(8),
        Column::number("R2", "%").digits(5),
        Column::number("Evaluations", ""),
        Column::text("Ended"),
        Column::number("Reference MSE", "Nm^2").digits(8),
        Column::number("Evaluations", ""),
    ])
    .caption("Table 5.1: simulation error by search method, free run");
    for row in SEARCHES {
        let Some(r) = f.rows.iter().find(|r| r.found.method == row.method) else { continue };
        let cells: Vec<Cell> = vec![
            row.method.name().into(),
            row.thesis_mse.into(),
            row.thesis_time_s.into(),
            r.free_run.mse.into(),
            percent(r.free_run.r2).into(),
            r.found.evaluations.into(),
            format!("{:?}", r.found.status).to_lowercase().into(),
            row.reference_mse.into(),
            row.reference_evaluations.into(),
        ];
        table = if row.method == Method::LevenbergMarquardt {
            table.stressed_row(cells)
        } else {
            table.row(cells)
        };
    }
    table
}

fn validation_table(f: &Searches) -> Table {
    let mut table = Table::new(vec![
        Column::text("Model"),
        Column::number("Thesis MSE", "Nm^2").digits(3),
        Column::number("Thesis R2", "%").digits(4),
        Column::number("MSE", "Nm^2").digits(5),
        Column::number("R2", "%").digits(4),
        Column::number("Reference MSE", "Nm^2").digits(5),
        Column::number("Reference R2", "%").digits(4),
    ])
    .caption("Table 5.2: means over ten unseen records, free run; and the one-step error on the identification record");
    let of = |m| f.rows.iter().find(|r| r.found.method == m);
    let rows: [(&str, Option<Fitness>, &published::Row); 4] = [
        ("M_PEM", of(Method::LeastSquares).map(|r| r.unseen), &published::TABLE_5_2_PEM),
        ("M_SEM", of(Method::LevenbergMarquardt).map(|r| r.unseen), &published::TABLE_5_2_SEM),
        ("true parameters", Some(f.truth_unseen), &published::TABLE_5_2_TRUE),
        ("PEM, one step, identification", of(Method::LeastSquares).map(|r| r.one_step), &published::ONE_STEP),
    ];
    for (name, ours, known) in rows {
        table = table.row(vec![
            name.into(),
            known.thesis.map(|t| t.0).into(),
            known.thesis.map(|t| t.1).into(),
            ours.map(|o| o.mse).into(),
            ours.map(|o| percent(o.r2)).into(),
            known.reference.map(|t| t.0).into(),
            Cell::from(known.reference.map(|t| t.1)),
        ]);
    }
    table
}

fn parameter_table(f: &Searches) -> Table {
    let mut table =
        Table::new(vec![Column::text("Parameters of (5.3)"), Column::text("theta_1 to theta_12")])
            .caption("Parameters: thesis (5.4), (5.6), (5.11) beside ours");
    table = table.row(vec!["true, eq. (5.4)".into(), vector(&torque_5_3().theta)]);
    for (name, theta, method) in [
        ("PEM", &published::THETA_5_6, Method::LeastSquares),
        ("SEM", &published::THETA_5_11, Method::LevenbergMarquardt),
    ] {
        table = table.row(vec![format!("thesis {name}").into(), vector(theta)]);
        if let Some(r) = f.rows.iter().find(|r| r.found.method == method) {
            table = table.row(vec![format!("ours {name}").into(), vector(&r.found.theta)]);
        }
    }
    table
}

/// Excess of the best cost over the optimum, against evaluations.
fn convergence(f: &Searches) -> XyPlot {
    let best = f.rows.iter().map(|r| r.free_run.mse).fold(f64::INFINITY, f64::min);
    let mut plot = XyPlot::new(
        "What the searches take (Figure 5.4)",
        Axis::new("log10 of evaluations", ""),
        Axis::new("log10 of MSE above the least one", "Nm^2"),
    )
    .caption("From least squares; below 1e-12 the rounding of the sums.");
    for r in &f.rows {
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for (evaluations, mse) in &r.found.history {
            x.push((*evaluations).max(1) as f64);
            y.push((mse - best).max(1e-12));
        }
        let log = |v: Vec<f64>| v.into_iter().map(f64::log10).collect::<Vec<f64>>();
        if x.len() > 1 {
            plot = plot.line(r.found.method.name(), log(x), log(y));
        }
    }
    plot
}

fn traces(f: &Searches) -> TimePlot {
    let n = DRAWN.min(f.measured.len());
    let mut panel = Panel::new("torque", "Nm").measured(f.measured[..n].to_vec());
    for (label, method) in
        [("PEM, free run", Method::LeastSquares), ("SEM, free run", Method::LevenbergMarquardt)]
    {
        if let Some(r) = f.rows.iter().find(|r| r.found.method == method) {
            panel = panel.line(label, r.trace[..n].to_vec());
        }
    }
    TimePlot::sampled("Measured and simulated output (Figures 5.3, 5.5)", f.sample_time_s, n)
        .panel(panel)
        .caption("The first 40 s of the identification record.")
}

/// Median.
fn median(pairs: &[Pair], f: impl Fn(&Pair) -> f64) -> f64 {
    statistics::median(&pairs.iter().map(f).collect::<Vec<_>>()).unwrap_or(f64::NAN)
}

fn noise_section(output: Option<Vec<Pair>>, equation: Option<Vec<Pair>>) -> Section {
    let n = output.as_ref().map_or(0, Vec::len);
    let mut section = Section::new("Where simulation error wins and where it loses").id("noise").text(format!(
        "{n} identification records of the known system with new inputs and noise each, ten unseen ones for all. With noise at the output, SEM is maximum likelihood; with noise in the equation, z(t) = f(z, u) + e(t), least squares is, and SEM must lose. One-step and free-run errors stand in rows of their own."
    ));
    if let Some(pairs) = &output {
        section = section.text(format!(
            "The thesis' free run of least squares has MSE 0.97; here it has {:.3} on average. With the parameters rounded as printed in (5.6) the median is {:.2}: 1 less the sum of the output parameters is 0.2, which magnifies rounding. That may explain the thesis' number; it does not prove it.",
            mean(pairs, |p| p.ols.free_run.mse),
            median(pairs, |p| p.ols_rounded)
        ));
    }
    section.push(noise_table(&[output.as_deref(), equation.as_deref()]));
    let warning = equation.iter().flatten().find_map(|p| p.sem.warnings.first());
    if let Some(text) = warning {
        section = section.text(format!("What the estimator says under equation noise: \"{text}\""));
    }
    section
}

type Number = (&'static str, fn(&Reached) -> f64);

fn noise_table(noises: &[Option<&[Pair]>; 2]) -> Table {
    let mut columns = vec![Column::text("Mean over the records")];
    for noise in ["Output noise", "Equation noise"] {
        for estimator in ["OLS", "SEM"] {
            columns.push(Column::number(format!("{noise}: {estimator}"), "").digits(4));
        }
    }
    let rows: [Number; 6] = [
        ("One-step MSE, identification, Nm^2", |r| r.one_step.mse),
        ("Free-run MSE, identification, Nm^2", |r| r.free_run.mse),
        ("Free-run MSE against the noise-free output, identification, Nm^2", |r| r.to_noise_free),
        ("One-step MSE, unseen, Nm^2", |r| r.unseen_one_step),
        ("Free-run MSE against the noise-free output, unseen, Nm^2", |r| r.unseen_to_noise_free),
        ("Fits that warn of their residuals, %", |r| if r.warnings.is_empty() { 0.0 } else { 100.0 }),
    ];
    let mut table = Table::new(columns).caption("Errors by noise and estimator");
    for (name, of) in rows {
        let mut cells: Vec<Cell> = vec![name.into()];
        for pairs in noises {
            cells.push(pairs.map(|p| mean(p, |p| of(&p.ols))).into());
            cells.push(pairs.map(|p| mean(p, |p| of(&p.sem))).into());
        }
        table = table.row(cells);
    }
    table
}
