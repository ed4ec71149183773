//! Stored models as the optimisation takes them.

use super::guard::Guarded;
use super::model::{OutputModel, OutputWay, Source};
use super::setup::Setup;
use super::{OptimiseError, OptimiseOptions, Optimum, Robust, Way, dynamic, optimise_models};
use crate::problem::CalibrationProblem;
use dynocal_ident::data::Dataset;
use dynocal_ident::derived::Monomial;
use dynocal_ident::estimate::ParameterDistribution;
use dynocal_ident::model::Run;
use dynocal_ident::model::form::Driven;
use dynocal_ident::stored::{StoredError, StoredModel};
use dynocal_ident::validate::boundary::BoundaryModel;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

/// What a stored model is to an optimisation: the structure that its inputs drive, and the way to it and back.
pub struct StoredOutput {
    output: String,
    driven: Driven,
    inputs: Vec<Source>,
    way: OutputWay,
    boundary: Option<BoundaryModel>,
    draws: Vec<Vec<f64>>,
}

impl StoredOutput {
    /// Takes the model apart.
    ///
    /// # Errors
    /// [`StoredError`]: nothing drives it, or its preparation does not act sample by sample.
    pub fn new(model: &StoredModel) -> Result<Self, StoredError> {
        let (driven, pointwise) = (model.driven()?, model.pointwise()?);
        let inputs = pointwise
            .inputs
            .iter()
            .map(|(name, affine)| Source {
                monomial: Monomial::of(name, &model.derived),
                offset: affine.offset,
                scale: affine.scale,
            })
            .collect();
        // The structure's own output is a monomial of the user's.
        let (factor, power) = match model.output_transform() {
            Some(t) => (t.factor, t.powers.values().next().copied().unwrap_or(1)),
            None => (1.0, 1),
        };
        let (offset, scale) = (pointwise.output.offset, pointwise.output.scale);
        let way = OutputWay { factor, power, offset, scale };
        let boundary = model.boundary.clone();
        Ok(Self { output: model.user_output().name, driven, inputs, way, boundary, draws: Vec::new() })
    }

    /// The model in the form of the program.
    pub fn model(&self) -> OutputModel<'_> {
        OutputModel {
            output: self.output.clone(),
            model: self.driven.model.as_ref(),
            theta: &self.driven.theta,
            inputs: self.inputs.clone(),
            way: self.way,
            boundary: self.boundary.as_ref(),
            draws: self.draws.clone(),
        }
    }
}

/// Largest relative difference of sample times that counts as equal.
const SAME_TIME: f64 = 1e-6;

/// [`optimise_models`] for stored models, whose units and sample time must be those of the record.
///
/// # Errors
/// [`OptimiseError`].
pub fn optimise_record(
    problem: &CalibrationProblem,
    models: &[&StoredModel],
    start: &Dataset,
    options: &OptimiseOptions,
    interrupt: &dyn Fn() -> bool,
) -> Result<Optimum, OptimiseError> {
    let taken = taken(models, start, options)?;
    let all: Vec<OutputModel> = taken.iter().map(StoredOutput::model).collect();
    optimise_models(problem, &all, start, options, interrupt)
}

/// All that [`optimise_record`] asks of problem, models and record before it searches.
///
/// # Errors
/// As [`optimise_record`].
pub fn check_record(
    problem: &CalibrationProblem,
    models: &[&StoredModel],
    start: &Dataset,
    options: &OptimiseOptions,
) -> Result<(), OptimiseError> {
    let taken = taken(models, start, options)?;
    let all: Vec<OutputModel> = taken.iter().map(StoredOutput::model).collect();
    let setup = Setup::new(problem, &all, start, options)?;
    if let Way::Dynamic(spec) = &options.way {
        dynamic::check(&setup, options, spec)?;
    }
    options.guard.map_or(Ok(()), |guard| Guarded::new(problem, &all, start, guard).map(drop))
}

fn taken(
    models: &[&StoredModel],
    start: &Dataset,
    options: &OptimiseOptions,
) -> Result<Vec<StoredOutput>, OptimiseError> {
    models.iter().try_for_each(|m| belongs(m, start))?;
    let mut taken = models.iter().map(|m| StoredOutput::new(m)).collect::<Result<Vec<_>, _>>()?;
    if let Some(robust) = options.robust {
        for (k, (t, m)) in taken.iter_mut().zip(models).enumerate() {
            t.draws = draws(t, m, start, robust, k as u64)?;
        }
    }
    Ok(taken)
}

/// Tries for each draw that is wanted.
const TRIES: usize = 20;
/// A draw is stable where its free run goes no further from zero than this many times what the record and the estimate's run do.
const STABLE: f64 = 10.0;

/// Draws of a stored model's parameters that are stable over the record: what an estimate says of its parameters knows nothing of
/// stability.
fn draws(
    taken: &StoredOutput,
    model: &StoredModel,
    record: &Dataset,
    robust: Robust,
    stream: u64,
) -> Result<Vec<Vec<f64>>, OptimiseError> {
    let refused = |found: String| OptimiseError::Draws { output: taken.output.clone(), found };
    let covariance = model.covariance().ok_or_else(|| {
        refused("does not say how its parameters depend on each other (identify it again)".into())
    })?;
    let distribution = ParameterDistribution::new(&model.theta(), &covariance)
        .map_err(|e| refused(format!("has a covariance that cannot be drawn from ({e})")))?;
    let of = taken.model();
    let u = of.rows(record)?;
    let y: Vec<f64> = record.values(&taken.output)?.iter().map(|y| taken.way.to_model(*y)).collect();
    let greatest = |v: &[f64]| v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let reach = |theta: &[f64]| {
        let mut run = vec![0.0; y.len()];
        let status = of.model.simulate(theta, &Run { u: &u, y: &y, start: of.model.max_lag() }, &mut run);
        let far = greatest(&run);
        if status == Status::Converged { far } else { f64::INFINITY }
    };
    let bound = STABLE * reach(&taken.driven.theta).max(greatest(&y));
    let mut rng = Rng64::stream(robust.seed, stream);
    let (mut out, tries) = (Vec::new(), TRIES * robust.draws);
    for _ in 0..tries {
        let mut other = model.clone();
        let theta = distribution.draw(&mut rng);
        other.parameters.iter_mut().zip(theta).for_each(|(p, v)| p.value = v);
        let theta = other.driven()?.theta;
        if reach(&theta) <= bound {
            out.push(theta);
        }
        if out.len() == robust.draws {
            return Ok(out);
        }
    }
    Err(refused(format!(
        "is stable over `{}` in {} of {tries} draws of its parameters",
        record.name,
        out.len()
    )))
}

fn belongs(model: &StoredModel, record: &Dataset) -> Result<(), OptimiseError> {
    let (name, output) = (record.name.clone(), model.user_output().name);
    let (found, expected) = (record.sample_time_s, model.sample_time_s);
    if (found - expected).abs() > SAME_TIME * expected {
        return Err(OptimiseError::SampleTime { record: name, found, output, expected });
    }
    for q in model.measured() {
        let channel = record.channel(&q.name)?;
        // Old files do not know the unit of every measured channel.
        if channel.unit != q.unit && q.unit != "-" {
            let (found, expected) = (channel.unit.clone(), q.unit);
            return Err(OptimiseError::Unit { record: name, channel: q.name, found, output, expected });
        }
    }
    Ok(())
}
