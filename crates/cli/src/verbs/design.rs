//! `dynocal design SPEC`: the most informative test signal within the limits of a user's own spec.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_numerics::interval::Interval;
use dynocal_jobs::design::estimate::estimate;
use dynocal_jobs::design::error::DesignJobError;
use dynocal_jobs::design::result::{Designed, LeastDistance, SafetyLine};
use dynocal_jobs::design::run::run as make;
use dynocal_jobs::design::read;
use dynocal_report::significant;
use dynocal_design::error::DesignError;
use dynocal_design::search::Failure as SearchFailure;

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::terminal::{print, say};
use crate::failure::{Exit, Failure};
use crate::table;
use dynocal_jobs::design::page as design_report;

pub(crate) const VERB: Verb =
    Verb { name: "design", describe: |c| Design::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Design the most informative test signal within limits (spec: examples/design/spec.toml)";

#[derive(Args, Debug)]
struct Design {
    /// Spec of the design (TOML)
    spec: PathBuf,
    #[command(flatten)]
    plan: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Design::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = read(&args.spec, &args.common.overrides())?;
    let plan = estimate(&job).map_err(with_hint)?;
    if args.plan.check {
        return show_plan(&plan, &job.out, "design", &args.common);
    }
    plan.allowed()?;
    let (found, curves, folder) = progress.during(|watch| make(&job, watch)).map_err(with_hint)?;
    design_report::write(&job, &found, &curves, folder.path())?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        print(&text(&found))?;
        let files = ["design.csv", "report.html"].map(|f| folder.path().join(f).display().to_string());
        print(&format!("\n{}\n", files.join("\n")))?;
    }
    Ok(if found.valid { Exit::Done } else { Exit::NotValid })
}

fn with_hint(e: DesignJobError) -> Failure {
    let hint = match &e {
        DesignJobError::Design(d) | DesignJobError::Search(SearchFailure::Problem(d)) => match d {
            DesignError::NoStart { .. } => {
                Some("leave out regressors, widen the limits, lengthen the record, or give earlier records in `prior`")
            }
            DesignError::Conflict { .. } => Some("one of the two has to give way"),
            _ => None,
        },
        DesignJobError::NotDriven { .. } => Some("see `dynocal list models`"),
        _ => None,
    };
    match hint {
        Some(h) => Failure::from(e).hint(h),
        None => e.into(),
    }
}

fn text(found: &Designed) -> String {
    let mut out = format!(
        "{}: {} samples of {} s, {}\n\n",
        found.name,
        found.samples,
        significant(found.sample_time_s, 4),
        design_report::ended(found.status)
    );
    let rows: Vec<Vec<String>> = found
        .efficiencies
        .iter()
        .map(|e| {
            let of = |v: f64| if v.is_finite() { format!("{v:.1}") } else { "none".into() };
            vec![e.model.clone(), e.rival.clone(), of(e.d_percent.median), of(e.i_percent.median), of(e.drawn_anew_percent)]
        })
        .collect();
    out += "Efficiency of random signals of the same limits, the design being 100 % (medians):\n\n";
    let header = ["model", "signal", "D [%]", "I [%]", "drawn anew [%]"];
    out += &table::render(&header, &rows, &[2, 3, 4]);
    if let Some((bound, percent)) = found.certificate.as_ref().and_then(|b| b.bound.zip(b.efficiency_percent)) {
        out += &format!("\nNo record within the amplitude limits has J_D below {bound:.2}: at least {percent:.1} % of it reached.\n");
    }
    let limited: Vec<&SafetyLine> = found.safety.iter().filter(|s| s.limits.is_some()).collect();
    if !limited.is_empty() {
        let rows: Vec<Vec<String>> = limited.iter().map(|s| safety(s)).collect();
        out += "\nPredicted outputs and their limits:\n\n";
        let header = ["output", "unit", "predicted", "limits", "margin", "band to limit", "at [s]"];
        out += &table::render(&header, &rows, &[4, 5, 6]);
    }
    out
}

fn safety(s: &SafetyLine) -> Vec<String> {
    let range = |r: Interval| format!("{} to {}", significant(r.lower, 4), significant(r.upper, 4));
    let LeastDistance { distance, at_s } =
        s.least_distance_of_band.unwrap_or(LeastDistance { distance: f64::NAN, at_s: f64::NAN });
    vec![
        s.output.name.clone(),
        s.output.unit.clone(),
        range(s.predicted),
        s.limits.map_or(String::new(), range),
        s.margin.map_or(String::new(), |m| significant(m.value, 3)),
        significant(distance, 3),
        format!("{at_s:.2}"),
    ]
}
