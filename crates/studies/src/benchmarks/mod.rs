//! Study `benchmarks`: published identification benchmarks by the specs of `examples/benchmarks`, in free run on the
//! official test records, published numbers beside ours.
//!
//! The data stay outside the program: they lie below the folder of `--data`, or of the environment variable that the
//! specs name.

mod cases;

use std::path::PathBuf;

use crate::StudyError;
use dynocal_ident::validate::{Kind, Seen};
use dynocal_jobs::identify::error::IdentifyError;
use dynocal_jobs::identify::job;
use dynocal_jobs::identify::result::Score;
use dynocal_jobs::identify::spec::{self, Job, Overrides};
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::watch::Watch;
use dynocal_report::{Cell, Column, Report, Section, Table};
use serde_json::{Value, json};

use crate::asked::Asked;
use crate::{Check, Options, Study, Surroundings, Task, TaskResult};
use cases::{Against, CASES, Case, LINEAR, Row};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "benchmarks",
        what: "Published identification benchmarks: official split, free run, published numbers beside ours (needs --data)",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

/// Most cost evaluations at reduced length.
const REDUCED_EVALUATIONS: i64 = 5;

fn tasks(o: &Options) -> Vec<Task> {
    let cases = CASES.iter().filter(|c| !o.reduced || c.small);
    let mut tasks = Vec::new();
    for case in cases {
        tasks.push(task(case, o, false));
        if case.rows.iter().any(|r| matches!(r.against, Against::Linear)) {
            tasks.push(task(case, o, true));
        }
    }
    tasks
}

/// The task of a case, or of the linear model that it is compared with.
fn task(case: &'static Case, o: &Options, linear: bool) -> Task {
    let (data, reduced, seed) = (o.data.clone(), o.reduced, o.seed);
    let name = if linear { format!("{}{LINEAR}", case.name) } else { case.name.to_string() };
    let folder = name.clone();
    Task {
        name,
        inputs: json!({ "spec": case.spec, "reduced": reduced, "linear": linear, "seed": seed }),
        run: Box::new(move |around: &Surroundings| {
            let out = around.runs.join(&folder);
            let job = job_of(case, data.clone(), out, reduced, linear)?;
            let note = |text: &str| around.watch.note(&format!("{folder}: {text}"));
            let found = job::run(&job, Watch { note: &note, ..around.watch }).map_err(|e| failed(case, e))?;
            let models: Vec<Value> = found
                .0
                .models
                .iter()
                .map(|m| json!({ "target": m.target, "parameters": m.parameters.len(), "status": m.status }))
                .collect();
            Ok(json!({ "scores": found.0.scores, "models": models, "valid": found.0.valid }))
        }),
    }
}

fn job_of(
    case: &Case,
    data: Option<PathBuf>,
    out: PathBuf,
    reduced: bool,
    linear: bool,
) -> Result<Job, StudyError> {
    let over = Overrides { reference: data, out: Some(out), ..Overrides::default() };
    let mut job = spec::parse(&format!("{}.toml", case.name), case.spec, &over)
        .map_err(|e| StudyError::Task { what: case.name.into(), reason: e.to_string() })?;
    // The study shows free runs; what else can be computed of a model takes its time.
    job.validate.stability_runs = 0;
    job.validate.folds = 0;
    for t in &mut job.targets {
        if linear {
            t.linear(case.linear.0, case.linear.1, case.linear.2);
        } else if reduced {
            t.estimator_keys.insert("max_evaluations".into(), toml::Value::Integer(REDUCED_EVALUATIONS));
        }
    }
    Ok(job)
}

fn failed(case: &Case, e: IdentifyError) -> StudyError {
    match e {
        IdentifyError::Interrupted => StudyError::Interrupted,
        other => StudyError::Task { what: case.name.into(), reason: other.to_string() },
    }
}

/// Free-run scores on unseen parts of the task `name`.
fn scores(results: &[TaskResult], name: &str) -> Vec<Score> {
    let value = results.iter().find(|r| r.name == name).map(|r| r.value["scores"].clone());
    let all: Vec<Score> = value.and_then(|v| serde_json::from_value(v).ok()).unwrap_or_default();
    all.into_iter().filter(|s| s.kind == Kind::FreeRun && s.data == Seen::Unseen).collect()
}

fn rmse(scores: &[Score], row: &Row) -> Option<f64> {
    let mine = |s: &&Score| s.part == row.part && s.output == row.output;
    Some(scores.iter().find(mine)?.rmse? * row.factor)
}

fn done(results: &[TaskResult], case: &Case) -> bool {
    results.iter().any(|r| r.name == case.name)
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    CASES
        .iter()
        .filter(|c| done(results, c))
        .flat_map(|c| c.rows.iter().map(|r| check(results, c, r)))
        .collect()
}

fn check(results: &[TaskResult], case: &Case, row: &Row) -> Check {
    let measured = rmse(&scores(results, case.name), row);
    let linear = rmse(&scores(results, &format!("{}{LINEAR}", case.name)), row);
    let (asked, note) = match row.against {
        Against::Published { value, by, best } => (
            Asked::AtMost(value),
            format!("published: {value} {} ({by}); best NARX of any kind {best}", row.unit),
        ),
        Against::Wanted { value, published } => {
            (Asked::AtMost(value), format!("published neural NARX: {published} {}", row.unit))
        }
        Against::Linear => {
            let beside = linear.map_or("none".into(), |l| format!("{l:.5} {}", row.unit));
            (linear.map_or(Asked::Reported, Asked::Below), format!("linear ARX in the same run: {beside}"))
        }
        Against::Nothing { published } => (Asked::Reported, published.into()),
    };
    Check {
        id: format!("{}-{}", case.name, if case.several_outputs { row.output } else { row.part }),
        what: format!("{}: free-run RMSE of {} on {}", case.title, row.output, row.part),
        asked: asked.text(),
        measured,
        unit: row.unit,
        holds: asked.holds(measured),
        note,
    }
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    let mut report = report;
    for case in CASES.iter().filter(|c| done(results, c)) {
        let mut section = Section::new(case.title).text(case.what);
        let found = scores(results, case.name);
        let linear = scores(results, &format!("{}{LINEAR}", case.name));
        let unit = case.rows.first().map_or("-", |r| r.unit);
        let mut table = Table::new(vec![
            Column::text("Test record"),
            Column::text("Output"),
            Column::number("Samples", "-"),
            Column::number("Free-run RMSE", unit).digits(4),
            Column::number("Linear ARX, same run", unit).digits(4),
            Column::text("Published"),
        ]);
        for row in case.rows {
            let samples = found.iter().find(|s| s.part == row.part && s.output == row.output);
            let published = match row.against {
                Against::Published { value, by, best } => format!("{value} ({by}), best NARX {best}"),
                Against::Wanted { published, .. } => format!("{published} (neural NARX)"),
                Against::Nothing { published } => published.into(),
                Against::Linear => "none".into(),
            };
            table = table.row([
                row.part.into(),
                row.output.into(),
                Cell::from(samples.map(|s| s.samples)),
                rmse(&found, row).into(),
                rmse(&linear, row).into(),
                published.into(),
            ]);
        }
        section.push(table);
        report = report.section(section.code("Spec", case.spec));
    }
    report
}
