//! `dynocal engine transient`: the engine on its bed, driven by inputs from a file.

use std::path::PathBuf;

use clap::Args;
use dynocal_files::table::Table;
use dynocal_files::units;
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, Variable};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::testbed::settings::BedOptions;
use dynocal_report::{Block, Cell, Column as Head, Panel, Report, Section, TimePlot, render, significant};

use crate::failure::{Exit, Failure};
use crate::terminal::print;
use crate::{interrupt, table};
use dynocal_plant::plants;

/// Most points of a plot.
const PLOTTED: usize = 4000;
/// Most events that are shown.
const SHOWN: usize = 20;

#[derive(Args, Debug)]
pub(crate) struct Transient {
    /// Inputs: a CSV with a column of time in s and columns named as inputs of the bed (`time [s], throttle [deg], ..`);
    /// each row holds until the next, inputs without a column stay at their start
    file: PathBuf,
    /// Parameter set, of the verb.
    #[arg(skip)]
    pub(crate) parameters: String,
    /// Bed: a TOML file with the keys of `[plant.bed]` (docs/testbed.md)
    #[arg(long, value_name = "FILE")]
    bed: Option<PathBuf>,
    /// Sample time
    #[arg(long, default_value_t = 0.01, value_name = "S", conflicts_with = "every_deg")]
    every_s: f64,
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
}

/// Inputs over time: for each input of the bed a column of the file, or none.
struct Drive {
    time_s: Vec<f64>,
    columns: Vec<Option<Vec<f64>>>,
}

/// What was recorded: time, then every variable of the bed.
struct Record {
    time_s: Vec<f64>,
    values: Vec<Vec<f64>>,
    events: Vec<LimitEvent>,
}

impl Transient {
    /// Drives the bed, shows ranges and events, writes what was asked for.
    pub(crate) fn run(&self) -> Result<Exit, Failure> {
        if !(self.every_s > 0.0 && self.every_s <= 10.0) {
            return Err(FileError::Sample(self.every_s).into());
        }
        let data = dynocal_files::dataset::read_table(&self.file, None)?;
        let mut bed = self.bed(&data)?;
        let drive = read(&data, &inputs(bed.variables()))?;
        bed.reset(self.seed);
        let record = self.record(&mut bed, &drive)?;
        let rows = ranges(bed.variables(), &record);
        print(&table::render(&["variable", "unit", "least", "mean", "greatest"], &rows, &[2, 3, 4]))?;
        print(&events_text(&record.events))?;
        if let Some(path) = &self.csv {
            let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &record.time_s)];
            for (v, x) in bed.variables().iter().zip(&record.values) {
                columns.push((&v.name, &v.unit, x));
            }
            dynocal_files::csv_io::write_columns(path, &columns)?;
        }
        if let Some(path) = &self.report {
            let page = render(&self.page(&bed, &record))?;
            dynocal_files::atomic::write(path, page.as_bytes())?;
            print(&format!("\n{}\n", path.display()))?;
        }
        // A part of a record is no result of it.
        Ok(if interrupt::asked() { Exit::NotValid } else { Exit::Done })
    }

    /// The bed, settled at the first row of the file where that gives actuators.
    fn bed(&self, data: &Table) -> Result<EngineBed, Failure> {
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
        let first =
            |name: &str| column_of(data, name).and_then(|i| data.numbers(&data.columns[i].name, 0, 1).ok());
        let set = BedSettings::of_set(&self.parameters, &params)?;
        let mut start = set.start;
        let fields: [(&str, &mut f64); 4] = [
            ("inj", &mut start.injection_mg),
            ("spark", &mut start.spark_deg),
            ("throttle", &mut start.throttle_deg),
            ("speed", &mut start.speed_rpm),
        ];
        for (name, field) in fields {
            if let Some(value) = first(name).and_then(|v| v.first().copied()) {
                *field = value;
            }
        }
        let start = if options.saturate { start.saturated() } else { start };
        let settings = BedSettings { start, options, ..set };
        Ok(EngineBed::new(&params, settings)?)
    }

    /// Inputs act at sample instants: a sample that begins at or after the time of a row has its values.
    fn record(&self, bed: &mut EngineBed, drive: &Drive) -> Result<Record, PlantError> {
        let variables = bed.variables().to_vec();
        let mut u: Vec<f64> = inputs(&variables).iter().map(|v| v.start).collect();
        let mut y = vec![0.0; variables.len() - u.len()];
        let mut record =
            Record { time_s: Vec::new(), values: vec![Vec::new(); variables.len()], events: Vec::new() };
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
                None => bed.step(&u, self.every_s.min(end_s - bed.time_s()), &mut y)?,
            }
            record.time_s.push(t0 + bed.time_s());
            for (values, x) in record.values.iter_mut().zip(u.iter().chain(&y)) {
                values.push(*x);
            }
            record.events.extend(bed.take_events());
        }
        Ok(record)
    }

    fn page(&self, bed: &EngineBed, record: &Record) -> Report {
        let thin = record.time_s.len().div_ceil(PLOTTED).max(1);
        let thinned = |v: &[f64]| v.iter().copied().step_by(thin).collect::<Vec<f64>>();
        let plot = |title: &str, causality: Causality| -> Block {
            let mut plot = TimePlot::new(title, thinned(&record.time_s));
            for (v, x) in bed.variables().iter().zip(&record.values) {
                if v.causality == causality {
                    let panel = Panel::new(v.name.clone(), v.unit.clone());
                    plot = plot.panel(match causality {
                        Causality::Input => panel.held(v.name.clone(), thinned(x)),
                        Causality::Output => panel.line(v.name.clone(), thinned(x)),
                    });
                }
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
            .section(Section::new("Outputs").block(plot("Outputs", Causality::Output)))
            .section(Section::new("Inputs").block(plot("Inputs", Causality::Input)))
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

fn ranges(variables: &[Variable], record: &Record) -> Vec<Vec<String>> {
    let one = |(v, x): (&Variable, &Vec<f64>)| {
        let least = x.iter().copied().fold(f64::INFINITY, f64::min);
        let most = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
        let text = |x: f64| significant(x, 5);
        vec![v.name.clone(), v.unit.clone(), text(least), text(mean), text(most)]
    };
    variables.iter().zip(&record.values).map(one).collect()
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
