//! `dynocal label`: labels of an ECU from logs.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches, Subcommand};
use dynocal_jobs::label::{Job, Labelled, film as recipe, function, run as label};
use dynocal_jobs::place::Place;
use dynocal_report::significant;

use super::Verb;
use crate::common::Common;
use crate::failure::{Exit, Failure, exit};
use crate::progress::Progress;
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb = Verb { name: "label", describe: |c| Label::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Fit labels of an ECU to measurements: any function of a spec, or the fuel table of an open ECU";

#[derive(Args, Debug)]
#[command(args_conflicts_with_subcommands = true)]
struct Label {
    /// Spec of a function whose labels are fitted (TOML); or a recipe
    #[arg(required = true)]
    spec: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
    #[command(subcommand)]
    recipe: Option<Recipe>,
}

#[derive(Subcommand, Debug)]
enum Recipe {
    /// The fuel table (VE) from logs with a lambda sensor; writes .msq and .table
    Ve(Ve),
    /// The fuel film of port injection (share, time constant over coolant) and the delay to the lambda sensor
    Film(Film),
}

#[derive(Args, Debug)]
struct Film {
    /// Log with tip-ins and steps of the fuel; several (cold, warm) are fitted together
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Channel of the injected fuel, mg for each cylinder and cycle
    #[arg(long, value_name = "CHANNEL", default_value = "inj")]
    fuel: String,
    /// Channel of the air meter, g/s
    #[arg(long, value_name = "CHANNEL", default_value = "air")]
    air: String,
    /// Channel of the speed, rpm
    #[arg(long, value_name = "CHANNEL", default_value = "speed")]
    speed: String,
    /// Channel of lambda
    #[arg(long, value_name = "CHANNEL", default_value = "lambda")]
    lambda: String,
    /// Channel of the coolant temperature; without it the time constant is one number
    #[arg(long, value_name = "CHANNEL")]
    coolant: Option<String>,
    /// Temperatures at which the time constant is told, in the unit of the coolant channel
    #[arg(long, value_name = "T,T,..", value_delimiter = ',')]
    at: Vec<f64>,
    /// Cylinders
    #[arg(long, value_name = "N", default_value_t = 4)]
    cylinders: usize,
    /// Stoichiometric air over fuel
    #[arg(long, value_name = "RATIO", default_value_t = 14.7)]
    afr: f64,
    #[command(flatten)]
    common: Common,
}

#[derive(Args, Debug)]
struct Ve {
    /// Log (.mlg, .msl, CSV); several are fitted together
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Tune that was in the ECU; without it the one that the first log carries
    #[arg(long, value_name = "FILE.msq")]
    tune: Option<PathBuf>,
    /// Definition of the ECU: steps and limits of its labels
    #[arg(long, value_name = "FILE.ini")]
    ini: Option<PathBuf>,
    /// Lambda that is wanted everywhere; without it what the target table of the tune asks for
    #[arg(long, value_name = "LAMBDA")]
    target: Option<f64>,
    /// Share of the samples, first in time, that the judged table is fitted to
    #[arg(long, value_name = "SHARE", default_value_t = 0.6)]
    train: f64,
    /// Weight of the smoothness, 1 as much as the data; without it by generalised cross-validation
    #[arg(long, value_name = "WEIGHT")]
    smooth: Option<f64>,
    /// Cells without data follow their neighbours instead of keeping their values
    #[arg(long)]
    extrapolate: bool,
    /// Coolant temperature from which samples count, degC
    #[arg(long, value_name = "DEGC", default_value_t = 71.0, allow_negative_numbers = true)]
    least_coolant: f64,
    /// Samples in which the ECU enriches count too, by the correction in the log; without it they are left out
    #[arg(long)]
    enriched: bool,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let typed = Label::from_arg_matches(matches)?;
    match (typed.recipe, typed.spec) {
        (Some(Recipe::Ve(args)), _) => ve(&args),
        (Some(Recipe::Film(args)), _) => film(args),
        (None, spec) => described(&spec.unwrap_or_default(), &typed.common),
    }
}

fn described(spec: &Path, common: &Common) -> Result<Exit, Failure> {
    let progress = common.start()?;
    let job = function::spec::read(spec, &common.overrides())?;
    fitted(&job, common, progress)
}

fn film(args: Film) -> Result<Exit, Failure> {
    let progress = args.common.start()?;
    let recipe = recipe::Film {
        data: args.logs,
        fuel: args.fuel,
        air: args.air,
        speed: args.speed,
        lambda: args.lambda,
        coolant: args.coolant,
        points: args.at,
        cylinders: args.cylinders,
        afr: args.afr,
    };
    let job = recipe.job(Place::run("label-film", args.common.out.as_deref()).out)?;
    fitted(&job, &args.common, progress)
}

fn fitted(job: &function::Job, common: &Common, progress: Progress) -> Result<Exit, Failure> {
    let (found, folder) = progress.during(|watch| function::run(job, watch))?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    common.print_summary(&folder.path().join("summary.json"))?;
    if common.shows_text() {
        let mut rows = Vec::new();
        let mut at = 0;
        for l in &found.labels {
            for k in 0..l.len() {
                let half = found.half_width[at].map_or("-".into(), |h| significant(h, 3));
                let name = if l.len() > 1 { format!("{}[{k}]", l.name) } else { l.name.clone() };
                rows.push(vec![
                    name,
                    l.unit.clone(),
                    significant(l.base[k], 6),
                    significant(found.fit.values[at], 6),
                    half,
                ]);
                at += 1;
            }
        }
        let header = ["label", "unit", "before", "fitted", "half width, 95 %"];
        print(&format!("{}\n\n{}", found.verdict.join("\n"), table::render(&header, &rows, &[2, 3, 4])))?;
        print(&format!("\nreport: {}\n", folder.path().join("report.html").display()))?;
    }
    Ok(exit(found.valid))
}

fn ve(args: &Ve) -> Result<Exit, Failure> {
    let progress = args.common.start()?;
    let mut job = Job::ve(args.logs.clone(), args.tune.clone(), args.ini.clone(), args.common.out.as_deref());
    job.target_lambda = args.target;
    job.keys.train = args.train;
    job.keys.fit.smooth = args.smooth;
    job.keys.fit.extrapolate = args.extrapolate;
    job.keys.mask.enriched = args.enriched;
    job.keys.mask.least_coolant_c = args.least_coolant;
    let (found, folder) = progress.during(|watch| label(&job, watch))?;
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

fn text(found: &Labelled) -> String {
    let mut out = found.verdict.join("\n");
    out.push('\n');
    for file in found.files.iter().filter(|f| f.ends_with(".msq") || f.ends_with(".table")) {
        out.push_str(&format!("written: {file}\n"));
    }
    out
}
