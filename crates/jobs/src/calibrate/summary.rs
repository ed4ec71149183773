//! `summary.json` of a calibration: results only, equal for equal runs (keys: docs/summary.md).

use super::at_rest::AtRest;
use super::design_step::Gain;
use super::fuelled::FuelledBy;
use super::models::{FreeRunScore, OutputModels};
use super::optimise_miss::Miss;
use super::optimise_step::Pass;
use super::optimise_trials::Learned;
use super::run::{ChainResult, STEPS};
use super::spec::CalibrateSpec;
use super::store::{RunFile, finished};
use super::validate_step::{Causality, StaticOnRecord};
use super::verdict::{Verdict, stages};
use crate::design::result::{CriterionLine, SafetyLine};
use dynocal_calib::gains::Tuned;
use dynocal_calib::map::static_map::StaticPoint;
use dynocal_calib::map::structures::InverseScore;
use dynocal_calib::problem::Metered;
use dynocal_calib::validate::MapScore;
use dynocal_numerics::status::Status;
use serde::Serialize;

/// Results of a calibration.
#[derive(Serialize)]
pub(crate) struct Summary<'a> {
    pub(crate) verb: &'static str,
    pub(crate) name: &'a str,
    pub(crate) status: Status,
    pub(crate) valid: bool,
    pub(crate) verdict: &'a str,
    pub(crate) warnings: &'a [String],
    pub(crate) steps: Vec<&'static str>,
    pub(crate) spec: &'a CalibrateSpec,
    pub(crate) bed: BedTimes,
    /// Gains of the loops that were found on the plant, with their margins; none where the spec gives them.
    pub(crate) loops: Option<&'a Tuned>,
    pub(crate) models: Vec<Models<'a>>,
    pub(crate) design: Option<Design<'a>>,
    pub(crate) passes: Vec<PassLine<'a>>,
    pub(crate) static_on_record: Option<&'a StaticOnRecord>,
    pub(crate) causality: Option<&'a Causality>,
    /// How fuel was given where the map does not inject.
    pub(crate) fuelled: Option<&'a FuelledBy>,
    pub(crate) inverse: Option<Inverse<'a>>,
    pub(crate) static_map: Option<&'a [StaticPoint]>,
    pub(crate) lag_s: Option<f64>,
    pub(crate) maps: &'a [MapScore],
    pub(crate) files: &'a [RunFile],
}

/// Bed times in s, lead-in and settling included.
#[derive(Serialize)]
pub(crate) struct BedTimes {
    pub(crate) loops_s: f64,
    pub(crate) identification_s: f64,
    pub(crate) design_s: f64,
    pub(crate) optimisation_s: f64,
    pub(crate) at_rest_s: f64,
    /// Records that identified who injects.
    pub(crate) fuelling_s: f64,
    /// Gains, identification, design, optimisation, points at rest and fuelling: what a calibration needs.
    pub(crate) total_s: f64,
    pub(crate) validation_records_s: f64,
    pub(crate) design_comparison_s: f64,
    pub(crate) static_map_s: f64,
    pub(crate) map_comparison_s: f64,
}

/// Candidates of one output in one step.
#[derive(Serialize)]
pub(crate) struct Models<'a> {
    pub(crate) step: String,
    pub(crate) output: &'a str,
    pub(crate) unit: &'a str,
    pub(crate) chosen: &'a str,
    pub(crate) candidates: Vec<CandidateLine<'a>>,
}

/// One candidate.
#[derive(Serialize)]
pub(crate) struct CandidateLine<'a> {
    pub(crate) name: &'a str,
    pub(crate) parameters: usize,
    pub(crate) status: Status,
    pub(crate) evaluations: usize,
    pub(crate) choosing_r2: Option<f64>,
    pub(crate) unseen_r2: Option<f64>,
    pub(crate) scores: &'a [FreeRunScore],
}

/// The test signal.
#[derive(Serialize)]
pub(crate) struct Design<'a> {
    pub(crate) status: Option<Status>,
    pub(crate) left_out: &'a str,
    pub(crate) choice: &'a [String],
    pub(crate) evaluations: usize,
    pub(crate) criteria: &'a [CriterionLine],
    pub(crate) safety: &'a [SafetyLine],
    pub(crate) gains: &'a [Gain],
}

/// One pass of the optimisation.
#[derive(Serialize)]
pub(crate) struct PassLine<'a> {
    pub(crate) pass: usize,
    pub(crate) status: Status,
    pub(crate) usable: bool,
    pub(crate) reason: &'a str,
    pub(crate) iterations: usize,
    pub(crate) start: f64,
    pub(crate) promised: f64,
    pub(crate) promised_ratio: f64,
    pub(crate) measured_start: f64,
    pub(crate) measured: f64,
    pub(crate) measured_ratio: f64,
    pub(crate) promise_gap_points: f64,
    pub(crate) meters: &'a [Metered],
    pub(crate) misses: &'a [Miss],
    pub(crate) learned: &'a Learned,
}

/// Fits of the inverse maps.
#[derive(Serialize)]
pub(crate) struct Inverse<'a> {
    pub(crate) pairs: &'a str,
    pub(crate) records: &'a [String],
    pub(crate) left_out: &'a [String],
    pub(crate) scores: &'a [InverseScore],
    /// Points at rest that the map was moved onto.
    pub(crate) at_rest: Option<&'a AtRest>,
}

impl<'a> Summary<'a> {
    /// Collects the results of a run as far as it went.
    pub(crate) fn new(
        name: &'a str,
        spec: &'a CalibrateSpec,
        r: &'a ChainResult,
        verdict: &'a Verdict,
        files: &'a [RunFile],
    ) -> Self {
        let validate = r.validate.as_ref().map(|d| &d.result);
        let models = stages(r);
        let models =
            models.into_iter().flat_map(|(step, m)| m.outputs.iter().map(move |o| lines(step.clone(), o)));
        Self {
            verb: super::store::KIND,
            name,
            status: verdict.status,
            valid: verdict.valid,
            verdict: &verdict.words,
            warnings: &verdict.warnings,
            steps: STEPS[..finished(r)].to_vec(),
            spec,
            bed: bed_times(r),
            loops: r.excite.as_ref().and_then(|d| d.result.tuned.as_ref()),
            models: models.collect(),
            design: r.design.as_ref().map(|d| Design {
                status: d.result.status,
                left_out: &d.result.left_out,
                choice: &d.result.choice,
                evaluations: d.result.evaluations,
                criteria: &d.result.criteria,
                safety: &d.result.safety,
                gains: &d.result.gains,
            }),
            passes: r.optimise.iter().flat_map(|d| &d.result.passes).map(pass).collect(),
            static_on_record: validate.and_then(|v| v.static_on_record.as_ref()),
            causality: validate.and_then(|v| v.causality.as_ref()),
            fuelled: validate.and_then(|v| v.fuelled.as_ref()),
            inverse: r.invert.as_ref().map(|d| Inverse {
                pairs: &d.result.pairs,
                records: &d.result.records,
                left_out: &d.result.left_out,
                scores: &d.result.scores,
                at_rest: d.result.at_rest.as_ref(),
            }),
            static_map: validate.map(|v| v.static_map.points.as_slice()),
            lag_s: validate.map(|v| v.lag_s),
            maps: validate.map_or(&[], |v| &v.scores),
            files,
        }
    }
}

fn bed_times(r: &ChainResult) -> BedTimes {
    let excite = r.excite.as_ref().map(|d| &d.result);
    let design = r.design.as_ref().map(|d| &d.result);
    let validate = r.validate.as_ref().map(|d| &d.result);
    BedTimes {
        loops_s: r.loops_bed_s(),
        identification_s: excite.map_or(0.0, |e| e.identification_bed_s),
        design_s: design.map_or(0.0, |d| d.bed_s),
        optimisation_s: r.optimise.as_ref().map_or(0.0, |d| d.result.bed_s),
        at_rest_s: r.at_rest_bed_s(),
        fuelling_s: r.fuelling_bed_s(),
        total_s: r.bed_s(),
        validation_records_s: excite.map_or(0.0, |e| e.validation_bed_s),
        design_comparison_s: design.map_or(0.0, |d| d.comparison_bed_s),
        static_map_s: validate.map_or(0.0, |v| v.static_map.bed_s),
        map_comparison_s: validate.map_or(0.0, |v| v.bed_s),
    }
}

fn lines(step: String, m: &OutputModels) -> Models<'_> {
    let candidates = m
        .candidates
        .iter()
        .map(|c| CandidateLine {
            name: &c.name,
            parameters: c.model.parameters.len(),
            status: c.status,
            evaluations: c.evaluations,
            choosing_r2: c.choosing_r2,
            unseen_r2: c.unseen_r2,
            scores: &c.scores,
        })
        .collect();
    Models { step, output: &m.output, unit: &m.unit, chosen: &m.best().name, candidates }
}

fn pass(p: &Pass) -> PassLine<'_> {
    PassLine {
        pass: p.pass,
        status: p.status,
        usable: p.usable,
        reason: &p.reason,
        iterations: p.iterations,
        start: p.start,
        promised: p.promised,
        promised_ratio: p.promised_ratio,
        measured_start: p.measured_start,
        measured: p.measured,
        measured_ratio: p.measured_ratio,
        promise_gap_points: 100.0 * (p.promised_ratio - p.measured_ratio).abs(),
        meters: &p.meters,
        misses: &p.misses,
        learned: &p.learned,
    }
}
