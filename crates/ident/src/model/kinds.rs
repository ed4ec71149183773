//! The one table of model kinds: from a name and keys in a spec to a structure for given channels, and from the name of a
//! form in a file back to it.
//!
//! ```
//! use dynocal_ident::model::kinds::kind;
//! let keys = "nb = 1\nnf = { inj = 1, spark = 2 }\nnk = { inj = 5 }".parse().unwrap();
//! let oe = kind("oe", &keys)?.form(&["inj".into(), "spark".into()], "torque", &[])?;
//! assert_eq!(oe.parameter_names(), ["b0(inj)", "b0(spark)", "f1(inj)", "f1(spark)", "f2(spark)"]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::sync::Arc;

use dynocal_numerics::registry::{BuildError, MemberDoc, nearest};

use super::form::{Form, FormRow};
use super::poly::StructureError;
use super::{linear, literature_kinds as printed, narmax, neural, poly, response};
use crate::experiment::Experiment;

/// A structure before it knows its channels.
pub trait Structure: Send + Sync {
    /// The structure of `output` driven by `inputs`. One that scales its channels takes their ranges from `data`; without
    /// data they stay as the keys say.
    ///
    /// # Errors
    /// [`StructureError`] when the structure does not fit these channels.
    fn form(
        &self,
        inputs: &[String],
        output: &str,
        data: &[Experiment],
    ) -> Result<Arc<dyn Form>, StructureError>;
}

/// One row of the table.
pub struct ModelKind {
    /// Name, summary and keys.
    pub doc: MemberDoc,
    /// What it becomes over given channels; several kinds may share a form.
    pub form: &'static FormRow,
    /// Builds the structure; unknown or wrong keys are a [`BuildError`].
    pub build: fn(&toml::Table) -> Result<Box<dyn Structure>, BuildError>,
}

/// All kinds of models.
pub static MODEL_KINDS: &[ModelKind] = &[
    poly::spec::POLYNOMIAL,
    poly::spec::ARX,
    poly::spec::POLY_ARX,
    neural::spec::KIND,
    narmax::KIND,
    linear::structures::LINEAR_ARX,
    linear::structures::ARMAX,
    linear::structures::OE,
    linear::structures::BJ,
    linear::structures::FIR_ARMA,
    linear::structures::ARMA,
    linear::structures::LINEAR,
    response::kinds::STEPWISE_POLYNOMIAL,
    response::kinds::GAUSSIAN_PROCESS,
    response::kinds::LOCAL_LINEAR,
    response::kinds::RBF,
    response::kinds::MEAN_OF,
    response::kinds::BEST_OF,
    printed::TORQUE_7_8,
    printed::LAMBDA_7_8,
    printed::TORQUE_4_17,
    printed::LAMBDA_4_53,
    printed::TORQUE_5_3,
    printed::INVERSE_INJ_7_18,
    printed::INVERSE_SPARK_7_18,
    printed::INVERSE_THROTTLE_7_18,
];

/// The forms that the kinds become, each once, then those that only an estimator makes.
pub fn forms() -> impl Iterator<Item = &'static FormRow> {
    let first =
        |k: &usize| MODEL_KINDS[..*k].iter().all(|other| other.form.name != MODEL_KINDS[*k].form.name);
    let of_kinds = (0..MODEL_KINDS.len()).filter(first).map(|k| MODEL_KINDS[k].form);
    of_kinds.chain([&neural::MEAN_FORM])
}

/// The row of `name`.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn row(name: &str) -> Result<&'static ModelKind, BuildError> {
    MODEL_KINDS.iter().find(|k| k.doc.name == name).ok_or_else(|| {
        let known: Vec<String> = MODEL_KINDS.iter().map(|k| k.doc.name.to_string()).collect();
        let nearest = nearest(name, &known);
        BuildError::UnknownMember { family: "model kind", found: name.into(), nearest, known }
    })
}

/// Builds the structure `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn kind(name: &str, keys: &toml::Table) -> Result<Box<dyn Structure>, BuildError> {
    (row(name)?.build)(keys)
}

/// Documentation of all kinds.
pub fn docs() -> Vec<MemberDoc> {
    MODEL_KINDS.iter().map(|k| k.doc).collect()
}
