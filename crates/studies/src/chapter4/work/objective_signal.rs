//! What the objective signal decides: a specific case against global accuracy, thesis section 4.8.1 with Figure 4.17.
//!
//! The specific case is torque under feedback: a controller moves the fuel pulse width so that torque follows steps while
//! speed drifts and the bypass valve moves slowly. What it sends over one record is the objective signal of a design; the
//! models are scored on what it sends over other records, and on broadband signals.

use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::library::Library;
use super::models::{identify, told, unseen, validate};
use super::source::{DesignCriterion, Record, Source, designed, problem, term};
use super::{Chapter4Error, Output, SAMPLES, START, Setting};

/// Torque noise variance.
const NOISE: f64 = 80.0;
/// Samples of a long objective signal.
const LONG: usize = 10 * SAMPLES;
/// Designs of each kind at most.
const MOST_DESIGNS: usize = 40;

/// Where identification signals come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Origin {
    /// A kind of the chapter.
    Known(Source),
    /// I-optimal for a uniform random objective signal.
    ForUdrn,
    /// I-optimal for a two-level objective signal.
    ForPrbs,
    /// I-optimal for one record of the control loop of the same length.
    ForLoop,
    /// I-optimal for ten times as much of the control loop.
    ForLongLoop,
    /// AI-optimal for the same.
    AiForLongLoop,
}

/// Rows of the comparison.
pub const ORIGINS: [Origin; 9] = [
    Origin::Known(Source::Aprbs),
    Origin::Known(Source::Udrn),
    Origin::Known(Source::Design(DesignCriterion::D)),
    Origin::Known(Source::Design(DesignCriterion::I)),
    Origin::ForUdrn,
    Origin::ForPrbs,
    Origin::ForLoop,
    Origin::ForLongLoop,
    Origin::AiForLongLoop,
];

impl Origin {
    /// Name in tables.
    pub fn name(self) -> String {
        match self {
            Origin::Known(Source::Design(DesignCriterion::I)) => "I for an APRBS".into(),
            Origin::Known(Source::Design(c)) => c.name().to_uppercase(),
            Origin::Known(s) => s.name().to_uppercase(),
            Origin::ForUdrn => "I for a UDRN".into(),
            Origin::ForPrbs => "I for a PRBS".into(),
            Origin::ForLoop => "I for one record of the loop".into(),
            Origin::ForLongLoop => "I for ten records of the loop".into(),
            Origin::AiForLongLoop => "AI for ten records of the loop".into(),
        }
    }
}

/// Errors of models on one kind of unseen signal.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Errors {
    /// Root mean square error in Nm against outputs without noise, mean over models and signals.
    pub rmse: f64,
    /// Its standard error.
    pub se: f64,
}

/// One kind of identification signal.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Case {
    /// Where its signals come from.
    pub origin: Origin,
    /// Number of models.
    pub n: usize,
    /// On other records of the control loop.
    pub on_loop: Errors,
    /// On APRBS.
    pub on_aprbs: Errors,
    /// On UDRN.
    pub on_udrn: Errors,
}

/// Compares objective signals: models of every origin on records of the loop and on broadband signals.
///
/// # Errors
/// [`Chapter4Error`].
pub fn compare(library: &Library, interrupt: &(dyn Fn() -> bool + Sync)) -> Result<Vec<Case>, Chapter4Error> {
    let (setting, seed) = (&library.setting, library.size.seed);
    let n = library.size.identification.min(MOST_DESIGNS);
    let loops = (0..library.size.validation)
        .into_par_iter()
        .map(|k| control_loop(setting, seed, 1 + k as u64, SAMPLES))
        .collect::<Result<Vec<Record>, _>>()?;
    let kinds: [(&[Record], u64); 3] = [
        (&loops, 0),
        (&library.validation(Source::Aprbs, interrupt)?, 1),
        (&library.validation(Source::Udrn, interrupt)?, 2),
    ];
    let validation = kinds
        .into_iter()
        .map(|(r, k)| unseen(setting, Output::Torque, NOISE, r, (seed, 11 << 40 | k << 32)))
        .collect::<Result<Vec<_>, _>>()?;
    let mut cases = Vec::new();
    for (i, &origin) in ORIGINS.iter().enumerate() {
        let records = records(library, origin, n, interrupt)?;
        let told = told(setting, Output::Torque, &records)?;
        let stream = 10 << 40 | (i as u64) << 32;
        let models = identify(setting, Output::Torque, NOISE, &records, &told, (seed, stream))?;
        let errors = |k: usize| {
            let (rmse, se) = validate(setting, Output::Torque, &models, &validation[k]).rmse;
            Errors { rmse, se }
        };
        cases.push(Case {
            origin,
            n: models.len(),
            on_loop: errors(0),
            on_aprbs: errors(1),
            on_udrn: errors(2),
        });
        if interrupt() {
            return Err(Chapter4Error::Interrupted);
        }
    }
    Ok(cases)
}

fn records(
    library: &Library,
    origin: Origin,
    n: usize,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Record>, Chapter4Error> {
    let (setting, seed) = (&library.setting, library.size.seed);
    let (criterion, u0) = match origin {
        Origin::Known(source) => {
            let all = library.identification(source, interrupt)?;
            return Ok(all.iter().take(n).cloned().collect());
        }
        Origin::ForUdrn => (DesignCriterion::I, library.validation(Source::Udrn, interrupt)?[0].u.clone()),
        Origin::ForPrbs => (DesignCriterion::I, library.validation(Source::Prbs, interrupt)?[0].u.clone()),
        Origin::ForLoop => (DesignCriterion::I, control_loop(setting, seed, 0, SAMPLES)?.u),
        Origin::ForLongLoop => (DesignCriterion::I, control_loop(setting, seed, 0, LONG)?.u),
        Origin::AiForLongLoop => (DesignCriterion::Ai, control_loop(setting, seed, 0, LONG)?.u),
    };
    let built = criterion.build()?;
    let one = |k: usize| {
        let term = term(setting, Output::Torque, built.as_ref(), 1.0, &u0);
        designed(&problem(setting, vec![term]), seed.wrapping_add(k as u64), interrupt)
    };
    (0..n).into_par_iter().map(one).collect()
}

/// Inputs of torque control over one record: u1 by an integrating controller with a proportional part on the torque of
/// the sample before, u2 in slow ramps, u3 a slow walk; demands stay where the box can reach them.
fn control_loop(setting: &Setting, seed: u64, number: u64, samples: usize) -> Result<Record, Chapter4Error> {
    const WARM_UP: usize = 60;
    // us per Nm.
    const PROPORTIONAL: f64 = 20.0;
    const INTEGRAL: f64 = 40.0;
    let mut rng = Rng64::stream(seed, 12 << 40 | number);
    let c = &setting.channels;
    let m = &setting.torque;
    let n = WARM_UP + samples;
    let middle = |i: usize| 0.5 * (c[i].lower + c[i].upper);
    let mut u: Vec<f64> = (0..n * 3).map(|k| middle(k % 3)).collect();
    let (mut demand, mut abv_to, mut integral) = (12.0, middle(1), middle(0));
    let mut error = 0.0;
    for t in 1..n {
        if t % 15 == 0 {
            demand = rng.uniform_in(4.0, 24.0);
        }
        if t % 30 == 0 {
            abv_to = rng.uniform_in(c[1].lower, c[1].upper);
        }
        let row = &u[(t - 1) * 3..t * 3];
        let speed = (row[2] + 40.0 * (rng.uniform() - 0.5)).clamp(c[2].lower, c[2].upper);
        let abv = row[1] + (abv_to - row[1]).clamp(-0.005, 0.005);
        if t > START {
            let zeros = vec![0.0; t];
            let (mut y, run) = (vec![0.0; t], Run { u: &u[..t * 3], y: &zeros, start: START });
            if m.model.simulate(&m.theta, &run, &mut y) != Status::Converged {
                return Err(Chapter4Error::Diverged { model: m.source });
            }
            error = demand - y[t - 1];
        }
        integral = (integral + INTEGRAL * error).clamp(c[0].lower, c[0].upper);
        let fuel = (integral + PROPORTIONAL * error).clamp(c[0].lower, c[0].upper);
        u[t * 3..(t + 1) * 3].copy_from_slice(&[fuel, abv, speed]);
    }
    Ok(Record { u: u.split_off(WARM_UP * 3), objective: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The loop follows its demand: torque settles within a step, inputs stay in the box and records differ.
    #[test]
    fn the_loop_stays_in_the_box_and_controls() {
        let setting = Setting::new().unwrap();
        let (a, b) =
            (control_loop(&setting, 1, 0, SAMPLES).unwrap(), control_loop(&setting, 1, 1, SAMPLES).unwrap());
        assert_ne!(a.u, b.u);
        for row in a.u.chunks_exact(3) {
            for (v, c) in row.iter().zip(&setting.channels) {
                assert!((c.lower..=c.upper).contains(v));
            }
        }
        let (y, _) = super::super::models::truth(&setting, Output::Torque, &a.u).unwrap();
        // Demands last 15 samples: at the end of each the torque stands between its reachable demands.
        let ends: Vec<f64> = (29..100).step_by(15).map(|t| y[t]).collect();
        assert!(ends.iter().all(|y| (0.0..28.0).contains(y)), "{ends:?}");
        let moved =
            a.u.chunks_exact(3).map(|r| r[0]).fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        assert!(moved.1 - moved.0 > 500.0, "{moved:?}");
    }
}
