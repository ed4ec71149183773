//! Crank-angle traces of one cylinder over one cycle.

use crate::engine::VirtualEngine;
use crate::error::PlantError;
use serde::{Deserialize, Serialize};

/// One cycle of one cylinder, firing top dead centre at 0 deg, from -360 to 360 deg.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CylinderTrace {
    /// Crank angle \[deg after firing TDC\].
    pub angle_deg: Vec<f64>,
    /// Volume \[m3\].
    pub volume_m3: Vec<f64>,
    /// Pressure \[Pa\].
    pub pressure_pa: Vec<f64>,
    /// Temperature \[K\].
    pub temperature_k: Vec<f64>,
    /// Gas in the cylinder \[kg\].
    pub mass_kg: Vec<f64>,
    /// Burned share of the fuel that burns in this cycle \[-\].
    pub burned: Vec<f64>,
}

impl CylinderTrace {
    /// Records the next whole cycle of cylinder `c` (0..3), one sample per degree at least a step apart.
    ///
    /// The engine moves on by one to two cycles.
    ///
    /// # Errors
    /// [`PlantError::Diverged`] for an unphysical state.
    ///
    /// ```
    /// use dynocal_plant::{engine::VirtualEngine, params::EngineParams, trace::CylinderTrace};
    /// let mut engine = VirtualEngine::new(&EngineParams::thesis())?;
    /// engine.advance_time(2.0);
    /// let t = CylinderTrace::record(&mut engine, 0)?;
    /// let peak = t.pressure_pa.iter().copied().fold(0.0, f64::max);
    /// assert!((1e-5 * peak - 1e-5 * engine.cycle_log()[0].peak_pa).abs() < 0.2);
    /// # Ok::<(), dynocal_plant::error::PlantError>(())
    /// ```
    pub fn record(engine: &mut VirtualEngine, c: usize) -> Result<Self, PlantError> {
        // The step is at most 2 deg, so that the start of a cycle at 360 deg is met within that.
        while !(360.0..362.0).contains(&engine.local_angle_deg(c)) {
            engine.advance_angle(1.0);
        }
        let mut out = Self::default();
        let mut before = f64::NEG_INFINITY;
        for _ in 0..=720 {
            let local = engine.local_angle_deg(c);
            // The second half of the first turn counts from the top dead centre ahead.
            let angle = if local >= 360.0 { local - 720.0 } else { local };
            if angle < before {
                break;
            }
            if angle > before {
                let gas = engine.gas_state(c);
                out.angle_deg.push(angle);
                out.volume_m3.push(gas.volume_m3);
                out.pressure_pa.push(gas.p_pa);
                out.temperature_k.push(gas.t_k);
                out.mass_kg.push(gas.mass_kg.iter().sum());
                out.burned.push(engine.state().cylinders[c % 4].wiebe.burned(angle));
            }
            before = angle;
            engine.advance_angle(1.0);
        }
        engine.check_state()?;
        Ok(out)
    }

    /// Apparent net heat release \[J/deg\] at each sample, dQ/dphi = g/(g-1) p dV/dphi + 1/(g-1) V dp/dphi with constant
    /// `gamma` (Heywood 9.27); 0 at both ends. Valid from intake closing to exhaust opening.
    ///
    /// ```
    /// use dynocal_plant::trace::CylinderTrace;
    /// // Isentropic: none. Pressure rises at constant volume: V dp/(g - 1).
    /// let v: Vec<f64> = (0..200).map(|k| 1e-4 * (1.0 + 0.001 * f64::from(k))).collect();
    /// let p = v.iter().map(|v| 1e5 * (v / 1e-4).powf(-1.3)).collect();
    /// let angle: Vec<f64> = (0..200).map(f64::from).collect();
    /// let t = CylinderTrace { angle_deg: angle.clone(), volume_m3: v, pressure_pa: p, ..CylinderTrace::default() };
    /// assert!(t.heat_release_j_deg(1.3).iter().all(|q| q.abs() < 1e-6));
    /// let p = angle.iter().map(|a| 1e5 + 100.0 * a).collect();
    /// let t = CylinderTrace { angle_deg: angle, volume_m3: vec![1e-4; 200], pressure_pa: p, ..CylinderTrace::default() };
    /// assert!((t.heat_release_j_deg(1.3)[100] - 1e-4 * 100.0 / 0.3).abs() < 1e-9);
    /// ```
    pub fn heat_release_j_deg(&self, gamma: f64) -> Vec<f64> {
        let (p, v, a) = (&self.pressure_pa, &self.volume_m3, &self.angle_deg);
        let inner = |k: usize| {
            let span = a[k + 1] - a[k - 1];
            let (dv, dp) = (v[k + 1] - v[k - 1], p[k + 1] - p[k - 1]);
            (gamma * p[k] * dv + v[k] * dp) / ((gamma - 1.0) * span)
        };
        (0..p.len()).map(|k| if k == 0 || k + 1 >= p.len() { 0.0 } else { inner(k) }).collect()
    }

    /// Work of the gas on the piston over the trace \[J\]: the integral of p dV by the trapezoidal rule.
    pub fn work_j(&self) -> f64 {
        let p = self.pressure_pa.windows(2).zip(self.volume_m3.windows(2));
        p.map(|(p, v)| 0.5 * (p[0] + p[1]) * (v[1] - v[0])).sum()
    }
}
