//! Values of Python as TOML.

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyFloat, PyInt, PyMapping, PyString};
use toml::Value;

use crate::errors::{Kind, Refusal};

/// Deepest nesting: a list that holds itself is no spec.
const DEEPEST: usize = 32;

/// A mapping as a table; entries that are None are left out. `key` is where it stands, for messages.
pub(crate) fn table(value: &Bound<'_, PyAny>, key: &str) -> PyResult<toml::Table> {
    match of(value, key, 0)? {
        Value::Table(t) => Ok(t),
        other => Err(Refusal::new(
            Kind::Argument,
            format!("`{key}`: found {} ({}), expected a mapping", value.get_type().name()?, other.type_str()),
        )
        .into()),
    }
}

/// A value as TOML.
pub(crate) fn of(value: &Bound<'_, PyAny>, key: &str, depth: usize) -> PyResult<Value> {
    let refused = |found: String, expected: &str| -> PyErr {
        Refusal::new(Kind::Argument, format!("`{key}`: found {found}, expected {expected}")).into()
    };
    if depth > DEEPEST {
        return Err(refused(format!("more than {DEEPEST} levels"), "tables and lists that end"));
    }
    if value.is_instance_of::<PyBool>() {
        return Ok(Value::Boolean(value.extract()?));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(Value::String(value.extract()?));
    }
    if value.is_instance_of::<PyInt>() {
        let number = value.extract::<i64>();
        return Ok(Value::Integer(number.map_err(|_| refused(value.to_string(), "an integer of 64 bits"))?));
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(Value::Float(value.extract()?));
    }
    if let Ok(map) = value.cast::<PyMapping>() {
        let mut table = toml::Table::new();
        for item in map.items()?.iter() {
            let (name, inner): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
            let name: String =
                name.extract().map_err(|_| refused(format!("the key {name}"), "keys that are text"))?;
            if !inner.is_none() {
                let place = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
                table.insert(name, of(&inner, &place, depth + 1)?);
            }
        }
        return Ok(Value::Table(table));
    }
    // Scalars and arrays of NumPy.
    if value.hasattr("tolist")? && value.hasattr("dtype")? {
        return of(&value.call_method0("tolist")?, key, depth + 1);
    }
    if value.hasattr("__fspath__")? {
        return Ok(Value::String(value.call_method0("__fspath__")?.extract()?));
    }
    if value.hasattr("__iter__")? && value.hasattr("__len__")? {
        let mut list = Vec::new();
        for (k, item) in value.try_iter()?.enumerate() {
            list.push(of(&item?, &format!("{key}[{k}]"), depth + 1)?);
        }
        return Ok(Value::Array(list));
    }
    let found = if value.is_none() { "None".into() } else { format!("a {}", value.get_type().name()?) };
    Err(refused(found, "a number, a text, true or false, a list or a mapping"))
}
