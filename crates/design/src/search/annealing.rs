//! Simulated annealing.

use super::{Chain, Search, bounded};
use dynocal_numerics::optim;
use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

/// The thesis' SAN (section 4.3): Metropolis acceptance, temperatures in a geometric series, annealed again and again.
/// Without derivatives; progress tells the mean of the trials at each temperature.
///
/// The default temperature is in units of the search objective (`ln J` where J is positive): 0.02 is the thesis' 100 at
/// its start of `J_A` = 4944.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Annealing {
    temperature: f64,
    cooling: f64,
    levels: usize,
}

impl Default for Annealing {
    fn default() -> Self {
        Self { temperature: 0.02, cooling: 0.95, levels: 150 }
    }
}

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "annealing",
        what: "simulated annealing with reannealing, without derivatives (thesis: SAN)",
        params: &[
            ParamDoc {
                name: "temperature",
                unit: "search objective",
                default: "0.02",
                what: "first temperature; the search objective is ln J, or J where J may be negative",
            },
            ParamDoc {
                name: "cooling",
                unit: "-",
                default: "0.95",
                what: "factor from one temperature to the next, between 0 and 1",
            },
            ParamDoc {
                name: "levels",
                unit: "-",
                default: "150",
                what: "temperatures after which the annealing begins again",
            },
        ],
    },
    build: |keys| {
        let k = registry::keys::<Annealing>("search annealing", keys)?;
        let wrong = |message: String| BuildError::Keys { member: "search annealing".into(), message };
        if !(k.temperature > 0.0 && k.temperature.is_finite()) {
            return Err(wrong(format!("temperature: found {}, expected a positive number", k.temperature)));
        }
        if !(k.cooling > 0.0 && k.cooling < 1.0) {
            return Err(wrong(format!("cooling: found {}, expected a number between 0 and 1", k.cooling)));
        }
        Ok(Box::new(k))
    },
};

impl Search for Annealing {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        // A tenth of a sweep over the free values at each temperature.
        let steps = x0.len().div_ceil(10);
        let levels = self.levels.max(1);
        let seed = chain.rng.below(1 << 48) as u64;
        let method =
            optim::Annealing { temperature: self.temperature, cooling: self.cooling, steps, levels, seed };
        let temperature = |line: usize| self.temperature * self.cooling.powi((line % levels) as i32);
        bounded::compare(chain, x0, &method, steps, &temperature);
    }
}
