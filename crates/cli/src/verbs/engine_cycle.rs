//! `dynocal engine cycle`: the engine in a car, driven through a cycle of demanded speed.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use dynocal_files::table::{Column, Table};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::params::EngineParams;
use dynocal_plant::vehicle::{
    Car, CycleError, DriveCycle, DriveLog, DriveOptions, EngineInCar, LoadUnits, PowerSource, SteadyGrid,
    drive,
};
use dynocal_report::{Axis, Block, Panel, Report, Section, TimePlot, XyPlot, render, significant};
use indicatif::{ProgressBar, ProgressStyle};

use crate::failure::{Exit, Failure};
use crate::terminal::print;
use crate::{interrupt, table};

/// Speeds of the steady points of the controller \[rpm\], and points a speed.
const GRID_RPM: [f64; 7] = [800.0, 1200.0, 1700.0, 2300.0, 3000.0, 3800.0, 4600.0];
const GRID_TORQUES: usize = 6;
/// A row of the CSV and a point of the plots every so many steps of 20 ms.
const THIN: usize = 10;

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
    /// Slope of the road
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

/// What is wrong with the file of a cycle.
#[derive(Debug, thiserror::Error)]
enum FileError {
    #[error("{file}: column {column} is in {found}: expected {expected}")]
    Unit { file: String, column: String, found: String, expected: &'static str },
    #[error("{file}: no column of {what} ({columns}): expected a column in {expected}")]
    Column { file: String, what: &'static str, columns: String, expected: &'static str },
    #[error("{file}: {source}")]
    Cycle { file: String, source: CycleError },
    #[error("--seconds {0}: expected at least 2")]
    Seconds(f64),
}

impl Cycle {
    /// Measures the controller's grid, drives the cycle, shows the result.
    pub(crate) fn run(&self, set: &str, params: &EngineParams) -> Result<Exit, Failure> {
        interrupt::install()?;
        let cycle = self.cycle()?;
        let units = match self.road_load {
            Units::LbfMph => LoadUnits::LbfMph,
            Units::NewtonMps => LoadUnits::NewtonMps,
            Units::NewtonKmh => LoadUnits::NewtonKmh,
        };
        let mut car = Car { grade: self.grade, ..Car::thesis() };
        car.road_load.units = units;
        let engine = VirtualEngine::new(params)?;
        let bar = bar(cycle.duration_s());
        bar.set_message("steady points for the controller");
        let grid = SteadyGrid::measure(&engine, &GRID_RPM, GRID_TORQUES)?;
        bar.set_message("driving");
        let mut source = EngineInCar::with_grid(engine, grid);
        let log = drive(
            &car,
            &cycle,
            &mut Counted { source: &mut source, bar: &bar },
            DriveOptions::default(),
            &|| interrupt::asked(),
        )?;
        bar.finish_and_clear();
        let facts = facts(&log, &cycle);
        let rows: Vec<Vec<String>> = facts
            .iter()
            .map(|(name, value, unit)| vec![(*name).into(), value.clone(), (*unit).into()])
            .collect();
        print(&table::render(&["quantity", "value", "unit"], &rows, &[1]))?;
        if let Some(path) = &self.csv {
            csv(path, &log)?;
        }
        if let Some(path) = &self.report {
            let name = self.file.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            dynocal_files::atomic::write(path, render(&report(&name, set, &log, &facts))?.as_bytes())?;
            print(&format!("\n{}\n", path.display()))?;
        }
        // A part of a cycle is no result of it.
        Ok(if interrupt::asked() { Exit::NotValid } else { Exit::Done })
    }

    fn cycle(&self) -> Result<DriveCycle, Failure> {
        let data = dynocal_files::dataset::read_table(&self.file, None)?;
        let column = |what, accepted: &[&str], expected| {
            let is = |c: &&Column| c.unit.as_ref().is_some_and(|(u, _)| accepted.contains(&u.as_str()));
            data.columns.iter().find(is).ok_or_else(|| self.missing(&data, what, expected))
        };
        let time = column("time", &["s"], "s (time_s, or time [s])")?;
        let speed =
            column("speed", &["m/s", "km/h", "mph"], "m/s, km/h or mph (speed_mps, or speed [km/h])")?;
        let factor = match speed.unit.as_ref().map_or("", |(u, _)| u.as_str()) {
            "km/h" => 1.0 / 3.6,
            "mph" => 0.447_04,
            _ => 1.0,
        };
        let times = data.numbers(&time.name, 0, data.rows())?;
        let speeds = data.numbers(&speed.name, 0, data.rows())?.iter().map(|v| v * factor).collect();
        let file = self.file.display().to_string();
        let cycle =
            DriveCycle::new(times.to_vec(), speeds).map_err(|source| FileError::Cycle { file, source })?;
        match self.seconds {
            Some(s) if s.is_nan() || s < 2.0 => Err(FileError::Seconds(s).into()),
            Some(s) => Ok(cycle.shortened(s)),
            None => Ok(cycle),
        }
    }

    /// Says which units the columns have when none fits.
    fn missing(&self, data: &Table, what: &'static str, expected: &'static str) -> FileError {
        let file = self.file.display().to_string();
        if let Some(c) = data.columns.iter().find(|c| c.name.to_lowercase().starts_with(what)) {
            let found = c.unit.as_ref().map_or("no unit".into(), |(u, _)| u.clone());
            return FileError::Unit { file, column: c.name.clone(), found, expected };
        }
        let names: Vec<&str> = data.columns.iter().map(|c| c.name.as_str()).collect();
        FileError::Column { file, what, columns: names.join(", "), expected }
    }
}

/// Moves the bar along with the engine.
struct Counted<'a> {
    source: &'a mut EngineInCar,
    bar: &'a ProgressBar,
}

impl PowerSource for Counted<'_> {
    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64) {
        self.source.limits_nm(speed_rpm)
    }

    fn step(
        &mut self,
        demand_nm: f64,
        speed_rpm: f64,
        dt_s: f64,
    ) -> Result<dynocal_plant::vehicle::Power, dynocal_plant::error::PlantError> {
        self.bar.inc((1e3 * dt_s) as u64);
        self.source.step(demand_nm, speed_rpm, dt_s)
    }
}

/// A bar over the milliseconds of the cycle, invisible where standard error is no terminal.
fn bar(seconds: f64) -> ProgressBar {
    let bar = ProgressBar::new((1e3 * seconds) as u64);
    if let Ok(style) =
        ProgressStyle::with_template("{msg:32} {bar:32} {percent:>3} %  {elapsed} gone, about {eta} left")
    {
        bar.set_style(style);
    }
    bar
}

/// Name, value, unit.
type Fact = (&'static str, String, &'static str);

fn facts(log: &DriveLog, cycle: &DriveCycle) -> Vec<Fact> {
    let seconds = log.time_s.last().copied().unwrap_or(0.0);
    let km = log.distance_m / 1e3;
    let share = |n: usize| 100.0 * n as f64 / log.time_s.len().max(1) as f64;
    let step_s = seconds / log.time_s.len().max(1) as f64;
    let burning: Vec<f64> = log.power.iter().map(|p| p.lambda).filter(|l| l.is_finite()).collect();
    let off = burning.iter().filter(|l| (**l - 1.0).abs() > 0.05).count();
    let most = log.power.iter().map(|p| p.torque_nm).fold(f64::NEG_INFINITY, f64::max);
    let rows: Vec<(&'static str, f64, usize, &'static str)> = vec![
        ("time driven", seconds, 5, "s"),
        ("of the cycle's", cycle.duration_s(), 5, "s"),
        ("distance", km, 5, "km"),
        ("fuel", log.fuel_g, 5, "g"),
        ("fuel, 0.745 kg/l", log.litres_per_100_km().unwrap_or(f64::NAN), 4, "l/100 km"),
        ("CO2, 3.09 g/g fuel", 3.09 * log.fuel_g / km, 4, "g/km"),
        ("engine work", log.engine_work_j / 3.6e6, 4, "kWh"),
        ("greatest torque", most, 4, "Nm"),
        ("speed error, RMS", 3.6 * log.rms_error_mps(), 3, "km/h"),
        ("outside 2 km/h within 1 s", log.outside as f64 * step_s, 3, "s"),
        ("lambda off by more than 0.05", share(off), 3, "% of time"),
        ("fuel cut off", share(log.power.iter().filter(|p| p.inj_mg == 0.0).count()), 3, "% of time"),
    ];
    rows.into_iter().map(|(n, v, d, u)| (n, significant(v, d), u)).collect()
}

/// Every `THIN`-th step.
fn thin(values: impl Iterator<Item = f64>) -> Vec<f64> {
    values.step_by(THIN).collect()
}

fn csv(path: &Path, log: &DriveLog) -> Result<(), Failure> {
    let power = |f: fn(&dynocal_plant::vehicle::Power) -> f64| thin(log.power.iter().map(f));
    let copy = |v: &[f64]| thin(v.iter().copied());
    let columns: [(&str, &str, Vec<f64>); 13] = [
        ("time", "s", copy(&log.time_s)),
        ("speed_demand", "m/s", copy(&log.demand_mps)),
        ("speed", "m/s", copy(&log.speed_mps)),
        ("engine_speed", "rpm", copy(&log.engine_rpm)),
        ("gear", "-", copy(&log.gear)),
        ("torque_demand", "Nm", copy(&log.demand_nm)),
        ("brake", "Nm", copy(&log.brake_nm)),
        ("torque", "Nm", power(|p| p.torque_nm)),
        ("fuel", "kg/h", power(|p| p.fuel_kg_h)),
        // Lambda without fuel is written as 0: files hold finite numbers.
        ("lambda", "-", power(|p| if p.lambda.is_finite() { p.lambda } else { 0.0 })),
        ("throttle", "deg", power(|p| p.throttle_deg)),
        ("spark", "deg", power(|p| p.spark_deg)),
        ("inj", "mg", power(|p| p.inj_mg)),
    ];
    let columns: Vec<(&str, &str, &[f64])> = columns.iter().map(|(n, u, v)| (*n, *u, v.as_slice())).collect();
    dynocal_files::csv_io::write_columns(path, &columns)?;
    Ok(())
}

fn report(name: &str, set: &str, log: &DriveLog, facts: &[Fact]) -> Report {
    let mut report = Report::new(format!("Drive cycle {name}"))
        .subtitle(format!("Virtual engine, parameter set {set}, in the car of thesis Table 3.3"));
    for (what, value, unit) in facts {
        report = report.fact(format!("{what} [{unit}]"), value.clone());
    }
    let time = thin(log.time_s.iter().copied());
    let kmh = |v: &[f64]| thin(v.iter().map(|x| 3.6 * x));
    let speed = Panel::new("Speed", "km/h").demand(kmh(&log.demand_mps)).line("Car", kmh(&log.speed_mps));
    let gear = Panel::new("Gear", "-").held("Gear", thin(log.gear.iter().copied()));
    let engine = Panel::new("Engine speed", "rpm").line("Engine", thin(log.engine_rpm.iter().copied()));
    let drive = TimePlot::new("Car", time.clone()).panel(speed).panel(gear).panel(engine);
    let power = |f: fn(&dynocal_plant::vehicle::Power) -> f64| thin(log.power.iter().map(f));
    let torque = Panel::new("Torque", "Nm")
        .demand(thin(log.demand_nm.iter().copied()))
        .line("Engine", power(|p| p.torque_nm));
    let lambda = Panel::new("Lambda", "-")
        .line("Lambda", power(|p| if p.lambda.is_finite() { p.lambda.min(2.0) } else { f64::NAN }));
    let fuel = Panel::new("Fuel", "kg/h").line("Fuel", power(|p| p.fuel_kg_h));
    let throttle = Panel::new("Throttle", "deg").line("Throttle", power(|p| p.throttle_deg));
    let inside = TimePlot::new("Engine", time)
        .panel(torque)
        .panel(lambda)
        .panel(fuel)
        .panel(throttle)
        .caption("Lambda has gaps where fuel is cut off.");
    let points: Block =
        XyPlot::new("Where the engine runs", Axis::new("Engine speed", "rpm"), Axis::new("Torque", "Nm"))
            .points("Every 0.2 s", thin(log.engine_rpm.iter().copied()), power(|p| p.torque_nm))
            .into();
    let text = "Throttle and spark come from steady points with the spark of the static rule, fuel from the air of \
                the last cycle; the demanded torque is trimmed by an integral. Overrun cuts the fuel off.";
    report
        .section(Section::new("Drive").block(drive))
        .section(Section::new("Engine").text(text).block(inside).block(points))
}
