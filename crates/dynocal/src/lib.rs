//! Dynamic powertrain calibration as one toolchain: which test next, which model, which actuator positions over time,
//! which map.
//!
//! # The problem
//!
//! A powertrain has inputs u (throttle, injection, spark, ..), given operating channels v (speed) and outputs y (torque,
//! lambda, ..). Sampled every `sample_time_s`, row t holds the inputs that act from instant t on and the outputs that
//! are measured at instant t.
//!
//! *Identify.* A dynamic model with parameters theta, free of measured outputs once it runs,
//!
//! ```text
//! y(t) = f(u(t-1), .., u(t-n), v(t-1), .., y(t-1), .., y(t-n); theta)
//! theta_hat = argmin  sum_t (y_measured(t) - y(t; theta))^2
//! ```
//!
//! *Design.* The record that tells most about theta within the limits of inputs, their rates and the predicted outputs,
//!
//! ```text
//! min over u   J(M(u)),   M = 1/sigma^2  sum_t  dy(t)/dtheta  dy(t)/dtheta',   e.g. J_D = -log det M
//! ```
//!
//! *Optimise.* The inputs that cost least over a whole transient, torque and lambda held on their demand w,
//!
//! ```text
//! min over u   sum_t  cost(u(t), v(t), y(t))   subject to   y(t) = w(t),   lower <= u <= upper,   |u(t) - u(t-1)| <= rate
//! ```
//!
//! *Invert.* A causal map from demand to inputs that does the same without looking ahead, and *validate* it beside a
//! static map on the plant.
//!
//! # The house
//!
//! | module | holds |
//! |---|---|
//! | [`numerics`] | linear algebra, random numbers, least squares, searches, interior point |
//! | [`ident`] | signals, records, models, estimation, validation, the contract with a plant |
//! | [`design`] | information, criteria, limits, search for the next record |
//! | [`plant`] | the virtual engine and its test bed |
//! | [`files`] | measurement files (CSV, Parquet, MDF, MAT), specs, run folders |
//! | [`label`] | curves, maps and scalars of ECU functions fitted to measurements |
//! | [`control`] | feedback: margins with exact delay, the plane of PI gains, Smith predictor, the PID that runs |
//! | [`calib`] | optimisation of records, maps, loops of design and measurement |
//! | [`export`] | maps, models and controllers in the formats of the neighbours: C, DCM, CDFX, FMU, ONNX, .. |
//! | [`report`] | pages from finished results |
//! | [`jobs`] | what the program does: a typed spec in, a result and a run folder out |
//!
//! # Example
//!
//! A record of a first-order lag, its model, and how well the model runs free:
//!
//! ```
//! use dynocal::prelude::*;
//!
//! // y(t) = 0.8 y(t-1) + 0.5 u(t-1)
//! let keys = toml::from_str("lo = -1.0\nhi = 1.0\nhold_s = 0.2")?;
//! let mut u = vec![0.0; 400];
//! signal("aprbs", &keys)?.fill(&mut u, 0.1, &mut Rng64::new(1))?;
//! let mut y = vec![0.0; 400];
//! for t in 1..400 {
//!     y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1];
//! }
//! let channel = |name: &str, role, values| Channel { name: name.into(), unit: "-".into(), role, values };
//! let record = Dataset {
//!     name: "lag".into(),
//!     sample_time_s: 0.1,
//!     channels: vec![channel("u", Role::Input, u), channel("y", Role::Output, y)],
//!     init_samples: 0,
//!     origin: "computed".into(),
//! };
//! let data = experiments(&[record], &["u".into()], "y")?;
//! let model = PolyNarx::parse(&["u"], "y", &["y(t-1)", "u(t-1)"])?;
//! let fit = estimator("ols", &toml::Table::new())?.estimate(&model, &data, None, &|| false)?;
//! assert!((fit.theta[0] - 0.8).abs() < 1e-9 && (fit.theta[1] - 0.5).abs() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A label of an ECU from measurements, with what the data say of each of its cells:
//!
//! ```
//! use dynocal::label::graph::{Graph, Node, Op, Record};
//! use dynocal::label::label::Label;
//! use dynocal::label::linear::{Options, Verdict};
//! use dynocal::label::nonlinear::{Target, fit};
//!
//! // y lags behind GAIN(x), and nothing was measured above x = 1.
//! let labels = vec![
//!     Label::curve("GAIN", "Nm", "x", "-", &[0.0, 1.0, 2.0], &[1.0, 1.0, 1.0]),
//!     Label::scalar("TAU", "s", 0.3),
//! ];
//! let node = |name: &str, op| Node { name: name.into(), op };
//! let nodes = vec![
//!     node("x", Op::Channel(0)),
//!     node("gain", Op::Label(0, vec![0])),
//!     node("tau", Op::Label(1, vec![])),
//!     node("y", Op::Lag(1, 2)),
//! ];
//! let graph = Graph { nodes, labels };
//! let time_s: Vec<f64> = (0..100).map(|k| 0.1 * f64::from(k)).collect();
//! let x: Vec<f64> = (0..100).map(|k| f64::from((k / 10) % 3) / 2.0).collect();
//! let record = Record { time_s: &time_s, channels: vec![&x] };
//! let y = graph.values(&[2.0, 5.0, 1.0, 0.5], &record);
//! let weights = vec![1.0; y.len()];
//! let target = Target { record, node: None, y: &y, weights: &weights };
//! let found = fit(&graph, &[target], &Options { smooth: Some(0.0), ..Options::default() }, &|| false)?;
//! assert!(found.converged && (found.fit.values[1] - 5.0).abs() < 1e-6 && (found.fit.values[3] - 0.5).abs() < 1e-6);
//! assert_eq!(found.fit.verdicts[2], Verdict::Untouched);
//! # Ok::<(), dynocal::label::LabelError>(())
//! ```
//!
//! The folder `examples` of this crate has whole tasks: identify a measured file, design a test, optimise a record, simulate a
//! stored model, calibrate on the virtual engine.

pub use dynocal_calib as calib;
pub use dynocal_control as control;
pub use dynocal_design as design;
pub use dynocal_export as export;
pub use dynocal_files as files;
pub use dynocal_ident as ident;
pub use dynocal_jobs as jobs;
pub use dynocal_label as label;
pub use dynocal_numerics as numerics;
pub use dynocal_plant as plant;
pub use dynocal_report as report;

pub mod prelude;
