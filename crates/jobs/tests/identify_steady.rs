//! `identify` on steady tables whose right answer is known.

use dynocal_files::{atomic, json};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};
use dynocal_jobs::identify::result::{Identified, Modelled};
use dynocal_jobs::identify::spec::{self, Job, Overrides};
use dynocal_jobs::identify::{job, page};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

const DATA: &str = r#"
[data]
file = "points.csv"
steady = true

[[channels]]
column = "speed"
role = "input"

[[channels]]
column = "load"
role = "input"

[[channels]]
column = "torque"
role = "output"
"#;

const SPLIT: &str = "[split]\ntest_every = 3\n";

fn truth(speed: f64, load: f64) -> f64 {
    -20.0 + 250.0 * load - 4e-6 * (speed - 2500.0).powi(2) + 0.02 * speed * load
}

/// Points in no order, with a standard deviation of 0.5 Nm.
fn table(n: usize, seed: u64) -> String {
    let mut rng = Rng64::new(seed);
    let mut text = String::from("speed [rpm],load [-],torque [Nm]\n");
    for _ in 0..n {
        let (speed, load) = (rng.uniform_in(1000.0, 5000.0), rng.uniform_in(0.1, 0.9));
        text += &format!("{speed},{load},{}\n", truth(speed, load) + 0.5 * rng.normal());
    }
    text
}

struct Bench(tempfile::TempDir);

impl Bench {
    fn new(points: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        atomic::write(&folder.path().join("points.csv"), points.as_bytes()).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.0.path().join(name)
    }

    /// Identifies, or says in words why not.
    fn identify(&self, spec: &str) -> Result<Identified, String> {
        atomic::write(&self.path("spec.toml"), spec.as_bytes()).unwrap();
        let over = Overrides { out: Some(self.path("run")), ..Overrides::default() };
        let job = spec::read(&self.path("spec.toml"), &over).map_err(|e| e.to_string())?;
        let (found, folder) = job::run(&job, Watch::silent()).map_err(|e| e.to_string())?;
        page::write(&found, folder.path()).map_err(|e| e.to_string())?;
        Ok(found)
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }
}

fn identify(spec: &str, points: &str) -> Result<Identified, String> {
    Bench::new(points).identify(spec)
}

fn model(found: &Identified) -> &Modelled {
    &found.models[0]
}

#[test]
fn points_become_a_model_that_is_close_where_it_has_not_seen_them() {
    let bench = Bench::new(&table(120, 1));
    let keys = "[model]\nstructure = { name = \"gaussian_process\", starts = 2 }\n";
    let found = bench.identify(&format!("{DATA}{SPLIT}{keys}")).unwrap();
    assert!(found.valid && found.steady, "{:?}", found.findings);
    // One score a part: present values alone have one kind of output.
    let parts: Vec<(&str, usize)> = found.scores.iter().map(|s| (s.part.as_str(), s.samples)).collect();
    assert_eq!(parts, [("estimation", 80), ("test", 40)]);
    // The noise is 0.5 Nm: of 40 test points its root mean square is within a third with a probability of 0.997.
    let rmse = found.scores[1].rmse.unwrap();
    assert!((0.33..0.72).contains(&rmse), "{rmse}");
    let scores = &model(&found).points.as_ref().unwrap().scores;
    assert_eq!(scores.unseen.as_ref().unwrap().points, 40);
    assert!((0.3..0.75).contains(&scores.left_out.rmse), "{:?}", scores.left_out);
    assert_eq!(scores.folds.as_ref().unwrap().points, 80);
    // Load moves torque by 250 Nm, speed by some 40.
    let total: Vec<f64> = scores.sensitivity.iter().map(|s| s.total).collect();
    assert!(total[1] > 0.8 && total[0] < 0.2, "{total:?}");
    let verdict = &found.verdict[0];
    assert!(verdict.starts_with("The model of torque is close on the unseen points (test)"), "{verdict}");
    assert!(
        verdict.contains("A plane (linear in every input) from the same points has an RMSE of"),
        "{verdict}"
    );
    let points = bench.text("run/steps/01-identify/test-record.csv");
    assert!(
        points.starts_with("torque_measured [Nm],torque_predicted [Nm],speed [rpm],load [-]\n"),
        "{points}"
    );
    let report = bench.text("run/report.html");
    let verdict_at = report.find("Verdict").unwrap();
    for title in ["Points that had no part in the fit", "What the models do", "Left-out errors"] {
        assert!(report.find(title).is_some_and(|at| at > verdict_at), "{title}");
    }
    for word in ["free run", "Free run", "one step", "Residual correlations"] {
        assert!(!report.contains(word), "{word}");
    }
}

#[test]
fn the_model_file_gives_the_same_numbers_on_other_points() {
    let bench = Bench::new(&table(120, 2));
    let keys = "[model]\nstructure = { name = \"local_linear\" }\n";
    let first = bench.identify(&format!("{DATA}{SPLIT}{keys}")).unwrap();
    let file = bench.path("run/steps/01-identify/model.json");
    let stored: StoredModel = json::read_versioned(&file, MODEL_SCHEMA, MODEL_VERSION).unwrap();
    assert!(stored.is_steady() && stored.boundary.is_some());
    let over = Overrides {
        data: vec![bench.path("points.csv")],
        out: Some(bench.path("again")),
        ..Overrides::default()
    };
    let again = Job::of_models(vec![stored], &over).unwrap();
    let found = job::run(&again, Watch::silent()).unwrap().0;
    assert!(found.steady && found.scores[0].samples == 120, "{:?}", found.scores);
    let mse = |found: &Identified, k: usize| found.scores[k].mse.unwrap();
    let whole = (80.0 * mse(&first, 0) + 40.0 * mse(&first, 1)) / 120.0;
    assert!((mse(&found, 0) - whole).abs() < 1e-9 * whole);
}

#[test]
fn a_choice_is_said_in_words_with_its_candidates() {
    let keys = "[model]\nstructure = { name = \"best_of\", folds = 4, models = [{ kind = \"stepwise_polynomial\", degree = 1 }, { kind = \"stepwise_polynomial\" }] }\n";
    let found = identify(&format!("{DATA}{keys}"), &table(80, 3)).unwrap();
    let choice = model(&found).points.as_ref().unwrap().choice.as_ref().unwrap();
    // Speed squared and its product with load are there: the plane is not enough.
    assert_eq!(choice.chosen, 1, "{choice:?}");
    assert!(found.verdict[0].contains("is taken"), "{:?}", found.verdict);
    assert!(found.verdict[1].contains("keep points apart"), "{:?}", found.verdict);
}

#[test]
fn polynomials_of_present_values_take_steady_tables_too() {
    let keys = "[model]\nstructure = { name = \"polynomial\", regressors = [\"1\", \"speed(t)\", \"speed(t)^2\", \"load(t)\", \"speed(t)*load(t)\"] }\nestimator = { name = \"ols\" }\n";
    let found = identify(&format!("{DATA}{SPLIT}{keys}"), &table(120, 4)).unwrap();
    let rmse = found.scores[1].rmse.unwrap();
    assert!((0.33..0.72).contains(&rmse), "{rmse}");
}

#[test]
fn what_needs_time_is_refused_with_its_key() {
    let gp = "[model]\nstructure = { name = \"gaussian_process\" }\n";
    let rbf = |more: &str| format!("{DATA}[model]\nstructure = {{ name = \"rbf\"{more} }}\n");
    let timed = DATA.replace("steady = true", "steady = true\nsample_time_s = 0.1");
    let sampled = DATA.replace("steady = true", "sample_time_s = 0.1");
    let arx = "[model]\nstructure = { name = \"arx\" }\nestimator = { name = \"ols\" }\n";
    let cases = [
        (format!("{timed}{gp}"), "data.steady"),
        (format!("{sampled}{SPLIT}{gp}"), "split.test_every"),
        (format!("{DATA}{arx}"), "a structure without lags for a steady table"),
        (rbf(", output_lags = 1"), "a structure without lags for a steady table"),
        (rbf(", wdths = [1]"), "candidates, input_lags"),
        (rbf("") + "estimator = { name = \"ols\" }\n", "one of the estimators learn"),
        (format!("{DATA}{gp}[validate]\nk_steps = [5]\n"), "validate.k_steps"),
        (format!("{DATA}{gp}[[prepare]]\nstep = \"offset\"\n"), "prepare"),
    ];
    for (spec, part) in cases {
        let said = identify(&spec, &table(30, 5)).expect_err(part);
        assert!(said.contains(part), "{part}: {said}");
    }
}

#[test]
fn a_constant_channel_and_a_missing_value_are_named() {
    let spec = format!("{DATA}[model]\nstructure = {{ name = \"gaussian_process\" }}\n");
    let still = |line: &str| match line.split_once(',') {
        Some((first, rest)) if first != "speed [rpm]" => format!("2000,{rest}\n"),
        _ => format!("{line}\n"),
    };
    let said = identify(&spec, &table(30, 6).lines().map(still).collect::<String>()).unwrap_err();
    assert!(said.contains("input `speed` is constant (2000)"), "{said}");
    let said = identify(&spec, &table(30, 6).replacen('\n', "\n2000,,7\n", 1)).unwrap_err();
    assert!(said.contains("load") && said.contains("line 2"), "{said}");
}

/// Points with other values than the truth, as `change` says.
fn changed(n: usize, seed: u64, change: impl Fn(usize, f64) -> f64) -> String {
    let mut rng = Rng64::new(seed);
    let mut text = String::from("speed [rpm],load [-],torque [Nm]\n");
    for i in 0..n {
        let (speed, load) = (rng.uniform_in(1000.0, 5000.0), rng.uniform_in(0.1, 0.9));
        text += &format!("{speed},{load},{}\n", change(i, truth(speed, load) + 0.5 * rng.normal()));
    }
    text
}

fn said(found: &Identified) -> String {
    found.findings.iter().map(|f| f.sentence() + "\n").collect()
}

#[test]
fn an_output_without_signal_is_a_fault_of_every_kind() {
    for kind in ["gaussian_process", "stepwise_polynomial", "local_linear", "rbf"] {
        let mut rng = Rng64::new(5);
        let noise: Vec<f64> = (0..60).map(|_| rng.normal()).collect();
        let keys = format!("[model]\nstructure = {{ name = \"{kind}\" }}\n");
        let found = identify(&format!("{DATA}{keys}"), &changed(60, 6, |i, _| noise[i])).unwrap();
        let text = said(&found);
        assert!(text.contains("than by the mean of the others"), "{kind}: {text}");
        assert!(found.verdict[0].starts_with("The model of torque is poor on points"), "{:?}", found.verdict);
    }
}

#[test]
fn a_point_that_does_not_fit_and_copies_of_rows_are_named() {
    let keys = "[model]\nstructure = { name = \"gaussian_process\", starts = 2 }\n";
    // 30 standard deviations of the noise.
    let wrong = changed(60, 7, |i, y| if i == 10 { y + 15.0 } else { y });
    let text = said(&identify(&format!("{DATA}{keys}"), &wrong).unwrap());
    assert!(text.contains("row 11 does not fit the others: measured"), "{text}");
    let right = changed(60, 7, |_, y| y);
    let text = said(&identify(&format!("{DATA}{keys}"), &right).unwrap());
    assert!(!text.contains("does not fit"), "{text}");
    let copied: String =
        right.clone() + &right.lines().skip(1).take(20).map(|l| format!("{l}\n")).collect::<String>();
    let text = said(&identify(&format!("{DATA}{keys}"), &copied).unwrap());
    assert!(
        text.contains("rows 61, 62, 63, 64, 65, 66, 67, 68 and 12 more repeat inputs and output"),
        "{text}"
    );
}

#[test]
fn few_points_give_a_model_without_folds_and_say_so() {
    let keys = "[model]\nstructure = { name = \"gaussian_process\", starts = 2 }\n";
    let found = identify(&format!("{DATA}{keys}"), &table(7, 8)).unwrap();
    let text = said(&found);
    assert!(text.contains("the folds cannot be learnt: without fold 1 of 5 (5 points are left)"), "{text}");
}

#[test]
fn a_misspelt_structure_is_named_with_the_nearest() {
    let keys = "[model]\nstructure = { name = \"gausian_process\" }\n";
    let text = identify(&format!("{DATA}{keys}"), &table(60, 8)).unwrap_err();
    assert!(text.contains("`gausian_process`") && text.contains("gaussian_process`"), "{text}");
    assert!(!text.contains("estimator"), "{text}");
}
