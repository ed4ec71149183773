//! `dynocal optimise`: optimal inputs over a record.

use std::path::Path;

use assert_cmd::Command;
use dynocal_files::{atomic, csv_io, json};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Quantity, StoredModel};

struct Outcome {
    code: i32,
    stdout: String,
    stderr: String,
}

fn dynocal(folder: &Path, args: &[&str]) -> Outcome {
    let out = Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Outcome { code: out.status.code().unwrap(), stdout: text(out.stdout), stderr: text(out.stderr) }
}

fn has(text: &str, part: &str) {
    assert!(text.contains(part), "no `{part}` in:\n{text}");
}

fn column(file: &Path, name: &str) -> Vec<f64> {
    let table = csv_io::read(file).unwrap();
    table.numbers(name, 0, table.rows()).unwrap().to_vec()
}

/// The example runs as it stands; its plan is one; `dynocal simulate` gives the demand on its inputs.
#[test]
fn the_example_gives_a_plan_that_meets_the_demand() {
    let tmp = tempfile::tempdir().unwrap();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/optimise");
    let spec = example.join("fuel.toml");
    let o = dynocal(tmp.path(), &["optimise", spec.to_str().unwrap(), "--out", "run", "--json"]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let summary: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    assert_eq!((&summary["schema"], &summary["verb"]), (&"dynocal/summary".into(), &"optimise".into()));
    assert!(summary["objective"]["change_percent"].as_f64().unwrap() < 0.0, "{}", summary["objective"]);
    for asked in summary["asked"].as_array().unwrap() {
        assert!(asked["largest"].as_f64().unwrap() <= asked["allowed"].as_f64().unwrap(), "{asked}");
    }
    let run = tmp.path().join("run");
    let plan = dynocal_files::plan::read(&run.join("optimum.plan.csv")).unwrap();
    assert_eq!((plan.len(), plan.demands.len(), plan.channels.len()), (1000, 2, 4));
    for c in &plan.channels {
        // What the player would apply is what was found.
        let applied = c.applied(plan.sample_time_s);
        assert!(
            applied.iter().zip(&c.values).all(|(a, v)| (a - v).abs() < 1e-6 * (1.0 + v.abs())),
            "{}",
            c.name
        );
    }
    let fuel = column(&run.join("optimum.csv"), "inj");
    let fuel_start = column(&run.join("optimum.csv"), "inj_start");
    let speed = column(&run.join("optimum.csv"), "speed");
    let mean = |inj: &[f64]| {
        let flows = inj.iter().zip(&speed).map(|(i, n)| 1.2e-4 * i * n);
        flows.skip(10).sum::<f64>() / (inj.len() - 10) as f64
    };
    assert!(mean(&fuel) < 0.995 * mean(&fuel_start));
    for output in ["torque", "lambda"] {
        let model = example.join(format!("{output}.json"));
        let (model, data) = (model.to_str().unwrap(), "run/optimum.csv");
        let args = ["simulate", "--model", model, "--data", data, "--start", "measured", "--out", output];
        let o = dynocal(tmp.path(), &args);
        assert_eq!(o.code, 0, "{}", o.stderr);
        let file = tmp.path().join(output).join(format!("data-{output}.csv"));
        let file = if file.exists() { file } else { only_csv(&tmp.path().join(output)) };
        let simulated = column(&file, output);
        let demand = column(&run.join("optimum.csv"), &format!("{output}_demand"));
        let worst = simulated.iter().zip(&demand).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-4, "{output}: {worst}");
    }
    let page = std::fs::read_to_string(run.join("report.html")).unwrap();
    for part in
        ["class=\"verdict\"", "What demands and limits cost", "rate limit of spark", "demand of torque"]
    {
        has(&page, part);
    }
    assert!(!column(&run.join("prices.csv"), "torque_demand").is_empty());
    let o = dynocal(tmp.path(), &["optimise", spec.to_str().unwrap(), "--check"]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    has(&o.stdout, "1000 samples");
}

/// A guard shows on the page and in the words; models whose correlations are not known are not drawn from.
#[test]
fn a_guard_is_on_the_page_and_draws_need_correlations() {
    let tmp = tempfile::tempdir().unwrap();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/optimise");
    for name in ["torque.json", "lambda.json", "record.csv.gz"] {
        std::fs::copy(example.join(name), tmp.path().join(name)).unwrap();
    }
    let text = std::fs::read_to_string(example.join("fuel.toml")).unwrap();
    let with = |name: &str, keys: &str| {
        let text = text.replace("[optimise]", &format!("[optimise]\n{keys}"));
        dynocal_files::atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap();
        dynocal(tmp.path(), &["optimise", name, "--out", "run"])
    };
    let o = with("guard.toml", "guard = { distance = 1.0 }");
    assert_eq!(o.code, 0, "{}", o.stderr);
    has(&o.stdout, "The guard holds: `torque_distance`, `lambda_distance`");
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    has(&page, "upper limit of torque_distance");
    let start = |t: usize| column(&tmp.path().join("run/optimum.csv"), "torque_distance")[t];
    assert!(start(500) > 0.0);
    // At a price it may be passed, which makes nothing invalid.
    let o = with("soft.toml", "guard = { distance = 0.5, soft_weight = 1e-3 }");
    assert_eq!(o.code, 0, "{}", o.stderr);
    has(&o.stdout, "everything asked is kept but what may give way at a price");
    has(&o.stdout, "The upper limit of torque_distance is missed by up to");
    let o = with("robust.toml", "robust = { draws = 2 }");
    assert_eq!(o.code, 0, "{}", o.stderr);
    // The problem limits no output.
    assert!(!o.stdout.contains("Every limit of an output"), "{}", o.stdout);
    has(&o.stdout, "Means are those of the decided samples, from 0.1500 s on");
    has(&o.stdout, "The demand of torque is met by its model as estimated; over the draws");
    let file = tmp.path().join("torque.json");
    let mut model: serde_json::Value = json::read(&file).unwrap();
    assert!(model.as_object_mut().unwrap().remove("correlation").is_some());
    json::write(&file, &model).unwrap();
    for args in [&["--out", "run"][..], &["--check"]] {
        let o = dynocal(tmp.path(), &[&["optimise", "robust.toml"], args].concat());
        assert_eq!(o.code, 2, "{}", o.stdout);
        has(&o.stderr, "the model of `torque` does not say how its parameters depend on each other");
    }
    let o = with("wrong.toml", "guard = { distance = 0.0 }\nrobust = { draws = 0 }");
    assert_eq!(o.code, 2, "{}", o.stdout);
    has(&o.stderr, "optimise.guard.distance");
    has(&o.stderr, "optimise.robust.draws");
}

fn only_csv(folder: &Path) -> std::path::PathBuf {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "csv"));
    assert_eq!(files.len(), 1, "{files:?}");
    files.remove(0)
}

const SPEC: &str = r#"
models = ["y.json"]

[record]
file = "start.csv"

[optimise]
demand = "record"

[problem]
inputs = [{ name = "u", unit = "bar", lower = 0.0, upper = 5.0 }]
demands = [{ output = "y", unit = "K", lower = 0.0, upper = 10.0 }]
minimise = [{ channel = "u" }]
"#;

/// y(t) = 0.5 y(t-1) + u(t-1), so that y reaches 10 K with u at 5 bar.
fn bed(spec: &str, demand: impl Fn(usize) -> f64, n: usize) -> tempfile::TempDir {
    let tmp = tempfile::tempdir().unwrap();
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    let structure = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap();
    let model = StoredModel::new(structure, &[1.0, 0.5], vec![quantity("u", "bar")], quantity("y", "K"), 0.5)
        .unwrap();
    json::write_versioned(&tmp.path().join("y.json"), MODEL_SCHEMA, MODEL_VERSION, &model).unwrap();
    let mut text = String::from("time [s],u [bar],y [K]\n");
    (0..n).for_each(|t| text += &format!("{},2,{}\n", 0.5 * t as f64, demand(t)));
    atomic::write(&tmp.path().join("start.csv"), text.as_bytes()).unwrap();
    atomic::write(&tmp.path().join("spec.toml"), spec.as_bytes()).unwrap();
    tmp
}

fn optimise(folder: &Path) -> Outcome {
    dynocal(folder, &["optimise", "spec.toml", "--out", "run"])
}

/// Each K of y costs 2 bar s of u and is worth a quarter: the best is none. The grid says what it is worth.
#[test]
fn dynamic_programming_says_what_its_grid_is_worth() {
    let spec = SPEC
        .replace("demand = \"record\"", "way = { name = \"dynamic\", cells = 20 }")
        .replace(
            "demands = [{ output = \"y\", unit = \"K\", lower = 0.0, upper = 10.0 }]",
            "limits = [{ output = \"y\", unit = \"K\" }]",
        )
        .replace("{ channel = \"u\" }", "{ channel = \"u\" }, { channel = \"y\", weight = -0.25 }");
    let tmp = bed(&spec, |_| 4.0, 60);
    let o = optimise(tmp.path());
    assert_eq!(o.code, 0, "{} {}", o.stdout, o.stderr);
    has(&o.stdout, "The grid has 20 cells along each remembered value (y(t))");
    let summary = std::fs::read_to_string(tmp.path().join("run/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert_eq!(summary["grid"]["remembered"][0], "y(t)");
    // All is linear, and so is the value between the points: y(1) = 4 fades by half from sample to sample, u is 0.
    let objective: f64 = -0.25 * 4.0 * (0..58).map(|k| 0.5f64.powi(k + 1)).sum::<f64>() / 58.0;
    let found = summary["grid"]["objective"].as_f64().unwrap();
    assert!((found - objective).abs() < 1e-9, "{found} {objective}");
}

/// The only input that gives a demand is known: u(t) = d(t+1) - d(t) / 2.
#[test]
fn a_demand_of_the_record_is_met_by_the_only_input_that_meets_it() {
    let demand = |t: usize| if t < 20 { 4.0 } else { 4.0 + 0.1 * (t - 20) as f64 };
    let tmp = bed(SPEC, demand, 60);
    let o = optimise(tmp.path());
    assert_eq!(o.code, 0, "{}", o.stderr);
    has(&o.stdout, "everything asked is kept");
    let u = column(&tmp.path().join("run/optimum.csv"), "u");
    for t in 1..59 {
        assert!((u[t] - (demand(t + 1) - 0.5 * demand(t))).abs() < 1e-6, "{t}: {}", u[t]);
    }
}

/// Prices are those of what is minimised, which the summary holds; a given channel outside of its range is said.
#[test]
fn what_is_minimised_and_what_leaves_its_range_is_said() {
    let given = SPEC.replace(
        "minimise =",
        "given = [{ name = \"speed\", unit = \"rpm\", lower = 1000.0, upper = 2000.0 }]\nminimise =",
    );
    let tmp = bed(&given, |_| 4.0, 60);
    let text = std::fs::read_to_string(tmp.path().join("start.csv")).unwrap();
    let with_speed = |(k, line): (usize, &str)| {
        format!(
            "{line},{}\n",
            if k == 0 {
                "speed [rpm]"
            } else if k == 31 {
                "2500"
            } else {
                "1500"
            }
        )
    };
    let text: String = text.lines().enumerate().map(with_speed).collect();
    atomic::write(&tmp.path().join("start.csv"), text.as_bytes()).unwrap();
    let o = optimise(tmp.path());
    assert_eq!(o.code, 0, "{}", o.stderr);
    has(
        &o.stderr,
        "speed of the record leaves the range that the spec gives, 1000 to 2000 rpm: 2500 at 15.00 s",
    );
    // Without smoothing, extension or soft limits it is the objective itself.
    let summary: serde_json::Value = json::read(&tmp.path().join("run/summary.json")).unwrap();
    let of = |key: &str| summary["objective"][key].as_f64().unwrap();
    assert!((of("minimised") - of("optimum")).abs() < 1e-3 * of("optimum"), "{}", summary["objective"]);
}

/// The plan of an earlier run is no result of one that has none.
#[test]
fn an_infeasible_run_takes_the_plan_of_the_run_before_away() {
    let tmp = bed(SPEC, |_| 4.0, 60);
    assert_eq!(optimise(tmp.path()).code, 0);
    let plans =
        ["optimum.plan.csv", "optimum.plan.json", "prices.csv"].map(|n| tmp.path().join("run").join(n));
    assert!(plans.iter().all(|p| p.exists()));
    let beyond = bed(SPEC, |t| if (20..30).contains(&t) { 12.0 } else { 4.0 }, 60);
    let record = std::fs::read(beyond.path().join("start.csv")).unwrap();
    atomic::write(&tmp.path().join("start.csv"), &record).unwrap();
    assert_eq!(optimise(tmp.path()).code, 1);
    assert!(plans.iter().all(|p| !p.exists()));
}

/// A weight is a unit: the optimum does not depend on it, and no weight makes a problem infeasible. Least u with y at 3 K is 1.5 bar.
#[test]
fn weights_of_any_size_give_the_same_optimum() {
    let limited = SPEC.replace("demand = \"record\"", "").replace(
        "demands = [{ output = \"y\", unit = \"K\", lower = 0.0, upper = 10.0 }]",
        "limits = [{ output = \"y\", unit = \"K\", lower = 3.0 }]",
    );
    for weight in ["1.0", "1e-9", "1e4", "1e8"] {
        let spec =
            limited.replace("{ channel = \"u\" }", &format!("{{ channel = \"u\", weight = {weight} }}"));
        let tmp = bed(&spec, |_| 4.0, 60);
        let o = optimise(tmp.path());
        assert_eq!(o.code, 0, "{weight}: {}{}", o.stdout, o.stderr);
        let u = column(&tmp.path().join("run/optimum.csv"), "u");
        assert!(u[10..50].iter().all(|u| (u - 1.5).abs() < 1e-4), "{weight}: {:?}", &u[10..50]);
    }
}

/// Bounds over the record that cross are named with both channels, not searched.
#[test]
fn bounds_of_the_record_that_cross_are_refused() {
    let tmp = bed(SPEC, |_| 4.0, 60);
    let record = std::fs::read_to_string(tmp.path().join("start.csv")).unwrap();
    let with = |(k, line): (usize, &str)| {
        format!("{line},{}\n", if k == 0 { "u_lower [bar],u_upper [bar]" } else { "4,3" })
    };
    let text: String = record.lines().enumerate().map(with).collect();
    atomic::write(&tmp.path().join("start.csv"), text.as_bytes()).unwrap();
    let o = optimise(tmp.path());
    assert_eq!(o.code, 2, "{}{}", o.stdout, o.stderr);
    has(&o.stderr, "`u_lower` is 4 and `u_upper` 3 at 0.5 s; expected a lower bound below the upper one");
}

#[test]
fn a_demand_beyond_reach_is_named_with_time_amount_and_actuator() {
    // From 10 s to 14.5 s 12 K are asked.
    let tmp = bed(SPEC, |t| if (20..30).contains(&t) { 12.0 } else { 4.0 }, 60);
    let o = optimise(tmp.path());
    assert_eq!(o.code, 1, "{}", o.stderr);
    has(&o.stdout, "the problem is infeasible");
    // y(20) = 4 / 2 + 5 = 7 K where 12 K are asked; after them y(30) is 5 K at least where 4 K are.
    let summary: serde_json::Value = json::read(&tmp.path().join("run/summary.json")).unwrap();
    let shortfall = &summary["shortfalls"][0];
    let number = |key: &str| shortfall[key].as_f64().unwrap();
    assert!((number("largest") + 5.0).abs() < 1e-3 && number("at_s") == 10.0, "{shortfall}");
    assert!(number("from_s") >= 9.5 && number("from_s") <= 10.0 && number("to_s") == 15.0, "{shortfall}");
    has(&o.stdout, "Y stays below its demand from ");
    has(&o.stdout, " to 15.00 s by up to ");
    has(
        &o.stdout,
        "the point at which the search gave up, in tables and plots, may miss more and is no plan",
    );
    // A point that is no optimum has no prices, and the verdict is said once.
    assert_eq!(summary["prices"], serde_json::json!([]));
    assert!(!tmp.path().join("run/prices.csv").exists() && !o.stdout.contains("one more of"));
    assert!(!o.stderr.contains("warning: Over"), "{}", o.stderr);
    has(&o.stdout, "K (at 10.00 s)");
    has(&o.stdout, "u at 5 bar");
    let run = tmp.path().join("run");
    assert!(run.join("optimum.csv").exists() && !run.join("optimum.plan.csv").exists());
    has(&std::fs::read_to_string(run.join("report.html")).unwrap(), "Where it cannot be met");
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let refused = |spec: &str, n: usize| {
        let tmp = bed(spec, |_| 4.0, n);
        let o = optimise(tmp.path());
        assert_eq!((o.code, o.stdout.as_str()), (2, ""), "{}", o.stderr);
        // What the run refuses, the check refuses.
        let checked = dynocal(tmp.path(), &["optimise", "spec.toml", "--out", "run", "--check"]);
        assert_eq!((checked.code, checked.stdout.as_str()), (2, ""), "{}", checked.stderr);
        assert_eq!(checked.stderr.lines().last(), o.stderr.lines().last());
        o.stderr
    };
    has(
        &refused(SPEC, 3),
        "`start` has 3 samples; the models reach back 1 samples, so at least 4 are needed",
    );
    has(
        &refused(&SPEC.replace("unit = \"K\"", "unit = \"Nm\""), 60),
        "column `y`: found unit `K`, expected `Nm`",
    );
    let nobody = SPEC.replace("minimise", "limits = [{ output = \"z\", unit = \"-\" }]\nminimise");
    has(&refused(&nobody, 60), "no model computes `z`");
    let text =
        refused(&SPEC.replace("demand = \"record\"", "way = { name = \"horzon\", length_s = 1.0 }"), 60);
    has(&text, "did you mean `horizon`?");
    has(&refused(&SPEC.replace("file =", "from_s = 99.0\nfile ="), 60), "leave no sample");
    let imposed = "way = { name = \"dynamic\" }\nend = \"start\"";
    let text = refused(&SPEC.replace("demand = \"record\"", imposed), 60);
    has(&text, "dynamic programming goes through a grid");
    has(&text, "inputs that are imposed at the end");
    let text = refused(&SPEC.replace("demand = \"record\"", "tolerance = -1.0\nextend_s = -1.0"), 60);
    has(&text, "optimise.tolerance");
    has(&text, "optimise.extend_s");
}
