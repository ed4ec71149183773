//! The work: read logs and tune, fit, judge, and say it.

use dynocal_export::ExportError;
use dynocal_export::tune::ini::Definition;
use dynocal_export::tune::msq::Tune;
use dynocal_export::tune::table::TuneTable;
use dynocal_files::FilesError;
use dynocal_label::label::Label;
use dynocal_label::linear::{NEIGHBOURS, Verdict};
use dynocal_label::ve::judge::{Decision, NEEDED, Reason};
use dynocal_label::ve::sensor::MOST_S;
use dynocal_label::ve::table::steep;
use dynocal_label::ve::{Found, Log, run};
use dynocal_numerics::watch::Watch;

use super::channels;
use super::result::{LabelJobError, Labelled};
use super::spec::Job;

/// Share of samples at which the logged table value must be that of the tune.
const SAME_TUNE: f64 = 0.95;
/// Share of the samples outside of the table that is said.
const OUTSIDE: f64 = 0.05;
/// Share of them from which a log says of the edges only and is refused.
const MOST_OUTSIDE: f64 = 0.9;
/// Drift of unseen samples that is said, as a share of lambda.
const DRIFT: f64 = 0.02;

/// Fits and judges in memory.
///
/// # Errors
/// [`LabelJobError`]: files, channels, options, a fit that is not possible, an interruption.
pub fn fit(job: &Job, watch: Watch) -> Result<Labelled, LabelJobError> {
    check(job)?;
    let definition = definition(job)?;
    let mut notes = Vec::new();
    let (mut logs, tune) = read(job, &mut notes, watch)?;
    let (label, held) = channels::table(&tune, definition.as_ref())?;
    let mut warnings = same_tune(&label, &logs);
    warnings.extend(outside(&label, &logs)?);
    if held.is_none() {
        warnings.push(format!(
            "no definition of the ECU (--ini): `{}` is written in steps of {} {} as the tune shows it, and its greatest value is not checked",
            label.name,
            label.step.unwrap_or(0.0),
            label.unit
        ));
    }
    warnings.extend(beyond(&label, held.as_ref()));
    targets(job, &tune, definition.as_ref(), &mut logs, &mut warnings)?;
    let found = run(&label, &logs, &job.keys, &|text| watch.note(text))?;
    if watch.interrupted() {
        return Err(LabelJobError::Interrupted);
    }
    warnings.extend(said(&found, &logs));
    warnings.extend(doubted(&label, &found));
    warnings.extend(notes);
    let change = found.judgement.decision == Decision::Change;
    let values = if change { found.table.values.clone() } else { label.base.clone() };
    let handed = if change { hand_over(&tune, &label, &values, held.as_ref())? } else { Vec::new() };
    Ok(Labelled {
        verb: "label",
        name: job.name.clone(),
        valid: found.judgement.decision != Decision::Refuse,
        verdict: verdict(&label, &found, job.keys.fit.extrapolate),
        warnings,
        half_width: found.table.half_width.iter().map(|h| h.is_finite().then_some(*h)).collect(),
        values,
        logs: logs.iter().map(|l| l.name.clone()).collect(),
        files: Vec::new(),
        label,
        found,
        handed,
    })
}

fn definition(job: &Job) -> Result<Option<Definition>, LabelJobError> {
    let Some(path) = &job.definition else { return Ok(None) };
    let bytes = std::fs::read(path).map_err(|e| FilesError::unread(path, &e))?;
    let found = Definition::parse(&bytes, &[]);
    if found.labels.is_empty() {
        return Err(LabelJobError::Option {
            option: "--ini",
            found: format!("{} without any label in [Constants]", path.display()),
            expected: "the definition of an ECU (.ini)",
        });
    }
    Ok(Some(found))
}

/// Logs, and the tune that is given or that the first of them carries. A log that comes twice counts once.
fn read(job: &Job, notes: &mut Vec<String>, watch: Watch) -> Result<(Vec<Log>, Tune), LabelJobError> {
    let mut tune = job.tune.as_ref().map(|path| Tune::read(path)).transpose()?;
    let mut logs: Vec<Log> = Vec::new();
    for path in &job.logs {
        watch.note(&format!("reading {}", path.display()));
        let (log, carried) = channels::log(path, tune.as_ref(), notes)?;
        let no_tune = || LabelJobError::NoTune { file: path.display().to_string() };
        if tune.is_none() {
            tune = Some(carried.ok_or_else(no_tune)?);
        }
        match logs.iter().find(|l| l.time_s == log.time_s && l.lambda == log.lambda) {
            Some(same) => {
                notes.push(format!("{}: the same records as {}: they count once", log.name, same.name))
            }
            None => logs.push(log),
        }
        if watch.interrupted() {
            return Err(LabelJobError::Interrupted);
        }
    }
    let none = || LabelJobError::NoTune { file: "-".into() };
    Ok((logs, tune.ok_or_else(none)?))
}

fn check(job: &Job) -> Result<(), LabelJobError> {
    let fail = |option, found: f64, expected| {
        Err(LabelJobError::Option { option, found: found.to_string(), expected })
    };
    if !(0.2..=0.9).contains(&job.keys.train) {
        return fail("--train", job.keys.train, "a share from 0.2 to 0.9");
    }
    let warm = job.keys.mask.least_coolant_c;
    if !(-100.0..=300.0).contains(&warm) {
        return fail("--least-coolant", warm, "a temperature in degC from -100 to 300");
    }
    match job.target_lambda {
        Some(l) if !(0.5..=1.5).contains(&l) => fail("--target", l, "a lambda from 0.5 to 1.5"),
        _ => Ok(()),
    }?;
    match job.keys.fit.smooth {
        Some(s) if !(0.0..=1e6).contains(&s) => fail("--smooth", s, "a number from 0 to 1e6"),
        _ => Ok(()),
    }
}

/// Values of the table as it was that the ECU cannot hold: they are left as they are where nothing changes them.
fn beyond(label: &Label, held: Option<&dynocal_export::tune::ini::Held>) -> Option<String> {
    let held = held?;
    let cells: Vec<(usize, String)> =
        (0..label.len()).filter_map(|k| held.check(label.base[k]).err().map(|why| (k, why))).collect();
    let (first, why) = cells.first()?;
    Some(format!(
        "`{}` has {} values that the ECU cannot hold, the first at {}: {why}",
        label.name,
        cells.len(),
        place(label, *first)
    ))
}

/// Where a cell lies, in words.
fn place(label: &Label, cell: usize) -> String {
    let nx = label.axes[0].points.len();
    let of = |k: usize, i: usize| format!("{} {}", label.axes[k].points[i], label.axes[k].unit);
    format!("{} / {}", of(0, cell % nx), of(1, cell / nx))
}

/// Whether the logs were driven with the table that is fitted.
fn same_tune(label: &Label, logs: &[Log]) -> Vec<String> {
    let mut out = Vec::new();
    for log in logs {
        let (mut same, mut all) = (0usize, 0usize);
        for k in (0..log.time_s.len()).filter(|k| log.ve[*k] > 0.0 && log.speed_rpm[*k] > 0.0) {
            all += 1;
            // The ECU cuts its look-up to a whole step.
            let step = label.step.unwrap_or(0.0);
            let tune = label.value(&label.base, &[log.speed_rpm[k], log.load[k]]);
            same += usize::from((log.ve[k] - tune).abs() <= 1.5 * step.max(1e-6 * tune.abs()));
        }
        let share = same as f64 / all.max(1) as f64;
        if all > 0 && share < SAME_TUNE {
            out.push(format!(
                "{}: the logged table value is that of the tune at {:.0} % of the samples only: cells were edited while driving, or the tune is not the one that was in the ECU; each sample counts with the value that was in use",
                log.name,
                100.0 * share
            ));
        }
    }
    out
}

/// Logs that leave the axes of the table: there the ECU takes its edge, and so does the fit. One that is hardly ever within them says
/// nothing of the cells, and is refused.
fn outside(label: &Label, logs: &[Log]) -> Result<Vec<String>, LabelJobError> {
    let ends = |k: usize| {
        let p = &label.axes[k].points;
        [p[0], p[p.len() - 1]]
    };
    let axes = [ends(0), ends(1)];
    let mut said = Vec::new();
    for log in logs {
        let known =
            |k: &usize| log.pulse_ms[*k] > 0.0 && log.speed_rpm[*k].is_finite() && log.load[*k].is_finite();
        let driven: Vec<usize> = (0..log.time_s.len()).filter(known).collect();
        let beyond = |v: f64, [from, to]: [f64; 2]| v < from || v > to;
        let out = |k: &&usize| beyond(log.speed_rpm[**k], axes[0]) || beyond(log.load[**k], axes[1]);
        let share = driven.iter().filter(out).count() as f64 / driven.len().max(1) as f64;
        if share > MOST_OUTSIDE {
            let range = |v: &[f64]| {
                let all = || driven.iter().map(|k| v[*k]);
                [all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max)]
            };
            return Err(LabelJobError::Outside {
                file: log.name.clone(),
                outside: 100.0 * share,
                most: 100.0 * MOST_OUTSIDE,
                samples: driven.len(),
                table: label.name.clone(),
                speed_rpm: range(&log.speed_rpm),
                load: range(&log.load),
                axes,
            });
        }
        if share > OUTSIDE {
            said.push(format!(
                "{}: {:.0} % of the samples lie outside of the axes of `{}`, where the ECU takes its edge: cells there are a mean of all that is beyond",
                log.name,
                100.0 * share,
                label.name
            ));
        }
    }
    Ok(said)
}

fn targets(
    job: &Job,
    tune: &Tune,
    definition: Option<&Definition>,
    logs: &mut [Log],
    warnings: &mut Vec<String>,
) -> Result<(), LabelJobError> {
    if let Some(lambda) = job.target_lambda {
        logs.iter_mut().for_each(|l| l.target.fill(lambda));
        return Ok(());
    }
    let Some(table) = channels::target(tune, definition) else {
        warnings.push(
            "the tune has no target table: the table is fitted to lambda 1 everywhere (--target)".into(),
        );
        return Ok(());
    };
    for log in logs {
        for k in 0..log.time_s.len() {
            log.target[k] = table.value(&table.base, &[log.speed_rpm[k], log.load[k]]);
        }
    }
    Ok(())
}

/// The tune with the table in it, and the table alone.
fn hand_over(
    tune: &Tune,
    label: &Label,
    values: &[f64],
    held: Option<&dynocal_export::tune::ini::Held>,
) -> Result<Vec<(String, Vec<u8>)>, ExportError> {
    let changed = tune.with(&label.name, values, held)?;
    let table = TuneTable {
        x_name: label.axes[0].name.clone(),
        x: label.axes[0].points.clone(),
        y_name: label.axes[1].name.clone(),
        y: label.axes[1].points.clone(),
        z: values.to_vec(),
    };
    let digits = tune.constant(&label.name)?.digits;
    Ok(vec![
        ("tune.msq".into(), changed.bytes().to_vec()),
        (format!("{}.table", label.name), table.text(digits).into_bytes()),
    ])
}

/// The decision and its reason, in words.
fn decided(label: &Label, found: &Found) -> String {
    let (j, name) = (&found.judgement, &label.name);
    let percent = |v: f64| format!("{:.1} %", 100.0 * v);
    let leave = |why: String| format!("Leave `{name}` as it is: {why} No file is written.");
    let counts = format!("({:.1} standard errors, {:.1} would count)", j.improvement, j.needed);
    match j.reason {
        Reason::Better => format!(
            "Take the new `{name}`: it explains unseen samples better (the gain is {:.1} times its standard error). What is written was fitted to all samples; what was judged, to the first part of them.",
            j.improvement
        ),
        Reason::Noise => leave(
            "the samples that were fitted do not show that it is wrong (a true table would be improved as much by fitting its noise).".into(),
        ),
        Reason::NoDifference => leave(format!(
            "on unseen samples no difference between the fitted table and the present one can be shown {counts}."
        )),
        Reason::TooFew => leave(format!(
            "nothing can be said of a new one: the {} later samples in cells that were fitted are worth {:.1} independent measurements, {NEEDED:.0} are needed (a longer log, or a smaller --train).",
            j.samples, j.facts
        )),
        Reason::NearestIsBetter => leave(format!(
            "the mean of the nearest cell explains unseen samples better ({} left) than the fitted table ({}): what the fit takes for the engine, the sensor or the enrichments is not what they did.",
            percent(j.rms_nearest),
            percent(j.rms_after)
        )),
        Reason::OnBound => leave(format!(
            "the {} of the lambda sensor lies on the bound of its search ({MOST_S} s), so that something else was found in its place.",
            found.sensor.on_bound().unwrap_or("delay")
        )),
        Reason::Worse => format!(
            "The fitted `{name}` is refused: it explains unseen samples worse than the present one {counts}. No file is written."
        ),
        Reason::NoEngine => format!(
            "The fitted `{name}` is refused: measured lambda leaves the expected one by {} even with it, with which no engine runs. Is each channel the quantity and in the unit that it is taken for? No file is written.",
            percent(j.rms_after)
        ),
    }
}

fn verdict(label: &Label, found: &Found, extrapolated: bool) -> Vec<String> {
    let j = &found.judgement;
    let percent = |v: f64| format!("{:.1} %", 100.0 * v);
    let numbers = format!(
        "On {} later samples that it was not fitted to (worth {:.0} independent measurements), measured lambda leaves the expected one by {} (root mean square) with the table as it was, by {} with the mean of the nearest cell, and by {} with the fitted table.",
        j.samples,
        j.facts,
        percent(j.rms_before),
        percent(j.rms_nearest),
        percent(j.rms_after)
    );
    let numbers = match j.samples {
        0 => "No later sample lies in cells of which the fitted part has one independent measurement: nothing judges.".into(),
        _ => numbers,
    };
    let count = |v: Verdict| found.table.verdicts.iter().filter(|x| **x == v).count();
    let kept = if extrapolated { "change as their neighbours do" } else { "keep their values" };
    let cells = format!(
        "Of {} cells, {} are determined by the data, {} are pulled by their neighbours (with less than one independent measurement a cell changes by no other share of its value than they do), {} are untouched (no data) and {kept}.",
        label.len(),
        count(Verdict::Determined),
        count(Verdict::Pulled),
        count(Verdict::Untouched)
    );
    let first = decided(label, found);
    let s = &found.sensor;
    let flow = match s.flow_delay_s > 0.0 {
        true => format!(
            ", and another {:.2} s at 2000 rpm and load 50 that shrinks with the flow",
            s.flow_delay_s
        ),
        false => String::new(),
    };
    let sensor = format!(
        "The lambda sensor answers after {:.2} s{flow}, with a time constant of {:.2} s; this came from the first part of the samples as well.",
        s.delay_s, s.lag_s
    );
    let steps = found.steps.map(|h| {
        let [low, middle, high] = h.quartiles_s;
        format!(
            "After a fuel cut lambda comes to half of its way back after {middle:.2} s ({} times, quartiles {low:.2} and {high:.2} s), whatever the table says; the delay and lag above make {:.2} s of it at 2000 rpm and load 50.",
            h.steps,
            s.delay_s + s.flow_delay_s + s.lag_s * std::f64::consts::LN_2
        )
    });
    [first, numbers, cells, sensor].into_iter().chain(steps).collect()
}

/// Cells of the new table that a tuner should look at, and a sensor that steps contradict.
fn doubted(label: &Label, found: &Found) -> Vec<String> {
    let mut out = Vec::new();
    let steep = steep(label, &found.table.values);
    if !steep.is_empty() {
        let named = steep.iter().take(NAMED).map(|(high, low, ratio)| {
            let v = &found.table.values;
            format!(
                "{} at {} beside {} at {} ({ratio:.2} times)",
                v[*high],
                place(label, *high),
                v[*low],
                place(label, *low)
            )
        });
        out.push(format!(
            "the new table is steeper than the one before is anywhere: {}{}; look at these cells before they are driven",
            named.collect::<Vec<_>>().join("; "),
            if steep.len() > NAMED { format!("; and {} more", steep.len() - NAMED) } else { String::new() }
        ));
    }
    let (own, mut held): (Vec<&String>, Vec<&String>) =
        found.table.held.iter().partition(|h| h.contains(NEIGHBOURS));
    if !own.is_empty() {
        out.push(format!(
            "{} cells with less than one independent measurement would go further than the cells around them, and are held at the change of these",
            own.len()
        ));
    }
    held.dedup();
    out.extend(held.into_iter().map(|h| format!("cells of the new table are held by a limit: {h}")));
    let s = &found.sensor;
    if let Some(part) = s.on_bound() {
        out.push(format!(
            "the {part} of the lambda sensor lies on the bound of the search, {MOST_S} s: it is not known"
        ));
    }
    if let Some(h) = &found.steps {
        let [low, _, high] = h.quartiles_s;
        let made = s.delay_s + s.flow_delay_s + s.lag_s * std::f64::consts::LN_2;
        // Tukey's fences.
        let fence = 1.5 * (high - low);
        if made < low - fence || made > high + fence {
            out.push(format!(
                "after fuel cuts lambda comes to half of its way back after {low:.2} to {high:.2} s (quartiles), the sensor that was found makes {made:.2} s of it: one of the two is something else"
            ));
        }
    }
    out
}

/// Pairs of cells that are named.
const NAMED: usize = 3;

fn said(found: &Found, logs: &[Log]) -> Vec<String> {
    let mut out = Vec::new();
    let [drift, error] = found.judgement.drift;
    if drift.abs() > DRIFT && drift.abs() > 3.0 * error {
        out.push(format!(
            "drift: later samples are {:.1} % {} than the fitted table says (standard error {:.1} %): the engine, its sensors or the fuel have changed during the logs, or what the table does not know (heat, fuel pressure) has",
            100.0 * drift.abs(),
            if drift > 0.0 { "leaner" } else { "richer" },
            100.0 * error
        ));
    }
    let by_log = |k: usize| {
        let own: Vec<f64> = found.residuals.iter().filter(|r| r.0 == k).map(|r| r.2).collect();
        (!own.is_empty()).then(|| own.iter().sum::<f64>() / own.len() as f64)
    };
    if logs.len() > 1 {
        let means: Vec<(usize, f64)> = (0..logs.len()).filter_map(|k| by_log(k).map(|m| (k, m))).collect();
        for (k, mean) in means.iter().filter(|(_, m)| m.abs() > DRIFT) {
            let word = if *mean > 0.0 { "leaner" } else { "richer" };
            out.push(format!(
                "{}: {:.1} % {word} than the fitted table on average: the logs do not agree",
                logs[*k].name,
                100.0 * mean.abs()
            ));
        }
    }
    if found.judgement.unknown > found.judgement.samples {
        out.push(format!(
            "{} of the later samples lie in cells of which the first part has less than one independent measurement, and are not judged: what is written there is what cells around them say",
            found.judgement.unknown
        ));
    }
    if found.table.proven == Some(false) {
        out.push("whole steps: the best that was found; the search ended before it could prove that there is none better".into());
    }
    out.extend(
        found.table.broken.iter().map(|b| format!("the table as it is breaks {b} among cells without data")),
    );
    if found.samples[1] * 5 < found.samples[0] {
        out.push(format!(
            "{} of {} samples count; the section on samples says why the others do not",
            found.samples[1], found.samples[0]
        ));
    }
    out
}
