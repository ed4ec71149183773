//! The table of linear structures with noise models: from a name and keys in a spec to a model for given channels.
//!
//! It stands beside [`crate::model::structures::MODEL_STRUCTURES`] because these models are estimated by prediction
//! errors of their own ([`crate::estimate::pem`]); what leaves them is a NARX model like all others
//! ([`LinearModel::deterministic`]).

use std::collections::BTreeMap;

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::{InputOrders, LinearModel};
use crate::model::poly::StructureError;

/// A linear structure before it knows its channels.
pub trait LinearStructure: Send + Sync {
    /// The model of `output` driven by `inputs`.
    ///
    /// # Errors
    /// [`StructureError`] when an order is given for a channel that is not an input, or nothing is left to estimate.
    fn model(&self, inputs: &[String], output: &str) -> Result<LinearModel, StructureError>;
}

const NA: ParamDoc =
    ParamDoc { name: "na", unit: "samples", default: "2", what: "order of A (past outputs)" };
const NB: ParamDoc = ParamDoc {
    name: "nb",
    unit: "samples",
    default: "2",
    what: "coefficients of B; one number, or a table of input = number",
};
const NK: ParamDoc = ParamDoc {
    name: "nk",
    unit: "samples",
    default: "1",
    what: "delay of each input; one number, or a table of input = number",
};
const NF: ParamDoc = ParamDoc {
    name: "nf",
    unit: "samples",
    default: "2",
    what: "order of F; one number, or a table of input = number",
};
const NC: ParamDoc =
    ParamDoc { name: "nc", unit: "samples", default: "1", what: "order of C (noise numerator)" };
const ND: ParamDoc =
    ParamDoc { name: "nd", unit: "samples", default: "1", what: "order of D (noise denominator)" };

/// One row: which orders the structure has is what its `params` list.
macro_rules! member {
    ($name:literal, $what:literal, $params:expr) => {
        Member {
            doc: MemberDoc { name: $name, what: $what, params: $params },
            build: |keys| build($name, $params, keys),
        }
    };
}

/// All linear structures.
pub static LINEAR_STRUCTURES: &[Member<dyn LinearStructure>] = &[
    member!("arx", "A y = sum B u + e", &[NA, NB, NK]),
    member!("armax", "A y = sum B u + C e", &[NA, NB, NC, NK]),
    member!("oe", "output error: y = sum B/F u + e", &[NB, NF, NK]),
    member!("bj", "Box-Jenkins: y = sum B/F u + C/D e", &[NB, NC, ND, NF, NK]),
    member!("fir_arma", "FIR with ARMA noise: y = sum B u + C/D e", &[NB, NC, ND, NK]),
    member!("arma", "time series without inputs: y = C/D e", &[NC, ND]),
    member!("linear", "the general form: A y = sum B/F u + C/D e", &[NA, NB, NC, ND, NF, NK]),
];

/// Builds the linear structure `name` from the keys of a spec.
///
/// ```
/// use dynocal_ident::model::linear::structures::linear_structure;
/// let keys = "nb = 1\nnf = { inj = 1, spark = 2 }\nnk = { inj = 5 }".parse().unwrap();
/// let model = linear_structure("oe", &keys)?.model(&["inj".into(), "spark".into()], "torque").unwrap();
/// assert_eq!(model.param_names(), ["b0(inj)", "b0(spark)", "f1(inj)", "f1(spark)", "f2(spark)"]);
/// assert_eq!((model.orders[0].nk, model.orders[1].nk), (5, 1));
/// # Ok::<(), dynocal_numerics::registry::BuildError>(())
/// ```
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn linear_structure(name: &str, keys: &toml::Table) -> Result<Box<dyn LinearStructure>, BuildError> {
    registry::build("linear structure", LINEAR_STRUCTURES, name, keys)
}

/// Documentation of all linear structures.
pub fn docs() -> Vec<MemberDoc> {
    LINEAR_STRUCTURES.iter().map(|m| m.doc).collect()
}

/// One order for all inputs, or one for each that is named.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
enum PerInput {
    All(usize),
    Each(BTreeMap<String, usize>),
}

impl PerInput {
    fn of(&self, input: &str, default: usize) -> usize {
        match self {
            Self::All(n) => *n,
            Self::Each(table) => table.get(input).copied().unwrap_or(default),
        }
    }

    fn unknown(&self, inputs: &[String]) -> Option<&String> {
        match self {
            Self::All(_) => None,
            Self::Each(table) => table.keys().find(|k| !inputs.contains(k)),
        }
    }
}

/// Orders as the spec gives them; one that the structure does not have is absent.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Orders {
    na: Option<usize>,
    nb: Option<PerInput>,
    nc: Option<usize>,
    nd: Option<usize>,
    nf: Option<PerInput>,
    nk: Option<PerInput>,
}

/// Orders with the defaults of the table filled in.
struct Checked {
    with_inputs: bool,
    na: usize,
    nc: usize,
    nd: usize,
    /// Given order and default of B, F and the delay.
    nb: (PerInput, usize),
    nf: (PerInput, usize),
    nk: (PerInput, usize),
}

fn build(
    name: &'static str,
    params: &'static [ParamDoc],
    keys: &toml::Table,
) -> Result<Box<dyn LinearStructure>, BuildError> {
    let known = |key: &str| params.iter().find(|p| p.name == key);
    if let Some(key) = keys.keys().find(|k| known(k).is_none()) {
        let names: Vec<&str> = params.iter().map(|p| p.name).collect();
        return Err(BuildError::Keys {
            member: name.into(),
            message: format!("unknown key `{key}`, expected one of {}", names.join(", ")),
        });
    }
    let o: Orders = registry::keys(name, keys)?;
    // An order that the structure does not have is zero.
    let default = |key: &str| known(key).and_then(|p| p.default.parse().ok()).unwrap_or(0);
    let per_input = |given: Option<PerInput>, key: &str| {
        let default = default(key);
        (given.unwrap_or(PerInput::All(default)), default)
    };
    Ok(Box::new(Checked {
        with_inputs: known("nb").is_some(),
        na: o.na.unwrap_or_else(|| default("na")),
        nc: o.nc.unwrap_or_else(|| default("nc")),
        nd: o.nd.unwrap_or_else(|| default("nd")),
        nb: per_input(o.nb, "nb"),
        nf: per_input(o.nf, "nf"),
        nk: per_input(o.nk, "nk"),
    }))
}

impl LinearStructure for Checked {
    fn model(&self, inputs: &[String], output: &str) -> Result<LinearModel, StructureError> {
        let inputs = if self.with_inputs { inputs } else { &[] };
        for (what, table) in [("nb", &self.nb.0), ("nf", &self.nf.0), ("nk", &self.nk.0)] {
            if let Some(found) = table.unknown(inputs) {
                return Err(StructureError::UnknownChannel {
                    text: what.into(),
                    found: found.clone(),
                    nearest: registry::nearest(found, inputs),
                    known: inputs.to_vec(),
                });
            }
        }
        let orders = |input: &String| InputOrders {
            nb: self.nb.0.of(input, self.nb.1),
            nf: self.nf.0.of(input, self.nf.1),
            nk: self.nk.0.of(input, self.nk.1),
        };
        let model = LinearModel {
            inputs: inputs.to_vec(),
            output: output.into(),
            na: self.na,
            orders: inputs.iter().map(orders).collect(),
            nc: self.nc,
            nd: self.nd,
        };
        model.check()?;
        Ok(model)
    }
}
