//! Parameter sets: the embedded ones by name, others from TOML text, with errors that name the line.

use super::EngineParams;
use crate::error::PlantError;
use dynocal_numerics::registry::MemberDoc;

/// An embedded parameter set.
#[derive(Debug)]
pub struct ParameterSet {
    /// Name and what it is.
    pub doc: MemberDoc,
    /// The documented TOML file.
    pub text: &'static str,
}

/// All embedded parameter sets.
pub static PARAMETER_SETS: &[ParameterSet] = &[
    ParameterSet {
        doc: MemberDoc {
            name: "thesis",
            what: "2.0 l, naturally aspirated range, imposed burn law: reproduces the published behaviour",
            params: &[],
        },
        text: include_str!("../../parameters/thesis.toml"),
    },
    ParameterSet {
        doc: MemberDoc {
            name: "pfi_1_6l",
            what: "1.6 l, port injection with fuel film, after thesis Table 3.1",
            params: &[],
        },
        text: include_str!("../../parameters/pfi_1_6l.toml"),
    },
    ParameterSet {
        doc: MemberDoc {
            name: "gtdi_2l",
            what: "2.0 l turbocharged, physical mode: knock, cam phasing, recirculation, emissions; class values",
            params: &[],
        },
        text: include_str!("../../parameters/gtdi_2l.toml"),
    },
    ParameterSet {
        doc: MemberDoc {
            name: "other_1_8l",
            what: "1.8 l turbocharged, other in structure: bore, cams, burn law, heat law, fuel, sensor; no engine behind it",
            params: &[],
        },
        text: include_str!("../../parameters/other_1_8l.toml"),
    },
    ParameterSet {
        doc: MemberDoc {
            name: "twin_2l",
            what: "2.0 l turbocharged, compression 10.8: fitted to the steady points of a measured engine",
            params: &[],
        },
        text: include_str!("../../parameters/twin_2l.toml"),
    },
];

/// Names that stand for an engine like a set (a set of its own for each seed).
pub const LIKE_A_SET: [&str; 2] = ["perturbed:SEED", "perturbed:SET:SEED"];

impl EngineParams {
    /// The embedded set of that name, or one like it: `perturbed:SEED`, `perturbed:SET:SEED`.
    ///
    /// # Errors
    /// [`PlantError::ParameterSet`] for an unknown name.
    ///
    /// ```
    /// use dynocal_plant::params::EngineParams;
    /// assert_eq!(EngineParams::named("thesis")?, EngineParams::thesis());
    /// # Ok::<(), dynocal_plant::error::PlantError>(())
    /// ```
    pub fn named(name: &str) -> Result<Self, PlantError> {
        if let Some((set, seed)) = super::perturb::parse(name) {
            return super::perturb::perturbed(&Self::named(set)?, seed);
        }
        match PARAMETER_SETS.iter().find(|s| s.doc.name == name) {
            Some(set) => Self::from_toml(set.text),
            None => Err(PlantError::ParameterSet {
                found: name.into(),
                known: PARAMETER_SETS
                    .iter()
                    .map(|s| s.doc.name)
                    .chain(LIKE_A_SET)
                    .collect::<Vec<_>>()
                    .join(", "),
            }),
        }
    }

    /// Read a parameter set from TOML text.
    ///
    /// # Errors
    /// [`PlantError::Toml`] for an unknown or missing key or a wrong type (with its line), [`PlantError::ParameterLine`]
    /// for a value out of range.
    ///
    /// ```
    /// use dynocal_plant::params::EngineParams;
    /// let p = EngineParams::thesis();
    /// let back = EngineParams::from_toml(&p.to_toml()).unwrap();
    /// assert_eq!(p, back);
    /// ```
    pub fn from_toml(text: &str) -> Result<Self, PlantError> {
        let p: Self = toml::from_str(text).map_err(|e| PlantError::Toml(Box::new(e)))?;
        p.check().map_err(|e| match &e {
            PlantError::Parameter { name, .. } | PlantError::ParameterRange { name, .. } => {
                match line_of(text, name) {
                    Some(line) => PlantError::ParameterLine { line, source: Box::new(e) },
                    None => e,
                }
            }
            _ => e,
        })?;
        Ok(p)
    }

    /// The parameter set as TOML text.
    pub fn to_toml(&self) -> String {
        // Plain numbers in plain tables always serialise; an empty text would fail to parse back.
        toml::to_string_pretty(self).unwrap_or_default()
    }
}

/// Line (from 1) of the key `table.key` (or `key`) in TOML text written with `[table]` headers.
fn line_of(text: &str, name: &str) -> Option<usize> {
    let (table, key) = name.rsplit_once('.').unwrap_or(("", name));
    let mut inside = String::new();
    for (k, line) in text.lines().enumerate() {
        let line = line.trim();
        if let Some(rest) = line.strip_prefix('[') {
            inside = rest.split(']').next().unwrap_or_default().trim().to_owned();
        } else if inside == table && line.split('=').next().is_some_and(|k| k.trim() == key) {
            return Some(k + 1);
        }
    }
    None
}
