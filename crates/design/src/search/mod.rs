//! Searches for a design: the contract, its table and the entry point [`design`].
//!
//! Each search starts from one record and improves it within a budget of evaluations; [`design`] runs it from
//! several starts in parallel. Streams of random numbers belong to starts, not threads, so that the result does not
//! depend on the number of threads.

mod annealing;
mod bounded;
mod chain;
mod compass;
mod exchange;
mod forecast;
mod genetic;
mod interior_point;
mod kicks;
mod lbfgs;
mod local;
mod outcome;
mod pattern;
mod redraw;
mod sqp;
mod trust_region;

pub use chain::Chain;
pub use outcome::{
    DesignOptions, DesignOutcome, FIRST_FREE_STREAM, Failure, design, random_record, random_record_within,
};
pub use redraw::Values;

use dynocal_numerics::registry::{self, BuildError, Member};
use dynocal_numerics::status::Iterate;

/// What a running search listens and reports to.
#[derive(Clone, Copy)]
pub struct Observer<'w> {
    /// Asked often; `true` ends the search at its best design.
    pub interrupt: &'w (dyn Fn() -> bool + Sync),
    /// Told after every local run. Lines of parallel starts may arrive in any order.
    pub progress: &'w (dyn Fn(&Iterate) + Sync),
}

/// A search from one start. It leaves its best design in the chain.
pub trait Search: Send + Sync {
    /// Searches from the variables `x0`.
    fn run(&self, chain: &mut Chain, x0: &[f64]);

    /// Free values that it can take at most.
    fn most_variables(&self) -> usize {
        usize::MAX
    }
}

/// All searches.
pub static SEARCHES: &[Member<dyn Search>] = &[
    kicks::MEMBER,
    local::MEMBER,
    compass::MEMBER,
    trust_region::MEMBER,
    sqp::MEMBER,
    interior_point::MEMBER,
    pattern::MEMBER,
    genetic::MEMBER,
    annealing::MEMBER,
];

/// Builds the search `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn search(name: &str, keys: &toml::Table) -> Result<Box<dyn Search>, BuildError> {
    registry::build("search", SEARCHES, name, keys)
}

fn no_keys<T: Search + Default + 'static>(
    name: &str,
    keys: &toml::Table,
) -> Result<Box<dyn Search>, BuildError> {
    match keys.keys().next() {
        None => Ok(Box::new(T::default())),
        Some(k) => Err(BuildError::Keys {
            member: format!("search {name}"),
            message: format!("unknown key `{k}`; this search has no keys"),
        }),
    }
}
