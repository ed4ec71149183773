//! What `calibrate`, its steps and `study` share: a checked spec in, a finished run folder out.

mod check;
pub(crate) mod load;
pub(crate) mod summary;
pub(crate) mod verdict;

use std::path::{Path, PathBuf};

use dynocal_calib::chain::context::{ChainError, Context, Event};
use dynocal_calib::chain::run::{self, ChainResult};
use dynocal_calib::chain::spec::CalibrateSpec;
use dynocal_files::run_folder::RunFolder;
use dynocal_files::spec::load;
use dynocal_ident::plant::{Plant, PlantError};

use crate::calibrate_report;
use crate::failure::{Exit, Failure};
use crate::plants;
use summary::Summary;

/// Kind of the run folder: all steps work in the folder of the whole calibration.
pub(crate) const KIND: &str = "calibrate";

/// A checked spec and where its run goes.
pub(crate) struct Campaign {
    pub(crate) name: String,
    pub(crate) spec: CalibrateSpec,
    pub(crate) out: PathBuf,
}

/// A run that reached the step it was asked for.
pub(crate) struct Finished {
    pub(crate) result: ChainResult,
    pub(crate) valid: bool,
    pub(crate) warnings: Vec<String>,
    pub(crate) summary: PathBuf,
    pub(crate) report: PathBuf,
}

impl Finished {
    pub(crate) fn exit(&self) -> Exit {
        if self.valid { Exit::Done } else { Exit::NotValid }
    }
}

/// Reads and checks the spec at `path`; seed and folder may come from the command line.
pub(crate) fn read(path: &Path, seed: Option<u64>, out: Option<&Path>) -> Result<Campaign, Failure> {
    let spec = load(path, |typed: &CalibrateSpec, faults| {
        check::check(typed, faults);
        Some(CalibrateSpec { seed: seed.unwrap_or(typed.seed), ..typed.clone() })
    })?;
    let name = path.file_stem().map_or_else(|| "calibrate".into(), |s| s.to_string_lossy().into_owned());
    let out = out.map_or_else(|| Path::new("runs").join(&name), Path::to_path_buf);
    Ok(Campaign { name, spec, out })
}

/// Runs the steps up to `until` and writes summary and report.
pub(crate) fn run(
    campaign: &Campaign,
    until: &str,
    tell: &(dyn Fn(Event) + Sync),
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Finished, ChainError> {
    let spec = &campaign.spec;
    let mut folder = RunFolder::open(&campaign.out, KIND, spec)?;
    let make = plants::find(&spec.plant.name).and_then(|p| p.make);
    let factory = |noise: bool| -> Result<Box<dyn Plant>, PlantError> {
        match make {
            Some(make) => make(&spec.plant, noise),
            None => Err(PlantError::Call(format!("plant `{}` is run outside", spec.plant.name))),
        }
    };
    let ctx = Context {
        spec,
        plants: make.is_some().then_some(&factory),
        measured: campaign.out.join("measured"),
        interrupt,
        tell,
    };
    // A search that is stopped inside says so in its own words; to the user it is one thing.
    let result = run::run(&ctx, &mut folder, until).map_err(|e| match e {
        ChainError::Files(_) | ChainError::NeedsMeasurement { .. } => e,
        _ if interrupt() => ChainError::Interrupted,
        _ => e,
    })?;
    tell(Event::Step(run::STEPS.len() + 1, run::STEPS.len() + 1, "report"));
    let verdict = verdict::of(spec, &result);
    let files = load::files(&campaign.out, &result)?;
    let summary = Summary::new(&campaign.name, spec, &result, &verdict, &files);
    let report = calibrate_report::write(&campaign.out, &summary, &result)?;
    let summary = folder.write_summary(&summary)?;
    Ok(Finished { result, valid: verdict.valid, warnings: verdict.warnings, summary, report })
}

/// Builds summary and report again from the finished steps of a run folder.
pub(crate) fn rebuild(path: &Path) -> Result<Finished, Failure> {
    let (name, spec, result) = load::run(path)?;
    let verdict = verdict::of(&spec, &result);
    let files = load::files(path, &result)?;
    let summary = Summary::new(&name, &spec, &result, &verdict, &files);
    let report = calibrate_report::write(path, &summary, &result)?;
    let summary_path = path.join("summary.json");
    dynocal_files::json::write_versioned(&summary_path, "dynocal/summary", 1, &summary)?;
    Ok(Finished { result, valid: verdict.valid, warnings: verdict.warnings, summary: summary_path, report })
}
