//! Tables on the crank-angle grid, built once per engine.
//!
//! A cycle has `cells` cells; a step spans one or more cells, its midpoint may fall between two, so
//! the tables have a node every half cell. Angles are local to a cylinder: 0 = firing TDC.

use crate::params::EngineParams;

/// Angle offsets of cylinders 1..4 \[deg\] (firing order 1-3-4-2): local = global - offset.
pub(crate) const OFFSETS_DEG: [f64; 4] = [0.0, 540.0, 180.0, 360.0];

/// Exponent of the motored reference pressure in Woschni's correlation.
pub(crate) const MOTORED_EXPONENT: f64 = 1.32;

/// Geometry at one node.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub(crate) volume_m3: f64,
    /// dV/dphi \[m3/rad\].
    pub(crate) dvolume: f64,
    pub(crate) wall_m2: f64,
    /// V^-1.32, for the motored pressure.
    pub(crate) motored: f64,
    /// Angle \[deg\] in -360..360, 0 = firing TDC.
    pub(crate) phi_deg: f64,
}

/// What happens at a given angle of a cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum EventKind {
    /// 180 deg: end of the gross cycle, begin of gas exchange.
    ExchangeBegins,
    /// 360 deg: peak pressure and residuals of the cycle are filed.
    CycleEnds,
    /// 420 deg (300 deg BTDC firing): fuel demand latched, injector opens.
    Injection,
    /// 540 deg: end of gas exchange.
    ExchangeEnds,
    /// 615 deg: Woschni reference state.
    Closed,
    /// 660 deg (60 deg BTDC firing): spark and burn latched.
    Spark,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Event {
    pub(crate) cell: usize,
    pub(crate) cylinder: usize,
    pub(crate) kind: EventKind,
}

/// All tables.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    pub(crate) cells: usize,
    pub(crate) cell_deg: f64,
    /// Half-cell nodes, padded by the longest step so that a midpoint never wraps.
    pub(crate) nodes: Vec<Node>,
    /// Valve areas against (angle - MOP + 360) \[m2\], same spacing and padding.
    pub(crate) intake_m2: Vec<f64>,
    pub(crate) exhaust_m2: Vec<f64>,
    pub(crate) offset_cells: [usize; 4],
    pub(crate) events: Vec<Event>,
}

impl Grid {
    pub(crate) fn new(p: &EngineParams) -> Self {
        let per_deg = p.stepping.cells_per_deg;
        let cells = 720 * per_deg;
        let half_deg = 0.5 / per_deg as f64;
        let padded = 2 * cells + 8 * per_deg;
        let node = |i: usize| {
            let local = (i % (2 * cells)) as f64 * half_deg;
            let phi_deg = if local > 360.0 { local - 720.0 } else { local };
            let phi = phi_deg.to_radians();
            let volume_m3 = p.geometry.volume_m3(phi);
            Node {
                volume_m3,
                dvolume: p.geometry.dvolume_m3_per_rad(phi),
                wall_m2: p.geometry.wall_area_m2(phi),
                motored: volume_m3.powf(-MOTORED_EXPONENT),
                phi_deg,
            }
        };
        let from_mop = |i: usize| (i % (2 * cells)) as f64 * half_deg - 360.0;
        let kinds = [
            (180.0, EventKind::ExchangeBegins),
            (360.0, EventKind::CycleEnds),
            (420.0, EventKind::Injection),
            (540.0, EventKind::ExchangeEnds),
            (615.0, EventKind::Closed),
            (660.0, EventKind::Spark),
        ];
        let to_cells = |deg: f64| (deg * per_deg as f64).round() as usize;
        let mut events = Vec::with_capacity(24);
        for (cylinder, offset) in OFFSETS_DEG.iter().enumerate() {
            for (local, kind) in kinds {
                events.push(Event { cell: to_cells(local + offset) % cells, cylinder, kind });
            }
        }
        events.sort_by_key(|e| (e.cell, e.cylinder, e.kind));
        Self {
            cells,
            cell_deg: 2.0 * half_deg,
            nodes: (0..padded).map(node).collect(),
            intake_m2: (0..padded).map(|i| p.intake_valve.area_m2(from_mop(i))).collect(),
            exhaust_m2: (0..padded).map(|i| p.exhaust_valve.area_m2(from_mop(i))).collect(),
            offset_cells: OFFSETS_DEG.map(to_cells),
            events,
        }
    }

    /// Local half-cell index of each cylinder at a global cell.
    #[inline]
    pub(crate) fn local_nodes(&self, cell: usize) -> [usize; 4] {
        self.offset_cells.map(|o| 2 * if cell >= o { cell - o } else { cell + self.cells - o })
    }

    /// Area of both kinds of valves at the dead centre of gas exchange \[m2\].
    pub(crate) fn overlap_m2(&self, intake: (usize, f64), exhaust: (usize, f64)) -> f64 {
        let at = |table: &[f64], shift: (usize, f64)| table[(self.cells + shift.0) % (2 * self.cells)];
        at(&self.intake_m2, intake) + at(&self.exhaust_m2, exhaust)
    }

    /// Shift that turns a local node into an index of a valve table for the opening point `mop_deg`: whole half cells
    /// and the rest.
    pub(crate) fn valve_shift(&self, mop_deg: f64) -> (usize, f64) {
        let period = 2.0 * self.cells as f64;
        let shift = ((360.0 - mop_deg) * 2.0 / self.cell_deg).rem_euclid(period);
        let whole = (shift + 1e-9).floor();
        let rest = shift - whole;
        (whole as usize % (2 * self.cells), if rest < 1e-9 { 0.0 } else { rest })
    }
}
