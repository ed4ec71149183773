//! Response models as rows of the table of model kinds: the keys of a kind, and beside them the lags of its inputs and output.

use std::collections::BTreeMap;
use std::sync::Arc;

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::form::{FORM, Learner, ResponseForm};
use super::{Learn, best_of, gp, local_linear, mean_of, polynomial, rbf};
use crate::experiment::Experiment;
use crate::model::form::Form;
use crate::model::kinds::{ModelKind, Structure};
use crate::model::poly::StructureError;

/// Keys of the lags; none of them for a steady model.
const LAGS: [ParamDoc; 3] = [
    ParamDoc {
        name: "input_lags",
        unit: "samples",
        default: "0",
        what: "last lag of each input, the first being 1; 0: its present value (steady)",
    },
    ParamDoc {
        name: "output_lags",
        unit: "samples",
        default: "0",
        what: "number of lags of the output, from 1; 0: none",
    },
    ParamDoc {
        name: "lags",
        unit: "samples",
        default: "{}",
        what: "table of input = [first lag, last lag], for inputs with lags of their own",
    },
];

/// The keys of a kind, then the lags.
const fn with_lags<const N: usize>(own: &[ParamDoc]) -> [ParamDoc; N] {
    let mut all = [LAGS[0]; N];
    let mut k = 0;
    while k < N {
        all[k] = if k < own.len() { own[k] } else { LAGS[k - own.len()] };
        k += 1;
    }
    all
}

/// One row from a row of the table of response models.
macro_rules! response_kind {
    ($row:ident, $member:expr) => {
        /// Row of the table.
        pub(in crate::model) const $row: ModelKind = ModelKind {
            doc: MemberDoc {
                name: $member.doc.name,
                what: $member.doc.what,
                params: {
                    const N: usize = $member.doc.params.len() + LAGS.len();
                    const ALL: &[ParamDoc] = &with_lags::<N>($member.doc.params);
                    ALL
                },
            },
            form: &FORM,
            build: |keys| build(&$member, keys),
        };
    };
}

response_kind!(STEPWISE_POLYNOMIAL, polynomial::MEMBER);
response_kind!(GAUSSIAN_PROCESS, gp::MEMBER);
response_kind!(LOCAL_LINEAR, local_linear::MEMBER);
response_kind!(RBF, rbf::MEMBER);
response_kind!(MEAN_OF, mean_of::MEMBER);
response_kind!(BEST_OF, best_of::MEMBER);

/// Longest lag in samples.
const MAX_LAG: usize = 10_000;

#[derive(Deserialize, Default)]
#[serde(default)]
struct Lags {
    input_lags: usize,
    output_lags: usize,
    lags: BTreeMap<String, [usize; 2]>,
}

struct ResponseStructure {
    lags: Lags,
    learner: Learner,
}

fn build(member: &Member<dyn Learn>, keys: &toml::Table) -> Result<Box<dyn Structure>, BuildError> {
    let name = member.doc.name;
    let is_lag = |key: &String| LAGS.iter().any(|p| p.name == key);
    let (of_lags, own): (toml::Table, toml::Table) =
        keys.iter().map(|(k, v)| (k.clone(), v.clone())).partition(|(k, _)| is_lag(k));
    let lags = registry::keys(name, &of_lags)?;
    // Keys of the learner are checked here and read again when it learns.
    (member.build)(&own).map_err(with_names_of_lags)?;
    Ok(Box::new(ResponseStructure { lags, learner: Learner { name: name.into(), keys: own } }))
}

/// A learner does not know of the lags that stand beside its keys.
fn with_names_of_lags(e: BuildError) -> BuildError {
    match e {
        BuildError::Keys { member, message } if message.contains("unknown field") => {
            let names = LAGS.map(|p| format!("`{}`", p.name)).join(", ");
            BuildError::Keys { member, message: format!("{message}, or of the lags {names}") }
        }
        other => other,
    }
}

impl Structure for ResponseStructure {
    fn form(
        &self,
        inputs: &[String],
        output: &str,
        _data: &[Experiment],
    ) -> Result<Arc<dyn Form>, StructureError> {
        if let Some(key) = self.lags.lags.keys().find(|k| !inputs.contains(k)) {
            let (text, nearest) = (format!("lags of {}", self.learner.name), registry::nearest(key, inputs));
            let (found, known) = (key.clone(), inputs.to_vec());
            return Err(StructureError::UnknownChannel { text, found, nearest, known });
        }
        let longest = |what: &'static str, text: String, found: usize| match found {
            0..=MAX_LAG => Ok(()),
            _ => Err(StructureError::Range { text, what, found, expected: format!("at most {MAX_LAG}") }),
        };
        longest("input_lags", format!("lags of {}", self.learner.name), self.lags.input_lags)?;
        longest("output_lags", format!("lags of {}", self.learner.name), self.lags.output_lags)?;
        for (input, [_, last]) in &self.lags.lags {
            longest("last lag", format!("lags of `{input}`"), *last)?;
        }
        let usual = if self.lags.input_lags == 0 { [0, 0] } else { [1, self.lags.input_lags] };
        let mut window = Vec::new();
        for (i, input) in inputs.iter().enumerate() {
            let [first, last] = self.lags.lags.get(input).copied().unwrap_or(usual);
            if first > last + 1 {
                return Err(StructureError::Range {
                    text: format!("lags of `{input}`"),
                    what: "first lag",
                    found: first,
                    expected: format!("at most the last lag {last} ([first, last]; [1, 0] for none)"),
                });
            }
            window.extend((first..=last).map(|lag| (i, lag)));
        }
        let learner = self.learner.clone();
        Ok(Arc::new(ResponseForm::new(inputs, output, window, self.lags.output_lags, learner)?))
    }
}
