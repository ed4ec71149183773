//! What every step of a campaign shares: the spec, the plant and the way to interrupt and report.

use super::channels::Channels;
use super::error::ChainError;
use super::spec::CalibrateSpec;
use crate::fuelling::stored::StoredFuelling;
use dynocal_calib::gains::Tuned;
use dynocal_calib::map::FeedforwardMap;
use dynocal_calib::problem::GivenChannel;
use dynocal_calib::validate::Scenario;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop, demand_name};
use dynocal_ident::plant::{Causality, Plant, PlantError};
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Makes plants: with the sensor noise of the spec, or free of noise.
pub type PlantFactory<'a> = &'a (dyn Fn(bool) -> Result<Box<dyn Plant>, PlantError> + Sync);

/// Time before a scenario in which the plant comes to rest at its first point, in s.
pub(super) const SETTLED_S: f64 = 4.0;

/// How loops are used in a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// They find the operating points.
    Lead,
    /// They trim a feedforward.
    Trim,
    /// They are open.
    Open,
}

/// Shared by all steps.
pub struct Context<'a> {
    /// The checked spec.
    pub spec: &'a CalibrateSpec,
    /// Its channels by their parts.
    pub channels: Channels,
    /// Where plants come from; none for a real bed.
    pub plants: Option<PlantFactory<'a>>,
    /// Folder with measured records when the plant is a real bed.
    pub measured: PathBuf,
    /// Whether to stop, and who is told.
    pub watch: Watch<'a>,
    /// Steps that have begun.
    pub begun: AtomicUsize,
    /// Loops with the gains that were found on the plant, where the spec has none.
    pub tuned: OnceLock<Vec<PlanLoop>>,
    /// Identified fuelling, where the spec names one, once it is there.
    pub fuelling: OnceLock<Identified>,
}

/// Fuelling that a campaign works with.
#[derive(Clone, Debug)]
pub struct Identified {
    /// Model and ranges.
    pub stored: StoredFuelling,
    /// Where it comes from.
    pub from: FuelledFrom,
}

/// Where the fuelling of a campaign comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FuelledFrom {
    /// Its file, or the spec of the job that identified it.
    pub file: String,
    /// Bed time of the records that identified it, in s; 0 where it came as a file.
    pub bed_s: f64,
    /// What it holds, where engine and fuelling are one plant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub governs: Option<Governs>,
}

/// What fuelling takes out of the hands of a calibration, where engine and fuelling are one plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Governs {
    /// Input of the problem that it sets.
    pub injection: String,
    /// Demanded output that it holds.
    pub lambda: String,
    /// Pressure before the throttle, which the air goes with; none where it is that of the surroundings.
    #[serde(default)]
    pub boost: Option<String>,
}

impl Governs {
    /// Outputs that models may read, each those before it: what flows through the engine stands on the pressure before the throttle.
    pub fn read(&self) -> impl Iterator<Item = &String> {
        self.boost.iter().chain(std::iter::once(&self.injection))
    }
}

/// Rough shares of the steps and of the report in the whole time, for progress only.
const SHARES: [f64; 7] = [0.10, 0.12, 0.28, 0.34, 0.03, 0.12, 0.01];

impl Context<'_> {
    /// Stops when asked to.
    ///
    /// # Errors
    /// [`ChainError::Interrupted`].
    pub fn check_interrupt(&self) -> Result<(), ChainError> {
        if self.watch.interrupted() { Err(ChainError::Interrupted) } else { Ok(()) }
    }

    /// Step `k` (from 0) of `of` begins.
    pub(super) fn begin(&self, k: usize, of: usize, name: &str) {
        self.begun.store(k, Ordering::Relaxed);
        self.watch.note(&format!("step {} of {of}: {name}", k + 1));
        self.fraction(0.0);
    }

    /// So much of the present step is done.
    pub(super) fn fraction(&self, done: f64) {
        let k = self.begun.load(Ordering::Relaxed).min(SHARES.len() - 1);
        let before: f64 = SHARES[..k].iter().sum();
        self.watch.fraction(before + SHARES[k] * done.clamp(0.0, 1.0));
    }

    /// A plant with or without sensor noise.
    ///
    /// # Errors
    /// [`ChainError::NeedsPlant`] for a real bed, [`PlantError`] otherwise.
    pub fn plant(&self, noise: bool) -> Result<Box<dyn Plant>, ChainError> {
        match self.plants {
            Some(make) => Ok(make(noise)?),
            None => Err(ChainError::NeedsPlant),
        }
    }

    /// Digests of the measured records of a real bed by name: another record is another input of every step.
    pub fn measured_digests(&self) -> Vec<(String, String)> {
        let Some(entries) = std::fs::read_dir(&self.measured).ok().filter(|_| self.plants.is_none()) else {
            return Vec::new();
        };
        let digest = |path: PathBuf| {
            let name = path.file_name()?.to_string_lossy().into_owned();
            Some((name, dynocal_files::run_folder::digest(&std::fs::read(&path).ok()?)))
        };
        let mut digests: Vec<_> = entries.filter_map(|e| digest(e.ok()?.path())).collect();
        digests.sort();
        digests
    }

    /// Whether the plant has sensor noise, as far as the spec says.
    pub fn noisy(&self) -> bool {
        !self.spec.plant.noise_words().is_empty()
    }

    /// What the fuelling holds, where engine and fuelling are one plant.
    pub(super) fn governs(&self) -> Option<&Governs> {
        self.fuelling.get()?.from.governs.as_ref()
    }

    /// Outputs that something else than a loop holds, each with the given channel of its demand.
    pub(super) fn held(&self) -> impl Iterator<Item = (&str, &GivenChannel)> {
        let demand = |output: &String| {
            let name = demand_name(output);
            self.spec.problem.given.iter().find(|g| g.name == name)
        };
        self.channels.watched.iter().filter_map(move |w| Some((w.as_str(), demand(w)?)))
    }

    /// Values at which the inputs that may move begin: those of the spec, else the plant's own, else the middles of their
    /// ranges; inside the bounds of the problem.
    ///
    /// # Errors
    /// [`ChainError::Plant`].
    pub fn start_inputs(&self) -> Result<Vec<f64>, ChainError> {
        let variables = match self.plants {
            Some(make) => make(false)?.variables().to_vec(),
            None => Vec::new(),
        };
        let own = |name: &str| {
            let v = variables.iter().find(|v| v.causality == Causality::Input && v.name == name);
            v.map(|v| v.start)
        };
        let start = |i: &dynocal_calib::problem::InputChannel| {
            let value = self.spec.excite.start.get(&i.name).copied().or_else(|| own(&i.name));
            value.unwrap_or(0.5 * (i.lower + i.upper)).clamp(i.lower, i.upper)
        };
        Ok(self.spec.problem.inputs.iter().map(start).collect())
    }

    /// Gains of the loop of demand number `k`.
    pub fn gains(&self, k: usize, tone: Tone) -> PiGains {
        let output = &self.channels.demands[k];
        let spec = self.spec.loops.iter().find(|l| l.output == *output);
        let found = self.tuned.get().and_then(|all| all.iter().find(|l| l.output == *output));
        let lead = spec.and_then(|l| l.gains).or(found.map(|l| l.gains));
        let lead = lead.unwrap_or(PiGains { ki: 0.0, kp: 0.0 });
        match tone {
            Tone::Trim => spec
                .and_then(|l| l.trim)
                .unwrap_or(PiGains { ki: TRIM_SHARE * lead.ki, kp: TRIM_SHARE * lead.kp }),
            _ => lead,
        }
    }

    /// From now on loops without gains of their own have those that were found.
    pub(super) fn close_loops_with(&self, tuned: Option<&Tuned>) {
        // Set once: what a finished step has found is what it would find again.
        tuned.into_iter().for_each(|t| drop(self.tuned.set(t.loops.clone())));
    }

    /// A map through a scenario open loop; the raw demands are recorded beside.
    pub(super) fn scenario_plan(&self, map: &dyn FeedforwardMap, name: &str, scenario: &Scenario) -> Plan {
        let drive = map.drive(&scenario.reference, self.spec.sample_time_s);
        let demands = self.channels.demands.len();
        let inputs = (0..drive.width()).map(|k| drive.column(k)).collect();
        let given = (0..self.channels.given.len()).map(|k| scenario.reference.column(demands + k)).collect();
        let wanted = (0..demands).map(|k| scenario.reference.column(k)).collect();
        let name = format!("{name}, {}", scenario.name);
        self.plan(&name, inputs, given, wanted, Tone::Open).settled(SETTLED_S)
    }

    /// A plan of inputs that may move, given channels and demands (one column each, in the order of the problem).
    pub fn plan(
        &self,
        name: &str,
        inputs: Vec<Vec<f64>>,
        given: Vec<Vec<f64>>,
        demands: Vec<Vec<f64>>,
        tone: Tone,
    ) -> Plan {
        let problem = &self.spec.problem;
        let moved = problem.inputs.iter().zip(inputs).map(|(i, values)| PlanChannel {
            rate_per_s: i.rate_per_s.filter(|_| self.spec.excite.keep_rates),
            ..PlanChannel::free(&i.name, &i.unit, values).within(i.lower, i.upper)
        });
        let imposed =
            problem.given.iter().zip(given).map(|(g, values)| PlanChannel::free(&g.name, &g.unit, values));
        let channels = moved.chain(imposed).collect();
        let loops = (0..problem.demands.len())
            .zip(&self.channels.driven)
            .map(|(k, input)| PlanLoop {
                output: self.channels.demands[k].clone(),
                input: self.channels.inputs[*input].clone(),
                gains: self.gains(k, tone),
                closed: tone != Tone::Open && !demands.is_empty(),
                schedule: Vec::new(),
            })
            .collect();
        let demands = problem
            .demands
            .iter()
            .zip(demands)
            .map(|(d, values)| PlanDemand { output: d.output.clone(), unit: d.unit.clone(), values })
            .collect();
        let mut plan = Plan::open_loop(name, self.spec.sample_time_s, channels)
            .with_loops(demands, loops)
            .with_limits(self.spec.abort.clone())
            .settled(self.spec.excite.lead_in_s);
        plan.outputs = self.channels.outputs();
        plan.outputs.extend(self.channels.watched.iter().cloned());
        plan
    }
}

/// Gains that trim, as a share of those that find an operating point.
const TRIM_SHARE: f64 = 0.25;
