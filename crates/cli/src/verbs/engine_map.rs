//! `dynocal engine map` and `full-load`: steady points as an engine controller holds them.

use std::path::PathBuf;

use clap::Args;
use dynocal_jobs::engine::load::{self, Grid, Loaded, Spec, What};
use dynocal_jobs::engine::{Engine, quantities};
use dynocal_plant::full_load::LoadLimits;
use dynocal_report::significant;

use super::engine::{page, show};
use crate::failure::{Exit, Failure, exit};
use crate::progress::Progress;
use crate::table;
use crate::terminal::{print, say};

#[derive(Args, Debug)]
pub(crate) struct Map {
    /// First, last speed and number of speeds
    #[arg(long, num_args = 3, value_names = ["FROM", "TO", "N"], default_values_t = [1000.0, 5000.0, 9.0])]
    speed_rpm: Vec<f64>,
    /// First, last torque and number of torques
    #[arg(long, num_args = 3, value_names = ["FROM", "TO", "N"], default_values_t = [20.0, 100.0, 5.0], allow_negative_numbers = true)]
    torque_nm: Vec<f64>,
    #[command(flatten)]
    limits: Limits,
}

#[derive(Args, Debug)]
pub(crate) struct FullLoad {
    /// First, last speed and number of speeds
    #[arg(long, num_args = 3, value_names = ["FROM", "TO", "N"], default_values_t = [1000.0, 5500.0, 10.0])]
    speed_rpm: Vec<f64>,
    /// Torque that is not exceeded
    #[arg(long, default_value_t = 366.0, allow_negative_numbers = true)]
    torque_nm: f64,
    #[command(flatten)]
    limits: Limits,
}

#[derive(Args, Debug)]
struct Limits {
    /// Most intake-manifold pressure
    #[arg(long, default_value_t = 240.0)]
    max_map_kpa: f64,
    /// Most exhaust temperature; the mixture is enriched for it
    #[arg(long, default_value_t = 950.0)]
    max_egt_degc: f64,
    /// Most peak pressure; the spark is retarded for it
    #[arg(long, default_value_t = 110.0)]
    max_pmax_bar: f64,
    /// Most knock integral; the spark is retarded for it
    #[arg(long, default_value_t = 1.0)]
    max_knock: f64,
    /// Write the table to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write a report with maps or curves
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

impl Limits {
    fn load(&self) -> LoadLimits {
        LoadLimits {
            map_kpa: self.max_map_kpa,
            egt_k: self.max_egt_degc + 273.15,
            pmax_bar: self.max_pmax_bar,
            knock: self.max_knock,
            ..LoadLimits::default()
        }
    }
}

/// Three numbers as clap has counted them.
fn grid(given: &[f64]) -> Grid {
    let at = |k: usize| given.get(k).copied().unwrap_or(f64::NAN);
    Grid { from: at(0), to: at(1), count: at(2) }
}

impl Map {
    pub(crate) fn run(&self, engine: &Engine) -> Result<Exit, Failure> {
        let what = What::Map { torque_nm: grid(&self.torque_nm) };
        let spec = Spec { what, speed_rpm: grid(&self.speed_rpm), limits: self.limits.load() };
        finish(engine, &spec, &self.limits)
    }
}

impl FullLoad {
    pub(crate) fn run(&self, engine: &Engine) -> Result<Exit, Failure> {
        let what = What::FullLoad { torque_nm: self.torque_nm };
        let spec = Spec { what, speed_rpm: grid(&self.speed_rpm), limits: self.limits.load() };
        finish(engine, &spec, &self.limits)
    }
}

/// What holds the torque at each speed of full load.
fn held(found: &Loaded) -> Result<(), Failure> {
    let rows: Vec<Vec<String>> = found
        .rows
        .iter()
        .flatten()
        .map(|p| vec![significant(p.request.speed_rpm, 4), load::held_by(p).to_owned()])
        .collect();
    Ok(print(&format!("\n{}", table::render(&["speed [rpm]", "held by"], &rows, &[0])))?)
}

/// Not valid when a point is out of reach or did not come to rest.
fn finish(engine: &Engine, spec: &Spec, files: &Limits) -> Result<Exit, Failure> {
    let found: Loaded = Progress::new(false).during(|watch| load::run(engine, spec, watch))?;
    let points = found.points();
    show(&points)?;
    if found.full_load {
        held(&found)?;
    }
    if let Some(path) = &files.csv {
        quantities::csv(path, &points)?;
    }
    page(files.report.as_deref(), || load::report(spec, &engine.set, &found))?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    Ok(exit(found.valid()))
}
