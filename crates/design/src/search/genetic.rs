//! Genetic algorithm.

use super::{Chain, Search, bounded};
use dynocal_numerics::optim;
use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

/// The thesis' GA (section 4.3): a steady-state genetic algorithm with real genes (Molina et al. 2010). Without
/// derivatives. A generation is as many offspring as the population has members; progress tells its mean.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Genetic {
    population: usize,
}

impl Default for Genetic {
    fn default() -> Self {
        Self { population: 20 }
    }
}

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "genetic",
        what: "steady-state genetic algorithm, without derivatives (thesis: GA)",
        params: &[ParamDoc {
            name: "population",
            unit: "-",
            default: "20",
            what: "members of the population, at least 4",
        }],
    },
    build: |keys| registry::keys::<Genetic>("search genetic", keys).map(|k| Box::new(k) as Box<dyn Search>),
};

impl Search for Genetic {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        let population = self.population.max(4);
        let seed = chain.rng.below(1 << 48) as u64;
        let method = optim::Genetic { population, seed };
        bounded::compare(chain, x0, &method, population, &|generation| generation as f64);
    }
}
