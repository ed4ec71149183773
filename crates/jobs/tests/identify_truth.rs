//! What `identify` says must be so: records whose right answer is known, and what must not pass in silence.

use std::fmt::Write as _;
use std::path::Path;

use dynocal_files::measurement::{Raster, by_ending};
use dynocal_files::table::{Cells, Column, UnitSource};
use dynocal_files::{atomic, json};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};
use dynocal_ident::validate::{Kind, Seen};
use dynocal_jobs::identify::finding::Grade;
use dynocal_jobs::identify::job;
use dynocal_jobs::identify::result::{Identified, Score};
use dynocal_jobs::identify::spec::{self, Overrides};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

const HEAD: &str = "
[data]
file = 'bed.csv'
sample_time_s = 0.1
[[channels]]
column = 'u'
unit = 'mg'
role = 'input'
[[channels]]
column = 'y'
unit = 'Nm'
role = 'output'
";

struct Bench(tempfile::TempDir);

impl Bench {
    fn new(files: &[(&str, &str)]) -> Self {
        let bench = Self(tempfile::tempdir().unwrap());
        files.iter().for_each(|(name, text)| bench.put(name, text));
        bench
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, text: &str) {
        atomic::write(&self.path(name), text.as_bytes()).unwrap();
    }

    fn overrides(&self, out: &str) -> Overrides {
        Overrides { out: Some(self.path(out)), ..Overrides::default() }
    }

    /// Identifies, or says in words why not.
    fn identify(&self, spec: &str) -> Result<Identified, String> {
        self.put("spec.toml", spec);
        let job = spec::read(&self.path("spec.toml"), &self.overrides("run")).map_err(|e| e.to_string())?;
        job::run(&job, Watch::silent()).map(|found| found.0).map_err(|e| e.to_string())
    }

    fn model(&self) -> StoredModel {
        json::read_versioned(&self.path("run/steps/01-identify/model.json"), MODEL_SCHEMA, MODEL_VERSION)
            .unwrap()
    }

    /// Scores stored models on the columns of a file.
    fn score(&self, models: Vec<StoredModel>, file: &str) -> Result<Identified, String> {
        let over = Overrides { data: vec![self.path(file)], ..self.overrides("scored") };
        let job = spec::Job::of_models(models, &over).map_err(|e| e.to_string())?;
        job::run(&job, Watch::silent()).map(|found| found.0).map_err(|e| e.to_string())
    }
}

fn csv(head: &str, columns: &[&[f64]]) -> String {
    let mut text = format!("{head}\n");
    for t in 0..columns[0].len() {
        let row: Vec<String> = columns.iter().map(|c| format!("{}", c[t])).collect();
        writeln!(text, "{}", row.join(",")).unwrap();
    }
    text
}

/// Levels held 20 to 80 samples.
fn held(n: usize, rng: &mut Rng64) -> Vec<f64> {
    let mut u = Vec::new();
    while u.len() < n {
        let (hold, level) = (20 + rng.below(60), rng.uniform_in(-1.0, 1.0));
        u.extend(std::iter::repeat_n(level, hold));
    }
    u.truncate(n);
    u
}

/// Output error with poles at 0.99 and 0.97 and much noise; the record begins in the middle of a run.
fn slow_output_error() -> String {
    let mut rng = Rng64::new(4);
    let u = held(2400, &mut rng);
    let mut w = vec![0.0; u.len()];
    for t in 2..u.len() {
        w[t] = 0.01 * u[t - 1] + 1.96 * w[t - 1] - 0.9603 * w[t - 2];
    }
    let y: Vec<f64> = w[400..].iter().map(|w| w + 2.0 * rng.normal()).collect();
    csv("u [mg],y [Nm]", &[&u[400..], &y])
}

/// y(t) = 0.5 + 0.8 y(t-1) + 2 u(t-1) without noise.
fn first_order(n: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut rng = Rng64::new(seed);
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let mut y = vec![0.0; n];
    (1..n).for_each(|t| y[t] = 0.5 + 0.8 * y[t - 1] + 2.0 * u[t - 1]);
    (u, y)
}

fn score<'a>(found: &'a Identified, part: &str, kind: Kind) -> &'a Score {
    found.scores.iter().find(|s| s.part == part && s.kind == kind).unwrap()
}

const ROWS: &str = "[split]\nestimation_rows = [[0, 1400]]\ntest_rows = [[1400, 2000]]\n";
const ARX: &str = "[model]\nstructure = { name = 'arx', na = 1, nb = 1 }\nestimator = { name = 'ols' }\n";

/// Free run and one step of an output-error model are one thing, from the start that is usual for it; its parameters have
/// standard errors. From noisy measured outputs the same free run is useless, and that is seen in the number.
#[test]
fn free_runs_of_output_error_models_start_from_estimated_outputs() {
    let bench = Bench::new(&[("bed.csv", &slow_output_error())]);
    let model = "[model]\nstructure = { name = 'oe', nb = 1, nf = 2 }\nestimator = { name = 'pem', initial = 'estimated' }\n";
    let found = bench.identify(&format!("{HEAD}{ROWS}{model}")).unwrap();
    let (one, free) = (score(&found, "test", Kind::OneStep), score(&found, "test", Kind::FreeRun));
    assert_eq!(one.rmse, free.rmse);
    assert!((free.rmse.unwrap() / 2.0 - 1.0).abs() < 0.1, "{:?}", free.rmse);
    assert!(found.models[0].parameters.iter().all(|p| p.std_error.is_some_and(|s| s > 0.0)));
    let measured = "[validate]\ninitial = 'measured'\n";
    let found = bench.identify(&format!("{HEAD}{ROWS}{model}{measured}")).unwrap();
    assert!(score(&found, "test", Kind::FreeRun).rmse.unwrap() > 1.3 * free.rmse.unwrap());
    // The stored model starts as it was scored, and `simulate` is the free run of `identify`.
    assert_eq!(bench.model().initial().words(), "from measured outputs");
}

/// Three slow poles under noise, a record that begins in the middle of a run: what noise three measured outputs hold grows
/// to many times the output, while the start that is estimated costs next to nothing. An order too high leaves poles that
/// nothing determines: their standard errors are numbers or absent, and never zero.
#[test]
fn slow_poles_do_not_collapse_and_nothing_is_certain() {
    let mut rng = Rng64::new(3);
    let u = held(3000, &mut rng);
    // (1 - 0.99 q)(1 - 0.98 q)(1 - 0.97 q), gain 10.
    let f = [-2.94, 2.8811, -0.941_094];
    let gain = 10.0 * (1.0 + f[0] + f[1] + f[2]);
    let mut w = vec![0.0; u.len()];
    for t in 3..u.len() {
        w[t] = gain * u[t - 1] - f[0] * w[t - 1] - f[1] * w[t - 2] - f[2] * w[t - 3];
    }
    let y: Vec<f64> = w[400..].iter().map(|w| w + 0.5 * rng.normal()).collect();
    let bench = Bench::new(&[("bed.csv", &csv("u [mg],y [Nm]", &[&u[400..], &y]))]);
    let rows = "[split]\nestimation_rows = [[0, 1800]]\ntest_rows = [[1800, 2600]]\n";
    let model = |nf: usize, keys: &str| {
        format!(
            "[model]\nstructure = {{ name = 'oe', nb = 1, nf = {nf} }}\nestimator = {{ name = 'pem'{keys} }}\n"
        )
    };
    let rmse = |keys: &str, initial: &str| {
        let validate = format!("[validate]\ninitial = '{initial}'\n");
        let found = bench.identify(&format!("{HEAD}{rows}{}{validate}", model(3, keys))).unwrap();
        score(&found, "test", Kind::FreeRun).rmse.unwrap()
    };
    let (measured, estimated) =
        (rmse(", initial = 'estimated'", "measured"), rmse(", initial = 'estimated'", "estimated"));
    println!("free run on the test rows: measured {measured:.3}, estimated {estimated:.3}, noise 0.5");
    assert!(estimated < 1.1 * 0.5 && measured > 5.0 * estimated, "{measured} {estimated}");
    for (nf, keys) in [
        (2, ""),
        (3, ", initial = 'estimated'"),
        (4, ""),
        (5, ""),
        (4, ", initial = 'estimated'"),
        (5, ", initial = 'estimated'"),
    ] {
        // Too high an order may be refused its verdict, not its numbers.
        let found = bench.identify(&format!("{HEAD}{rows}{}", model(nf, keys))).unwrap();
        for p in &found.models[0].parameters {
            assert!(p.std_error.is_none_or(|s| s > 0.0), "order {nf}{keys}: {} +- {:?}", p.name, p.std_error);
        }
    }
}

/// A model that is fine on its record and grows on a share of other inputs within the same limits is no model to trust: that is
/// said with the share, and the run is not valid.
#[test]
fn a_share_of_unstable_random_runs_is_a_fault() {
    let mut rng = Rng64::new(11);
    let n = 1200;
    // y(t) = (0.75 + 0.4 u(t-1)) y(t-1) + 1: grows while u is held above 0.625; the record crosses that for single samples.
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let mut y = vec![4.0; n];
    (1..n).for_each(|t| y[t] = (0.75 + 0.4 * u[t - 1]) * y[t - 1] + 1.0);
    let bench = Bench::new(&[("bed.csv", &csv("u [mg],y [Nm]", &[&u, &y]))]);
    let rows = "[split]\nestimation_rows = [[0, 800]]\ntest_rows = [[800, 1200]]\n";
    let model = "[model]\nstructure = { name = 'polynomial', regressors = ['1', 'y(t-1)', 'u(t-1)*y(t-1)'] }\n\
                 estimator = { name = 'ols' }\n";
    let found = bench.identify(&format!("{HEAD}{rows}{model}")).unwrap();
    assert!(score(&found, "test", Kind::FreeRun).rmse.unwrap() < 1e-6);
    let fault = found.findings.iter().find(|f| f.text.contains("free runs on random inputs"));
    let fault = fault.unwrap_or_else(|| panic!("{:?}", found.findings));
    assert!(fault.text.contains(" of 20 "), "{}", fault.text);
    assert!(!found.valid && fault.grade == Grade::Fault, "{fault:?}");
}

/// A stored model carries its preparation: scored on the rows of its test it has the numbers of its test.
#[test]
fn stored_models_apply_their_preparation() {
    let (u, y) = first_order(2000, 1);
    // Far from zero, so that forgetting the offset shows.
    let y: Vec<f64> = y.iter().map(|v| 300.0 + 4.0 * v).collect();
    let bench = Bench::new(&[
        ("bed.csv", &csv("u [mg],y [Nm]", &[&u, &y])),
        ("other.csv", &csv("u [mg],y [Nm]", &[&u[1400..], &y[1400..]])),
    ]);
    let steps = "[[prepare]]\nstep = 'offset'\n[[prepare]]\nstep = 'scale'\n";
    let arx = ARX.replace("nb = 1", "nb = 1, constant = false");
    let found = bench.identify(&format!("{HEAD}{ROWS}{steps}{arx}")).unwrap();
    let expected = score(&found, "test", Kind::FreeRun);
    let again = bench.score(vec![bench.model()], "other.csv").unwrap();
    let got = score(&again, "record", Kind::FreeRun);
    assert_eq!((got.unit.as_str(), got.samples), ("Nm", expected.samples));
    let (a, b) = (got.rmse.unwrap(), expected.rmse.unwrap());
    assert!((a - b).abs() <= 1e-9 * (1e-3 + b), "{a} and {b}");
    assert_eq!(again.preparation.len(), 1);
    // Other units of the file are converted, unknown ones refused.
    let kilo: Vec<f64> = u.iter().map(|v| v * 1e-3).collect();
    bench.put("gram.csv", &csv("u [g],y [Nm]", &[&kilo[1400..], &y[1400..]]));
    let converted = bench.score(vec![bench.model()], "gram.csv").unwrap();
    let c = score(&converted, "record", Kind::FreeRun).rmse.unwrap();
    assert!((c - b).abs() <= 1e-6 * (1e-3 + b), "{c} and {b}");
    bench.put("volt.csv", &csv("u [V],y [Nm]", &[&u, &y]));
    let fault = bench.score(vec![bench.model()], "volt.csv").unwrap_err();
    assert!(fault.contains('V') && fault.contains("mg") && fault.contains("`u`"), "{fault}");
}

/// A channel that follows from others is a name in the spec, and the stored model reads the measured ones.
#[test]
fn derived_channels_are_identified_and_stored() {
    let mut rng = Rng64::new(3);
    let n = 600;
    let speed: Vec<f64> = (0..n).map(|_| rng.uniform_in(1000.0, 3000.0)).collect();
    let mut phi = vec![1.0; n];
    (1..n).for_each(|t| phi[t] = 0.4 * phi[t - 1] + 5.0 * (120.0 / speed[t - 1]) + 0.2);
    let lambda: Vec<f64> = phi.iter().map(|p| 1.0 / p).collect();
    let text = csv("speed [rpm],lambda [-]", &[&speed, &lambda]);
    let bench = Bench::new(&[("bed.csv", &text)]);
    let head = HEAD
        .replace("'u'", "'speed'")
        .replace("'mg'", "'rpm'")
        .replace("'y'", "'lambda'")
        .replace("'Nm'", "'-'");
    let derive = "[[derive]]\nname = 'cycle'\nunit = 's'\nfactor = 120\npowers = { speed = -1 }\n\
                  [[derive]]\nname = 'phi'\npowers = { lambda = -1 }\n";
    let model = "[model]\ntarget = 'phi'\ninputs = ['cycle']\n\
                 structure = { name = 'polynomial', regressors = ['1', 'cycle(t-1)', 'phi(t-1)'] }\nestimator = { name = 'ols' }\n";
    let found = bench.identify(&format!("{head}{derive}{model}")).unwrap();
    let values: Vec<f64> = found.models[0].parameters.iter().map(|p| p.value).collect();
    for (found, truth) in values.iter().zip([0.2, 5.0, 0.4]) {
        assert!((found - truth).abs() < 1e-9, "{values:?}");
    }
    let stored = bench.model();
    assert_eq!(stored.user_output().name, "lambda");
    assert_eq!(stored.measured_inputs().iter().map(|q| q.name.as_str()).collect::<Vec<_>>(), ["speed"]);
    let again = bench.score(vec![stored], "bed.csv").unwrap();
    assert!(score(&again, "record", Kind::FreeRun).rmse.unwrap() < 1e-9);
    let wrong = derive.replace("speed = -1", "sped = -1");
    let fault = bench.identify(&format!("{head}{wrong}{model}")).unwrap_err();
    assert!(fault.contains("derive[1]") && fault.contains("`speed`"), "{fault}");
}

/// Finite and far is as bad as infinite: said, marked, and not valid.
#[test]
fn free_runs_far_outside_are_faults() {
    let (u, y) = first_order(1000, 2);
    let bench = Bench::new(&[("bed.csv", &csv("u [mg],y [Nm]", &[&u, &y]))]);
    let rows = "[split]\nestimation_rows = [[0, 700]]\ntest_rows = [[700, 1000]]\n";
    let found = bench.identify(&format!("{HEAD}{rows}{ARX}")).unwrap();
    assert!(found.valid && found.verdict[0].contains("is close"), "{:?}", found.findings);
    let mut unstable = bench.model();
    unstable.parameters.iter_mut().filter(|p| p.name == "y(t-1)").for_each(|p| p.value = 1.02);
    let found = bench.score(vec![unstable], "bed.csv").unwrap();
    let free = score(&found, "record", Kind::FreeRun);
    assert!(free.rmse.is_some_and(|v| v.is_finite() && v > 1e6) && free.outside);
    assert!(!found.valid && found.findings[0].grade == Grade::Fault);
    assert!(found.warnings[0].contains("leaves the measured range"), "{:?}", found.warnings);
    assert!(found.verdict.last().unwrap().starts_with("Do not use it"), "{:?}", found.verdict);
    assert!(
        !found.warnings[0].contains("estimator `sem`"),
        "a stored model cannot be told to be estimated otherwise"
    );
}

/// What chose between candidates is no test.
#[test]
fn selection_records_are_not_unseen() {
    let (u, y) = first_order(1000, 5);
    let bench = Bench::new(&[("bed.csv", &csv("u [mg],y [Nm]", &[&u, &y]))]);
    let rows = "[split]\nestimation_rows = [[0, 600]]\nselection_rows = [[600, 1000]]\n";
    let model = "[model]\nstructure = { name = 'neural', hidden = 2, input_lags = 1 }\n\
                 estimator = { name = 'train', starts = 3, max_evaluations = 30 }\n";
    let found = bench.identify(&format!("{HEAD}{rows}{model}")).unwrap();
    assert_eq!(score(&found, "selection", Kind::FreeRun).data, Seen::Selection);
    assert!(found.warnings.iter().any(|w| w.contains("no test data")), "{:?}", found.warnings);
    assert!(found.verdict[0].contains("the records that chose it"), "{:?}", found.verdict);
    // The starts of the training are told apart.
    assert!(found.findings.iter().any(|f| f.grade == Grade::Note && f.text.starts_with("3 starts: RMSE")));
}

/// Empty cells that a step bridges are counted, in the test set as in the estimation, and a stamp that differs by rounding is
/// the stamp.
#[test]
fn resampling_counts_what_it_bridges_and_takes_coinciding_stamps() {
    let (u, y) = first_order(400, 7);
    // 0.1 k written by adding up differs from 0.1 k in the last digits.
    let mut stamps = vec![0.0_f64];
    (1..400).for_each(|t| stamps.push(stamps[t - 1] + 0.1));
    let mut text = String::from("t [s],u [mg],y [Nm]\n");
    let mut other = text.clone();
    for t in 0..400 {
        // Every third output of the test file is not known; in the other every fiftieth.
        let cell = |every: usize| if t > 0 && t % every == 0 { String::new() } else { y[t].to_string() };
        writeln!(text, "{},{},{}", stamps[t], u[t], cell(50)).unwrap();
        writeln!(other, "{},{},{}", stamps[t], u[t], cell(3)).unwrap();
    }
    let bench = Bench::new(&[("bed.csv", &text), ("other.csv", &other)]);
    let head = HEAD.replace("sample_time_s = 0.1", "time = 't'\nmissing = 'mark'");
    let spec = format!(
        "{head}[[test]]\nname = 'other'\nfile = 'other.csv'\n[[prepare]]\nstep = 'resample'\nsample_time_s = 0.1\nmax_gap_s = 0.05\n{ARX}"
    );
    let found = bench.identify(&spec).unwrap();
    // Nothing may be bridged over 0.05 s: what is known stays, what is empty is missing.
    let samples = |part: &str| score(&found, part, Kind::OneStep).samples;
    assert_eq!((samples("estimation"), samples("other")), (399 - 7, 399 - 133));
    let said =
        |about: &str, text: &str| found.findings.iter().any(|f| f.about == about && f.text.contains(text));
    assert!(
        said("estimation", "7 values missing") && said("other", "133 values missing"),
        "{:?}",
        found.findings
    );
    let bridged = bench.identify(&spec.replace("max_gap_s = 0.05", "max_gap_s = 1.0")).unwrap();
    let said =
        |about: &str, text: &str| bridged.findings.iter().any(|f| f.about == about && f.text.contains(text));
    assert!(
        said("estimation", "7 values filled in") && said("other", "132 values filled in"),
        "{:?}",
        bridged.findings
    );
}

/// A noise-free record gives no sentence about noise; where the structure misses something, least squares is compared before
/// anything is said of it, and it is a note.
#[test]
fn sentences_about_noise_are_compared_first() {
    let (u, y) = first_order(800, 8);
    let sem = "[model]\nstructure = { name = 'arx', na = 1, nb = 1 }\nestimator = { name = 'sem' }\n";
    let bench = Bench::new(&[("bed.csv", &csv("u [mg],y [Nm]", &[&u, &y]))]);
    let clean = bench.identify(&format!("{HEAD}{sem}")).unwrap();
    assert!(clean.findings.iter().all(|f| !f.text.contains("noise")), "{:?}", clean.findings);
    // A slow second pole that the structure lacks.
    let mut z = vec![0.0; y.len()];
    (1..y.len()).for_each(|t| z[t] = 0.95 * z[t - 1] + 0.05 * y[t]);
    let mixed: Vec<f64> = y.iter().zip(&z).map(|(a, b)| a + 4.0 * b).collect();
    bench.put("bed.csv", &csv("u [mg],y [Nm]", &[&u, &mixed]));
    let found = bench.identify(&format!("{HEAD}{sem}")).unwrap();
    let told: Vec<_> = found.findings.iter().filter(|f| f.text.contains("noise")).collect();
    assert!(!told.is_empty(), "{:?}", found.findings);
    for f in told {
        assert!(f.grade == Grade::Note && f.text.contains("least squares was compared"), "{}", f.text);
        assert!(!f.text.contains("more efficient"), "{}", f.text);
    }
}

/// Each of these was accepted in silence.
#[test]
fn what_cannot_be_is_refused_by_name() {
    let (u, y) = first_order(300, 9);
    let bench = Bench::new(&[("bed.csv", &csv("u [mg],y [Nm]", &[&u, &y]))]);
    let fault = |spec: &str| bench.identify(&format!("{HEAD}{spec}")).unwrap_err();
    let has = |text: String, parts: &[&str]| {
        assert!(parts.iter().all(|p| text.contains(p)), "{parts:?} in {text}");
    };
    has(
        fault(&format!("[split]\nestimation_rows = []\ntest_rows = [[0, 300]]\n{ARX}")),
        &["split.estimation_rows", "empty"],
    );
    has(fault(&format!("[split]\ncolumn = 'u'\nestimation = []\n{ARX}")), &["split.estimation", "empty"]);
    has(fault(&format!("[[test]]\nname = 'again'\nfile = 'bed.csv'\n{ARX}")), &["again", "unseen"]);
    let neural =
        "[model]\nstructure = { name = 'neural', lags = { u = [5, 1] } }\nestimator = { name = 'train' }\n";
    has(fault(neural), &["`u`", "first lag 5"]);
    has(fault(&ARX.replace("'ols'", "'pem'")), &["`arx`", "ols, rls, iv, sem, train", "linear_arx"]);
    for huge in ["2147483648", "9223372036854775807"] {
        has(fault(&ARX.replace("na = 1", &format!("na = {huge}"))), &["longest lag"]);
        has(fault(&format!("{ARX}[validate]\nk_steps = [{huge}]\n")), &["validate.k_steps"]);
        has(fault(&format!("{ARX}[validate]\nstability_runs = {huge}\n")), &["validate.stability_runs"]);
        let oe =
            format!("[model]\nstructure = {{ name = 'oe', nf = {huge} }}\nestimator = {{ name = 'pem' }}\n");
        has(fault(&oe), &["nf", "at most"]);
    }
    // A boundary that everything or nothing is inside of would be no guard.
    for quantile in ["0.0", "1.0", "1.5", "-0.1", "nan"] {
        let boundary = format!("{ARX}[validate]\nboundary = {{ quantile = {quantile} }}\n");
        has(fault(&boundary), &["validate.boundary.quantile", "above 0 and below 1"]);
    }
    // Parameters under names of another structure; a model without its inputs.
    bench.identify(&format!("{HEAD}{ARX}")).unwrap();
    let mut swapped = bench.model();
    swapped.parameters.swap(0, 1);
    has(bench.score(vec![swapped], "bed.csv").unwrap_err(), &["parameter 1 is called `u(t-1)`"]);
    let mut bare = bench.model();
    bare.inputs.clear();
    has(bench.score(vec![bare], "bed.csv").unwrap_err(), &["its channels are  -> y"]);
    // The first row is a sample, not a header; a unit in parentheses is a unit.
    bench.put("bed.csv", &csv("0.5,1.5", &[&u, &y]));
    has(fault(ARX), &["bed.csv, line 1", "found values"]);
    bench.put("bed.csv", &csv("u (g),y (Nm)", &[&u, &y]));
    let spec = HEAD.replace("'u'", "'u (g)'\nname = 'u'").replace("'y'", "'y (Nm)'\nname = 'y'");
    has(bench.identify(&format!("{spec}{ARX}")).unwrap_err(), &["u (g)", "`g`", "`mg`"]);
    assert!(Path::new(&bench.path("spec.toml")).exists());
}

fn raster(name: &str, interval_s: f64, columns: &[(&str, &str, &[f64])]) -> Raster {
    let column = |(name, unit, v): &(&str, &str, &[f64])| Column {
        name: (*name).into(),
        unit: Some(((*unit).into(), UnitSource::Bracket)),
        cells: Cells::Number(v.to_vec()),
    };
    let time_s = (0..columns[0].2.len()).map(|t| t as f64 * interval_s).collect();
    Raster { name: name.into(), time_s, columns: columns.iter().map(column).collect() }
}

/// One record in every format of the table gives the same parameters to the last bit.
#[test]
fn any_measurement_format_is_identified() {
    let (u, y) = first_order(300, 11);
    let bench = Bench::new(&[]);
    let whole = [raster("bed", 0.1, &[("u", "mg", &u), ("y", "Nm", &y)])];
    let mut found = Vec::new();
    for name in ["bed.csv", "bed.csv.gz", "bed.parquet", "bed.mf4", "bed.mat"] {
        let write = by_ending(&bench.path(name)).and_then(|f| f.write).unwrap();
        write(&bench.path(name), &whole).unwrap();
        bench.identify(&format!("{}{ARX}", HEAD.replace("bed.csv", name))).unwrap();
        let theta = bench.model().theta();
        assert!(theta.iter().any(|c| (c - 0.8).abs() < 1e-9), "{name}: {theta:?}");
        found.push(theta);
    }
    assert!(found.windows(2).all(|w| w[0] == w[1]), "{found:?}");
}

/// What a reader decides or loses is a finding; keys of `[data]` decide otherwise.
#[test]
fn decisions_of_the_readers_are_told() {
    let (u, y) = first_order(300, 12);
    let mut text = String::from("Logger 7\nu;Tq_Brake\nmg;Nm\n");
    let comma = |x: f64| format!("{x}").replace('.', ",");
    (0..300).for_each(|t| writeln!(text, "{};{}", comma(u[t]), comma(y[t])).unwrap());
    let bench = Bench::new(&[("bed.csv", &text)]);
    let head =
        HEAD.replace("sample_time_s = 0.1", "sample_time_s = 0.1\nalias = { y = ['trq', 'Tq_Brake'] }");
    let found = bench.identify(&format!("{head}{ARX}")).unwrap();
    let said = |text: &str| found.findings.iter().any(|f| f.grade == Grade::Note && f.text.contains(text));
    assert!(said("separator `;`, decimal comma, header in line 2, units in the line below"));
    assert!(said("`Tq_Brake` is taken as `y`"), "{:?}", found.findings);
    assert!(bench.model().theta().iter().any(|c| (c - 2.0).abs() < 1e-9));
    // A decimal sign that is not that of the file leaves words, and the cell is named.
    let wrong = head.replace("alias", "csv = { decimal = '.' }\nalias");
    assert!(bench.identify(&format!("{wrong}{ARX}")).unwrap_err().contains("line 4"));

    // Two rasters: the slower one is held, and that is told.
    let slow: Vec<f64> = u.iter().step_by(10).copied().collect();
    let held: Vec<f64> = (0..300).map(|t| slow[t / 10]).collect();
    let mut z = vec![0.0; 300];
    (1..300).for_each(|t| z[t] = 0.5 + 0.8 * z[t - 1] + 2.0 * held[t - 1]);
    let rasters = [raster("fast", 0.1, &[("y", "Nm", &z)]), raster("slow", 1.0, &[("u", "mg", &slow)])];
    (by_ending(&bench.path("bed.mf4")).and_then(|f| f.write).unwrap())(&bench.path("bed.mf4"), &rasters)
        .unwrap();
    let found = bench.identify(&format!("{}{ARX}", HEAD.replace("bed.csv", "bed.mf4"))).unwrap();
    assert!(found.findings.iter().any(|f| f.text.contains("30 rows held onto 300")), "{:?}", found.findings);
    assert!(bench.model().theta().iter().any(|c| (c - 2.0).abs() < 1e-9));
}
