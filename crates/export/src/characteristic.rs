//! Scalars, curves and maps with axes, units and limits: the neutral form of what a calibrator calls a characteristic.

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use crate::error::ExportError;

/// Breakpoints of a curve or map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Name; of a shared axis the name of the axis in the ECU.
    pub name: String,
    /// One line.
    pub description: String,
    /// Unit.
    pub unit: String,
    /// Quantity that enters, e.g. `speed`.
    pub input: String,
    /// Breakpoints, strictly increasing.
    pub points: Vec<f64>,
    /// Whether several characteristics share it.
    pub shared: bool,
}

/// A scalar (no axis), curve (one), map (two); a block of values where `axes` is empty and there are several values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Characteristic {
    /// Name, a C identifier.
    pub name: String,
    /// One line.
    pub description: String,
    /// Unit of the values.
    pub unit: String,
    /// Axes, x first.
    pub axes: Vec<Axis>,
    /// Values, x fastest.
    pub values: Vec<f64>,
    /// Least and greatest value allowed, where they are known.
    pub limits: Option<Interval>,
}

/// Whether `name` is an identifier of C, A2L and DCM alike.
pub fn is_identifier(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 128
        && name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// Whether `name` is one that an ECU may have: identifiers with dots and brackets, `Ign.tab[2]`, as DCM and CDF allow.
pub fn is_ecu_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 255
        && name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || "_.[]".contains(c))
}

/// `name` made an identifier: other characters become underscores.
pub fn identifier(name: &str) -> String {
    let clean: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if clean.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') { clean } else { format!("x{clean}") }
}

impl Axis {
    /// Checks breakpoints: finite, strictly increasing, at least two.
    ///
    /// # Errors
    /// [`ExportError::Form`].
    pub fn check(&self) -> Result<(), ExportError> {
        if self.points.len() < 2 {
            let found = self.points.len();
            return Err(ExportError::form(
                &self.name,
                format!("found {found} axis points, expected at least 2"),
            ));
        }
        match self.points.windows(2).position(|w| !(w[1] > w[0] && w[0].is_finite() && w[1].is_finite())) {
            None => Ok(()),
            Some(k) => Err(ExportError::form(
                &self.name,
                format!(
                    "found the axis points {} and {}, expected finite and strictly increasing ones",
                    self.points[k],
                    self.points[k + 1]
                ),
            )),
        }
    }
}

impl Characteristic {
    /// Number of values that the axes ask for (any number without axes).
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether there is no value.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Checks name, axes, number of values and that all are finite.
    ///
    /// # Errors
    /// [`ExportError::Form`].
    pub fn check(&self) -> Result<(), ExportError> {
        if !is_ecu_name(&self.name) {
            return Err(ExportError::form(
                &self.name,
                "found this name, expected letters, digits, underscores, and for parts of it dots and brackets",
            ));
        }
        self.axes.iter().try_for_each(Axis::check)?;
        let wanted: usize = self.axes.iter().map(|a| a.points.len()).product();
        if (!self.axes.is_empty() && self.values.len() != wanted) || self.values.is_empty() {
            let sizes: Vec<String> = self.axes.iter().map(|a| a.points.len().to_string()).collect();
            return Err(ExportError::form(
                &self.name,
                format!("found {} values, expected {wanted} ({})", self.values.len(), sizes.join(" x ")),
            ));
        }
        match self.values.iter().find(|v| !v.is_finite()) {
            Some(v) => {
                Err(ExportError::form(&self.name, format!("found the value {v}, expected finite values")))
            }
            None => Ok(()),
        }
    }
}
