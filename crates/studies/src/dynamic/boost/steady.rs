//! What all controllers share: steady points of the engine over torque and speed, held as a controller of a bed holds them.

use dynocal_calib::fuelling::SteadyPoint;
use dynocal_plant::cams::CamSchedule;
use dynocal_plant::full_load::{LoadLimits, load_map};
use dynocal_plant::params::EngineParams;

/// Knock that the steady map leaves room to: cycles scatter.
const KNOCK: f64 = 0.85;
/// Least rise of torque (Nm) and pressure (kPa) from point to point.
const RISE: f64 = 0.2;

/// A steady point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    /// Torque in Nm, fuel at lambda 1 in mg, spark in deg, throttle in deg, wastegate in mm, manifold pressure, pressure before the
    /// throttle in kPa.
    values: [f64; 7],
}

/// Steady points by speed, torque rising.
#[derive(Clone, Debug)]
pub(super) struct Steady {
    speed_rpm: Vec<f64>,
    rows: Vec<Vec<Held>>,
    cams: CamSchedule,
    /// Bed time in s.
    pub(super) time_s: f64,
}

/// Quantities of a point.
#[derive(Clone, Copy, Debug)]
pub(super) enum Of {
    Torque,
    Fuel,
    Spark,
    Throttle,
    Wastegate,
    Map,
    Boost,
}

impl Steady {
    pub(super) fn measured(parameters: &str, speed_rpm: &[f64], torque_nm: &[f64]) -> Result<Self, String> {
        let params = EngineParams::named(parameters).map_err(|e| e.to_string())?;
        let cams = params.cams.clone().ok_or("the engine has no schedule of its cams")?;
        let limits = LoadLimits { knock: KNOCK, ..LoadLimits::default() };
        let map = load_map(&params, speed_rpm, torque_nm, limits).map_err(|e| e.to_string())?;
        let (mut rows, mut time_s) = (Vec::new(), 0.0);
        for row in map {
            let mut held = Vec::new();
            for point in row {
                let p = point.map_err(|e| e.to_string())?;
                time_s += p.time_s;
                let (u, y) = (&p.inputs, &p.outputs);
                let values = [
                    y.torque_cycle_nm,
                    u.injection_mg * p.lambda,
                    u.spark_deg,
                    u.throttle_deg,
                    u.wastegate_mm,
                    y.map_kpa,
                    y.boost_kpa,
                ];
                // A point at a limit does not go beyond the one before: tables over torque and pressure have to rise.
                let rises = |h: &Held| {
                    [Of::Torque, Of::Map]
                        .iter()
                        .all(|of| values[*of as usize] > h.values[*of as usize] + RISE)
                };
                if held.last().is_none_or(rises) {
                    held.push(Held { values });
                }
            }
            if held.len() < 2 {
                return Err("the engine holds fewer than two torques at a speed".into());
            }
            rows.push(held);
        }
        Ok(Self { speed_rpm: speed_rpm.to_vec(), rows, cams, time_s })
    }

    /// `of` a point at a speed where `by` has the value `at`; held at the ends.
    pub(super) fn at(&self, of: Of, by: Of, at: f64, speed_rpm: f64) -> f64 {
        let row = |row: &[Held]| {
            let key = |h: &Held| h.values[by as usize];
            let k = row.partition_point(|h| key(h) <= at).clamp(1, row.len() - 1);
            let share =
                ((at - key(&row[k - 1])) / (key(&row[k]) - key(&row[k - 1])).max(1e-9)).clamp(0.0, 1.0);
            let value = |k: usize| row[k].values[of as usize];
            value(k - 1) + share * (value(k) - value(k - 1))
        };
        let n = &self.speed_rpm;
        if n.len() == 1 {
            return row(&self.rows[0]);
        }
        let k = n.partition_point(|v| *v <= speed_rpm).clamp(1, n.len() - 1);
        let share = ((speed_rpm - n[k - 1]) / (n[k] - n[k - 1])).clamp(0.0, 1.0);
        (1.0 - share) * row(&self.rows[k - 1]) + share * row(&self.rows[k])
    }

    /// The points as they are identified from, with the coolant at a temperature in degC.
    pub(super) fn points(&self, coolant_c: f64) -> Vec<SteadyPoint> {
        let mut out = Vec::new();
        for (speed_rpm, row) in self.speed_rpm.iter().zip(&self.rows) {
            let of = |held: &Held| {
                let [_, fuel, _, throttle_deg, _, map_kpa, upstream_kpa] = held.values;
                let cams_deg = Some(self.cams_deg(*speed_rpm, map_kpa));
                SteadyPoint {
                    speed_rpm: *speed_rpm,
                    map_kpa,
                    throttle_deg,
                    fuel,
                    coolant_c,
                    upstream_kpa,
                    cams_deg,
                }
            };
            out.extend(row.iter().map(of));
        }
        out
    }

    /// Least and greatest place of intake and exhaust cam over the points, in deg.
    pub(super) fn cam_ranges_deg(&self) -> [[f64; 2]; 2] {
        let mut out = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for (n, row) in self.speed_rpm.iter().zip(&self.rows) {
            for held in row {
                let cams = self.cams_deg(*n, held.values[Of::Map as usize]);
                out.iter_mut().zip(cams).for_each(|(r, c)| *r = [r[0].min(c), r[1].max(c)]);
            }
        }
        out
    }

    /// Cams of the load schedule.
    pub(super) fn cams_deg(&self, speed_rpm: f64, map_kpa: f64) -> [f64; 2] {
        self.cams.at(speed_rpm, map_kpa).into()
    }
}
