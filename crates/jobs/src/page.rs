//! Why a page could not be written.

use dynocal_files::FilesError;
use dynocal_ident::data::DataError;

/// A page could not be written.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// Reading what is shown, or writing the page.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A record lacks what is drawn.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The page itself.
    #[error(transparent)]
    Render(#[from] dynocal_report::RenderError),
}
