//! What a fit must not claim: cells without knowledge of their own, labels that are known together only, verdicts of a few samples.

mod planted;

use dynocal_label::follow::extension;
use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{self, Options, Problem, Verdict};
use dynocal_label::nonlinear::{self, Target};
use dynocal_label::rows::Rows;
use dynocal_label::ve::judge::{Decision, Reason};
use dynocal_label::ve::sensor::Sensor;
use dynocal_label::ve::{Found, Keys, run};
use dynocal_numerics::rng::Rng64;
use planted::planted;

const SENSOR: Sensor = Sensor { delay_s: 0.2, flow_delay_s: 0.15, lag_s: 0.25 };

fn keys() -> Keys {
    Keys { sensor: Some(SENSOR), ..Keys::default() }
}

/// Least and greatest share by which known cells change, and whether every changed cell lies between them, a step aside.
fn within(label: &Label, found: &Found) -> (f64, f64, bool) {
    let t = &found.table;
    let share = |k: usize| t.exact[k] / label.base[k];
    let known = (0..label.len()).filter(|k| t.facts[*k] >= 1.0).map(share);
    let (least, most) = known.fold((f64::INFINITY, 0.0f64), |r, s| (r.0.min(s), r.1.max(s)));
    let inside = (0..label.len()).filter(|k| t.values[*k] != label.base[*k]).all(|k| {
        let step = 1.0 / label.base[k];
        (least - step..=most + step).contains(&(t.values[k] / label.base[k]))
    });
    (least, most, inside)
}

/// The means of an extension have weights that are not negative and a sum of 1, and a straight line stays one.
#[test]
fn what_follows_is_a_mean_of_what_is_known() {
    let axes = vec![Axis::new("x", "-", &[0.0, 1.0, 3.0, 4.0, 9.0]), Axis::new("y", "-", &[0.0, 2.0, 3.0])];
    let label = Label::new("M", "-", axes, &[1.0; 15]);
    let mut known = [false; 15];
    [0, 4, 7, 13].iter().for_each(|k| known[*k] = true);
    let means = extension(&label, &known).unwrap();
    for k in 0..15 {
        assert_eq!(means[k].is_empty(), known[k]);
        let sum: f64 = means[k].iter().map(|m| m.1).sum();
        assert!(
            known[k] || (sum - 1.0).abs() < 1e-12 && means[k].iter().all(|m| m.1 > 0.0),
            "{:?}",
            means[k]
        );
    }
    let line = Label::curve("C", "-", "x", "-", &[0.0, 1.0, 3.0, 4.0], &[0.0; 4]);
    let means = extension(&line, &[true, false, false, true]).unwrap();
    let at = |k: usize| means[k].iter().map(|(j, w)| w * line.axes[0].points[*j]).sum::<f64>();
    assert!((at(1) - 1.0).abs() < 1e-12 && (at(2) - 3.0).abs() < 1e-12, "{means:?}");
}

/// A few samples in a row of a sensor that is far off, in a corner that is hardly visited: no cell leaves what the known ones do, with
/// and without extrapolation.
#[test]
fn a_few_samples_do_not_take_a_cell_away() {
    let (label, _, mut log) = planted(1, 0.15);
    let high = (0..log.time_s.len()).max_by(|a, b| log.speed_rpm[*a].total_cmp(&log.speed_rpm[*b])).unwrap();
    for k in high.saturating_sub(5)..high + 15 {
        log.lambda[k] = 2.5 - 0.01 * (k % 7) as f64;
    }
    let mut extrapolating = keys();
    extrapolating.fit.extrapolate = true;
    for keys in [keys(), extrapolating] {
        let found = run(&label, std::slice::from_ref(&log), &keys, &|_| ()).unwrap();
        let (least, most, inside) = within(&label, &found);
        println!("known cells change by {least:.2} to {most:.2}");
        assert!(inside && least > 0.5 && most < 1.6, "{least} {most}");
        let moved = |k: &usize| found.table.values[*k] != label.base[*k];
        let untouched = (0..label.len()).filter(|k| found.table.verdicts[*k] == Verdict::Untouched);
        let count = untouched.filter(moved).count();
        assert!(keys.fit.extrapolate || count == 0, "{count} untouched cells moved");
    }
}

/// A table that is wrong by one factor, of an engine that nothing changes: later samples do not drift, whatever cells they visit.
#[test]
fn a_constant_factor_is_no_drift() {
    let (label, truth, log) = planted(3, 0.0);
    let mut wrong = label.clone();
    wrong.base = truth.iter().map(|v| (v / 1.12).round()).collect();
    let mut driven = log;
    for k in 0..driven.time_s.len() {
        let at = [driven.speed_rpm[k], driven.load[k]];
        let ratio = label.value(&label.base, &at) / wrong.value(&wrong.base, &at);
        driven.ve[k] /= ratio;
        driven.lambda[k] *= ratio;
    }
    let found = run(&wrong, &[driven], &keys(), &|_| ()).unwrap();
    let [drift, error] = found.judgement.drift;
    println!("{:?}, drift {drift:.4} +- {error:.4}", found.judgement.reason);
    assert_eq!(found.judgement.decision, Decision::Change);
    assert!(drift.abs() < 0.01 || drift.abs() < 3.0 * error, "{drift} {error}");
}

/// Half a minute of judged samples says nothing, however good it looks.
#[test]
fn a_few_judged_samples_decide_nothing() {
    let (label, _, log) = planted(1, 0.15);
    let cut = |v: &Vec<f64>| v[..1000].to_vec();
    let mut short = log.clone();
    (short.time_s, short.speed_rpm, short.load) = (cut(&log.time_s), cut(&log.speed_rpm), cut(&log.load));
    (short.ve, short.enrichment, short.lambda) = (cut(&log.ve), cut(&log.enrichment), cut(&log.lambda));
    (short.target, short.pulse_ms) = (cut(&log.target), cut(&log.pulse_ms));
    short.coolant_c = None;
    // A slow error of the sensor: its samples hang together for minutes.
    for k in 0..1000 {
        short.lambda[k] *= 1.0 + 0.1 * (k as f64 / 300.0).sin();
    }
    let keys = Keys { train: 0.9, ..keys() };
    let found = run(&label, &[short], &keys, &|_| ()).unwrap();
    let j = &found.judgement;
    println!("{:?} of {:.1} measurements", j.reason, j.facts);
    assert_eq!((j.decision, j.reason), (Decision::Keep, Reason::TooFew));
}

/// Lambda that is off by a hundred times, whatever the table: no table.
#[test]
fn a_table_that_leaves_most_of_lambda_is_refused() {
    let (label, _, mut log) = planted(1, 0.15);
    log.enrichment.iter_mut().for_each(|g| *g *= 100.0);
    let found = run(&label, &[log], &keys(), &|_| ()).unwrap();
    assert_eq!((found.judgement.decision, found.judgement.reason), (Decision::Refuse, Reason::NoEngine));
}

fn curve(points: &[f64], base: f64) -> Label {
    Label::curve("C", "-", "x", "-", points, &vec![base; points.len()])
}

fn rows(label: &Label, x: &[f64]) -> Rows {
    let mut out = Rows::default();
    for x in x {
        out.start();
        label.enter(&mut out, 0, 1.0, &[*x]);
    }
    out
}

/// Cells without data, at a base that a monotone or convex curve through the data cannot have, give way.
#[test]
fn cells_without_data_do_not_hold_a_shaped_label_at_its_base() {
    let mut rng = Rng64::new(5);
    let x: Vec<f64> = (0..1000).map(|_| rng.uniform_in(4.0, 11.0)).collect();
    let y: Vec<f64> = x.iter().map(|x| 1.0 + 0.2 * x + 0.1 * rng.normal()).collect();
    let points: Vec<f64> = (0..7).map(|k| 2.0 * f64::from(k)).collect();
    let shapes: [fn(&mut Axis); 3] = [|a| a.gradient[0] = 0.0, |a| a.convex = 1, |a| a.gradient = [0.0, 0.3]];
    for (k, shape) in shapes.into_iter().enumerate() {
        for (smooth, step) in [(None, None), (Some(0.0), None), (Some(0.0), Some(0.1))] {
            let mut label = curve(&points, 5.0);
            shape(&mut label.axes[0]);
            label.step = step;
            let rows = rows(&label, &x);
            let problem = Problem::new(std::slice::from_ref(&label), &rows, &y);
            let found = linear::fit(&problem, &Options { smooth, ..Options::default() }).unwrap();
            println!("shape {k}, smooth {smooth:?}, step {step:?}: {:.2?}", found.values);
            for c in 2..6 {
                assert!((found.values[c] - 1.0 - 0.2 * points[c]).abs() < 0.1, "{:?}", found.values);
            }
            assert_eq!(found.verdicts[0], Verdict::Untouched);
            assert!(found.half_width[0].is_infinite());
        }
    }
}

fn node(name: &str, op: Op) -> Node {
    Node { name: name.into(), op }
}

/// Two curves that are added, and two that are multiplied: a constant, and a factor, are open between them, which is said of both; what
/// they give together is found, and the search ends.
#[test]
fn labels_that_are_known_together_only_are_open() {
    let points = [0.0, 1.0, 2.0, 3.0];
    let mut rng = Rng64::new(2);
    let n = 2000;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let x: Vec<f64> = (0..n).map(|_| rng.uniform_in(0.0, 3.0)).collect();
    let y: Vec<f64> = (0..n).map(|_| rng.uniform_in(0.0, 3.0)).collect();
    let noise: Vec<f64> = (0..n).map(|_| 0.02 * rng.normal()).collect();
    for multiplied in [false, true] {
        let graph = |lock: bool| {
            let mut labels = vec![curve(&points, 1.0), curve(&points, 1.0)];
            labels[0].name = "F".into();
            labels[1].name = "G".into();
            labels[0].locked[0] = lock;
            let both = if multiplied { Op::Multiply(vec![2, 3]) } else { Op::Add(vec![2, 3]) };
            let nodes = vec![
                node("x", Op::Channel(0)),
                node("y", Op::Channel(1)),
                node("f", Op::Label(0, vec![0])),
                node("g", Op::Label(1, vec![1])),
                node("out", both),
            ];
            Graph { nodes, labels }
        };
        let truth = [1.0, 1.5, 1.8, 1.9, 2.0, 1.4, 1.2, 1.7];
        let record = Record { time_s: &time_s, channels: vec![&x, &y] };
        let out = graph(false).values(&truth, &record);
        let out: Vec<f64> = out.iter().zip(&noise).map(|(a, e)| a + e).collect();
        let weights = vec![1.0; n];
        let target = || Target { record: record.clone(), node: None, y: &out, weights: &weights };
        let found = nonlinear::fit(&graph(false), &[target()], &Options::default(), &|| false).unwrap();
        println!(
            "multiplied {multiplied}: {} steps, {:.3?}, left {:.4}",
            found.steps, found.fit.exact, found.fit.rms[1]
        );
        assert!(found.converged && found.fit.rms[1] < 0.022);
        assert_eq!((found.fit.open.len(), found.fit.open.cells(0).len()), (1, 8));
        assert!(found.fit.verdicts.iter().all(|v| *v == Verdict::Open));
        assert!(found.fit.half_width.iter().all(|h| h.is_infinite()));
        // One cell settles it.
        let found = nonlinear::fit(&graph(true), &[target()], &Options::default(), &|| false).unwrap();
        assert!(found.converged && found.fit.open.is_empty());
        for (k, truth) in truth.iter().enumerate() {
            assert!((found.fit.exact[k] - truth).abs() < 0.02, "{k}: {}", found.fit.exact[k]);
        }
    }
}

/// What nothing depends on is said to be that, and not to be a lack of samples.
#[test]
fn a_label_without_influence_is_named() {
    let x = [0.5, 1.5, 2.5];
    let mut label = curve(&[0.0, 1.0, 2.0, 3.0], 1.0);
    label.locked = vec![true; 4];
    let rows = rows(&label, &x);
    let problem = Problem::new(std::slice::from_ref(&label), &rows, &x);
    let message = linear::fit(&problem, &Options::default()).unwrap_err().to_string();
    assert!(message.contains("are locked") && message.contains("3 samples"), "{message}");
}

/// A map of 256 cells from many samples: each sample has four cells, and costs as much.
#[test]
fn a_function_without_memory_is_fitted_row_by_row() {
    let axis = |name: &str| Axis::new(name, "-", &(0..16).map(f64::from).collect::<Vec<_>>());
    let label = Label::new("M", "-", vec![axis("x"), axis("y")], &[0.0; 256]);
    let nodes =
        vec![node("x", Op::Channel(0)), node("y", Op::Channel(1)), node("m", Op::Label(0, vec![0, 1]))];
    let graph = Graph { nodes, labels: vec![label.clone()] };
    let mut rng = Rng64::new(4);
    let n = 20_000;
    let time_s: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let mut drawn = || -> Vec<f64> { (0..n).map(|_| rng.uniform_in(0.0, 15.0)).collect() };
    let (x, y) = (drawn(), drawn());
    let z: Vec<f64> = (0..n).map(|k| (0.3 * x[k]).sin() + 0.1 * y[k]).collect();
    let record = Record { time_s: &time_s, channels: vec![&x, &y] };
    let weights = vec![1.0; n];
    let target = Target { record, node: None, y: &z, weights: &weights };
    let begun = std::time::Instant::now();
    let options = Options { smooth: Some(0.0), ..Options::default() };
    let found = nonlinear::fit(&graph, &[target], &options, &|| false).unwrap();
    println!("{:.2} s, {} steps", begun.elapsed().as_secs_f64(), found.steps);
    let mut rows = Rows::default();
    for k in 0..n {
        rows.start();
        label.enter(&mut rows, 0, 1.0, &[x[k], y[k]]);
    }
    let problem = Problem::new(std::slice::from_ref(&label), &rows, &z);
    let direct = linear::fit(&problem, &options).unwrap();
    for k in 0..256 {
        assert!((found.fit.exact[k] - direct.exact[k]).abs() < 1e-8, "{k}");
    }
}
