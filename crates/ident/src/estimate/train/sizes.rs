//! How large a network should be: thesis Table 7.1.

use serde::Serialize;

use super::Train;
use crate::estimate::EstimateError;
use crate::experiment::Experiment;
use crate::model::Model;

/// One row of the study: means over all trainings of one size.
#[derive(Clone, Debug, Serialize)]
pub struct SizeScore {
    /// Neurons of each hidden layer.
    pub hidden: Vec<usize>,
    /// Parameters.
    pub params: usize,
    /// Mean squared free-run error on the fitted samples.
    pub fit: f64,
    /// The same on the selection samples.
    pub selection: f64,
    /// The same on the test samples; NaN without any.
    pub test: f64,
    /// Trainings that the means are taken over.
    pub trainings: usize,
}

/// Builds the model with these neurons in its hidden layers.
pub type BuildSize<'a> = dyn Fn(&[usize]) -> Result<Box<dyn Model>, EstimateError> + 'a;

/// Trains every size `trainings` times, each time with another division and other starts (seeds from `train.seed` on),
/// and gives the mean scores of the chosen points, one row per size.
///
/// # Errors
/// As [`Train::train`], and what `build` gives for a size.
pub fn layer_sizes(
    train: &Train,
    sizes: &[Vec<usize>],
    trainings: usize,
    build: &BuildSize<'_>,
    data: &[Experiment],
    interrupt: &dyn Fn() -> bool,
) -> Result<Vec<SizeScore>, EstimateError> {
    let mut rows = Vec::with_capacity(sizes.len());
    for hidden in sizes {
        let model = build(hidden)?;
        let mut sums = [0.0; 3];
        for i in 0..trainings.max(1) {
            let seed = train.seed + i as u64;
            let found = Train { seed, ..train.clone() }.train(model.as_ref(), data, &[], None, interrupt)?;
            let best = found.best;
            for (sum, v) in sums.iter_mut().zip([found.fit.mse, found.scores[best], found.test_scores[best]])
            {
                *sum += v;
            }
        }
        let mean = |i: usize| sums[i] / trainings.max(1) as f64;
        rows.push(SizeScore {
            hidden: hidden.clone(),
            params: model.n_params(),
            fit: mean(0),
            selection: mean(1),
            test: mean(2),
            trainings: trainings.max(1),
        });
    }
    Ok(rows)
}
