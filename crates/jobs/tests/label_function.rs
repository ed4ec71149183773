//! Labels of described functions: axes that are placed, rows of the criterion, units, conditions.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_files::csv_io::write_columns;
use dynocal_jobs::label::function::{Fitted, run, spec};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

fn fitted(folder: &Path, text: &str) -> Result<Fitted, String> {
    let path = folder.join("spec.toml");
    atomic::write(&path, text.as_bytes()).unwrap();
    let over = Overrides { out: Some(folder.join("run")), ..Overrides::default() };
    let job = spec::read(&path, &over).map_err(|e| e.to_string())?;
    run(&job, Watch::silent()).map(|f| f.0).map_err(|e| e.to_string())
}

/// The labels that were written.
fn dcm(found: &Fitted, folder: &Path) -> String {
    let file = found.files.iter().find(|f| f.ends_with(".dcm")).unwrap();
    std::fs::read_to_string(folder.join("run").join(file)).unwrap()
}

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
