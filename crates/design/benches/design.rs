//! Speed of one evaluation, and value and CPU time of whole designs.
//!
//! The designs are those of chapter 4: torque model (4.17), sigma^2 = 80, random start in the box (4.16), convention
//! trim; medians over ten seeds. CPU time is that of the process from `/proc` and left out where there is none.

use criterion::Criterion as Bench;
use dynocal_design::channel::Channel;
use dynocal_design::criterion::criterion;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, OutputLimits, Term};
use dynocal_design::search::{DesignOptions, design, random_record};
use dynocal_ident::model::literature::{lambda_4_53, torque_4_17};

fn signal_u0() -> Vec<f64> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/reference/design_u0.json");
    let text = std::fs::read_to_string(path).expect("the reduced reference lies in the repository");
    let v: serde_json::Value = serde_json::from_str(&text).expect("valid JSON");
    v["u"]
        .as_array()
        .into_iter()
        .flatten()
        .flat_map(|r| r.as_array().into_iter().flatten())
        .filter_map(|x| x.as_f64())
        .collect()
}

fn scales() -> Vec<f64> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/reference/design_u0.json");
    let text = std::fs::read_to_string(path).expect("the reduced reference lies in the repository");
    let v: serde_json::Value = serde_json::from_str(&text).expect("valid JSON");
    v["c_torque"].as_array().into_iter().flatten().filter_map(|x| x.as_f64()).collect()
}

/// User and system time of the process in s (Linux counts hundredths).
fn cpu_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = stat.rsplit(')').next()?.split_whitespace().collect();
    Some((fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?) / 100.0)
}

fn channels(kind: &str) -> Vec<Channel> {
    let mut c = vec![
        Channel::free("fpw", 2000.0, 6000.0),
        Channel::free("abv", 0.4, 0.6),
        Channel::free("speed", 1000.0, 2000.0),
    ];
    match kind {
        "rate" => c.iter_mut().zip([500.0, 0.025, 125.0]).for_each(|(c, r)| c.rate_per_sample = Some(r)),
        "output" => {
            c[0] = Channel::free("fpw", 1800.0, 6200.0);
            c[1] = Channel::free("abv", 0.35, 0.65);
            c[2] = Channel::free("speed", 800.0, 2200.0);
        }
        _ => {}
    }
    c
}

fn designs() {
    let (u0, scale) = (signal_u0(), scales());
    let model = torque_4_17();
    let budget = std::env::var("EVALUATIONS").ok().and_then(|v| v.parse().ok()).unwrap_or(4000);
    let wanted = [
        ("box", "d", -436.2),
        ("box", "ai", 2.138e5),
        ("box", "a", 899.0),
        ("box", "wa", 1.954e5),
        ("box", "i", 984.0),
        ("box", "g", 13.23),
        ("box", "e", 382.0),
        ("rate", "d", -401.0),
        ("rate", "ai", 8.93e5),
        ("output", "d", -450.3),
        ("output", "ai", 9.85e4),
    ];
    println!(
        "{:8}{:4}{:>12}{:>12}{:>12}{:>12}{:>10}",
        "limits", "J", "wanted", "median", "best", "worst", "CPU s"
    );
    let only = std::env::var("CASES").unwrap_or_default();
    for (kind, name, target) in
        wanted.into_iter().filter(|(k, n, _)| only.is_empty() || only.contains(&format!("{k}-{n},")))
    {
        let c = criterion(name, &Default::default()).expect("known");
        let mut term = Term {
            objective_signal: &u0,
            reference_scale: &scale,
            ..Term::new("torque", &model.model, &model.theta, model.noise_variance, c.as_ref())
        };
        if kind == "output" {
            term.limits = Some(OutputLimits { lower: -10.0, upper: 40.0, margin: 0.0 });
        }
        let problem = DesignProblem {
            channels: channels(kind),
            n_samples: 100,
            convention: Convention::Trim,
            start: 10,
            terms: vec![term],
        };
        // Constrained runs take more evaluations each, and more of them to get out of the first basin.
        let evaluations = if kind == "output" { 2 * budget } else { budget };
        let before = cpu_s();
        let mut ends: Vec<f64> = (0..10)
            .map(|seed| {
                let search = std::env::var("SEARCH").unwrap_or("kicks".into());
                let options = DesignOptions { search, seed, evaluations, ..Default::default() };
                let found = design(&problem, &options, &|| false, &|_| {}).expect("well posed");
                let spent = (found.status, found.evaluations, found.start_value);
                if std::env::var_os("VERBOSE").is_some() {
                    println!(
                        "   {seed}: {} {spent:?} {:?}",
                        found.value,
                        found.safety[0].worst.map(|w| w.distance)
                    );
                }
                found.value
            })
            .collect();
        let cpu = cpu_s().zip(before).map_or(f64::NAN, |(a, b)| (a - b) / 10.0);
        ends.sort_by(f64::total_cmp);
        let median = 0.5 * (ends[4] + ends[5]);
        println!("{kind:8}{name:4}{target:12.5}{median:12.5}{:12.5}{:12.5}{cpu:10.3}", ends[0], ends[9]);
    }
}

/// Designs of growing length to a projected gradient of 1e-4 of its start: J_D of the torque model, one local run.
fn growth() {
    let (d, model) = (criterion("d", &Default::default()).expect("known"), torque_4_17());
    println!("{:>9}{:>14}{:>14}{:>14}{:>10}", "samples", "evaluations", "J_D", "gradient", "CPU s");
    for n_samples in [100, 1000, 10_000] {
        let problem = DesignProblem {
            channels: channels("box"),
            n_samples,
            convention: Convention::Trim,
            start: 10,
            terms: vec![Term::new("torque", &model.model, &model.theta, model.noise_variance, d.as_ref())],
        };
        let start = random_record(&problem, 2).expect("well posed");
        let before = projected_gradient(&problem, &start);
        let options = DesignOptions {
            search: "local".into(),
            start: Some(start),
            evaluations: 6000,
            gradient_tolerance: 1e-4 * before,
            value_tolerance: 0.0,
            ..Default::default()
        };
        let from = cpu_s();
        let found = design(&problem, &options, &|| false, &|_| {}).expect("well posed");
        let cpu = cpu_s().zip(from).map_or(f64::NAN, |(a, b)| a - b);
        let left = projected_gradient(&problem, &found.u) / before;
        println!("{n_samples:9}{:14}{:14.4}{left:14.2e}{cpu:10.2}", found.evaluations, found.value);
    }
}

/// Largest component of the projected gradient per unit of range.
fn projected_gradient(problem: &DesignProblem, u: &[f64]) -> f64 {
    let mut g = vec![0.0; u.len()];
    Evaluator::new(problem).expect("well posed").value_gradient(u, 8.0, &mut g);
    u.iter().zip(&g).enumerate().fold(0.0, |worst, (k, (u, g))| {
        let c = &problem.channels[k % problem.channels.len()];
        let range = c.upper - c.lower;
        let x = (u - c.lower) / range;
        worst.max(((x - g * range).clamp(0.0, 1.0) - x).abs())
    })
}

fn main() {
    designs();
    growth();
    if std::env::var_os("DESIGNS_ONLY").is_some() {
        return;
    }
    let mut bench = Bench::default().configure_from_args();
    let (u0, model) = (signal_u0(), torque_4_17());
    for name in ["d", "ai", "i", "g", "e"] {
        let c = criterion(name, &Default::default()).expect("known");
        let term = Term {
            objective_signal: &u0,
            ..Term::new("torque", &model.model, &model.theta, model.noise_variance, c.as_ref())
        };
        let problem = DesignProblem {
            channels: channels("box"),
            n_samples: 100,
            convention: Convention::Trim,
            start: 10,
            terms: vec![term],
        };
        let u = random_record(&problem, 1).expect("well posed");
        let mut e = Evaluator::new(&problem).expect("well posed");
        let mut g = vec![0.0; u.len()];
        bench.bench_function(&format!("{name} value and gradient, 100 samples of (4.17)"), |b| {
            b.iter(|| e.value_gradient(&u, 8.0, &mut g));
        });
    }
    let (d, lambda) = (criterion("d", &Default::default()).expect("known"), lambda_4_53());
    let problem = DesignProblem {
        channels: channels("box"),
        n_samples: 2000,
        convention: Convention::Trim,
        start: 10,
        terms: vec![
            Term::new("torque", &model.model, &model.theta, model.noise_variance, d.as_ref()),
            Term::new("lambda", &lambda.model, &lambda.theta, lambda.noise_variance, d.as_ref()),
        ],
    };
    let u = random_record(&problem, 1).expect("well posed");
    let mut e = Evaluator::new(&problem).expect("well posed");
    let mut g = vec![0.0; u.len()];
    bench.bench_function("d value and gradient, 2000 samples of (4.17) and (4.53)", |b| {
        b.iter(|| e.value_gradient(&u, 8.0, &mut g));
    });
    bench.final_summary();
}
