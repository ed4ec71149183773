//! Symmetric indefinite factorisation of matrices whose graph is a long chain: a frontal method.
//!
//! ```text
//! P'A P = L D L',   D of 1x1 and 2x2 blocks
//! ```
//!
//! Programs over time couple a sample with its neighbours only. One dense front then slides along the chain: it takes
//! up the entries of the next few columns, eliminates what is fully summed, keeps the rest. A pivot must not let the
//! columns of L grow beyond `1 / THRESHOLD` (Duff and Reid 1983, test of section 2); what finds no such pivot stays
//! in the front and waits for the next columns, so that the inertia is as exact as that of a dense factorisation.
//! All memory is laid out once.
//!
//! Reference: I. S. Duff, J. K. Reid, The multifrontal solution of indefinite sparse symmetric linear equations,
//! ACM Trans. Math. Softw. 9 (1983), 302-325.

use super::front::{Front, Pivot};

/// Columns that are taken up together.
const TOGETHER: usize = 6;
/// Widest front that is worth it: beyond, a tree of fronts wins.
const WIDEST: usize = 64;
/// Room for delayed pivots beside the widest front.
const ROOM: usize = 24;

/// What the chain looks like around some successive columns, found once.
#[derive(Clone, Debug)]
struct Block {
    /// Positions taken up, from and to.
    own: (usize, usize),
    /// Positions that stay behind, ascending: range of `Frontal::rest`.
    rest: (usize, usize),
    /// Entries of the matrix: range of `Frontal::entries`.
    entries: (usize, usize),
    /// Where the previous block's rest goes, in own ++ rest: range of `Frontal::place`.
    place: (usize, usize),
}

/// One entry: index of its value, row and column in own ++ rest.
#[derive(Clone, Copy, Debug)]
struct Entry {
    value: u32,
    row: u16,
    column: u16,
}

/// One front's share of the factors: `columns` of L over `rows` indices.
#[derive(Clone, Copy, Debug)]
struct Panel {
    columns: usize,
    index: (usize, usize),
    l: usize,
    first_pivot: usize,
}

/// Numbers of eigenvalues by sign; the rest is zero to rounding.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Signs {
    pub(super) positive: usize,
    pub(super) negative: usize,
    /// Whether it ended early: too many are negative.
    pub(super) stopped: bool,
}

pub(super) struct Frontal {
    order: usize,
    blocks: Vec<Block>,
    rest: Vec<usize>,
    entries: Vec<Entry>,
    place: Vec<u16>,
    /// Position of each unknown.
    position: Vec<usize>,
    front: Front,
    next: Front,
    /// Most negative eigenvalues that what is eliminated after each block may have, see [`Frontal::expect_rows`].
    most_negative: Vec<usize>,
    /// Largest original entry of each row, by position.
    size: Vec<f64>,
    // Factors.
    panels: Vec<Panel>,
    index: Vec<u32>,
    l: Vec<f64>,
    pivots: Vec<Pivot>,
    x: Vec<f64>,
    local: Vec<f64>,
}

impl Frontal {
    /// Structure from the compressed columns of the lower triangle, for unknowns in the order `position`; none when
    /// a front would be too wide.
    pub(super) fn new(col_ptr: &[usize], row_idx: &[usize], position: &[usize]) -> Option<Self> {
        let n = position.len();
        let mut columns: Vec<Vec<(usize, usize)>> = vec![Vec::new(); n];
        for j in 0..n {
            for v in col_ptr[j]..col_ptr[j + 1] {
                let (a, b) = (position[j], position[row_idx[v]]);
                columns[a.min(b)].push((a.max(b), v));
            }
        }
        let (mut blocks, mut rest, mut entries, mut place) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut waiting: Vec<usize> = Vec::new();
        let mut widest = 0;
        for first in (0..n).step_by(TOGETHER) {
            let end = (first + TOGETHER).min(n);
            let mut now = waiting.clone();
            now.extend(columns[first..end].iter().flatten().map(|e| e.0));
            now.sort_unstable();
            now.dedup();
            now.retain(|&p| p >= end);
            widest = widest.max(end - first + now.len());
            if widest > WIDEST {
                return None;
            }
            let local = |p: usize| {
                if p < end { p - first } else { end - first + now.partition_point(|&q| q < p) }
            };
            let (rest_from, entries_from, place_from) = (rest.len(), entries.len(), place.len());
            place.extend(waiting.iter().map(|&p| local(p) as u16));
            for c in first..end {
                let column = (c - first) as u16;
                entries.extend(columns[c].iter().map(|&(r, v)| Entry {
                    value: v as u32,
                    row: local(r) as u16,
                    column,
                }));
            }
            rest.extend_from_slice(&now);
            blocks.push(Block {
                own: (first, end),
                rest: (rest_from, rest.len()),
                entries: (entries_from, entries.len()),
                place: (place_from, place.len()),
            });
            waiting = now;
        }
        Some(Self {
            order: n,
            blocks,
            rest,
            entries,
            place,
            position: position.to_vec(),
            front: Front::new(widest + ROOM),
            next: Front::new(widest + ROOM),
            most_negative: Vec::new(),
            size: vec![0.0; n],
            panels: Vec::new(),
            index: Vec::new(),
            l: Vec::new(),
            pivots: Vec::new(),
            x: vec![0.0; n],
            local: vec![0.0; widest + ROOM],
        })
    }

    /// Says which unknowns are rows of constraints, each with the first position that it is coupled with, so that
    /// [`Frontal::factor`] can stop early.
    ///
    /// A matrix `[W J'; J -D]` with D >= 0 that has as many negative eigenvalues as rows is positive definite where J is
    /// zero. By interlacing, the block of the first unknowns then has no more negative eigenvalues than there are rows coupled
    /// with any of them: each row takes one direction off at most. More of them in the pivots so far, and the inertia is
    /// wrong whatever follows.
    pub(super) fn expect_rows(&mut self, rows_from: impl Iterator<Item = usize>) {
        let mut begin: Vec<usize> = rows_from.collect();
        begin.sort_unstable();
        self.most_negative = self.blocks.iter().map(|b| begin.partition_point(|p| *p < b.own.1)).collect();
    }

    /// Factorises the matrix with these values; none when the delayed pivots do not fit into the front. Where
    /// [`Frontal::expect_rows`] shows that there are too many negative eigenvalues it stops; the signs so far say so.
    pub(super) fn factor(&mut self, values: &[f64]) -> Option<Signs> {
        pulp::Arch::new().dispatch(Factor(self, values))
    }

    #[inline(always)]
    fn factor_wide(&mut self, values: &[f64]) -> Option<Signs> {
        self.panels.clear();
        self.index.clear();
        self.l.clear();
        self.pivots.clear();
        self.size.fill(0.0);
        self.front.empty();
        let mut signs = Signs { positive: 0, negative: 0, stopped: false };
        for b in 0..self.blocks.len() {
            if !self.take_up(b, values) {
                return None;
            }
            let first_pivot = self.pivots.len();
            self.next.eliminate(&self.size, &mut self.pivots);
            self.keep(first_pivot);
            std::mem::swap(&mut self.front, &mut self.next);
            let positive = self.pivots[first_pivot..].iter().filter(|p| p.positive).count();
            signs.positive += positive;
            signs.negative += self.pivots.len() - first_pivot - positive;
            if self.most_negative.get(b).is_some_and(|most| signs.negative > *most) {
                signs.stopped = true;
                break;
            }
        }
        Some(signs)
    }

    /// Builds the front of block `b` in `next`: what `front` left, then the block's own columns and rest.
    #[inline(always)]
    fn take_up(&mut self, b: usize, values: &[f64]) -> bool {
        let Block { own, rest, entries, place } = self.blocks[b];
        let (old, new) = (&self.front, &mut self.next);
        let delayed = old.summed - old.done;
        let width = delayed + own.1 - own.0 + rest.1 - rest.0;
        if width > new.most {
            return false;
        }
        new.start(width, delayed + own.1 - own.0);
        new.index[..delayed].copy_from_slice(&old.index[old.done..old.summed]);
        for (k, p) in (own.0..own.1).enumerate() {
            new.index[delayed + k] = p;
        }
        new.index[delayed + own.1 - own.0..width].copy_from_slice(&self.rest[rest.0..rest.1]);
        let place = &self.place[place.0..place.1];
        let target = |k: usize| {
            if k < old.summed { k - old.done } else { delayed + place[k - old.summed] as usize }
        };
        for j in old.done..old.width {
            let (from, to) = (old.column(j), target(j) * new.most);
            for (i, v) in from.iter().enumerate() {
                new.a[to + target(j + i)] = *v;
            }
        }
        for e in &self.entries[entries.0..entries.1] {
            let v = values[e.value as usize];
            let (row, column) = (delayed + e.row as usize, delayed + e.column as usize);
            new.a[column * new.most + row] += v;
            for k in [row, column] {
                let s = &mut self.size[new.index[k]];
                *s = s.max(v.abs());
            }
        }
        true
    }

    /// Stores the eliminated columns of `next`.
    #[inline(always)]
    fn keep(&mut self, first_pivot: usize) {
        let f = &self.next;
        let index_from = self.index.len();
        self.index.extend(f.index[..f.width].iter().map(|&p| p as u32));
        self.panels.push(Panel {
            columns: f.done,
            index: (index_from, self.index.len()),
            l: self.l.len(),
            first_pivot,
        });
        for j in 0..f.done {
            self.l.extend_from_slice(&f.column(j)[1..]);
        }
    }

    /// Solves with the last factorisation, which must have found all pivots.
    pub(super) fn solve(&mut self, rhs: &[f64], out: &mut [f64]) {
        pulp::Arch::new().dispatch(Solve(self, rhs, out));
    }

    #[inline(always)]
    fn solve_wide(&mut self, rhs: &[f64], out: &mut [f64]) {
        let Self { order, position, panels, index, l, pivots, x, local, .. } = self;
        for k in 0..*order {
            x[position[k]] = rhs[k];
        }
        for p in panels.iter() {
            let at = &index[p.index.0..p.index.1];
            let w = &mut local[..at.len()];
            at.iter().zip(w.iter_mut()).for_each(|(&k, w)| *w = x[k as usize]);
            forward(&l[p.l..], &pivots[p.first_pivot..p.first_pivot + p.columns], w);
            at.iter().zip(w.iter()).for_each(|(&k, w)| x[k as usize] = *w);
        }
        for p in panels.iter().rev() {
            let at = &index[p.index.0..p.index.1];
            let w = &mut local[..at.len()];
            at.iter().zip(w.iter_mut()).for_each(|(&k, w)| *w = x[k as usize]);
            backward(&l[p.l..], &pivots[p.first_pivot..p.first_pivot + p.columns], w);
            // The rest of the front is known already.
            at[..p.columns].iter().zip(w.iter()).for_each(|(&k, w)| x[k as usize] = *w);
        }
        for k in 0..*order {
            out[k] = x[position[k]];
        }
    }
}

/// Compiled once for each width of vectors; plain closures would not be.
struct Factor<'a>(&'a mut Frontal, &'a [f64]);
struct Solve<'a>(&'a mut Frontal, &'a [f64], &'a mut [f64]);

impl pulp::WithSimd for Factor<'_> {
    type Output = Option<Signs>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Option<Signs> {
        self.0.factor_wide(self.1)
    }
}

impl pulp::WithSimd for Solve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.solve_wide(self.1, self.2);
    }
}

/// `w <- D^-1 L^-1 w` for one panel: eliminated entries divided by D, the others updated.
#[inline(always)]
fn forward(l: &[f64], pivots: &[Pivot], w: &mut [f64]) {
    let mut from = 0;
    for k in 0..pivots.len() {
        let (head, tail) = w.split_at_mut(k + 1);
        let column = &l[from..from + tail.len()];
        let v = head[k];
        tail.iter_mut().zip(column).for_each(|(t, l)| *t -= v * l);
        from += column.len();
    }
    let mut k = 0;
    while k < pivots.len() {
        let p = &pivots[k];
        if p.pair {
            let q = &pivots[k + 1];
            (w[k], w[k + 1]) = (p.inverse * w[k] + p.off * w[k + 1], p.off * w[k] + q.inverse * w[k + 1]);
            k += 2;
        } else {
            w[k] *= p.inverse;
            k += 1;
        }
    }
}

/// `w <- L'^-1 w` for one panel.
#[inline(always)]
fn backward(l: &[f64], pivots: &[Pivot], w: &mut [f64]) {
    let mut end: usize = (0..pivots.len()).map(|k| w.len() - 1 - k).sum();
    for k in (0..pivots.len()).rev() {
        let (head, tail) = w.split_at_mut(k + 1);
        let column = &l[end - tail.len()..end];
        // Four sums, so that the additions need not wait for each other.
        let mut sums = [0.0f64; 4];
        let (c, t) = (column.chunks_exact(4), tail.chunks_exact(4));
        let odd: f64 = c.remainder().iter().zip(t.remainder()).map(|(a, b)| a * b).sum();
        for (c, t) in c.zip(t) {
            for i in 0..4 {
                sums[i] += c[i] * t[i];
            }
        }
        head[k] -= (sums[0] + sums[1]) + (sums[2] + sums[3]) + odd;
        end -= column.len();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng64;

    /// Lower triangle by columns of a dense symmetric matrix, entries within `band` of the diagonal.
    fn compressed(a: &[f64], n: usize, band: usize) -> (Vec<usize>, Vec<usize>, Vec<f64>) {
        let (mut ptr, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
        for j in 0..n {
            for i in j..n.min(j + band + 1) {
                rows.push(i);
                values.push(a[i * n + j]);
            }
            ptr.push(rows.len());
        }
        (ptr, rows, values)
    }

    /// Congruences keep the inertia (Sylvester): `L D L'` with L unit lower banded and D of known signs, zeros on
    /// the diagonal of D replaced by 2x2 blocks [0 1; 1 0], so that pivots of size one alone cannot do.
    #[test]
    fn inertia_and_solution_of_matrices_built_from_known_factors() {
        let mut rng = Rng64::new(3);
        for (n, band) in [(1usize, 0usize), (7, 2), (61, 5), (200, 11)] {
            let mut d = vec![0.0; n * n];
            let (mut negative, mut k) = (0, 0);
            while k < n {
                if k + 1 < n && rng.uniform_in(0.0, 1.0) < 0.5 {
                    d[k * n + k + 1] = 1.0;
                    d[(k + 1) * n + k] = 1.0;
                    negative += 1;
                    k += 2;
                } else {
                    d[k * n + k] = rng.uniform_in(-2.0, 2.0);
                    negative += usize::from(d[k * n + k] < 0.0);
                    k += 1;
                }
            }
            let half = band.saturating_sub(1);
            let mut l = vec![0.0; n * n];
            for i in 0..n {
                (i.saturating_sub(half)..i).for_each(|j| l[i * n + j] = rng.uniform_in(-0.5, 0.5));
                l[i * n + i] = 1.0;
            }
            let product = |a: &[f64], b: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
                let sum = |i: usize, j: usize| (0..n).map(|k| a[i * n + k] * b(k, j)).sum();
                (0..n * n).map(|e| sum(e / n, e % n)).collect()
            };
            let a = product(&product(&l, &|i, j| d[i * n + j]), &|i, j| l[j * n + i]);
            let (ptr, rows, values) = compressed(&a, n, band);
            let position: Vec<usize> = (0..n).collect();
            let mut frontal = Frontal::new(&ptr, &rows, &position).expect("narrow");
            let signs = frontal.factor(&values).expect("fits");
            assert_eq!(signs, Signs { positive: n - negative, negative, stopped: false }, "n {n}");
            let x: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
            let rhs: Vec<f64> = (0..n).map(|i| (0..n).map(|j| a[i * n + j] * x[j]).sum()).collect();
            let mut found = vec![0.0; n];
            frontal.solve(&rhs, &mut found);
            // The factors grow with the inverse of L: condition numbers up to 1e6 at this band and size.
            let worst = x.iter().zip(&found).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(worst < 1e-7, "n {n}: {worst}");
        }
    }

    /// `[W J'; J 0]` along a chain: W = 2 I, each row the difference of two successive variables. It has the inertia that is
    /// expected and is factorised to the end; with W = -2 I at the first variables it ends long before.
    #[test]
    fn a_factorisation_ends_where_too_many_are_negative() {
        let (m, n) = (120, 360);
        // Variables 2k, 2k + 1, then row k behind them, coupling 2k and 2k + 2.
        let diagonal = |p: usize, sign: f64| if p % 3 == 2 && p / 3 < m { 0.0 } else { sign };
        let build = |bent: usize| {
            let (mut ptr, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
            for p in 0..n {
                rows.push(p);
                values.push(diagonal(p, if p < bent { -2.0 } else { 2.0 }));
                if p % 3 == 0 {
                    rows.push(p + 2);
                    values.push(1.0);
                }
                if p % 3 == 2 && p + 1 < n {
                    rows.push(p + 1);
                    values.push(-1.0);
                }
                ptr.push(rows.len());
            }
            (ptr, rows, values)
        };
        let position: Vec<usize> = (0..n).collect();
        let factor = |bent: usize, expect: bool| {
            let (ptr, rows, values) = build(bent);
            let mut frontal = Frontal::new(&ptr, &rows, &position).expect("narrow");
            if expect {
                frontal.expect_rows((0..m).map(|k| 3 * k));
            }
            frontal.factor(&values).expect("fits")
        };
        let right = Signs { positive: n - m, negative: m, stopped: false };
        assert_eq!(factor(0, true), right);
        assert_eq!(factor(0, false), right);
        let (whole, early) = (factor(60, false), factor(60, true));
        assert!(whole.negative > m && !whole.stopped, "{whole:?}");
        assert!(early.stopped && early.positive + early.negative < n / 3, "{early:?}");
    }

    #[test]
    fn a_dependent_row_is_called_zero_and_a_wide_graph_is_refused() {
        // [1 0 1; 0 1 1; 1 1 2]: the last row is the sum of the others.
        let a = [1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0];
        let (ptr, rows, values) = compressed(&a, 3, 2);
        let mut frontal = Frontal::new(&ptr, &rows, &[0, 1, 2]).expect("narrow");
        assert_eq!(frontal.factor(&values), Some(Signs { positive: 2, negative: 0, stopped: false }));
        let n = 2 * WIDEST;
        let (ptr, rows, _) = compressed(&vec![1.0; n * n], n, n);
        assert!(Frontal::new(&ptr, &rows, &(0..n).collect::<Vec<_>>()).is_none());
    }
}
