//! Residuals of a fit and their derivatives.
//!
//! A constant x between low and high is moved by z, x = low + (high - low)(1 + sin z)/2, so that the search knows no
//! bounds; at an end dx/dz vanishes and the constant rests there.

use std::f64::consts::FRAC_PI_2;

use dynocal_numerics::lm::LeastSquares;
use dynocal_numerics::watch::Watch;
use dynocal_plant::driven::{Answer, drive};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::params::EngineParams;
use dynocal_plant::state::EngineState;
use rayon::prelude::*;

use super::constants::Constant;
use super::read::Measured;
use super::{COMPARED, Compared};

/// Step of the derivatives in z: some 3 % of half a range, far above what a point that stands still still moves.
const STEP: f64 = 0.03;
/// Nearest to an end of its range that a constant starts, in z.
const MARGIN: f64 = 0.15;

/// The points that are fitted, and the constants that move.
pub(super) struct Problem<'a> {
    base: EngineParams,
    constants: Vec<&'static Constant>,
    points: Vec<Measured>,
    /// Where each residual stands: point, quantity.
    rows: Vec<(usize, Compared)>,
    /// Where each point stood at the last derivatives.
    states: Vec<Option<EngineState>>,
    watch: Watch<'a>,
    /// Evaluations so far; the first comes with the derivatives at the start.
    evaluations: usize,
    pub(super) error: Option<PlantError>,
}

impl<'a> Problem<'a> {
    pub(super) fn new(
        base: &EngineParams,
        constants: Vec<&'static Constant>,
        points: Vec<Measured>,
        watch: Watch<'a>,
    ) -> Self {
        let measured = |k: usize| {
            let there = |q: &Compared| q.measured(&points[k]);
            COMPARED.into_iter().filter(there).map(move |q| (k, q)).collect::<Vec<_>>()
        };
        let rows = (0..points.len()).flat_map(measured).collect();
        let states = vec![None; points.len()];
        Self { base: base.clone(), constants, rows, states, watch, evaluations: 1, error: None, points }
    }

    /// Number of points that are fitted.
    pub(super) fn points(&self) -> usize {
        self.points.len()
    }

    /// Where the constants of the set stand; those at an end of their range start a little inside.
    pub(super) fn start(&self) -> Vec<f64> {
        let mut p = self.base.clone();
        let z = |c: &&Constant| {
            let (low, high) = c.range;
            let x = (c.place)(&mut p).map_or(low, |v| *v);
            let most = FRAC_PI_2 - MARGIN;
            (2.0 * (x - low) / (high - low) - 1.0).clamp(-1.0, 1.0).asin().clamp(-most, most)
        };
        self.constants.iter().map(z).collect()
    }

    /// The engine at `z`.
    pub(super) fn params(&self, z: &[f64]) -> EngineParams {
        let mut p = self.base.clone();
        for (c, z) in self.constants.iter().zip(z) {
            if let Some(place) = (c.place)(&mut p) {
                *place = c.range.0 + 0.5 * (c.range.1 - c.range.0) * (1.0 + z.sin());
            }
        }
        p
    }

    fn engine(&mut self, z: &[f64]) -> Option<VirtualEngine> {
        match VirtualEngine::new(&bare(self.params(z))) {
            Ok(engine) => Some(engine),
            Err(e) => {
                self.error = Some(e);
                None
            }
        }
    }

    fn weigh(&self, answers: &[Answer], r: &mut [f64]) {
        for (r, (k, q)) in r.iter_mut().zip(&self.rows) {
            *r = q.error(&answers[*k], &self.points[*k]).unwrap_or(0.0) / q.asked().1;
        }
    }

    /// Answers of all points, from where each of them stood.
    fn answers(&mut self, engine: &VirtualEngine) -> Option<Vec<(Answer, EngineState)>> {
        let one = |e: &mut VirtualEngine, (m, s): (&Measured, &Option<EngineState>)| {
            if self.watch.interrupted() {
                return Ok(None);
            }
            from(e, engine, s.as_ref())?;
            let y = drive(e, &m.at)?;
            Ok(Some((y, e.snapshot())))
        };
        let all: Result<Option<Vec<_>>, PlantError> =
            self.points.par_iter().zip(&self.states).map_init(|| engine.clone(), one).collect();
        match all {
            Ok(found) => found,
            Err(e) => {
                self.error = Some(e);
                None
            }
        }
    }
}

impl LeastSquares for Problem<'_> {
    fn n(&self) -> usize {
        self.constants.len()
    }

    fn residuals(&self) -> usize {
        self.rows.len()
    }

    fn residual(&mut self, z: &[f64], r: &mut [f64]) -> bool {
        self.evaluations += 1;
        let Some(engine) = self.engine(z) else { return false };
        let Some(found) = self.answers(&engine) else { return false };
        let answers: Vec<Answer> = found.iter().map(|f| f.0).collect();
        self.weigh(&answers, r);
        self.watch.note(&format!(
            "evaluation {}: {:.4} (1: all errors as asked)",
            self.evaluations,
            mean_square(r)
        ));
        r.iter().all(|v| v.is_finite())
    }

    /// One-sided differences, every point from the state that it has without the step.
    fn residual_jacobian(&mut self, z: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        let Some(engine) = self.engine(z) else { return false };
        let Some(found) = self.answers(&engine) else { return false };
        let answers: Vec<Answer> = found.iter().map(|f| f.0).collect();
        self.weigh(&answers, r);
        self.states = found.into_iter().map(|f| Some(f.1)).collect();
        self.watch.note(&format!("derivatives of {} constants at {:.4}", z.len(), mean_square(r)));
        let n = z.len();
        let mut moved = vec![0.0; r.len()];
        for k in 0..n {
            // Towards the middle of the range.
            let step = if z[k].sin() > 0.0 { -STEP } else { STEP };
            let mut to = z.to_vec();
            to[k] += step;
            let Some(engine) = self.engine(&to) else { return false };
            let Some(found) = self.answers(&engine) else { return false };
            let answers: Vec<Answer> = found.iter().map(|f| f.0).collect();
            self.weigh(&answers, &mut moved);
            for (i, (a, b)) in moved.iter().zip(r.iter()).enumerate() {
                jac[i * n + k] = (a - b) / step;
            }
            self.watch.fraction((k + 1) as f64 / n as f64);
        }
        r.iter().chain(jac.iter()).all(|v| v.is_finite())
    }
}

/// Without what a steady comparison does not look at: emissions and the knock integral.
pub(super) fn bare(mut p: EngineParams) -> EngineParams {
    p.emissions = None;
    p.knock = None;
    p
}

/// Puts `engine` into a state, or into that of `fresh`.
pub(super) fn from(
    engine: &mut VirtualEngine,
    fresh: &VirtualEngine,
    state: Option<&EngineState>,
) -> Result<(), PlantError> {
    engine.restore(state.unwrap_or(fresh.state()))
}

pub(super) fn mean_square(r: &[f64]) -> f64 {
    r.iter().map(|v| v * v).sum::<f64>() / r.len().max(1) as f64
}
