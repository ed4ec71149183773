//! The job `control`: equal to closed forms, equal between a stored model and its transfer function, bad input named.

use std::path::Path;

use dynocal_files::json;
use dynocal_ident::model::initial::Initial;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Quantity, Seen, StoredModel};
use dynocal_jobs::control::{Controlled, run, spec, work};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::watch::Watch;

fn parsed(text: &str, folder: &Path) -> Result<spec::Job, String> {
    let file = folder.join("spec.toml");
    let over = Overrides { seed: None, out: Some(folder.join("run")) };
    spec::parse(&file.display().to_string(), text, &over).map_err(|e| e.to_string())
}

fn found(text: &str, folder: &Path) -> Controlled {
    work::control(&parsed(text, folder).unwrap(), Watch::silent()).unwrap()
}

const LAG: &str = "[[loops]]\noutput = \"y\"\ninput = \"u\"\n";

/// e^-s / (4 s + 1) with given SIMC gains: the closed forms of the loop 0.5 e^-s / s.
#[test]
fn given_gains_are_judged_as_they_are() {
    let tmp = tempfile::tempdir().unwrap();
    let plant = "[[plants]]\nchannels = [[{ num = [1.0], den = [4.0, 1.0], delay_s = 1.0 }]]\n";
    let asked = "[asked]\nsensitivity = 1.6\n";
    let own = found(&format!("{asked}{LAG}kp = 2.0\nki = 0.5\n{plant}"), tmp.path());
    let m = &own.together[0].loops[0];
    assert!(
        (m.gain_up.unwrap() - std::f64::consts::PI).abs() < 1e-6 && (m.sensitivity - 1.590490).abs() < 1e-6
    );
    assert!(own.valid && own.verdict[0].contains("keep"), "{:?}", own.verdict);
    assert!(own.checks.iter().all(|c| c.holds), "{:?}", own.checks);
    // pi/2 - 1/2 rad; pi - 1 s of delay: each margin that is told is run on both sides of itself.
    assert!((m.phase_deg.unwrap() - 61.3521).abs() < 1e-4 && own.unchecked.is_empty(), "{:?}", own.unchecked);
    for what in [
        "gain margin",
        "phase margin",
        "delay margin",
        "disk margin at",
        "disk margin of S",
        "disk margin of T",
    ] {
        let of: Vec<bool> =
            own.checks.iter().filter(|c| c.what.starts_with(what)).map(|c| c.expected_stable).collect();
        assert_eq!(of, [true, false], "{what}: {:?}", own.checks);
    }
    // The same without the margin that it lacks.
    let refused = found(&format!("[asked]\nsensitivity = 1.5\n{LAG}kp = 2.0\nki = 0.5\n{plant}"), tmp.path());
    assert!(!refused.valid && refused.verdict[0].contains("must not be used"), "{:?}", refused.verdict);
    // Gains past the boundary of stability have no margins, and the set point is named.
    let unstable = found(&format!("{LAG}kp = 8.0\nki = 0.5\n{plant}"), tmp.path());
    assert!(!unstable.valid && unstable.warnings[0].contains("plant 1"), "{:?}", unstable.warnings);
    // What no PI can do is said with the best there is.
    let slow = found(&format!("[asked]\nsettling_s = 0.5\n{LAG}{plant}"), tmp.path());
    assert!(!slow.valid && slow.verdict[0].contains("no PI"), "{:?}", slow.verdict);
    assert!(slow.together[0].violation.unwrap() <= 1.0);
    // Any margin is kept by a controller that does nothing, which is no use.
    let idle = found(&format!("[asked]\ndelay_margin_s = 1e6\n{LAG}{plant}"), tmp.path());
    assert!(!idle.valid && idle.verdict[0].contains("next to nothing"), "{:?}", idle.verdict);
}

/// A delay that is a slip of units is refused before anything is searched: margins over it would take hours.
#[test]
fn a_delay_of_ten_thousand_lags_is_refused() {
    let tmp = tempfile::tempdir().unwrap();
    let text = |delay: f64| {
        format!("{LAG}[[plants]]\nchannels = [[{{ num = [1.0], den = [4.0, 1.0], delay_s = {delay:.1} }}]]\n")
    };
    let job = parsed(&text(1e6), tmp.path()).unwrap();
    let e = work::control(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string();
    assert!(
        e.contains("plant 1") && e.contains("times its shortest lag") && e.contains("unit of its delay"),
        "{e}"
    );
    assert!(found(&text(40.0), tmp.path()).valid);
}

/// A stored model about a set point is its transfer function, preparation and all; the page is written.
#[test]
fn a_stored_model_is_its_transfer_function() {
    let tmp = tempfile::tempdir().unwrap();
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    // y(t) = 0.8 y(t-1) + 0.02 u(t-2)^2: about u = 5 the gain is 0.2.
    let structure = PolyNarx::parse(&["u"], "y", &["u(t-2)*u(t-2)", "y(t-1)"]).unwrap();
    let mut model =
        StoredModel::new(structure, &[0.02, 0.8], vec![quantity("u", "V")], quantity("y", "Nm"), 0.1)
            .unwrap();
    model.initial = Some(Initial::Rest);
    json::write_versioned(&tmp.path().join("model.json"), MODEL_SCHEMA, MODEL_VERSION, &model).unwrap();
    let gains = "kp = 0.8\nki = 1.5\n";
    let stored = format!(
        "models = [\"model.json\"]\ndraws = 3\n{LAG}{gains}[[points]]\nname = \"five\"\nvalues = {{ u = 5.0 }}\n"
    );
    let job = parsed(&stored, tmp.path()).unwrap();
    let (own, folder) = run(&job, Watch::silent()).unwrap();
    let given = format!(
        "sample_time_s = 0.1\n{LAG}{gains}[[plants]]\nchannels = [[{{ num = [0.0, 0.0, 0.2], den = [1.0, -0.8] }}]]\n"
    );
    let other = found(&given, tmp.path());
    let (a, b) = (&own.together[0].loops[0], &other.together[0].loops[0]);
    let close = |x: f64, y: f64| assert!((x / y - 1.0).abs() < 1e-6, "{x} {y}");
    close(a.gain_up.unwrap(), b.gain_up.unwrap());
    close(a.phase_deg.unwrap(), b.phase_deg.unwrap());
    close(a.sensitivity, b.sensitivity);
    assert!(own.warnings.iter().any(|w| w.contains("covariance")), "{:?}", own.warnings);
    assert!(folder.path().join("report.html").exists() && folder.path().join("summary.json").exists());
}

/// Draws that are unstable by themselves are no plant that came to rest in a test: left out, counted, and the rest is judged.
#[test]
fn draws_that_run_away_are_left_out_and_counted() {
    let tmp = tempfile::tempdir().unwrap();
    let quantity = |name: &str| Quantity { name: name.into(), unit: "-".into() };
    let structure = PolyNarx::parse(&["u"], "y", &["u(t-2)", "y(t-1)"]).unwrap();
    let mut model =
        StoredModel::new(structure, &[0.1, 0.95], vec![quantity("u")], quantity("y"), 0.1).unwrap();
    model.initial = Some(Initial::Rest);
    model.parameters[0].std_error = Some(0.001);
    model.parameters[1].std_error = Some(0.04);
    model.correlate(&[1e-6, 0.0, 0.0, 0.0016]);
    // Where an output was seen says whether a point was visited: its rest at u = 1 is 2.
    let seen = |maximum: f64| Seen { name: "y".into(), unit: "Nm".into(), minimum: -1.0, maximum };
    let mut of = |maximum: f64| {
        model.seen = vec![seen(maximum)];
        json::write_versioned(&tmp.path().join("model.json"), MODEL_SCHEMA, MODEL_VERSION, &model).unwrap();
        let point = "[[points]]\nname = \"one\"\nvalues = { u = 1.0 }\n";
        found(&format!("models = [\"model.json\"]\ndraws = 40\n{LAG}{point}"), tmp.path())
    };
    let own = of(3.0);
    let t = &own.together[0];
    // The pole is above one in a draw of ten.
    assert!(t.draws < 40 && t.draws > 25 && t.unstable_draws == 0, "{} {}", t.draws, t.unstable_draws);
    let said = format!("{} of 40 draws of the parameters", 40 - t.draws);
    assert!(own.warnings.iter().any(|w| w.contains(&said) && w.contains("left out")), "{:?}", own.warnings);
    assert!(own.verdict[0].contains(&format!("for {} draws", t.draws)), "{:?}", own.verdict);
    assert!(own.beyond.is_empty());
    let beyond = of(1.0);
    assert_eq!(beyond.beyond, ["one"]);
    assert!(
        beyond.warnings.iter().any(|w| w.contains("comes to rest at 2.0000 Nm")),
        "{:?}",
        beyond.warnings
    );
    assert!(beyond.verdict.iter().any(|v| v.contains("no record was there")), "{:?}", beyond.verdict);
}

/// Outputs that nearly move together: each loop alone settles in a second, both together need minutes, and that is what is asked about.
#[test]
fn settling_is_judged_with_every_loop_closed() {
    let tmp = tempfile::tempdir().unwrap();
    let lag = |b: f64| format!("{{ num = [0.0, {b}], den = [1.0, -0.9] }}");
    let plant =
        format!("[[plants]]\nchannels = [[{}, {}], [{}, {}]]\n", lag(0.1), lag(0.095), lag(0.1), lag(0.1));
    let loops = "[[loops]]\noutput = \"a\"\ninput = \"u\"\nkp = 0.4\nki = 0.4\n[[loops]]\noutput = \"b\"\ninput = \"v\"\nkp = 0.4\nki = 0.4\n";
    let own = found(&format!("sample_time_s = 0.1\n[asked]\nsettling_s = 10.0\n{loops}{plant}"), tmp.path());
    let alone = own.loops[0].rules[0].settling_s.unwrap();
    let closed = own.together[0].steps[0].settling_s.unwrap();
    assert!(alone < 10.0 && closed > 50.0, "{alone} {closed}");
    assert!(!own.valid && own.verdict[0].contains("with all loops closed"), "{:?}", own.verdict);
    assert!(own.warnings.iter().any(|w| w.contains("is 20.00")), "{:?}", own.warnings);
}

/// Samples of delay are resolved one by one: thousands of them are refused before the work.
#[test]
fn thousands_of_samples_of_delay_are_refused() {
    let tmp = tempfile::tempdir().unwrap();
    let plant = "[[plants]]\nchannels = [[{ num = [0.0, 0.1], den = [1.0, -0.9] }]]\n";
    let job =
        parsed(&format!("sample_time_s = 0.02\n{LAG}extra_delay_s = 100.0\n{plant}"), tmp.path()).unwrap();
    let e = work::estimate(&job).map(|_| ()).unwrap_err().to_string();
    assert!(e.contains("samples by which `y` is late") && e.contains("at most 1000"), "{e}");
}

/// A plant that is unstable by itself is judged under given gains; only a search refuses it.
#[test]
fn given_gains_hold_an_unstable_plant() {
    let tmp = tempfile::tempdir().unwrap();
    let plant = "[[plants]]\nchannels = [[{ num = [1.0], den = [1.0, -1.0] }]]\n";
    // s - 1 + 10 + 1 / s: stable; 1 / (1 + 10 / (s - 1)) is at most 1.
    let own = found(&format!("{LAG}kp = 10.0\nki = 1.0\n{plant}"), tmp.path());
    assert!(own.together[0].violation.is_some_and(|v| v <= 1.0), "{:?} {:?}", own.verdict, own.together);
    let job = parsed(&format!("{LAG}{plant}"), tmp.path()).unwrap();
    assert!(work::control(&job, Watch::silent()).is_err());
}

/// Two loops that act on each other, searched: what is kept is kept by every set point, and equal for any number of threads.
#[test]
fn coupled_loops_keep_what_is_asked_together() {
    let tmp = tempfile::tempdir().unwrap();
    let text =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/control/loops.toml"))
            .unwrap();
    let own = found(&text, tmp.path());
    assert!(own.valid, "{:?} {:?}", own.verdict, own.checks);
    for t in &own.together {
        assert!(t.violation.unwrap() <= 1.0);
        for m in &t.loops {
            assert!(
                m.gain_up.is_none_or(|g| g >= 2.0) && m.phase_deg.unwrap() >= 45.0 && m.sensitivity <= 1.7,
                "{m:?}"
            );
        }
        let (i, b) = (t.outputs.as_ref().unwrap(), t.both.as_ref().unwrap());
        assert!(i.alpha >= 0.4 && b.alpha <= i.alpha && b.alpha <= b.alpha_lost * (1.0 + 1e-9));
    }
    assert!(own.loops[1].kp < 0.0, "fuel makes lambda smaller: {:?}", own.loops[1].kp);
}

#[test]
fn bad_specs_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let plant = "[[plants]]\nchannels = [[{ num = [1.0], den = [4.0, 1.0] }]]\n";
    for (text, part) in [
        (format!("models = [\"m.json\"]\n{LAG}"), "points"),
        (LAG.to_string(), "plants"),
        (format!("{LAG}kp = 1.0\n{plant}"), "loops[1].ki"),
        (format!("{LAG}extra_delay_s = -1.0\n{plant}"), "extra_delay_s"),
        (format!("draws = 5\n{LAG}{plant}"), "draws"),
        (format!("[asked]\nsensitivity = 0.9\n{LAG}{plant}"), "asked.sensitivity"),
        (
            format!("{LAG}[[plants]]\nchannels = [[{{ num = [1.0, 0.0, 0.0], den = [4.0, 1.0] }}]]\n"),
            "degree of the numerator",
        ),
        (
            format!("{LAG}[[plants]]\nchannels = [[{{ num = [1.0], den = [4.0, 1.0] }}], []]\n"),
            "plants[1].channels",
        ),
        (format!("reaction_samples = 2\n{LAG}{plant}"), "reaction_samples"),
    ] {
        let refused = parsed(&text, tmp.path()).map(|_| ()).unwrap_err();
        assert!(refused.contains(part) && refused.contains("spec.toml"), "{part}: {refused}");
    }
    // Signs that change between set points, a plant that does nothing.
    let two = |a: f64, b: f64| {
        format!(
            "{LAG}[[plants]]\nname = \"low\"\nchannels = [[{{ num = [{a:?}], den = [4.0, 1.0] }}]]\n[[plants]]\nname = \"high\"\nchannels = [[{{ num = [{b:?}], den = [4.0, 1.0] }}]]\n"
        )
    };
    let failed = |text: &str| {
        work::control(&parsed(text, tmp.path()).unwrap(), Watch::silent())
            .map(|_| ())
            .unwrap_err()
            .to_string()
    };
    let text = failed(&two(1.0, -1.0));
    assert!(text.contains("low") && text.contains("high"), "{text}");
    assert!(failed(&two(1.0, 0.0)).contains("high"));
    let one = |time: &str, channel: &str| format!("{time}{LAG}[[plants]]\nchannels = [[{channel}]]\n");
    assert!(failed(&one("", "{ num = [1.0], den = [1.0, -0.5] }")).contains("unstable by itself"));
    let half =
        failed(&one("sample_time_s = 0.1\n", "{ num = [0.0, 0.2], den = [1.0, -0.8], delay_s = 0.05 }"));
    assert!(half.contains("whole number") && half.contains("plant 1"), "{half}");
    // Without delay every gain is stable: there is no end to the plane, and gains are found all the same.
    assert!(found(&one("", "{ num = [1.0], den = [1.0, 1.0] }"), tmp.path()).valid);
}
