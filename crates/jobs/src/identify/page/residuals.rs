//! Correlations of the residuals with their bounds.

use crate::identify::result::{Identified, ResidualTests};
use dynocal_ident::validate::Correlation;
use dynocal_report::{Axis, Block, Section, XyPlot};

use super::kind_text;

/// Most inputs whose correlation is drawn for a target.
const INPUTS: usize = 6;

/// The section.
pub(super) fn section(found: &Identified) -> Section {
    let mut section = Section::new("Residuals").text(
        "Correlation of the errors that the estimator made small, with each other and with past inputs, at the lags of the \
         x axis. Values within the bounds are what independent errors give in 95 of 100 lags. Correlation with an input: \
         the model misses dynamics of that input. Correlation with itself: one-step errors are not white, the noise model \
         or the standard errors do not hold; errors of a free run need not be white.",
    );
    for m in &found.models {
        for r in &m.residuals {
            section = section.heading(format!("{}, {}, {}", m.target, r.part, kind_text(r.kind)));
            let plots: Vec<Block> = plots(r);
            for pair in plots.chunks(2) {
                section = section.columns(pair.to_vec());
            }
        }
    }
    section
}

fn plots(r: &ResidualTests) -> Vec<Block> {
    let mut out: Vec<Block> = vec![plot("Autocorrelation", &r.auto).into()];
    for c in r.cross.iter().take(INPUTS) {
        out.push(plot(&format!("With {}", c.input), &c.correlation).into());
    }
    out
}

fn plot(title: &str, c: &Correlation) -> XyPlot {
    let lags: Vec<f64> = c.lags.iter().map(|l| *l as f64).collect();
    let ends = match (lags.first(), lags.last()) {
        (Some(a), Some(b)) => vec![*a, *b],
        _ => vec![0.0, 1.0],
    };
    XyPlot::new(title, Axis::new("Lag", "samples"), Axis::new("Correlation", "-"))
        .band("95 % bounds", ends, vec![-c.bound; 2], vec![c.bound; 2])
        .points("residual", lags, c.values.clone())
        .caption(format!("{:.0} % of the lags outside the bounds.", 100.0 * c.share_outside))
}
