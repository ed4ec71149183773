//! A plan as two files, and the record that comes back.
//!
//! `NAME.plan.csv` holds the samples: time in s, every channel as `name [unit]`, every demand as `<output>_demand [unit]`.
//! `NAME.plan.json` holds what a table cannot: sample time, ranges, rates, loops with their gains, limits, settling. Both
//! together read back to the same plan, bit for bit.

use std::path::{Path, PathBuf};

use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLimit, PlanLoop, demand_name};
use serde::{Deserialize, Serialize};

use crate::dataset::{ChannelSpec, Layout, STAMPS, Select, Time, datasets, read_table};
use crate::error::FilesError;
use crate::measurement::csv_io;
use crate::table::Table;
use crate::{json, units};

/// Schema name of the JSON file.
pub const PLAN_SCHEMA: &str = "dynocal/plan";
/// Version of the JSON file.
pub const PLAN_VERSION: u32 = 1;

/// What stands beside the samples.
#[derive(Serialize, Deserialize)]
struct Stored {
    name: String,
    /// In words, for who plays it: `closed loop: torque by throttle`.
    mode: String,
    sample_time_s: f64,
    samples: usize,
    settle_s: f64,
    channels: Vec<StoredChannel>,
    demands: Vec<StoredDemand>,
    loops: Vec<PlanLoop>,
    limits: Vec<PlanLimit>,
    /// Recorded outputs; empty: all.
    outputs: Vec<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredChannel {
    name: String,
    unit: String,
    lower: Option<f64>,
    upper: Option<f64>,
    rate_per_s: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredDemand {
    output: String,
    unit: String,
}

/// Writes `NAME.plan.csv` and `NAME.plan.json` into `folder`; returns the path of the CSV file.
///
/// # Errors
/// [`FilesError::Write`]; [`FilesError::Malformed`] for a plan with faults or a name that is no file name.
///
/// # Examples
/// ```
/// use dynocal_ident::pi::PiGains;
/// use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
/// let channel = PlanChannel::free("throttle", "deg", vec![12.0, 12.1, 1.0 / 3.0]).within(0.0, 60.0);
/// let demand = PlanDemand { output: "torque".into(), unit: "Nm".into(), values: vec![50.0; 3] };
/// let plan = Plan::open_loop("hold", 0.03, vec![channel])
///     .with_loops(vec![demand], vec![PlanLoop::closed("torque", "throttle", PiGains { ki: 0.3, kp: 0.05 })])
///     .settled(3.0);
/// let folder = tempfile::tempdir()?;
/// let csv = dynocal_files::plan::write(folder.path(), &plan)?;
/// assert!(csv.ends_with("hold.plan.csv"));
/// assert_eq!(dynocal_files::plan::read(&csv)?, plan);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(folder: &Path, plan: &Plan) -> Result<PathBuf, FilesError> {
    let path = |ending: &str| folder.join(format!("{}.plan.{ending}", plan.name));
    let refused = |reason: String| FilesError::Malformed {
        path: path("csv").display().to_string(),
        format: "plan",
        reason,
    };
    if plan.name.is_empty() || plan.name.starts_with('.') || plan.name.contains(['/', '\\', ':', '\0']) {
        return Err(refused(format!("its name `{}` cannot be that of a file", plan.name)));
    }
    faultless(plan).map_err(refused)?;
    let finite = |v: f64| Some(v).filter(|v| v.is_finite());
    let channel = |c: &PlanChannel| StoredChannel {
        name: c.name.clone(),
        unit: c.unit.clone(),
        lower: finite(c.lower),
        upper: finite(c.upper),
        rate_per_s: c.rate_per_s,
    };
    let stored = Stored {
        name: plan.name.clone(),
        mode: plan.mode(),
        sample_time_s: plan.sample_time_s,
        samples: plan.len(),
        settle_s: plan.settle_s,
        channels: plan.channels.iter().map(channel).collect(),
        demands: plan
            .demands
            .iter()
            .map(|d| StoredDemand { output: d.output.clone(), unit: d.unit.clone() })
            .collect(),
        loops: plan.loops.clone(),
        limits: plan.limits.clone(),
        outputs: plan.outputs.clone(),
    };
    json::write_versioned(&path("json"), PLAN_SCHEMA, PLAN_VERSION, &stored)?;
    csv_io::write_dataset(&path("csv"), &plan.as_dataset())?;
    Ok(path("csv"))
}

fn faultless(plan: &Plan) -> Result<(), String> {
    let faults: Vec<String> = plan.check().iter().map(ToString::to_string).collect();
    if faults.is_empty() { Ok(()) } else { Err(faults.join("; ")) }
}

/// The two files of a plan, given either of them; none where the name is not `NAME.plan.csv` or `NAME.plan.json`.
pub fn files(path: &Path) -> Option<(PathBuf, PathBuf)> {
    let name = path.file_name()?.to_str()?;
    let stem = name.strip_suffix(".plan.csv").or_else(|| name.strip_suffix(".plan.json"))?;
    let file = |ending: &str| path.with_file_name(format!("{stem}.plan.{ending}"));
    Some((file("csv"), file("json")))
}

/// Reads a plan from its two files, given either of them.
///
/// # Errors
/// [`FilesError`]: a file is missing, a column or unit is not that of the JSON file, a cell is no number, stamps are not
/// those of the sample time, or the plan has faults.
pub fn read(path: &Path) -> Result<Plan, FilesError> {
    let (csv, json_path) = files(path).ok_or_else(|| FilesError::Malformed {
        path: path.display().to_string(),
        format: "plan",
        reason: "a plan is two files, NAME.plan.csv and NAME.plan.json".into(),
    })?;
    let stored: Stored = json::read_versioned(&json_path, PLAN_SCHEMA, PLAN_VERSION)?;
    let refused = |path: &Path, reason: String| FilesError::Malformed {
        path: path.display().to_string(),
        format: "plan",
        reason,
    };
    let table = csv_io::read(&csv)?;
    if table.rows() != stored.samples {
        let (found, expected, json) = (table.rows(), stored.samples, json_path.display());
        return Err(refused(&csv, format!("found {found} samples, expected {expected} as in {json}")));
    }
    stamps(&table, stored.sample_time_s)?;
    let mut known = vec!["time".to_string()];
    let mut column = |name: String, unit: &str| -> Result<Vec<f64>, FilesError> {
        let values = values(&table, &name, unit)?;
        known.push(name);
        Ok(values)
    };
    let mut channels = Vec::new();
    for c in stored.channels {
        channels.push(PlanChannel {
            values: column(c.name.clone(), &c.unit)?,
            name: c.name,
            unit: c.unit,
            lower: c.lower.unwrap_or(f64::NEG_INFINITY),
            upper: c.upper.unwrap_or(f64::INFINITY),
            rate_per_s: c.rate_per_s,
        });
    }
    let mut demands = Vec::new();
    for d in stored.demands {
        let values = column(demand_name(&d.output), &d.unit)?;
        demands.push(PlanDemand { output: d.output, unit: d.unit, values });
    }
    if let Some(extra) = table.columns.iter().find(|c| !known.contains(&c.name)) {
        let reason =
            format!("column `{}` is neither a channel nor a demand of {}", extra.name, json_path.display());
        return Err(refused(&csv, reason));
    }
    let plan = Plan {
        name: stored.name,
        sample_time_s: stored.sample_time_s,
        channels,
        demands,
        loops: stored.loops,
        limits: stored.limits,
        settle_s: stored.settle_s,
        outputs: stored.outputs,
    };
    faultless(&plan).map_err(|reason| refused(&json_path, reason))?;
    Ok(plan)
}

/// All cells of a column in its unit.
fn values(table: &Table, name: &str, unit: &str) -> Result<Vec<f64>, FilesError> {
    let column = table.column(name)?;
    let expected = units::normalise(unit);
    match &column.unit {
        Some((found, _)) if *found != expected => Err(FilesError::Unit {
            path: table.file.clone(),
            column: name.into(),
            found: found.clone(),
            expected,
            hint: " as in the JSON file".into(),
        }),
        _ => Ok(table.numbers(name, 0, table.rows())?.to_vec()),
    }
}

/// The stamps must be those of the sample time, to 1 % of it: a plan that was cut out of another one says so.
fn stamps(table: &Table, sample_time_s: f64) -> Result<(), FilesError> {
    let stamps = table.numbers("time", 0, table.rows())?;
    let slack = |t: f64| 0.01 * sample_time_s + 1e-9 * t.abs();
    match stamps.windows(2).position(|w| (w[1] - w[0] - sample_time_s).abs() > slack(w[1])) {
        None => Ok(()),
        Some(k) => Err(FilesError::NonUniformTime {
            path: table.file.clone(),
            place: table.place(k + 1),
            column: "time".into(),
            found_s: stamps[k + 1] - stamps[k],
            expected_s: sample_time_s,
        }),
    }
}

/// Unit of an output where the plan says one.
fn output_unit(plan: &Plan, output: &str) -> Option<String> {
    let limits = plan.limits.iter().find(|l| l.output == output).map(|l| l.unit.clone());
    plan.demand(output).map(|d| d.unit.clone()).or(limits)
}

/// The columns that a record of `plan` must have beside the time, in words: `inj [mg], throttle [deg], torque [Nm]`.
pub fn record_columns(plan: &Plan) -> String {
    let inputs = plan.channels.iter().map(|c| format!("{} [{}]", c.name, c.unit));
    let outputs = plan.outputs.iter().map(|o| match output_unit(plan, o) {
        Some(unit) => format!("{o} [{unit}]"),
        None => format!("{o} with its unit"),
    });
    let all: Vec<String> = inputs.chain(outputs).collect();
    all.join(", ")
}

/// Reads the record that a bed made of `plan`: its channels as inputs, its outputs (all other columns with a unit where the
/// plan names none), the rest as auxiliary channels, among them the stamps in s as [`STAMPS`]. Columns in another unit are
/// converted where that is exact. What of it is not what the plan asked for, `dynocal_ident::play::check_record` says.
///
/// # Errors
/// [`FilesError`]: a column or unit is missing, a cell is no number, stamps do not increase.
pub fn read_record(path: &Path, plan: &Plan) -> Result<Dataset, FilesError> {
    read_record_told(path, plan, &|_| ())
}

/// As [`read_record`]; what was decided or lost while the file was read goes to `tell`.
///
/// # Errors
/// As [`read_record`].
pub fn read_record_told(path: &Path, plan: &Plan, tell: &dyn Fn(&str)) -> Result<Dataset, FilesError> {
    let table = read_table(path, None)?;
    table.notes.iter().for_each(|n| tell(n));
    let stamps = crate::measurement::time_column(&table).map_or("time", |c| c.name.as_str()).to_string();
    for name in plan.channels.iter().map(|c| &c.name).chain(&plan.outputs) {
        table.column(name)?;
    }
    let demanded: Vec<String> = plan.demands.iter().map(|d| demand_name(&d.output)).collect();
    let spec = |name: &str| {
        let channel = plan.channel(name);
        let output = plan.outputs.iter().any(|o| o == name);
        let (role, unit) = match channel {
            Some(c) => (Role::Input, Some(c.unit.clone())),
            None if demanded.iter().any(|d| d == name) => (Role::Auxiliary, None),
            None if output || plan.outputs.is_empty() => (Role::Output, output_unit(plan, name)),
            None => (Role::Auxiliary, None),
        };
        ChannelSpec { column: name.into(), name: name.into(), unit, convert: true, role }
    };
    let asked = |name: &str| plan.channel(name).is_some() || plan.outputs.iter().any(|o| o == name);
    // What nobody asked for and nobody can read is left out.
    let kept = |c: &&crate::table::Column| {
        c.name != STAMPS && c.name != stamps && (asked(&c.name) || c.unit.is_some())
    };
    let channels = table.columns.iter().filter(kept).map(|c| spec(&c.name)).collect();
    let time = Time::Stamps { column: stamps, unit: None };
    let layout = Layout { channels, time, ..Layout::default() };
    let mut record = datasets(&table, &layout, &Select::All)?.remove(0);
    record.name.clone_from(&plan.name);
    let stamps = record.values(STAMPS)?;
    let mut intervals: Vec<f64> = stamps.windows(2).map(|w| w[1] - w[0]).collect();
    let middle = intervals.len() / 2;
    record.sample_time_s = *intervals.select_nth_unstable_by(middle, f64::total_cmp).1;
    Ok(record)
}
