//! The tables of members, signals by name, and specs as text.

use dynocal_ident::signal as signals;
use dynocal_jobs::families::FAMILIES;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use dynocal_studies::STUDIES;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

use crate::errors::{Kind, Refusal, run};
use crate::values::table;
use crate::watched::watched;

/// Longest signal, in samples.
const MOST_SAMPLES: usize = 100_000_000;

#[pyfunction]
pub(crate) fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// All families with their members and keys, as JSON.
#[pyfunction]
pub(crate) fn members() -> PyResult<String> {
    let one = |what: &str, docs: Vec<dynocal_numerics::registry::MemberDoc>| serde_json::json!({ "what": what, "members": docs });
    let mut all: serde_json::Map<String, serde_json::Value> =
        FAMILIES.iter().map(|f| (f.name.to_string(), one(f.what, (f.docs)()))).collect();
    all.insert("studies".into(), one("Studies", STUDIES.iter().map(|s| s.doc).collect()));
    Ok(serde_json::to_string(&all).map_err(run)?)
}

/// Samples of the signal `name`.
#[pyfunction]
pub(crate) fn signal<'py>(
    py: Python<'py>,
    name: &str,
    keys: &Bound<'py, PyAny>,
    samples: usize,
    sample_time_s: f64,
    seed: u64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let keys = table(keys, name)?;
    if !(2..=MOST_SAMPLES).contains(&samples) {
        let text = format!("found {samples} samples, expected 2 to {MOST_SAMPLES}");
        return Err(Refusal::new(Kind::Argument, text).into());
    }
    let signal = signals::signal(name, &keys).map_err(Refusal::from)?;
    let fill = move |_: Watch| {
        let mut u = vec![0.0; samples];
        signal.fill(&mut u, sample_time_s, &mut Rng64::new(seed)).map(|()| u)
    };
    Ok(watched(py, None, fill)?.map_err(Refusal::from)?.into_pyarray(py))
}

/// A mapping as the text of a spec.
#[pyfunction]
pub(crate) fn to_toml(value: &Bound<'_, PyAny>) -> PyResult<String> {
    Ok(toml::to_string(&table(value, "")?).map_err(|e| Refusal::of(Kind::Spec, &e))?)
}
