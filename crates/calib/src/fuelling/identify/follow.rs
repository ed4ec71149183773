//! What the channels of a record would show.

use super::record::TransientRecord;
use crate::fuelling::charge::TERMS;
use crate::fuelling::filling::FillingState;
use crate::fuelling::{Fuelling, Timing};

/// What the pressure channel would show.
pub(super) fn shown(r: &TransientRecord<'_>, f: &Fuelling) -> Vec<f64> {
    followed(r, f, |state, _| state.shown_kpa())
}

/// Pressure of the filling, corrected by what was measured.
pub(super) fn pressure(r: &TransientRecord<'_>, f: &Fuelling) -> Vec<f64> {
    followed(r, f, |state, _| state.pressure_kpa())
}

/// `of` the filling after each sample of the record.
fn followed(r: &TransientRecord<'_>, f: &Fuelling, of: impl Fn(&FillingState, usize) -> f64) -> Vec<f64> {
    let dt = r.sample_time_s;
    let mut state = FillingState::at_rest(r.map_kpa[0], r.throttle_deg[0], dt);
    let step = |t: usize| {
        let before = r.map_kpa[t.saturating_sub(1)];
        let air = f.air(r.coolant_c(t), r.cams_deg(t));
        let held = (r.speed_rpm[t], r.throttle_deg[t], r.upstream_kpa(t));
        state.step(&f.filling, air, held, before, dt);
        of(&state, t)
    };
    (0..r.speed_rpm.len()).map(step).collect()
}

/// The sample before a time in samples out of `n`, the part of a sample after it, and whether it is within the ends, where it is held.
fn place(n: usize, t: f64) -> (usize, f64, bool) {
    let within = t.clamp(0.0, (n - 1) as f64);
    let k = (within as usize).min(n - 2);
    (k, within - k as f64, within == t)
}

/// A value between samples, held at the ends.
fn between(v: &[f64], t: f64) -> f64 {
    let (k, part, _) = place(v.len(), t);
    v[k] + part * (v[k + 1] - v[k])
}

/// What is in the cylinders over what makes lambda 1, injection by injection, and speed and pressure of the air that it meets.
fn in_cylinder(r: &TransientRecord<'_>, f: &Fuelling, pressure: &[f64]) -> (Vec<f64>, Vec<[f64; 2]>) {
    let (dt, timing): (f64, &Timing) = (r.sample_time_s, &f.timing);
    let film = |t: usize| f.film_of(r.coolant_c(t), r.speed_rpm[t], pressure[t]);
    let mut state = film(0).at_rest(r.injection[0], r.speed_rpm[0]);
    let of = |t: usize| {
        let speed = r.speed_rpm[t];
        let fuel = film(t).forward(&mut state, r.injection[t], speed, dt);
        let met = t as f64 + (timing.charge_s + timing.charge_cycles * 120.0 / speed) / dt;
        // Known a sample after they were.
        let cams_deg = r.cams_deg.map(|cams| cams.map(|c| between(c, met - 1.0)));
        let at = [between(r.speed_rpm, met), between(pressure, met)];
        (fuel / f.air(r.coolant_c(t), cams_deg).at(at[0], at[1]), at)
    };
    (0..r.speed_rpm.len()).map(of).unzip()
}

/// What passes between cylinder and sensor in a sample.
struct Way {
    /// Samples from an injection until the sensor begins to show it, and those of them that go with one over the flow.
    late: f64,
    through: f64,
    /// What the gas in the volume follows of a step, and that by the logarithm of the flow.
    mixed: (f64, f64),
}

fn way(r: &TransientRecord<'_>, f: &Fuelling, pressure: &[f64], t: usize) -> Way {
    let (dt, timing, speed) = (r.sample_time_s, &f.timing, r.speed_rpm[t]);
    let flow = f.air(r.coolant_c(t), r.cams_deg(t)).flow(speed, pressure[t]);
    let late = timing.delay_s(speed, flow);
    let through = late - timing.delay_s(speed, f64::INFINITY);
    Way { late: late / dt, through: through / dt, mixed: timing.mixed(flow, dt) }
}

/// What follows of a step of a value in a sample.
fn follow(r: &TransientRecord<'_>, f: &Fuelling) -> f64 {
    -(-r.sample_time_s / f.timing.sensor_lag_s).exp_m1()
}

/// 1 / lambda as the sensor would show it, the pressure being what it is.
pub(super) fn richness(r: &TransientRecord<'_>, f: &Fuelling, pressure: &[f64]) -> Vec<f64> {
    let (mixture, _) = in_cylinder(r, f, pressure);
    let follow = follow(r, f);
    let (mut mixed, mut shown) = (mixture[0], mixture[0]);
    let step = |t: usize| {
        let way = way(r, f, pressure, t);
        mixed += way.mixed.0 * (between(&mixture, t as f64 - way.late) - mixed);
        shown += follow * (mixed - shown);
        shown
    };
    (0..r.speed_rpm.len()).map(step).collect()
}

/// The same with its derivatives by the coefficients of the charge, given sample by sample to `take`: those of the mixture that is seen,
///
/// ```text
/// d phi(t - D) = - phi(t - D) T(met) / c(met) + phi' D' T(t) / c(t),   T terms of c, D' part of the delay D that goes with 1 / c
/// ```
///
/// behind the lag of the volume, which goes with 1 / c too, and that of the sensor.
pub(super) fn richness_slopes(
    r: &TransientRecord<'_>,
    f: &Fuelling,
    pressure: &[f64],
    take: &mut dyn FnMut(usize, f64, &[f64; TERMS]),
) {
    let (mixture, met) = in_cylinder(r, f, pressure);
    let over = |[speed, pressure]: [f64; 2], by: f64| {
        let share = by / f.charge.at(speed, pressure);
        f.charge.terms(speed, pressure).map(|v| v * share)
    };
    let slopes: Vec<[f64; TERMS]> = met.iter().zip(&mixture).map(|(at, phi)| over(*at, -phi)).collect();
    let follow = follow(r, f);
    let (mut mixed, mut mixed_by) = (mixture[0], slopes[0]);
    let (mut shown, mut by) = (mixture[0], slopes[0]);
    for t in 0..r.speed_rpm.len() {
        let Way { late, through, mixed: (share, share_by) } = way(r, f, pressure, t);
        let (k, part, inside) = place(mixture.len(), t as f64 - late);
        let rise = if inside { mixture[k + 1] - mixture[k] } else { 0.0 };
        let step = mixture[k] + part * (mixture[k + 1] - mixture[k]) - mixed;
        // Of the flow of now: the delay of what comes, and how much of it the volume follows.
        let later = over([r.speed_rpm[t], pressure[t]], share * rise * through + share_by * step);
        mixed += share * step;
        shown += follow * (mixed - shown);
        for (j, (m, d)) in mixed_by.iter_mut().zip(by.iter_mut()).enumerate() {
            *m += share * (slopes[k][j] + part * (slopes[k + 1][j] - slopes[k][j]) - *m) + later[j];
            *d += follow * (*m - *d);
        }
        take(t, shown, &by);
    }
}
