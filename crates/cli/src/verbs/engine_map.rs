//! `dynocal engine map` and `full-load`: steady points as an engine controller holds them.

use std::path::PathBuf;

use clap::Args;
use dynocal_plant::full_load::{LoadLimits, LoadPoint, load_map};
use dynocal_plant::params::EngineParams;
use dynocal_report::{Axis, Block, HeatMap, Report, Section, XyPlot, render};

use super::engine::{Point, QUANTITIES, Quantity, csv, show};
use crate::failure::{Exit, Failure};
use crate::terminal::{print, say};

#[derive(Args, Debug)]
pub(crate) struct Map {
    /// First, last speed and number of speeds
    #[arg(long, num_args = 3, value_names = ["FROM", "TO", "N"], default_values_t = [1000.0, 5000.0, 9.0])]
    speed_rpm: Vec<f64>,
    /// First, last torque and number of torques
    #[arg(long, num_args = 3, value_names = ["FROM", "TO", "N"], default_values_t = [20.0, 100.0, 5.0])]
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
    #[arg(long, default_value_t = 366.0)]
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

/// A grid that is none.
#[derive(Debug, thiserror::Error)]
#[error(
    "--{name} {from} {to} {count}: expected first below last and 2 to 100 values (1 where both are equal)"
)]
struct Grid {
    name: &'static str,
    from: f64,
    to: f64,
    count: f64,
}

fn grid(name: &'static str, given: &[f64]) -> Result<Vec<f64>, Failure> {
    let [from, to, count] = given[..] else { return Ok(given.to_vec()) };
    if from == to && count == 1.0 {
        return Ok(vec![from]);
    }
    if !(from < to && (2.0..=100.0).contains(&count) && count.fract() == 0.0) {
        return Err(Grid { name, from, to, count }.into());
    }
    Ok((0..count as usize).map(|k| from + (to - from) * k as f64 / (count - 1.0)).collect())
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

    fn finish(&self, points: &[Point], report: Report) -> Result<(), Failure> {
        if let Some(path) = &self.csv {
            csv(path, points)?;
        }
        if let Some(path) = &self.report {
            dynocal_files::atomic::write(path, render(&report)?.as_bytes())?;
            print(&format!("\n{}\n", path.display()))?;
        }
        Ok(())
    }
}

/// Points that stand, as inputs and outputs.
fn points(rows: &[Vec<LoadPoint>]) -> Vec<Point> {
    rows.iter().flatten().map(|p| (p.inputs, p.outputs)).collect()
}

fn run_grid(
    params: &EngineParams,
    speeds: &[f64],
    torques: &[f64],
    limits: &Limits,
) -> Result<Vec<Vec<LoadPoint>>, Failure> {
    let rows = load_map(params, speeds, torques, limits.load())?;
    let all: Result<Vec<Vec<LoadPoint>>, _> =
        rows.into_iter().map(|row| row.into_iter().collect::<Result<Vec<_>, _>>()).collect();
    Ok(all?)
}

/// Not valid when a point did not come to rest.
fn verdict(rows: &[Vec<LoadPoint>]) -> Exit {
    let moving: Vec<&LoadPoint> = rows.iter().flatten().filter(|p| !p.settled).collect();
    for p in &moving {
        let (n, t) = (p.request.speed_rpm, p.request.torque_nm);
        say(&format!("warning: {n} rpm, {t} Nm did not come to rest in {:.0} s", p.time_s));
    }
    if moving.is_empty() { Exit::Done } else { Exit::NotValid }
}

impl Map {
    pub(crate) fn run(&self, set: &str, params: &EngineParams) -> Result<Exit, Failure> {
        let speeds = grid("speed-rpm", &self.speed_rpm)?;
        let torques = grid("torque-nm", &self.torque_nm)?;
        let rows = run_grid(params, &speeds, &torques, &self.limits)?;
        let points = points(&rows);
        show(&points)?;
        let missed = rows.iter().flatten().filter(|p| !p.reached).count();
        let mut report = Report::new("Engine: map")
            .subtitle(format!("Virtual engine, parameter set {set}"))
            .fact("Torques that the limits do not allow", missed as f64);
        let mut section = Section::new("Maps")
            .text("Cells are empty where the limits do not allow the torque. Spark, boost and mixture as a controller holds them.");
        for (name, quantity) in [
            ("BSFC", "bsfc"),
            ("Spark", "spark"),
            ("Exhaust temperature", "egt"),
            ("Residual", "residual"),
            ("NO", "no"),
            ("Knock integral", "knock"),
        ] {
            if let Some(q) = QUANTITIES.iter().find(|q| q.0 == quantity) {
                section = section.block(heat_map(name, q, (&speeds, &torques), &rows));
            }
        }
        report = report.section(section);
        self.limits.finish(&points, report)?;
        Ok(verdict(&rows))
    }
}

/// A quantity of the table over speed and torque; points out of reach are left empty.
fn heat_map(
    title: &str,
    q: &Quantity,
    (speeds, torques): (&[f64], &[f64]),
    rows: &[Vec<LoadPoint>],
) -> Block {
    let z = (0..torques.len()).flat_map(|j| {
        rows.iter().map(move |r| if r[j].reached { (q.3)(&(r[j].inputs, r[j].outputs)) } else { f64::NAN })
    });
    HeatMap::new(
        title,
        (Axis::new("Speed", "rpm"), speeds.to_vec()),
        (Axis::new("Torque", "Nm"), torques.to_vec()),
        (Axis::new(title, q.1), z.collect()),
    )
    .contours()
    .into()
}

impl FullLoad {
    pub(crate) fn run(&self, set: &str, params: &EngineParams) -> Result<Exit, Failure> {
        let speeds = grid("speed-rpm", &self.speed_rpm)?;
        let rows = run_grid(params, &speeds, &[self.torque_nm], &self.limits)?;
        let points = points(&rows);
        show(&points)?;
        let mut section = Section::new("Full load");
        for quantity in
            ["torque", "map", "exhaust", "turbo", "spark", "ca50", "knock", "lambda", "egt", "bsfc", "pmax"]
        {
            let Some(q) = QUANTITIES.iter().find(|q| q.0 == quantity) else { continue };
            let y: Vec<f64> = points.iter().map(q.3).collect();
            section = section.block(XyPlot::new(q.0, Axis::new("Speed", "rpm"), Axis::new(q.0, q.1)).line(
                set,
                speeds.clone(),
                y,
            ));
        }
        let report = Report::new("Engine: full load")
            .subtitle(format!("Virtual engine, parameter set {set}"))
            .section(section);
        self.limits.finish(&points, report)?;
        Ok(verdict(&rows))
    }
}
