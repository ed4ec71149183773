//! Parts of the bed against closed solutions and balances, without an engine.

use dynocal_plant::deviations::{Deviations, Scatter};
use dynocal_plant::film::{Film, FilmModel};
use dynocal_plant::testbed::catalyst::{CatalystSettings, Feed};
use dynocal_plant::testbed::delay::DelayLine;
use dynocal_plant::testbed::dynamics::{ActuatorSettings, Lag, PiGains};
use dynocal_plant::testbed::dynamometer::{DynoMode, DynoSettings, DynoState};
use dynocal_plant::testbed::guard::{Action, Found, GuardState, HOLD_S, LimitSettings};
use dynocal_plant::testbed::sensor::{SensorSettings, quantise};
use dynocal_plant::testbed::thermal::{ThermalSettings, viscosity_mm2_s};

const RAD_S: f64 = std::f64::consts::PI / 30.0;

/// Runs a dynamometer against an engine torque that is a function of speed \[rad/s\].
fn spin(
    d: &DynoSettings,
    from_rpm: f64,
    demand: f64,
    torque: impl Fn(f64) -> f64,
    h: f64,
    n: usize,
) -> DynoState {
    let mut s = d.at(from_rpm, 0.0);
    for _ in 0..n {
        let tick = d.begin(&mut s, demand, h);
        d.end(&mut s, tick, torque(tick.omega) * tick.omega * h, h);
    }
    s
}

#[test]
fn load_mode_answers_a_step_as_the_closed_solution() {
    let d = DynoSettings { mode: DynoMode::Load, ..DynoSettings::default() };
    let j = d.inertia_kg_m2();
    // Constant torque: a straight line, whatever the tick (up to the first tick, whose acceleration is not known).
    let s = spin(&d, 2000.0, 40.0, |_| 70.0, 1e-3, 1000);
    let expected = 2000.0 * RAD_S + (70.0 - 40.0) / j;
    assert!((s.omega - expected).abs() < 1e-2 * 1e-3 * expected, "{} {expected}", s.omega);
    // Torque that falls with speed, T = T_0 - b w: w_inf + (w_0 - w_inf) e^(-b t/J).
    let (t0, b) = (150.0, 0.4);
    let end = |h: f64, n: usize| spin(&d, 2000.0, 40.0, |w| t0 - b * w, h, n).omega;
    let (w0, w1) = (2000.0 * RAD_S, (t0 - 40.0) / b);
    let exact = w1 + (w0 - w1) * (-b * 0.8 / j).exp();
    let (coarse, fine) = ((end(4e-3, 200) - exact).abs(), (end(1e-3, 800) - exact).abs());
    assert!(fine < 1e-5 * exact, "{fine}");
    // Second order: a quarter of the tick, a sixteenth of the error.
    assert!(coarse / fine > 10.0, "{coarse} {fine}");
}

#[test]
fn power_is_balanced_to_rounding_and_a_held_rotor_says_so() {
    let d = DynoSettings { mode: DynoMode::Load, ..DynoSettings::default() };
    let check = |s: &DynoState, from: f64| {
        let half = 0.5 * d.inertia_kg_m2();
        let kinetic = half * (s.omega * s.omega - (from * RAD_S).powi(2));
        let balance = s.engine_j - s.load_j + s.held_j - kinetic;
        assert!(balance.abs() < 1e-9 * s.load_j.abs().max(1.0), "{balance} {s:?}");
    };
    let s = spin(&d, 3000.0, 55.0, |w| 60.0 + 20.0 * (0.37 * w).sin(), 1e-3, 5000);
    check(&s, 3000.0);
    assert_eq!(s.held_j, 0.0);
    // A load that the engine cannot carry: held at the least speed, and the work for it is on the account.
    let s = spin(&d, 1500.0, 100.0, |_| 10.0, 1e-3, 3000);
    check(&s, 1500.0);
    assert!((s.speed_rpm() - d.least_rpm).abs() < 1e-9 && s.held_j > 0.0);
}

#[test]
fn the_speed_controller_is_the_second_order_system_that_its_gains_make() {
    let d = DynoSettings { mode: DynoMode::InertialSpeed, ..DynoSettings::default() };
    let j = d.inertia_kg_m2();
    // A step of engine torque T: J w' = T - p w - i int w, so w(t) = T/(J w_d) e^(-z w_n t) sin(w_d t).
    let (p, i) = (d.gains.proportional, d.gains.integral);
    let wn = (i / j).sqrt();
    let z = p / (2.0 * (i * j).sqrt());
    let wd = wn * (1.0 - z * z).sqrt();
    let torque = 50.0;
    for n in [50, 150, 400] {
        let h = 5e-4;
        let s = spin(&d, 2000.0, 2000.0, |_| torque, h, n);
        let t = h * n as f64;
        let exact = torque / (j * wd) * (-z * wn * t).exp() * (wd * t).sin();
        let peak = torque / (j * wn);
        assert!((s.omega - 2000.0 * RAD_S - exact).abs() < 0.01 * peak, "{n}: {} {exact}", s.omega);
    }
    // At the end the load carries the engine and the speed is the demanded one.
    let s = spin(&d, 2000.0, 2500.0, |_| torque, 1e-3, 5000);
    assert!((s.speed_rpm() - 2500.0).abs() < 1e-6 && (s.load_nm - torque).abs() < 1e-6);
}

#[test]
fn lag_actuator_and_controller_have_their_closed_answers() {
    let mut lag = Lag::new(1.0);
    (0..37).for_each(|_| _ = lag.step(3.0, 0.07, 0.002));
    assert!((lag.value - (3.0 - 2.0 * (-0.074f64 / 0.07).exp())).abs() < 1e-13);
    // Rate limit: a straight line while the lag would be faster.
    let a = ActuatorSettings { lag_s: 0.05, rate_per_s: 100.0 };
    let mut x = Lag::new(0.0);
    for k in 1..=300 {
        let before = x.value;
        a.step(&mut x, 80.0, 0.002);
        assert!(x.value - before <= 100.0 * 0.002 + 1e-12);
        if k <= 200 {
            assert!((x.value - 0.2 * f64::from(k)).abs() < 1e-9, "{k} {}", x.value);
        }
    }
    // PI on a constant error: p e + i e t, stopped at the limit without winding up.
    let g = PiGains { proportional: 2.0, integral: 5.0 };
    let mut integral = 0.0;
    let y: Vec<f64> = (0..1000).map(|_| g.step(&mut integral, 0.1, (0.0, 1.0), 0.01)).collect();
    assert!((y[9] - (0.2 + 0.05)).abs() < 1e-12 && y[999] == 1.0);
    assert!(g.step(&mut integral, -0.2, (0.0, 1.0), 0.01) < 0.6, "leaves the limit at once");
}

#[test]
fn a_constant_delay_is_an_exact_shift() {
    let u = |k: i64| if k < 0 { -1.0 } else { (0.3 * k as f64).sin() + (k % 7) as f64 };
    for (delay, h) in [(0.15_f64, 0.03), (0.03, 0.001), (1.0, 0.01)] {
        let n = (delay / h).round() as i64;
        let mut line = DelayLine::new(delay, n as usize + 3, -1.0);
        // Long enough for the coordinate to start over.
        for k in 0..20_000 {
            let y = line.push(u(k), h);
            assert_eq!(y, u(k + 1 - n), "delay {delay}, step {k}");
        }
    }
    // Between the steps of a held input the value of the step in which t - delay lies.
    let mut line = DelayLine::new(0.025, 8, -1.0);
    for k in 0..50 {
        assert_eq!(line.push(u(k), 0.01), u(k - 2), "{k}");
    }
}

#[test]
fn transport_follows_the_flow() {
    // Plug flow of content M with flow q(t) = q0 (1 + 0.6 sin t): what leaves at t entered at t0 with
    // Q(t) - Q(t0) = M, Q the integral of q. A ramp u(t) = t reads as t0.
    let (q0, m, h) = (10.0f64, 3.0, 1e-3);
    let total = |t: f64| q0 * (t + 0.6 * (1.0 - t.cos()));
    let mut line = DelayLine::new(m, 1000, 0.0);
    for k in 0..8000 {
        let (t, t1) = (h * f64::from(k), h * f64::from(k + 1));
        let y = line.push(t, total(t1) - total(t));
        // Bisection for the entry time.
        let (mut lo, mut hi) = (t1 - 2.0, t1);
        for _ in 0..60 {
            let mid = 0.5 * (lo + hi);
            if total(t1) - total(mid) > m { lo = mid } else { hi = mid }
        }
        if lo > 0.0 {
            assert!(y <= lo + 1e-6 && y > lo - h - 1e-6, "{y} {lo}");
        }
    }
    // Without flow nothing moves.
    let before = line.push(0.0, 0.0);
    for _ in 0..100 {
        assert_eq!(line.push(5.0, 0.0), before);
    }
}

#[test]
fn quantisation_gives_multiples_with_a_uniform_error() {
    let q = 0.25;
    let n = 40_000;
    let (mut sum, mut square) = (0.0, 0.0);
    let mut bins = [0usize; 10];
    for k in 0..n {
        // A slow sweep that is no rational multiple of the step.
        let x = 0.001 * f64::from(k) * std::f64::consts::SQRT_2 - 20.0;
        let y = quantise(x, q);
        assert_eq!((y / q).fract(), 0.0);
        let e = y - x;
        assert!(e.abs() <= 0.5 * q + 1e-12);
        sum += e;
        square += e * e;
        bins[(((e / q + 0.5) * 10.0) as usize).min(9)] += 1;
    }
    let n = f64::from(n);
    assert!((sum / n).abs() < 1e-3 * q && (square / n - q * q / 12.0).abs() < 1e-3 * q * q);
    assert!(bins.iter().all(|&b| (b as f64 - n / 10.0).abs() < 0.02 * n), "{bins:?}");
}

#[test]
fn drift_and_noise_have_their_variance_and_seeds_are_independent() {
    let s = SensorSettings { noise: 2.0, drift: 0.0, ..SensorSettings::default() };
    let n = 20_000;
    let series = |s: &SensorSettings, seed: u64, dt: f64| -> Vec<f64> {
        let mut state = s.at(10.0, 1e-3);
        (0..n)
            .map(|k| {
                state.tick(s, 10.0, 10.0, dt);
                state.read(s, false, (seed, k), dt) - 10.0
            })
            .collect()
    };
    let correlation = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>() / n as f64;
    let (a, b) = (series(&s, 1, 0.01), series(&s, 2, 0.01));
    // Five standard errors: of the variance of white noise 5 sqrt(2/n), of a correlation 5/sqrt(n).
    let e = 5.0 / (n as f64).sqrt();
    for x in [&a, &b] {
        assert!((correlation(x, x) / 4.0 - 1.0).abs() < e * 2f64.sqrt());
        assert!((correlation(&x[1..], x) / 4.0).abs() < e, "white");
    }
    assert!((correlation(&a, &b) / 4.0).abs() < e, "seeds are independent");
    assert_eq!(a, series(&s, 1, 0.01));
    // Ornstein-Uhlenbeck from zero: variance s^2 (1 - e^(-2t/tau)), correlation e^(-t/tau). Over 2000 seeds.
    let d = SensorSettings { drift: 3.0, drift_s: 5.0, ..SensorSettings::default() };
    let (mut early, mut late, mut cross) = (0.0, 0.0, 0.0);
    let seeds = 2000;
    for seed in 0..seeds {
        let mut state = d.at(0.0, 1e-3);
        let mut read = |k| {
            state.tick(&d, 0.0, 10.0, 0.5);
            state.read(&d, false, (seed, k), 0.5)
        };
        let y: Vec<f64> = (0..30).map(&mut read).collect();
        early += y[1] * y[1];
        late += y[29] * y[29];
        cross += y[29] * y[24];
    }
    let m = seeds as f64;
    let stationary = |t: f64| 9.0 * (1.0 - (-2.0 * t / 5.0f64).exp());
    let e = 5.0 * (2.0 / m).sqrt();
    assert!((early / m / stationary(1.0) - 1.0).abs() < e, "{}", early / m);
    assert!((late / m / stationary(15.0) - 1.0).abs() < e, "{}", late / m);
    assert!((cross / m / 9.0 - (-2.5f64 / 5.0).exp()).abs() < e, "{}", cross / m);
}

#[test]
fn a_guard_backs_off_trips_in_half_its_time_and_recovers() {
    let limit = LimitSettings {
        what: "pmax".into(),
        max: Some(50.0),
        action: Action::RetardSpark,
        within_s: 0.4,
        ..LimitSettings::default()
    };
    let h = 0.01;
    let mut g = GuardState::default();
    assert_eq!(g.tick(&limit, Some(49.0), h), Found::Nothing);
    assert_eq!(g.tick(&limit, Some(51.0), h), Found::Exceeded);
    let mut outside = 1;
    while g.tick(&limit, Some(51.0), h) != Found::Tripped {
        outside += 1;
        assert!(outside <= 20, "trips after half of 0.4 s");
    }
    assert!(outside >= 19 && (g.correction - 40.0 * h * f64::from(outside + 1)).abs() < 1e-9);
    // The trip ends after the hold time inside; the correction then goes back.
    let kept = g.correction;
    let mut held = 0;
    while g.trip_s > 0.0 {
        g.tick(&limit, Some(10.0), h);
        held += 1;
    }
    assert!((f64::from(held) * h - HOLD_S).abs() < 2.0 * h && g.correction > kept - 0.1);
    (0..600).for_each(|_| _ = g.tick(&limit, Some(10.0), h));
    assert_eq!(g.correction, 0.0);
    // Absent values count as inside; limits below work alike.
    assert_eq!(g.tick(&limit, None, h), Found::Nothing);
    let least = LimitSettings { min: Some(0.7), max: None, ..limit };
    assert_eq!((least.violated(0.6), least.violated(0.8), least.violated(60.0)), (Some(0.7), None, None));
}

#[test]
fn the_film_conserves_fuel_and_answers_a_step_as_a_first_order_lag() {
    let model = FilmModel { share: 0.35, tau_s: 0.25 };
    let mut film = Film::default();
    let (period, gap) = (0.06, 0.04);
    let (mut injected, mut taken) = (0.0, 0.0);
    let mut last = 0.0;
    for k in 0..400 {
        let m = if k < 200 { 10e-6 } else { 25e-6 };
        let t = period * f64::from(k);
        film.inject(&model, 1.0, m, t);
        injected += m;
        last = film.induct(&model, 1.0, t + gap);
        taken += last;
        let balance = injected - taken - film.film_kg - film.airborne_kg;
        assert!(balance.abs() < 1e-15 * f64::from(k + 1), "{balance}");
        // Recursion in closed form: the film before injection k after the step is
        // f_inf + (f_0 - f_inf) a^n with a = e^(-T/tau), f_inf = X m a/(1 - a).
        if k >= 200 {
            let a = (-period / model.tau_s).exp();
            let f = |m: f64| model.share * m * a / (1.0 - a);
            let before = f(25e-6) + (f(10e-6) - f(25e-6)) * a.powi(k - 200);
            let wet = before + model.share * m;
            let since = (-(period - gap) / model.tau_s).exp();
            // Evaporated between the last induction and this injection, and from there to this induction.
            let expected = (1.0 - model.share) * m
                + (before / since - before)
                + wet * (1.0 - (-gap / model.tau_s).exp());
            assert!((last - expected).abs() < 1e-12, "{k}: {last} {expected}");
        }
    }
    assert!((last - 25e-6).abs() < 1e-12, "steady: what goes in comes out");
    // A colder wall evaporates more slowly: less is taken right after an injection.
    let take = |factor| {
        let mut f = Film::default();
        f.inject(&model, factor, 1e-5, 0.0);
        f.induct(&model, factor, gap)
    };
    assert!(take(4.0) < take(1.0) && take(4.0) > (1.0 - model.share) * 1e-5);
}

#[test]
fn scatter_has_its_variation_and_no_memory() {
    let s = Scatter { heat: 0.02, burn: 0.1, dilution: 0.0 };
    let n = 20_000u64;
    let x: Vec<(f64, f64)> =
        (0..n).map(|k| s.cycle(3, k / 4, (k % 4) as usize)).map(|c| (c.heat - 1.0, c.burn - 1.0)).collect();
    let m = n as f64;
    let mean = |f: &dyn Fn(usize) -> f64, len: usize| (0..len).map(f).sum::<f64>() / len as f64;
    // Normal numbers cut at 3 sigma have a variance of 0.9749.
    let variance = mean(&|i| x[i].0 * x[i].0, x.len()) / (0.02 * 0.02);
    assert!((variance - 0.975).abs() < 5.0 * (2.0 / m).sqrt(), "{variance}");
    let variance = mean(&|i| x[i].1 * x[i].1, x.len()) / 0.01;
    assert!((variance - 0.975).abs() < 5.0 * (2.0 / m).sqrt(), "{variance}");
    for lag in [1, 4] {
        let c = mean(&|i| x[i].0 * x[i + lag].0, x.len() - lag) / (0.02 * 0.02);
        assert!(c.abs() < 5.0 / m.sqrt(), "lag {lag}: {c}");
    }
    assert!(mean(&|i| x[i].0 * x[i].1, x.len()).abs() / 0.002 < 5.0 / m.sqrt());
    // Unequal cylinders keep the mean of the engine and differ by seed.
    let d = |seed| Deviations::default().with_imbalance(seed, 0.03, 0.05);
    assert!((d(1).fuel_share.iter().sum::<f64>() - 4.0).abs() < 1e-14);
    assert_ne!(d(1).fuel_share, d(2).fuel_share);
}

#[test]
fn warm_up_conserves_energy_and_reaches_its_steady_state() {
    let t = ThermalSettings { start_k: 300.0, ambient_k: 300.0, ..ThermalSettings::default() };
    let mut s = t.start();
    let (gas_w, friction_w, h) = (5000.0, 1000.0, 0.01);
    let mut put_j = 0.0;
    for k in 0..400_000 {
        t.step(&mut s, gas_w * h, friction_w * h, h);
        put_j += (gas_w + t.friction_share * friction_w) * h;
        if k % 50_000 == 0 {
            let [cw, cc, co] = t.capacity_j_k;
            let stored = cw * (s.wall_k - 300.0) + cc * (s.coolant_k - 300.0) + co * (s.oil_k - 300.0);
            assert!((stored + s.lost_j - put_j).abs() < 1e-9 * put_j);
        }
    }
    // Steady: walls above coolant by Q/UA; all that comes in goes out.
    assert!((s.wall_k - s.coolant_k - gas_w / t.wall_coolant_w_k).abs() < 1e-6);
    let [begins, open] = t.thermostat_k;
    assert!(s.coolant_k > begins && s.coolant_k < open, "the thermostat regulates: {}", s.coolant_k);
    let opening = (s.coolant_k - begins) / (open - begins);
    let out = opening * t.radiator_w_k * (s.coolant_k - 300.0) + t.oil_ambient_w_k * (s.oil_k - 300.0);
    assert!((out - gas_w - t.friction_share * friction_w).abs() < 1e-3, "{out}");
    // Walls alone (no coolant warm-up): a first-order lag with C_w/UA.
    let alone = ThermalSettings { capacity_j_k: [4e3, 1e12, 1e12], ..t };
    let mut s = alone.start();
    for _ in 0..2000 {
        alone.step(&mut s, gas_w * h, 0.0, h);
    }
    let ua = alone.wall_coolant_w_k;
    let exact = 300.0 + gas_w / ua * (1.0 - (-20.0 * ua / 4e3f64).exp());
    assert!((s.wall_k - exact).abs() < 0.01, "{} {exact}", s.wall_k);
    // Oil: the two points of its viscosity, thicker when cold, and friction that follows.
    assert!((viscosity_mm2_s(313.15) - 62.0).abs() < 1e-9 && (viscosity_mm2_s(373.15) - 10.5).abs() < 1e-9);
    assert!((t.friction_factor(363.15) - 1.0).abs() < 1e-14);
    let cold = t.friction_factor(293.15);
    assert!(cold > 1.5 && cold < 2.5, "cold friction is about twice the warm: {cold}");
}

const LEAN: Feed =
    Feed { gas_g: 0.02, gas_k: 900.0, lambda: 1.05, afr: 14.7, unburned_j_g: 100.0, heat_j_g_o2: 14e3 };

/// Oxygen in gas of `feed` with the lambda behind the catalyst \[g\].
fn oxygen_out_g(feed: &Feed, lambda: f64) -> f64 {
    let air = feed.gas_g * feed.lambda * feed.afr / (1.0 + feed.lambda * feed.afr);
    0.232 * air * (1.0 - 1.0 / lambda)
}

#[test]
fn the_catalyst_conserves_oxygen_and_energy() {
    let c = CatalystSettings { start_k: 600.0, ..CatalystSettings::default() };
    let h = 0.002;
    let mut s = c.start();
    let (first, mut gas_j) = (s, 0.0);
    for k in 0..30_000 {
        // Lean and rich, idle to full flow, cold to hot gas.
        let lambda = if (k / 700) % 2 == 0 { 1.04 } else { 0.95 };
        let flow = 5.0 + 40.0 * f64::from(k % 5000) / 5000.0;
        let feed = Feed { gas_g: flow * h, gas_k: 700.0 + f64::from(k % 3000) / 10.0, lambda, ..LEAN };
        let before: f64 = s.oxygen_g.iter().sum();
        c.step(&mut s, &feed, h);
        let stored = s.oxygen_g.iter().sum::<f64>() - before;
        let off = CatalystSettings::excess_oxygen_g(&feed) - oxygen_out_g(&feed, s.lambda) - stored;
        assert!(off.abs() < 1e-14, "{off} g at {k}");
        assert!(s.oxygen_g.iter().all(|m| *m >= 0.0) && (0.0..=1.0).contains(&s.filling));
        gas_j += 1.15 * feed.gas_g * (feed.gas_k - s.out_k);
    }
    let brick: f64 = s.brick_k.iter().zip(&first.brick_k).map(|(a, b)| a - b).sum();
    let held = c.capacity_j_k / s.brick_k.len() as f64 * brick + c.pipe_j_k * (s.pipe_k - first.pipe_k);
    let off = gas_j + s.heat_j[0] - s.heat_j[1] - held;
    assert!(off.abs() < 1e-9 * gas_j.abs().max(s.heat_j[0]), "{off} J of {gas_j} J");
    assert!(s.heat_j[0] > 0.0);
}

#[test]
fn the_store_fills_faster_than_it_empties_and_holds_less_at_high_flow() {
    let c = CatalystSettings { start_k: 900.0, ..CatalystSettings::default() };
    let h = 0.002;
    // What the brick has taken, or given, when half of the excess or deficit comes through.
    let until_half = |flow: f64, lambda: f64, full: f64| {
        let mut s = c.start();
        s.oxygen_g = [full * c.capacity_g(flow) / s.oxygen_g.len() as f64; 10];
        let feed = Feed { gas_g: flow * h, lambda, ..LEAN };
        let begin: f64 = s.oxygen_g.iter().sum();
        for _ in 0..100_000 {
            c.step(&mut s, &feed, h);
            if (s.lambda - 1.0) / (lambda - 1.0) > 0.5 {
                break;
            }
        }
        (s.oxygen_g.iter().sum::<f64>() - begin).abs()
    };
    let (low, high) = (until_half(5.0, 1.05, 0.0), until_half(50.0, 1.05, 0.0));
    assert!(high < 0.8 * low && low < c.oxygen_g, "{low} g at 5 g/s, {high} g at 50 g/s");
    let (fills, empties) = (until_half(20.0, 1.05, 0.0), until_half(20.0, 0.95, 1.0));
    assert!(empties < fills, "{fills} g taken, {empties} g given");
    // What comes through at once, of an excess through empty stores and of a deficit through full ones.
    let slip = |lambda: f64, full: f64| {
        let mut s = c.start();
        s.oxygen_g = [full * c.capacity_g(20.0) / s.oxygen_g.len() as f64; 10];
        c.step(&mut s, &Feed { gas_g: 20.0 * 1e-6, lambda, ..LEAN }, 1e-6);
        (1.0 - 1.0 / s.lambda) / (1.0 - 1.0 / lambda)
    };
    let (lean, rich) = (slip(1.05, 0.0), slip(0.95, 1.0));
    assert!(lean >= 0.0 && lean < 0.01 * rich && rich < 0.01, "{lean} of an excess, {rich} of a deficit");
    // Cold it does nothing.
    let mut cold = CatalystSettings { start_k: 300.0, ..c }.start();
    let before = cold.oxygen_g;
    c.step(&mut cold, &Feed { gas_k: 300.0, ..LEAN }, h);
    assert!((cold.lambda - 1.05).abs() < 1e-4, "{}", cold.lambda);
    assert!(cold.oxygen_g.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-7));
}

#[test]
fn light_off_moves_inward() {
    let c = CatalystSettings { start_k: 293.15, ..CatalystSettings::default() };
    assert!((c.conversion(c.light_off_k, c.reference_g_s) - 0.5).abs() < 1e-12);
    assert!(c.conversion(c.light_off_k, 2.0 * c.reference_g_s) < 0.5);
    let mut s = c.start();
    let mut lit = [None; 10];
    let h = 0.01;
    for k in 0..150_000 {
        c.step(&mut s, &Feed { gas_g: 12.0 * h, gas_k: 800.0, lambda: 1.0, ..LEAN }, h);
        for (seen, t) in lit.iter_mut().zip(&s.brick_k) {
            if seen.is_none() && *t > c.light_off_k {
                *seen = Some(k);
            }
        }
        if k == 100 {
            assert!(s.conversion < 0.02, "cold: {}", s.conversion);
        }
    }
    let times: Vec<i32> = lit.iter().map(|t| t.expect("every cell gets hot")).collect();
    assert!(times.windows(2).all(|w| w[1] > w[0]), "{times:?}");
    assert!(s.conversion > 0.9, "warm: {}", s.conversion);
    // Steady: the gas keeps what it brought and what burned, less what the walls lost.
    let lost = c.ambient_w_k * (s.brick_k.iter().sum::<f64>() / 10.0 - c.ambient_k)
        + c.pipe_ambient_w_k * (s.pipe_k - c.ambient_k);
    let expected = 800.0 + (s.conversion * 100.0 * 12.0 - lost) / (12.0 * 1.15);
    assert!((s.out_k - expected).abs() < 1.0, "{} {expected}", s.out_k);
}
