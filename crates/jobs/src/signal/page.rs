//! The page of test signals: every channel over time, in frequency and in amplitude, and how pairs go together.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_ident::excitation::coverage::PAIR_CELLS;
use dynocal_ident::signal::analysis::Analysis;
use dynocal_report::{
    Axis, Bars, Cell, Column, HeatMap, KeyValue, Panel, Report, Section, Table, TimePlot, XyPlot, render,
};

use super::result::Made;
use super::spec::Job;
use crate::page::PageError;

/// Most samples that are drawn, and most lines of the spectrum: a page must stay light.
const DRAWN: usize = 5000;
/// Points of a pair that are drawn.
const PAIRS_DRAWN: usize = 4000;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(job: &Job, made: &Made, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(job, made))?.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(job: &Job, made: &Made) -> Report {
    let many = if job.channels.len() > 1 { "s" } else { "" };
    let mut report = Report::new(format!("Test signal{many}: {}", job.name))
        .fact("Sample time", format!("{} s", job.sample_time_s))
        .fact("Seed", job.seed.to_string());
    for warning in &made.warnings {
        report = report.warning(warning.as_str());
    }
    if !made.pairs.is_empty() {
        report = report.section(together(job, made));
    }
    for ((w, u), a) in job.channels.iter().zip(&made.columns).zip(&made.analyses) {
        let section = Section::new(format!("{} ({})", w.name, w.signal));
        report = report.section(
            analysed(section, (&w.name, &w.unit), job.sample_time_s, u, a).code("Keys", w.keys.to_string()),
        );
    }
    report
}

/// Correlation and coverage of pairs.
fn together(job: &Job, made: &Made) -> Section {
    let mut table = Table::new(vec![
        Column::text("Channels"),
        Column::number("Correlation (2.45)", "").digits(3),
        Column::number("95 % bound", "").digits(3),
        Column::number("Largest at any lag", "").digits(3),
        Column::number("Lag", "s").digits(3),
        Column::number("Cells visited", "%").digits(3),
    ]);
    for p in &made.pairs {
        let c = made.correlations.iter().find(|c| c.a == p.a && c.b == p.b);
        table = table.row(vec![
            format!("{}, {}", p.a, p.b).into(),
            Cell::from(c.map(|c| c.r)),
            Cell::from(c.map(|c| c.bound)),
            Cell::from(c.map(|c| c.r_max)),
            Cell::from(c.map(|c| c.lag as f64 * job.sample_time_s)),
            (100.0 * p.occupied).into(),
        ]);
    }
    let mut section = Section::new("Channels together")
        .text(
            "Independent channels stay within the bound, which takes their own autocorrelation (thesis eq. 2.46) into \
             account. Cells: of a grid of ten by ten between least and greatest values.",
        )
        .block(table);
    let find = |name: &str| job.channels.iter().position(|c| c.name == name).unwrap_or(0);
    for p in &made.pairs {
        let (a, b) = (find(&p.a), find(&p.b));
        let axis = |i: usize| Axis::new(&job.channels[i].name, &job.channels[i].unit);
        let drawn = |i: usize| made.columns[i][..made.columns[i].len().min(PAIRS_DRAWN)].to_vec();
        let points = XyPlot::new(format!("{} and {}: samples", p.a, p.b), axis(a), axis(b)).points(
            "samples",
            drawn(a),
            drawn(b),
        );
        let moves = |i: usize| made.analyses[i].maximum > made.analyses[i].minimum;
        if !(moves(a) && moves(b)) {
            section = section.block(points);
            continue;
        }
        let middles = |i: usize| -> Vec<f64> {
            let (lo, hi) = (made.analyses[i].minimum, made.analyses[i].maximum);
            (0..PAIR_CELLS).map(|k| lo + (k as f64 + 0.5) / PAIR_CELLS as f64 * (hi - lo)).collect()
        };
        // Counts come row by row of `a`, the map takes them row by row of its vertical axis.
        let counts = (0..PAIR_CELLS * PAIR_CELLS)
            .map(|k| p.counts[(k % PAIR_CELLS) * PAIR_CELLS + k / PAIR_CELLS] as f64)
            .collect();
        let map = HeatMap::new(
            format!("{} and {}: coverage", p.a, p.b),
            (axis(a), middles(a)),
            (axis(b), middles(b)),
            (Axis::new("samples per cell", ""), counts),
        );
        section = section.columns(vec![points.into(), map.into()]);
    }
    section
}

/// Powers in dB, those that rounding leaves where there are none cut off.
fn decibels(density: &[f64]) -> Vec<f64> {
    let largest = density.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    density.iter().map(|d| 10.0 * d.max(FLOOR * largest).log10()).collect()
}

/// Least power that is drawn, as a share of the largest.
const FLOOR: f64 = 1e-12;

/// Numbers of a channel in `unit`: name, value, unit.
pub fn numbers<'a>(unit: &'a str, a: &Analysis) -> Vec<(&'static str, Option<f64>, &'a str)> {
    vec![
        ("Samples", Some(a.samples as f64), "-"),
        ("Mean", Some(a.mean), unit),
        ("Standard deviation", Some(a.standard_deviation), unit),
        ("Least value", Some(a.minimum), unit),
        ("Greatest value", Some(a.maximum), unit),
        ("Largest step", Some(a.largest_step), unit),
        ("Crest factor", a.crest_factor, "-"),
        ("Coverage of the range", Some(100.0 * a.coverage), "%"),
    ]
}

/// Adds numbers, time, autocorrelation, spectrum and amplitudes of one channel (name and unit) to its section.
fn analysed(section: Section, (name, unit): (&str, &str), dt_s: f64, u: &[f64], a: &Analysis) -> Section {
    let facts = numbers(unit, a)
        .into_iter()
        .map(|(name, value, unit)| KeyValue::new(name, Cell::from(value), unit))
        .collect();
    let drawn = &u[..u.len().min(DRAWN)];
    let caption = if drawn.len() < u.len() {
        format!(
            "The first {} of {} samples; all are in signal.{}.",
            drawn.len(),
            u.len(),
            crate::kept::ending(u.len())
        )
    } else {
        String::new()
    };
    let time = TimePlot::sampled("Signal", dt_s, drawn.len())
        .panel(Panel::new(name, unit).held(name, drawn))
        .caption(caption);
    let mut section = section.key_values(facts).block(time);
    if let Some(r) = &a.autocorrelation {
        let lag_s: Vec<f64> = r.lags.iter().map(|l| *l as f64 * dt_s).collect();
        section = section.block(
            XyPlot::new("Autocorrelation", Axis::new("lag", "s"), Axis::new("correlation", "-"))
                .line("autocorrelation", lag_s, r.values.clone())
                .caption(format!("95 % bound of white noise: {:.3}", r.bound)),
        );
    }
    let s = &a.spectrum;
    let lines = s.density.len().min(DRAWN);
    section
        .block(
            XyPlot::new(
                "Power spectral density",
                Axis::new("frequency", "Hz"),
                Axis::new("density", format!("dB over 1 ({unit})^2/Hz")),
            )
            .line("density", &s.frequency_hz[..lines], decibels(&s.density[..lines]))
            .caption(format!("One-sided, about the mean; mean of {} segments", s.segments)),
        )
        .block(
            Bars::new(
                "Amplitude density",
                Axis::new("share per unit", format!("1/({unit})")),
                a.amplitudes.middle.iter().map(|m| dynocal_report::significant(*m, 4)),
            )
            .series("density", a.amplitudes.density.clone()),
        )
}
