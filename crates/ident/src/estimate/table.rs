//! The one table of estimators: names, keys, which forms of models they fit, what they do with missing samples.

use dynocal_numerics::registry::{BuildError, MemberDoc, nearest};

use super::{Estimator, els, iv, learn, ols, pem, rls, sem, train};
use crate::model::form::FormRow;
use crate::model::kinds::{MODEL_KINDS, ModelKind};

/// Which forms an estimator fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fits {
    /// Every NARX model.
    Narx,
    /// The forms of these names.
    Forms(&'static [&'static str]),
}

impl Fits {
    /// Whether it fits models of this form.
    pub fn covers(self, form: &FormRow) -> bool {
        match self {
            Self::Narx => form.narx,
            Self::Forms(names) => names.contains(&form.name),
        }
    }

    /// The kinds of models that it fits.
    pub fn kinds(self) -> impl Iterator<Item = &'static ModelKind> {
        MODEL_KINDS.iter().filter(move |k| self.covers(k.form))
    }

    /// What it fits, in words.
    pub(super) fn words(self) -> String {
        match self {
            Self::Narx => "NARX models (polynomials, networks)".into(),
            Self::Forms(names) => format!("the form {}", names.join(", ")),
        }
    }
}

/// What an estimator does with missing samples (NaN).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gaps {
    /// It estimates them.
    Estimated,
    /// It needs every sample: gaps are bridged, and what is bridged has no weight.
    Bridged {
        /// Whether the errors are those of a free run, which reads no measured outputs.
        free_run: bool,
    },
}

/// One row of the table.
pub struct EstimatorRow {
    /// Name, summary and keys.
    pub doc: MemberDoc,
    /// Which models it fits.
    pub fits: Fits,
    /// What it does with missing samples.
    pub gaps: Gaps,
    /// Builds it; unknown or wrong keys are a [`BuildError`].
    pub build: fn(&toml::Table) -> Result<Box<dyn Estimator>, BuildError>,
}

/// All estimators.
pub static ESTIMATORS: &[EstimatorRow] =
    &[ols::ROW, rls::ROW, iv::ROW, sem::ROW, train::ROW, pem::ROW, els::ROW, learn::ROW];

/// The row of `name`.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn row(name: &str) -> Result<&'static EstimatorRow, BuildError> {
    ESTIMATORS.iter().find(|r| r.doc.name == name).ok_or_else(|| {
        let known: Vec<String> = ESTIMATORS.iter().map(|r| r.doc.name.to_string()).collect();
        let nearest = nearest(name, &known);
        BuildError::UnknownMember { family: "estimator", found: name.into(), nearest, known }
    })
}

/// Builds the estimator `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn estimator(name: &str, keys: &toml::Table) -> Result<Box<dyn Estimator>, BuildError> {
    (row(name)?.build)(keys)
}

/// Documentation of all estimators.
pub fn docs() -> Vec<MemberDoc> {
    ESTIMATORS.iter().map(|r| r.doc).collect()
}
