//! Sentences that were untrue or of no use, each asked for again: what comes now.

use std::path::Path;

use assert_cmd::Command;

/// Code, and all that was said, page included.
fn said(folder: &Path, args: &[&str]) -> (i32, String) {
    let out = Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (out.status.code().unwrap(), text(out.stdout) + &text(out.stderr))
}

fn write(folder: &Path, name: &str, text: &str) {
    dynocal_files::atomic::write(&folder.join(name), text.as_bytes()).unwrap();
}

/// y(t) = 0.5 + 0.8 y(t-1) + 2 u(t-1) without noise, stamped every `dt_s`.
fn record(header: &str, dt_s: f64) -> String {
    let (mut y, mut text) = (0.0, format!("{header}\n"));
    for t in 0..300 {
        let u = ((t * t * 13) % 17) as f64 / 8.0 - 1.0;
        text += &format!("{:e},{u},{y}\n", t as f64 * dt_s);
        y = 0.5 + 0.8 * y + 2.0 * u;
    }
    text
}

const UNITS: &str = "time [s],u [mg],y [Nm]";

fn spec(structure: &str, estimator: &str, more: &str) -> String {
    format!(
        "[data]\nfile = \"bed.csv\"\ntime = \"time\"\n{more}\n[[channels]]\ncolumn = \"u\"\nrole = \"input\"\n\
         [[channels]]\ncolumn = \"y\"\nrole = \"output\"\n[split]\nfractions = [0.7, 0.3]\n\
         [model]\nstructure = {{ {structure} }}\nestimator = {{ {estimator} }}\n"
    )
}

/// Everything that an identification says: terminal and page.
fn identified(header: &str, dt_s: f64, text: &str) -> (i32, String) {
    let tmp = tempfile::tempdir().unwrap();
    write(tmp.path(), "bed.csv", &record(header, dt_s));
    write(tmp.path(), "spec.toml", text);
    let (code, mut all) = said(tmp.path(), &["identify", "spec.toml", "--out", "run"]);
    all += &std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap_or_default();
    (code, all)
}

fn without(text: &str, parts: &[&str]) {
    parts.iter().for_each(|p| assert!(!text.contains(p), "`{p}` in:\n{}", &text[..text.len().min(4000)]));
}

#[test]
fn times_are_written_with_the_digits_that_they_need() {
    let (_, text) =
        identified(UNITS, 1e-5, &spec("name = 'arx', na = 1, nb = 1, nk = 1", "name = 'sem'", ""));
    without(&text, &["0.000 to 0.000", "at 0.000", "of 0.0000 s"]);
}

/// The search was `sem` itself, and there is no key for a start point.
#[test]
fn advice_is_what_can_be_done() {
    let structure = "name = 'polynomial', regressors = ['u(t-1)^3*y(t-1)', 'y(t-1)^3', 'y(t-1)^2*u(t-2)']";
    for estimator in ["sem", "train"] {
        let (_, text) = identified(UNITS, 0.1, &spec(structure, &format!("name = '{estimator}'"), ""));
        without(&text, &["estimator `sem`)", "start point", "on these data"]);
    }
}

#[test]
fn a_search_without_evaluations_left_is_said_in_words() {
    let structure = "name = 'neural', hidden = 3, lags = { u = [0, 1] }";
    let (code, text) =
        identified(UNITS, 0.1, &spec(structure, "name = 'train', starts = 2, max_evaluations = 2", ""));
    assert!(code == 1 && text.contains("used up its evaluations without converging"), "{code}");
    without(&text, &["as Limit", "Limit after", "u(t-0)"]);
    assert!(text.contains("u(t)"));
}

/// A value of the wrong type names file, line and key, and what is expected in words.
#[test]
fn wrong_types_name_their_key() {
    for (structure, estimator, more, parts) in [
        (
            "name = 'arx', na = 'two'",
            "name = 'ols'",
            "",
            ["`model.structure.na`", "found the text \"two\", expected a whole number"],
        ),
        (
            "name = 'arx'",
            "name = 'sem', max_evaluations = 1.5",
            "",
            ["`model.estimator.max_evaluations`", "found 1.5, expected a whole number"],
        ),
        (
            "name = 'arx'",
            "name = 'ols'",
            "init_samples = 'ten'",
            ["`data.init_samples`", "found the text \"ten\", expected a whole number"],
        ),
    ] {
        let (code, text) = identified(UNITS, 0.1, &spec(structure, estimator, more));
        assert_eq!(code, 2, "{text}");
        parts.iter().for_each(|p| assert!(text.contains(p), "no `{p}` in {text}"));
        without(&text, &["f64", "usize", "u64", "integer", "expected one of \n", "expected one of)"]);
        assert!(text.contains("spec.toml:"), "{text}");
    }
}

#[test]
fn a_missing_unit_of_time_is_asked_for_by_its_key() {
    let (code, text) = identified("time,u [mg],y [Nm]", 0.1, &spec("name = 'arx'", "name = 'ols'", ""));
    assert!(code == 2 && text.contains("`time_unit = \"s\"` in [data]"), "{text}");
    let given = spec("name = 'arx', na = 1, nb = 1, nk = 1", "name = 'ols'", "time_unit = 's'");
    assert!(identified("time,u [mg],y [Nm]", 0.1, &given).0 < 2);
}

/// A model that is exact but for rounding is no fault, and nothing is infinitely many times as much.
#[test]
fn an_exact_model_may_be_used() {
    for estimator in ["ols", "sem"] {
        let structure = "name = 'polynomial', regressors = ['1', 'u(t-1)', 'y(t-1)']";
        let (code, text) = identified(UNITS, 0.1, &spec(structure, &format!("name = '{estimator}'"), ""));
        assert_eq!(code, 0, "{estimator}: {}", &text[..text.len().min(2000)]);
        without(&text, &["inf times", "Do not use it"]);
    }
}

/// All options that are missing, at once.
#[test]
fn missing_options_come_together() {
    let tmp = tempfile::tempdir().unwrap();
    for (args, parts) in [
        (&["export"][..], &["--to", "<SOURCE>"][..]),
        (&["new", "identify"], &["--from"]),
        (&["convert"], &["<INPUT>", "<OUTPUT>"]),
        (&["compare"], &["<FIRST>", "<SECOND>"]),
    ] {
        let (code, text) = said(tmp.path(), args);
        assert_eq!(code, 2, "{text}");
        parts.iter().for_each(|p| assert!(text.contains(p), "no `{p}` in {text}"));
    }
}
