//! The plants that a spec can name: one row each, for the parser of specs and for `dynocal list plants`.
//!
//! The table stands here because this is the only crate that sees both the campaigns and the plants.

use dynocal_calib::chain::spec::PlantSpec;
use dynocal_files::spec::Faults;
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_numerics::registry::{MemberDoc, ParamDoc};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;

/// Makes a plant, with the sensor noise of the spec or free of noise.
type Make = fn(&PlantSpec, noise: bool) -> Result<Box<dyn Plant>, PlantError>;

/// One row of the table.
pub(crate) struct PlantMember {
    /// Name and keys of `[plant]`.
    pub(crate) doc: MemberDoc,
    /// Faults of its keys.
    check: fn(&PlantSpec, &mut Faults),
    /// Makes it; none when records are measured outside and read from files.
    pub(crate) make: Option<Make>,
}

/// All plants.
pub(crate) static PLANTS: &[PlantMember] = &[
    PlantMember {
        doc: MemberDoc {
            name: "virtual_engine",
            what: "Embedded gasoline engine: crank-angle resolved, speed imposed by an ideal dynamometer",
            params: &[
                ParamDoc { name: "parameters", unit: "-", default: "thesis", what: "Parameter set (thesis)" },
                ParamDoc {
                    name: "torque_noise_nm",
                    unit: "Nm",
                    default: "0",
                    what: "Standard deviation of white sensor noise on torque",
                },
                ParamDoc {
                    name: "lambda_noise",
                    unit: "-",
                    default: "0",
                    what: "Standard deviation of white sensor noise on lambda",
                },
            ],
        },
        check: check_virtual_engine,
        make: Some(virtual_engine),
    },
    PlantMember {
        doc: MemberDoc {
            name: "bed",
            what: "Real bed: plans are written to files, measured records are read from RUN/measured",
            params: &[],
        },
        check: |_, _| (),
        make: None,
    },
];

/// The row of `name`.
pub(crate) fn find(name: &str) -> Option<&'static PlantMember> {
    PLANTS.iter().find(|p| p.doc.name == name)
}

/// Faults of the table `[plant]` of a spec.
pub(crate) fn check(spec: &PlantSpec, faults: &mut Faults) {
    match find(&spec.name) {
        Some(member) => (member.check)(spec, faults),
        None => {
            let known: Vec<String> = PLANTS.iter().map(|p| p.doc.name.to_string()).collect();
            faults.unknown("plant.name", &spec.name, &known);
        }
    }
}

/// A parameter set by name.
type Set = (&'static str, fn() -> EngineParams);

/// Parameter sets of the virtual engine.
const SETS: [Set; 1] = [("thesis", EngineParams::thesis)];

fn check_virtual_engine(spec: &PlantSpec, faults: &mut Faults) {
    if !SETS.iter().any(|s| s.0 == spec.parameters) {
        faults.unknown("plant.parameters", &spec.parameters, &SETS.map(|s| s.0.to_string()));
    }
    faults.range("plant.torque_noise_nm", spec.torque_noise_nm, 0.0, 20.0, "Nm");
    faults.range("plant.lambda_noise", spec.lambda_noise, 0.0, 0.2, "");
}

fn virtual_engine(spec: &PlantSpec, noise: bool) -> Result<Box<dyn Plant>, PlantError> {
    let (name, params) = SETS
        .iter()
        .find(|s| s.0 == spec.parameters)
        .ok_or_else(|| PlantError::Call(format!("no parameter set `{}`", spec.parameters)))?;
    let mut settings = BedSettings { set_name: (*name).into(), ..BedSettings::default() };
    if noise {
        settings.noise.torque_nm = spec.torque_noise_nm;
        settings.noise.lambda = spec.lambda_noise;
    }
    let bed = EngineBed::new(&params(), settings).map_err(|e| PlantError::Call(e.to_string()))?;
    Ok(Box::new(bed))
}
