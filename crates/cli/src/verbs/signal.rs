//! `dynocal signal NAME`: makes a test signal, analyses it and writes it to a file. `dynocal signal SPEC.toml` makes
//! several channels together.

use std::path::Path;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_ident::signal::signal;
use dynocal_jobs::place::{Place, is_name};
use dynocal_jobs::signal::spec::{self, MOST_SAMPLES, Wanted};
use dynocal_jobs::signal::work::estimate;
use dynocal_jobs::signal::{Job, Made, page, run as make, store};
use dynocal_report::significant;

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::failure::{Exit, Failure};
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb =
    Verb { name: "signal", describe: |c| Signal::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Make a test signal, analyse it and write it as CSV (`dynocal list signals`)";

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
    plan: Check,
    #[command(flatten)]
    common: Common,
}

/// What was asked for cannot be made.
#[derive(Debug, thiserror::Error)]
enum ArgumentError {
    #[error("--keys {found}: expected KEY=VALUE, e.g. hold_s=3{reason}")]
    Key { found: String, reason: String },
    #[error("{}", .0.join("; "))]
    Missing(Vec<&'static str>),
    #[error("--{flag} {found}: expected {expected}")]
    Value { flag: &'static str, found: String, expected: String },
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Signal::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = if args.name.ends_with(".toml") {
        spec::read(Path::new(&args.name), &args.common.overrides())?
    } else {
        one(&args)?
    };
    let plan = estimate(&job);
    if args.plan.check {
        return show_plan(&plan, &job.out, "signal", &args.common);
    }
    plan.allowed()?;
    let (made, folder) = progress.during(|watch| make(&job, watch))?;
    for warning in &made.warnings {
        say(&format!("warning: {warning}"));
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        print(&text(&job, &made))?;
        let files = store::files(&job).map(|f| folder.path().join(f).display().to_string());
        print(&format!("\n{}\n", files.join("\n")))?;
    }
    Ok(Exit::Done)
}

/// One channel from the arguments.
fn one(args: &Signal) -> Result<Job, Failure> {
    let (Some(sample_time_s), Some(length_s)) = (args.sample_time_s, args.length_s) else {
        let asked = [
            ("--sample-time-s is missing: expected the sample time in s", args.sample_time_s),
            ("--length-s is missing: expected the length in s", args.length_s),
        ];
        let missing = asked.into_iter().filter(|(_, given)| given.is_none()).map(|(name, _)| name);
        return Err(ArgumentError::Missing(missing.collect()).into());
    };
    let keys = keys(&args.keys)?;
    signal(&args.name, &keys)
        .map_err(|e| Failure::from(e).hint("`dynocal list signals` shows the keys of every signal"))?;
    let refused = |flag, found: &dyn ToString, expected: String| {
        Failure::from(ArgumentError::Value { flag, found: found.to_string(), expected })
    };
    if !(sample_time_s > 0.0 && sample_time_s.is_finite()) {
        return Err(refused("sample-time-s", &sample_time_s, "a positive number of seconds".into()));
    }
    if args.channel == "time" || !is_name(&args.channel) {
        return Err(refused("channel", &args.channel, "a name of its own, `time` is taken".into()));
    }
    let expected = || format!("2 to {MOST_SAMPLES:e} samples of {sample_time_s} s");
    let samples =
        spec::samples(length_s, sample_time_s).ok_or_else(|| refused("length-s", &length_s, expected()))?;
    let name = format!("signal-{}", args.name);
    let place = Place::run(&name, args.common.out.as_deref());
    let wanted =
        Wanted { name: args.channel.clone(), unit: args.unit.clone(), signal: args.name.clone(), keys };
    Ok(Job {
        name: args.name.clone(),
        samples,
        sample_time_s,
        seed: args.common.seed.unwrap_or(1),
        channels: vec![wanted],
        out: place.out,
    })
}

/// `key=value` pairs as a table; a value that is no TOML value is a text.
fn keys(pairs: &[String]) -> Result<toml::Table, ArgumentError> {
    let mut all = toml::Table::new();
    for pair in pairs {
        let fault = |reason: &str| ArgumentError::Key { found: pair.clone(), reason: reason.into() };
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

fn text(job: &Job, made: &Made) -> String {
    if let ([w], [a]) = (&job.channels[..], &made.analyses[..]) {
        let rows: Vec<Vec<String>> = page::numbers(&w.unit, a)
            .into_iter()
            .map(|(name, value, unit)| {
                let value = value.map_or("none".into(), |v| significant(v, 5));
                vec![name.into(), value, unit.into()]
            })
            .collect();
        return table::render(&["number", "value", "unit"], &rows, &[1]);
    }
    let number = |v: f64| significant(v, 4);
    let channels = job.channels.iter().zip(&made.analyses).map(|(w, a)| {
        let crest = a.crest_factor.map_or("none".into(), number);
        vec![w.name.clone(), w.unit.clone(), w.signal.clone(), number(a.minimum), number(a.maximum), crest]
    });
    let header = ["channel", "unit", "signal", "least", "greatest", "crest factor"];
    let mut out = table::render(&header, &channels.collect::<Vec<_>>(), &[3, 4, 5]);
    let pairs: Vec<Vec<String>> = made
        .correlations
        .iter()
        .map(|c| {
            let pair = made.pairs.iter().find(|p| p.a == c.a && p.b == c.b);
            let cells = pair.map_or("none".into(), |p| format!("{:.0}", 100.0 * p.occupied));
            vec![format!("{}, {}", c.a, c.b), format!("{:.3}", c.r), format!("{:.3}", c.bound), cells]
        })
        .collect();
    if !pairs.is_empty() {
        let header = ["channels", "correlation", "95 % bound", "cells visited [%]"];
        out += &format!("\n{}", table::render(&header, &pairs, &[1, 2, 3]));
    }
    out
}
