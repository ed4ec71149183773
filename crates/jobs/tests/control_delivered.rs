//! What the job `control` delivers: plants out of records, predictors, schedules; and the exported controller beside the one that runs.

use std::path::Path;

use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
use dynocal_control::predictor::{Predictor, TransportFlow};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::stored::{CONTROLLER_SCHEMA, CONTROLLER_VERSION, StoredController};
use dynocal_control::system::Transfer;
use dynocal_export::evaluate::Machine;
use dynocal_files::json;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Quantity, StoredModel};
use dynocal_jobs::control::{Controlled, run, spec, work};
use dynocal_jobs::export::controller;
use dynocal_jobs::place::Overrides;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

fn parsed(text: &str, folder: &Path) -> Result<spec::Job, String> {
    let file = folder.join("spec.toml");
    let over = Overrides { seed: None, out: Some(folder.join("run")) };
    spec::parse(&file.display().to_string(), text, &over).map_err(|e| e.to_string())
}

fn found(text: &str, folder: &Path) -> Controlled {
    work::control(&parsed(text, folder).unwrap(), Watch::silent()).unwrap()
}

fn stored(folder: &Path) -> StoredController {
    json::read_versioned(&folder.join("run/controller.json"), CONTROLLER_SCHEMA, CONTROLLER_VERSION).unwrap()
}

/// A test of y(t) = 0.9 y(t-1) + 0.2 u(t-3) with noise: open loop, or under a PI that follows a demand.
fn record(path: &Path, closed: bool, rows: usize, most: f64) {
    let mut rng = Rng64::new(4);
    let (mut u, mut y, mut w) = (vec![0.0; rows], vec![0.0; rows], vec![0.0; rows]);
    let (mut x, mut hold, mut level, mut integral) = (0.0, 0, 0.0, 0.0);
    for t in 0..rows {
        if hold == 0 {
            (hold, level) = (3 + rng.below(20), rng.uniform_in(-1.0, 1.0));
        }
        hold -= 1;
        x = 0.9 * x + 0.2 * if t >= 3 { u[t - 3] } else { 0.0 };
        y[t] = 5.0 + x + 0.02 * rng.normal();
        w[t] = 5.0 + level;
        let e = w[t] - y[t];
        integral += 0.02 * e;
        u[t] = if closed { 0.3 * e + integral } else { level }.clamp(-most, most);
    }
    let time: Vec<f64> = (0..rows).map(|t| 0.1 * t as f64).collect();
    let columns: [(&str, &str, &[f64]); 4] =
        [("time", "s", &time), ("u", "V", &u), ("y", "Nm", &y), ("w", "Nm", &w)];
    dynocal_files::csv_io::write_columns(path, &columns).unwrap();
}

const LOOP: &str = "[[loops]]\noutput = \"y\"\ninput = \"u\"\n";

/// From a record alone: the same margins as of the plant that made it, within what the record can know; the page and the files.
#[test]
fn records_become_plants_in_open_and_closed_loop() {
    let tmp = tempfile::tempdir().unwrap();
    let gains = "kp = 0.4\nki = 0.6\n";
    let given = format!(
        "sample_time_s = 0.1\n{LOOP}{gains}[[plants]]\nchannels = [[{{ num = [0.0, 0.0, 0.0, 0.2], den = [1.0, -0.9] }}]]\n"
    );
    let truth = found(&given, tmp.path());
    let t = &truth.together[0].loops[0];
    for closed in [false, true] {
        record(&tmp.path().join("test.csv"), closed, 3000, 9.0);
        let demands = if closed { "demands = [\"w\"]\n" } else { "" };
        let text = format!("records = [\"test.csv\"]\ndraws = 8\n{demands}{LOOP}{gains}");
        let (own, folder) = run(&parsed(&text, tmp.path()).unwrap(), Watch::silent()).unwrap();
        let m = &own.together[0].loops[0];
        let off = m.gain_up.unwrap() / t.gain_up.unwrap() - 1.0;
        assert!(off.abs() < 0.1, "closed {closed}: gain margin off by {off}");
        assert!((m.phase_deg.unwrap() - t.phase_deg.unwrap()).abs() < 4.0);
        // Without a model: within a tenth too, and no frequency past 0.4 of the sampling frequency.
        let free = &own.measured[0];
        let off = free.margins[0].found.gain_up.unwrap() / t.gain_up.unwrap() - 1.0;
        assert!(off.abs() < 0.15, "closed {closed}: measured gain margin off by {off}");
        assert!(free.highest_hz <= 4.0 && free.highest_hz > 3.5);
        let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
        assert!(page.contains("500 Hz of the thesis") && page.contains("Coherence of y"));
        let files = std::fs::read_dir(folder.path()).unwrap().flatten();
        let names: Vec<String> = files.map(|f| f.file_name().to_string_lossy().into_owned()).collect();
        assert!(names.iter().any(|f| f.starts_with("response_1_test")), "{names:?}");
    }
}

#[test]
fn records_that_cannot_serve_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    record(&tmp.path().join("test.csv"), false, 3000, 9.0);
    let failed = |text: &str| {
        work::control(&parsed(text, tmp.path()).unwrap(), Watch::silent())
            .map(|_| ())
            .unwrap_err()
            .to_string()
    };
    let late = failed(&format!("records = [\"test.csv\"]\n{LOOP}extra_delay_s = 400.0\n"));
    assert!(late.contains("test.csv") && late.contains("less than the record lasts"), "{late}");
    record(&tmp.path().join("short.csv"), false, 60, 9.0);
    let short = failed(&format!("records = [\"short.csv\"]\n{LOOP}"));
    assert!(short.contains("short.csv") && short.contains("60 samples"), "{short}");
    // An output that the input does not move: whatever margins its model promises, it explains nothing.
    {
        let mut rng = Rng64::new(11);
        let rows = 500;
        let time: Vec<f64> = (0..rows).map(|t| 0.1 * t as f64).collect();
        let u: Vec<f64> = (0..rows).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
        let y: Vec<f64> = (0..rows).map(|_| rng.normal()).collect();
        let columns: [(&str, &str, &[f64]); 3] = [("time", "s", &time), ("u", "V", &u), ("y", "Nm", &y)];
        dynocal_files::csv_io::write_columns(&tmp.path().join("noise.csv"), &columns).unwrap();
    }
    let noise =
        found(&format!("records = [\"noise.csv\"]\ndraws = 0\n{LOOP}kp = -1e-4\nki = -1e-4\n"), tmp.path());
    assert!(!noise.valid && noise.verdict[0].contains("explains nothing"), "{:?}", noise.verdict);
    // An actuator at its end opens the loop: said, not refused.
    record(&tmp.path().join("held.csv"), true, 1500, 0.25);
    let held = found(
        &format!("records = [\"held.csv\"]\ndemands = [\"w\"]\ndraws = 2\n{LOOP}kp = 0.4\nki = 0.6\n"),
        tmp.path(),
    );
    assert!(held.warnings.iter().any(|w| w.contains("saturated actuator")), "{:?}", held.warnings);
    for (text, part) in [
        (format!("records = [\"test.csv\"]\nmodels = [\"m.json\"]\n{LOOP}"), "one of them"),
        (format!("records = [\"test.csv\"]\ndemands = [\"a\", \"b\"]\n{LOOP}"), "one for each loop"),
        (
            format!(
                "segment_s = 2.0\n{LOOP}[[plants]]\nchannels = [[{{ num = [1.0], den = [4.0, 1.0] }}]]\n"
            ),
            "records",
        ),
        (format!("records = [\"test.csv\"]\n{LOOP}predictor = true\n"), "extra_delay_s"),
        (format!("records = [\"test.csv\"]\n{LOOP}lower = 3.0\nupper = 1.0\n"), "lower"),
        (format!("records = [\"test.csv\"]\nschedule = [\"speed\"]\n{LOOP}"), "schedule"),
    ] {
        let refused = parsed(&text, tmp.path()).map(|_| ()).unwrap_err();
        assert!(refused.contains(part), "{part}: {refused}");
    }
}

/// A delayed loop with a predictor has the gains of the undelayed one and settles faster than the retuned PI; its file runs.
#[test]
fn a_predictor_is_tuned_judged_and_delivered() {
    let tmp = tempfile::tempdir().unwrap();
    let plant = "[[plants]]\nchannels = [[{ num = [0.0, 0.1], den = [1.0, -0.9] }]]\n";
    let of = |extra: &str| format!("sample_time_s = 0.02\n{LOOP}{extra}{plant}");
    let plain = found(&of(""), tmp.path());
    let text = of("extra_delay_s = 0.1\npredictor = true\nlower = -2.0\nupper = 3.0\nstart = 0.5\n");
    let (own, _) = run(&parsed(&text, tmp.path()).unwrap(), Watch::silent()).unwrap();
    let (a, b) = (&plain.loops[0], &own.loops[0]);
    assert!(own.detuned > 1.0 || (a.kp - b.kp).abs() < 1e-9, "{} {}", a.kp, b.kp);
    let retuned = b.rules.iter().find(|r| r.rule.contains("retuned")).unwrap();
    // The search sees the loop without the delay; what is delivered is smaller until the predictor's own loop keeps what is asked.
    let search = b.rules.iter().find(|r| r.rule == "search").unwrap();
    assert!(search.settling_s.unwrap() < retuned.settling_s.unwrap());
    assert!(own.valid && own.together[0].loops[0].sensitivity <= 1.7 + 1e-9, "{:?}", own.verdict);
    let p = b.predictor.as_ref().unwrap();
    assert!(p.above_s.unwrap() > 0.0 && p.gain.0 < 1.0 && p.gain.1 > 1.0);
    // Independent of the interval: the runtime within it and beyond it, on a plant whose delay is wrong.
    let file = stored(tmp.path());
    let l = &file.loops[0];
    let end = |samples: usize| {
        let mut c = Predictor::new(
            l.gains,
            ActuatorLimits { lower: -1e9, upper: 1e9, rate_per_s: None },
            0.02,
            0.0,
            l.predictor.as_ref().unwrap(),
        )
        .unwrap();
        let (mut x, mut past, mut u) = (0.0, vec![0.0; samples + 2], 0.0);
        let mut last: f64 = 0.0;
        for t in 0..40_000 {
            // One sample from measurement to actuator, as the job takes it.
            let measured = past[samples];
            let next = c.step(0.0, 1.0, measured);
            x = 0.9 * x + 0.1 * u;
            u = next;
            past.rotate_right(1);
            past[0] = x;
            if t > 39_500 {
                last = last.max((x - 1.0).abs());
            }
        }
        last
    };
    let beyond = (p.above_s.unwrap() / 0.02).floor() as usize;
    assert!(end(5) < 1e-6 && end(5 + beyond) < 0.1, "{} {}", end(5), end(5 + beyond));
    assert!(!(end(5 + beyond + 1) < 0.1), "{}", end(6 + beyond));
    assert!(own.verdict.iter().any(|v| v.contains("Smith predictor of `y` stands")), "{:?}", own.verdict);
}

/// Gains over a grid of set points: each point keeps what is asked with its own, the file has them as a map; points that are no
/// grid are refused.
#[test]
fn gains_are_scheduled_over_the_set_points() {
    let tmp = tempfile::tempdir().unwrap();
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    let structure =
        dynocal_ident::model::poly::PolyNarx::parse(&["u", "speed"], "y", &["u(t-2)*speed(t-1)", "y(t-1)"])
            .unwrap();
    let inputs = vec![quantity("u", "V"), quantity("speed", "rpm")];
    let mut model = StoredModel::new(structure, &[0.0001, 0.8], inputs, quantity("y", "Nm"), 0.1).unwrap();
    model.initial = Some(dynocal_ident::model::initial::Initial::Rest);
    json::write_versioned(&tmp.path().join("model.json"), MODEL_SCHEMA, MODEL_VERSION, &model).unwrap();
    let point = |n: f64| format!("[[points]]\nvalues = {{ u = 1.0, speed = {n:?} }}\n");
    let text = |points: &str| {
        format!("models = [\"model.json\"]\ndraws = 0\nschedule = [\"speed\"]\n{LOOP}{points}")
    };
    let all: String = [3000.0, 1000.0, 2000.0].map(point).concat();
    let (own, _) = run(&parsed(&text(&all), tmp.path()).unwrap(), Watch::silent()).unwrap();
    assert!(own.valid, "{:?}", own.verdict);
    let file = stored(tmp.path());
    let s = file.loops[0].schedule.as_ref().unwrap();
    assert_eq!(s.axes[0].points, [1000.0, 2000.0, 3000.0]);
    assert_eq!(s.axes[0].unit, "rpm");
    // The table has the rows that are delivered, in the order of the set points.
    let table = std::fs::read_to_string(tmp.path().join("run/gains_by_point.csv")).unwrap();
    assert!(table.contains("y_kp [V/Nm]") && table.contains("y_ki [V/Nm/s]"), "{table}");
    let second: Vec<f64> = table.lines().nth(2).unwrap().split(',').map(|v| v.parse().unwrap()).collect();
    assert!(second[1] == own.loops[0].by_point[1].0 && second[1] == s.at(&[1000.0]).0, "{table}");
    // The gain of the plant goes with speed: that of the controller with one over it.
    for n in [1000.0, 2000.0, 3000.0] {
        let (kp, ki) = s.at(&[n]);
        let (kp0, ki0) = s.at(&[1000.0]);
        assert!((kp * n / (kp0 * 1000.0) - 1.0).abs() < 0.02 && (ki * n / (ki0 * 1000.0) - 1.0).abs() < 0.02);
    }
    // A set point that was never visited is said so.
    model.seen = vec![dynocal_ident::stored::Seen {
        name: "speed".into(),
        unit: "rpm".into(),
        minimum: 900.0,
        maximum: 2500.0,
    }];
    json::write_versioned(&tmp.path().join("model.json"), MODEL_SCHEMA, MODEL_VERSION, &model).unwrap();
    let beyond = found(&text(&all), tmp.path());
    let said = |w: &&String| w.contains("`speed` = 3000") && w.contains("outside of what");
    assert_eq!(beyond.warnings.iter().filter(said).count(), 1, "{:?}", beyond.warnings);
    let twice: String = [3000.0, 3000.0].map(point).concat();
    let refused = work::control(&parsed(&text(&twice), tmp.path()).unwrap(), Watch::silent());
    let refused = refused.map(|_| ()).unwrap_err().to_string();
    assert!(refused.contains("no full grid of 1"), "{refused}");
    program_is_runtime(&file);
}

/// A schedule of a PID: proportional and integral gains go with the set point, one derivative part is shared; each set point keeps what is
/// asked with its own, and the file runs as it is exported.
#[test]
fn a_schedule_shares_its_derivative_part() {
    let tmp = tempfile::tempdir().unwrap();
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    let terms = ["u(t-3)*speed(t-1)", "y(t-1)", "y(t-2)"];
    let structure = dynocal_ident::model::poly::PolyNarx::parse(&["u", "speed"], "y", &terms).unwrap();
    let inputs = vec![quantity("u", "V"), quantity("speed", "rpm")];
    let coefficients = [1e-5, 1.8, -0.81];
    let mut model = StoredModel::new(structure, &coefficients, inputs, quantity("y", "Nm"), 0.1).unwrap();
    model.initial = Some(dynocal_ident::model::initial::Initial::Rest);
    json::write_versioned(&tmp.path().join("model.json"), MODEL_SCHEMA, MODEL_VERSION, &model).unwrap();
    let point = |n: f64| format!("[[points]]\nvalues = {{ u = 1.0, speed = {n:?} }}\n");
    let all: String = [1000.0, 2000.0].map(point).concat();
    let keys = "models = [\"model.json\"]\ndraws = 0\nschedule = [\"speed\"]\n";
    let text = format!("{keys}{LOOP}derivative = true\n{all}");
    let (own, _) = run(&parsed(&text, tmp.path()).unwrap(), Watch::silent()).unwrap();
    let l = &own.loops[0];
    assert!(own.valid && l.kd > 0.0 && l.by_point.len() == 2, "{:?}", own.verdict);
    let file = stored(tmp.path());
    assert_eq!((file.loops[0].gains.kd, file.loops[0].gains.filter_s), (l.kd, l.derivative_filter_s));
    assert_eq!(file.loops[0].schedule.as_ref().unwrap().kp.len(), 2);
    program_is_runtime(&file);
}

/// The exported program beside the running controller over a noisy run with limits: equal to 1e-9 of the range.
fn program_is_runtime(file: &StoredController) {
    let made = controller(file);
    made.package.check().unwrap();
    let mut machine: Machine<f64> = Machine::new(&made.package).unwrap();
    let l = &file.loops[0];
    let mut rng = Rng64::new(8);
    let mut pid = Pid::new(l.gains, l.limits, file.sample_time_s, l.start).unwrap();
    let mut predictor = l
        .predictor
        .as_ref()
        .map(|p| Predictor::new(l.gains, l.limits, file.sample_time_s, l.start, p).unwrap());
    for t in 0..3000 {
        let (r, mut y, mut f) =
            (if t / 200 % 2 == 0 { 1.0 } else { -0.6 }, 0.8 * rng.normal(), 0.05 * rng.normal());
        // Sensors fail for a sample, and for some; a feedforward once, the first sample too.
        if t % 311 == 0 || (1000..1040).contains(&t) {
            y = f64::NAN;
        }
        if t == 2000 {
            f = f64::INFINITY;
        }
        let flow = if t % 700 == 699 { f64::NAN } else { 25.0 + 26.0 * (0.01 * t as f64).sin() };
        if let (Some(p), Some(known)) = (&mut predictor, &l.predictor) {
            p.set_delay(known.samples_at(flow));
        }
        let own = match (&mut predictor, &l.schedule) {
            (Some(p), _) => p.step(f, r, y),
            (None, None) => pid.step(f, r - y),
            (None, Some(s)) => {
                let speed = 1000.0 + t as f64;
                let (kp, ki) = s.at(&[speed]);
                // Other gains as the program has them: the integral stays.
                let state = pid.state();
                pid =
                    Pid::new(PidGains { kp, ki, ..l.gains }, l.limits, file.sample_time_s, l.start).unwrap();
                pid.restore(state);
                pid.step(f, r - y)
            }
        };
        let mut inputs = if l.schedule.is_some() { vec![1000.0 + t as f64, r, y, f] } else { vec![r, y, f] };
        if l.predictor.as_ref().is_some_and(|p| p.flow.is_some()) {
            inputs.push(flow);
        }
        let out = machine.step(&inputs)[0];
        assert!((own - out).abs() < 1e-9 * (1.0 + own.abs()), "sample {t}: runs {own}, exported {out}");
    }
}

/// PID with derivative, rate and range limits; Smith predictor with and without filter.
#[test]
fn exported_controllers_are_those_that_run() {
    let tmp = tempfile::tempdir().unwrap();
    let text = format!(
        "sample_time_s = 0.02\n{LOOP}extra_delay_s = 0.1\npredictor = true\nfilter_s = 0.3\nlower = -1.0\nupper = 1.5\nstart = 0.2\n[[plants]]\nchannels = [[{{ num = [0.0, 0.1], den = [1.0, -0.9] }}]]\n"
    );
    run(&parsed(&text, tmp.path()).unwrap(), Watch::silent()).unwrap();
    let mut file = stored(tmp.path());
    // The folder of the run is a source as its file is.
    let to_c = dynocal_jobs::export::ExportSpec { to: vec!["c".into()], ..Default::default() };
    let left = dynocal_jobs::export::run(&tmp.path().join("run"), &tmp.path().join("c"), &to_c).unwrap();
    assert!(left.files.iter().any(|f| f.ends_with("controller.c")), "{:?}", left.files);
    program_is_runtime(&file);
    file.loops[0].predictor.as_mut().unwrap().filter_s = 0.0;
    file.loops[0].predictor.as_mut().unwrap().model =
        Transfer::sampled(&[0.0, 0.0, 0.3, 0.1], &[2.0, -1.5, 0.2]);
    program_is_runtime(&file);
    // Its delay by a flow: between samples, to the longest one where nothing flows.
    let predictor = file.loops[0].predictor.as_mut().unwrap();
    predictor.flow = Some(TransportFlow { channel: "air".into(), unit: "g/s".into(), nominal: 20.0 });
    program_is_runtime(&file);
    file.loops[0].predictor = None;
    file.loops[0].gains = PidGains { kp: 0.7, ki: 0.9, kd: 0.05, filter_s: 0.08 };
    file.loops[0].limits.rate_per_s = Some(4.0);
    program_is_runtime(&file);
    gcc(&file);
    unit(&file);
}

/// The exported observer of a catalyst beside the one that runs: a store that is driven through both ends, with a biased front sensor; a
/// sensor without a number moves nothing.
#[test]
fn the_exported_observer_is_the_one_that_runs() {
    let tmp = tempfile::tempdir().unwrap();
    let text = format!(
        "sample_time_s = 0.02\n{LOOP}[catalyst]\ncapacity_g = 0.6\nhalf_g_s = 30.0\nrear_band = 0.01\ntarget = 0.5\ngain = 0.02\nmost = 0.02\nlearn = 0.3\n[[plants]]\nchannels = [[{{ num = [0.0, 0.1], den = [1.0, -0.9] }}]]\n"
    );
    run(&parsed(&text, tmp.path()).unwrap(), Watch::silent()).unwrap();
    let file = stored(tmp.path());
    let settings: OxygenSettings = file.catalyst.unwrap();
    let made = controller(&file);
    made.package.check().unwrap();
    let program = made.package.program.as_ref().unwrap();
    let place = |name: &str| program.inputs.iter().position(|i| i.name == name).unwrap();
    let out = |name: &str| program.outputs.iter().position(|o| o.name == name).unwrap();
    let mut machine: Machine<f64> = Machine::new(&made.package).unwrap();
    let mut own = OxygenObserver::new(settings, settings.target).unwrap();
    let mut rng = Rng64::new(3);
    let mut store_g = 0.3;
    let mut inputs = vec![0.0; program.inputs.len()];
    for t in 0..20_000 {
        let air = 15.0 + 10.0 * (1e-3 * f64::from(t)).sin();
        let lambda = 1.0 + if t / 1500 % 2 == 0 { 0.02 } else { -0.02 } + 0.002 * rng.normal();
        let most = settings.capacity_g / (1.0 + air / settings.half_g_s);
        store_g = (store_g + 0.23 * (1.0 - 1.0 / lambda) * air * 0.02).clamp(0.0, most);
        let rear = if store_g == 0.0 {
            0.97
        } else if store_g == most {
            1.03
        } else {
            1.0
        };
        let front = lambda + 0.004;
        let trim = own.step(front, rear, air, 0.02);
        (inputs[place("lambda_before")], inputs[place("lambda_behind")]) = (front, rear);
        inputs[place("air_flow")] = air;
        let y = machine.step(&inputs);
        let (told, filled) = (y[out("lambda_trim")], y[out("oxygen_filling")]);
        assert!((told - trim).abs() < 1e-9, "sample {t}: {told} {trim}");
        assert!((filled - own.filling(air)).abs() < 1e-9, "sample {t}");
    }
    assert!(own.state().breaks.iter().all(|n| *n > 2), "{:?}", own.state());
    // Without sensors, with a lambda that no flame has: as the one that runs.
    for (front, rear, air) in [
        (f64::NAN, 1.05, 15.0),
        (1.01, f64::NAN, 12.0),
        (f64::INFINITY, 1.05, 12.0),
        (0.0, 1.0, 12.0),
        (1.01, 1.05, 0.0),
        (1.01, 0.97, f64::NAN),
        (0.99, 1.0, 20.0),
    ] {
        let trim = own.step(front, rear, air, 0.02);
        (inputs[place("lambda_before")], inputs[place("lambda_behind")]) = (front, rear);
        inputs[place("air_flow")] = air;
        let told = machine.step(&inputs)[out("lambda_trim")];
        // Filling is a share of what the flow leaves usable: without a flow both have the trim of some flow.
        assert!(air.is_nan() || (told - trim).abs() < 1e-9, "{front} {rear} {air}: {told} {trim}");
    }
    // Key on: no flow, the rear sensor in air. Nothing is learnt of a store that nobody knows.
    let mut fresh = OxygenObserver::new(settings, settings.target).unwrap();
    let mut other: Machine<f64> = Machine::new(&made.package).unwrap();
    for air in [0.0, 0.1, 5.0] {
        let trim = fresh.step(1.0, 1.5, air, 0.02);
        (inputs[place("lambda_before")], inputs[place("lambda_behind")]) = (1.0, 1.5);
        inputs[place("air_flow")] = air;
        let told = other.step(&inputs)[out("lambda_trim")];
        assert!((told - trim).abs() < 1e-9 && fresh.state().bias == 0.0, "{air}: {told} {trim}");
    }
    let before = own.filling(15.0);
    (inputs[place("lambda_before")], inputs[place("lambda_behind")]) = (f64::NAN, f64::NAN);
    inputs[place("air_flow")] = 15.0;
    let blind = machine.step(&inputs)[out("oxygen_filling")];
    assert!((blind - before).abs() < 0.05, "{blind} {before}");
    for (key, part) in [("target = 0.5\nmemory = 5.0", "catalyst.memory"), ("target = 2.0", "catalyst")] {
        let text = text.replace("target = 0.5", key);
        let refused = parsed(&text, tmp.path()).map(|_| ()).unwrap_err();
        assert!(refused.contains(part), "{refused}");
    }
}

/// A loop with a derivative part settles sooner than its best PI, keeps what is asked and leaves as a PID; transport goes by a flow.
#[test]
fn a_pid_is_tuned_judged_and_delivered() {
    let tmp = tempfile::tempdir().unwrap();
    let plant =
        "[[plants]]\nchannels = [[{ num = [0.0, 0.0, 0.0, 0.01, 0.009], den = [1.0, -1.8, 0.81] }]]\n";
    let of = |extra: &str| format!("sample_time_s = 0.1\n{LOOP}{extra}{plant}");
    let (own, folder) =
        run(&parsed(&of("derivative = true\n"), tmp.path()).unwrap(), Watch::silent()).unwrap();
    let l = &own.loops[0];
    let pi = l.rules.iter().find(|r| r.rule.contains("without a derivative")).unwrap();
    assert!(own.valid && l.kd > 0.0, "{:?}", own.verdict);
    assert!(l.rules[0].settling_s.unwrap() < pi.settling_s.unwrap(), "{:?}", l.rules);
    assert!(own.verdict.iter().any(|v| v.contains("kd = ")), "{:?}", own.verdict);
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(page.contains("its filter") && page.contains("Ms 1.7") && page.contains("delay margin"));
    let file = stored(tmp.path());
    assert_eq!((file.loops[0].gains.kd, file.loops[0].gains.filter_s), (l.kd, l.derivative_filter_s));
    program_is_runtime(&file);
    // The same gains, given, are the same loop.
    let given = of(&format!(
        "kp = {}\nki = {}\nkd = {}\nderivative_filter_s = {}\n",
        l.kp, l.ki, l.kd, l.derivative_filter_s
    ));
    let given = found(&given, tmp.path());
    let (a, b) = (&own.together[0].loops[0], &given.together[0].loops[0]);
    assert!((a.sensitivity - b.sensitivity).abs() < 1e-9 && given.valid, "{a:?} {b:?}");
    for (extra, part) in [
        ("derivative = true\nkp = 1.0\nki = 1.0\n", "derivative"),
        ("derivative_filter_s = 0.1\n", "derivative_filter_s"),
        ("kd = 1.0\n", "ki"),
        ("transport_flow = \"air\"\n", "transport_flow_nominal"),
        ("transport_flow = \"air\"\ntransport_flow_nominal = 20.0\n", "predictor"),
        ("transport_flow_unit = \"g/s\"\n", "transport_flow"),
    ] {
        let refused = parsed(&of(extra), tmp.path()).map(|_| ()).unwrap_err();
        assert!(refused.contains(part), "{part}: {refused}");
    }
}

/// The functional mock-up unit of the export, run by the reader of plants, beside the controller that runs.
fn unit(file: &StoredController) {
    use dynocal_export::format::{Keys, write};
    use dynocal_plant::plants::{PlantSpec, find};
    let l = &file.loops[0];
    let mut rng = Rng64::new(11);
    let rows: Vec<[f64; 3]> = (0..500).map(|_| [rng.normal(), rng.normal(), 0.1 * rng.normal()]).collect();
    for format in ["fmu2", "fmu3"] {
        let tmp = tempfile::tempdir().unwrap();
        let made = controller(file);
        let files = write(&made.package, format, &Keys::default()).unwrap();
        let fmu = files.iter().find(|f| f.name.ends_with(".fmu")).unwrap();
        dynocal_files::atomic::write(&tmp.path().join(&fmu.name), &fmu.bytes).unwrap();
        let ranges =
            ["demand", "measured", "feedforward"].map(|n| format!("y_{n} = [-100.0, 100.0]")).join(", ");
        let table = toml::from_str(&format!("ranges = {{ {ranges} }}")).unwrap();
        let spec = PlantSpec {
            name: "fmu".into(),
            file: Some(tmp.path().join(&fmu.name)),
            fmu: table,
            ..PlantSpec::default()
        };
        let mut unit = find("fmu").and_then(|m| m.make).unwrap()(&spec, false).unwrap();
        unit.reset(0);
        let mut pid = Pid::new(l.gains, l.limits, file.sample_time_s, l.start).unwrap();
        let mut y = [0.0];
        for (t, row) in rows.iter().enumerate() {
            let own = pid.step(row[2], row[0] - row[1]);
            unit.step(row, file.sample_time_s, &mut y).unwrap();
            assert!(
                (own - y[0]).abs() < 1e-6 * (1.0 + own.abs()),
                "{format}, sample {t}: runs {own}, unit {}",
                y[0]
            );
        }
    }
}

/// The C of the export, compiled, beside the evaluator bit for bit and beside the running controller.
fn gcc(file: &StoredController) {
    use dynocal_export::format::{Keys, Precision, write};
    if std::process::Command::new("gcc").arg("--version").output().is_err() {
        println!("SKIPPED READER: no gcc");
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let made = controller(file);
    let files = write(&made.package, "c", &Keys { precision: Precision::Double }).unwrap();
    for f in &files {
        dynocal_files::atomic::write(&tmp.path().join(&f.name), &f.bytes).unwrap();
    }
    let main = "#include <stdio.h>\n#include \"controller.h\"\nint main(void) {\n    FILE *f = fopen(\"in.bin\", \"rb\"), *g = fopen(\"out.bin\", \"wb\");\n\
    double u[3], y[1];\n    controller_state_T s;\n    controller_init(&s);\n    while (fread(u, sizeof(double), 3, f) == 3) {\n\
        controller_step(&s, u, y);\n        fwrite(y, sizeof(double), 1, g);\n    }\n    fclose(f); fclose(g);\n    return 0;\n}\n";
    dynocal_files::atomic::write(&tmp.path().join("main.c"), main.as_bytes()).unwrap();
    let strict =
        ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O2", "-ffp-contract=off"];
    let done = std::process::Command::new("gcc")
        .current_dir(tmp.path())
        .args(strict)
        .args(["main.c", "controller.c", "-lm", "-o", "main"])
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let mut rng = Rng64::new(9);
    let rows: Vec<[f64; 3]> = (0..20_000).map(|_| [rng.normal(), rng.normal(), 0.1 * rng.normal()]).collect();
    let bytes: Vec<u8> = rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    dynocal_files::atomic::write(&tmp.path().join("in.bin"), &bytes).unwrap();
    assert!(
        std::process::Command::new(tmp.path().join("main"))
            .current_dir(tmp.path())
            .status()
            .unwrap()
            .success()
    );
    let out = std::fs::read(tmp.path().join("out.bin")).unwrap();
    let mut machine: Machine<f64> = Machine::new(&made.package).unwrap();
    assert_eq!(out.len(), 8 * rows.len());
    for (row, bytes) in rows.iter().zip(out.chunks_exact(8)) {
        let compiled = f64::from_le_bytes(bytes.try_into().unwrap());
        assert_eq!(machine.step(row)[0].to_bits(), compiled.to_bits());
    }
}

/// With a filter of the prediction error the margins are those of the loop that runs: the gain at which they end is the one at which the
/// plant's gain may grow no more, which is found without them.
#[test]
fn a_filtered_predictor_has_the_margins_of_its_own_loop() {
    let tmp = tempfile::tempdir().unwrap();
    let plant = "[[plants]]\nchannels = [[{ num = [0.0, 0.1], den = [1.0, -0.9] }]]\n";
    for filter_s in [0.0, 0.5, 2.0] {
        let text = format!(
            "sample_time_s = 0.1\n[[loops]]\noutput = \"y\"\ninput = \"u\"\nextra_delay_s = 1.0\npredictor = true\nfilter_s = {filter_s}\n{plant}"
        );
        let file = tmp.path().join("spec.toml");
        let over = Overrides { seed: None, out: Some(tmp.path().join("run")) };
        let job = spec::parse(&file.display().to_string(), &text, &over).unwrap();
        let own = work::control(&job, Watch::silent()).unwrap();
        let promised = own.together[0].loops[0].gain_up.unwrap();
        let plants = own.loops[0].predictor.as_ref().unwrap().gain.1;
        assert!((promised / plants - 1.0).abs() < 1e-4, "{filter_s}: {promised} {plants}");
    }
}
