//! `dynocal convert IN OUT`: a measurement file in another format, merged, renamed, in other units.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_files::measurement::ReadKeys;
use dynocal_files::measurement::merge::{Keys, Rule};
use dynocal_jobs::convert::{Conversion, convert};

use super::Verb;
use super::reading::{FlagError, Reading};
use crate::failure::{Exit, Failure};
use crate::terminal::say;

pub(crate) const VERB: Verb =
    Verb { name: "convert", describe: |c| Convert::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Convert a measurement file; several rasters are merged by a stated rule";

#[derive(Args, Debug)]
struct Convert {
    /// Measurement file
    input: PathBuf,
    /// File to write; its ending names the format (.mf4, .parquet, .csv, .csv.gz, .mat)
    output: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Channel to keep, by its new name; may be repeated; all without it
    #[arg(long, value_name = "NAME")]
    channel: Vec<String>,
    /// Name that a channel gets and the names that it may have, e.g. torque=Tq_Brake,trq; may be repeated
    #[arg(long, value_name = "NAME=OLD,..")]
    alias: Vec<String>,
    /// Unit that a channel gets, e.g. torque=Nm; may be repeated
    #[arg(long, value_name = "NAME=UNIT")]
    unit: Vec<String>,
    /// Merge all rasters, also where the output could hold them: hold, line, mean, event
    #[arg(long, value_name = "RULE", value_parser = rule)]
    merge: Option<Rule>,
    /// Rule of one channel, e.g. state=event; may be repeated
    #[arg(long, value_name = "NAME=RULE")]
    rule: Vec<String>,
    /// Merge onto the raster of this channel or group; without it onto that with most samples
    #[arg(long, value_name = "NAME")]
    raster: Option<String>,
    /// Merge onto a uniform axis with this sample time in s
    #[arg(long, value_name = "S", conflicts_with = "raster")]
    sample_time_s: Option<f64>,
    /// Stamps that differ by less are equal, in s
    #[arg(long, value_name = "S", default_value_t = Keys::default().tolerance_s)]
    tolerance_s: f64,
    /// Write over a file that is there
    #[arg(long)]
    force: bool,
    /// Say nothing but errors
    #[arg(long, short)]
    quiet: bool,
}

fn rule(name: &str) -> Result<Rule, String> {
    match name {
        "hold" => Ok(Rule::Hold),
        "line" => Ok(Rule::Line),
        "mean" => Ok(Rule::Mean),
        "event" => Ok(Rule::Event),
        _ => Err("expected one of hold, line, mean, event".into()),
    }
}

/// NAME=TEXT pairs of a flag.
fn pairs(flag: &'static str, form: &str, given: &[String]) -> Result<BTreeMap<String, String>, FlagError> {
    let mut out = BTreeMap::new();
    for text in given {
        let fail = |expected: String| FlagError { flag, found: text.clone(), expected };
        let pair = text.split_once('=').filter(|(n, v)| !n.is_empty() && !v.is_empty());
        let (name, value) = pair.ok_or_else(|| fail(form.into()))?;
        if out.insert(name.to_string(), value.to_string()).is_some() {
            return Err(fail(format!("`{name}` once only")));
        }
    }
    Ok(out)
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Convert::from_arg_matches(matches)?;
    let rules = pairs("--rule", "NAME=RULE", &args.rule)?;
    let rules = rules.into_iter().map(|(name, text)| match rule(&text) {
        Ok(r) => Ok((name, r)),
        Err(expected) => Err(FlagError { flag: "--rule", found: format!("{name}={text}"), expected }),
    });
    let alias = pairs("--alias", "NAME=OLD,.., e.g. torque=Tq_Brake,trq", &args.alias)?;
    let list = |text: String| text.split(',').map(|n| n.trim().to_string()).collect();
    let keys = Keys {
        rule: args.merge.unwrap_or_default(),
        rules: rules.collect::<Result<_, _>>()?,
        raster: args.raster,
        sample_time_s: args.sample_time_s,
        tolerance_s: args.tolerance_s,
    };
    let how = Conversion {
        format: args.reading.format,
        // What only merging can do is a wish for it.
        merge: args.merge.is_some() || keys != Keys::default(),
        read: ReadKeys {
            csv: args.reading.dialect()?,
            alias: alias.into_iter().map(|(n, o)| (n, list(o))).collect(),
            merge: keys,
        },
        channels: args.channel,
        units: pairs("--unit", "NAME=UNIT, e.g. torque=Nm", &args.unit)?,
    };
    let same = |a: &Path, b: &Path| Some(std::fs::canonicalize(a).ok()? == std::fs::canonicalize(b).ok()?);
    if same(&args.input, &args.output) == Some(true) {
        let (found, expected) = (args.output.display().to_string(), "another file than the one that is read".into());
        return Err(FlagError { flag: "OUTPUT", found, expected }.into());
    }
    if args.output.exists() && !args.force {
        let (found, expected) = (args.output.display().to_string(), "a file that is not there, or --force".into());
        return Err(FlagError { flag: "OUTPUT", found, expected }.into());
    }
    let notes = convert(&args.input, &args.output, &how)?;
    if !args.quiet {
        notes.iter().for_each(|n| say(n));
    }
    Ok(Exit::Done)
}
