//! Where cells stand in the matrices near that of a step, and the coarse functions of each label.

use std::ops::Range;

use crate::graph::{Graph, Op};
use crate::label::Label;
use crate::rows::between;

/// Numbers of a matrix within a group up to which its labels are taken together.
const MOST_IN_BAND: usize = 1 << 27;
/// Coarse functions in all: their matrix is held whole.
const MOST_COARSE: usize = 2048;

/// Labels that are read at the same place: their cells lie side by side, cell by cell.
pub(super) struct Group {
    pub(super) labels: Vec<usize>,
    /// Number of cells of all its labels.
    pub(super) len: usize,
    /// Farthest that places of one read, or of one row of the roughness, lie apart.
    pub(super) width: usize,
    /// Whether a label is read at several places of a sample: these count as if they were samples of their own.
    pub(super) apart: bool,
    /// Number of its first coarse function.
    pub(super) coarse: usize,
}

/// The order of all cells.
pub(super) struct Order {
    pub(super) groups: Vec<Group>,
    /// Of each label: the number of its group, and its number among the group's.
    member: Vec<(usize, usize)>,
    /// First cell of each label.
    cells: Vec<usize>,
    /// Cells along the first axis, and whether the second one runs faster.
    turned: Vec<(usize, usize, bool)>,
    /// Coarse functions of each label, and how many they are.
    hats: Vec<Hats>,
    pub(super) coarse: usize,
}

/// Coarse functions of a label: for each axis those that are straight between some of its breakpoints and 0 at the others of these.
/// Their sum along one axis is that along the other, so that the last one of the second axis is left out.
struct Hats {
    /// Of each axis: for each breakpoint the function below and the share of the next one.
    axes: Vec<Vec<(usize, f64)>>,
    /// Functions of each axis.
    count: Vec<usize>,
}

impl Hats {
    fn new(label: &Label, most: usize) -> Self {
        let (mut axes, mut count) = (Vec::new(), Vec::new());
        for a in &label.axes {
            let (n, kept) = (a.points.len(), a.points.len().min(most));
            let points: Vec<f64> = (0..kept).map(|q| a.points[q * (n - 1) / (kept - 1)]).collect();
            axes.push(a.points.iter().map(|p| between(&points, *p)).collect());
            count.push(kept);
        }
        Self { axes, count }
    }

    fn len(&self) -> usize {
        match self.count[..] {
            [] => 0,
            [x] => x,
            [x, y, ..] => x + y - 1,
        }
    }

    /// Calls `take` with each function that is not 0 at a cell, and its value there.
    fn at(&self, cell: usize, take: &mut dyn FnMut(usize, f64)) {
        let nx = self.axes.first().map_or(1, Vec::len);
        let (mut from, len) = (0, self.len());
        for (k, axis) in self.axes.iter().enumerate() {
            let (q, s) = axis[if k == 0 { cell % nx } else { cell / nx }];
            for (q, v) in [(from + q, 1.0 - s), (from + q + 1, s)] {
                if v != 0.0 && q < len {
                    take(q, v);
                }
            }
            from += self.count[k];
        }
    }
}

impl Order {
    pub(super) fn new(graph: &Graph, spans: &[Range<usize>]) -> Self {
        let turned = |l: &Label| match l.axes.as_slice() {
            [x, y] => (x.points.len(), y.points.len(), y.points.len() < x.points.len()),
            _ => (l.len(), 1, false),
        };
        let mut out = Self {
            groups: Vec::new(),
            member: vec![(0, 0); spans.len()],
            cells: spans.iter().map(|s| s.start).collect(),
            turned: graph.labels.iter().map(turned).collect(),
            hats: Vec::new(),
            coarse: 0,
        };
        let mut most = graph.labels.iter().flat_map(|l| &l.axes).map(|a| a.points.len()).max().unwrap_or(2);
        loop {
            out.hats = graph.labels.iter().map(|l| Hats::new(l, most)).collect();
            if most <= 2 || out.hats.iter().map(Hats::len).sum::<usize>() <= MOST_COARSE {
                break;
            }
            most -= 1;
        }
        for labels in together(graph) {
            out.group(graph, labels);
        }
        out
    }

    /// Adds a group, or its labels one by one where they would be too many.
    fn group(&mut self, graph: &Graph, labels: Vec<usize>) {
        let (l, members) = (labels[0], labels.len());
        let (nx, ny, turned) = self.turned[l];
        let fast = match ny {
            1 => 1,
            _ if turned => ny,
            _ => nx,
        };
        let rough = labels.iter().any(|l| !graph.labels[*l].roughness().is_empty());
        // Around a place lie the next line and the next cell in it; the roughness reaches one line further.
        let width = ((if rough { 2 * fast } else { fast + 1 } * members) + members - 1).max(members + 2);
        let len = members * graph.labels[l].len();
        if members > 1 && len.saturating_mul(width + 1) > MOST_IN_BAND {
            labels.into_iter().for_each(|l| self.group(graph, vec![l]));
            return;
        }
        let apart = reads(graph, l).len() > 1;
        for (m, l) in labels.iter().enumerate() {
            self.member[*l] = (self.groups.len(), m);
        }
        let functions = members * self.hats[l].len();
        let width = if len.saturating_mul(width + 1) > MOST_IN_BAND { 0 } else { width.min(len.max(1) - 1) };
        self.groups.push(Group { labels, len, width, apart, coarse: self.coarse });
        self.coarse += functions;
    }

    /// Group of a label, and the place of one of its cells in it.
    pub(super) fn place(&self, l: usize, cell: usize) -> (usize, usize) {
        let (g, m) = self.member[l];
        let (own, (nx, ny, turned)) = (cell - self.cells[l], self.turned[l]);
        let at = if turned { (own % nx) * ny + own / nx } else { own };
        (g, at * self.groups[g].labels.len() + m)
    }

    /// Calls `take` with the number of each coarse function that is not 0 at a cell of label `l`, and its value.
    pub(super) fn functions(&self, l: usize, cell: usize, take: &mut dyn FnMut(usize, f64)) {
        let (g, m) = self.member[l];
        let group = &self.groups[g];
        let members = group.labels.len();
        self.hats[l].at(cell - self.cells[l], &mut |q, v| take(group.coarse + q * members + m, v));
    }

    /// Label of each coarse function.
    pub(super) fn owners(&self) -> Vec<usize> {
        let mut out = vec![0; self.coarse];
        for group in &self.groups {
            for (m, l) in group.labels.iter().enumerate() {
                (0..self.hats[*l].len()).for_each(|q| out[group.coarse + q * group.labels.len() + m] = *l);
            }
        }
        out
    }
}

/// Nodes that each place of label `l` comes from.
fn reads(graph: &Graph, l: usize) -> Vec<&Vec<usize>> {
    let of = |n: &'_ crate::graph::Node| matches!(n.op, Op::Label(label, _) if label == l);
    let nodes = graph.nodes.iter().filter(|n| of(n));
    nodes
        .filter_map(|n| match &n.op {
            Op::Label(_, at) => Some(at),
            _ => None,
        })
        .collect()
}

/// Labels that are read at the same place, once each.
fn together(graph: &Graph) -> Vec<Vec<usize>> {
    let points = |l: usize| graph.labels[l].axes.iter().map(|a| &a.points);
    let same = |a: usize, b: usize| {
        let (x, y) = (reads(graph, a), reads(graph, b));
        x.len() == 1 && x == y && points(a).eq(points(b))
    };
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for l in 0..graph.labels.len() {
        match groups.iter_mut().find(|g| same(g[0], l)) {
            Some(g) => g.push(l),
            None => groups.push(vec![l]),
        }
    }
    groups
}
