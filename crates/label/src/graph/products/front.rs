//! Sums of many labels that are read at one place, each times a gain, taken together; and all else that no label changes.
//!
//! ```text
//! sum(t) = .. + sum_b sum_c w_bc(t) sum_m g_m(t) theta[cell_bc(t), m]        bundles b, corners c of a place, members m
//! ```
//!
//! A bundle is made of labels at one place (of channels only) on the same axes, each of which a sum takes once, alone or times a gain (of
//! channels only). Its cells lie side by side and so do the gains of a sample, so that a place is looked up once for all members and the
//! sum over them runs over neighbours. What the members give one by one is never held.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use crate::graph::forward::Run;
use crate::graph::{Graph, Op, Record};
use crate::rows::between;

/// Numbers that are taken at a time: rows of gains are whole multiples of it.
const LANES: usize = 4;
/// A bundle takes the gains of another one where these are at most so many times its own.
const SHARED: f64 = 1.5;
/// Samples that one processor takes at a time.
const PIECE: usize = 4096;

/// Interval of an axis and share of the way through it, at each sample.
pub(super) struct LookUp {
    pub(super) node: usize,
    pub(super) points: Vec<f64>,
    pub(super) below: Vec<u16>,
    pub(super) share: Vec<f64>,
}

impl LookUp {
    pub(super) fn new(node: usize, points: &[f64], values: &[f64]) -> Self {
        let at = |x: &f64| {
            let (below, share) = between(points, *x);
            (below as u16, share)
        };
        let (below, share) = values.par_iter().map(at).unzip();
        Self { node, points: points.to_vec(), below, share }
    }
}

/// A label of a bundle: its number, and the place of its gain.
struct Member {
    label: usize,
    slot: usize,
}

/// Labels at one place.
struct Bundle {
    sum: usize,
    /// Numbers of the look-ups, one an axis.
    places: Vec<usize>,
    /// Cells along the first axis, and in all.
    row: usize,
    cells: usize,
    members: Vec<Member>,
    gains: usize,
}

/// Gains, sample by sample; none for 1.
struct Gains {
    nodes: Vec<Option<usize>>,
    width: usize,
    rows: Vec<f64>,
}

/// What no label of a function changes over a record, for what leads to one node.
pub(crate) struct Front {
    pub(super) looks: Vec<Arc<LookUp>>,
    bundles: Vec<Bundle>,
    gains: Vec<Gains>,
    /// Nodes of the members, and of their products with gains.
    pub(super) taken: Vec<bool>,
    /// Nodes that the output needs, but for those.
    needed: Vec<bool>,
    first: Vec<usize>,
}

/// A member before gains have places: sum, label, its node, gain.
struct Found {
    sum: usize,
    label: usize,
    node: usize,
    gain: Option<usize>,
}

/// Nodes that no label changes.
fn fixed(graph: &Graph) -> Vec<bool> {
    let mut out: Vec<bool> = Vec::new();
    for node in &graph.nodes {
        let own =
            !matches!(node.op, Op::Label(..) | Op::Inverse(..)) && node.op.inputs().iter().all(|i| out[*i]);
        out.push(own);
    }
    out
}

/// Where a node that reads a label is read.
fn read(graph: &Graph, node: usize) -> Option<(usize, &[usize])> {
    match &graph.nodes[node].op {
        Op::Label(l, at) => Some((*l, at)),
        _ => None,
    }
}

/// All members there can be, and the nodes that they take.
fn members(graph: &Graph, needed: &[bool], fixed: &[bool]) -> (Vec<Found>, Vec<Vec<usize>>) {
    let mut uses = vec![0; graph.nodes.len()];
    for k in (0..needed.len()).filter(|k| needed[*k]) {
        graph.nodes[k].op.inputs().into_iter().for_each(|i| uses[i] += 1);
    }
    let single = |node: usize| {
        let (label, at) = read(graph, node).filter(|_| uses[node] == 1)?;
        (!at.is_empty() && at.iter().all(|i| fixed[*i])).then_some(label)
    };
    let (mut found, mut takes) = (Vec::new(), Vec::new());
    for sum in (0..needed.len()).filter(|k| needed[*k]) {
        let Op::Add(terms) = &graph.nodes[sum].op else { continue };
        for term in terms.iter().filter(|t| uses[**t] == 1) {
            if let Some(label) = single(*term) {
                found.push(Found { sum, label, node: *term, gain: None });
                takes.push(vec![*term]);
            }
            let Op::Multiply(factors) = &graph.nodes[*term].op else { continue };
            let [a, b] = factors[..] else { continue };
            for (node, gain) in [(a, b), (b, a)] {
                if let Some(label) = single(node).filter(|_| fixed[gain]) {
                    found.push(Found { sum, label, node, gain: Some(gain) });
                    takes.push(vec![node, *term]);
                }
            }
        }
    }
    (found, takes)
}

/// Members of one sum at one place on the same axes; those that are alone are none.
fn together(graph: &Graph, found: &[Found]) -> Vec<Vec<usize>> {
    let points = |f: &Found| graph.labels[f.label].axes.iter().map(|a| &a.points);
    let place = |f: &Found| read(graph, f.node).map(|r| r.1);
    let mut out: Vec<Vec<usize>> = Vec::new();
    for (k, f) in found.iter().enumerate() {
        let same = |g: &Found| g.sum == f.sum && place(g) == place(f) && points(g).eq(points(f));
        match out.iter_mut().find(|o| same(&found[o[0]])) {
            Some(own) => own.push(k),
            None => out.push(vec![k]),
        }
    }
    out.retain(|o| o.len() > 1);
    out
}

impl Front {
    /// Of what leads to node `output` of `graph` over `record`.
    pub(crate) fn new(graph: &Graph, record: &Record, output: usize) -> Self {
        let (m, fixed) = (graph.nodes.len(), fixed(graph));
        let mut needed = vec![false; m];
        needed[output] = true;
        for k in (0..=output).rev() {
            if needed[k] {
                graph.nodes[k].op.inputs().into_iter().for_each(|i| needed[i] = true);
            }
        }
        let (found, takes) = members(graph, &needed, &fixed);
        let groups = together(graph, &found);
        let mut out = Self {
            looks: Vec::new(),
            bundles: Vec::new(),
            gains: Vec::new(),
            taken: vec![false; m],
            needed,
            first: graph.first(),
        };
        for k in groups.iter().flatten() {
            takes[*k].iter().for_each(|node| out.taken[*node] = true);
        }
        // Values of what is fixed and enters a bundle or a place.
        let still: Vec<bool> = (0..m).map(|k| fixed[k] && out.needed[k]).collect();
        let run = graph.run_some(&graph.base(), record, &still, &|_| None);
        out.look_up(graph, &fixed, &run);
        out.bundle(graph, &found, groups, &run, record.time_s.len());
        (0..m).for_each(|k| out.needed[k] &= !out.taken[k]);
        out
    }

    /// Places of all labels that are read where no label leads to.
    fn look_up(&mut self, graph: &Graph, fixed: &[bool], run: &Run) {
        for k in (0..graph.nodes.len()).filter(|k| self.needed[*k]) {
            let Some((l, at)) = read(graph, k) else { continue };
            for (node, axis) in at.iter().zip(&graph.labels[l].axes).filter(|(i, _)| fixed[**i]) {
                if self.look(*node, &axis.points).is_none() {
                    self.looks.push(Arc::new(LookUp::new(*node, &axis.points, &run.values[*node])));
                }
            }
        }
    }

    /// The look-up of an axis at a node.
    fn look(&self, node: usize, points: &[f64]) -> Option<usize> {
        self.looks.iter().position(|o| o.node == node && o.points == points)
    }

    fn bundle(
        &mut self,
        graph: &Graph,
        found: &[Found],
        mut groups: Vec<Vec<usize>>,
        run: &Run,
        samples: usize,
    ) {
        groups.sort_by_key(|g| std::cmp::Reverse(g.len()));
        for group in groups {
            let mut nodes: Vec<Option<usize>> = group.iter().map(|k| found[*k].gain).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let gains = self.gains_of(nodes, run, samples);
            let known = &self.gains[gains].nodes;
            let one = &found[group[0]];
            let label = &graph.labels[one.label];
            let at = read(graph, one.node).map_or(&[][..], |r| r.1);
            let places = at.iter().zip(&label.axes).filter_map(|(node, axis)| self.look(*node, &axis.points));
            let member = |k: &usize| {
                let f = &found[*k];
                let slot = known.binary_search(&f.gain).unwrap_or_default();
                Member { label: f.label, slot }
            };
            self.bundles.push(Bundle {
                sum: one.sum,
                places: places.collect(),
                row: label.axes.first().map_or(1, |a| a.points.len()),
                cells: label.len(),
                members: group.iter().map(member).collect(),
                gains,
            });
        }
    }

    /// Gains in which these are.
    fn gains_of(&mut self, nodes: Vec<Option<usize>>, run: &Run, samples: usize) -> usize {
        let most = SHARED * nodes.len() as f64;
        let holds = |g: &Gains| {
            g.nodes.len() as f64 <= most && nodes.iter().all(|n| g.nodes.binary_search(n).is_ok())
        };
        if let Some(known) = self.gains.iter().position(holds) {
            return known;
        }
        let width = nodes.len().next_multiple_of(LANES);
        let mut rows = vec![0.0; samples * width];
        rows.par_chunks_mut(PIECE * width).enumerate().for_each(|(piece, rows)| {
            for (t, row) in (piece * PIECE..).zip(rows.chunks_mut(width)) {
                for (v, node) in row.iter_mut().zip(&nodes) {
                    *v = node.map_or(1.0, |n| run.values[n][t]);
                }
            }
        });
        self.gains.push(Gains { nodes, width, rows });
        self.gains.len() - 1
    }

    /// Values of all nodes that lead to the output, but for those of members.
    pub(crate) fn run(&self, graph: &Graph, theta: &[f64], record: &Record) -> Run {
        let tables = self.tables(theta);
        let sum = |k: usize| {
            self.bundles.iter().any(|b| b.sum == k).then(|| {
                let mut y = vec![0.0; record.time_s.len()];
                y.par_chunks_mut(PIECE).enumerate().for_each(|(piece, y)| {
                    self.forward(k, &tables, piece * PIECE..piece * PIECE + y.len(), y);
                });
                y
            })
        };
        graph.run_some(theta, record, &self.needed, &sum)
    }

    /// Cells of `v` as the bundles have them: those of all members side by side.
    pub(super) fn tables(&self, v: &[f64]) -> Vec<Vec<f64>> {
        let of = |b: &Bundle| {
            let width = self.gains[b.gains].width;
            let mut table = vec![0.0; b.cells * width];
            for m in &b.members {
                let own = &v[self.first[m.label]..][..b.cells];
                table[m.slot..].iter_mut().step_by(width).zip(own).for_each(|(t, v)| *t += v);
            }
            table
        };
        self.bundles.iter().map(of).collect()
    }

    /// Tables of zeros.
    pub(super) fn none(&self) -> Vec<Vec<f64>> {
        self.bundles.iter().map(|b| vec![0.0; b.cells * self.gains[b.gains].width]).collect()
    }

    /// Adds tables to the cells that they stand for.
    pub(super) fn gather(&self, tables: &[Vec<f64>], cells: &mut [f64]) {
        for (b, table) in self.bundles.iter().zip(tables) {
            let width = self.gains[b.gains].width;
            for m in &b.members {
                let own = &mut cells[self.first[m.label]..][..b.cells];
                own.iter_mut().zip(table[m.slot..].iter().step_by(width)).for_each(|(c, t)| *c += t);
            }
        }
    }

    /// Calls `take` with each cell of a bundle and the sums of the weights of its visits and of their squares, of sums that lead on.
    pub(super) fn visits(
        &self,
        counts: &[bool],
        leads: impl Fn(usize) -> bool,
        take: &mut dyn FnMut(usize, [f64; 2]),
    ) {
        for b in self.bundles.iter().filter(|b| leads(b.sum)) {
            let width = self.gains[b.gains].width;
            let mut sums = vec![[0.0; 2]; b.cells];
            self.over(b, 0..counts.len(), |t, at, weights, count, _| {
                for (at, w) in at[..count].iter().zip(weights).filter(|_| counts[t]) {
                    let sum = &mut sums[at / width];
                    *sum = [sum[0] + w, sum[1] + w * w];
                }
            });
            for m in &b.members {
                sums.iter().enumerate().for_each(|(k, sum)| take(self.first[m.label] + k, *sum));
            }
        }
    }

    /// Calls `take` with each sample of a piece: corners of the place in the table, their weights, how many they are, and the gains.
    fn over<'a>(
        &'a self,
        b: &Bundle,
        piece: Range<usize>,
        mut take: impl FnMut(usize, [usize; 4], [f64; 4], usize, &'a [f64]),
    ) {
        let gains = &self.gains[b.gains];
        let width = gains.width;
        let rows = gains.rows[piece.start * width..piece.end * width].chunks_exact(width);
        let look = |k: usize| {
            let look = &self.looks[b.places[k]];
            let below = look.below[piece.clone()].iter().map(|i| usize::from(*i));
            below.zip(look.share[piece.clone()].iter().copied())
        };
        match b.places.len() {
            1 => look(0).zip(rows).enumerate().for_each(|(t, ((i, s), gains))| {
                take(t, [i * width, (i + 1) * width, 0, 0], [1.0 - s, s, 0.0, 0.0], 2, gains);
            }),
            _ => look(0).zip(look(1)).zip(rows).enumerate().for_each(|(t, (((i, s), (j, r)), gains))| {
                let (c, up) = ((j * b.row + i) * width, b.row * width);
                let weights = [(1.0 - s) * (1.0 - r), s * (1.0 - r), (1.0 - s) * r, s * r];
                take(t, [c, c + width, c + up, c + up + width], weights, 4, gains);
            }),
        }
    }

    /// Adds what the bundles of node `sum` give over a piece, with the cells of `tables`.
    pub(super) fn forward(&self, sum: usize, tables: &[Vec<f64>], piece: Range<usize>, own: &mut [f64]) {
        for (b, table) in self.bundles.iter().zip(tables).filter(|(b, _)| b.sum == sum) {
            pulp::Arch::new().dispatch(
                #[inline(always)]
                || {
                    self.over(
                        b,
                        piece.clone(),
                        #[inline(always)]
                        |t, at, weights, count, gains| {
                            let mut parts = [0.0; LANES];
                            for (at, w) in at[..count].iter().zip(weights) {
                                let mut own = [0.0; LANES];
                                let cells = &table[*at..*at + gains.len()];
                                for (g, v) in gains.chunks_exact(LANES).zip(cells.chunks_exact(LANES)) {
                                    (0..LANES).for_each(|l| own[l] += g[l] * v[l]);
                                }
                                (0..LANES).for_each(|l| parts[l] += w * own[l]);
                            }
                            own[t] += parts.iter().sum::<f64>();
                        },
                    );
                },
            );
        }
    }

    /// Adds what reaches node `sum` over a piece to the tables of its bundles.
    pub(super) fn backward(&self, sum: usize, tables: &mut [Vec<f64>], piece: Range<usize>, reaches: &[f64]) {
        for (b, table) in self.bundles.iter().zip(tables).filter(|(b, _)| b.sum == sum) {
            pulp::Arch::new().dispatch(
                #[inline(always)]
                || {
                    self.over(
                        b,
                        piece.clone(),
                        #[inline(always)]
                        |t, at, weights, count, gains| {
                            let reaches = reaches[t];
                            for (at, w) in at[..count].iter().zip(weights) {
                                let factor = w * reaches;
                                let cells = &mut table[*at..*at + gains.len()];
                                for (v, g) in cells.chunks_exact_mut(LANES).zip(gains.chunks_exact(LANES)) {
                                    (0..LANES).for_each(|l| v[l] += factor * g[l]);
                                }
                            }
                        },
                    );
                },
            );
        }
    }
}
