//! Numbers of others: disk margins of published loops (python-control 0.10.2 with Slycot 0.7.1, agreeing with Seiler, Packard and
//! Gahinet), and closed forms.

mod common;

use common::{CONTINUOUS, near, resonant, satellite, simc, third_order};
use dynocal_control::disk::{DiskMargin, Place, disk, of_loop};
use dynocal_control::margin::{Side, margins};
use dynocal_control::plane::Channel;
use dynocal_control::smith::Smith;
use dynocal_control::system::Transfer;
use dynocal_control::tune::{Lag, simc as simc_gains};

/// Upper and lower bound agree.
#[track_caller]
fn tight(d: &DiskMargin) {
    assert!((d.alpha_lost / d.alpha - 1.0).abs() < 1e-6, "{d:?}");
}

#[test]
fn disk_margins_of_the_third_order_loop() {
    let l = third_order();
    for (skew, expected) in [(0.0, 0.45809), (1.0, 0.40215), (-1.0, 0.48637)] {
        let d = disk(&l, Place::Outputs, skew).unwrap();
        near(d.alpha, expected, 5);
        tight(&d);
    }
    let d = disk(&l, Place::Inputs, 0.0).unwrap();
    near(20.0 * d.gain_up.unwrap().log10(), 4.0508, 4);
    near(d.phase_deg, 25.802, 3);
    // The peak is flat: the published frequency to two digits.
    near(d.peak_rad_s, 1.9, 1);
    let m = margins(&l, Side::Outputs, 0).unwrap();
    near(m.gain_up.unwrap(), 3.60, 2);
    near(m.phase_deg.unwrap(), 29.11, 2);
}

#[test]
fn disk_margins_of_the_resonant_loop() {
    let l = resonant();
    for (skew, expected) in [(0.0, 0.71788), (1.0, 0.58518), (-1.0, 0.72395)] {
        near(disk(&l, Place::Outputs, skew).unwrap().alpha, expected, 5);
    }
    let d = disk(&l, Place::Outputs, 0.0).unwrap();
    near(20.0 * d.gain_up.unwrap().log10(), 6.526, 3);
    near(d.phase_deg, 39.49, 2);
    let m = margins(&l, Side::Outputs, 0).unwrap();
    near(m.gain_up.unwrap(), 2.9012, 4);
    near(m.phase_deg.unwrap(), 42.446, 3);
}

#[test]
fn disk_margins_of_the_spinning_satellite() {
    let l = satellite([1.0, 0.0, 0.0, 1.0]);
    for place in [Place::Inputs, Place::Outputs] {
        // At rest S = [0 -10; 10 0] and T = [1 10; -10 1]: mu(T) = sqrt(101).
        for (skew, expected) in [(0.0, 0.09975), (1.0, 0.09950), (-1.0, 1.0 / 101f64.sqrt())] {
            let d = disk(&l, place, skew).unwrap();
            near(d.alpha, expected, 5);
            tight(&d);
        }
        let d = disk(&l, place, 0.0).unwrap();
        near(20.0 * d.gain_up.unwrap().log10(), 0.8671, 4);
        near(d.phase_deg, 5.711, 3);
    }
    let both = disk(&l, Place::Both, 0.0).unwrap();
    near(both.alpha, 0.049845, 6);
    near(20.0 * both.gain_up.unwrap().log10(), 0.4330, 4);
    near(both.phase_deg, 2.855, 3);
    for k in 0..2 {
        for side in [Side::Inputs, Side::Outputs] {
            let d = of_loop(&l, side, k, 0.0).unwrap();
            near(d.alpha, 2.0, 5);
            near(d.phase_deg, 90.0, 3);
            let m = margins(&l, side, k).unwrap();
            assert!(m.gain_up.is_none(), "{m:?}");
            near(m.phase_deg.unwrap(), 90.0, 3);
        }
    }
}

#[test]
fn disk_margins_of_the_satellite_with_the_better_gains() {
    let l = satellite([1.0, -2.0, 0.0, 1.0]);
    // python-control 0.10.2 with Slycot 0.7.1 on 20 000 frequencies from 1e-4 rad/s on: the peak is at rest, and grids that begin
    // higher up give 0.37616, 0.36905, 0.36761.
    for (skew, expected) in [(0.0, 0.37615207), (1.0, 0.36904158), (-1.0, 0.36759888)] {
        let place = Place::Outputs;
        near(disk(&l, place, skew).unwrap().alpha, expected, 7);
    }
    let d = disk(&l, Place::Outputs, 0.0).unwrap();
    near(20.0 * d.gain_up.unwrap().log10(), 3.3067, 3);
    near(d.phase_deg, 21.304, 2);
    let both = disk(&l, Place::Both, 0.0).unwrap();
    near(both.alpha, 0.22618, 4);
    near(20.0 * both.gain_up.unwrap().log10(), 1.973, 3);
    near(both.phase_deg, 12.904, 3);
    // Four blocks: the bounds need not meet, but never cross.
    assert!(both.alpha <= both.alpha_lost * (1.0 + 1e-9), "{both:?}");
}

/// kp(w) = T w sin(L w) - cos(L w), ki(w) = w (sin(L w) + T w cos(L w)) for T = 4, L = 1.
#[test]
fn the_plane_of_a_lag_with_dead_time_is_analytic() {
    let c = Channel::new(CONTINUOUS, Transfer::continuous(&[1.0], &[4.0, 1.0], 1.0)).unwrap();
    for p in c.gain_locus(1.0) {
        let w = p.w_rad_s;
        let (kp, ki) = (4.0 * w * w.sin() - w.cos(), w * (w.sin() + 4.0 * w * w.cos()));
        assert!((p.kp - kp).abs() + (p.ki - ki).abs() < 1e-9 * (1.0 + 10.0 * w * w), "{p:?} {kp} {ki}");
    }
    let set = c.stable_set(400);
    assert_eq!(set.kp.len(), 1);
    near(set.kp[0].upper, 6.93451, 5);
    near(set.kp[0].lower, -1.0, 5);
    near(set.largest_ki, 3.21360, 5);
    near(set.kp_at_largest_ki, 3.91405, 4);
    near(set.area, 17.0733, 4);
}

#[test]
fn the_simc_loop_is_analytic() {
    let m = margins(&simc(), Side::Outputs, 0).unwrap();
    near(m.gain_up.unwrap(), std::f64::consts::PI, 5);
    near(m.phase_deg.unwrap(), 90.0 - 0.5f64.to_degrees(), 4);
    near(m.phase_deg.unwrap(), 61.3521, 4);
    near(m.sensitivity, 1.590490, 6);
    near(m.complementary, 1.0, 4);
    // Phase margin over frequency: (90 deg - 0.5 rad) / 0.5 rad/s.
    near(m.delay_s.unwrap(), (std::f64::consts::FRAC_PI_2 - 0.5) / 0.5, 5);
    let gains = simc_gains(&Lag { gain: 1.0, lag_s: 4.0, dead_s: 1.0 }, None);
    assert_eq!((gains.kp, gains.ki), (2.0, 0.5));
}

/// e^-s / (s + 1) with complementary sensitivity 1 / (lambda s + 1) of the undelayed loop.
#[test]
fn smith_predictors_lose_stability_where_they_should() {
    let p = Transfer::continuous(&[1.0], &[1.0, 1.0], 0.0);
    for (lambda, above, below) in [
        (0.1, 0.14874, Some(-0.15236)),
        (0.2, 0.29820, Some(-0.32143)),
        (0.5, 1.62724, None),
        (1.0, 2.34845, None),
    ] {
        let k = Transfer::continuous(&[1.0, 1.0], &[lambda, 0.0], 0.0);
        let found = Smith::new(CONTINUOUS, k, p.clone(), 1.0).delay_interval(&p, 1.0).unwrap();
        near(found.above_s.unwrap(), above, 5);
        match below {
            Some(b) => near(found.below_s.unwrap(), b, 5),
            None => assert!(found.below_s.is_none(), "{found:?}"),
        }
    }
}

/// A sampled loop of three channels that others publish: structured singular values at five frequencies, the peak and the ends of that of
/// its closed loop over 300 frequencies from 0.01 to 100 rad/s, and the disk margin of the first loop with the others closed at 4.05 rad/s
/// (tests of RobustAndOptimalControl.jl).
#[test]
fn structured_singular_values_of_three_channels() {
    use dynocal_control::matrix::{C, Matrix, ONE};
    use dynocal_control::mu;
    #[rustfmt::skip]
    let a = [
        1.0, 0.0, 9.84, 0.0, 0.0,
        0.0, 1.0, 0.01, 2.14634e-6, 0.0,
        0.0, 0.0, 1.0, 0.0, 0.0,
        0.0, 0.0, 0.0, 1.0, -1.73983959887,
        0.0, 0.0, 0.0, 0.0, 0.56597684805,
    ];
    #[rustfmt::skip]
    let b = [
        0.0, 4.901416e-5, 0.00019883877999999998,
        0.0, 0.0, 0.0,
        0.0, 0.0, 4.0414389999999996e-5,
        0.0, -0.02004649371, 0.0,
        0.0, -0.00490141631, 0.0,
    ];
    #[rustfmt::skip]
    let c = [
        0.0, -0.83516488404, 0.0, 0.0, 0.0,
        186.74725411661, 0.0, 0.0, 0.0, 0.0,
        -7.44299057498, 0.0, 7035.08410814126, 0.0, 0.0,
    ];
    let d = [0.0, 0.0, 0.0, 34875.36444283988, 0.0, 0.0, 48304.01940122544, 0.0, 0.0];
    let matrix = |rows: usize, cols: usize, v: &[f64]| Matrix {
        rows,
        cols,
        data: v.iter().map(|v| C::new(*v, 0.0)).collect(),
    };
    let (a, b, c, d) = (matrix(5, 5, &a), matrix(5, 3, &b), matrix(3, 5, &c), matrix(3, 3, &d));
    let at = |w: f64| {
        let z = C::from_polar(1.0, 0.01 * w);
        let states = Matrix::identity(5).sum(z, &a, C::new(-1.0, 0.0)).inverse().unwrap();
        c.times(&states).times(&b).sum(ONE, &d, ONE)
    };
    for (w, expected) in [
        (0.01, 2.961017564832289e5),
        (0.1, 0.029880921297303e5),
        (1.0, 0.000452684368322e5),
        (10.0, 0.000033712186847e5),
        (100.0, 0.000003488286208e5),
    ] {
        let found = mu::upper(&at(w));
        assert!((found / expected - 1.0).abs() < 1e-5, "{w}: {found} {expected}");
        assert!((mu::lower(&at(w)).value / expected - 1.0).abs() < 1e-4, "{w}: lower");
    }
    let closed = |w: f64| -> (Matrix, Matrix) {
        let open = at(w);
        let inverse = open.sum(ONE, &Matrix::identity(3), ONE).inverse().unwrap();
        (open.times(&inverse), inverse)
    };
    let of: Vec<f64> =
        (0..300).map(|k| mu::upper(&closed(10f64.powf(-2.0 + 4.0 * f64::from(k) / 299.0)).0)).collect();
    // To the tolerances of those tests, for the grids differ.
    let peak = of.iter().copied().fold(0.0, f64::max);
    let s = closed(4.05).1.at(0, 0);
    let alpha = 1.0 / (s - C::new(0.5, 0.0)).norm();
    for (found, expected, tolerance) in [
        (of[0], 1.0, 1e-3),
        (peak, 2.503148529400597, 1e-3),
        (of[299], 0.397718223553195, 0.03),
        (alpha, 0.794418036911981, 1e-3),
    ] {
        assert!((found / expected - 1.0).abs() < tolerance, "{found} {expected}");
    }
}
