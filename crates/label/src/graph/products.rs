//! Products with the derivative J of a function without holding it, over all processors.
//!
//! Nodes are taken in stages: nodes with a memory one after the other over the whole record, all others in pieces of time, whose
//! numbers stay near the processor. Sums are made over a fixed number of parts, so that results do not depend on the processors.

pub(crate) mod front;
mod memory;
pub(crate) mod statics;

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::forward::{Run, slopes};
use super::{Graph, Op, Record};
use front::{Front, LookUp};

/// Parts of a record that are summed up apart.
const PARTS: usize = 32;
/// Samples of a piece: of a hundred nodes its numbers stay in the second cache.
const PIECE: usize = 256;

/// J of one node of a function at one point, for products with it ([`Graph::products`]).
pub struct Products<'a> {
    graph: &'a Graph,
    record: &'a Record<'a>,
    theta: Vec<f64>,
    first: Vec<usize>,
    run: Run,
    output: usize,
    /// Stage of each node between a label and the output; none for others.
    stage: Vec<Option<usize>>,
    stages: usize,
    /// Nodes of which the whole record is needed: memory, output, and what later stages read.
    whole: Vec<bool>,
    looks: Vec<Arc<LookUp>>,
    /// What no label changes.
    front: Arc<Front>,
    /// Look-ups of each label node.
    look: Vec<Vec<usize>>,
    /// What decays in each lag and film.
    decays: Vec<memory::Decay>,
}

/// Values over a piece of time.
type Piece = Vec<Vec<f64>>;

impl Graph {
    /// The derivative of node `output` at `theta`, without holding it.
    pub fn products<'a>(&'a self, theta: &[f64], record: &'a Record<'a>, output: usize) -> Products<'a> {
        let front = Arc::new(Front::new(self, record, output));
        Products::new(self, record, theta, self.run(theta, record), output, front)
    }
}

impl<'a> Products<'a> {
    /// At `theta`, of which `run` are the values (those of members of bundles are not needed).
    pub(crate) fn new(
        graph: &'a Graph,
        record: &'a Record<'a>,
        theta: &[f64],
        run: Run,
        output: usize,
        front: Arc<Front>,
    ) -> Self {
        let m = graph.nodes.len();
        let mut leads = vec![false; m];
        leads[output] = true;
        for k in (0..=output).rev().filter(|k| !matches!(graph.nodes[*k].op, Op::Hysteresis(..))) {
            if leads[k] {
                graph.nodes[k].op.inputs().into_iter().for_each(|i| leads[i] = true);
            }
        }
        let mut stage: Vec<Option<usize>> = vec![None; m];
        for k in (0..m).filter(|k| leads[*k]) {
            let op = &graph.nodes[k].op;
            let before = op.inputs().into_iter().filter_map(|i| stage[i]).max();
            stage[k] = match op {
                Op::Hysteresis(..) => None,
                Op::Label(..) | Op::Inverse(..) => Some(before.unwrap_or(0)),
                _ if op.remembers() => before.map(|s| s + 1),
                _ => before,
            };
        }
        let mut whole = vec![false; m];
        whole[output] = true;
        for k in (0..m).filter(|k| stage[*k].is_some() && !front.taken[*k]) {
            let op = &graph.nodes[k].op;
            whole[k] |= op.remembers();
            for i in op.inputs().into_iter().filter(|i| !front.taken[*i]) {
                whole[i] |= op.remembers() || (stage[i].is_some() && stage[i] < stage[k]);
            }
        }
        let stages = stage.iter().flatten().max().map_or(0, |s| s + 1);
        let first = graph.first();
        let mut out = Self {
            graph,
            record,
            theta: theta.to_vec(),
            first,
            run,
            output,
            stage,
            stages,
            whole,
            looks: front.looks.clone(),
            front,
            look: vec![Vec::new(); m],
            decays: vec![Vec::new(); m],
        };
        out.look_up();
        out.find_decays();
        out
    }

    /// Places of all label nodes on their axes; labels on one axis at one node share them.
    fn look_up(&mut self) {
        let graph = self.graph;
        for k in (0..graph.nodes.len()).filter(|k| self.stage[*k].is_some()) {
            let Op::Label(l, at) = &graph.nodes[k].op else { continue };
            for (node, axis) in at.iter().zip(&graph.labels[*l].axes) {
                let known = self.looks.iter().position(|o| o.node == *node && o.points == axis.points);
                let place = known.unwrap_or_else(|| {
                    self.looks.push(Arc::new(LookUp::new(*node, &axis.points, &self.run.values[*node])));
                    self.looks.len() - 1
                });
                self.look[k].push(place);
            }
        }
    }

    /// Values of the output.
    pub(crate) fn values(&self) -> &[f64] {
        &self.run.values[self.output]
    }

    fn samples(&self) -> usize {
        self.record.time_s.len()
    }

    /// Samples of part `p`.
    fn part(&self, p: usize) -> Range<usize> {
        let n = self.samples();
        n * p / PARTS..n * (p + 1) / PARTS
    }

    /// Cells that count at sample `t` of node `k`, which reads label `l`, the derivatives of the node with respect to them, and how many they
    /// are.
    fn corners(&self, k: usize, l: usize, t: usize) -> ([usize; 4], [f64; 4], usize) {
        if let Op::Inverse(..) = self.graph.nodes[k].op {
            let found = self.graph.read_cells(k, t, &self.theta, &self.first, &self.run);
            let (_, cells, weights, n) = found.unwrap_or((l, [0; 4], [0.0; 4], 0));
            return (cells.map(|c| c + self.first[l]), weights, n);
        }
        let at = |i: usize| {
            let look = &self.looks[self.look[k][i]];
            (usize::from(look.below[t]), look.share[t])
        };
        let from = self.first[l];
        match self.look[k].len() {
            0 => ([from, 0, 0, 0], [1.0, 0.0, 0.0, 0.0], 1),
            1 => {
                let (i, s) = at(0);
                ([from + i, from + i + 1, 0, 0], [1.0 - s, s, 0.0, 0.0], 2)
            }
            _ => {
                let ((i, s), (j, r)) = (at(0), at(1));
                let n = self.graph.labels[l].axes[0].points.len();
                let c = from + j * n + i;
                (
                    [c, c + 1, c + n, c + n + 1],
                    [(1.0 - s) * (1.0 - r), s * (1.0 - r), (1.0 - s) * r, s * r],
                    4,
                )
            }
        }
    }

    /// Places in a map over a piece: the lowest of the four cells, and the shares along both axes; none for what is no map.
    fn plane(
        &self,
        k: usize,
        l: usize,
        piece: Range<usize>,
    ) -> Option<impl Iterator<Item = (usize, f64, f64)> + '_> {
        let [x, y] = self.look[k][..] else { return None };
        let (n, first) = (self.row(l), self.first[l]);
        let along = move |look: usize| {
            let look = &self.looks[look];
            let whole = look.below[piece.clone()].iter().map(|i| usize::from(*i));
            whole.zip(look.share[piece.clone()].iter().copied())
        };
        Some(along(x).zip(along(y)).map(move |((i, s), (j, r))| (first + j * n + i, s, r)))
    }

    /// Cells of label `l` along its first axis.
    fn row(&self, l: usize) -> usize {
        self.graph.labels[l].axes.first().map_or(1, |a| a.points.len())
    }

    /// Adds what reaches label node `k` over a piece to its cells.
    fn to_cells(&self, k: usize, l: usize, piece: Range<usize>, own: &[f64], cells: &mut [f64]) {
        let n = self.row(l);
        match self.plane(k, l, piece.clone()) {
            Some(at) => own.iter().zip(at).for_each(|(g, (c, s, r))| {
                let (low, high) = (g * (1.0 - r), g * r);
                cells[c] += low * (1.0 - s);
                cells[c + 1] += low * s;
                cells[c + n] += high * (1.0 - s);
                cells[c + n + 1] += high * s;
            }),
            None => own.iter().enumerate().for_each(|(i, g)| {
                let (at, weights, n) = self.corners(k, l, piece.start + i);
                (0..n).for_each(|c| cells[at[c]] += g * weights[c]);
            }),
        }
    }

    /// Calls `take` with cells that samples visit, which `counts` says of each: sum of their weights there, and of the squares of these.
    pub(crate) fn visits(&self, counts: &[bool], take: &mut dyn FnMut(usize, [f64; 2])) {
        self.front.visits(counts, |sum| self.stage[sum].is_some(), take);
        let own = |k: &usize| self.stage[*k].is_some() && !self.front.taken[*k];
        for k in (0..self.graph.nodes.len()).filter(own) {
            let (Op::Label(l, _) | Op::Inverse(l, _)) = self.graph.nodes[k].op else { continue };
            for t in (0..self.samples()).filter(|t| counts[*t]) {
                let (cells, weights, n) = self.corners(k, l, t);
                // Shares of a visit: of a label read these are the weights themselves.
                let all: f64 = weights[..n].iter().map(|w| w.abs()).sum();
                (0..n).filter(|c| weights[*c] != 0.0).for_each(|c| {
                    let share = weights[c].abs() / all;
                    take(cells[c], [share, share * share]);
                });
            }
        }
    }

    /// `J v`, a number for each sample; `v` has one for each cell.
    pub fn forward(&self, v: &[f64]) -> Vec<f64> {
        let (n, m) = (self.samples(), self.graph.nodes.len());
        let mut d: Vec<Vec<f64>> =
            (0..m).map(|k| if self.whole[k] { vec![0.0; n] } else { Vec::new() }).collect();
        let tables = self.front.tables(v);
        for stage in 0..self.stages {
            for k in (0..m).filter(|k| self.stage[*k] == Some(stage) && self.graph.nodes[*k].op.remembers()) {
                let (mut dy, mut dm) = (std::mem::take(&mut d[k]), 0.0);
                let done = self.remember_forward(k, &d, &mut dy);
                for t in 0..if done { 0 } else { n } {
                    dy[t] = self.graph.tangent(
                        k,
                        t,
                        v,
                        &self.theta,
                        &self.first,
                        self.record,
                        &self.run,
                        &d,
                        &dy,
                        &mut dm,
                    );
                }
                d[k] = dy;
            }
            let found: Vec<Piece> =
                (0..PARTS).into_par_iter().map(|p| self.part_forward(p, stage, v, &tables, &d)).collect();
            for (p, piece) in found.into_iter().enumerate() {
                for (k, values) in piece.into_iter().enumerate().filter(|(_, values)| !values.is_empty()) {
                    d[k][self.part(p)].copy_from_slice(&values);
                }
            }
        }
        std::mem::take(&mut d[self.output])
    }

    /// Whether node `k` is taken in pieces at this stage.
    fn instant(&self, k: usize, stage: usize) -> bool {
        self.stage[k] == Some(stage) && !self.front.taken[k] && !self.graph.nodes[k].op.remembers()
    }

    /// Derivatives of the nodes of a stage that are needed as a whole, over one part.
    fn part_forward(&self, p: usize, stage: usize, v: &[f64], tables: &[Vec<f64>], d: &[Vec<f64>]) -> Piece {
        let m = self.graph.nodes.len();
        let mut out: Piece = vec![Vec::new(); m];
        let mut near: Piece = vec![Vec::new(); m];
        let all = self.part(p);
        for from in all.clone().step_by(PIECE) {
            let piece = from..(from + PIECE).min(all.end);
            for k in (0..m).filter(|k| self.instant(*k, stage)) {
                let mut own = std::mem::take(&mut near[k]);
                own.clear();
                own.resize(piece.len(), 0.0);
                self.tangents_of(k, stage, piece.clone(), v, d, &near, &mut own);
                self.front.forward(k, tables, piece.clone(), &mut own);
                if self.whole[k] {
                    out[k].extend_from_slice(&own);
                }
                near[k] = own;
            }
        }
        out
    }

    fn tangents_of(
        &self,
        k: usize,
        stage: usize,
        piece: Range<usize>,
        v: &[f64],
        d: &[Vec<f64>],
        near: &[Vec<f64>],
        own: &mut [f64],
    ) {
        let op = &self.graph.nodes[k].op;
        let from = piece.start;
        if let Op::Label(l, _) | Op::Inverse(l, _) = op {
            let n = self.row(*l);
            match self.plane(k, *l, piece.clone()) {
                Some(at) => own.iter_mut().zip(at).for_each(|(own, (c, s, r))| {
                    let (low, high) =
                        (v[c] + s * (v[c + 1] - v[c]), v[c + n] + s * (v[c + n + 1] - v[c + n]));
                    *own = low + r * (high - low);
                }),
                None => own.iter_mut().enumerate().for_each(|(i, own)| {
                    let (cells, weights, n) = self.corners(k, *l, from + i);
                    *own = (0..n).map(|c| weights[c] * v[cells[c]]).sum();
                }),
            }
        }
        for (which, input) in op.inputs().into_iter().enumerate() {
            if self.stage[input].is_none() || self.front.taken[input] {
                continue;
            }
            let dx = if self.instant(input, stage) { &near[input][..] } else { &d[input][piece.clone()] };
            match op {
                Op::Add(_) => own.iter_mut().zip(dx).for_each(|(o, d)| *o += d),
                _ => {
                    let factors = self.partials(k, which, piece.clone());
                    own.iter_mut().zip(dx).zip(factors.iter()).for_each(|((o, d), f)| *o += d * f);
                }
            }
        }
    }

    /// Derivatives of node `k` over a piece; products of two are the rule.
    fn partials(&self, k: usize, which: usize, piece: Range<usize>) -> Cow<'_, [f64]> {
        match &self.graph.nodes[k].op {
            Op::Multiply(i) if i.len() == 2 => Cow::Borrowed(&self.run.values[i[1 - which]][piece]),
            _ => Cow::Owned(piece.map(|t| self.partial(k, which, t)).collect()),
        }
    }

    /// Derivative of node `k`, which knows only its sample, with respect to what enters at place `which`.
    fn partial(&self, k: usize, which: usize, t: usize) -> f64 {
        let x = |i: &usize| self.run.values[*i][t];
        let of = |holds: bool| if holds { 1.0 } else { 0.0 };
        match &self.graph.nodes[k].op {
            Op::Add(_) => 1.0,
            Op::Subtract(..) => [1.0, -1.0][which],
            Op::Multiply(i) => {
                let others = i.iter().enumerate().filter(|(a, _)| *a != which);
                others.map(|(_, i)| x(i)).product()
            }
            Op::Divide(_, b) if which == 0 => 1.0 / x(b),
            Op::Divide(a, b) => -x(a) / (x(b) * x(b)),
            Op::Min(a, b) => of((x(a) <= x(b)) == (which == 0)),
            Op::Max(a, b) => of((x(a) >= x(b)) == (which == 0)),
            Op::Switch(c, ..) => of(which > 0 && (x(c) > 0.0) == (which == 1)),
            Op::Label(l, at) => {
                let label = &self.graph.labels[*l];
                let place: Vec<f64> = at.iter().map(x).collect();
                slopes(label, &self.theta[self.first[*l]..self.first[*l] + label.len()], &place)[which]
            }
            Op::Inverse(l, a) => {
                let label = &self.graph.labels[*l];
                label.inverse(&self.theta[self.first[*l]..self.first[*l] + label.len()], x(a)).1
            }
            _ => 0.0,
        }
    }

    /// `J'u`, a number for each cell; `u` has one for each sample.
    pub fn backward(&self, u: &[f64]) -> Vec<f64> {
        let (n, m) = (self.samples(), self.graph.nodes.len());
        let mut bar: Vec<Vec<f64>> =
            (0..m).map(|k| if self.whole[k] { vec![0.0; n] } else { Vec::new() }).collect();
        bar[self.output].copy_from_slice(u);
        let mut out = vec![0.0; self.theta.len()];
        for stage in (0..self.stages).rev() {
            let found: Vec<(Piece, Vec<f64>)> =
                (0..PARTS).into_par_iter().map(|p| self.part_backward(p, stage, &bar)).collect();
            for (p, (piece, cells)) in found.into_iter().enumerate() {
                out.iter_mut().zip(cells).for_each(|(o, c)| *o += c);
                for (k, values) in piece.into_iter().enumerate().filter(|(_, values)| !values.is_empty()) {
                    bar[k][self.part(p)].iter_mut().zip(values).for_each(|(b, v)| *b += v);
                }
            }
            for k in (0..m).rev().filter(|k| self.stage[*k] == Some(stage)) {
                if self.graph.nodes[k].op.remembers() && !self.remember_backward(k, &mut bar) {
                    self.graph.hand_back(
                        k,
                        &self.theta,
                        &self.first,
                        self.record,
                        &self.run,
                        &mut bar,
                        &mut out,
                    );
                }
            }
        }
        out
    }

    /// What the nodes of a stage hand to nodes before it, over one part, and to the cells.
    fn part_backward(&self, p: usize, stage: usize, bar: &[Vec<f64>]) -> (Piece, Vec<f64>) {
        let m = self.graph.nodes.len();
        let mut out: Piece = vec![Vec::new(); m];
        let mut cells = vec![0.0; self.theta.len()];
        let mut tables = self.front.none();
        let mut near: Piece = vec![Vec::new(); m];
        let all = self.part(p);
        for from in all.clone().step_by(PIECE) {
            let piece = from..(from + PIECE).min(all.end);
            for k in (0..m).filter(|k| self.instant(*k, stage)) {
                near[k].clear();
                match self.whole[k] {
                    true => near[k].extend_from_slice(&bar[k][piece.clone()]),
                    false => near[k].resize(piece.len(), 0.0),
                }
            }
            for k in (0..m).rev().filter(|k| self.instant(*k, stage)) {
                let own = std::mem::take(&mut near[k]);
                if let Op::Label(l, _) | Op::Inverse(l, _) = self.graph.nodes[k].op {
                    self.to_cells(k, l, piece.clone(), &own, &mut cells);
                }
                self.front.backward(k, &mut tables, piece.clone(), &own);
                for (which, input) in self.graph.nodes[k].op.inputs().into_iter().enumerate() {
                    if self.stage[input].is_none() || self.front.taken[input] {
                        continue;
                    }
                    let offset = from - all.start;
                    let to = if self.instant(input, stage) {
                        &mut near[input][..]
                    } else {
                        out[input].resize(all.len(), 0.0);
                        &mut out[input][offset..offset + piece.len()]
                    };
                    if let Op::Add(_) = self.graph.nodes[k].op {
                        to.iter_mut().zip(&own).for_each(|(t, g)| *t += g);
                    } else {
                        let factors = self.partials(k, which, piece.clone());
                        to.iter_mut().zip(&own).zip(factors.iter()).for_each(|((t, g), f)| *t += g * f);
                    }
                }
                near[k] = own;
            }
        }
        self.front.gather(&tables, &mut cells);
        (out, cells)
    }
}
