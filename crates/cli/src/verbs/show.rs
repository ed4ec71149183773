//! `dynocal show FILE`: channels, units, rates, ranges and gaps of a measurement file.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_files::atomic;
use dynocal_files::measurement::ReadKeys;
use dynocal_jobs::show::page::{about, on_a_line, page, unit_or_states};
use dynocal_jobs::show::{ChannelSummary, Contents, contents};
use dynocal_report::{render, significant};

use super::Verb;
use super::reading::Reading;
use crate::failure::{Exit, Failure};
use crate::table;
use crate::terminal::print;

pub(crate) const VERB: Verb = Verb { name: "show", describe: |c| Show::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Show what is in a measurement file (`dynocal list formats`)";

#[derive(Args, Debug)]
struct Show {
    /// Measurement file
    file: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Writes a page with plots
    #[arg(long, value_name = "HTML")]
    page: Option<PathBuf>,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Show::from_arg_matches(matches)?;
    let keys = ReadKeys { csv: args.reading.dialect()?, ..ReadKeys::default() };
    let found = contents(&args.file, args.reading.format, &keys).map_err(|e| {
        let failure = Failure::from(e);
        match hint(&args.file) {
            Some(text) => failure.hint(text),
            None => failure,
        }
    })?;
    if let Some(path) = &args.page {
        atomic::write(path, render(&page(&found))?.as_bytes())?;
    }
    let text = if args.json { format!("{}\n", serde_json::to_string_pretty(&found)?) } else { text(&found) };
    print(&text)?;
    Ok(Exit::Done)
}

/// What is meant where something else than a measurement is given.
fn hint(path: &Path) -> Option<String> {
    if path.join("run.json").exists() {
        return Some(format!(
            "a run folder: its page is {}, its numbers are in summary.json; `dynocal export` takes its maps and models",
            path.join("report.html").display()
        ));
    }
    let json = path.extension().is_some_and(|e| e == "json") && path.is_file();
    json.then(|| {
        "a measurement file is shown; a stored model is scored by `dynocal identify --model FILE --data FILE`, run by `dynocal \
         simulate`, taken away by `dynocal export`"
            .into()
    })
}

fn text(found: &Contents) -> String {
    let mut out = format!("{} ({})\n", found.file, found.format);
    found.notes.iter().for_each(|n| out.push_str(&format!("  {n}\n")));
    for (k, g) in found.groups.iter().enumerate() {
        let name = if g.name.is_empty() { String::new() } else { format!(" `{}`", g.name) };
        out.push_str(&format!("\ngroup {}{name}: {}\n", k + 1, about(g)));
        let rows: Vec<Vec<String>> = g.channels.iter().map(row).collect();
        let head = ["channel", "unit or states", "rows", "gaps", "min", "max", "mean"];
        out.push_str(&table::render(&head, &rows, &[2, 3, 4, 5, 6]));
    }
    out
}

fn row(c: &ChannelSummary) -> Vec<String> {
    let number = |x: Option<f64>| x.map_or("-".into(), |x| significant(x, 6));
    let counts = [c.rows.to_string(), c.gaps.to_string()];
    let values = [number(c.min), number(c.max), number(c.mean)];
    [on_a_line(&c.name), unit_or_states(c)].into_iter().chain(counts).chain(values).collect()
}
