//! Whether a calibration may be used as it is, and what to know before.
//!
//! The verdict follows the *final* map: it must have finite results on the plant, and no fault of the models or of the last
//! pass that it stands on. A pass that must not be used is left out of map and models, and said. Against the rivals the
//! delivered map is compared in words, also where it is not better.

mod rivals;

use super::models::ModelsResult;
use super::optimise_step::{MOST_GAP_POINTS, Pass};
use super::poor;
use super::run::ChainResult;
use super::spec::{CalibrateSpec, INFORMATIVE};
use super::validate_step::{DYNAMIC, NOT_REFINED, ONE_LAG, OWN_FUEL, ValidateResult};
use dynocal_calib::validate::{MOST_OFFSET, MapScore, spent_input};
use dynocal_ident::data::UnitAfter;
use dynocal_numerics::status::Status;
use dynocal_report::{capital, significant, with_unit};
use rivals::{beaten, beyond_reference, left_with, of_static, out_of_reach, rounded_far, static_saves_more};

/// Difference of a meter and what follows from the inputs that is worth a warning, as a share.
const METER: f64 = 0.01;

/// Share of the samples outside of what fuelling was identified on that is worth a warning.
const MOST_OUTSIDE: f64 = 0.01;

/// Warnings and what they mean together.
pub struct Verdict {
    /// False when the final map must not be used.
    pub valid: bool,
    /// What came out, against what, in one or two sentences.
    pub words: String,
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
    excitation(r, &mut f);
    let last = r.design.as_ref().filter(|_| r.optimise.is_none());
    let refused = last.and_then(|d| poor::refused(spec, &d.result.models));
    let told = refused.is_some();
    if let Some(why) = refused {
        f.fault(Status::Stalled, why);
    }
    passes(spec, r, &mut f);
    if let Some(v) = &r.validate {
        comparison(spec, &v.result, &mut f);
        f.notes.extend(static_saves_more(r, &v.result));
        f.notes.extend(beyond_reference(&v.result));
    }
    design(spec, r, &mut f);
    models(r, told, &mut f);
    f.notes.extend(rounded_far(r));
    f.notes.extend(unread_boost(spec, r));
    if let Some(i) = &r.invert {
        f.notes.extend(i.result.left_out.iter().map(|l| format!("Left out of the map: {l}.")));
    }
    let noise = spec.plant.noise_words();
    if !noise.is_empty() && spec.plant.name != "bed" {
        f.notes.push(format!(
            "Records carry sensor noise ({noise}); static map and comparison of the maps are run without it."
        ));
    }
    let valid = f.faults.is_empty();
    let words = words(spec, r, valid);
    f.faults.extend(f.notes);
    Verdict { valid, words, status: f.status, warnings: f.faults }
}

/// A pressure before the throttle that has no model cannot be read by the others.
fn unread_boost(spec: &CalibrateSpec, r: &ChainResult) -> Option<String> {
    let by = r.excite.as_ref()?.result.fuelled.as_ref()?.governs.as_ref()?;
    let boost = by.boost.as_ref()?;
    let modelled =
        spec.problem.demand_names().into_iter().chain(spec.problem.other_outputs()).any(|o| o == *boost);
    (!modelled).then(|| {
        format!(
            "The models of the air do not know `{boost}`, which the fuelling reads: it has no model, as the problem does not limit it. A limit on it, however far, gives it one."
        )
    })
}

/// Mean distance of the excitation from a demand from which on it is not that of the demand, as a share of its range.
const NOT_FOLLOWED: f64 = 0.25;

/// Records that stand beside their demands: what was asked for is out of reach.
fn excitation(r: &ChainResult, f: &mut Findings) {
    for d in r.excite.iter().flat_map(|e| &e.result.followed) {
        if !(d.share.abs() <= NOT_FOLLOWED) {
            f.fault(
                Status::Infeasible,
                format!(
                    "The records do not follow the demand of {}: measured less demanded is {} in the mean, {:.1} times the range of the demand. The plant, or what holds it there, does not reach it.",
                    d.output,
                    with_unit(d.mean_error, 3, &d.unit),
                    d.share.abs()
                ),
            );
        }
    }
}

fn passes(spec: &CalibrateSpec, r: &ChainResult, f: &mut Findings) {
    let Some(o) = &r.optimise else { return };
    let passes = &o.result.passes;
    let last = passes.last().map_or(0, |p| p.pass);
    for p in passes {
        for g in &p.gave_way {
            let unit = spec.problem.unit(&g.output).unwrap_or("-");
            f.notes.push(format!(
                "Where the models found no way in pass {}, the demand of {} gave way: by {}{after} (RMS), {}{after} at most.",
                p.pass,
                g.output,
                significant(g.rms, 2),
                significant(g.largest, 2),
                after = UnitAfter(unit)
            ));
        }
        if !p.usable {
            let text = format!("The optimum of pass {} must not be used: {}.", p.pass, p.reason);
            if p.pass == last {
                f.fault(p.status, text);
            } else {
                f.notes.push(text);
            }
        } else if !p.status.is_success() {
            f.notes.push(format!(
                "The optimisation of pass {} {} after {} iterations; its demands are met.",
                p.pass,
                how_it_ended(p.status),
                p.iterations
            ));
        }
        for l in p.limits.iter().filter(|l| l.soft && l.passed()) {
            f.notes.push(format!("The measured optimum of pass {} passes {}.", p.pass, l.words()));
        }
        let points = p.missed_points().abs();
        if points > MOST_GAP_POINTS {
            let what = objective_words(spec);
            let seen = if p.unmetered(&spec.problem).is_empty() { "measured" } else { "played" };
            f.notes
                .push(format!("Promised and {seen} {what} of pass {} differ by {points:.1} points.", p.pass));
        }
    }
    if let Some(p) = passes.last() {
        meters(spec, p, f);
    }
}

/// Where what is minimised comes from: a meter, and whether it agrees with the inputs, or the inputs alone.
fn meters(spec: &CalibrateSpec, p: &Pass, f: &mut Findings) {
    let formula = |name: &str| {
        let d = spec.problem.derive.iter().find(|d| d.name == name);
        d.map_or_else(|| name.to_string(), ToString::to_string)
    };
    for m in p.meters.iter().filter(|m| !(m.error.abs() <= METER)) {
        f.notes.push(format!(
            "The meter of {} reads {:+.1} % in the mean beside {}: the actuator, the factor (number of cylinders) or the meter is off. What was saved is by the meter, what was promised by the inputs.",
            m.channel,
            100.0 * m.error,
            formula(&m.channel)
        ));
    }
    for name in p.unmetered(&spec.problem) {
        f.notes.push(format!(
            "Nothing meters {name}: it follows from the recorded inputs, {}. An error of an actuator does not show in it.",
            formula(&name)
        ));
    }
}

/// Points of R2 that a designed record may cost without a word.
const WORSE_POINTS: f64 = 1.0;

/// What is minimised, in words.
pub(crate) fn objective_words(spec: &CalibrateSpec) -> String {
    let names: Vec<&str> = spec.problem.minimise.iter().map(|t| t.channel.as_str()).collect();
    names.join(" + ")
}

fn comparison(spec: &CalibrateSpec, v: &ValidateResult, f: &mut Findings) {
    let missed: Vec<_> = v.static_map.points.iter().filter(|p| !p.missed.is_empty()).collect();
    if let Some(first) = missed.first() {
        f.notes.push(format!(
            "{} of {} points of the static map were not reached, e.g. at {} and {}: {}.",
            missed.len(),
            v.static_map.points.len(),
            first.demand,
            first.given,
            first.missed
        ));
    }
    if let Some(by) = v.fuelled.as_ref().filter(|by| by.outside > MOST_OUTSIDE) {
        f.notes.push(format!(
            "In {} % of the comparison speed or throttle lie outside of what `{}` was identified on.",
            significant(100.0 * by.outside, 2),
            by.file
        ));
    }
    for s in &v.scores {
        let finite = s.objective.is_finite() && s.demands.iter().all(|d| d.rms.is_finite());
        if !finite {
            let text = format!("The {} has no finite result in {}.", s.map, s.scenario);
            // What a rival does is no fault of the map that is delivered.
            if s.map == DYNAMIC { f.fault(Status::Diverged, text) } else { f.notes.push(text) }
        }
    }
    for s in v.scores.iter().filter(|s| s.map == DYNAMIC) {
        for (k, (d, range)) in s.demands.iter().zip(&spec.problem.demands).enumerate() {
            let most = MOST_OFFSET[k.min(1)];
            if d.offset > most * (range.upper - range.lower) {
                f.fault(
                    Status::Stalled,
                    format!(
                        "The dynamic map leaves a steady offset of {} in {} ({}): more than {} % of its range.",
                        with_unit(d.offset, 3, &d.unit),
                        d.output,
                        s.scenario,
                        100.0 * most
                    ),
                );
            }
        }
        f.notes.extend(out_of_reach(s));
        f.notes.extend(beaten(v, s));
        for l in s.limits.iter().filter(|l| l.passed()) {
            let text =
                format!("In {} the dynamic map passes {}; {}.", s.scenario, l.words(), of_static(v, s, l));
            if l.soft { f.notes.push(text) } else { f.fault(Status::Infeasible, text) }
        }
    }
}

fn design(spec: &CalibrateSpec, r: &ChainResult, f: &mut Findings) {
    let Some(d) = r.design.as_ref().map(|d| &d.result) else { return };
    if !d.left_out.is_empty() && !d.left_out.starts_with("no design was asked") {
        f.notes.push(format!(
            "The campaign went on without a designed record: {}.",
            d.left_out.trim_end_matches('.')
        ));
    }
    if let Some(s @ (Status::Infeasible | Status::Diverged)) = d.status {
        f.notes.push(format!(
            "The test signal does not keep its limits on the models (the search {}).",
            how_it_ended(s)
        ));
    }
    let of = |data: &str| d.gains.iter().find(|g| g.data.starts_with(data));
    if let (Some(own), Some(before)) = (of("with the designed"), of("identification records")) {
        for ((name, a), (_, b)) in own.r2.iter().zip(&before.r2) {
            let (a, b) = (100.0 * a.unwrap_or(f64::NEG_INFINITY), 100.0 * b.unwrap_or(f64::NEG_INFINITY));
            if a < b - WORSE_POINTS {
                f.notes.push(format!(
                    "With the designed record the {name} model became worse: free-run R2 on unseen records {} %, {} % before.",
                    significant(a, 4),
                    significant(b, 4)
                ));
            }
        }
    }
    // Where both have chosen levels they are of one recipe, and which is better says nothing.
    if !d.choice.is_empty() && spec.excite.signal == INFORMATIVE {
        return;
    }
    if let (Some(own), Some(other)) = (of("with the designed"), of("with one more")) {
        let worse: Vec<String> = own
            .r2
            .iter()
            .zip(&other.r2)
            .filter(|(a, b)| b.1 >= a.1)
            .map(|((name, a), (_, b))| {
                format!(
                    "{name} {:.2} against {:.2} %",
                    100.0 * a.unwrap_or(f64::NAN),
                    100.0 * b.unwrap_or(f64::NAN)
                )
            })
            .collect();
        if !worse.is_empty() {
            f.notes.push(format!(
                "The designed record was worth no more than one more record of the first recipe (free-run R2 on unseen records): {}.",
                worse.join(", ")
            ));
        }
    }
}

/// `told`: those that no optimum is sought on are named already.
fn models(r: &ChainResult, told: bool, f: &mut Findings) {
    let all = stages(r);
    let last = all.last().map(|(stage, _)| stage.clone());
    for (stage, m) in &all {
        let decides = Some(stage) == last.as_ref();
        for o in &m.outputs {
            let best = o.best();
            if best.scores.iter().any(|s| s.r2.is_none()) {
                let text = format!("The {} model of the step {stage} diverges on a record.", o.output);
                if decides { f.fault(Status::Diverged, text) } else { f.notes.push(text) }
            }
            if best.earlier {
                f.notes.push(format!(
                    "The records of the step {stage} made the {} model worse on the record that chooses: the earlier model goes on.",
                    o.output
                ));
            }
            if let Some(worse) = best.unseen_r2.and_then(poor::worse_than_mean).filter(|_| !(told && decides))
            {
                let text = format!("The {} model of the step {stage} {worse}.", o.output);
                if decides { f.fault(Status::Stalled, text) } else { f.notes.push(text) }
            }
            if !best.status.is_success() && decides {
                f.notes.push(format!(
                    "The estimate of the {} model of the step {stage} {} after {} evaluations.",
                    o.output,
                    how_it_ended(best.status),
                    best.evaluations
                ));
            }
            if decides {
                f.notes.extend(
                    best.warnings.iter().map(|w| format!("{} model of the step {stage}: {w}", o.output)),
                );
            }
        }
    }
}

/// All sets of models of a run with the step that they come from, in order.
pub fn stages(r: &ChainResult) -> Vec<(String, &ModelsResult)> {
    let mut out: Vec<(String, &ModelsResult)> = Vec::new();
    out.extend(r.identify.iter().map(|d| ("identify".into(), &d.result)));
    out.extend(
        r.design.iter().filter(|d| !d.result.records.is_empty()).map(|d| ("design".into(), &d.result.models)),
    );
    for p in r.optimise.iter().flat_map(|d| &d.result.passes) {
        out.push((format!("optimise, pass {}", p.pass), &p.models));
    }
    out
}

/// What is said where engine and fuelling are one plant.
const ONE_PLANT: &str = " Models and optimum are those of engine and fuelling as one plant: the injection is modelled and not moved, and models that read it are scored on what its model says.";

/// One or two sentences at the top of the page.
fn words(spec: &CalibrateSpec, r: &ChainResult, valid: bool) -> String {
    let Some(v) = r.validate.as_ref().map(|d| &d.result) else {
        let (done, all) = (super::store::finished(r), super::run::STEPS.len());
        return match (r.invert.is_some(), valid) {
            (true, true) => format!(
                "{done} of {all} steps are finished: the dynamic map is there, and nothing speaks against it so far. It has not been compared with other maps."
            ),
            (true, false) => {
                format!("{done} of {all} steps are finished: the dynamic map must not be used as it is.")
            }
            (false, _) => format!("{done} of {all} steps are finished; there is no map to judge yet."),
        };
    };
    let passes = r.optimise.iter().flat_map(|d| &d.result.passes);
    let head = match (valid, passes.filter(|p| p.usable).count()) {
        (true, _) => "The dynamic map may be used.",
        (false, 0) => {
            "The dynamic map must not be used: no pass of the optimisation may be, and it was made from the last one only to be looked at."
        }
        (false, _) => "The dynamic map must not be used as it is.",
    };
    let own = v.scores.iter().filter(|s| s.map == DYNAMIC);
    let paragraphs = own.map(|own| against_rivals(spec, v, own));
    let fuel = v.fuelled.as_ref().map_or(String::new(), |by| {
        let one = spec.fuelling.as_ref().is_some_and(|f| f.plant);
        let as_one = if one { ONE_PLANT } else { "" };
        format!(" Its fuel is given by measured states (`{}`), its other inputs by the map.{as_one}", by.file)
    });
    std::iter::once(format!("{head}{fuel}")).chain(paragraphs).collect::<Vec<_>>().join("\n")
}

/// What the dynamic map is worth in one scenario, in sentences.
fn against_rivals(spec: &CalibrateSpec, v: &ValidateResult, own: &MapScore) -> String {
    let of_scenario = || v.scores.iter().filter(|s| s.scenario == own.scenario);
    // What differs from the delivered map in its dynamics or its fuel alone is no rival of it: it says what these are worth.
    let rivals: Vec<&MapScore> = of_scenario()
        .filter(|s| ![DYNAMIC, ONE_LAG, NOT_REFINED, OWN_FUEL].contains(&s.map.as_str()))
        .collect();
    let mut out = Vec::new();
    for d in &own.demands {
        let integrals = rivals
            .iter()
            .filter_map(|s| s.demand(&d.output).map(|o| (o.integral_s, s.map.as_str())))
            .filter(|(i, _)| i.is_finite());
        if let Some((integral, map)) = integrals.min_by(|a, b| a.0.total_cmp(&b.0)) {
            let word = if d.integral_s < integral { "better" } else { "worse" };
            let unit = if d.unit == "-" { "s".to_string() } else { format!("{} s", d.unit) };
            let (own, best) = (significant(d.integral_s, 4), significant(integral, 4));
            out.push(format!(
                "it holds {} {word} than the best rival, the {map}: {own} against {best} {unit} of error integrated over a step",
                d.output
            ));
        }
    }
    let own_fuel = of_scenario().find(|s| s.map == OWN_FUEL);
    out.extend(own_fuel.and_then(|plain| left_with("its own fuel", own, plain)));
    // Where the map does not inject, its dynamics say little of the further demands.
    let one_lag = of_scenario().find(|s| s.map == ONE_LAG && own_fuel.is_none());
    out.extend(one_lag.and_then(|plain| left_with("one lag in the place of its own dynamics", own, plain)));
    if let Some(rival) = rivals.iter().find(|s| s.map == "static map") {
        let unit = match &spec.problem.minimise[..] {
            [one] => spec.problem.unit(&one.channel).unwrap_or("-"),
            _ => "-",
        };
        let yields = match (own.economy, rival.economy, own.demands.first()) {
            (Some(own), Some(rival), Some(lead)) => format!(
                ", and gives {:.1} % {} {} for the same sum of {}",
                100.0 * (own / rival - 1.0).abs(),
                if own >= rival { "more" } else { "less" },
                lead.output,
                spent_input(&spec.problem).unwrap_or_else(|| objective_words(spec))
            ),
            _ => String::new(),
        };
        out.push(format!(
            "it takes {} of {}, the static map {}{yields}",
            with_unit(own.objective, 4, unit),
            objective_words(spec),
            with_unit(rival.objective, 4, unit)
        ));
    }
    format!("{}: {}.", capital(&own.scenario), out.join("; "))
}

/// How a search ended, in words that follow its name.
pub fn how_it_ended(s: Status) -> &'static str {
    match s {
        Status::Converged => "converged",
        Status::Stalled => "came to a stand before it converged",
        Status::Limit => "had used up its budget",
        Status::Infeasible => "found nothing that keeps all limits",
        Status::Diverged => "diverged",
        Status::Interrupted => "was interrupted",
    }
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
