//! What is asked of inputs and outputs at each sample: limits of the problem, those of single samples, soft ones.

use super::bounds::bound_channels;
use super::program::{SoftLimit, Sum};
use super::setup::Setup;
use crate::problem::LimitChannel;

/// What is asked of an output that is a column.
pub(super) struct Asked {
    pub(super) output: String,
    pub(super) column: usize,
    /// `demand`, `lower`, `upper`.
    pub(super) of: &'static str,
    pub(super) values: Vec<f64>,
    /// Its range, or the size of its limit.
    pub(super) size: f64,
}

impl Setup<'_> {
    /// The same with the upper limits of `outputs` as loose as the start needs them.
    pub(super) fn loosened(mut self, outputs: &[String]) -> Self {
        for name in outputs {
            let limit = self.problem.limits.iter().find(|l| l.output == *name);
            let (Some(upper), Some(c)) = (limit.and_then(|l| l.upper), self.column(name)) else { continue };
            let start = self.start.iter().skip(c).step_by(self.columns.len());
            let [_, bound] = bound_channels(name);
            self.given.push((bound, start.map(|d| d.max(upper)).collect()));
            self.loose.push(name.clone());
        }
        self
    }

    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|n| n == name)
    }

    /// Lower and upper limit of an output at every sample, where it has them: those of the problem, and those that the record
    /// has sample by sample.
    pub(super) fn limits_of(&self, l: &LimitChannel) -> [Option<Vec<f64>>; 2] {
        let [lower, upper] = bound_channels(&l.output).map(|name| self.given(&name));
        let loose = self.loose.contains(&l.output);
        let both = |constant: Option<f64>, local: Option<&[f64]>, tighter: fn(f64, f64) -> f64| match (
            constant, local,
        ) {
            (Some(c), Some(v)) if !loose => Some(v.iter().map(|v| tighter(*v, c)).collect()),
            (_, Some(v)) => Some(v.to_vec()),
            (Some(c), None) => Some(vec![c; self.samples]),
            (None, None) => None,
        };
        [both(l.lower, lower, f64::max), both(l.upper, upper, f64::min)]
    }

    /// Limits of each sample of an output where the record has some; else none.
    pub(super) fn local_limits(&self, l: &LimitChannel) -> Vec<(f64, f64)> {
        if bound_channels(&l.output).iter().all(|name| self.given(name).is_none()) {
            return Vec::new();
        }
        let [lower, upper] = self.limits_of(l);
        let at = |side: &Option<Vec<f64>>, t: usize, none: f64| side.as_ref().map_or(none, |v| v[t]);
        (0..self.samples).map(|t| (at(&lower, t, f64::NEG_INFINITY), at(&upper, t, f64::INFINITY))).collect()
    }

    /// Bounds of each sample of input `c` where the record has some, inside those of the problem and about its start; else none.
    pub(super) fn local_bounds(&self, c: usize) -> Vec<(f64, f64)> {
        let input = &self.problem.inputs[c];
        let [lower, upper] = bound_channels(&input.name).map(|name| self.given(&name));
        if lower.or(upper).is_none() {
            return Vec::new();
        }
        let at = |bound: Option<&[f64]>, t: usize, other: f64| bound.map_or(other, |v| v[t]);
        let of = |t: usize| {
            let start = self.start[t * self.columns.len() + c];
            let lower = at(lower, t, input.lower).max(input.lower).min(start);
            (lower, at(upper, t, input.upper).min(input.upper).max(start))
        };
        (0..self.samples).map(of).collect()
    }

    /// All that is asked of outputs that are columns.
    pub(super) fn asked(&self) -> Vec<Asked> {
        let demands = self.problem.demands.iter().filter_map(|d| {
            let values = self.given(&d.output)?.to_vec();
            let (output, size) = (d.output.clone(), d.upper - d.lower);
            Some(Asked { column: self.column(&output)?, output, of: "demand", values, size })
        });
        let limits = self.problem.limits.iter().flat_map(|l| {
            let limit = |of, values: Option<Vec<f64>>| {
                let (output, values) = (l.output.clone(), values?);
                let size = match (l.lower, l.upper) {
                    (Some(lower), Some(upper)) => upper - lower,
                    _ => values.iter().fold(1e-3, |m: f64, v| m.max(v.abs())),
                };
                Some(Asked { column: self.column(&output)?, output, of, values, size })
            };
            let [lower, upper] = self.limits_of(l);
            limit("lower", lower).into_iter().chain(limit("upper", upper)).collect::<Vec<_>>()
        });
        demands.chain(limits).collect()
    }

    /// Channels whose mean is limited, with that mean and its limit.
    pub(super) fn mean_limits(&self) -> Vec<(String, Sum, f64)> {
        let limited = self.problem.limits.iter().filter_map(|l| Some((&l.output, l.mean_upper?)));
        limited
            .map(|(name, upper)| (name.clone(), self.mean(&self.problem.monomial(name), 1.0), upper))
            .collect()
    }

    /// Everything that is asked of outputs as soft limits; those that have a weight of their own keep it, as a share `own` of it.
    pub(super) fn all_soft(&self, price: f64, own: f64) -> Vec<SoftLimit> {
        let mut out = Vec::new();
        for a in self.asked() {
            let limit = self.problem.limits.iter().find(|l| l.output == a.output && a.of != "demand");
            let price = match limit.and_then(|l| l.soft_weight) {
                Some(weight) => own * weight / (self.to - self.from) as f64,
                None => price / a.size,
            };
            if price == 0.0 {
                continue;
            }
            let limit = |above| SoftLimit { column: a.column, above, limit: a.values.clone(), price };
            if a.of != "upper" {
                out.push(limit(false));
            }
            if a.of != "lower" {
                out.push(limit(true));
            }
        }
        out
    }

    pub(super) fn soft(&self, l: &LimitChannel) -> Vec<SoftLimit> {
        let column = self.column(&l.output);
        let (Some(column), Some(weight)) = (column, l.soft_weight) else { return Vec::new() };
        let price = weight / (self.to - self.from) as f64;
        let limit = |values: Vec<f64>, above| SoftLimit { column, above, limit: values, price };
        let [lower, upper] = self.limits_of(l);
        lower.map(|v| limit(v, false)).into_iter().chain(upper.map(|v| limit(v, true))).collect()
    }
}
