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
//!
//! Slacks of inequalities (a bounded variable that occurs in one row only, linearly, with coefficient s) leave the
//! system beforehand: with their diagonal entry g > 0 they add `-s^2 / g` to the row's diagonal and count as one
//! positive eigenvalue. What remains goes to the sliding front of [`super::frontal`] where the variables' own order
//! makes it a narrow chain, else, or when the front overflows, to feral.

use super::frontal::Frontal;
use crate::linalg::norm_inf;
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

/// Residual relative to right-hand side and solution at which a solution needs no refinement; most refinements; and
/// the residual above which the sliding front is not trusted and feral factorises again.
const REFINE_ABOVE: f64 = 1e-12;
const REFINEMENTS: usize = 3;
const TRUST_BELOW: f64 = 1e-8;
/// Least diagonal entry of an eliminated slack: its inverse stays finite.
const SLACK_DIAGONAL_MIN: f64 = 1e-30;

/// What the factorisation says about the matrix.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Inertia {
    Right,
    TooFewNegative,
    Wrong,
    /// The same, found before the end: whether it is singular, too, is not known.
    WrongEarly,
    Singular,
}

/// A slack that is eliminated before the factorisation.
#[derive(Clone, Copy, Debug)]
struct Slack {
    variable: usize,
    row: usize,
    /// Jacobian entry.
    entry: usize,
    /// Coefficient and diagonal of the last assembled matrix.
    coefficient: f64,
    diagonal: f64,
}

/// The system of one problem structure: analysed once, refactorised for each set of values.
pub(super) struct Kkt {
    n: usize,
    m: usize,
    slacks: Vec<Slack>,
    /// Variables that stay.
    kept: Vec<usize>,
    matrix: CscMatrix,
    /// Places of the kept entries: (place in the matrix, entry).
    hessian: Vec<(usize, usize)>,
    jacobian: Vec<(usize, usize)>,
    diagonal: Vec<usize>,
    frontal: Option<Frontal>,
    /// Set up when it is needed first.
    general: Option<Solver>,
    by_front: bool,
    last_dw: f64,
    /// Whether the last factorisation needed dw > 0: the Hessian bends the wrong way somewhere along the constraints.
    pub(super) convexified: bool,
    rhs: Vec<f64>,
    solution: Vec<f64>,
    residual: Vec<f64>,
    correction: Vec<f64>,
}

/// One thread: the same digits everywhere, and the caller decides what runs in parallel. Minimum degree without
/// a matching first: the matching costs ten refactorisations on banded problems and saved nothing there.
fn general_solver() -> Solver {
    let analysis = SupernodeParams { preprocess: OrderingPreprocess::None, ..SupernodeParams::default() };
    Solver::with_params(feral::NumericParams::default(), analysis)
        .with_ordering(OrderingMethod::Amd)
        .with_parallel(false)
        .with_scaling(ScalingStrategy::InfNorm)
}

/// Variables with a finite bound, one Jacobian entry and no Hessian entry.
fn find_slacks(hess: &[(usize, usize)], jac: &[(usize, usize)], bounded: &[bool]) -> Vec<Slack> {
    let mut uses = vec![0usize; bounded.len()];
    jac.iter().for_each(|e| uses[e.1] += 1);
    hess.iter().for_each(|e| {
        uses[e.0] += 2;
        uses[e.1] += 2;
    });
    let mut slacks = Vec::new();
    for (entry, &(row, variable)) in jac.iter().enumerate() {
        if uses[variable] == 1 && bounded[variable] {
            slacks.push(Slack { variable, row, entry, coefficient: 0.0, diagonal: 1.0 });
        }
    }
    slacks
}

/// Places of the unknowns along the chain: variables in their own order, each row behind its last variable.
fn chain_order(n: usize, m: usize, jac: &[(usize, usize)]) -> Vec<usize> {
    let mut key: Vec<(usize, usize)> = (0..n).map(|j| (j, 0)).chain((0..m).map(|_| (0, 1))).collect();
    for &(i, j) in jac {
        key[n + i].0 = key[n + i].0.max(j);
    }
    let mut order: Vec<usize> = (0..n + m).collect();
    order.sort_by_key(|&k| key[k]);
    let mut position = vec![0; n + m];
    order.iter().enumerate().for_each(|(p, &k)| position[k] = p);
    position
}

impl Kkt {
    /// Structure from (row, column) of the lower triangle of W and of J, duplicates being summed, and from which
    /// variables have a finite bound.
    pub(super) fn new(m: usize, hess: &[(usize, usize)], jac: &[(usize, usize)], bounded: &[bool]) -> Self {
        let slacks = find_slacks(hess, jac, bounded);
        let mut place = vec![0; bounded.len()];
        slacks.iter().for_each(|s| place[s.variable] = usize::MAX);
        let kept: Vec<usize> = (0..bounded.len()).filter(|&j| place[j] == 0).collect();
        kept.iter().enumerate().for_each(|(k, &j)| place[j] = k);
        let n = kept.len();
        // (column, row) pairs, so that sorting gives the compressed columns.
        let of_hess: Vec<(usize, usize)> =
            hess.iter().map(|&(i, j)| (place[i].min(place[j]), place[i].max(place[j]))).collect();
        let (at_j, of_jac): (Vec<usize>, Vec<(usize, usize)>) = (0..jac.len())
            .filter(|&k| place[jac[k].1] != usize::MAX)
            .map(|k| (k, (place[jac[k].1], n + jac[k].0)))
            .unzip();
        let diagonal = (0..n + m).map(|k| (k, k));
        let mut sorted: Vec<(usize, usize)> =
            of_hess.iter().chain(&of_jac).copied().chain(diagonal.clone()).collect();
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
        let find = |(j, i): (usize, usize)| {
            col_ptr[j] + row_idx[col_ptr[j]..col_ptr[j + 1]].partition_point(|&r| r < i)
        };
        let chain: Vec<(usize, usize)> = of_jac.iter().map(|&(j, i)| (i - n, j)).collect();
        let order = chain_order(n, m, &chain);
        let mut frontal = Frontal::new(&col_ptr, &row_idx, &order);
        if let Some(front) = &mut frontal {
            // A row without kept variables is coupled with itself alone.
            let mut first = order[n..].to_vec();
            chain.iter().for_each(|&(i, j)| first[i] = first[i].min(order[j]));
            front.expect_rows(first.into_iter());
        }
        Self {
            n,
            m,
            hessian: of_hess.iter().enumerate().map(|(k, &e)| (find(e), k)).collect(),
            jacobian: of_jac.iter().zip(at_j).map(|(&e, k)| (find(e), k)).collect(),
            diagonal: diagonal.map(find).collect(),
            frontal,
            matrix: CscMatrix { n: n + m, col_ptr, values: vec![0.0; row_idx.len()], row_idx },
            slacks,
            kept,
            general: None,
            by_front: false,
            last_dw: 0.0,
            convexified: false,
            rhs: vec![0.0; n + m],
            solution: vec![0.0; n + m],
            residual: vec![0.0; n + m],
            correction: vec![0.0; n + m],
        }
    }

    fn assemble(&mut self, hess: &[f64], sigma: &[f64], jac: &[f64], dw: f64, dc: f64) {
        let v = &mut self.matrix.values;
        v.fill(0.0);
        if !hess.is_empty() {
            self.hessian.iter().for_each(|&(p, k)| v[p] += hess[k]);
        }
        self.jacobian.iter().for_each(|&(p, k)| v[p] += jac[k]);
        for (&p, &j) in self.diagonal[..self.n].iter().zip(&self.kept) {
            v[p] += sigma[j] + dw;
        }
        for &p in &self.diagonal[self.n..] {
            v[p] -= dc;
        }
        for s in &mut self.slacks {
            s.coefficient = jac[s.entry];
            s.diagonal = (sigma[s.variable] + dw).max(SLACK_DIAGONAL_MIN);
            v[self.diagonal[self.n + s.row]] -= s.coefficient * s.coefficient / s.diagonal;
        }
    }

    fn factor(&mut self) -> Inertia {
        if let Some(front) = &mut self.frontal
            && let Some(signs) = front.factor(&self.matrix.values)
        {
            self.by_front = true;
            return if signs.stopped {
                Inertia::WrongEarly
            } else {
                self.judge(signs.positive, signs.negative)
            };
        }
        self.factor_generally()
    }

    fn factor_generally(&mut self) -> Inertia {
        self.by_front = false;
        let solver = self.general.get_or_insert_with(general_solver);
        let status = solver.factor(&self.matrix, None);
        crate::vector_state::clear();
        match (status, solver.inertia()) {
            (FactorStatus::Success | FactorStatus::WrongInertia { .. }, Some(i)) => {
                let (positive, negative) = (i.positive, i.negative);
                self.judge(positive, negative)
            }
            (FactorStatus::Success | FactorStatus::WrongInertia { .. }, None) => Inertia::Wrong,
            (FactorStatus::Singular | FactorStatus::FatalError(_), _) => Inertia::Singular,
        }
    }

    fn judge(&self, positive: usize, negative: usize) -> Inertia {
        if positive + negative < self.n + self.m {
            Inertia::Singular
        } else if negative == self.m {
            Inertia::Right
        } else if negative < self.m {
            Inertia::TooFewNegative
        } else {
            Inertia::Wrong
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
        self.convexified = false;
        self.assemble(hess, sigma, jac, dw_floor, 0.0);
        if !self.is_finite() {
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
            let now = self.factor();
            if now == Inertia::Right {
                (self.last_dw, self.convexified) = (dw, true);
                return true;
            }
            if now == Inertia::Singular && first == Inertia::WrongEarly && dc == 0.0 {
                dc = dc_singular;
                continue;
            }
            dw *= if seen { DW_GROW } else { DW_GROW_FIRST };
        }
        false
    }

    /// Factorises `[S, J'; J, -dc I]` with S > 0: always of the right inertia in exact arithmetic.
    pub(super) fn factor_quasidefinite(&mut self, sigma: &[f64], jac: &[f64], dc: f64) -> bool {
        self.assemble(&[], sigma, jac, 0.0, dc);
        self.is_finite() && self.factor() == Inertia::Right
    }

    fn is_finite(&self) -> bool {
        self.matrix.values.iter().all(|v| v.is_finite())
    }

    /// Solves with the last factorisation; `false` on a failure or non-finite result.
    pub(super) fn solve(&mut self, rhs: &[f64], out: &mut [f64]) -> bool {
        let (n, all) = (self.n, self.kept.len() + self.slacks.len());
        for (r, &j) in self.rhs.iter_mut().zip(&self.kept) {
            *r = rhs[j];
        }
        self.rhs[n..].copy_from_slice(&rhs[all..]);
        for s in &self.slacks {
            self.rhs[n + s.row] -= s.coefficient * rhs[s.variable] / s.diagonal;
        }
        if !self.solve_reduced() {
            return false;
        }
        for (x, &j) in self.solution.iter().zip(&self.kept) {
            out[j] = *x;
        }
        out[all..].copy_from_slice(&self.solution[n..]);
        for s in &self.slacks {
            out[s.variable] = (rhs[s.variable] - s.coefficient * out[all + s.row]) / s.diagonal;
        }
        out.iter().all(|v| v.is_finite())
    }

    fn solve_reduced(&mut self) -> bool {
        if self.by_front {
            if self.solve_by_front() {
                return true;
            }
            if self.factor_generally() == Inertia::Singular {
                return false;
            }
        }
        let Some(solver) = &self.general else { return false };
        let once = RefineOptions::with_max_steps(1);
        let solved = solver.solve_refined_into(&self.matrix, &self.rhs, &mut self.solution, once);
        crate::vector_state::clear();
        solved.is_ok()
    }

    /// `false` when the residual stays large.
    fn solve_by_front(&mut self) -> bool {
        let Some(front) = &mut self.frontal else { return false };
        front.solve(&self.rhs, &mut self.solution);
        let mut ratio = residual(&self.matrix, &self.rhs, &self.solution, &mut self.residual);
        for _ in 0..REFINEMENTS {
            if ratio <= REFINE_ABOVE {
                break;
            }
            front.solve(&self.residual, &mut self.correction);
            self.solution.iter_mut().zip(&self.correction).for_each(|(x, d)| *x += d);
            let now = residual(&self.matrix, &self.rhs, &self.solution, &mut self.residual);
            let stuck = now > 0.5 * ratio;
            ratio = now;
            if stuck {
                break;
            }
        }
        ratio <= TRUST_BELOW
    }
}

/// `r = b - A x`; returns |r| relative to |b| and |x|, largest entries.
fn residual(a: &CscMatrix, b: &[f64], x: &[f64], r: &mut [f64]) -> f64 {
    r.copy_from_slice(b);
    for j in 0..a.n {
        let (xj, mut sum) = (x[j], 0.0);
        let range = a.col_ptr[j]..a.col_ptr[j + 1];
        for (&i, &v) in a.row_idx[range.clone()].iter().zip(&a.values[range]) {
            sum += v * x[i];
            r[i] -= if i == j { 0.0 } else { v * xj };
        }
        r[j] -= sum;
    }
    let (size_b, size_x) = (norm_inf(b), norm_inf(x));
    norm_inf(r) / (size_b + size_x.min(1e6 * size_b)).max(f64::MIN_POSITIVE)
}
