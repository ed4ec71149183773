//! What the channels of a record would show.

use super::record::TransientRecord;
use crate::fuelling::coolant::Air;
use crate::fuelling::filling::FillingState;
use crate::fuelling::{Fuelling, Timing};

/// What the pressure channel would show.
pub(super) fn shown(r: &TransientRecord<'_>, f: &Fuelling) -> Vec<f64> {
    followed(r, f, |state, t| state.shown_kpa(r.speed_rpm[t], r.sample_time_s))
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

/// A value between samples, held at the ends.
fn between(v: &[f64], t: f64) -> f64 {
    let t = t.clamp(0.0, (v.len() - 1) as f64);
    let k = (t as usize).min(v.len() - 2);
    v[k] + (t - k as f64) * (v[k + 1] - v[k])
}

/// 1 / lambda as the sensor would show it, the pressure being what it is.
pub(super) fn richness(r: &TransientRecord<'_>, f: &Fuelling, pressure: &[f64]) -> Vec<f64> {
    let (n, dt, timing): (usize, f64, &Timing) = (r.speed_rpm.len(), r.sample_time_s, &f.timing);
    let air: Vec<Air<'_>> = (0..n).map(|t| f.air(r.coolant_c(t), r.cams_deg(t))).collect();
    let mut state = f.film_at(r.coolant_c(0)).at_rest(r.injection[0], r.speed_rpm[0]);
    let in_cylinder: Vec<f64> = (0..n)
        .map(|t| {
            let speed = r.speed_rpm[t];
            let fuel = f.film_at(r.coolant_c(t)).forward(&mut state, r.injection[t], speed, dt);
            let ahead = (timing.charge_s + timing.charge_cycles * 120.0 / speed) / dt;
            let met = t as f64 + ahead;
            // Known a sample after they were.
            let cams_deg = r.cams_deg.map(|cams| cams.map(|c| between(c, met - 1.0)));
            let air = Air { cams_deg, ..air[t] };
            fuel / air.at(between(r.speed_rpm, met), between(pressure, met))
        })
        .collect();
    let follow = -(-dt / timing.sensor_lag_s).exp_m1();
    let mut shown = in_cylinder[0];
    (0..n)
        .map(|t| {
            let delay_s = timing.delay_s(r.speed_rpm[t], air[t].flow(r.speed_rpm[t], pressure[t]));
            shown += follow * (between(&in_cylinder, t as f64 - delay_s / dt) - shown);
            shown
        })
        .collect()
}
