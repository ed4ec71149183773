//! A steady calibration that is ready to run: its spec read, filled in and checked, and where the run goes.

use dynocal_files::run_folder::RunPlace;
use std::path::Path;

use dynocal_files::spec::{Faults, LoadError, SpecError};

use super::check::check;
use super::spec::MapSpec;
use crate::place::{Overrides, Place};

/// A checked spec and where its run goes.
#[derive(Clone, Debug)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Run folder.
    pub out: RunPlace,
    /// The checked spec, its axes and held values filled in.
    pub spec: MapSpec,
}

impl Job {
    /// The plant in words.
    pub fn plant(&self) -> String {
        let p = &self.spec.plant;
        if p.name == "virtual_engine" { format!("{} {}", p.name, p.parameters) } else { p.name.clone() }
    }
}

/// Reads and checks the spec at `path`.
///
/// # Errors
/// [`LoadError`] with every fault.
pub fn read(path: &Path, overrides: &Overrides) -> Result<Job, LoadError> {
    dynocal_files::spec::load(path, |t: &MapSpec, faults| checked(t, path, overrides, faults))
}

/// The same for a spec that is there as text; `file` is its name in messages.
///
/// # Errors
/// [`SpecError`] with every fault.
pub fn parse(file: &str, text: &str, overrides: &Overrides) -> Result<Job, SpecError> {
    dynocal_files::spec::parse(file, text, |t: &MapSpec, faults| {
        checked(t, Path::new(file), overrides, faults)
    })
}

fn checked(t: &MapSpec, path: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let mut spec = MapSpec { seed: over.seed.unwrap_or(t.seed), ..t.clone() };
    spec.edits = spec.edits.map(|file| path.parent().unwrap_or(Path::new("")).join(file));
    fill(&mut spec);
    check(&spec, faults);
    let place = Place::of(path, t.name.as_deref(), None, over.out.as_deref(), faults);
    faults.is_empty().then_some(Job { name: place.name, out: place.out, spec })
}

/// Values of an axis that the spec does not give.
const AXIS: usize = 8;

/// Axes and held values that the spec leaves open.
fn fill(s: &mut MapSpec) {
    if s.axes.is_empty() {
        let even =
            |(a, b): (f64, f64)| (0..AXIS).map(|k| a + (b - a) * k as f64 / (AXIS - 1) as f64).collect();
        let demand = s.problem.demands.first().map(|d| (d.output.clone(), even((d.lower, d.upper))));
        let given = s.problem.given.first().map(|g| (g.name.clone(), even((g.lower, g.upper))));
        s.axes = demand.into_iter().chain(given).collect();
    }
    let demands = s.problem.demands.iter().map(|d| (&d.output, d.lower, d.upper));
    let given = s.problem.given.iter().map(|g| (&g.name, g.lower, g.upper));
    for (name, lower, upper) in demands.chain(given) {
        if !s.axes.contains_key(name) && !s.held.contains_key(name) {
            s.held.insert(name.clone(), 0.5 * (lower + upper));
        }
    }
}
