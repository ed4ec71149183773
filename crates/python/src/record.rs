//! Records of NumPy arrays.

use std::sync::Arc;

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_jobs::identify::memory::fingerprint;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::errors::{Kind, Refusal};

/// A record: channels of equal length. Nothing changes it.
#[pyclass(frozen, module = "dynocal._dynocal")]
pub(crate) struct Record {
    pub(crate) data: Arc<Dataset>,
}

impl From<Dataset> for Record {
    fn from(data: Dataset) -> Self {
        Self { data: Arc::new(data) }
    }
}

/// Copies of records, for work that outlives the call.
pub(crate) fn owned(records: &[PyRef<'_, Record>]) -> Vec<Dataset> {
    records.iter().map(|r| Dataset::clone(&r.data)).collect()
}

pub(crate) fn role(name: &str) -> Result<Role, Refusal> {
    match name {
        "input" => Ok(Role::Input),
        "output" => Ok(Role::Output),
        "auxiliary" => Ok(Role::Auxiliary),
        _ => Err(Refusal::new(
            Kind::Argument,
            format!("role: found `{name}`, expected input, output or auxiliary"),
        )),
    }
}

pub(crate) fn role_name(role: Role) -> &'static str {
    match role {
        Role::Input => "input",
        Role::Output => "output",
        Role::Auxiliary => "auxiliary",
    }
}

#[pymethods]
impl Record {
    #[new]
    fn new(
        name: String,
        sample_time_s: f64,
        channels: Vec<(String, String, String, PyReadonlyArray1<'_, f64>)>,
        init_samples: usize,
        origin: String,
    ) -> PyResult<Self> {
        let one = |(name, unit, part, values): (String, String, String, PyReadonlyArray1<'_, f64>)| {
            Ok(Channel {
                name,
                unit,
                role: role(&part)?,
                values: values.as_array().iter().copied().collect(),
            })
        };
        let channels = channels.into_iter().map(one).collect::<Result<Vec<_>, Refusal>>()?;
        let data = Dataset { name, sample_time_s, channels, init_samples, origin };
        data.check_marked().map_err(Refusal::from)?;
        Ok(data.into())
    }

    #[getter]
    fn name(&self) -> &str {
        &self.data.name
    }

    #[getter]
    fn sample_time_s(&self) -> f64 {
        self.data.sample_time_s
    }

    #[getter]
    fn init_samples(&self) -> usize {
        self.data.init_samples
    }

    #[getter]
    fn origin(&self) -> &str {
        &self.data.origin
    }

    fn __len__(&self) -> usize {
        self.data.len()
    }

    /// Name, unit and role of each channel.
    fn channels(&self) -> Vec<(String, String, &'static str)> {
        self.data.channels.iter().map(|c| (c.name.clone(), c.unit.clone(), role_name(c.role))).collect()
    }

    /// A copy of the samples of a channel.
    fn values<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(self.data.values(name).map_err(Refusal::from)?.to_vec().into_pyarray(py))
    }

    /// Channels as columns (samples, channels).
    fn matrix<'py>(&self, py: Python<'py>, names: Vec<String>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.data.matrix(&names).map_err(Refusal::from)?;
        rows.into_pyarray(py).reshape([self.data.len(), names.len()])
    }

    /// Samples `start..stop` as a record of their own.
    fn part(&self, start: usize, stop: usize, name: String) -> PyResult<Self> {
        if start >= stop || stop > self.data.len() {
            let text =
                format!("samples: found {start} to {stop}, expected a part of 0 to {}", self.data.len());
            return Err(Refusal::new(Kind::Argument, text).into());
        }
        Ok(self.data.part(start, stop, name).into())
    }

    /// The same record with other roles: channels that are in neither list become auxiliary.
    fn with_roles(&self, inputs: Vec<String>, outputs: Vec<String>) -> PyResult<Self> {
        for name in inputs.iter().chain(&outputs) {
            self.data.channel(name).map_err(Refusal::from)?;
        }
        let mut data = Dataset::clone(&self.data);
        for c in &mut data.channels {
            c.role = match (inputs.contains(&c.name), outputs.contains(&c.name)) {
                (_, true) => Role::Output,
                (true, false) => Role::Input,
                (false, false) => Role::Auxiliary,
            };
        }
        Ok(data.into())
    }

    /// The same record with another number of leading samples that only initialise.
    fn with_init_samples(&self, init_samples: usize) -> Self {
        Dataset { init_samples, ..Dataset::clone(&self.data) }.into()
    }

    /// Digest of sample time, channels, units and samples.
    fn fingerprint(&self, py: Python<'_>) -> String {
        let data = self.data.clone();
        py.detach(move || fingerprint(&data))
    }

    /// Number of missing samples of each channel.
    fn missing(&self) -> Vec<(String, usize)> {
        let count = |c: &Channel| (c.name.clone(), c.values.iter().filter(|v| v.is_nan()).count());
        self.data.channels.iter().map(count).collect()
    }
}
