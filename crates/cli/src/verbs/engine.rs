//! `dynocal engine point|sweep|motored|map|full-load|transient|cycle|fit`: the virtual engine without a spec.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches, Subcommand, ValueEnum};
use dynocal_jobs::engine::quantities::{self, Point, QUANTITIES, Quantity};
use dynocal_jobs::engine::steady::{self, Spec};
use dynocal_jobs::engine::{self as job, store};
use dynocal_report::Report;

use super::Verb;
use super::engine_cycle::Cycle;
use super::engine_fit::Fit;
use super::engine_map::{FullLoad, Map};
use super::engine_transient::Transient;
use crate::failure::{Exit, Failure};
use crate::progress::Progress;
use crate::terminal::{print, say};
use crate::{interrupt, table};

pub(crate) const VERB: Verb =
    Verb { name: "engine", describe: |c| Engine::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Run the virtual engine at a steady point, over a sweep of one input, a map or full load, motored, in a car, or fit it to a measured map";

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
    /// Fitted to a measured map: physical constants by least squares on two thirds of its points, judged on the rest
    Fit(Fit),
}

/// Inputs that a torque settles by itself.
const GIVEN: [&str; 6] =
    ["inj_mg", "throttle_deg", "intake_cam_deg", "exhaust_cam_deg", "wastegate_mm", "egr_mm"];

#[derive(Args, Debug, Clone, Copy)]
struct At {
    /// Speed
    #[arg(long, default_value_t = 2000.0)]
    speed_rpm: f64,
    /// Brake torque to settle to; throttle and fuel follow, and boost as in full-load where they do not do
    #[arg(long, allow_negative_numbers = true, conflicts_with_all = GIVEN)]
    torque_nm: Option<f64>,
    /// Lambda to settle to [default: 1]
    #[arg(long, requires = "torque_nm", conflicts_with_all = GIVEN)]
    lambda: Option<f64>,
    /// Fuel per cylinder and cycle
    #[arg(long)]
    inj_mg: Option<f64>,
    /// Throttle angle
    #[arg(long)]
    throttle_deg: Option<f64>,
    /// Intake cam, maximum opening before gas-exchange dead centre
    #[arg(long)]
    intake_cam_deg: Option<f64>,
    /// Exhaust cam, maximum opening after gas-exchange dead centre
    #[arg(long)]
    exhaust_cam_deg: Option<f64>,
    /// Bore of the wastegate
    #[arg(long)]
    wastegate_mm: Option<f64>,
    /// Lift of the recirculation valve
    #[arg(long)]
    egr_mm: Option<f64>,
    /// Spark advance before firing dead centre; with --torque-nm and without this, the spark of least fuel
    #[arg(long, allow_negative_numbers = true)]
    spark_deg: Option<f64>,
}

#[derive(Args, Debug, Clone)]
struct Files {
    /// Write the table to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write a report; of a sweep its curves, and p-V diagram and traces of the first cylinder at the last point
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

impl From<Input> for steady::Input {
    fn from(input: Input) -> Self {
        match input {
            Input::Speed => Self::Speed,
            Input::Throttle => Self::Throttle,
            Input::Spark => Self::Spark,
            Input::Inj => Self::Injection,
            Input::IntakeCam => Self::IntakeCam,
            Input::ExhaustCam => Self::ExhaustCam,
            Input::Wastegate => Self::Wastegate,
            Input::Egr => Self::Egr,
            Input::WiebeM => Self::WiebeM,
        }
    }
}

impl From<At> for steady::At {
    fn from(at: At) -> Self {
        Self {
            speed_rpm: at.speed_rpm,
            torque_nm: at.torque_nm,
            lambda: at.lambda.unwrap_or(1.0),
            injection_mg: at.inj_mg,
            throttle_deg: at.throttle_deg,
            intake_cam_deg: at.intake_cam_deg,
            exhaust_cam_deg: at.exhaust_cam_deg,
            wastegate_mm: at.wastegate_mm,
            egr_mm: at.egr_mm,
            spark_deg: at.spark_deg,
        }
    }
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Engine::from_arg_matches(matches)?;
    interrupt::install()?;
    let engine = job::Engine::named(&args.parameters)?;
    let (spec, files) = match args.what {
        What::Transient(transient) => return transient.run(&engine),
        What::Cycle(cycle) => return cycle.run(&engine),
        What::Fit(fit) => return fit.run(&engine),
        What::Map(map) => return map.run(&engine),
        What::FullLoad(load) => return load.run(&engine),
        What::Point { at, files } => (Spec::Point(at.into()), files),
        What::Sweep { input, from, to, points, at, files } => {
            (Spec::Sweep { input: input.into(), from, to, points: points as usize, at: at.into() }, files)
        }
        What::Motored { speed_rpm, throttle_deg, files } => (Spec::Motored { speed_rpm, throttle_deg }, files),
    };
    let found = Progress::new(false).during(|watch| steady::run(&engine, &spec, watch))?;
    show(&found.points)?;
    if let (Spec::Point(at), [p]) = (&spec, &found.points[..])
        && at.torque_nm.is_some()
    {
        print(&format!("\nagain by its inputs: {}\n", again(&args.parameters, p)))?;
    }
    if let Some(path) = &files.csv {
        quantities::csv(path, &found.points)?;
    }
    page(files.report.as_deref(), || steady::report(&spec, &engine.set, &found))?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    Ok(Exit::Done)
}

/// The command that holds the inputs of a point, in full digits.
fn again(parameters: &str, p: &Point) -> String {
    let u = &p.inputs;
    let options = [
        ("speed-rpm", u.speed_rpm),
        ("throttle-deg", u.throttle_deg),
        ("spark-deg", u.spark_deg),
        ("inj-mg", u.injection_mg),
        ("intake-cam-deg", u.intake_mop_deg_btdc),
        ("exhaust-cam-deg", u.exhaust_mop_deg_atdc),
        ("wastegate-mm", u.wastegate_mm),
        ("egr-mm", u.egr_mm),
    ];
    let given = options.iter().filter(|(_, v)| v.is_finite());
    given.fold(format!("dynocal engine point --parameters {parameters}"), |c, (name, v)| format!("{c} --{name} {v}"))
}

/// Writes the page where one is asked for, and says where it is.
pub(super) fn page(path: Option<&Path>, report: impl FnOnce() -> Report) -> Result<(), Failure> {
    let Some(path) = path else { return Ok(()) };
    store::page(path, &report())?;
    Ok(print(&format!("\n{}\n", path.display()))?)
}

/// One quantity per line for a few points, otherwise one point per line with what is read most.
pub(super) fn show(points: &[Point]) -> Result<(), Failure> {
    const SHORT: [&str; 11] =
        ["speed", "throttle", "spark", "inj", "torque", "lambda", "map", "egt", "bsfc", "pmax", "ca50"];
    let text = |q: &Quantity, p: &Point| q.text(p);
    if let [p] = points {
        let rows: Vec<Vec<String>> =
            QUANTITIES.iter().map(|q| vec![q.name.into(), text(q, p), q.unit.into()]).collect();
        return Ok(print(&table::render(&["quantity", "value", "unit"], &rows, &[1]))?);
    }
    let columns: Vec<&Quantity> = QUANTITIES.iter().filter(|q| SHORT.contains(&q.name)).collect();
    let header: Vec<String> = columns.iter().map(|q| format!("{} [{}]", q.name, q.unit)).collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let rows: Vec<Vec<String>> =
        points.iter().map(|p| columns.iter().map(|q| text(q, p)).collect()).collect();
    let right: Vec<usize> = (0..columns.len()).collect();
    Ok(print(&table::render(&header, &rows, &right))?)
}
