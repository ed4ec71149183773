//! What `calibrate`, its steps and `study` share: a checked spec in, a finished run folder out.

use crate::place::Place;
use dynocal_files::run_folder::RunPlace;
use dynocal_numerics::watch::Watch;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicUsize;

use crate::calibrate::context::{Context, Governs, PlantFactory};
use crate::calibrate::error::ChainError;
use crate::calibrate::run::{self, ChainResult};
use crate::calibrate::spec::CalibrateSpec;
use dynocal_files::run_folder::{MEASURED, RunFolder};
use dynocal_files::spec::{Faults, SpecError, load};
use dynocal_ident::plant::{Plant, PlantError};

use super::channels::Channels;
pub use super::store::KIND;
use super::summary::Summary;
use super::{check, fuel_plant, fuelled, page, store, verdict};
use dynocal_files::spec::LoadError;
use dynocal_plant::plants;

/// A checked spec and where its run goes.
pub struct Campaign {
    /// Name of the run.
    pub name: String,
    /// The checked spec.
    pub spec: CalibrateSpec,
    /// Run folder.
    pub out: RunPlace,
}

/// A run that reached the step it was asked for.
pub struct Finished {
    /// What the steps found.
    pub result: ChainResult,
    /// False when a result must not be used as it is.
    pub valid: bool,
    /// Sentences, most important first.
    pub warnings: Vec<String>,
    /// What came out, against what.
    pub verdict: String,
    /// Path of summary.json.
    pub summary: PathBuf,
    /// Path of report.html.
    pub report: PathBuf,
}

/// Reads and checks the spec at `path`; seed and folder may come from the command line.
pub fn read(path: &Path, seed: Option<u64>, out: Option<&Path>) -> Result<Campaign, LoadError> {
    let mut place = None;
    let spec =
        load(path, |typed: &CalibrateSpec, faults| checked(typed, path, seed, out, &mut place, faults))?;
    Ok(campaign(spec, path, place, out))
}

/// The same for a spec that is there as text; `file` is its name in messages, and files in it are relative to the working
/// folder.
///
/// # Errors
/// [`SpecError`] with every fault.
pub fn parse(file: &str, text: &str, seed: Option<u64>, out: Option<&Path>) -> Result<Campaign, SpecError> {
    let (mut place, path) = (None, Path::new(file));
    let spec = dynocal_files::spec::parse(file, text, |typed: &CalibrateSpec, faults| {
        checked(typed, path, seed, out, &mut place, faults)
    })?;
    Ok(campaign(spec, path, place, out))
}

fn checked(
    typed: &CalibrateSpec,
    path: &Path,
    seed: Option<u64>,
    out: Option<&Path>,
    place: &mut Option<Place>,
    faults: &mut Faults,
) -> Option<CalibrateSpec> {
    check::check(typed, faults);
    *place = Some(Place::of(path, typed.name.as_deref(), None, out, faults));
    Some(CalibrateSpec { seed: seed.unwrap_or(typed.seed), ..typed.clone() })
}

fn campaign(mut spec: CalibrateSpec, path: &Path, place: Option<Place>, out: Option<&Path>) -> Campaign {
    // Files in a spec are relative to its folder.
    let folder = path.parent().unwrap_or(Path::new(""));
    given_files(&mut spec).for_each(|f| *f = folder.join(&*f));
    let Place { name, out } = place.unwrap_or_else(|| Place::run("calibrate", out));
    Campaign { name, spec, out }
}

/// All files that a spec names.
fn given_files(spec: &mut CalibrateSpec) -> impl Iterator<Item = &mut PathBuf> {
    let e = &mut spec.excite;
    let a2l = spec.export.as_mut().and_then(|e| e.a2l.as_mut());
    let maps = spec.optimise.start_maps.iter_mut().flat_map(|m| &mut m.files);
    e.identification_files
        .iter_mut()
        .chain(&mut e.validation_files)
        .chain(spec.identify.files.values_mut())
        .chain(&mut spec.design.record)
        .chain(&mut spec.plant.file)
        .chain(spec.fuelling.iter_mut().flat_map(|f| f.file.iter_mut().chain(&mut f.spec)))
        .chain(maps)
        .chain(a2l)
}

/// Opens the files that a campaign is given, without running anything.
///
/// # Errors
/// [`ChainError`]: the first file that does not fit.
pub fn check_given(campaign: &Campaign) -> Result<(), ChainError> {
    let ctx = context(&campaign.spec, &campaign.out, None, Watch::silent());
    let governs = fuelled::governs(&ctx)?;
    let governed = governs.as_ref().map(|by| fuel_plant::checked(&campaign.spec, by)).transpose()?;
    let on = on_plant(&ctx, governs.as_ref().zip(governed.as_ref()), None);
    super::given::check(on.as_ref().unwrap_or(&ctx))?;
    fuelled::check(&ctx)
}

fn context<'a>(
    spec: &'a CalibrateSpec,
    out: &Path,
    plants: Option<PlantFactory<'a>>,
    watch: Watch<'a>,
) -> Context<'a> {
    Context {
        spec,
        channels: Channels::of(spec),
        plants,
        measured: out.join(MEASURED),
        watch,
        begun: AtomicUsize::new(0),
        tuned: OnceLock::new(),
        fuelling: OnceLock::new(),
    }
}

/// The campaign on engine and fuelling as one plant, where they are: its spec, and plants of `make` where it has any.
fn on_plant<'a>(
    whole: &Context<'a>,
    governed: Option<(&Governs, &'a CalibrateSpec)>,
    make: Option<PlantFactory<'a>>,
) -> Option<Context<'a>> {
    let (by, spec) = governed?;
    let plain = Channels::of(spec);
    // Only what is modelled can be read.
    let read = by.read().filter(|r| plain.others.contains(r)).cloned().collect();
    let channels = Channels { read, watched: vec![by.lambda.clone()], ..plain };
    let plants = make.filter(|_| whole.plants.is_some());
    let measured = whole.measured.clone();
    Some(Context { channels, measured, ..context(spec, Path::new(""), plants, whole.watch) })
}

/// The last step that a campaign can do: the comparison of the maps steps a plant itself, which is not there on a real bed.
pub fn last_step(spec: &CalibrateSpec) -> &'static str {
    let stepped = plants::find(&spec.plant.name).is_some_and(|p| p.make.is_some());
    if stepped { run::STEPS[run::STEPS.len() - 1] } else { run::STEPS[run::STEPS.len() - 2] }
}

/// Runs the steps up to `until` and writes summary and report.
///
/// # Errors
/// [`ChainError`]; finished steps are kept.
pub fn run(campaign: &Campaign, until: &str, watch: Watch) -> Result<Finished, ChainError> {
    let spec = &campaign.spec;
    let mut folder = RunFolder::open_at(&campaign.out, KIND, spec)?;
    let make = plants::find(&spec.plant.name).and_then(|p| p.make);
    let factory = |noise: bool| -> Result<Box<dyn Plant>, PlantError> {
        match make {
            Some(make) => make(&spec.plant, noise),
            None => Err(PlantError::Call(format!("plant `{}` is run outside", spec.plant.name))),
        }
    };
    let ctx = context(spec, &campaign.out, make.is_some().then_some(&factory), watch);
    // A search that is stopped inside says so in its own words; to the user it is one thing.
    let governs = fuelled::governs(&ctx)?;
    let governed = governs.as_ref().map(|by| fuel_plant::checked(spec, by)).transpose()?;
    let as_one = |noise: bool| fuelled::plant(&ctx, noise);
    let on = on_plant(&ctx, governs.as_ref().zip(governed.as_ref()), Some(&as_one));
    let on = on.as_ref().unwrap_or(&ctx);
    let result = run::run(&ctx, on, &mut folder, until).map_err(|e| match e {
        ChainError::Files(_) | ChainError::NeedsMeasurement { .. } => e,
        _ if watch.interrupted() => ChainError::Interrupted,
        _ => e,
    })?;
    ctx.begin(run::STEPS.len(), run::STEPS.len() + 1, "report");
    let verdict = verdict::of(spec, &result);
    let files = store::files(&campaign.out, &result)?;
    let summary = Summary::new(&campaign.name, spec, &result, &verdict, &files);
    let report = page::write(&campaign.out, (&ctx, on), &summary, &result)?;
    let summary = folder.write_summary(&summary)?;
    Ok(Finished {
        result,
        valid: verdict.valid,
        warnings: verdict.warnings,
        verdict: verdict.words,
        summary,
        report,
    })
}

/// Builds summary and report again from the finished steps of a run folder.
pub fn rebuild(path: &Path) -> Result<Finished, ChainError> {
    let (name, spec, result) = store::run(path)?;
    let verdict = verdict::of(&spec, &result);
    let files = store::files(path, &result)?;
    let summary = Summary::new(&name, &spec, &result, &verdict, &files);
    // Nothing is run: the report reads records and models of the folder.
    let ctx = context(&spec, path, None, Watch::silent());
    let governs = result.excite.as_ref().and_then(|d| d.result.fuelled.as_ref()?.governs.as_ref());
    let governed = governs.map(|by| fuel_plant::spec(&spec, by));
    let on = on_plant(&ctx, governs.zip(governed.as_ref()), None);
    let report = page::write(path, (&ctx, on.as_ref().unwrap_or(&ctx)), &summary, &result)?;
    let summary_path = path.join("summary.json");
    dynocal_files::json::write_versioned(&summary_path, "dynocal/summary", 1, &summary)?;
    Ok(Finished {
        result,
        valid: verdict.valid,
        warnings: verdict.warnings,
        verdict: verdict.words,
        summary: summary_path,
        report,
    })
}
