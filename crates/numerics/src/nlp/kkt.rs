//! The sparse symmetric KKT system; the only module that names feral.
//!
//! ```text
//! [ W + S + dw I    J'    ] [ dx ]   [ a ]
//! [ J              -dc I  ] [ dl ] = [ b ]
//! ```
//!
//! W Hessian of the Lagrangian, S bound terms (diagonal). A step is a descent direction for the barrier problem
//! when the matrix has n positive and m negative eigenvalues; dw and dc are raised until it has (Waechter and
//! Biegler 2006, algorithm IC).

use feral::scaling::ScalingStrategy;
use feral::symbolic::{OrderingMethod, OrderingPreprocess, SupernodeParams};
use feral::{CscMatrix, FactorStatus, RefineOptions, Solver};

/// First, smallest and largest dw, and its growth and decay: the values of the paper's section 3.1.
const DW_FIRST: f64 = 1e-4;
const DW_MIN: f64 = 1e-20;
const DW_MAX: f64 = 1e40;
const DW_GROW_FIRST: f64 = 100.0;
const DW_GROW: f64 = 8.0;
const DW_DECAY: f64 = 1.0 / 3.0;

/// What the factorisation says about the matrix.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Inertia {
    Right,
    TooFewNegative,
    Wrong,
    Singular,
}

/// The system of one problem structure: analysed once, refactorised for each set of values.
pub(super) struct Kkt {
    n: usize,
    m: usize,
    solver: Solver,
    matrix: CscMatrix,
    diagonal: Vec<usize>,
    hessian: Vec<usize>,
    jacobian: Vec<usize>,
    last_dw: f64,
}

/// One thread: the same digits everywhere, and the caller decides what runs in parallel. Minimum degree without
/// a matching first: the matching costs ten refactorisations on banded problems and saved nothing there.
fn solver() -> Solver {
    let analysis = SupernodeParams { preprocess: OrderingPreprocess::None, ..SupernodeParams::default() };
    Solver::with_params(feral::NumericParams::default(), analysis)
        .with_ordering(OrderingMethod::Amd)
        .with_parallel(false)
        .with_scaling(ScalingStrategy::InfNorm)
}

impl Kkt {
    /// Structure from (row, column) of the lower triangle of W and of J; duplicates are summed.
    pub(super) fn new(n: usize, m: usize, hess: &[(usize, usize)], jac: &[(usize, usize)]) -> Self {
        let lower = |&(i, j): &(usize, usize)| if i >= j { (j, i) } else { (i, j) };
        // (column, row) pairs, so that sorting gives the compressed columns.
        let entries: Vec<(usize, usize)> = hess
            .iter()
            .map(lower)
            .chain(jac.iter().map(|&(i, j)| (j, n + i)))
            .chain((0..n + m).map(|k| (k, k)))
            .collect();
        let mut sorted = entries.clone();
        sorted.sort_unstable();
        sorted.dedup();
        let mut col_ptr = vec![0; n + m + 1];
        for &(j, _) in &sorted {
            col_ptr[j + 1] += 1;
        }
        for j in 0..n + m {
            col_ptr[j + 1] += col_ptr[j];
        }
        let row_idx: Vec<usize> = sorted.iter().map(|e| e.1).collect();
        let place = |&(j, i): &(usize, usize)| {
            let range = &row_idx[col_ptr[j]..col_ptr[j + 1]];
            col_ptr[j] + range.partition_point(|&r| r < i)
        };
        let position: Vec<usize> = entries.iter().map(place).collect();
        let (h, j) = (hess.len(), jac.len());
        Self {
            n,
            m,
            solver: solver(),
            hessian: position[..h].to_vec(),
            jacobian: position[h..h + j].to_vec(),
            diagonal: position[h + j..].to_vec(),
            matrix: CscMatrix { n: n + m, col_ptr, values: vec![0.0; row_idx.len()], row_idx },
            last_dw: 0.0,
        }
    }

    fn assemble(&mut self, hess: &[f64], sigma: &[f64], jac: &[f64], dw: f64, dc: f64) {
        let v = &mut self.matrix.values;
        v.fill(0.0);
        for (&p, h) in self.hessian.iter().zip(hess) {
            v[p] += h;
        }
        for (&p, j) in self.jacobian.iter().zip(jac) {
            v[p] += j;
        }
        for (&p, s) in self.diagonal[..self.n].iter().zip(sigma) {
            v[p] += s + dw;
        }
        for &p in &self.diagonal[self.n..] {
            v[p] -= dc;
        }
    }

    fn factor(&mut self) -> Inertia {
        let status = self.solver.factor(&self.matrix, None);
        crate::vector_state::clear();
        match status {
            FactorStatus::Success | FactorStatus::WrongInertia { .. } => match self.solver.inertia() {
                Some(i) if i.zero > 0 => Inertia::Singular,
                Some(i) if i.positive == self.n && i.negative == self.m => Inertia::Right,
                Some(i) if i.negative < self.m => Inertia::TooFewNegative,
                _ => Inertia::Wrong,
            },
            FactorStatus::Singular | FactorStatus::FatalError(_) => Inertia::Singular,
        }
    }

    /// Factorises with as much regularisation as gives the right inertia, at least `dw_floor`; `dc` is used when
    /// the Jacobian looks rank deficient. `false` when no regularisation helps (non-finite values).
    pub(super) fn factor_regularised(
        &mut self,
        hess: &[f64],
        sigma: &[f64],
        jac: &[f64],
        dw_floor: f64,
        dc_singular: f64,
    ) -> bool {
        self.assemble(hess, sigma, jac, dw_floor, 0.0);
        if !self.matrix.values.iter().all(|v| v.is_finite()) {
            return false;
        }
        let first = self.factor();
        if first == Inertia::Right {
            return true;
        }
        let mut dc = 0.0;
        if matches!(first, Inertia::Singular | Inertia::TooFewNegative) {
            dc = dc_singular;
            self.assemble(hess, sigma, jac, dw_floor, dc);
            if self.factor() == Inertia::Right {
                return true;
            }
        }
        let seen = self.last_dw > 0.0;
        let mut dw = if seen { (DW_DECAY * self.last_dw).max(DW_MIN) } else { DW_FIRST }.max(dw_floor);
        while dw <= DW_MAX {
            self.assemble(hess, sigma, jac, dw, dc);
            if self.factor() == Inertia::Right {
                self.last_dw = dw;
                return true;
            }
            dw *= if seen { DW_GROW } else { DW_GROW_FIRST };
        }
        false
    }

    /// Factorises `[S, J'; J, -dc I]` with S > 0: always of the right inertia in exact arithmetic.
    pub(super) fn factor_quasidefinite(&mut self, sigma: &[f64], jac: &[f64], dc: f64) -> bool {
        self.assemble(&[], sigma, jac, 0.0, dc);
        self.matrix.values.iter().all(|v| v.is_finite()) && self.factor() == Inertia::Right
    }

    /// Solves with the last factorisation; `false` on a failure or non-finite result.
    pub(super) fn solve(&self, rhs: &[f64], out: &mut [f64]) -> bool {
        let solved = self.solver.solve_refined_into(&self.matrix, rhs, out, RefineOptions::with_max_steps(1));
        crate::vector_state::clear();
        solved.is_ok()
            && out.iter().all(|v| v.is_finite())
    }
}
