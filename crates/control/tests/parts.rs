//! Runtime controllers, interaction, Smith predictors, gains in the plane: by their properties.

mod common;

use common::{CONTINUOUS, near};
use dynocal_control::closed::Closed;
use dynocal_control::interaction::{decoupler, relative_gains};
use dynocal_control::plane::Channel;
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::search::choose;
use dynocal_control::simulate::run;
use dynocal_control::smith::Smith;
use dynocal_control::system::{System, Time, Transfer};
use dynocal_control::tune::{Asked, lag, step_run};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;

const TIME: Time = Time::Sampled { sample_time_s: 0.1 };
const WIDE: ActuatorLimits = ActuatorLimits { lower: -1e9, upper: 1e9, rate_per_s: None };

fn sampled(a: f64, b: f64, delay: usize) -> Transfer {
    let mut num = vec![0.0; delay];
    num.push(b);
    Transfer::sampled(&num, &[1.0, -a])
}

/// Far from its limits the running controller is its transfer function, digit for digit but for rounding.
#[test]
fn the_running_controller_is_its_transfer_function() {
    let gains = PidGains { kp: 1.2, ki: 0.8, kd: 0.3, filter_s: 0.2 };
    let plant = sampled(0.9, 0.1, 3);
    let closed = Closed::new(
        System::single(TIME, plant).unwrap(),
        System::single(TIME, gains.transfer(TIME)).unwrap(),
    )
    .unwrap();
    // A demand that does not begin with a jump of the derivative: the controller knows no error before its first.
    let demand = |t: usize| (0.07 * t as f64).sin() * (1.0 - (-(t as f64) * 0.01).exp());
    let found = run(&closed, 0.1, 400, &|t, r| r[0] = demand(t), &|_, d| d[0] = 0.0).unwrap();
    let mut pid = Pid::new(gains, WIDE, 0.1, 0.0).unwrap();
    let (mut y, mut past) = (0.0, [0.0; 3]);
    for t in 0..400 {
        y = 0.9 * y + 0.1 * past[2];
        let u = pid.step(0.0, demand(t) - y);
        assert!((y - found.y[t]).abs() < 1e-9 && (u - found.u[t]).abs() < 1e-9, "{t}: {y} {}", found.y[t]);
        past = [u, past[0], past[1]];
    }
}

/// Limits of range and rate are kept always, and left in the first sample after the error changes its sign.
#[test]
fn limits_are_kept_and_left_at_once() {
    let limits = ActuatorLimits { lower: 0.0, upper: 10.0, rate_per_s: Some(30.0) };
    let mut rng = Rng64::new(2);
    for trial in 0..50 {
        let gains = PidGains::pi(rng.uniform_in(0.0, 3.0), rng.uniform_in(0.1, 5.0));
        let mut pid = Pid::new(gains, limits, 0.1, 5.0).unwrap();
        let mut last = 5.0;
        for _ in 0..200 {
            let u = pid.step(rng.normal(), 10.0 * rng.normal());
            assert!(
                (0.0..=10.0).contains(&u) && (u - last).abs() <= 3.0 + 1e-12,
                "{trial}: {u} after {last}"
            );
            last = u;
        }
        for _ in 0..300 {
            pid.step(0.0, 50.0);
        }
        assert_eq!(pid.state().output, 10.0);
        assert!(pid.step(0.0, -0.5) < 10.0, "{trial}: {gains:?}");
    }
}

/// Taking over, and other gains, begin where the actuator was; a measurement that is lost holds it.
#[test]
fn starts_and_transfers_have_no_bump() {
    let mut pid = Pid::new(PidGains::pi(2.0, 1.0), WIDE, 0.1, 0.0).unwrap();
    pid.take_over(7.0, 0.5, 3.0);
    near(pid.step(0.5, 3.0), 7.0 + 1.0 * 3.0 * 0.1, 12);
    let before = pid.state().output;
    assert_eq!(pid.step(0.5, f64::NAN), before);
    pid.change_gains(PidGains::pi(5.0, 1.0));
    near(pid.step(0.5, 3.0), before + 0.3, 12);
}

/// A saved state goes on as the controller itself, through text.
#[test]
fn a_saved_state_goes_on() {
    let limits = ActuatorLimits { lower: -1.0, upper: 1.0, rate_per_s: Some(5.0) };
    let gains = PidGains { kp: 1.0, ki: 2.0, kd: 0.1, filter_s: 0.05 };
    let mut rng = Rng64::new(8);
    let mut first = Pid::new(gains, limits, 0.01, 0.2).unwrap();
    for _ in 0..100 {
        first.step(0.0, rng.normal());
    }
    let mut second = Pid::new(gains, limits, 0.01, 0.0).unwrap();
    second.restore(first.state());
    for _ in 0..100 {
        let e = rng.normal();
        assert_eq!(first.step(0.1, e), second.step(0.1, e));
    }
}

/// Relative gains of the Wood and Berry column at rest: 2.01 (12.8 19.4 / (12.8 19.4 - 18.9 6.6)).
#[test]
fn relative_gains_and_the_decoupler_are_those_of_the_column() {
    let lag = |k: f64, t: f64, d: f64| Transfer::continuous(&[k], &[t, 1.0], d);
    let channels =
        vec![lag(12.8, 16.7, 1.0), lag(-18.9, 21.0, 3.0), lag(6.6, 10.9, 7.0), lag(-19.4, 14.4, 3.0)];
    let plant = System::new(CONTINUOUS, 2, 2, channels).unwrap();
    let rga = relative_gains(&plant, 0.0).unwrap();
    let exact = 12.8 * 19.4 / (12.8 * 19.4 - 18.9 * 6.6);
    near(rga[0], exact, 12);
    near(rga[0] + rga[1], 1.0, 12);
    let d = decoupler(&plant).unwrap();
    let g = [12.8, -18.9, 6.6, -19.4];
    near(g[0] * d[1] + g[1] * d[3], 0.0, 10);
    near(g[2] * d[0] + g[3] * d[2], 0.0, 10);
    let singular = System::new(
        CONTINUOUS,
        2,
        2,
        vec![Transfer::gain(1.0), Transfer::gain(2.0), Transfer::gain(2.0), Transfer::gain(4.0)],
    );
    assert!(relative_gains(&singular.unwrap(), 0.0).unwrap_err().to_string().contains("singular"));
}

/// With an exact model the predictor answers like the undelayed loop, later by the delay; its interval in the delay is that of
/// counts of unstable poles on either side of its ends.
#[test]
fn the_ends_of_a_delay_interval_are_where_poles_cross() {
    let p = Transfer::continuous(&[1.0], &[1.0, 1.0], 0.0);
    for lambda in [0.1, 0.2, 0.5] {
        let k = Transfer::continuous(&[1.0, 1.0], &[lambda, 0.0], 0.0);
        let smith = Smith::new(CONTINUOUS, k, p.clone(), 1.0);
        let found = smith.delay_interval(&p, 1.0).unwrap();
        for end in [found.above_s, found.below_s].into_iter().flatten() {
            assert!(smith.unstable(&p, 1.0, 0.98 * end).unwrap().is_stable(), "{lambda} {end}");
            assert!(!smith.unstable(&p, 1.0, 1.02 * end).unwrap().is_stable(), "{lambda} {end}");
        }
        for w in [0.1, 1.0, 7.0] {
            let l = smith.loop_response(&p, 1.0, 0.0, w);
            let closed = l / (l + 1.0);
            let expected = dynocal_numerics::fft::Complex::from_polar(1.0, -w)
                / dynocal_numerics::fft::Complex::new(1.0, lambda * w);
            assert!((closed - expected).norm() < 1e-12);
        }
        // A filter of the prediction error widens the interval.
        let filtered = Smith { filter: Transfer::continuous(&[1.0], &[0.5, 1.0], 0.0), ..smith.clone() };
        let wider = filtered.delay_interval(&p, 1.0).unwrap();
        assert!(wider.above_s.unwrap() > found.above_s.unwrap(), "{lambda} {wider:?} {found:?}");
        let gains = smith.gain_interval(&p, 0.0, Interval { lower: 0.1, upper: 10.0 }).unwrap();
        assert!(gains.lower <= 0.5 && gains.upper > 1.5, "{lambda} {gains:?}");
    }
}

/// The boundary of the plane of a sampled channel separates gains that run stable from those that do not.
#[test]
fn the_plane_of_a_sampled_channel_separates_stable_from_unstable_runs() {
    let c = Channel::new(TIME, sampled(0.8, 0.2, 3)).unwrap();
    for kp in [0.0, 0.5, 1.0, 2.0] {
        let stable = c.stable_ki(kp);
        assert_eq!(stable.len(), 1, "{kp} {stable:?}");
        let edge = stable[0].upper;
        for (share, expected) in [(0.98, true), (1.02, false)] {
            let closed = Closed::new(
                System::single(TIME, c.transfer.clone()).unwrap(),
                System::single(TIME, PidGains::pi(kp, edge * share).transfer(TIME)).unwrap(),
            )
            .unwrap();
            let growth = dynocal_control::simulate::growth(&closed, 0.1, 20_000).unwrap();
            assert_eq!(growth < 0.0, expected, "{kp} {share}: {growth}");
            assert_eq!(c.is_stable(kp, edge * share), expected);
            assert_eq!(closed.is_stable(), expected);
        }
        let kept = c.ki_with_sensitivity(kp, 1.6);
        for i in &kept {
            let ki = 0.999 * i.upper;
            assert!(c.sensitivity_on_grid(kp, ki) <= 1.6 + 1e-9, "{kp} {ki}");
        }
    }
    // Poles on the locus of a damping have it: 1 + G C = 0 there.
    for p in c.damping_locus(0.4).iter().filter(|p| p.w_rad_s > 0.5 && p.w_rad_s < 20.0) {
        let s = dynocal_numerics::fft::Complex::new(-0.4, 0.84f64.sqrt()) * p.w_rad_s;
        let q = (-s * 0.1).exp();
        let g = q * q * q * 0.2 / (1.0 - q * 0.8);
        let chi = g * (0.1 / (1.0 - q) * p.ki + p.kp) + 1.0;
        assert!(chi.norm() < 1e-8 * (1.0 + p.ki.abs() + p.kp.abs()), "{p:?} {chi}");
    }
}

/// The search keeps what is asked on all channels, and is not slower than SIMC where SIMC keeps it.
#[test]
fn the_search_keeps_what_is_asked() {
    let channels: Vec<Channel> = [(0.8, 0.2, 3), (0.85, 0.2, 3), (0.8, 0.15, 4)]
        .map(|(a, b, d)| Channel::new(TIME, sampled(a, b, d)).unwrap())
        .into();
    let lags: Vec<_> = channels.iter().map(|c| lag(c).unwrap()).collect();
    // First lag: -0.1 / ln 0.8 = 0.448 s, dead time about three samples.
    assert!((lags[0].lag_s - 0.448).abs() < 0.05 && (lags[0].dead_s - 0.25).abs() < 0.1, "{:?}", lags[0]);
    let r = step_run(&channels, &lags);
    let asked = Asked { sensitivity: 1.6, ..Asked::default() };
    let found = choose(&channels, &asked, r).unwrap();
    assert!(found.kept && found.tuned.violation.unwrap() <= 1.0, "{:?}", found.tuned);
    for m in found.tuned.margins.iter().flatten() {
        assert!(m.sensitivity <= 1.6 && m.gain_up.unwrap() >= 2.0 && m.phase_deg.unwrap() >= 45.0, "{m:?}");
    }
    for l in &lags {
        let simc = dynocal_control::tune::judged(
            "simc",
            &dynocal_control::tune::simc(l, None),
            &channels,
            &asked,
            r,
        );
        if simc.violation.is_some_and(|v| v <= 1.0) {
            assert!(
                found.tuned.settling_s.unwrap() <= simc.settling_s.unwrap(),
                "{simc:?} {:?}",
                found.tuned
            );
        }
    }
    // What no PI can meet is said with the nearest there is.
    let hard = Asked { settling_s: Some(0.5), ..asked };
    let found = choose(&channels, &hard, r).unwrap();
    assert!(!found.kept && found.tuned.settling_s.unwrap() > 0.5 && found.tuned.violation.unwrap() <= 1.0);
    // Integrals of integrals have no phase to give: margins alone cannot be met either.
    let double = Transfer::sampled(&[0.0, 0.01, 0.01], &[1.0, -2.0, 1.0]);
    assert!(choose(&[Channel::new(TIME, double).unwrap()], &asked, r).is_err());
}

#[test]
fn bad_numbers_are_named() {
    let text = |e: dynocal_control::error::ControlError| e.to_string();
    let single = |g: Transfer| System::single(CONTINUOUS, g).map(|_| ()).map_err(text);
    assert!(
        single(Transfer::continuous(&[1.0, 0.0], &[1.0], 0.0))
            .unwrap_err()
            .contains("degree of the numerator")
    );
    assert!(single(Transfer::continuous(&[1.0], &[1.0, 1.0], -1.0)).unwrap_err().contains("delay"));
    assert!(single(Transfer::continuous(&[f64::NAN], &[1.0, 1.0], 0.0)).unwrap_err().contains("finite"));
    assert!(
        Channel::new(CONTINUOUS, Transfer::continuous(&[-1.0], &[1.0, 1.0], 0.0))
            .map(|_| ())
            .map_err(text)
            .unwrap_err()
            .contains("gain of the channel")
    );
    let limits = ActuatorLimits { lower: 1.0, upper: 0.0, rate_per_s: None };
    assert!(
        Pid::new(PidGains::pi(1.0, 1.0), limits, 0.1, 0.0)
            .map(|_| ())
            .map_err(text)
            .unwrap_err()
            .contains("upper limit")
    );
    let l = common::unity(Transfer::continuous(&[25.0], &[1.0, 1.0, 1.0, 1.0], 0.0), CONTINUOUS);
    let refused =
        dynocal_control::disk::disk(&l, dynocal_control::disk::Place::Inputs, 0.0).map(|_| ()).map_err(text);
    assert!(refused.unwrap_err().contains("2 unstable poles"));
}

/// What can be cancelled in time is, what cannot is left as small as least squares make it; behind it the channels are the sums.
#[test]
fn decouplers_cancel_what_can_be_cancelled() {
    use dynocal_control::interaction::{behind, dynamic_decoupler, static_decoupler};
    use dynocal_control::system::{System, Time, Transfer};
    let time = Time::Sampled { sample_time_s: 0.1 };
    let lag = |num: &[f64]| Transfer::sampled(num, &[1.0, -0.9]);
    // u2 reaches y1 one sample after u1 at half its gain: D12 = -0.5 q. y2 does not hear of u1.
    let plant = System::new(
        time,
        2,
        2,
        vec![lag(&[0.0, 0.2]), lag(&[0.0, 0.0, 0.1]), Transfer::gain(0.0), lag(&[0.0, 0.3])],
    )
    .unwrap();
    let d = dynamic_decoupler(&plant, 6).unwrap();
    let filter = &d.channel(0, 1).num;
    for (k, v) in filter.iter().enumerate() {
        assert!((v - if k == 1 { -0.5 } else { 0.0 }).abs() < 1e-3, "{filter:?}");
    }
    assert!(d.channel(1, 0).num.iter().all(|v| v.abs() < 1e-6));
    assert_eq!(d.channel(0, 0).num, [1.0]);
    // Sooner than it can be met: the answer comes back, and what is left is less than with the gain alone.
    let soon = System::new(
        time,
        2,
        2,
        vec![lag(&[0.0, 0.0, 0.0, 0.2]), lag(&[0.0, 0.1]), Transfer::gain(0.0), lag(&[0.0, 0.3])],
    )
    .unwrap();
    let left = |d: &System| {
        // Step of the second demand as the first output sees it.
        let (a, b) = (soon.channel(0, 0).times(d.channel(0, 1)), soon.channel(0, 1).times(d.channel(1, 1)));
        let answer = |g: &Transfer, t: usize| {
            let mut y = vec![0.0; t + 1];
            for k in 0..=t {
                let moved: f64 = g.num.iter().take(k + 1).sum();
                y[k] = moved + if k > 0 { 0.9 * y[k - 1] } else { 0.0 };
            }
            y[t]
        };
        (0..80).map(|t| (answer(&a, t) + answer(&b, t)).powi(2)).sum::<f64>()
    };
    let (fixed, filtered) = (static_decoupler(&soon).unwrap(), dynamic_decoupler(&soon, 30).unwrap());
    assert!(left(&filtered) < 0.7 * left(&fixed), "{} {}", left(&filtered), left(&fixed));
    for w in [0.1, 3.0, 20.0] {
        for k in 0..2 {
            let sum = soon.at(w).times(&filtered.at(w)).at(k, k);
            assert!(
                (behind(&soon, &filtered, k).unwrap().at(time, w) - sum).norm() < 1e-9 * (1.0 + sum.norm())
            );
        }
    }
    let endless = System::new(
        time,
        2,
        2,
        vec![
            Transfer::sampled(&[0.0, 0.1], &[1.0, -1.0]),
            lag(&[0.0, 0.1]),
            Transfer::gain(0.0),
            lag(&[0.0, 0.3]),
        ],
    )
    .unwrap();
    assert!(dynamic_decoupler(&endless, 5).is_err());
}

/// Plants whose plane has ends that grow without limit, or none at all: `e^(-s/2) / (s + 1)^2` loses stability without an integral at
/// `kp = 1 + w^2`, `w / 2 + 2 atan w = pi`; an integrator never; a fast lag takes an integral as fast as itself.
#[test]
fn the_plane_has_a_range_where_its_ends_run_away() {
    let channel = |num: &[f64], den: &[f64], delay_s: f64| {
        Channel::new(Time::Continuous, Transfer::continuous(num, den, delay_s)).unwrap()
    };
    let twice = channel(&[1.0], &[1.0, 2.0, 1.0], 0.5);
    let (mut lower, mut upper) = (1.0f64, 3.0f64);
    for _ in 0..60 {
        let w = 0.5 * (lower + upper);
        if 0.5 * w + 2.0 * w.atan() < std::f64::consts::PI { lower = w } else { upper = w }
    }
    let ranges = twice.kp_ranges();
    let end = ranges.last().unwrap().upper;
    assert!((end - (1.0 + lower * lower)).abs() < 1e-6 && ranges[0].lower < 0.0, "{ranges:?}");
    assert!(!twice.stable_ki(0.8).is_empty());
    let integrator = channel(&[1.0], &[1.0, 0.0], 0.0);
    assert!(integrator.kp_ranges().iter().any(|r| r.upper > 0.0), "{:?}", integrator.kp_ranges());
    let fast = channel(&[1.0], &[1e-3, 1.0], 0.0);
    assert!(fast.stable_ki(1.0).last().unwrap().upper > 1e3, "{:?}", fast.stable_ki(1.0));
}

/// What a loop sees beside a closed one is what the frequency response says, with shared denominators and without.
#[test]
fn a_channel_beside_a_closed_loop_is_the_quotient_of_responses() {
    use dynocal_control::interaction::beside_closed;
    use dynocal_control::matrix::{C, ONE};
    let time = Time::Sampled { sample_time_s: 0.05 };
    let g = |num: &[f64], a: f64| Transfer::sampled(num, &[1.0, -a]);
    let shared =
        vec![g(&[0.0, 0.3], 0.7), g(&[0.0, 0.0, 0.1], 0.7), g(&[0.0, -0.2], 0.5), g(&[0.0, 0.4], 0.5)];
    let own = vec![g(&[0.0, 0.3], 0.7), g(&[0.0, 0.0, 0.1], 0.6), g(&[0.0, -0.2], 0.8), g(&[0.0, 0.4], 0.5)];
    let late = shared.iter().map(|c| c.delayed(0.1)).collect();
    let c = Transfer::sampled(&[0.6, -0.5], &[1.0, -1.0]);
    for channels in [shared, own, late] {
        let plant = System::new(time, 2, 2, channels).expect("a system");
        for k in 0..2 {
            let seen = beside_closed(&plant, &c, k).expect("whole delays");
            for w in [0.3, 2.0, 11.0, 50.0] {
                let at = |o: usize, i: usize| plant.channel(o, i).at(time, w);
                let (j, cw): (usize, C) = (1 - k, c.at(time, w));
                let expected = at(k, k) - at(k, j) * cw / (ONE + cw * at(j, j)) * at(j, k);
                assert!(
                    (seen.at(time, w) - expected).norm() < 1e-9,
                    "loop {k} at {w} rad/s: {} {expected}",
                    seen.at(time, w)
                );
            }
        }
    }
    let between =
        System::new(time, 2, 2, vec![Transfer::sampled(&[0.0, 1.0], &[1.0, -0.5]).delayed(0.02); 4]);
    let refused = beside_closed(&between.expect("a system"), &c, 0).expect_err("two fifths of a sample");
    assert!(refused.to_string().contains("0.02"), "{refused}");
    let single = System::single(time, c.clone()).expect("a system");
    assert!(beside_closed(&single, &c, 0).is_err());
}
