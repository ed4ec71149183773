//! Two sets of maps beside each other: equal is equal in every format, and a difference is found wherever it is.

#![allow(clippy::disallowed_methods)] // files of tests are written as they are

mod common;

use common::axis;
use dynocal_export::characteristic::Characteristic;
use dynocal_export::compare::compare;
use dynocal_export::evaluate::lookup;
use dynocal_export::format::{Keys, read, write};
use dynocal_export::package::Extrapolation;
use dynocal_numerics::rng::Rng64;

fn map(x: &[f64], y: &[f64], values: Vec<f64>) -> Characteristic {
    Characteristic {
        name: "M".into(),
        description: String::new(),
        unit: "Nm".into(),
        axes: vec![axis("x", "rpm", "speed", x), axis("y", "mg", "inj", y)],
        values,
        limits: None,
    }
}

#[test]
fn a_file_is_equal_to_itself_in_another_format() {
    let maps = common::maps();
    for format in ["dcm", "cdfx", "json"] {
        let file = write(&maps, format, &Keys::default()).unwrap().remove(0);
        let back = read(&file.name, &file.bytes).unwrap();
        let found = compare(&maps.characteristics, &back.characteristics);
        assert_eq!(found.both.len(), maps.characteristics.len(), "{format}");
        assert!(found.only_first.is_empty() && found.only_second.is_empty(), "{format}");
        // A DCM is ASCII: the degree sign is spelt out, and is the same unit.
        for d in &found.both {
            assert!(d.is_equal(), "{format}: {d:?}");
        }
    }
}

#[test]
fn one_value_is_found() {
    let a = common::maps().characteristics;
    let mut b = a.clone();
    b[4].values[5] = 30.0; // INJ_MAP at 4000 rpm, 150 Nm was 33
    b.remove(0);
    b[0].name = "OTHER".into();
    let found = compare(&a, &b);
    assert_eq!(
        (found.only_first, found.only_second),
        (vec!["LAM_KP".to_string(), "INJ_COEF".into()], vec!["OTHER".into()])
    );
    let d = found.both.iter().find(|d| !d.is_equal()).unwrap();
    assert_eq!((d.name.as_str(), d.points, d.differing), ("INJ_MAP", 6, 1));
    assert!((d.rms.unwrap() - 3.0 / 6f64.sqrt()).abs() < 1e-12);
    let l = d.largest.as_ref().unwrap();
    assert_eq!((l.at.as_slice(), l.first, l.second), (&[4000.0, 150.0][..], 33.0, 30.0));
}

/// No point anywhere in the common region differs more than what was found on the points of both axes.
#[test]
fn nothing_between_the_points_differs_more() {
    let mut rng = Rng64::new(5);
    for _ in 0..50 {
        let mut points = |n: usize| {
            let mut p: Vec<f64> = (0..n).map(|_| rng.uniform_in(0.0, 10.0)).collect();
            p.sort_by(f64::total_cmp);
            p
        };
        let (ax, ay, bx, by) = (points(4), points(3), points(5), points(6));
        let mut values = |n: usize| (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect::<Vec<_>>();
        let (a, b) = (map(&ax, &ay, values(12)), map(&bx, &by, values(30)));
        let found = compare(std::slice::from_ref(&a), std::slice::from_ref(&b)).both.remove(0);
        let range = |p: &[f64], q: &[f64]| (p[0].max(q[0]), p[p.len() - 1].min(q[q.len() - 1]));
        let (x, y) = (range(&ax, &bx), range(&ay, &by));
        let Some(largest) = &found.largest else {
            assert!(x.0 > x.1 || y.0 > y.1, "{found:?}");
            continue;
        };
        let most = (largest.second - largest.first).abs();
        for _ in 0..2000 {
            let u = [rng.uniform_in(x.0, x.1), rng.uniform_in(y.0, y.1)];
            let d = lookup(&a, &u, Extrapolation::Clip) - lookup(&b, &u, Extrapolation::Clip);
            assert!(d.abs() <= most * (1.0 + 1e-12), "{u:?}: {d} beyond {most}");
        }
    }
}

#[test]
fn units_are_converted_or_refused() {
    let a = map(&[0.0, 60.0], &[0.0, 1000.0], vec![1.0, 2.0, 3.0, 4.0]);
    // rad/s, g and lbf ft: the same map.
    let mut b = a.clone();
    b.axes[0].unit = "rad/s".into();
    b.axes[0].points = vec![0.0, 2.0 * std::f64::consts::PI];
    b.axes[1].unit = "g".into();
    b.axes[1].points = vec![0.0, 1.0];
    b.unit = "lb ft".into();
    b.values.iter_mut().for_each(|v| *v /= 1.3558179483314004);
    let d = compare(std::slice::from_ref(&a), &[b.clone()]).both.remove(0);
    assert_eq!((d.points, d.differing, d.remarks.len()), (4, 0, 3), "{d:?}");
    b.unit = "kPa".into();
    let d = compare(std::slice::from_ref(&a), &[b]).both.remove(0);
    assert!(d.points == 0 && d.remarks[0].contains("`kPa` cannot become `Nm`"), "{d:?}");
    let far = map(&[100.0, 200.0], &[0.0, 1000.0], vec![0.0; 4]);
    let d = compare(&[a], &[far]).both.remove(0);
    assert!(d.points == 0 && d.remarks[0].contains("nothing in common"), "{d:?}");
}
