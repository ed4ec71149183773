//! A sample of the controllers that run never allocates.

use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
use dynocal_control::predictor::{PredictedModel, Predictor};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::system::Transfer;
use dynocal_control::trim::LongTrim;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;

#[global_allocator]
static COUNTER: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

// One test only: the counter is global to the process.
#[test]
fn no_allocation_in_a_sample() {
    let limits = ActuatorLimits { lower: -1.0, upper: 1.0, rate_per_s: Some(20.0) };
    let gains = PidGains { kp: 1.0, ki: 2.0, kd: 0.01, filter_s: 0.05 };
    let model = Transfer::sampled(&[0.0, 0.2, 0.1], &[1.0, -0.7]);
    let known = PredictedModel { model, delay_samples: 7.0, longest_samples: 40, filter_s: 0.2, flow: None };
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
    let mut pid = Pid::new(gains, limits, 0.01, 0.0).unwrap();
    let mut smith = Predictor::new(gains, limits, 0.01, 0.0, &known).unwrap();
    let mut oxygen = OxygenObserver::new(store, 0.5).unwrap();
    let mut trim = LongTrim::new(vec![vec![0.0, 1.0, 2.0]; 2], 10.0, 1.0).unwrap();
    let region = Region::new(COUNTER);
    let mut sum = 0.0;
    for t in 0..1000 {
        let y = f64::from(t % 37) * 0.02;
        smith.set_delay(5.0 + 10.0 * y);
        sum += pid.step(0.0, 0.5 - y) + smith.step(0.0, 0.5, y);
        sum += oxygen.step(0.98 + 0.05 * y, 1.0 + 0.03 * y, 10.0, 0.01) + trim.learn(&[y, 2.0 * y], y, 0.01);
    }
    let change = region.change();
    assert!(sum.is_finite());
    assert_eq!((change.allocations, change.reallocations), (0, 0), "{change:?}");
}
