//! A known system whose time constant depends on its inputs, so that what a record tells depends on the parameters: robust
//! and sequential design on it.

use dynocal_design::channel::Channel;
use dynocal_design::criterion::criterion;
use dynocal_design::problem::{DesignProblem, Term};
use dynocal_design::search::{DesignOptions, design};
use dynocal_ident::data::Dataset;
use dynocal_ident::model::poly::{PolyNarx, StructureError};
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::signals::Kind;
use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::bed::TestBed;
use dynocal_calib::loops::model::{identify, mean_square};
use dynocal_calib::loops::plan::{Aim, Structure, know, next_record, problem};
use dynocal_calib::loops::rehearsal::{Input, ModelPlant};
use dynocal_calib::loops::robust::{Ensemble, Risk, Stable, draws};
use dynocal_calib::loops::rounds::{Rounds, StopRule, sequential};

/// Output of the system.
const OUTPUT: &str = "y";
/// Regressors with their parameters: poles from 0.35 to 0.85.
const TERMS: [(&str, f64); 7] = [
    ("1", 0.1),
    ("u(t-1)", 0.5),
    ("v(t-1)", 0.3),
    ("u(t-1)^2", 0.2),
    ("y(t-1)", 0.6),
    ("u(t-1)*y(t-1)", -0.15),
    ("v(t-1)*y(t-1)", 0.1),
];

/// The system, its bed and its noise.
pub struct Known {
    model: PolyNarx,
    theta: Vec<f64>,
    bed: TestBed,
    /// Standard deviation of the measurement noise.
    pub noise: f64,
}

impl Known {
    /// The system with measurement noise of standard deviation `noise`.
    ///
    /// # Errors
    /// Never for this list.
    pub fn new(noise: f64) -> Result<Self, StructureError> {
        let model = PolyNarx::parse(&["u", "v"], OUTPUT, &TERMS.map(|t| t.0))?;
        let channels = vec![Channel::free("u", -1.0, 1.0), Channel::free("v", -1.0, 1.0)];
        let bed = TestBed { channels, sample_time_s: 0.3, settle_s: 3.0 };
        Ok(Self { model, theta: TERMS.map(|t| t.1).to_vec(), bed, noise })
    }

    fn plant(&self, noise: bool, seed: u64) -> Result<ModelPlant, PlantError> {
        let input =
            |name: &str| Input { name: name.into(), unit: "-".into(), min: -1.0, max: 1.0, start: 0.0 };
        let deviation = if noise { self.noise } else { 0.0 };
        let inputs = vec![input("u"), input("v")];
        let mut plant =
            ModelPlant::new(Box::new(self.model.clone()), self.theta.clone(), OUTPUT, inputs, deviation)?;
        plant.reset(seed);
        Ok(plant)
    }

    fn random(&self, noise: bool, seed: u64, stream: u64, samples: usize) -> Result<Dataset, LoopError> {
        let u = Kind::Udrn.record(&self.bed, samples, &mut Rng64::stream(seed, stream))?;
        self.bed.measure(&mut self.plant(noise, seed ^ stream << 20)?, "random", &u)
    }

    fn structures(&self) -> [Structure<'_>; 1] {
        [Structure::new(OUTPUT, &self.model)]
    }
}

/// Losses of one seed's records at fresh draws of the parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobustSeed {
    /// Largest loss of the nominal design, of the design for the mean, of that for the worst share.
    pub worst: [f64; 3],
    /// Mean losses.
    pub mean: [f64; 3],
}

/// Size of the robust comparison.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobustSize {
    /// First seed.
    pub seed: u64,
    /// Seeds.
    pub seeds: u64,
    /// Samples of the first record, whose estimate gives the distribution.
    pub initial: usize,
    /// Samples of the design.
    pub samples: usize,
    /// Draws that are designed for.
    pub draws: usize,
    /// Fresh draws that are judged on.
    pub fresh: usize,
    /// Worst share of the conditional value at risk.
    pub share: f64,
    /// Evaluations of one design.
    pub evaluations: usize,
}

impl Known {
    /// Robust against nominal D-designs over fresh draws of the parameters' distribution.
    ///
    /// # Errors
    /// [`LoopError`].
    pub fn robust(&self, size: RobustSize) -> Result<Vec<RobustSeed>, LoopError> {
        (0..size.seeds).map(|k| self.robust_seed(size, size.seed + k)).collect()
    }

    fn robust_seed(&self, size: RobustSize, seed: u64) -> Result<RobustSeed, LoopError> {
        let data = self.bed.experiments(&[self.random(true, seed, 1, size.initial)?], OUTPUT)?;
        let fit = identify(&self.model, &data)?;
        let u0 = Kind::Udrn.record(&self.bed, 200, &mut Rng64::stream(seed, 2))?;
        let c = criterion("d", &toml::Table::new())?;
        let variance = fit.noise_variance;
        let term = Term::new(OUTPUT, &self.model, &fit.theta, variance, c.as_ref());
        let posed: DesignProblem = problem(&self.bed, size.samples, vec![term]);
        let options = DesignOptions { seed, evaluations: size.evaluations, ..DesignOptions::default() };
        let never = || false;
        let nominal = design(&posed, &options, &never, &|_| {})?.u;
        // A design drives harder than a random record, and a draw must be stable under both to be judged at all.
        let driven = [u0, nominal.clone()].concat();
        let stable = Stable { u: &driven, initial_output: 0.0, bound: 10.0 };
        let drawn = |n, s| draws(&self.model, &fit.theta, &fit.covariance, n, s, stable);
        let (few, fresh) = (drawn(size.draws, seed)?, drawn(size.fresh, seed + 1_000_000)?);
        // Losses are measured from designs that start at the nominal one, so that a poor local optimum hides none.
        let options = DesignOptions { start: Some(nominal.clone()), ..options };
        let ensemble = Ensemble::new(&posed, &few, &options, &never)?;
        let mean = ensemble.design(Risk::Mean, &nominal, &options, &never)?.u;
        let cvar = ensemble.design(Risk::Cvar(size.share), &mean, &options, &never)?.u;
        let judge = Ensemble::new(&posed, &fresh, &options, &never)?;
        let mut out = RobustSeed { worst: [0.0; 3], mean: [0.0; 3] };
        for (i, u) in [nominal, mean, cvar].iter().enumerate() {
            let losses = judge.losses(u)?;
            out.worst[i] = losses.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            out.mean[i] = Risk::Mean.of(&losses);
        }
        Ok(out)
    }
}

/// Size of the sequential comparison.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequentialSize {
    /// First seed.
    pub seed: u64,
    /// Seeds.
    pub seeds: u64,
    /// Samples of the first, random stretch.
    pub initial: usize,
    /// Samples of every further stretch.
    pub samples: usize,
    /// Further stretches.
    pub rounds: usize,
    /// Held-out samples of the stop rule.
    pub held_out: usize,
    /// Evaluations of the design of one stretch; the fixed design has as many for each of its stretches.
    pub evaluations: usize,
}

/// Error of a model whose free run diverges.
const USELESS: f64 = 1e6;

/// One seed: a sequential campaign, one fixed design, and what the stop rule said.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequentialSeed {
    /// Mean squared error without noise on unseen records at the start and after every stretch; a diverged free run counts
    /// as a million.
    pub errors: Vec<f64>,
    /// The same after one fixed design as long as all stretches.
    pub fixed: f64,
    /// The same after random stretches of that length.
    pub random: f64,
    /// Predicted reduction for every stretch; none where the model before it had diverged.
    pub predicted: Vec<Option<f64>>,
    /// Share of the present error that it is.
    pub relative: Vec<Option<f64>>,
}

/// What a sequential comparison needs of a system.
pub trait Sequenced: Sync {
    /// What is moved.
    fn bed(&self) -> &TestBed;
    /// What is designed for and identified.
    fn structure(&self) -> Structure<'_>;
    /// Criterion of the designs with its keys, from the first record.
    ///
    /// # Errors
    /// [`LoopError`] of an estimation.
    fn criterion(&self, first: &[Dataset]) -> Result<(String, toml::Table), LoopError>;
    /// A plant with or without sensor noise.
    ///
    /// # Errors
    /// [`PlantError`] of the plant.
    fn fresh(&self, noise: bool, seed: u64) -> Result<Box<dyn Plant>, PlantError>;
    /// Variance of the measurement noise.
    fn noise_variance(&self) -> f64;
}

impl Sequenced for Known {
    fn bed(&self) -> &TestBed {
        &self.bed
    }

    fn structure(&self) -> Structure<'_> {
        self.structures()[0]
    }

    fn criterion(&self, _first: &[Dataset]) -> Result<(String, toml::Table), LoopError> {
        Ok(("i".into(), toml::Table::new()))
    }

    fn fresh(&self, noise: bool, seed: u64) -> Result<Box<dyn Plant>, PlantError> {
        Ok(Box::new(self.plant(noise, seed)?))
    }

    fn noise_variance(&self) -> f64 {
        self.noise * self.noise
    }
}

/// Sequential against fixed design, and the stop rule, for every seed.
///
/// # Errors
/// [`LoopError`].
pub fn compare(
    system: &dyn Sequenced,
    size: SequentialSize,
    unseen_records: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<SequentialSeed>, LoopError> {
    let (bed, s) = (system.bed(), system.structure());
    let random = |noise: bool, seed: u64, stream: u64, samples: usize| -> Result<Dataset, LoopError> {
        let u = Kind::Udrn.record(bed, samples, &mut Rng64::stream(seed, stream))?;
        bed.measure(system.fresh(noise, (stream << 32) + seed)?.as_mut(), "random", &u)
    };
    let unseen: Result<Vec<Dataset>, LoopError> =
        (0..unseen_records).into_par_iter().map(|k| random(false, size.seed, (8 << 8) + k, 200)).collect();
    let unseen = bed.experiments(&unseen?, s.output)?;
    let objective = Kind::Udrn.record(bed, 200, &mut Rng64::stream(size.seed, 7 << 40))?;
    let one = |k: u64| -> Result<SequentialSeed, LoopError> {
        let seed = size.seed + k;
        let held_out = [random(true, seed, 3, size.held_out)?];
        let first = Kind::Udrn.record(bed, size.initial, &mut Rng64::stream(seed, 4))?;
        let mut plant = system.fresh(true, (5 << 32) + seed)?;
        let initial = vec![bed.measure(plant.as_mut(), "first", &first)?];
        let at_first = plant.save();
        let search = DesignOptions { seed, evaluations: size.evaluations, ..DesignOptions::default() };
        let (criterion, keys) = system.criterion(&initial)?;
        let aim = Aim { criterion, keys, objective: objective.clone(), adds: true, search, robust: None };
        let structures = [s];
        let rounds = Rounds {
            bed,
            structures: &structures,
            aim: &aim,
            samples: size.samples,
            rounds: size.rounds,
            limits: &[],
        };
        // The rule only watches: what comes after its stop is to be observed too.
        let rule = StopRule { held_out: &held_out, noise: system.noise_variance(), threshold: 0.0 };
        let campaign = sequential(plant.as_mut(), &rounds, initial.clone(), Some(rule), interrupt)?;
        let error = |records: &[Dataset]| -> Result<f64, LoopError> {
            let data = bed.experiments(records, s.output)?;
            let found = mean_square(s.used(), &identify(s.used(), &data)?.theta, &unseen);
            Ok(if found < USELESS { found } else { USELESS })
        };
        let errors: Result<Vec<f64>, LoopError> =
            (1..=campaign.records.len()).map(|n| error(&campaign.records[..n])).collect();
        // The fixed design knows what the first stretch told and never looks again.
        let all = size.samples * size.rounds;
        let known = know(bed, &structures, &initial)?;
        let mut fixed_aim = aim.clone();
        fixed_aim.search.evaluations *= size.rounds;
        let plan = next_record(bed, &structures, &known, &fixed_aim, all, &[], interrupt)?.u;
        let drawn = Kind::Udrn.record(bed, all, &mut Rng64::stream(seed, 6))?;
        let mut after = |u: &[f64]| -> Result<f64, LoopError> {
            plant.restore(&at_first)?;
            let going_on = TestBed { settle_s: 0.0, ..bed.clone() };
            let record = going_on.measure(plant.as_mut(), "fixed", u)?;
            error(&[initial[0].clone(), record])
        };
        let forecasts = campaign.rounds.iter().map(|r| r.forecast);
        Ok(SequentialSeed {
            errors: errors?,
            fixed: after(&plan)?,
            random: after(&drawn)?,
            predicted: forecasts.clone().map(|f| f.map(|f| f.reduction)).collect(),
            relative: forecasts.map(|f| f.map(|f| f.relative)).collect(),
        })
    };
    (0..size.seeds).into_par_iter().map(one).collect()
}
