//! `dynocal engine transient`: the engine on its bed, driven by inputs from a file.

use std::path::PathBuf;

use clap::Args;
use dynocal_ident::data::Channel;
use dynocal_ident::plant::LimitEvent;
use dynocal_jobs::engine::Engine;
use dynocal_jobs::engine::transient::{self, Every, Spec, grouped};
use dynocal_plant::testbed::guard::Trip;
use dynocal_report::significant;

use super::engine::page;
use crate::failure::{Exit, Failure, exit};
use crate::progress::Progress;
use crate::table;
use crate::terminal::print;

/// Most events that are shown.
const SHOWN: usize = 20;

#[derive(Args, Debug)]
pub(crate) struct Transient {
    /// Inputs: a CSV with a column of time in s and columns named as inputs of the bed (`time [s], throttle [deg], ..`);
    /// each row holds until the next, inputs without a column stay at their start. Or a plan, NAME.plan.csv with
    /// NAME.plan.json beside it: played with its loops and limits at its own sample time (docs/bed.md)
    file: PathBuf,
    /// Bed: a TOML file with the keys of `[plant.bed]` (docs/testbed.md)
    #[arg(long, value_name = "FILE")]
    bed: Option<PathBuf>,
    /// Sample time; 0.01 s where nothing is said
    #[arg(long, value_name = "S", conflicts_with = "every_deg")]
    every_s: Option<f64>,
    /// Sample by crank angle instead: 1 a degree, 180 a stroke, 720 a cycle
    #[arg(long, value_name = "DEG")]
    every_deg: Option<f64>,
    /// Seed of sensor noise and of the scatter of cycles
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write time, inputs and outputs to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write a report with plots
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

impl Transient {
    /// Drives the bed, shows ranges and events, writes what was asked for.
    pub(crate) fn run(&self, engine: &Engine) -> Result<Exit, Failure> {
        let every = match (self.every_s, self.every_deg) {
            (Some(every_s), _) => Every::Time { every_s },
            (None, Some(every_deg)) => Every::Angle { every_deg },
            (None, None) => Every::Default,
        };
        let spec = Spec { file: self.file.clone(), bed: self.bed.clone(), every, seed: self.seed };
        let found = Progress::new(false).during(|watch| transient::run(engine, &spec, watch))?;
        let rows: Vec<Vec<String>> = found.channels.iter().map(range).collect();
        print(&table::render(&["variable", "unit", "least", "mean", "greatest"], &rows, &[2, 3, 4]))?;
        print(&events_text(&found.events, &found.trips))?;
        if let Some(stop) = &found.stop {
            print(&format!("\nthe plan {stop}\n"))?;
        }
        if let Some(path) = &self.csv {
            transient::csv(path, &found)?;
        }
        page(self.report.as_deref(), || transient::report(&spec, &found))?;
        Ok(exit(found.whole()))
    }
}

fn range(c: &Channel) -> Vec<String> {
    let x = &c.values;
    let least = x.iter().copied().fold(f64::INFINITY, f64::min);
    let most = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
    let text = |x: f64| significant(x, 5);
    vec![c.name.clone(), c.unit.clone(), text(least), text(mean), text(most)]
}

fn events_text(events: &[LimitEvent], trips: &[Trip]) -> String {
    if events.is_empty() {
        return String::new();
    }
    let groups = grouped(events, trips);
    let rows: Vec<Vec<String>> = groups
        .iter()
        .take(SHOWN)
        .map(|g| {
            let numbers = [significant(g.limit, 5), significant(g.worst, 5)];
            let times = [format!("{:.3}", g.from_s), format!("{:.3}", g.to_s), g.count.to_string()];
            [g.what.clone()].into_iter().chain(times).chain(numbers).collect()
        })
        .collect();
    let more = groups.len().saturating_sub(SHOWN);
    let tail = if more > 0 { format!("and {more} more stretches\n") } else { String::new() };
    let head = ["limit touched", "from [s]", "to [s]", "events", "limit", "worst at an event"];
    format!("\n{}{tail}", table::render(&head, &rows, &[1, 2, 3, 4, 5]))
}
