//! `dynocal control`: margins and PI gains of loops around stored models, records of tests, a plant or given transfer functions.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::control::{Controlled, estimate, run as control, spec};
use dynocal_report::significant;

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::failure::{Exit, Failure, exit};
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb =
    Verb { name: "control", describe: |c| Control::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Tune PI and PID loops on models, records of tests, a plant or transfer functions, and prove their margins";

#[derive(Args, Debug)]
struct Control {
    /// Spec of the loops (TOML)
    spec: PathBuf,
    #[command(flatten)]
    check: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Control::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = spec::read(&args.spec, &args.common.overrides())?;
    if args.check.check {
        return show_plan(&estimate(&job)?, &job.out, "control", &args.common);
    }
    let (found, folder) = progress.during(|watch| control(&job, watch))?;
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

/// Verdict, and the margins of every set point.
fn text(found: &Controlled) -> String {
    let mut out = found.verdict.join("\n");
    out.push_str("\n\n");
    let number = |v: Option<f64>| v.map_or("-".into(), |v| significant(v, 4));
    let mut rows = Vec::new();
    for t in &found.together {
        for (m, l) in t.loops.iter().zip(&found.loops) {
            rows.push(vec![
                t.point.clone(),
                l.output.clone(),
                number(m.gain_up),
                number(m.phase_deg),
                number(m.delay_s),
                number(Some(m.sensitivity)),
                number(t.outputs.as_ref().map(|d| d.alpha)),
                number(t.violation),
            ]);
        }
    }
    let header = ["set point", "loop", "gain", "phase deg", "delay s", "Ms", "disk", "asked/had"];
    out + &table::render(&header, &rows, &[2, 3, 4, 5, 6, 7])
}
