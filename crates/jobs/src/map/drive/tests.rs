use super::*;
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::steady::layout::{Factor, FactorKind};
use dynocal_calib::steady::trim::Along;
use dynocal_calib::steady::trim::Choice;

/// As stiff in its lag as in its correction, and a lag that is there at once.
fn alike(lambda: f64) -> Choice {
    Choice { lambda, kappa: lambda, tau_s: 0.0 }
}

/// One axis and no held channel.
fn layout() -> Layout {
    let factor = Factor {
        name: "torque".into(),
        unit: "Nm".into(),
        lower: 10.0,
        upper: 100.0,
        kind: FactorKind::Demand(0),
    };
    Layout {
        problem: CalibrationProblem::thesis(),
        loops: Vec::new(),
        factors: vec![factor],
        axes: 1,
        held: std::collections::BTreeMap::new(),
        responses: Vec::new(),
        sample_time_s: 0.1,
    }
}

/// `u = y`, learnt over the torque, and what lines say of it: scatter by the demand, and what they differ by among themselves.
fn trimmed(words: &str, held: f64, between: Option<f64>) -> Drive {
    let layout = layout();
    let rows: Vec<([f64; 1], [f64; 0])> = (1..=24).map(|k| ([4.0 * f64::from(k)], [])).collect();
    let rows: Vec<(&[f64], &[f64])> = rows.iter().map(|(x, r)| (&x[..], &r[..])).collect();
    let y: Vec<f64> = rows.iter().map(|r| r.0[0]).collect();
    let mut spec = MapSpec::default();
    let line = toml::Table::from_iter([
        ("kind".to_string(), "stepwise_polynomial".into()),
        ("degree".to_string(), 2.into()),
    ]);
    spec.models.candidates = vec![line];
    let record = record(&layout, &rows);
    let over = vec!["torque".into()];
    let mut found = drive(&layout, &record, over, &y, ("throttle", "deg"), &spec, Watch::silent()).unwrap();
    let mut along = Along::default();
    (0..8).for_each(|k| along.push(vec![10.0 + 10.0 * f64::from(k)], Way::default(), 0.0, 1.0));
    let trim = Trim::with(&[vec![10.0, 50.0, 100.0]], &along, alike(1.0)).unwrap();
    found.take(Trim { scatter: held, ..trim }, Some(0), between);
    found.choice = words.into();
    found
}

/// u = y with a window that has a tenth more of the input: the demand there was less than the map says for it, by the slope; the lag of the way is none of it.
#[test]
fn what_is_left_of_a_window_counts_in_its_cell_by_the_demand() {
    let axes = [vec![10.0, 50.0, 100.0]];
    let mut lagging = Along::default();
    for k in 0..16 {
        let up = if k % 2 == 0 { 1.0 } else { -1.0 };
        let way = Way { up, since_s: 1e6, before: [(0.0, 0.0); 2], window_s: 1.0 };
        lagging.push(vec![10.0 + 5.0 * f64::from(k)], way, -0.03 * up, 1.0);
    }
    let trim = Trim::with(&axes, &lagging, alike(1e-3)).unwrap();
    let of = |slope: f64, share: f64, up: f64, demand: Option<usize>| {
        let mut drive = trimmed("first.", 0.01, None);
        drive.take(trim.clone(), demand, None);
        let way = Way { up, since_s: 1e6, before: [(0.0, 0.0); 2], window_s: 1.0 };
        let set = Set { at: &[90.0], way, input: 90.0 * share, said: [90.0, 90.0], slope, weight: 1.0 };
        drive.compare(&axes, &[set]);
        drive.trimmed.unwrap().cells
    };
    let near = |cells: &[Option<f64>], expected: f64| {
        assert_eq!((cells.len(), cells[0], cells[1]), (3, None, None));
        assert!((cells[2].unwrap() - expected).abs() < 1e-3, "{cells:?} {expected}");
    };
    let tenth = 1.1f64.ln();
    near(&of(2.0, 1.1, 0.0, Some(0)), -0.5 * tenth);
    // An input that falls with the demand.
    near(&of(-2.0, 1.1, 0.0, Some(0)), 0.5 * tenth);
    // On the way up the demand is 3 % behind what the input gives at rest: all that there is more of the input.
    near(&of(2.0, (2.0 * 0.03f64).exp(), 1.0, Some(0)), 0.0);
    near(&of(2.0, (-2.0 * 0.03f64).exp(), -1.0, Some(0)), 0.0);
    assert!(of(2.0, 1.1, 0.0, None).is_empty());
}

/// Of maps over other channels that is taken which lines contradict less, by what they differ among themselves where there are three of them.
#[test]
fn lines_choose_between_maps() {
    let of = |own: Drive, mut first: Drive| {
        own.rather_than(&mut first);
        first.choice
    };
    let less = of(trimmed("other.", 0.01, None), trimmed("first.", 0.02, None));
    assert!(
        less.starts_with("other. Taken rather than over torque") && less.contains("1.0 % and 2.0 %"),
        "{less}"
    );
    assert_eq!(of(trimmed("other.", 0.03, None), trimmed("first.", 0.02, None)), "first.");
    let between = of(trimmed("other.", 0.01, Some(0.05)), trimmed("first.", 0.02, Some(0.03)));
    assert_eq!(between, "first.");
    // What is no number is no less, and a map that no line went along is not compared.
    assert_eq!(of(trimmed("other.", f64::NAN, None), trimmed("first.", 0.02, None)), "first.");
    let bare = Drive { trimmed: None, ..trimmed("other.", 0.0, None) };
    assert_eq!(of(bare, trimmed("first.", 0.02, None)), "first.");
}

/// A map that was learnt from lines as well is taken where less is left along them, and keeps what was said of the errors of the other: its own lines test nothing.
#[test]
fn a_map_learnt_from_lines_is_no_test_of_itself() {
    let mut before = trimmed("first.", 0.02, Some(0.04));
    let error = before.error;
    Drive { error: 1e-6, points: 99, ..trimmed("again.", 0.01, Some(0.001)) }.in_place_of(&mut before, 60);
    assert!(before.choice.starts_with("first. Learnt again with 60 points of lines"), "{}", before.choice);
    let t = before.trimmed.as_ref().unwrap();
    assert_eq!((t.held, t.between, before.points), (0.01, Some(0.04), 24));
    assert_eq!(before.error, error);
    let kept = before.choice.clone();
    trimmed("worse.", 0.03, Some(0.001)).in_place_of(&mut before, 60);
    trimmed("none.", f64::NAN, None).in_place_of(&mut before, 60);
    assert_eq!(before.choice, kept);
}
