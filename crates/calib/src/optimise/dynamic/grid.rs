//! The grid of one or two remembered values, and the value of each stage on it.

use super::stage::Stages;

/// Evenly spaced points.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) cells: usize,
    /// Whether values outside cannot be: an input within its bounds.
    pub(super) closed: bool,
}

impl Axis {
    fn point(&self, k: usize) -> f64 {
        self.low + (self.high - self.low) * k as f64 / self.cells as f64
    }

    /// Cell of a value, and its place in it: outside of 0 to 1 beyond the ends.
    fn place(&self, v: f64) -> (usize, f64) {
        let at = (v - self.low) / (self.high - self.low) * self.cells as f64;
        let cell = at.floor().clamp(0.0, (self.cells - 1) as f64);
        (cell as usize, at - cell)
    }

    pub(super) fn holds(&self, v: f64) -> bool {
        self.closed || (self.low..=self.high).contains(&v)
    }

    pub(super) fn widen(&mut self, share: f64) {
        let more = share * (self.high - self.low);
        (self.low, self.high) = (self.low - more, self.high + more);
    }

    /// The same with half the cells.
    pub(super) fn coarser(&self) -> Self {
        Self { cells: (self.cells / 2).max(1), ..self.clone() }
    }
}

/// Values of all stages over one or two axes.
pub(super) struct Grid {
    pub(super) axes: Vec<Axis>,
    /// Stage by stage; the last one is zero.
    values: Vec<Vec<f64>>,
}

impl Grid {
    pub(super) fn new(axes: Vec<Axis>) -> Self {
        Self { axes, values: Vec::new() }
    }

    /// Goes through the stages from the last to the first; stages that an interruption leaves out are zero.
    pub(super) fn fill(mut self, stages: &Stages<'_>, interrupt: &dyn Fn() -> bool) -> Self {
        let count = self.axes.iter().map(|a| a.cells + 1).product();
        let mut work = stages.work();
        self.values = vec![vec![0.0; count]; stages.count() + 1];
        for k in (0..stages.count()).rev() {
            if interrupt() {
                break;
            }
            let mut now = vec![0.0; count];
            for (node, v) in now.iter_mut().enumerate() {
                let state = self.state(node);
                *v = stages.best(k, &state, &self, &mut work).0;
            }
            self.values[k] = now;
        }
        self
    }

    fn state(&self, mut node: usize) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.axes.len());
        for axis in &self.axes {
            out.push(axis.point(node % (axis.cells + 1)));
            node /= axis.cells + 1;
        }
        out
    }

    /// Value of stage `k`, linear between the points and on beyond the ends.
    pub(super) fn value(&self, k: usize, state: &[f64]) -> f64 {
        let values = &self.values[k];
        let (i, a) = self.axes[0].place(state[0]);
        let along = |from: usize| values[from + i] * (1.0 - a) + values[from + i + 1] * a;
        match self.axes.get(1) {
            None => along(0),
            Some(axis) => {
                let (j, b) = axis.place(state[1]);
                let row = self.axes[0].cells + 1;
                along(j * row) * (1.0 - b) + along((j + 1) * row) * b
            }
        }
    }
}
