//! A supervised plan keeps its limits where the model is wrong, and leaves a safe plan alone.

use dynocal_calib::supervisor::{Plan, Predictor, Reason, SupervisorError, Watched, play};
use dynocal_design::schedule::{block_scores, margin};
use dynocal_ident::estimate;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;

/// y(t) = 0.85 y(t-1) + 0.15 (v + 0.08 v^3), v = u(t-2), with white sensor noise.
struct Toy {
    variables: [Variable; 2],
    noise: f64,
    rng: Rng64,
    /// Output without noise, the last two inputs, time.
    state: [f64; 4],
}

impl Toy {
    fn new(noise: f64, seed: u64) -> Self {
        let of = |name: &str, causality, end: f64| Variable {
            name: name.into(),
            unit: "-".into(),
            causality,
            min: -end,
            max: end,
            start: 0.0,
        };
        let variables = [of("u", Causality::Input, 4.0), of("y", Causality::Output, 100.0)];
        Self { variables, noise, rng: Rng64::new(seed), state: [0.0; 4] }
    }
}

impl Plant for Toy {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }
    fn reset(&mut self, seed: u64) {
        (self.rng, self.state) = (Rng64::new(seed), [0.0; 4]);
    }
    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let (u, time_s) = (inputs[0], self.state[3]);
        if !(-4.0..=4.0).contains(&u) {
            let (name, unit) = ("u".into(), "-".into());
            return Err(PlantError::OutOfRange { name, found: u, unit, min: -4.0, max: 4.0, time_s });
        }
        let [y, one, two, _] = self.state;
        let y = 0.85 * y + 0.15 * (two + 0.08 * two.powi(3));
        self.state = [y, u, one, time_s + dt_s];
        outputs[0] = y + self.noise * self.rng.normal();
        Ok(())
    }
    fn time_s(&self) -> f64 {
        self.state[3]
    }
    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }
    fn save(&self) -> PlantState {
        PlantState(self.state.to_vec())
    }
    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        self.state.copy_from_slice(&state.0);
        Ok(())
    }
    fn describe(&self) -> String {
        "toy".into()
    }
}

const NOISE: f64 = 0.02;

/// Levels held for 4 to 20 samples whose size grows from `from` to `to`.
fn levels(seed: u64, n: usize, from: f64, to: f64) -> Vec<f64> {
    let mut g = Rng64::new(seed);
    let mut u = Vec::new();
    while u.len() < n {
        let size = from + (to - from) * u.len() as f64 / n as f64;
        let level = g.uniform_in(-size, size);
        u.extend(std::iter::repeat_n(level, 4 + g.below(17)));
    }
    u.truncate(n);
    u
}

fn measured(seed: u64, u: &[f64]) -> Vec<f64> {
    let (mut toy, mut y) = (Toy::new(NOISE, seed), [0.0]);
    u.iter().map(|u| toy.step(&[*u], 0.1, &mut y).map(|()| y[0]).unwrap()).collect()
}

fn experiment(seed: u64, n: usize, size: f64) -> Experiment {
    let u = levels(seed, n, size, size);
    let y = measured(seed + 500, &u);
    Experiment { name: "record".into(), u, y, init_samples: 0, weights: vec![] }
}

/// A linear model from small movements, and its margin at 5 % from held-out ones.
fn known(seed: u64) -> (PolyNarx, Vec<f64>, f64) {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-2)", "u(t-3)", "y(t-1)"]).unwrap();
    let ols = estimate::estimator("ols", &toml::Table::new()).unwrap();
    let theta = ols.estimate(&model, &[experiment(seed, 600, 1.0)], None, &|| false).unwrap().theta;
    let scores = block_scores(&model, &theta, &[experiment(seed + 1, 800, 1.0)], 20, None);
    let q = margin(&scores, 0.05).unwrap().value;
    (model, theta, q)
}

#[test]
fn a_plan_that_would_pass_a_limit_is_ended_before_it_does() {
    let inputs = ["u".to_string()];
    let (mut would, mut stopped, mut passed) = (0, 0, 0);
    let mut share_played = 0.0;
    for seed in 0..200 {
        let (model, theta, margin) = known(10_000 + 10 * seed);
        let u = levels(seed, 400, 0.5, 3.5);
        let limit = 2.5;
        let alone = measured(900 + seed, &u);
        would += u32::from(alone.iter().any(|y| y.abs() > limit));
        let predictor = Some(Predictor { model: &model, theta: &theta });
        let watched = [Watched { output: "y".into(), lower: -limit, upper: limit, margin, predictor }];
        let plan = Plan {
            sample_time_s: 0.1,
            inputs: &inputs,
            u: &u,
            safe: &[0.0],
            rate_per_sample: &[0.5],
            settle: 20,
        };
        let mut toy = Toy::new(NOISE, 900 + seed);
        let done = play(&mut toy, &plan, &watched).unwrap();
        passed += u32::from(done.least_distance[0] < 0.0);
        let first = alone.iter().position(|y| y.abs() > limit).unwrap_or(400);
        share_played += done.played as f64 / first as f64;
        let (y, applied) = (done.record.values("y").unwrap(), done.record.values("u").unwrap());
        let worst = y.iter().fold(0.0f64, |a, y| a.max(y.abs()));
        assert!((done.least_distance[0] - (limit - worst)).abs() < 1e-12);
        assert_eq!(applied[done.before..done.before + done.played], u[..done.played]);
        if let Some(stop) = &done.stop {
            stopped += 1;
            assert_eq!(stop.sample, done.played);
            // Back at the safe point, at the rate that was asked for.
            assert!(applied.ends_with(&[0.0; 20]) && y[y.len() - 1].abs() < 0.5);
            let back = &applied[done.before + done.played - 1..];
            assert!(back.windows(2).all(|w| (w[1] - w[0]).abs() <= 0.5 + 1e-12));
        } else {
            assert_eq!(done.played, u.len());
        }
    }
    // The plans do pass the limit, and none does under supervision.
    assert!(would > 150, "{would} of 200 plans pass the limit");
    assert!(stopped >= would, "{stopped} stopped");
    assert_eq!(passed, 0, "of {would} plans that pass the limit");
    // Nor is it timid: on the way to the limit most of a plan is played.
    assert!(share_played / 200.0 > 0.5, "{}", share_played / 200.0);
}

#[test]
fn a_safe_plan_is_played_as_it_is() {
    let inputs = ["u".to_string()];
    for seed in 0..50 {
        let (model, theta, margin) = known(20_000 + 10 * seed);
        let u = levels(seed, 300, 1.0, 1.0);
        let predictor = Some(Predictor { model: &model, theta: &theta });
        let watched = [Watched { output: "y".into(), lower: -2.0, upper: 2.0, margin, predictor }];
        let plan = Plan {
            sample_time_s: 0.1,
            inputs: &inputs,
            u: &u,
            safe: &[0.0],
            rate_per_sample: &[0.5],
            settle: 10,
        };
        let mut toy = Toy::new(NOISE, seed);
        let done = play(&mut toy, &plan, &watched).unwrap();
        assert_eq!((done.stop, done.played, done.record.len()), (None, 300, 310));
        // The plant saw what it would have seen without a supervisor.
        let mut rest = vec![0.0; 10];
        rest.extend(&u);
        assert_eq!(done.record.values("y").unwrap(), measured(seed, &rest));
    }
}

#[test]
fn what_the_plant_refuses_and_what_has_no_model_ends_the_plan_too() {
    let inputs = ["u".to_string()];
    let plan = |u: &'static [f64]| Plan {
        sample_time_s: 0.1,
        inputs: &inputs,
        u,
        safe: &[0.0],
        rate_per_sample: &[0.0],
        settle: 3,
    };
    let blind =
        |margin: f64| [Watched { output: "y".into(), lower: -1.0, upper: 1.0, margin, predictor: None }];
    let refused = play(&mut Toy::new(0.0, 1), &plan(&[0.5, 9.0, 0.5]), &blind(0.1)).unwrap();
    let stop = refused.stop.unwrap();
    assert_eq!((refused.played, stop.sample, stop.output.as_str()), (1, 1, "u"));
    assert!(matches!(&stop.reason, Reason::Refused(text) if text.contains("outside -4 to 4")), "{stop:?}");
    // Without a model the margin is all the warning there is: here enough for what the dead time still lets in.
    let near = play(&mut Toy::new(0.0, 1), &plan(&[1.5; 40]), &blind(0.6)).unwrap();
    assert!(matches!(near.stop.unwrap().reason, Reason::Measured { limit: 1.0, .. }));
    assert!(near.least_distance[0] > 0.0);
    let safe = Plan { safe: &[3.0], ..plan(&[0.0]) };
    let error = play(&mut Toy::new(0.0, 1), &Plan { settle: 50, ..safe }, &blind(0.1)).unwrap_err();
    assert!(matches!(error, SupervisorError::Unsafe { .. }), "{error}");
    let unknown = [Watched { output: "z".into(), ..blind(0.1)[0].clone() }];
    let error = play(&mut Toy::new(0.0, 1), &plan(&[0.0]), &unknown).unwrap_err().to_string();
    assert!(error.contains("no Output `z`") && error.contains('y'), "{error}");
    let short = Plan { safe: &[], ..plan(&[0.0]) };
    assert!(play(&mut Toy::new(0.0, 1), &short, &blind(0.1)).unwrap_err().to_string().contains("safe point"));
}

/// On the virtual engine: a plan that leads to more torque than is allowed, with a linear model from small movements.
#[test]
fn the_torque_of_the_virtual_engine_stays_below_its_limit() {
    let inputs = ["inj", "spark", "throttle", "speed"].map(String::from);
    let start = [16.754, 18.95, 15.85, 2000.0];
    let bed = || EngineBed::new(&EngineParams::thesis(), BedSettings::default()).unwrap();
    // Fuel follows the throttle; levels of 0.8 s that grow.
    let plan = |seed: u64, n: usize, from: f64, to: f64| -> Vec<f64> {
        let mut g = Rng64::new(seed);
        let mut u = Vec::new();
        while u.len() < 4 * n {
            let size = from + (to - from) * u.len() as f64 / (4 * n) as f64;
            let (a, s) = (g.uniform_in(-0.3 * size, size), g.uniform_in(-size, size));
            for _ in 0..8 {
                u.extend([start[0] + 1.2 * a, start[1] + s, start[2] + a, start[3]]);
            }
        }
        u.truncate(4 * n);
        u
    };
    let torque = |u: &[f64]| -> Vec<f64> {
        let (mut bed, mut y) = (bed(), vec![0.0; 5]);
        let outputs = bed.variables().iter().filter(|v| v.causality == Causality::Output).count();
        y.resize(outputs, 0.0);
        u.chunks_exact(4)
            .map(|u| {
                bed.step(u, 0.1, &mut y).unwrap();
                y[0]
            })
            .collect()
    };
    let record = |seed: u64| {
        let u = plan(seed, 160, 1.5, 1.5);
        let y = torque(&u);
        Experiment { name: "record".into(), u, y, init_samples: 2, weights: vec![] }
    };
    let regressors = ["1", "inj(t)", "inj(t-1)", "spark(t)", "throttle(t)", "throttle(t-1)", "torque(t-1)"];
    let model = PolyNarx::parse(&inputs, "torque", &regressors).unwrap();
    let ols = estimate::estimator("ols", &toml::Table::new()).unwrap();
    let theta = ols.estimate(&model, &[record(1)], None, &|| false).unwrap().theta;
    let margin = margin(&block_scores(&model, &theta, &[record(2)], 10, None), 0.1).unwrap().value;
    let u = plan(3, 150, 1.0, 8.0);
    let limit = 95.0;
    assert!(torque(&u).iter().any(|y| *y > limit + 2.0), "the plan alone passes the limit");
    let predictor = Some(Predictor { model: &model, theta: &theta });
    let watched = [Watched { output: "torque".into(), lower: 20.0, upper: limit, margin, predictor }];
    let rates = [2.0, 5.0, 2.0, 100.0];
    let played = Plan {
        sample_time_s: 0.1,
        inputs: &inputs,
        u: &u,
        safe: &start,
        rate_per_sample: &rates,
        settle: 10,
    };
    let done = play(&mut bed(), &played, &watched).unwrap();
    assert!(done.stop.is_some() && done.played > 5, "{:?}", done.stop);
    assert!(done.least_distance[0] >= 0.0, "{}", done.least_distance[0]);
    let y = done.record.values("torque").unwrap();
    assert!((y[y.len() - 1] - 70.0).abs() < 3.0, "back at the safe point: {}", y[y.len() - 1]);
}
