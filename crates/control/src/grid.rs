//! Frequencies at which a loop is looked at.
//!
//! A logarithmic grid from well below to well above every pole, zero and delay, dense about lightly damped roots, and as fine
//! as the delay asks while there is loop gain left. What lies between two frequencies is refined where a quantity is looked
//! for; a peak narrower than the grid can be missed, and results say on how many frequencies they stand.

use std::f64::consts::PI;

use dynocal_numerics::fft::Complex;

use crate::poly;
use crate::system::{System, Time, Transfer};

/// Frequencies in a decade.
const PER_DECADE: f64 = 40.0;
/// Decades beyond the least and greatest root.
const BEYOND: f64 = 2.0;
/// Loop gain below which delay turns nothing that counts.
const SMALL: f64 = 0.02;
/// Rate in a sample below which a root is one at rest: repeated roots are found with that uncertainty.
const SLOWEST: f64 = 1e-6;
/// Frequencies in which delay turns by a half turn.
const STEPS: f64 = 8.0;
/// Most frequencies that delay adds.
const MOST: usize = 20_000;

/// Grid in rad/s for a plant under a controller, ascending.
pub fn frequencies(plant: &System, controller: &System) -> Vec<f64> {
    let time = plant.time;
    let mut roots: Vec<Complex<f64>> = Vec::new();
    for c in plant.poles.iter().chain(&controller.poles).chain(plant.channels.iter().map(|g| &g.num)) {
        roots.extend(poly::roots(c).unwrap_or_default());
    }
    for c in controller.channels.iter().map(|g| &g.num) {
        roots.extend(poly::roots(c).unwrap_or_default());
    }
    let delay_s = plant.delay_s() + controller.delay_s();
    let mut out = match time {
        Time::Continuous => continuous(&roots, plant.channels.iter().chain(&controller.channels)),
        Time::Sampled { sample_time_s } => sampled(&roots, sample_time_s),
    };
    let gain = |w: f64| plant.at(w).times(&controller.at(w)).norm();
    let repeats = if time == Time::Continuous { repeated(&mut out, delay_s, gain) } else { false };
    if delay_s > 0.0 || time.nyquist_rad_s().is_some() {
        delayed(&mut out, delay_s + lags(plant) + lags(controller), gain);
    }
    ends(&mut out, time == Time::Continuous && !repeats);
    out.sort_by(f64::total_cmp);
    out.dedup_by(|a, b| (*a - *b).abs() <= 1e-13 * b.abs());
    // A pole of the open loop on the axis has no response there.
    out.retain(|w| plant.at(*w).data.iter().chain(&controller.at(*w).data).all(|v| v.norm().is_finite()));
    out
}

/// Time in s that numerators of a sampled system span: their leading zeros turn the response like a delay.
fn lags(system: &System) -> f64 {
    let Time::Sampled { sample_time_s } = system.time else { return 0.0 };
    let longest = system.channels.iter().map(|g| poly::degree(&g.num)).max().unwrap_or(0);
    longest as f64 * sample_time_s
}

/// Whether a loop with delay keeps its gain at high frequencies: it repeats itself then, turn by turn, and the grid ends with a whole half
/// turn beyond its roots, where the loop is real.
fn repeated(out: &mut Vec<f64>, delay_s: f64, gain: impl Fn(f64) -> f64) -> bool {
    let top = out.iter().copied().fold(0.0, f64::max);
    if !(delay_s > 0.0 && gain(1e3 * top) > SMALL) {
        return false;
    }
    let end = (top * delay_s / PI).ceil() * PI / delay_s;
    let affordable = end * STEPS * delay_s / PI <= MOST as f64;
    if affordable {
        out.push(end);
    }
    affordable
}

/// A few frequencies far below, and of a loop whose gain fades far `above`: a peak at rest is approached with the square of the
/// frequency, and two decades leave five digits of it.
fn ends(out: &mut Vec<f64>, above: bool) {
    let least = out.iter().copied().filter(|w| *w > 0.0).fold(f64::INFINITY, f64::min);
    let most = out.iter().copied().fold(0.0, f64::max);
    out.extend((1..=4).map(|k| least * 0.1f64.powi(k)));
    if above {
        out.extend((1..=3).map(|k| most * 10f64.powi(k)));
    }
}

fn logarithmic(lower: f64, upper: f64) -> Vec<f64> {
    let n = ((upper / lower).log10() * PER_DECADE).ceil().max(1.0) as usize;
    (0..=n).map(|k| lower * (upper / lower).powf(k as f64 / n as f64)).collect()
}

/// About the roots and every delay: a fast loop's beside that of one that is decades slower.
fn continuous<'a>(roots: &[Complex<f64>], channels: impl Iterator<Item = &'a Transfer>) -> Vec<f64> {
    let sizes = roots.iter().map(|r| r.norm()).filter(|v| *v > 1e-12 && v.is_finite());
    let delays = channels.filter(|g| g.delay_s > 0.0 && !g.is_zero()).map(|g| 1.0 / g.delay_s);
    let features: Vec<f64> = sizes.chain(delays).collect();
    let greatest = features.iter().copied().fold(0.0, f64::max);
    let least = features.iter().copied().filter(|v| *v > 1e-12 * greatest).fold(f64::INFINITY, f64::min);
    let (least, greatest) = if greatest > 0.0 { (least, greatest) } else { (1.0, 1.0) };
    let span = 10f64.powf(BEYOND);
    let mut out = logarithmic(least / span, greatest * span);
    for r in roots.iter().filter(|r| r.im > 0.0 && r.re.abs() < 0.3 * r.norm()) {
        about(&mut out, r.im, r.re.abs().max(1e-6 * r.im));
    }
    out
}

fn sampled(roots: &[Complex<f64>], sample_time_s: f64) -> Vec<f64> {
    let end = PI / sample_time_s;
    // Roots are those of polynomials in z^-1: the distance from the circle is a rate.
    let rates = roots.iter().filter(|r| r.norm() > 1e-6).map(|r| r.norm().ln().abs().max(r.arg().abs()));
    let least = rates.filter(|v| *v > SLOWEST).fold(PI, f64::min) / sample_time_s;
    let mut out = logarithmic(least / 10f64.powf(BEYOND), end);
    out.extend((1..=64).map(|k| end * f64::from(k) / 64.0));
    for r in roots.iter().filter(|r| r.arg().abs() > SLOWEST && r.norm().ln().abs() < 0.3) {
        let (centre, width) = (r.arg().abs() / sample_time_s, r.norm().ln().abs() / sample_time_s);
        about(&mut out, centre, width.max(1e-6 * centre));
    }
    out.retain(|w| *w <= end);
    out
}

/// Frequencies about a resonance.
fn about(out: &mut Vec<f64>, centre: f64, width: f64) {
    for k in -24..=24 {
        let w = centre + width * f64::from(k) * 1.2f64.powi(i32::abs(k)) / 4.0;
        if w > 0.0 {
            out.push(w);
        }
    }
}

/// Adds frequencies so that `delay_s` turns by less than an eighth of a half turn from one to the next, as long as there is
/// loop gain.
fn delayed(out: &mut Vec<f64>, delay_s: f64, gain: impl Fn(f64) -> f64) {
    if !(delay_s > 0.0) {
        return;
    }
    out.sort_by(f64::total_cmp);
    let Some(last) = out.iter().copied().rev().find(|w| gain(*w) > SMALL) else { return };
    let step = PI / (STEPS * delay_s);
    let count = ((last / step) as usize).min(MOST);
    out.extend((1..=count).map(|k| step * k as f64));
}
