//! `dynocal export SOURCE --to FORMAT`: maps, models and controllers in the formats of the neighbours.

use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_export::format::{EXPORTS, Keys, Precision};
use dynocal_export::package::Extrapolation;
use dynocal_jobs::export::{self, ExportSpec};

use super::Verb;
use crate::failure::{Exit, Failure};
use crate::terminal::{print, say};

pub(crate) const VERB: Verb = Verb { name: "export", describe: |c| Export::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Export maps, models and controllers: C, DCM, CDFX, A2L, FMU, ONNX, .. (`dynocal list exports`)";

#[derive(Args, Debug)]
struct Export {
    /// Run folder of `calibrate` or `map` (its maps), `identify` (its models) or `control` (its controller), one of their files, a map
    /// file (.json, .dcm, .cdfx, .csv), or a spec (.toml) whose plant leaves as FMU
    source: PathBuf,
    /// Formats
    #[arg(long, required = true, num_args = 1.., value_name = "FORMAT",
        value_parser = PossibleValuesParser::new(EXPORTS.iter().map(|e| e.doc.name)))]
    to: Vec<String>,
    /// Folder to write into
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    /// Arithmetic of generated C
    #[arg(long, value_parser = ["float", "double"], default_value = "float")]
    precision: String,
    /// Look-ups outside their axes
    #[arg(long, value_parser = ["clip", "linear"], default_value = "clip")]
    extrapolation: String,
    /// Sample time in s of a map whose run is not at hand
    #[arg(long, value_name = "S")]
    sample_time_s: Option<f64>,
    /// A2L of the ECU whose limits the characteristics take
    #[arg(long, value_name = "FILE")]
    a2l: Option<PathBuf>,
    /// The library of the engine's FMU, where it does not stand beside the program
    #[arg(long, value_name = "FILE")]
    library: Option<PathBuf>,
    /// Print the list of files, and nothing else
    #[arg(long, short)]
    quiet: bool,
}

/// Does what `[export]` of a spec asks for, when the run in `folder` is done.
pub(super) fn of_run(folder: &Path, spec: &ExportSpec, quiet: bool) -> Result<(), Failure> {
    let done = export::of_run(folder, spec)?;
    if !quiet {
        done.notes.iter().for_each(|n| say(n));
        done.files.iter().for_each(|p| say(&format!("exported {}", p.display())));
    }
    Ok(())
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Export::from_arg_matches(matches)?;
    let double = args.precision == "double";
    let linear = args.extrapolation == "linear";
    let spec = ExportSpec {
        to: args.to,
        keys: Keys { precision: if double { Precision::Double } else { Precision::Float } },
        extrapolation: if linear { Extrapolation::Linear } else { Extrapolation::Clip },
        sample_time_s: args.sample_time_s,
        a2l: args.a2l,
        engine: false,
        library: args.library,
    };
    let done = export::run(&args.source, &args.out, &spec)?;
    if let Some(words) = not_valid(&args.source) {
        say(&format!("warning: the run must not be used as it is: {words}"));
    }
    if !args.quiet {
        done.notes.iter().for_each(|n| say(n));
    }
    let paths: String = done.files.iter().map(|p| format!("{}\n", p.display())).collect();
    print(&paths)?;
    Ok(Exit::Done)
}

/// The verdict of a run folder whose results are not valid.
fn not_valid(source: &Path) -> Option<String> {
    // A controller stands beside the summary of its run.
    let folder = if source.ends_with("controller.json") { source.parent()? } else { source };
    let text = std::fs::read_to_string(folder.join("summary.json")).ok()?;
    let summary: serde_json::Value = serde_json::from_str(&text).ok()?;
    if summary.get("valid")?.as_bool()? {
        return None;
    }
    let verdict = summary.get("verdict").map(|v| v.get(0).unwrap_or(v)).and_then(|v| v.as_str());
    Some(verdict.unwrap_or("its summary says that it is not valid").to_string())
}
