//! Labels of described functions: axes that are placed, rows of the criterion, units, conditions.

use std::path::Path;

use dynocal_files::csv_io::write_columns;
use dynocal_files::json;
use dynocal_ident::model::initial::Initial;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Quantity, StoredModel};
use dynocal_numerics::rng::Rng64;

use super::{dcm, fitted};

/// Samples that visit every breakpoint of an axis evenly, with the values of `f`.
fn curve(folder: &Path, points: &[f64], f: &dyn Fn(f64) -> f64) {
    let n = 10 * points.len();
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let x: Vec<f64> = (0..n).map(|k| points[k % points.len()]).collect();
    let y: Vec<f64> = x.iter().map(|x| f(*x)).collect();
    write_columns(&folder.join("data.csv"), &[("time", "s", &time_s), ("x", "-", &x), ("y", "Nm", &y)])
        .unwrap();
}

fn curve_spec(points: &[f64], place: usize) -> String {
    format!(
        r#"data = ["data.csv"]
target = "y"
fit = {{ smooth = 0.0 }}

[[labels]]
name = "CURVE"
unit = "Nm"
base = [0.0]
axes = [{{ name = "x", unit = "-", points = {points:?}, place = {place} }}]

[[nodes]]
name = "x"
op = "channel"
channel = "x"
unit = "-"

[[nodes]]
name = "y"
op = "label"
label = "CURVE"
in = ["x"]
"#
    )
}

/// The best breakpoints of a parabola are evenly spaced; a straight line over a width h leaves at most h^2 / 8 of it.
#[test]
fn a_parabola_keeps_breakpoints_at_equal_spacing() {
    let tmp = tempfile::tempdir().unwrap();
    let points: Vec<f64> = (0..=40).map(|k| f64::from(k) / 40.0).collect();
    curve(tmp.path(), &points, &|x| x * x);
    let found = fitted(tmp.path(), &curve_spec(&points, 5)).unwrap();
    let chosen = &found.chosen[0];
    assert_eq!(chosen.points, [0.0, 0.25, 0.5, 0.75, 1.0]);
    let h: f64 = 0.25;
    // The interpolation error x (h - x) is h^2 / sqrt(30) in the root mean square; on ten samples of each width a little less.
    let rms = h * h / 30f64.sqrt();
    let at_five = chosen.loss.iter().find(|l| l.0 == 5).unwrap().1;
    assert!((at_five / rms - 1.0).abs() < 0.03, "{at_five} {rms}");
    // Fitted anew, straight lines balance: the greatest error is h^2 / 8 where they touch nothing more.
    assert!(found.unseen_rms_full.unwrap() < 1e-9 && found.unseen_rms[1] <= h * h / 8.0);
    assert!(chosen.loss.windows(2).all(|w| w[1].1 <= w[0].1 + 1e-12));
    assert_eq!(found.labels[0].len(), 5);
    assert!(dcm(&found, tmp.path()).contains("KENNLINIE CURVE 5"));
}

/// Five of twelve breakpoints, the ends kept: the job against all 120 choices.
#[test]
fn five_of_twelve_breakpoints_are_the_best_of_all_choices() {
    for seed in 0..20 {
        let mut rng = Rng64::new(seed);
        let points: Vec<f64> = (0..12).map(|k| f64::from(k) + 0.4 * rng.uniform()).collect();
        let values: Vec<f64> = (0..12).map(|_| rng.normal()).collect();
        let tmp = tempfile::tempdir().unwrap();
        let of = |x: f64| values[points.iter().position(|p| *p == x).unwrap()];
        curve(tmp.path(), &points, &of);
        let found = fitted(tmp.path(), &curve_spec(&points, 5)).unwrap();
        let mut best = (f64::INFINITY, Vec::new());
        for a in 1..11 {
            for b in a + 1..11 {
                for c in b + 1..11 {
                    let kept = [0, a, b, c, 11];
                    let error = (0..12).map(|k| {
                        let i = kept.partition_point(|j| *j <= k).clamp(1, 4) - 1;
                        let (p, q) = (kept[i], kept[i + 1]);
                        let s = (points[k] - points[p]) / (points[q] - points[p]);
                        (values[k] - (1.0 - s) * values[p] - s * values[q]).powi(2)
                    });
                    let error: f64 = error.sum();
                    if error < best.0 {
                        best = (error, kept.map(|k| points[k]).to_vec());
                    }
                }
            }
        }
        assert_eq!(found.chosen[0].points, best.1, "seed {seed}");
    }
}

/// A curve and a map share an axis: both have the same breakpoints in the end, and the file lists each axis once.
#[test]
fn shared_axes_are_placed_for_all_their_labels() {
    let tmp = tempfile::tempdir().unwrap();
    let points: Vec<f64> = (0..9).map(f64::from).collect();
    let n = 9 * 4 * 8;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * f64::from(k)).collect();
    let x: Vec<f64> = (0..n).map(|k| f64::from(k % 9)).collect();
    let z: Vec<f64> = (0..n).map(|k| f64::from((k / 9) % 4)).collect();
    // The map bends at 2, the curve at 6.
    let map: Vec<f64> = x.iter().zip(&z).map(|(x, z)| (x - 2.0).max(0.0) * (1.0 + z)).collect();
    let bend: Vec<f64> = x.iter().map(|x| (x - 6.0).max(0.0)).collect();
    let columns: [(&str, &str, &[f64]); 5] =
        [("time", "s", &time_s), ("x", "-", &x), ("z", "-", &z), ("map", "-", &map), ("bend", "-", &bend)];
    write_columns(&tmp.path().join("data.csv"), &columns).unwrap();
    let text = format!(
        r#"data = ["data.csv"]
fit = {{ smooth = 0.0 }}
reduce = 3

[[axes]]
name = "X"
unit = "-"
points = {points:?}
place = 4

[[labels]]
name = "MAP"
unit = "-"
base = [0.0]
axes = [{{ name = "X" }}, {{ name = "Z", unit = "-", points = [0, 1, 2, 3] }}]

[[labels]]
name = "CURVE"
unit = "-"
base = [0.0]
axes = [{{ name = "X" }}]

[[nodes]]
name = "x"
op = "channel"
channel = "x"

[[nodes]]
name = "z"
op = "channel"
channel = "z"

[[nodes]]
name = "map"
op = "label"
label = "MAP"
in = ["x", "z"]

[[nodes]]
name = "curve"
op = "label"
label = "CURVE"
in = ["x"]

[[rows]]
node = "map"
target = "map"

[[rows]]
node = "curve"
target = "bend"
weight = 4.0
"#
    );
    let found = fitted(tmp.path(), &text).unwrap();
    assert_eq!(found.chosen[0].points, [0.0, 2.0, 6.0, 8.0]);
    assert_eq!(found.chosen[0].labels, ["MAP", "CURVE"]);
    assert_eq!(found.labels[0].axes[0].points, found.labels[1].axes[0].points);
    assert!(found.unseen_rms[1] < 1e-8, "{:?}", found.unseen_rms);
    assert_eq!(found.rows.len(), 2);
    let dcm = dcm(&found, tmp.path());
    // The axis Z is the map's own, but calibration tools list both axes of a map in one way.
    assert_eq!(dcm.matches("STUETZSTELLENVERTEILUNG").count(), 2, "{dcm}");
}

#[test]
fn units_that_do_not_agree_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let points = [0.0, 1.0, 2.0];
    curve(tmp.path(), &points, &|x| x);
    let good = curve_spec(&points, 2);
    let wrong =
        fitted(tmp.path(), &good.replace("unit = \"-\", points", "unit = \"rpm\", points")).unwrap_err();
    assert!(wrong.contains("nodes[1].in") && wrong.contains("`rpm`, the unit of the axis `x`"), "{wrong}");
    let file = fitted(tmp.path(), &good.replace("\"-\"", "\"kPa\"")).unwrap_err();
    assert!(file.contains("channel `x` is in `-`, expected `kPa`"), "{file}");
    let said = fitted(tmp.path(), &format!("{good}unit = \"deg\"\n")).unwrap_err();
    assert!(said.contains("nodes[1].unit") && said.contains("`Nm`, which is what it gives"), "{said}");
    let count = fitted(tmp.path(), &good.replace("place = 2", "place = 7")).unwrap_err();
    assert!(count.contains("labels[0].axes[0].place") && count.contains("from 2 to 3"), "{count}");
}

/// Samples within a while of a jump do not count.
#[test]
fn a_condition_on_the_rate_leaves_out_what_follows_a_jump() {
    let tmp = tempfile::tempdir().unwrap();
    let n = 400;
    let time_s: Vec<f64> = (0..n).map(|k| 0.05 * f64::from(k)).collect();
    let x: Vec<f64> = (0..n).map(|k| 1.0 + f64::from((k / 50) % 2)).collect();
    // Right but for one second after each jump.
    let y: Vec<f64> =
        (0..n).zip(&x).map(|(k, x)| 3.0 * x + if k >= 50 && k % 50 < 20 { 5.0 } else { 0.0 }).collect();
    write_columns(&tmp.path().join("data.csv"), &[("time", "s", &time_s), ("x", "-", &x), ("y", "Nm", &y)])
        .unwrap();
    let text = r#"data = ["data.csv"]
target = "y"

[[where]]
channel = "x"
slower_than = 0.2
for_s = 1.1

[[labels]]
name = "GAIN"
unit = "Nm"
base = [1.0]

[[nodes]]
name = "x"
op = "channel"
channel = "x"

[[nodes]]
name = "gain"
op = "label"
label = "GAIN"

[[nodes]]
name = "y"
op = "multiply"
in = ["x", "gain"]
"#;
    let found = fitted(tmp.path(), text).unwrap();
    assert!(
        (found.fit.values[0] - 3.0).abs() < 1e-9 && found.samples[0] + found.samples[1] < 400,
        "{:?}",
        found.samples
    );
    let bare = fitted(tmp.path(), &text.replace("slower_than = 0.2\n", "")).unwrap_err();
    assert!(bare.contains("where[0].for_s") && bare.contains("slower_than"), "{bare}");
}

const NODE: &str = r#"data = ["data.csv"]
target = "y"
fit = { smooth = 0.0 }

[[labels]]
name = "CURVE"
unit = "V"
base = [2.0]
axes = [{ name = "x", unit = "-", points = [0.0, 0.5, 1.0] }]

[[nodes]]
name = "x"
op = "channel"
channel = "x"
unit = "-"

[[nodes]]
name = "u"
op = "label"
label = "CURVE"
in = ["x"]

[[nodes]]
name = "y"
op = "model"
file = "model.json"
in = ["u"]
"#;

/// A stored model behind a curve: the curve comes back through it.
#[test]
fn a_stored_model_is_a_node() {
    let tmp = tempfile::tempdir().unwrap();
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    // y(t) = 0.8 y(t-1) + 0.02 u(t-2)^2, from rest.
    let structure = PolyNarx::parse(&["u"], "y", &["u(t-2)*u(t-2)", "y(t-1)"]).unwrap();
    let mut model =
        StoredModel::new(structure, &[0.02, 0.8], vec![quantity("u", "V")], quantity("y", "Nm"), 0.1)
            .unwrap();
    model.initial = Some(Initial::Rest);
    json::write_versioned(&tmp.path().join("model.json"), MODEL_SCHEMA, MODEL_VERSION, &model).unwrap();
    let truth = [3.0, 5.0, 4.0];
    let mut rng = Rng64::new(3);
    let n = 1500;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let mut held = 0.5;
    let x: Vec<f64> = (0..n)
        .map(|k| {
            if k % 15 == 0 {
                held = rng.uniform();
            }
            held
        })
        .collect();
    let u = |x: f64| {
        if x < 0.5 {
            truth[0] + (truth[1] - truth[0]) * x / 0.5
        } else {
            truth[1] + (truth[2] - truth[1]) * (x - 0.5) / 0.5
        }
    };
    let mut y = vec![0.02 * u(x[0]).powi(2) / 0.2; 2];
    for t in 2..n {
        y.push(0.8 * y[t - 1] + 0.02 * u(x[t - 2]).powi(2));
    }
    let y: Vec<f64> = y.iter().map(|v| v + 0.02 * rng.normal()).collect();
    let write = |time_s: &[f64]| {
        write_columns(
            &tmp.path().join("data.csv"),
            &[("time", "s", time_s), ("x", "-", &x), ("y", "Nm", &y)],
        )
        .unwrap();
    };
    write(&time_s);
    let found = fitted(tmp.path(), NODE).unwrap();
    assert!(found.valid, "{:?}", found.verdict);
    for (k, truth) in truth.iter().enumerate() {
        let (value, half) = (found.fit.values[k], found.half_width[k].unwrap());
        assert!((value - truth).abs() < 2.0 * half && half < 0.05, "{value} +- {half}, planted {truth}");
    }
    // What does not fit is named with its key.
    let refused = |from: &str, to: &str| fitted(tmp.path(), &NODE.replace(from, to)).unwrap_err();
    assert!(refused("model.json", "other.json").contains("nodes[2].file"));
    assert!(refused("in = [\"u\"]", "in = [\"u\", \"x\"]").contains("nodes[2].in"));
    assert!(refused("unit = \"V\"", "unit = \"A\"").contains("the unit of `u`"));
    assert!(refused("file = ", "output = \"z\"\nfile = ").contains("`y`, the one of the model"));
    let mut uneven = time_s.clone();
    uneven[700..].iter_mut().for_each(|t| *t += 0.05);
    write(&uneven);
    let message = fitted(tmp.path(), NODE).unwrap_err();
    assert!(message.contains("found a step of 0.1500 s"), "{message}");
}

/// A curve with one corner between the breakpoints of the fit: chosen breakpoints end beside it, moved ones at it.
#[test]
fn breakpoints_move_to_a_corner_between_those_of_the_fit() {
    let tmp = tempfile::tempdir().unwrap();
    let points: Vec<f64> = (0..=20).map(|k| 0.05 * f64::from(k)).collect();
    let corner = 0.37;
    let f = |x: f64| if x < corner { 4.0 * x } else { 4.0 * corner - (x - corner) };
    // Samples everywhere, not on the breakpoints alone.
    let n = 2000;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let x: Vec<f64> = (0..n).map(|k| (k as f64 * 0.618_034).fract()).collect();
    let y: Vec<f64> = x.iter().map(|x| f(*x)).collect();
    write_columns(&tmp.path().join("data.csv"), &[("time", "s", &time_s), ("x", "-", &x), ("y", "Nm", &y)])
        .unwrap();
    let text = curve_spec(&points, 3);
    let chosen = fitted(tmp.path(), &text).unwrap();
    let moved = fitted(tmp.path(), &text.replace("place = 3", "place = 3, move = true")).unwrap();
    assert!(points.contains(&chosen.chosen[0].points[1]) && chosen.chosen[0].moved.is_none());
    let found = moved.chosen[0].points[1];
    println!("{found}; left {:e} in place of {:e}", moved.unseen_rms[1], chosen.unseen_rms[1]);
    assert!((found - corner).abs() < 0.01, "{found}");
    let [before, after] = moved.chosen[0].moved.unwrap();
    assert!(after < before && moved.unseen_rms[1] < 0.5 * chosen.unseen_rms[1]);
    // Values that are given by definition keep their breakpoints.
    let base: Vec<f64> = points.iter().map(|x| f(*x)).collect();
    let held = text
        .replace("place = 3", "place = 3, move = true")
        .replace("base = [0.0]", &format!("base = {base:?}\nlocked = [7, 8]"));
    let locked = fitted(tmp.path(), &held).unwrap();
    assert!(points.contains(&locked.chosen[0].points[1]), "{:?}", locked.chosen[0].points);
    let text = text.replace("place = 3", "place = 3, move = true");
    let alone = fitted(tmp.path(), &text.replace("place = 3, ", "")).unwrap_err();
    assert!(alone.contains("move") && alone.contains("`place` beside it"), "{alone}");
}
