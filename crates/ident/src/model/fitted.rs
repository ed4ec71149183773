//! A form with its parameters, ready to simulate and predict.

use super::form::{AnyForm, Driven, Form};
use super::initial::Initial;
use super::poly::StructureError;
use super::{Kind, Model};
use crate::experiment::Experiment;

/// A structure with parameters.
///
/// ```
/// use dynocal_ident::experiment::Experiment;
/// use dynocal_ident::model::Kind;
/// use dynocal_ident::model::fitted::Fitted;
/// use dynocal_ident::model::linear::LinearModel;
/// // Output error: one step ahead there is no more to know than in free run.
/// let oe = Fitted::new(LinearModel::oe(&["u"], "y", 1, 1, 1), vec![1.0, -0.8])?;
/// let u: Vec<f64> = (0..40).map(|t| f64::from((t * t / 3) % 5) - 2.0).collect();
/// let y: Vec<f64> = (0..40).map(|t| f64::from((t * 7) % 11)).collect();
/// let e = Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] };
/// assert_eq!(oe.output(&e, Kind::OneStep), oe.output(&e, Kind::FreeRun));
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Fitted {
    form: AnyForm,
    theta: Vec<f64>,
    driven: Option<Driven>,
    initial: Initial,
}

impl Fitted {
    /// `theta` (p) as estimated; free runs start as is usual for the form.
    ///
    /// # Errors
    /// [`StructureError`]: another number of parameters, or names that cannot stand in regressors.
    pub fn new(form: impl Into<AnyForm>, theta: Vec<f64>) -> Result<Self, StructureError> {
        let form = form.into();
        let expected = form.form().parameters();
        if theta.len() != expected {
            let (output, inputs) = (form.form().output().to_string(), form.form().inputs().to_vec());
            return Err(StructureError::Parameters { output, found: theta.len(), expected, inputs });
        }
        let (driven, initial) = (form.form().driven(&theta)?, form.form().row().initial);
        Ok(Self { form, theta, driven, initial })
    }

    /// The same with free runs that start as `initial` says.
    pub fn starting(self, initial: Initial) -> Self {
        Self { initial, ..self }
    }

    /// How its free runs start.
    pub fn initial(&self) -> Initial {
        self.initial
    }

    /// The structure as a file keeps it.
    pub fn any(&self) -> &AnyForm {
        &self.form
    }

    /// The structure.
    pub fn form(&self) -> &dyn Form {
        self.form.form()
    }

    /// Parameters (p).
    pub fn theta(&self) -> &[f64] {
        &self.theta
    }

    /// What the free run simulates, with its parameters; none for a time series, which nothing drives.
    pub fn simulated(&self) -> Option<(&dyn Model, &[f64])> {
        self.driven.as_ref().map(|d| (d.model.as_ref(), d.theta.as_slice()))
    }

    /// The same to be kept.
    pub fn driven(&self) -> Option<&Driven> {
        self.driven.as_ref()
    }

    /// First sample that is scored: the same for all kinds of output, so that their numbers can be compared.
    pub fn first(&self, e: &Experiment) -> usize {
        e.init_samples.max(self.form().memory())
    }

    /// Output on one record (N) as `kind` says. None where the structure has no such output.
    pub fn output(&self, e: &Experiment, kind: Kind) -> Option<Vec<f64>> {
        self.form().computed(&self.theta, self.driven.as_ref(), e, kind, self.initial)
    }
}
