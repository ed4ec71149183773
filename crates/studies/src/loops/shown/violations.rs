//! How often a limit of the torque is passed when the model that keeps it is wrong in structure.

use dynocal_design::search::DesignOptions;
use dynocal_ident::model::Model;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::engine::{Engine, OUTPUT};
use super::signals::Kind;
use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::bed::TestBed;
use dynocal_calib::loops::plan::{Aim, Structure};
use dynocal_calib::loops::rounds::{Limit, Rounds, iterate};

/// The experiment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// First seed.
    pub seed: u64,
    /// Campaigns of each structure.
    pub seeds: u64,
    /// Samples of each record.
    pub samples: usize,
    /// Designed records.
    pub rounds: usize,
    /// Limits of the torque in Nm.
    pub limits_nm: Interval,
    /// Stated rate: share of the samples predicted to be at a limit.
    pub rate: f64,
    /// Factor on the margins of the first designed record.
    pub caution: f64,
    /// Share of the box that the first, random record uses.
    pub first_box: f64,
    /// Evaluations of one design.
    pub evaluations: usize,
}

/// Counts of one round over all seeds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Count {
    /// Measured samples.
    pub samples: usize,
    /// Of them beyond a limit.
    pub beyond: usize,
    /// Samples predicted to be within 2 % of the range of the limits from a limit with its margin.
    pub at_limit: usize,
    /// Of them beyond.
    pub at_limit_beyond: usize,
    /// Largest passing of a limit in Nm.
    pub worst_nm: f64,
    /// Sum over the campaigns of the upper margin in Nm.
    pub margin_nm: f64,
    /// Campaigns whose design did not meet its narrowed limits.
    pub infeasible: usize,
}

/// A structure's counts, round by round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observed {
    /// Structure.
    pub structure: String,
    /// Setup.
    pub setup: Setup,
    /// Rounds.
    pub rounds: Vec<Count>,
}

/// Runs the campaigns of one structure: a random record in the middle of the box, then designs up to the limits.
///
/// # Errors
/// [`LoopError`].
pub fn observe(
    engine: &Engine,
    name: &str,
    model: &dyn Model,
    setup: Setup,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Observed, LoopError> {
    let one = |k: u64| -> Result<Vec<Count>, LoopError> {
        let seed = setup.seed + k;
        let mut rng = Rng64::stream(seed, 5 << 40);
        let mut plant = engine.plant(true, (5 << 40) + seed)?;
        let u = Kind::Udrn.record(&middle(&engine.bed, setup.first_box), setup.samples, &mut rng)?;
        let initial = vec![engine.bed.measure(&mut plant, "initial", &u)?];
        let search = DesignOptions {
            seed,
            evaluations: setup.evaluations,
            output_tolerance: 1e-3,
            ..DesignOptions::default()
        };
        let aim = Aim {
            criterion: "d".into(),
            keys: toml::Table::new(),
            objective: Vec::new(),
            adds: true,
            search,
            robust: None,
        };
        let limits = [Limit {
            output: OUTPUT.into(),
            lower: setup.limits_nm.lower,
            upper: setup.limits_nm.upper,
            rate: setup.rate,
            caution: setup.caution,
        }];
        let structures = [Structure::new(OUTPUT, model)];
        let rounds = Rounds {
            bed: &engine.bed,
            structures: &structures,
            aim: &aim,
            samples: setup.samples,
            rounds: setup.rounds,
            limits: &limits,
        };
        let done = iterate(&mut plant, &rounds, initial, interrupt)?;
        done.rounds
            .iter()
            .zip(&done.records[1..])
            .map(|(r, record)| {
                let kept = r.limits[0].kept;
                let predicted = r.design.safety.first().map_or(&[][..], |s| &s.predicted);
                let feasible = r.design.status != dynocal_numerics::status::Status::Infeasible;
                let margin_nm = setup.limits_nm.upper - kept.upper;
                let infeasible = usize::from(!feasible);
                let measured = record.values(OUTPUT)?;
                let counted = count(setup.limits_nm, kept, predicted, measured);
                Ok(Count { margin_nm, infeasible, ..counted })
            })
            .collect()
    };
    let all: Result<Vec<_>, LoopError> = (0..setup.seeds).into_par_iter().map(one).collect();
    let mut rounds = vec![Count::default(); setup.rounds];
    for campaign in all? {
        for (sum, c) in rounds.iter_mut().zip(campaign) {
            sum.samples += c.samples;
            sum.beyond += c.beyond;
            sum.at_limit += c.at_limit;
            sum.at_limit_beyond += c.at_limit_beyond;
            sum.worst_nm = sum.worst_nm.max(c.worst_nm);
            sum.margin_nm += c.margin_nm / setup.seeds as f64;
            sum.infeasible += c.infeasible;
        }
    }
    Ok(Observed { structure: name.into(), setup, rounds })
}

/// The middle `share` of every channel of the box.
fn middle(bed: &TestBed, share: f64) -> TestBed {
    let mut narrow = bed.clone();
    for c in &mut narrow.channels {
        let (mid, half) = (0.5 * (c.lower + c.upper), 0.5 * share * (c.upper - c.lower));
        (c.lower, c.upper) = (mid - half, mid + half);
    }
    narrow
}

fn count(limits: Interval, narrowed: Interval, predicted: &[f64], measured: &[f64]) -> Count {
    let near = 0.02 * limits.width();
    let mut c = Count::default();
    for (y, z) in predicted.iter().zip(measured) {
        let beyond = (z - limits.upper).max(limits.lower - z);
        let at_limit = *y > narrowed.upper - near || *y < narrowed.lower + near;
        c.samples += 1;
        c.beyond += usize::from(beyond > 0.0);
        c.at_limit += usize::from(at_limit);
        c.at_limit_beyond += usize::from(at_limit && beyond > 0.0);
        c.worst_nm = c.worst_nm.max(beyond);
    }
    c
}
