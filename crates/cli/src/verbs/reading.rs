//! Flags of the verbs that read one measurement file.

use std::collections::BTreeMap;

use clap::Args;
use dynocal_files::dataset::Format;
use dynocal_files::measurement::csv_dialect::CsvKeys;

use crate::failure::Failure;

// No doc comment: clap would show it in `--help` in place of each verb's own description.
#[derive(Args, Debug)]
pub(crate) struct Reading {
    /// Format, where neither its first bytes nor its name tell it (`dynocal list formats`)
    #[arg(long, value_name = "NAME", value_parser = format)]
    pub(crate) format: Option<Format>,
    /// Dialect of a CSV file as TOML, e.g. 'separator = ";", header_line = 3'
    #[arg(long, value_name = "KEYS")]
    pub(crate) csv: Option<String>,
}

/// What a flag says cannot be understood.
#[derive(Debug, thiserror::Error)]
#[error("{flag} {found}: expected {expected}")]
pub(crate) struct FlagError {
    pub(crate) flag: &'static str,
    pub(crate) found: String,
    pub(crate) expected: String,
}

fn format(name: &str) -> Result<Format, String> {
    Format::try_from(name.to_string())
}

impl Reading {
    /// The dialect as `--csv` gives it.
    pub(crate) fn dialect(&self) -> Result<CsvKeys, Failure> {
        let Some(text) = &self.csv else { return Ok(CsvKeys::default()) };
        let whole: Result<BTreeMap<String, CsvKeys>, _> = toml::from_str(&format!("csv = {{ {text} }}"));
        let expected = |e: toml::de::Error| format!("keys of a dialect in TOML ({})", e.message());
        let fail = |e| FlagError { flag: "--csv", found: text.clone(), expected: expected(e) };
        Ok(whole.map_err(fail)?.remove("csv").unwrap_or_default())
    }
}
