//! The car: inertia, resistance, gears, clutch.

use crate::error::PlantError;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

const LBF_N: f64 = 4.448_221_615_260_5;
const MPH_MPS: f64 = 0.447_04;

/// Units of the coefficients A, B, C of (3.2), which Table 3.3 of the thesis leaves open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadUnits {
    /// lbf, lbf/mph, lbf/mph2: the reading under which 100 Nm gives 0 to 50 mph in the thesis' 20 s.
    LbfMph,
    /// N, N s/m, N s2/m2.
    NewtonMps,
    /// N, N h/km, N h2/km2.
    NewtonKmh,
}

/// Resistance `F_r = a + b v + c v^2`, eq. (3.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoadLoad {
    /// Units of the three coefficients.
    pub units: LoadUnits,
    /// Constant part.
    pub a: f64,
    /// Linear part.
    pub b: f64,
    /// Quadratic part.
    pub c: f64,
}

impl RoadLoad {
    /// Coefficients in N, N s/m, N s2/m2.
    pub fn si(&self) -> [f64; 3] {
        let (force, speed) = match self.units {
            LoadUnits::LbfMph => (LBF_N, MPH_MPS),
            LoadUnits::NewtonMps => (1.0, 1.0),
            LoadUnits::NewtonKmh => (1.0, 1.0 / 3.6),
        };
        [self.a * force, self.b * force / speed, self.c * force / (speed * speed)]
    }

    /// Resistance \[N\] at `speed_mps` >= 0.
    pub fn force_n(&self, speed_mps: f64) -> f64 {
        let [a, b, c] = self.si();
        a + speed_mps * (b + speed_mps * c)
    }
}

/// A car with manual ratios and gears chosen by its speed (thesis Table 3.3 and Figure 3.10).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Car {
    /// Mass \[kg\]; acts through a slope only, inertia is `inertia_kg_m2`.
    pub mass_kg: f64,
    /// Tyre radius R \[m\].
    pub tyre_radius_m: f64,
    /// Inertia J of car and driveline at the wheel \[kg m2\].
    pub inertia_kg_m2: f64,
    /// Resistance.
    pub road_load: RoadLoad,
    /// Basic gear G_b.
    pub final_drive: f64,
    /// Gear ratios G, first gear first.
    pub gears: Vec<f64>,
    /// Speeds at which the next gear is taken \[m/s\], one fewer than gears.
    pub shift_up_mps: Vec<f64>,
    /// How far the speed must fall below a shift speed before the gear is given back \[m/s\].
    pub hysteresis_mps: f64,
    /// Least engine speed \[rpm\]: below it the clutch slips and transmits the engine's torque.
    pub launch_rpm: f64,
    /// Slope of the road \[-\], positive uphill.
    pub grade: f64,
}

/// What moves in a car.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CarState {
    /// Speed \[m/s\].
    pub speed_mps: f64,
    /// Gear, 0 for the first.
    pub gear: usize,
    /// Distance \[m\].
    pub distance_m: f64,
}

impl Car {
    /// The car of thesis Table 3.3, shifting at 10, 20, 30 and 40 mph, launched at 800 rpm.
    pub fn thesis() -> Self {
        Self {
            mass_kg: 1200.0,
            tyre_radius_m: 0.3,
            inertia_kg_m2: 108.0,
            road_load: RoadLoad { units: LoadUnits::LbfMph, a: 34.7, b: 0.289, c: 0.01705 },
            final_drive: 4.06,
            gears: vec![3.417, 2.136, 1.448, 1.028, 0.767],
            shift_up_mps: [10.0, 20.0, 30.0, 40.0].map(|v| v * MPH_MPS).to_vec(),
            hysteresis_mps: 2.0 * MPH_MPS,
            launch_rpm: 800.0,
            grade: 0.0,
        }
    }

    /// Refuses what no car has.
    ///
    /// # Errors
    /// [`PlantError::Parameter`] naming the first value that is out of range.
    pub fn check(&self) -> Result<(), PlantError> {
        let rows = [
            ("car.mass_kg", self.mass_kg),
            ("car.tyre_radius_m", self.tyre_radius_m),
            ("car.inertia_kg_m2", self.inertia_kg_m2),
            ("car.final_drive", self.final_drive),
            ("car.launch_rpm", self.launch_rpm),
            ("car.gears", self.gears.iter().copied().fold(f64::INFINITY, f64::min)),
        ];
        for (name, found) in rows {
            if !(found.is_finite() && found > 0.0) {
                return Err(PlantError::Parameter { name, found, expected: "a positive number" });
            }
        }
        let ascending = self.shift_up_mps.windows(2).all(|w| w[0] < w[1]);
        if self.shift_up_mps.len() + 1 != self.gears.len() || !ascending {
            let found = self.shift_up_mps.len() as f64;
            let expected = "ascending speeds, one fewer than gears";
            return Err(PlantError::Parameter { name: "car.shift_up_mps", found, expected });
        }
        Ok(())
    }

    /// The car at rest in first gear.
    pub fn at_rest(&self) -> CarState {
        CarState { speed_mps: 0.0, gear: 0, distance_m: 0.0 }
    }

    /// Total ratio G_b G of a gear.
    pub fn ratio(&self, gear: usize) -> f64 {
        self.final_drive * self.gears[gear.min(self.gears.len() - 1)]
    }

    /// Engine speed \[rpm\]: that of the wheels through the gear, at least the launch speed.
    pub fn engine_rpm(&self, state: &CarState) -> f64 {
        let wheel = state.speed_mps / self.tyre_radius_m;
        (wheel * self.ratio(state.gear) * 30.0 / PI).max(self.launch_rpm)
    }

    /// Whether the clutch slips.
    pub fn slips(&self, state: &CarState) -> bool {
        self.engine_rpm(state) <= self.launch_rpm
    }

    /// Gear for a speed: up at the shift speeds, down only below the hysteresis.
    pub fn gear_for(&self, speed_mps: f64, gear: usize) -> usize {
        let mut gear = gear.min(self.gears.len() - 1);
        while gear < self.shift_up_mps.len() && speed_mps >= self.shift_up_mps[gear] {
            gear += 1;
        }
        while gear > 0 && speed_mps < self.shift_up_mps[gear - 1] - self.hysteresis_mps {
            gear -= 1;
        }
        gear
    }

    /// Resistance and slope at a speed \[N\].
    pub fn resistance_n(&self, speed_mps: f64) -> f64 {
        const G_MPS2: f64 = 9.806_65;
        let slope = self.mass_kg * G_MPS2 * self.grade / (1.0 + self.grade * self.grade).sqrt();
        self.road_load.force_n(speed_mps) + slope
    }

    /// Acceleration \[m/s2\] from eq. (3.5).
    fn acceleration(&self, speed_mps: f64, wheel_nm: f64) -> f64 {
        let r = self.tyre_radius_m;
        (wheel_nm - self.resistance_n(speed_mps) * r) * r / self.inertia_kg_m2
    }

    /// Engine torque \[Nm\] that gives an acceleration \[m/s2\] in the present gear (eq. 3.5 solved for T_e).
    pub fn torque_for(&self, state: &CarState, acceleration_mps2: f64) -> f64 {
        let r = self.tyre_radius_m;
        let wheel = self.inertia_kg_m2 * acceleration_mps2 / r + self.resistance_n(state.speed_mps) * r;
        wheel / self.ratio(state.gear)
    }

    /// One step of eq. (3.5) by the midpoint rule, then the gear. A car does not roll backwards: resistance and brake
    /// hold it at rest.
    pub fn step(&self, state: &mut CarState, engine_nm: f64, brake_nm: f64, dt_s: f64) {
        let wheel = engine_nm * self.ratio(state.gear) - brake_nm;
        let v = state.speed_mps;
        let middle = (v + 0.5 * dt_s * self.acceleration(v, wheel)).max(0.0);
        let next = (v + dt_s * self.acceleration(middle, wheel)).max(0.0);
        state.distance_m += 0.5 * dt_s * (v + next);
        state.speed_mps = next;
        state.gear = self.gear_for(next, state.gear);
    }
}
