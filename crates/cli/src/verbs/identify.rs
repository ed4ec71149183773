//! `dynocal identify SPEC`: from a measured file to a validated model.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_calib::identify::job::{self, IdentifyError};
use dynocal_calib::identify::result::{Identified, Score};
use dynocal_calib::identify::spec::{self, Overrides};
use dynocal_ident::validate::{Kind, Seen};

use super::Verb;
use crate::common::{Common, print};
use crate::failure::{Exit, Failure};
use crate::{identify_report, interrupt, table};

pub(crate) const VERB: Verb =
    Verb { name: "identify", describe: |c| Identify::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Identify a dynamic model from a measured file (CSV or Parquet)";

#[derive(Args, Debug)]
struct Identify {
    /// Spec of the identification (TOML)
    spec: PathBuf,
    /// Data file instead of the one that the spec names
    #[arg(long, value_name = "FILE")]
    data: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Identify::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let overrides =
        Overrides { data: args.data.clone(), seed: args.common.seed, out: args.common.out.clone() };
    let job = spec::read(&args.spec, &overrides)?;
    let asked = || {
        progress.evaluation();
        interrupt::asked()
    };
    let outcome = job::run(&job, &|text| progress.note(text), &asked);
    progress.finish();
    let (found, folder) = outcome.map_err(with_hint)?;
    identify_report::write(&found, folder.path())?;
    for warning in &found.warnings {
        eprintln!("warning: {warning}");
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        print(&text(&found));
        print(&format!("\nreport: {}\n", folder.path().join("report.html").display()));
    }
    Ok(if found.valid { Exit::Done } else { Exit::NotValid })
}

fn with_hint(e: IdentifyError) -> Failure {
    let hint = match &e {
        IdentifyError::Estimate(dynocal_ident::estimate::EstimateError::Unstable { .. }) => {
            Some("see `dynocal list models` for structures with fewer output terms")
        }
        IdentifyError::Files(dynocal_files::FilesError::Format { .. }) => {
            Some("write format = \"csv\" or \"parquet\" in [data]")
        }
        _ => None,
    };
    match hint {
        Some(h) => Failure::from(e).hint(h),
        None => e.into(),
    }
}

fn text(found: &Identified) -> String {
    let head = format!(
        "{}: {} from {}\n{} {}, {} parameters (rank {}), {} samples, {:?} after {} evaluations\n\n",
        found.name,
        found.target,
        found.inputs.join(", "),
        found.structure,
        found.estimator,
        found.parameters,
        found.rank,
        found.samples,
        found.status,
        found.evaluations
    );
    let rows: Vec<Vec<String>> = found.scores.iter().map(row).collect();
    let unit = found.scores.first().map_or("-", |s| s.unit.as_str());
    let rmse = format!("RMSE [{unit}]");
    let header = ["data", "output", "records", "samples", &rmse, "R2 [%]", "NRMSE fit [%]"];
    head + &table::render(&header, &rows, &[2, 3, 4, 5, 6])
}

fn row(s: &Score) -> Vec<String> {
    let number = |x: Option<f64>, digits: usize| x.map_or("diverged".into(), |v| format!("{v:.digits$}"));
    vec![
        if s.data == Seen::Unseen { "unseen" } else { "estimation" }.into(),
        if s.kind == Kind::FreeRun { "free run" } else { "one step" }.into(),
        s.records.to_string(),
        s.samples.to_string(),
        number(s.rmse, 5),
        number(s.r2_percent, 3),
        number(s.nrmse_fit_percent, 3),
    ]
}
