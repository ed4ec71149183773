//! The spec as typed. Keys that must be there are options, so that one missing key does not hide other faults.

use std::collections::BTreeMap;
use std::path::PathBuf;

use dynocal_files::dataset::{Format, Missing};
use dynocal_files::measurement::csv_dialect::CsvKeys;
use dynocal_files::measurement::merge;
use dynocal_ident::data::Role;
use dynocal_ident::model::initial::Initial;
use serde::{Deserialize, Serialize};

use crate::export_spec::ExportKeys;
use crate::kept;

/// In which format the scored records stay in the run folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Keep {
    /// CSV up to [`kept::MOST_CSV_ROWS`] rows together, Parquet above.
    #[default]
    Auto,
    /// CSV.
    Csv,
    /// Parquet.
    Parquet,
    /// They are left out, and with them what is drawn of them.
    None,
}

impl Keep {
    /// Ending of the files of records with so many rows together; none where they are not written.
    pub fn ending(self, rows: usize) -> Option<&'static str> {
        match self {
            Keep::Auto => Some(kept::ending(rows)),
            Keep::Csv => Some("csv"),
            Keep::Parquet => Some("parquet"),
            Keep::None => None,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Typed {
    pub(super) name: Option<String>,
    pub(super) out: Option<PathBuf>,
    pub(super) records: Option<Keep>,
    pub(super) data: Option<TypedData>,
    pub(super) channels: Option<Vec<TypedChannel>>,
    pub(super) derive: Option<Vec<TypedDerive>>,
    pub(super) split: Option<TypedSplit>,
    pub(super) test: Option<Vec<TypedTest>>,
    pub(super) prepare: Option<Vec<toml::Table>>,
    pub(super) model: Option<TypedModel>,
    pub(super) validate: Option<TypedValidate>,
    pub(super) export: Option<ExportKeys>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedData {
    pub(super) file: Option<String>,
    pub(super) files: Option<Vec<String>>,
    pub(super) format: Option<Format>,
    pub(super) csv: Option<CsvKeys>,
    pub(super) merge: Option<merge::Keys>,
    pub(super) alias: Option<BTreeMap<String, Vec<String>>>,
    pub(super) steady: Option<bool>,
    pub(super) sample_time_s: Option<f64>,
    pub(super) time: Option<String>,
    pub(super) time_unit: Option<String>,
    pub(super) trajectory: Option<String>,
    pub(super) cut: Option<TypedCut>,
    pub(super) init_samples: Option<usize>,
    pub(super) missing: Option<Missing>,
    pub(super) multisine_period: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TypedCut {
    pub(super) trigger: Option<String>,
    pub(super) above: Option<f64>,
    pub(super) gap_s: Option<f64>,
    pub(super) shortest: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedChannel {
    pub(super) column: Option<String>,
    pub(super) name: Option<String>,
    pub(super) unit: Option<String>,
    #[serde(default)]
    pub(super) convert: bool,
    pub(super) role: Option<Role>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedDerive {
    pub(super) name: Option<String>,
    pub(super) unit: Option<String>,
    pub(super) factor: Option<f64>,
    pub(super) powers: Option<BTreeMap<String, i32>>,
    pub(super) role: Option<Role>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedSplit {
    pub(super) column: Option<String>,
    pub(super) estimation: Option<Vec<toml::Value>>,
    pub(super) selection: Option<Vec<toml::Value>>,
    pub(super) test: Option<Vec<toml::Value>>,
    pub(super) estimation_rows: Option<Vec<(usize, usize)>>,
    pub(super) selection_rows: Option<Vec<(usize, usize)>>,
    pub(super) test_rows: Option<Vec<(usize, usize)>>,
    pub(super) test_every: Option<usize>,
    pub(super) fractions: Option<Vec<f64>>,
    pub(super) blocks: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedTest {
    pub(super) name: Option<String>,
    pub(super) file: Option<String>,
    pub(super) format: Option<Format>,
    pub(super) init_samples: Option<usize>,
    pub(super) columns: Option<BTreeMap<String, String>>,
    pub(super) cut: Option<bool>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedModel {
    pub(super) target: Option<String>,
    pub(super) targets: Option<Vec<String>>,
    pub(super) inputs: Option<Vec<String>>,
    pub(super) structure: Option<toml::Table>,
    pub(super) structures: Option<BTreeMap<String, toml::Table>>,
    pub(super) select: Option<toml::Table>,
    pub(super) warm_start_samples: Option<usize>,
    pub(super) estimator: Option<toml::Table>,
    pub(super) initial: Option<toml::Value>,
    pub(super) cost: Option<toml::Value>,
    pub(super) search: Option<toml::Value>,
    pub(super) covariance: Option<toml::Value>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedValidate {
    pub(super) k_steps: Option<Vec<usize>>,
    pub(super) band: Option<BTreeMap<String, f64>>,
    pub(super) folds: Option<usize>,
    pub(super) stability_runs: Option<usize>,
    pub(super) residual_lags: Option<usize>,
    pub(super) initial: Option<Initial>,
    pub(super) confidence: Option<f64>,
    pub(super) boundary: Option<toml::Table>,
}
