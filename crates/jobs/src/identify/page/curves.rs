//! What the model does at rest, after a step and over frequency, input by input.

use dynocal_report::{Axis, Block, Section, XyPlot};

use crate::identify::curves::InputCurves;
use crate::identify::result::{Identified, Modelled};

/// The section; none where no model has curves.
pub(super) fn section(found: &Identified) -> Option<Section> {
    if found.models.iter().all(|m| m.curves.is_empty()) {
        return None;
    }
    let mut section = Section::new("What the models do").text(format!(
        "Steady output over each input, all others at the medians of the estimation, with the band that the parameters' \
         covariance gives at {:.0} %; change of the output after a step by a tenth of the input's range; gain and phase about the \
         same point. Straight lines, equal steps and one frequency response everywhere mean a linear system. Inputs that the \
         preparation shifts or scales are in its units.",
        100.0 * found.confidence
    ));
    for m in &found.models {
        for c in &m.curves {
            section = section.heading(format!("{} over {}", m.target, c.input));
            for pair in plots(m, c, found.confidence).chunks(2) {
                section = section.columns(pair.to_vec());
            }
        }
    }
    Some(section)
}

fn plots(m: &Modelled, c: &InputCurves, confidence: f64) -> Vec<Block> {
    let mut out: Vec<Block> = Vec::new();
    let s = &c.steady;
    if !s.input.is_empty() {
        let mut plot = XyPlot::new(
            "At rest",
            Axis::new(c.input.as_str(), ""),
            Axis::new(m.target.as_str(), m.unit.as_str()),
        )
        .line(m.target.as_str(), s.input.clone(), s.output.clone());
        if !s.deviation.is_empty() {
            for (label, values) in [("lower", &s.low), ("upper", &s.high)] {
                plot = plot.line(
                    format!("{label} {:.0} %", 100.0 * confidence),
                    s.input.clone(),
                    values.clone(),
                );
            }
        }
        out.push(plot.into());
    }
    if !c.response.is_empty() {
        out.push(
            XyPlot::new(
                "After a step",
                Axis::new("Time", "s"),
                Axis::new(format!("Change of {}", m.target), m.unit.as_str()),
            )
            .line(
                format!("step of {}", dynocal_report::significant(c.step, 3)),
                c.time_s.clone(),
                c.response.clone(),
            )
            .into(),
        );
    }
    if !c.frequency_hz.is_empty() {
        let decades: Vec<f64> = c.frequency_hz.iter().map(|f| f.log10()).collect();
        for (title, unit, values) in [("Gain", "dB", &c.gain_db), ("Phase", "deg", &c.phase_deg)] {
            out.push(
                XyPlot::new(title, Axis::new("log10 of the frequency in Hz", "-"), Axis::new(title, unit))
                    .line(title, decades.clone(), values.clone())
                    .into(),
            );
        }
    }
    out
}
