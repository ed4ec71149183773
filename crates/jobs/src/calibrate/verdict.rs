//! Whether a calibration may be used as it is, and what to know before.

use crate::calibrate::models::OutputModels;
use crate::calibrate::run::ChainResult;
use crate::calibrate::spec::CalibrateSpec;
use dynocal_numerics::status::Status;

/// Largest violation of the demands at which an optimum counts as feasible, in Nm and in lambda.
pub const VIOLATION: f64 = 1e-6;
/// Difference of promised and measured fuel ratio that is worth a warning, in points.
const PROMISE_POINTS: f64 = 1.5;
/// Torque and lambda errors above which a point of the static map was not reached.
const STATIC_ERROR: (f64, f64) = (1.0, 0.02);

/// Warnings and what they mean together.
pub struct Verdict {
    /// False when something did not converge or must not be used.
    pub valid: bool,
    /// The worst way in which a step ended.
    pub status: Status,
    /// Sentences, most important first.
    pub warnings: Vec<String>,
}

/// Collects what makes a run invalid, and what is only worth knowing.
struct Findings {
    faults: Vec<String>,
    notes: Vec<String>,
    status: Status,
}

impl Findings {
    fn fault(&mut self, status: Status, text: String) {
        if self.faults.is_empty() {
            self.status = status;
        }
        self.faults.push(text);
    }
}

/// Judges a run as far as it went.
pub fn of(spec: &CalibrateSpec, r: &ChainResult) -> Verdict {
    let mut f = Findings { faults: Vec::new(), notes: Vec::new(), status: Status::Converged };
    if let Some(o) = &r.optimise {
        passes(&o.result.passes, &mut f);
    }
    if let Some(v) = &r.validate {
        comparison(&v.result, &mut f);
    }
    if let Some(d) = &r.design {
        design(&d.result, &mut f);
    }
    models(r, &mut f);
    if let Some(i) = &r.invert
        && i.result.published.is_none()
    {
        f.notes.push(
            "The published map (7.18) has no stable fit on these records: it is not in the comparison."
                .into(),
        );
    }
    if spec.plant.torque_noise_nm > 0.0 || spec.plant.lambda_noise > 0.0 {
        f.notes.push(format!(
            "Records carry sensor noise (torque {} Nm, lambda {}); static map and comparison of the maps are run without it.",
            spec.plant.torque_noise_nm, spec.plant.lambda_noise
        ));
    }
    let valid = f.faults.is_empty();
    f.faults.extend(f.notes);
    Verdict { valid, status: f.status, warnings: f.faults }
}

fn passes(passes: &[crate::calibrate::optimise_step::Pass], f: &mut Findings) {
    for p in passes {
        if !p.status.is_success() {
            let text = format!(
                "The fuel optimisation of pass {} ended as \"{}\" after {} iterations.",
                p.pass,
                word(p.status),
                p.iterations
            );
            f.fault(p.status, text);
        }
        let points = 100.0 * (p.measured_ratio - p.promised_ratio).abs();
        if !(p.measured_ratio.is_finite() && p.promised_ratio.is_finite()) {
            f.fault(Status::Diverged, format!("Pass {} has no finite fuel ratio.", p.pass));
        } else if p.promised_ratio < 1.0 && p.measured_ratio >= 1.0 {
            let text = format!(
                "Pass {} promised to save {:.1} % of fuel and measured {:+.1} %: its optimum must not be used.",
                p.pass,
                100.0 * (1.0 - p.promised_ratio),
                100.0 * (p.measured_ratio - 1.0)
            );
            f.fault(Status::Stalled, text);
        } else if points > PROMISE_POINTS {
            f.notes
                .push(format!("Promised and measured fuel of pass {} differ by {points:.1} points.", p.pass));
        }
        let feasible = p.torque_violation_nm < VIOLATION && p.lambda_violation < VIOLATION;
        if !feasible {
            let text = format!(
                "The optimum of pass {} misses its demand by up to {:.2e} Nm and {:.2e} in lambda (allowed: {VIOLATION:e}).",
                p.pass, p.torque_violation_nm, p.lambda_violation
            );
            f.fault(Status::Infeasible, text);
        }
    }
}

fn comparison(v: &crate::calibrate::validate_step::ValidateResult, f: &mut Findings) {
    let missed = v
        .static_map
        .points
        .iter()
        .filter(|p| p.torque_error_nm.abs() > STATIC_ERROR.0 || p.lambda_error.abs() > STATIC_ERROR.1)
        .count();
    if missed > 0 {
        f.notes.push(format!(
            "{missed} of {} points of the static map missed torque by more than {} Nm or lambda by more than {}.",
            v.static_map.points.len(),
            STATIC_ERROR.0,
            STATIC_ERROR.1
        ));
    }
    for s in v.scores.iter().filter(|s| !s.torque_rms_nm.is_finite() || !s.lambda_rms.is_finite()) {
        f.fault(Status::Diverged, format!("The {} has no finite result in {}.", s.map, s.scenario));
    }
}

fn design(d: &crate::calibrate::design_step::DesignResult, f: &mut Findings) {
    match d.status {
        Some(s @ (Status::Infeasible | Status::Diverged)) => {
            f.fault(s, format!("The test signal has no design within its limits (the search ended as \"{}\").", word(s)));
        }
        Some(s @ (Status::Limit | Status::Stalled)) => f.notes.push(format!(
            "The search for the test signal ended as \"{}\" after {} evaluations: the design is better than its start, not proven the best.",
            word(s),
            d.evaluations
        )),
        _ => {}
    }
}

fn models(r: &ChainResult, f: &mut Findings) {
    for (stage, m) in stages(r) {
        let best = m.best();
        if best.unseen_r2.is_none() {
            f.fault(
                Status::Diverged,
                format!("Every {} model of the step {stage} diverged on an unseen record.", m.output),
            );
        }
        if !best.status.is_success() {
            f.notes.push(format!(
                "The {} model of the step {stage} was estimated until \"{}\" after {} evaluations.",
                m.output,
                word(best.status),
                best.evaluations
            ));
        }
        f.notes.extend(best.warnings.iter().map(|w| format!("{} model of the step {stage}: {w}", m.output)));
    }
}

/// All pairs of models of a run with the step that they come from, in order.
pub fn stages(r: &ChainResult) -> Vec<(String, &OutputModels)> {
    let mut out: Vec<(String, &OutputModels)> = Vec::new();
    if let Some(d) = &r.identify {
        out.extend([&d.result.torque, &d.result.lambda].map(|m| ("identify".into(), m)));
    }
    if let Some(d) = &r.design
        && d.result.status.is_some()
    {
        out.extend([&d.result.torque, &d.result.lambda].map(|m| ("design".into(), m)));
    }
    for p in r.optimise.iter().flat_map(|d| &d.result.passes) {
        out.extend([&p.torque, &p.lambda].map(|m| (format!("optimise, pass {}", p.pass), m)));
    }
    out
}

/// A status as it stands in JSON.
pub fn word(s: Status) -> &'static str {
    match s {
        Status::Converged => "converged",
        Status::Stalled => "stalled",
        Status::Limit => "limit",
        Status::Infeasible => "infeasible",
        Status::Diverged => "diverged",
        Status::Interrupted => "interrupted",
    }
}
