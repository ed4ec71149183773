//! Records of a campaign: played on the plant or measured by a bed from a plan that is written, checked, kept and read back.

use super::context::Context;
use super::error::ChainError;
use dynocal_calib::map::Port;
use dynocal_calib::problem::meter_name;
use dynocal_calib::supervisor::{self, Predictor};
use dynocal_files::csv_io;
use dynocal_files::dataset;
use dynocal_files::measurement;
use dynocal_files::{FilesError, units};
use dynocal_ident::data::{Channel, Dataset, Role, UnitAfter};
use dynocal_ident::plan::{Plan, demand_name};
use dynocal_ident::plant::{Causality, Plant};
use dynocal_ident::play::{self, PlayError, RecordFault, RecordTolerance};
use dynocal_ident::stored::{StoredError, StoredModel};
use dynocal_report::significant;
use serde::{Deserialize, Serialize};
use std::path::Path;

impl Context<'_> {
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
        let record = if self.plants.is_some() {
            let mut plant = self.plant(noise)?;
            self.play(folder, plan, plant.as_mut(), models)?
        } else {
            self.measured_by_bed(folder, plan)?
        };
        self.finished(folder, plan, record)
    }

    /// The same on a plant that is there.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn measure_on(
        &self,
        folder: &Path,
        plan: &Plan,
        plant: &mut dyn Plant,
    ) -> Result<Dataset, ChainError> {
        self.check_interrupt()?;
        let record = self.play(folder, plan, plant, &[])?;
        self.finished(folder, plan, record)
    }

    /// Plays a plan from a reset under the supervisor.
    fn play(
        &self,
        folder: &Path,
        plan: &Plan,
        plant: &mut dyn Plant,
        models: &[&StoredModel],
    ) -> Result<Dataset, ChainError> {
        plant.reset(noise_seed(self.spec.seed, &plan.name));
        let inputs: Vec<String> = plan.channels.iter().map(|c| c.name.clone()).collect();
        // Only outputs with an abort rule are watched, and by models that read nothing but the plan.
        let planned = |m: &&&StoredModel| m.inputs.iter().all(|q| !self.channels.read.contains(&q.name));
        let watched = models.iter().filter(planned);
        let watched = watched.filter(|m| plan.limits.iter().any(|l| l.output == m.user_output().name));
        let views = watched
            .map(|m| Ok((m.user_output().name, m.over(&inputs)?)))
            .collect::<Result<Vec<_>, StoredError>>()?;
        let predictors: Vec<(&str, Predictor)> =
            views.iter().map(|(name, v)| (name.as_str(), Predictor { model: v, theta: v.theta() })).collect();
        let mut watchdog = supervisor::for_plan(plan, &predictors);
        let mut asked = plan.clone();
        asked.outputs.extend(self.meters_of(plant).into_iter().map(|m| m.name));
        let played = play::play(plant, &asked, &mut watchdog).map_err(|e| {
            begins_beyond(plan, |output| self.spec.problem.unit(output).unwrap_or("-").to_string(), e)
        })?;
        if let Some(stop) = played.stop {
            let kept = folder.join(format!("{}.stopped.csv", plan.name));
            csv_io::write_dataset(&kept, &played.record)?;
            let (record, kept) = (plan.name.clone(), kept.display().to_string());
            return Err(ChainError::Stopped { record, stop: stop.to_string(), kept });
        }
        Ok(played.record)
    }

    /// Meters named, a loop in a limit cycle refused.
    fn finished(&self, folder: &Path, plan: &Plan, mut record: Dataset) -> Result<Dataset, ChainError> {
        self.name_meters(plan, &mut record)?;
        self.refuse_oscillation(folder, plan, &record)?;
        record.init_samples = self.spec.identify.init_samples;
        Ok(record)
    }

    /// Outputs of a plant that meter what is minimised, with the unit that the problem has for them.
    pub(super) fn meters_of(&self, plant: &dyn Plant) -> Vec<Port> {
        let has =
            |name: &str| plant.variables().iter().any(|v| v.causality == Causality::Output && v.name == name);
        self.channels.meters.iter().filter(|m| has(&m.name)).cloned().collect()
    }

    /// What a meter said is kept apart from what follows from the inputs, in the unit of the problem.
    fn name_meters(&self, plan: &Plan, record: &mut Dataset) -> Result<(), ChainError> {
        let outputs = self.channels.outputs();
        for m in self.channels.meters.iter().filter(|m| !outputs.contains(&m.name)) {
            let Some(c) = record.channels.iter_mut().find(|c| c.name == m.name) else { continue };
            let (scale, offset) = meter_conversion(m, &c.unit, &record.origin, &plan.name)?;
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
        let (inputs, mut outputs) = (self.channels.plant_inputs(), self.channels.outputs());
        outputs.extend(self.channels.watched.iter().cloned());
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

/// Scale and offset from the `unit` of a meter to that of the problem; a fault of the record `measured` of a plan where there are none.
///
/// # Errors
/// [`ChainError::Record`].
pub(super) fn meter_conversion(
    meter: &Port,
    unit: &str,
    measured: &str,
    plan: &str,
) -> Result<(f64, f64), ChainError> {
    units::conversion(unit, &meter.unit).ok_or_else(|| {
        let fault = format!(
            "channel `{}`: found the unit {unit}, expected {} or a unit that converts to it",
            meter.name, meter.unit
        );
        ChainError::Record { measured: measured.into(), plan: plan.into(), faults: vec![fault] }
    })
}

fn texts(names: &[String]) -> Vec<&str> {
    names.iter().map(String::as_str).collect()
}

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

/// A record that begins where it may not says which one, and what to change; `unit` of an output.
fn begins_beyond(plan: &Plan, unit: impl Fn(&str) -> String, e: PlayError) -> ChainError {
    let PlayError::Unsafe { output, value, lower, upper } = e else { return e.into() };
    let of = |v: f64| format!("{}{}", significant(v, 4), UnitAfter(&unit(&output)));
    let allowed = match (lower.is_finite(), upper.is_finite()) {
        (true, true) => format!("{} to {}", of(lower), of(upper)),
        (true, false) => format!("at least {}", of(lower)),
        _ => format!("at most {}", of(upper)),
    };
    ChainError::BeginsBeyond { record: plan.name.clone(), found: of(value), output, allowed }
}
