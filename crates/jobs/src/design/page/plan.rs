//! The plan over time, its predicted outputs with bands and limits, and what of the inputs it covers.

use crate::design::Job;
use crate::design::margins::{MarginBasis, MarginUsed};
use crate::design::result::{Curves, Designed, OutputCurve, Outside};
use dynocal_ident::data::UnitAfter;
use dynocal_numerics::interval::Interval;
use dynocal_report::{Axis, Cell, Column, Panel, Section, Table, TimePlot, XyPlot};

/// Most samples that are drawn: a page must stay light.
const DRAWN: usize = 4000;

fn column(found: &Designed, curves: &Curves, i: usize, n: usize) -> Vec<f64> {
    curves.u.iter().skip(i).step_by(found.channels.len()).take(n).copied().collect()
}

/// Channels and predicted outputs over time.
pub(super) fn section(job: &Job, found: &Designed, curves: &Curves) -> Section {
    let n = found.samples.min(DRAWN);
    let mut inputs = TimePlot::sampled("Plan", found.sample_time_s, n);
    for (i, (q, c)) in found.channels.iter().zip(&job.channels).enumerate() {
        let mut panel = Panel::new(&q.name, &q.unit).held(&q.name, column(found, curves, i, n));
        if c.file.is_none() {
            panel = panel.level("lower limit", c.channel.lower).level("upper limit", c.channel.upper);
        }
        inputs = inputs.panel(panel);
    }
    if n < found.samples {
        inputs =
            inputs.caption(format!("The first {n} of {} samples; all are in design.csv.", found.samples));
    }
    let mut outputs = TimePlot::sampled("Predicted outputs", found.sample_time_s, n)
        .caption("Filled: the band that the output stays in at the stated rate. Dashed: the limits.");
    for (line, OutputCurve { predicted: y, half_width: half }) in found.safety.iter().zip(&curves.outputs) {
        let side = |sign: f64| -> Vec<f64> { y[..n].iter().zip(half).map(|(y, h)| y + sign * h).collect() };
        let mut panel = Panel::new(&line.output.name, &line.output.unit);
        if let Some(Interval { lower, upper }) = line.limits {
            let label = match line.margin.map(|m| (m.basis, m.rate)) {
                Some((MarginBasis::Quantile | MarginBasis::FewBlocks, rate)) => {
                    format!("band, {} % of blocks", dynocal_report::significant(100.0 * (1.0 - rate), 3))
                }
                Some((MarginBasis::Given, _)) => "margin as given".into(),
                _ => "margin, a share of the range".into(),
            };
            panel = panel.band(label, side(-1.0), side(1.0));
            panel = panel.level("lower limit", lower).level("upper limit", upper);
        }
        outputs = outputs.panel(panel.simulated(&y[..n]));
    }
    Section::new("Plan").block(inputs).block(outputs)
}

/// The safety table, and what the margins stand on.
pub(super) fn safety(found: &Designed) -> Section {
    let mut table = Table::new(vec![
        Column::text("Output"),
        Column::number("Predicted", "from").digits(4),
        Column::number("", "to").digits(4),
        Column::number("Limits", "from").digits(4),
        Column::number("", "to").digits(4),
        Column::number("Prediction to limit", "").digits(4),
        Column::number("Band to limit", "").digits(4),
        Column::number("Worst at", "s").digits(4),
    ]);
    for s in &found.safety {
        table = table.row(vec![
            format!("{} [{}]", s.output.name, s.output.unit).into(),
            s.predicted.lower.into(),
            s.predicted.upper.into(),
            Cell::from(s.limits.map(|l| l.lower)),
            Cell::from(s.limits.map(|l| l.upper)),
            Cell::from(s.least_distance.map(|d| d.distance)),
            Cell::from(s.least_distance_of_band.map(|d| d.distance)),
            Cell::from(s.least_distance_of_band.map(|d| d.at_s)),
        ]);
    }
    let mut section = Section::new("Safety").block(table);
    for s in &found.safety {
        let margin =
            s.margin.map(|m| format!("Margin of {}: {}.", s.output.name, margin(&m, &s.output.unit)));
        let outside = s.outside.map(|Outside { worst, share }| {
            format!(
                " {:.1} % of the plan lie outside of what its model was identified on, at most {worst:.2} of the boundary.",
                100.0 * share
            )
        });
        if let Some(text) = margin.map(|m| m + &outside.unwrap_or_default()) {
            section = section.text(text);
        }
    }
    section.text(
        "The band is the margin about the prediction; it grows with the square of the distance to what was identified. \
         Distances are to the nearer limit, negative where it is passed. On the bed a supervisor should still watch the \
         measured outputs.",
    )
}

fn margin(m: &MarginUsed, unit: &str) -> String {
    let unit = UnitAfter(unit);
    let why = match m.basis {
        MarginBasis::Given => "given".to_string(),
        MarginBasis::Range => "a share of the range, no held-out data".to_string(),
        MarginBasis::FewBlocks => format!("{} held-out blocks, too few for a quantile", m.blocks),
        MarginBasis::Quantile => format!("quantile of {} held-out blocks of {} samples", m.blocks, m.block),
    };
    let kept = if m.kept > m.value { format!(", searched with {:.4}", m.kept) } else { String::new() };
    match m.basis {
        MarginBasis::Given => format!("{:.4}{unit} ({why}{kept})", m.value),
        _ => format!("{:.4}{unit} at a rate of {} ({why}{kept})", m.value, m.rate),
    }
}

/// Coverage, correlation, and the plane of every pair of channels with its regions.
pub(super) fn coverage(job: &Job, found: &Designed, curves: &Curves) -> Section {
    let mut table = Table::new(vec![
        Column::text("Channel"),
        Column::text("Unit"),
        Column::number("Least", ""),
        Column::number("Greatest", ""),
        Column::number("Cells of the range visited", "%").digits(3),
    ]);
    for c in &found.coverage {
        let unit = found.channels.iter().find(|q| q.name == c.input).map_or("", |q| q.unit.as_str());
        table = table.row(vec![
            c.input.as_str().into(),
            unit.into(),
            c.minimum.into(),
            c.maximum.into(),
            (100.0 * c.occupied).into(),
        ]);
    }
    let mut pairs = Table::new(vec![
        Column::text("Channels"),
        Column::number("Correlation (2.45)", "").digits(2),
        Column::number("95 % bound", "").digits(2),
        Column::number("Largest at any lag", "").digits(2),
        Column::number("Lag", "samples").digits(2),
        Column::number("Cells of both visited", "%").digits(3),
    ]);
    for p in &found.pairs {
        let c = found.correlations.iter().find(|c| c.a == p.a && c.b == p.b);
        pairs = pairs.row(vec![
            format!("{}, {}", p.a, p.b).into(),
            Cell::from(c.map(|c| c.r)),
            Cell::from(c.map(|c| c.bound)),
            Cell::from(c.map(|c| c.r_max)),
            Cell::from(c.map(|c| c.lag as f64)),
            (100.0 * p.occupied).into(),
        ]);
    }
    let mut section = Section::new("Inputs").block(table);
    if !found.pairs.is_empty() {
        section = section.block(pairs);
    }
    let n = found.samples.min(DRAWN);
    for b in 1..found.channels.len() {
        for a in 0..b {
            let axis = |i: usize| Axis::new(&found.channels[i].name, &found.channels[i].unit);
            let mut plot = XyPlot::new(
                format!("{} and {}", found.channels[a].name, found.channels[b].name),
                axis(a),
                axis(b),
            )
            .points("samples", column(found, curves, a, n), column(found, curves, b, n));
            for (name, x, y) in outlines(job, &found.channels[a].name, &found.channels[b].name) {
                plot = plot.line(name, x, y);
            }
            section = section.block(plot);
        }
    }
    section
}

/// Closed outlines of the polygons in the plane of two channels.
fn outlines(job: &Job, a: &str, b: &str) -> Vec<(String, Vec<f64>, Vec<f64>)> {
    let regions = job.channels.iter().flat_map(|c| &c.channel.regions);
    regions
        .filter_map(|r| {
            let channels = r.channels();
            let swapped = channels == [b, a];
            if r.corners().is_empty() || !(swapped || channels == [a, b]) {
                return None;
            }
            let closed = || r.corners().iter().chain(r.corners().first());
            let (first, second) = if swapped { (1, 0) } else { (0, 1) };
            Some((
                r.name().to_string(),
                closed().map(|c| c[first]).collect(),
                closed().map(|c| c[second]).collect(),
            ))
        })
        .collect()
}
