//! What the design is compared with: random signals within the same limits.

use dynocal_design::channel::Layout;
use dynocal_design::criterion::{Criterion, criterion};
use dynocal_design::problem::{DesignProblem, Evaluator, Term};
use dynocal_design::safety::safety;
use dynocal_design::search::FIRST_FREE_STREAM;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;

use super::load::{DesignJobError, Loaded};
use super::result::Efficiency;

/// Kinds of rivals: name, and levels (none: uniform).
const KINDS: [(&str, Option<usize>); 2] = [("aprbs", Some(5)), ("udrn", None)];

/// A record of a kind within all limits of the inputs, in the free variables.
fn drawn(layout: &Layout, levels: Option<usize>, rng: &mut Rng64) -> Vec<f64> {
    let (lower, upper) = layout.bounds();
    let mut x: Vec<f64> = (0..layout.len())
        .map(|j| {
            let share = match levels {
                Some(n) => rng.below(n) as f64 / (n - 1) as f64,
                None => rng.uniform(),
            };
            lower[j] + share * (upper[j] - lower[j])
        })
        .collect();
    layout.repair(&mut x);
    layout.round(&mut x);
    x
}

/// A uniformly distributed record (N x m) within all limits of the inputs.
pub(super) fn uniform(layout: &Layout, seed: u64) -> Vec<f64> {
    let x = drawn(layout, None, &mut Rng64::stream(seed, FIRST_FREE_STREAM));
    let mut u = vec![0.0; layout.n_samples() * layout.n_channels()];
    layout.fill(&x, &mut u);
    u
}

/// The record that is drawn towards the middle until the predicted outputs keep their limits, with the share of the
/// amplitude that is left; none where not even the middle keeps them.
fn within_outputs(problem: &DesignProblem, e: &mut Evaluator, x: &[f64]) -> Option<(Vec<f64>, f64)> {
    let layout = e.layout().clone();
    let (lower, upper) = layout.bounds();
    let middle: Vec<f64> = lower.iter().zip(upper).map(|(l, u)| 0.5 * (l + u)).collect();
    let at = |s: f64| {
        let mut z: Vec<f64> = middle.iter().zip(x).map(|(m, x)| m + s * (x - m)).collect();
        layout.repair(&mut z);
        layout.round(&mut z);
        let mut u = vec![0.0; layout.n_samples() * layout.n_channels()];
        layout.fill(&z, &mut u);
        u
    };
    let limited = problem.terms.iter().any(|t| t.limits.is_some());
    let mut keeps = |u: &[f64]| {
        e.value(u);
        safety(problem, e).iter().filter_map(|s| s.worst).all(|w| w.distance >= 0.0)
    };
    if !limited {
        return Some((at(1.0), 1.0));
    }
    const STEPS: usize = 40;
    (0..=STEPS).rev().map(|k| k as f64 / STEPS as f64).find_map(|s| {
        let u = at(s);
        keeps(&u).then_some((u, s))
    })
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
    let e = Evaluator::new(problem)?;
    let mut out = Vec::new();
    for (k, (rival, levels)) in KINDS.iter().enumerate() {
        let found: Vec<(Vec<f64>, f64)> = (0..count)
            .into_par_iter()
            .map(|s| {
                let stream = FIRST_FREE_STREAM + (((k + 1) as u64) << 20) + s as u64;
                let x = drawn(e.layout(), *levels, &mut Rng64::stream(seed, stream));
                within_outputs(problem, &mut e.clone(), &x)
            })
            .collect::<Vec<_>>()
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
                amplitude_percent: 100.0 * spread(&found.iter().map(|f| f.1).collect::<Vec<_>>()).0,
                d_percent: spread(&of_d),
                i_percent: spread(&of_i),
            });
        }
    }
    Ok(out)
}

/// Median, least and greatest; NaN where nothing was found. A singular rival has an infinite criterion and counts zero.
fn spread(values: &[f64]) -> (f64, f64, f64) {
    let mut v: Vec<f64> = values.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
    v.sort_by(f64::total_cmp);
    match (v.first(), v.last()) {
        (Some(a), Some(b)) => (0.5 * (v[(v.len() - 1) / 2] + v[v.len() / 2]), *a, *b),
        _ => (f64::NAN, f64::NAN, f64::NAN),
    }
}
