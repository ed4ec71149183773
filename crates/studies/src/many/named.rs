//! A study of the table as tasks of many workers.

use dynocal_files::run_folder::digest_of;
use serde_json::{Value, json};

use super::{Batch, Line, Written};
use crate::{Options, Study, StudyError, Surroundings, Task, TaskResult, all_hold, conclude};

/// The tasks of `study`.
///
/// # Errors
/// [`StudyError`].
pub fn batch<'a>(study: &'a Study, options: &'a Options) -> Result<Batch<'a>, StudyError> {
    let tasks = (study.tasks)(options);
    let inputs: Vec<(&str, &Value)> = tasks.iter().map(|t| (t.name.as_str(), &t.inputs)).collect();
    let digest = digest_of(&(env!("CARGO_PKG_VERSION"), study.doc.name, options, inputs))?;
    let names: Vec<String> = tasks.iter().map(|t| t.name.clone()).collect();
    Ok(Batch {
        name: study.doc.name.into(),
        spec: json!((study.doc.name, options)),
        digest,
        count: tasks.len(),
        about: Box::new(move |k| Line::from_iter([("name".to_string(), Value::from(names[k].as_str()))])),
        work: Box::new(move |k, place, watch| {
            let around = Surroundings { runs: place.out.join("runs"), watch };
            let value = (tasks[k].run)(&around).map_err(|e| named(&tasks[k], e))?;
            Ok(Line::from_iter([("result".to_string(), value)]))
        }),
        end: Box::new(|lines, folder| {
            let mut results = Vec::new();
            lines.each(&mut |line| {
                let name = line.get("name").and_then(Value::as_str).unwrap_or_default().to_string();
                results.push(TaskResult { name, value: line.get("result").cloned().unwrap_or_default() });
                Ok(())
            })?;
            let done = conclude(study, options, &results, folder)?;
            let failed = done.checks.iter().filter(|c| c.holds == Some(false)).count();
            let verdict = match failed {
                0 => "all checks hold".to_string(),
                n => format!("{n} of {} checks do not hold", done.checks.len()),
            };
            Ok(Written { valid: all_hold(&done.checks), verdict: vec![verdict], checks: done.checks })
        }),
    })
}

/// An error says which task it is of.
fn named(task: &Task, e: StudyError) -> StudyError {
    match e {
        StudyError::Interrupted => e,
        e => StudyError::Task { what: format!("task `{}`", task.name), reason: e.to_string() },
    }
}
