//! What a function would be without memory: rows of J at single samples, for matrices that are near those of the fit.

use rayon::prelude::*;

use super::Products;
use crate::graph::Op;

/// A label read at a sample: its number, the derivative of the output with respect to what is read, the cells around the place, their
/// weights, and how many they are.
pub(crate) struct Read {
    pub(crate) label: usize,
    pub(crate) slope: f64,
    pub(crate) cells: [usize; 4],
    pub(crate) weights: [f64; 4],
    pub(crate) count: usize,
}

impl Products<'_> {
    /// Nodes between labels and output, the last first, with what enters them.
    pub(crate) fn on_the_way(&self) -> Vec<(usize, Vec<usize>)> {
        let led = (0..=self.output).rev().filter(|k| self.stage[*k].is_some());
        led.map(|k| (k, self.graph.nodes[k].op.inputs())).collect()
    }

    /// The row of J at sample `t`, as if the function had no memory; `nodes` are those of [`Products::on_the_way`].
    pub(crate) fn read_at(&self, t: usize, nodes: &[(usize, Vec<usize>)], take: &mut dyn FnMut(Read)) {
        let mut bar = vec![0.0; self.graph.nodes.len()];
        bar[self.output] = 1.0;
        for (k, inputs) in nodes {
            let (slope, op) = (bar[*k], &self.graph.nodes[*k].op);
            if slope == 0.0 {
                continue;
            }
            for (which, input) in inputs.iter().enumerate().filter(|(_, i)| self.stage[**i].is_some()) {
                bar[*input] += slope
                    * match op {
                        Op::Integrator(..) => 0.0,
                        _ if op.remembers() => f64::from(u8::from(which == 0)),
                        _ => self.partial(*k, which, t),
                    };
            }
            if let Op::Label(label, _) | Op::Inverse(label, _) = *op {
                let (cells, weights, count) = self.corners(*k, label, t);
                take(Read { label, slope, cells, weights, count });
            }
        }
    }

    /// Every so many samples that at most `most` are left.
    pub(crate) fn some(&self, most: usize) -> Vec<usize> {
        (0..self.samples()).step_by(self.samples().div_ceil(most).max(1)).collect()
    }

    /// Trace of the part of `J'WJ` within each label, as if the function had no memory, from at most `most` samples.
    pub(crate) fn traces(&self, weights: &[f64], most: usize) -> Vec<f64> {
        let (nodes, samples) = (self.on_the_way(), self.some(most));
        let none = || vec![0.0; self.graph.labels.len()];
        let parts: Vec<Vec<f64>> = samples
            .par_chunks(samples.len().div_ceil(super::PARTS).max(1))
            .map(|part| {
                let mut out = none();
                for t in part.iter().filter(|t| weights[**t] > 0.0) {
                    self.read_at(*t, &nodes, &mut |r| {
                        let own: f64 = r.weights[..r.count].iter().map(|a| a * a).sum();
                        out[r.label] += weights[*t] * r.slope * r.slope * own;
                    });
                }
                out
            })
            .collect();
        parts.iter().fold(none(), |mut sum, p| {
            sum.iter_mut().zip(p).for_each(|(s, p)| *s += p);
            sum
        })
    }
}
