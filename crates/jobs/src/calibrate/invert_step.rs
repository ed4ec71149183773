//! Step 5: from measured optimal records to the dynamic map that is delivered, and the published map beside it.

use super::context::{ChainError, Context};
use super::optimise_step::{END_EFFECT, response_and_actuators};
use dynocal_calib::engine_model::EngineModel;
use dynocal_calib::map::published::{PUBLISHED_SHIFT, PublishedMap, input_rows, structures};
use dynocal_calib::map::structured::{Pairs, StructuredMap};
use dynocal_calib::map::{Actuators, Reference};
use dynocal_ident::data::Dataset;
use dynocal_ident::estimate::{Estimator, ols::Ols, sem::Sem};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Fit of one actuator by one map on the identification data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InverseScore {
    /// Map.
    pub map: String,
    /// Actuator.
    pub actuator: String,
    /// Estimator.
    pub estimator: String,
    /// R2 of the simulated actuator; none when the free run is unstable.
    pub r2: Option<f64>,
    /// How the estimator ended.
    pub status: Status,
}

/// What step 5 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct InvertResult {
    /// The map that is delivered.
    pub dynamic: StructuredMap,
    /// The published structure, for comparison; none when no stable fit was found.
    pub published: Option<PublishedMap>,
    /// Fits.
    pub scores: Vec<InverseScore>,
    /// Whether pairs came from measured or simulated responses.
    pub pairs: String,
    /// Records used.
    pub records: Vec<String>,
}

type Record = (Vec<Reference>, Vec<Actuators>);

/// Fits both maps on the optimal records.
///
/// # Errors
/// [`ChainError`].
pub fn invert(
    ctx: &Context,
    optima: &[Dataset],
    torque: &EngineModel,
    lambda: &EngineModel,
) -> Result<InvertResult, ChainError> {
    let simulated = match ctx.spec.invert.pairs.as_str() {
        "measured" => false,
        "simulated" => true,
        "auto" => ctx.noisy(),
        other => {
            return Err(ChainError::Spec {
                key: "invert.pairs".into(),
                found: format!("\"{other}\""),
                expected: "one of auto, measured, simulated".into(),
            });
        }
    };
    let data: Vec<Record> = optima
        .iter()
        .map(|d| {
            let (mut response, actuators) = response_and_actuators(d)?;
            if simulated {
                // Noise in the regressors biases an inverse towards zero; the model's free run has none.
                let (t, _) = torque.simulate(d)?;
                let (l, _) = lambda.simulate(d)?;
                for (k, r) in response.iter_mut().enumerate() {
                    (r.torque_nm, r.lambda) = (t[k], l[k]);
                }
            }
            let n = response.len().saturating_sub(END_EFFECT);
            response.truncate(n);
            Ok((response, actuators[..n].to_vec()))
        })
        .collect::<Result<_, ChainError>>()?;
    let pairs: Vec<Pairs> = data.iter().map(|(r, a)| Pairs { response: r, actuators: a }).collect();
    let dynamic = StructuredMap::fit(&ctx.spec.invert.shape, &pairs, ctx.map_limits())?;
    let mut scores = structured_scores(&dynamic, &data);
    let published = published(ctx, &data, &mut scores)?;
    Ok(InvertResult {
        dynamic,
        published,
        scores,
        pairs: if simulated { "simulated" } else { "measured" }.into(),
        records: optima.iter().map(|d| d.name.clone()).collect(),
    })
}

const ACTUATORS: [&str; 3] = ["inj", "spark", "throttle"];

fn structured_scores(map: &StructuredMap, data: &[Record]) -> Vec<InverseScore> {
    (0..3)
        .map(|c| {
            let (mut y, mut z) = (Vec::new(), Vec::new());
            for (response, actuators) in data {
                for t in 0..response.len() {
                    y.push(map.at(response, t)[c]);
                    z.push(actuators[t][c]);
                }
            }
            InverseScore {
                map: "structured inverse".into(),
                actuator: ACTUATORS[c].into(),
                estimator: "least squares".into(),
                r2: Some(r2(&y, &z)),
                status: Status::Converged,
            }
        })
        .collect()
}

fn r2(y: &[f64], z: &[f64]) -> f64 {
    let mean = z.iter().sum::<f64>() / z.len().max(1) as f64;
    let sse: f64 = y.iter().zip(z).map(|(a, b)| (a - b).powi(2)).sum();
    1.0 - sse / z.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
}

/// Records shifted by eq. (7.17): response at t + shift explains the actuator at t.
fn shifted(data: &[Record], actuator: usize) -> Vec<Experiment> {
    data.iter()
        .enumerate()
        .map(|(k, (response, actuators))| {
            let n = response.len().saturating_sub(PUBLISHED_SHIFT);
            Experiment {
                name: format!("optimal record {}", k + 1),
                u: input_rows(&response[PUBLISHED_SHIFT.min(response.len())..]),
                y: actuators[..n].iter().map(|a| a[actuator]).collect(),
                init_samples: 4,
                weights: Vec::new(),
            }
        })
        .collect()
}

fn published(
    ctx: &Context,
    data: &[Record],
    scores: &mut Vec<InverseScore>,
) -> Result<Option<PublishedMap>, ChainError> {
    let models = structures();
    let mut theta: [Vec<f64>; 3] = Default::default();
    let mut stable = true;
    for (c, model) in models.iter().enumerate() {
        ctx.check_interrupt()?;
        let experiments = shifted(data, c);
        // The least-squares start of these structures is often unstable: several starts are worth their time.
        let sem = Sem {
            max_evaluations: 100,
            restarts: 3,
            seed: ctx.spec.seed,
            cost_tolerance: 1e-8,
            ..Sem::default()
        };
        let jobs: [(&str, &dyn Estimator); 2] =
            [("one-step error", &Ols::default()), ("simulation error", &sem)];
        for (estimator, job) in jobs {
            let fit = job.estimate(model, &experiments, None, &|| (ctx.interrupt)());
            let (r2, status) = match &fit {
                Ok(fit) => (simulated_r2(model, &fit.theta, &experiments), fit.status),
                Err(_) => (None, Status::Diverged),
            };
            scores.push(InverseScore {
                map: "published inverse (7.18)".into(),
                actuator: ACTUATORS[c].into(),
                estimator: estimator.into(),
                r2,
                status,
            });
            // A fit whose free run diverges is no map.
            if let (Ok(fit), "simulation error", Some(_)) = (fit, estimator, r2) {
                theta[c] = fit.theta;
            }
        }
        stable &= !theta[c].is_empty();
    }
    let limits = ctx.map_limits();
    Ok(stable.then_some(PublishedMap { models, theta, shift: PUBLISHED_SHIFT, limits }))
}

fn simulated_r2(model: &dyn Model, theta: &[f64], data: &[Experiment]) -> Option<f64> {
    let (mut y, mut z) = (Vec::new(), Vec::new());
    for e in data {
        let mut out = vec![0.0; e.len()];
        let start = e.first(model);
        model.simulate(theta, &Run { u: &e.u, y: &e.y, start }, &mut out);
        y.extend_from_slice(&out[start..]);
        z.extend_from_slice(&e.y[start..]);
    }
    Some(r2(&y, &z)).filter(|v| v.is_finite())
}
