//! What runs: the Smith predictor beside the undelayed loop, the oxygen store, the long-term trim.

use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
use dynocal_control::predictor::{PredictedModel, Predictor};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::stored::{Schedule, ScheduleAxis, StoredController, StoredLoop};
use dynocal_control::system::Transfer;
use dynocal_control::trim::LongTrim;
use dynocal_numerics::rng::Rng64;

const WIDE: ActuatorLimits = ActuatorLimits { lower: -1e9, upper: 1e9, rate_per_s: None };
const DT_S: f64 = 0.02;

/// x(t) = 0.9 x(t-1) + 0.1 gain u(t-1), seen `delay` samples late.
struct Plant {
    x: f64,
    gain: f64,
    line: Vec<f64>,
    at: usize,
}

impl Plant {
    fn new(delay: usize, gain: f64) -> Self {
        Self { x: 0.0, gain, line: vec![0.0; delay + 1], at: 0 }
    }

    fn shown(&mut self) -> f64 {
        let n = self.line.len();
        self.line[self.at % n] = self.x;
        self.at += 1;
        self.line[self.at % n]
    }

    fn step(&mut self, u: f64) {
        self.x = 0.9 * self.x + 0.1 * self.gain * u;
    }
}

fn known(delay: f64, filter_s: f64) -> PredictedModel {
    PredictedModel {
        model: Transfer::sampled(&[0.0, 0.1], &[1.0, -0.9]),
        delay_samples: delay,
        longest_samples: 60,
        filter_s,
        flow: None,
    }
}

/// With the model that the plant is, the delayed loop is the undelayed one with the pure delay after it, limits or not.
#[test]
fn a_predictor_with_the_right_model_is_the_undelayed_loop() {
    let tight = ActuatorLimits { lower: -1.0, upper: 2.0, rate_per_s: Some(30.0) };
    for (delay, limits) in [(5, WIDE), (17, WIDE), (5, tight), (40, tight)] {
        let gains = PidGains::pi(3.0, 20.0);
        let demand = |t: usize| if t < 100 { 1.0 } else { -0.5 };
        let mut pid = Pid::new(gains, limits, DT_S, 0.0).unwrap();
        let mut c = Predictor::new(gains, limits, DT_S, 0.0, &known(delay as f64, 0.0)).unwrap();
        let (mut plain, mut late) = (Plant::new(0, 1.0), Plant::new(delay, 1.0));
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for t in 0..300 {
            let y = plain.shown();
            a.push(y);
            plain.step(pid.step(0.0, demand(t) - y));
            let y = late.shown();
            b.push(y);
            late.step(c.step(0.0, demand(t), y));
        }
        for t in delay..300 {
            assert!(
                (b[t] - a[t - delay]).abs() < 1e-12,
                "delay {delay}, sample {t}: {} {}",
                b[t],
                a[t - delay]
            );
        }
    }
}

/// A delay that follows the transport (set from sample to sample) is answered; left at its first value the same loop oscillates.
#[test]
fn a_scheduled_delay_follows_the_transport() {
    let run = |follows: bool| {
        let mut c = Predictor::new(PidGains::pi(6.0, 60.0), WIDE, DT_S, 0.0, &known(10.0, 0.0)).unwrap();
        let (mut plant, mut past) = (Plant::new(0, 1.0), vec![0.0f64; 400]);
        let mut left: f64 = 0.0;
        for t in 0..4000 {
            // 10 samples at first, 30 later: the flow falls to a third.
            let delay = if t < 1000 { 10 } else { 10 + ((t - 1000) / 20).min(20) };
            let y = plant.shown();
            past.rotate_right(1);
            past[0] = y;
            if follows {
                c.set_delay(delay as f64);
            }
            plant.step(c.step(0.0, if t < 2000 { 0.0 } else { 1.0 }, past[delay]));
            if t > 3000 {
                left = left.max((y - 1.0).abs());
            }
        }
        left
    };
    assert!(run(true) < 1e-3, "{}", run(true));
    assert!(run(false) > 1.0, "{}", run(false));
}

/// The filter of the prediction error keeps a gain that is 1.9 times wrong stable, where the plain predictor does not.
#[test]
fn the_filter_buys_robustness() {
    let run = |filter_s: f64| {
        let mut c = Predictor::new(PidGains::pi(9.0, 90.0), WIDE, DT_S, 0.0, &known(12.0, filter_s)).unwrap();
        let mut plant = Plant::new(12, 2.2);
        let mut last: f64 = 0.0;
        for t in 0..3000 {
            let y = plant.shown();
            plant.step(c.step(0.0, 1.0, y));
            if t > 2900 {
                last = last.max((y - 1.0).abs());
            }
        }
        last
    };
    assert!(run(0.5) < 1e-3 && !(run(0.0) < 1.0), "{} {}", run(0.5), run(0.0));
}

/// Schedules: exact at their points, linear between, held outside; files that cannot run are refused by name.
#[test]
fn stored_controllers_are_checked() {
    let axis = |channel: &str, points: &[f64]| ScheduleAxis {
        channel: channel.into(),
        unit: "-".into(),
        points: points.to_vec(),
    };
    let s = Schedule {
        axes: vec![axis("speed", &[1000.0, 2000.0]), axis("load", &[0.0, 1.0, 2.0])],
        kp: vec![1.0, 2.0, 3.0, 5.0, 6.0, 7.0],
        ki: vec![0.0; 6],
    };
    assert_eq!(s.at(&[2000.0, 1.0]).0, 6.0);
    assert_eq!(s.at(&[1500.0, 0.5]).0, 3.5);
    assert_eq!(s.at(&[9000.0, -3.0]).0, 5.0);
    let own = StoredLoop {
        output: "lambda".into(),
        output_unit: "-".into(),
        input: "inj".into(),
        input_unit: "mg".into(),
        gains: PidGains::pi(-1.0, -2.0),
        schedule: Some(s),
        limits: WIDE,
        start: 0.0,
        predictor: Some(known(5.0, 0.0)),
    };
    let file = |l: StoredLoop| StoredController { sample_time_s: DT_S, loops: vec![l], catalyst: None };
    file(own.clone()).check().unwrap();
    let refused = |change: &dyn Fn(&mut StoredLoop)| {
        let mut l = own.clone();
        change(&mut l);
        file(l).check().unwrap_err().to_string()
    };
    assert!(refused(&|l| l.schedule.as_mut().unwrap().kp.truncate(5)).contains("schedule of lambda"));
    assert!(
        refused(&|l| l.predictor.as_mut().unwrap().delay_samples = 99.0).contains("delay of the predictor")
    );
    assert!(refused(&|l| l.predictor.as_mut().unwrap().model.num[0] = 1.0).contains("within its own sample"));
    assert!(refused(&|l| l.limits.upper = -2e9).contains("upper limit"));
}

const STORE: OxygenSettings = OxygenSettings {
    capacity_g: 1.0,
    half_g_s: 60.0,
    rear_band: 0.01,
    target: 0.5,
    gain: 0.03,
    most: 0.02,
    learn: 0.3,
    memory: 0.0,
};

/// A store whose front sensor reads 0.5 % rich, driven at random: with the trim that is learnt from break-throughs the
/// rear sensor leaves its band less and less, without it again and again.
#[test]
fn the_rear_trim_learns_the_bias_of_the_front_sensor() {
    for seed in 0..10 {
        let breaks = |trimmed: bool| {
            let mut rng = Rng64::new(seed);
            let mut c = OxygenObserver::new(STORE, 0.5).unwrap();
            let (mut held, mut air, mut off, mut counted) = (0.4f64, 10.0, 0.0, 0u32);
            let (mut trim, mut before) = (0.0, false);
            for t in 0..180_000 {
                if t % 300 == 0 {
                    air = rng.uniform_in(4.0, 25.0);
                }
                off += 0.05 * (0.01 * rng.normal() - off);
                let lambda = 1.0 + off + if trimmed { trim } else { 0.0 } + 0.005;
                let taken = 0.23 * air * (1.0 - 1.0 / lambda) * 0.01;
                let room = 1.0 / (1.0 + air / 60.0);
                let next = held + taken;
                let rear = if (0.0..=room).contains(&next) {
                    1.0
                } else {
                    lambda + if next > room { 0.02 } else { -0.02 }
                };
                held = next.clamp(0.0, room);
                let out = (rear - 1.0f64).abs() > 0.01;
                counted += u32::from(out && !before && t > 90_000);
                before = out;
                trim = c.step(lambda - 0.005, rear, air, 0.01);
            }
            counted
        };
        let (with, without) = (breaks(true), breaks(false));
        assert!(4 * with < without, "seed {seed}: {with} break-throughs with the trim, {without} without");
    }
}

/// A store that holds 0.6 or 1.6 of what is given, a front sensor 0.3 % wrong: over passages from end to end both are found.
#[test]
fn capacity_and_bias_are_estimated_together() {
    for (seed, truth, off) in [(1, 0.6, 0.003), (2, 1.6, -0.003), (3, 1.0, 0.0), (4, 1.6, 0.003)] {
        let mut rng = Rng64::new(seed);
        let mut c = OxygenObserver::new(OxygenSettings { memory: 30.0, ..STORE }, 0.5).unwrap();
        let (mut held, mut air, mut wanted) = (0.5 * truth, 10.0, 1.0);
        for t in 0..200_000 {
            if t % 500 == 0 {
                air = rng.uniform_in(4.0, 25.0);
                wanted = 1.0 + rng.uniform_in(-0.04, 0.04);
            }
            let lambda = wanted + 0.005 * rng.normal();
            let room = truth / (1.0 + air / 60.0);
            let next = held + 0.23 * air * (1.0 - 1.0 / lambda) * 0.01;
            let rear = if next > room {
                1.02
            } else if next < 0.0 {
                0.98
            } else {
                1.0
            };
            held = next.clamp(0.0, room);
            c.step(lambda + off, rear, air, 0.01);
        }
        let found = c.state().passages.capacity_g;
        assert!((found / truth - 1.0).abs() < 0.1, "seed {seed}: {found} of {truth} g");
        // A sensor that reads lean tells of oxygen that is not there.
        assert!((c.state().bias / 0.23 + off).abs() < 0.001, "seed {seed}: bias {}", c.state().bias / 0.23);
        // A saved state goes on as it was.
        let mut again = OxygenObserver::new(OxygenSettings { memory: 30.0, ..STORE }, 0.1).unwrap();
        again.restore(c.state());
        assert_eq!(again.step(1.01, 1.0, 9.0, 0.01), c.step(1.01, 1.0, 9.0, 0.01));
    }
}

/// A map that is wrong by a known surface: the trim finds it where the engine was, and feedback is left with nothing.
#[test]
fn the_long_trim_takes_over_what_feedback_adds() {
    let axes = vec![vec![1000.0, 2000.0, 3000.0], vec![20.0, 50.0, 80.0]];
    let wrong = |n: f64, t: f64| 0.05 * (n / 1000.0 - 2.0) - 0.001 * (t - 50.0);
    let mut trim = LongTrim::new(axes, 5.0, 0.5).unwrap();
    let mut rng = Rng64::new(3);
    let (mut feedback, mut early, mut late) = (0.0f64, 0.0f64, 0.0f64);
    let points = 300;
    for k in 0..points {
        let at = [rng.uniform_in(1000.0, 3000.0), rng.uniform_in(20.0, 80.0)];
        for t in 0..1000 {
            let error = wrong(at[0], at[1]) - trim.at(&at) - feedback;
            feedback += 0.05 * error;
            if t > 100 {
                feedback -= trim.learn(&at, feedback, 0.01);
            }
            let sum = if k < 10 {
                &mut early
            } else if k >= points - 10 {
                &mut late
            } else {
                continue;
            };
            *sum += error.abs();
        }
    }
    for (n, t) in [(1000.0, 20.0), (2000.0, 50.0), (2500.0, 65.0), (3000.0, 20.0)] {
        assert!(
            (trim.at(&[n, t]) - wrong(n, t)).abs() < 2e-3,
            "{n} {t}: {} {}",
            trim.at(&[n, t]),
            wrong(n, t)
        );
    }
    assert!(late < 0.1 * early, "{early} {late}");
    assert_eq!(trim.visited(1.0), 1.0);
    // Numbers that are none teach nothing.
    let before = trim.clone();
    assert_eq!(trim.learn(&[f64::NAN, 50.0], 1.0, 0.01), 0.0);
    assert_eq!(trim, before);
}
