//! What the optimum of a cell is searched with: models with limits and weights, and the region that was reached.

use dynocal_calib::steady::cell::{Setting, Side, deviations};
use dynocal_calib::steady::day::DayPoint;
use dynocal_calib::steady::envelope::Envelope;
use dynocal_calib::steady::layout::{Layout, ResponseSource};
use dynocal_calib::steady::station::SteadyPoint;
use dynocal_ident::model::response::Response;
use dynocal_numerics::interval::Interval;

use super::learn::Learned;
use super::reach::Reach;
use super::spec::MapSpec;

/// Hull of the axes that were reached. A demand that was met counts as it was asked for: what it was measured at scatters about it, and what it is worth where a
/// slow channel has come to rest is within a share of the axis.
pub(super) fn envelope(layout: &Layout, points: &[DayPoint]) -> Envelope {
    let used = points.iter().map(|p| &p.point).filter(|p| p.usable);
    let at = |p: &SteadyPoint| {
        let as_asked = p.touched.is_empty() && p.saturated.is_empty();
        if as_asked { p.asked[..layout.axes].to_vec() } else { p.factors[..layout.axes].to_vec() }
    };
    let reached: Vec<Vec<f64>> = used.map(at).collect();
    let ranges: Vec<Interval> =
        layout.factors[..layout.axes].iter().map(|f| Interval::new(f.lower, f.upper)).collect();
    Envelope::of(&reached, &ranges)
}

/// Models with limits and weights; what a demand reaches at the end of its input, where that was met. An end of a driven input at which no point
/// stood is no limit of the cells; one at which some did counts as far as models expect it, without room for what they do not know, where lines
/// along the maps will find it: to pass it harms nothing.
pub(super) fn setting<'a>(
    layout: &Layout,
    models: &'a [Learned],
    reach: Option<&'a Reach>,
    spec: &MapSpec,
) -> Setting<'a> {
    let mut sides = Vec::new();
    for (k, (r, model)) in layout.responses.iter().zip(models).enumerate() {
        let scale = model.spread.max(f64::MIN_POSITIVE);
        let stays =
            |upper: bool| model.met[usize::from(upper)] && reach.is_none_or(|e| !e.replaces(k, upper));
        let upper = r.upper.filter(|_| stays(true));
        let lower = r.lower.filter(|_| stays(false));
        // A model of an opening errs by a quarter of it: room for that would keep cells far from an end which lines along the maps will find.
        let found_later = matches!(r.source, ResponseSource::Driven(_)) && spec.bed.sweep.is_some();
        let caution = if found_later { 0.0 } else { 1.0 };
        sides.extend(upper.map(|limit| Side { response: k, limit, sign: 1.0, scale, caution }));
        sides.extend(lower.map(|limit| Side { response: k, limit, sign: -1.0, scale, caution }));
    }
    sides.extend(reach.iter().flat_map(|e| e.sides(models.len())));
    let reserves = || reach.iter().flat_map(|e| e.responses());
    Setting {
        models: models.iter().map(|m| m as &dyn Response).chain(reserves()).collect(),
        weights: layout
            .responses
            .iter()
            .zip(models)
            .map(|(r, _)| r.weight)
            .chain(reserves().map(|_| 0.0))
            .collect(),
        sides,
        z: deviations(spec.optimise.probability),
        caution: spec.optimise.caution,
        ranges: layout.factors.iter().map(|f| Interval::new(f.lower, f.upper)).collect(),
        axes: layout.axes,
    }
}
