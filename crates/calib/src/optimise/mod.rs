//! Optimisation over a record: the inputs of a whole transient at once (thesis section 7.5), for any calibration problem.
//!
//! A start record gives the given channels, the inputs to begin with and the first samples of the outputs. The demand of
//! the demanded outputs is the models' own response to the start inputs, so the program is feasible by construction (or, where
//! [`DemandFrom::Record`] asks for it, the output of the record). Channels `<input>_lower` and `<input>_upper` of the record bound an
//! input sample by sample, inside its bounds of the problem; of an output with limits they tighten its limits. It is solved as
//! one sparse program over all samples ([`program`] has the equations).
//!
//! ```
//! use dynocal_calib::optimise::{OptimiseOptions, model::OutputModel, optimise_models};
//! use dynocal_calib::problem::CalibrationProblem;
//! use dynocal_ident::data::{Channel, Dataset, Role};
//! use dynocal_ident::model::poly::PolyNarx;
//!
//! // Heat from two burners, the second one cheaper: the demand moves to it as far as its limit lets it.
//! let problem: CalibrationProblem = toml::from_str(r#"
//!     inputs = [{ name = "a", unit = "kW", lower = 0.0, upper = 9.0 }, { name = "b", unit = "kW", lower = 0.0, upper = 2.0 }]
//!     demands = [{ output = "heat", unit = "kW", lower = 0.0, upper = 11.0 }]
//!     minimise = [{ channel = "a", weight = 2.0 }, { channel = "b", weight = 1.0 }]
//! "#)?;
//! let heat = PolyNarx::parse(&["a", "b"], "heat", &["a(t-1)", "b(t-1)", "heat(t-1)"])?;
//! let model = OutputModel::plain("heat", &heat, &[0.5, 0.5, 0.5], &["a", "b"]);
//! let channel = |name: &str, role, v| Channel { name: name.into(), unit: "kW".into(), role, values: vec![v; 50] };
//! let start = Dataset {
//!     name: "start".into(),
//!     sample_time_s: 1.0,
//!     channels: vec![channel("a", Role::Input, 4.0), channel("b", Role::Input, 1.0), channel("heat", Role::Output, 5.0)],
//!     init_samples: 0,
//!     origin: "example".into(),
//! };
//! let found = optimise_models(&problem, &[model], &start, &OptimiseOptions::default(), &|| false)?;
//! assert!(found.status.is_success());
//! assert!((found.start_objective - 9.0).abs() < 1e-12 && (found.objective - 8.0).abs() < 1e-6);
//! assert!(found.violations.iter().all(|v| v.largest < 1e-6));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bounds;
mod checks;
mod dynamic;
mod error;
mod guard;
mod horizon;
mod limits;
pub mod model;
mod options;
mod prices;
pub mod program;
mod result;
mod robust;
mod segments;
mod setup;
mod shortfall;
mod starts;
mod stored;
mod way;
mod within;

pub use bounds::bound_channels;
pub use dynamic::{Dynamic, GridValue};
pub use error::OptimiseError;
pub use guard::{Guard, distance_name};
pub use horizon::Horizon;
pub use options::{DemandFrom, EndCondition, History, OptimiseOptions};
pub use prices::Price;
pub use result::{Optimum, PartOutcome, TermValue, Violation};
pub use robust::{Robust, Spread};
pub use segments::{Seam, Segments};
pub use shortfall::Shortfall;
pub use stored::{StoredOutput, check_record, optimise_record};
pub use way::{Batch, WAYS, Way};

use crate::problem::CalibrationProblem;
use dynocal_ident::data::Dataset;
use dynocal_numerics::nlp::{self, NlpOptions, NlpOutcome};
use dynocal_numerics::status::Status;
use guard::Guarded;
use model::OutputModel;
use program::Program;
use robust::Ensemble;
use setup::Setup;

/// Optimises the inputs of `start` for `problem`; `interrupt` is asked once per iteration.
///
/// # Errors
/// [`OptimiseError`]: problem, models and record do not belong together, or no demand can be formed.
pub fn optimise_models(
    problem: &CalibrationProblem,
    models: &[OutputModel<'_>],
    start: &Dataset,
    options: &OptimiseOptions,
    interrupt: &dyn Fn() -> bool,
) -> Result<Optimum, OptimiseError> {
    let ensemble = options.robust.map(|_| Ensemble::new(problem, models, start));
    let Some(ensemble) = ensemble else {
        return guarded(problem, models, models, start, options, interrupt);
    };
    let all: Vec<OutputModel> = models.iter().cloned().chain(ensemble.models(models)).collect();
    let found = guarded(&ensemble.problem, &all, models, &ensemble.start, options, interrupt)?;
    Ok(ensemble.folded(found))
}

/// With the guard of the models `known`, where one is asked for.
fn guarded(
    problem: &CalibrationProblem,
    models: &[OutputModel<'_>],
    known: &[OutputModel<'_>],
    start: &Dataset,
    options: &OptimiseOptions,
    interrupt: &dyn Fn() -> bool,
) -> Result<Optimum, OptimiseError> {
    let Some(guard) = options.guard else {
        return solved(problem, models, &[], start, options, interrupt);
    };
    let guarded = Guarded::new(problem, known, start, guard)?;
    let all: Vec<OutputModel> = models.iter().cloned().chain(guarded.models()).collect();
    let distances = guarded.names();
    let mut found = solved(&guarded.problem, &all, &distances, &guarded.start, options, interrupt)?;
    // That a distance is not negative is no wish of anybody.
    let meant = |channel: &String, of: &str| of != "lower" || !distances.contains(channel);
    found.violations.retain(|v| meant(&v.channel, &v.of));
    found.prices.retain(|p| meant(&p.channel, &p.of));
    Ok(found)
}

fn solved(
    problem: &CalibrationProblem,
    models: &[OutputModel<'_>],
    distances: &[String],
    start: &Dataset,
    options: &OptimiseOptions,
    interrupt: &dyn Fn() -> bool,
) -> Result<Optimum, OptimiseError> {
    let samples = start.len();
    let more = (options.extend_s / start.sample_time_s).round().max(0.0) as usize;
    let extended = if more > 0 { extended(start, more) } else { start.clone() };
    let setup = Setup::new(problem, models, &extended, options)?.loosened(distances);
    let view_s = match options.way {
        Way::Horizon(spec) => spec.length_s,
        Way::Segments(spec) => spec.length_s,
        Way::Batch(_) | Way::Dynamic(_) => f64::INFINITY,
    };
    let expected_s = (setup.lag + 1) as f64 * setup.sample_time_s;
    if view_s < expected_s - 0.5 * setup.sample_time_s {
        return Err(OptimiseError::View { found_s: view_s, lag: setup.lag, expected_s });
    }
    let found = match options.way {
        Way::Dynamic(spec) => dynamic::solve(&setup, options, &spec, interrupt)?,
        Way::Batch(spec) => whole(&setup, options, spec.starts, interrupt),
        Way::Horizon(spec) => horizon::solve(&setup, options, &spec, interrupt),
        Way::Segments(spec) => segments::solve(&setup, options, &spec, interrupt),
    };
    let mut optimum = Optimum::new(&setup, &found, samples);
    if options.robust.is_some() {
        optimum.spreads = robust::spreads(&setup, &found.values, samples);
    }
    Ok(optimum)
}

/// Columns that a search ended with.
struct Found {
    status: Status,
    iterations: usize,
    /// Samples x columns.
    values: Vec<f64>,
    parts: Vec<PartOutcome>,
    prices: Vec<Price>,
    shortfalls: Vec<Shortfall>,
    /// All that the program minimises.
    minimised: Option<f64>,
    grid: Option<GridValue>,
}

impl Found {
    /// Nothing yet: the start.
    fn start(setup: &Setup<'_>) -> Self {
        let values = setup.start.clone();
        Self {
            status: Status::Converged,
            iterations: 0,
            values,
            parts: Vec::new(),
            prices: Vec::new(),
            shortfalls: Vec::new(),
            minimised: None,
            grid: None,
        }
    }
}

/// The whole of a setup at once.
fn batch(setup: &Setup<'_>, options: &OptimiseOptions, interrupt: &dyn Fn() -> bool) -> Found {
    batch_from(setup, options, None, interrupt)
}

/// The same; `warm` is the barrier parameter to begin with where the start is nearly optimal.
fn batch_from(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    warm: Option<f64>,
    interrupt: &dyn Fn() -> bool,
) -> Found {
    let mut program = Program::new(setup.parts());
    let (found, _) = search(&mut program, options, warm, interrupt);
    found
}

/// Solves a program; the outcome of the interior point beside the columns.
fn search(
    program: &mut Program<'_>,
    options: &OptimiseOptions,
    warm: Option<f64>,
    interrupt: &dyn Fn() -> bool,
) -> (Found, NlpOutcome) {
    let (tolerance, max_iterations) = (options.tolerance, options.max_iterations);
    let nlp_options = NlpOptions { tolerance, max_iterations, warm_barrier: warm };
    let outcome = nlp::solve(program, &nlp_options, interrupt);
    program.load(&outcome.x);
    let found = Found {
        status: outcome.status,
        iterations: outcome.history.len().saturating_sub(1),
        values: program.values(),
        parts: Vec::new(),
        prices: Vec::new(),
        shortfalls: Vec::new(),
        minimised: Some(outcome.objective),
        grid: None,
    };
    (found, outcome)
}

/// The whole of a setup at once, with prices, from the start record and from `starts - 1` others.
fn whole(setup: &Setup<'_>, options: &OptimiseOptions, starts: usize, interrupt: &dyn Fn() -> bool) -> Found {
    let mut best: Option<(f64, Found)> = None;
    let mut parts = Vec::new();
    for k in 0..starts.max(1) {
        let mut program = Program::new(setup.parts());
        if k > 0 {
            starts::other(setup, &mut program, k);
        }
        let (mut found, outcome) = search(&mut program, options, None, interrupt);
        let (status, iterations) = (found.status, found.iterations);
        let (from_s, to_s) = (0.0, setup.samples as f64 * setup.sample_time_s);
        parts.push(PartOutcome { from_s, to_s, status, iterations });
        found.prices = prices::prices(setup, &mut program, &outcome);
        let solved = |f: &Found| f.status.is_success();
        let better = best.as_ref().is_none_or(|(value, so_far)| {
            solved(&found) && !solved(so_far)
                || solved(&found) == solved(so_far) && outcome.objective < *value
        });
        if better {
            best = Some((outcome.objective, found));
        }
        if interrupt() {
            break;
        }
    }
    let mut found = best.map_or_else(|| Found::start(setup), |b| b.1);
    if failed(found.status) && options.give > 0.0 && !interrupt() {
        found = giving(setup, options, found, interrupt);
    }
    if failed(found.status) && !interrupt() {
        found = from_what_is_met(setup, options, found, interrupt);
    }
    if starts > 1 {
        found.parts = parts;
    }
    if failed(found.status) && options.explain {
        found.shortfalls = shortfall::shortfalls(setup, options, found.status, 0.0, interrupt);
    }
    found
}

/// The search again with demands that may give way, where it then ends; else what was `found`.
fn giving(setup: &Setup<'_>, options: &OptimiseOptions, found: Found, interrupt: &dyn Fn() -> bool) -> Found {
    let soft = setup.giving();
    let mut program = Program::new(soft.parts());
    let (mut again, outcome) = search(&mut program, options, None, interrupt);
    if !again.status.is_success() {
        return found;
    }
    again.iterations += found.iterations;
    again.prices = prices::prices(&soft, &mut program, &outcome);
    again
}

/// The search again from inputs that meet everything, where there are some; else what was `found`.
fn from_what_is_met(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    mut found: Found,
    interrupt: &dyn Fn() -> bool,
) -> Found {
    let Some(values) = shortfall::met(setup, options, interrupt) else { return found };
    let mut program = Program::new(setup.parts());
    program.columns.begin_at(&values);
    let (mut again, outcome) = search(&mut program, options, None, interrupt);
    if again.status.is_success() {
        again.iterations += found.iterations;
        again.prices = prices::prices(setup, &mut program, &outcome);
        return again;
    }
    // There are inputs that meet everything: that none were found is no proof of anything.
    if found.status == Status::Infeasible {
        found.status = Status::Stalled;
    }
    found
}

/// Whether a search ended without a solution, by itself.
fn failed(status: Status) -> bool {
    !matches!(status, Status::Converged | Status::Interrupted)
}

/// The program that [`optimise_models`] solves, for tests and for callers with a solver of their own.
///
/// # Errors
/// As [`optimise_models`].
pub fn parts<'a>(
    problem: &'a CalibrationProblem,
    models: &[OutputModel<'a>],
    start: &Dataset,
    options: &OptimiseOptions,
) -> Result<program::Parts<'a>, OptimiseError> {
    Ok(Setup::new(problem, models, start, options)?.parts())
}

/// The record with its last row repeated.
fn extended(record: &Dataset, more: usize) -> Dataset {
    let mut out = record.clone();
    for c in &mut out.channels {
        let last = c.values.last().copied().unwrap_or(f64::NAN);
        c.values.resize(c.values.len() + more, last);
    }
    out
}
