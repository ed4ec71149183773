//! The unit as a plant.

use std::collections::BTreeMap;
use std::path::Path;

use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};
use dynocal_numerics::interval::Interval;
use tempfile::TempDir;

use crate::archive;
use crate::description::{Description, FmiVariable, Role, Version};
use crate::error::FmuError;
use crate::library::Instance;
use crate::library2::Unit2;
use crate::library3::Unit3;

/// What the user decides.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FmuSettings {
    /// Parameters and their values.
    pub parameters: BTreeMap<String, f64>,
    /// Ranges of inputs and outputs, where the description has none.
    pub ranges: BTreeMap<String, Interval>,
}

/// One step that was made since the last start.
#[derive(Clone, Debug)]
struct Made {
    inputs: Vec<f64>,
    step_s: f64,
}

/// A unit that answers tests.
///
/// Its state is saved as the unit's own bytes where it can serialise; else the steps since the last start are kept and
/// made again, which is exact and takes their time.
pub struct FmuPlant {
    path: String,
    about: Description,
    instance: Box<dyn Instance>,
    variables: Vec<Variable>,
    inputs: Vec<u32>,
    outputs: Vec<u32>,
    parameters: Vec<(u32, f64)>,
    time_s: f64,
    made: Vec<Made>,
    /// Why the unit cannot go on: a start that it refused.
    broken: Option<FmuError>,
    /// Whether its state comes out as bytes and goes in again.
    serialises: bool,
    /// The unpacked archive; the library is loaded from it.
    _folder: TempDir,
}

impl FmuPlant {
    /// Unpacks, loads and starts the FMU at `path`.
    ///
    /// # Errors
    /// [`FmuError`].
    pub fn open(path: &Path, settings: &FmuSettings) -> Result<Self, FmuError> {
        let name = path.display().to_string();
        let mut archive = archive::open(path)?;
        let about = Description::parse(&name, &archive::description(path, &mut archive)?)?;
        let wanted = archive::binary_path(&about);
        let folder = archive::unpack(path, &mut archive, &wanted)?;
        let binary = folder.path().join(&wanted);
        let resources = folder.path().join("resources");
        let instance: Box<dyn Instance> = match about.version {
            Version::Two => {
                let uri = format!("file://{}", resources.display());
                Box::new(Unit2::load(&name, &binary, &uri, &about)?)
            }
            Version::Three => {
                Box::new(Unit3::load(&name, &binary, &format!("{}/", resources.display()), &about)?)
            }
        };
        let parameters = parameters(&name, &about, &settings.parameters)?;
        ranges(&name, &about, &settings.ranges)?;
        let of = |role: Role| about.variables.iter().filter(move |v| v.role == role);
        let variables = of(Role::Input).chain(of(Role::Output)).map(|v| variable(v, settings)).collect();
        let serialises = about.serialises;
        let mut plant = Self {
            inputs: of(Role::Input).map(|v| v.reference).collect(),
            outputs: of(Role::Output).map(|v| v.reference).collect(),
            path: name,
            instance,
            variables,
            parameters,
            time_s: 0.0,
            made: Vec::new(),
            broken: None,
            serialises,
            _folder: folder,
            about,
        };
        plant.start()?;
        plant.first_outputs()?;
        // A description may promise more than the binary does: then the steps are made again instead.
        plant.serialises =
            serialises && plant.instance.save().is_ok_and(|b| plant.instance.restore(&b).is_ok());
        Ok(plant)
    }

    /// What the unit says about itself.
    pub fn description(&self) -> &Description {
        &self.about
    }

    /// What the outputs are before the first step: the unit says it, not its description.
    fn first_outputs(&mut self) -> Result<(), FmuError> {
        let mut values = vec![0.0; self.outputs.len()];
        self.instance.get(&self.outputs, &mut values)?;
        for (v, y) in self.variables[self.inputs.len()..].iter_mut().zip(values) {
            if !y.is_finite() {
                let reason =
                    format!("the output `{}` is {y} after the start, expected a finite number", v.name);
                return Err(FmuError::Description { path: self.path.clone(), line: 0, reason });
            }
            v.start = y;
        }
        Ok(())
    }

    fn start(&mut self) -> Result<(), FmuError> {
        let inputs = self.about.variables.iter().filter(|v| v.role == Role::Input);
        let starts = inputs.filter_map(|v| v.start.map(|s| (v.reference, s)));
        let all: Vec<(u32, f64)> = self.parameters.iter().copied().chain(starts).collect();
        self.instance.start(&all)?;
        self.time_s = 0.0;
        self.made.clear();
        Ok(())
    }

    fn advance(&mut self, inputs: &[f64], dt_s: f64) -> Result<(), FmuError> {
        self.instance.set(&self.inputs, inputs)?;
        self.instance.step(self.time_s, dt_s)?;
        self.time_s += dt_s;
        Ok(())
    }
}

fn variable(v: &FmiVariable, settings: &FmuSettings) -> Variable {
    let stated = settings.ranges.get(&v.name);
    // A description without limits allows every number.
    let min = stated.map(|r| r.lower).or(v.min).unwrap_or(f64::MIN);
    let max = stated.map(|r| r.upper).or(v.max).unwrap_or(f64::MAX);
    Variable {
        name: v.name.clone(),
        unit: v.unit.clone(),
        causality: if v.role == Role::Input { Causality::Input } else { Causality::Output },
        min,
        max,
        start: v.start.unwrap_or(0.0).clamp(min, max),
    }
}

fn parameters(
    path: &str,
    about: &Description,
    wanted: &BTreeMap<String, f64>,
) -> Result<Vec<(u32, f64)>, FmuError> {
    let find = |(name, value): (&String, &f64)| {
        let known = || about.variables.iter().filter(|v| v.role == Role::Parameter);
        known().find(|v| v.name == *name).map(|v| (v.reference, *value)).ok_or_else(|| {
            FmuError::Description {
                path: path.into(),
                line: 0,
                reason: format!(
                    "found no parameter `{name}`; there are: {}",
                    known().map(|v| v.name.as_str()).collect::<Vec<_>>().join(", ")
                ),
            }
        })
    };
    wanted.iter().map(find).collect()
}

fn ranges(path: &str, about: &Description, wanted: &BTreeMap<String, Interval>) -> Result<(), FmuError> {
    let known = || about.variables.iter().filter(|v| matches!(v.role, Role::Input | Role::Output));
    match wanted.keys().find(|name| !known().any(|v| v.name == **name)) {
        None => Ok(()),
        Some(name) => Err(FmuError::Description {
            path: path.into(),
            line: 0,
            reason: format!(
                "found no input or output `{name}`; there are: {}",
                known().map(|v| v.name.as_str()).collect::<Vec<_>>().join(", ")
            ),
        }),
    }
}

/// Six bytes in a number: exact in an f64.
fn pack(bytes: &[u8]) -> Vec<f64> {
    let word = |c: &[u8]| c.iter().rev().fold(0u64, |a, b| a << 8 | u64::from(*b)) as f64;
    std::iter::once(bytes.len() as f64).chain(bytes.chunks(6).map(word)).collect()
}

/// The bytes again; `None` where the numbers are not those of [`pack`].
fn unpack(numbers: &[f64]) -> Option<Vec<u8>> {
    let (length, words) = numbers.split_first()?;
    if *length != length.trunc() || words.len() as f64 != (length / 6.0).ceil() {
        return None;
    }
    let mut out: Vec<u8> = words.iter().flat_map(|w| (*w as u64).to_le_bytes()[..6].to_vec()).collect();
    out.truncate(*length as usize);
    Some(out)
}

impl Plant for FmuPlant {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }

    fn reset(&mut self, _seed: u64) {
        // There is no way to refuse here: the next step does, and says why.
        self.broken = self.start().err();
    }

    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        if inputs.len() != self.inputs.len() || outputs.len() != self.outputs.len() {
            return Err(PlantError::Call(format!(
                "{}: found {} inputs and {} outputs, expected {} and {}",
                self.path,
                inputs.len(),
                outputs.len(),
                self.inputs.len(),
                self.outputs.len()
            )));
        }
        for (v, x) in self.variables.iter().zip(inputs) {
            if !x.is_finite() {
                return Err(PlantError::NonFinite { name: v.name.clone(), time_s: self.time_s });
            }
            if !(v.min..=v.max).contains(x) {
                return Err(PlantError::OutOfRange {
                    name: v.name.clone(),
                    found: *x,
                    unit: v.unit.clone(),
                    min: v.min,
                    max: v.max,
                    time_s: self.time_s,
                });
            }
        }
        let refused = |e: FmuError| PlantError::Call(e.to_string());
        self.broken.clone().map_or(Ok(()), Err).map_err(refused)?;
        self.advance(inputs, dt_s).map_err(refused)?;
        self.instance.get(&self.outputs, outputs).map_err(refused)?;
        let names = self.variables[self.inputs.len()..].iter().map(|v| &v.name);
        if let Some((name, _)) = names.zip(outputs.iter()).find(|(_, y)| !y.is_finite()) {
            return Err(PlantError::NonFinite { name: name.clone(), time_s: self.time_s });
        }
        if !self.serialises {
            self.made.push(Made { inputs: inputs.to_vec(), step_s: dt_s });
        }
        Ok(())
    }

    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        if outputs.len() != self.outputs.len() {
            let (found, expected) = (outputs.len(), self.outputs.len());
            return Err(PlantError::Call(format!(
                "{}: {found} outputs asked for, expected {expected}",
                self.path
            )));
        }
        let refused = |e: FmuError| PlantError::Call(e.to_string());
        self.broken.clone().map_or(Ok(()), Err).map_err(refused)?;
        self.instance.get(&self.outputs, outputs).map_err(refused)
    }

    fn time_s(&self) -> f64 {
        self.time_s
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }

    fn save(&self) -> PlantState {
        let mut numbers = vec![self.time_s];
        if self.serialises {
            // A unit that refuses leaves a state that `restore` refuses.
            numbers.extend(self.instance.save().map(|b| pack(&b)).unwrap_or_default());
        }
        for m in &self.made {
            numbers.push(m.step_s);
            numbers.extend_from_slice(&m.inputs);
        }
        PlantState(numbers)
    }

    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        let refused = |e: FmuError| PlantError::Call(e.to_string());
        let foreign = || PlantError::Call(format!("{}: the state is not this plant's", self.path));
        let (time_s, rest) = state.0.split_first().ok_or_else(foreign)?;
        if self.serialises {
            self.instance.restore(&unpack(rest).ok_or_else(foreign)?).map_err(refused)?;
            self.time_s = *time_s;
            return Ok(());
        }
        let row = self.inputs.len() + 1;
        if !rest.len().is_multiple_of(row) {
            return Err(foreign());
        }
        self.start().map_err(refused)?;
        for made in rest.chunks(row) {
            self.advance(&made[1..], made[0]).map_err(refused)?;
            self.made.push(Made { inputs: made[1..].to_vec(), step_s: made[0] });
        }
        Ok(())
    }

    fn describe(&self) -> String {
        let number = if self.about.version == Version::Two { "2.0" } else { "3.0" };
        format!("FMU {} (FMI {number}, {}), {}", self.about.model, self.about.token, self.path)
    }
}
