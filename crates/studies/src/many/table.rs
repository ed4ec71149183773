//! The numbers of all tasks as columns.

use std::collections::BTreeMap;
use std::path::Path;

use dynocal_files::measurement::parquet_io;
use serde::Serialize;
use serde_json::Value;

use super::Line;
use crate::StudyError;

/// Most columns: what is beyond stays in the chunks.
const MOST_COLUMNS: usize = 500;
/// Longest list whose numbers become columns.
const MOST_LIST: usize = 32;

/// A number of every task; NaN where a task has none.
#[derive(Clone, Debug)]
pub(super) struct Column {
    /// Its place in a line, e.g. `result.models.0.rmse`. The unit is where the key says it.
    pub(super) name: String,
    pub(super) values: Vec<f64>,
}

/// Mean and spread of a column over the tasks that have it.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Spread {
    pub(super) name: String,
    pub(super) tasks: usize,
    pub(super) mean: f64,
    /// Standard deviation with n - 1.
    pub(super) sd: Option<f64>,
    pub(super) least: f64,
    pub(super) greatest: f64,
}

/// Columns, in the order in which lines bring them.
#[derive(Default)]
pub(super) struct Columns {
    known: BTreeMap<String, usize>,
    pub(super) columns: Vec<Column>,
    rows: usize,
    /// Whether there were more than are kept.
    pub(super) cut: bool,
}

impl Columns {
    /// A line more.
    pub(super) fn push(&mut self, line: &Line) {
        let mut found = Vec::new();
        for (key, value) in line {
            numbers(key, value, &mut found);
        }
        let (rows, known) = (self.rows, &mut self.known);
        for (name, value) in found {
            let next = self.columns.len();
            if next == MOST_COLUMNS && !known.contains_key(&name) {
                self.cut = true;
                continue;
            }
            let at = *known.entry(name.clone()).or_insert(next);
            if at == next {
                self.columns.push(Column { name, values: vec![f64::NAN; rows] });
            }
            self.columns[at].values.push(value);
        }
        self.rows += 1;
        for c in &mut self.columns {
            c.values.resize(self.rows, f64::NAN);
        }
    }

    /// Writes all columns.
    pub(super) fn write(&self, path: &Path) -> Result<(), StudyError> {
        let columns: Vec<(&str, &str, &[f64])> =
            self.columns.iter().map(|c| (c.name.as_str(), "", c.values.as_slice())).collect();
        Ok(parquet_io::write_columns(path, &columns)?)
    }

    /// Spread of every number that is a result.
    pub(super) fn spreads(&self) -> Vec<Spread> {
        self.columns
            .iter()
            .filter(|c| c.name == "valid" || c.name.starts_with("result."))
            .filter_map(spread)
            .collect()
    }
}

/// Mean in two passes: a large mean does not eat a small spread.
fn spread(column: &Column) -> Option<Spread> {
    let values: Vec<f64> = column.values.iter().copied().filter(|v| v.is_finite()).collect();
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    let name = column.name.strip_prefix("result.").unwrap_or(&column.name).to_string();
    (!values.is_empty()).then(|| Spread {
        name,
        tasks: values.len(),
        mean,
        sd: (values.len() > 1).then(|| (squares / (n - 1.0)).sqrt()),
        least: values.iter().copied().fold(f64::INFINITY, f64::min),
        greatest: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    })
}

/// Numbers and truths in `value`, by their place.
fn numbers(name: &str, value: &Value, out: &mut Vec<(String, f64)>) {
    match value {
        Value::Number(n) => out.extend(n.as_f64().map(|v| (name.to_string(), v))),
        Value::Bool(b) => out.push((name.to_string(), f64::from(*b))),
        Value::Object(o) => o.iter().for_each(|(k, v)| numbers(&format!("{name}.{k}"), v, out)),
        Value::Array(a) if a.len() <= MOST_LIST => {
            a.iter().enumerate().for_each(|(k, v)| numbers(&format!("{name}.{k}"), v, out));
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::Columns;
    use serde_json::json;

    #[test]
    fn numbers_become_columns_and_what_a_task_lacks_is_missing() {
        let mut columns = Columns::default();
        let lines = [
            json!({"task": 0, "valid": true, "result": {"r": [1.0, 2.0], "text": "x"}}),
            json!({"task": 1, "status": "failed"}),
            json!({"task": 2, "valid": false, "result": {"r": [1e9 + 1.0, null], "more": 3}}),
        ];
        lines.iter().for_each(|l| columns.push(l.as_object().unwrap()));
        let names: Vec<&str> = columns.columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["task", "valid", "result.r.0", "result.r.1", "result.more"]);
        assert!(columns.columns.iter().all(|c| c.values.len() == 3));
        assert!(
            columns.columns[2].values[1].is_nan()
                && columns.columns[4].values[..2].iter().all(|v| v.is_nan())
        );
        let spreads = columns.spreads();
        assert_eq!((spreads[0].name.as_str(), spreads[0].tasks, spreads[0].mean), ("valid", 2, 0.5));
        // Two numbers: the standard deviation is their distance over the root of two.
        assert!((spreads[1].sd.unwrap() - 1e9 / 2f64.sqrt()).abs() < 1e-3);
        assert_eq!((spreads[3].tasks, spreads[3].sd), (1, None));
    }

    #[test]
    fn a_small_spread_beside_a_large_mean_is_kept() {
        let mut columns = Columns::default();
        for k in 0..5 {
            columns.push(json!({"result": {"x": 1e8 + f64::from(k) * 1e-3}}).as_object().unwrap());
        }
        let sd = columns.spreads()[0].sd.unwrap();
        assert!((sd - 1e-3 * 2.5f64.sqrt()).abs() < 1e-7, "{sd}");
    }
}
