//! The spec of a calibration as the user writes it. Every key has a default that works on the virtual engine.

use dynocal_calib::gains::TuneSpec;
use dynocal_calib::map::structures::{self, MapStructure};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::steady::SearchSpec;
use dynocal_calib::validate::ValidateSpec;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::PlanLimit;
use dynocal_ident::play::RecordTolerance;
use dynocal_numerics::registry::BuildError;
pub use dynocal_plant::plants::PlantSpec;
use serde::{Deserialize, Serialize};

use crate::export_spec::ExportKeys;
use crate::fuelling::spec::Channels;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A range.
pub type Range = (f64, f64);

/// A whole calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateSpec {
    /// Name of the run; that of the spec's file where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Title of the report.
    pub title: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Control, hold and identification interval in s.
    pub sample_time_s: f64,
    /// Longest time in s from a change of an input to the steepest change of an output that a record of a bed may show: analysers
    /// with long lines and slow thermocouples need more.
    pub longest_delay_s: f64,
    /// The plant.
    pub plant: PlantSpec,
    /// What may move, what must be met, what is minimised.
    pub problem: CalibrationProblem,
    /// Loops that hold demanded outputs, one for each demand.
    pub loops: Vec<LoopSpec>,
    /// How gains are found where the loops have none.
    pub tune: TuneSpec,
    /// Abort rules of every record that is played: the plan ends before an output passes them, and what was measured is kept.
    pub abort: Vec<PlanLimit>,
    /// Fuel by measured states in place of the map's own; none: the map injects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fuelling: Option<FuelledSpec>,
    /// Step 1: excitation.
    pub excite: ExciteSpec,
    /// Step 2: models.
    pub identify: IdentifySpec,
    /// Step 3: optimal test signal.
    pub design: DesignSpec,
    /// Step 4: optimisation over a record.
    pub optimise: OptimiseSpec,
    /// Step 5: inverse map.
    pub invert: InvertSpec,
    /// Step 6: static map and comparison.
    pub validate: CompareSpec,
    /// Formats in which the maps leave.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub export: Option<ExportKeys>,
}

impl Default for CalibrateSpec {
    fn default() -> Self {
        Self {
            name: None,
            title: "Dynamic calibration".into(),
            seed: 1,
            sample_time_s: 0.03,
            longest_delay_s: RecordTolerance::default().longest_delay_s,
            plant: PlantSpec::default(),
            problem: engine_problem(),
            loops: vec![
                LoopSpec { output: "torque".into(), input: "throttle".into(), gains: None, trim: None },
                LoopSpec { output: "lambda".into(), input: "inj".into(), gains: None, trim: None },
            ],
            tune: TuneSpec::default(),
            abort: Vec::new(),
            fuelling: None,
            excite: ExciteSpec::default(),
            identify: IdentifySpec::default(),
            design: DesignSpec::default(),
            optimise: OptimiseSpec::default(),
            invert: InvertSpec::default(),
            validate: CompareSpec::default(),
            export: None,
        }
    }
}

/// The problem of the thesis with the bounds that loops and maps on an engine need: a motored cylinder has no lambda that a loop
/// could hold, and above 60 deg nothing changes any more in a throttle.
fn engine_problem() -> CalibrationProblem {
    let mut problem = CalibrationProblem::thesis();
    for i in &mut problem.inputs {
        match i.name.as_str() {
            "inj" => i.lower = 1.0,
            "throttle" => i.upper = 60.0,
            _ => {}
        }
    }
    problem
}

/// A loop that holds a demanded output by one input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopSpec {
    /// Demanded output.
    pub output: String,
    /// Input that the loop drives.
    pub input: String,
    /// Gains with which the loop finds an operating point (excitation, static map); none: a short identification on the
    /// plant finds those of all loops ([`CalibrateSpec::tune`]).
    #[serde(default)]
    pub gains: Option<PiGains>,
    /// Smaller gains that only trim a feedforward: they hold what was promised without taking over. A quarter of `gains`
    /// where they are not given.
    #[serde(default)]
    pub trim: Option<PiGains>,
}

/// The family of `identify.families` that is generated beside polynomials.
pub(super) const NEURAL: &str = "neural";
/// The value of `excite.signal` that chooses levels instead of drawing them.
pub(super) const INFORMATIVE: &str = "informative";
/// The value of `design.model` that asks for the candidate of most parameters.
pub(super) const RICHEST: &str = "richest";
/// The value of `design.criterion` that lets the lack of fit decide.
pub(super) const AUTO: &str = "auto";

/// The excitation in closed loop (thesis section 7.4.1): levels of an APRBS on every demand and on every input that no loop
/// drives, displaced against each other, and a triangular sweep of the given channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExciteSpec {
    /// Length of one record in s.
    pub record_s: f64,
    /// Identification records.
    pub identification_records: usize,
    /// Validation records, of other seeds and sweep periods; where there are at least two, the first chooses between
    /// candidates, the others only judge.
    pub validation_records: usize,
    /// Ranges by channel where they are not those of the problem.
    pub ranges: BTreeMap<String, Range>,
    /// Values at which inputs that loops drive begin, where the plant's own are not wanted (a real bed has none).
    pub start: BTreeMap<String, f64>,
    /// How levels are drawn: `aprbs` at random from a few, `informative` so that each tells most.
    pub signal: String,
    /// Equidistant levels of each channel.
    pub levels: usize,
    /// Hold time of the levels in s.
    pub hold_s: f64,
    /// Duration of a sweep of a given channel from end to end, in s.
    pub sweep_s: f64,
    /// Dwell at both ends of the sweep in s.
    pub dwell_s: f64,
    /// Whether every plan keeps to the rates of the inputs, for actuators that must not be stepped. Else rates bind the optimum alone:
    /// a record in which inputs step tells more.
    pub keep_rates: bool,
    /// Time before each record in which the loops find the first operating point, in s.
    pub lead_in_s: f64,
    /// Records of an earlier campaign or of a bed (any measurement format, with the channels of the problem) instead of step 1: for
    /// identification.
    pub identification_files: Vec<PathBuf>,
    /// The same for validation.
    pub validation_files: Vec<PathBuf>,
}

impl Default for ExciteSpec {
    fn default() -> Self {
        Self {
            record_s: 60.0,
            identification_records: 2,
            validation_records: 3,
            ranges: BTreeMap::new(),
            start: BTreeMap::new(),
            signal: "aprbs".into(),
            levels: 5,
            hold_s: 3.0,
            sweep_s: 7.0,
            dwell_s: 1.0,
            keep_rates: false,
            lead_in_s: 3.0,
            identification_files: Vec::new(),
            validation_files: Vec::new(),
        }
    }
}

/// Models of the demanded and limited outputs. The tables are those of a spec of `dynocal identify`; what is not given is
/// generated from the problem (`steps/02-identify/*.toml` shows it, and `dynocal identify` runs it).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IdentifySpec {
    /// Leading samples of each record that enter no score.
    pub init_samples: usize,
    /// Further derived channels for the pools of candidates, beside those of the problem.
    pub derive: Vec<dynocal_ident::derived::Derived>,
    /// Steps of the preparation.
    pub prepare: Vec<toml::Table>,
    /// Candidates by output: tables `[model]` of `dynocal identify`; the one with the best free run on the records that
    /// choose goes on.
    pub models: BTreeMap<String, Vec<toml::Table>>,
    /// Stored models by output (`model.json` of `dynocal identify`) instead of an estimate.
    pub files: BTreeMap<String, PathBuf>,
    /// Terms of a generated polynomial; a third more for outputs that are modelled by their reciprocal.
    pub terms: usize,
    /// How often the terms are doubled for further candidates; the records that choose say what is large enough.
    pub doublings: usize,
    /// Families of generated candidates beside polynomials: `neural`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub families: Vec<String>,
    /// Longest lag of a generated pool in samples; half as many again for outputs that are modelled by their reciprocal, whose sensor
    /// lies behind a transport.
    pub lags: usize,
    /// Judgement: the table `[validate]` of `dynocal identify`.
    pub validate: toml::Table,
}

impl Default for IdentifySpec {
    fn default() -> Self {
        Self {
            init_samples: 10,
            derive: Vec::new(),
            prepare: Vec::new(),
            models: BTreeMap::new(),
            files: BTreeMap::new(),
            terms: 30,
            doublings: 0,
            families: Vec::new(),
            lags: 5,
            validate: toml::Table::new(),
        }
    }
}

/// The optimal test signal: inputs designed by `dynocal design` for the identified models within the limits of the problem,
/// played with trimming loops about the predicted outputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DesignSpec {
    /// Whether to design at all.
    pub enabled: bool,
    /// A record that was designed and measured elsewhere, instead of a design.
    pub record: Option<PathBuf>,
    /// `auto`: the lack of fit decides between levels that tell most and a record that is I-optimal for the richest models. Else the
    /// criterion that is minimised (`d`, `i`, ...); those of predictions are about the records of the excitation.
    pub criterion: String,
    /// For which model: the `chosen` one, or the candidate of most parameters (`richest`) that is nowhere unstable.
    pub model: String,
    /// Length of the designed record in s.
    pub record_s: f64,
    /// Least time at a value in s.
    pub hold_s: f64,
    /// Least time in which an input that a loop drives goes through its range, in s.
    pub ramp_s: f64,
    /// Time between the corners of given channels in s.
    pub given_point_s: f64,
    /// Share of the demanded range by which predicted outputs may leave it, at either end.
    pub excess: f64,
    /// Starts of the search.
    pub starts: usize,
    /// Most evaluations of criterion and gradient per start.
    pub max_evaluations: usize,
}

impl Default for DesignSpec {
    fn default() -> Self {
        Self {
            enabled: true,
            record: None,
            criterion: "d".into(),
            model: "chosen".into(),
            record_s: 60.0,
            hold_s: 1.5,
            ramp_s: 1.5,
            given_point_s: 3.0,
            excess: 1.0,
            starts: 1,
            max_evaluations: 300,
        }
    }
}

/// Optimisation over a record, in passes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiseSpec {
    /// Passes at most: optimise, measure, identify again.
    pub passes: usize,
    /// Passes end before their number when an optimum that may be used is measured within so many points of what it promised; none: they
    /// do not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within_points: Option<f64>,
    /// Times at most that start and optimum are corrected by what was missed and played again, where the plant does not follow the optimum.
    #[serde(skip_serializing_if = "none_of")]
    pub trials: usize,
    /// Whether an optimum is sought on models of demanded outputs that say less of unseen records than the mean of the output does.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub force: bool,
    /// Length of each record in s.
    pub record_s: f64,
    /// Ranges of the demands where they are not the inner parts of those of the problem.
    pub ranges: BTreeMap<String, Range>,
    /// Hold time of the levels of the leading demand in s.
    pub hold_s: f64,
    /// Most iterations of the interior point.
    pub max_iterations: usize,
    /// Scaled KKT error at which it has converged.
    pub tolerance: f64,
    /// Weight on increments of inputs whose `increment_weight` is absent: increments as large as those of the start record add
    /// this share to the objective. 0: none.
    pub smoothing: f64,
    /// How far a demand may give way where the search does not end with demands that are met exactly, see `give` of
    /// `dynocal optimise`: far less than models and sensors know.
    pub give: f64,
    /// Maps that an ECU has, along which inputs of the start records go.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_maps: Option<StartMaps>,
}

fn none_of(count: &usize) -> bool {
    *count == 0
}

impl Default for OptimiseSpec {
    fn default() -> Self {
        Self {
            passes: 2,
            within_points: None,
            trials: 0,
            force: false,
            record_s: 60.0,
            ranges: BTreeMap::new(),
            hold_s: 1.5,
            max_iterations: 300,
            tolerance: 1e-8,
            smoothing: 0.01,
            give: 1e-9,
            start_maps: None,
        }
    }
}

/// Which maps of which files begin.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartMaps {
    /// Files in a form that is read back (DCM, CDFX, CSV maps, JSON).
    pub files: Vec<PathBuf>,
    /// Characteristic (scalar, curve or map) of each input that begins by one.
    pub maps: BTreeMap<String, String>,
    /// Demanded output or given channel of an axis, by the axis' name or the quantity that enters it; an axis that is called as the
    /// channel needs none.
    pub axes: BTreeMap<String, String>,
}

/// The inverse map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InvertSpec {
    /// Structure of the map that is delivered, a row of the table of map structures.
    pub structure: String,
    /// Its keys.
    pub shape: toml::Table,
    /// Structures that are fitted and compared beside it, where they are made for the problem's channels.
    pub rivals: Vec<String>,
    /// Whether the map learns from the re-identified models' simulated outputs instead of the measured ones (better
    /// when sensors are noisy); `auto` decides by the noise of the plant.
    pub pairs: String,
    /// Records that the map itself drives with the loops about it, each as long as one of the optimisation, after each of which the
    /// map is fitted again (thesis section 7.8.2).
    pub refine: usize,
    /// Points at rest on the plant that the map is moved onto.
    pub at_rest: AtRestSpec,
}

impl Default for InvertSpec {
    fn default() -> Self {
        Self {
            structure: "lead_lag".into(),
            shape: toml::Table::new(),
            rivals: vec!["structured".into(), "published_7_18".into()],
            pairs: "auto".into(),
            refine: 0,
            at_rest: AtRestSpec::default(),
        }
    }
}

/// The points at rest that a map is moved onto.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AtRestSpec {
    /// Whether to measure them at all.
    pub enabled: bool,
    /// Points along the leading demand and along the first given channel.
    pub points: usize,
    /// Time at each point in s.
    pub hold_s: f64,
    /// Its end over which is averaged, in s.
    pub average_s: f64,
}

impl Default for AtRestSpec {
    fn default() -> Self {
        Self { enabled: true, points: 5, hold_s: 3.5, average_s: 1.0 }
    }
}

impl InvertSpec {
    /// The structure with its keys.
    ///
    /// # Errors
    /// [`BuildError`]: the name or a key.
    pub fn built(&self) -> Result<Box<dyn MapStructure>, BuildError> {
        (structures::row(&self.structure)?.build)(&self.shape)
    }
}

/// Grid of the static map.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StaticSpec {
    /// Axis of the leading demand; five values over the inner three quarters of its range where it is empty.
    pub demand: Vec<f64>,
    /// Axis of the first given channel; five values over the inner nine tenths of its range where it is empty.
    pub given: Vec<f64>,
    /// Search of the inputs that no loop drives.
    pub search: SearchSpec,
}

/// Static map and comparison.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CompareSpec {
    /// Grid of the static map.
    pub static_map: StaticSpec,
    /// Scenarios.
    pub scenario: ValidateSpec,
}

/// Identified fuelling that injects in place of the delivered map: one that is there, or a job that identifies it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FuelledSpec {
    /// `fuelling.json` of a run of `dynocal fuelling`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Spec of `dynocal fuelling`, which is run before the first step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spec: Option<PathBuf>,
    /// Whether it injects in the records of the excitation, too: lambda then stays near what is demanded.
    pub excite: bool,
    /// Whether the throttle of the delivered map may go ahead of its rest: sooner there in torque, with larger spikes of lambda.
    pub lead: bool,
    /// Whether engine and fuelling are one plant: models, design and optimisation move everything but the injection, which is one more
    /// output, and the lambda that is demanded is a given channel.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub plant: bool,
    /// Names of the channels of `file` on the plant; a spec has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channels: Option<Channels>,
}

impl Default for FuelledSpec {
    fn default() -> Self {
        Self { file: None, spec: None, excite: true, lead: false, plant: false, channels: None }
    }
}
