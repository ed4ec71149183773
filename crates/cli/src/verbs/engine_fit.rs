//! `dynocal engine fit`: constants of the engine from a measured map.

use std::path::PathBuf;

use clap::Args;
use dynocal_jobs::engine::Engine;
use dynocal_jobs::engine::fit::{FitResult, Spec, store};
use dynocal_jobs::place::Place;
use dynocal_report::significant;

use crate::failure::{Exit, Failure, exit};
use crate::progress::Progress;
use crate::table;
use crate::terminal::{print, say};

#[derive(Args, Debug)]
pub(crate) struct Fit {
    /// Measured map, a steady point a row: speed, torque, lambda and p_intake (or map), and where there are air,
    /// p_before_throttle, T_before_throttle, p_after_filter, T_after_filter, p_exhaust_manifold, T_exhaust_manifold, spark,
    /// intake_cam, exhaust_cam; units in brackets
    map: PathBuf,
    /// Most evaluations of all fitted points
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=1000))]
    evaluations: u32,
    /// Run folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Fit {
    /// Not valid when a judged error is beyond what is asked.
    pub(crate) fn run(&self, engine: &Engine) -> Result<Exit, Failure> {
        let spec = Spec { map: self.map.clone(), evaluations: self.evaluations as usize };
        let place = Place::run("engine-fit", self.out.as_deref());
        let (found, folder) =
            Progress::new(false).during(|watch| store::fit(engine, &spec, &place.out, watch))?;
        show(&found)?;
        for note in &found.notes {
            say(&format!("note: {note}"));
        }
        for warning in &found.warnings {
            say(&format!("warning: {warning}"));
        }
        print(&format!("\n{}\n", folder.path().display()))?;
        Ok(exit(found.valid()))
    }
}

fn show(found: &FitResult) -> Result<(), Failure> {
    let text = |v: f64| significant(v, 4);
    let constants: Vec<Vec<String>> = found
        .constants
        .iter()
        .map(|c| {
            let width = c.half_width.map_or("-".into(), |w| significant(w, 2));
            vec![c.key.into(), text(c.start), text(c.value), width, c.note.unwrap_or_default().into()]
        })
        .collect();
    print(&table::render(&["constant", "before", "fitted", "+-", "note"], &constants, &[1, 2, 3]))?;
    let condition = found.condition.map_or("not determined".into(), |c| significant(c, 3));
    let n = found.fitted_points;
    print(&format!(
        "{n} points fitted; +-: 95 % for independent errors; condition of the derivatives {condition}\n"
    ))?;
    let scores: Vec<Vec<String>> = found
        .scores
        .iter()
        .map(|s| {
            let (b, f, j) = (text(s.before), text(s.fitted), text(s.judged));
            vec![s.quantity.into(), s.unit.into(), text(s.asked), b, f, j, text(s.bias), text(s.worst)]
        })
        .collect();
    let head = ["error", "unit", "asked", "before", "fitted", "judged", "mean", "largest"];
    Ok(print(&format!("\n{}", table::render(&head, &scores, &[2, 3, 4, 5, 6, 7])))?)
}
