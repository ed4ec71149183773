//! Long records are cut where a trigger is on or the time pauses; what is left out is said.

use dynocal_files::csv_io;
use dynocal_files::dataset::{ChannelSpec, Layout, Select, Time, datasets};
use dynocal_files::split::{By, Cut, experiments};
use dynocal_files::table::Table;
use dynocal_ident::data::Role;

/// Stamps in ms: 5 rows, a pause, 3 rows, a clock that starts again, 4 rows, a pause, 1 row.
fn bed() -> Table {
    let stamps = [0, 20, 40, 60, 80, 500, 520, 540, 0, 20, 40, 60, 900];
    let row = |(k, t): (usize, &i32)| format!("{t},{k},{}\n", i32::from(k % 4 > 0));
    let rows: String = stamps.iter().enumerate().map(row).collect();
    csv_io::parse("bed.csv", format!("time [ms],x [Nm],on\n{rows}").as_bytes()).unwrap()
}

fn gap(shortest: usize) -> Cut {
    Cut { by: By::Gap { column: "time".into(), unit: None, longer_s: 0.021 }, shortest }
}

#[test]
fn pauses_and_clocks_that_start_again() {
    let found = experiments(&bed(), &gap(1)).unwrap();
    assert_eq!(found.ranges, [0..5, 5..8, 8..12, 12..13]);
    let found = experiments(&bed(), &gap(4)).unwrap();
    assert_eq!(found.ranges, [0..5, 8..12]);
    assert_eq!(
        found.note,
        "cut at pauses of `time` over 0.021 s: 2 experiments, 9 of 13 rows; 2 pieces of fewer than 4 rows are left out"
    );
    let e = experiments(&bed(), &gap(6)).unwrap_err().to_string();
    assert!(e.contains("bed.csv: cut at pauses") && e.contains("no experiment is left"), "{e}");
}

/// Every piece has the uniform time that the whole record has not.
#[test]
fn pieces_become_records() {
    let channel =
        ChannelSpec { column: "x".into(), name: "x".into(), unit: None, convert: false, role: Role::Output };
    let time = Time::Column { column: "time".into(), unit: None };
    let whole = Layout { channels: vec![channel], time, ..Layout::default() };
    assert!(datasets(&bed(), &whole, &Select::All).is_err());
    let cut = Layout { cut: Some(gap(2)), ..whole.clone() };
    let all = datasets(&bed(), &cut, &Select::All).unwrap();
    let values: Vec<Vec<f64>> = all.iter().map(|d| d.channels[0].values.clone()).collect();
    assert_eq!(values, [vec![0.0, 1.0, 2.0, 3.0, 4.0], vec![5.0, 6.0, 7.0], vec![8.0, 9.0, 10.0, 11.0]]);
    assert!(all.iter().all(|d| d.sample_time_s == 0.02));
    // Rows that are selected count only inside of an experiment.
    let some = datasets(&bed(), &cut, &Select::Rows(vec![(3, 7)])).unwrap();
    assert_eq!(some.iter().map(|d| d.len()).collect::<Vec<_>>(), [2, 2]);
    let e = datasets(&bed(), &cut, &Select::Rows(vec![(12, 13)])).unwrap_err().to_string();
    assert!(e.contains("no experiment is left"), "{e}");
    // A trigger and pauses are one thing to a reader: runs of rows.
    let by = By::Trigger { column: "on".into(), above: 0.5 };
    let on =
        Layout { cut: Some(Cut { by, shortest: 3 }), time: Time::Sampled { sample_time_s: 0.02 }, ..whole };
    let found = datasets(&bed(), &on, &Select::All).unwrap();
    assert_eq!(found.iter().map(|d| d.channels[0].values[0]).collect::<Vec<_>>(), [1.0, 5.0, 9.0]);
}
