//! Axes that are fitted with the labels on them, from a spec to the DCM.

use std::path::Path;

use dynocal_files::csv_io::write_columns;
use dynocal_numerics::rng::Rng64;

use super::{dcm, fitted};

/// Torque over speed (a corner at 2300 rpm) times a factor over speed and load, with noise.
fn data(folder: &Path) {
    let mut rng = Rng64::new(7);
    let n = 3000;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * f64::from(k)).collect();
    let speed: Vec<f64> = (0..n).map(|_| 1000.0 + 4000.0 * rng.uniform()).collect();
    let load: Vec<f64> = (0..n).map(|_| rng.uniform()).collect();
    let y: Vec<f64> = (0..n as usize)
        .map(|k| {
            let of = |corner: f64, low: f64, high: f64| {
                if speed[k] < corner { low * (corner - speed[k]) } else { high * (speed[k] - corner) }
            };
            200.0 - of(2300.0, 0.05, 0.02) + load[k] * (50.0 - of(2300.0, 0.02, 0.005)) + 0.5 * rng.normal()
        })
        .collect();
    let columns: [(&str, &str, &[f64]); 4] =
        [("time", "s", &time_s), ("speed", "rpm", &speed), ("load", "-", &load), ("y", "Nm", &y)];
    write_columns(&folder.join("data.csv"), &columns).unwrap();
}

fn text(keys: &str) -> String {
    format!(
        r#"data = ["data.csv"]
target = "y"
fit = {{ smooth = 0.0 }}

[[axes]]
name = "speed"
unit = "rpm"
points = [1000, 3000, 5000]
{keys}

[[labels]]
name = "BASE"
unit = "Nm"
base = [100]
axes = [{{ name = "speed" }}]

[[labels]]
name = "MORE"
unit = "Nm"
base = [0]
locked = [0, 1, 2]
axes = [{{ name = "speed" }}, {{ name = "load", unit = "-", points = [0, 1] }}]

[[nodes]]
name = "n"
op = "channel"
channel = "speed"
unit = "rpm"

[[nodes]]
name = "load"
op = "channel"
channel = "load"

[[nodes]]
name = "base"
op = "label"
label = "BASE"
in = ["n"]

[[nodes]]
name = "more"
op = "label"
label = "MORE"
in = ["n", "load"]

[[nodes]]
name = "torque"
op = "add"
in = ["base", "more"]
"#
    )
}

#[test]
fn a_corner_between_breakpoints_is_found_and_delivered() {
    let tmp = tempfile::tempdir().unwrap();
    data(tmp.path());
    let plain = fitted(tmp.path(), &text("")).unwrap();
    let free = text("fit = true").replace("locked = [0, 1, 2]", "base_weight = 0.001");
    let found = fitted(tmp.path(), &free).unwrap();
    assert!(found.valid && found.converged, "{:?}", found.verdict);
    // Both labels stand on the new breakpoints; the corner is where it was put.
    let corner = |label: usize| found.labels[label].axes[0].points[1];
    assert!((corner(0) - 2300.0).abs() < 20.0, "{}", corner(0));
    assert_eq!(corner(0), corner(1));
    assert_eq!(found.labels[0].axes[0].points[2], 5000.0);
    assert!(found.unseen_rms[1] < 0.55 && plain.unseen_rms[1] > 2.0 * found.unseen_rms[1]);
    // Their own label and its intervals are told; what is written has them as axis.
    assert_eq!(found.labels[2].name, "speed breakpoints");
    let half = found.half_width[found.half_width.len() - 2].unwrap();
    assert!((corner(0) - 2300.0).abs() < half && half < 20.0, "{half}");
    let dcm = dcm(&found, tmp.path());
    assert!(!dcm.contains("breakpoints"), "{dcm}");
    let written = format!("{}", corner(0));
    assert!(dcm.contains(&written[..4]), "{written} in {dcm}");
}

/// Values that are given by definition are given at a place; where that leaves no breakpoint the spec is at fault.
#[test]
fn a_breakpoint_of_a_locked_cell_stays() {
    let tmp = tempfile::tempdir().unwrap();
    data(tmp.path());
    let said = fitted(tmp.path(), &text("fit = true")).unwrap_err();
    assert!(said.contains("axes[0].fit") && said.contains("none to fit"), "{said}");
}

/// Limits that would hold over breakpoints as they were are faults of the spec, as is a function that is too large.
#[test]
fn what_an_axis_in_the_fit_cannot_have_is_a_fault() {
    let tmp = tempfile::tempdir().unwrap();
    data(tmp.path());
    let convex = text("fit = true")
        .replace(r#"axes = [{ name = "speed" }]"#, r#"axes = [{ name = "speed", convex = 1 }]"#);
    let said = fitted(tmp.path(), &convex).unwrap_err();
    assert!(said.contains("axes[0].fit") && said.contains("curvature"), "{said}");
    let points: Vec<f64> = (0..300).map(|k| 1000.0 + 10.0 * f64::from(k)).collect();
    let large = text("fit = true").replace("[1000, 3000, 5000]", &format!("{points:?}"));
    let said = fitted(tmp.path(), &large.replace("locked = [0, 1, 2]", "")).unwrap_err();
    assert!(said.contains("at most 500"), "{said}");
}

#[test]
fn an_axis_is_placed_or_fitted_and_not_both() {
    let tmp = tempfile::tempdir().unwrap();
    data(tmp.path());
    let said = fitted(tmp.path(), &text("fit = true\nplace = 2")).unwrap_err();
    assert!(said.contains("axes[0].fit") && said.contains("`fit` or `place`"), "{said}");
    // An axis that labels share moves for all of them or for none.
    let one = text("").replacen(r#"{ name = "speed" }"#, r#"{ name = "speed", fit = true }"#, 1);
    let said = fitted(tmp.path(), &one).unwrap_err();
    assert!(said.contains("labels[0].axes[0].fit") && said.contains("shared axis"), "{said}");
}

/// Breakpoints far from where they belong, on a curve that starts flat: other placings are tried, and what is left is noise.
#[test]
fn breakpoints_are_found_from_a_flat_start_far_away() {
    let dir = tempfile::tempdir().unwrap();
    let mut rng = Rng64::new(1);
    let n = 1500;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * f64::from(k)).collect();
    let x: Vec<f64> = (0..n).map(|_| 10.0 * rng.uniform()).collect();
    let of = |x: f64| {
        if x < 3.0 {
            2.0 * x / 3.0
        } else if x < 4.5 {
            2.0 + 2.0 * (x - 3.0)
        } else {
            5.0 + (x - 4.5) / 5.5
        }
    };
    let y: Vec<f64> = x.iter().map(|x| of(*x) + 0.1 * rng.normal()).collect();
    let columns: [(&str, &str, &[f64]); 3] = [("time", "s", &time_s), ("x", "-", &x), ("y", "-", &y)];
    write_columns(&dir.path().join("data.csv"), &columns).unwrap();
    let text = r#"data = ["data.csv"]
target = "y"

[[labels]]
name = "C"
unit = "-"
base = [1]
axes = [{ name = "x", unit = "-", points = [0, 6, 8, 10], fit = true }]

[[nodes]]
name = "x"
op = "channel"
channel = "x"
unit = "-"

[[nodes]]
name = "c"
op = "label"
label = "C"
in = ["x"]
"#;
    // Bounds that leave no room, and a step that fits nowhere between them.
    for (keys, words) in
        [("least = 2\ngreatest = 2", "locked"), ("least = 0\ngreatest = 1\nstep = 2", "a step within 0 to 1")]
    {
        let said =
            fitted(dir.path(), &text.replace("base = [1]", &format!("base = [1]\n{keys}"))).unwrap_err();
        assert!(said.contains("spec.toml:4: `labels[0].") && said.contains("found 2"), "{said}");
        assert!(said.contains(words), "{said}");
    }
    let found = fitted(dir.path(), text).unwrap();
    assert!(found.converged && found.unseen_rms[1] < 0.12, "{:?} {:?}", found.unseen_rms, found.warnings);
    let points = &found.labels[0].axes[0].points;
    assert!((points[1] - 3.0).abs() < 0.15 && (points[2] - 4.5).abs() < 0.15, "{points:?}");
}
