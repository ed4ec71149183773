//! Iterated local search with random kicks.

use super::chain::Candidate;
use super::{Chain, Search};
use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

/// A local run, then random kicks of the best design, each followed by a short local run that goes on only where it
/// leads to a better design. Design problems have very many local optima of nearly equal value, so that a
/// kick of a few samples keeps most of what was won (iterated local search, Lourenco, Martin & Stuetzle 2003). A design
/// that is a little worse may be kicked on, by Metropolis' rule with a temperature that falls with the budget (Kirkpatrick,
/// Gelatt & Vecchi 1983): with budgets of seconds this gains one to five per cent over taking improvements only.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Kicks {
    window: usize,
    rough_evaluations: usize,
    patience: f64,
    temperature: f64,
}

impl Default for Kicks {
    fn default() -> Self {
        Self { window: 6, rough_evaluations: 30, patience: 0.01, temperature: 0.003 }
    }
}

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "kicks",
        what: "local run, then random kicks of the best design with short local runs",
        params: &[
            ParamDoc {
                name: "window",
                unit: "free values",
                default: "6",
                what: "longest stretch of a record that a kick draws anew",
            },
            ParamDoc {
                name: "rough_evaluations",
                unit: "-",
                default: "30",
                what: "evaluations after a kick before it is judged",
            },
            ParamDoc {
                name: "patience",
                unit: "-",
                default: "0.01",
                what: "search objective above the one before the kick up to which it is pursued",
            },
            ParamDoc {
                name: "temperature",
                unit: "-",
                default: "0.003",
                what: "search objective by which a design after a kick may be worse and still be kicked on, at the start; falls to 0 with the budget",
            },
        ],
    },
    build: |keys| registry::keys::<Kicks>("search kicks", keys).map(|k| Box::new(k) as Box<dyn Search>),
};

/// Evaluations of one local run after a kick, under output limits and under rate limits or regions alone.
const OUTPUTS_RUN: usize = 500;
const RATES_RUN: usize = 900;

/// Where a kick strikes.
struct Stretch {
    /// First sample.
    from: usize,
    /// Free values of each channel.
    length: usize,
}

impl Kicks {
    fn stretch(&self, chain: &mut Chain) -> Stretch {
        let samples = chain.evaluator.layout().n_samples();
        Stretch { from: chain.rng.below(samples), length: 1 + chain.rng.below(self.window.max(1)) }
    }

    /// Draws the stretch of every channel anew, or as many free values anywhere.
    fn kick(&self, chain: &mut Chain, at: &Stretch, everywhere: bool, x: &mut [f64]) {
        let layout = chain.evaluator.layout().clone();
        let (lower, upper) = layout.bounds();
        for i in 0..layout.n_channels() {
            let range = layout.variables(i);
            let n = range.len();
            if n == 0 {
                continue;
            }
            for k in 0..at.length.min(n) {
                let k =
                    if everywhere { chain.rng.below(n) } else { (layout.knot(i, at.from) + k).min(n - 1) };
                let j = range.start + k;
                x[j] = chain.rng.uniform_in(lower[j], upper[j]);
            }
        }
        layout.repair(x);
    }
}

impl Kicks {
    /// A short run from `x`, a longer one where that comes near to the design `from` before the kick.
    fn free(&self, chain: &mut Chain, x: &[f64], from: &Candidate, left: usize) -> Candidate {
        let rough = self.rough_evaluations;
        let tried = chain.refine(x, rough, true, None);
        if tried.f >= from.f + self.patience {
            return tried;
        }
        let kept = chain.refine(&tried.x, left.saturating_sub(rough).min(5 * rough), true, None);
        if kept.f < tried.f { kept } else { tried }
    }

    /// Under output limits the multipliers stay what they were but for those around the stretch, which belong to values that
    /// the kick has moved. Rate limits alone are found again from nothing, with a small penalty that lets the record leave
    /// them for a better place.
    fn constrained(&self, chain: &mut Chain, from: &Candidate, left: usize) -> Candidate {
        let at = self.stretch(chain);
        let mut x = from.x.clone();
        let everywhere = !chain.evaluator.limits_outputs() && chain.rng.uniform() < 0.3;
        self.kick(chain, &at, everywhere, &mut x);
        chain.give_up = if chain.feasible(from.violation) { from.f + self.patience } else { f64::INFINITY };
        let found = if chain.evaluator.limits_outputs() {
            let part = chain.evaluator.around(at.from, at.length);
            let multipliers = from.multipliers.clone().map(|mut mu| {
                chain.evaluator.forget(&mut mu, &part);
                mu
            });
            chain.refine_kicked(&x, left.min(OUTPUTS_RUN), multipliers)
        } else {
            chain.refine(&x, left.min(RATES_RUN), false, None)
        };
        chain.give_up = f64::INFINITY;
        found
    }
}

impl Search for Kicks {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        let total = chain.left();
        // The last part of the budget polishes the best design to the tolerance.
        let polish = total / 8;
        let first = chain.refine(x0, if chain.is_constrained() { total / 2 } else { total / 4 }, false, None);
        chain.offer(first);
        let mut current = chain.best.clone();
        let room = chain.left().saturating_sub(polish).max(1);
        while chain.left() > polish + 2 * self.rough_evaluations {
            let Some(from) = current.clone() else { break };
            let left = chain.left().saturating_sub(polish);
            let found = match chain.is_constrained() {
                true => self.constrained(chain, &from, left),
                false => {
                    let mut x = from.x.clone();
                    let (at, everywhere) = (self.stretch(chain), chain.rng.uniform() < 0.3);
                    self.kick(chain, &at, everywhere, &mut x);
                    self.free(chain, &x, &from, left)
                }
            };
            // Metropolis' rule, cooling with the budget: a record that is a little worse may be on the way to a better.
            let temperature = self.temperature * left as f64 / room as f64;
            let worse = -temperature * (1.0 - chain.rng.uniform()).ln();
            let accept = chain.better((found.f - worse, found.violation), (from.f, from.violation));
            chain.offer(found.clone());
            if accept {
                current = Some(found);
            }
        }
        if let Some(best) = chain.best.clone() {
            let left = chain.left();
            let last = chain.refine(&best.x, left, false, best.multipliers.clone());
            let converged = last.converged;
            // Converged is a statement about the point that is returned, also where the polish changed nothing.
            if !chain.offer(last)
                && let Some(b) = &mut chain.best
            {
                b.converged |= converged;
            }
        }
    }
}
