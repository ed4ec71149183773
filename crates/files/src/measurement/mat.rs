//! What a MATLAB file holds, whichever container it is in, and how measurements lie in it.
//!
//! A channel is a numeric vector; its raster are the vectors of equal length in the same place (the top level, or one
//! struct). Time is told by its name. A struct `units` beside them may name the unit of each.

use crate::error::FilesError;
use crate::measurement::{ChannelInfo, GroupInfo, Raster, Source, TakeChunk, time_channel};
use crate::table::Cells;
use crate::units;

/// A MATLAB value.
#[derive(Clone, Debug, PartialEq)]
pub enum MatValue {
    /// Numbers, column-major.
    Numbers {
        /// Size in each dimension, at least two.
        dims: Vec<usize>,
        /// Values.
        values: Vec<f64>,
    },
    /// A row of characters.
    Text(String),
    /// A scalar struct: fields in order.
    Struct(Vec<(String, MatValue)>),
    /// A cell array, flattened.
    Cell(Vec<MatValue>),
    /// Something without meaning to us, with the name of its class.
    Other(String),
}

impl MatValue {
    /// A column vector.
    pub fn vector(values: &[f64]) -> Self {
        MatValue::Numbers { dims: vec![values.len(), 1], values: values.to_vec() }
    }

    /// A scalar.
    pub fn scalar(value: f64) -> Self {
        MatValue::Numbers { dims: vec![1, 1], values: vec![value] }
    }

    /// Field `name` of a struct.
    pub fn field(&self, name: &str) -> Option<&MatValue> {
        match self {
            MatValue::Struct(fields) => fields.iter().find(|f| f.0 == name).map(|f| &f.1),
            _ => None,
        }
    }

    /// The values of a vector (one dimension longer than 1 at most).
    pub fn as_vector(&self) -> Option<&[f64]> {
        match self {
            MatValue::Numbers { dims, values } if dims.iter().filter(|d| **d != 1).count() <= 1 => {
                Some(values)
            }
            _ => None,
        }
    }
}

/// A file read as variables.
pub(crate) struct Variables {
    path: String,
    groups: Vec<GroupInfo>,
    values: Vec<Vec<Vec<f64>>>,
    notes: Vec<String>,
}

impl Variables {
    pub(crate) fn new(path: &str, variables: Vec<(String, MatValue)>) -> Result<Self, FilesError> {
        let mut out = Self { path: path.into(), groups: Vec::new(), values: Vec::new(), notes: Vec::new() };
        out.place("", variables, 0);
        if out.groups.is_empty() {
            return Err(FilesError::Empty {
                path: path.into(),
                expected: "numeric vectors of at least two samples",
            });
        }
        Ok(out)
    }

    /// The vectors of one place become groups by length; structs are places of their own.
    fn place(&mut self, name: &str, variables: Vec<(String, MatValue)>, depth: usize) {
        let stated: Vec<(String, String)> = match variables.iter().find(|v| v.0 == "units") {
            Some((_, MatValue::Struct(fields))) => fields
                .iter()
                .filter_map(
                    |(n, v)| if let MatValue::Text(t) = v { Some((n.clone(), t.clone())) } else { None },
                )
                .collect(),
            _ => Vec::new(),
        };
        let first = self.groups.len();
        for (variable, value) in variables {
            match value {
                MatValue::Struct(fields) if variable != "units" && depth < 8 => {
                    let inner = if name.is_empty() { variable } else { format!("{name}.{variable}") };
                    self.place(&inner, fields, depth + 1);
                }
                MatValue::Numbers { dims, values } if values.len() >= 2 => {
                    self.numbers(name, first, &variable, &dims, values, &stated);
                }
                MatValue::Struct(_) if variable == "units" => {}
                other => {
                    let what = match other {
                        MatValue::Text(_) => "text".to_string(),
                        MatValue::Cell(_) => "a cell array".to_string(),
                        MatValue::Struct(_) => "a struct inside too many others".to_string(),
                        MatValue::Numbers { values, .. } => format!("{} values, no record", values.len()),
                        MatValue::Other(class) => format!("of class {class}"),
                    };
                    self.notes.push(format!("variable `{variable}` is left out: {what}"));
                }
            }
        }
        for group in &mut self.groups[first..] {
            group.time = time_channel(group);
        }
    }

    fn numbers(
        &mut self,
        place: &str,
        first: usize,
        variable: &str,
        dims: &[usize],
        values: Vec<f64>,
        stated: &[(String, String)],
    ) {
        let rows = if dims.first() == Some(&1) { values.len() } else { dims.first().copied().unwrap_or(0) };
        let columns = values.len() / rows.max(1);
        if rows < 2 || columns == 0 || dims.iter().filter(|d| **d > 1).count() > 2 {
            self.notes
                .push(format!("variable `{variable}` of size {dims:?} is left out: no vector, no table"));
            return;
        }
        let known = self.groups[first.min(self.groups.len())..]
            .iter()
            .position(|g| g.name == place && g.rows == rows as u64)
            .map(|k| k + first);
        let group = known.unwrap_or_else(|| {
            let info = GroupInfo { name: place.into(), channels: Vec::new(), time: None, rows: rows as u64 };
            self.groups.push(info);
            self.values.push(Vec::new());
            self.groups.len() - 1
        });
        for (k, column) in values.chunks(rows).enumerate() {
            let name = if columns == 1 { variable.to_string() } else { format!("{variable}_{}", k + 1) };
            let unit = stated.iter().find(|s| s.0 == variable).map(|s| units::normalise(&s.1));
            let unit = unit.or_else(|| units::from_suffix(variable).map(str::to_string));
            self.groups[group].channels.push(ChannelInfo { name, unit, comment: String::new(), text: false });
            self.values[group].push(column.to_vec());
        }
    }
}

impl Source for Variables {
    fn file(&self) -> &str {
        &self.path
    }

    fn groups(&self) -> &[GroupInfo] {
        &self.groups
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn chunks(&self, group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError> {
        take(&channels.iter().map(|c| Cells::Number(self.values[group][*c].clone())).collect::<Vec<_>>())
    }
}

/// Rasters as variables: one raster at the top level, several as structs, each with `units`.
pub(crate) fn variables(rasters: &[Raster]) -> Result<Vec<(String, MatValue)>, String> {
    let mut out = Vec::new();
    for (k, raster) in rasters.iter().enumerate() {
        let mut fields = vec![("time".to_string(), MatValue::vector(&raster.time_s))];
        let mut stated = vec![("time".to_string(), MatValue::Text("s".into()))];
        for c in &raster.columns {
            let name = identifier(&c.name);
            let Cells::Number(values) = &c.cells else {
                return Err(format!("column `{}` holds words, expected numbers", c.name));
            };
            if fields.iter().any(|f| f.0 == name) {
                return Err(format!(
                    "column `{}` has the name `{name}` in MATLAB, which is taken already",
                    c.name
                ));
            }
            fields.push((name.clone(), MatValue::vector(values)));
            // A channel whose unit nobody knows has none, not that of a ratio.
            stated.extend(c.unit.as_ref().map(|u| (name, MatValue::Text(u.0.clone()))));
        }
        fields.push(("units".into(), MatValue::Struct(stated)));
        if rasters.len() == 1 {
            out = fields;
        } else {
            out.push((format!("raster_{}", k + 1), MatValue::Struct(fields)));
        }
    }
    Ok(out)
}

/// A name that MATLAB takes: letters, digits and underscores, a letter first, 63 characters at most.
pub fn identifier(name: &str) -> String {
    let clean: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).take(60).collect();
    if clean.starts_with(|c: char| c.is_ascii_alphabetic()) { clean } else { format!("x{clean}") }
}
