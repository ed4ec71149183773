//! Robust: limits hold for every draw of the models, and what is minimised is the mean over them.
//!
//! Parameters theta are known as well as their estimate says: `N(theta, C)`. With draws theta_1 .. theta_K of the models whose
//! outputs are not demanded, each such output stands in the program K + 1 times, all driven by the same inputs:
//!
//! ```text
//! minimise   mean_k f(u, y_k)      k = 0 the estimate itself, 1 .. K the draws
//! subject to every limit of an output, for every k                 (soft ones at the mean of their violations)
//! ```
//!
//! Demands are met by the models as estimated; how far other draws are from them is told ([`Spread`]), because no inputs meet a
//! demand exactly for two models.

use super::model::{OutputModel, Source};
use super::result::{TermValue, Violation};
use super::setup::Setup;
use super::{Optimum, Price};
use crate::problem::{CalibrationProblem, LimitChannel, ObjectiveTerm};
use dynocal_files::spec::Faults;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::derived::Derived;
use serde::{Deserialize, Serialize};

use super::bounds::bound_channels;

/// How many draws of the models an optimum must hold for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robust {
    /// Number of draws.
    pub draws: usize,
    /// Seed that they are drawn with.
    #[serde(default)]
    pub seed: u64,
}

impl Robust {
    /// Checks its keys.
    pub(super) fn check(&self, key: &str, faults: &mut Faults) {
        faults.range(&format!("{key}.draws"), self.draws as f64, 1.0, 100.0, "draws");
    }
}

/// How far the draws of a demanded output's model are from the demand, on the optimal inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Output.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Root of the mean square over samples and draws.
    pub rms: f64,
    /// Largest.
    pub largest: f64,
    /// Draws whose free run diverges; they are not in the numbers.
    pub diverged: usize,
}

/// A problem in which the outputs that are not demanded stand once for each draw.
pub(super) struct Ensemble {
    pub(super) problem: CalibrationProblem,
    pub(super) start: Dataset,
    /// Outputs and derived channels that differ between draws.
    drawn: Vec<String>,
    draws: usize,
}

fn copy_name(name: &str, k: usize) -> String {
    format!("{name}#{k}")
}

impl Ensemble {
    pub(super) fn new(problem: &CalibrationProblem, models: &[OutputModel<'_>], start: &Dataset) -> Self {
        let draws = models.iter().map(|m| m.draws.len()).max().unwrap_or(0);
        let others = problem.other_outputs();
        let is_drawn = |m: &&OutputModel<'_>| !m.draws.is_empty() && others.contains(&m.output);
        let drawn = models.iter().filter(is_drawn).map(|m| m.output.clone()).collect();
        let mut out = Self { problem: problem.clone(), start: start.clone(), drawn, draws };
        out.copy_derived();
        out.copy_limits();
        out.copy_terms();
        out.copy_start();
        out
    }

    fn is_drawn(&self, name: &str) -> bool {
        self.drawn.iter().any(|n| n == name)
    }

    /// The channel that `name` is a copy of, and which; none for channels of the user, whatever their name.
    fn copy_of<'b>(&self, name: &'b str) -> Option<(&'b str, usize)> {
        let (base, k) = name.rsplit_once('#')?;
        let k = k.parse().ok().filter(|k| (1..=self.draws).contains(k))?;
        self.is_drawn(base).then_some((base, k))
    }

    fn base<'b>(&self, name: &'b str) -> &'b str {
        self.copy_of(name).map_or(name, |(base, _)| base)
    }

    fn renamed(&self, name: &str, k: usize) -> String {
        if self.is_drawn(name) { copy_name(name, k) } else { name.into() }
    }

    fn copy_derived(&mut self) {
        for d in self.problem.derive.clone() {
            if !d.powers.keys().any(|name| self.is_drawn(name)) {
                continue;
            }
            for k in 1..=self.draws {
                let powers = d.powers.iter().map(|(name, p)| (self.renamed(name, k), *p)).collect();
                self.problem.derive.push(Derived { name: copy_name(&d.name, k), powers, ..d.clone() });
            }
            self.drawn.push(d.name);
        }
    }

    fn copy_limits(&mut self) {
        let share = 1.0 / (self.draws + 1) as f64;
        let mut copies = Vec::new();
        for k in 1..=self.draws {
            let drawn = self.problem.limits.iter().filter(|l| self.is_drawn(&l.output));
            copies.extend(drawn.map(|l| LimitChannel { output: copy_name(&l.output, k), ..l.clone() }));
        }
        self.problem.limits.extend(copies);
        let all: Vec<bool> =
            self.problem.limits.iter().map(|l| self.is_drawn(self.base(&l.output))).collect();
        for (l, _) in self.problem.limits.iter_mut().zip(all).filter(|(_, drawn)| *drawn) {
            l.soft_weight = l.soft_weight.map(|w| w * share);
        }
    }

    fn copy_terms(&mut self) {
        let share = 1.0 / (self.draws + 1) as f64;
        let of = |term: &ObjectiveTerm| match self.is_drawn(&term.channel) {
            false => vec![term.clone()],
            true => {
                let names = (1..=self.draws).map(|k| copy_name(&term.channel, k));
                let all = std::iter::once(term.channel.clone()).chain(names);
                all.map(|channel| ObjectiveTerm { channel, weight: share * term.weight }).collect()
            }
        };
        self.problem.minimise = self.problem.minimise.iter().flat_map(of).collect();
    }

    /// Each copy begins as its output does in the record, and has the same limits of single samples.
    fn copy_start(&mut self) {
        let mut copies = Vec::new();
        for name in &self.drawn {
            let [lower, upper] = bound_channels(name);
            for c in self.start.channels.iter() {
                let to = |k: usize| {
                    let [l, u] = bound_channels(&copy_name(name, k));
                    match &c.name {
                        n if n == name => Some(copy_name(name, k)),
                        n if *n == lower => Some(l),
                        n if *n == upper => Some(u),
                        _ => None,
                    }
                };
                copies.extend((1..=self.draws).filter_map(to).map(|name| Channel { name, ..c.clone() }));
            }
        }
        self.start.channels.extend(copies);
    }

    /// The copies of the models.
    pub(super) fn models<'b>(&self, models: &'b [OutputModel<'b>]) -> Vec<OutputModel<'b>> {
        let mut out = Vec::new();
        for m in models.iter().filter(|m| self.is_drawn(&m.output)) {
            for (k, theta) in (1..=self.draws).zip(&m.draws) {
                let source = |s: &Source| {
                    let mut s = s.clone();
                    for (name, _) in &mut s.monomial.powers {
                        *name = self.renamed(name, k);
                    }
                    s
                };
                out.push(OutputModel {
                    output: copy_name(&m.output, k),
                    theta,
                    inputs: m.inputs.iter().map(source).collect(),
                    draws: Vec::new(),
                    ..m.clone()
                });
            }
        }
        out
    }

    /// Folds the copies into the channels that they are copies of.
    pub(super) fn folded(&self, mut found: Optimum) -> Optimum {
        found.violations = self.folded_violations(found.violations);
        found.terms = self.folded_terms(found.terms);
        found.prices = self.folded_prices(found.prices);
        found.responses.retain(|c| self.copy_of(&c.name).is_none());
        for s in &mut found.shortfalls {
            if let Some((base, k)) = self.copy_of(&s.output) {
                s.output = format!("{base} of draw {k}");
            }
        }
        let (copies, mut outputs): (Vec<Channel>, Vec<Channel>) =
            found.outputs.into_iter().partition(|c| self.copy_of(&c.name).is_some());
        for (side, better) in [("least", f64::min as fn(f64, f64) -> f64), ("greatest", f64::max)] {
            for name in &self.drawn {
                let Some(mut c) = outputs.iter().find(|c| c.name == *name).cloned() else { continue };
                for copy in copies.iter().filter(|c| self.base(&c.name) == name) {
                    c.values.iter_mut().zip(&copy.values).for_each(|(v, other)| *v = better(*v, *other));
                }
                c.name = format!("{name}_{side}");
                c.role = Role::Auxiliary;
                outputs.push(c);
            }
        }
        found.outputs = outputs;
        found
    }

    /// The worst of all copies.
    fn folded_violations(&self, all: Vec<Violation>) -> Vec<Violation> {
        let mut out: Vec<Violation> = Vec::new();
        for v in all {
            let channel = self.base(&v.channel).to_string();
            match out.iter_mut().find(|o| o.channel == channel && o.of == v.of) {
                Some(o) if v.largest > o.largest => (o.largest, o.at_s) = (v.largest, v.at_s),
                Some(_) => {}
                None => out.push(Violation { channel, ..v }),
            }
        }
        out
    }

    /// The mean of the copies of each term, whose weights are shares of its own; terms that the user names twice stay two.
    fn folded_terms(&self, all: Vec<TermValue>) -> Vec<TermValue> {
        let mut out: Vec<TermValue> = Vec::new();
        for t in all {
            match (self.copy_of(&t.channel), out.last_mut()) {
                (Some(_), Some(o)) => {
                    let weight = o.weight + t.weight;
                    o.start = (o.weight * o.start + t.weight * t.start) / weight;
                    o.optimum = (o.weight * o.optimum + t.weight * t.optimum) / weight;
                    o.weight = weight;
                }
                _ => out.push(t),
            }
        }
        out
    }

    /// The sum of all copies: the limit moves for all of them.
    fn folded_prices(&self, all: Vec<Price>) -> Vec<Price> {
        let mut out: Vec<Price> = Vec::new();
        for p in all {
            let channel = self.base(&p.channel).to_string();
            match out.iter_mut().find(|o| o.channel == channel && o.of == p.of) {
                Some(o) => {
                    o.price += p.price;
                    o.by_sample.iter_mut().zip(&p.by_sample).for_each(|(a, b)| *a += b);
                }
                None => out.push(Price { channel, ..p }),
            }
        }
        out
    }
}

/// Free runs of the draws of demanded outputs on the columns `values`, held against the demand.
pub(super) fn spreads(setup: &Setup<'_>, values: &[f64], samples: usize) -> Vec<Spread> {
    let mut out = Vec::new();
    let first = setup.first_equation();
    for m in setup.models.iter().filter(|m| !m.draws.is_empty()) {
        let Some(demand) = setup.given(&m.output) else { continue };
        let from: Vec<f64> = demand.iter().map(|y| m.way.to_model(*y)).collect();
        let (mut sum, mut largest, mut diverged) = (0.0, 0.0f64, 0);
        for theta in &m.draws {
            let drawn = OutputModel { theta, ..m.clone() };
            let Some(run) = setup.free_run(&drawn, values, &from, first) else {
                diverged += 1;
                continue;
            };
            for t in first..samples {
                let off = (m.way.to_user(run[t]) - demand[t]).abs();
                (sum, largest) = (sum + off * off, largest.max(off));
            }
        }
        let count = (m.draws.len() - diverged) * (samples - first);
        out.push(Spread {
            output: m.output.clone(),
            unit: setup.problem.unit(&m.output).unwrap_or("-").into(),
            rms: (sum / count.max(1) as f64).sqrt(),
            largest,
            diverged,
        });
    }
    out
}
