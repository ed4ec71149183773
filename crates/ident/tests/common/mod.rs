//! Reading of reference records. Columns are checked by name, so that a test cannot read the wrong channel.
#![allow(dead_code)]

pub(crate) mod lag;
pub(crate) mod systems;

use std::path::PathBuf;

use dynocal_ident::data::{Channel, Dataset, Role};

/// Folder of the small reference values that are part of the project.
pub(crate) fn own(file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference").join(file)
}

/// A file of the large reference data, or `None` (printed) where they are not installed.
pub(crate) fn reference(file: &str) -> Option<PathBuf> {
    match std::env::var("DYNOCAL_REFERENCE_DIR") {
        Ok(dir) => Some(PathBuf::from(dir).join("reference").join(file)),
        Err(_) => {
            println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
            None
        }
    }
}

/// A CSV with a header of names as a dataset; `columns` are (name in the file, name, role).
pub(crate) fn dataset(path: &PathBuf, sample_time_s: f64, columns: &[(&str, &str, Role)]) -> Dataset {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|l| l.split(',').map(|v| v.trim().parse().unwrap()).collect()).collect();
    let channels = columns
        .iter()
        .map(|(column, name, role)| {
            let i = header.iter().position(|h| h == column).unwrap_or_else(|| panic!("no {column}"));
            Channel {
                name: (*name).into(),
                unit: "-".into(),
                role: *role,
                values: rows.iter().map(|r| r[i]).collect(),
            }
        })
        .collect();
    Dataset {
        name: path.file_stem().unwrap().to_string_lossy().into_owned(),
        sample_time_s,
        channels,
        init_samples: 0,
        origin: "reference data".into(),
    }
}

/// Numbers of a file with one column.
pub(crate) fn column(path: &PathBuf) -> Vec<f64> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().map(|l| l.trim().parse().unwrap()).collect()
}

/// The record of chapter 5.
pub(crate) fn ch5(path: &PathBuf) -> Dataset {
    use Role::{Input, Output};
    dataset(
        path,
        0.1,
        &[
            ("u1_fraction", "abv", Input),
            ("u2_deg", "spark", Input),
            ("u3_rpm", "speed", Input),
            ("z", "torque", Output),
            ("y_noise_free", "noise_free", Role::Auxiliary),
        ],
    )
}

/// An engine record of chapter 7.
pub(crate) fn engine(path: &PathBuf) -> Dataset {
    use Role::{Input, Output};
    dataset(
        path,
        0.03,
        &[
            ("INJ_mg", "inj", Input),
            ("SA_deg", "spark", Input),
            ("theta_deg", "throttle", Input),
            ("N_rpm", "speed", Input),
            ("T_Nm", "torque", Output),
            ("lambda", "lambda", Output),
        ],
    )
}

/// |a - b| <= tolerance |b|.
pub(crate) fn relative(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance * b.abs(), "found {a}, expected {b} to {tolerance} relative");
}
