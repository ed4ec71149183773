//! `dynocal engine transient`: the engine on its bed, driven by inputs from a file.

use std::path::PathBuf;

use clap::Args;
use dynocal_calib::supervisor;
use dynocal_files::table::Table;
use dynocal_files::units;
use dynocal_ident::data::{Channel, Role};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, Variable};
use dynocal_ident::play::{Interruptible, Unwatched, Watchdog, play};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::testbed::settings::BedOptions;
use dynocal_report::{Block, Cell, Column as Head, Panel, Report, Section, TimePlot, render, significant};

use crate::failure::{Exit, Failure};
use crate::terminal::print;
use crate::{interrupt, table};
use dynocal_plant::plants;

/// Sample time in s where none is given.
const EVERY_S: f64 = 0.01;
/// Most points of a plot.
const PLOTTED: usize = 4000;
/// Most events that are shown.
const SHOWN: usize = 20;

#[derive(Args, Debug)]
pub(crate) struct Transient {
    /// Inputs: a CSV with a column of time in s and columns named as inputs of the bed (`time [s], throttle [deg], ..`);
    /// each row holds until the next, inputs without a column stay at their start. Or a plan, NAME.plan.csv with
    /// NAME.plan.json beside it: played with its loops and limits at its own sample time (docs/bed.md)
    file: PathBuf,
    /// Parameter set, of the verb.
    #[arg(skip)]
    pub(crate) parameters: String,
    /// Bed: a TOML file with the keys of `[plant.bed]` (docs/testbed.md)
    #[arg(long, value_name = "FILE")]
    bed: Option<PathBuf>,
    /// Sample time; 0.01 s where nothing is said
    #[arg(long, value_name = "S", conflicts_with = "every_deg")]
    every_s: Option<f64>,
    /// Sample by crank angle instead: 1 a degree, 180 a stroke, 720 a cycle
    #[arg(long, value_name = "DEG")]
    every_deg: Option<f64>,
    /// Seed of sensor noise and of the scatter of cycles
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write time, inputs and outputs to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write a report with plots
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// What is wrong with the file of inputs.
#[derive(Debug, thiserror::Error)]
enum FileError {
    #[error("{file}: no column `time` in s; there are: {columns}")]
    Time { file: String, columns: String },
    #[error("{file}: column `{column}` is no input of this bed; inputs: {known}")]
    Unknown { file: String, column: String, known: String },
    #[error("{file}: column `{column}` is in {found}: expected {expected}")]
    Unit { file: String, column: String, found: String, expected: String },
    #[error("{file}: row {row}: time {found} s: expected a time after that of the row before")]
    Order { file: String, row: usize, found: f64 },
    #[error("{file}: {rows} rows: expected at least 2")]
    Short { file: String, rows: usize },
    #[error("bed file {file}: {message}")]
    Bed { file: String, message: String },
    #[error("--every-s {0}: expected more than 0 and at most 10 s")]
    Sample(f64),
    #[error("{file}: a plan is sampled every {expected_s} s: leave out --every-s and --every-deg")]
    Sampled { file: String, expected_s: f64 },
}

/// Inputs over time: for each input of the bed a column of the file, or none.
struct Drive {
    time_s: Vec<f64>,
    columns: Vec<Option<Vec<f64>>>,
}

/// What was recorded: time, then every variable of the bed, or the channels of a plan.
struct Record {
    time_s: Vec<f64>,
    channels: Vec<Channel>,
    events: Vec<LimitEvent>,
    /// Why a plan ended early.
    stop: Option<String>,
}

impl Transient {
    /// Drives the bed, shows ranges and events, writes what was asked for.
    pub(crate) fn run(&self) -> Result<Exit, Failure> {
        let (bed, record) = match dynocal_files::plan::files(&self.file) {
            Some(_) => self.played()?,
            None => self.driven()?,
        };
        let rows = ranges(&record);
        print(&table::render(&["variable", "unit", "least", "mean", "greatest"], &rows, &[2, 3, 4]))?;
        print(&events_text(&record.events))?;
        if let Some(stop) = &record.stop {
            print(&format!("\nthe plan {stop}\n"))?;
        }
        if let Some(path) = &self.csv {
            let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &record.time_s)];
            columns.extend(record.channels.iter().map(|c| (c.name.as_str(), c.unit.as_str(), &c.values[..])));
            dynocal_files::csv_io::write_columns(path, &columns)?;
        }
        if let Some(path) = &self.report {
            let page = render(&self.page(&bed, &record))?;
            dynocal_files::atomic::write(path, page.as_bytes())?;
            print(&format!("\n{}\n", path.display()))?;
        }
        // A part of a record is no result of it.
        Ok(if interrupt::asked() || record.stop.is_some() { Exit::NotValid } else { Exit::Done })
    }

    /// A file of inputs on the bed.
    fn driven(&self) -> Result<(EngineBed, Record), Failure> {
        let every_s = self.every_s.unwrap_or(EVERY_S);
        if !(every_s > 0.0 && every_s <= 10.0) {
            return Err(FileError::Sample(every_s).into());
        }
        let data = dynocal_files::dataset::read_table(&self.file, None)?;
        let first = |name: &str| {
            let i = column_of(&data, name)?;
            data.numbers(&data.columns[i].name, 0, 1).ok()?.first().copied()
        };
        let mut bed = self.bed(&first)?;
        let drive = read(&data, &inputs(bed.variables()))?;
        bed.reset(self.seed);
        let record = self.record(&mut bed, &drive, every_s)?;
        Ok((bed, record))
    }

    /// A plan on the bed, its limits watched by the measured values.
    fn played(&self) -> Result<(EngineBed, Record), Failure> {
        let plan = dynocal_files::plan::read(&self.file)?;
        if self.every_s.is_some() || self.every_deg.is_some() {
            let file = self.file.display().to_string();
            return Err(FileError::Sampled { file, expected_s: plan.sample_time_s }.into());
        }
        let first =
            |name: &str| plan.channel(name).and_then(|c| c.applied(plan.sample_time_s).first().copied());
        let mut bed = self.bed(&first)?;
        bed.reset(self.seed);
        let interrupt = || interrupt::asked();
        let mut limits = supervisor::for_plan(&plan, &[]);
        let mut unwatched = Unwatched;
        // Without limits an event of the bed is something to report and no reason to end.
        let watchdog: &mut dyn Watchdog = if plan.limits.is_empty() { &mut unwatched } else { &mut limits };
        let played = play(&mut bed, &plan, &mut Interruptible { interrupt: &interrupt, watchdog })?;
        let record = Record {
            time_s: (0..played.played).map(|t| t as f64 * plan.sample_time_s).collect(),
            channels: played.record.channels,
            events: played.events,
            stop: played.stop.map(|s| s.to_string()),
        };
        Ok((bed, record))
    }

    /// The bed, settled at the first row of the file where that gives actuators.
    fn bed(&self, first: &dyn Fn(&str) -> Option<f64>) -> Result<EngineBed, Failure> {
        let params = plants::parameters(&self.parameters)?;
        let options = match &self.bed {
            None => BedOptions::of_set(&self.parameters),
            Some(path) => {
                let fault = |message: String| FileError::Bed { file: path.display().to_string(), message };
                let text = std::fs::read_to_string(path).map_err(|e| fault(e.to_string()))?;
                let given: toml::Table = toml::from_str(&text).map_err(|e| fault(e.to_string()))?;
                BedOptions::from_table(&self.parameters, &given).map_err(|e| fault(e.to_string()))?
            }
        };
        let set = BedSettings::of_set(&self.parameters, &params)?;
        let mut start = set.start;
        let fields: [(&str, &mut f64); 4] = [
            ("inj", &mut start.injection_mg),
            ("spark", &mut start.spark_deg),
            ("throttle", &mut start.throttle_deg),
            ("speed", &mut start.speed_rpm),
        ];
        for (name, field) in fields {
            if let Some(value) = first(name) {
                *field = value;
            }
        }
        let start = if options.saturate { start.saturated() } else { start };
        let settings = BedSettings { start, options, ..set };
        Ok(EngineBed::new(&params, settings)?)
    }

    /// Inputs act at sample instants: a sample that begins at or after the time of a row has its values.
    fn record(&self, bed: &mut EngineBed, drive: &Drive, every_s: f64) -> Result<Record, PlantError> {
        let variables = bed.variables().to_vec();
        let mut u: Vec<f64> = inputs(&variables).iter().map(|v| v.start).collect();
        let mut y = vec![0.0; variables.len() - u.len()];
        let channel = |v: &Variable| Channel {
            name: v.name.clone(),
            unit: v.unit.clone(),
            role: if v.causality == Causality::Input { Role::Input } else { Role::Output },
            values: Vec::new(),
        };
        let channels = variables.iter().map(channel).collect();
        let mut record = Record { time_s: Vec::new(), channels, events: Vec::new(), stop: None };
        let t0 = drive.time_s[0];
        let n = drive.time_s.len();
        // The last row holds as long as the one before it.
        let end_s = 2.0 * drive.time_s[n - 1] - drive.time_s[n - 2] - t0;
        let mut row = 0;
        while bed.time_s() < end_s - 1e-9 && !interrupt::asked() {
            while row + 1 < n && drive.time_s[row + 1] - t0 <= bed.time_s() + 1e-9 {
                row += 1;
            }
            for (u, column) in u.iter_mut().zip(&drive.columns) {
                if let Some(values) = column {
                    *u = values[row];
                }
            }
            match self.every_deg {
                Some(deg) => bed.step_angle(&u, deg, &mut y)?,
                None => bed.step(&u, every_s.min(end_s - bed.time_s()), &mut y)?,
            }
            record.time_s.push(t0 + bed.time_s());
            for (c, x) in record.channels.iter_mut().zip(u.iter().chain(&y)) {
                c.values.push(*x);
            }
            record.events.extend(bed.take_events());
        }
        Ok(record)
    }

    fn page(&self, bed: &EngineBed, record: &Record) -> Report {
        let thin = record.time_s.len().div_ceil(PLOTTED).max(1);
        let thinned = |v: &[f64]| v.iter().copied().step_by(thin).collect::<Vec<f64>>();
        let plot = |title: &str, inputs: bool| -> Block {
            let mut plot = TimePlot::new(title, thinned(&record.time_s));
            for c in record.channels.iter().filter(|c| (c.role == Role::Input) == inputs) {
                let panel = Panel::new(c.name.clone(), c.unit.clone());
                plot = plot.panel(match inputs {
                    true => panel.held(c.name.clone(), thinned(&c.values)),
                    false => panel.line(c.name.clone(), thinned(&c.values)),
                });
            }
            plot.into()
        };
        let name = self.file.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let mut events = dynocal_report::Table::new(vec![
            Head::number("Time", "s"),
            Head::text("What"),
            Head::number("Value", ""),
            Head::number("Limit", ""),
        ]);
        for e in record.events.iter().take(200) {
            let cells: Vec<Cell> =
                vec![e.time_s.into(), e.what.clone().into(), e.value.into(), e.limit.into()];
            events = events.row(cells);
        }
        Report::new(format!("Transient {name}"))
            .subtitle(bed.describe())
            .fact("Time [s]", significant(record.time_s.last().copied().unwrap_or(0.0), 5))
            .fact("Samples", record.time_s.len().to_string())
            .fact("Events", record.events.len().to_string())
            .section(Section::new("Outputs").block(plot("Outputs", false)))
            .section(Section::new("Inputs").block(plot("Inputs", true)))
            .section(Section::new("Events").text("Limits that were touched, the first 200.").block(events))
    }
}

fn inputs(variables: &[Variable]) -> Vec<Variable> {
    variables.iter().filter(|v| v.causality == Causality::Input).cloned().collect()
}

/// Column for a name, with or without the unit as a suffix (`speed`, `speed_rpm`).
fn column_of(data: &Table, name: &str) -> Option<usize> {
    data.columns.iter().position(|c| stem(&c.name) == name || c.name == name)
}

/// Name without a suffix that stands for a unit.
fn stem(name: &str) -> &str {
    match (units::from_suffix(name), name.rsplit_once('_')) {
        (Some(_), Some((stem, _))) => stem,
        _ => name,
    }
}

fn read(data: &Table, inputs: &[Variable]) -> Result<Drive, Failure> {
    let file = || data.file.clone();
    let names = |v: &mut dyn Iterator<Item = &str>| v.collect::<Vec<_>>().join(", ");
    let time = column_of(data, "time").ok_or_else(|| FileError::Time {
        file: file(),
        columns: names(&mut data.columns.iter().map(|c| c.name.as_str())),
    })?;
    let mut columns: Vec<Option<Vec<f64>>> = vec![None; inputs.len()];
    for (i, c) in data.columns.iter().enumerate() {
        let place = inputs.iter().position(|v| v.name == c.name || v.name == stem(&c.name));
        let expected = match place {
            Some(k) => inputs[k].unit.clone(),
            None if i == time => "s".into(),
            None => {
                let known = names(&mut inputs.iter().map(|v| v.name.as_str()));
                return Err(FileError::Unknown { file: file(), column: c.name.clone(), known }.into());
            }
        };
        if let Some((found, _)) = c.unit.as_ref().filter(|(u, _)| *u != units::normalise(&expected)) {
            let (column, found) = (c.name.clone(), found.clone());
            return Err(FileError::Unit { file: file(), column, found, expected }.into());
        }
        if let Some(k) = place {
            columns[k] = Some(data.numbers(&c.name, 0, data.rows())?.to_vec());
        }
    }
    if data.rows() < 2 {
        return Err(FileError::Short { file: file(), rows: data.rows() }.into());
    }
    let time_s = data.numbers(&data.columns[time].name, 0, data.rows())?.to_vec();
    if let Some(k) = (1..time_s.len()).find(|&k| time_s[k] <= time_s[k - 1]) {
        return Err(FileError::Order { file: file(), row: k + 1, found: time_s[k] }.into());
    }
    Ok(Drive { time_s, columns })
}

fn ranges(record: &Record) -> Vec<Vec<String>> {
    let one = |c: &Channel| {
        let x = &c.values;
        let least = x.iter().copied().fold(f64::INFINITY, f64::min);
        let most = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
        let text = |x: f64| significant(x, 5);
        vec![c.name.clone(), c.unit.clone(), text(least), text(mean), text(most)]
    };
    record.channels.iter().map(one).collect()
}

fn events_text(events: &[LimitEvent]) -> String {
    if events.is_empty() {
        return String::new();
    }
    let rows: Vec<Vec<String>> = events
        .iter()
        .take(SHOWN)
        .map(|e| {
            vec![format!("{:.3}", e.time_s), e.what.clone(), significant(e.value, 5), significant(e.limit, 5)]
        })
        .collect();
    let more = events.len().saturating_sub(SHOWN);
    let tail = if more > 0 { format!("and {more} more\n") } else { String::new() };
    format!("\n{}{tail}", table::render(&["time [s]", "event", "value", "limit"], &rows, &[0, 2, 3]))
}
