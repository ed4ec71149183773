//! A user's FMU as a plant: `[plant] name = "fmu"`, `file`, and under `[plant.fmu]` its parameters and ranges.

use std::collections::BTreeMap;
use std::path::PathBuf;

use dynocal_fmu::{FmuPlant, FmuSettings};
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::registry::{MemberDoc, ParamDoc};
use serde::Deserialize;

use crate::plants::{PlantFault, PlantMember, PlantSpec};

/// Row of the table of plants.
pub(super) const MEMBER: PlantMember = PlantMember {
    doc: MemberDoc {
        name: "fmu",
        what: "A user's FMU (FMI 2.0 or 3.0, co-simulation); it runs with the rights of the program",
        params: &[
            ParamDoc {
                name: "file",
                unit: "-",
                default: "none",
                what: "The FMU, relative to the working folder",
            },
            ParamDoc { name: "fmu.parameters", unit: "-", default: "{}", what: "Its parameters by name" },
            ParamDoc {
                name: "fmu.ranges",
                unit: "-",
                default: "{}",
                what: "Least and greatest value of channels",
            },
        ],
    },
    check: faults,
    make: Some(make),
    sample_time_s: None,
};

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Keys {
    parameters: BTreeMap<String, f64>,
    ranges: BTreeMap<String, Interval>,
}

/// Faults of the keys: an FMU has no keys of the virtual engine.
fn faults(spec: &PlantSpec) -> Vec<PlantFault> {
    let own = PlantSpec {
        name: spec.name.clone(),
        file: spec.file.clone(),
        fmu: spec.fmu.clone(),
        ..PlantSpec::default()
    };
    let foreign =
        (*spec != own).then(|| PlantFault::new("plant", "further keys", "name, file and fmu alone"));
    settings(spec).err().into_iter().chain(foreign).collect()
}

fn settings(spec: &PlantSpec) -> Result<(PathBuf, FmuSettings), PlantFault> {
    let file =
        spec.file.clone().ok_or_else(|| PlantFault::new("plant.file", "nothing", "the path of an FMU"))?;
    let keys: Keys = toml::Value::Table(spec.fmu.clone()).try_into().map_err(|e: toml::de::Error| {
        PlantFault::new("plant.fmu", e.message(), "tables `parameters` and `ranges`")
    })?;
    if let Some((name, range)) =
        keys.ranges.iter().find(|(_, r)| r.lower.partial_cmp(&r.upper) != Some(std::cmp::Ordering::Less))
    {
        return Err(PlantFault::new(
            format!("plant.fmu.ranges.{name}"),
            format!("{} to {}", range.lower, range.upper),
            "the lower end first",
        ));
    }
    let settings = FmuSettings { parameters: keys.parameters, ranges: keys.ranges };
    Ok((file, settings))
}

fn make(spec: &PlantSpec, _noise: bool) -> Result<Box<dyn Plant>, PlantError> {
    let (file, settings) = settings(spec)
        .map_err(|f| PlantError::Call(format!("{}: found {}, expected {}", f.key, f.found, f.expected)))?;
    let plant = FmuPlant::open(&file, &settings).map_err(|e| PlantError::Call(e.to_string()))?;
    Ok(Box::new(plant))
}
