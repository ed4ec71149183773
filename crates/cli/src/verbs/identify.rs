//! `dynocal identify SPEC`: from a measured file to a validated model.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::identify::error::IdentifyError;
use dynocal_jobs::identify::job;
use dynocal_numerics::watch::Watch;
use dynocal_jobs::identify::result::{Identified, Modelled, Score};
use dynocal_jobs::identify::spec::{self, Job, Overrides};
use dynocal_files::json;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::terminal::{print, say};
use crate::failure::{Exit, Failure};
use crate::table;
use dynocal_jobs::identify::page as identify_report;

pub(crate) const VERB: Verb =
    Verb { name: "identify", describe: |c| Identify::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Identify a dynamic or steady model from a measured file (CSV, Parquet, MDF, MAT)";

#[derive(Args, Debug)]
struct Identify {
    /// Spec of the identification (TOML)
    #[arg(required_unless_present = "model")]
    spec: Option<PathBuf>,
    /// Score this model.json on the data instead of estimating; several run as one set. Without a spec, `--data` has
    /// columns with the names of the channels
    #[arg(long, value_name = "FILE")]
    model: Vec<PathBuf>,
    /// Data file instead of those that the spec names; several are several experiments
    #[arg(long, value_name = "FILE", required_unless_present = "spec")]
    data: Vec<PathBuf>,
    #[command(flatten)]
    plan: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Identify::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let overrides = Overrides {
        data: args.data.clone(),
        seed: args.common.seed,
        out: args.common.out.clone(),
        reference: None,
    };
    let job = job_of(&args, &overrides)?;
    if args.plan.check {
        return show_plan(&job::check(&job, Watch::silent()).map_err(with_hint)?, &job.out, "identify", &args.common);
    }
    let (found, folder) = progress.during(|watch| job::run(&job, watch)).map_err(with_hint)?;
    identify_report::write(&found, folder.path())?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    if let Some(export) = &job.export {
        super::export::of_run(folder.path(), export, args.common.quiet)?;
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        print(&text(&found))?;
        print(&format!("\nreport: {}\n", folder.path().join("report.html").display()))?;
    }
    Ok(if found.valid { Exit::Done } else { Exit::NotValid })
}

fn job_of(args: &Identify, overrides: &Overrides) -> Result<Job, Failure> {
    let read = |path: &PathBuf| json::read_versioned::<StoredModel>(path, MODEL_SCHEMA, MODEL_VERSION);
    let models = args.model.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    match &args.spec {
        Some(path) if models.is_empty() => Ok(spec::read(path, overrides)?),
        Some(path) => Ok(spec::read(path, overrides)?.with_models(models)),
        None => Ok(Job::of_models(models, overrides)?),
    }
}

fn with_hint(e: IdentifyError) -> Failure {
    let hint = match &e {
        IdentifyError::Interrupted => Some("the same command again does it from the start"),
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
    let mut out = format!("{}\n\n{}\n", found.name, found.verdict.join("\n"));
    for m in &found.models {
        out += &format!(
            "\n{} from {}\n{}{}, {}\n\n",
            m.target,
            m.inputs.join(", "),
            m.what.clone().unwrap_or_else(|| format!("{} {}, {} parameters", m.structure, m.estimator, m.parameters.len())),
            size(m),
            identify_report::ended(m)
        );
        let own: Vec<&Score> = found.scores.iter().filter(|s| s.output == m.target).collect();
        let banded = own.iter().any(|s| s.band.is_some());
        let rows: Vec<Vec<String>> = own.iter().map(|s| row(s, banded, found.steady)).collect();
        let (rmse, within) = (format!("RMSE [{}]", m.unit), format!("95 % within [{}]", m.unit));
        let mut header = vec!["data", "output", "records", "samples", &rmse, &within];
        if banded {
            header.push("in band [%]");
        }
        header.extend(["R2 [%]", "NRMSE fit [%]"]);
        let right: Vec<usize> = (2..header.len()).collect();
        out += &table::render(&header, &rows, &right);
    }
    out
}

fn size(m: &Modelled) -> String {
    match (m.rank, m.samples) {
        (Some(0), Some(samples)) => format!(", {samples} points"),
        (Some(rank), Some(samples)) => format!(" (rank {rank}), {samples} samples"),
        _ => String::new(),
    }
}

fn row(s: &Score, banded: bool, steady: bool) -> Vec<String> {
    let number = |x: Option<f64>, digits: usize| x.map_or("diverged".into(), |v| format!("{v:.digits$}"));
    let error = |x: Option<f64>| x.map_or("diverged".into(), |v| dynocal_report::significant(v, 5));
    let mut cells = vec![
        s.part.clone(),
        format!("{}{}", if steady { "each point".into() } else { identify_report::kind_text(s.kind) }, if s.outside { " (far outside)" } else { "" }),
        s.records.to_string(),
        s.samples.to_string(),
        error(s.rmse),
        error(s.error_95),
    ];
    if banded {
        cells.push(s.in_band_percent.map_or("-".into(), |v| format!("{v:.1}")));
    }
    cells.extend([number(s.r2_percent, 3), number(s.nrmse_fit_percent, 3)]);
    cells
}
