//! The network as a row of the table of model kinds, and its form in a file.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use serde::de::{self, Deserialize, Deserializer, SeqAccess, Visitor};

use super::{Activation, Layout, NeuralNarx, Scaling};
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::form::{Driven, Form, FormRow};
use crate::model::initial::Initial;
use crate::model::kinds::{ModelKind, Structure};
use crate::model::poly::StructureError;

/// Row of the table.
pub(in crate::model) const KIND: ModelKind = ModelKind {
    doc: MemberDoc {
        name: "neural",
        what: "neural NARX: layers of neurons over lagged inputs and outputs, channels scaled inside",
        params: &[
            ParamDoc {
                name: "hidden",
                unit: "-",
                default: "10",
                what: "number of neurons, or a list with that of each hidden layer",
            },
            ParamDoc {
                name: "activation",
                unit: "-",
                default: "tanh",
                what: "`tanh`, `sigmoid`, `relu` or `softplus`",
            },
            ParamDoc {
                name: "direct",
                unit: "-",
                default: "false",
                what: "whether a linear path leads from all regressors to the output",
            },
            ParamDoc {
                name: "input_lags",
                unit: "samples",
                default: "5",
                what: "last lag of each input; the first is 1",
            },
            ParamDoc {
                name: "output_lags",
                unit: "samples",
                default: "1",
                what: "number of lags of the output, from 1",
            },
            ParamDoc {
                name: "lags",
                unit: "samples",
                default: "{}",
                what: "table of input = [first lag, last lag], for inputs with lags of their own",
            },
            ParamDoc {
                name: "scaling",
                unit: "-",
                default: "range",
                what: "what of the data becomes -1 and 1: least and greatest value (`range`) or one standard deviation around the mean (`standard`)",
            },
            ParamDoc {
                name: "ranges",
                unit: "channel",
                default: "{}",
                what: "table of channel = [what becomes -1, what becomes 1]; a channel without one is scaled from the data",
            },
        ],
    },
    form: &FORM,
    build: |keys| Ok(Box::new(registry::keys::<Neural>("neural", keys)?)),
};

#[derive(serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Neural {
    hidden: Layers,
    activation: Activation,
    direct: bool,
    input_lags: usize,
    output_lags: usize,
    lags: BTreeMap<String, [usize; 2]>,
    scaling: Scaling,
    ranges: BTreeMap<String, [f64; 2]>,
}

impl Default for Neural {
    fn default() -> Self {
        Self {
            hidden: Layers(vec![10]),
            activation: Activation::Tanh,
            direct: false,
            input_lags: 5,
            output_lags: 1,
            lags: BTreeMap::new(),
            scaling: Scaling::Range,
            ranges: BTreeMap::new(),
        }
    }
}

impl Neural {
    fn build(
        &self,
        inputs: &[String],
        output: &str,
        data: &[Experiment],
    ) -> Result<NeuralNarx, StructureError> {
        let names: Vec<&str> = inputs.iter().map(String::as_str).collect();
        self.known(self.lags.keys(), &names)?;
        self.known(self.ranges.keys(), &[&names[..], &[output]].concat())?;
        if let Some((input, [first, last])) = self.lags.iter().find(|(_, [first, last])| *first > last + 1) {
            return Err(StructureError::Range {
                text: format!("lags of `{input}`"),
                what: "first lag",
                found: *first,
                expected: format!("at most the last lag {last} ([first, last]; [1, 0] for none)"),
            });
        }
        let lags = |name: &str| self.lags.get(name).copied().unwrap_or([1, self.input_lags]);
        let layout = Layout {
            hidden: self.hidden.0.clone(),
            activation: self.activation,
            direct: self.direct,
            input_lags: names.iter().map(|n| lags(n)).collect(),
            output_lags: self.output_lags,
        };
        let net = NeuralNarx::with_layout(&names, output, layout)?.scaled_by(self.scaling, data)?;
        let (of_inputs, of_output) = net.ranges();
        let given = |name: &str, found: [f64; 2]| self.ranges.get(name).copied().unwrap_or(found);
        let of_inputs: Vec<[f64; 2]> = names.iter().zip(of_inputs).map(|(n, r)| given(n, r)).collect();
        net.with_ranges(&of_inputs, given(output, of_output))
    }

    /// Every key names a channel: a misspelt one would be without effect.
    fn known<'a>(
        &self,
        mut keys: impl Iterator<Item = &'a String>,
        channels: &[&str],
    ) -> Result<(), StructureError> {
        match keys.find(|k| !channels.contains(&k.as_str())) {
            None => Ok(()),
            Some(key) => {
                let known: Vec<String> = channels.iter().map(|c| c.to_string()).collect();
                let (text, nearest) = ("network".into(), registry::nearest(key, &known));
                Err(StructureError::UnknownChannel { text, found: key.clone(), nearest, known })
            }
        }
    }
}

/// The form in a file.
static FORM: FormRow = FormRow {
    name: "neural",
    narx: true,
    initial: Initial::Measured,
    read: |text| Ok(Arc::new(serde_json::from_value::<NeuralNarx>(text)?)),
};

impl Structure for Neural {
    fn form(
        &self,
        inputs: &[String],
        output: &str,
        data: &[Experiment],
    ) -> Result<Arc<dyn Form>, StructureError> {
        Ok(Arc::new(self.build(inputs, output, data)?))
    }
}

impl Form for NeuralNarx {
    fn row(&self) -> &'static FormRow {
        &FORM
    }

    fn inputs(&self) -> &[String] {
        &self.inputs
    }

    fn output(&self) -> &str {
        &self.output
    }

    fn parameter_names(&self) -> Vec<String> {
        (0..self.n_params()).map(|k| self.param_name(k)).collect()
    }

    fn memory(&self) -> usize {
        self.max_lag()
    }

    fn dynamics(&self) -> Option<&dyn Model> {
        Some(self)
    }

    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        Ok(Some(Driven { model: Arc::new(self.clone()), theta: theta.to_vec() }))
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

/// A number of neurons or a list of them.
struct Layers(Vec<usize>);

impl<'de> Deserialize<'de> for Layers {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct OneOrMany;

        impl<'de> Visitor<'de> for OneOrMany {
            type Value = Layers;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a number of neurons, or a list with that of each layer, e.g. `[8, 4]`")
            }

            fn visit_i64<E: de::Error>(self, v: i64) -> Result<Layers, E> {
                usize::try_from(v)
                    .map(|n| Layers(vec![n]))
                    .map_err(|_| E::invalid_value(de::Unexpected::Signed(v), &self))
            }

            fn visit_u64<E: de::Error>(self, v: u64) -> Result<Layers, E> {
                usize::try_from(v)
                    .map(|n| Layers(vec![n]))
                    .map_err(|_| E::invalid_value(de::Unexpected::Unsigned(v), &self))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Layers, A::Error> {
                let mut sizes = Vec::new();
                while let Some(n) = seq.next_element()? {
                    sizes.push(n);
                }
                Ok(Layers(sizes))
            }
        }

        from.deserialize_any(OneOrMany)
    }
}
