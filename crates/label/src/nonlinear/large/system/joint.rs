//! A matrix near that of the step, over all labels at once: that of the function as if it had no memory, in the size of the diagonal.
//!
//! Maps that are added and whose gains move together, or that are told apart by one locked cell only, are tied far more to each other
//! than a matrix label by label knows. Of a memory only the size is told: the part of `J'WJ` of labels a and b is
//!
//! ```text
//! sqrt(s_a s_b) sum_t w(t) j_a(t) j_b(t)',     s = trace of the label's part of J'WJ / trace of the same without memory
//! ```
//!
//! with j the row of J without memory, summed over some of the samples.

use dynocal_numerics::linalg::axpy;
use rayon::prelude::*;

use super::System;
use super::tiles::{TILE, Tiles};
use crate::error::LabelError;
use crate::graph::products::statics::Read;
use crate::graph::{Graph, Op};

/// Cells up to which such a matrix is held: a GiB.
pub(in super::super) const MOST_CELLS: usize = 16_384;
/// Samples that it is summed over: so many for each cell, and so many at least and at most.
const SAMPLES_A_CELL: usize = 16;
const SAMPLES: [usize; 2] = [1 << 16, 1 << 19];
/// Samples whose rows are held at a time.
const HELD: usize = 4096;
/// Part of the diagonal that is added: some cells may have none of the samples.
const MORE: f64 = 1e-3;

/// Change of the size of the data on a label, as a factor, from which the matrix is another one.
const OTHER: f64 = 4.0;

/// The matrix, factorised.
pub(in super::super) struct Joint {
    /// Place of each cell in it.
    place: Vec<usize>,
    tiles: Tiles,
    /// Size of the data on each label that it was made for.
    sizes: Vec<f64>,
}

/// Where the cells of labels stand: those of labels that are read at the same place lie side by side, cell by cell.
struct Order {
    /// Of each label: the number of its group, its number among the group's, and how many these are.
    member: Vec<(usize, usize, usize)>,
    /// First place of each group.
    first: Vec<usize>,
    /// First cell of each label.
    cells: Vec<usize>,
}

impl Order {
    fn new(graph: &Graph, spans: &[std::ops::Range<usize>]) -> Self {
        let nodes_of = |l: usize| -> Vec<&Vec<usize>> {
            let reads = graph.nodes.iter().filter_map(|n| match &n.op {
                Op::Label(label, at) if *label == l => Some(at),
                _ => None,
            });
            reads.collect()
        };
        let same = |a: usize, b: usize| {
            let (x, y) = (nodes_of(a), nodes_of(b));
            let points = |l: usize| graph.labels[l].axes.iter().map(|a| &a.points);
            x.len() == 1 && x == y && points(a).eq(points(b))
        };
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for l in 0..graph.labels.len() {
            match groups.iter_mut().find(|g| same(g[0], l)) {
                Some(g) => g.push(l),
                None => groups.push(vec![l]),
            }
        }
        let mut member = vec![(0, 0, 0); graph.labels.len()];
        let (mut first, mut sum) = (Vec::new(), 0);
        for (g, labels) in groups.iter().enumerate() {
            first.push(sum);
            labels.iter().enumerate().for_each(|(m, l)| member[*l] = (g, m, labels.len()));
            sum += labels.iter().map(|l| graph.labels[*l].len()).sum::<usize>();
        }
        Self { member, first, cells: spans.iter().map(|s| s.start).collect() }
    }

    /// Place of cell `cell` of label `l`.
    fn place(&self, l: usize, cell: usize) -> usize {
        let (g, m, members) = self.member[l];
        self.first[g] + (cell - self.cells[l]) * members + m
    }
}

/// The row of a sample: pieces of neighbouring places, none over the border of a tile.
#[derive(Default)]
struct Row {
    /// Tile row, first row in it, and where the numbers stand.
    pieces: Vec<(usize, usize, std::ops::Range<usize>)>,
    values: Vec<f64>,
}

impl Row {
    /// Gathers reads; `group` holds for each group the first cell's place and where its numbers begin.
    fn add(&mut self, order: &Order, read: &Read, factor: f64, free: &[bool], group: &mut [(usize, usize)]) {
        let (g, m, members) = order.member[read.label];
        let base = order.place(read.label, read.cells[0]) - m;
        if group[g].0 != base {
            group[g] = (base, self.values.len());
            for c in 0..read.count {
                self.run(order.place(read.label, read.cells[c]) - m, members);
            }
        }
        let from = group[g].1 + m;
        for c in (0..read.count).filter(|c| free[read.cells[*c]]) {
            self.values[from + c * members] += factor * read.slope * read.weights[c];
        }
    }

    /// Room for `members` numbers from place `from` on.
    fn run(&mut self, from: usize, members: usize) {
        let (mut at, end) = (from, from + members);
        while at < end {
            let to = end.min((at / TILE + 1) * TILE);
            let v = self.values.len();
            self.values.resize(v + to - at, 0.0);
            self.pieces.push((at / TILE, at % TILE, v..v + to - at));
            at = to;
        }
    }
}

impl Joint {
    /// The matrix at the point of `s`.
    pub(super) fn new(graph: &Graph, s: &System, sizes: Vec<f64>) -> Result<Self, LabelError> {
        let order = Order::new(graph, &s.spans);
        let n = s.base.len();
        let most = (SAMPLES_A_CELL * n).clamp(SAMPLES[0], SAMPLES[1]) / s.products.len().max(1);
        let mut trace = vec![0.0; graph.labels.len()];
        for (p, w) in s.products.iter().zip(&s.weights) {
            axpy(1.0, &p.traces(w, most), &mut trace);
        }
        // Scalars have a part of their own.
        let factors: Vec<f64> = s
            .spans
            .iter()
            .zip(&trace)
            .zip(&sizes)
            .map(
                |((span, trace), size)| {
                    if *trace > 0.0 && span.len() > 1 { (size / trace).sqrt() } else { 0.0 }
                },
            )
            .collect();
        let mut tiles = Tiles::zeros(n);
        for (p, w) in s.products.iter().zip(&s.weights) {
            let (nodes, samples) = (p.on_the_way(), p.some(most));
            for held in samples.chunks(HELD) {
                let row = |t: &usize| {
                    let (mut row, mut group) = (Row::default(), vec![(usize::MAX, 0); order.first.len()]);
                    if w[*t] > 0.0 {
                        let root = w[*t].sqrt();
                        p.read_at(*t, &nodes, &mut |r| {
                            if factors[r.label] > 0.0 {
                                row.add(&order, &r, root * factors[r.label], &s.free, &mut group);
                            }
                        });
                    }
                    row
                };
                let rows: Vec<Row> = held.par_iter().map(row).collect();
                sum_up(&mut tiles, &rows);
            }
        }
        let mut place = vec![0; n];
        for (l, span) in s.spans.iter().enumerate() {
            span.clone().for_each(|cell| place[cell] = order.place(l, cell));
        }
        let mut out = Self { place, tiles, sizes };
        out.hold(s);
        out.tiles.factor().map_err(|e| LabelError::Singular(e.to_string()))?;
        Ok(out)
    }

    /// Adds roughness, base, and what keeps cells that do not move where they are.
    fn hold(&mut self, s: &System) {
        let mean = s.diagonal.iter().sum::<f64>() / s.diagonal.len().max(1) as f64;
        for (row, w) in &s.rough {
            for (i, a) in row.iter().filter(|(i, _)| s.free[*i]) {
                for (j, b) in row.iter().filter(|(j, _)| s.free[*j] && j >= i) {
                    *self.tiles.at(self.place[*i], self.place[*j]) += w * a * b;
                }
            }
        }
        for k in 0..self.place.len() {
            let own = if s.free[k] { s.base_weight[k] + MORE * s.diagonal[k] + 1e-9 * mean } else { mean };
            let own = if s.diagonal[k] > 0.0 { own } else { mean };
            *self.tiles.at(self.place[k], self.place[k]) += own.max(f64::MIN_POSITIVE);
        }
    }

    /// Whether the data have nearly these sizes on the labels.
    pub(super) fn fits(&self, sizes: &[f64]) -> bool {
        self.sizes.iter().zip(sizes).all(|(a, b)| (a / OTHER..=a * OTHER).contains(b))
    }

    /// Solves with the matrix; only what `moves` counts.
    pub(super) fn solve(&self, r: &[f64], moves: &[bool]) -> Result<Vec<f64>, LabelError> {
        let mut x = vec![0.0; r.len()];
        for (k, at) in self.place.iter().enumerate() {
            x[*at] = if moves[k] { r[k] } else { 0.0 };
        }
        self.tiles.solve(&mut x).map_err(|e| LabelError::Singular(e.to_string()))?;
        Ok(self.place.iter().zip(moves).map(|(at, m)| if *m { x[*at] } else { 0.0 }).collect())
    }
}

/// Adds the squares of rows to the upper triangle, a row of tiles on each processor.
fn sum_up(tiles: &mut Tiles, rows: &[Row]) {
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
