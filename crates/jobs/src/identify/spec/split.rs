//! Which samples estimate, which select, which test: table `split`.

use dynocal_files::dataset::Select;
use dynocal_files::spec::Faults;
use serde::Serialize;

use super::typed::TypedSplit;

/// Division of the data.
#[derive(Clone, Debug, Serialize)]
pub enum Split {
    /// By rows of the files.
    Rows {
        /// Rows to estimate from.
        estimation: Select,
        /// Rows that choose between candidates (early stopping, structure).
        selection: Option<Select>,
        /// Rows that nothing before the scores may see.
        test: Option<Select>,
    },
    /// By shares of every record.
    Shares {
        /// Shares for estimation, selection and test; their sum is 1.
        fractions: [f64; 3],
        /// Every record is first cut into so many blocks, which are dealt out in turn; 1: three pieces in order.
        blocks: usize,
    },
    /// Every so many-th row of every table tests, the others estimate: for steady tables.
    Every {
        /// Distance of the rows that test.
        every: usize,
    },
}

const SHAPE: &str = "column with estimation (and test) values, or estimation_rows (and test_rows), or fractions (and blocks), or test_every";

/// The split of the spec; without a table everything estimates.
pub(super) fn split(typed: Option<&TypedSplit>, faults: &mut Faults) -> Option<Split> {
    let Some(s) = typed else {
        return Some(Split::Rows { estimation: Select::All, selection: None, test: None });
    };
    let by_rows = s.estimation_rows.is_some() || s.selection_rows.is_some() || s.test_rows.is_some();
    let by_value = s.column.is_some() || s.estimation.is_some() || s.selection.is_some() || s.test.is_some();
    let by_share = s.fractions.is_some() || s.blocks.is_some();
    match (by_value, by_rows, by_share, s.test_every) {
        (true, false, false, None) => values(s, faults),
        (false, true, false, None) => rows(s, faults),
        (false, false, true, None) => shares(s, faults),
        (false, false, false, Some(every)) => {
            if every < 2 {
                faults.push("split.test_every", every, "2 or more: each so many-th row tests");
            }
            Some(Split::Every { every })
        }
        _ => {
            faults.push("split", "another combination of keys", SHAPE);
            None
        }
    }
}

fn values(s: &TypedSplit, faults: &mut Faults) -> Option<Split> {
    let (Some(column), Some(estimation)) = (&s.column, &s.estimation) else {
        faults.push("split", "another combination of keys", SHAPE);
        return None;
    };
    let label = |v: &toml::Value| v.as_str().map_or_else(|| v.to_string(), str::to_string);
    let part = |v: &Vec<toml::Value>| -> Vec<String> { v.iter().map(label).collect() };
    let (estimation, selection, test) =
        (part(estimation), s.selection.as_ref().map(part), s.test.as_ref().map(part));
    let lists =
        [("estimation", Some(&estimation)), ("selection", selection.as_ref()), ("test", test.as_ref())];
    for (key, values) in lists {
        if values.is_some_and(Vec::is_empty) {
            let expected = "at least one value; leave the key out where there are none";
            faults.push(&format!("split.{key}"), "an empty list", expected);
        }
    }
    let all: Vec<&String> =
        [Some(&estimation), selection.as_ref(), test.as_ref()].into_iter().flatten().flatten().collect();
    if let Some(k) = (1..all.len()).find(|k| all[..*k].contains(&all[*k])) {
        let expected = "each value in one part only: what is called unseen must not have been seen";
        faults.push("split", format!("`{}` twice", all[k]), expected);
    }
    let select = |values| Select::Values { column: column.clone(), values };
    Some(Split::Rows {
        estimation: select(estimation),
        selection: selection.map(select),
        test: test.map(select),
    })
}

fn rows(s: &TypedSplit, faults: &mut Faults) -> Option<Split> {
    let Some(estimation) = &s.estimation_rows else {
        faults.push("split", "another combination of keys", SHAPE);
        return None;
    };
    let parts = [
        ("split.estimation_rows", Some(estimation)),
        ("split.selection_rows", s.selection_rows.as_ref()),
        ("split.test_rows", s.test_rows.as_ref()),
    ];
    let mut all: Vec<(usize, usize)> = Vec::new();
    for (key, ranges) in parts {
        if ranges.is_some_and(Vec::is_empty) {
            faults.push(
                key,
                "an empty list",
                "at least one [first, end); leave the key out where there are none",
            );
        }
        for r in ranges.into_iter().flatten() {
            if r.0 >= r.1 {
                let expected = "[first, end) with first < end, zero-based rows";
                faults.push(key, format!("[{}, {}]", r.0, r.1), expected);
            }
            if let Some(other) = all.iter().find(|o| o.0 < r.1 && r.0 < o.1) {
                let found = format!("[{}, {}] and [{}, {}]", other.0, other.1, r.0, r.1);
                let expected = "rows that no two ranges share: what is called unseen must not have been seen";
                faults.push("split", found, expected);
            }
            all.push(*r);
        }
    }
    Some(Split::Rows {
        estimation: Select::Rows(estimation.clone()),
        selection: s.selection_rows.clone().map(Select::Rows),
        test: s.test_rows.clone().map(Select::Rows),
    })
}

fn shares(s: &TypedSplit, faults: &mut Faults) -> Option<Split> {
    let given = s.fractions.clone().unwrap_or_else(|| vec![0.7, 0.15, 0.15]);
    let fractions = match given[..] {
        [e, t] => [e, 0.0, t],
        [e, v, t] => [e, v, t],
        _ => {
            let expected = "[estimation, test] or [estimation, selection, test], e.g. [0.7, 0.15, 0.15]";
            faults.push("split.fractions", format!("{} numbers", given.len()), expected);
            return None;
        }
    };
    let sum: f64 = fractions.iter().sum();
    if !(fractions.iter().all(|f| (0.0..=1.0).contains(f)) && (sum - 1.0).abs() < 1e-9 && fractions[0] > 0.0)
    {
        let expected = "shares from 0 to 1 with sum 1, the first above 0";
        faults.push("split.fractions", format!("{given:?}"), expected);
    }
    let blocks = s.blocks.unwrap_or(1);
    if blocks == 0 {
        faults.push("split.blocks", "0", "a number of blocks, 1 or more");
    }
    Some(Split::Shares { fractions, blocks })
}
