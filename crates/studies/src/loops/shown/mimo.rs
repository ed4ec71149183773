//! One record for two outputs (thesis section 4.11) on the engine: torque and lambda from fuel, spark, throttle and
//! speed.

use dynocal_design::channel::Channel;
use dynocal_design::search::DesignOptions;
use dynocal_ident::data::Dataset;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::{PolyNarx, StructureError};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::signals::Kind;
use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::bed::TestBed;
use dynocal_calib::loops::model::{identify, mean_square};
use dynocal_calib::loops::plan::{Aim, Structure};
use dynocal_calib::loops::rounds::{Rounds, iterate};
use dynocal_jobs::calibrate::context::PlantFactory;

/// Outputs.
pub const OUTPUTS: [&str; 2] = ["torque", "lambda"];

/// What a record is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum For {
    /// Nothing: uniform random.
    Random,
    /// Torque alone.
    Torque,
    /// Lambda alone.
    Lambda,
    /// Both, each relative to its value for a random record.
    Both,
}

impl For {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Random, Self::Torque, Self::Lambda, Self::Both];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            For::Random => "UDRN",
            For::Torque => "design for torque",
            For::Lambda => "design for lambda",
            For::Both => "composite design",
        }
    }
}

/// Errors on unseen records without noise, per seed: torque in Nm^2, lambda.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// What the records were for.
    pub of: For,
    /// Mean squared errors per output, per seed.
    pub mse: [Vec<f64>; 2],
}

/// Size of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// First seed.
    pub seed: u64,
    /// Seeds.
    pub seeds: u64,
    /// Samples of the first, random record.
    pub initial: usize,
    /// Samples of the designed one.
    pub samples: usize,
    /// Unseen records.
    pub unseen: u64,
    /// Evaluations of one design.
    pub evaluations: usize,
}

/// Box about 2000 rpm and 30 Nm in which lambda stays near 1.
fn bed() -> TestBed {
    let channels = vec![
        Channel::free("inj", 8.5, 10.5),
        Channel::free("spark", 10.0, 30.0),
        Channel::free("throttle", 9.5, 11.5),
        Channel::free("speed", 1800.0, 2200.0),
    ];
    TestBed { channels, sample_time_s: 0.3, settle_s: 3.0 }
}

/// All inputs at two lags, all products of second degree at the first, and the last output. Lambda does not read the
/// spark.
fn structure(output: &str) -> Result<PolyNarx, StructureError> {
    let all = bed().names();
    let names: Vec<&String> = all.iter().filter(|n| output == OUTPUTS[0] || *n != "spark").collect();
    let mut terms: Vec<String> = vec!["1".into()];
    for lag in [1, 2] {
        terms.extend(names.iter().map(|n| format!("{n}(t-{lag})")));
    }
    for (i, a) in names.iter().enumerate() {
        terms.push(format!("{a}(t-1)^2"));
        terms.extend(names[i + 1..].iter().map(|b| format!("{a}(t-1)*{b}(t-1)")));
    }
    terms.push(format!("{output}(t-1)"));
    PolyNarx::parse(&all, output, &terms)
}

/// Records for every purpose and seed, and the errors of both models.
///
/// # Errors
/// [`LoopError`].
pub fn compare(
    plants: PlantFactory,
    size: Size,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Errors>, LoopError> {
    let bed = bed();
    let fault = |e: StructureError| LoopError::Model { what: "structure".into(), reason: e.to_string() };
    let models = [structure(OUTPUTS[0]).map_err(fault)?, structure(OUTPUTS[1]).map_err(fault)?];
    let unseen: Result<Vec<Dataset>, LoopError> = (0..size.unseen)
        .into_par_iter()
        .map(|k| {
            let u = Kind::Udrn.record(&bed, 200, &mut Rng64::stream(size.seed, (9 << 40) + k))?;
            bed.measure(plants(false)?.as_mut(), "unseen", &u)
        })
        .collect();
    let unseen = unseen?;
    let unseen: Vec<Vec<Experiment>> =
        OUTPUTS.iter().map(|o| bed.experiments(&unseen, o)).collect::<Result<_, _>>()?;
    let objective = Kind::Udrn.record(&bed, 200, &mut Rng64::stream(size.seed, 10 << 40))?;
    let one = |of: For, k: u64| -> Result<[f64; 2], LoopError> {
        if interrupt() {
            return Err(LoopError::Interrupted);
        }
        let seed = size.seed + k;
        let mut rng = Rng64::stream(seed, 11 << 40);
        let mut plant = plants(true)?;
        plant.reset((11 << 40) + seed);
        let first = Kind::Udrn.record(&bed, size.initial, &mut rng)?;
        let mut records = vec![bed.measure(plant.as_mut(), "initial", &first)?];
        let both: Vec<Structure> =
            OUTPUTS.iter().zip(&models).map(|(output, model)| Structure::new(output, model)).collect();
        let structures = match of {
            For::Random => {
                let u = Kind::Udrn.record(&bed, size.samples, &mut rng)?;
                records.push(bed.measure(plant.as_mut(), "random", &u)?);
                &[][..]
            }
            For::Torque => &both[..1],
            For::Lambda => &both[1..],
            For::Both => &both[..],
        };
        if !structures.is_empty() {
            let search = DesignOptions { seed, evaluations: size.evaluations, ..DesignOptions::default() };
            let aim = Aim {
                criterion: "i".into(),
                keys: toml::Table::new(),
                objective: objective.clone(),
                adds: true,
                search,
                robust: None,
            };
            let rounds =
                Rounds { bed: &bed, structures, aim: &aim, samples: size.samples, rounds: 1, limits: &[] };
            records = iterate(plant.as_mut(), &rounds, records, interrupt)?.records;
        }
        let mut mse = [0.0; 2];
        for i in 0..2 {
            let data = bed.experiments(&records, OUTPUTS[i])?;
            mse[i] = mean_square(&models[i], &identify(&models[i], &data)?.theta, &unseen[i]);
        }
        Ok(mse)
    };
    For::ALL
        .into_iter()
        .map(|of| {
            let all: Result<Vec<[f64; 2]>, LoopError> =
                (0..size.seeds).into_par_iter().map(|k| one(of, k)).collect();
            let all = all?;
            Ok(Errors { of, mse: [0, 1].map(|i| all.iter().map(|m| m[i]).collect()) })
        })
        .collect()
}
