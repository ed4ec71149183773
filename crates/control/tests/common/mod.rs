//! Loops with published margins.
#![allow(dead_code, unreachable_pub)]

use dynocal_control::closed::Closed;
use dynocal_control::poly::multiply;
use dynocal_control::system::{System, Time, Transfer};

pub const CONTINUOUS: Time = Time::Continuous;

/// One loop closed by one gain.
pub fn unity(l: Transfer, time: Time) -> Closed {
    Closed::new(System::single(time, l).unwrap(), System::single(time, Transfer::gain(1.0)).unwrap()).unwrap()
}

/// 25 / (s^3 + 10 s^2 + 10 s + 10).
pub fn third_order() -> Closed {
    unity(Transfer::continuous(&[25.0], &[1.0, 10.0, 10.0, 10.0], 0.0), CONTINUOUS)
}

/// 6.25 (s+3)(s+5) / (s (s+1)^2 (s^2 + 0.18 s + 100)).
pub fn resonant() -> Closed {
    let den = multiply(&[0.0, 1.0, 2.0, 1.0], &[100.0, 0.18, 1.0]);
    let num = vec![6.25 * 15.0, 6.25 * 8.0, 6.25];
    unity(Transfer { num, den, delay_s: 0.0 }, CONTINUOUS)
}

/// The spinning satellite with a = 10 under a gain matrix, row-major.
pub fn satellite(gains: [f64; 4]) -> Closed {
    let (a, b) = ([0.0, 10.0, -10.0, 0.0], [1.0, 0.0, 0.0, 1.0]);
    let plant = System::from_states(CONTINUOUS, &a, &b, &[1.0, 10.0, -10.0, 1.0], &[0.0; 4], 2).unwrap();
    let gains = gains.iter().map(|k| Transfer::gain(*k)).collect();
    Closed::new(plant, System::new(CONTINUOUS, 2, 2, gains).unwrap()).unwrap()
}

/// Loop 0.5 e^-s / s: the plant e^-s / (4 s + 1) under its SIMC gains 2 + 0.5 / s.
pub fn simc() -> Closed {
    unity(Transfer::continuous(&[0.5], &[1.0, 0.0], 1.0), CONTINUOUS)
}

#[track_caller]
pub fn near(found: f64, expected: f64, digits: i32) {
    let allowed = 0.6 * 10f64.powi(-digits);
    assert!((found - expected).abs() <= allowed, "found {found}, expected {expected} within {allowed}");
}
