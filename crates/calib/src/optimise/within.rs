//! Demands that stay near what the problem asks.

use std::ops::Range;

/// Distance from the range of a demand at which it is led back, as a share of the range.
const BEYOND: f64 = 0.5;

/// `values`, led back where they leave `range` by more than half of it:
///
/// ```text
/// y + w F(clamp(y) - y)
/// ```
///
/// F is a first-order lag of `lag` samples forwards and backwards, so that the way back is no edge that no input could follow. The
/// weight w is 0 up to sample `reached`, from which on every output obeys the inputs, and 1 from `lag` samples later on: before
/// it a response can only be what it is. What lasts is led back; a peak that is short beside the lag stays outside.
pub(super) fn led_back(values: &mut [f64], range: Range<f64>, reached: usize, lag: usize) {
    let beyond = BEYOND * (range.end - range.start);
    let (lower, upper) = (range.start - beyond, range.end + beyond);
    let lag = lag.max(1) as f64;
    let gain = 1.0 - (-1.0 / lag).exp();
    let mut state = 0.0;
    let mut back: Vec<f64> = values.iter().map(|y| y.clamp(lower, upper) - y).collect();
    let mut pass = |v: &mut f64| {
        state += gain * (*v - state);
        *v = state;
    };
    back.iter_mut().for_each(&mut pass);
    back.iter_mut().rev().for_each(&mut pass);
    for (t, (y, b)) in values.iter_mut().zip(back).enumerate() {
        *y += b * ((t as f64 - reached as f64) / lag).clamp(0.0, 1.0);
    }
}
