//! What the page's script receives: the plots as compact JSON.
//!
//! Only display happens here: numbers are rounded to six digits, and records longer than [`MAX_SAMPLES`] are thinned to
//! the extremes of equal bins, so that no peak is lost; the page says so below the plot.

use serde::Serialize;

use crate::numbers::{Compact, CompactNumber, PLOT_DIGITS};
use crate::plots::{Axis, Bars, ColourScale, HeatMap, Panel, Role, TimePlot, XyPlot};

/// Longest record that is kept whole.
pub(crate) const MAX_SAMPLES: usize = 20_000;

/// Digits of time stamps: 1 ms in 10 days.
const TIME_DIGITS: usize = 10;

#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub(crate) enum PlotView<'a> {
    Time {
        id: String,
        x: &'a Axis,
        t: TimeView<'a>,
        panels: Vec<PanelView<'a>>,
        marks: Vec<MarkView<'a>>,
    },
    Xy {
        id: String,
        x: &'a Axis,
        y: &'a Axis,
        series: Vec<XyView<'a>>,
        equal: bool,
    },
    Heat(HeatView<'a>),
    Bars {
        id: String,
        value: &'a Axis,
        categories: &'a [String],
        series: Vec<BarView<'a>>,
        levels: Vec<MarkView<'a>>,
    },
}

/// Uniform stamps need three numbers only.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum TimeView<'a> {
    Uniform { start: f64, step: f64, n: usize },
    Listed(Owned<'a>),
}

#[derive(Serialize)]
pub(crate) struct PanelView<'a> {
    y: &'a Axis,
    #[serde(skip_serializing_if = "Option::is_none")]
    range: Option<[f64; 2]>,
    series: Vec<SeriesView<'a>>,
    levels: Vec<MarkView<'a>>,
}

#[derive(Serialize)]
pub(crate) struct SeriesView<'a> {
    label: &'a str,
    role: Role,
    held: bool,
    v: Owned<'a>,
}

#[derive(Serialize)]
pub(crate) struct MarkView<'a> {
    label: &'a str,
    at: CompactNumber,
}

#[derive(Serialize)]
pub(crate) struct XyView<'a> {
    label: &'a str,
    role: Role,
    line: bool,
    points: bool,
    x: Compact<'a>,
    y: Compact<'a>,
}

#[derive(Serialize)]
pub(crate) struct HeatView<'a> {
    id: String,
    x: &'a Axis,
    y: &'a Axis,
    z: &'a Axis,
    xs: Compact<'a>,
    ys: Compact<'a>,
    zs: Compact<'a>,
    scale: ColourScale,
    contours: bool,
    cell_values: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    range: Option<[f64; 2]>,
    overlays: Vec<XyView<'a>>,
}

#[derive(Serialize)]
pub(crate) struct BarView<'a> {
    label: &'a str,
    v: Compact<'a>,
}

/// Values that are borrowed while whole, and owned once thinned.
pub(crate) struct Owned<'a> {
    values: std::borrow::Cow<'a, [f64]>,
    digits: usize,
}

impl Serialize for Owned<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Compact { values: &self.values, digits: self.digits }.serialize(serializer)
    }
}

fn mark(label: &str, at: f64) -> MarkView<'_> {
    MarkView { label, at: CompactNumber(at, PLOT_DIGITS) }
}

/// The view of a time plot. With `bin` > 0 the record is thinned to two samples per bin (see [`bin_for`]).
pub(crate) fn time<'a>(id: String, plot: &'a TimePlot, bin: usize) -> PlotView<'a> {
    PlotView::Time {
        id,
        x: &plot.x,
        t: time_axis(&plot.time, bin),
        panels: plot.panels.iter().map(|panel| panel_view(panel, bin)).collect(),
        marks: plot.marks.iter().map(|m| mark(&m.label, m.at)).collect(),
    }
}

fn panel_view(panel: &Panel, bin: usize) -> PanelView<'_> {
    let series = panel.series.iter().map(|s| SeriesView {
        label: &s.label,
        role: s.role,
        held: s.held,
        v: Owned {
            values: if bin == 0 { s.values.as_slice().into() } else { extremes(&s.values, bin).into() },
            digits: PLOT_DIGITS,
        },
    });
    PanelView {
        y: &panel.y,
        range: panel.range,
        series: series.collect(),
        levels: panel.levels.iter().map(|l| mark(&l.label, l.value)).collect(),
    }
}

/// Samples per bin that bring `n` samples below [`MAX_SAMPLES`]; 0 when the record is short enough.
pub(crate) fn bin_for(n: usize) -> usize {
    if n <= MAX_SAMPLES { 0 } else { n.div_ceil(MAX_SAMPLES / 2) }
}

fn time_axis(time: &[f64], bin: usize) -> TimeView<'_> {
    if bin > 0 {
        let stamps: Vec<f64> = time.chunks(bin).flat_map(|c| [c[0], c[c.len() / 2]]).collect();
        return TimeView::Listed(Owned { values: stamps.into(), digits: TIME_DIGITS });
    }
    let (n, start) = (time.len(), time[0]);
    let step = if n > 1 { (time[n - 1] - start) / (n - 1) as f64 } else { 1.0 };
    let uniform = time.iter().enumerate().all(|(k, t)| (t - (start + k as f64 * step)).abs() <= 1e-6 * step);
    if uniform {
        let step = crate::numbers::rounded(step, TIME_DIGITS);
        TimeView::Uniform { start, step, n }
    } else {
        TimeView::Listed(Owned { values: time.into(), digits: TIME_DIGITS })
    }
}

/// Smallest and largest value of each bin, in the order in which they occur; a bin without finite value is a gap.
pub(crate) fn extremes(values: &[f64], bin: usize) -> Vec<f64> {
    let mut thinned = Vec::with_capacity(2 * values.len().div_ceil(bin));
    for chunk in values.chunks(bin) {
        let (mut low, mut high) = ((f64::NAN, 0), (f64::NAN, 0));
        for (i, &v) in chunk.iter().enumerate().filter(|(_, v)| v.is_finite()) {
            if low.0.is_nan() || v < low.0 {
                low = (v, i);
            }
            if high.0.is_nan() || v > high.0 {
                high = (v, i);
            }
        }
        thinned.extend(if low.1 <= high.1 { [low.0, high.0] } else { [high.0, low.0] });
    }
    thinned
}

pub(crate) fn xy<'a>(id: String, plot: &'a XyPlot) -> PlotView<'a> {
    let series = plot.series.iter().map(|s| XyView {
        label: &s.label,
        role: s.role,
        line: s.line,
        points: s.points,
        x: Compact::plot(&s.x),
        y: Compact::plot(&s.y),
    });
    PlotView::Xy { id, x: &plot.x, y: &plot.y, series: series.collect(), equal: plot.equal }
}

pub(crate) fn heat<'a>(id: String, map: &'a HeatMap) -> PlotView<'a> {
    PlotView::Heat(HeatView {
        id,
        x: &map.x,
        y: &map.y,
        z: &map.z,
        xs: Compact::plot(&map.x_values),
        ys: Compact::plot(&map.y_values),
        zs: Compact::plot(&map.z_values),
        scale: map.scale,
        contours: map.contours,
        cell_values: map.cell_values,
        range: map.range,
        overlays: map
            .overlays
            .iter()
            .map(|o| XyView {
                label: &o.label,
                role: Role::Other,
                line: o.line,
                points: true,
                x: Compact::plot(&o.x),
                y: Compact::plot(&o.y),
            })
            .collect(),
    })
}

pub(crate) fn bars<'a>(id: String, bars: &'a Bars) -> PlotView<'a> {
    PlotView::Bars {
        id,
        value: &bars.value,
        categories: &bars.categories,
        series: bars
            .series
            .iter()
            .map(|s| BarView { label: &s.label, v: Compact::plot(&s.values) })
            .collect(),
        levels: bars.levels.iter().map(|l| mark(&l.label, l.value)).collect(),
    }
}
