//! State of a new engine.

use crate::combustion::Wiebe;
use crate::deviations::Variation;
use crate::dissociation::HeldEnergy;
use crate::end_gas::EndGas;
use crate::film::Film;
use crate::gas::VOLUMES;
use crate::grid::Grid;
use crate::inputs::Inputs;
use crate::params::EngineParams;
use crate::state::{CATALYST, CycleRecord, Cylinder, EXHAUST, EngineState, Gas, INTAKE, Ledger, PIPE, Sums};

/// Cylinders and intake filled with air at half an atmosphere, exhaust with hot products.
pub(crate) fn initial_state(p: &EngineParams, grid: &Grid, inputs: Inputs) -> EngineState {
    let cylinder = Cylinder {
        to_inject_kg: 0.0,
        film: Film::default(),
        burnable_kg: 0.0,
        wiebe: Wiebe::new(0.0, p.burn.duration_deg, inputs.wiebe_m),
        woschni_ref: 0.0,
        motored_ref: 0.0,
        residual: 0.0,
        lambda: 9.99,
        stable: 1.0,
        bound_j_kg: 0.0,
        held: HeldEnergy::default(),
        end_gas: EndGas::default(),
        trapped_kg: 0.0,
        running_peak_pa: 0.0,
        running_peak_deg: 0.0,
        // Of a fired cycle, until there has been one.
        blown_down_k: 1150.0,
        work_j: 0.0,
        exchange_work_j: 0.0,
        last: CycleRecord { peak_pa: 10e5, ..CycleRecord::default() },
        variation: Variation::default(),
    };
    let nodes = grid.local_nodes(0);
    let mut state = EngineState {
        gas: Gas {
            mass_kg: [[0.0; VOLUMES]; 3],
            energy_j: [0.0; VOLUMES],
            liquid_kg: [0.0; 4],
            shaft_rad_s: p.turbocharger.map_or(0.0, |t| t.least_rad_s),
        },
        t_k: [300.0; VOLUMES],
        t_before_k: [300.0; VOLUMES],
        cylinders: [cylinder.clone(), cylinder.clone(), cylinder.clone(), cylinder],
        inputs,
        time_s: 0.0,
        cycle: 0,
        cell: 0,
        next_event: 0,
        remainder_deg: 0.0,
        work_ring_j: vec![0.0; grid.cells],
        work_sum_j: 0.0,
        torque_sensor_nm: 0.0,
        peak_mean_pa: 10e5,
        interval: Sums::default(),
        half_turns: [Sums::default(); 4],
        running: Sums::default(),
        slot: 0,
        ledger: Ledger::default(),
    };
    let (pa, ta) = (p.ambient.pressure_pa, p.ambient.temperature_k);
    let fill = |p_pa: f64, volume_m3: f64, species: usize, t_k: f64| {
        let mut m = [0.0; 3];
        m[species] = p_pa * volume_m3 / (p.gas.r_j_kg_k[species] * t_k);
        m
    };
    for (c, node) in nodes.iter().enumerate() {
        let m = fill(0.5 * pa, grid.nodes[*node].volume_m3, 0, 350.0);
        set_volume(&mut state, p, c, m, 350.0);
    }
    set_volume(&mut state, p, PIPE, fill(pa, p.charge_pipe_m3, 0, ta), ta);
    let intake = &p.intake_manifold;
    set_volume(&mut state, p, INTAKE, fill(0.5 * pa, intake.volume_m3, 0, intake.wall_k), intake.wall_k);
    for (v, m) in [(EXHAUST, &p.exhaust_manifold), (CATALYST, &p.catalyst)] {
        set_volume(&mut state, p, v, fill(pa, m.volume_m3, 2, 800.0), 800.0);
    }
    state
}

/// Fill one volume with given masses \[kg\] at a temperature \[K\].
pub(crate) fn set_volume(s: &mut EngineState, p: &EngineParams, volume: usize, mass_kg: [f64; 3], t_k: f64) {
    for i in 0..3 {
        s.gas.mass_kg[i][volume] = mass_kg[i];
    }
    s.gas.energy_j[volume] = p.gas.energy_j(mass_kg, t_k);
    s.t_k[volume] = t_k;
    s.t_before_k[volume] = t_k;
}
