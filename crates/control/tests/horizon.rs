//! The receding horizon: deadbeat where nothing is in its way, no offset, and within limits no better plan than its own.

use dynocal_control::error::ControlError;
use dynocal_control::horizon::{Horizon, HorizonSettings};
use dynocal_control::system::{System, Time, Transfer};
use dynocal_numerics::rng::Rng64;

const TIME: Time = Time::Sampled { sample_time_s: 0.1 };

fn settings(n: usize, price: f64, limit: f64) -> HorizonSettings {
    HorizonSettings {
        ahead: 25,
        moves: 6,
        weights: vec![1.0; n],
        prices: vec![price; n],
        lower: vec![-limit; n],
        upper: vec![limit; n],
        correction_s: 0.0,
    }
}

/// y(t) = 0.9 y(t-1) + 0.2 u(t-3).
fn late() -> System {
    System::single(TIME, Transfer::sampled(&[0.0, 0.0, 0.0, 0.2], &[1.0, -0.9])).unwrap()
}

/// Two inputs on two outputs, all channels other.
fn coupled() -> System {
    let g = |num: &[f64], a: f64| Transfer::sampled(num, &[1.0, -a]);
    let all = vec![
        g(&[0.0, 0.0, 0.2], 0.8),
        g(&[0.0, 0.05], 0.9),
        g(&[0.0, 0.0, 0.0, -0.06], 0.85),
        g(&[0.0, 0.15, 0.1], 0.6),
    ];
    System::new(TIME, 2, 2, all).unwrap()
}

/// Outputs of a system for rows of inputs, from rest.
fn outputs(plant: &System, u: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mut parts = vec![vec![0.0; u.len() + 1]; plant.channels.len()];
    let mut out = vec![vec![0.0; plant.outputs]; u.len() + 1];
    for t in 1..=u.len() {
        for (c, g) in plant.channels.iter().enumerate() {
            let input = c % plant.inputs;
            let forward: f64 = g
                .num
                .iter()
                .enumerate()
                .skip(1)
                .filter(|(k, _)| *k <= t)
                .map(|(k, b)| b * u[t - k][input])
                .sum();
            let back: f64 = g
                .den
                .iter()
                .enumerate()
                .skip(1)
                .filter(|(k, _)| *k <= t)
                .map(|(k, a)| a * parts[c][t - k])
                .sum();
            parts[c][t] = forward - back;
            out[t][c / plant.inputs] += parts[c][t];
        }
    }
    out
}

/// Free moves: the demand is reached one sample after the delay, and with preview as soon as it is there.
#[test]
fn without_a_price_the_demand_is_there_after_the_delay() {
    for preview in [false, true] {
        let mut c = Horizon::new(&late(), settings(1, 1e-10, 1e9)).unwrap();
        let mut u: Vec<Vec<f64>> = Vec::new();
        let demand = |t: usize| if t >= 20 { 1.0 } else { 0.0 };
        for t in 0..60 {
            let y = outputs(&late(), &u)[t][0];
            let ahead = |j: usize, _: usize| demand(if preview { t + j } else { t });
            u.push(c.step(&ahead, &[y]).unwrap().to_vec());
        }
        let y = outputs(&late(), &u);
        let first = if preview { 20 } else { 23 };
        for (t, y) in y.iter().enumerate() {
            let wanted = if t >= first { 1.0 } else { 0.0 };
            assert!((y[0] - wanted).abs() < 1e-3, "preview {preview}, sample {t}: {}", y[0]);
        }
    }
}

/// A plant with other gains and a load that nobody knows: nothing is left.
#[test]
fn nothing_is_left_at_rest() {
    let mut other = coupled();
    other.channels.iter_mut().for_each(|g| g.num.iter_mut().for_each(|b| *b *= 1.2));
    let mut c =
        Horizon::new(&coupled(), HorizonSettings { correction_s: 0.3, ..settings(2, 0.1, 1e9) }).unwrap();
    let mut u: Vec<Vec<f64>> = Vec::new();
    let mut last = [0.0; 2];
    for t in 0..300 {
        let y = outputs(&other, &u).pop().unwrap();
        last = [y[0] + 0.3, y[1] - 0.2];
        // A sensor that fails for a while leaves no trace.
        let shown = if (50..55).contains(&t) { [f64::NAN; 2] } else { last };
        u.push(c.step(&|_, o| [0.7, -0.4][o], &shown).unwrap().to_vec());
    }
    assert!((last[0] - 0.7).abs() < 1e-6 && (last[1] + 0.4).abs() < 1e-6, "{last:?}");
}

/// Within limits: no other plan within them costs less, by a run of the plant.
#[test]
fn no_plan_within_the_limits_costs_less() {
    let plant = coupled();
    let own = settings(2, 0.02, 0.6);
    let mut c = Horizon::new(&plant, own.clone()).unwrap();
    let demand = [1.0, -0.8];
    c.step(&|_, o| demand[o], &[0.0, 0.0]).unwrap();
    let best = c.plan().to_vec();
    let cost = |plan: &[f64]| {
        let u: Vec<Vec<f64>> =
            (0..own.ahead).map(|j| plan[2 * j.min(own.moves - 1)..][..2].to_vec()).collect();
        let y = outputs(&plant, &u);
        let far: f64 = y[1..].iter().map(|y| (0..2).map(|o| (demand[o] - y[o]).powi(2)).sum::<f64>()).sum();
        let moved: f64 =
            (0..plan.len()).map(|k| (plan[k] - if k < 2 { 0.0 } else { plan[k - 2] }).powi(2)).sum();
        far + 0.02 * moved
    };
    let least = cost(&best);
    assert!(best.iter().all(|v| v.abs() <= 0.6 + 1e-9));
    assert!(best.iter().any(|v| v.abs() > 0.6 - 1e-6), "no limit is reached: {best:?}");
    let mut rng = Rng64::new(3);
    for size in [1e-3, 1e-2, 0.1, 1.0] {
        for _ in 0..300 {
            let other: Vec<f64> =
                best.iter().map(|v| (v + size * rng.uniform_in(-1.0, 1.0)).clamp(-0.6, 0.6)).collect();
            assert!(cost(&other) >= least - 1e-9, "{size}: {} below {least}", cost(&other));
        }
    }
    // Without limits as well, and there for less.
    let mut free = Horizon::new(&plant, settings(2, 0.02, f64::INFINITY)).unwrap();
    free.step(&|_, o| demand[o], &[0.0, 0.0]).unwrap();
    assert!(cost(free.plan()) < least);
}

#[test]
fn what_cannot_be_is_named() {
    let refused = |plant: &System, s: HorizonSettings| -> String {
        Horizon::new(plant, s).map(|_| ()).unwrap_err().to_string()
    };
    let s = settings(1, 0.1, 1.0);
    assert!(refused(&late(), settings(2, 0.1, 1.0)).contains("weights"));
    assert!(refused(&late(), HorizonSettings { moves: 26, ..s.clone() }).contains("moves"));
    assert!(refused(&late(), HorizonSettings { prices: vec![0.0], ..s.clone() }).contains("price"));
    assert!(refused(&late(), HorizonSettings { lower: vec![2.0], ..s.clone() }).contains("lower limit"));
    let at_once = System::single(TIME, Transfer::sampled(&[0.5, 0.1], &[1.0, -0.9])).unwrap();
    assert!(refused(&at_once, s.clone()).contains("within its own sample"));
    let continuous =
        System::single(Time::Continuous, Transfer::continuous(&[1.0], &[1.0, 1.0], 0.0)).unwrap();
    assert!(matches!(Horizon::new(&continuous, s), Err(ControlError::Model(_))));
}
