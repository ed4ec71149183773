//! Stored models.

use std::path::PathBuf;
use std::sync::Arc;

use dynocal_files::json;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::initial::Initial;
use dynocal_ident::stored::{Computed, MODEL_SCHEMA, MODEL_VERSION, Quantity, StoredModel};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::errors::{Kind, Refusal};
use crate::record::Record;
use crate::watched::{short, watched};

/// From so many values of the inputs on a call may take longer than somebody waits for Ctrl-C.
const LONG: usize = 200_000;

/// A model of one output with all that is needed to run it.
#[pyclass(frozen, module = "dynocal._dynocal")]
pub(crate) struct Model {
    pub(crate) stored: Arc<StoredModel>,
}

impl From<StoredModel> for Model {
    fn from(stored: StoredModel) -> Self {
        Self { stored: Arc::new(stored) }
    }
}

/// Name, samples, first computed sample and remarks of what a model computed.
type Answer<'py> = (String, Bound<'py, PyArray1<f64>>, usize, Vec<String>);

fn initial(name: Option<&str>) -> Result<Option<Initial>, Refusal> {
    let known = [Initial::Rest, Initial::Measured, Initial::Estimated];
    match name {
        None => Ok(None),
        Some(n) => known.into_iter().find(|i| i.key() == n).map(Some).ok_or_else(|| {
            let text = format!("initial: found `{n}`, expected rest, measured or estimated");
            Refusal::new(Kind::Argument, text)
        }),
    }
}

/// Checks a model that comes from a text or a file.
fn checked(model: StoredModel) -> Result<Model, Refusal> {
    model.check()?;
    Ok(model.into())
}

impl Model {
    /// A record of arrays: inputs as columns in the order of the model.
    fn record(&self, u: &PyReadonlyArray2<'_, f64>, y: Option<Vec<f64>>) -> Result<Dataset, Refusal> {
        let inputs = self.stored.measured_inputs();
        let u = u.as_array();
        if u.ncols() != inputs.len() {
            let names: Vec<&str> = inputs.iter().map(|q| q.name.as_str()).collect();
            let text =
                format!("u: found {} columns, expected {}: {}", u.ncols(), inputs.len(), names.join(", "));
            return Err(Refusal::new(Kind::Argument, text));
        }
        let columns = inputs.into_iter().zip(u.columns());
        let mut channels: Vec<Channel> = columns
            .map(|(q, c)| Channel {
                name: q.name,
                unit: q.unit,
                role: Role::Input,
                values: c.iter().copied().collect(),
            })
            .collect();
        if let Some(values) = y {
            let Quantity { name, unit } = self.stored.user_output();
            channels.push(Channel { name, unit, role: Role::Output, values });
        }
        let (name, origin) = ("arrays".into(), "arrays".into());
        let data =
            Dataset { name, sample_time_s: self.stored.sample_time_s, channels, init_samples: 0, origin };
        data.check()?;
        Ok(data)
    }

    fn compute(
        &self,
        py: Python<'_>,
        record: Arc<Dataset>,
        work: impl Fn(&StoredModel, &Dataset) -> Result<Vec<Computed>, Refusal> + Send + 'static,
    ) -> PyResult<Vec<Computed>> {
        let model = self.stored.clone();
        let values = record.len() * record.channels.len();
        let work = move || work(&model, &record);
        let found = if values < LONG { short(py, work)? } else { watched(py, None, move |_| work())? };
        Ok(found?)
    }
}

fn answers<'py>(py: Python<'py>, found: Vec<Computed>) -> Vec<Answer<'py>> {
    found.into_iter().map(|c| (c.record, c.y.into_pyarray(py), c.first, c.remarks)).collect()
}

/// The only record of arrays.
fn only<'py>(py: Python<'py>, mut found: Vec<Computed>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    if found.len() != 1 {
        let text =
            "the preparation that is stored with the model cuts the record into several: give a Dataset";
        return Err(Refusal::new(Kind::Model, text).into());
    }
    Ok(found.remove(0).y.into_pyarray(py))
}

#[pymethods]
impl Model {
    /// From the text of a model file.
    #[staticmethod]
    fn from_json(text: &str) -> PyResult<Self> {
        let value: serde_json::Value = serde_json::from_str(text)
            .map_err(|e| Refusal::of(Kind::Model, &e).about("the text of a model"))?;
        let (schema, version) = (value["schema"].as_str(), value["schema_version"].as_u64());
        if schema != Some(MODEL_SCHEMA)
            || !version.is_some_and(|v| (1..=u64::from(MODEL_VERSION)).contains(&v))
        {
            let text = format!(
                "the text of a model: found schema {} version {}, expected `{MODEL_SCHEMA}` version 1 to {MODEL_VERSION}",
                value["schema"], value["schema_version"]
            );
            return Err(Refusal::new(Kind::Model, text).into());
        }
        let model: StoredModel = serde_json::from_value(value)
            .map_err(|e| Refusal::of(Kind::Model, &e).about("the text of a model"))?;
        Ok(checked(model)?)
    }

    /// From a file that `identify` or [`Model::save`] wrote.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let read = move || json::read_versioned::<StoredModel>(&path, MODEL_SCHEMA, MODEL_VERSION);
        Ok(checked(short(py, read)?.map_err(Refusal::from)?)?)
    }

    /// Writes the file that `identify` would.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let model = self.stored.clone();
        let write = move || json::write_versioned(&path, MODEL_SCHEMA, MODEL_VERSION, &*model);
        Ok(short(py, write)?.map_err(Refusal::from)?)
    }

    /// The text of the file.
    fn to_json(&self) -> PyResult<String> {
        let mut value = serde_json::json!({ "schema": MODEL_SCHEMA, "schema_version": MODEL_VERSION });
        let body = serde_json::to_value(&*self.stored).map_err(|e| Refusal::of(Kind::Model, &e))?;
        if let (Some(all), serde_json::Value::Object(body)) = (value.as_object_mut(), body) {
            all.extend(body);
        }
        Ok(json::to_text(&value).map_err(Refusal::from)?)
    }

    /// Channels that drive it, as they are measured: name and unit.
    fn inputs(&self) -> Vec<(String, String)> {
        self.stored.measured_inputs().into_iter().map(|q| (q.name, q.unit)).collect()
    }

    /// Channel that it computes: name and unit.
    fn output(&self) -> (String, String) {
        let q = self.stored.user_output();
        (q.name, q.unit)
    }

    /// Name, value and standard error of each parameter.
    fn parameters(&self) -> Vec<(String, f64, Option<f64>)> {
        self.stored.parameters.iter().map(|p| (p.name.clone(), p.value, p.std_error)).collect()
    }

    /// Name of its kind.
    #[getter]
    fn kind(&self) -> &'static str {
        self.stored.structure.form().row().name
    }

    #[getter]
    fn estimator(&self) -> &str {
        &self.stored.estimator
    }

    #[getter]
    fn sample_time_s(&self) -> f64 {
        self.stored.sample_time_s
    }

    #[getter]
    fn is_steady(&self) -> bool {
        self.stored.is_steady()
    }

    #[getter]
    fn noise_variance(&self) -> Option<f64> {
        self.stored.noise_variance
    }

    /// Samples that a run needs before the first one that it computes.
    #[getter]
    fn memory(&self) -> usize {
        self.stored.structure.form().memory()
    }

    /// Free run over a record.
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        record: &Record,
        start: Option<&str>,
    ) -> PyResult<Vec<Answer<'py>>> {
        let start = initial(start)?;
        let found = self.compute(py, record.data.clone(), move |m, d| Ok(m.simulate(d, start)?))?;
        Ok(answers(py, found))
    }

    /// `steps` ahead over a record with measured outputs.
    fn predict<'py>(&self, py: Python<'py>, record: &Record, steps: usize) -> PyResult<Vec<Answer<'py>>> {
        let found = self.compute(py, record.data.clone(), move |m, d| Ok(m.predict(d, steps)?))?;
        Ok(answers(py, found))
    }

    /// Free run over inputs (samples, channels) from rest, or from the outputs `y0` of the first samples.
    fn simulate_arrays<'py>(
        &self,
        py: Python<'py>,
        u: PyReadonlyArray2<'py, f64>,
        y0: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let n = u.as_array().nrows();
        let start = if y0.is_some() { Initial::Measured } else { Initial::Rest };
        let y = y0.map(|y0| {
            let given = y0.as_array();
            let last = given.iter().next_back().copied().unwrap_or(0.0);
            // Only the first samples are read; the rest has to be a number.
            let rest = std::iter::repeat_n(last, n.saturating_sub(given.len()));
            (given.len(), given.iter().copied().chain(rest).take(n).collect::<Vec<f64>>())
        });
        let (init_samples, y) = y.map_or((0, None), |(k, y)| (k, Some(y)));
        let needed = self.memory();
        if y.is_some() && init_samples < needed {
            let text = format!(
                "y0: found {init_samples} samples, expected at least {needed}: so many past ones are read"
            );
            return Err(Refusal::new(Kind::Argument, text).into());
        }
        let record = Dataset { init_samples, ..self.record(&u, y)? };
        let found = self.compute(py, Arc::new(record), move |m, d| Ok(m.simulate(d, Some(start))?))?;
        only(py, found)
    }

    /// `steps` ahead over inputs (samples, channels) and the measured outputs.
    fn predict_arrays<'py>(
        &self,
        py: Python<'py>,
        u: PyReadonlyArray2<'py, f64>,
        y: PyReadonlyArray1<'py, f64>,
        steps: usize,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let record = self.record(&u, Some(y.as_array().iter().copied().collect()))?;
        let found = self.compute(py, Arc::new(record), move |m, d| Ok(m.predict(d, steps)?))?;
        only(py, found)
    }

    /// Sentences on the channels of a record that leave what the model was estimated on.
    fn outside(&self, record: &Record) -> Vec<String> {
        self.stored.outside(&record.data).iter().map(|o| o.sentence()).collect()
    }
}
