//! The dynamometer: imposes speed at once, controls the speed of a rotor with inertia, or imposes a load.
//!
//! The rotor obeys J dw/dt = T - T_load with the inertia J of engine and rotor. Each tick the engine turns at the speed
//! that the middle of the tick is expected to have, and the kinetic energy takes up what work is left:
//! J w'^2/2 = J w^2/2 + W_engine - T_load angle. Power is thus balanced to rounding, and a constant torque gives the
//! exact straight line.

use super::dynamics::PiGains;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// What the dynamometer imposes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DynoMode {
    /// The demanded speed at once, whatever the torque (thesis 3.6).
    #[default]
    Speed,
    /// The demanded speed by a PI controller on the load of a rotor with inertia.
    InertialSpeed,
    /// A load torque; speed follows from the balance of torques.
    Load,
}

/// Settings of the dynamometer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DynoSettings {
    /// What is imposed.
    pub mode: DynoMode,
    /// Inertia of crank train and flywheel \[kg m2\].
    pub engine_kg_m2: f64,
    /// Inertia of rotor and shaft \[kg m2\].
    pub rotor_kg_m2: f64,
    /// Speed controller: load \[Nm\] per error \[rad/s\], and per second.
    pub gains: PiGains,
    /// Greatest load, braking or driving \[Nm\].
    pub torque_limit_nm: f64,
    /// The rotor is held at this least speed \[rpm\]...
    pub least_rpm: f64,
    /// ...and at this greatest.
    pub most_rpm: f64,
}

impl Default for DynoSettings {
    /// Ideal speed; inertias of a 2 l engine and of a low-inertia machine, controller with 3 Hz and damping 0.8.
    fn default() -> Self {
        Self {
            mode: DynoMode::Speed,
            engine_kg_m2: 0.15,
            rotor_kg_m2: 0.15,
            gains: PiGains { proportional: 9.0, integral: 107.0 },
            torque_limit_nm: 500.0,
            least_rpm: 600.0,
            most_rpm: 6500.0,
        }
    }
}

/// What moves, and the account of work since the start.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct DynoState {
    /// Speed w \[rad/s\].
    pub omega: f64,
    /// Acceleration of the last tick \[rad/s2\].
    pub acceleration: f64,
    /// Load of the last tick \[Nm\].
    pub load_nm: f64,
    /// Integral part of the speed controller \[Nm\].
    pub integral_nm: f64,
    /// Work of the engine on the shaft \[J\].
    pub engine_j: f64,
    /// Work taken by the load \[J\].
    pub load_j: f64,
    /// Work given to hold the rotor at its least or greatest speed \[J\].
    pub held_j: f64,
}

/// Speed and load of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DynoTick {
    /// Speed at which the engine turns \[rad/s\].
    pub omega: f64,
    /// Load \[Nm\].
    pub load_nm: f64,
}

const RAD_S: f64 = PI / 30.0;

impl DynoSettings {
    /// Inertia J of engine and rotor \[kg m2\].
    pub fn inertia_kg_m2(&self) -> f64 {
        self.engine_kg_m2 + self.rotor_kg_m2
    }

    /// Turning at `speed_rpm` under `load_nm`.
    pub fn at(&self, speed_rpm: f64, load_nm: f64) -> DynoState {
        DynoState { omega: speed_rpm * RAD_S, load_nm, integral_nm: load_nm, ..DynoState::default() }
    }

    /// Begins a tick of `h_s`. `demand` is the demanded speed \[rpm\], or the load \[Nm\] in load mode.
    pub fn begin(&self, state: &mut DynoState, demand: f64, h_s: f64) -> DynoTick {
        let (least, most) = (self.least_rpm * RAD_S, self.most_rpm * RAD_S);
        if self.mode == DynoMode::Speed {
            state.omega = demand * RAD_S;
            return DynoTick { omega: state.omega, load_nm: state.load_nm };
        }
        let omega = (state.omega + 0.5 * h_s * state.acceleration).clamp(least, most);
        let limit = self.torque_limit_nm;
        let load_nm = match self.mode {
            DynoMode::InertialSpeed => {
                let error = omega - demand * RAD_S;
                self.gains.step(&mut state.integral_nm, error, (-limit, limit), h_s)
            }
            _ => demand.clamp(-limit, limit),
        };
        DynoTick { omega, load_nm }
    }

    /// Ends the tick in which the engine turned for `time_s` and did `work_j` on the shaft. Returns whether the rotor
    /// had to be held at a speed limit.
    pub fn end(&self, state: &mut DynoState, tick: DynoTick, work_j: f64, time_s: f64) -> bool {
        state.engine_j += work_j;
        if time_s <= 0.0 {
            return false;
        }
        if self.mode == DynoMode::Speed {
            // The machine takes whatever the engine gives.
            state.load_j += work_j;
            state.load_nm = work_j / (tick.omega * time_s);
            return false;
        }
        let load_j = tick.load_nm * tick.omega * time_s;
        state.load_j += load_j;
        state.load_nm = tick.load_nm;
        let half_j = 0.5 * self.inertia_kg_m2();
        let before = state.omega;
        let energy = half_j * before * before + work_j - load_j;
        let free = (energy.max(0.0) / half_j).sqrt();
        let omega = free.clamp(self.least_rpm * RAD_S, self.most_rpm * RAD_S);
        let held = omega != free;
        if held {
            state.held_j += half_j * omega * omega - energy;
        }
        state.acceleration = if held { 0.0 } else { (omega - before) / time_s };
        state.omega = omega;
        held
    }
}

impl DynoState {
    /// Speed \[rpm\].
    pub fn speed_rpm(&self) -> f64 {
        self.omega / RAD_S
    }

    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        [&mut self.omega, &mut self.acceleration, &mut self.load_nm, &mut self.integral_nm]
            .into_iter()
            .for_each(&mut *f);
        [&mut self.engine_j, &mut self.load_j, &mut self.held_j].into_iter().for_each(&mut *f);
    }
}
