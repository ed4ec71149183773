//! The run folder of a campaign.

use dynocal_files::run_folder::RunFolder;
use dynocal_files::{csv_io, json};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION};

use super::page;
use super::result::{Sequenced, SequentialError};

/// Writes every record, the models (files that `identify`, `design`, `simulate` and `calibrate` read), the page and the
/// summary.
///
/// # Errors
/// [`SequentialError::Files`], [`SequentialError::Page`].
pub fn write(folder: &RunFolder, mut found: Sequenced) -> Result<Sequenced, SequentialError> {
    let mut files = vec!["report.html".to_string()];
    for r in found.records.iter().chain([&found.held_out]) {
        let name = format!("{}.csv", r.name);
        csv_io::write_dataset(&folder.path().join(&name), r)?;
        files.push(name);
    }
    for (model, o) in found.models.iter().zip(&found.outputs) {
        let one = found.outputs.len() == 1;
        let name = if one { "model.json".into() } else { format!("model-{}.json", o.output) };
        json::write_versioned(&folder.path().join(&name), MODEL_SCHEMA, MODEL_VERSION, model)?;
        files.push(name);
    }
    found.files = files;
    page::write(&found, folder.path())?;
    folder.write_summary(&found)?;
    Ok(found)
}
