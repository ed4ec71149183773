//! Polynomial structures as rows of the table of model kinds, and their form in a file.

use std::sync::Arc;

use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::products::products;
use super::regressor::{MAX_DEGREE, MAX_LAG};
use super::{PolyNarx, Regressor, StructureError};
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::form::{Driven, Form, FormRow};
use crate::model::initial::Initial;
use crate::model::kinds::{ModelKind, Structure};

/// The form in a file.
pub(in crate::model) static FORM: FormRow = FormRow {
    name: "polynomial",
    narx: true,
    initial: Initial::Measured,
    read: |text| Ok(Arc::new(serde_json::from_value::<PolyNarx>(text)?)),
};

/// Row of the table.
pub(in crate::model) const POLYNOMIAL: ModelKind = ModelKind {
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
    form: &FORM,
    build: |keys| Ok(Box::new(registry::keys::<Listed>("polynomial", keys)?)),
};

/// Row of the table.
pub(in crate::model) const ARX: ModelKind = ModelKind {
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
    form: &FORM,
    build: |keys| Ok(Box::new(registry::keys::<Arx>("arx", keys)?)),
};

/// Row of the table.
pub(in crate::model) const POLY_ARX: ModelKind = ModelKind {
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
    form: &FORM,
    build: |keys| Ok(Box::new(registry::keys::<PolyArx>("poly_arx", keys)?)),
};

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

/// Most products of a structure that takes them all.
const MOST_PRODUCTS: u128 = 20_000;

/// Refuses orders that no record could fill, before anything of that size is built.
fn short(output: &str, na: usize, nb: usize, nk: usize) -> Result<(), StructureError> {
    let longest = na.max(nk.saturating_add(nb));
    let range = |what, found| StructureError::Range {
        text: format!("orders of `{output}`"),
        what,
        found,
        expected: format!("at most {MAX_LAG}"),
    };
    if longest > MAX_LAG { Err(range("longest lag", longest)) } else { Ok(()) }
}

impl Arx {
    fn build(&self, inputs: &[String], output: &str) -> Result<PolyNarx, StructureError> {
        short(output, self.na, self.nb, self.nk)?;
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
        short(output, self.na, self.nb, self.nk)?;
        // C(V + d, d) products: counted before they are made.
        let (variables, degree) = ((inputs.len() * self.nb) as u128, u128::from(self.degree));
        let count = (1..=degree.min(64)).fold(1u128, |c, d| c.saturating_mul(variables + d) / d);
        if count > MOST_PRODUCTS || self.degree > MAX_DEGREE {
            return Err(StructureError::Range {
                text: format!("products of `{output}`"),
                what: "degree",
                found: self.degree as usize,
                expected: format!(
                    "at most {MAX_DEGREE}, and no more than {MOST_PRODUCTS} products of {variables} lagged inputs"
                ),
            });
        }
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

/// All of them are a polynomial.
macro_rules! polynomial_structure {
    ($($kind:ty),*) => {$(
        impl Structure for $kind {
            fn form(
                &self,
                inputs: &[String],
                output: &str,
                _data: &[Experiment],
            ) -> Result<Arc<dyn Form>, StructureError> {
                Ok(Arc::new(self.build(inputs, output)?))
            }
        }
    )*};
}
polynomial_structure!(Listed, Arx, PolyArx);

impl Form for PolyNarx {
    fn row(&self) -> &'static FormRow {
        &FORM
    }

    fn inputs(&self) -> &[String] {
        self.inputs()
    }

    fn output(&self) -> &str {
        self.output()
    }

    fn parameter_names(&self) -> Vec<String> {
        self.regressor_texts()
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
