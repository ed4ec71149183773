//! `dynocal simulate`: stored models on new inputs, without measured outputs.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches, ValueEnum};
use dynocal_ident::model::initial::Initial;
use dynocal_jobs::simulate::work::estimate;
use dynocal_jobs::simulate::{Job, Simulated, run as simulate, spec};
use dynocal_report::significant;

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::failure::{Exit, Failure, exit};
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb =
    Verb { name: "simulate", describe: |c| Simulate::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Simulate stored models on new inputs, without measured outputs";

#[derive(Args, Debug)]
struct Simulate {
    /// Spec of the simulation (TOML); or --model and --data
    #[arg(required_unless_present_any = ["model", "data"], conflicts_with_all = ["model", "data", "start", "init_samples"])]
    spec: Option<PathBuf>,
    /// Model file (model.json of `dynocal identify`); several are several outputs
    #[arg(long, value_name = "FILE", requires = "data")]
    model: Vec<PathBuf>,
    /// Data file with columns named as the channels of the models; several are several records
    #[arg(long, value_name = "FILE", requires = "model")]
    data: Vec<PathBuf>,
    /// Where the models start; without it as each model says where its output was measured, else from rest
    #[arg(long, value_enum)]
    start: Option<Start>,
    /// Samples at the start of every record that only initialise
    #[arg(long, value_name = "N")]
    init_samples: Option<usize>,
    #[command(flatten)]
    plan: Check,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Start {
    Rest,
    Measured,
    Estimated,
}

impl From<Start> for Initial {
    fn from(start: Start) -> Self {
        match start {
            Start::Rest => Self::Rest,
            Start::Measured => Self::Measured,
            Start::Estimated => Self::Estimated,
        }
    }
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Simulate::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = match &args.spec {
        Some(path) => spec::read(path, &args.common.overrides())?,
        None => {
            let job = Job::new(args.model.clone(), args.data.clone(), args.common.out.as_deref());
            let start = args.start.map(Initial::from);
            Job { start, init_samples: args.init_samples.unwrap_or(0), ..job }
        }
    };
    if args.plan.check {
        return show_plan(&estimate(&job)?, &job.out, "simulate", &args.common);
    }
    let (found, folder) = progress.during(|watch| simulate(&job, watch))?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        print(&text(&found))?;
        print(&format!("\nreport: {}\n", folder.path().join("report.html").display()))?;
    }
    Ok(exit(found.valid))
}

fn text(found: &Simulated) -> String {
    let number = |v: Option<f64>| v.map_or("-".into(), |v| significant(v, 5));
    let rows: Vec<Vec<String>> = found
        .outputs
        .iter()
        .map(|o| {
            vec![
                o.record.clone(),
                o.output.clone(),
                o.unit.clone(),
                o.samples.to_string(),
                number(o.range.map(|r| r.lower)),
                number(o.range.map(|r| r.upper)),
                number(o.rmse),
            ]
        })
        .collect();
    let header = ["record", "output", "unit", "samples", "least", "greatest", "RMSE to measured"];
    table::render(&header, &rows, &[3, 4, 5, 6])
}
