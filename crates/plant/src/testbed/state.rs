//! Everything that moves on a bed, beside the engine.

use super::catalyst::CatalystState;
use super::dynamics::Lag;
use super::dynamometer::DynoState;
use super::guard::GuardState;
use super::idle::IdleState;
use super::sensor::SensorState;
use super::thermal::ThermalState;

/// State of a bed.
#[derive(Debug, Clone, PartialEq)]
pub struct BedState {
    /// Time since the reset \[s\].
    pub time_s: f64,
    /// Seed of noise and scatter.
    pub seed: u64,
    /// Samples read.
    pub samples: u64,
    /// Dynamometer.
    pub dyno: DynoState,
    /// Throttle behind its actuator \[deg\].
    pub throttle: Lag,
    /// Wastegate behind its actuator \[mm\].
    pub wastegate: Lag,
    /// Air-bleed valve behind its actuator \[-\].
    pub bleed: Lag,
    /// Opening points of the cams that follow a schedule, intake and exhaust \[deg\].
    pub cams: [Lag; 2],
    /// Integrals of the torque loop \[deg\] and of the lambda loop \[mg\].
    pub integrals: [f64; 2],
    /// One for each output.
    pub sensors: Vec<SensorState>,
    /// What was read last: one for each output.
    pub shown: Vec<f64>,
    /// One for each limit.
    pub guards: Vec<GuardState>,
    /// Inputs that are saturated now.
    pub saturated: Vec<bool>,
    /// Time since fuel has returned \[s\].
    pub fuelled_s: f64,
    /// Fuel cut-off and idle control.
    pub idle: IdleState,
    /// Warm-up, when on.
    pub thermal: Option<ThermalState>,
    /// Catalyst, when on.
    pub catalyst: Option<CatalystState>,
}

impl BedState {
    /// Visits every number in a fixed order; counters and halves of the seed travel as exact f64.
    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        f(&mut self.time_s);
        let mut halves = [(self.seed >> 32) as f64, (self.seed & 0xffff_ffff) as f64, self.samples as f64];
        halves.iter_mut().for_each(&mut *f);
        self.seed = ((halves[0] as u64) << 32) | halves[1] as u64;
        self.samples = halves[2] as u64;
        self.dyno.visit(f);
        [&mut self.throttle.value, &mut self.wastegate.value, &mut self.bleed.value]
            .into_iter()
            .for_each(&mut *f);
        self.cams.iter_mut().for_each(|c| f(&mut c.value));
        self.integrals.iter_mut().for_each(&mut *f);
        self.sensors.iter_mut().for_each(|s| s.visit(f));
        self.shown.iter_mut().for_each(&mut *f);
        self.guards.iter_mut().for_each(|g| g.visit(f));
        for flag in &mut self.saturated {
            let mut x = f64::from(u8::from(*flag));
            f(&mut x);
            *flag = x != 0.0;
        }
        f(&mut self.fuelled_s);
        self.idle.visit(f);
        if let Some(t) = &mut self.thermal {
            t.visit(f);
        }
        if let Some(c) = &mut self.catalyst {
            c.visit(f);
        }
    }
}
