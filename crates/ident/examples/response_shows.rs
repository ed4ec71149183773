//! What response models are asked to show, over seeds: `cargo run --release -p dynocal-ident --example response_shows -- PART`,
//! PART one of `coverage`, `coverage5`, `varying`, `local`, `size`, `sequential` (the last with `MAP.csv` of measured points).
//!
//! Numbers are printed as they come out; nothing here is asserted.

use std::time::Instant;

use dynocal_ident::model::response::gp::{GaussianProcess, GpModel, NoiseChoice};
use dynocal_ident::model::response::score::Unseen;
use dynocal_ident::model::response::sequential::{Aim, next_points};
use dynocal_ident::model::response::{Ask, Learn, Points, Prediction, Response, ResponseModel, learner};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;
type Function = fn(&[f64]) -> f64;

fn main() -> Outcome<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match args.first().map(String::as_str) {
        Some("coverage") => {
            coverage(args.get(1).map(String::as_str), args.get(2).map_or(Ok(200), |n| n.parse())?)
        }
        Some("coverage5") => coverage5(),
        Some("varying") => varying(),
        Some("local") => local(),
        Some("size") => size(),
        Some("sequential") => sequential(args.get(1).map(String::as_str)),
        _ => Err("one of coverage, coverage5, varying, local, size, sequential".into()),
    }
}

/// Torque-like function of speed, load, spark, lambda, cam in [0, 1]; that of `bench/peers/response.py`.
fn engine_like(u: &[f64]) -> f64 {
    let (speed, load, spark, lam, cam) = (u[0], u[1], u[2], u[3], u[4]);
    let air = load
        * (0.75 + 0.5 * speed - 0.45 * speed * speed + 0.12 * cam * (1.0 - speed) - 0.1 * cam * cam * speed);
    let best = 0.65 - 0.3 * load + 0.25 * speed;
    let late = (spark - best).max(0.0);
    let efficiency = 1.0 - 0.9 * (spark - best).powi(2) - 0.35 * late.powi(3);
    let mixture = 1.0 - 0.6 * (lam - 0.45).powi(2) - 0.15 * (6.0 * (lam - 0.8)).tanh();
    320.0 * air * efficiency * mixture - 18.0 - 25.0 * speed.powf(1.5)
}

/// Smooth function of three inputs in [0, 1].
fn three(x: &[f64]) -> f64 {
    (3.0 * x[0]).sin() + x[1] * x[1] * (1.0 + x[0]) + 0.5 * (2.0 * x[2]).cos() * x[1]
}

fn draw(n: usize, d: usize, noise: f64, rng: &mut Rng64, f: Function) -> Points {
    let x: Vec<f64> = (0..n * d).map(|_| rng.uniform()).collect();
    let y = x.chunks_exact(d).map(|x| f(x) + noise * rng.normal()).collect();
    Points { inputs: (0..d).map(|j| format!("x{j}")).collect(), output: "y".into(), x, y }
}

fn mean(v: &[f64]) -> f64 {
    v.iter().sum::<f64>() / v.len().max(1) as f64
}

/// Half of the 95 % interval of a mean.
fn half(v: &[f64]) -> f64 {
    let m = mean(v);
    let n = v.len() as f64;
    1.96 * (v.iter().map(|x| (x - m).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt()
}

/// Share of new measurements in the 95 % band, ratio of squared errors to predicted variances, left-out coverage.
fn coverage(only: Option<&str>, seeds: u64) -> Outcome<()> {
    println!("three inputs, 120 points, noise 0.05 of about 3 range, 500 new measurements, {seeds} seeds");
    for (kind, keys) in [
        ("gaussian_process", "starts = 2"),
        ("stepwise_polynomial", ""),
        ("local_linear", ""),
        ("local_linear", "quadratic = true"),
        ("rbf", ""),
        ("mean_of", "models = [{ kind = 'stepwise_polynomial' }, { kind = 'rbf' }]"),
    ] {
        if only.is_some_and(|o| o != kind) {
            continue;
        }
        let learner = learner(kind, &keys.parse()?)?;
        let each = (0..seeds).into_par_iter().map(|seed| {
            let mut rng = Rng64::stream(71, seed);
            let (p, test) = (draw(120, 3, 0.05, &mut rng, three), draw(500, 3, 0.05, &mut rng, three));
            let learnt = learner.learn(&p, &|| false).ok()?;
            let left = Unseen::of(&learnt.left_out.residuals, &learnt.left_out.variance, p.output_range());
            let unseen = Unseen::on(&learnt.model, &test);
            let mut at = Prediction::new(3);
            let inside = (0..test.len()).filter(|i| {
                learnt.model.predict(test.row(*i), Ask::Variance, &mut at);
                (three(test.row(*i)) - at.mean).abs() <= 1.96 * at.variance.sqrt()
            });
            let response = inside.count() as f64 / test.len() as f64;
            Some([
                unseen.coverage,
                unseen.variance_ratio,
                unseen.rmse,
                left.coverage,
                response,
                at.noise.sqrt(),
            ])
        });
        let found: Vec<_> = each.collect::<Vec<_>>().into_iter().flatten().collect();
        let of = |k: usize| -> Vec<f64> { found.iter().map(|f| f[k]).collect() };
        println!(
            "{kind} {keys}: {} fits, coverage {:.2} +- {:.2} %, variance ratio {:.3} +- {:.3}, rmse {:.4}, left-out coverage {:.2} %, function in the band of the response {:.2} %, noise {:.4}",
            found.len(),
            100.0 * mean(&of(0)),
            100.0 * half(&of(0)),
            mean(&of(1)),
            half(&of(1)),
            mean(&of(2)),
            100.0 * mean(&of(3)),
            100.0 * mean(&of(4)),
            mean(&of(5))
        );
    }
    Ok(())
}

fn coverage5() -> Outcome<()> {
    println!("five inputs, 300 points, 1 % noise, 3000 test points, 200 seeds");
    let each = (0..200_u64).into_par_iter().map(|seed| {
        let mut rng = Rng64::stream(72, seed);
        let clean = draw(3000, 5, 0.0, &mut rng, engine_like);
        let noise = 0.01 * clean.output_range();
        let p = draw(300, 5, noise, &mut rng, engine_like);
        let measured =
            Points { y: clean.y.iter().map(|y| y + noise * rng.normal()).collect(), ..clean.clone() };
        let learnt = GaussianProcess::default().learn(&p, &|| false).ok()?;
        let lost = match &learnt.model {
            ResponseModel::GaussianProcess(m) => m.lengths().iter().filter(|l| **l > 30.0).count(),
            _ => 0,
        };
        // The band of the response itself is held against the clean function.
        let mut at = Prediction::new(5);
        let inside = (0..clean.len()).filter(|i| {
            learnt.model.predict(clean.row(*i), Ask::Variance, &mut at);
            (clean.y[*i] - at.mean).abs() <= 1.96 * at.variance.sqrt()
        });
        let response = inside.count() as f64 / clean.len() as f64;
        let error = Unseen::on(&learnt.model, &clean).of_range;
        Some((Unseen::on(&learnt.model, &measured).coverage, response, error, lost as f64))
    });
    let found: Vec<_> = each.collect::<Vec<_>>().into_iter().flatten().collect();
    let of = |k: usize| -> Vec<f64> { found.iter().map(|f| [f.0, f.1, f.2, f.3][k]).collect() };
    println!(
        "{} fits: measurements in the band {:.2} +- {:.2} %, clean function in the band of the response {:.2} +- {:.2} %, \
         error {:.4} % of the range, inputs lost {}",
        found.len(),
        100.0 * mean(&of(0)),
        100.0 * half(&of(0)),
        100.0 * mean(&of(1)),
        100.0 * half(&of(1)),
        100.0 * mean(&of(2)),
        of(3).iter().sum::<f64>()
    );
    Ok(())
}

/// Motorcycle-like: calm, then violent, then calming; the standard deviation is known.
fn varying() -> Outcome<()> {
    let std = |x: f64| 0.05 + 0.5 / (1.0 + (-12.0 * (x - 0.35)).exp()) * (1.0 - 0.6 * x);
    let truth =
        |x: f64| if x < 0.3 { 0.0 } else { -1.5 * (9.0 * (x - 0.3)).sin() * (-3.0 * (x - 0.3)).exp() };
    let keys = GaussianProcess { noise: NoiseChoice::Varying, ..Default::default() };
    let found: Vec<[f64; 2]> = (0..20_u64)
        .map(|seed| {
            let mut rng = Rng64::stream(73, seed);
            let x: Vec<f64> = (0..1000).map(|_| rng.uniform()).collect();
            let y = x.iter().map(|x| truth(*x) + std(*x) * rng.normal()).collect();
            let p = Points { inputs: vec!["time".into()], output: "acceleration".into(), x, y };
            let learnt = keys.learn(&p, &|| false)?;
            let mut at = Prediction::new(1);
            let (mut local, mut whole) = (0.0, 0.0);
            for i in 0..500 {
                let x = (f64::from(i) + 0.5) / 500.0;
                learnt.model.predict(&[x], Ask::Variance, &mut at);
                let e = at.noise.sqrt() - std(x);
                local += (e / std(x)).powi(2) / 500.0;
                whole += e * e / 500.0;
            }
            let ends = (0..500)
                .map(|i| std(f64::from(i) / 499.0))
                .fold((f64::INFINITY, 0.0_f64), |(a, b), v| (a.min(v), b.max(v)));
            Ok([local.sqrt(), whole.sqrt() / (ends.1 - ends.0)])
        })
        .collect::<Outcome<_>>()?;
    for (k, what) in ["relative to the local deviation", "over the range of the deviation"].iter().enumerate()
    {
        let v: Vec<f64> = found.iter().map(|f| f[k]).collect();
        let worst = v.iter().copied().fold(0.0, f64::max);
        println!(
            "RMS error of the standard deviation {what}: mean {:.2} %, worst {:.2} %",
            100.0 * mean(&v),
            100.0 * worst
        );
    }
    Ok(())
}

/// y = 1 / (0.1 + u), 15 equidistant points, 1000 test points.
fn local() -> Outcome<()> {
    let f = |u: f64| 1.0 / (0.1 + u);
    let x: Vec<f64> = (0..15).map(|i| f64::from(i) / 14.0).collect();
    let y = x.iter().map(|u| f(*u)).collect();
    let p = Points { inputs: vec!["u".into()], output: "y".into(), x, y };
    for keys in ["", "quadratic = true"] {
        let learnt = learner("local_linear", &keys.parse()?)?.learn(&p, &|| false)?;
        let mut at = Prediction::new(1);
        let squares: f64 = (0..1000)
            .map(|i| {
                let u = f64::from(i) / 999.0;
                learnt.model.predict(&[u], Ask::Mean, &mut at);
                (at.mean - f(u)).powi(2)
            })
            .sum();
        println!(
            "{keys}: {}: RMSE over range {:.4}",
            learnt.model.describe(),
            (squares / 1000.0).sqrt() / (f(0.0) - f(1.0))
        );
    }
    Ok(())
}

/// Wall time of learning, memory and time of a prediction with gradient.
fn size() -> Outcome<()> {
    for n in [300, 1000, 2000, 20_000] {
        let mut rng = Rng64::stream(74, n as u64);
        let p = draw(n, 5, 2.0, &mut rng, engine_like);
        let before = Instant::now();
        let learnt = GaussianProcess::default().learn(&p, &|| false)?;
        let spent = before.elapsed().as_secs_f64();
        let test = draw(1000, 5, 0.0, &mut rng, engine_like);
        let error = Unseen::on(&learnt.model, &test);
        let mut at = Prediction::new(5);
        let before = Instant::now();
        for i in 0..1000 {
            learnt.model.predict(test.row(i), Ask::Gradient, &mut at);
        }
        let predict = before.elapsed().as_secs_f64() * 1e3;
        let bytes = match &learnt.model {
            ResponseModel::GaussianProcess(m) => m.bytes(),
            _ => 0,
        };
        println!(
            "{n} points: {spent:.2} s, prediction with gradient {predict:.1} us, error {:.3} % of the range, {:.1} MiB kept: {}",
            100.0 * error.of_range,
            bytes as f64 / 1_048_576.0,
            learnt.model.describe()
        );
    }
    Ok(())
}

fn process(p: &Points) -> Outcome<GpModel> {
    match (GaussianProcess { starts: 2, ..Default::default() }).learn(p, &|| false)?.model {
        ResponseModel::GaussianProcess(model) => Ok(model),
        other => Err(other.describe().into()),
    }
}

/// Rows that lie far from each other, the first drawn.
fn space_filling(pool: &Points, count: usize, rng: &mut Rng64) -> Vec<usize> {
    let d = pool.dim();
    let spans: Vec<f64> = (0..d)
        .map(|j| {
            let ends =
                pool.column(j).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            (ends.1 - ends.0).max(f64::MIN_POSITIVE)
        })
        .collect();
    let distance = |a: usize, b: usize| -> f64 {
        (0..d).map(|j| ((pool.row(a)[j] - pool.row(b)[j]) / spans[j]).powi(2)).sum()
    };
    let mut chosen = vec![rng.below(pool.len())];
    let mut nearest: Vec<f64> = (0..pool.len()).map(|i| distance(i, chosen[0])).collect();
    while chosen.len() < count {
        let next = (0..pool.len()).max_by(|a, b| nearest[*a].total_cmp(&nearest[*b])).unwrap_or(0);
        chosen.push(next);
        (0..pool.len()).for_each(|i| nearest[i] = nearest[i].min(distance(i, next)));
    }
    chosen
}

/// Errors after `counts` points: by the largest fall of the integrated variance, and by filling the space.
fn campaign(pool: &Points, test: &Points, counts: &[usize], seed: u64) -> Outcome<Vec<[f64; 2]>> {
    let mut rng = Rng64::stream(75, seed);
    let most = counts[counts.len() - 1];
    let filling = space_filling(pool, most, &mut rng);
    let mut taken = filling[..counts[0]].to_vec();
    let reference: Vec<f64> = (0..200).flat_map(|_| pool.row(rng.below(pool.len())).to_vec()).collect();
    let mut out = Vec::new();
    for count in counts {
        while taken.len() < *count {
            let model = process(&pool.rows(&taken))?;
            let free: Vec<usize> = (0..pool.len()).filter(|i| !taken.contains(i)).collect();
            let candidates: Vec<f64> = free.iter().flat_map(|i| pool.row(*i).iter().copied()).collect();
            let batch = 5.min(count - taken.len());
            let next = next_points(&model, Aim::IntegratedVariance, &candidates, &reference, &[], 0.0, batch);
            taken.extend(next.iter().map(|c| free[c.candidate]));
        }
        let error =
            |rows: &[usize]| -> Outcome<f64> { Ok(Unseen::on(&process(&pool.rows(rows))?, test).of_range) };
        out.push([error(&taken)?, error(&filling[..*count])?]);
    }
    Ok(out)
}

fn sequential(map: Option<&str>) -> Outcome<()> {
    let functions: [(&str, usize, Function); 3] = [
        ("ridge 1/(0.1 + x0) + x1", 2, |x| 1.0 / (0.1 + x[0]) + x[1]),
        ("three smooth inputs", 3, three),
        ("knee tanh(8 (x0 - 0.6)) (1 + x1)", 2, |x| (8.0 * (x[0] - 0.6)).tanh() * (1.0 + x[1])),
    ];
    let counts = [15, 25, 40];
    let report = |name: &str, all: Vec<Vec<[f64; 2]>>| {
        for (k, count) in counts.iter().enumerate() {
            let of = |j: usize| -> Vec<f64> { all.iter().map(|e| 100.0 * e[k][j]).collect() };
            let difference: Vec<f64> = all.iter().map(|e| 100.0 * (e[k][0] - e[k][1])).collect();
            println!(
                "{name}, {count} points: integrated variance {:.3} %, space-filling {:.3} %, difference {:.3} +- {:.3} % of the range ({} seeds)",
                mean(&of(0)),
                mean(&of(1)),
                mean(&difference),
                half(&difference),
                all.len()
            );
        }
    };
    for (name, d, f) in functions {
        let all: Vec<Vec<[f64; 2]>> = (0..20_u64)
            .into_par_iter()
            .filter_map(|seed| {
                let mut rng = Rng64::stream(76, seed);
                let pool = draw(400, d, 0.01, &mut rng, f);
                campaign(&pool, &draw(1000, d, 0.0, &mut rng, f), &counts, seed).ok()
            })
            .collect();
        report(name, all);
    }
    if let Some(path) = map {
        let (pool, test) = measured(path)?;
        let all = (0..20_u64)
            .into_par_iter()
            .filter_map(|seed| campaign(&pool, &test, &counts, seed).ok())
            .collect();
        report("torque of the measured map", all);
    }
    Ok(())
}

/// Torque over speed, intake pressure and lambda; every third point is the test.
fn measured(path: &str) -> Outcome<(Points, Points)> {
    let text = std::fs::read_to_string(path)?;
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let place = |name: &str| head.iter().position(|h| *h == name).ok_or(format!("no column `{name}`"));
    let (inputs, output) = (["speed [rpm]", "p_intake [Pa]", "lambda [-]"], "torque [Nm]");
    let columns: Vec<usize> = inputs.iter().chain([&output]).map(|n| place(n)).collect::<Result<_, _>>()?;
    let empty =
        Points { inputs: inputs.map(String::from).to_vec(), output: output.into(), x: vec![], y: vec![] };
    let (mut pool, mut test) = (empty.clone(), empty);
    for (i, line) in lines.enumerate() {
        let cells: Vec<&str> = line.split(',').collect();
        let part = if i % 3 == 2 { &mut test } else { &mut pool };
        for c in &columns[..3] {
            part.x.push(cells[*c].parse()?);
        }
        part.y.push(cells[columns[3]].parse()?);
    }
    Ok((pool, test))
}
