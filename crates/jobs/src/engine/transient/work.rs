//! The bed, driven.

use std::path::Path;

use dynocal_calib::supervisor;
use dynocal_ident::data::{Channel, Role};
use dynocal_ident::plant::{Causality, Plant, PlantError, Variable};
use dynocal_ident::play::{Interruptible, PlayError, Unwatched, Watchdog, play};
use dynocal_numerics::watch::Watch;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::testbed::settings::BedOptions;

use super::file::{Drive, DriveFileError, column_of, drive};
use super::{EVERY_S, Every, MOST_VALUES, Spec, Transient};
use crate::engine::{Engine, EngineJobError};

/// Speed in rpm that stands for one that nobody gives.
const MOST_RPM: f64 = 1e4;

/// Drives the bed.
///
/// # Errors
/// [`EngineJobError`]: files, units, a bed that cannot be built, a record that would not fit into memory.
pub fn run(engine: &Engine, spec: &Spec, watch: Watch) -> Result<Transient, EngineJobError> {
    match dynocal_files::plan::files(&spec.file) {
        Some(_) => played(engine, spec, watch),
        None => driven(engine, spec, watch),
    }
}

/// Writes time, inputs and outputs.
///
/// # Errors
/// [`EngineJobError::Files`].
pub fn csv(path: &Path, found: &Transient) -> Result<(), EngineJobError> {
    let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &found.time_s)];
    columns.extend(found.channels.iter().map(|c| (c.name.as_str(), c.unit.as_str(), &c.values[..])));
    Ok(dynocal_files::csv_io::write_columns(path, &columns)?)
}

/// A file of inputs on the bed.
fn driven(engine: &Engine, spec: &Spec, watch: Watch) -> Result<Transient, EngineJobError> {
    match spec.every {
        Every::Time { every_s } if !(every_s > 0.0 && every_s <= 10.0) => {
            return Err(DriveFileError::Sample(every_s).into());
        }
        Every::Angle { every_deg } if !(every_deg > 0.0 && every_deg <= 7200.0) => {
            return Err(DriveFileError::Angle(every_deg).into());
        }
        _ => {}
    }
    let data = dynocal_files::dataset::read_table(&spec.file, None)?;
    data.notes.iter().for_each(|n| watch.note(n));
    let first = |name: &str| {
        let i = column_of(&data, name)?;
        data.numbers(&data.columns[i].name, 0, 1).ok()?.first().copied()
    };
    let mut bed = bed(engine, spec, &first)?;
    let inputs = inputs(bed.variables());
    let drive = drive(&data, &inputs)?;
    if !bed.saturates() {
        drive.within(&data, &inputs)?;
    }
    fits(spec, &bed, &inputs, &drive)?;
    bed.reset(spec.seed);
    Ok(record(&mut bed, &drive, spec.every, watch)?)
}

/// Whether the record fits into memory, before it is begun.
fn fits(spec: &Spec, bed: &EngineBed, inputs: &[Variable], drive: &Drive) -> Result<(), DriveFileError> {
    let samples = match spec.every {
        Every::Default => drive.length_s() / EVERY_S,
        Every::Time { every_s } => drive.length_s() / every_s,
        Every::Angle { every_deg } => {
            let speed = inputs.iter().position(|v| v.name == "speed");
            let column = speed.and_then(|k| drive.columns[k].as_deref()).unwrap_or(&[]);
            // A bed without a speed input may run as fast as any engine.
            let least_rpm = speed.map_or(MOST_RPM, |k| inputs[k].start);
            let most_rpm = column.iter().copied().fold(least_rpm, f64::max);
            drive.length_s() * 6.0 * most_rpm / every_deg
        }
    };
    let variables = bed.variables().len();
    if samples * variables as f64 <= MOST_VALUES {
        return Ok(());
    }
    let file = spec.file.display().to_string();
    Err(DriveFileError::Large { file, samples, variables, most: MOST_VALUES })
}

/// A plan on the bed, its limits watched by the measured values.
fn played(engine: &Engine, spec: &Spec, watch: Watch) -> Result<Transient, EngineJobError> {
    let plan = dynocal_files::plan::read(&spec.file)?;
    if spec.every != Every::Default {
        let file = spec.file.display().to_string();
        return Err(DriveFileError::Sampled { file, expected_s: plan.sample_time_s }.into());
    }
    let first = |name: &str| plan.channel(name).and_then(|c| c.applied(plan.sample_time_s).first().copied());
    let mut bed = bed(engine, spec, &first)?;
    bed.reset(spec.seed);
    let mut limits = supervisor::for_plan(&plan, &[]);
    let mut unwatched = Unwatched;
    // Without limits an event of the bed is something to report and no reason to end.
    let watchdog: &mut dyn Watchdog = if plan.limits.is_empty() { &mut unwatched } else { &mut limits };
    let interrupt = || watch.interrupted();
    let found = play(&mut bed, &plan, &mut Interruptible { interrupt: &interrupt, watchdog }).map_err(
        |source: PlayError| EngineJobError::Play { file: spec.file.display().to_string(), source },
    )?;
    Ok(Transient {
        bed: bed.describe(),
        time_s: (0..found.played).map(|t| t as f64 * plan.sample_time_s).collect(),
        channels: found.record.channels,
        events: found.events,
        trips: bed.take_trips(),
        stop: found.stop.map(|s| s.to_string()),
        interrupted: watch.interrupted(),
    })
}

/// A fault of a bed file with the line of its key.
fn with_line(text: &str, e: &dynocal_plant::error::PlantError) -> String {
    let line = match e {
        // The reader of the whole table names the key in its message.
        dynocal_plant::error::PlantError::Bed { key, found, .. } if key == "bed" => {
            let name = found.split('`').nth(1).unwrap_or_default();
            let is_key = |l: &str| {
                let l = l.trim().trim_start_matches('[').trim_end_matches(']');
                let key = l.split('=').next().unwrap_or_default().trim();
                key == name || key.ends_with(&format!(".{name}"))
            };
            text.lines().position(|l| !name.is_empty() && is_key(l)).map(|k| k + 1)
        }
        dynocal_plant::error::PlantError::Bed { key, .. } => {
            dynocal_files::spec::line_of(text, key.strip_prefix("bed.").unwrap_or(key))
        }
        _ => None,
    };
    match line {
        Some(line) => format!("line {line}: {e}"),
        None => e.to_string(),
    }
}

/// The bed, settled at the first row of the file.
fn bed(
    engine: &Engine,
    spec: &Spec,
    first: &dyn Fn(&str) -> Option<f64>,
) -> Result<EngineBed, EngineJobError> {
    let options = match &spec.bed {
        None => BedOptions::of_set(&engine.set),
        Some(path) => {
            let fault = |message: String| DriveFileError::Bed { file: path.display().to_string(), message };
            let text = std::fs::read_to_string(path).map_err(|e| fault(e.to_string()))?;
            let given: toml::Table = toml::from_str(&text).map_err(|e| fault(e.to_string()))?;
            BedOptions::from_table(&engine.set, &given).map_err(|e| fault(with_line(&text, &e)))?
        }
    };
    let set = BedSettings::of_set(&engine.set, &engine.params)?;
    let settings = BedSettings { options, ..set }.at_first(&engine.params, first)?;
    Ok(EngineBed::new(&engine.params, settings)?)
}

/// Inputs act at sample instants: a sample that begins at or after the time of a row has its values.
fn record(bed: &mut EngineBed, drive: &Drive, every: Every, watch: Watch) -> Result<Transient, PlantError> {
    let variables = bed.variables().to_vec();
    let mut u: Vec<f64> = inputs(&variables).iter().map(|v| v.start).collect();
    let mut y = vec![0.0; variables.len() - u.len()];
    let channel = |v: &Variable| Channel {
        name: v.name.clone(),
        unit: v.unit.clone(),
        role: if v.causality == Causality::Input { Role::Input } else { Role::Output },
        values: Vec::new(),
    };
    let mut found = Transient {
        bed: bed.describe(),
        time_s: Vec::new(),
        channels: variables.iter().map(channel).collect(),
        events: Vec::new(),
        trips: Vec::new(),
        stop: None,
        interrupted: false,
    };
    let (t0, n, end_s) = (drive.time_s[0], drive.time_s.len(), drive.length_s());
    let mut row = 0;
    while bed.time_s() < end_s - 1e-9 && !watch.interrupted() {
        while row + 1 < n && drive.time_s[row + 1] - t0 <= bed.time_s() + 1e-9 {
            row += 1;
        }
        for (u, column) in u.iter_mut().zip(&drive.columns) {
            if let Some(values) = column {
                *u = values[row];
            }
        }
        let left_s = end_s - bed.time_s();
        match every {
            Every::Angle { every_deg } => bed.step_angle(&u, every_deg, &mut y)?,
            Every::Time { every_s } => bed.step(&u, every_s.min(left_s), &mut y)?,
            Every::Default => bed.step(&u, EVERY_S.min(left_s), &mut y)?,
        }
        found.time_s.push(t0 + bed.time_s());
        for (c, x) in found.channels.iter_mut().zip(u.iter().chain(&y)) {
            c.values.push(*x);
        }
        found.events.extend(bed.take_events());
        watch.fraction((bed.time_s() / end_s).min(1.0));
    }
    found.interrupted = watch.interrupted();
    found.trips = bed.take_trips();
    Ok(found)
}

fn inputs(variables: &[Variable]) -> Vec<Variable> {
    variables.iter().filter(|v| v.causality == Causality::Input).cloned().collect()
}
