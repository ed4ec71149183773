//! Linear structures with noise models as rows of the table of model kinds, and their form in a file.
//!
//! They are estimated by prediction errors of their own (estimator `pem`); what leaves them is a NARX model like all
//! others ([`LinearModel::deterministic`]).

use std::collections::BTreeMap;
use std::sync::Arc;

use dynocal_numerics::registry::{self, BuildError, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::{InputOrders, LinearModel};
use crate::experiment::Experiment;
use crate::model::form::{Form, FormRow};
use crate::model::initial::Initial;
use crate::model::kinds::{ModelKind, Structure};
use crate::model::poly::StructureError;

/// The form in a file. Its poles are those of the system and may be slow: the noise of a measured start would be carried
/// through the whole run.
pub(super) static FORM: FormRow = FormRow {
    name: "linear",
    narx: false,
    initial: Initial::Estimated,
    read: |text| Ok(Arc::new(serde_json::from_value::<LinearModel>(text)?)),
};

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
macro_rules! linear_kind {
    ($row:ident, $name:literal, $what:literal, $params:expr) => {
        /// Row of the table.
        pub(in crate::model) const $row: ModelKind = ModelKind {
            doc: MemberDoc { name: $name, what: $what, params: $params },
            form: &FORM,
            build: |keys| build($name, $params, keys),
        };
    };
}

linear_kind!(
    LINEAR_ARX,
    "linear_arx",
    "A y = sum B u + e: as `arx`, but without constant, with orders of each input, and missing samples are estimated",
    &[NA, NB, NK]
);
linear_kind!(ARMAX, "armax", "A y = sum B u + C e", &[NA, NB, NC, NK]);
linear_kind!(OE, "oe", "output error: y = sum B/F u + e", &[NB, NF, NK]);
linear_kind!(BJ, "bj", "Box-Jenkins: y = sum B/F u + C/D e", &[NB, NC, ND, NF, NK]);
linear_kind!(FIR_ARMA, "fir_arma", "FIR with ARMA noise: y = sum B u + C/D e", &[NB, NC, ND, NK]);
linear_kind!(ARMA, "arma", "time series without inputs: y = C/D e", &[NC, ND]);
linear_kind!(LINEAR, "linear", "the general linear form: A y = sum B/F u + C/D e", &[NA, NB, NC, ND, NF, NK]);

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
) -> Result<Box<dyn Structure>, BuildError> {
    let known = |key: &str| params.iter().find(|p| p.name == key);
    if let Some(key) = keys.keys().find(|k| known(k).is_none()) {
        let names: Vec<String> = params.iter().map(|p| format!("`{}`", p.name)).collect();
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

impl Structure for Checked {
    fn form(
        &self,
        inputs: &[String],
        output: &str,
        _data: &[Experiment],
    ) -> Result<Arc<dyn Form>, StructureError> {
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
        Ok(Arc::new(model))
    }
}
