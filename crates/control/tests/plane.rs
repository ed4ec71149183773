//! The plane of gains beyond lags: what is stable against counts, derivative parts, lightly damped plants, integrators, long delays.

use dynocal_control::plane::Channel;
use dynocal_control::runtime::PidGains;
use dynocal_control::search::{choose, choose_pid};
use dynocal_control::system::{Time, Transfer};
use dynocal_control::tune::{Asked, Lag, StepRun, judged, lag, settled_s, step_response, step_run};
use dynocal_numerics::rng::Rng64;

const TIME: Time = Time::Sampled { sample_time_s: 0.1 };

fn continuous(num: &[f64], den: &[f64], delay_s: f64) -> Channel {
    Channel::new(Time::Continuous, Transfer::continuous(num, den, delay_s)).unwrap()
}

fn run_of(channels: &[Channel]) -> StepRun {
    let lags: Vec<Lag> = channels.iter().filter_map(|c| lag(c).ok()).collect();
    step_run(channels, &lags)
}

/// Intervals of ki that follow from the signs of the crossings are those that a count at each ki finds, for plants drawn at random with
/// delays, derivative parts, and sampled.
#[test]
fn stable_intervals_are_those_of_a_count() {
    let mut rng = Rng64::new(5);
    for k in 0..40 {
        let lag_s = rng.uniform_in(0.2, 3.0);
        let channel = match k % 4 {
            0 => continuous(&[1.0], &[lag_s, 1.0], rng.uniform_in(0.1, 8.0)),
            1 => continuous(&[rng.uniform_in(-0.3, 0.5), 1.0], &[lag_s, rng.uniform_in(0.2, 2.0), 1.0], 0.7),
            2 => continuous(&[1.0], &[0.3, 1.0, rng.uniform_in(0.05, 1.0), 0.4], 0.2),
            _ => {
                let a = rng.uniform_in(0.5, 0.98);
                let num = [0.0, 0.0, 1.0 - a, rng.uniform_in(-0.5, 0.5) * (1.0 - a)];
                Channel::new(TIME, Transfer::sampled(&num, &[1.0, -a])).unwrap()
            }
        };
        let kd = if k % 3 == 0 { 0.0 } else { rng.uniform_in(0.0, 0.3) };
        let channel = channel.with_derivative(kd, 0.1).unwrap();
        let top = channel.kp_ranges().last().map_or(1.0, |i| i.upper);
        for _ in 0..6 {
            let kp = rng.uniform_in(-0.3, 1.2) * top;
            let found = channel.stable_ki(kp);
            let end = found.last().map_or(top, |i| i.upper);
            for _ in 0..40 {
                let ki = rng.uniform_in(1e-3, 1.3) * end;
                let near = |edge: f64| (ki / edge - 1.0).abs() < 1e-6;
                if found.iter().any(|i| near(i.lower) || near(i.upper)) {
                    continue;
                }
                let inside = found.iter().any(|i| ki > i.lower && ki < i.upper);
                // Without an upper edge the interval ends where there is enough to choose from.
                let beyond = found.last().is_some_and(|i| ki > i.upper);
                let stable = channel.unstable(kp, ki).is_stable();
                assert!(inside == stable || (beyond && stable && k % 4 == 1), "{k} {kp} {ki} {found:?}");
            }
        }
    }
}

/// A derivative part moves the boundary as it should: `1 / s^2` under a PD with a filter is stable for small ki only, by Routh
/// `T s^4 + s^3 + (T kp + kd) s^2 + (T ki + kp) s + ki`; without it no PI holds it.
#[test]
fn a_derivative_part_holds_what_no_pi_holds() {
    let twice = continuous(&[1.0], &[1.0, 0.0, 0.0], 0.0);
    let asked = Asked::default();
    assert!(twice.stable_ki(1.0).is_empty());
    let (t, kd, kp) = (0.05, 1.0, 0.6);
    let with = twice.with_derivative(kd, t).unwrap();
    let edge = with.stable_ki(kp).last().unwrap().upper;
    // Hurwitz: a1 a2 a3 = a3^2 a0 + a1^2 with a3 = 1/T, a2 = (T kp + kd)/T, a1 = (T ki + kp)/T, a0 = ki/T.
    let routh = |ki: f64| {
        let (a3, a2, a1, a0) = (1.0 / t, (t * kp + kd) / t, (t * ki + kp) / t, ki / t);
        a1 * a2 * a3 - a3 * a3 * a0 - a1 * a1
    };
    assert!(routh(0.999 * edge) > 0.0 && routh(1.001 * edge) < 0.0, "{edge} {}", routh(edge));
    for p in with.gain_locus(2.0).iter().filter(|p| p.w_rad_s > 0.01 && p.w_rad_s < 10.0) {
        let s = dynocal_numerics::fft::Complex::new(0.0, p.w_rad_s);
        let c = s.inv() * p.ki + p.kp + s * kd / (s * t + 1.0);
        assert!((c / (s * s) + 0.5).norm() < 1e-9, "{p:?}");
    }
    // No PI holds it, and the search for a PID does not need one.
    let late = [continuous(&[1.0], &[1.0, 0.0, 0.0], 0.2)];
    assert!(choose(&[twice], &asked, StepRun { step_s: 0.01, rows: 4000 }).is_err());
    let found = choose_pid(&late, &asked, None, run_of(&late)).unwrap();
    assert!(found.choice.kept && found.kd > 0.0 && found.pi.is_none(), "{:?}", found.choice.tuned);
}

/// A PID that is searched keeps what is asked and settles sooner than the best PI: on a lag with dead time, and by far on a lightly
/// damped plant; the margins are those of the loop with its derivative part.
#[test]
fn a_pid_is_faster_than_the_best_pi() {
    let asked = Asked::default();
    for (channel, sooner) in [
        (continuous(&[1.0], &[1.0, 2.0, 1.0], 0.3), 0.85),
        (continuous(&[1.0], &[1.0, 0.02, 1.0], 0.0), 0.05),
        (
            Channel::new(TIME, Transfer::sampled(&[0.0, 0.0, 0.0, 0.01, 0.009], &[1.0, -1.8, 0.81])).unwrap(),
            0.95,
        ),
    ] {
        let r = run_of(std::slice::from_ref(&channel));
        let found = choose_pid(std::slice::from_ref(&channel), &asked, None, r).unwrap();
        let pid = &found.choice.tuned;
        assert!(
            found.kd > 0.0 && found.choice.kept && found.pi.as_ref().unwrap().violation.unwrap() <= 1.0,
            "{found:?}"
        );
        let (own, pi) = (pid.settling_s.unwrap(), found.pi.as_ref().unwrap().settling_s.unwrap());
        assert!(own < sooner * pi, "{own} {pi} {:?}", (found.kd, found.filter_s));
        let gains = PidGains { kp: pid.kp, ki: pid.ki, kd: found.kd, filter_s: found.filter_s };
        let closed = dynocal_control::closed::Closed::new(
            dynocal_control::system::System::single(channel.time, channel.transfer.clone()).unwrap(),
            dynocal_control::system::System::single(channel.time, gains.transfer(channel.time)).unwrap(),
        )
        .unwrap();
        let m = dynocal_control::margin::margins(&closed, dynocal_control::margin::Side::Outputs, 0).unwrap();
        let told = pid.margins[0].as_ref().unwrap();
        // The time it settles in is that of a run eight times as fine.
        if channel.time == Time::Continuous {
            let fine =
                StepRun { step_s: r.step_s / 40.0, rows: 3000.max((1.5 * own / r.step_s) as usize * 40) };
            let again = settled_s(&channel, &gains, fine).unwrap();
            assert!((again / own - 1.0).abs() < 0.03, "{own} {again}");
        }
        assert!((m.sensitivity / told.sensitivity - 1.0).abs() < 1e-3, "{m:?} {told:?}");
    }
}

/// Of a lightly damped plant only a thousandth of what is stable keeps margins: integral control alone keeps `Ms` up to about
/// `ki = 0.02 (1 - 1/Ms)`, the resonance of size 50 ki staying a circle away from -1, and the search is no slower.
#[test]
fn the_search_finds_what_a_lightly_damped_plant_leaves() {
    let channel = continuous(&[1.0], &[1.0, 0.02, 1.0], 0.0);
    let r = run_of(std::slice::from_ref(&channel));
    let asked = Asked::default();
    let found = choose(std::slice::from_ref(&channel), &asked, r).unwrap();
    let by_hand = judged("by hand", &PidGains::pi(1e-6, 0.008), std::slice::from_ref(&channel), &asked, r);
    assert!(found.kept && by_hand.violation.unwrap() <= 1.0, "{:?} {by_hand:?}", found.tuned);
    assert!(found.tuned.settling_s.unwrap() <= by_hand.settling_s.unwrap(), "{:?} {by_hand:?}", found.tuned);
}

/// An integrator holds its demand without an integral, but not a load: the search lets neither wait.
#[test]
fn a_load_on_an_integrator_fades() {
    let channel = continuous(&[1.0], &[1.0, 0.0], 1.0);
    let r = run_of(std::slice::from_ref(&channel));
    let found = choose(std::slice::from_ref(&channel), &Asked::default(), r).unwrap();
    assert!(found.kept, "{:?}", found.tuned);
    // SIMC has an integral time of 8 dead times; four of those at most.
    assert!(found.tuned.kp / found.tuned.ki < 32.0, "{:?}", found.tuned);
}

/// A delay of a hundred lags: the boundary has thousands of crossings, and nearly the gains of a plain delay are left.
#[test]
fn long_delays_have_a_plane() {
    let channel = continuous(&[1.0], &[1.0, 1.0], 100.0);
    let ranges = channel.kp_ranges();
    // The limit of P control is sqrt(1 + w^2) at w = pi / 101 nearly, 1.0005; ends are found on the grid.
    let end = ranges.last().unwrap().upper;
    assert!((end - 1.0).abs() < 1e-3, "{ranges:?}");
    // A plain delay under an integral: pi / (2 L); the lag takes a hundredth of it.
    let ki = channel.stable_ki(0.0);
    let edge = std::f64::consts::FRAC_PI_2 / 101.0;
    assert!(ki.len() == 1 && (ki[0].upper / edge - 1.0).abs() < 0.01, "{ki:?}");
}

/// Gains follow the units and the time of the plant: the same plant in other ones has the same margins and settles in the same share of its
/// time; a lag of a million dead times is no slower than its dead time lets it be.
#[test]
fn gains_follow_the_scales_of_the_plant() {
    let asked = Asked::default();
    let of = |channel: Channel| {
        let channels = [channel];
        choose(&channels, &asked, run_of(&channels)).unwrap().tuned
    };
    let plain = of(continuous(&[1.0], &[1.0, 2.0, 1.0], 0.3));
    let (gain, time) = (1e9, 1e-6);
    let scaled = of(continuous(&[gain], &[time * time, 2.0 * time, 1.0], 0.3 * time));
    assert!((scaled.kp * gain / plain.kp - 1.0).abs() < 0.02, "{plain:?} {scaled:?}");
    let (a, b) = (plain.settling_s.unwrap(), scaled.settling_s.unwrap());
    assert!((b / time / a - 1.0).abs() < 0.02, "{a} {b}");
    let slow = of(continuous(&[1.0], &[1e6, 1.0], 1.0));
    assert!(slow.settling_s.unwrap() < 20.0, "{slow:?}");
}

/// A plant that answers at once, `(1 - s) / (1 + s)`: stable for `|kp| < 1`, `0 < ki < 1 + kp`, by hand from
/// `(1 - kp) s^2 + (1 + kp - ki) s + ki`; they settle in a run though plant and controller answer at once.
#[test]
fn plants_that_answer_at_once_have_a_plane() {
    let channel = continuous(&[-1.0, 1.0], &[1.0, 1.0], 0.0);
    let ranges = channel.kp_ranges();
    let end = ranges.last().unwrap().upper;
    assert!((end - 1.0).abs() < 1e-3, "{ranges:?}");
    for kp in [-0.5, 0.2, 0.8] {
        let ki = channel.stable_ki(kp);
        assert!(ki.len() == 1 && (ki[0].upper / (1.0 + kp) - 1.0).abs() < 1e-6, "{kp} {ki:?}");
        // The gain may grow until `1 - g kp` or `1 + g (kp - ki)` is 0.
        let m = channel.margins(kp, 0.3).unwrap();
        let most =
            [1.0 / kp, 1.0 / (0.3 - kp)].into_iter().filter(|g| *g > 0.0).fold(f64::INFINITY, f64::min);
        assert!((m.gain_up.unwrap() / most - 1.0).abs() < 1e-3, "{kp} {most} {m:?}");
    }
}

/// A plain delay repeats itself at all frequencies, and with it a loop of a PI or a PID: stable up to `ki = w sin w` at `kp = -cos w`, by
/// hand, and a search for a PID (whose filter leaves it a gain too) that keeps what is asked.
#[test]
fn a_plain_delay_has_gains() {
    let channel = continuous(&[1.0], &[1.0], 1.0);
    for kp in [-0.5f64, 0.0, 0.5, 0.9] {
        let w = (-kp).acos();
        let ki = channel.stable_ki(kp);
        assert!(ki.len() == 1 && (ki[0].upper / (w * w.sin()) - 1.0).abs() < 1e-6, "{kp} {ki:?}");
    }
    for channel in [channel, continuous(&[1.0, 2.0], &[1.0, 1.0], 0.1)] {
        let (asked, own) = (Asked::default(), [channel]);
        let found = choose_pid(&own, &asked, None, run_of(&own)).unwrap();
        let (own, pi) = (found.choice.tuned.settling_s, found.pi.as_ref().unwrap());
        assert!(found.choice.kept && asked.kept_by(pi), "{found:?}");
        assert!(own.unwrap() <= pi.settling_s.unwrap(), "{own:?} {pi:?}");
    }
}

/// What arrives behind a delay arrives as it left: a derivative kick through `e^-Ls / (s + 1)` is `(kd / T) (e^-t - e^-t/T) / (1/T - 1)`, by
/// hand until the loop closes, and a run is as good as one eight times as fine afterwards, also where the step does not divide the delay.
#[test]
fn a_kick_passes_a_delay_as_it_is() {
    let channel = continuous(&[1.0], &[1.0, 1.0], 1.0);
    let (kd, filter) = (0.3, 0.02);
    let gains = PidGains { kp: 0.0, ki: 0.0, kd, filter_s: filter };
    let (y, r) = step_response(&channel, &gains, StepRun { step_s: 0.013, rows: 500 }).unwrap();
    let by_hand = |t: f64| match t < 1.0 {
        true => 0.0,
        false => kd / filter * ((1.0 - t).exp() - ((1.0 - t) / filter).exp()) / (1.0 / filter - 1.0),
    };
    for (k, y) in y.iter().enumerate().take_while(|(k, _)| (*k as f64) * r.step_s < 2.0) {
        let expected = by_hand(k as f64 * r.step_s);
        assert!((y - expected).abs() < 1e-4, "{k}: {y} {expected}");
    }
    for channel in
        [channel, continuous(&[1.0], &[1.0, 0.4, 1.0], 0.2), continuous(&[1.0, 2.0], &[1.0, 1.0], 0.1)]
    {
        let asked = Asked::default();
        let r = run_of(std::slice::from_ref(&channel));
        let found = choose_pid(std::slice::from_ref(&channel), &asked, None, r).unwrap();
        let (pid, pi) = (&found.choice.tuned, found.pi.as_ref().unwrap());
        let own = pid.settling_s.unwrap();
        let gains = PidGains { kp: pid.kp, ki: pid.ki, kd: found.kd, filter_s: found.filter_s };
        let step_s = r.step_s.min(if found.kd > 0.0 { found.filter_s } else { 1.0 }) / 8.37;
        let fine = StepRun { step_s, rows: (3.0 * own / step_s) as usize };
        let again = settled_s(&channel, &gains, fine).unwrap();
        assert!((again / own - 1.0).abs() < 0.02, "{own} {again} {gains:?}");
        assert!(own <= pi.settling_s.unwrap(), "{own} {pi:?}");
    }
}
