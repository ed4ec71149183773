//! What an identification refuses.

use dynocal_files::FilesError;
use dynocal_ident::data::DataError;
use dynocal_ident::derived::DerivedError;
use dynocal_ident::estimate::EstimateError;
use dynocal_ident::model::poly::StructureError;
use dynocal_ident::prepare::PrepareError;
use dynocal_ident::select::SelectError;
use dynocal_ident::stored::StoredError;
use dynocal_numerics::registry::BuildError;

/// The job could not be done.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// Data.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Derived channels.
    #[error(transparent)]
    Derived(#[from] DerivedError),
    /// Estimation.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// Structure.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// A stored model.
    #[error(transparent)]
    Stored(#[from] StoredError),
    /// Preparation.
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    /// Structure selection.
    #[error(transparent)]
    Select(#[from] SelectError),
    /// A checked member cannot be built any more.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// More memory than a run may take.
    #[error("{0}")]
    Large(String),
    /// Records in different units.
    #[error(
        "{record}: channel `{channel}` is in `{found}`, in {other} it is in `{expected}`: convert one of them"
    )]
    Unit {
        /// Record.
        record: String,
        /// Channel.
        channel: String,
        /// Its unit.
        found: String,
        /// Unit elsewhere.
        expected: String,
        /// Record that has it.
        other: String,
    },
    /// A test set that is the data of the estimation.
    #[error(
        "the test set `{test}` is the file {file} that the model is estimated from: what is called unseen must not have been seen"
    )]
    SameFile {
        /// Test set.
        test: String,
        /// File.
        file: String,
    },
    /// Stored models that saw differently prepared records.
    #[error(
        "the models of `{first}` and `{second}` were estimated from differently prepared records: they cannot run as one set; score them one by one"
    )]
    Preparations {
        /// Output of one.
        first: String,
        /// Output of the other.
        second: String,
    },
    /// Outputs that depend on each other at the same sample.
    #[error(
        "the model of `{target}` uses the output `{input}` of the same sample, which is computed by another model: use `{input}(t-1)` or an earlier sample"
    )]
    Loop {
        /// Target.
        target: String,
        /// Output that is used at once.
        input: String,
    },
    /// Outputs that depend on each other, one of them a mean of networks.
    #[error(
        "the model of `{target}` takes its input `{input}` from another model, and one of the two is a mean of networks, which does not \
         run sample by sample with others: estimate it without `mean`"
    )]
    Together {
        /// Target.
        target: String,
        /// Input that another model computes.
        input: String,
    },
    /// The user stopped it.
    #[error("interrupted before the estimate was finished")]
    Interrupted,
}
