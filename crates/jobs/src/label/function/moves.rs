//! Breakpoints that leave the places where the fit had them.

use dynocal_calib::steady::breakpoints::Tables;
use dynocal_label::label::{Axis, Label};

/// Most rounds over all breakpoints, and the gain of one, as a share, from which another one follows.
const ROUNDS: usize = 50;
const GAIN: f64 = 1e-4;
/// Halvings of the range in which a breakpoint is looked for.
const HALVINGS: usize = 24;
/// Golden section.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// The tables as labels over the axes `points`, with what the whole tables have there.
struct Fine<'a> {
    tables: &'a Tables,
    layers: Vec<Label>,
}

/// A label over one or two axes; tables have their last axis fastest, labels their first.
fn over(axes: &[Vec<f64>], values: &[f64]) -> Label {
    let own = axes.iter().rev().map(|a| Axis::new("", "-", a)).collect();
    Label::new("", "-", own, values)
}

impl Fine<'_> {
    /// Weighted squares that straight lines between `points` lose.
    fn lost(&self, points: &[Vec<f64>]) -> f64 {
        let empty = vec![0.0; points.iter().map(Vec::len).product()];
        let mut coarse = over(points, &empty);
        let width = self.tables.axes.get(1).map_or(1, Vec::len);
        let mut sum = 0.0;
        for fine in &self.layers {
            coarse.base = coarse.sampled(fine, &fine.base);
            for (k, v) in fine.base.iter().enumerate().filter(|(k, _)| self.tables.weights[*k] > 0.0) {
                let at = [k / width, k % width];
                let place: Vec<f64> = self.tables.axes.iter().zip(at).map(|(a, i)| a[i]).rev().collect();
                sum += self.tables.weights[k] * (v - coarse.value(&coarse.base, &place)).powi(2);
            }
        }
        sum
    }
}

/// Moves the breakpoints `points` of each axis where `free`, one after the other, each between its neighbours, as long as less is lost;
/// the squares that are lost at first and at last. Breakpoints at the ends stay.
pub(super) fn moved(tables: &Tables, points: &mut [Vec<f64>], free: &[Vec<bool>]) -> [f64; 2] {
    let layers = tables.layers.iter().map(|l| over(&tables.axes, l)).collect();
    let fine = Fine { tables, layers };
    let first = fine.lost(points);
    let mut least = first;
    for _ in 0..ROUNDS {
        let before = least;
        for (axis, free) in free.iter().enumerate() {
            for q in 1..points[axis].len().max(1) - 1 {
                if free[q] {
                    least = one(&fine, points, (axis, q), least);
                }
            }
        }
        if !(before - least > GAIN * before) {
            break;
        }
    }
    [first, least]
}

/// One breakpoint by golden section, within the breakpoints of the whole table beside it and its neighbours; what is lost then.
fn one(fine: &Fine, points: &mut [Vec<f64>], (axis, q): (usize, usize), least: f64) -> f64 {
    let (p, all) = (&points[axis], &fine.tables.axes[axis]);
    let own = p[q];
    let near = 1e-6 * (all[all.len() - 1] - all[0]);
    let below = all.iter().copied().filter(|a| *a < own - near).fold(p[q - 1], f64::max);
    let above = all.iter().copied().filter(|a| *a > own + near).fold(p[q + 1], f64::min);
    // Neighbours keep a distance, or two breakpoints would be one.
    let (mut a, mut b) = (below.max(p[q - 1] + near), above.min(p[q + 1] - near));
    let mut lost = |x: f64| {
        points[axis][q] = x;
        fine.lost(points)
    };
    let mut pair = [b - GOLDEN * (b - a), a + GOLDEN * (b - a)];
    let mut found = pair.map(&mut lost);
    for _ in 0..HALVINGS {
        if found[0] <= found[1] {
            b = pair[1];
            pair = [b - GOLDEN * (b - a), pair[0]];
            found = [lost(pair[0]), found[0]];
        } else {
            a = pair[0];
            pair = [pair[1], a + GOLDEN * (b - a)];
            found = [found[1], lost(pair[1])];
        }
    }
    let best = if found[0] <= found[1] { 0 } else { 1 };
    // Where nothing is gained it stays.
    let (x, value) = if found[best] < least { (pair[best], found[best]) } else { (own, least) };
    points[axis][q] = x;
    value
}
