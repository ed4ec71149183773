//! `dynocal list [FAMILY]`: what there is, from the tables that the parser of specs uses.

use clap::{ArgMatches, Args, FromArgMatches};
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
    #[arg(value_parser = clap::builder::PossibleValuesParser::new(FAMILIES.iter().map(|f| f.0)))]
    family: Option<String>,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

type Family = (&'static str, fn() -> Vec<MemberDoc>);

static FAMILIES: &[Family] = &[
    ("signals", dynocal_ident::signal::docs),
    ("models", dynocal_ident::model::kinds::docs),
    ("estimators", dynocal_ident::estimate::docs),
    ("preparation", dynocal_ident::prepare::docs),
    ("selections", dynocal_ident::select::docs),
    ("criteria", || dynocal_design::criterion::CRITERIA.iter().map(|m| m.doc).collect()),
    ("searches", || dynocal_design::search::SEARCHES.iter().map(|m| m.doc).collect()),
    ("parameters", || dynocal_plant::params::PARAMETER_SETS.iter().map(|s| s.doc).collect()),
    ("plants", || dynocal_plant::plants::PLANTS.iter().map(|p| p.doc).collect()),
    ("formats", || dynocal_files::measurement::FORMATS.iter().map(|f| f.doc).collect()),
    ("exports", || dynocal_export::format::EXPORTS.iter().map(|e| e.doc).collect()),
    ("studies", || dynocal_studies::STUDIES.iter().map(|s| s.doc).collect()),
    ("optimisers", || dynocal_numerics::optim::OPTIMISERS.iter().map(|m| m.doc).collect()),
];

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = List::from_arg_matches(matches)?;
    let wanted = FAMILIES.iter().filter(|f| args.family.as_deref().is_none_or(|name| name == f.0));
    if args.json {
        let all: serde_json::Map<String, serde_json::Value> =
            wanted.map(|(name, docs)| ((*name).to_string(), serde_json::json!(docs()))).collect();
        print(&format!("{}\n", serde_json::to_string_pretty(&all)?))?;
    } else {
        let parts: Vec<String> = wanted.map(|(name, docs)| format!("{name}\n\n{}", text(&docs()))).collect();
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
