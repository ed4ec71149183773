//! Reports: finished results in, one self-contained `report.html` out.
//!
//! This crate computes nothing of its own. A caller fills a [`Report`] (plain structs, JSON-able with serde), and
//! [`render`] turns it into one HTML page that opens offline: style, scripts and data are inside, and a content
//! security policy forbids every network access. Equal documents give equal bytes.
//!
//! ```
//! use dynocal_report::{Check, Column, Panel, Report, Section, Table, TimePlot, render};
//!
//! let time_s: Vec<f64> = (0..200).map(|k| 0.03 * k as f64).collect();
//! let measured: Vec<f64> = time_s.iter().map(|t| 50.0 + 20.0 * t.sin()).collect();
//! let simulated: Vec<f64> = time_s.iter().map(|t| 50.0 + 19.5 * (t - 0.02).sin()).collect();
//!
//! let report = Report::new("Torque model")
//!     .subtitle("validation record 1")
//!     .warning("lambda left its limits for 0.4 s")
//!     .check(Check::new("fit", "free-run R2").asked(">= 99").measured(99.3).unit("%").holds(true))
//!     .section(
//!         Section::new("Validation")
//!             .text("The model runs free from the measured initial values.")
//!             .block(Table::new(vec![Column::text("Output"), Column::number("R2", "%")]).row(["torque".into(), 99.3.into()]))
//!             .block(
//!                 TimePlot::new("Measured over simulated", time_s)
//!                     .panel(Panel::new("Torque", "Nm").measured(measured).simulated(simulated)),
//!             ),
//!     );
//! let html = render(&report)?;
//! assert!(html.starts_with("<!doctype html>"));
//! # Ok::<(), dynocal_report::RenderError>(())
//! ```

mod model;
mod numbers;
mod plots;
mod render;
mod view;

pub use model::{Align, Block, Cell, Check, Column, Details, KeyValue, Report, Section, Table};
pub use numbers::{capital, significant, with_unit};
pub use plots::{
    Axis, BarSeries, Bars, ColourScale, HeatMap, Level, Mark, Overlay, Panel, Role, Series, TimePlot, XyPlot,
    XySeries,
};
pub use render::{RenderError, render};
