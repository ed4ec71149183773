//! What a calibration takes, before it runs.

use dynocal_plant::plants;

use super::job::{Campaign, last_step};
use super::spec::{AUTO, CalibrateSpec};
use crate::estimate::Estimate;

/// Rough share of the pool of candidates that a generated polynomial is selected from: products of two of the lagged channels.
fn candidates(channels: usize, lags: usize) -> f64 {
    let lagged = (channels * lags) as f64;
    1.0 + lagged + 0.5 * lagged * (lagged + 1.0)
}

/// The steps with their records. The largest matrix is that of the selection, the dominant loops are those of estimation, design
/// and optimisation; records of a plant are counted by their samples.
pub fn estimate(campaign: &Campaign) -> Estimate {
    let s = &campaign.spec;
    let samples = |seconds: f64| (seconds / s.sample_time_s).max(0.0);
    let (e, d, o) = (&s.excite, &s.design, &s.optimise);
    let identification = e.identification_records as f64 * samples(e.record_s);
    let by_lack = d.enabled && d.criterion == AUTO;
    let all = identification
        + samples(if by_lack { d.record_s.max(e.record_s) } else { d.record_s })
        + 2.0 * o.passes as f64 * samples(o.record_s);
    let channels = s.problem.inputs.len() + s.problem.given.len() + 1;
    let pool = candidates(channels, s.identify.lags);
    // Every size is tried.
    let sizes = (2usize << s.identify.doublings) - 1;
    let most = s.identify.terms << s.identify.doublings;
    let terms = (most + most / 3) as f64;
    let outputs = (s.problem.demands.len() + s.problem.other_outputs().len()) as f64;
    let stepped = plants::find(&s.plant.name).is_some_and(|p| p.make.is_some());
    let records = |n: usize, length_s: f64| format!("{n} records of {length_s} s");
    let excitation = match e.identification_files.len() {
        0 => format!(
            "{}, {} to judge",
            records(e.identification_records, e.record_s),
            records(e.validation_records, e.record_s)
        ),
        n => format!("{n} files, {} to judge", e.validation_files.len()),
    };
    // Models of the rest read that of the injection.
    let one_plant = s.fuelling.as_ref().is_some_and(|f| f.plant);
    let gains = if s.loops.iter().all(|l| l.gains.is_some()) { "as given" } else { "found on the plant" };
    let plan = Estimate::new(&campaign.name)
        .line("run folder", campaign.out.display().to_string())
        .line(
            "plant",
            if stepped { s.plant.name.clone() } else { format!("{}: plans and files", s.plant.name) },
        )
        .line("gains of the loops", gains)
        .line("fuel", fuel_words(s))
        .line("excite", excitation)
        .line(
            "identify",
            identification_words(s, outputs, &format!("up to {terms} terms of about {pool:.0}")),
        )
        .line(
            "design",
            match &d.record {
                Some(file) => format!("the record `{}`", file.display()),
                None if by_lack => format!("{}, as the lack of fit asks", records(1, e.record_s)),
                None if one_plant => "none: no design knows models that read each other".into(),
                None if d.enabled => format!("{}, criterion {}", records(1, d.record_s), d.criterion),
                None => "none".into(),
            },
        );
    let designed = d.enabled && d.record.is_none() && !one_plant;
    let evaluations = if designed { (d.starts * d.max_evaluations) as f64 } else { 0.0 };
    let estimated = outputs - s.identify.files.len() as f64;
    let iterations = (o.passes * o.max_iterations) as f64;
    let at_most = if o.within_points.is_some() { " at most" } else { "" };
    let trials = match o.trials {
        0 => String::new(),
        n => format!(", start and optimum at most {n} times more where the plant does not follow"),
    };
    plan.line("optimise", format!("{} passes{at_most} over {} s{trials}", o.passes, o.record_s))
        .line("ends with", last_step(s))
        .memory(8.0 * outputs * all * (2.0 * pool + 3.0 * terms))
        .work(estimated * identification * 2.0 * pool * (s.identify.terms * sizes) as f64 * 4.0 / 3.0)
        .work(outputs * evaluations * 4.0 * samples(d.record_s) * terms * terms)
        .work(outputs * iterations * 1e3 * samples(o.record_s))
}

/// Who injects in the delivered map.
fn fuel_words(s: &CalibrateSpec) -> String {
    let named = s.fuelling.iter().flat_map(|f| f.spec.iter().chain(&f.file)).next();
    named.map_or_else(|| "by the map".into(), |file| format!("by measured states, `{}`", file.display()))
}

/// Outputs that are estimated, and those whose models are given.
fn identification_words(s: &CalibrateSpec, outputs: f64, terms: &str) -> String {
    let given = s.identify.files.len();
    let estimated = outputs as usize - given.min(outputs as usize);
    match (estimated, given) {
        (n, 0) => format!("{n} outputs, {terms}"),
        (0, n) => format!("nothing before the step design: {n} models are given"),
        (n, g) => format!("{n} outputs, {terms}; {g} models are given"),
    }
}
