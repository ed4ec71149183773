//! Gains of the loops of a plan, from a short identification on the plant itself, with a stated margin.
//!
//! At every operating point that is given, the inputs of the loops are moved by a few percent, a linear model of all loops
//! together is fitted to what comes back, and PI gains follow from it:
//!
//! ```text
//! y_o(t) = c_o + sum_i sum_k b_oik u_i(t-k)                                     regularised, one record
//! step of the own channel -> gain k, time constant T, dead time L              28 % and 63 % of the step response
//! kp = T / (2 k L),  ki = kp / min(T, 8 L)                                      SIMC with its closed-loop time at L
//! kp / F, ki / F^2                                                             F >= 1, the same for all loops
//! W = det(I + G C) - 1,   max 20 log10 |W / (1 + W)| <= 2 n dB,  n loops        biggest log modulus (BLT)
//! max |1 / (1 + g c)| <= 2                                                     each loop alone
//! ```
//!
//! S. Skogestad, J. Process Control 13 (2003) 291-309, for SIMC; W. L. Luyben, Ind. Eng. Chem. Process Des. Dev. 25 (1986)
//! 654-660, for the detuning of loops that act on each other. The demands of a point may be far from the inputs with which it
//! begins: the inputs are led there with open loops by the steady gains of a point before, or by what one movement of each input
//! shows at the first, from where the same demands were held or else from where the plan begins. Where one test does not tell
//! the effects well enough there are more, four at most. Several points share one set of gains: the smallest of their own,
//! detuned until the models of all points keep the margins. The gains are then played at all points: where a loop still
//! oscillates ([`dynocal_ident::play::oscillation`]), F grows and they are played again.

mod fit;
mod margin;
mod point;

use dynocal_files::spec::Faults;
use dynocal_ident::data::Dataset;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanLoop};
use dynocal_ident::plant::Plant;
use dynocal_ident::play::{Oscillation, PlayError};
use serde::{Deserialize, Serialize};

use fit::Linear;
use margin::Found;
pub use margin::LoopMargin;
use point::{Bench, Point, Trial};

/// How gains are found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TuneSpec {
    /// Size of the test movements, as a share of the value of the input, which counts as a tenth of its range at least.
    pub share: f64,
    /// Length of a test in s; there are up to four where noise hides the effects.
    pub test_s: f64,
    /// Shortest time between two movements of one input in s.
    pub hold_s: f64,
    /// Longest dead time and memory of an input in s; up to twice as much is tried where responses do not settle within.
    pub memory_s: f64,
    /// Time of the trial of the gains in s.
    pub trial_s: f64,
    /// Biggest log modulus in dB for each loop.
    pub log_modulus_db: f64,
    /// Largest sensitivity of each loop alone.
    pub sensitivity: f64,
    /// Most tests at each point. 1: one, where its plan begins. Else the inputs are led to where its demands are held, and the
    /// test is made there; where they do not arrive, what it shows leads them on.
    pub rounds: usize,
}

impl Default for TuneSpec {
    fn default() -> Self {
        Self {
            share: 0.05,
            test_s: 15.0,
            hold_s: 0.2,
            memory_s: 0.6,
            trial_s: 7.0,
            log_modulus_db: 2.0,
            sensitivity: 2.0,
            rounds: 2,
        }
    }
}

impl TuneSpec {
    /// Reports what cannot be; `key` is the name of the table.
    pub fn check(&self, key: &str, sample_time_s: f64, faults: &mut Faults) {
        let name = |part: &str| format!("{key}.{part}");
        faults.range(&name("share"), self.share, 1e-4, 0.5, "-");
        faults.range(&name("test_s"), self.test_s, 1.0, 600.0, "s");
        faults.range(&name("hold_s"), self.hold_s, 1e-3, 60.0, "s");
        // One column of the fit for each lag of each input.
        faults.range(&name("memory_s"), self.memory_s, sample_time_s, 100.0 * sample_time_s, "s");
        faults.range(&name("trial_s"), self.trial_s, 1.0, 600.0, "s");
        faults.range(&name("log_modulus_db"), self.log_modulus_db, 0.1, 20.0, "dB");
        faults.range(&name("sensitivity"), self.sensitivity, 1.05, 10.0, "-");
        if !(1..=10).contains(&self.rounds) {
            faults.push(&name("rounds"), self.rounds, "a whole number from 1 to 10");
        }
    }
}

/// Margins at one operating point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointMargin {
    /// Name of its plan.
    pub point: String,
    /// Margins of each loop on the identified model, the other loops open.
    pub loops: Vec<LoopMargin>,
    /// Biggest log modulus of all loops together in dB.
    pub log_modulus_db: f64,
    /// Inputs at which the demands are held, in the order of the plan's channels.
    pub inputs: Vec<f64>,
}

/// Gains that were found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tuned {
    /// The loops of the plans with their gains, closed.
    pub loops: Vec<PlanLoop>,
    /// What they keep at each point.
    pub points: Vec<PointMargin>,
    /// Factor F by which the gains are smaller than the smallest that one point alone would have had.
    pub detuned: f64,
    /// Oscillations that trials showed and that made F larger.
    pub oscillations: Vec<Oscillation>,
    /// Bed time in s.
    pub used_s: f64,
}

/// Gains could not be found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TuneError {
    /// The plant.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// An input does nothing to its output, or the record cannot be fitted.
    #[error("gains of the loop that is to hold `{output}` by `{input}`: {reason}")]
    NoAnswer {
        /// Output.
        output: String,
        /// Input.
        input: String,
        /// What was found.
        reason: String,
    },
    /// No gains are quiet.
    #[error("{point}: {oscillation}; made smaller by a factor {factor:.1} they still are")]
    Restless {
        /// Operating point.
        point: String,
        /// The last oscillation.
        oscillation: Box<Oscillation>,
        /// Factor.
        factor: f64,
    },
}

/// Growth of F after a trial that oscillates, and most trials in a row.
const RETRY: (f64, usize) = (1.6, 6);

/// One set of gains for the loops that the plans share. The first row of each plan is an operating point: its channels are where
/// it begins, its demands are what is held. The gains that the plans have are not looked at. Random numbers are those of `seed`.
///
/// # Errors
/// [`TuneError`]; a call without plans, or with plans whose loops differ, finds no answer.
pub fn tune(
    plant: &mut dyn Plant,
    plans: &[Plan],
    spec: &TuneSpec,
    seed: u64,
    interrupt: &dyn Fn() -> bool,
) -> Result<Tuned, TuneError> {
    let loops = common_loops(plans)?;
    let mut bench = Bench { plant, spec, seed, interrupt, used_s: 0.0, oscillations: Vec::new() };
    let mut points: Vec<Point> = Vec::new();
    for (k, plan) in plans.iter().enumerate() {
        let point = bench.point(plan, k, &points)?;
        points.push(point);
    }
    let (mut factor, mut trials) = (1.0, 0);
    loop {
        let start = margin::least(loops, points.iter().map(|p| p.gains.as_slice()))?;
        let models: Vec<_> = points.iter().map(|p| &p.linear).collect();
        let found = margin::detuned(&models, &start, loops, spec, factor)?;
        let (plan, o) = match bench.tried(&points, &found.loops)? {
            Trial::Restless(plan, o) => (plan, o),
            Trial::Quiet(inputs) => {
                let at = points.iter().map(|p| p.plan).zip(inputs);
                return Ok(Tuned {
                    oscillations: bench.oscillations,
                    used_s: bench.used_s,
                    ..tuned(found, at)
                });
            }
        };
        trials += 1;
        if trials >= RETRY.1 {
            return Err(TuneError::Restless { point: plan, oscillation: Box::new(o), factor: found.detuned });
        }
        bench.oscillations.push(o);
        factor = RETRY.0 * found.detuned;
    }
}

/// The test about the first row of `plan`, number `number` of the plans, for a plant that is driven elsewhere: loops open, and twice
/// [`TuneSpec::test_s`] long, because nobody is there to ask for a second one.
pub fn test_plan(plan: &Plan, spec: &TuneSpec, seed: u64, number: usize) -> Plan {
    let start = point::start(plan);
    let long = TuneSpec { test_s: 2.0 * spec.test_s, ..spec.clone() };
    let test = point::test(plan, &start, &long, seed, 1000 * number);
    Plan { name: format!("{}_test", plan.name), ..test }
}

/// Gains from records of the [`test_plan`]s of `plans`, in their order, without a trial.
///
/// # Errors
/// [`TuneError::NoAnswer`].
pub fn from_tests(plans: &[Plan], records: &[Dataset], spec: &TuneSpec) -> Result<Tuned, TuneError> {
    let loops = common_loops(plans)?;
    let fitted = |r: &Dataset| Linear::fit(std::slice::from_ref(r), loops, spec);
    let models = records.iter().map(fitted).collect::<Result<Vec<_>, _>>()?;
    let own = models.iter().map(|m| {
        let found = margin::detuned(&[m], &margin::alone(m, loops)?, loops, spec, 1.0)?;
        Ok(found.loops.iter().map(|l| l.gains).collect())
    });
    let own: Vec<Vec<PiGains>> = own.collect::<Result<_, TuneError>>()?;
    let start = margin::least(loops, own.iter().map(Vec::as_slice))?;
    let found = margin::detuned(&models.iter().collect::<Vec<_>>(), &start, loops, spec, 1.0)?;
    let used_s = records.iter().map(|r| r.len() as f64 * r.sample_time_s).sum();
    Ok(Tuned { used_s, ..tuned(found, plans.iter().map(|p| (p, point::start(p)))) })
}

/// What was found, by point with its inputs.
fn tuned<'a>(found: Found, points: impl Iterator<Item = (&'a Plan, Vec<f64>)>) -> Tuned {
    let points = found.margins.into_iter().zip(points).map(|(m, (plan, inputs))| PointMargin {
        point: plan.name.clone(),
        loops: m.loops,
        log_modulus_db: m.log_modulus_db,
        inputs,
    });
    let points = points.collect();
    Tuned { loops: found.loops, points, detuned: found.detuned, oscillations: Vec::new(), used_s: 0.0 }
}

/// The loops of the first plan, which all others share.
fn common_loops(plans: &[Plan]) -> Result<&[PlanLoop], TuneError> {
    let refused = |output: &str, input: &str, reason: &str| TuneError::NoAnswer {
        output: output.into(),
        input: input.into(),
        reason: reason.into(),
    };
    let loops = plans.first().map(|p| p.loops.as_slice()).filter(|l| !l.is_empty());
    let Some(loops) = loops else { return Err(refused("-", "-", "no plan with a loop is given")) };
    let same = |p: &Plan| {
        p.loops.len() == loops.len()
            && p.loops.iter().zip(loops).all(|(a, b)| a.output == b.output && a.input == b.input)
    };
    match plans.iter().find(|p| !same(p)) {
        Some(p) => Err(refused(
            &loops[0].output,
            &loops[0].input,
            &format!("the plan `{}` has other loops than `{}`", p.name, plans[0].name),
        )),
        None => Ok(loops),
    }
}
