//! One instance: a plant with its inputs, outputs and parameters as numbered variables.

use std::path::Path;

use dynocal_ident::plant::{Causality, Plant, PlantState, Variable};
use dynocal_plant::params::EngineParams;
use dynocal_plant::plants::{PlantSpec, find, parameters, virtual_engine_with};
use serde_json::Value;

/// File of the resources: the table `[plant]` of a spec.
pub const PLANT: &str = "plant.toml";
/// File of the resources: a parameter set that came from a file.
pub const PARAMETERS: &str = "parameters.toml";
/// Seed of sensor noise.
const SEED: u64 = 0;

/// A parameter of the engine: its path in the parameter set and its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name, e.g. `throttle.diameter_m` or `valve.lift[2]`.
    pub name: String,
    /// Value.
    pub value: f64,
}

/// What an instance is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The plant.
    pub spec: PlantSpec,
    /// The engine's numbers.
    pub parameters: Vec<Parameter>,
    tree: Value,
}

fn flatten(prefix: &str, value: &Value, out: &mut Vec<Parameter>) {
    let join = |k: &str| if prefix.is_empty() { k.to_string() } else { format!("{prefix}.{k}") };
    match value {
        // Whole numbers are counts (cylinders, nodes): they shape the engine and are no parameters.
        Value::Number(n) if n.is_f64() => {
            out.push(Parameter { name: prefix.into(), value: n.as_f64().unwrap_or(f64::NAN) });
        }
        Value::Object(map) => map.iter().for_each(|(k, v)| flatten(&join(k), v, out)),
        // Names of FMI: a matrix has its indices in one pair of brackets.
        Value::Array(list) => list.iter().enumerate().for_each(|(k, v)| {
            let name = match prefix.strip_suffix(']') {
                Some(outer) => format!("{outer},{}]", k + 1),
                None => format!("{prefix}[{}]", k + 1),
            };
            flatten(&name, v, out);
        }),
        _ => {}
    }
}

/// Puts the values back in the order in which [`flatten`] met them.
fn unflatten(value: &mut Value, values: &mut std::slice::Iter<'_, Parameter>) {
    match value {
        Value::Number(n) if n.is_f64() => {
            if let Some(x) = values.next().and_then(|p| serde_json::Number::from_f64(p.value)) {
                *n = x;
            }
        }
        Value::Object(map) => map.values_mut().for_each(|v| unflatten(v, values)),
        Value::Array(list) => list.iter_mut().for_each(|v| unflatten(v, values)),
        _ => {}
    }
}

impl Setup {
    /// The plant of a spec with the parameters of its set.
    ///
    /// # Errors
    /// What is wrong with the spec.
    pub fn new(spec: PlantSpec) -> Result<Self, String> {
        if let Some(fault) = dynocal_plant::plants::check(&spec).first() {
            return Err(format!("{}: found {}, expected {}", fault.key, fault.found, fault.expected));
        }
        // Only the virtual engine has parameters of its own; a published model is what it is.
        let tree = match spec.name.as_str() {
            "virtual_engine" => {
                let params = parameters(&spec.parameters).map_err(|e| e.to_string())?;
                serde_json::to_value(&params).map_err(|e| e.to_string())?
            }
            _ => Value::Null,
        };
        let mut parameters = Vec::new();
        flatten("", &tree, &mut parameters);
        Ok(Self { spec, parameters, tree })
    }

    /// What the resources of an FMU say: [`PLANT`], and [`PARAMETERS`] where the engine's numbers came from a file.
    ///
    /// # Errors
    /// A file that is missing or broken.
    pub fn from_resources(folder: &Path) -> Result<Self, String> {
        let path = folder.join(PLANT);
        let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        let mut spec: PlantSpec = toml::from_str(&text).map_err(|e| format!("{}: {e}", path.display()))?;
        let own = folder.join(PARAMETERS);
        if own.is_file() {
            spec.parameters = own.display().to_string();
        }
        Self::new(spec)
    }

    /// The engine's parameters as they are now.
    ///
    /// # Errors
    /// A value that the engine does not take.
    pub fn params(&self) -> Result<EngineParams, String> {
        if let Some(p) = self.parameters.iter().find(|p| !p.value.is_finite()) {
            return Err(format!("parameter {}: found {}, expected a finite number", p.name, p.value));
        }
        let mut tree = self.tree.clone();
        unflatten(&mut tree, &mut self.parameters.iter());
        serde_json::from_value(tree).map_err(|e| e.to_string())
    }

    fn plant(&self) -> Result<Box<dyn Plant>, String> {
        let make = find(&self.spec.name).and_then(|m| m.make);
        if self.spec.name == "virtual_engine" {
            return virtual_engine_with(&self.spec, &self.params()?, true).map_err(|e| e.to_string());
        }
        let make = make.ok_or_else(|| format!("the plant `{}` cannot be simulated", self.spec.name))?;
        make(&self.spec, true).map_err(|e| e.to_string())
    }
}

/// A plant at work.
pub struct Engine {
    setup: Setup,
    plant: Box<dyn Plant>,
    variables: Vec<Variable>,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
    time_s: f64,
    /// Parameters were changed and the plant is not yet made of them.
    stale: bool,
}

impl Engine {
    /// At the start.
    ///
    /// # Errors
    /// What is wrong with the setup.
    pub fn new(setup: Setup) -> Result<Self, String> {
        let mut plant = setup.plant()?;
        plant.reset(SEED);
        let variables = plant.variables().to_vec();
        let start = |c: Causality| variables.iter().filter(|v| v.causality == c).map(|v| v.start).collect();
        let (inputs, outputs) = (start(Causality::Input), start(Causality::Output));
        Ok(Self { setup, plant, variables, inputs, outputs, time_s: 0.0, stale: false })
    }

    /// Variables of the plant: inputs first.
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// Its setup.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// Back to the start with the parameters as they are.
    ///
    /// # Errors
    /// A value that the engine does not take.
    pub fn restart(&mut self, start_s: f64) -> Result<(), String> {
        if std::mem::take(&mut self.stale) {
            self.plant = self.setup.plant()?;
        }
        self.plant.reset(SEED);
        self.time_s = start_s;
        let starts = self.variables.iter().filter(|v| v.causality == Causality::Output).map(|v| v.start);
        self.outputs.iter_mut().zip(starts).for_each(|(y, v)| *y = v);
        Ok(())
    }

    /// Whole reset: inputs and parameters too.
    ///
    /// # Errors
    /// What is wrong with the setup.
    pub fn reset(&mut self) -> Result<(), String> {
        *self = Self::new(Setup::new(self.setup.spec.clone())?)?;
        Ok(())
    }

    /// Variable by its reference: 0 time, then inputs, outputs, parameters.
    pub fn get(&self, reference: u32) -> Option<f64> {
        let k = (reference as usize).checked_sub(1);
        let Some(k) = k else { return Some(self.time_s) };
        let (m, q) = (self.inputs.len(), self.outputs.len());
        let parameter = || self.setup.parameters.get(k - m - q).map(|p| p.value);
        if k < m {
            Some(self.inputs[k])
        } else if k < m + q {
            Some(self.outputs[k - m])
        } else {
            parameter()
        }
    }

    /// Sets an input, or a parameter (which acts from the next start).
    pub fn set(&mut self, reference: u32, value: f64) -> bool {
        let Some(k) = (reference as usize).checked_sub(1) else { return false };
        let (m, q) = (self.inputs.len(), self.outputs.len());
        if k < m {
            self.inputs[k] = value;
            return true;
        }
        match k.checked_sub(m + q).and_then(|k| self.setup.parameters.get_mut(k)) {
            Some(p) => {
                self.stale |= p.value.to_bits() != value.to_bits();
                p.value = value;
                true
            }
            None => false,
        }
    }

    /// Holds the inputs for `step_s`.
    ///
    /// # Errors
    /// What the plant says.
    pub fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), String> {
        self.plant.step(&self.inputs, step_s, &mut self.outputs).map_err(|e| e.to_string())?;
        self.time_s = time_s + step_s;
        Ok(())
    }

    /// Everything that changes, as numbers: time, inputs, outputs, parameters, the plant's state.
    pub fn save(&self) -> Vec<f64> {
        let mut out = vec![self.time_s];
        out.extend_from_slice(&self.inputs);
        out.extend_from_slice(&self.outputs);
        out.extend(self.setup.parameters.iter().map(|p| p.value));
        out.extend(self.plant.save().0);
        out
    }

    /// Continues from saved numbers, with the parameters that they were saved with.
    ///
    /// # Errors
    /// Numbers of something else.
    pub fn restore(&mut self, numbers: &[f64]) -> Result<(), String> {
        let (m, q, p) = (self.inputs.len(), self.outputs.len(), self.setup.parameters.len());
        let Some((own, plant)) = numbers.split_at_checked(1 + m + q + p) else {
            return Err(format!(
                "found a state of {} numbers, expected {} and more",
                numbers.len(),
                1 + m + q + p
            ));
        };
        let (inputs, rest) = own[1..].split_at(m);
        let (outputs, parameters) = rest.split_at(q);
        for (known, value) in self.setup.parameters.iter_mut().zip(parameters) {
            self.stale |= known.value.to_bits() != value.to_bits();
            known.value = *value;
        }
        if std::mem::take(&mut self.stale) {
            self.plant = self.setup.plant()?;
        }
        self.plant.restore(&PlantState(plant.to_vec())).map_err(|e| e.to_string())?;
        self.time_s = own[0];
        self.inputs.copy_from_slice(inputs);
        self.outputs.copy_from_slice(outputs);
        Ok(())
    }
}
