//! Predicted outputs of the models that have limits, over a part of a record at a time.
//!
//! Whether a record keeps its output limits can be told sample by sample, without sensitivities: a stretch of the free
//! run needs the inputs and outputs of the longest lag before it and nothing else.

use crate::problem::{Convention, DesignProblem};
use dynocal_ident::model::{Model, Run};

/// One output with its limits.
#[derive(Clone)]
struct Output<'a> {
    model: &'a dyn Model,
    theta: &'a [f64],
    lower: f64,
    upper: f64,
    /// Predicted output of the padded record.
    y: Vec<f64>,
}

/// Free runs of one record (see the module).
#[derive(Clone)]
pub(crate) struct Forecast<'a> {
    m: usize,
    pad: usize,
    start: usize,
    lag: usize,
    hold: bool,
    /// Padded record, (N + pad) x m.
    u: Vec<f64>,
    outputs: Vec<Output<'a>>,
    work: Vec<f64>,
}

impl<'a> Forecast<'a> {
    /// For the terms of `problem` that have limits, aimed `inside` (a share of their range).
    pub(crate) fn new(problem: &DesignProblem<'a>, inside: f64) -> Self {
        let (m, (pad, start)) = (problem.channels.len(), problem.padding());
        let rows = problem.n_samples + pad;
        let limited = problem.terms.iter().filter_map(|t| t.limits.map(|l| (t, l.kept())));
        let outputs = limited.map(|(t, kept)| Output {
            model: t.model,
            theta: t.theta,
            lower: kept.lower + inside * kept.width(),
            upper: kept.upper - inside * kept.width(),
            y: vec![t.initial_output; rows],
        });
        let hold = problem.convention == Convention::Hold;
        let (u, outputs) = (vec![0.0; rows * m], outputs.collect());
        Self { m, pad, start, lag: problem.max_lag(), hold, u, outputs, work: Vec::new() }
    }

    /// Whether no output has limits.
    pub(crate) fn is_free(&self) -> bool {
        self.outputs.is_empty()
    }

    /// Samples of the record that only initialise, and the longest lag.
    pub(crate) fn reach(&self) -> (usize, usize) {
        (self.start - self.pad, self.lag)
    }

    /// Samples of the record (N x m); after a change call [`Forecast::changed`].
    pub(crate) fn record(&mut self) -> &mut [f64] {
        &mut self.u[self.pad * self.m..]
    }

    /// First sample of the record whose outputs have to be computed anew after a change at `sample`.
    pub(crate) fn changed(&mut self, sample: usize) -> usize {
        if sample == 0 && self.hold {
            let (pad, rest) = self.u.split_at_mut(self.pad * self.m);
            pad.chunks_exact_mut(self.m).for_each(|row| row.copy_from_slice(&rest[..self.m]));
        }
        sample.max(self.start - self.pad)
    }

    /// Computes the samples `from..to` of the record; the first one that passes a limit, with its excess in ranges.
    /// Samples after it are not computed.
    pub(crate) fn first_violation(&mut self, from: usize, to: usize) -> Option<(usize, f64)> {
        let (first, last) = ((from + self.pad).max(self.start), to + self.pad);
        if first >= last {
            return None;
        }
        let mut worst: Option<(usize, f64)> = None;
        for o in &mut self.outputs {
            let back = first - self.lag;
            let length = last - back;
            self.work.resize(length, 0.0);
            let run = Run { u: &self.u[back * self.m..last * self.m], y: &o.y[back..last], start: self.lag };
            o.model.simulate(o.theta, &run, &mut self.work);
            o.y[first..last].copy_from_slice(&self.work[self.lag..]);
            let over = |y: f64| ((y - o.upper).max(o.lower - y) / (o.upper - o.lower)).max(0.0);
            let passed = |y: f64| !(o.lower..=o.upper).contains(&y);
            if let Some(k) = o.y[first..last].iter().position(|y| passed(*y)) {
                let y = o.y[first + k];
                let (sample, excess) =
                    (first + k - self.pad, if y.is_finite() { over(y) } else { f64::INFINITY });
                match &mut worst {
                    Some((s, e)) if *s == sample => *e += excess,
                    Some((s, _)) if *s < sample => {}
                    _ => worst = Some((sample, excess)),
                }
            }
        }
        worst
    }

    /// Copies of the outputs of the samples `from..to`, one output after the other.
    pub(crate) fn save(&self, from: usize, to: usize, into: &mut Vec<f64>) {
        into.clear();
        self.outputs.iter().for_each(|o| into.extend_from_slice(&o.y[from + self.pad..to + self.pad]));
    }

    /// Puts back what [`Forecast::save`] gave for the same samples.
    pub(crate) fn restore(&mut self, from: usize, to: usize, saved: &[f64]) {
        let length = to - from;
        for (o, part) in self.outputs.iter_mut().zip(saved.chunks_exact(length.max(1))) {
            o.y[from + self.pad..to + self.pad].copy_from_slice(part);
        }
    }
}
