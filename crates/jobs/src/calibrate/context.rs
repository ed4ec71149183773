//! What every step of a campaign shares: the spec, the plant and the way to interrupt and report.

use super::channels::Channels;
use super::spec::CalibrateSpec;
use dynocal_calib::gains::{TuneError, Tuned};
use dynocal_calib::map::structures::MapError;
use dynocal_calib::optimise::OptimiseError;
use dynocal_calib::problem::meter_name;
use dynocal_calib::supervisor::{self, Predictor};
use dynocal_files::FilesError;
use dynocal_files::csv_io;
use dynocal_files::dataset;
use dynocal_files::measurement;
use dynocal_files::units;
use dynocal_ident::data::{Channel, DataError, Dataset, Role};
use dynocal_ident::derived::DerivedError;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop, demand_name};
use dynocal_ident::plant::{Causality, Plant, PlantError};
use dynocal_ident::play::{self, Oscillation, PlayError, RecordFault, RecordTolerance};
use dynocal_ident::stored::{StoredError, StoredModel};
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Why a campaign cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum ChainError {
    /// A file.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A record.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A derived channel.
    #[error(transparent)]
    Derived(#[from] DerivedError),
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A plan that cannot be played.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// A member of a table.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The optimisation.
    #[error(transparent)]
    Optimise(#[from] OptimiseError),
    /// The map.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A stored model.
    #[error(transparent)]
    Model(#[from] StoredError),
    /// Estimation or selection.
    #[error("{what}: {reason}")]
    Identify {
        /// Model or step.
        what: String,
        /// Reason.
        reason: String,
    },
    /// The test signal.
    #[error("design: {0}")]
    Design(String),
    /// A plan ended early.
    #[error(
        "the record `{record}` {stop}; what was measured is kept in `{kept}`. Narrow `excite.ranges` or `design`, or move the limit"
    )]
    Stopped {
        /// Record.
        record: String,
        /// Where and why.
        stop: String,
        /// File with what was measured.
        kept: String,
    },
    /// A real bed must measure first.
    #[error(
        "{} wait to be run on the bed:\n{}\nPut each measured record at the path that stands beside it, with the channels {channels}, and start again: finished steps are kept (docs/bed.md)",
        if waiting.len() == 1 { "a plan".to_string() } else { format!("{} plans", waiting.len()) },
        waiting.join("\n")
    )]
    NeedsMeasurement {
        /// `plan -> measured`, one line for each.
        waiting: Vec<String>,
        /// Channels of the record.
        channels: String,
    },
    /// Two files with the record of one plan.
    #[error("`{found}` are all called like the plan `{plan}`: leave one")]
    TwoRecords {
        /// Files.
        found: String,
        /// Plan.
        plan: String,
    },
    /// A record of a bed that is not what the plan asked for.
    #[error("`{measured}` is not the record of the plan `{plan}`:\n{}", faults.join("\n"))]
    Record {
        /// Measured file.
        measured: String,
        /// Plan.
        plan: String,
        /// What differs, in sentences.
        faults: Vec<String>,
    },
    /// Gains of the loops.
    #[error(transparent)]
    Gains(#[from] TuneError),
    /// A record in which a loop oscillates.
    #[error(
        "the record `{record}` is refused: {oscillation}; it is kept in `{kept}`. Give smaller `gains` in [[loops]]; gains that are left out are identified on the plant, where a larger `tune.test_s` makes them surer"
    )]
    Oscillates {
        /// Record.
        record: String,
        /// Loop, period, amplitude.
        oscillation: Box<Oscillation>,
        /// File with what was measured.
        kept: String,
    },
    /// A step that only a plant in the loop can do.
    #[error(
        "the static map and the comparison of the maps step a plant themselves: on a real bed the chain ends with `dynocal calibrate SPEC --until invert`, which has written the map"
    )]
    NeedsPlant,
    /// Ctrl-C.
    #[error("interrupted: finished steps are kept, start again with the same folder to go on")]
    Interrupted,
    /// The spec.
    #[error("spec: {key} = {found}: expected {expected}")]
    Spec {
        /// Key.
        key: String,
        /// Value.
        found: String,
        /// Expected.
        expected: String,
    },
}

/// Makes plants: with the sensor noise of the spec, or free of noise.
pub type PlantFactory<'a> = &'a (dyn Fn(bool) -> Result<Box<dyn Plant>, PlantError> + Sync);

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
        plan
    }

    /// Runs a plan on the plant under the supervisor, or writes it and reads the measured record when the plant is a real
    /// bed.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn measure(&self, folder: &Path, plan: &Plan, noise: bool) -> Result<Dataset, ChainError> {
        self.measure_with(folder, plan, noise, &[])
    }

    /// The same with models of outputs, which let the supervisor look ahead.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn measure_with(
        &self,
        folder: &Path,
        plan: &Plan,
        noise: bool,
        models: &[&StoredModel],
    ) -> Result<Dataset, ChainError> {
        self.check_interrupt()?;
        let mut record = if self.plants.is_some() {
            let mut plant = self.plant(noise)?;
            plant.reset(noise_seed(self.spec.seed, &plan.name));
            let inputs: Vec<String> = plan.channels.iter().map(|c| c.name.clone()).collect();
            // Only outputs with an abort rule are watched.
            let watched =
                models.iter().filter(|m| plan.limits.iter().any(|l| l.output == m.user_output().name));
            let views = watched
                .map(|m| Ok((m.user_output().name, m.over(&inputs)?)))
                .collect::<Result<Vec<_>, StoredError>>()?;
            let predictors: Vec<(&str, Predictor)> = views
                .iter()
                .map(|(name, v)| (name.as_str(), Predictor { model: v, theta: v.theta() }))
                .collect();
            let mut watchdog = supervisor::for_plan(plan, &predictors);
            let mut asked = plan.clone();
            asked.outputs.extend(self.meters_of(plant.as_ref()));
            let played = play::play(plant.as_mut(), &asked, &mut watchdog)?;
            if let Some(stop) = played.stop {
                let kept = folder.join(format!("{}.stopped.csv", plan.name));
                csv_io::write_dataset(&kept, &played.record)?;
                let (record, kept) = (plan.name.clone(), kept.display().to_string());
                return Err(ChainError::Stopped { record, stop: stop.to_string(), kept });
            }
            played.record
        } else {
            self.measured_by_bed(folder, plan)?
        };
        self.name_meters(plan, &mut record)?;
        self.refuse_oscillation(folder, plan, &record)?;
        record.init_samples = self.spec.identify.init_samples;
        Ok(record)
    }

    /// Outputs of a plant that meter what is minimised.
    fn meters_of(&self, plant: &dyn Plant) -> Vec<String> {
        let has =
            |name: &str| plant.variables().iter().any(|v| v.causality == Causality::Output && v.name == name);
        self.channels.meters.iter().map(|m| m.name.clone()).filter(|name| has(name)).collect()
    }

    /// What a meter said is kept apart from what follows from the inputs, in the unit of the problem.
    fn name_meters(&self, plan: &Plan, record: &mut Dataset) -> Result<(), ChainError> {
        let outputs = self.channels.outputs();
        for m in self.channels.meters.iter().filter(|m| !outputs.contains(&m.name)) {
            let Some(c) = record.channels.iter_mut().find(|c| c.name == m.name) else { continue };
            let Some((scale, offset)) = units::conversion(&c.unit, &m.unit) else {
                let fault = format!(
                    "channel `{}`: found the unit {}, expected {} or a unit that converts to it",
                    m.name, c.unit, m.unit
                );
                let (measured, plan) = (record.origin.clone(), plan.name.clone());
                return Err(ChainError::Record { measured, plan, faults: vec![fault] });
            };
            c.values.iter_mut().for_each(|v| *v = *v * scale + offset);
            (c.name, c.unit, c.role) = (meter_name(&m.name), m.unit.clone(), Role::Auxiliary);
        }
        Ok(())
    }

    /// A loop in a limit cycle is no excitation and no operating point.
    fn refuse_oscillation(&self, folder: &Path, plan: &Plan, record: &Dataset) -> Result<(), ChainError> {
        let mut judged = record.clone();
        for d in &plan.demands {
            let name = demand_name(&d.output);
            if judged.channel(&name).is_err() {
                let (unit, values) = (d.unit.clone(), d.values.clone());
                judged.channels.push(Channel { name, unit, role: Role::Auxiliary, values });
            }
        }
        for l in plan.loops.iter().filter(|l| l.closed) {
            if let Some(o) = play::oscillation(&judged, l)? {
                let kept = folder.join(format!("{}.refused.csv", plan.name));
                csv_io::write_dataset(&kept, record)?;
                return Err(ChainError::Oscillates {
                    record: plan.name.clone(),
                    oscillation: Box::new(o),
                    kept: kept.display().to_string(),
                });
            }
        }
        Ok(())
    }

    /// The record of a plan that a bed has played, checked against it; the plan is written for the bed.
    fn measured_by_bed(&self, folder: &Path, plan: &Plan) -> Result<Dataset, ChainError> {
        let path = dynocal_files::plan::write(folder, plan)?;
        let mut found = measurement::called(&self.measured, &plan.name);
        if found.len() > 1 {
            let found = found.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join("` and `");
            return Err(ChainError::TwoRecords { found, plan: plan.name.clone() });
        }
        let Some(measured) = found.pop() else {
            let measured = self.measured.join(format!("{}.csv", plan.name));
            let waiting = vec![format!("  {} ({}) -> {}", path.display(), plan.mode(), measured.display())];
            let mut channels = dynocal_files::plan::record_columns(plan);
            for m in &self.channels.meters {
                channels.push_str(&format!(", and {} [{}] where it is metered", m.name, m.unit));
            }
            return Err(ChainError::NeedsMeasurement { waiting, channels });
        };
        let tell = |text: &str| self.watch.note(text);
        let mut record = dynocal_files::plan::read_record_told(&measured, plan, &tell)?;
        let longest_delay_s = self.spec.longest_delay_s;
        let tolerance = RecordTolerance { longest_delay_s, ..RecordTolerance::default() };
        let faults: Vec<String> =
            play::check_record_within(plan, &record, &tolerance).iter().map(RecordFault::to_string).collect();
        if !faults.is_empty() {
            let (measured, plan) = (measured.display().to_string(), path.display().to_string());
            return Err(ChainError::Record { measured, plan, faults });
        }
        // The stamps have been compared: the record has the sample time of the plan.
        record.channels.retain(|c| c.name != dataset::STAMPS);
        record.sample_time_s = plan.sample_time_s;
        record.origin = format!("bed, {}", measured.display());
        Ok(record)
    }

    /// A record with the channels of the problem from a file.
    ///
    /// # Errors
    /// [`ChainError::Files`].
    pub fn read_record(&self, path: &Path, name: &str) -> Result<Dataset, ChainError> {
        let (inputs, outputs) = (self.channels.plant_inputs(), self.channels.outputs());
        let tell = |text: &str| self.watch.note(text);
        let mut d = dataset::read_dataset_told(path, &texts(&inputs), &texts(&outputs), &tell)?;
        d.name = name.into();
        d.init_samples = self.spec.identify.init_samples;
        Ok(d)
    }

    /// Reads the records of a step back, bit for bit.
    ///
    /// # Errors
    /// [`ChainError::Files`].
    pub fn load_records(&self, folder: &Path, refs: &[RecordRef]) -> Result<Vec<Dataset>, ChainError> {
        let one = |r: &RecordRef| {
            let mut d = self.read_record(&folder.join(&r.file), &r.name)?;
            // The time column is rounded, the spec is not.
            d.sample_time_s = self.spec.sample_time_s;
            d.origin.clone_from(&r.origin);
            Ok(d)
        };
        refs.iter().map(one).collect()
    }
}

fn texts(names: &[String]) -> Vec<&str> {
    names.iter().map(String::as_str).collect()
}

/// Gains that trim, as a share of those that find an operating point.
const TRIM_SHARE: f64 = 0.25;

/// All records, or the first fault; plans that wait for a bed are named together.
///
/// # Errors
/// [`ChainError`].
pub(super) fn all_measured(records: Vec<Result<Dataset, ChainError>>) -> Result<Vec<Dataset>, ChainError> {
    let (mut done, mut plans, mut of_record) = (Vec::new(), Vec::new(), String::new());
    for record in records {
        match record {
            Ok(d) => done.push(d),
            Err(ChainError::NeedsMeasurement { mut waiting, channels }) => {
                plans.append(&mut waiting);
                of_record = channels;
            }
            Err(other) => return Err(other),
        }
    }
    if plans.is_empty() {
        return Ok(done);
    }
    Err(ChainError::NeedsMeasurement { waiting: plans, channels: of_record })
}

/// Seed of the sensor noise of one record: depends on seed and name only, not on the order of the runs.
pub(super) fn noise_seed(seed: u64, name: &str) -> u64 {
    name.bytes().fold(seed ^ 0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// Name of a file without folder and endings.
pub(super) fn stem(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    name.split('.').next().unwrap_or(&name).to_string()
}

/// A stored record of a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordRef {
    /// Name.
    pub name: String,
    /// File inside the step's folder.
    pub file: String,
    /// Origin.
    pub origin: String,
}

/// Writes records as CSV into a step's folder.
///
/// # Errors
/// [`FilesError`].
pub fn save_records(folder: &Path, records: &[Dataset]) -> Result<Vec<RecordRef>, FilesError> {
    records
        .iter()
        .map(|r| {
            let file = format!("{}.csv", r.name.replace([' ', ','], "_").replace("__", "_"));
            csv_io::write_dataset(&folder.join(&file), r)?;
            Ok(RecordRef { name: r.name.clone(), file, origin: r.origin.clone() })
        })
        .collect()
}
