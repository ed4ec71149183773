//! Estimation and scoring of records in memory.

use std::sync::Arc;

use dynocal_ident::stored::StoredModel;
use dynocal_jobs::identify::finding::Finding;
use dynocal_jobs::identify::memory;
use pyo3::prelude::*;

use crate::errors::Refusal;
use crate::model::Model;
use crate::record::{Record, owned};
use crate::values::table;
use crate::watched::watched;

/// Grade, what it concerns, and the sentence.
type Said = (String, String, String);

fn said(findings: Vec<Finding>) -> Vec<Said> {
    findings.into_iter().map(|f| (f.grade.word().to_string(), f.about, f.text)).collect()
}

/// A model, how its search ended, evaluations, samples, rank, findings.
type Learnt = (Model, Option<String>, usize, usize, Option<usize>, Vec<Said>);

/// Estimates the targets that `tables` (as `model`, `prepare`, `derive`, `validate` of a spec) describe, from records.
#[pyfunction]
pub(crate) fn learn(
    py: Python<'_>,
    name: String,
    tables: &Bound<'_, PyAny>,
    records: Vec<PyRef<'_, Record>>,
    selecting: Vec<PyRef<'_, Record>>,
    steady: bool,
    seed: Option<u64>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Learnt>> {
    let tables = table(tables, "")?;
    let Some(first) = records.first() else { return Ok(Vec::new()) };
    let job = memory::job(&name, &tables, &first.data, steady, seed).map_err(Refusal::from)?;
    let (records, selecting) = (owned(&records), owned(&selecting));
    let found = watched(py, progress, move |watch| memory::learn(&job, records, selecting, watch))?;
    let one = |l: memory::Learnt| {
        let status =
            l.status.and_then(|s| serde_json::to_value(s).ok()).and_then(|v| Some(v.as_str()?.to_string()));
        (l.model.into(), status, l.evaluations, l.samples, l.rank, said(l.findings))
    };
    Ok(found.map_err(Refusal::from)?.into_iter().map(one).collect())
}

/// Scores of models, which run as one set, on records: JSON, and findings.
#[pyfunction]
pub(crate) fn judge(
    py: Python<'_>,
    models: Vec<PyRef<'_, Model>>,
    records: Vec<PyRef<'_, Record>>,
    k_steps: Vec<usize>,
) -> PyResult<(String, Vec<Said>)> {
    let models: Vec<StoredModel> =
        models.iter().map(|m| StoredModel::clone(&Arc::clone(&m.stored))).collect();
    let records = owned(&records);
    let found =
        watched(py, None, move |_| memory::judge(models, records, k_steps))?.map_err(Refusal::from)?;
    let text = serde_json::to_string(&found.scores).map_err(crate::errors::run)?;
    Ok((text, said(found.findings)))
}
