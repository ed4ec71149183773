//! A matrix near that of the step, on two levels: within labels that are read at one place, and between coarse functions of all labels.
//!
//! ```text
//! A^-1 ~ sum_g E_g B_g^-1 E_g' + P C^-1 P'            B_g = E_g' A~ E_g,   C = P' A~ P
//! ```
//!
//! A~ is the matrix of the function as if it had no memory, in the size of the diagonal: its part of labels a and b is
//!
//! ```text
//! sqrt(s_a s_b) sum_t w(t) j_a(t) j_b(t)',     s = trace of the label's part of J'WJ / trace of the same without memory
//! ```
//!
//! with j the row of J without memory, over some of the samples. Cells of labels that are read at one place are tied to their neighbours
//! only, so that B_g is a band. What ties labels that are read at different places is nearly always a function of one quantity, or a
//! constant: maps that are added, whose gains move together, or that are told apart by one locked cell only. P holds these, for each label
//! the functions of either axis alone. (Two-level additive Schwarz: M. Dryja, O. B. Widlund, Domain decomposition algorithms with small
//! overlap, SIAM J. Sci. Comput. 15 (1994), 604-620.) All costs grow as samples and cells do.

use dynocal_numerics::linalg::{LinalgError, axpy};
use rayon::prelude::*;

use super::System;
use super::band::Band;
use super::order::Order;
use super::tiles::{TILE, Tiles};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::graph::products::Products;
use crate::graph::products::statics::Read;

/// Samples that the matrices are summed over: so many for each cell, and so many at least and at most.
const SAMPLES_A_CELL: usize = 8;
const SAMPLES: [usize; 2] = [1 << 16, 1 << 18];
/// Samples for each coarse function.
const SAMPLES_A_FUNCTION: usize = 32;
/// Samples whose rows are held at a time.
const HELD: usize = 4096;
/// Part of the diagonal that is added: some cells may have none of the samples.
const MORE: f64 = 1e-3;
/// The same of coarse functions, each of which has many samples.
const MORE_COARSE: f64 = 1e-6;
/// Change of the size of the data on a label, as a factor, from which the matrix is another one.
const OTHER: f64 = 4.0;

/// The matrices, factorised.
pub(in super::super) struct Levels {
    order: Order,
    /// Group and place of each cell.
    place: Vec<(usize, usize)>,
    /// Coarse functions at each cell.
    functions: Vec<Vec<(usize, f64)>>,
    bands: Vec<Band>,
    coarse: Tiles,
    /// Size of the data on each label that they were made for.
    sizes: Vec<f64>,
}

/// Entries at increasing places.
type Entries = Vec<(usize, f64)>;

/// What a sample adds: to each group (several times where a label is read at several places), and to the coarse functions.
struct Parts {
    groups: Vec<(usize, Entries)>,
    coarse: Option<Row>,
}

/// The coarse row of a sample: pieces of neighbouring places, none over the border of a tile.
struct Row {
    /// Tile row, first row in it, and where the numbers stand.
    pieces: Vec<(usize, usize, std::ops::Range<usize>)>,
    values: Vec<f64>,
}

impl Row {
    fn new(entries: &Entries) -> Self {
        let mut out = Self { pieces: Vec::new(), values: entries.iter().map(|e| e.1).collect() };
        let mut from = 0;
        for k in 1..=entries.len() {
            let ends = |(at, _): (usize, f64)| at != entries[k - 1].0 + 1 || at % TILE == 0;
            if entries.get(k).is_none_or(|e| ends(*e)) {
                let at = entries[from].0;
                out.pieces.push((at / TILE, at % TILE, from..k));
                from = k;
            }
        }
        out
    }
}

/// Sorts entries and joins those at one place.
fn joined(mut entries: Entries) -> Entries {
    entries.sort_unstable_by_key(|e| e.0);
    entries.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        kept.1 += if same { next.1 } else { 0.0 };
        same
    });
    entries
}

impl Levels {
    /// The matrices at the point of `s`.
    pub(super) fn new(graph: &Graph, s: &System, sizes: Vec<f64>) -> Result<Self, LabelError> {
        let order = Order::new(graph, &s.spans);
        let n = s.base.len();
        let (mut place, mut functions) = (vec![(0, 0); n], vec![Vec::new(); n]);
        for (l, span) in s.spans.iter().enumerate() {
            for cell in span.clone() {
                place[cell] = order.place(l, cell);
                if s.free[cell] {
                    order.functions(l, cell, &mut |q, v| functions[cell].push((q, v)));
                }
            }
        }
        let bands = order.groups.iter().map(|g| Band::zeros(g.len, g.width)).collect();
        let coarse = Tiles::zeros(order.coarse);
        let mut out = Self { order, place, functions, bands, coarse, sizes };
        out.sum(graph, s);
        out.hold(s);
        let singular = |e: LinalgError| LabelError::Singular(e.to_string());
        out.bands.par_iter_mut().try_for_each(Band::factor).map_err(singular)?;
        out.coarse.factor().map_err(singular)?;
        Ok(out)
    }

    /// Sums up rows of some of the samples.
    fn sum(&mut self, graph: &Graph, s: &System) {
        let most = (SAMPLES_A_CELL * s.base.len()).clamp(SAMPLES[0], SAMPLES[1]) / s.products.len().max(1);
        let samples: Vec<Vec<usize>> = s.products.iter().map(|p| p.some(most)).collect();
        let all: usize = samples.iter().map(Vec::len).sum();
        let every = (all / (SAMPLES_A_FUNCTION * self.order.coarse).max(1)).max(1);
        let [fine, coarse] = self.factors(graph, s, most, every);
        for ((p, w), samples) in s.products.iter().zip(&s.weights).zip(&samples) {
            let nodes = p.on_the_way();
            for (held, from) in samples.chunks(HELD).zip((0..).step_by(HELD)) {
                let part = |(k, t): (usize, &usize)| {
                    let both = [&fine[..], if (from + k) % every == 0 { &coarse[..] } else { &[] }];
                    self.parts(s, p, w[*t], *t, &nodes, both)
                };
                let parts: Vec<Parts> = held.par_iter().enumerate().map(part).collect();
                self.bands.par_iter_mut().enumerate().for_each(|(g, band)| {
                    let own = parts.iter().flat_map(|p| &p.groups).filter(|(group, _)| *group == g);
                    own.for_each(|(_, entries)| band.add(entries));
                });
                let rows: Vec<&Row> = parts.iter().filter_map(|p| p.coarse.as_ref()).collect();
                sum_up(&mut self.coarse, &rows);
            }
        }
    }

    /// Factors by which the rows of each label are brought to the size of the diagonal: of cells, and of coarse functions.
    fn factors(&self, graph: &Graph, s: &System, most: usize, every: usize) -> [Vec<f64>; 2] {
        let mut trace = vec![0.0; graph.labels.len()];
        for (p, w) in s.products.iter().zip(&s.weights) {
            axpy(1.0, &p.traces(w, most), &mut trace);
        }
        // Scalars have a part of their own.
        let of = |size: f64, trace: f64, l: usize| {
            if trace > 0.0 && s.spans[l].len() > 1 { (size / trace).sqrt() } else { 0.0 }
        };
        let fine: Vec<f64> = (0..trace.len()).map(|l| of(self.sizes[l], trace[l], l)).collect();
        // Of coarse functions: what random signs say of them, against the same without memory.
        let owners = self.order.owners();
        let mut size = vec![0.0; trace.len()];
        for draw in &s.draws {
            let own = self.down(draw);
            own.iter().zip(&owners).for_each(|(v, l)| size[*l] += v * v / s.draws.len() as f64);
        }
        let mut trace = vec![0.0; size.len()];
        for (p, w) in s.products.iter().zip(&s.weights) {
            let nodes = p.on_the_way();
            let ones = vec![1.0; size.len()];
            for t in p.some(most).into_iter().step_by(every) {
                let entries = self.coarse_entries(s, p, w[t], t, &nodes, &ones);
                entries.iter().for_each(|(q, v)| trace[owners[*q]] += v * v);
            }
        }
        let coarse = (0..trace.len()).map(|l| of(size[l], trace[l], l)).collect();
        [fine, coarse]
    }

    /// What coarse functions have of a sample.
    fn coarse_entries(
        &self,
        s: &System,
        p: &Products,
        weight: f64,
        t: usize,
        nodes: &[(usize, Vec<usize>)],
        factors: &[f64],
    ) -> Entries {
        let mut out = Entries::new();
        if weight > 0.0 {
            p.read_at(t, nodes, &mut |r: Read| {
                let factor = weight.sqrt() * factors[r.label] * r.slope;
                for c in (0..r.count).filter(|c| s.free[r.cells[*c]]) {
                    out.extend(
                        self.functions[r.cells[c]].iter().map(|(q, v)| (*q, factor * r.weights[c] * v)),
                    );
                }
            });
        }
        joined(out)
    }

    fn parts(
        &self,
        s: &System,
        p: &Products,
        weight: f64,
        t: usize,
        nodes: &[(usize, Vec<usize>)],
        [fine, coarse]: [&[f64]; 2],
    ) -> Parts {
        let mut groups: Vec<(usize, Entries)> = Vec::new();
        if weight > 0.0 {
            p.read_at(t, nodes, &mut |r: Read| {
                let factor = weight.sqrt() * fine[r.label] * r.slope;
                if factor == 0.0 {
                    return;
                }
                let g = self.place[r.cells[0]].0;
                let known = groups.iter().position(|(group, _)| *group == g);
                let at = known.filter(|_| !self.order.groups[g].apart).unwrap_or_else(|| {
                    groups.push((g, Entries::new()));
                    groups.len() - 1
                });
                let free = (0..r.count).filter(|c| s.free[r.cells[*c]] && r.weights[*c] != 0.0);
                groups[at].1.extend(free.map(|c| (self.place[r.cells[c]].1, factor * r.weights[c])));
            });
        }
        let groups = groups.into_iter().map(|(g, e)| (g, joined(e))).collect();
        let coarse =
            (!coarse.is_empty()).then(|| Row::new(&self.coarse_entries(s, p, weight, t, nodes, coarse)));
        Parts { groups, coarse }
    }

    /// Adds roughness, base, and what keeps cells that do not move where they are.
    fn hold(&mut self, s: &System) {
        let mean = s.diagonal.iter().sum::<f64>() / s.diagonal.len().max(1) as f64;
        for (row, w) in &s.rough {
            let free = || row.iter().filter(|(i, _)| s.free[*i]);
            let Some((first, _)) = free().next() else { continue };
            let (group, root) = (self.place[*first].0, w.sqrt());
            self.bands[group].add(&joined(free().map(|(i, d)| (self.place[*i].1, root * d)).collect()));
            let of = |(i, d): &(usize, f64)| {
                let d = root * d;
                self.functions[*i].iter().map(move |(q, v)| (*q, d * v)).collect::<Vec<_>>()
            };
            let entries = joined(free().flat_map(of).collect());
            for (k, (i, a)) in entries.iter().enumerate() {
                entries[k..].iter().for_each(|(j, b)| *self.coarse.at(*i, *j) += a * b);
            }
        }
        let mut own_coarse = vec![0.0; self.order.coarse];
        for k in 0..self.place.len() {
            let own = if s.free[k] { s.base_weight[k] + MORE * s.diagonal[k] + 1e-9 * mean } else { mean };
            let own = if s.diagonal[k] > 0.0 { own } else { mean };
            let (group, at) = self.place[k];
            self.bands[group].add(&[(at, own.max(f64::MIN_POSITIVE).sqrt())]);
            let coarse = s.base_weight[k] + MORE_COARSE * s.diagonal[k] + 1e-9 * mean;
            self.functions[k].iter().for_each(|(q, v)| own_coarse[*q] += coarse * v * v);
        }
        for (q, own) in own_coarse.iter().enumerate() {
            // A function of cells that do not move is none.
            *self.coarse.at(q, q) += if *own > 0.0 { *own } else { mean.max(f64::MIN_POSITIVE) };
        }
    }

    /// Whether the data have nearly these sizes on the labels.
    pub(super) fn fits(&self, sizes: &[f64]) -> bool {
        self.sizes.iter().zip(sizes).all(|(a, b)| (a / OTHER..=a * OTHER).contains(b))
    }

    /// `P'r`.
    fn down(&self, r: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.order.coarse];
        for (r, functions) in r.iter().zip(&self.functions) {
            functions.iter().for_each(|(q, v)| out[*q] += v * r);
        }
        out
    }

    /// Solves with the matrices; only what `moves` counts.
    pub(super) fn solve(&self, r: &[f64], moves: &[bool]) -> Result<Vec<f64>, LabelError> {
        let r: Vec<f64> = r.iter().zip(moves).map(|(r, m)| if *m { *r } else { 0.0 }).collect();
        let mut own: Vec<Vec<f64>> = self.order.groups.iter().map(|g| vec![0.0; g.len]).collect();
        self.place.iter().zip(&r).for_each(|((g, at), r)| own[*g][*at] = *r);
        self.bands.par_iter().zip(&mut own).for_each(|(band, x)| band.solve(x));
        let mut coarse = self.down(&r);
        self.coarse.solve(&mut coarse).map_err(|e| LabelError::Singular(e.to_string()))?;
        let of = |k: usize| {
            let (g, at) = self.place[k];
            let sum: f64 = self.functions[k].iter().map(|(q, v)| v * coarse[*q]).sum();
            if moves[k] { own[g][at] + sum } else { 0.0 }
        };
        Ok((0..r.len()).map(of).collect())
    }
}

/// Adds the squares of rows to the upper triangle, a row of tiles on each processor.
fn sum_up(tiles: &mut Tiles, rows: &[&Row]) {
    let count = tiles.rows_mut().len();
    let widths: Vec<usize> = (0..count).map(|j| tiles.width(j)).collect();
    tiles.rows_mut().par_iter_mut().enumerate().for_each(|(i, own)| {
        for row in rows {
            for (_, from, at) in row.pieces.iter().filter(|(tile, ..)| *tile == i) {
                for (tile, column, other) in row.pieces.iter().filter(|(tile, ..)| *tile >= i) {
                    let (width, values) = (widths[*tile], &row.values[other.clone()]);
                    for (r, v) in row.values[at.clone()].iter().enumerate() {
                        let to = (from + r) * width + column;
                        axpy(*v, values, &mut own[tile - i][to..to + values.len()]);
                    }
                }
            }
        }
    });
}
