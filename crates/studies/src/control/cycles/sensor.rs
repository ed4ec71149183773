//! The lambda sensor of the drives: gas of a cycle after a transport that goes with one over the flow, through a lag.

use std::collections::VecDeque;

use super::STEP_S;

/// Transport of the gas: volume as mass in g, and a constant part in s; lag of the sensor in s.
const TRANSPORT: (f64, f64) = (0.9, 0.05);
const SENSOR_S: f64 = 0.06;
/// Longest transport in steps.
pub(super) const LONGEST: usize = 100;
/// Lags of the sensor after which it shows nothing of gas without fuel any more: less than 1 % of it.
const LAGS: f64 = 5.0;
/// Cycles after one without fuel whose gas tells nothing of the mixture: residual gas is air, and half of it goes in each.
const CLEAN_CYCLES: f64 = 10.0;
/// Lambda that is shown of gas without fuel.
const UNFUELLED: f64 = 3.0;

/// Lambda on its way, latest last, and what the sensor shows.
pub(super) struct LambdaSensor {
    line: VecDeque<(f64, bool)>,
    shown: f64,
    /// Time for which it shows gas without fuel still.
    blind_s: f64,
    /// Cycles since the last one without fuel.
    cycles: f64,
}

/// Transport in s at a flow of air in g/s.
pub(super) fn transport_s(air_g_s: f64) -> f64 {
    TRANSPORT.1 + TRANSPORT.0 / air_g_s.max(1.0)
}

impl LambdaSensor {
    pub(super) fn at_rest() -> Self {
        Self { line: VecDeque::with_capacity(LONGEST + 2), shown: 1.0, blind_s: 0.0, cycles: CLEAN_CYCLES }
    }

    /// A step at a speed with gas of `lambda`, if it was fuelled; gives the lambda of the gas.
    pub(super) fn pass(&mut self, lambda: Option<f64>, air_g_s: f64, speed_rpm: f64) -> f64 {
        let gas = lambda.map_or(UNFUELLED, |l| l.clamp(0.5, UNFUELLED));
        self.cycles = if lambda.is_some() { self.cycles + STEP_S * speed_rpm / 120.0 } else { 0.0 };
        self.line.push_back((gas, self.cycles >= CLEAN_CYCLES));
        let delay = (transport_s(air_g_s) / STEP_S) as usize;
        while self.line.len() > delay.min(LONGEST) + 1 {
            self.line.pop_front();
        }
        let (seen, fuelled) = self.line.front().copied().unwrap_or((1.0, true));
        self.shown += -(-STEP_S / SENSOR_S).exp_m1() * (seen - self.shown);
        self.blind_s = if fuelled { (self.blind_s - STEP_S).max(0.0) } else { LAGS * SENSOR_S };
        gas
    }

    /// What it shows, whatever the gas was.
    pub(super) fn shown(&self) -> f64 {
        self.shown
    }

    /// What it shows of fuelled gas; none while there is gas of a cut or of the cycles after it in it, as an ECU knows of its own cuts.
    pub(super) fn lambda(&self) -> Option<f64> {
        (self.blind_s <= 0.0).then_some(self.shown)
    }
}
