//! Flags of every verb that computes.

use std::path::{Path, PathBuf};

use clap::Args;
use dynocal_files::run_folder::{RunFolder, RunPlace};
use dynocal_jobs::estimate::Estimate;
use dynocal_jobs::place::Overrides;
use dynocal_report::significant;

use crate::failure::{Exit, Failure};
use crate::progress::Progress;
use crate::table;
use crate::terminal::print;

/// Most threads: enough for any machine of today, few enough for the smallest to live on.
const MOST_THREADS: i64 = 512;

// No doc comment: clap would show it in `--help` in place of each verb's own description.
#[derive(Args, Debug, Clone)]
pub(crate) struct Common {
    /// Print summary.json on standard output; everything else goes to standard error
    #[arg(long)]
    pub(crate) json: bool,
    /// Say nothing but errors
    #[arg(long, short)]
    pub(crate) quiet: bool,
    /// Seed of every random choice; overrides the spec
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
    /// Threads for independent work; results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_THREADS))]
    threads: Option<u16>,
    /// Run folder; overrides the spec
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

// For verbs with a spec. No doc comment, as above.
#[derive(Args, Debug, Clone, Copy)]
pub(crate) struct Check {
    /// Check spec and data, show the plan with what it takes in memory and work, and run nothing
    #[arg(long)]
    pub(crate) check: bool,
}

/// Shows the plan of a job; one that is too large is refused, and a folder that is not for this run.
pub(crate) fn show_plan(
    plan: &Estimate,
    out: &RunPlace,
    kind: &str,
    common: &Common,
) -> Result<Exit, Failure> {
    RunFolder::check_at(out, kind)?;
    if common.json {
        print(&format!("{}\n", serde_json::to_string_pretty(plan)?))?;
        plan.allowed()?;
        return Ok(Exit::Done);
    }
    let mut rows: Vec<Vec<String>> = plan.plan.iter().map(|l| vec![l.what.clone(), l.text.clone()]).collect();
    rows.push(vec!["memory".into(), format!("about {} MB", significant(1e-6 * plan.memory_bytes, 2))]);
    rows.push(vec!["work".into(), format!("about {} operations", significant(plan.operations, 2))]);
    print(&format!("{}\n\n{}", plan.name, table::render(&["what", "plan"], &rows, &[])))?;
    plan.allowed()?;
    Ok(Exit::Done)
}

impl Common {
    /// Sets threads and Ctrl-C up; returns where progress goes.
    pub(crate) fn start(&self) -> Result<Progress, Failure> {
        if let Some(n) = self.threads {
            rayon::ThreadPoolBuilder::new().num_threads(usize::from(n)).build_global()?;
        }
        crate::interrupt::install()?;
        Ok(Progress::new(self.quiet))
    }

    /// What the arguments change in a spec.
    pub(crate) fn overrides(&self) -> Overrides {
        Overrides { seed: self.seed, out: self.out.clone() }
    }

    /// Whether a human-readable result is wanted on standard output.
    pub(crate) fn shows_text(&self) -> bool {
        !self.json && !self.quiet
    }

    /// Prints the summary at `path` on standard output where `--json` asks for it.
    pub(crate) fn print_summary(&self, path: &Path) -> Result<(), Failure> {
        if self.json {
            print(&std::fs::read_to_string(path)?)?;
        }
        Ok(())
    }
}
