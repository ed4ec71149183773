//! How the scored records stay in the run folder of `identify`: CSV, Parquet for long ones, or not at all.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use dynocal_files::atomic;
use dynocal_files::dataset::read_table;
use dynocal_jobs::identify::spec::{self, MOST_CSV_ROWS, Overrides};
use dynocal_jobs::identify::{job, page};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

/// A first-order answer to white noise, `n` rows.
fn record(n: usize) -> String {
    let (mut rng, mut y) = (Rng64::new(7), 0.0);
    let mut text = String::from("u [mg],y [Nm]\n");
    for _ in 0..n {
        let u = rng.normal();
        writeln!(text, "{u:.5},{y:.5}").unwrap();
        y = 0.8 * y + u + 0.1 * rng.normal();
    }
    text
}

/// Identifies with `first` as the first line of the spec; gives the run folder and the files of records.
fn files(folder: &Path, first: &str) -> (PathBuf, Vec<String>) {
    let text = format!(
        "{first}\n[data]\nfile = 'bed.csv'\nsample_time_s = 0.1\n\
         [[channels]]\ncolumn = 'u'\nrole = 'input'\n[[channels]]\ncolumn = 'y'\nrole = 'output'\n\
         [split]\nfractions = [0.6, 0.4]\n\
         [model]\nstructure = {{ name = 'arx', na = 1, nb = 1, nk = 1 }}\nestimator = {{ name = 'ols' }}\n"
    );
    atomic::write(&folder.join("spec.toml"), text.as_bytes()).unwrap();
    let out = folder.join(format!("run{}", first.len()));
    let overrides = Overrides { out: Some(out.clone()), ..Overrides::default() };
    let job = spec::read(&folder.join("spec.toml"), &overrides).unwrap();
    let (found, _) = job::run(&job, Watch::silent()).unwrap();
    page::write(&found, &out).unwrap();
    let files = found.records.iter().map(|r| r.file.clone()).collect::<Vec<_>>();
    assert!(files.iter().all(|f| out.join(f).exists()) && out.join("report.html").exists());
    (out, files)
}

#[test]
fn long_records_are_parquet_and_hold_what_csv_holds() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("bed.csv"), record(MOST_CSV_ROWS + 500).as_bytes()).unwrap();
    let (run, parquet) = files(tmp.path(), "");
    assert!(parquet.len() == 2 && parquet.iter().all(|f| f.ends_with(".parquet")), "{parquet:?}");
    let (other, csv) = files(tmp.path(), "records = 'csv'");
    let mut size = [0, 0];
    for (p, c) in parquet.iter().zip(&csv) {
        assert_eq!(p.strip_suffix("parquet"), c.strip_suffix("csv"));
        let (a, b) = (read_table(&run.join(p), None).unwrap(), read_table(&other.join(c), None).unwrap());
        assert!(a.columns == b.columns, "{p}");
        size[0] += std::fs::metadata(run.join(p)).unwrap().len();
        size[1] += std::fs::metadata(other.join(c)).unwrap().len();
    }
    assert!(3 * size[0] < 2 * size[1], "{size:?}");
}

#[test]
fn records_may_be_left_out_and_short_ones_are_csv() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("bed.csv"), record(400).as_bytes()).unwrap();
    assert!(files(tmp.path(), "").1.iter().all(|f| f.ends_with(".csv")));
    assert!(files(tmp.path(), "records = 'parquet'").1.iter().all(|f| f.ends_with(".parquet")));
    let (run, none) = files(tmp.path(), "records = 'none'");
    assert!(none.is_empty());
    let page = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("The spec keeps no records"), "nothing says why there is nothing");
}
