//! What estimate, validation and preparation say, as findings.

use dynocal_ident::data::Gap;
use dynocal_ident::estimate::Fit;
use dynocal_ident::prepare::{Became, Effect};
use dynocal_ident::validate::{Kind, Seen};
use dynocal_numerics::status::Status;

use super::finding::{Finding, Grade};
use super::result::{Modelled, Prepared, Score};
use super::spec::Target;

/// Share of random free runs that may diverge before the model is at fault; fewer are a warning.
const UNSTABLE: f64 = 0.05;
/// Share of the samples outside the boundary, in percent, above which a part is called an extrapolation.
const OUTSIDE: f64 = 10.0;

/// What an estimate says of itself.
pub fn of_fit(t: &Target, f: &Fit) -> Vec<Finding> {
    let mut out = Vec::new();
    if !f.status.is_success() {
        let text = format!(
            "the search of `{}` {} after {} evaluations",
            f.estimator,
            in_words(f.status),
            f.evaluations
        );
        out.push(Finding::new(Grade::Fault, t.target.as_str(), text));
    }
    let warning = |w: &String| Finding::new(Grade::Warning, t.target.as_str(), w.as_str());
    out.extend(f.warnings.iter().map(warning));
    out.extend(f.notes.iter().map(|n| Finding::new(Grade::Note, t.target.as_str(), n.as_str())));
    out
}

/// How a search ended.
pub fn in_words(status: Status) -> &'static str {
    match status {
        Status::Converged => "converged",
        Status::Stalled => "found no better point although its tolerance is not met,",
        Status::Limit => "used up its evaluations without converging,",
        Status::Infeasible => "found no point that keeps the limits",
        Status::Diverged => "met no finite value",
        Status::Interrupted => "was interrupted",
    }
}

/// Share of the points in the 95 % band below which the bands are called too narrow.
const NARROW: f64 = 0.85;

/// What bands say of a response model.
fn of_bands(m: &Modelled) -> Option<Finding> {
    let scores = &m.points.as_ref()?.scores;
    let (what, u) = match (&scores.unseen, &scores.folds) {
        (Some(u), _) => ("unseen points", u),
        (None, Some(u)) => ("held-out points", u),
        (None, None) => ("left-out points", &scores.left_out),
    };
    let text = format!(
        "the 95 % band of a measurement holds {:.0} % of {} {what}: it is too narrow there",
        100.0 * u.coverage,
        u.points
    );
    (u.coverage < NARROW).then(|| Finding::new(Grade::Warning, m.target.as_str(), text))
}

/// Share of the variance of held-out points, in percent, below which little of them is told.
const LITTLE: f64 = 5.0;

/// What points say that had no part in a response model.
fn of_signal(m: &Modelled) -> Option<Finding> {
    let p = m.points.as_ref()?;
    let number = |v: f64| dynocal_report::significant(v, 3);
    let ((rmse, how), mean) = (p.held_out(), p.of_the_mean());
    let errors = format!("RMSE {} against {}", number(rmse), number(mean));
    let (grade, text) = match p.held_out_r2_percent() {
        _ if rmse >= mean => {
            let text = format!(
                "points held out {how} are predicted no better than by the mean of the others ({errors}): nothing that these inputs explain was found"
            );
            (Grade::Fault, text)
        }
        r2 if r2 < LITTLE => {
            let text = format!(
                "points held out {how} are predicted hardly better than by the mean of the others ({errors}): little that these inputs explain was found"
            );
            (Grade::Warning, text)
        }
        _ => return None,
    };
    Some(Finding::new(grade, m.target.as_str(), text))
}

/// What stability, coverage and bands say of a model.
pub fn of_model(m: &Modelled) -> Vec<Finding> {
    let mut out: Vec<Finding> = of_signal(m).into_iter().chain(of_bands(m)).collect();
    let warnings = m.points.iter().flat_map(|p| &p.warnings);
    out.extend(warnings.map(|w| Finding::new(Grade::Warning, m.target.as_str(), w.as_str())));
    if let Some(s) = m.after.stability.as_ref().filter(|s| s.share_diverged > 0.0) {
        let grade = if s.share_diverged > UNSTABLE { Grade::Fault } else { Grade::Warning };
        let where_it_is =
            if s.share_diverged < 1.0 { "unstable on a part of them" } else { "unstable there" };
        let text = format!(
            "{:.0} of {} free runs on random inputs within the limits of the estimation records leave the range of the output by \
             more than ten times its width: it is {where_it_is}",
            (s.share_diverged * s.runs as f64).round(),
            s.runs
        );
        out.push(Finding::new(grade, m.target.as_str(), text));
    }
    let things = if m.points.is_some() { "points" } else { "samples" };
    for c in m.after.coverage.iter().filter(|c| c.outside_percent > OUTSIDE) {
        let text = format!(
            "{:.0} % of the {things} of {} lie outside of what was identified: their scores are those of an extrapolation",
            c.outside_percent, c.part
        );
        out.push(Finding::new(Grade::Warning, m.target.as_str(), text));
    }
    out
}

/// A free run on data that had no part in the model, further from them than their mean.
pub fn of_scores(scores: &[Score]) -> Vec<Finding> {
    let judged = |s: &&Score| s.kind == Kind::FreeRun && s.data == Seen::Unseen && !s.outside;
    let worse = |s: &Score| {
        let (r2, rmse) = (s.r2_percent.filter(|r2| *r2 <= 0.0)?, s.rmse?);
        let text = format!(
            "the free run on {} is no nearer to what was measured than its mean is (RMSE {}, R2 {:.0} %): nothing of it is told there",
            s.part,
            dynocal_report::significant(rmse, 3),
            r2
        );
        Some(Finding::new(Grade::Fault, s.output.as_str(), text))
    };
    scores.iter().filter(judged).filter_map(worse).collect()
}

/// Samples that the preparation filled, left missing or gave up, counted for each part and step.
pub fn losses(preparation: &[Prepared]) -> Vec<Finding> {
    let mut out = Vec::new();
    for p in preparation {
        for note in &p.notes {
            let (mut filled, mut lost, mut dropped) = (0, 0, 0);
            for c in &note.changes {
                match &c.effect {
                    Effect::Samples { runs, became: Became::Missing | Became::CutOut } => {
                        lost += runs.iter().map(Gap::samples).sum::<usize>();
                    }
                    Effect::Samples { runs, .. } => filled += runs.iter().map(Gap::samples).sum::<usize>(),
                    Effect::Dropped { from, to, .. } => dropped += to - from,
                    _ => {}
                }
            }
            let counts = [
                (filled, "values filled in"),
                (lost, "values missing or cut out"),
                (dropped, "samples given up"),
            ];
            let said: Vec<String> =
                counts.iter().filter(|c| c.0 > 0).map(|(n, what)| format!("{n} {what}")).collect();
            if !said.is_empty() {
                let text = format!("step {}: {}", note.step, said.join(", "));
                out.push(Finding::new(Grade::Note, p.part.as_str(), text));
            }
            let remark = |r: &String| Finding::new(Grade::Warning, p.part.as_str(), r.as_str());
            out.extend(note.remarks.iter().map(remark));
        }
    }
    out
}
