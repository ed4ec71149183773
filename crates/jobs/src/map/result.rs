//! What a steady calibration gives.

use dynocal_calib::gains::Tuned;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::day::{DayEnd, DayPoint, Drift};
use dynocal_calib::steady::envelope::Envelope;
use dynocal_calib::steady::front::Front;
use dynocal_calib::steady::grid::Cell;
use dynocal_calib::steady::layout::{AxisRange, Layout};
use dynocal_calib::steady::refine::Left;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::status::Status;
use dynocal_report::Check;
use serde::Serialize;

use super::drive::Drive;
use super::inverse::Inverse;
use super::learn::Learned;
use super::lines::Sweeps;
use super::loops::InputLoop;
use super::refine::Round;
use super::rest::Rest;
use super::setting::setting;
use super::spec::MapSpec;

/// A cell with edits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Edit {
    /// Values of the axes.
    pub at: Vec<f64>,
    /// What was edited.
    pub values: Vec<Edited>,
    /// What is minimised, edited less optimum, as the models expect it.
    pub costs: f64,
    /// Limits that are broken, uncertainty counted in.
    pub passed: Vec<Passed>,
    /// Whether the bed has reached the cell: where it has not, nothing is known of limits.
    pub reached: bool,
}

/// An edited value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Edited {
    /// Input.
    pub input: String,
    /// Unit.
    pub unit: String,
    /// The optimum.
    pub optimum: f64,
    /// The edit.
    pub edit: f64,
}

/// An axis of the maps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapAxis {
    /// Channel.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Values.
    pub points: Vec<f64>,
}

impl MapAxis {
    /// Its range.
    pub fn range(&self) -> AxisRange {
        let end = |p: Option<&f64>| p.copied().unwrap_or(0.0);
        AxisRange {
            name: self.name.clone(),
            range: Interval::new(end(self.points.first()), end(self.points.last())),
        }
    }
}

/// Bed time in s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BedTime {
    /// Gains of the loops.
    pub gains_s: f64,
    /// Points to learn from, repeats among them.
    pub points_s: f64,
    /// Lines of the maps.
    pub sweeps_s: f64,
    /// Verification.
    pub verify_s: f64,
}

impl BedTime {
    /// All of it.
    pub fn all_s(&self) -> f64 {
        self.gains_s + self.points_s + self.sweeps_s + self.verify_s
    }
}

/// A response at a verification point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Deviation {
    /// Response.
    pub response: String,
    /// What the models promised there.
    pub promised: f64,
    /// Half width of the 95 % interval of a measurement about it.
    pub half_width: f64,
    /// What was measured.
    pub measured: f64,
    /// How far it passes its limit; negative: room. None without a limit.
    pub passed: Option<f64>,
    /// What the deviation of an input that a loop drives does to the demand that it holds: as a share of it where its map is relative, else the
    /// deviation itself; none for outputs.
    pub at_demand: Option<f64>,
}

/// A verification point: the maps at an operating point that no model has seen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verified {
    /// Values of the axes, as asked.
    pub at: Vec<f64>,
    /// Whether it was measured as asked.
    pub measured: bool,
    /// What is to be known about it.
    pub note: String,
    /// Responses; none where it was not measured.
    pub deviations: Vec<Deviation>,
    /// What is minimised: promised, half width of its 95 % interval, measured.
    pub objective: Option<[f64; 3]>,
    /// Whether it keeps its limits and its promise.
    pub kept: bool,
}

/// What breakpoints and steps cost, by the models: the delivered maps at the cells of the full ones, against these.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Delivered {
    /// Cells of the full maps.
    pub full_cells: usize,
    /// Mean of what is minimised that is lost, as a share.
    pub mean_loss: f64,
    /// The largest loss of a cell.
    pub largest_loss: f64,
    /// The limit that is passed most, uncertainty counted in, with how far; none where all are kept.
    pub passed: Option<Passed>,
    /// The other response of a front over the full cells, as a share of that of the least objective; none without a front.
    pub against_share: Option<f64>,
    /// Cells whose optimum has no setting in steps that keeps all limits.
    pub lost_cells: usize,
}

/// A limit that is passed between breakpoints.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Passed {
    /// Response.
    pub response: String,
    /// Unit.
    pub unit: String,
    /// How far.
    pub by: f64,
}

/// A steady calibration, the body of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Mapped {
    /// Always `map`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether the maps may be used.
    pub valid: bool,
    /// What came of it, in a sentence or two.
    pub verdict: String,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// What was asked and measured.
    pub checks: Vec<Check>,
    /// Bed time.
    pub bed: BedTime,
    /// Why the day ended.
    pub end: DayEnd,
    /// Axes of the maps, the last one fastest in `cells`.
    pub axes: Vec<MapAxis>,
    /// Batches of points that followed the optimum.
    pub rounds: Vec<Round>,
    /// What more points might be worth, where that was little enough to take no more (`bed.refine.gain`, `interval`).
    pub enough: Option<Left>,
    /// How the program of the whole map ended and its iterations; none where cells were optimised by themselves.
    pub whole: Option<(Status, usize)>,
    /// What is minimised against another response; none where it was not asked for.
    pub front: Option<Front>,
    /// What breakpoints and steps of the ECU cost; none where none were asked for.
    pub delivered: Option<Delivered>,
    /// Cells that are held as a user has edited them.
    pub edits: Vec<Edit>,
    /// Inverse maps of the inputs that loops drive.
    pub inverses: Vec<Inverse>,
    /// What is minimised over each free input at some cells.
    pub loops: Vec<InputLoop>,
    /// What the verification says of each cell: whether all points around it keep limits and promise; none where there is none.
    pub verified_cells: Vec<Option<bool>>,
    /// Drift over the day.
    pub drift: Vec<Drift>,
    /// Response models.
    pub models: Vec<Learned>,
    /// Maps of the inputs that loops drive.
    pub drives: Vec<Drive>,
    /// Lines of the maps that were gone along; none where none were asked for.
    pub sweeps: Option<Sweeps>,
    /// Verification points.
    pub verified: Vec<Verified>,
    /// Cells, the last axis fastest.
    pub cells: Vec<Cell>,
    /// Gains that were found; none where they were given.
    pub tuned: Option<Tuned>,
    /// What is known of a channel that is slower than a point; none where none was named.
    pub rest: Option<Rest>,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// Points of the day.
    #[serde(skip)]
    pub points: Vec<DayPoint>,
    /// Factors and responses.
    #[serde(skip)]
    pub layout: Layout,
    /// The region of the axes that was reached.
    #[serde(skip)]
    pub envelope: Envelope,
    /// The maps.
    #[serde(skip)]
    pub map: StaticMap,
}

impl Mapped {
    /// Models, limits and weights that the cells were searched with.
    pub fn setting(&self, spec: &MapSpec) -> Setting<'_> {
        setting(&self.layout, &self.models, None, spec)
    }
}
