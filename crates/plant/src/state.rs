//! The state of the engine: plain numbers, cloned for snapshots.

use crate::combustion::Wiebe;
use crate::deviations::Variation;
use crate::dissociation::HeldEnergy;
use crate::emissions::EngineOut;
use crate::end_gas::EndGas;
use crate::film::Film;
use crate::gas::VOLUMES;
use crate::inputs::Inputs;
use serde::{Deserialize, Serialize};

/// Volume number of the charge pipe.
pub const PIPE: usize = 4;
/// Volume number of the intake manifold.
pub const INTAKE: usize = 5;
/// Volume number of the exhaust manifold.
pub const EXHAUST: usize = 6;
/// Volume number of the catalyst.
pub const CATALYST: usize = 7;

/// Contents of all gas volumes (0..3 cylinders, then the four manifolds).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gas {
    /// Masses of air, fuel vapour, products \[kg\].
    pub mass_kg: [[f64; VOLUMES]; 3],
    /// Sensible internal energy \[J\], 0 at 298.15 K.
    pub energy_j: [f64; VOLUMES],
    /// Liquid fuel in the cylinders \[kg\].
    pub liquid_kg: [f64; 4],
    /// Speed of the turbocharger's shaft \[rad/s\]; it is integrated with the gas.
    pub shaft_rad_s: f64,
}

/// What one cylinder remembers between events.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cylinder {
    /// Fuel still to be injected in this cycle \[kg\].
    pub to_inject_kg: f64,
    /// Fuel in the intake port (port injection).
    pub film: Film,
    /// Fuel that burns in this cycle \[kg\].
    pub burnable_kg: f64,
    /// Burn curve.
    pub wiebe: Wiebe,
    /// V_d T_r/(p_r V_r) at 615 deg \[m3 K/(Pa m3)\], for Woschni's combustion term.
    pub woschni_ref: f64,
    /// p_r V_r^1.32 at 615 deg, for the motored pressure.
    pub motored_ref: f64,
    /// Residual fraction at the spark latch \[-\].
    pub residual: f64,
    /// Lambda of the charge at the spark latch \[-\].
    pub lambda: f64,
    /// Share of cycles like this one that burn \[-\].
    pub stable: f64,
    /// Energy bound in CO and H2 per mass of burned fuel \[J/kg\].
    pub bound_j_kg: f64,
    /// Energy of dissociation of the charge.
    pub held: HeldEnergy,
    /// Unburned gas and burned zone.
    pub end_gas: EndGas,
    /// Trapped mass at the spark latch \[kg\].
    pub trapped_kg: f64,
    /// Running peak pressure \[Pa\] and its angle \[deg ATDC\].
    pub running_peak_pa: f64,
    /// Angle of the running peak \[deg ATDC\].
    pub running_peak_deg: f64,
    /// Gas after blow-down, at bottom dead centre \[K\].
    pub blown_down_k: f64,
    /// Work since the last mark \[J\].
    pub work_j: f64,
    /// Work of the last gas exchange \[J\].
    pub exchange_work_j: f64,
    /// Last complete cycle.
    pub last: CycleRecord,
    /// Variation of the gross work from cycle to cycle.
    #[serde(default)]
    pub variation: Variation,
}

/// Results of one complete cycle of one cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct CycleRecord {
    /// Peak pressure \[Pa\].
    pub peak_pa: f64,
    /// Angle of the peak \[deg ATDC\].
    pub peak_deg: f64,
    /// Gross work (540..180 deg over firing TDC) \[J\].
    pub gross_work_j: f64,
    /// Work of the gas exchange (180..540 deg) \[J\].
    pub exchange_work_j: f64,
    /// Residual fraction \[-\].
    pub residual: f64,
    /// Lambda of the charge \[-\].
    pub lambda: f64,
    /// Trapped mass \[kg\].
    pub trapped_kg: f64,
    /// Angles of 10, 50 and 90 % burned \[deg ATDC\] (of the burnable fuel).
    pub ca_deg: [f64; 3],
    /// Knock integral at 90 % burned \[-\]; 1 is the onset.
    pub knock: f64,
    /// Hottest burned zone \[K\].
    pub burned_k: f64,
    /// Engine-out emissions.
    pub emissions: EngineOut,
}

/// Sums over time since they were last cleared.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Sums {
    /// Time \[s\].
    pub time_s: f64,
    /// Integral of lambda \[s\].
    pub lambda_s: f64,
    /// Integral of the intake-manifold pressure \[Pa s\].
    pub map_pa_s: f64,
    /// Integral of the exhaust-manifold pressure \[Pa s\].
    pub exhaust_pa_s: f64,
    /// Air through the throttle \[kg\].
    pub air_kg: f64,
    /// Integral of the charge-pipe pressure \[Pa s\].
    pub pipe_pa_s: f64,
    /// Exhaust gas recirculated \[kg\].
    pub egr_kg: f64,
    /// Time in which the compressor surged \[s\].
    pub surge_s: f64,
    /// Gas out of the tailpipe \[kg\].
    pub exhaust_kg: f64,
    /// Integral of tailpipe flow times exhaust-manifold temperature \[kg K\].
    pub exhaust_kg_k: f64,
    /// Work of the gas on the pistons \[J\].
    pub work_j: f64,
    /// Heat to the walls of the cylinders \[J\].
    pub cylinder_heat_j: f64,
    /// Integral of the friction torque \[Nm s\].
    pub friction_nm_s: f64,
    /// Integral of the torque-sensor signal \[Nm s\].
    pub torque_nm_s: f64,
}

impl Sums {
    pub(crate) fn add(&mut self, o: &Self) {
        self.time_s += o.time_s;
        self.lambda_s += o.lambda_s;
        self.map_pa_s += o.map_pa_s;
        self.exhaust_pa_s += o.exhaust_pa_s;
        self.air_kg += o.air_kg;
        self.pipe_pa_s += o.pipe_pa_s;
        self.egr_kg += o.egr_kg;
        self.surge_s += o.surge_s;
        self.exhaust_kg += o.exhaust_kg;
        self.exhaust_kg_k += o.exhaust_kg_k;
        self.work_j += o.work_j;
        self.cylinder_heat_j += o.cylinder_heat_j;
        self.friction_nm_s += o.friction_nm_s;
        self.torque_nm_s += o.torque_nm_s;
    }
}

/// Balance sheet since the start: what crossed the border of the whole engine.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Ledger {
    /// Work done by the gas \[J\].
    pub work_j: f64,
    /// Heat to all walls \[J\].
    pub wall_heat_j: f64,
    /// Heat to the walls of the cylinders \[J\].
    pub cylinder_heat_j: f64,
    /// Heat from the exhaust manifold \[J\].
    pub exhaust_heat_j: f64,
    /// Fuel burned \[kg\].
    pub burned_kg: f64,
    /// Heat taken by evaporation \[J\].
    pub evaporation_j: f64,
    /// Enthalpy in minus out through throttle (with a turbocharger: compressor) and tailpipe \[J\].
    pub enthalpy_in_j: f64,
    /// Gas mass in minus out through throttle (with a turbocharger: compressor) and tailpipe \[kg\].
    pub mass_in_kg: f64,
    /// Fuel injected \[kg\].
    pub injected_kg: f64,
    /// Energy bound in CO and H2 on rich mixture \[J\].
    pub bound_j: f64,
    /// Work of the compressor on the gas \[J\].
    pub compressor_j: f64,
    /// Work of the gas on the turbine \[J\].
    pub turbine_j: f64,
}

/// Everything that changes while the engine runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EngineState {
    /// Gas contents.
    pub gas: Gas,
    /// Temperatures at the last evaluation \[K\] (warm start of the solver).
    pub t_k: [f64; VOLUMES],
    /// Temperatures one evaluation before \[K\].
    pub t_before_k: [f64; VOLUMES],
    /// Cylinder memories.
    pub cylinders: [Cylinder; 4],
    /// Inputs in force.
    pub inputs: Inputs,
    /// Simulated time \[s\].
    pub time_s: f64,
    /// Completed cycles.
    pub cycle: u64,
    /// Cell of the crank-angle grid.
    pub cell: usize,
    /// Index of the next event.
    pub next_event: usize,
    /// Angle asked for but not yet stepped \[deg\].
    pub remainder_deg: f64,
    /// Work of each cell of the last 720 deg \[J\].
    pub work_ring_j: Vec<f64>,
    /// Sum of the ring \[J\].
    pub work_sum_j: f64,
    /// Lagged torque-sensor signal \[Nm\].
    pub torque_sensor_nm: f64,
    /// Mean peak pressure of the last cycles \[Pa\].
    pub peak_mean_pa: f64,
    /// Sums since the interval was cleared.
    pub interval: Sums,
    /// Sums of the last four half turns (oldest overwritten) and of the running one.
    pub half_turns: [Sums; 4],
    /// Running half turn.
    pub running: Sums,
    /// Slot of `half_turns` to be written next.
    pub slot: usize,
    /// Balance sheet.
    pub ledger: Ledger,
}

/// Means of the last 720 deg that walls at rest follow from.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Means {
    /// Flow out of the tailpipe \[kg/s\]; 0 before the first half turn.
    pub(crate) exhaust_kg_s: f64,
    /// Heat to the walls of all cylinders \[W\]; none before the first half turn.
    pub(crate) cylinder_heat_w: Option<f64>,
}

impl EngineState {
    pub(crate) fn means(&self) -> Means {
        let sum = |of: fn(&Sums) -> f64| self.half_turns.iter().map(of).sum::<f64>();
        let time_s = sum(|h| h.time_s);
        if time_s <= 0.0 {
            return Means::default();
        }
        let heat = sum(|h| h.cylinder_heat_j) / time_s;
        Means { exhaust_kg_s: sum(|h| h.exhaust_kg) / time_s, cylinder_heat_w: Some(heat) }
    }
}
