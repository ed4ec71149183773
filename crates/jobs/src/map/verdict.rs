//! What a steady calibration is worth, in words and checks.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::day::{DayEnd, Purpose};
use dynocal_calib::steady::grid::{Cell, CellState, neighbours};
use dynocal_calib::steady::layout::Layout;
use dynocal_ident::data::UnitAfter;
use dynocal_report::{Cell as Value, Check, significant};

use super::cells::{above_alone, end_in_words, missed, objective_unit};
use super::halfway::JUMP;
use super::learn::Learned;
use super::result::{MapAxis, Mapped, Verified};
use super::spec::MapSpec;

/// Share of measured deviations that has to lie inside of their 95 % intervals.
const COVERED: f64 = 0.8;
/// Explained share of the variance below which a model is called rough.
const ROUGH: f64 = 0.8;
/// Share by which the maps may pass what was taken from the front.
const TAKEN: f64 = 0.002;
/// Loss of a cell by breakpoints and steps, as a share of what is minimised, above which it is said.
const LOST: f64 = 0.01;
/// How many times as fast as asked lines may be gone along before it is said: what is rounded to samples is no hurry.
const HURRIED: f64 = 1.02;
/// Deviation that is none, as a share of the scatter of the response over the points: what settling leaves.
const SMALL: f64 = 0.02;

/// Fills verdict, checks and warnings.
pub(super) fn judge(found: &mut Mapped, spec: &MapSpec) {
    verify_drives(found);
    let mut warnings = Vec::new();
    let count = |state: CellState| found.cells.iter().filter(|c| c.state == state).count();
    let (optimal, infeasible, filled) =
        (count(CellState::Optimal), count(CellState::Infeasible), count(CellState::Filled));
    let (n, beyond) = (found.cells.len(), beyond_limits(found, spec));
    let measured: Vec<&Verified> = found.verified.iter().filter(|v| v.measured).collect();
    let kept = measured.iter().filter(|v| v.kept).count();
    let (inside, all) = covered(found, &measured);
    let mut checks = vec![
        Check::new("cells", "cells inside the envelope that keep all limits with the asked probability")
            .asked(format!("{}", n - filled - beyond))
            .measured(optimal as f64)
            .holds(infeasible == beyond && optimal > 0),
        Check::new("verified", "verification points that were measured and keep limits and promise")
            .asked(format!("{}", spec.verify.points))
            .measured(kept as f64)
            .note(if spec.verify.points > 0 {
                ""
            } else {
                "`verify.points` is 0: what nothing has tested is not called usable"
            })
            .holds(spec.verify.points > 0 && kept == spec.verify.points),
    ];
    if all > 0 {
        let share = inside as f64 / all as f64;
        if share < COVERED {
            warnings.push(format!(
                "the models are surer than they may be: {inside} of {all} responses of the verification lie in their 95 % intervals"
            ));
        }
        let check = Check::new("coverage", "deviations inside of the 95 % intervals of the models, or below 2 % of the scatter of the points")
            .asked(format!(">= {}", 100.0 * COVERED))
            .measured(100.0 * share)
            .unit("%");
        checks.push(
            check.holds(share >= COVERED).note(format!("{all} responses at {} points", measured.len())),
        );
    }
    let done = matches!(found.end, DayEnd::Done | DayEnd::BedTime);
    let used = found.points.iter().filter(|p| p.purpose != Purpose::Verify);
    let usable = used.clone().filter(|p| p.point.usable).count();
    checks.push(
        Check::new("points", "points of the day that could be used")
            .measured(usable as f64)
            .note(end_in_words(&found.end))
            .holds(done),
    );
    if let Some(last) = found.rounds.last() {
        let share = last.error.map(|e| 100.0 * e);
        let check =
            Check::new("promise", "error of what was promised for the last batch of points at the optimum")
                .unit("%")
                .note(format!(
                    "{} batches; {} % or less ends them before their points are used up",
                    found.rounds.len(),
                    100.0 * spec.bed.refine.tolerance
                ));
        checks.push(match share {
            Some(share) => check.measured(share),
            None => check,
        });
    }
    checks.extend(worth(found, spec));
    if let Some((status, iterations)) = found.whole {
        checks.push(
            Check::new("whole", "iterations of the program of all cells together")
                .measured(iterations as f64)
                .note(format!("it ended as {status:?}"))
                .holds(status.is_success()),
        );
        // Maps from a front are dearer by what was traded.
        if let Some([mean, largest]) =
            above_alone(&found.cells, spec.optimise.caution).filter(|_| found.front.is_none())
        {
            let words = "what steps, ways and smoothness of the program of all cells add to what is minimised, mean of the cells";
            let most = format!("{} % at most", significant(100.0 * largest, 2));
            checks.push(Check::new("whole-cost", words).measured(100.0 * mean).unit("%").note(most.clone()));
            if largest > LOST {
                let mean = significant(100.0 * mean, 2);
                warnings.push(format!(
                    "steps, ways and smoothness of `optimise.whole` cost {mean} % of what is minimised in the mean of the cells and {most}"
                ));
            }
        }
    }
    if let Some((front, share)) = found.front.as_ref().zip(take(spec)) {
        let least = front.points.last().map_or(f64::NAN, |p| p.other);
        let first = front.points.first().map_or(f64::NAN, |p| p.other);
        let check = Check::new("front", "the other response of the maps that were taken from the front, as a share of that of the least objective")
            .asked(format!("<= {share}"));
        checks.push(match &front.taken {
            Some(t) => {
                let delivered = found.delivered.as_ref().and_then(|d| d.against_share);
                let measured = delivered.unwrap_or(t.other / first);
                check.measured(measured).holds(measured <= share + TAKEN)
            }
            None => check.measured(least / first).holds(false).note(format!(
                "no map within the limits has less of `{}`: what `front.take` asks for is not there",
                front.against
            )),
        });
    }
    edited(found, &mut checks, &mut warnings);
    if let Some(d) = found.delivered.as_ref().filter(|d| d.largest_loss > LOST) {
        warnings.push(format!(
            "breakpoints and steps of the ECU cost {} % of what is minimised in the mean of the cells and {} % at most",
            significant(100.0 * d.mean_loss, 2),
            significant(100.0 * d.largest_loss, 2)
        ));
    }
    if !done {
        warnings.push(format!("the day ended early: {}", end_in_words(&found.end)));
    }
    for c in found.cells.iter().filter(|c| c.state == CellState::Infeasible).take(10) {
        let at: Vec<String> =
            found.axes.iter().zip(&c.at).map(|(a, v)| format!("{} {v} {}", a.name, a.unit)).collect();
        warnings.push(format!("at {}: {}", at.join(", "), missed(&found.layout, c)));
    }
    for v in found.verified.iter().filter(|v| !v.kept) {
        warnings.push(broken(found, spec, v));
    }
    for d in found.drift.iter().filter(|d| d.corrected && !slow(found, &d.response)) {
        warnings.push(format!(
            "`{}` drifted by {} {} per hour (standard error {}): the points were corrected for it",
            d.response,
            significant(d.per_hour, 3),
            d.unit,
            significant(d.per_hour_error, 2)
        ));
    }
    for note in found.sweeps.iter().flat_map(|s| &s.notes) {
        warnings.push(format!("along the maps: {note}"));
    }
    for fast in found.sweeps.iter().map(|s| s.fastest).filter(|f| *f >= HURRIED) {
        warnings.push(format!(
            "along the maps: bed time was short: lines were gone along up to {fast:.2} times as fast as asked"
        ));
    }
    if spec.bed.sweep.is_some() && found.sweeps.is_none() {
        let names: Vec<String> = found.drives.iter().map(|d| format!("`{}`", d.input)).collect();
        warnings.push(format!(
            "`bed.sweep` was asked for, but this bed cannot go along lines (it is driven through files): what {} set was measured at points only",
            names.join(" and ")
        ));
    }
    for d in found.drives.iter().filter(|d| d.rough()) {
        let (input, missed) = (&d.input, d.missed());
        warnings.push(format!(
            "the map of `{input}` alone does not hold its demand: it errs by {missed} rms, of the demand along lines and in the verification, or, without lines and where that is more, of the input on points that had no part in it"
        ));
    }
    let decides = |m: &&Learned| !driven(found, &m.response);
    for m in found.models.iter().filter(decides).filter(|m| m.explained() < ROUGH) {
        warnings.push(format!(
            "the model of `{}` is rough: it misses unseen points by {} {} rms where they scatter by {}",
            m.response,
            significant(m.rmse, 3),
            m.unit,
            significant(m.spread, 3)
        ));
    }
    warnings.extend(jumps(&found.axes, &found.layout, &found.cells));
    if filled > 0 {
        warnings.push(format!(
            "{filled} of {n} cells lie outside of what was reached on the bed, or were not reached along the maps: they are filled from their neighbours, keep no limit that was checked, and must not be driven"
        ));
        warnings.extend(met(found));
    }
    found.valid = checks.iter().all(|c| c.holds != Some(false));
    let failed: Vec<&Check> = checks.iter().filter(|c| c.holds == Some(false)).collect();
    warnings.extend(failed.iter().map(|c| fails(c)));
    let minutes = significant(found.bed.all_s() / 60.0, 3);
    let cells = format!(
        "{optimal} of {n} cells hold an optimum that keeps all limits with {} %",
        100.0 * spec.optimise.probability
    );
    let verified = format!("{kept} of {} verification points keep limits and promise", spec.verify.points);
    let worth = match (found.valid, filled, beyond) {
        (true, 0, 0) => "The maps can be used",
        (true, _, 0) => "The maps can be used in the cells that are not marked as filled",
        (true, ..) => {
            "The maps can be used in the cells that are not marked as filled, or as not known to keep limits"
        }
        (false, ..) => "The maps must not be used as they are",
    };
    let alone = if found.valid {
        guided(found)
    } else {
        let ids: Vec<String> = failed.iter().map(|c| format!("`{}`", c.id)).collect();
        format!(", as what is asked for does not hold ({})", ids.join(", "))
    };
    let edited = match found.edits.len() {
        0 => String::new(),
        n => format!("; {n} of the cells stand as they were edited"),
    };
    found.verdict = format!(
        "{worth}{alone}: {cells}{edited}; {verified}; {usable} usable points and {minutes} min of bed time."
    );
    found.checks = checks;
    found.warnings = warnings;
}

/// A check that does not hold, in words.
fn fails(c: &Check) -> String {
    let unit = UnitAfter(&c.unit);
    let of = |word: &str, v: &Value| match v {
        Value::Number(v) => format!("; {word} {}{unit}", significant(*v, 4)),
        Value::Text(v) => format!("; {word} {v}{unit}"),
        Value::Empty => String::new(),
    };
    let note = if c.note.is_empty() { String::new() } else { format!(" ({})", c.note) };
    format!("`{}` does not hold: {}{}{}{note}", c.id, c.what, of("asked", &c.asked), of("found", &c.measured))
}

/// Cells at the end of the demand that the models expect to keep all limits, but not with the asked probability: at the same place of the other axes there is
/// an optimum with less of the demand, and none with more. What is known of the engine ends there, as it does where it was not reached. Others are
/// conflicts of limits, or faults of models.
fn beyond_limits(found: &Mapped, spec: &MapSpec) -> usize {
    let l = &found.layout;
    let Some((axis, _)) = l.leading_demand() else { return 0 };
    // Driven inputs stand in the cells as their own maps say.
    let bare = Setting { z: 0.0, ..found.setting(spec) };
    let expected = |c: &&Cell| bare.judge(&c.optimum.x, c.optimum.status, None).feasible;
    let ends = |c: &&Cell| {
        let beside = |o: &&Cell| o.at.iter().zip(&c.at).enumerate().all(|(k, (a, b))| k == axis || a == b);
        let optimal = found.cells.iter().filter(beside).filter(|o| o.state == CellState::Optimal);
        let more = |o: &Cell| o.at[axis].abs() > c.at[axis].abs();
        optimal.clone().any(|o| !more(o)) && !optimal.clone().any(more)
    };
    let infeasible = found.cells.iter().filter(|c| c.state == CellState::Infeasible);
    infeasible.filter(expected).filter(ends).count()
}

/// Cells that are held as edited, and what that breaks.
fn edited(found: &Mapped, checks: &mut Vec<Check>, warnings: &mut Vec<String>) {
    if found.edits.is_empty() {
        return;
    }
    let kept = found.edits.iter().filter(|e| e.passed.is_empty()).count();
    checks.push(
        Check::new("edits", "edited cells that keep all limits with the asked probability")
            .asked(format!("{}", found.edits.len()))
            .measured(kept as f64)
            .holds(kept == found.edits.len()),
    );
    for e in &found.edits {
        let at = place(found, &e.at);
        if !e.passed.is_empty() {
            warnings.push(format!("the edit at {at} breaks limits: {}; {}", e.broken(), e.words()));
        }
        let of =
            found.cells.iter().find(|c| c.at == e.at).map_or(f64::NAN, |c| c.optimum.objective - e.costs);
        if e.costs > LOST * of.abs() {
            warnings.push(format!(
                "the edit at {at} costs {} % of what is minimised there, by the models",
                significant(100.0 * e.costs / of.abs(), 2)
            ));
        }
        if !e.reached {
            warnings.push(format!("the edit at {at} lies outside of what was reached on the bed: nothing is known of limits there"));
        }
    }
}

/// What more points may be worth, where the spec asks for a stop in the unit of what is minimised.
fn worth(found: &Mapped, spec: &MapSpec) -> Vec<Check> {
    let r = &spec.bed.refine;
    let left = found.enough.or(found.rounds.last().and_then(|r| r.left));
    let note = match found.enough {
        Some(_) => "no more points were taken for it",
        None => "before the last batch; the day ended otherwise",
    };
    let one = |(id, what, most, is): (&'static str, &'static str, f64, Option<f64>)| {
        let check = Check::new(id, what).asked(format!("<= {most}")).unit(objective_unit(found)).note(note);
        (most > 0.0).then(|| is.map_or(check.clone(), |v| check.clone().measured(v)))
    };
    let gain = "what the optimum may lie below the maps (two standard deviations), mean of the cells";
    let interval = "95 % interval of what is minimised in the cells, half width, mean";
    [
        ("gain", gain, r.gain, left.map(|l| l.gain)),
        ("interval", interval, r.interval, left.map(|l| l.interval)),
    ]
    .into_iter()
    .filter_map(one)
    .collect()
}

/// What loops set at the verification points, for the maps of the inputs that they drive.
fn verify_drives(found: &mut Mapped) {
    let measured: Vec<&Verified> = found.verified.iter().filter(|v| v.measured).collect();
    for d in &mut found.drives {
        let of = |v: &&Verified| {
            let at = v.deviations.iter().find(|at| at.response == d.input)?;
            at.at_demand
        };
        let missed: Vec<f64> = measured.iter().filter_map(of).collect();
        d.verify(&missed);
    }
}

/// The verification holds the demands with controllers: a map whose model is rough was not shown to hold one alone.
fn guided(found: &Mapped) -> String {
    let rough = found.drives.iter().filter(|d| d.rough());
    let names: Vec<String> = rough.map(|d| format!("`{}` (missed by {})", d.input, d.missed())).collect();
    if names.is_empty() {
        return String::new();
    }
    format!(", but only under a controller that corrects {}", names.join(" and "))
}

/// Whether a response is recorded only: a point does not wait for it.
fn slow(found: &Mapped, name: &str) -> bool {
    found.layout.responses.iter().any(|r| r.slow && r.name == name)
}

fn driven(found: &Mapped, name: &str) -> bool {
    found.layout.problem.inputs.iter().any(|i| i.name == name)
}

/// The share that is asked of the front.
fn take(spec: &MapSpec) -> Option<f64> {
    spec.optimise.front.as_ref().and_then(|f| f.take)
}

/// What the bed met where it was sent to cells that are filled.
fn met(found: &Mapped) -> Vec<String> {
    let n = found.layout.axes;
    let one = |c: &Cell| {
        let sent = found
            .points
            .iter()
            .rev()
            .find(|p| p.purpose == Purpose::Optimum && p.point.asked[..n] == c.at[..])?;
        let p = &sent.point;
        let mut why: Vec<String> = p.touched.iter().map(|t| format!("`{}`", t.output)).collect();
        why.sort();
        why.dedup();
        let mut words = Vec::new();
        if !why.is_empty() {
            words.push(format!("{} touched on the way", why.join(", ")));
        }
        if !p.saturated.is_empty() {
            words.push(format!("`{}` at the end of its range", p.saturated.join("`, `")));
        }
        if !p.usable {
            words.push(p.note.clone());
        }
        if words.is_empty() {
            let at = place(found, &c.at);
            return Some(format!("the bed reached {at} at a point, but nothing shows that the maps do"));
        }
        let reached = place(found, &p.factors[..n]);
        let so_far = if p.usable { format!("; reached: {reached}") } else { String::new() };
        Some(format!(
            "the bed was sent to {} and did not reach it: {}{so_far}",
            place(found, &c.at),
            words.join("; ")
        ))
    };
    found.cells.iter().filter(|c| c.state == CellState::Filled).filter_map(one).collect()
}

/// Neighbouring cells with optima between which free inputs go through more than half of their ranges.
fn jumps(axes: &[MapAxis], layout: &Layout, cells: &[Cell]) -> Vec<String> {
    let values: Vec<Vec<f64>> = axes.iter().map(|a| a.points.clone()).collect();
    let optimal = |k: &usize| cells[*k].state == CellState::Optimal;
    let later = |k: usize| neighbours(&values, k).into_iter().filter(move |j| *j > k).filter(optimal);
    let pairs = (0..cells.len()).filter(optimal).flat_map(|k| later(k).map(move |j| (k, j)));
    let one = |(k, j): (usize, usize)| {
        let (a, b) = (&cells[k].optimum.x, &cells[j].optimum.x);
        let free = layout.factors.iter().enumerate().skip(layout.axes);
        let words = free.filter(|(i, f)| (a[*i] - b[*i]).abs() > JUMP * (f.upper - f.lower)).map(|(i, f)| {
            let (u, v) = (significant(a[i], 4), significant(b[i], 4));
            format!("`{}` goes from {u} to {v}{}", f.name, UnitAfter(&f.unit))
        });
        let words: Vec<String> = words.collect();
        let (from, to) = (at_axes(axes, &cells[k].at), at_axes(axes, &cells[j].at));
        let words = (!words.is_empty()).then(|| words.join(", "))?;
        Some(format!(
            "between {from} and {to} {words}: the straight line between two optima is no optimum, and may be worse than either"
        ))
    };
    pairs.filter_map(one).collect()
}

/// Values of the axes in words.
fn place(found: &Mapped, at: &[f64]) -> String {
    at_axes(&found.axes, at)
}

fn at_axes(axes: &[MapAxis], at: &[f64]) -> String {
    let each = axes.iter().zip(at);
    let each: Vec<String> =
        each.map(|(a, x)| format!("{} {}{}", a.name, significant(*x, 4), UnitAfter(&a.unit))).collect();
    each.join(", ")
}

/// Deviations inside of their intervals or too small to matter, and all of them.
fn covered(found: &Mapped, verified: &[&Verified]) -> (usize, usize) {
    let all = || verified.iter().flat_map(|v| v.deviations.iter().zip(&found.models));
    let inside = all().filter(|(d, m)| {
        let away = (d.measured - d.promised).abs();
        away <= d.half_width.max(SMALL * m.spread)
    });
    (inside.count(), all().count())
}

/// What is wrong at a verification point.
fn broken(found: &Mapped, spec: &MapSpec, v: &Verified) -> String {
    let at = place(found, &v.at);
    if !v.measured {
        return format!("verification at {at}: {}", v.note);
    }
    let mut parts = Vec::new();
    for (d, r) in v.deviations.iter().zip(&found.layout.responses) {
        if let Some(passed) = d.passed.filter(|p| *p > 0.0) {
            parts.push(format!("`{}` passes its limit by {} {}", d.response, significant(passed, 3), r.unit));
        }
    }
    if let Some([promised, _, measured]) = v.objective
        && (measured - promised).abs() > spec.verify.objective * promised.abs()
    {
        let (m, p) = (significant(measured, 4), significant(promised, 4));
        parts.push(format!("what is minimised is {m} where {p} was promised"));
    }
    format!("verification at {at}: {}", parts.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::problem::CalibrationProblem;
    use dynocal_calib::steady::cell::CellOptimum;
    use dynocal_calib::steady::layout::{Factor, FactorKind};
    use dynocal_numerics::status::Status;

    /// A cam of 40 deg that goes over between two of the cells, beside one that was not reached.
    #[test]
    fn an_input_that_goes_through_most_of_its_range_is_named_with_its_cells() {
        let factor = |name: &str, lower: f64, upper: f64, kind: FactorKind| Factor {
            name: name.into(),
            unit: if name == "cam" { "deg".into() } else { String::new() },
            lower,
            upper,
            kind,
        };
        let axis = |name: &str, points: &[f64]| MapAxis {
            name: name.into(),
            unit: "Nm".into(),
            points: points.to_vec(),
        };
        let layout = |axes: usize| Layout {
            problem: CalibrationProblem::thesis(),
            loops: Vec::new(),
            factors: (0..axes)
                .map(|k| factor("y", 0.0, 9.0, FactorKind::Given(k)))
                .chain([factor("cam", 215.0, 255.0, FactorKind::Free(0))])
                .collect(),
            axes,
            held: std::collections::BTreeMap::new(),
            responses: Vec::new(),
            sample_time_s: 0.1,
        };
        let cell = |at: Vec<f64>, cam: f64, state: CellState| {
            let x: Vec<f64> = at.iter().copied().chain([cam]).collect();
            let optimum = CellOptimum {
                x,
                responses: Vec::new(),
                deviations: Vec::new(),
                objective: 1.0,
                objective_deviation: 0.0,
                feasible: true,
                status: Status::Converged,
                prices: Vec::new(),
            };
            Cell { at, state, optimum, best: 1.0 }
        };
        use CellState::{Filled, Optimal};
        let row = [(215.0, Optimal), (230.0, Optimal), (252.0, Optimal), (215.0, Filled)];
        let cells: Vec<Cell> = (0..4).map(|k| cell(vec![k as f64], row[k].0, row[k].1)).collect();
        let found = jumps(&[axis("y", &[0.0, 1.0, 2.0, 3.0])], &layout(1), &cells);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0].starts_with("between y 1.000 Nm and y 2.000 Nm `cam` goes from 230.0 to 252.0 deg:"),
            "{found:?}"
        );
        // Of four cells in a square those that share a side are neighbours, and no others.
        let square = |cams: [f64; 4]| -> Vec<Cell> {
            (0..4).map(|k| cell(vec![(k / 2) as f64, (k % 2) as f64], cams[k], Optimal)).collect()
        };
        let axes = [axis("y", &[0.0, 1.0]), axis("z", &[0.0, 1.0])];
        let count = |cams| jumps(&axes, &layout(2), &square(cams)).len();
        assert_eq!((count([215.0; 4]), count([215.0, 255.0, 215.0, 255.0])), (0, 2));
        assert_eq!((count([215.0, 235.0, 215.0, 235.0]), count([255.0, 215.0, 215.0, 255.0])), (0, 4));
    }
}
