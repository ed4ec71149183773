//! What the model does at rest, after a step and over frequency, input by input.

use dynocal_report::{Axis, Block, Cell, Column, Section, Table, XyPlot};

use crate::identify::curves::InputCurves;
use crate::identify::poles::Pole;
use crate::identify::result::{Identified, Modelled};

/// The section; none where no model has curves.
pub(super) fn section(found: &Identified) -> Option<Section> {
    if found.models.iter().all(|m| m.curves.is_empty()) {
        return None;
    }
    let mut section = Section::new("What the models do").text(format!(
        "Steady output over each input, all others at the medians of the estimation, with the band that the parameters' \
         covariance gives at {:.0} %; change of the output after a step by a tenth of the input's range; gain and phase about the \
         same point. Straight lines, equal steps and one frequency response everywhere mean a linear system; where there are unseen \
         records a linear ARX with the same memory stands beside. Inputs that the preparation shifts or scales are in its units.",
        100.0 * found.confidence
    ));
    for m in &found.models {
        for c in &m.curves {
            section = section.heading(format!("{} over {}", m.target, c.input));
            for pair in plots(m, c, found.confidence).chunks(2) {
                section = section.columns(pair.to_vec());
            }
        }
        if let Some(dt) = m.sample_time_s.filter(|_| !m.poles.is_empty()) {
            section = section.heading(format!("Poles of {}", m.target)).block(plane(m)).block(table(m, dt));
        }
    }
    Some(section)
}

/// Poles in the plane of z with the circle that they must not leave.
fn plane(m: &Modelled) -> XyPlot {
    let angle = |k: usize| std::f64::consts::TAU * k as f64 / CIRCLE as f64;
    let circle = |f: fn(f64) -> f64| (0..=CIRCLE).map(|k| f(angle(k))).collect::<Vec<_>>();
    let part = |f: fn(&Pole) -> f64| m.poles.iter().map(f).collect::<Vec<_>>();
    XyPlot::new("Plane of z", Axis::new("real part", "-"), Axis::new("imaginary part", "-"))
        .line("limit of stability", circle(f64::cos), circle(f64::sin))
        .points("poles", part(|p| p.re), part(|p| p.im))
        .equal_scales()
        .caption("About the same point; of a linear model the same everywhere.")
}

fn table(m: &Modelled, sample_time_s: f64) -> Table {
    let columns = vec![
        Column::number("Real part", "-").digits(4),
        Column::number("Imaginary part", "-").digits(4),
        Column::number("Size", "-").digits(4),
        Column::number("Time constant", "s").digits(3),
        Column::number("Frequency", "Hz").digits(3),
    ];
    let row = |p: &Pole| -> Vec<Cell> {
        vec![
            p.re.into(),
            p.im.into(),
            p.size().into(),
            p.time_constant_s(sample_time_s).into(),
            p.frequency_hz(sample_time_s).into(),
        ]
    };
    m.poles.iter().take(SHOWN).fold(Table::new(columns), |t, p| t.row(row(p)))
}

/// Corners of the circle.
const CIRCLE: usize = 72;
/// Most poles in the table.
const SHOWN: usize = 20;

/// The linear model beside, where there is one: what a straight line would have done.
fn rival<'a>(m: &'a Modelled, c: &InputCurves) -> Option<&'a InputCurves> {
    m.baseline.as_ref()?.curves.iter().find(|b| b.input == c.input)
}

/// Name of the linear model in legends.
const LINEAR: &str = "linear ARX";

fn plots(m: &Modelled, c: &InputCurves, confidence: f64) -> Vec<Block> {
    let mut out: Vec<Block> = Vec::new();
    let s = &c.steady;
    if !s.input.is_empty() {
        let mut plot = XyPlot::new(
            "At rest",
            Axis::new(c.input.as_str(), c.unit.as_str()),
            Axis::new(m.target.as_str(), m.unit.as_str()),
        );
        if !s.deviation.is_empty() {
            let label = format!("{:.0} % band", 100.0 * confidence);
            plot = plot.band(label, s.input.clone(), s.low.clone(), s.high.clone());
        }
        plot = plot.line(m.target.as_str(), s.input.clone(), s.output.clone());
        if let Some(b) = rival(m, c).map(|b| &b.steady).filter(|b| !b.input.is_empty()) {
            plot = plot.line(LINEAR, b.input.clone(), b.output.clone());
        }
        out.push(plot.into());
    }
    if !c.response.is_empty() {
        let mut plot = XyPlot::new(
            "After a step",
            Axis::new("Time", "s"),
            Axis::new(format!("Change of {}", m.target), m.unit.as_str()),
        )
        .line(
            format!("step of {}", dynocal_report::significant(c.step, 3)),
            c.time_s.clone(),
            c.response.clone(),
        );
        if let Some(b) = rival(m, c).filter(|b| !b.response.is_empty()) {
            plot = plot.line(LINEAR, b.time_s.clone(), b.response.clone());
        }
        out.push(plot.into());
    }
    if !c.frequency_hz.is_empty() {
        let decades = |c: &InputCurves| c.frequency_hz.iter().map(|f| f.log10()).collect::<Vec<_>>();
        let gain: fn(&InputCurves) -> &Vec<f64> = |c| &c.gain_db;
        for (title, unit, of) in [("Gain", "dB", gain), ("Phase", "deg", |c| &c.phase_deg)] {
            let axis = Axis::new("log10 of the frequency in Hz", "-");
            let mut plot =
                XyPlot::new(title, axis, Axis::new(title, unit)).line(title, decades(c), of(c).clone());
            if let Some(b) = rival(m, c).filter(|b| !b.frequency_hz.is_empty()) {
                plot = plot.line(LINEAR, decades(b), of(b).clone());
            }
            out.push(plot.into());
        }
    }
    out
}
