//! A supervised plan keeps its limits where the model is wrong, and leaves a safe plan alone.

use dynocal_calib::supervisor::{Predictor, Supervisor, Watched, for_plan};
use dynocal_design::schedule::{block_scores, margin};
use dynocal_ident::data::Dataset;
use dynocal_ident::estimate;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLimit, PlanLoop};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};
use dynocal_ident::play::{PlayError, Reason, Unwatched, play};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;

/// y(t) = 0.85 y(t-1) + 0.15 (v + 0.08 v^3), v = u(t-3), with white sensor noise.
struct Toy {
    variables: [Variable; 2],
    noise: f64,
    rng: Rng64,
    shown: f64,
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
        Self { variables, noise, rng: Rng64::new(seed), shown: 0.0, state: [0.0; 4] }
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
        self.shown = y + self.noise * self.rng.normal();
        outputs[0] = self.shown;
        Ok(())
    }
    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        outputs[0] = self.shown;
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

/// A plan of the toy: from rest at 0, then `u`, settled for `settle` samples before.
fn toy_plan(u: &[f64], settle: usize, rate_per_s: Option<f64>) -> Plan {
    let values = std::iter::once(0.0).chain(u.iter().copied()).collect();
    let channel = PlanChannel { rate_per_s, ..PlanChannel::free("u", "-", values) };
    Plan::open_loop("toy", 0.1, vec![channel]).settled(0.1 * settle as f64)
}

/// Unwatched.
fn alone(seed: u64, u: &[f64], settle: usize) -> Dataset {
    play(&mut Toy::new(NOISE, seed), &toy_plan(u, settle, None), &mut Unwatched).unwrap().record
}

fn experiment(seed: u64, n: usize, size: f64) -> Experiment {
    let record = alone(seed + 500, &levels(seed, n, size, size), 5);
    let (u, y) = (record.values("u").unwrap().to_vec(), record.values("y").unwrap().to_vec());
    Experiment { name: "record".into(), u, y, init_samples: 0, weights: vec![] }
}

/// A linear model from small movements, and its margin at 5 % from held-out ones.
fn known(seed: u64) -> (PolyNarx, Vec<f64>, f64) {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-2)", "u(t-3)", "u(t-4)", "y(t-1)"]).unwrap();
    let ols = estimate::estimator("ols", &toml::Table::new()).unwrap();
    let theta = ols.estimate(&model, &[experiment(seed, 600, 1.0)], None, &|| false).unwrap().theta;
    let scores = block_scores(&model, &theta, &[experiment(seed + 1, 800, 1.0)], 20, None);
    let q = margin(&scores, 0.05).unwrap().value;
    (model, theta, q)
}

fn largest(y: &[f64]) -> f64 {
    y.iter().fold(0.0f64, |a, y| a.max(y.abs()))
}

#[test]
fn a_plan_that_would_pass_a_limit_is_ended_before_it_does() {
    let (mut would, mut stopped, mut passed) = (0, 0, 0);
    let mut share_played = 0.0;
    for seed in 0..200 {
        let (model, theta, margin) = known(10_000 + 10 * seed);
        // Within the rate of the way back, so that the plan is played as it is.
        let u = ramps(&levels(seed, 400, 0.5, 3.5), 0.5);
        let limit = 2.5;
        let unwatched = alone(900 + seed, &u, 20);
        let unwatched = unwatched.values("y").unwrap();
        would += u32::from(largest(unwatched) > limit);
        let plan = toy_plan(&u, 20, Some(5.0))
            .with_limits(vec![PlanLimit::between("y", "-", -limit, limit, margin)]);
        let predictor = Predictor { model: &model, theta: &theta };
        let mut supervisor = for_plan(&plan, &[("y", predictor)]);
        let done = play(&mut Toy::new(NOISE, 900 + seed), &plan, &mut supervisor).unwrap();
        let least = done.least_distance[0].distance;
        passed += u32::from(least < 0.0);
        let first = unwatched.iter().position(|y| y.abs() > limit).unwrap_or(401);
        share_played += done.played as f64 / first as f64;
        let (y, applied) = (done.record.values("y").unwrap(), done.record.values("u").unwrap());
        let back = done.way_back.as_ref().map_or(&[][..], |b| b.values("y").unwrap());
        assert!(least <= limit - largest(y).max(largest(back)) + 1e-12, "no measured value is left out");
        assert_eq!(applied, &plan.channels[0].values[..done.played]);
        assert_eq!((done.before, done.record.len()), (20, done.played));
        if let Some(stop) = &done.stop {
            stopped += 1;
            assert_eq!(stop.sample, done.played);
            // Back at the safe point, at the rate that was asked for.
            let way = done.way_back.as_ref().unwrap().values("u").unwrap();
            assert!(way.ends_with(&[0.0; 20]) && back[back.len() - 1].abs() < 0.5);
            let course: Vec<f64> = applied.last().into_iter().chain(way).copied().collect();
            assert!(course.windows(2).all(|w| (w[1] - w[0]).abs() <= 0.5 + 1e-12));
        } else {
            assert_eq!(done.played, plan.len());
        }
    }
    // The plans do pass the limit, and none does under supervision.
    assert!(would > 150, "{would} of 200 plans pass the limit");
    assert!(stopped >= would, "{stopped} stopped");
    assert_eq!(passed, 0, "of {would} plans that pass the limit");
    // Nor is it timid: on the way to the limit most of a plan is played.
    assert!(share_played / 200.0 > 0.5, "{}", share_played / 200.0);
}

/// `u` with steps of at most `most`.
fn ramps(u: &[f64], most: f64) -> Vec<f64> {
    let mut at = 0.0;
    u.iter()
        .map(|v| {
            at += (v - at).clamp(-most, most);
            at
        })
        .collect()
}

#[test]
fn a_safe_plan_is_played_as_it_is() {
    for seed in 0..50 {
        let (model, theta, margin) = known(20_000 + 10 * seed);
        let u = levels(seed, 300, 1.0, 1.0);
        let predictor = Some(Predictor { model: &model, theta: &theta });
        let watched = Watched { output: "y".into(), lower: -2.0, upper: 2.0, margin, predictor };
        let plan = toy_plan(&u, 10, None);
        let done = play(&mut Toy::new(NOISE, seed), &plan, &mut Supervisor::new(vec![watched])).unwrap();
        assert_eq!((done.stop, done.played, done.record.len()), (None, 301, 301));
        // The plant saw what it would have seen without a supervisor.
        assert_eq!(done.record, alone(seed, &u, 10));
    }
}

/// A loop leads where nobody planned: the supervisor sees what it is about to apply.
#[test]
fn what_a_loop_is_about_to_do_is_watched_too() {
    let (mut would, mut passed, mut share) = (0, 0, 0.0);
    for seed in 0..50 {
        let (model, theta, margin) = known(30_000 + 10 * seed);
        // The demand grows beyond the limit of 2.5; the feedforward stays at 0.
        let demand = levels(seed, 400, 0.5, 5.0);
        let values = std::iter::once(0.0).chain(demand.iter().copied()).collect();
        let demand = PlanDemand { output: "y".into(), unit: "-".into(), values };
        let closed = PlanLoop::closed("y", "u", PiGains { ki: 0.8, kp: 0.3 });
        let mut plan = toy_plan(&[0.0; 400], 20, Some(5.0)).with_loops(vec![demand], vec![closed]);
        plan.channels[0] = plan.channels[0].clone().within(-4.0, 4.0);
        let free = play(&mut Toy::new(NOISE, seed), &plan, &mut Unwatched).unwrap().record;
        let free = free.values("y").unwrap();
        would += u32::from(largest(free) > 2.5);
        let plan = plan.with_limits(vec![PlanLimit::between("y", "-", -2.5, 2.5, margin)]);
        let predictor = Predictor { model: &model, theta: &theta };
        let done =
            play(&mut Toy::new(NOISE, seed), &plan, &mut for_plan(&plan, &[("y", predictor)])).unwrap();
        passed += u32::from(done.least_distance[0].distance < 0.0);
        // Until it objects, the loop does what it does alone.
        assert_eq!(done.record.values("y").unwrap(), &free[..done.played]);
        share += done.played as f64 / free.iter().position(|y| y.abs() > 2.5).unwrap_or(401) as f64;
    }
    assert!(would > 30, "{would} of 50 loops pass the limit");
    assert_eq!(passed, 0, "of {would} loops that pass the limit");
    assert!(share / 50.0 > 0.5, "{}", share / 50.0);
}

#[test]
fn what_the_plant_refuses_and_what_has_no_model_ends_the_plan_too() {
    let watched = |output: &str, margin: f64| {
        Supervisor::new(vec![Watched {
            output: output.into(),
            lower: -1.0,
            upper: 1.0,
            margin,
            predictor: None,
        }])
    };
    let blind = |margin: f64| watched("y", margin);
    let toy = || Toy::new(0.0, 1);
    let refused = play(&mut toy(), &toy_plan(&[0.5, 9.0, 0.5], 3, None), &mut blind(0.1)).unwrap();
    let stop = refused.stop.clone().unwrap();
    assert_eq!((refused.played, stop.sample, stop.output.as_str()), (2, 2, "u"));
    assert!(
        matches!(&stop.reason, Reason::Refused(e) if e.to_string().contains("outside -4 to 4")),
        "{stop:?}"
    );
    assert!(refused.whole().unwrap_err().to_string().contains("2 samples were played"));
    // Without a model the margin is all the warning there is: here enough for what the dead time still lets in.
    let plan = toy_plan(&[1.5; 40], 3, None).with_limits(vec![PlanLimit::between("y", "-", -1.0, 1.0, 0.6)]);
    let near = play(&mut toy(), &plan, &mut for_plan(&plan, &[])).unwrap();
    assert!(matches!(near.stop.unwrap().reason, Reason::Measured { limit: 1.0, .. }));
    assert!(near.least_distance[0].distance > 0.0);
    let far = Plan::open_loop("far", 0.1, vec![PlanChannel::free("u", "-", vec![3.0])]).settled(5.0);
    let error = play(&mut toy(), &far, &mut blind(0.1)).unwrap_err();
    assert!(matches!(error, PlayError::Unsafe { .. }), "{error}");
    let error = play(&mut toy(), &toy_plan(&[0.0], 3, None), &mut watched("z", 0.1)).unwrap_err().to_string();
    assert!(error.contains("no such output") && error.contains('y'), "{error}");
    let model = PolyNarx::parse(&["u", "v"], "y", &["u(t-1)", "v(t-1)"]).unwrap();
    let predictor = Predictor { model: &model, theta: &[0.0, 0.0] };
    let plan = toy_plan(&[0.0], 3, None).with_limits(vec![PlanLimit::upper("y", "-", 1.0, 0.1)]);
    let error = play(&mut toy(), &plan, &mut for_plan(&plan, &[("y", predictor)])).unwrap_err().to_string();
    assert!(error.contains("found 2 inputs, expected the 1 channels"), "{error}");
}

/// On the virtual engine: a plan that leads to more torque than is allowed, with a linear model from small movements.
#[test]
fn the_torque_of_the_virtual_engine_stays_below_its_limit() {
    let names = ["inj", "spark", "throttle", "speed"];
    let units = ["mg", "deg", "deg", "rpm"];
    let start = [16.754, 18.95, 15.85, 2000.0];
    let rates = [20.0, 50.0, 20.0, 1000.0];
    let bed = || EngineBed::new(&EngineParams::thesis(), BedSettings::default()).unwrap();
    // Fuel follows the throttle; levels of 0.8 s that grow, after the start point.
    let plan = |seed: u64, n: usize, from: f64, to: f64| -> Plan {
        let mut g = Rng64::new(seed);
        let mut rows = vec![start];
        while rows.len() < n {
            let size = from + (to - from) * rows.len() as f64 / n as f64;
            let (a, s) = (g.uniform_in(-0.3 * size, size), g.uniform_in(-size, size));
            for _ in 0..8 {
                rows.push([start[0] + 1.2 * a, start[1] + s, start[2] + a, start[3]]);
            }
        }
        rows.truncate(n);
        let channel = |i: usize| {
            let values = rows.iter().map(|r| r[i]).collect();
            PlanChannel { rate_per_s: Some(rates[i]), ..PlanChannel::free(names[i], units[i], values) }
        };
        Plan::open_loop("engine", 0.1, (0..4).map(channel).collect()).settled(1.0)
    };
    let record = |seed: u64| {
        let record = play(&mut bed(), &plan(seed, 160, 1.5, 1.5), &mut Unwatched).unwrap().record;
        let u = record.matrix(&names.map(String::from)).unwrap();
        let y = record.values("torque").unwrap().to_vec();
        Experiment { name: "record".into(), u, y, init_samples: 2, weights: vec![] }
    };
    let regressors =
        ["1", "inj(t-1)", "inj(t-2)", "spark(t-1)", "throttle(t-1)", "throttle(t-2)", "torque(t-1)"];
    let model = PolyNarx::parse(&names.map(String::from), "torque", &regressors).unwrap();
    let ols = estimate::estimator("ols", &toml::Table::new()).unwrap();
    let theta = ols.estimate(&model, &[record(1)], None, &|| false).unwrap().theta;
    let margin = margin(&block_scores(&model, &theta, &[record(2)], 10, None), 0.1).unwrap().value;
    let limit = 95.0;
    let plan =
        plan(3, 150, 1.0, 8.0).with_limits(vec![PlanLimit::between("torque", "Nm", 20.0, limit, margin)]);
    let alone = play(&mut bed(), &plan, &mut Unwatched).unwrap();
    assert!(alone.least_distance[0].distance < -2.0, "the plan alone passes the limit");
    let predictor = Predictor { model: &model, theta: &theta };
    let done = play(&mut bed(), &plan, &mut for_plan(&plan, &[("torque", predictor)])).unwrap();
    assert!(done.stop.is_some() && done.played > 5, "{:?}", done.stop);
    assert!(done.least_distance[0].distance >= 0.0, "{}", done.least_distance[0].distance);
    let back = done.way_back.unwrap();
    let y = back.values("torque").unwrap();
    assert!((y[y.len() - 1] - 70.0).abs() < 3.0, "back at the safe point: {}", y[y.len() - 1]);
}
