//! Label jobs on records with faults, and of functions whose base is right: what is said of them.

use std::path::Path;

use dynocal_files::csv_io::write_columns;
use dynocal_files::run_folder::RunPlace;
use dynocal_jobs::label::film::Film;
use dynocal_jobs::label::function::{Fitted, run};
use dynocal_jobs::place::Place;
use dynocal_label::graph::{Graph, Record};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

use super::fitted;

const CURVE: &str = r#"data = ["data.csv"]
target = "y"

[[labels]]
name = "C"
unit = "-"
base = [3.0, 4.0, 5.0]
axes = [{ name = "x", unit = "-", points = [0, 1, 2] }]

[[nodes]]
name = "x"
op = "channel"
channel = "x"

[[nodes]]
name = "y"
op = "label"
label = "C"
in = ["x"]
"#;

/// `y = 3 + x` with noise of 0.1 at random places.
fn straight(seed: u64, n: usize) -> [Vec<f64>; 3] {
    let mut rng = Rng64::new(seed);
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let x: Vec<f64> = (0..n).map(|_| rng.uniform_in(0.0, 2.0)).collect();
    let y = x.iter().map(|x| 3.0 + x + 0.1 * rng.normal()).collect();
    [time_s, x, y]
}

fn write(folder: &Path, [time_s, x, y]: &[Vec<f64>; 3]) {
    write_columns(&folder.join("data.csv"), &[("time", "s", time_s), ("x", "-", x), ("y", "-", y)]).unwrap();
}

/// A base that is true is left as it is; in one of twenty cases the fitted samples show more than noise by chance, and later ones judge.
#[test]
fn a_true_base_is_left_as_it_is() {
    let mut left = 0;
    for seed in 0..20 {
        let tmp = tempfile::tempdir().unwrap();
        write(tmp.path(), &straight(seed, 600));
        let found = fitted(tmp.path(), CURVE).unwrap();
        let leaves = found.verdict[0].starts_with("Leave the labels as they are");
        assert_eq!(
            leaves || !found.valid,
            found.files.iter().all(|f| !f.ends_with(".dcm")),
            "{:?}",
            found.files
        );
        left += usize::from(leaves);
    }
    println!("{left} of 20 are left");
    assert!(left >= 18, "{left}");
}

/// Samples without a number in what enters do not count, and are said; the others are as good as before.
#[test]
fn samples_without_a_number_are_left_out_and_said() {
    let tmp = tempfile::tempdir().unwrap();
    let mut data = straight(1, 600);
    (0..600).step_by(10).for_each(|k| data[1][k] = f64::NAN);
    write(tmp.path(), &data);
    let found = fitted(tmp.path(), &CURVE.replace("3.0, 4.0, 5.0", "1.0, 1.0, 1.0")).unwrap();
    assert!((found.fit.values[0] - 3.0).abs() < 0.1, "{:?}", found.fit.values);
    assert_eq!(found.samples.iter().sum::<usize>(), 540);
    let said = found.warnings.iter().any(|w| w.contains("60 samples without a number in `x`"));
    assert!(said && found.valid, "{:?}", found.warnings);
}

const LAG: &str = r#"data = ["data.csv"]
target = "y"

[[labels]]
name = "TAU"
unit = "s"
base = [1.0]
least = 0.0
greatest = 5.0

[[nodes]]
name = "x"
op = "channel"
channel = "x"

[[nodes]]
name = "tau"
op = "label"
label = "TAU"

[[nodes]]
name = "y"
op = "lag"
in = ["x", "tau"]
"#;

/// Steps through a lag of 0.25 s, noise 0.02.
fn lagging(n: usize) -> [Vec<f64>; 3] {
    let mut rng = Rng64::new(7);
    let (dt, keep) = (0.05, (-0.05f64 / 0.25).exp());
    let time_s: Vec<f64> = (0..n).map(|k| dt * k as f64).collect();
    let x: Vec<f64> = (0..n).map(|k| f64::from(u8::from((k / 40) % 2 == 0))).collect();
    let mut state = x[0];
    let y = (0..n).map(|k| {
        if k > 0 {
            state = keep * state + (1.0 - keep) * x[k - 1];
        }
        state + 0.02 * rng.normal()
    });
    let y = y.collect();
    [time_s, x, y]
}

/// A clock that is set back, a single bad stamp: the lag is found, and both are said.
#[test]
fn a_clock_that_goes_back_is_a_new_stretch() {
    let tmp = tempfile::tempdir().unwrap();
    let mut data = lagging(1600);
    data[0][800..].iter_mut().for_each(|t| *t -= 20.0);
    data[0][300] -= 0.5;
    write(tmp.path(), &data);
    // From near: from 1 s a first step ends at 0, where the function knows no lag.
    let found = fitted(tmp.path(), &LAG.replace("base = [1.0]", "base = [0.4]")).unwrap();
    assert!(
        (found.fit.values[0] - 0.25).abs() < 0.02 && found.valid,
        "{:?} {:?}",
        found.fit.values,
        found.verdict
    );
    for part in ["the stamp of record 301", "goes back once (first at record 801"] {
        assert!(found.warnings.iter().any(|w| w.contains(part)), "{part}: {:?}", found.warnings);
    }
}

/// A search from a time of 0 finds its way; a time in another unit is refused; a time on its bound is not used.
#[test]
fn times_start_from_nothing_have_one_unit_and_no_bound() {
    let tmp = tempfile::tempdir().unwrap();
    write(tmp.path(), &lagging(1600));
    let from_none = fitted(tmp.path(), &LAG.replace("base = [1.0]", "base = [0.0]")).unwrap();
    assert!((from_none.fit.values[0] - 0.25).abs() < 0.02, "{:?}", from_none.fit.values);
    let unit = fitted(tmp.path(), &LAG.replace("unit = \"s\"", "unit = \"ms\"")).unwrap_err();
    assert!(unit.contains("nodes[2].in") && unit.contains("a time in `ms`"), "{unit}");
    let low = LAG.replace("greatest = 5.0", "greatest = 0.15").replace("base = [1.0]", "base = [0.1]");
    let bound = fitted(tmp.path(), &low).unwrap();
    assert!(
        !bound.valid && bound.verdict[0].contains("`TAU` on its greatest value, 0.15 s"),
        "{:?}",
        bound.verdict
    );
    assert!(bound.files.iter().all(|f| !f.ends_with(".dcm")));
}

#[test]
fn faults_of_a_spec_are_faults_of_the_spec() {
    let tmp = tempfile::tempdir().unwrap();
    write(tmp.path(), &straight(1, 300));
    let refused = |from: &str, to: &str, words: &[&str]| {
        let message = fitted(tmp.path(), &CURVE.replace(from, to)).unwrap_err();
        words.iter().for_each(|w| assert!(message.contains(w), "{w}: {message}"));
    };
    refused("target = \"y\"", "target = \"y\"\nfit = { smooth = -1.0 }", &["fit.smooth"]);
    refused("points = [0, 1, 2]", "points = [0, 1, 2], convex = 5", &["labels[0]", "convex = 5"]);
    let clip = "\n[[nodes]]\nname = \"z\"\nop = \"clip\"\nin = [\"y\"]\nleast = 9.0\ngreatest = 3.0\n";
    let message = fitted(tmp.path(), &format!("{CURVE}{clip}")).unwrap_err();
    assert!(message.contains("nodes[2].least") && message.contains("not above `greatest`"), "{message}");
    let locked = CURVE.replace("base = [3.0, 4.0, 5.0]", "base = [3.0, 4.0, 5.0]\nlocked = [0, 1, 2]");
    let message = fitted(tmp.path(), &locked).unwrap_err();
    assert!(message.contains("all cells of all labels are locked"), "{message}");
}

/// One row with a weight: what is said of its channel is in the unit of the channel.
#[test]
fn a_weight_does_not_change_what_is_left_of_a_channel() {
    let tmp = tempfile::tempdir().unwrap();
    write(tmp.path(), &straight(1, 600));
    let rows = "\n[[rows]]\nnode = \"y\"\ntarget = \"y\"\nweight = 4.0\n";
    let text = CURVE.replace("target = \"y\"\n", "").replace("3.0, 4.0, 5.0", "1.0, 1.0, 1.0");
    let found = fitted(tmp.path(), &format!("{text}{rows}")).unwrap();
    let left = found.rows[0].3;
    assert!((left - 0.1).abs() < 0.02, "{left}");
    assert!(
        found.verdict[1].contains(&format!("by {left:.4} with the fitted labels")),
        "{:?}",
        found.verdict
    );
}

/// An engine with a film, written as the recipe's own function says, with `driven` done to fuel, air and speed, and `sensed` to what the sensor says.
fn film(
    folder: &Path,
    share: f64,
    driven: &dyn Fn(&mut [Vec<f64>; 3]),
    sensed: &dyn Fn(&mut Vec<f64>),
) -> Result<Fitted, String> {
    let recipe = Film {
        data: vec![folder.join("film.csv")],
        fuel: "inj".into(),
        air: "air".into(),
        speed: "speed".into(),
        lambda: "lambda".into(),
        coolant: None,
        points: Vec::new(),
        cylinders: 4,
        afr: 14.7,
    };
    let out: RunPlace = Place::run("label-film", Some(&folder.join("run"))).out;
    let job = recipe.job(out).unwrap();
    let n = 8000;
    let mut rng = Rng64::new(3);
    let time_s: Vec<f64> = (0..n).map(|k| 0.02 * k as f64).collect();
    let speed = vec![2000.0; n];
    let air: Vec<f64> = (0..n).map(|k| if (k / 1000) % 2 == 0 { 12.0 } else { 20.0 }).collect();
    // Fuel in steps around what the air needs, in mg for each of four cylinders and cycle.
    let fuel = (0..n)
        .map(|k| air[k] / 14.7 * 1e3 * 120.0 / (4.0 * 2000.0) * if (k / 150) % 2 == 0 { 1.05 } else { 0.95 });
    let fuel: Vec<f64> = fuel.collect();
    let graph: &Graph = &job.graph;
    let truth = [share, 0.6, 1.0, 1.5, 0.3, 0.6, 0.08];
    let mut all = [fuel, air, speed];
    driven(&mut all);
    let record = Record { time_s: &time_s, channels: vec![&all[0], &all[2], &all[1]] };
    let values = graph.values(&truth, &record);
    let mut lambda: Vec<f64> = values.iter().map(|l| l + 0.003 * rng.normal()).collect();
    sensed(&mut lambda);
    let columns: Vec<(&str, &str, &[f64])> = vec![
        ("time", "s", &time_s),
        ("inj", "mg", &all[0]),
        ("air", "g/s", &all[1]),
        ("speed", "rpm", &all[2]),
        ("lambda", "-", &lambda),
    ];
    write_columns(&folder.join("film.csv"), &columns).unwrap();
    run(&job, Watch::silent()).map(|f| f.0).map_err(|e| e.to_string())
}

/// A fuel cut and an engine that is off at first are left out; a lambda that is none, or stuck, is refused.
#[test]
fn the_film_recipe_knows_what_is_no_lambda() {
    let tmp = tempfile::tempdir().unwrap();
    let clean = film(tmp.path(), 0.3, &|_| (), &|_| ()).unwrap();
    println!("{:?} {:.3?}", clean.verdict[0], clean.fit.values);
    assert!((clean.fit.values[0] - 0.3).abs() < 0.05, "{:?}", clean.fit.values);
    let off = |c: &mut [Vec<f64>; 3]| {
        c[0][4000..4200].fill(0.0);
        c.iter_mut().for_each(|v| v[..200].fill(0.0));
    };
    let cut = film(tmp.path(), 0.3, &off, &|l| l.iter_mut().for_each(|l| *l = l.min(7.0)));
    let cut = cut.unwrap();
    println!("{:?} {:.3?}", cut.verdict[0], cut.fit.values);
    assert!(cut.converged && (cut.fit.values[0] - 0.3).abs() < 0.05, "{:?}", cut.fit.values);
    let ratio = film(tmp.path(), 0.3, &|_| (), &|l| l.iter_mut().for_each(|l| *l *= 14.7)).unwrap_err();
    assert!(ratio.contains("channel `lambda` has a median of"), "{ratio}");
    let stuck = film(tmp.path(), 0.3, &|_| (), &|l| l.fill(1.0)).unwrap_err();
    assert!(stuck.contains("found 0 samples that count"), "{stuck}");
}
