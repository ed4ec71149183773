//! Filling of the manifold: its pressure from the throttle command, corrected slowly by what is measured.

use super::coolant::Air;
use dynocal_numerics::linalg::{LinalgError, least_squares};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Most of the logarithm of what leaves a manifold over what is expected, and of its change in a sample.
const MOST_BALANCE: f64 = 0.5;
const MOST_BALANCE_STEP: f64 = 0.02;
/// Terms of the polynomial of the throttle.
pub(super) const TERMS: usize = 4;
/// Ratio of specific heats of air.
const GAMMA: f64 = 1.4;
/// Steps of the integration in a sample.
const STEPS: usize = 4;
/// Least pressure, and least distance from that before the throttle, in kPa.
const LEAST_KPA: f64 = 5.0;
const LEAST_DROP_KPA: f64 = 0.05;
/// Longest cycle that the mean is taken over, in s.
const CYCLE_S: f64 = 0.3;

/// The manifold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filling {
    /// Pressure before the throttle in kPa: what it is where it is not measured, and what [`Filling::area`] is told at.
    pub upstream_kpa: f64,
    /// What the throttle angle is divided by, in deg.
    pub throttle_deg: f64,
    /// Coefficients of 1, x, x^2, x^3 of the scaled angle, in the unit of the injection per s.
    pub area: Vec<f64>,
    /// Pressure in kPa per unit of fuel that the charge in the manifold is worth.
    pub gain: f64,
    /// Time constant of the throttle in s.
    pub throttle_lag_s: f64,
    /// Greatest rate of the throttle in deg/s; none where the records show no limit.
    #[serde(default)]
    pub throttle_rate_deg_s: Option<f64>,
    /// Time constant of the pressure channel in s, beside its mean over a cycle; 0 or a sample where it was identified, as records do
    /// not tell more of it from the lag of the throttle.
    #[serde(default)]
    pub sensor_lag_s: f64,
    /// Correction by the measured pressure in 1/s.
    pub correction_per_s: f64,
}

/// Flow function of a nozzle at the pressure ratio `ratio`: constant where it is choked.
fn psi(ratio: f64) -> f64 {
    let critical = (2.0 / (GAMMA + 1.0)).powf(GAMMA / (GAMMA - 1.0));
    let r = ratio.clamp(critical, 1.0);
    (2.0 * GAMMA / (GAMMA - 1.0) * (r.powf(2.0 / GAMMA) - r.powf((GAMMA + 1.0) / GAMMA))).max(0.0).sqrt()
}

impl Filling {
    /// The throttle from steady points `(flow into the cylinder, pressure, throttle, pressure before it)`, where what flows in flows
    /// out.
    pub(super) fn of_rest(&self, points: &[[f64; 4]]) -> Result<Self, LinalgError> {
        let throttle_deg = points.iter().map(|p| p[2].abs()).fold(1e-9, f64::max);
        let mut out = Self { throttle_deg, area: vec![0.0; TERMS], ..self.clone() };
        let mut rows = Vec::with_capacity(points.len() * TERMS);
        for [flow, p, throttle, upstream] in points {
            let share = self.nozzle(*p, *upstream) / flow;
            rows.extend(out.terms(*throttle).map(|t| t * share));
        }
        out.area = least_squares(&rows, points.len(), TERMS, &vec![1.0; points.len()], 1e-9)?.x;
        Ok(out)
    }

    fn terms(&self, throttle_deg: f64) -> [f64; TERMS] {
        let x = throttle_deg / self.throttle_deg;
        [1.0, x, x * x, x * x * x]
    }

    /// What flows through the throttle at pressures behind and before it, in the unit of the injection per s and cylinder.
    pub fn inflow(&self, throttle_deg: f64, pressure_kpa: f64, upstream_kpa: f64) -> f64 {
        let area = dynocal_numerics::linalg::dot(&self.terms(throttle_deg), &self.area);
        area.max(0.0) * self.nozzle(pressure_kpa, upstream_kpa)
    }

    /// Flow of a nozzle over that which is choked at the pressure of the record: it goes with the pressure before it.
    fn nozzle(&self, pressure_kpa: f64, upstream_kpa: f64) -> f64 {
        upstream_kpa / self.upstream_kpa * psi(pressure_kpa / upstream_kpa)
    }

    /// The logarithm of what leaves over what throttle and charge say, after a sample in which the channel showed `error_kpa` more than was
    /// expected: the observer's second state, with the correction its two poles are together,
    ///
    /// ```text
    /// dp/dt = g (inflow - exp(w) flow) + l e,   dw/dt = -(l / 2)^2 e / (g flow)
    /// ```
    pub(super) fn balanced(&self, w: f64, error_kpa: f64, flow: f64, dt_s: f64) -> f64 {
        let step = (0.5 * self.correction_per_s).powi(2) * error_kpa * dt_s / (self.gain * flow).max(1e-9);
        let next = w - step.clamp(-MOST_BALANCE_STEP, MOST_BALANCE_STEP);
        if next.is_finite() { next.clamp(-MOST_BALANCE, MOST_BALANCE) } else { w }
    }

    /// Pressure and throttle `h_s` later.
    fn advance(
        &self,
        air: Air<'_>,
        (mut p, mut throttle): (f64, f64),
        (speed_rpm, command, upstream_kpa): (f64, f64, f64),
        h_s: f64,
    ) -> (f64, f64) {
        let h = h_s / STEPS as f64;
        let follow = -(-h / self.throttle_lag_s.max(1e-6)).exp_m1();
        let most = self.throttle_rate_deg_s.map_or(f64::INFINITY, |rate| rate * h);
        for _ in 0..STEPS {
            throttle += (follow * (command - throttle)).clamp(-most, most);
            let slope =
                |p: f64| self.gain * (self.inflow(throttle, p, upstream_kpa) - air.flow(speed_rpm, p));
            // Heun: the manifold is fast where the throttle is nearly wide open.
            let first = slope(p);
            p += 0.5 * h * (first + slope(p + h * first));
            p = p.clamp(LEAST_KPA, upstream_kpa.max(2.0 * LEAST_KPA) - LEAST_DROP_KPA);
        }
        (p, throttle)
    }
}

/// What the filling knows at a sample.
#[derive(Clone, Debug)]
pub struct FillingState {
    /// Pressure in kPa.
    pressure_kpa: f64,
    /// Throttle behind its lag in deg.
    throttle_deg: f64,
    /// Pressures of the samples before, newest first.
    past: VecDeque<f64>,
    /// What the channel shows.
    shown_kpa: f64,
}

impl FillingState {
    /// At rest at a measured pressure and a throttle command; samples are `dt_s` apart.
    pub fn at_rest(pressure_kpa: f64, throttle_deg: f64, dt_s: f64) -> Self {
        let samples = (CYCLE_S / dt_s).ceil().max(1.0) as usize + 1;
        Self {
            pressure_kpa,
            throttle_deg,
            past: std::iter::repeat_n(pressure_kpa, samples).collect(),
            shown_kpa: pressure_kpa,
        }
    }

    /// Pressure now in kPa.
    pub fn pressure_kpa(&self) -> f64 {
        self.pressure_kpa
    }

    /// What a channel shows that is a mean over a cycle, behind its lag.
    pub fn shown_kpa(&self) -> f64 {
        self.shown_kpa
    }

    /// Mean over the last cycle of what goes in straight lines from sample to sample.
    fn cycle_kpa(&self, speed_rpm: f64, dt_s: f64) -> f64 {
        let samples = (120.0 / speed_rpm / dt_s).min((self.past.len() - 1) as f64);
        let (whole, part) = (samples as usize, samples.fract());
        let at = |k: usize| self.past[k.min(self.past.len() - 1)];
        let whole_sum: f64 = (0..whole).map(|k| 0.5 * (at(k) + at(k + 1))).sum();
        let last = at(whole) + 0.5 * part * (at(whole + 1) - at(whole));
        (whole_sum + part * last) / samples
    }

    /// One sample on: `measured_kpa` is what the channel shows at its beginning, `command_deg` and `upstream_kpa` hold during it.
    pub fn step(
        &mut self,
        filling: &Filling,
        air: Air<'_>,
        (speed_rpm, command_deg, upstream_kpa): (f64, f64, f64),
        measured_kpa: f64,
        dt_s: f64,
    ) {
        let error = measured_kpa - self.shown_kpa;
        let corrected = self.pressure_kpa + filling.correction_per_s * dt_s * error;
        let from = (corrected, self.throttle_deg);
        let held = (speed_rpm, command_deg, upstream_kpa);
        (self.pressure_kpa, self.throttle_deg) = filling.advance(air, from, held, dt_s);
        self.past.pop_back();
        self.past.push_front(self.pressure_kpa);
        let follow = -(-dt_s / filling.sensor_lag_s.max(1e-9)).exp_m1();
        self.shown_kpa += follow * (self.cycle_kpa(speed_rpm, dt_s) - self.shown_kpa);
    }

    /// Pressure `ahead_s` from now, the command being held, speed and pressure before the throttle going on as they go
    /// (`[rpm, rpm/s]`, `[kPa, kPa/s]`).
    pub fn ahead(
        &self,
        filling: &Filling,
        air: Air<'_>,
        speed_rpm: [f64; 2],
        command_deg: f64,
        upstream_kpa: [f64; 2],
        ahead_s: f64,
        dt_s: f64,
    ) -> f64 {
        let (mut at, mut left) = ((self.pressure_kpa, self.throttle_deg), ahead_s);
        while left > 1e-12 {
            let h = left.min(dt_s);
            let then = |[value, slope]: [f64; 2]| value + slope * (ahead_s - left + 0.5 * h);
            at = filling.advance(air, at, (then(speed_rpm), command_deg, then(upstream_kpa)), h);
            left -= h;
        }
        at.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of what goes in a straight line the mean over a cycle is what was half a cycle ago, also where a cycle is no whole number of samples.
    #[test]
    fn a_channel_shows_the_mean_over_a_cycle() {
        let mut state = FillingState::at_rest(0.0, 10.0, 0.01);
        for (k, p) in state.past.iter_mut().enumerate() {
            *p = 60.0 - k as f64;
        }
        for speed_rpm in [700.0, 1537.0, 2000.0, 2890.0, 11000.0] {
            let samples = 120.0 / speed_rpm / 0.01;
            let shown = state.cycle_kpa(speed_rpm, 0.01);
            assert!((shown - (60.0 - 0.5 * samples)).abs() < 1e-9, "{speed_rpm} rpm: {shown}");
        }
        // The longest cycle, coarse samples, and samples that are longer than it: what is there.
        assert!((state.cycle_kpa(400.0, 0.01) - 45.0).abs() < 1e-9);
        let coarse = |dt_s| FillingState::at_rest(40.0, 10.0, dt_s).cycle_kpa(420.0, dt_s);
        assert_eq!([coarse(0.05), coarse(0.4)], [40.0; 2]);
    }
}
