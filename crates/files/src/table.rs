//! A file as it is: named columns of numbers or text, before anything is known about roles.

use std::borrow::Cow;
use std::collections::BTreeMap;

use dynocal_numerics::registry::nearest;

use crate::error::FilesError;

/// Cells of one column.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells {
    /// Every cell reads as a number (NaN and infinities, and NaN for an empty cell, included).
    Number(Vec<f64>),
    /// At least one cell does not.
    Text(Vec<String>),
}

impl Cells {
    /// Number of rows.
    pub fn len(&self) -> usize {
        match self {
            Cells::Number(v) => v.len(),
            Cells::Text(v) => v.len(),
        }
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Cell `row` as text: integers without decimals, so that `10` in a spec matches 10.0 in a file.
    pub fn label(&self, row: usize) -> String {
        match self {
            Cells::Number(v) => format!("{}", v[row]),
            Cells::Text(v) => v[row].clone(),
        }
    }

    /// Whether cells `a` and `b` are equal.
    pub fn same(&self, a: usize, b: usize) -> bool {
        match self {
            Cells::Number(v) => v[a] == v[b],
            Cells::Text(v) => v[a] == v[b],
        }
    }
}

/// Where a unit comes from: a bracket is a statement, a suffix of the name only a strong hint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnitSource {
    /// `torque [Nm]`, or metadata.
    Bracket,
    /// `torque_nm`.
    Suffix,
}

/// One column.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Name without the unit in brackets.
    pub name: String,
    /// Unit as normalised by [`crate::units::normalise`], if the file gives one.
    pub unit: Option<(String, UnitSource)>,
    /// Cells.
    pub cells: Cells,
}

/// A whole file.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// File name for messages.
    pub file: String,
    /// Columns of equal length.
    pub columns: Vec<Column>,
    /// Line in the file of each row (text formats); empty where rows have no lines.
    pub lines: Vec<u64>,
    /// What was decided on the way in (dialect, stamps, merging), in the user's words.
    pub notes: Vec<String>,
}

impl Table {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |c| c.cells.len())
    }

    /// Place of `row` in the user's terms: `line 17`, or `row 16` (from 1) where there are no lines.
    pub fn place(&self, row: usize) -> String {
        match self.lines.get(row) {
            Some(l) => format!("line {l}"),
            None => format!("row {}", row + 1),
        }
    }

    /// The column `name`.
    ///
    /// # Errors
    /// [`FilesError::NoColumn`] with the nearest name and all names.
    pub fn column(&self, name: &str) -> Result<&Column, FilesError> {
        self.columns.iter().find(|c| c.name == name).ok_or_else(|| {
            let known: Vec<String> = self.columns.iter().map(|c| c.name.clone()).collect();
            FilesError::NoColumn {
                path: self.file.clone(),
                found: name.into(),
                nearest: nearest(name, &known),
                known,
            }
        })
    }

    /// The numbers of column `name` in the rows `from..to`, all finite.
    ///
    /// # Errors
    /// [`FilesError::NoColumn`], [`FilesError::Cell`] with the first cell that is not a finite number.
    pub fn numbers(&self, name: &str, from: usize, to: usize) -> Result<&[f64], FilesError> {
        let column = self.column(name)?;
        let bad = |row: usize, found: String| FilesError::Cell {
            path: self.file.clone(),
            place: self.place(row),
            column: name.into(),
            found,
        };
        match &column.cells {
            Cells::Number(v) => match v[from..to].iter().position(|x| !x.is_finite()) {
                Some(k) => Err(bad(from + k, describe(v[from + k], !self.lines.is_empty()))),
                None => Ok(&v[from..to]),
            },
            Cells::Text(v) => {
                let k = v[from..to].iter().position(|s| !s.parse().is_ok_and(f64::is_finite)).unwrap_or(0);
                Err(bad(from + k, v.get(from + k).cloned().unwrap_or_default()))
            }
        }
    }

    /// The numbers of column `name` in the rows `from..to`, NaN where the cell is empty or says that the sample is
    /// missing (`NA`, `n/a`, `NaN`, `null`, `none`, `-`, `?`).
    ///
    /// # Errors
    /// [`FilesError::NoColumn`], [`FilesError::Cell`] with the first cell that is infinite or other text.
    pub fn numbers_or_missing(
        &self,
        name: &str,
        from: usize,
        to: usize,
    ) -> Result<Cow<'_, [f64]>, FilesError> {
        let bad = |row: usize, found: String| FilesError::Cell {
            path: self.file.clone(),
            place: self.place(row),
            column: name.into(),
            found,
        };
        match &self.column(name)?.cells {
            Cells::Number(v) => match v[from..to].iter().position(|x| x.is_infinite()) {
                Some(k) => Err(bad(from + k, format!("{}", v[from + k]))),
                None => Ok(Cow::Borrowed(&v[from..to])),
            },
            Cells::Text(v) => {
                // A file with decimal commas keeps them in a column that holds words as well.
                let number =
                    |(k, text): (usize, &String)| match text.trim().replacen(',', ".", 1).parse::<f64>() {
                        Ok(x) if !x.is_infinite() => Ok(x),
                        _ if is_missing(text) => Ok(f64::NAN),
                        _ => Err(bad(from + k, text.clone())),
                    };
                v[from..to].iter().enumerate().map(number).collect::<Result<Vec<_>, _>>().map(Cow::Owned)
            }
        }
    }
}

/// Texts that stand for a missing sample.
const MISSING: [&str; 8] = ["", "na", "n/a", "nan", "null", "none", "-", "?"];

fn is_missing(text: &str) -> bool {
    MISSING.iter().any(|m| text.trim().eq_ignore_ascii_case(m))
}

fn describe(value: f64, text_file: bool) -> String {
    if value.is_nan() && text_file { "NaN or an empty cell".into() } else { format!("{value}") }
}

/// Gives columns the names of `alias`: where no column has a name already, the first of its other names that is there
/// gets it. Says what was done.
///
/// ```
/// use dynocal_files::table::{Cells, Column, rename};
/// let mut column = Column { name: "Tq_Brake".into(), unit: None, cells: Cells::Number(vec![]) };
/// let alias = [("torque".into(), vec!["trq".into(), "Tq_Brake".into()])].into();
/// assert_eq!(rename(&mut [&mut column], &alias), ["column `Tq_Brake` is taken as `torque`"]);
/// assert_eq!(column.name, "torque");
/// ```
pub fn rename(columns: &mut [&mut Column], alias: &BTreeMap<String, Vec<String>>) -> Vec<String> {
    let mut notes = Vec::new();
    for (name, others) in alias {
        let place = |n: &String| columns.iter().position(|c| c.name == *n);
        if place(name).is_some() {
            continue;
        }
        if let Some(k) = others.iter().find_map(place) {
            let found = std::mem::replace(&mut columns[k].name, name.clone());
            notes.push(format!("column `{found}` is taken as `{name}`"));
        }
    }
    notes
}
