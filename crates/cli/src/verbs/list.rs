//! `dynocal list [FAMILY]`: what there is, from the tables that the parser of specs uses.

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::families::FAMILIES;
use dynocal_numerics::registry::MemberDoc;

use super::Verb;
use crate::terminal::print;
use crate::failure::{Exit, Failure};
use crate::table;

pub(crate) const VERB: Verb = Verb { name: "list", describe: |c| List::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "List signals, models, estimators, criteria, plants, engine parameters, file formats, optimisers and studies with their parameters";

#[derive(Args, Debug)]
struct List {
    /// One family; without it all
    #[arg(value_parser = clap::builder::PossibleValuesParser::new(FAMILIES.iter().map(|f| f.name).chain([STUDIES])))]
    family: Option<String>,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

/// The tables of the jobs, and that of the studies, which stands above them.
fn families() -> impl Iterator<Item = (&'static str, Vec<MemberDoc>)> {
    let studies = || dynocal_studies::STUDIES.iter().map(|s| s.doc).collect();
    FAMILIES.iter().map(|f| (f.name, (f.docs)())).chain(std::iter::once_with(move || (STUDIES, studies())))
}

/// Family of the studies.
const STUDIES: &str = "studies";

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = List::from_arg_matches(matches)?;
    let wanted = families().filter(|f| args.family.as_deref().is_none_or(|name| name == f.0));
    if args.json {
        let all: serde_json::Map<String, serde_json::Value> =
            wanted.map(|(name, docs)| (name.to_string(), serde_json::json!(docs))).collect();
        print(&format!("{}\n", serde_json::to_string_pretty(&all)?))?;
    } else {
        let parts: Vec<String> = wanted.map(|(name, docs)| format!("{name}\n\n{}", text(&docs))).collect();
        print(&parts.join("\n"))?;
    }
    Ok(Exit::Done)
}

fn text(docs: &[MemberDoc]) -> String {
    let mut rows = Vec::new();
    for d in docs {
        rows.push(vec![d.name.to_string(), String::new(), String::new(), d.what.to_string()]);
        for p in d.params {
            let default = if p.default.is_empty() { "(required)" } else { p.default };
            rows.push(vec![
                format!("  .{}", p.name),
                p.unit.to_string(),
                default.to_string(),
                p.what.to_string(),
            ]);
        }
    }
    table::render(&["name", "unit", "default", "what"], &rows, &[])
}
