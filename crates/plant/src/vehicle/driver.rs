//! The driver: demanded speed to torque and brake.

use super::car::{Car, CarState};
use serde::{Deserialize, Serialize};

/// What the driver's feet ask for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Command {
    /// Engine torque \[Nm\].
    pub torque_nm: f64,
    /// Brake torque at the wheels \[Nm\], at least 0.
    pub brake_nm: f64,
}

/// A driver who knows the car: the torque of eq. (3.5) for the demanded acceleration, seen `preview_s` ahead, and a PI
/// correction of the speed error. Below `least_torque_nm` the brake takes the rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Driver {
    /// Acceleration per speed error \[1/s\].
    pub gain_per_s: f64,
    /// Integral time \[s\].
    pub integral_s: f64,
    /// How far ahead the cycle is seen \[s\]: about the delay of the engine.
    pub preview_s: f64,
    /// Least engine torque that is asked for \[Nm\].
    pub least_torque_nm: f64,
    /// Greatest engine torque that is asked for \[Nm\].
    pub most_torque_nm: f64,
    /// Integral of the correction \[m/s2\].
    #[serde(default)]
    correction_mps2: f64,
}

impl Driver {
    /// A driver for an engine between two torques \[Nm\].
    pub fn new(least_torque_nm: f64, most_torque_nm: f64) -> Self {
        Self {
            gain_per_s: 1.0,
            integral_s: 8.0,
            preview_s: 0.5,
            least_torque_nm,
            most_torque_nm,
            correction_mps2: 0.0,
        }
    }

    /// Torque and brake for the speed now demanded \[m/s\] and the acceleration demanded ahead \[m/s2\].
    pub fn command(
        &mut self,
        car: &Car,
        state: &CarState,
        demand_mps: f64,
        ahead_mps2: f64,
        dt_s: f64,
    ) -> Command {
        let error = demand_mps - state.speed_mps;
        let wanted = ahead_mps2 + self.gain_per_s * error + self.correction_mps2;
        let torque = car.torque_for(state, wanted);
        let command = if demand_mps < 0.1 && state.speed_mps < 0.3 {
            // Standing: the foot is on the brake.
            Command { torque_nm: 0.0, brake_nm: 500.0 }
        } else {
            // A slipping clutch brings no drag to the wheels: the brake has to do all of it.
            let least = if car.slips(state) { 0.0 } else { self.least_torque_nm };
            let engine = torque.clamp(least, self.most_torque_nm.max(least));
            Command { torque_nm: engine, brake_nm: ((engine - torque) * car.ratio(state.gear)).max(0.0) }
        };
        // At the engine's limit nobody presses harder (no wind-up).
        let limited = torque > self.most_torque_nm && error > 0.0;
        if demand_mps < 0.1 {
            self.correction_mps2 = 0.0;
        } else if !limited {
            self.correction_mps2 += dt_s * self.gain_per_s * error / self.integral_s;
        }
        command
    }
}
