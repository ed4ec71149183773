//! A job over seeds and points in parts: the same results however it is cut, who works, and who dies.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use dynocal_files::atomic;
use dynocal_numerics::watch::Watch;
use dynocal_studies::many::{self, How, JobStudy, Part, Replaced};
use dynocal_studies::{Check, Options, Study, StudyError, Surroundings, Task};
use serde_json::Value;

const SPEC: &str = "job = 'signal'\nseeds = { first = 3, count = 4 }\n\
    [values]\n'channels.0.signal.hi' = [1.0, 2.0, 5.0]\n\
    [spec]\nlength_s = 20.0\nsample_time_s = 0.1\n\
    [[spec.channels]]\nname = 'u'\nunit = 'V'\nsignal = { name = 'aprbs', lo = 0.0, hi = 1.0, hold_s = 0.5 }\n";

fn study(text: &str, out: &Path) -> JobStudy {
    let replaced = Replaced {
        over: dynocal_jobs::place::Overrides { seed: None, out: Some(out.into()) },
        ..Replaced::default()
    };
    many::parse("many.toml", text, &replaced).unwrap()
}

fn run(text: &str, out: &Path, how: &How) -> many::Left {
    let study = study(text, out);
    let batch = many::of_job(&study, Watch::silent()).unwrap();
    many::run(&batch, how, out, Watch::silent()).unwrap()
}

fn join(chunk_tasks: usize) -> How {
    How { chunk_tasks: Some(chunk_tasks), lease: Duration::from_millis(300), ..How::join() }
}

fn lines(out: &Path) -> Vec<Value> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(out.join("chunks")).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    let texts = files.iter().map(|f| fs::read_to_string(f).unwrap()).collect::<String>();
    texts.lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

/// What may not depend on how the work was cut.
fn results(out: &Path) -> [Vec<u8>; 3] {
    ["summary.json", "report.html", "results.parquet"].map(|f| fs::read(out.join(f)).unwrap())
}

#[test]
fn every_point_has_every_seed_and_the_cut_changes_nothing() {
    let tmp = tempfile::tempdir().unwrap();
    let (one, other) = (tmp.path().join("one"), tmp.path().join("other"));
    let ended = run(SPEC, &one, &join(1)).finished.unwrap();
    assert!(ended.written.valid, "{:?}", ended.written.verdict);
    run(SPEC, &other, &join(5));
    assert_eq!(
        (
            fs::read_dir(one.join("chunks")).unwrap().count(),
            fs::read_dir(other.join("chunks")).unwrap().count()
        ),
        (12, 3)
    );
    assert_eq!(lines(&one), lines(&other));
    assert_eq!(results(&one), results(&other));
    let found = lines(&one);
    for (k, line) in found.iter().enumerate() {
        assert_eq!(line["task"], k);
        assert_eq!(line["seed"], 3 + k % 4);
        assert_eq!(line["point"]["channels.0.signal.hi"], [1.0, 2.0, 5.0][k / 4]);
    }
    // A task is what the job alone gives for that seed and value.
    let alone = tmp.path().join("alone");
    let spec = study(SPEC, &one);
    let (point, seed) = spec.task(6);
    let text = toml::to_string(&spec.at(point).unwrap()).unwrap();
    let mut asked =
        dynocal_jobs::runs::Asked::of(dynocal_jobs::runs::Spec::Text { name: "many.toml".into(), text });
    asked.over = dynocal_jobs::place::Overrides { seed, out: Some(alone.clone()) };
    (dynocal_jobs::runs::find("signal").unwrap().run)(&asked, Watch::silent()).unwrap();
    let mut summary: Value = dynocal_files::json::read(&alone.join("summary.json")).unwrap();
    let parts = summary.as_object_mut().unwrap();
    parts.retain(|k, _| !["schema", "schema_version", "files"].contains(&k.as_str()));
    assert_eq!(found[6]["result"]["channels"], summary["channels"]);
    assert!(!one.join("work").exists() && fs::read_dir(one.join("claims")).unwrap().count() == 0);
}

#[test]
fn shards_of_separate_folders_come_together() {
    let tmp = tempfile::tempdir().unwrap();
    let whole = tmp.path().join("whole");
    run(SPEC, &whole, &join(2));
    let meeting = tmp.path().join("meeting");
    fs::create_dir_all(meeting.join("chunks")).unwrap();
    for index in 1..=3 {
        let part = tmp.path().join(format!("part{index}"));
        let left = run(SPEC, &part, &How { part: Part::Shard { index, of: 3 }, ..join(3) });
        // The plan may have done the first task for everybody.
        assert!(left.finished.is_none() && left.state.done == 4, "{}", left.state.done);
        for e in fs::read_dir(part.join("chunks")).unwrap() {
            let e = e.unwrap();
            fs::copy(e.path(), meeting.join("chunks").join(e.file_name())).unwrap();
        }
        if index == 1 {
            for file in ["run.json", "spec.json", "tasks.json"] {
                fs::copy(part.join(file), meeting.join(file)).unwrap();
            }
        }
    }
    let ended = run(SPEC, &meeting, &join(1));
    assert!(ended.finished.is_some());
    assert_eq!(lines(&meeting), lines(&whole));
    assert_eq!(results(&meeting), results(&whole));
}

/// Finished chunks are taken over: what a second run does is what is missing, and nothing else.
#[test]
fn what_is_there_is_not_done_again_and_a_damaged_chunk_is() {
    let tmp = tempfile::tempdir().unwrap();
    let whole = tmp.path().join("whole");
    run(SPEC, &whole, &join(3));
    let out = tmp.path().join("out");
    run(SPEC, &out, &How { part: Part::Shard { index: 1, of: 2 }, ..join(3) });
    // A line that was torn, and one of other inputs.
    let first = out.join("chunks/0000000000-0000000002.jsonl");
    let text = fs::read_to_string(&first).unwrap();
    atomic::write(&first, &text.as_bytes()[..text.len() - 20]).unwrap();
    let second = out.join("chunks/0000000003-0000000005.jsonl");
    let text = fs::read_to_string(&second).unwrap().replacen("\"digest\":\"", "\"digest\":\"0", 1);
    atomic::write(&second, text.as_bytes()).unwrap();
    let left = run(SPEC, &out, &join(3));
    assert!(left.finished.is_some());
    assert_eq!(results(&out), results(&whole));
    let damaged = fs::read_dir(out.join("chunks"))
        .unwrap()
        .filter(|e| e.as_ref().unwrap().path().extension().is_some_and(|x| x == "damaged"));
    assert_eq!(damaged.count(), 2);
    // Removing one chunk is asking for it again, and the end comes anew.
    fs::remove_file(&second).unwrap();
    run(SPEC, &out, &join(3));
    assert!(second.exists());
    assert_eq!(results(&out), results(&whole));
}

#[test]
fn workers_that_join_share_and_one_that_died_is_replaced() {
    let tmp = tempfile::tempdir().unwrap();
    let (whole, out) = (tmp.path().join("whole"), tmp.path().join("out"));
    run(SPEC, &whole, &join(1));
    // What a worker that was killed leaves: a claim that nobody touches, and half a file.
    let spec = study(SPEC, &out);
    let batch = many::of_job(&spec, Watch::silent()).unwrap();
    many::plan(&batch, &join(1), &out, Watch::silent()).unwrap();
    atomic::write(&out.join("claims/0000000007-0000000007"), b"dead").unwrap();
    atomic::write(&out.join("chunks/.0000000007-0000000007.jsonl.x.tmp"), b"{").unwrap();
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| run(SPEC, &out, &join(1)));
        }
    });
    assert_eq!(results(&out), results(&whole));
    assert_eq!(lines(&out), lines(&whole));
    let names =
        fs::read_dir(out.join("chunks")).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    assert!(names.into_iter().all(|n| !n.ends_with(".tmp")));
    // Every chunk was begun once but the dead one at most twice: claims work.
    let logs =
        fs::read_dir(out.join("workers")).unwrap().map(|e| fs::read_to_string(e.unwrap().path()).unwrap());
    let text = logs.collect::<String>();
    let begun = text.lines().filter(|l| l.contains("from_s")).count();
    assert!((12..=13).contains(&begun), "{begun}");
}

#[test]
fn a_task_that_cannot_be_done_is_a_result_and_the_others_go_on() {
    let tmp = tempfile::tempdir().unwrap();
    let out = tmp.path().join("out");
    // At the third point the bounds are reversed.
    let text = SPEC.replace("[1.0, 2.0, 5.0]", "[1.0, 2.0, -5.0]");
    let ended = run(&text, &out, &join(4)).finished.unwrap();
    assert!(!ended.written.valid);
    let found = lines(&out);
    assert!(found[..8].iter().all(|l| l["status"] == "done"));
    assert!(
        found[8..].iter().all(|l| l["status"] == "failed" && l["error"].as_str().unwrap().contains("lo")),
        "{}",
        found[8]
    );
    assert!(ended.written.verdict.join(" ").contains("4 could not be done"), "{:?}", ended.written.verdict);
    let page = fs::read_to_string(ended.report).unwrap();
    assert!(page.contains("8 of 12 runs of signal are valid"));
}

#[test]
fn a_folder_of_other_tasks_is_refused_and_an_interrupted_one_goes_on() {
    let tmp = tempfile::tempdir().unwrap();
    let (out, whole) = (tmp.path().join("out"), tmp.path().join("whole"));
    let spec = study(SPEC, &out);
    let batch = many::of_job(&spec, Watch::silent()).unwrap();
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let stop = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) > 30;
    let stopped = many::run(&batch, &join(1), &out, Watch { interrupt: &stop, ..Watch::silent() });
    assert!(matches!(stopped, Err(StudyError::Interrupted)));
    let kept = fs::read_dir(out.join("chunks")).unwrap().count();
    assert!((1..12).contains(&kept), "{kept}");
    assert!(!out.join("summary.json").exists());
    let other = study(&SPEC.replace("count = 4", "count = 5"), &out);
    let other = many::of_job(&other, Watch::silent()).unwrap();
    let refused = many::run(&other, &join(1), &out, Watch::silent());
    assert!(matches!(refused, Err(StudyError::OtherTasks { .. })));
    run(SPEC, &out, &join(1));
    run(SPEC, &whole, &join(1));
    assert_eq!(results(&out), results(&whole));
}

#[test]
fn faults_name_key_found_and_expected() {
    let cases = [
        ("job = 'x'\n[spec]\n", "`job`", "one of identify"),
        ("[spec]\n", "`job`", "identify"),
        ("job = 'signal'\n", "`spec`", "a file, or a table"),
        ("job = 'signal'\nspec = 'no.toml'\n", "no.toml", "a file of TOML"),
        ("job = 'signal'\nspec = 3\n", "found 3", "a file, or a table"),
        ("job = 'signal'\nseeds = [1, 1]\n[spec]\n", "`seeds`", "each once"),
        (
            "job = 'signal'\nseeds = { first = 1, count = -2 }\n[spec]\n",
            "`seeds`",
            "{ first = 1, count = 200 }",
        ),
        ("job = 'signal'\nseeds = []\n[spec]\n", "`seeds`", "whole numbers"),
        ("job = 'signal'\nchunk_tasks = 0\n[spec]\n", "`chunk_tasks`", "1 or more"),
        ("job = 'signal'\n[values]\na = []\n[spec]\n", "values.a", "at least one value"),
        ("job = 'signal'\n[values]\n'a.b' = [1]\n[spec]\n", "found no table `a`", "keys of the job's spec"),
        (
            "job = 'signal'\n[values]\n'a.3' = [1]\n[spec]\na = [1]\n",
            "expected a place from 0 in the 1",
            "keys of the job's spec",
        ),
        ("job = 'signal'\npoints = [{ a = 1 }, { b = 1 }]\n[spec]\n", "`points`", "the same keys"),
        ("job = 'signal'\npoints = []\n[spec]\n", "`points`", "at least one point"),
        ("job = 'signal'\nseads = [1]\n[spec]\n", "seads", "did you mean `seeds`"),
    ];
    for (text, found, expected) in cases {
        let said = many::parse("s.toml", text, &Replaced::default()).unwrap_err().to_string();
        assert!(said.contains("s.toml") && said.contains(found) && said.contains(expected), "{text}\n{said}");
    }
    // Faults of the job's own spec are found before anything is written.
    let tmp = tempfile::tempdir().unwrap();
    let out = tmp.path().join("out");
    let bad = study(&SPEC.replace("length_s = 20.0\n", ""), &out);
    let said = many::of_job(&bad, Watch::silent()).err().unwrap().to_string();
    assert!(said.contains("length_s") && !out.exists(), "{said}");
}

/// A study as those of the table, quick: squares, and their sum as its check.
static SQUARES: Study = Study {
    doc: dynocal_numerics::registry::MemberDoc { name: "squares", what: "squares of numbers", params: &[] },
    tasks: |options| (0..7).map(|k| square(k + options.seed)).collect(),
    reduce: |results| {
        let sum: f64 = results.iter().filter_map(|r| r.value.as_f64()).sum();
        vec![Check {
            id: "sum".into(),
            what: "sum of squares".into(),
            asked: Some("= 140".into()),
            measured: Some(sum),
            unit: "-",
            holds: Some(sum == 140.0),
            note: results.iter().map(|r| r.name.as_str()).collect::<Vec<_>>().join(" "),
        }]
    },
    sections: |report, _| report,
};

fn square(k: u64) -> Task {
    let run = move |_: &Surroundings| Ok(Value::from((k * k) as f64));
    Task { name: format!("square-{k}"), inputs: k.into(), run: Box::new(run) }
}

/// A study of many tasks in parts is the study, by files and checks: 1 + 4 + .. + 49 = 140.
#[test]
fn a_study_in_parts_is_the_study() {
    let tmp = tempfile::tempdir().unwrap();
    let (alone, parts) = (tmp.path().join("alone"), tmp.path().join("parts"));
    let options = Options { seed: 1, reduced: false, reference: None, data: None };
    dynocal_studies::run(&SQUARES, &options, &alone, Watch::silent()).unwrap();
    let batch = many::of_study(&SQUARES, &options).unwrap();
    let half = How { part: Part::Shard { index: 2, of: 2 }, ..join(2) };
    assert!(many::run(&batch, &half, &parts, Watch::silent()).unwrap().finished.is_none());
    let left = many::run(&batch, &join(2), &parts, Watch::silent()).unwrap();
    let ended = left.finished.unwrap();
    assert!(ended.written.valid && ended.written.checks[0].measured == Some(140.0));
    for file in ["summary.json", "report.html"] {
        assert_eq!(fs::read(alone.join(file)).unwrap(), fs::read(parts.join(file)).unwrap(), "{file}");
    }
}
