//! `dynocal new identify|design|calibrate|map --from FILE`: a commented spec with the channels of a measurement file.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_files::atomic;
use dynocal_files::measurement::ReadKeys;
use dynocal_jobs::draft::{Kind, Wishes, draft};

use super::Verb;
use super::reading::{FlagError, Reading};
use crate::failure::{Exit, Failure};
use crate::terminal::{print, say};

pub(crate) const VERB: Verb = Verb { name: "new", describe: |c| New::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Write a first spec from a measurement file: its channels, units, ranges, sample time";

#[derive(Args, Debug)]
struct New {
    /// What the spec is for: identify, design, calibrate, map
    #[arg(value_parser = kind)]
    kind: Kind,
    /// Measurement file
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// Spec to write; without it the name of the file in this folder: FILE.toml (identify), FILE-design.toml,
    /// FILE-calibrate.toml, FILE-map.toml
    #[arg(long, value_name = "SPEC")]
    to: Option<PathBuf>,
    /// Output (calibrate, map: what is demanded); may be repeated; without it the last channel that moves
    #[arg(long, value_name = "NAME")]
    output: Vec<String>,
    /// Input; may be repeated; without it every other channel that moves
    #[arg(long, value_name = "NAME")]
    input: Vec<String>,
    /// calibrate, map: operating channel that the bed imposes; may be repeated; without it speed
    #[arg(long, value_name = "NAME")]
    given: Vec<String>,
    /// design: stored model; may be repeated
    #[arg(long, value_name = "FILE")]
    model: Vec<PathBuf>,
    /// Sample time in s, of a file without time stamps
    #[arg(long, value_name = "S", conflicts_with = "steady")]
    sample_time_s: Option<f64>,
    /// Every row is a steady point
    #[arg(long)]
    steady: bool,
    #[command(flatten)]
    reading: Reading,
    /// Write over a spec that is there
    #[arg(long)]
    force: bool,
    /// Say nothing but errors
    #[arg(long, short)]
    quiet: bool,
}

fn kind(name: &str) -> Result<Kind, String> {
    let found = Kind::ALL.iter().find(|(n, _)| *n == name).map(|(_, k)| *k);
    let names: Vec<&str> = Kind::ALL.iter().map(|(n, _)| *n).collect();
    found.ok_or_else(|| format!("expected one of {}", names.join(", ")))
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = New::from_arg_matches(matches)?;
    if let Some(dt) = args.sample_time_s.filter(|dt| !(dt.is_finite() && *dt > 0.0)) {
        let expected = "a positive number of seconds".into();
        return Err(FlagError { flag: "--sample-time-s", found: dt.to_string(), expected }.into());
    }
    let to = args.to.unwrap_or_else(|| {
        let name = args.from.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = name.split('.').next().unwrap_or("spec");
        // One file is the beginning of several specs: the second must not stumble over the first.
        PathBuf::from(match args.kind {
            Kind::Identify => format!("{stem}.toml"),
            kind => format!("{stem}-{}.toml", kind.name()),
        })
    });
    if to.exists() && !args.force {
        let expected = "a file that is not there, or --force".into();
        return Err(FlagError { flag: "--to", found: to.display().to_string(), expected }.into());
    }
    let wishes = Wishes {
        format: args.reading.format,
        dialect: args.reading.csv.clone(),
        read: ReadKeys { csv: args.reading.dialect()?, ..ReadKeys::default() },
        outputs: args.output,
        inputs: args.input,
        given: args.given,
        sample_time_s: args.sample_time_s,
        steady: args.steady,
        models: args.model,
    };
    let folder = to.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let spec = draft(args.kind, &args.from, folder, &wishes)?;
    atomic::write(&to, spec.text.as_bytes())?;
    if args.quiet {
        return Ok(Exit::Done);
    }
    spec.notes.iter().for_each(|n| say(n));
    let (kind, to) = (args.kind.name(), to.display());
    print(&format!("{to}\nread it, then: dynocal {kind} {to} --check\n"))?;
    Ok(Exit::Done)
}
