//! A label: its cells with axes, base values, and what they shall keep.

use serde::{Deserialize, Serialize};

use crate::error::LabelError;
use crate::rows::{Rows, between};

/// Breakpoints of a label.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Quantity that enters.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Breakpoints, strictly increasing.
    pub points: Vec<f64>,
    /// Share of the smoothness of this axis; 0 for none.
    pub smooth: f64,
    /// Least and greatest gradient along it, in units of the label over units of the axis; 0 on one side means monotone.
    pub gradient: [f64; 2],
    /// 1 for convex, -1 for concave, 0 for neither.
    pub convex: i8,
}

impl Axis {
    /// An axis without demands, smoothness 1.
    pub fn new(name: &str, unit: &str, points: &[f64]) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            points: points.to_vec(),
            smooth: 1.0,
            gradient: [f64::NEG_INFINITY, f64::INFINITY],
            convex: 0,
        }
    }
}

/// A scalar (no axis), a curve (one) or a map (two).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// Name.
    pub name: String,
    /// Unit of the values.
    pub unit: String,
    /// Axes, x first.
    pub axes: Vec<Axis>,
    /// Values as they are, x fastest.
    pub base: Vec<f64>,
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// Step between two values that the ECU can hold; none of a floating label.
    pub step: Option<f64>,
    /// One of the values that it can hold (the others lie whole steps away).
    pub origin: f64,
    /// Cells that are never altered.
    pub locked: Vec<bool>,
    /// Weight of the base values, in samples: so many measurements that the present value is right.
    pub base_weight: f64,
    /// Size of each cell in which the roughness is measured, positive; empty for 1. With the base as size the change of a cell counts as
    /// a share of what was there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sizes: Vec<f64>,
}

/// A limit `sum_j c_j theta_j >= d` of the cells of one label.
#[derive(Clone, Debug, PartialEq)]
pub struct Limit {
    /// Cells and factors.
    pub terms: Vec<(usize, f64)>,
    /// Least value of the sum.
    pub least: f64,
    /// In words.
    pub what: String,
}

impl Label {
    /// A label over `axes` without demands.
    pub fn new(name: &str, unit: &str, axes: Vec<Axis>, base: &[f64]) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            axes,
            base: base.to_vec(),
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            step: None,
            origin: 0.0,
            locked: vec![false; base.len()],
            base_weight: 0.0,
            sizes: Vec::new(),
        }
    }

    /// A scalar.
    pub fn scalar(name: &str, unit: &str, base: f64) -> Self {
        Self::new(name, unit, Vec::new(), &[base])
    }

    /// A curve over one axis.
    pub fn curve(name: &str, unit: &str, x: &str, x_unit: &str, points: &[f64], base: &[f64]) -> Self {
        Self::new(name, unit, vec![Axis::new(x, x_unit, points)], base)
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.base.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.base.is_empty()
    }

    /// Checks axes, values and demands.
    ///
    /// # Errors
    /// [`LabelError::Label`].
    pub fn check(&self) -> Result<(), LabelError> {
        let fail = |reason: String| Err(LabelError::label(&self.name, reason));
        if self.axes.len() > 2 {
            return fail(format!("found {} axes, expected at most 2", self.axes.len()));
        }
        for a in &self.axes {
            if a.points.len() < 2 || !a.points.windows(2).all(|w| w[1] > w[0]) {
                return fail(format!("axis `{}` needs two or more breakpoints that increase", a.name));
            }
            let finite = a.points.iter().all(|p| p.is_finite()) && a.smooth.is_finite();
            if !finite || a.smooth < 0.0 {
                return fail(format!(
                    "axis `{}`: found a number that is not finite, or a negative smoothness",
                    a.name
                ));
            }
            if !(a.gradient[0] <= a.gradient[1]) {
                return fail(format!(
                    "axis `{}`: found a gradient of {} to {}, expected the least first",
                    a.name, a.gradient[0], a.gradient[1]
                ));
            }
        }
        let wanted: usize = self.axes.iter().map(|a| a.points.len()).product();
        if self.base.len() != wanted || self.locked.len() != wanted {
            return fail(format!("found {} values, expected {wanted}", self.base.len()));
        }
        if !self.base.iter().all(|v| v.is_finite()) {
            return fail("found a value that is not finite".into());
        }
        if !self.sizes.is_empty()
            && (self.sizes.len() != wanted || !self.sizes.iter().all(|s| *s > 0.0 && s.is_finite()))
        {
            return fail(format!("found {} sizes, expected {wanted} that are positive", self.sizes.len()));
        }
        if let Some(a) = self.axes.iter().find(|a| !(-1..=1).contains(&a.convex)) {
            return fail(format!("axis `{}`: found convex = {}, expected 1, 0 or -1", a.name, a.convex));
        }
        if !(self.lower <= self.upper) || self.step.is_some_and(|s| !(s > 0.0 && s.is_finite())) {
            return fail("found limits the wrong way round, or a step that is not positive".into());
        }
        if !(self.base_weight >= 0.0 && self.base_weight.is_finite()) {
            return fail(format!("found the weight {} of the base, expected 0 or more", self.base_weight));
        }
        Ok(())
    }

    /// Cells around the point `at` (one value an axis) and their weights: `1`, `(1-s), s`, or the four products.
    pub fn weights(&self, at: &[f64]) -> ([usize; 4], [f64; 4], usize) {
        match self.axes.as_slice() {
            [] => ([0; 4], [1.0, 0.0, 0.0, 0.0], 1),
            [x] => {
                let (i, s) = between(&x.points, at[0]);
                ([i, i + 1, 0, 0], [1.0 - s, s, 0.0, 0.0], 2)
            }
            [x, y, ..] => {
                let ((i, s), (j, t)) = (between(&x.points, at[0]), between(&y.points, at[1]));
                let n = x.points.len();
                let cell = j * n + i;
                let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
                ([cell, cell + 1, cell + n, cell + n + 1], weights, 4)
            }
        }
    }

    /// Adds `factor` times this label at `at` to the last row; `offset` is the number of its first cell.
    pub fn enter(&self, rows: &mut Rows, offset: usize, factor: f64, at: &[f64]) {
        let (cells, weights, n) = self.weights(at);
        (0..n).for_each(|k| rows.push(offset + cells[k], factor * weights[k]));
    }

    /// Value at `at` with the cells `values`.
    pub fn value(&self, values: &[f64], at: &[f64]) -> f64 {
        let (cells, weights, n) = self.weights(at);
        (0..n).filter(|k| weights[*k] != 0.0).map(|k| weights[k] * values[cells[k]]).sum()
    }

    /// Where a curve with the increasing cells `values` has the value `v` (its ends for what is beyond), and the derivative of that place
    /// with respect to `v` (0 beyond).
    pub fn inverse(&self, values: &[f64], v: f64) -> (f64, f64) {
        let points = &self.axes[0].points;
        if v.is_nan() {
            return (f64::NAN, 0.0);
        }
        let (i, s) = between(values, v);
        let (p, h) = (points[i + 1] - points[i], values[i + 1] - values[i]);
        let inside = v >= values[0] && v < values[values.len() - 1];
        // At a breakpoint exactly the breakpoint, without rounding.
        let at = if s == 1.0 { points[i + 1] } else { points[i] + s * p };
        (at, if inside { p / h } else { 0.0 })
    }

    /// The same label on some of its breakpoints, `kept` by number for each axis, with what it has there.
    pub fn thinned(&self, kept: &[Vec<usize>]) -> Self {
        let nx = self.axes.first().map_or(1, |a| a.points.len());
        let one = vec![0];
        let (xs, ys) = (kept.first().unwrap_or(&one), kept.get(1).unwrap_or(&one));
        let cells: Vec<usize> = ys.iter().flat_map(|j| xs.iter().map(move |i| j * nx + i)).collect();
        let axes = self.axes.iter().zip(kept);
        Self {
            axes: axes
                .map(|(a, k)| Axis { points: k.iter().map(|i| a.points[*i]).collect(), ..a.clone() })
                .collect(),
            base: cells.iter().map(|c| self.base[*c]).collect(),
            locked: cells.iter().map(|c| self.locked[*c]).collect(),
            sizes: if self.sizes.is_empty() {
                Vec::new()
            } else {
                cells.iter().map(|c| self.sizes[*c]).collect()
            },
            ..self.clone()
        }
    }

    /// Values at the cells of this label of `other`, a label over the same quantities, with the cells `values`.
    pub fn sampled(&self, other: &Self, values: &[f64]) -> Vec<f64> {
        let nx = self.axes.first().map_or(1, |a| a.points.len());
        (0..self.len())
            .map(|c| {
                let at: Vec<f64> = (0..self.axes.len())
                    .map(|k| self.axes[k].points[if k == 0 { c % nx } else { c / nx }])
                    .collect();
                other.value(values, &at)
            })
            .collect()
    }

    /// Lines of cells along axis `k`.
    pub(crate) fn lines(&self, k: usize) -> Vec<Vec<usize>> {
        let nx = self.axes.first().map_or(1, |a| a.points.len());
        let ny = self.axes.get(1).map_or(1, |a| a.points.len());
        match k {
            0 => (0..ny).map(|j| (0..nx).map(|i| j * nx + i).collect()).collect(),
            _ => (0..nx).map(|i| (0..ny).map(|j| j * nx + i).collect()).collect(),
        }
    }

    /// Rows of the roughness: `|D theta|^2` is the integral of the squared second derivative along each axis, the axis as a share of
    /// its range, times its `smooth`, averaged over the lines of the other axis; values in shares of `sizes`, where there are some.
    pub fn roughness(&self) -> Vec<Vec<(usize, f64)>> {
        let mut out = Vec::new();
        for (k, axis) in self.axes.iter().enumerate().filter(|(_, a)| a.smooth > 0.0) {
            let p = &axis.points;
            let range = p[p.len() - 1] - p[0];
            let lines = self.lines(k);
            for line in &lines {
                for i in 1..p.len() - 1 {
                    let (a, b) = ((p[i] - p[i - 1]) / range, (p[i + 1] - p[i]) / range);
                    // f'' from three points, over the half intervals around the middle one.
                    let scale = (axis.smooth * 0.5 * (a + b) / lines.len() as f64).sqrt() * 2.0 / (a + b);
                    let size = |c: usize| self.sizes.get(c).copied().unwrap_or(1.0);
                    out.push(vec![
                        (line[i - 1], scale / a / size(line[i - 1])),
                        (line[i], -scale * (1.0 / a + 1.0 / b) / size(line[i])),
                        (line[i + 1], scale / b / size(line[i + 1])),
                    ]);
                }
            }
        }
        out
    }

    /// Whether cells limit each other: gradient windows or curvature.
    pub fn is_shaped(&self) -> bool {
        self.axes.iter().any(|a| a.convex != 0 || a.gradient.iter().any(|g| g.is_finite()))
    }

    /// Limits from gradients and convexity.
    pub fn limits(&self) -> Vec<Limit> {
        let mut out = Vec::new();
        for (k, axis) in self.axes.iter().enumerate() {
            let p = &axis.points;
            for line in self.lines(k) {
                for i in 1..p.len() {
                    let h = p[i] - p[i - 1];
                    let what = |side: &str| {
                        format!(
                            "`{}`: {side} gradient along `{}` from {} to {}",
                            self.name,
                            axis.name,
                            p[i - 1],
                            p[i]
                        )
                    };
                    let [least, greatest] = axis.gradient;
                    if least.is_finite() {
                        let terms = vec![(line[i], 1.0), (line[i - 1], -1.0)];
                        out.push(Limit { terms, least: least * h, what: what("least") });
                    }
                    if greatest.is_finite() {
                        let terms = vec![(line[i], -1.0), (line[i - 1], 1.0)];
                        out.push(Limit { terms, least: -greatest * h, what: what("greatest") });
                    }
                }
                if axis.convex != 0 {
                    let sign = f64::from(axis.convex.signum());
                    for i in 1..p.len() - 1 {
                        let (a, b) = (p[i] - p[i - 1], p[i + 1] - p[i]);
                        // In shares of the interval, so that the numbers have the size of the label.
                        let terms = vec![
                            (line[i - 1], sign * b / (a + b)),
                            (line[i], -sign),
                            (line[i + 1], sign * a / (a + b)),
                        ];
                        let what = format!("`{}`: curvature along `{}` at {}", self.name, axis.name, p[i]);
                        out.push(Limit { terms, least: 0.0, what });
                    }
                }
            }
        }
        out
    }
}
