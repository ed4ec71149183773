//! Models and FMUs as nodes of a function.

use std::fmt::{self, Debug, Formatter};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use dynocal_files::json;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::plant::{Causality, Plant};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Quantity, StoredModel};
use dynocal_label::graph::outside::{Outside, Response};
use dynocal_plant::plants::{self, PlantSpec};

/// Share by which a step between stamps may differ from the sample time of a model.
const UNEVEN: f64 = 1e-3;

/// The model or FMU in `path`; `output` names one of several.
///
/// # Errors
/// Found and expected, in words.
pub(super) fn read(path: &Path, output: Option<&str>) -> Result<Outside, (String, String)> {
    let is_fmu = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("fmu"));
    if is_fmu { unit(path, output) } else { stored(path, output) }
}

fn named(path: &Path, inputs: Vec<Quantity>, unit: String, response: Arc<dyn Response>) -> Outside {
    let inputs = inputs.into_iter().map(|q| (q.name, q.unit)).collect();
    Outside { name: path.display().to_string(), inputs, unit, response }
}

/// A stored model, which runs free from rest.
struct Stored {
    model: StoredModel,
    inputs: Vec<Quantity>,
}

impl Debug for Stored {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "Stored({})", self.model.user_output().name)
    }
}

fn stored(path: &Path, output: Option<&str>) -> Result<Outside, (String, String)> {
    let wrong = |found: String| (found, "a stored model or an FMU (`.fmu`)".to_string());
    let model: StoredModel =
        json::read_versioned(path, MODEL_SCHEMA, MODEL_VERSION).map_err(|e| wrong(e.to_string()))?;
    model.check().map_err(|e| wrong(e.to_string()))?;
    let own = model.user_output();
    if let Some(other) = output.filter(|o| *o != own.name) {
        return Err((format!("the output `{other}`"), format!("`{}`, the one of the model", own.name)));
    }
    let inputs = model.measured_inputs();
    if inputs.iter().any(|q| q.name == own.name) {
        return Err(wrong(format!("a model whose output `{}` is also its input", own.name)));
    }
    let response = Arc::new(Stored { model, inputs: inputs.clone() });
    Ok(named(path, inputs, own.unit, response))
}

impl Response for Stored {
    fn values(&self, time_s: &[f64], inputs: &[&[f64]]) -> Result<Vec<f64>, String> {
        let n = time_s.len();
        let step_s = (time_s[n - 1] - time_s[0]) / (n.max(2) - 1) as f64;
        let uneven = time_s.windows(2).find(|w| !((w[1] - w[0] - step_s).abs() <= UNEVEN * step_s));
        if let Some(w) = uneven.filter(|_| !self.model.is_steady()) {
            return Err(format!(
                "found a step of {:.4} s at {:.3} s, expected stamps {step_s:.4} s apart, as the model has its own sample time",
                w[1] - w[0],
                w[0]
            ));
        }
        let channels = self.inputs.iter().zip(inputs).map(|(q, x)| Channel {
            name: q.name.clone(),
            unit: q.unit.clone(),
            role: Role::Input,
            values: x.to_vec(),
        });
        let record = Dataset {
            name: "node".into(),
            sample_time_s: if self.model.is_steady() { self.model.sample_time_s } else { step_s },
            channels: channels.collect(),
            init_samples: 0,
            origin: String::new(),
        };
        let found = self.model.simulate(&record, None).map_err(|e| e.to_string())?;
        let y = found.into_iter().next().map(|c| c.y).unwrap_or_default();
        match y.iter().position(|v| !v.is_finite()) {
            Some(k) => Err(format!("the output is not a finite number from {:.3} s on", time_s[k])),
            None => Ok(y),
        }
    }
}

/// An FMU: what enters at one stamp acts until the next one.
struct Unit {
    plant: Mutex<Box<dyn Plant>>,
    /// Number of its outputs, and of the one that is read.
    outputs: usize,
    at: usize,
    about: String,
}

impl Debug for Unit {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "Unit({})", self.about)
    }
}

fn unit(path: &Path, output: Option<&str>) -> Result<Outside, (String, String)> {
    let wrong = |found: String| (found, "an FMU for co-simulation".to_string());
    let spec = PlantSpec { name: "fmu".into(), file: Some(path.to_path_buf()), ..PlantSpec::default() };
    let make = plants::find("fmu").and_then(|m| m.make).ok_or_else(|| wrong("no FMU".into()))?;
    let plant = make(&spec, false).map_err(|e| wrong(e.to_string()))?;
    let of = |c: Causality| plant.variables().iter().filter(move |v| v.causality == c);
    let quantity =
        |v: &dynocal_ident::plant::Variable| Quantity { name: v.name.clone(), unit: v.unit.clone() };
    let inputs: Vec<Quantity> = of(Causality::Input).map(quantity).collect();
    let outputs: Vec<Quantity> = of(Causality::Output).map(quantity).collect();
    let known = || outputs.iter().map(|q| format!("`{}`", q.name)).collect::<Vec<_>>().join(", ");
    let at = match (output, outputs.len()) {
        (None, 1) => Some(0),
        (None, _) => None,
        (Some(name), _) => outputs.iter().position(|q| q.name == name),
    };
    let Some(at) = at else {
        let found = output.map_or("no `output`".to_string(), |o| format!("the output `{o}`"));
        return Err((found, format!("one of {}", known())));
    };
    let (about, own, outputs) = (plant.describe(), outputs[at].unit.clone(), outputs.len());
    let response = Arc::new(Unit { plant: Mutex::new(plant), outputs, at, about });
    Ok(named(path, inputs, own, response))
}

impl Response for Unit {
    fn values(&self, time_s: &[f64], inputs: &[&[f64]]) -> Result<Vec<f64>, String> {
        let mut plant = self.plant.lock().unwrap_or_else(PoisonError::into_inner);
        plant.reset(0);
        let mut outputs = vec![0.0; self.outputs];
        plant.outputs(&mut outputs).map_err(|e| e.to_string())?;
        let mut y = vec![outputs[self.at]];
        let mut held = vec![0.0; inputs.len()];
        for t in 1..time_s.len() {
            held.iter_mut().zip(inputs).for_each(|(h, x)| *h = x[t - 1]);
            let step_s = time_s[t] - time_s[t - 1];
            // Stamps of a log may repeat.
            if step_s > 0.0 {
                let at = |e: dynocal_ident::plant::PlantError| format!("at {:.3} s: {e}", time_s[t]);
                plant.step(&held, step_s, &mut outputs).map_err(at)?;
            }
            y.push(outputs[self.at]);
        }
        Ok(y)
    }
}
