//! From errors of the crates below to exceptions of `dynocal.errors`.

use std::error::Error;

use dynocal_files::FilesError;
use dynocal_files::spec::{LoadError, SpecError};
use dynocal_ident::data::DataError;
use dynocal_ident::plant::PlantError;
use dynocal_ident::stored::StoredError;
use dynocal_jobs::export::ExportJobError;
use dynocal_jobs::identify::error::IdentifyError;
use dynocal_jobs::runs::RunError;
use dynocal_numerics::registry::BuildError;
use pyo3::prelude::*;

use crate::words::plain;

/// Class of `dynocal.errors`.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Kind {
    Argument,
    Spec,
    Data,
    File,
    Model,
    Estimate,
    Run,
    Plant,
    Fork,
    Bug,
}

impl Kind {
    fn class(self) -> &'static str {
        match self {
            Self::Argument => "ArgumentError",
            Self::Spec => "SpecError",
            Self::Data => "DataError",
            Self::File => "FileError",
            Self::Model => "ModelError",
            Self::Estimate => "EstimateError",
            Self::Run => "RunError",
            Self::Plant => "PlantError",
            Self::Fork => "ForkError",
            Self::Bug => "InternalError",
        }
    }
}

/// Why a call is refused, on its way to Python.
#[derive(Clone, Debug)]
pub(crate) struct Refusal {
    kind: Kind,
    text: String,
}

impl Refusal {
    pub(crate) fn new(kind: Kind, text: impl Into<String>) -> Self {
        Self { kind, text: plain(&text.into()) }
    }

    /// An error with its causes.
    pub(crate) fn of(kind: Kind, error: &dyn Error) -> Self {
        let mut text = error.to_string();
        let mut cause = error.source();
        while let Some(c) = cause {
            let more = c.to_string();
            // Messages that already contain their cause need not say it twice.
            if !text.contains(&more) {
                text = format!("{text}\n  because: {more}");
            }
            cause = c.source();
        }
        Self { kind, text: plain(&text) }
    }

    /// The same where a name that stands for no file is not called one.
    pub(crate) fn instead(mut self, of: &str, name: &str) -> Self {
        self.text = self.text.replace(of, name);
        self
    }

    /// The same with what it is about in front.
    pub(crate) fn about(mut self, what: &str) -> Self {
        self.text = format!("{what}: {}", self.text);
        self
    }
}

/// An error of a job while it runs.
pub(crate) fn run(error: impl Error) -> Refusal {
    Refusal::of(Kind::Run, &error)
}

impl From<Refusal> for PyErr {
    fn from(r: Refusal) -> Self {
        let raise = |py: Python<'_>| -> PyResult<PyErr> {
            let class = py.import("dynocal.errors")?.getattr(r.kind.class())?;
            Ok(PyErr::from_value(class.call1((r.text.as_str(),))?))
        };
        Python::attach(|py| raise(py).unwrap_or_else(|e| e))
    }
}

macro_rules! kinds {
    ($($error:ty => $kind:ident),* $(,)?) => {
        $(impl From<$error> for Refusal {
            fn from(e: $error) -> Self {
                Self::of(Kind::$kind, &e)
            }
        })*
    };
}

kinds! {
    FilesError => File,
    SpecError => Spec,
    DataError => Data,
    StoredError => Model,
    BuildError => Argument,
    PlantError => Plant,
}

impl From<LoadError> for Refusal {
    fn from(e: LoadError) -> Self {
        match e {
            LoadError::File(e) => e.into(),
            LoadError::Spec(e) => e.into(),
        }
    }
}

impl From<IdentifyError> for Refusal {
    fn from(e: IdentifyError) -> Self {
        let kind = match &e {
            IdentifyError::Files(_) => Kind::File,
            IdentifyError::Data(_)
            | IdentifyError::Derived(_)
            | IdentifyError::Prepare(_)
            | IdentifyError::Unit { .. }
            | IdentifyError::SameFile { .. } => Kind::Data,
            IdentifyError::Stored(_) | IdentifyError::Preparations { .. } => Kind::Model,
            IdentifyError::Build(_) => Kind::Argument,
            _ => Kind::Estimate,
        };
        Self::of(kind, &e)
    }
}

impl From<ExportJobError> for Refusal {
    fn from(e: ExportJobError) -> Self {
        match e {
            ExportJobError::Files(e) => e.into(),
            ExportJobError::Model { .. } => Self::of(Kind::Model, &e),
            e => Self::of(Kind::Run, &e),
        }
    }
}

impl From<RunError> for Refusal {
    fn from(e: RunError) -> Self {
        match e {
            RunError::File(e) => e.into(),
            RunError::Spec(e) => e.into(),
            RunError::Identify(e) => (*e).into(),
            RunError::Argument(text) => Self::new(Kind::Argument, text),
            e => Self::of(Kind::Run, &e),
        }
    }
}
