//! The virtual engine: construction, stepping, outputs, snapshots.

use crate::deviations::Deviations;
use crate::dissociation::HeldEnergy;
use crate::error::PlantError;
use crate::exhaust_wall::Sinks;
use crate::gas::VOLUMES;
use crate::grid::Grid;
use crate::initial::{initial_state, set_volume};
use crate::inputs::Inputs;
use crate::outputs::Outputs;
use crate::params::EngineParams;
use crate::state::{CycleRecord, EXHAUST, EngineState, Gas, Means, Sums};
use crate::step::{Held, Model, Rates, add, advance};
use std::sync::Arc;

/// Crank-angle resolved four-cylinder gasoline engine, filling-and-emptying level (F0).
///
/// Deterministic, no allocation while stepping, cheap to clone (tables are shared).
///
/// ```
/// use dynocal_plant::{engine::VirtualEngine, inputs::Inputs, params::EngineParams};
/// let mut engine = VirtualEngine::new(&EngineParams::thesis())?;
/// engine.set_inputs(Inputs { injection_mg: 16.75, throttle_deg: 15.85, ..Inputs::default() })?;
/// engine.advance_time(2.0);
/// let y = engine.outputs();
/// assert!((y.torque_nm - 70.0).abs() < 2.0 && (y.lambda - 1.0).abs() < 0.02);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
#[derive(Debug, Clone)]
pub struct VirtualEngine {
    pub(crate) params: Arc<EngineParams>,
    pub(crate) model: Arc<Model>,
    pub(crate) grid: Arc<Grid>,
    pub(crate) held: Held,
    pub(crate) deviations: Deviations,
    pub(crate) state: EngineState,
    pub(crate) k: Rates,
    mid: Gas,
}

/// State of one gas volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GasState {
    /// Pressure \[Pa\].
    pub p_pa: f64,
    /// Temperature \[K\].
    pub t_k: f64,
    /// Volume \[m3\].
    pub volume_m3: f64,
    /// Masses of air, fuel vapour, products \[kg\].
    pub mass_kg: [f64; 3],
}

impl VirtualEngine {
    /// An engine at rest state (manifolds near ambient, hot exhaust), driven by `Inputs::default()`.
    ///
    /// # Errors
    /// [`PlantError::Parameter`] when a parameter is out of range.
    pub fn new(params: &EngineParams) -> Result<Self, PlantError> {
        params.check()?;
        let grid = Grid::new(params);
        let inputs = Inputs::default();
        let deviations = Deviations::default();
        let held = Held::new(params, &grid, &inputs, &deviations, &Means::default());
        let state = initial_state(params, &grid, inputs);
        let mid = state.gas.clone();
        Ok(Self {
            params: Arc::new(params.clone()),
            model: Arc::new(Model::new(params)),
            grid: Arc::new(grid),
            held,
            deviations,
            state,
            k: Rates::ZERO,
            mid,
        })
    }

    /// Constants of this engine.
    pub fn params(&self) -> &EngineParams {
        &self.params
    }

    /// Set the inputs from now on.
    ///
    /// # Errors
    /// [`PlantError::Input`] when an input is outside the box; the old inputs stay in force.
    pub fn set_inputs(&mut self, inputs: Inputs) -> Result<(), PlantError> {
        inputs.check()?;
        if inputs.egr_mm > 0.0 && self.params.egr.is_none() {
            // The engine has no such path: its box ends at 0.
            return Err(PlantError::Input {
                name: "egr",
                found: inputs.egr_mm,
                low: 0.0,
                high: 0.0,
                unit: "mm",
            });
        }
        if inputs != self.state.inputs {
            self.state.inputs = inputs;
            self.hold();
        }
        Ok(())
    }

    /// Sets in what this engine differs from the ideal one from now on. Deviations are no part of the state: whoever
    /// sets them sets them again after [`Self::restore`].
    pub fn set_deviations(&mut self, deviations: Deviations) {
        if deviations != self.deviations {
            self.deviations = deviations;
            self.hold();
        }
    }

    /// What follows from inputs and deviations until they change.
    fn hold(&mut self) {
        let means = self.state.means();
        self.held = Held::new(&self.params, &self.grid, &self.state.inputs, &self.deviations, &means);
    }

    /// Where the heat of the exhaust manifold goes; none where ports and manifold are not apart.
    pub fn exhaust_sinks(&self) -> Option<Sinks> {
        let wall = self.params.exhaust_wall?;
        Some(wall.of(self.params.ambient.temperature_k, &self.deviations, self.state.means().exhaust_kg_s))
    }

    /// Wall of the exhaust manifold \[K\]: as set from outside, at rest with the gas, or one temperature of all.
    pub fn manifold_wall_k(&self) -> f64 {
        let Some(wall) = self.params.exhaust_wall else { return self.params.exhaust_manifold.wall_k };
        self.deviations.manifold_wall_k.unwrap_or_else(|| {
            let ambient_k = self.params.ambient.temperature_k;
            let through = self.exhaust_sinks().map_or(0.0, |s| s.manifold.0);
            // In series: what passes the wall leaves it to the air.
            let drop = if wall.ambient_w_k > 0.0 { through / wall.ambient_w_k } else { 1.0 };
            ambient_k + drop * (self.state.t_k[EXHAUST] - ambient_k)
        })
    }

    /// Advance by an angle \[deg\]; what is less than a step is carried to the next call.
    pub fn advance_angle(&mut self, deg: f64) {
        pulp::Arch::new().dispatch(Advance { engine: self, deg });
    }

    #[inline(always)]
    fn advance_by(&mut self, deg: f64) {
        // The guard absorbs rounding of sums of intervals, far below any step.
        const GUARD_DEG: f64 = 1e-7;
        let mut left = self.state.remainder_deg + deg;
        loop {
            let cells = self.step_cells();
            let span = cells as f64 * self.grid.cell_deg;
            if left < span - GUARD_DEG {
                break;
            }
            self.step(cells);
            left -= span;
        }
        self.state.remainder_deg = left;
    }

    /// Advance by a time \[s\] at the present speed; what is less than a step is carried over.
    pub fn advance_time(&mut self, time_s: f64) {
        self.advance_angle(time_s * self.held.deg_s);
    }

    /// Clear the sums behind the interval means of [`Outputs`].
    pub fn clear_interval(&mut self) {
        self.state.interval = Sums::default();
    }

    /// Outputs at the present angle.
    pub fn outputs(&self) -> Outputs {
        Outputs::new(&self.params, &self.model, &self.held, &self.state, &self.k)
    }

    /// Last complete cycle of each cylinder.
    pub fn cycle_log(&self) -> [CycleRecord; 4] {
        [0, 1, 2, 3].map(|c| self.state.cylinders[c].last)
    }

    /// The whole state, to be given back to [`Self::restore`].
    pub fn snapshot(&self) -> EngineState {
        self.state.clone()
    }

    /// View of the state (pressures of the last step are in [`Self::outputs`]).
    pub fn state(&self) -> &EngineState {
        &self.state
    }

    /// Continue from a snapshot of an engine with the same parameters.
    ///
    /// # Errors
    /// [`PlantError::Snapshot`] for another crank-angle grid, [`PlantError::Input`] for bad inputs in it.
    pub fn restore(&mut self, state: &EngineState) -> Result<(), PlantError> {
        let (found, expected) = (state.work_ring_j.len(), self.grid.cells);
        if found != expected || state.cell >= expected || state.next_event > self.grid.events.len() {
            return Err(PlantError::Snapshot { found, expected });
        }
        state.inputs.check()?;
        self.state.clone_from(state);
        self.hold();
        Ok(())
    }

    /// Check that the gas state is physical.
    ///
    /// # Errors
    /// [`PlantError::Diverged`] naming the first volume with a non-finite or negative content.
    pub fn check_state(&self) -> Result<(), PlantError> {
        let g = &self.state.gas;
        for volume in 0..VOLUMES {
            let finite = g.energy_j[volume].is_finite() && self.state.t_k[volume].is_finite();
            // Species that burn or leave may end a rounding error below zero.
            let negative = g.mass_kg.iter().any(|m| m[volume] < -1e-9 || m[volume].is_nan());
            if !finite || negative {
                return Err(PlantError::Diverged { volume, time_s: self.state.time_s });
            }
        }
        Ok(())
    }

    /// Replace the contents of one volume: masses of air, fuel vapour, products \[kg\] and temperature \[K\].
    pub fn set_volume(&mut self, volume: usize, mass_kg: [f64; 3], t_k: f64) {
        set_volume(&mut self.state, &self.params, volume, mass_kg, t_k);
    }

    /// From now on: other air around the engine, charge pipe and shaft given from outside.
    pub(crate) fn surround(&mut self, pressure_pa: f64, temperature_k: f64) {
        Arc::make_mut(&mut self.model).surround(pressure_pa, temperature_k);
    }

    /// Pressure, temperature and volume of one gas volume at the present angle.
    pub fn gas_state(&self, volume: usize) -> GasState {
        let s = &self.state;
        let mass_kg = [0, 1, 2].map(|i| s.gas.mass_kg[i][volume]);
        let gas = &self.model.gas;
        let held = if volume < 4 { s.cylinders[volume].held } else { HeldEnergy::default() };
        let mut t_k = s.t_k[volume];
        for _ in 0..20 {
            let (d, slope) = held.at(t_k);
            let step = (s.gas.energy_j[volume] - gas.energy_j(mass_kg, t_k) - mass_kg[2] * d)
                / (gas.heat_capacity_j_k(mass_kg, t_k) + mass_kg[2] * slope);
            t_k += step;
            if step.abs() < 1e-9 {
                break;
            }
        }
        let volume_m3 = if volume < 4 {
            self.grid.nodes[self.grid.local_nodes(s.cell)[volume]].volume_m3
        } else {
            self.model.manifold_m3[volume]
        };
        let mr = gas.mass_r_j_k(mass_kg) + mass_kg[2] * held.extra_r_j_kg_k;
        GasState { p_pa: mr * t_k / volume_m3, t_k, volume_m3, mass_kg }
    }

    /// Local crank angle of cylinder `c` (0..3) \[deg after firing TDC, 0..720\].
    pub fn local_angle_deg(&self, c: usize) -> f64 {
        self.grid.local_nodes(self.state.cell)[c % 4] as f64 * 0.5 * self.grid.cell_deg
    }

    /// Step wanted by the inputs, shortened until the grid of the longer step is met.
    #[inline]
    fn step_cells(&self) -> usize {
        let mut cells = self.held.step_cells;
        while self.state.cell & (cells - 1) != 0 {
            cells /= 2;
        }
        cells
    }

    #[inline(always)]
    fn step(&mut self, cells: usize) {
        self.events();
        let dt = cells as f64 * self.grid.cell_deg / self.held.deg_s;
        self.inject(dt);
        let s = &mut self.state;
        let start = self.grid.local_nodes(s.cell);
        // Linear extrapolation of the last two evaluations: usually one Newton correction remains.
        let mut guess = [0.0; VOLUMES];
        for v in 0..VOLUMES {
            guess[v] = 2.0 * s.t_k[v] - s.t_before_k[v];
        }
        let t_mid_before = s.t_k;
        self.model.rates(&s.gas, &start, &self.grid, &self.held, &s.cylinders, &mut guess, &mut self.k);
        advance(&s.gas, &self.k, 0.5 * dt, &mut self.mid);
        let t_start = guess;
        for v in 0..VOLUMES {
            guess[v] += t_start[v] - t_mid_before[v];
        }
        let middle = start.map(|i| i + cells);
        self.model.rates(&self.mid, &middle, &self.grid, &self.held, &s.cylinders, &mut guess, &mut self.k);
        add(&mut s.gas, &self.k, dt);
        restore_positive(&mut s.gas);
        s.t_before_k = t_start;
        s.t_k = guess;
        self.account(cells, dt, &middle);
    }
}

/// [`VirtualEngine::advance_angle`], compiled for the widest registers there are. Nothing is fused or reordered: the numbers
/// are those of any other machine.
struct Advance<'a> {
    engine: &'a mut VirtualEngine,
    deg: f64,
}

impl pulp::WithSimd for Advance<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.engine.advance_by(self.deg);
    }
}

/// A flow that turns between start and middle of a step can carry away a species that was not there. What a cylinder
/// is short of comes from the exhaust manifold, so that mass and energy stay exact.
#[inline]
fn restore_positive(gas: &mut Gas) {
    // Rounding stays where it is.
    const SHORT_KG: f64 = -1e-13;
    for species in &mut gas.mass_kg {
        for c in 0..4 {
            if species[c] < SHORT_KG {
                species[EXHAUST] += species[c];
                species[c] = 0.0;
            }
        }
    }
}
