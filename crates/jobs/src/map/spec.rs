//! The spec of a steady calibration as the user writes it. Every key has a default that works on the virtual engine.

use std::collections::BTreeMap;
use std::path::PathBuf;

use dynocal_calib::gains::TuneSpec;
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::steady::grid::GridSpec;
use dynocal_calib::steady::plan::{Order, PlanKind};
use dynocal_calib::steady::refine::RefineSpec;
use dynocal_calib::steady::station::ApproachSpec;
use dynocal_numerics::interval::Interval;
use dynocal_plant::plants::PlantSpec;
use serde::{Deserialize, Serialize};

use crate::calibrate::spec::{CalibrateSpec, LoopSpec};

/// A steady calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapSpec {
    /// Name of the run; that of the spec's file where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Title of the report.
    pub title: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Interval of control and measurement in s.
    pub sample_time_s: f64,
    /// The plant.
    pub plant: PlantSpec,
    /// What may move, what must be met, what is limited and minimised.
    pub problem: CalibrationProblem,
    /// Loops that hold demanded outputs, one for each demand.
    pub loops: Vec<LoopSpec>,
    /// How gains are found where the loops have none.
    pub tune: TuneSpec,
    /// Axes of the maps: one demand, one given channel, or both, with their values; eight over the range of the first of each
    /// where it is empty.
    pub axes: BTreeMap<String, Vec<f64>>,
    /// Values of the demands and given channels that are no axes; the middle of their range where they are not there.
    pub held: BTreeMap<String, f64>,
    /// Values of inputs with which the day begins, where those of the plant are not wanted.
    pub start: BTreeMap<String, f64>,
    /// The day on the bed.
    pub bed: BedSpec,
    /// Response models.
    pub models: ModelsSpec,
    /// The optimum of each cell.
    pub optimise: GridSpec,
    /// Verification.
    pub verify: VerifySpec,
    /// Table of cells that a user has edited ([`super::edits`]), relative to the spec; they stand in the maps as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edits: Option<PathBuf>,
}

impl Default for MapSpec {
    fn default() -> Self {
        let CalibrateSpec { problem, loops, .. } = CalibrateSpec::default();
        Self {
            name: None,
            title: "Steady calibration".into(),
            seed: 1,
            sample_time_s: 0.03,
            plant: PlantSpec::default(),
            problem,
            loops,
            tune: TuneSpec::default(),
            axes: BTreeMap::new(),
            held: BTreeMap::new(),
            start: BTreeMap::new(),
            bed: BedSpec::default(),
            models: ModelsSpec::default(),
            optimise: GridSpec::default(),
            verify: VerifySpec::default(),
            edits: None,
        }
    }
}

impl MapSpec {
    /// Channels that are measured beside those of the problem: what a front is traced against, and what is slow.
    pub fn others(&self) -> Vec<&String> {
        let against = self.optimise.front.as_ref().map(|f| &f.against);
        against.into_iter().chain(&self.bed.slow).collect()
    }
}

/// The day on the bed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BedSpec {
    /// Most points of the day: to learn from, repeats and verification together.
    pub points: usize,
    /// How the planned points are chosen.
    pub plan: PlanKind,
    /// Their order within a block.
    pub order: Order,
    /// Points between two repeats of the first point.
    pub block: usize,
    /// Bed time in minutes after which no further point begins, verification included.
    pub minutes: f64,
    /// Ranges of inputs that no loop drives, where they are not those of the problem.
    pub ranges: BTreeMap<String, Interval>,
    /// How far past its limit an output may go while a point is approached; unit of the output.
    pub beyond: BTreeMap<String, f64>,
    /// How points are approached and held.
    pub approach: ApproachSpec,
    /// Points that follow the optimum.
    pub refine: RefineSpec,
    /// An output that is slower than a point (oil): what it is away from where it comes to rest is taken out of what is measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slow: Option<String>,
    /// Lines of the finished maps along which the inputs that loops drive are measured, where it is there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep: Option<SweepSpec>,
}

/// Sweeps along the finished maps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SweepSpec {
    /// Time in s in which the whole of the first axis is gone through; every line is gone there and back, or with rests there only.
    pub pass_s: f64,
    /// Lines between two neighbouring values of the other axis.
    pub between: usize,
    /// Rest at the turn of a line in s: what the demand comes to there is neither lag of the way nor a loop that is behind.
    pub turn_s: f64,
    /// Rest at each value of the first axis in s; with one a line is gone one way only, and what is measured is what stands there at rest. 0: none.
    pub rest_s: f64,
}

impl Default for SweepSpec {
    fn default() -> Self {
        Self { pass_s: 25.0, between: 1, turn_s: 0.0, rest_s: 0.0 }
    }
}

impl Default for BedSpec {
    fn default() -> Self {
        Self {
            points: 75,
            plan: PlanKind::default(),
            order: Order::default(),
            block: 15,
            minutes: 60.0,
            ranges: BTreeMap::new(),
            beyond: BTreeMap::new(),
            approach: ApproachSpec::default(),
            refine: RefineSpec::default(),
            slow: None,
            sweep: None,
        }
    }
}

/// What an error of a response counts by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Errors {
    /// Itself.
    Absolute,
    /// Its share of what was measured: what is minimised differs by few percent between settings, and by multiples over the map.
    /// Only for outputs that are positive everywhere; others by themselves.
    #[default]
    Relative,
}

/// Response models: candidates as for `best_of`, the simplest first, each a table with `kind` and its keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelsSpec {
    /// Candidates; chosen by nested validation for each response.
    pub candidates: Vec<toml::Table>,
    /// By which errors the model of what is minimised is chosen.
    pub errors: Errors,
    /// Folds, inner and outer.
    pub folds: usize,
    /// Channels that the map of a driven input may follow from in place of the factors, by input: factors, other driven inputs, limited
    /// outputs, what is minimised, derived channels. The folds decide between them and the factors.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub over: BTreeMap<String, Vec<String>>,
}

impl Default for ModelsSpec {
    fn default() -> Self {
        let kind = |kind: &str| toml::Table::from_iter([("kind".to_string(), kind.into())]);
        let quadratic = || {
            let mut table = kind("stepwise_polynomial");
            table.insert("degree".into(), 2.into());
            table
        };
        // Engines are products more than sums: fuel, pressure and knock by their logarithms.
        let log = |mut table: toml::Table| {
            table.insert("transform".into(), "log".into());
            table
        };
        // And they change faster at small loads and speeds than at large ones. The last one is that by which `bed.slow` is judged.
        let warped = |warp: &str| {
            let mut table = log(kind("gaussian_process"));
            table.insert("warp".into(), warp.into());
            table
        };
        let processes =
            [kind("gaussian_process"), log(kind("gaussian_process")), warped("sqrt"), warped("asinh")];
        let polynomials =
            [quadratic(), log(quadratic()), kind("stepwise_polynomial"), log(kind("stepwise_polynomial"))];
        Self {
            candidates: polynomials.into_iter().chain(processes).collect(),
            errors: Errors::Relative,
            folds: 5,
            over: BTreeMap::new(),
        }
    }
}

impl ModelsSpec {
    /// Keys of the learner that chooses among the candidates by `folds` parts.
    pub(super) fn choice_keys(&self, folds: usize) -> toml::Table {
        let tables = self.candidates.iter().cloned().map(toml::Value::Table).collect();
        let folds = toml::Value::Integer(i64::try_from(folds).unwrap_or(5));
        toml::Table::from_iter([("models".into(), toml::Value::Array(tables)), ("folds".into(), folds)])
    }
}

/// The verification run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VerifySpec {
    /// Unseen points of the finished maps that are measured.
    pub points: usize,
    /// Share of its size by which a measured output may pass its limit.
    pub limit: f64,
    /// Share by which what is minimised may differ from what was promised.
    pub objective: f64,
}

impl Default for VerifySpec {
    fn default() -> Self {
        Self { points: 8, limit: 0.03, objective: 0.03 }
    }
}
