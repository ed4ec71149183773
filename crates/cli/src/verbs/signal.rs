//! `dynocal signal NAME`: makes a test signal, analyses it and writes it to a file. `dynocal signal SPEC.toml` makes
//! several channels together (see [`super::signal_set`]).

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_report::{Axis, Bars, Cell, KeyValue, Panel, Report, Section, TimePlot, XyPlot, render};
use dynocal_files::run_folder::RunFolder;
use dynocal_files::{atomic, csv_io};
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::signal::analysis::{Analysis, analyse};
use dynocal_ident::signal::signal;
use dynocal_numerics::rng::Rng64;
use serde::Serialize;

use super::{Verb, signal_set};
use crate::common::Common;
use crate::terminal::print;
use crate::failure::{Exit, Failure};
use crate::table;

pub(crate) const VERB: Verb =
    Verb { name: "signal", describe: |c| Signal::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Make a test signal, analyse it and write it as CSV (`dynocal list signals`)";

/// Most samples of one signal: a day at 100 Hz.
pub(super) const MOST_SAMPLES: f64 = 1e7;
/// Most lags of the autocorrelation.
pub(super) const LAGS: usize = 200;
/// Most samples that are drawn, and most lines of the spectrum: a page must stay light.
const DRAWN: usize = 5000;

#[derive(Args, Debug)]
struct Signal {
    /// Name of the signal (`dynocal list signals`), or a spec (*.toml) with several channels
    name: String,
    /// Parameters as key=value, e.g. --keys lo=10 hi=90 hold_s=3
    #[arg(long, value_name = "KEY=VALUE", num_args = 1..)]
    keys: Vec<String>,
    /// Length in s; a spec has its own
    #[arg(long, value_name = "S")]
    length_s: Option<f64>,
    /// Sample time in s; a spec has its own
    #[arg(long, value_name = "S")]
    sample_time_s: Option<f64>,
    /// Name of the channel in the file
    #[arg(long, default_value = "u")]
    channel: String,
    /// Unit of the channel
    #[arg(long, default_value = "-")]
    unit: String,
    #[command(flatten)]
    common: Common,
}

/// What was asked for cannot be made.
#[derive(Debug, thiserror::Error)]
enum SignalError {
    #[error("--keys {found}: expected KEY=VALUE, e.g. hold_s=3{reason}")]
    Key { found: String, reason: String },
    #[error("--{flag} is missing: expected {expected}")]
    Missing { flag: &'static str, expected: &'static str },
    #[error("--{flag} {found}: expected {expected}")]
    Number { flag: &'static str, found: f64, expected: String },
    #[error("signal {name}: a sample is not a finite number")]
    NotFinite { name: String },
}

/// A signal that cannot be analysed.
pub(super) fn not_finite(name: &str) -> impl std::error::Error + 'static {
    SignalError::NotFinite { name: name.into() }
}

/// The request as understood: what a folder must hold to make the same file again.
#[derive(Serialize)]
struct Request<'a> {
    name: &'a str,
    keys: toml::Table,
    samples: usize,
    sample_time_s: f64,
    channel: &'a str,
    unit: &'a str,
    seed: u64,
}

#[derive(Serialize)]
struct Summary<'a> {
    verb: &'static str,
    name: &'a str,
    valid: bool,
    warnings: Vec<String>,
    signal: &'a Request<'a>,
    analysis: &'a Analysis,
    files: [&'static str; 2],
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Signal::from_arg_matches(matches)?;
    args.common.start()?;
    if args.name.ends_with(".toml") {
        return signal_set::run(Path::new(&args.name), &args.common);
    }
    let given = |flag, value: Option<f64>, expected| value.ok_or(SignalError::Missing { flag, expected });
    let sample_time_s = given("sample-time-s", args.sample_time_s, "the sample time in s")?;
    let length_s = given("length-s", args.length_s, "the length in s")?;
    let request = Request {
        name: &args.name,
        keys: keys(&args.keys)?,
        samples: samples(length_s, sample_time_s)?,
        sample_time_s,
        channel: &args.channel,
        unit: &args.unit,
        seed: args.common.seed.unwrap_or(1),
    };
    let made = signal(request.name, &request.keys)
        .map_err(|e| Failure::from(e).hint("`dynocal list signals` shows the keys of every signal"))?;
    let mut u = vec![0.0; request.samples];
    made.fill(&mut u, request.sample_time_s, &mut Rng64::new(request.seed))?;
    let lags = LAGS.min(request.samples / 2);
    let found = analyse(&u, request.sample_time_s, lags)
        .ok_or_else(|| SignalError::NotFinite { name: request.name.into() })?;
    let out =
        args.common.out.clone().unwrap_or_else(|| Path::new("runs").join(format!("signal-{}", request.name)));
    let summary = write(&request, &u, &found, &out)?;
    args.common.print_summary(&summary)?;
    if args.common.shows_text() {
        print(&text(&request, &found))?;
        print(&format!("\n{}\n{}\n", out.join("signal.csv").display(), out.join("report.html").display()))?;
    }
    Ok(Exit::Done)
}

/// `key=value` pairs as a table; a value that is no TOML value is a text.
fn keys(pairs: &[String]) -> Result<toml::Table, SignalError> {
    let mut all = toml::Table::new();
    for pair in pairs {
        let fault = |reason: &str| SignalError::Key { found: pair.clone(), reason: reason.into() };
        let (key, value) = pair.split_once('=').ok_or_else(|| fault(""))?;
        let key = key.trim();
        if key.is_empty() || !key.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return Err(fault(""));
        }
        let parsed: Option<toml::Value> =
            toml::from_str::<toml::Table>(&format!("v = {value}")).ok().and_then(|mut t| t.remove("v"));
        let value = parsed.unwrap_or_else(|| toml::Value::String(value.into()));
        if all.insert(key.into(), value).is_some() {
            return Err(fault(" (this key is given twice)"));
        }
    }
    Ok(all)
}

fn samples(length_s: f64, sample_time_s: f64) -> Result<usize, SignalError> {
    let number = |flag, found, expected: &str| SignalError::Number { flag, found, expected: expected.into() };
    if !(sample_time_s > 0.0 && sample_time_s.is_finite()) {
        return Err(number("sample-time-s", sample_time_s, "a positive number of seconds"));
    }
    let n = (length_s / sample_time_s).round();
    if !(2.0..=MOST_SAMPLES).contains(&n) {
        let expected = format!("2 to {MOST_SAMPLES:e} samples of {sample_time_s} s");
        return Err(number("length-s", length_s, &expected));
    }
    Ok(n as usize)
}

fn write(request: &Request, u: &[f64], found: &Analysis, out: &Path) -> Result<PathBuf, Failure> {
    let folder = RunFolder::open(out, "signal", request)?;
    let data = Dataset {
        name: request.name.into(),
        sample_time_s: request.sample_time_s,
        channels: vec![Channel {
            name: request.channel.into(),
            unit: request.unit.into(),
            role: Role::Input,
            values: u.to_vec(),
        }],
        init_samples: 0,
        origin: format!("signal {} with seed {}", request.name, request.seed),
    };
    csv_io::write_dataset(&out.join("signal.csv"), &data)?;
    atomic::write(&out.join("report.html"), render(&report(request, u, found))?.as_bytes())?;
    Ok(folder.write_summary(&Summary {
        verb: "signal",
        name: request.name,
        valid: true,
        warnings: Vec::new(),
        signal: request,
        analysis: found,
        files: ["signal.csv", "report.html"],
    })?)
}

/// Numbers of the signal: name, value, unit.
fn numbers<'a>(unit: &'a str, a: &Analysis) -> Vec<(&'static str, Option<f64>, &'a str)> {
    vec![
        ("Samples", Some(a.samples as f64), "-"),
        ("Mean", Some(a.mean), unit),
        ("Standard deviation", Some(a.standard_deviation), unit),
        ("Least value", Some(a.minimum), unit),
        ("Greatest value", Some(a.maximum), unit),
        ("Largest step", Some(a.largest_step), unit),
        ("Crest factor", a.crest_factor, "-"),
        ("Coverage of the range", Some(100.0 * a.coverage), "%"),
    ]
}

fn text(request: &Request, a: &Analysis) -> String {
    let rows: Vec<Vec<String>> = numbers(request.unit, a)
        .into_iter()
        .map(|(name, value, unit)| {
            let value = value.map_or("none".into(), |v| dynocal_report::significant(v, 5));
            vec![name.into(), value, unit.into()]
        })
        .collect();
    table::render(&["number", "value", "unit"], &rows, &[1])
}

fn report(request: &Request, u: &[f64], a: &Analysis) -> Report {
    let section = analysed(Section::new("Signal"), (request.channel, request.unit), request.sample_time_s, u, a);
    Report::new(format!("Test signal: {}", request.name))
        .fact("Sample time", format!("{} s", request.sample_time_s))
        .fact("Seed", request.seed.to_string())
        .section(section.code("Keys", request.keys.to_string()))
}

/// Adds numbers, time, autocorrelation, spectrum and amplitudes of one channel (name and unit) to its section.
pub(super) fn analysed(
    section: Section,
    (name, unit): (&str, &str),
    dt_s: f64,
    u: &[f64],
    a: &Analysis,
) -> Section {
    let facts = numbers(unit, a)
        .into_iter()
        .map(|(name, value, unit)| KeyValue::new(name, Cell::from(value), unit))
        .collect();
    let drawn = &u[..u.len().min(DRAWN)];
    let caption = if drawn.len() < u.len() {
        format!("The first {} of {} samples; all are in signal.csv.", drawn.len(), u.len())
    } else {
        String::new()
    };
    let time = TimePlot::sampled("Signal", dt_s, drawn.len())
        .panel(Panel::new(name, unit).held(name, drawn))
        .caption(caption);
    let mut section = section.key_values(facts).block(time);
    if let Some(r) = &a.autocorrelation {
        let lag_s: Vec<f64> = r.lags.iter().map(|l| *l as f64 * dt_s).collect();
        section = section.block(
            XyPlot::new("Autocorrelation", Axis::new("lag", "s"), Axis::new("correlation", "-"))
                .line("autocorrelation", lag_s, r.values.clone())
                .caption(format!("95 % bound of white noise: {:.3}", r.bound)),
        );
    }
    let s = &a.spectrum;
    let lines = s.density.len().min(DRAWN);
    section
        .block(
            XyPlot::new(
                "Power spectral density",
                Axis::new("frequency", "Hz"),
                Axis::new("density", format!("({unit})^2/Hz")),
            )
            .line("density", &s.frequency_hz[..lines], &s.density[..lines])
            .caption(format!("One-sided, about the mean; mean of {} segments", s.segments)),
        )
        .block(
            Bars::new(
                "Amplitude density",
                Axis::new("share per unit", format!("1/({unit})")),
                a.amplitudes.middle.iter().map(|m| dynocal_report::significant(*m, 4)),
            )
            .series("density", a.amplitudes.density.clone()),
        )
}
