//! Coarse axes: fewer breakpoints first, so that a fit starts near, and fewer breakpoints left, chosen after the fit.

use dynocal_calib::steady::breakpoints::Tables;
use dynocal_label::graph::Graph;
use dynocal_label::label::Label;
use serde::Serialize;

use super::moves;
use super::spec::Placed;

/// An axis with its chosen breakpoints.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Chosen {
    /// Name.
    pub name: String,
    /// Labels on it.
    pub labels: Vec<String>,
    /// Breakpoints that it had.
    pub had: usize,
    /// Breakpoints that are left.
    pub points: Vec<f64>,
    /// For each number of breakpoints, the root mean square of what interpolation between them loses, in shares of the ranges of the
    /// labels; the other axis has what was chosen for it.
    pub loss: Vec<(usize, f64)>,
    /// The same between the chosen breakpoints before and after they were moved, where they were.
    pub moved: Option<[f64; 2]>,
}

/// Most numbers of breakpoints for which the loss is told.
const MOST_TOLD: usize = 40;

/// Every `step`-th breakpoint of each axis of each label; the ends stay, and those of locked cells: a value that is given by definition
/// settles the size of others.
pub(super) fn every(graph: &Graph, step: usize) -> Graph {
    let labels = graph.labels.iter().map(|l| {
        let nx = l.axes.first().map_or(1, |a| a.points.len());
        let locked: Vec<[usize; 2]> =
            (0..l.len()).filter(|c| l.locked[*c]).map(|c| [c % nx, c / nx]).collect();
        let kept: Vec<Vec<usize>> = l
            .axes
            .iter()
            .enumerate()
            .map(|(k, a)| {
                let n = a.points.len();
                let stays = |i: &usize| {
                    i.is_multiple_of(step.max(1)) || *i == n - 1 || locked.iter().any(|c| c[k] == *i)
                };
                (0..n).filter(stays).collect()
            })
            .collect();
        l.thinned(&kept)
    });
    Graph { labels: labels.collect(), nodes: graph.nodes.clone() }
}

/// Cells of `graph` from those of `coarse`.
pub(super) fn spread(graph: &Graph, coarse: &Graph, values: &[f64]) -> Vec<f64> {
    let mut from = 0;
    let mut out = Vec::new();
    for (l, c) in graph.labels.iter().zip(&coarse.labels) {
        out.extend(l.sampled(c, &values[from..from + c.len()]));
        from += c.len();
    }
    out
}

/// The function on the breakpoints that are chosen for the values `theta`, with these values there, and what was chosen.
pub(super) fn place(graph: &Graph, placed: &[Placed], theta: &[f64]) -> (Graph, Vec<Chosen>) {
    let mut fitted = graph.labels.clone();
    let mut from = 0;
    for l in &mut fitted {
        l.base = theta[from..from + l.len()].to_vec();
        from += l.len();
    }
    let mut kept: Vec<Vec<Vec<usize>>> =
        fitted.iter().map(|l| l.axes.iter().map(|a| (0..a.points.len()).collect()).collect()).collect();
    let mut chosen = Vec::new();
    // Breakpoints of the axes of labels that were moved.
    let mut elsewhere: Vec<((usize, usize), Vec<f64>)> = Vec::new();
    let mut done: Vec<&str> = Vec::new();
    for p in placed {
        if done.contains(&p.name.as_str()) {
            continue;
        }
        // The second axis of the same labels is searched with it, where it is placed as well.
        let partner = partner(&fitted, p);
        let other =
            partner.as_ref().and_then(|name| placed.iter().find(|o| o.name == *name && touches(o, p)));
        let all: Vec<&Placed> = std::iter::once(p).chain(other).collect();
        done.extend(all.iter().map(|a| a.name.as_str()));
        let group = group(&fitted, p, other, partner.as_deref());
        let counts: Vec<usize> = group
            .names
            .iter()
            .zip(&group.tables.axes)
            .map(|(n, a)| all.iter().find(|q| q.name == *n).map_or(a.len(), |q| q.count))
            .collect();
        let best = group.tables.choose(&counts);
        let mut points: Vec<Vec<f64>> =
            best.iter().zip(&group.tables.axes).map(|(k, a)| k.iter().map(|i| a[*i]).collect()).collect();
        let free: Vec<Vec<bool>> = (0..points.len())
            .map(|k| {
                let mover = all.iter().find(|q| q.moves && q.name == group.names[k]);
                best[k].iter().map(|i| mover.is_some_and(|q| !holds(&fitted, q, *i))).collect()
            })
            .collect();
        let cells = (group.tables.weights.len() * group.tables.layers.len()) as f64;
        let moved = free
            .iter()
            .flatten()
            .any(|f| *f)
            .then(|| moves::moved(&group.tables, &mut points, &free).map(|e| (e / cells).sqrt()));
        for q in all {
            let Some(axis) = group.names.iter().position(|n| *n == q.name) else { continue };
            for (l, k) in &q.of {
                kept[*l][*k].clone_from(&best[axis]);
                if q.moves {
                    elsewhere.push(((*l, *k), points[axis].clone()));
                }
            }
            chosen.push(Chosen {
                name: q.name.clone(),
                labels: q.of.iter().map(|(l, _)| fitted[*l].name.clone()).collect(),
                had: group.tables.axes[axis].len(),
                points: points[axis].clone(),
                loss: loss(&group.tables, &counts, axis),
                moved: moved.filter(|_| q.moves),
            });
        }
    }
    let labels = graph.labels.iter().zip(&kept).enumerate().map(|(number, (l, k))| {
        let mut out = l.thinned(k);
        for ((_, axis), points) in elsewhere.iter().filter(|((own, _), _)| *own == number) {
            out.axes[*axis].points.clone_from(points);
        }
        // Base stays what it was: the values come as a start.
        out.base = out.sampled(l, &l.base);
        out
    });
    (Graph { labels: labels.collect(), nodes: graph.nodes.clone() }, chosen)
}

/// Whether a cell that is given by definition lies at breakpoint `i` of the axis.
fn holds(labels: &[Label], p: &Placed, i: usize) -> bool {
    p.of.iter().any(|(l, k)| {
        let label = &labels[*l];
        let nx = label.axes[0].points.len();
        (0..label.len()).any(|c| label.locked[c] && (if *k == 0 { c % nx } else { c / nx }) == i)
    })
}

fn touches(a: &Placed, b: &Placed) -> bool {
    a.of.iter().any(|(l, _)| b.of.iter().any(|(m, _)| l == m))
}

/// The other axis of the labels of `p`; a spec has one at most.
fn partner(labels: &[Label], p: &Placed) -> Option<String> {
    p.of.iter().find_map(|(l, k)| {
        labels[*l].axes.iter().enumerate().find(|(i, _)| i != k).map(|(_, a)| a.name.clone())
    })
}

struct Group {
    names: Vec<String>,
    tables: Tables,
}

/// All labels of an axis (and of its partner) as tables over both: a curve is constant along the other axis.
fn group(labels: &[Label], p: &Placed, other: Option<&Placed>, partner: Option<&str>) -> Group {
    let (first, at) = p.of[0];
    let mut names = vec![p.name.clone()];
    let mut axes = vec![labels[first].axes[at].points.clone()];
    let has = |l: &Label, name: &str| l.axes.iter().position(|a| a.name == name);
    if let Some(name) = partner {
        names.push(name.to_string());
        let with =
            p.of.iter().find_map(|(l, _)| has(&labels[*l], name).map(|k| labels[*l].axes[k].points.clone()));
        axes.push(with.unwrap_or_default());
    }
    let mut members: Vec<usize> = p.of.iter().map(|(l, _)| *l).collect();
    members.extend(other.into_iter().flat_map(|o| o.of.iter().map(|(l, _)| *l)));
    members.sort_unstable();
    members.dedup();
    let width = axes.get(1).map_or(1, Vec::len);
    let layers = members.iter().map(|m| {
        let l = &labels[*m];
        let range = l.base.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |r, v| (r.0.min(*v), r.1.max(*v)));
        // A label without a range loses nothing.
        let scale = if range.1 > range.0 { 1.0 / (range.1 - range.0) } else { 0.0 };
        (0..axes[0].len() * width)
            .map(|c| {
                let place = [c / width, c % width];
                let at: Vec<f64> = l
                    .axes
                    .iter()
                    .map(|a| {
                        names.iter().position(|n| *n == a.name).map_or(a.points[0], |k| axes[k][place[k]])
                    })
                    .collect();
                scale * l.value(&l.base, &at)
            })
            .collect()
    });
    let layers: Vec<Vec<f64>> = layers.collect();
    let weights = vec![1.0; axes[0].len() * width];
    Group { names, tables: Tables { axes, layers, weights } }
}

/// The loss over the number of breakpoints of one axis.
fn loss(tables: &Tables, counts: &[usize], axis: usize) -> Vec<(usize, f64)> {
    let cells = (tables.weights.len() * tables.layers.len()) as f64;
    (2..=tables.axes[axis].len().min(MOST_TOLD))
        .map(|n| {
            let mut counts = counts.to_vec();
            counts[axis] = n;
            (n, (tables.error(&tables.choose(&counts)) / cells).sqrt())
        })
        .collect()
}
