//! Step 5: from measured optimal records to the dynamic map that is delivered, and the published map beside it where the
//! problem is the thesis'.

use super::context::{ChainError, Context};
use super::optimise_step::END_EFFECT;
use dynocal_calib::map::Rows;
use dynocal_calib::map::published::{self, PUBLISHED_SHIFT, PublishedMap};
use dynocal_calib::map::structured::{Pairs, StructuredMap};
use dynocal_ident::data::Dataset;
use dynocal_ident::estimate::{Estimator, ols::Ols, sem::Sem};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::{Model, Run};
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Fit of one actuator by one map on the identification data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InverseScore {
    /// Map.
    pub map: String,
    /// Actuator.
    pub actuator: String,
    /// Estimator.
    pub estimator: String,
    /// R2 of the simulated actuator; none when the free run is unstable or the actuator does not move.
    pub r2: Option<f64>,
    /// How the estimator ended.
    pub status: Status,
}

/// What step 5 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InvertResult {
    /// The map that is delivered.
    pub dynamic: StructuredMap,
    /// The published structure, for comparison; none when no stable fit was found or the problem is another.
    pub published: Option<PublishedMap>,
    /// Fits.
    pub scores: Vec<InverseScore>,
    /// Whether pairs came from measured or simulated responses.
    pub pairs: String,
    /// Records used.
    pub records: Vec<String>,
    /// Records of passes that were left out because their optimum must not be used.
    pub left_out: Vec<String>,
}

/// Response and actuators of one record.
type Record = (Rows, Rows);

/// Fits both maps on the optimal records; `models` by output, in the order of the demands first.
///
/// # Errors
/// [`ChainError`].
pub fn invert(
    ctx: &Context,
    optima: &[Dataset],
    left_out: Vec<String>,
    models: &[&StoredModel],
) -> Result<InvertResult, ChainError> {
    let simulated = match ctx.spec.invert.pairs.as_str() {
        "measured" => false,
        "simulated" => true,
        _ => ctx.noisy(),
    };
    let data: Vec<Record> =
        optima.iter().map(|d| pairs_of(ctx, d, simulated, models)).collect::<Result<_, _>>()?;
    let pairs: Vec<Pairs> = data.iter().map(|(r, a)| Pairs { response: r, actuators: a }).collect();
    let dynamic = StructuredMap::fit(&ctx.spec.invert.shape, &ctx.channels.ports, &pairs)?;
    let mut scores = structured_scores(&dynamic, &data);
    let published = match published::fits(&ctx.channels.ports) {
        true => published_map(ctx, &data, &mut scores)?,
        false => None,
    };
    Ok(InvertResult {
        dynamic,
        published,
        scores,
        pairs: if simulated { "simulated" } else { "measured" }.into(),
        records: optima.iter().map(|d| d.name.clone()).collect(),
        left_out,
    })
}

fn pairs_of(
    ctx: &Context,
    record: &Dataset,
    simulated: bool,
    models: &[&StoredModel],
) -> Result<Record, ChainError> {
    let (mut response, mut actuators) = (ctx.channels.references(record)?, ctx.channels.actuators(record)?);
    if simulated {
        // Noise in the regressors biases an inverse towards zero; the model's free run has none.
        for (k, demand) in ctx.channels.demands.iter().enumerate() {
            let Some(model) = models.iter().find(|m| m.user_output().name == *demand) else { continue };
            if let Some(run) = model.simulate(record, None)?.into_iter().next() {
                response.set_column(k, &run.y);
            }
        }
    }
    let n = response.len().saturating_sub(END_EFFECT);
    response.truncate(n);
    actuators.truncate(n);
    Ok((response, actuators))
}

fn structured_scores(map: &StructuredMap, data: &[Record]) -> Vec<InverseScore> {
    let width = map.ports.actuators.len();
    let mut u = vec![0.0; width];
    let mut columns = vec![(Vec::new(), Vec::new()); width];
    for (response, actuators) in data {
        for t in 0..response.len() {
            map.at(response, t, &mut u);
            for (c, (y, z)) in columns.iter_mut().enumerate() {
                y.push(u[c]);
                z.push(actuators.row(t)[c]);
            }
        }
    }
    map.ports
        .actuators
        .iter()
        .zip(columns)
        .map(|(port, (y, z))| InverseScore {
            map: "structured inverse".into(),
            actuator: port.name.clone(),
            estimator: "least squares".into(),
            r2: r2(&y, &z),
            status: Status::Converged,
        })
        .collect()
}

fn r2(y: &[f64], z: &[f64]) -> Option<f64> {
    let mean = z.iter().sum::<f64>() / z.len().max(1) as f64;
    let sse: f64 = y.iter().zip(z).map(|(a, b)| (a - b).powi(2)).sum();
    Some(1.0 - sse / z.iter().map(|v| (v - mean).powi(2)).sum::<f64>()).filter(|v| v.is_finite())
}

/// Records shifted by eq. (7.17): response at t + shift explains the actuator at t.
fn shifted(data: &[Record], actuator: usize) -> Vec<Experiment> {
    data.iter()
        .enumerate()
        .map(|(k, (response, actuators))| {
            let n = response.len().saturating_sub(PUBLISHED_SHIFT);
            let from = PUBLISHED_SHIFT.min(response.len()) * response.width();
            Experiment {
                name: format!("optimal record {}", k + 1),
                u: response.values()[from..].to_vec(),
                y: (0..n).map(|t| actuators.row(t)[actuator]).collect(),
                init_samples: 4,
                weights: Vec::new(),
            }
        })
        .collect()
}

fn published_map(
    ctx: &Context,
    data: &[Record],
    scores: &mut Vec<InverseScore>,
) -> Result<Option<PublishedMap>, ChainError> {
    let models = published::structures();
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
            let fit = job.estimate(model, &experiments, None, &|| ctx.watch.interrupted());
            let (r2, status) = match &fit {
                Ok(fit) => (simulated_r2(model, &fit.theta, &experiments), fit.status),
                Err(_) => (None, Status::Diverged),
            };
            scores.push(InverseScore {
                map: "published inverse (7.18)".into(),
                actuator: published::ACTUATORS[c].into(),
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
    let ports = ctx.channels.ports.clone();
    Ok(stable.then_some(PublishedMap { ports, models, theta, shift: PUBLISHED_SHIFT }))
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
    r2(&y, &z)
}
