//! Every margin as a run: stable at 0.98 of what is guaranteed, unstable at 1.02 of what is lost.

mod common;

use common::{CONTINUOUS, resonant, satellite, simc, third_order, unity};
use dynocal_control::closed::Closed;
use dynocal_control::disk::{DiskMargin, Place, disk, of_loop};
use dynocal_control::margin::{Side, margins};
use dynocal_control::perturb::{is_gain, perturbed, perturbed_loop};
use dynocal_control::runtime::PidGains;
use dynocal_control::system::{System, Time, Transfer};
use dynocal_control::trial::{grows, later, louder, turned};
use dynocal_numerics::rng::Rng64;

#[track_caller]
fn expect(l: &Closed, w: f64, stable: bool, what: &str) {
    let growth = grows(l, w, w).unwrap();
    assert!((growth < 0.0) == stable, "{what}: the run grows by {growth}, expected stable: {stable}");
    assert_eq!(l.is_stable(), stable, "{what}: by the argument {:?}", l.unstable());
}

fn with_plant(l: &Closed, plant: System) -> Closed {
    Closed::new(plant, l.controller.clone()).unwrap()
}

/// Gain, phase and delay margins of each loop, the others closed.
fn classical(l: &Closed, what: &str) {
    for (side, k) in sides(l) {
        let (m, at) = (margins(l, side, k).unwrap(), (side, k));
        let what = format!("{what}: {side:?} {k}");
        for (factor, w) in [(m.gain_up, m.gain_up_rad_s), (m.gain_down.map(f64::recip), m.gain_down_rad_s)] {
            let (Some(g), Some(w)) = (factor, w) else { continue };
            for (share, stable) in [(0.98, true), (1.02, false)] {
                let factor = if Some(g) == m.gain_up { g * share } else { 1.0 / (g * share) };
                let plant = louder(&l.plant, at, factor).unwrap();
                let w = w.max(0.1 * m.sensitivity_rad_s);
                expect(&with_plant(l, plant), w, stable, &format!("{what}: gain {share}"));
            }
        }
        if let (Some(p), Some(w)) = (m.phase_deg, m.phase_rad_s) {
            for (share, stable) in [(0.98, true), (1.02, false)] {
                // A turned loop is run only: the argument of a pair is not asked for.
                let growth = grows(&turned(l, at, (p * share).to_radians()).unwrap(), w, w).unwrap();
                assert!((growth < 0.0) == stable, "{what}: phase {share} grows by {growth}");
            }
        }
        if let (Some(d), Some(w)) = (m.delay_s, m.delay_rad_s) {
            for (share, stable) in [(0.98, true), (1.02, false)] {
                let plant = later(&l.plant, at, share * d, w).unwrap();
                expect(&with_plant(l, plant), w, stable, &format!("{what}: delay {share}"));
            }
        }
    }
}

fn sides(l: &Closed) -> Vec<(Side, usize)> {
    let of = |side, n: usize| (0..n).map(move |k| (side, k));
    of(Side::Inputs, l.plant.inputs).chain(of(Side::Outputs, l.plant.outputs)).collect()
}

/// What is lost at rest is waited for as something a tenth as fast as the slowest crossover; none where it is lost at no frequency that a run
/// reaches.
fn waited(l: &Closed, d: &DiskMargin) -> Option<f64> {
    let crossovers: Vec<f64> =
        sides(l).into_iter().filter_map(|(side, k)| margins(l, side, k).unwrap().phase_rad_s).collect();
    let slowest = crossovers.iter().copied().fold(f64::INFINITY, f64::min);
    let fastest = crossovers.iter().copied().fold(0.0, f64::max);
    let at_rest = slowest.is_finite() && d.perturbation.iter().all(|p| is_gain(*p));
    let w = if at_rest { d.lost_rad_s.max(0.1 * slowest) } else { d.lost_rad_s };
    (w < 1e3 * fastest).then_some(w)
}

/// Disk margins with the perturbation that was found.
fn disks(l: &Closed, what: &str) {
    for place in [Place::Inputs, Place::Outputs, Place::Both] {
        let d = disk(l, place, 0.0).unwrap();
        let Some(w) = waited(l, &d) else { continue };
        for (share, stable) in [(0.98, true), (1.02, false)] {
            let Some(plant) = perturbed(&l.plant, place, &d, share).unwrap() else { continue };
            expect(&with_plant(l, plant), w, stable, &format!("{what}: {place:?} {share} of {d:?}"));
        }
    }
    for (side, k) in sides(l) {
        let d = of_loop(l, side, k, 0.0).unwrap();
        let Some(w) = waited(l, &d) else { continue };
        for (share, stable) in [(0.98, true), (1.02, false)] {
            let Some(plant) = perturbed_loop(&l.plant, (side, k), &d, share).unwrap() else { continue };
            let what = format!("{what}: {side:?} {k} alone, {share} of {d:?}");
            expect(&with_plant(l, plant), w, stable, &what);
        }
    }
}

#[test]
fn published_loops_do_as_their_margins_say() {
    for (l, what) in [(third_order(), "third order"), (resonant(), "resonant"), (simc(), "simc")] {
        classical(&l, what);
    }
    disks(&third_order(), "third order");
    disks(&satellite([1.0, -2.0, 0.0, 1.0]), "satellite");
    classical(&satellite([1.0, -2.0, 0.0, 1.0]), "satellite");
}

#[test]
fn sampled_loops_do_as_their_margins_say() {
    let time = Time::Sampled { sample_time_s: 0.1 };
    for (a, b, delay, kp, ki) in [(0.8, 0.2, 3, 1.0, 1.2), (0.95, 0.1, 1, 4.0, 4.0), (0.5, 0.4, 8, 0.3, 0.8)]
    {
        let mut num = vec![0.0; delay];
        num.push(b);
        let g = Transfer::sampled(&num, &[1.0, -a]);
        let l = g.times(&PidGains::pi(kp, ki).transfer(time));
        classical(&unity(l.clone(), time), &format!("{a} {delay}"));
        disks(&unity(l, time), &format!("{a} {delay}"));
    }
}

/// 0.35 z^-2 / (1 + 0.7 z^-1) is 1.17 at half the sampling frequency. One more sample makes p = z^3 + 0.7 z^2 + 0.35 of the loop: of an odd
/// degree and with p(-1) = 0.05 above 0, so a pole lies beyond -1 (E. I. Jury, Theory and Application of the z-Transform Method, 1964).
#[test]
fn a_gain_above_one_at_half_the_sampling_frequency_leaves_no_sample() {
    let time = Time::Sampled { sample_time_s: 0.1 };
    let l = unity(Transfer::sampled(&[0.0, 0.0, 0.35], &[1.0, 0.7]), time);
    assert!(l.is_stable());
    let m = margins(&l, Side::Outputs, 0).unwrap();
    assert!(m.delay_s.unwrap() <= 0.1, "{m:?}");
    let one_more = later(&l.plant, (Side::Outputs, 0), 0.1, 1.0).unwrap();
    expect(&with_plant(&l, one_more), 10.0, false, "one more sample");
}

/// Two sampled loops that act on each other, drawn at random.
#[test]
fn drawn_coupled_loops_do_as_their_margins_say() {
    let time = Time::Sampled { sample_time_s: 0.05 };
    let mut rng = Rng64::new(11);
    let mut looked_at = 0;
    for _ in 0..12 {
        let mut own = |gain: f64| {
            let mut num = vec![0.0; 1 + rng.below(5)];
            let a = rng.uniform_in(0.3, 0.95);
            num.push(gain * rng.uniform_in(0.5, 1.5) * (1.0 - a));
            Transfer::sampled(&num, &[1.0, -a])
        };
        let channels = vec![own(1.0), own(0.4), own(-0.5), own(1.0)];
        let plant = System::new(time, 2, 2, channels).unwrap();
        let pi = |kp, ki| PidGains::pi(kp, ki).transfer(time);
        let l = Closed::new(plant, System::diagonal(time, &[pi(0.5, 1.5), pi(0.4, 1.0)]).unwrap()).unwrap();
        if l.is_stable() {
            looked_at += 1;
            disks(&l, "drawn");
            classical(&l, "drawn");
        }
    }
    assert!(looked_at >= 8, "{looked_at}");
}

/// The count of unstable poles against runs, over gains on both sides of stability.
#[test]
fn the_argument_and_the_run_agree() {
    let mut rng = Rng64::new(5);
    let (mut stable, mut unstable) = (0, 0);
    for _ in 0..60 {
        let (t, delay, kp, ki) = (
            rng.uniform_in(0.2, 3.0),
            rng.uniform_in(0.2, 1.5),
            rng.uniform_in(0.0, 4.0),
            rng.uniform_in(0.05, 3.0),
        );
        let g = Transfer::continuous(&[1.0], &[t, 1.0], delay);
        let l = unity(g.times(&PidGains::pi(kp, ki).transfer(CONTINUOUS)), CONTINUOUS);
        let growth = grows(&l, 1.0, 1.0).unwrap();
        if growth.abs() < 0.2 {
            continue;
        }
        assert_eq!(growth < 0.0, l.is_stable(), "{t} {delay} {kp} {ki}: {growth} {:?}", l.unstable());
        if growth < 0.0 { stable += 1 } else { unstable += 1 }
    }
    assert!(stable > 10 && unstable > 10, "{stable} {unstable}");
}
