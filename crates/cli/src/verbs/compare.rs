//! `dynocal compare FIRST SECOND`: two map files, or the maps of two runs, beside each other.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_export::compare::{Comparison, Difference, compare};
use dynocal_jobs::export::characteristics;
use dynocal_report::significant;

use super::Verb;
use crate::failure::{Exit, Failure};
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb =
    Verb { name: "compare", describe: |c| Compare::augment_args(c.about(ABOUT)), run };

const ABOUT: &str =
    "Compare the maps of two files or runs (.dcm, .cdfx, .csv, .json, run folders of calibrate)";

#[derive(Args, Debug)]
struct Compare {
    /// Map file or run folder
    first: PathBuf,
    /// Map file or run folder; its units are converted to those of the first
    second: PathBuf,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Compare::from_arg_matches(matches)?;
    let (first, said) = characteristics(&args.first)?;
    let (second, also) = characteristics(&args.second)?;
    said.iter().chain(&also).for_each(|n| say(n));
    let found = compare(&first, &second);
    let text = if args.json { format!("{}\n", serde_json::to_string_pretty(&found)?) } else { text(&found) };
    print(&text)?;
    Ok(Exit::Done)
}

fn text(found: &Comparison) -> String {
    let equal = found.both.iter().filter(|d| d.is_equal()).count();
    let mut out = format!("{equal} of {} characteristics that both have are equal\n", found.both.len());
    let others: Vec<&Difference> = found.both.iter().filter(|d| !d.is_equal()).collect();
    if !others.is_empty() {
        let head = ["name", "unit", "points", "differ", "rms", "largest", "at", "first", "second"];
        let rows: Vec<Vec<String>> = others.iter().map(|d| row(d)).collect();
        out.push_str(&format!("\n{}", table::render(&head, &rows, &[2, 3, 4, 5, 7, 8])));
    }
    for d in others {
        d.remarks.iter().for_each(|r| out.push_str(&format!("{}: {r}\n", d.name)));
    }
    for (what, names) in [("first", &found.only_first), ("second", &found.only_second)] {
        if !names.is_empty() {
            out.push_str(&format!("only in the {what}: {}\n", names.join(", ")));
        }
    }
    out
}

fn row(d: &Difference) -> Vec<String> {
    let number = |x: f64| significant(x, 6);
    let [largest, at, first, second] = match &d.largest {
        Some(l) => {
            let at: Vec<String> = l.at.iter().map(|x| format!("{x}")).collect();
            [number(l.second - l.first), at.join(", "), number(l.first), number(l.second)]
        }
        None => ["-"; 4].map(String::from),
    };
    let rms = d.rms.map_or("-".into(), number);
    let counts = [d.points.to_string(), d.differing.to_string()];
    let unit = d.unit.clone();
    [d.name.clone(), unit].into_iter().chain(counts).chain([rms, largest, at, first, second]).collect()
}
