//! `dynocal engine cycle`: the engine in a car, driven through a cycle of demanded speed.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use dynocal_jobs::engine::{Engine, cycle};
use dynocal_plant::vehicle::LoadUnits;

use super::engine::page;
use crate::failure::{Exit, Failure, exit};
use crate::progress::Progress;
use crate::table;
use crate::terminal::{print, say};

#[derive(Args, Debug)]
pub(crate) struct Cycle {
    /// Cycle: a CSV with time and speed (`time_s,speed_mps`, or units in brackets; m/s, km/h or mph)
    file: PathBuf,
    /// Only the first seconds of the cycle
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Units in which the road-load coefficients 34.7, 0.289, 0.01705 of thesis Table 3.3 are read
    #[arg(long, value_enum, default_value_t = Units::LbfMph)]
    road_load: Units,
    /// Slope of the road, rise over distance along the ground (0.05: 5 %)
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    grade: f64,
    /// Write speeds, torque, fuel and engine inputs to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write a report with plots
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// Readings of Table 3.3.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Units {
    LbfMph,
    NewtonMps,
    NewtonKmh,
}

impl Cycle {
    /// Drives the cycle, shows the result.
    pub(crate) fn run(&self, engine: &Engine) -> Result<Exit, Failure> {
        let units = match self.road_load {
            Units::LbfMph => LoadUnits::LbfMph,
            Units::NewtonMps => LoadUnits::NewtonMps,
            Units::NewtonKmh => LoadUnits::NewtonKmh,
        };
        let name = self.file.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let cycle = cycle::read(&self.file, self.seconds, &say)?;
        let spec = cycle::Spec { name, cycle, units, grade: self.grade };
        let found = Progress::new(false).during(|watch| cycle::run(engine, &spec, watch))?;
        let rows: Vec<Vec<String>> =
            found.facts.iter().map(|f| vec![f.name.into(), f.text.clone(), f.unit.into()]).collect();
        print(&table::render(&["quantity", "value", "unit"], &rows, &[1]))?;
        if let Some(path) = &self.csv {
            cycle::csv(path, &found.log)?;
        }
        page(self.report.as_deref(), || cycle::report(&spec, &engine.set, &found))?;
        // A part of a cycle is no result of it.
        Ok(exit(!found.interrupted))
    }
}
