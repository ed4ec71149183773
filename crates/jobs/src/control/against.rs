//! What was measured and speaks against the models, or against the margins that they promise.

use super::result::{Controlled, LoopResult, MeasuredResult};
use super::words::digits;

/// Each contradiction in words; none: the measurement and the models agree as far as the measurement knows.
pub(super) fn measured(found: &Controlled) -> Vec<String> {
    let of = |(point, m): (usize, &MeasuredResult)| {
        let each = found.loops.iter().enumerate();
        each.flat_map(|(k, l)| one(found, (point, m), (k, l))).collect::<Vec<_>>()
    };
    found.measured.iter().enumerate().flat_map(of).collect()
}

fn one(
    found: &Controlled,
    (point, m): (usize, &MeasuredResult),
    (k, l): (usize, &LoopResult),
) -> Vec<String> {
    let mut out = Vec::new();
    let r2 = m.models[k].1;
    if !(r2 > 0.0) {
        out.push(format!(
            "{}: the model of `{}` explains nothing: in free run over what it was not fitted on its errors are larger than all movement of the output (R2 = {} %)",
            m.point, l.output, digits(r2)
        ));
    }
    // Off by more than the gain that is asked to be left over.
    let most = 1.0 - 1.0 / found.asked.gain_margin;
    if let Some(wrong) = m.wrong[k].filter(|w| *w > most) {
        out.push(format!(
            "{}: the model of `{}` is off by {:.0} % of what was measured, where the measurement is sure to a tenth of that",
            m.point,
            l.output,
            100.0 * wrong
        ));
    }
    // What the model promises of the same loop, the others open: one that promises less is judged with all loops closed.
    let alone = l.rules.first().filter(|_| l.predictor.is_none() && l.by_point.is_empty());
    let promise = alone.and_then(|t| t.margins.get(point)?.as_ref());
    let own = &m.margins[k];
    for (what, unit, interval, asked, promised) in [
        ("gain margin", "", own.gain_up, found.asked.gain_margin, promise.map(|p| p.gain_up)),
        ("phase margin", " deg", own.phase_deg, found.asked.phase_margin_deg, promise.map(|p| p.phase_deg)),
    ] {
        let Some((low, high)) = interval.filter(|(_, high)| *high < asked) else { continue };
        if promised.flatten().is_none_or(|p| p >= asked) {
            out.push(format!(
                "{}: the {what} of `{}` as it was measured is {} to {}{unit}, below the {asked}{unit} that are asked, whatever its model says",
                m.point, l.output, digits(low), digits(high)
            ));
        }
    }
    out
}
