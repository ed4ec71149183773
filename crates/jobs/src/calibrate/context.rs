//! What every step of a campaign shares: the spec, the plant and the way to interrupt and report.

use super::spec::CalibrateSpec;
use dynocal_calib::control::LoopGains;
use dynocal_calib::fuel::FuelError;
use dynocal_calib::map::MapLimits;
use dynocal_calib::map::structured::MapError;
use dynocal_calib::record::ActuatorLimits;
use dynocal_files::FilesError;
use dynocal_files::csv_io;
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::plan::Plan;
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_ident::play::{PlayError, RecordFault, Unwatched, check_record, play};
use dynocal_numerics::registry::BuildError;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Why a campaign cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum ChainError {
    /// A file.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A record.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A plan that could not be played.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// A measured record is not what its plan asked for.
    #[error("{file} is not a record of the plan `{plan}`: {}", .faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Record {
        /// File.
        file: String,
        /// Plan.
        plan: String,
        /// Every fault.
        faults: Vec<RecordFault>,
    },
    /// A member of a table.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The optimisation.
    #[error(transparent)]
    Fuel(#[from] FuelError),
    /// The map.
    #[error(transparent)]
    Map(#[from] MapError),
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
    /// A real bed must measure first.
    #[error(
        "the plan `{plan}` ({mode}; its loops and limits stand beside it) waits to be run on the bed: put the measured record at `{measured}` (columns time [s], {columns}) and start again: finished steps are kept"
    )]
    NeedsMeasurement {
        /// Plan that was written.
        plan: String,
        /// Open or closed loop.
        mode: String,
        /// Columns of the record, with units.
        columns: String,
        /// Where the record is expected.
        measured: String,
    },
    /// A step that only a plant in the loop can do.
    #[error(
        "the static map and the comparison of the maps step a plant themselves: on a real bed the chain ends with `dynocal invert`, which has written the map; run this step on the virtual engine"
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

/// Least fuel in mg that loops and maps use: a motored cylinder has no lambda that a loop could hold.
pub const MIN_FUEL_MG: f64 = 1.0;

/// Throttle angle in deg above which nothing changes any more.
pub const OPEN_THROTTLE_DEG: f64 = 60.0;

/// Makes plants: with the sensor noise of the spec, or free of noise.
pub type PlantFactory<'a> = &'a (dyn Fn(bool) -> Result<Box<dyn Plant>, PlantError> + Sync);

/// What the caller is told while a campaign runs.
#[derive(Clone, Debug)]
pub enum Event {
    /// A step begins: number (from 1), of, name.
    Step(usize, usize, &'static str),
    /// A step was taken from an earlier run.
    Resumed(&'static str),
    /// Fraction of the present step that is done.
    Fraction(f64),
    /// Something worth a line in the log.
    Note(String),
}

/// Shared by all steps.
pub struct Context<'a> {
    /// The checked spec.
    pub spec: &'a CalibrateSpec,
    /// Where plants come from; none for a real bed.
    pub plants: Option<PlantFactory<'a>>,
    /// Folder with measured records when the plant is a real bed.
    pub measured: PathBuf,
    /// Whether to stop.
    pub interrupt: &'a (dyn Fn() -> bool + Sync),
    /// Who is told.
    pub tell: &'a (dyn Fn(Event) + Sync),
}

impl Context<'_> {
    /// Stops when asked to.
    ///
    /// # Errors
    /// [`ChainError::Interrupted`].
    pub fn check_interrupt(&self) -> Result<(), ChainError> {
        if (self.interrupt)() { Err(ChainError::Interrupted) } else { Ok(()) }
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

    /// Whether the plant has sensor noise.
    pub fn noisy(&self) -> bool {
        self.spec.plant.torque_noise_nm > 0.0 || self.spec.plant.lambda_noise > 0.0
    }

    /// Actuator limits of every closed-loop run.
    pub fn actuator_limits(&self) -> ActuatorLimits {
        let p = &self.spec.optimise.program;
        ActuatorLimits {
            inj_mg: (p.inj_mg.0.max(MIN_FUEL_MG), p.inj_mg.1),
            spark_deg: p.spark_deg,
            throttle_deg: (p.throttle_deg.0, p.throttle_deg.1.min(OPEN_THROTTLE_DEG)),
        }
    }

    /// The actuator limits as numbers, for the digest of a step.
    pub fn actuator_limits_key(&self) -> [f64; 6] {
        let l = self.actuator_limits();
        [l.inj_mg.0, l.inj_mg.1, l.spark_deg.0, l.spark_deg.1, l.throttle_deg.0, l.throttle_deg.1]
    }

    /// The same limits for maps.
    pub fn map_limits(&self) -> MapLimits {
        let l = self.actuator_limits();
        MapLimits {
            lower: [l.inj_mg.0, l.spark_deg.0, l.throttle_deg.0],
            upper: [l.inj_mg.1, l.spark_deg.1, l.throttle_deg.1],
        }
    }

    /// Runs a plan on the plant, or writes it and reads the measured record when the plant is a real bed.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn measure(&self, folder: &Path, plan: &Plan, noise: bool) -> Result<Dataset, ChainError> {
        self.check_interrupt()?;
        let name = &plan.name;
        if self.plants.is_some() {
            let mut plant = self.plant(noise)?;
            plant.reset(noise_seed(self.spec.seed, name));
            return Ok(play(plant.as_mut(), plan, &mut Unwatched)?.whole()?.record);
        }
        let plan_path = dynocal_files::plan::write(folder, plan)?;
        let measured = self.measured.join(format!("{name}.csv"));
        if !measured.exists() {
            return Err(ChainError::NeedsMeasurement {
                plan: plan_path.display().to_string(),
                mode: plan.mode(),
                columns: dynocal_files::plan::record_columns(plan),
                measured: measured.display().to_string(),
            });
        }
        let mut record = dynocal_files::plan::read_record(&measured, plan)?;
        let faults = check_record(plan, &record);
        if !faults.is_empty() {
            let file = measured.display().to_string();
            return Err(ChainError::Record { file, plan: name.clone(), faults });
        }
        // The stamps have been compared: the record has the sample time of the plan.
        record.channels.retain(|c| c.name != dynocal_files::dataset::STAMPS);
        record.sample_time_s = plan.sample_time_s;
        record.origin = format!("bed, {}", measured.display());
        Ok(record)
    }
}

/// Seed of the sensor noise of one record: depends on seed and name only, not on the order of the runs.
fn noise_seed(seed: u64, name: &str) -> u64 {
    name.bytes().fold(seed ^ 0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// A stored record of a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

/// Reads the records of a step back, bit for bit.
///
/// # Errors
/// [`FilesError`].
pub fn load_records(
    folder: &Path,
    refs: &[RecordRef],
    sample_time_s: f64,
) -> Result<Vec<Dataset>, FilesError> {
    refs.iter()
        .map(|r| {
            let mut d = read_record(&folder.join(&r.file), &r.name)?;
            // The time column is rounded, the spec is not.
            d.sample_time_s = sample_time_s;
            d.origin.clone_from(&r.origin);
            Ok(d)
        })
        .collect()
}

fn read_record(path: &Path, name: &str) -> Result<Dataset, FilesError> {
    let inputs: Vec<&str> = dynocal_calib::record::INPUTS.to_vec();
    let mut d = dynocal_files::dataset::read_dataset(path, &inputs, &["torque", "lambda"])?;
    d.name = name.into();
    Ok(d)
}

/// Gains by name, as the spec gives them.
///
/// # Errors
/// [`ChainError::Spec`] with the names there are.
pub fn gains(name: &str) -> Result<LoopGains, ChainError> {
    LoopGains::named(name).ok_or_else(|| ChainError::Spec {
        key: "excite.gains".into(),
        found: format!("\"{name}\""),
        expected: format!("one of {}", LoopGains::NAMES.join(", ")),
    })
}
