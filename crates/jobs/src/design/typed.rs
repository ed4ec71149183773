//! The spec as typed. Keys that must be there are options, so that one missing key does not hide other faults.

use std::collections::BTreeMap;
use std::path::PathBuf;

use dynocal_design::channel::Shape;
use dynocal_design::problem::Convention;
use dynocal_files::measurement::csv_dialect::CsvKeys;
use dynocal_files::measurement::merge;
use serde::Deserialize;

use crate::identify::spec::TypedCut;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Typed {
    pub(super) name: Option<String>,
    pub(super) out: Option<PathBuf>,
    pub(super) length_s: Option<f64>,
    pub(super) sample_time_s: Option<f64>,
    pub(super) convention: Option<Convention>,
    pub(super) seed: Option<u64>,
    pub(super) rivals: Option<usize>,
    pub(super) certificate: Option<bool>,
    pub(super) efficiencies: Option<bool>,
    pub(super) channels: Option<Vec<TypedChannel>>,
    pub(super) regions: Option<Vec<TypedRegion>>,
    pub(super) models: Option<Vec<TypedModel>>,
    pub(super) objective: Option<TypedObjective>,
    pub(super) records: Option<TypedRecords>,
    pub(super) search: Option<toml::Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedRecords {
    pub(super) csv: Option<CsvKeys>,
    pub(super) merge: Option<merge::Keys>,
    pub(super) alias: Option<BTreeMap<String, Vec<String>>>,
    pub(super) cut: Option<TypedCut>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TypedChannel {
    pub(super) name: Option<String>,
    pub(super) unit: Option<String>,
    pub(super) lower: Option<f64>,
    pub(super) upper: Option<f64>,
    pub(super) hold_s: Option<f64>,
    pub(super) shape: Option<Shape>,
    pub(super) rate_per_s: Option<f64>,
    pub(super) before: Option<f64>,
    pub(super) start: Option<f64>,
    pub(super) end: Option<f64>,
    pub(super) levels: Option<Vec<f64>>,
    pub(super) file: Option<PathBuf>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedRegion {
    pub(super) name: Option<String>,
    pub(super) channels: Option<(String, String)>,
    pub(super) outside: Option<Vec<[f64; 2]>>,
    pub(super) inside: Option<Vec<[f64; 2]>>,
    pub(super) forbidden: Option<BTreeMap<String, [f64; 2]>>,
    pub(super) sum: Option<BTreeMap<String, f64>>,
    pub(super) at_most: Option<f64>,
    pub(super) at_least: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedModel {
    pub(super) literature: Option<String>,
    pub(super) file: Option<PathBuf>,
    pub(super) noise_std: Option<f64>,
    pub(super) criterion: Option<String>,
    pub(super) weight: Option<f64>,
    pub(super) initial_output: Option<f64>,
    pub(super) prior: Option<Vec<PathBuf>>,
    pub(super) held_out: Option<Vec<PathBuf>>,
    pub(super) limits: Option<TypedLimits>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedLimits {
    pub(super) lower: Option<f64>,
    pub(super) upper: Option<f64>,
    pub(super) margin: Option<f64>,
    pub(super) rate: Option<f64>,
    pub(super) block_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedObjective {
    pub(super) file: Option<PathBuf>,
    pub(super) length_s: Option<f64>,
    pub(super) signals: Option<BTreeMap<String, toml::Table>>,
}
