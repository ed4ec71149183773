//! What the design is compared with: random signals within the same limits.

use dynocal_design::channel::Layout;
use dynocal_design::criterion::{Criterion, criterion};
use dynocal_design::problem::{DesignProblem, Evaluator, Term};
use dynocal_design::search::Values;
use dynocal_design::search::{FIRST_FREE_STREAM, random_record_within};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;

use super::error::DesignJobError;
use super::loaded::Loaded;
use super::result::{Efficiency, MedianRange};

/// Kinds of rivals: name, and what values are drawn from. Where an output passes its limits, blocks are drawn anew.
const KINDS: [(&str, Values); 2] = [("aprbs", Values::Steps(5)), ("udrn", Values::Uniform)];

/// A uniformly distributed record (N x m) within all limits of the inputs.
pub(super) fn uniform(layout: &Layout, seed: u64) -> Vec<f64> {
    let mut rng = Rng64::stream(seed, FIRST_FREE_STREAM);
    let (lower, upper) = layout.bounds();
    let mut x: Vec<f64> =
        (0..layout.len()).map(|j| lower[j] + rng.uniform() * (upper[j] - lower[j])).collect();
    layout.repair(&mut x);
    layout.round(&mut x);
    let mut u = vec![0.0; layout.n_samples() * layout.n_channels()];
    layout.fill(&x, &mut u);
    u
}

/// Values of D and I of one model alone over a record.
struct Alone<'a> {
    d: Evaluator<'a>,
    i: Evaluator<'a>,
}

/// The two criteria that every design is judged by.
fn judges() -> Result<[Box<dyn Criterion>; 2], DesignJobError> {
    let none = toml::Table::new();
    Ok([criterion("d", &none)?, criterion("i", &none)?])
}

impl<'a> Alone<'a> {
    fn new(
        problem: &DesignProblem<'a>,
        term: &Term<'a>,
        judges: &'a [Box<dyn Criterion>; 2],
        objective: &'a [f64],
    ) -> Result<Self, DesignJobError> {
        let with = |c: &'a dyn Criterion, objective_signal: &'a [f64]| {
            let one = Term { criterion: Some(c), weight: 1.0, limits: None, objective_signal, ..*term };
            Evaluator::new(&DesignProblem { terms: vec![one], ..problem.clone() })
        };
        Ok(Self { d: with(judges[0].as_ref(), &[])?, i: with(judges[1].as_ref(), objective)? })
    }

    /// J_D and J_I of `u`.
    fn values(&mut self, u: &[f64]) -> (f64, f64) {
        (self.d.value(u), self.i.value(u))
    }
}

/// Efficiencies of `count` signals of each kind for each model with a criterion, relative to the design `u`.
pub(super) fn efficiencies(
    problem: &DesignProblem,
    models: &[Loaded],
    objective: &[f64],
    u: &[f64],
    count: usize,
    seed: u64,
) -> Result<Vec<Efficiency>, DesignJobError> {
    let judges = judges()?;
    let mut out = Vec::new();
    for (k, (rival, values)) in KINDS.iter().enumerate() {
        let found: Vec<(Vec<f64>, f64)> = (0..count)
            .into_par_iter()
            .map(|s| {
                let stream = FIRST_FREE_STREAM + (((k + 1) as u64) << 20) + s as u64;
                random_record_within(problem, *values, &mut Rng64::stream(seed, stream))
            })
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .flatten()
            .collect();
        for (term, m) in problem.terms.iter().zip(models).filter(|(t, _)| t.criterion.is_some()) {
            let mut alone = Alone::new(problem, term, &judges, objective)?;
            let (d, i) = alone.values(u);
            let p = term.model.n_params() as f64;
            let (mut of_d, mut of_i) = (Vec::new(), Vec::new());
            for (rival, _) in &found {
                let (rd, ri) = alone.values(rival);
                of_d.push(100.0 * (-(rd - d) / p).exp());
                of_i.push(100.0 * i / ri);
            }
            out.push(Efficiency {
                model: m.name.clone(),
                rival: (*rival).into(),
                signals: found.len(),
                drawn_anew_percent: 100.0 * spread(&found.iter().map(|f| f.1).collect::<Vec<_>>()).median,
                same_error_samples: 100.0 * problem.n_samples as f64 / spread(&of_i).greatest,
                d_percent: spread(&of_d),
                i_percent: spread(&of_i),
            });
        }
    }
    Ok(out)
}

/// Median, least and greatest; NaN where nothing was found. A singular rival has an infinite criterion and counts zero.
fn spread(values: &[f64]) -> MedianRange {
    let mut v: Vec<f64> = values.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
    v.sort_by(f64::total_cmp);
    match (v.first(), v.last()) {
        (Some(least), Some(greatest)) => {
            let median = 0.5 * (v[(v.len() - 1) / 2] + v[v.len() / 2]);
            MedianRange { median, least: *least, greatest: *greatest }
        }
        _ => MedianRange { median: f64::NAN, least: f64::NAN, greatest: f64::NAN },
    }
}
