//! `summary.json` of a calibration: results only, equal for equal runs (keys: docs/summary.md).

use crate::calibrate::design_step::{CriterionValue, Gain, SafetyLine};
use crate::calibrate::invert_step::InverseScore;
use crate::calibrate::models::{FreeRunScore, OutputModels};
use crate::calibrate::optimise_step::Pass;
use crate::calibrate::run::{ChainResult, STEPS};
use crate::calibrate::spec::CalibrateSpec;
use crate::calibrate::validate_step::BestSpark;
use dynocal_calib::map::static_map::StaticPoint;
use dynocal_calib::validate::MapScore;
use dynocal_ident::validate::{Kind, Reference, Seen};
use dynocal_numerics::status::Status;
use serde::Serialize;

use super::store::{RunFile, finished};
use super::verdict::{Verdict, stages};

/// Results of a calibration.
#[derive(Serialize)]
pub(crate) struct Summary<'a> {
    pub(crate) verb: &'static str,
    pub(crate) name: &'a str,
    pub(crate) status: Status,
    pub(crate) valid: bool,
    pub(crate) warnings: &'a [String],
    pub(crate) steps: Vec<&'static str>,
    pub(crate) spec: &'a CalibrateSpec,
    pub(crate) bed: BedTimes,
    pub(crate) models: Vec<Models<'a>>,
    pub(crate) design: Option<Design<'a>>,
    pub(crate) passes: Vec<PassLine>,
    pub(crate) best_spark: Option<&'a BestSpark>,
    pub(crate) inverse: Option<Inverse<'a>>,
    pub(crate) static_map: Option<&'a [StaticPoint]>,
    pub(crate) maps: &'a [MapScore],
    pub(crate) files: &'a [RunFile],
}

/// Bed times in s, lead-in and settling included.
#[derive(Serialize)]
pub(crate) struct BedTimes {
    pub(crate) identification_s: f64,
    pub(crate) design_s: f64,
    pub(crate) optimisation_s: f64,
    /// Identification, design and optimisation: what a calibration needs.
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
    pub unseen_r2: Option<f64>,
    pub(crate) scores: Vec<ScoreLine<'a>>,
}

/// A score with what it is a score of.
#[derive(Serialize)]
pub(crate) struct ScoreLine<'a> {
    pub(crate) record: &'a str,
    pub(crate) data: Seen,
    pub(crate) kind: Kind,
    pub(crate) reference: Reference,
    pub(crate) rmse: Option<f64>,
    pub p95: Option<f64>,
    pub r2: Option<f64>,
}

/// The test signal.
#[derive(Serialize)]
pub(crate) struct Design<'a> {
    pub(crate) status: Option<Status>,
    pub(crate) evaluations: usize,
    pub(crate) criteria: &'a [CriterionValue],
    pub(crate) safety: &'a [SafetyLine],
    pub(crate) gains: &'a [Gain],
}

/// One pass of the optimisation.
#[derive(Serialize)]
pub(crate) struct PassLine {
    pub(crate) pass: usize,
    pub(crate) status: Status,
    pub(crate) iterations: usize,
    pub(crate) start_fuel_kg_h: f64,
    pub(crate) promised_fuel_kg_h: f64,
    pub(crate) promised_ratio: f64,
    pub(crate) measured_start_fuel_kg_h: f64,
    pub(crate) measured_fuel_kg_h: f64,
    pub(crate) measured_ratio: f64,
    pub(crate) promise_gap_points: f64,
    pub(crate) fuel_per_work_ratio: f64,
    pub(crate) torque_violation_nm: f64,
    pub(crate) lambda_violation: f64,
    pub(crate) torque_rms_nm: f64,
    pub(crate) lambda_rms: f64,
}

/// Fits of the inverse maps.
#[derive(Serialize)]
pub(crate) struct Inverse<'a> {
    pub(crate) pairs: &'a str,
    pub(crate) records: &'a [String],
    pub(crate) scores: &'a [InverseScore],
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
        Self {
            verb: super::job::KIND,
            name,
            status: verdict.status,
            valid: verdict.valid,
            warnings: &verdict.warnings,
            steps: STEPS[..finished(r)].to_vec(),
            spec,
            bed: bed_times(r),
            models: stages(r).into_iter().map(|(step, m)| models(step, m)).collect(),
            design: r.design.as_ref().map(|d| Design {
                status: d.result.status,
                evaluations: d.result.evaluations,
                criteria: &d.result.criteria,
                safety: &d.result.safety,
                gains: &d.result.gains,
            }),
            passes: r.optimise.iter().flat_map(|d| &d.result.passes).map(pass).collect(),
            best_spark: validate.map(|v| &v.best_spark),
            inverse: r.invert.as_ref().map(|d| Inverse {
                pairs: &d.result.pairs,
                records: &d.result.records,
                scores: &d.result.scores,
            }),
            static_map: validate.map(|v| v.static_map.points.as_slice()),
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
        identification_s: excite.map_or(0.0, |e| e.identification_bed_s),
        design_s: design.map_or(0.0, |d| d.bed_s),
        optimisation_s: r.optimise.as_ref().map_or(0.0, |d| d.result.bed_s),
        total_s: r.bed_s(),
        validation_records_s: excite.map_or(0.0, |e| e.validation_bed_s),
        design_comparison_s: design.map_or(0.0, |d| d.comparison_bed_s),
        static_map_s: validate.map_or(0.0, |v| v.static_map.bed_s),
        map_comparison_s: validate.map_or(0.0, |v| v.bed_s),
    }
}

fn models(step: String, m: &OutputModels) -> Models<'_> {
    let candidates = m
        .candidates
        .iter()
        .map(|c| CandidateLine {
            name: &c.name,
            parameters: c.model.theta.len(),
            status: c.status,
            evaluations: c.evaluations,
            unseen_r2: c.unseen_r2,
            scores: c.scores.iter().map(score).collect(),
        })
        .collect();
    Models { step, output: &m.output, unit: &m.unit, chosen: &m.best().name, candidates }
}

fn score(s: &FreeRunScore) -> ScoreLine<'_> {
    ScoreLine {
        record: &s.record,
        data: s.data,
        kind: Kind::FreeRun,
        reference: Reference::Noisy,
        rmse: s.rmse,
        p95: s.p95,
        r2: s.r2,
    }
}

fn pass(p: &Pass) -> PassLine {
    PassLine {
        pass: p.pass,
        status: p.status,
        iterations: p.iterations,
        start_fuel_kg_h: p.start_fuel_kg_h,
        promised_fuel_kg_h: p.promised_fuel_kg_h,
        promised_ratio: p.promised_ratio,
        measured_start_fuel_kg_h: p.measured_start_fuel_kg_h,
        measured_fuel_kg_h: p.measured_fuel_kg_h,
        measured_ratio: p.measured_ratio,
        promise_gap_points: 100.0 * (p.promised_ratio - p.measured_ratio).abs(),
        fuel_per_work_ratio: p.fuel_per_work_ratio,
        torque_violation_nm: p.torque_violation_nm,
        lambda_violation: p.lambda_violation,
        torque_rms_nm: p.torque_rms_nm,
        lambda_rms: p.lambda_rms,
    }
}
