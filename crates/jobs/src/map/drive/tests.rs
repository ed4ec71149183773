use super::*;
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::steady::layout::{Factor, FactorKind};
use dynocal_calib::steady::trim::Along;

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
    let trim = Trim::with(&[vec![10.0, 50.0, 100.0]], &along, 1.0, 0.0).unwrap();
    found.take(Trim { scatter: held, ..trim }, Some(0), between);
    found.choice = words.into();
    found
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
