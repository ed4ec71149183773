//! Networks of section 7.4.2: Table 7.1, the best of ten trainings as in Table 7.2, and the best of eight starts chosen
//! on a record of its own.

use dynocal_ident::data::Dataset;
use dynocal_ident::estimate::EstimateError;
use dynocal_ident::estimate::train::{Division, Train, layer_sizes};
use dynocal_ident::experiment::{Experiment, experiments};
use dynocal_ident::model::Model;
use dynocal_ident::model::neural::NeuralNarx;
use dynocal_ident::validate::{Kind, output};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::plans::INPUTS;
use super::{Chapter5Error, Fitness};
use crate::chapter4::work::statistics::Stat;

/// Lags of every input and of the output, eq. (7.7).
pub const LAGS: (usize, usize) = (5, 1);
/// Neurons of the chosen network.
pub const NEURONS: usize = 10;
/// Share of the samples that selects, and share that only tests.
const SELECTION: f64 = 0.15;
const TEST: f64 = 0.15;

/// Scores of one layer size.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Size {
    /// Neurons of the hidden layer.
    pub hidden: usize,
    /// Weights.
    pub weights: usize,
    /// Free-run MSE over the trainings: fitted, selecting and test samples; none where a training failed.
    pub mse: [Option<Stat>; 3],
}

/// Trains each size `trainings` times on one record, each time with another random division 70/15/15 of its samples and
/// another start, and gives the free-run MSE of the three parts.
///
/// # Errors
/// [`Chapter5Error::Estimate`], [`Chapter5Error::Interrupted`].
pub fn sizes(
    record: &Dataset,
    of: &str,
    sizes: &[usize],
    trainings: u64,
    options: &Options,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Size>, Chapter5Error> {
    let data = experiments_of(std::slice::from_ref(record), of)?;
    // Large ones first: the last to begin should not be the longest.
    let mut tasks: Vec<(usize, u64)> =
        sizes.iter().flat_map(|h| (0..trainings).map(move |k| (*h, k))).collect();
    tasks.sort_by_key(|(h, k)| (std::cmp::Reverse(*h), *k));
    let one = |&(hidden, k): &(usize, u64)| -> Result<(usize, usize, [f64; 3]), Chapter5Error> {
        if interrupt() {
            return Err(Chapter5Error::Interrupted);
        }
        let train = divided(options, options.seed + k);
        let build = |h: &[usize]| -> Result<Box<dyn Model>, EstimateError> {
            Ok(Box::new(NeuralNarx::new(&INPUTS, of, h[0], LAGS.0, LAGS.1)?.scaled_to(&data)?))
        };
        let rows = layer_sizes(&train, &[vec![hidden]], 1, &build, &data, &|| interrupt())?;
        let found = rows.first().map_or([f64::NAN; 3], |r| [r.fit, r.selection, r.test]);
        Ok((hidden, rows.first().map_or(0, |r| r.params), found))
    };
    let found: Vec<(usize, usize, [f64; 3])> =
        tasks.par_iter().map(one).collect::<Vec<_>>().into_iter().collect::<Result<_, _>>()?;
    let row = |hidden: &usize| {
        let of_size = || found.iter().filter(|f| f.0 == *hidden);
        let part = |i: usize| Stat::of(&of_size().map(|f| f.2[i]).collect::<Vec<_>>());
        let weights = of_size().next().map_or(0, |f| f.1);
        Size { hidden: *hidden, weights, mse: [part(0), part(1), part(2)] }
    };
    Ok(sizes.iter().map(row).collect())
}

/// How long the trainings are.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Options {
    /// Seed.
    pub seed: u64,
    /// Most cost evaluations of one training.
    pub evaluations: usize,
    /// Moves without a better selection score that end a training.
    pub patience: usize,
}

fn divided(options: &Options, seed: u64) -> Train {
    Train {
        starts: 1,
        division: Division::Random,
        selection: SELECTION,
        test: TEST,
        max_evaluations: options.evaluations,
        patience: options.patience,
        seed,
        ..Train::default()
    }
}

/// A trained network with its scores.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trained {
    /// Score of every training or start by which the best is chosen (MSE).
    #[serde(deserialize_with = "dynocal_ident::nullable::numbers")]
    pub scores: Vec<f64>,
    /// The best one.
    pub best: usize,
    /// Free run on the identification record, the first where there are several.
    pub identification: Fitness,
    /// Free run on the selection record, where there is one.
    pub selection: Option<Fitness>,
    /// Free run on each unseen record.
    pub unseen: Vec<Fitness>,
    /// Free run over the first unseen record.
    #[serde(deserialize_with = "dynocal_ident::nullable::numbers")]
    pub unseen_trace: Vec<f64>,
    /// Measured output there.
    pub unseen_measured: Vec<f64>,
}

impl Trained {
    /// Mean over the unseen records.
    pub fn mean_unseen(&self) -> Fitness {
        Fitness::mean(&self.unseen)
    }
}

/// As the thesis: `trainings` with random divisions of one record, the best on its own test samples is kept.
///
/// # Errors
/// As [`sizes`].
pub fn best_of_divisions(
    identification: &Dataset,
    unseen: &[Dataset],
    of: &str,
    trainings: u64,
    options: &Options,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Trained, Chapter5Error> {
    let data = experiments_of(std::slice::from_ref(identification), of)?;
    let net = network(of, &data)?;
    let one = |k: u64| -> Result<(Vec<f64>, f64), Chapter5Error> {
        if interrupt() {
            return Err(Chapter5Error::Interrupted);
        }
        let found = divided(options, options.seed + k).train(&net, &data, &[], None, &|| interrupt())?;
        Ok((found.fit.theta, found.test_scores[found.best]))
    };
    let found: Vec<(Vec<f64>, f64)> =
        (0..trainings).into_par_iter().map(one).collect::<Vec<_>>().into_iter().collect::<Result<_, _>>()?;
    let (thetas, scores): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    let best = (0..scores.len()).min_by(|a, b| scores[*a].total_cmp(&scores[*b])).unwrap_or(0);
    Ok(trained(&net, &thetas[best], scores, best, &data[0], None, &experiments_of(unseen, of)?))
}

/// `starts` random starts fitted to all of the identification records, stopped and chosen on the selection record.
///
/// # Errors
/// As [`sizes`].
pub fn best_of_starts(
    identification: &[Dataset],
    selection: &Dataset,
    unseen: &[Dataset],
    of: &str,
    starts: usize,
    options: &Options,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Trained, Chapter5Error> {
    let data = experiments_of(identification, of)?;
    let selecting = experiments_of(std::slice::from_ref(selection), of)?;
    let net = network(of, &data)?;
    let train = Train {
        starts,
        max_evaluations: options.evaluations,
        patience: options.patience,
        seed: options.seed,
        ..Train::default()
    };
    let found = train.train(&net, &data, &selecting, None, &|| interrupt())?;
    if interrupt() {
        return Err(Chapter5Error::Interrupted);
    }
    let theta = &found.fit.theta;
    let unseen = experiments_of(unseen, of)?;
    Ok(trained(&net, theta, found.scores, found.best, &data[0], selecting.first(), &unseen))
}

fn trained(
    net: &NeuralNarx,
    theta: &[f64],
    scores: Vec<f64>,
    best: usize,
    data: &Experiment,
    selection: Option<&Experiment>,
    unseen: &[Experiment],
) -> Trained {
    let of = |e: &Experiment| Fitness::of(net, theta, e, Kind::FreeRun);
    Trained {
        scores,
        best,
        identification: of(data),
        selection: selection.map(of),
        unseen: unseen.iter().map(of).collect(),
        unseen_trace: unseen.first().map(|e| output(net, theta, e, Kind::FreeRun)).unwrap_or_default(),
        unseen_measured: unseen.first().map(|e| e.y.clone()).unwrap_or_default(),
    }
}

fn experiments_of(records: &[Dataset], of: &str) -> Result<Vec<Experiment>, Chapter5Error> {
    Ok(experiments(records, &INPUTS.map(String::from), of)?)
}

fn network(of: &str, data: &[Experiment]) -> Result<NeuralNarx, Chapter5Error> {
    Ok(NeuralNarx::new(&INPUTS, of, NEURONS, LAGS.0, LAGS.1)?.scaled_to(data)?)
}
