//! `dynocal._dynocal`: what the Python package `dynocal` calls.
//!
//! Conversions, threads, errors; no mathematics. Everything long runs in a thread of its own without the interpreter's lock
//! ([`watched`]), and a user sees only exceptions of `dynocal.errors` ([`errors`]).

mod arrow_in;
mod arrow_out;
mod arrow_type;
mod errors;
mod files;
mod fit;
mod jobs;
mod many;
mod model;
mod plant;
mod record;
mod tables;
mod values;
mod watched;
mod words;

// What has not been tried without the lock does not claim to be safe without it.
#[pyo3::pymodule(gil_used = true)]
mod _dynocal {
    #[pymodule_export]
    use super::arrow_in::record_from_arrow;
    #[pymodule_export]
    use super::arrow_out::record_to_arrow;
    #[pymodule_export]
    use super::files::{contents, convert, is_time, read, write};
    #[pymodule_export]
    use super::fit::{judge, learn};
    #[pymodule_export]
    use super::jobs::{Finished, check, export, program, run, study};
    #[pymodule_export]
    use super::many::Tasks;
    #[pymodule_export]
    use super::model::Model;
    #[pymodule_export]
    use super::plant::Plant;
    #[pymodule_export]
    use super::record::Record;
    #[pymodule_export]
    use super::tables::{members, signal, to_toml, version};
    #[pymodule_export]
    use super::watched::{after_fork, rest};

    use numpy::{PyArray1, PyArrayMethods};
    use pyo3::prelude::*;

    /// Looks the C interface of NumPy up, and that by which arrays are borrowed. The first array would do it otherwise, where a pending
    /// Ctrl-C makes the look-up fail, and with it the process.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        PyArray1::<f64>::zeros(module.py(), 1, false).try_readonly()?;
        Ok(())
    }
}
