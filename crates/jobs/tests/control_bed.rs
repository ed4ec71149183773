//! The job `control` where it makes its own tests, decouples loops, and meets plants that are not what textbooks have.

use std::path::Path;

use dynocal_jobs::control::{Controlled, run, spec, work};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

fn parsed(text: &str, folder: &Path) -> Result<spec::Job, String> {
    let file = folder.join("spec.toml");
    let over = Overrides { seed: None, out: Some(folder.join("run")) };
    spec::parse(&file.display().to_string(), text, &over).map_err(|e| e.to_string())
}

fn tried(text: &str, folder: &Path) -> Result<Controlled, String> {
    work::control(&parsed(text, folder)?, Watch::silent()).map_err(|e| e.to_string())
}

const ENGINE: &str = "draws = 4\n[plant]\nname = \"virtual_engine\"\nparameters = \"pfi_1_6l\"\n";
const LOOPS: &str = "[[loops]]\noutput = \"torque\"\ninput = \"throttle\"\nstep = 0.6\nkp = 0.2\nki = 0.7\n\
[[loops]]\noutput = \"lambda\"\ninput = \"inj\"\nstep = 0.5\nkp = -4.0\nki = -20.0\n";

/// No record of the user's: all four tests about the same point give the same plant, and the multisine tells what bends.
#[test]
fn tests_on_the_bed_give_one_plant() {
    let tmp = tempfile::tempdir().unwrap();
    let lambda = "[[loops]]\noutput = \"lambda\"\ninput = \"inj\"\nstep = 0.5\nkp = -4.0\nki = -20.0\n";
    let engine = ENGINE.replace("draws = 4", "draws = 0");
    for kind in ["levels", "multisine", "chirp", "steps"] {
        let text = format!(
            "{engine}[test]\nkind = \"{kind}\"\nlength_s = 30.0\nsettle_s = 5.0\nhighest_hz = 4.0\n{lambda}"
        );
        let (own, folder) = run(&parsed(&text, tmp.path()).unwrap(), Watch::silent()).unwrap();
        assert_eq!(own.points, ["start"]);
        // Lambda goes with one over the fuel: -1 over the 12.5 mg of the start.
        let steady = own.loops[0].lags[0].map_or(f64::NAN, |l| l.gain * own.loops[0].sign);
        assert!((steady * 12.5 + 1.0).abs() < 0.2, "{kind}: {steady}");
        let shown = &own.measured[0].distortion;
        assert_eq!(shown.iter().flatten().count(), usize::from(kind == "multisine"), "{kind}");
        let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
        assert_eq!(page.contains("Odd distortion over the excited lines"), kind == "multisine");
        assert!(own.controller.is_some());
    }
}

/// Steps of one input after the other: each model explains both of its inputs. The gain margin of torque that is measured lies below what its
/// model promises, with all of its interval: what asks for one between them is refused.
#[test]
fn a_measured_margin_refuses_what_its_model_promises() {
    let tmp = tempfile::tempdir().unwrap();
    let loops = "[[loops]]\noutput = \"torque\"\ninput = \"throttle\"\nstep = 1.0\nkp = 0.2249\nki = 0.4393\n\
        [[loops]]\noutput = \"lambda\"\ninput = \"inj\"\nstep = 0.3\nkp = -6.184\nki = -26.38\n";
    let of = |gain_margin: f64| {
        let text = format!(
            "seed = 3\n[plant]\nname = \"virtual_engine\"\nparameters = \"pfi_1_6l\"\n[test]\nlength_s = 60.0\nkind = \"steps\"\n\
             [asked]\ngain_margin = {gain_margin:?}\n[[points]]\nname = \"P\"\nvalues = {{ speed = 2000.0 }}\n{loops}"
        );
        tried(&text, tmp.path()).unwrap()
    };
    let own = of(2.0);
    assert!(own.valid && own.measured[0].models.iter().all(|m| m.1 > 90.0), "{:?}", own.verdict);
    let asked = 0.5
        * (own.measured[0].margins[0].gain_up.unwrap().1
            + own.loops[0].rules[0].margins[0].as_ref().unwrap().gain_up.unwrap());
    let more = of(asked);
    assert!(more.together[0].violation.unwrap() <= 1.0, "{:?}", more.verdict);
    assert!(!more.valid && more.verdict[0].contains("as it was measured"), "{:?}", more.verdict);
}

#[test]
fn tests_that_cannot_be_made_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let with = |test: &str, loops: &str| {
        tried(&format!("{ENGINE}{test}{loops}"), tmp.path()).map(|_| ()).unwrap_err()
    };
    let point = |name: &str, v: f64| format!("[[points]]\nvalues = {{ {name} = {v:?} }}\n");
    for (test, loops, part) in [
        ("[test]\nlength_s = 1.0\n".to_string(), LOOPS.to_string(), "test.length_s"),
        ("[test]\nhighest_hz = 30.0\n".into(), LOOPS.into(), "0.4 of the sampling frequency"),
        ("[test]\nkind = \"noise\"\n".into(), LOOPS.into(), "multisine"),
        (String::new(), LOOPS.replace("step = 0.5\n", ""), "loops[2].step"),
        (String::new(), LOOPS.replace("step = 0.5", "step = 1e9"), "its range is"),
        (String::new(), LOOPS.replace("\"inj\"", "\"fuel\""), "the plant has no input `fuel`"),
        (String::new(), LOOPS.replace("\"torque\"", "\"power\""), "the plant has no output `power`"),
        (
            "[test]\nlength_s = 60.0\n".into(),
            LOOPS.replace("step = 0.5", "step = 0.5\nextra_delay_s = 100.0"),
            "less than the test lasts",
        ),
        (point("gear", 3.0), LOOPS.into(), "the plant has no input `gear`"),
        ("models = [\"m.json\"]\n".into(), String::new(), "models"),
    ] {
        let said = with(&test, &loops);
        assert!(said.contains(part), "{part}: {said}");
    }
    let bed = format!("[plant]\nname = \"bed\"\n{LOOPS}");
    assert!(tried(&bed, tmp.path()).unwrap_err().contains("a plant that answers"));
    let none = "[[loops]]\noutput = \"y\"\ninput = \"u\"\nstep = 1.0\n[[plants]]\nchannels = [[{ num = [1.0], den = [4.0, 1.0] }]]\n";
    assert!(tried(none, tmp.path()).unwrap_err().contains("[plant]"));
}

/// Two loops that act on each other strongly; the second input reaches the first output sooner than the first one does.
const COUPLED: &str = "sample_time_s = 0.1\n[[loops]]\noutput = \"a\"\ninput = \"u\"\n[[loops]]\noutput = \"b\"\ninput = \"v\"\n\
[[plants]]\nchannels = [[{ num = [0.0, 0.0, 0.2], den = [1.0, -0.8] }, { num = [0.0, 0.06], den = [1.0, -0.9] }], [{ num = [0.0, 0.0, 0.0, 0.06], den = [1.0, -0.85] }, { num = [0.0, 0.15], den = [1.0, -0.7] }]]\n";

/// A decoupler leaves each output its own demand at rest, and with it what is promised is what runs do.
#[test]
fn decoupled_loops_keep_what_is_asked() {
    let tmp = tempfile::tempdir().unwrap();
    let of = |kind: &str| {
        let (own, folder) =
            run(&parsed(&format!("{kind}{COUPLED}"), tmp.path()).unwrap(), Watch::silent()).unwrap();
        assert!(
            own.valid && !own.checks.is_empty() && own.checks.iter().all(|c| c.holds),
            "{kind}: {:?}",
            own.verdict
        );
        let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
        assert_eq!(page.contains("The decoupler"), !kind.is_empty());
        own
    };
    let (plain, fixed, filtered) = (of(""), of("decoupler = \"static\"\n"), of("decoupler = \"dynamic\"\n"));
    assert!(plain.decoupler.is_none() && plain.controller.is_some());
    for own in [&fixed, &filtered] {
        let d = own.decoupler.as_ref().unwrap();
        assert!(d.left[0].0 > 0.5, "{:?}", d.left);
        assert!(own.controller.is_none());
    }
    assert!(fixed.decoupler.as_ref().unwrap().left[0].1 < 1e-12);
    assert!(filtered.decoupler.as_ref().unwrap().left[0].1 < 0.01);
    let failed = |text: &str| parsed(text, tmp.path()).map(|_| ()).unwrap_err();
    assert!(failed(&format!("taps = 5\n{COUPLED}")).contains("dynamic"));
    assert!(failed(&format!("decoupler = \"dynamic\"\ntaps = 0\n{COUPLED}")).contains("1 to 200"));
    let one = "decoupler = \"static\"\n[[loops]]\noutput = \"y\"\ninput = \"u\"\n[[plants]]\nchannels = [[{ num = [1.0], den = [4.0, 1.0] }]]\n";
    assert!(failed(one).contains("two loops at least"));
    // Rows that do the same have no decoupler.
    let twin = "{ num = [0.0, 0.2], den = [1.0, -0.8] }";
    let singular = format!(
        "decoupler = \"static\"\n{}[[plants]]\nchannels = [[{twin}, {twin}], [{twin}, {twin}]]\n",
        COUPLED.split("[[plants]]").next().unwrap()
    );
    assert!(tried(&singular, tmp.path()).unwrap_err().contains("singular"));
    // Nor have they loops without one: said with the set point.
    let plain = singular
        .replace("decoupler = \"static\"\n", "")
        .replace("[[plants]]\n", "[[plants]]\nname = \"low\"\n");
    let said = tried(&plain, tmp.path()).map(|_| ()).unwrap_err();
    assert!(said.contains("low") && said.contains("always move together"), "{said}");
}

/// Integrators, inverse responses of either sign, no delay and a hundred samples of it: gains that keep what is asked; what runs away by
/// itself is refused.
#[test]
fn plants_that_are_not_lags() {
    let tmp = tempfile::tempdir().unwrap();
    let of = |time: &str, channel: &str| {
        tried(
            &format!(
                "{time}[[loops]]\noutput = \"y\"\ninput = \"u\"\n[[plants]]\nchannels = [[{channel}]]\n"
            ),
            tmp.path(),
        )
    };
    for (time, channel, sign) in [
        ("", "{ num = [1.0], den = [1.0, 0.0], delay_s = 1.0 }", 1.0),
        ("", "{ num = [-2.0, 1.0], den = [1.0, 2.0, 1.0] }", 1.0),
        ("", "{ num = [2.0, -1.0], den = [1.0, 2.0, 1.0] }", -1.0),
        ("", "{ num = [1.0], den = [1.0, 1.0] }", 1.0),
        ("sample_time_s = 0.02\n", "{ num = [0.0, -0.1], den = [1.0, -0.9] }", -1.0),
        ("sample_time_s = 0.02\n", "{ num = [0.0, 0.1], den = [1.0, -0.9], delay_s = 2.0 }", 1.0),
    ] {
        let own = of(time, channel).unwrap();
        assert!(own.valid, "{channel}: {:?}", own.verdict);
        assert!(own.loops[0].ki * sign > 0.0, "{channel}: {}", own.loops[0].ki);
        assert!(own.checks.iter().all(|c| c.holds), "{channel}: {:?}", own.checks);
    }
    for (time, channel) in [
        ("", "{ num = [1.0], den = [1.0, -1.0] }"),
        ("sample_time_s = 0.02\n", "{ num = [0.0, 0.1], den = [1.0, -1.1] }"),
    ] {
        let said = of(time, channel).map(|_| ()).unwrap_err();
        assert!(said.contains("unstable by itself") && said.contains("plant 1"), "{said}");
    }
}

/// A gap in a record and a channel that it does not have are named.
#[test]
fn records_with_gaps_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let mut rng = Rng64::new(3);
    let mut text = "time,u,y\ns,V,Nm\n".to_string();
    for t in 0..800 {
        let y = if t == 400 { String::new() } else { format!("{}", rng.normal()) };
        text.push_str(&format!("{},{},{y}\n", 0.1 * f64::from(t), rng.normal()));
    }
    dynocal_files::atomic::write(&tmp.path().join("gap.csv"), text.as_bytes()).unwrap();
    let of = |input: &str| {
        tried(
            &format!("records = [\"gap.csv\"]\n[[loops]]\noutput = \"y\"\ninput = \"{input}\"\n"),
            tmp.path(),
        )
        .map(|_| ())
        .unwrap_err()
    };
    let said = of("u");
    assert!(said.contains("gap.csv") && said.contains('y'), "{said}");
    let said = of("w");
    assert!(said.contains("gap.csv") && said.contains('w'), "{said}");
}

/// A channel whose sign its own draws do not agree about is told so, and not as two set points that differ.
#[test]
fn a_sign_that_a_test_does_not_tell_is_named() {
    let tmp = tempfile::tempdir().unwrap();
    let text = "[plant]\nname = \"virtual_engine\"\n[test]\nlength_s = 240.0\n\
[[loops]]\noutput = \"torque\"\ninput = \"throttle\"\nstep = 1.0\n\
[[loops]]\noutput = \"lambda\"\ninput = \"spark\"\nstep = 1.0\n";
    let refused = tried(text, tmp.path()).map(|_| ()).unwrap_err();
    assert!(refused.contains("start: ") && refused.contains("is not known"), "{refused}");
}
