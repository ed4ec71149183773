//! Plants as objects: the virtual engine, a user's FMU, literature systems.

use std::sync::{Arc, Mutex, MutexGuard};

use dynocal_ident::plant::{Causality, Plant as Contract, PlantError, PlantState};
use dynocal_plant::plants::{self, PlantSpec};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use serde::Deserialize;

use crate::errors::{Kind, Refusal};
use crate::values::table;
use crate::watched::{bug, watched};

/// A plant in its state. One thread at a time: a call while another one runs is refused.
#[pyclass(frozen, module = "dynocal._dynocal")]
pub(crate) struct Plant {
    plant: Arc<Mutex<Box<dyn Contract>>>,
}

/// Name, unit, whether it is an input, least and greatest allowed value, value after a reset.
type Variable = (String, String, bool, f64, f64, f64);

/// Time in s, what touched its limit, value, limit.
type Event = (f64, String, f64, f64);

impl Plant {
    /// The plant for one call. Its steps use no thread of a pool, so a forked process may take them.
    fn held(&self) -> PyResult<MutexGuard<'_, Box<dyn Contract>>> {
        let busy = || {
            Refusal::new(
                Kind::Plant,
                "the plant is in use by another call: give each thread its own, or wait",
            )
        };
        self.plant.try_lock().map_err(|e| match e {
            std::sync::TryLockError::WouldBlock => busy().into(),
            std::sync::TryLockError::Poisoned(_) => bug(),
        })
    }
}

fn count(plant: &dyn Contract, which: Causality) -> usize {
    plant.variables().iter().filter(|v| v.causality == which).count()
}

/// One step, whose inputs are counted first.
fn step(plant: &mut dyn Contract, u: &[f64], dt_s: f64, y: &mut [f64]) -> Result<(), Refusal> {
    let expected = count(plant, Causality::Input);
    if u.len() != expected {
        let text = format!("u: found {} values, expected {expected}, one for each input", u.len());
        return Err(Refusal::new(Kind::Argument, text));
    }
    if !(dt_s > 0.0 && dt_s.is_finite()) {
        return Err(Refusal::new(
            Kind::Argument,
            format!("ts_s: found {dt_s}, expected a positive number of seconds"),
        ));
    }
    Ok(plant.step(u, dt_s, y)?)
}

#[pymethods]
impl Plant {
    /// From the keys of `[plant]` of a spec; without `noise` its sensors are exact.
    #[new]
    fn new(keys: &Bound<'_, PyAny>, noise: bool) -> PyResult<Self> {
        let keys = table(keys, "plant")?;
        let spec = PlantSpec::deserialize(keys)
            .map_err(|e| Refusal::new(Kind::Argument, format!("plant: {}", e.message())))?;
        if let Some(fault) = plants::check(&spec).first() {
            let expected = if fault.known.is_empty() {
                fault.expected.clone()
            } else {
                format!("one of {}", fault.known.join(", "))
            };
            let text = format!("{}: found {}, expected {expected}", fault.key, fault.found);
            return Err(Refusal::new(Kind::Argument, text).into());
        }
        let make = plants::find(&spec.name).and_then(|p| p.make).ok_or_else(|| {
            Refusal::new(
                Kind::Plant,
                format!("the plant `{}` is run outside: there is nothing to step", spec.name),
            )
        })?;
        let plant = make(&spec, noise).map_err(Refusal::from)?;
        Ok(Self { plant: Arc::new(Mutex::new(plant)) })
    }

    fn variables(&self) -> PyResult<Vec<Variable>> {
        let plant = self.held()?;
        let one = |v: &dynocal_ident::plant::Variable| {
            (v.name.clone(), v.unit.clone(), v.causality == Causality::Input, v.min, v.max, v.start)
        };
        Ok(plant.variables().iter().map(one).collect())
    }

    fn describe(&self) -> PyResult<String> {
        Ok(self.held()?.describe())
    }

    fn reset(&self, seed: u64) -> PyResult<()> {
        self.held()?.reset(seed);
        Ok(())
    }

    #[getter]
    fn time_s(&self) -> PyResult<f64> {
        Ok(self.held()?.time_s())
    }

    /// Holds `u` for `ts_s`; returns what a bed would record.
    fn step<'py>(
        &self,
        py: Python<'py>,
        u: PyReadonlyArray1<'py, f64>,
        ts_s: f64,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let u: Vec<f64> = u.as_array().iter().copied().collect();
        let mut plant = self.held()?;
        let mut y = vec![0.0; count(plant.as_ref(), Causality::Output)];
        // A step takes about as long as giving the lock away and taking it back.
        step(plant.as_mut(), &u, ts_s, &mut y)?;
        Ok(y.into_pyarray(py))
    }

    /// What the plant shows now.
    fn outputs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let plant = self.held()?;
        let mut y = vec![0.0; count(plant.as_ref(), Causality::Output)];
        plant.outputs(&mut y).map_err(Refusal::from)?;
        Ok(y.into_pyarray(py))
    }

    /// Steps over the rows of `u` (samples, inputs); returns (samples, outputs). Where it is interrupted the plant stays in
    /// the state that it has reached.
    fn run<'py>(
        &self,
        py: Python<'py>,
        u: PyReadonlyArray2<'py, f64>,
        ts_s: f64,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        drop(self.held()?);
        let u = u.as_array().to_owned();
        let plant = self.plant.clone();
        let work = move |watch: dynocal_numerics::watch::Watch| -> Result<(Vec<f64>, usize), Refusal> {
            let mut plant = plant
                .try_lock()
                .map_err(|_| Refusal::new(Kind::Plant, "the plant is in use by another call"))?;
            let (n, outputs) = (u.nrows(), count(plant.as_ref(), Causality::Output));
            let mut y = vec![0.0; n * outputs];
            for (t, row) in u.rows().into_iter().enumerate() {
                if watch.interrupted() {
                    return Err(PlantError::Call("interrupted".into()).into());
                }
                watch.fraction(t as f64 / n as f64);
                let row: Vec<f64> = row.iter().copied().collect();
                step(plant.as_mut(), &row, ts_s, &mut y[t * outputs..(t + 1) * outputs])?;
            }
            Ok((y, outputs))
        };
        let (y, outputs) = watched(py, progress, work)??;
        let n = y.len().checked_div(outputs).unwrap_or(0);
        y.into_pyarray(py).reshape([n, outputs])
    }

    /// The whole state, as numbers that mean something to this plant only.
    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(self.held()?.save().0.into_pyarray(py))
    }

    fn restore(&self, state: PyReadonlyArray1<'_, f64>) -> PyResult<()> {
        let state = PlantState(state.as_array().iter().copied().collect());
        Ok(self.held()?.restore(&state).map_err(Refusal::from)?)
    }

    /// Limits that were touched since the last call.
    fn events(&self) -> PyResult<Vec<Event>> {
        let events = self.held()?.take_events();
        Ok(events.into_iter().map(|e| (e.time_s, e.what, e.value, e.limit)).collect())
    }
}
