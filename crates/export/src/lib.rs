//! Maps, models and controllers in the formats of the neighbours.
//!
//! What leaves the program takes a neutral form first: a [`characteristic::Characteristic`] is a scalar, curve or map
//! with axes, units and limits; a [`program::Program`] is what is computed sample by sample,
//!
//! ```text
//! y(t) = sum_k c_k prod_i x_i(t - l_i)^p_i,   x through delays, lags, scalings, limits, networks, look-ups
//! ```
//!
//! general enough for polynomial NARX models, networks, structured dynamic maps and scheduled controllers. A
//! [`package::Package`] holds both with their provenance; the rows of [`format::EXPORTS`] write it and read it back.
//! [`evaluate::Machine`] runs a program operation by operation as the generated C does.
//!
//! ```
//! use dynocal_export::characteristic::{Axis, Characteristic};
//! use dynocal_export::format::{Keys, read, write};
//! use dynocal_export::package::Package;
//! let axis = |name: &str, unit: &str, points: &[f64]| Axis {
//!     name: name.into(),
//!     description: String::new(),
//!     unit: unit.into(),
//!     input: name.to_lowercase(),
//!     points: points.to_vec(),
//!     shared: false,
//! };
//! let map = Characteristic {
//!     name: "INJ_MAP".into(),
//!     description: "Injected mass".into(),
//!     unit: "mg".into(),
//!     axes: vec![axis("SPEED", "rpm", &[1000.0, 2000.0, 4000.0]), axis("TORQUE", "Nm", &[50.0, 150.0])],
//!     values: vec![12.5, 12.0, 13.25, 31.0, 30.5, 33.0],
//!     limits: None,
//! };
//! let package = Package { name: "INJ".into(), characteristics: vec![map], ..Default::default() };
//! let files = write(&package, "dcm", &Keys::default()).unwrap();
//! let back = read(&files[0].name, &files[0].bytes).unwrap();
//! assert_eq!(back.characteristics[0].values, package.characteristics[0].values);
//! ```

pub mod characteristic;
pub mod compare;
pub mod error;
pub mod evaluate;
pub mod format;
pub mod package;
pub mod program;
pub mod tune;

pub use error::ExportError;
