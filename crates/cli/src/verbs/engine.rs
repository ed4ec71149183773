//! `dynocal engine point|sweep|motored|map|full-load|transient|cycle`: the virtual engine without a spec.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches, Subcommand, ValueEnum};
use dynocal_report::{Axis, Block, Report, Section, XyPlot, render};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::outputs::Outputs;
use dynocal_plant::statics::{SettleOptions, Target, best_spark, settle, spark_guess_deg, steady};
use dynocal_plant::trace::CylinderTrace;

use super::Verb;
use super::engine_cycle::Cycle;
use super::engine_transient::Transient;
use super::engine_map::{FullLoad, Map};
use crate::terminal::print;
use crate::failure::{Exit, Failure};
use crate::table;
use dynocal_plant::plants;

pub(crate) const VERB: Verb =
    Verb { name: "engine", describe: |c| Engine::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Run the virtual engine at a steady point, over a sweep of one input, a map or full load, motored, or in a car";

/// Time at constant inputs before the outputs are averaged, and the time of averaging (thesis 6.6.1) \[s\].
const SETTLE_S: f64 = 9.0;
const AVERAGE_S: f64 = 1.0;

#[derive(Args, Debug)]
struct Engine {
    /// Parameter set: a name (`dynocal list parameters`), `perturbed:SEED`, or a file like crates/plant/parameters/*.toml
    #[arg(long, global = true, default_value = "thesis", value_name = "NAME|FILE.toml")]
    parameters: String,
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// One steady point, at given inputs or at a torque
    Point {
        #[command(flatten)]
        at: At,
        #[command(flatten)]
        files: Files,
    },
    /// One input in equal steps, the others held
    Sweep {
        /// Input that moves
        #[arg(value_enum)]
        input: Input,
        /// First value
        #[arg(long, allow_negative_numbers = true)]
        from: f64,
        /// Last value
        #[arg(long, allow_negative_numbers = true)]
        to: f64,
        /// Number of values
        #[arg(long, default_value_t = 11, value_parser = clap::value_parser!(u32).range(2..=1000))]
        points: u32,
        #[command(flatten)]
        at: At,
        #[command(flatten)]
        files: Files,
    },
    /// Without fuel
    Motored {
        /// Speed
        #[arg(long, default_value_t = 2000.0)]
        speed_rpm: f64,
        /// Throttle angle
        #[arg(long, default_value_t = 90.0)]
        throttle_deg: f64,
        #[command(flatten)]
        files: Files,
    },
    /// On its bed, with inputs from a file
    Transient(Transient),
    /// Grid of speed and torque as an engine controller holds it: boost, knock limit, exhaust temperature
    Map(Map),
    /// Most torque over speed within the limits
    FullLoad(FullLoad),
    /// In a car that follows a drive cycle
    Cycle(Cycle),
}

#[derive(Args, Debug, Clone, Copy)]
struct At {
    /// Speed
    #[arg(long, default_value_t = 2000.0)]
    speed_rpm: f64,
    /// Brake torque to settle to; throttle and fuel follow
    #[arg(long, allow_negative_numbers = true, conflicts_with_all = ["inj_mg", "throttle_deg"])]
    torque_nm: Option<f64>,
    /// Lambda to settle to
    #[arg(long, default_value_t = 1.0, requires = "torque_nm")]
    lambda: f64,
    /// Fuel per cylinder and cycle
    #[arg(long)]
    inj_mg: Option<f64>,
    /// Throttle angle
    #[arg(long)]
    throttle_deg: Option<f64>,
    /// Spark advance before firing dead centre; with --torque-nm and without this, the spark of least fuel
    #[arg(long, allow_negative_numbers = true)]
    spark_deg: Option<f64>,
}

#[derive(Args, Debug, Clone)]
struct Files {
    /// Write the table to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write a report with p-V diagram and traces of the first cylinder at the last point
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// An input that can be swept.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Input {
    Speed,
    Throttle,
    Spark,
    Inj,
    IntakeCam,
    ExhaustCam,
    Wastegate,
    Egr,
    WiebeM,
}

impl Input {
    fn set(self, u: &mut Inputs, value: f64) {
        *match self {
            Input::Speed => &mut u.speed_rpm,
            Input::Throttle => &mut u.throttle_deg,
            Input::Spark => &mut u.spark_deg,
            Input::Inj => &mut u.injection_mg,
            Input::IntakeCam => &mut u.intake_mop_deg_btdc,
            Input::ExhaustCam => &mut u.exhaust_mop_deg_atdc,
            Input::Wastegate => &mut u.wastegate_mm,
            Input::Egr => &mut u.egr_mm,
            Input::WiebeM => &mut u.wiebe_m,
        } = value;
    }
}

/// Inputs and outputs of one point.
pub(super) type Point = (Inputs, Outputs);

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Engine::from_arg_matches(matches)?;
    let params = plants::parameters(&args.parameters)?;
    let mut engine = VirtualEngine::new(&params)?;
    let (title, points, files) = match args.what {
        What::Transient(mut transient) => {
            transient.parameters = args.parameters;
            return transient.run();
        }
        What::Cycle(cycle) => return cycle.run(&args.parameters, &params),
        What::Map(map) => return map.run(&args.parameters, &params),
        What::FullLoad(load) => return load.run(&args.parameters, &params),
        What::Point { at, files } => ("Engine: point", vec![at.point(&mut engine)?], files),
        What::Sweep { input, from, to, points, at, files } => {
            let (mut u, _) = at.point(&mut engine)?;
            let mut all = Vec::new();
            for k in 0..points {
                input.set(&mut u, from + (to - from) * f64::from(k) / f64::from(points - 1));
                all.push((u, steady(&mut engine, u, SETTLE_S, AVERAGE_S)?));
            }
            ("Engine: sweep", all, files)
        }
        What::Motored { speed_rpm, throttle_deg, files } => {
            let u = Inputs { speed_rpm, throttle_deg, injection_mg: 0.0, ..Inputs::default() };
            ("Engine: motored", vec![(u, steady(&mut engine, u, SETTLE_S, AVERAGE_S)?)], files)
        }
    };
    show(&points)?;
    if let Some(path) = &files.csv {
        csv(path, &points)?;
    }
    if let Some(path) = &files.report {
        let trace = CylinderTrace::record(&mut engine, 0)?;
        let page = render(&report(title, &args.parameters, &points, &trace))?;
        dynocal_files::atomic::write(path, page.as_bytes())?;
        print(&format!("\n{}\n", path.display()))?;
    }
    Ok(Exit::Done)
}

impl At {
    fn point(self, engine: &mut VirtualEngine) -> Result<Point, PlantError> {
        let speed_rpm = self.speed_rpm;
        if let Some(torque_nm) = self.torque_nm {
            let target = Target { speed_rpm, torque_nm, lambda: self.lambda };
            let options = SettleOptions::default();
            let point = match self.spark_deg {
                Some(spark) => settle(engine, target, spark, options)?,
                None => best_spark(engine, target, spark_guess_deg(speed_rpm, torque_nm), options)?,
            };
            return Ok((point.inputs, point.outputs));
        }
        let d = Inputs::default();
        let u = Inputs {
            speed_rpm,
            throttle_deg: self.throttle_deg.unwrap_or(d.throttle_deg),
            injection_mg: self.inj_mg.unwrap_or(d.injection_mg),
            spark_deg: self.spark_deg.unwrap_or(d.spark_deg),
            ..d
        };
        Ok((u, steady(engine, u, SETTLE_S, AVERAGE_S)?))
    }
}

/// A column: name, unit, significant digits on the terminal, value.
pub(super) type Quantity = (&'static str, &'static str, usize, fn(&Point) -> f64);

pub(super) static QUANTITIES: &[Quantity] = &[
    ("speed", "rpm", 4, |p| p.0.speed_rpm),
    ("throttle", "deg", 4, |p| p.0.throttle_deg),
    ("spark", "deg", 4, |p| p.0.spark_deg),
    ("inj", "mg", 4, |p| p.0.injection_mg),
    ("intake_cam", "deg", 4, |p| p.0.intake_mop_deg_btdc),
    ("exhaust_cam", "deg", 4, |p| p.0.exhaust_mop_deg_atdc),
    ("wastegate", "mm", 3, |p| p.0.wastegate_mm),
    ("egr", "mm", 3, |p| p.0.egr_mm),
    ("wiebe_m", "-", 3, |p| p.0.wiebe_m),
    ("torque", "Nm", 5, |p| p.1.torque_nm),
    ("lambda", "-", 4, |p| p.1.lambda),
    ("map", "kPa", 4, |p| p.1.map_kpa),
    ("egt", "degC", 4, |p| p.1.egt_k - 273.15),
    ("air", "g/s", 4, |p| p.1.air_g_s),
    ("fuel", "kg/h", 4, |p| p.1.fuel_kg_h),
    ("bsfc", "g/kWh", 4, |p| p.1.bsfc_g_kwh),
    ("imep", "bar", 4, |p| p.1.imep_bar),
    ("pmep", "bar", 3, |p| p.1.pmep_bar),
    ("fmep", "bar", 3, |p| p.1.fmep_bar),
    ("pmax", "bar", 4, |p| p.1.pmax_bar),
    ("ca50", "deg", 3, |p| p.1.ca50_deg),
    ("burn_10_90", "deg", 4, |p| p.1.burn_deg),
    ("residual", "-", 3, |p| p.1.residual),
    ("vol_eff", "-", 3, |p| p.1.volumetric_efficiency),
    ("boost", "kPa", 4, |p| p.1.boost_kpa),
    ("exhaust", "kPa", 4, |p| p.1.exhaust_kpa),
    ("turbo", "rpm", 4, |p| p.1.turbo_rpm),
    ("knock", "-", 3, |p| p.1.knock),
    ("egr_rate", "-", 3, |p| p.1.egr_rate),
    ("no", "ppm", 3, |p| p.1.no_ppm),
    ("co", "%", 3, |p| p.1.co_pct),
    ("hc", "ppm", 3, |p| p.1.hc_ppm),
];

/// One quantity per line for a few points, otherwise one point per line with what is read most.
pub(super) fn show(points: &[Point]) -> Result<(), Failure> {
    const SHORT: [&str; 11] =
        ["speed", "throttle", "spark", "inj", "torque", "lambda", "map", "egt", "bsfc", "pmax", "ca50"];
    let text = |q: &Quantity, p: &Point| dynocal_report::significant((q.3)(p), q.2);
    if let [p] = points {
        let rows: Vec<Vec<String>> =
            QUANTITIES.iter().map(|q| vec![q.0.into(), text(q, p), q.1.into()]).collect();
        return print(&table::render(&["quantity", "value", "unit"], &rows, &[1]));
    }
    let columns: Vec<&Quantity> = QUANTITIES.iter().filter(|q| SHORT.contains(&q.0)).collect();
    let header: Vec<String> = columns.iter().map(|q| format!("{} [{}]", q.0, q.1)).collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let rows: Vec<Vec<String>> =
        points.iter().map(|p| columns.iter().map(|q| text(q, p)).collect()).collect();
    let right: Vec<usize> = (0..columns.len()).collect();
    print(&table::render(&header, &rows, &right))
}

pub(super) fn csv(path: &Path, points: &[Point]) -> Result<(), Failure> {
    let values: Vec<Vec<f64>> = QUANTITIES.iter().map(|q| points.iter().map(q.3).collect()).collect();
    let columns: Vec<(&str, &str, &[f64])> =
        QUANTITIES.iter().zip(&values).map(|(q, v)| (q.0, q.1, v.as_slice())).collect();
    dynocal_files::csv_io::write_columns(path, &columns)?;
    Ok(())
}

fn report(title: &str, set: &str, points: &[Point], t: &CylinderTrace) -> Report {
    let mut report = Report::new(title).subtitle(format!("Virtual engine, parameter set {set}"));
    if let Some(p) = points.last() {
        for q in QUANTITIES {
            report = report.fact(format!("{} [{}]", q.0, q.1), dynocal_report::significant((q.3)(p), q.2));
        }
    }
    let litre: Vec<f64> = t.volume_m3.iter().map(|v| 1e3 * v).collect();
    let bar: Vec<f64> = t.pressure_pa.iter().map(|p| 1e-5 * p).collect();
    let log = |v: &[f64]| v.iter().map(|x| x.log10()).collect::<Vec<f64>>();
    let pressure = || Axis::new("Pressure", "bar");
    let angle = || Axis::new("Angle after firing dead centre", "deg");
    let pv: Vec<Block> = vec![
        XyPlot::new("p-V diagram", Axis::new("Volume", "l"), pressure())
            .line("Cylinder 1", litre.clone(), bar.clone())
            .into(),
        XyPlot::new(
            "Logarithmic",
            Axis::new("log10 of volume in l", ""),
            Axis::new("log10 of pressure in bar", ""),
        )
        .line("Cylinder 1", log(&litre), log(&bar))
        .into(),
    ];
    let curve = |name: &str, axis: Axis, y: Vec<f64>| -> Block {
        XyPlot::new(name, angle(), axis).line("Cylinder 1", t.angle_deg.clone(), y).into()
    };
    let mg = t.mass_kg.iter().map(|m| 1e6 * m).collect();
    let traces = vec![
        curve("Pressure", pressure(), bar),
        curve("Temperature", Axis::new("Temperature", "K"), t.temperature_k.clone()),
        curve("Gas in the cylinder", Axis::new("Mass", "mg"), mg),
        curve("Burned share", Axis::new("Share", ""), t.burned.clone()),
        heat_release(t),
    ];
    let text = "First cylinder, one cycle at the last point.";
    let traces = traces.into_iter().fold(Section::new("Traces").text(text), Section::block);
    report.section(Section::new("Pressure and volume").text(text).columns(pv)).section(traces)
}

/// Apparent heat release between intake closing and exhaust opening.
fn heat_release(t: &CylinderTrace) -> Block {
    const GAMMA: f64 = 1.3;
    let rate = t.heat_release_j_deg(GAMMA);
    let closed = t.angle_deg.iter().zip(rate).filter(|(a, _)| (-60.0..100.0).contains(*a));
    let (angle, rate): (Vec<f64>, Vec<f64>) = closed.map(|(a, q)| (*a, q)).unzip();
    XyPlot::new(
        "Apparent heat release",
        Axis::new("Angle after firing dead centre", "deg"),
        Axis::new("Rate", "J/deg"),
    )
    .line("Cylinder 1", angle, rate)
    .caption("From pressure and volume with a constant ratio of heat capacities of 1.3: net of wall heat.")
    .into()
}
