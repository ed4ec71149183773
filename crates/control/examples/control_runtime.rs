//! Time of a sample of the controllers that run: written as JSON. The limit of an ECU task is 2 us: a controller past it ends the
//! program with 1. Horizons are what could be had, and no ECU's.

use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use dynocal_control::error::ControlError;
use dynocal_control::horizon::{Horizon, HorizonSettings};
use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
use dynocal_control::predictor::{PredictedModel, Predictor};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::system::{System, Time, Transfer};
use dynocal_control::trim::LongTrim;

/// Samples that are timed, and those of a horizon.
const SAMPLES: usize = 1_000_000;
const AHEAD: usize = 2000;

/// What a task of an ECU has for a sample in us.
const TASK_US: f64 = 2.0;

/// Mean time of a sample in us, written.
fn timed(name: &str, samples: usize, step: &mut dyn FnMut(f64) -> f64) -> f64 {
    let begun = Instant::now();
    let mut sum = 0.0;
    for t in 0..samples {
        sum += step(black_box((t % 97) as f64 * 0.01));
    }
    let us = 1e6 * begun.elapsed().as_secs_f64() / samples as f64;
    black_box(sum);
    println!("{{\"controller\": \"{name}\", \"us_per_sample\": {us:.4}}}");
    us
}

fn main() -> Result<ExitCode, ControlError> {
    let limits = ActuatorLimits { lower: -1.0, upper: 1.0, rate_per_s: Some(20.0) };
    let gains = PidGains { kp: 1.0, ki: 2.0, kd: 0.01, filter_s: 0.05 };
    let mut pid = Pid::new(gains, limits, 0.01, 0.0)?;
    let mut all = vec![timed("PID", SAMPLES, &mut |y| pid.step(0.0, 0.5 - y))];
    let mut num = vec![0.0];
    num.extend((0..24).map(|k| 0.02 / (1.0 + k as f64)));
    let den = [1.0, -1.2, 0.5, -0.1, 0.05, -0.02, 0.01];
    let known = PredictedModel {
        model: Transfer::sampled(&num, &den),
        delay_samples: 17.5,
        longest_samples: 100,
        filter_s: 0.2,
        flow: None,
    };
    let mut smith = Predictor::new(gains, limits, 0.01, 0.0, &known)?;
    all.push(timed("Smith predictor, model of 6 and 24", SAMPLES, &mut |y| {
        smith.set_delay(10.0 + 20.0 * y);
        smith.step(0.0, 0.5, y)
    }));
    let store = OxygenSettings {
        capacity_g: 1.0,
        half_g_s: 60.0,
        rear_band: 0.01,
        target: 0.5,
        gain: 0.03,
        most: 0.02,
        learn: 0.3,
        memory: 0.0,
    };
    let mut oxygen = OxygenObserver::new(store, 0.5)?;
    all.push(timed("oxygen store and rear trim", SAMPLES, &mut |y| {
        oxygen.step(0.99 + 0.02 * y, 1.0, 10.0, 0.01)
    }));
    let axis = |n: usize| (0..n).map(|k| k as f64).collect::<Vec<f64>>();
    let mut trim = LongTrim::new(vec![axis(16), axis(16)], 60.0, 0.3)?;
    all.push(timed("long-term trim of 16 x 16", SAMPLES, &mut |y| {
        trim.learn(&[15.0 * y, 7.0], 0.01 * y, 0.01)
    }));
    horizons()?;
    let within = all.iter().all(|us| *us < TASK_US);
    Ok(if within { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Two coupled loops 75 samples ahead with 20 moves: no limit reached, and limits that hold nearly every plan.
fn horizons() -> Result<(), ControlError> {
    let g = |b: f64, a: f64| {
        let mut num = vec![0.0; 9];
        num.extend((0..8).map(|k| b / (1.0 + f64::from(k))));
        Transfer::sampled(&num, &[1.0, -a, 0.1])
    };
    let all = vec![g(0.1, 0.9), g(0.03, 0.8), g(-0.02, 0.85), g(0.2, 0.7)];
    let plant = System::new(Time::Sampled { sample_time_s: 0.02 }, 2, 2, all)?;
    for (name, most) in [("receding horizon of 75 samples", 1e6), ("receding horizon at its limits", 0.2)] {
        let settings = HorizonSettings {
            ahead: 75,
            moves: 20,
            weights: vec![1.0; 2],
            prices: vec![1.0; 2],
            lower: vec![-most; 2],
            upper: vec![most; 2],
            correction_s: 0.1,
        };
        let mut horizon = Horizon::new(&plant, settings)?;
        let mut failed = None;
        timed(name, AHEAD, &mut |y| match horizon.step(&|_, o| [0.8, -0.6][o], &[y, -y]) {
            Ok(u) => u[0],
            Err(e) => {
                failed = Some(e);
                f64::NAN
            }
        });
        failed.map_or(Ok(()), Err)?;
    }
    Ok(())
}
