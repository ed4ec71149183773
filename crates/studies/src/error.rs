//! Why a study cannot go on.

use dynocal_files::FilesError;
use dynocal_files::spec::LoadError;
use dynocal_ident::data::DataError;
use dynocal_ident::plant::PlantError;
use dynocal_jobs::calibrate::error::ChainError;
use dynocal_jobs::runs::RunError;

/// A study cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A file.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A spec of the study's own.
    #[error(transparent)]
    Spec(#[from] LoadError),
    /// A record.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A calibration that the study runs.
    #[error(transparent)]
    Calibrate(Box<ChainError>),
    /// A task failed.
    #[error("{what}: {reason}")]
    Task {
        /// Task or step.
        what: String,
        /// Reason.
        reason: String,
    },
    /// The result of a task is not what its reduction reads.
    #[error("result of the task `{task}`: {reason}")]
    Result {
        /// Task.
        task: String,
        /// Reason.
        reason: String,
    },
    /// A job over seeds and points.
    #[error(transparent)]
    Job(#[from] RunError),
    /// The folder holds the tasks of something else.
    #[error(
        "{folder} holds tasks of another spec, other seeds or another version: take another folder, or remove this one"
    )]
    OtherTasks {
        /// Folder.
        folder: String,
    },
    /// Ctrl-C.
    #[error("interrupted: finished tasks are kept, start again with the same folder to go on")]
    Interrupted,
}

impl From<ChainError> for StudyError {
    fn from(e: ChainError) -> Self {
        match e {
            ChainError::Interrupted => Self::Interrupted,
            e => Self::Calibrate(Box::new(e)),
        }
    }
}
