//! The table of model structures: from a name and keys in a spec to a structure for given channels.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::Model;
use super::literature::{self, LiteratureModel};
use super::neural::NeuralNarx;
use super::poly::{PolyNarx, Regressor, StructureError};
use crate::experiment::Experiment;
use crate::select::pool::products;

/// A model structure before it knows its channels.
pub trait Structure: Send + Sync {
    /// The model of `output` driven by `inputs`.
    ///
    /// # Errors
    /// [`StructureError`] when the structure does not fit these channels.
    fn model(&self, inputs: &[String], output: &str) -> Result<Box<dyn Model>, StructureError>;

    /// The same for known data: a structure that scales its channels takes their ranges from `data`.
    ///
    /// # Errors
    /// As [`Structure::model`].
    fn model_on(
        &self,
        inputs: &[String],
        output: &str,
        _data: &[Experiment],
    ) -> Result<Box<dyn Model>, StructureError> {
        self.model(inputs, output)
    }

    /// The same as a polynomial, for what needs its regressors; `None` for other kinds of model.
    ///
    /// # Errors
    /// As [`Structure::model`].
    fn polynomial(&self, inputs: &[String], output: &str) -> Result<Option<PolyNarx>, StructureError>;

    /// The same as a network scaled to `data`, for what stores it; `None` for other kinds of model.
    ///
    /// # Errors
    /// As [`Structure::model`].
    fn network(
        &self,
        _inputs: &[String],
        _output: &str,
        _data: &[Experiment],
    ) -> Result<Option<NeuralNarx>, StructureError> {
        Ok(None)
    }
}

/// One row of the table for a structure of the thesis: it takes no keys, and the user's channel names.
macro_rules! literature_member {
    ($name:literal, $what:literal, $model:expr) => {
        Member {
            doc: MemberDoc { name: $name, what: $what, params: &[] },
            build: |keys| {
                registry::keys::<NoKeys>($name, keys)?;
                Ok(Box::new(Printed($model)))
            },
        }
    };
}
/// All model structures.
pub static MODEL_STRUCTURES: &[Member<dyn Structure>] = &[
    Member {
        doc: MemberDoc {
            name: "polynomial",
            what: "polynomial NARX with the regressors that are listed",
            params: &[ParamDoc {
                name: "regressors",
                unit: "-",
                default: "",
                what: "list of products, e.g. `1`, `inj(t-1)*spark(t-3)^2`, `torque(t-1)`; a factor may be abs, cos, exp, pos (positive part), sin, sqrt or tanh of a combination, `tanh(20*x(t-1) - 20*x(t-2) + 0.5)`",
            }],
        },
        build: |keys| Ok(Box::new(registry::keys::<Listed>("polynomial", keys)?)),
    },
    Member {
        doc: MemberDoc {
            name: "arx",
            what: "linear ARX: all inputs with the same lags, and the output",
            params: &[
                ParamDoc { name: "na", unit: "samples", default: "1", what: "number of output lags" },
                ParamDoc { name: "nb", unit: "samples", default: "2", what: "number of lags of each input" },
                ParamDoc { name: "nk", unit: "samples", default: "1", what: "first lag of each input" },
                ParamDoc { name: "constant", unit: "-", default: "true", what: "whether there is an offset" },
            ],
        },
        build: |keys| Ok(Box::new(registry::keys::<Arx>("arx", keys)?)),
    },
    Member {
        doc: MemberDoc {
            name: "poly_arx",
            what: "ARX lags with all products of the lagged variables up to a degree",
            params: &[
                ParamDoc { name: "na", unit: "samples", default: "1", what: "number of output lags" },
                ParamDoc { name: "nb", unit: "samples", default: "2", what: "number of lags of each input" },
                ParamDoc { name: "nk", unit: "samples", default: "1", what: "first lag of each input" },
                ParamDoc {
                    name: "degree",
                    unit: "-",
                    default: "2",
                    what: "highest degree of the products of inputs",
                },
                ParamDoc {
                    name: "output_products",
                    unit: "-",
                    default: "false",
                    what: "whether y(t-1) is also multiplied by each lagged input",
                },
            ],
        },
        build: |keys| Ok(Box::new(registry::keys::<PolyArx>("poly_arx", keys)?)),
    },
    super::neural::spec::MEMBER,
    literature_member!(
        "torque_7_8",
        "torque structure of eq. (7.8); inputs inj, spark, throttle, speed",
        literature::torque_7_8()
    ),
    literature_member!(
        "lambda_7_8",
        "lambda structure of eq. (7.8); inputs inj, spark, throttle, speed",
        literature::lambda_7_8()
    ),
    literature_member!(
        "torque_4_17",
        "torque structure of eq. (4.17); inputs fuel pulse width, bleed valve, speed",
        literature::torque_4_17()
    ),
    literature_member!(
        "lambda_4_53",
        "lambda structure of eq. (4.53); inputs fuel pulse width, bleed valve, speed",
        literature::lambda_4_53()
    ),
    literature_member!(
        "torque_5_3",
        "linear torque structure of eq. (5.3); inputs bleed valve, spark, speed",
        literature::torque_5_3()
    ),
    literature_member!("inverse_inj_7_18", "injection from torque, lambda and speed, eq. (7.18)", {
        let [inj, _, _] = literature::inverse_7_18();
        inj
    }),
    literature_member!("inverse_spark_7_18", "spark from torque, lambda and speed, eq. (7.18)", {
        let [_, spark, _] = literature::inverse_7_18();
        spark
    }),
    literature_member!("inverse_throttle_7_18", "throttle from torque, lambda and speed, eq. (7.18)", {
        let [_, _, throttle] = literature::inverse_7_18();
        throttle
    }),
];

/// Builds the structure `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn structure(name: &str, keys: &toml::Table) -> Result<Box<dyn Structure>, BuildError> {
    registry::build("model structure", MODEL_STRUCTURES, name, keys)
}

/// Documentation of all structures.
pub fn docs() -> Vec<MemberDoc> {
    MODEL_STRUCTURES.iter().map(|m| m.doc).collect()
}

/// Keys of a member that has none.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoKeys {}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Listed {
    regressors: Vec<String>,
}

impl Listed {
    fn build(&self, inputs: &[String], output: &str) -> Result<PolyNarx, StructureError> {
        PolyNarx::parse(inputs, output, &self.regressors)
    }
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Arx {
    na: usize,
    nb: usize,
    nk: usize,
    constant: bool,
}

impl Default for Arx {
    fn default() -> Self {
        Self { na: 1, nb: 2, nk: 1, constant: true }
    }
}

impl Arx {
    fn build(&self, inputs: &[String], output: &str) -> Result<PolyNarx, StructureError> {
        PolyNarx::arx(inputs, output, self.na, self.nb, self.nk, self.constant)
    }
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct PolyArx {
    na: usize,
    nb: usize,
    nk: usize,
    degree: u32,
    output_products: bool,
}

impl Default for PolyArx {
    fn default() -> Self {
        Self { na: 1, nb: 2, nk: 1, degree: 2, output_products: false }
    }
}

impl PolyArx {
    fn build(&self, inputs: &[String], output: &str) -> Result<PolyNarx, StructureError> {
        let lagged: Vec<Regressor> = (0..inputs.len())
            .flat_map(|i| (self.nk..self.nk + self.nb).map(move |lag| Regressor::input(i, lag)))
            .collect();
        let mut regressors = products(&lagged, self.degree);
        regressors.insert(0, Regressor::constant());
        regressors.extend((1..=self.na).map(Regressor::output));
        if self.output_products && self.na > 0 {
            regressors.extend(lagged.iter().map(|r| r.times(&Regressor::output(1))));
        }
        PolyNarx::new(inputs.to_vec(), output.into(), regressors)
    }
}

/// A structure of the thesis under the user's channel names.
struct Printed(LiteratureModel);

impl Printed {
    fn build(&self, inputs: &[String], output: &str) -> Result<PolyNarx, StructureError> {
        PolyNarx::new(inputs.to_vec(), output.into(), self.0.model.regressors().to_vec())
    }
}

/// All of them answer both questions from one polynomial.
macro_rules! polynomial_structure {
    ($($kind:ty),*) => {$(
        impl Structure for $kind {
            fn model(&self, inputs: &[String], output: &str) -> Result<Box<dyn Model>, StructureError> {
                Ok(Box::new(self.build(inputs, output)?))
            }

            fn polynomial(&self, inputs: &[String], output: &str) -> Result<Option<PolyNarx>, StructureError> {
                self.build(inputs, output).map(Some)
            }
        }
    )*};
}
polynomial_structure!(Listed, Arx, PolyArx, Printed);
