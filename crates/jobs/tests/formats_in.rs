//! What jobs take from measurement files: experiments cut from long records, records in any format.

use std::fmt::Write as _;
use std::path::Path;

use dynocal_files::atomic;
use dynocal_ident::validate::Kind;
use dynocal_jobs::design;
use dynocal_jobs::identify::job;
use dynocal_jobs::identify::result::Identified;
use dynocal_jobs::identify::spec::{self, Overrides};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

const CHANNELS: &str = "[[channels]]\ncolumn = 'u'\nunit = 'mg'\nrole = 'input'\n\
    [[channels]]\ncolumn = 'y'\nunit = 'Nm'\nrole = 'output'\n\
    [split]\nfractions = [0.7, 0.3]\n\
    [model]\nstructure = { name = 'arx', na = 1, nb = 1 }\nestimator = { name = 'ols' }\n";

/// Three experiments of y(t) = 0.5 + 0.8 y(t-1) + 2 u(t-1) that begin where they like, 200 rows each, with pauses of 5 s and 40
/// rows of nonsense between, in which the trigger is off.
fn long_record() -> String {
    let mut rng = Rng64::new(7);
    let mut text = String::from("time [s],u [mg],y [Nm],run\n");
    let mut k = 0;
    for experiment in 0..3 {
        let mut y = 10.0 * f64::from(experiment);
        for _ in 0..200 {
            let u = rng.uniform_in(-1.0, 1.0);
            writeln!(text, "{},{u},{y},1", f64::from(k) * 0.1 + 5.0 * f64::from(experiment)).unwrap();
            y = 0.5 + 0.8 * y + 2.0 * u;
            k += 1;
        }
        for _ in 0..40 {
            let (u, y) = (rng.uniform_in(-9.0, 9.0), rng.uniform_in(-99.0, 99.0));
            writeln!(text, "{},{u},{y},0", f64::from(k) * 0.1 + 5.0 * f64::from(experiment)).unwrap();
            k += 1;
        }
    }
    text
}

fn identify(folder: &Path, data: &str) -> Result<Identified, String> {
    let path = folder.join("spec.toml");
    atomic::write(&path, format!("[data]\nfile = 'bed.csv'\n{data}{CHANNELS}").as_bytes()).unwrap();
    let over = Overrides { out: Some(folder.join("run")), ..Overrides::default() };
    let job = spec::read(&path, &over).map_err(|e| e.to_string())?;
    job::run(&job, Watch::silent()).map(|found| found.0).map_err(|e| e.to_string())
}

fn worst(found: &Identified) -> f64 {
    let one = found.scores.iter().filter(|s| s.kind == Kind::OneStep);
    one.map(|s| s.rmse.unwrap()).fold(0.0, f64::max)
}

/// Cut at the trigger the records are exactly the system; whole they are not, and that is no fault of the fit.
#[test]
fn identify_cuts_at_a_trigger_and_at_pauses() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("bed.csv"), long_record().as_bytes()).unwrap();
    let whole = identify(tmp.path(), "sample_time_s = 0.1\n").unwrap();
    assert!(worst(&whole) > 1.0, "{}", worst(&whole));
    let cut =
        identify(tmp.path(), "sample_time_s = 0.1\ncut = { trigger = 'run', above = 0.5, shortest = 50 }\n")
            .unwrap();
    assert!(worst(&cut) < 1e-9, "{}", worst(&cut));
    let said = serde_json::to_string(&cut).unwrap();
    assert!(said.contains("cut where `run` is above 0.5: 3 experiments, 600 of 720 rows"), "{said}");
    // By the stamps alone: three records, each with its nonsense; the jumps of the time are no samples any more.
    let refused = identify(tmp.path(), "time = 'time'\n").unwrap_err();
    assert!(refused.contains("time stamps must be uniform"), "{refused}");
    let pauses = identify(tmp.path(), "time = 'time'\ncut = { gap_s = 1.0 }\n").unwrap();
    let said = serde_json::to_string(&pauses).unwrap();
    assert!(said.contains("cut at pauses of `time` over 1 s: 3 experiments, 720 of 720 rows"), "{said}");
}

#[test]
fn faults_of_a_cut_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("bed.csv"), long_record().as_bytes()).unwrap();
    for (keys, parts) in [
        ("cut = { gap_s = 1.0 }\n", &["data.cut.gap_s", "data.time"][..]),
        ("cut = { trigger = 'run' }\n", &["data.cut", "trigger and above"]),
        ("cut = { trigger = 'run', above = 0.5, gap_s = 1.0 }\n", &["data.cut", "another combination"]),
        ("cut = { triger = 'run', above = 0.5 }\n", &["data.cut.triger", "did you mean `trigger`?"]),
        ("cut = { trigger = 'ran', above = 0.5 }\n", &["no column `ran`"]),
        ("cut = { trigger = 'run', above = 2.0 }\n", &["`run` is above 2", "no experiment is left"]),
    ] {
        let e = identify(tmp.path(), &format!("sample_time_s = 0.1\n{keys}")).unwrap_err();
        assert!(parts.iter().all(|p| e.contains(p)), "{parts:?} in {e}");
    }
}

const DESIGN: &str = "length_s = 3.0\nsample_time_s = 0.1\n\
    [[channels]]\nname = 'fpw'\nunit = 'us'\nlower = 2000.0\nupper = 6000.0\n\
    [[channels]]\nname = 'abv'\nunit = '-'\nlower = 0.4\nupper = 0.6\n\
    [[channels]]\nname = 'speed'\nunit = 'rpm'\nlower = 1000.0\nupper = 2000.0\n";

/// Two earlier records in one file with a pause are worth what they are in two files.
#[test]
fn design_takes_the_experiments_of_a_long_record() {
    let tmp = tempfile::tempdir().unwrap();
    let mut rng = Rng64::new(3);
    let head = "time [s],pulse [us],abv [-],speed [rpm]\n";
    let (mut all, mut parts) = (String::from(head), Vec::new());
    for k in 0..2 {
        let mut part = String::from(head);
        for t in 0..60 {
            let (fpw, abv) = (rng.uniform_in(2000.0, 6000.0), rng.uniform_in(0.4, 0.6));
            let rest = format!("{fpw},{abv},{}\n", rng.uniform_in(1000.0, 2000.0));
            write!(part, "{},{rest}", f64::from(t) * 0.1).unwrap();
            write!(all, "{},{rest}", f64::from(t + 600 * k) * 0.1).unwrap();
        }
        parts.push(part);
    }
    for (name, text) in [("all.csv", &all), ("a.csv", &parts[0]), ("b.csv", &parts[1])] {
        atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap();
    }
    let prior = |files: &str, records: &str| {
        let path = tmp.path().join("plan.toml");
        let model = format!("[[models]]\nliterature = 'torque_4_17'\ncriterion = 'd'\nprior = [{files}]\n");
        atomic::write(
            &path,
            format!("{DESIGN}{model}[records]\nalias = {{ fpw = ['pulse'] }}\n{records}").as_bytes(),
        )
        .unwrap();
        let job = design::read(&path, &Default::default()).map_err(|e| e.to_string())?;
        let found = design::load::load(&job).map_err(|e| e.to_string())?;
        Ok::<_, String>((found.models[0].prior.clone(), found.notes))
    };
    let (two, _) = prior("'a.csv', 'b.csv'", "").unwrap();
    let (one, notes) = prior("'all.csv'", "cut = { gap_s = 0.15 }\n").unwrap();
    assert!(!two.is_empty());
    assert_eq!(one, two);
    assert!(notes.iter().any(|n| n.contains("column `pulse` is taken as `fpw`")), "{notes:?}");
    assert!(notes.iter().any(|n| n.contains("2 experiments, 120 of 120 rows")), "{notes:?}");
    let refused = prior("'all.csv'", "").unwrap_err();
    assert!(refused.contains("time stamps must be uniform"), "{refused}");
}
