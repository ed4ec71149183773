//! Study `chapter4`: what optimal test signals are worth on the known engine models of thesis chapter 4.
//!
//! One task per kind of signal: a population of signals, their criteria, the models they identify and the scores of
//! these on the same unseen signals; further tasks repeat designs, put limits on them and compare searches. Tables 4.2
//! to 4.18 and Figures 4.12 to 4.16, the thesis beside ours. Tasks share the signals of one library, which makes each
//! kind once and depends on nothing but the size and the seed.

mod fir;
mod limits;
mod mimo;
mod objectives;
mod parameters;
mod searches;
mod validation;
pub mod work;

use std::sync::Arc;

use crate::StudyError;
use crate::chapter4::work::library::Library;
use crate::chapter4::work::population::{Population, measure};
use crate::chapter4::work::source::{DesignCriterion, Source};
use crate::chapter4::work::{Chapter4Error, Size};
use dynocal_numerics::registry::MemberDoc;
use dynocal_report::{Cell, Report};
use serde::Serialize;
use serde_json::{Value, json};

use super::asked::Asked;
use super::{Check, Options, Study, Surroundings, Task, TaskResult, check, result};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "chapter4",
        what: "Optimal test signals on the engine models of thesis chapter 4: Tables 4.2 to 4.18, searches, statistical validation",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

/// Kinds of signals, one task each.
const SOURCES: [Source; 11] = [
    Source::Prbs,
    Source::Aprbs,
    Source::Udrn,
    Source::Design(DesignCriterion::D),
    Source::Design(DesignCriterion::A),
    Source::Design(DesignCriterion::Wa),
    Source::Design(DesignCriterion::I),
    Source::Design(DesignCriterion::G),
    Source::Design(DesignCriterion::Ai),
    Source::Composite(DesignCriterion::D),
    Source::Composite(DesignCriterion::Ai),
];
/// Torque noise variance of Tables 4.9 to 4.13, 4.17 and that of lambda in Table 4.18.
const TORQUE_NOISE: f64 = 80.0;
const LAMBDA_NOISE: f64 = 0.04;
/// Sampling time of both models.
const SAMPLE_S: f64 = 0.1;

/// Designed validation signals of each kind.
const DESIGNED: usize = 40;

/// What tasks compute from.
type Shared = Arc<Result<Library, Chapter4Error>>;

fn tasks(o: &Options) -> Vec<Task> {
    let n = if o.reduced { 3 } else { 100 };
    let size = Size { identification: n, validation: n, designed: n.min(DESIGNED), seed: o.seed };
    let shared: Shared = Arc::new(Library::new(size));
    let mut tasks: Vec<Task> = SOURCES
        .iter()
        .map(|&source| {
            let inputs = json!({ "source": source, "size": size });
            task(&shared, source.name(), inputs, move |l, interrupt| measure(l, source, interrupt))
        })
        .collect();
    tasks.extend(validation::tasks(&shared, size));
    tasks.extend(parameters::tasks(&shared, size, o.reduced));
    tasks.extend(limits::tasks(&shared, size));
    tasks.extend(searches::tasks(&shared, size, o.reduced));
    tasks.push(fir::task(size));
    tasks
}

/// A task whose result is that of a computation of the chapter.
fn task<T: Serialize>(
    shared: &Shared,
    name: impl Into<String>,
    inputs: Value,
    run: impl Fn(&Library, &(dyn Fn() -> bool + Sync)) -> Result<T, Chapter4Error> + 'static,
) -> Task {
    let (shared, name) = (shared.clone(), name.into());
    let of = name.clone();
    let failed = move |reason: String| StudyError::Task { what: format!("chapter 4, {of}"), reason };
    let work = move |around: &Surroundings| match shared.as_ref() {
        Err(e) => Err(failed(e.to_string())),
        Ok(library) => match run(library, around.watch.interrupt) {
            Ok(found) => serde_json::to_value(found).map_err(|e| failed(e.to_string())),
            Err(Chapter4Error::Interrupted) => Err(StudyError::Interrupted),
            Err(e) => Err(failed(e.to_string())),
        },
    };
    Task { name, inputs, run: Box::new(work) }
}

/// The populations that can be read; a missing one makes its checks fail.
fn populations(results: &[TaskResult]) -> Vec<Population> {
    SOURCES.iter().filter_map(|s| result(results, &s.name())).collect()
}

fn of(populations: &[Population], source: Source) -> Option<&Population> {
    populations.iter().find(|p| p.source == source)
}

/// A mean with its standard error in brackets.
fn with_error(pair: Option<(f64, f64)>, decimals: usize) -> Cell {
    pair.map_or(Cell::Empty, |(mean, se)| format!("{mean:.decimals$} ({se:.decimals$})").into())
}

/// Name of a kind of signal in a table.
fn label(source: Source) -> String {
    source.name().to_uppercase()
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let all = populations(results);
    let mut checks = objectives::checks(&all);
    checks.extend(validation::checks(&all));
    checks.extend(parameters::checks(&all, results));
    checks.extend(limits::checks(results));
    checks.extend(searches::checks(results));
    checks.extend(validation::case_checks(results));
    checks.extend(fir::checks(results));
    checks
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    let all = populations(results);
    let report = report
        .section(fir::section(results))
        .section(searches::section(results))
        .section(objectives::objectives(&all))
        .section(objectives::criteria(&all))
        .section(parameters::bounds(&all))
        .section(parameters::distribution(results))
        .section(parameters::iterations(results));
    let report = report
        .section(validation::correlations(results))
        .section(validation::r2(&all))
        .section(validation::cases(results))
        .section(limits::outputs(results))
        .section(limits::rates(results));
    report.section(mimo::weights(&all)).section(mimo::scores(&all))
}
