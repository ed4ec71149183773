//! Designed against random records on the black box of section 4.10.

use dynocal_design::search::DesignOptions;
use dynocal_ident::data::Dataset;
use dynocal_ident::estimate::Fit;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::{PolyNarx, StructureError};
use dynocal_ident::validate::{Kind as Computed, output};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::engine::{Engine, OUTPUT, doubt};
use super::signals::Kind;
use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::model::{identify, mean_square};
use dynocal_calib::loops::plan::{Aim, Structure};
use dynocal_calib::loops::rounds::{Rounds, iterate};

/// Size of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// First seed.
    pub seed: u64,
    /// Campaigns of each kind.
    pub seeds: u64,
    /// Samples of the first, random record of a designed campaign.
    pub initial: usize,
    /// Samples of each designed record.
    pub designed: usize,
    /// Designed records; rivals are as long as all of it.
    pub rounds: usize,
    /// Unseen records of each kind.
    pub unseen: u64,
    /// Evaluations of one design.
    pub evaluations: usize,
}

/// Rank, and the mean squared errors on random and on ramped unseen records.
type Score = (usize, f64, f64);

impl Size {
    /// Samples of a whole campaign.
    pub fn samples(&self) -> usize {
        self.initial + self.rounds * self.designed
    }
}

/// What a campaign's records are designed for, or that they are not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Campaign {
    /// One record of a kind.
    Random(Kind),
    /// The affine model by AI, each record for itself, as the thesis does it.
    Affine,
    /// The affine model by the mean squared error that products of second degree, left out, would cause.
    DoubtedAffine,
    /// The quadratic NARX by I.
    Quadratic,
    /// The quadratic NARX by the mean squared error that terms of third degree, left out, would cause.
    DoubtedQuadratic,
}

impl Campaign {
    /// The designed ones.
    pub const DESIGNED: [Self; 4] =
        [Self::Affine, Self::DoubtedAffine, Self::Quadratic, Self::DoubtedQuadratic];

    /// Name in tables.
    pub fn name(self) -> String {
        match self {
            Campaign::Random(kind) => kind.name(),
            Campaign::Affine => "design: affine, AI".into(),
            Campaign::DoubtedAffine => "design: affine in doubt, MSE".into(),
            Campaign::Quadratic => "design: quadratic NARX, I".into(),
            Campaign::DoubtedQuadratic => "design: quadratic NARX in doubt, MSE".into(),
        }
    }
}

/// How a model is obtained from the records of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// The affine model (4.52) by least squares.
    Affine,
    /// The quadratic NARX by its simulation error.
    Quadratic,
    /// The affine model that comes nearest to the identified quadratic NARX over the objective signal.
    Reduced,
}

impl Way {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Affine, Self::Quadratic, Self::Reduced];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Way::Affine => "affine (4.52)",
            Way::Quadratic => "quadratic NARX",
            Way::Reduced => "affine, reduced from the quadratic NARX",
        }
    }
}

/// One way's result from one campaign of every seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Way.
    pub way: Way,
    /// Numerical rank of the records for the structure, per seed.
    pub rank: Vec<usize>,
    /// Mean squared error on unseen random records without noise in Nm^2, per seed.
    pub random: Vec<f64>,
    /// The same on unseen ramps and holds.
    pub ramps: Vec<f64>,
}

/// A kind of campaign over all seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Campaign.
    pub campaign: Campaign,
    /// Outcomes, one per way.
    pub outcomes: Vec<Outcome>,
    /// Mean of |lambda - 1| over all records: how well it was held.
    pub lambda_error: f64,
}

/// The whole comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BlackBox {
    /// Size.
    pub size: Size,
    /// Variance of the torque over the unseen records without noise: random, ramps.
    pub variance: (f64, f64),
    /// Campaigns.
    pub compared: Vec<Compared>,
}

/// What every campaign is compared on.
pub struct Setting<'a> {
    /// Engine.
    pub engine: &'a Engine<'a>,
    affine: PolyNarx,
    quadratic: PolyNarx,
    doubted_affine: PolyNarx,
    doubted_quadratic: PolyNarx,
    objective: Vec<f64>,
    random: Vec<Experiment>,
    ramps: Vec<Experiment>,
}

/// Streams of the records, one range for each use.
const OBJECTIVE: u64 = 1 << 40;
const UNSEEN: u64 = 2 << 40;
const TRAINING: u64 = 3 << 40;
const CAMPAIGN: u64 = 4 << 40;

impl<'a> Setting<'a> {
    /// Measures the unseen records, without noise.
    ///
    /// # Errors
    /// [`LoopError`] of the plant.
    pub fn new(engine: &'a Engine<'a>, size: Size) -> Result<Self, LoopError> {
        let unseen = |kind: Kind, first: u64| -> Result<Vec<Experiment>, LoopError> {
            let records: Result<Vec<Dataset>, LoopError> = (0..size.unseen)
                .into_par_iter()
                .map(|k| {
                    let mut rng = Rng64::stream(size.seed, UNSEEN + first + k);
                    engine.measure(false, 0, "unseen", &kind.record(&engine.bed, 200, &mut rng)?)
                })
                .collect();
            engine.bed.experiments(&records?, OUTPUT)
        };
        let objective = Kind::Udrn.record(&engine.bed, 200, &mut Rng64::stream(size.seed, OBJECTIVE))?;
        let structure =
            |e: StructureError| LoopError::Model { what: "structure".into(), reason: e.to_string() };
        Ok(Self {
            engine,
            affine: engine.affine().map_err(structure)?,
            quadratic: engine.quadratic().map_err(structure)?,
            doubted_affine: engine.doubted_affine().map_err(structure)?,
            doubted_quadratic: engine.doubted_quadratic().map_err(structure)?,
            objective,
            random: unseen(Kind::Udrn, 0)?,
            ramps: unseen(Kind::SpaceFilling { hold: 3, ramp: 3 }, 1 << 20)?,
        })
    }

    /// The kind among `kinds` whose quadratic NARX predicts best, on `records` training records of each and the unseen
    /// ones' own training counterparts.
    ///
    /// # Errors
    /// [`LoopError`] of the plant.
    pub fn tuned(&self, kinds: &[Kind], records: u64, size: Size) -> Result<Kind, LoopError> {
        let judge = (0..records)
            .into_par_iter()
            .map(|k| {
                let mut rng = Rng64::stream(size.seed, TRAINING + (1 << 30) + k);
                let u = Kind::Udrn.record(&self.engine.bed, 200, &mut rng)?;
                self.engine.measure(true, TRAINING + k, "training", &u)
            })
            .collect::<Result<Vec<_>, LoopError>>()?;
        let judge = self.engine.bed.experiments(&judge, OUTPUT)?;
        let error = |kind: &Kind| -> Result<f64, LoopError> {
            let each: Result<Vec<f64>, LoopError> = (0..records)
                .into_par_iter()
                .map(|k| {
                    let mut rng = Rng64::stream(size.seed, TRAINING + k);
                    let u = kind.record(&self.engine.bed, size.samples(), &mut rng)?;
                    let record = [self.engine.measure(true, TRAINING + (1 << 20) + k, "training", &u)?];
                    let data = self.engine.bed.experiments(&record, OUTPUT)?;
                    Ok(mean_square(&self.quadratic, &identify(&self.quadratic, &data)?.theta, &judge))
                })
                .collect();
            Ok(each?.iter().sum())
        };
        let errors: Result<Vec<f64>, LoopError> = kinds.iter().map(error).collect();
        let best = kinds.iter().zip(errors?).min_by(|a, b| a.1.total_cmp(&b.1));
        best.map(|b| *b.0).ok_or(LoopError::Shape { what: "kinds to choose from", found: 0, expected: 1 })
    }

    /// Runs the campaign for every seed and scores its models.
    ///
    /// # Errors
    /// [`LoopError`].
    pub fn compare(
        &self,
        campaign: Campaign,
        size: Size,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Compared, LoopError> {
        let one = |k: u64| -> Result<(Vec<Score>, f64), LoopError> {
            if interrupt() {
                return Err(LoopError::Interrupted);
            }
            let records = self.records(campaign, size, size.seed + k, interrupt)?;
            let data = self.engine.bed.experiments(&records, OUTPUT)?;
            let scores = Way::ALL.iter().map(|way| self.score(*way, &data)).collect::<Result<_, _>>()?;
            let lambda: Vec<f64> = records
                .iter()
                .flat_map(|r| r.values("lambda").map(<[f64]>::to_vec).unwrap_or_default())
                .collect();
            Ok((scores, lambda.iter().map(|l| (l - 1.0).abs()).sum::<f64>() / lambda.len() as f64))
        };
        let all: Result<Vec<_>, LoopError> = (0..size.seeds).into_par_iter().map(one).collect();
        let all = all?;
        let outcome = |i: usize| Outcome {
            way: Way::ALL[i],
            rank: all.iter().map(|a| a.0[i].0).collect(),
            random: all.iter().map(|a| a.0[i].1).collect(),
            ramps: all.iter().map(|a| a.0[i].2).collect(),
        };
        Ok(Compared {
            campaign,
            outcomes: (0..Way::ALL.len()).map(outcome).collect(),
            lambda_error: all.iter().map(|a| a.1).sum::<f64>() / all.len() as f64,
        })
    }

    fn records(
        &self,
        campaign: Campaign,
        size: Size,
        seed: u64,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<Dataset>, LoopError> {
        let bed = &self.engine.bed;
        let mut rng = Rng64::stream(seed, CAMPAIGN);
        let noise = CAMPAIGN + seed;
        let (kept, model, criterion, adds) = match campaign {
            Campaign::Random(kind) => {
                let u = kind.record(bed, size.samples(), &mut rng)?;
                return Ok(vec![self.engine.measure(true, noise, "random", &u)?]);
            }
            Campaign::Affine => (&self.affine, &self.affine, "ai", false),
            Campaign::DoubtedAffine => (&self.affine, &self.doubted_affine, "mse", true),
            Campaign::Quadratic => (&self.quadratic, &self.quadratic, "i", true),
            Campaign::DoubtedQuadratic => (&self.quadratic, &self.doubted_quadratic, "mse", true),
        };
        let mut plant = self.engine.plant(true, noise)?;
        let u = Kind::Udrn.record(bed, size.initial, &mut rng)?;
        let initial = vec![bed.measure(&mut plant, "initial", &u)?];
        let keys = match criterion {
            "mse" => doubt(kept, model, &bed.experiments(&initial, OUTPUT)?)?,
            _ => toml::Table::new(),
        };
        let search = DesignOptions { seed, evaluations: size.evaluations, ..DesignOptions::default() };
        let aim = Aim {
            criterion: criterion.into(),
            keys,
            objective: self.objective.clone(),
            adds,
            search,
            robust: None,
        };
        let structures = [Structure::new(OUTPUT, model)];
        let rounds = Rounds {
            bed,
            structures: &structures,
            aim: &aim,
            samples: size.designed,
            rounds: size.rounds,
            limits: &[],
        };
        Ok(iterate(&mut plant, &rounds, initial, interrupt)?.records)
    }

    /// Rank and errors on both unseen sets.
    fn score(&self, way: Way, data: &[Experiment]) -> Result<Score, LoopError> {
        let model = if way == Way::Quadratic { &self.quadratic } else { &self.affine };
        let fit = match way {
            Way::Reduced => {
                let rich = identify(&self.quadratic, data)?;
                Fit { rank: rich.rank, ..self.reduce(&rich.theta)? }
            }
            _ => identify(model, data)?,
        };
        let error = |unseen: &[Experiment]| mean_square(model, &fit.theta, unseen);
        Ok((fit.rank, error(&self.random), error(&self.ramps)))
    }

    /// The affine model nearest to the quadratic one over the objective signal.
    fn reduce(&self, theta: &[f64]) -> Result<Fit, LoopError> {
        let m = self.quadratic.n_inputs();
        let n = self.objective.len() / m;
        let lag = self.quadratic.max_lag();
        let mut e = Experiment {
            name: "objective signal".into(),
            u: self.objective.clone(),
            y: vec![0.0; n],
            init_samples: lag,
            weights: Vec::new(),
        };
        // The free run forgets its start within a few samples of a pole near 0.25.
        e.y = output(&self.quadratic, theta, &e, Computed::FreeRun);
        e.init_samples = 10;
        identify(&self.affine, &[e])
    }

    /// Variance of the unseen outputs.
    pub fn variance(&self) -> (f64, f64) {
        let of = |all: &[Experiment]| {
            let y: Vec<f64> = all.iter().flat_map(|e| e.y.clone()).collect();
            let mean = y.iter().sum::<f64>() / y.len() as f64;
            y.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / y.len() as f64
        };
        (of(&self.random), of(&self.ramps))
    }
}
