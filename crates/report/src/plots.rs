//! Plots: what is drawn over which axes.

use serde::{Deserialize, Serialize};

use crate::numbers::nullable;

/// Name and unit of a quantity.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Axis {
    /// Name of the quantity.
    pub label: String,
    /// Unit; empty for none.
    pub unit: String,
}

impl Axis {
    /// Name and unit.
    pub fn new(label: impl Into<String>, unit: impl Into<String>) -> Self {
        Axis { label: label.into(), unit: unit.into() }
    }
}

/// What a line stands for; fixes its colour and dash, so that the whole report reads the same.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Measured on the plant: dark.
    Measured,
    /// Simulated by a model: orange.
    Simulated,
    /// Demanded: blue, dashed.
    Demand,
    /// A bound: red, dashed.
    Limit,
    /// One side of a band: its lower side has the label, its upper side follows without one; the area between is filled.
    Band,
    /// Anything else: the next colour of the palette.
    #[default]
    Other,
}

/// Stacked panels over a common time axis, with one cursor and one zoom.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TimePlot {
    /// Heading.
    pub title: String,
    /// Text below the plot; may be empty.
    pub caption: String,
    /// Name and unit of the common axis, time in s by default.
    pub x: Axis,
    /// Axis values (n), strictly increasing.
    pub time: Vec<f64>,
    /// Panels, top to bottom.
    pub panels: Vec<Panel>,
    /// Named instants, drawn as vertical lines.
    pub marks: Vec<Mark>,
}

impl TimePlot {
    /// A plot over time in s.
    pub fn new(title: impl Into<String>, time_s: impl Into<Vec<f64>>) -> Self {
        TimePlot {
            title: title.into(),
            x: Axis::new("Time", "s"),
            time: time_s.into(),
            ..TimePlot::default()
        }
    }
    /// A plot over `n` instants k Ts, k = 0..n.
    pub fn sampled(title: impl Into<String>, sample_time_s: f64, n: usize) -> Self {
        TimePlot::new(title, (0..n).map(|k| k as f64 * sample_time_s).collect::<Vec<f64>>())
    }
    /// Adds a panel below the others.
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }
    /// Names an instant.
    pub fn mark(mut self, at: f64, label: impl Into<String>) -> Self {
        self.marks.push(Mark { at, label: label.into() });
        self
    }
    /// Sets the text below the plot.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }
}

/// A named position on the common axis.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// Position in units of the axis.
    pub at: f64,
    /// Short name.
    pub label: String,
}

/// One panel of a [`TimePlot`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Panel {
    /// Vertical axis.
    pub y: Axis,
    /// Lines, drawn in this order.
    pub series: Vec<Series>,
    /// Constant bounds, drawn dashed.
    pub levels: Vec<Level>,
    /// Fixed vertical range; fitted to the visible data when not given.
    pub range: Option<[f64; 2]>,
}

impl Panel {
    /// An empty panel with its vertical axis.
    pub fn new(label: impl Into<String>, unit: impl Into<String>) -> Self {
        Panel { y: Axis::new(label, unit), ..Panel::default() }
    }
    /// Adds a line.
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }
    /// Adds a measured line.
    pub fn measured(self, values: impl Into<Vec<f64>>) -> Self {
        self.series(Series::new("measured", values).role(Role::Measured))
    }
    /// Adds a simulated line.
    pub fn simulated(self, values: impl Into<Vec<f64>>) -> Self {
        self.series(Series::new("simulated", values).role(Role::Simulated))
    }
    /// Adds a demanded line.
    pub fn demand(self, values: impl Into<Vec<f64>>) -> Self {
        self.series(Series::new("demand", values).role(Role::Demand))
    }
    /// Adds any line in the next colour.
    pub fn line(self, label: impl Into<String>, values: impl Into<Vec<f64>>) -> Self {
        self.series(Series::new(label, values))
    }
    /// Adds a held input: constant between samples.
    pub fn held(self, label: impl Into<String>, values: impl Into<Vec<f64>>) -> Self {
        self.series(Series::new(label, values).held())
    }
    /// Adds a band between two lines; what is added later lies on top.
    pub fn band(self, label: impl Into<String>, low: impl Into<Vec<f64>>, high: impl Into<Vec<f64>>) -> Self {
        self.series(Series::new(label, low).role(Role::Band)).series(Series::new("", high).role(Role::Band))
    }
    /// Adds a constant bound.
    pub fn level(mut self, label: impl Into<String>, value: f64) -> Self {
        self.levels.push(Level { label: label.into(), value });
        self
    }
    /// Fixes the vertical range, for instance when a diverging line would flatten the rest.
    pub fn range(mut self, low: f64, high: f64) -> Self {
        self.range = Some([low, high]);
        self
    }
}

/// A line over the common axis.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Series {
    /// Name in the legend.
    pub label: String,
    /// Meaning, which fixes the colour.
    pub role: Role,
    /// Values (n); non-finite ones are gaps, null in JSON.
    #[serde(with = "nullable")]
    pub values: Vec<f64>,
    /// Constant between samples (drawn as steps).
    pub held: bool,
}

impl Series {
    /// A line in the next colour of the palette.
    pub fn new(label: impl Into<String>, values: impl Into<Vec<f64>>) -> Self {
        Series { label: label.into(), values: values.into(), ..Series::default() }
    }
    /// Sets the meaning.
    pub fn role(mut self, role: Role) -> Self {
        self.role = role;
        self
    }
    /// Draws steps.
    pub fn held(mut self) -> Self {
        self.held = true;
        self
    }
}

/// A constant bound with a name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// Name.
    pub label: String,
    /// Value in units of the axis.
    pub value: f64,
}

/// Curves and points over two axes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct XyPlot {
    /// Heading.
    pub title: String,
    /// Text below the plot; may be empty.
    pub caption: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Curves and clouds, drawn in this order.
    pub series: Vec<XySeries>,
    /// A unit has the same length on both axes: circles are round.
    pub equal: bool,
}

impl XyPlot {
    /// Gives a unit the same length on both axes.
    pub fn equal_scales(mut self) -> Self {
        self.equal = true;
        self
    }
    /// An empty plot.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        XyPlot { title: title.into(), x, y, ..XyPlot::default() }
    }
    /// Adds a curve or cloud.
    pub fn series(mut self, series: XySeries) -> Self {
        self.series.push(series);
        self
    }
    /// Adds a curve in the next colour.
    pub fn line(self, label: impl Into<String>, x: impl Into<Vec<f64>>, y: impl Into<Vec<f64>>) -> Self {
        self.series(XySeries { line: true, ..XySeries::new(label, x, y) })
    }
    /// Adds a band between two curves over `x`; what is added later lies on top.
    pub fn band(
        self,
        label: impl Into<String>,
        x: impl Into<Vec<f64>>,
        low: impl Into<Vec<f64>>,
        high: impl Into<Vec<f64>>,
    ) -> Self {
        let (mut x, mut y, mut high) = (x.into(), low.into(), high.into());
        // Once around the area: there along the lower side, back along the upper one.
        let back: Vec<f64> = x.iter().rev().copied().collect();
        x.extend(back);
        high.reverse();
        y.extend(high);
        self.series(XySeries { line: true, role: Role::Band, ..XySeries::new(label, x, y) })
    }
    /// Adds a cloud of points in the next colour.
    pub fn points(self, label: impl Into<String>, x: impl Into<Vec<f64>>, y: impl Into<Vec<f64>>) -> Self {
        self.series(XySeries { points: true, ..XySeries::new(label, x, y) })
    }
    /// Sets the text below the plot.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }
}

/// One curve or cloud.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct XySeries {
    /// Name in the legend.
    pub label: String,
    /// Meaning, which fixes the colour.
    pub role: Role,
    /// Abscissae (m).
    #[serde(with = "nullable")]
    pub x: Vec<f64>,
    /// Ordinates (m).
    #[serde(with = "nullable")]
    pub y: Vec<f64>,
    /// Join the points.
    pub line: bool,
    /// Draw the points.
    pub points: bool,
}

impl XySeries {
    /// Points that are not drawn until `line` or `points` is set.
    pub fn new(label: impl Into<String>, x: impl Into<Vec<f64>>, y: impl Into<Vec<f64>>) -> Self {
        XySeries { label: label.into(), x: x.into(), y: y.into(), ..XySeries::default() }
    }
    /// Sets the meaning.
    pub fn role(mut self, role: Role) -> Self {
        self.role = role;
        self
    }
}

/// Colours of a [`HeatMap`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ColourScale {
    /// Light to dark, for magnitudes.
    #[default]
    Sequential,
    /// Blue through white to red, white at zero, for differences.
    Diverging,
}

/// A quantity over a rectangular grid.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HeatMap {
    /// Heading.
    pub title: String,
    /// Text below the plot; may be empty.
    pub caption: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// The mapped quantity, named at the colour bar.
    pub z: Axis,
    /// Grid along x (nx), strictly increasing.
    pub x_values: Vec<f64>,
    /// Grid along y (ny), strictly increasing.
    pub y_values: Vec<f64>,
    /// Values (ny rows of nx), row by row: `z_values[j * nx + i]` stands at `(x_values[i], y_values[j])`.
    #[serde(with = "nullable")]
    pub z_values: Vec<f64>,
    /// Colours.
    pub scale: ColourScale,
    /// Draw contour lines with their values.
    pub contours: bool,
    /// Write the value into each cell (for small grids).
    pub cell_values: bool,
    /// Least and greatest value of the colours; those of the data where it is absent. Maps beside each other that shall be
    /// compared need the same.
    pub range: Option<[f64; 2]>,
    /// Points and lines on top, such as operating points and limits.
    pub overlays: Vec<Overlay>,
}

impl HeatMap {
    /// A map of `z_values` (ny rows of nx) over `x_values` and `y_values`.
    pub fn new(
        title: impl Into<String>,
        (x, x_values): (Axis, Vec<f64>),
        (y, y_values): (Axis, Vec<f64>),
        (z, z_values): (Axis, Vec<f64>),
    ) -> Self {
        HeatMap { title: title.into(), x, y, z, x_values, y_values, z_values, ..HeatMap::default() }
    }
    /// Adds contour lines.
    pub fn contours(mut self) -> Self {
        self.contours = true;
        self
    }
    /// Writes the value into each cell.
    pub fn cell_values(mut self) -> Self {
        self.cell_values = true;
        self
    }
    /// Uses blue, white, red with white at zero.
    pub fn diverging(mut self) -> Self {
        self.scale = ColourScale::Diverging;
        self
    }
    /// Draws points on top.
    pub fn overlay(
        mut self,
        label: impl Into<String>,
        x: impl Into<Vec<f64>>,
        y: impl Into<Vec<f64>>,
    ) -> Self {
        self.overlays.push(Overlay { label: label.into(), x: x.into(), y: y.into(), line: false });
        self
    }
    /// Draws a line with its points on top.
    pub fn overlay_line(
        mut self,
        label: impl Into<String>,
        x: impl Into<Vec<f64>>,
        y: impl Into<Vec<f64>>,
    ) -> Self {
        self.overlays.push(Overlay { label: label.into(), x: x.into(), y: y.into(), line: true });
        self
    }
    /// Fixes the values of the first and the last colour.
    pub fn range(mut self, low: f64, high: f64) -> Self {
        self.range = Some([low, high]);
        self
    }
    /// Sets the text below the plot.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }
}

/// Points or a line on top of a map.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Overlay {
    /// Name in the legend.
    pub label: String,
    /// Abscissae (m).
    #[serde(with = "nullable")]
    pub x: Vec<f64>,
    /// Ordinates (m).
    #[serde(with = "nullable")]
    pub y: Vec<f64>,
    /// Join the points.
    #[serde(default)]
    pub line: bool,
}

/// Horizontal bars: one group per category, one bar per series, values written at the bars.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Bars {
    /// Heading.
    pub title: String,
    /// Text below the plot; may be empty.
    pub caption: String,
    /// Value axis.
    pub value: Axis,
    /// Names of the groups (g).
    pub categories: Vec<String>,
    /// Series with g values each.
    pub series: Vec<BarSeries>,
    /// Bounds, drawn as dashed lines across the groups.
    pub levels: Vec<Level>,
}

impl Bars {
    /// Bars without series.
    pub fn new<S: Into<String>>(
        title: impl Into<String>,
        value: Axis,
        categories: impl IntoIterator<Item = S>,
    ) -> Self {
        let categories = categories.into_iter().map(Into::into).collect();
        Bars { title: title.into(), value, categories, ..Bars::default() }
    }
    /// Adds a series: one value per category.
    pub fn series(mut self, label: impl Into<String>, values: impl Into<Vec<f64>>) -> Self {
        self.series.push(BarSeries { label: label.into(), values: values.into() });
        self
    }
    /// Adds a bound.
    pub fn level(mut self, label: impl Into<String>, value: f64) -> Self {
        self.levels.push(Level { label: label.into(), value });
        self
    }
    /// Sets the text below the plot.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }
}

/// One series of bars.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct BarSeries {
    /// Name in the legend.
    pub label: String,
    /// One value per category.
    #[serde(with = "nullable")]
    pub values: Vec<f64>,
}
