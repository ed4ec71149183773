//! What the records say before any fit.

use crate::identify::before::{Approximation, Before, PairRow};
use crate::identify::result::Identified;
use dynocal_report::{Axis, Block, Column, HeatMap, Section, Table, XyPlot};

/// Most pairs of inputs that are drawn.
const PAIRS: usize = 6;

/// The section; none where nothing was checked.
pub(super) fn section(found: &Identified) -> Option<Section> {
    let b = found.before.as_ref()?;
    let mut section = Section::new("Excitation").text(
        "What the estimation records can tell, before any fit. Order of persistence: so many lags of an input can be told \
         apart. Coverage: share of the cells of an input's range (of the cells that two inputs reach one by one) that \
         are visited (together). Correlation: inputs that move together cannot be told apart.",
    );
    if !b.warnings.is_empty() {
        section = section.text(b.warnings.join("\n"));
    }
    section.push(inputs(b));
    if !b.pairs.is_empty() {
        section.push(pairs(b));
        let maps: Vec<Block> = b.pairs.iter().take(PAIRS).filter_map(|p| map(b, p)).collect();
        for two in maps.chunks(2) {
            section = section.columns(two.to_vec());
        }
    }
    if !b.rises.is_empty() {
        section.push(rises(b));
        let mut told: Vec<&str> = b.rises.iter().map(|r| r.verdict.as_str()).collect();
        told.dedup();
        section = section.text(told.join("\n"));
    }
    for a in &b.approximations {
        section = section.columns(vec![gain(a).into(), distortion(a).into()]);
    }
    Some(section)
}

fn inputs(b: &Before) -> Table {
    let mut table = Table::new(vec![
        Column::text("Input"),
        Column::text("Unit"),
        Column::number("From", "").digits(4),
        Column::number("To", "").digits(4),
        Column::number("Coverage", "%").digits(3),
        Column::text("Order of persistence"),
    ]);
    for i in &b.inputs {
        let order = if i.order >= i.tested { format!("{} or more", i.order) } else { i.order.to_string() };
        table = table.row([
            i.input.as_str().into(),
            i.unit.as_str().into(),
            i.minimum.into(),
            i.maximum.into(),
            i.occupied_percent.into(),
            order.into(),
        ]);
    }
    table
}

fn pairs(b: &Before) -> Table {
    let mut table = Table::new(vec![
        Column::text("Inputs"),
        Column::number("Correlation", "-").digits(3),
        Column::number("Largest", "-").digits(3),
        Column::number("At lag", "samples"),
        Column::number("Bound if independent", "-").digits(3),
        Column::number("Coverage", "%").digits(3),
    ]);
    for p in &b.pairs {
        table = table.row([
            format!("{}, {}", p.a, p.b).into(),
            p.correlation.into(),
            p.largest.into(),
            p.lag.map(|l| l.to_string()).into(),
            p.bound.into(),
            p.occupied_percent.into(),
        ]);
    }
    table
}

/// Visits of the cells of two inputs.
fn map(b: &Before, p: &PairRow) -> Option<Block> {
    let cells = p.counts.len().isqrt();
    if cells == 0 || cells * cells != p.counts.len() {
        return None;
    }
    let row = |name: &str| b.inputs.iter().find(|i| i.input == name);
    let (a, c) = (row(&p.a)?, row(&p.b)?);
    let centres = |lo: f64, hi: f64| -> Vec<f64> {
        (0..cells).map(|k| lo + (hi - lo) * (k as f64 + 0.5) / cells as f64).collect()
    };
    // Rows of the map are the second input.
    let at = |k: usize| p.counts[k % cells * cells + k / cells] as f64;
    let values: Vec<f64> = (0..cells * cells).map(at).collect();
    let map = HeatMap::new(
        format!("Samples by {} and {}", p.a, p.b),
        (Axis::new(p.a.as_str(), a.unit.as_str()), centres(a.minimum, a.maximum)),
        (Axis::new(p.b.as_str(), c.unit.as_str()), centres(c.minimum, c.maximum)),
        (Axis::new("samples", "-"), values),
    );
    Some(map.into())
}

fn rises(b: &Before) -> Table {
    let mut table = Table::new(vec![
        Column::text("From"),
        Column::text("To"),
        Column::number("Rise time", "s").digits(3),
        Column::number("Samples in it", "-").digits(3),
    ])
    .caption(format!("Sample time {} s: 4 to 6 samples in the rise time are wanted", b.sample_time_s));
    for r in &b.rises {
        table =
            table.row([r.input.as_str().into(), r.output.as_str().into(), r.rise_s.into(), r.samples.into()]);
    }
    table
}

fn gain(a: &Approximation) -> XyPlot {
    let title = format!("Best linear approximation, {} to {}", a.input, a.output);
    XyPlot::new(title, Axis::new("Frequency", "Hz"), Axis::new("Gain", "dB"))
        .line("gain", a.frequency_hz.clone(), a.gain_db.clone())
        .points("deviation, noise and distortion", a.frequency_hz.clone(), a.total_db.clone())
        .points("deviation, noise", a.frequency_hz.clone(), a.noise_db.clone())
}

fn distortion(a: &Approximation) -> XyPlot {
    let mut plot = XyPlot::new(
        format!("Output at excited and other lines, {}", a.output),
        Axis::new("Frequency", "Hz"),
        Axis::new("Amplitude", "dB"),
    );
    for (name, points) in [("excited", &a.excited), ("even lines", &a.even), ("odd lines", &a.odd)] {
        if !points.is_empty() {
            let (f, v): (Vec<f64>, Vec<f64>) = points.iter().map(|l| (l.frequency_hz, l.level_db)).unzip();
            plot = plot.points(name, f, v);
        }
    }
    plot
}
