//! What a spec moves and measures on a plant: axes, where the day begins, factors and responses.

use dynocal_calib::gains::Tuned;
use dynocal_calib::problem::{DemandChannel, InputChannel};
use dynocal_calib::steady::layout::{AxisRange, Factor, FactorKind, Layout};
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::PlanLoop;
use dynocal_ident::plant::{Causality, Variable};
use dynocal_numerics::interval::Interval;

use super::error::MapError;
use super::result::MapAxis;
use super::spec::MapSpec;

/// Share of an axis by which points are planned beyond its ends.
const BEYOND: f64 = 0.05;

/// Every channel of the problem is there, in its unit.
pub(super) fn has_channels(spec: &MapSpec, variables: &[Variable]) -> Result<(), MapError> {
    let p = &spec.problem;
    let inputs = p.inputs.iter().map(|i| (&i.name, &i.unit, Causality::Input));
    let given = p.given.iter().map(|g| (&g.name, &g.unit, Causality::Input));
    let demands = p.demands.iter().map(|d| (&d.output, &d.unit, Causality::Output));
    let derived = |name: &str| p.derive.iter().any(|d| d.name == name);
    let limits = p.limits.iter().filter(|l| !derived(&l.output));
    let limits = limits.map(|l| (&l.output, &l.unit, Causality::Output));
    for (name, unit, causality) in inputs.chain(given).chain(demands).chain(limits) {
        let all = variables.iter().filter(|v| v.causality == causality);
        if !all.clone().any(|v| v.name == *name && v.unit == *unit) {
            let role = if causality == Causality::Input { "input" } else { "output" };
            let known: Vec<String> = all.map(|v| format!("{} [{}]", v.name, v.unit)).collect();
            let (name, unit, known) = (name.clone(), unit.clone(), known.join(", "));
            return Err(MapError::Channel { role, name, unit, known });
        }
    }
    Ok(())
}

/// What the front is traced against and what is slower than a point are measured and modelled, too.
fn with_others(spec: &MapSpec, layout: &mut Layout, variables: &[Variable]) -> Result<(), MapError> {
    let front = spec.optimise.front.as_ref().map(|f| ("optimise.front.against", &f.against));
    let slow = spec.bed.slow.as_ref().map(|name| ("bed.slow", name));
    let output =
        |name: &String| variables.iter().any(|v| v.causality == Causality::Output && v.name == *name);
    for (key, name) in [front, slow].into_iter().flatten() {
        let (is_slow, others) = (key == "bed.slow", layout.responses.len());
        if (!is_slow || output(name)) && layout.add_response(name, variables) {
            // One that is limited or minimised, too, stays what it is.
            layout.responses[others..].iter_mut().for_each(|r| r.slow = is_slow);
            continue;
        }
        let outputs = variables.iter().filter(|v| v.causality == Causality::Output);
        let known: Vec<String> = outputs.map(|v| format!("{} [{}]", v.name, v.unit)).collect();
        return Err(MapError::Response { key, name: name.clone(), known: known.join(", ") });
    }
    Ok(())
}

/// Axes in the order of maps: the demand, then the given channel, which is the fast one.
pub(super) fn axes(spec: &MapSpec) -> Vec<MapAxis> {
    let (demands, given) = (spec.problem.demand_names(), spec.problem.given_names());
    let axis = |name: &String| {
        let points = spec.axes.get(name)?.clone();
        let unit = spec.problem.unit(name).unwrap_or("-").to_string();
        Some(MapAxis { name: name.clone(), unit, points })
    };
    demands.iter().chain(&given).filter_map(axis).collect()
}

/// Values of all inputs that may move with which the day begins: of the spec, else the plant's own.
pub(super) fn start(spec: &MapSpec, variables: &[Variable]) -> Vec<f64> {
    let own = |name: &str| {
        let v = variables.iter().find(|v| v.causality == Causality::Input && v.name == name);
        v.map(|v| v.start)
    };
    let one = |i: &InputChannel| {
        let value = spec.start.get(&i.name).copied().or_else(|| own(&i.name));
        value.unwrap_or(0.5 * (i.lower + i.upper)).clamp(i.lower, i.upper)
    };
    spec.problem.inputs.iter().map(one).collect()
}

/// The loops in the order of the demands.
fn closed(spec: &MapSpec, gains: &dyn Fn(&str) -> PiGains) -> Vec<PlanLoop> {
    let one = |d: &DemandChannel| {
        let l = spec.loops.iter().find(|l| l.output == d.output)?;
        Some(PlanLoop::closed(&l.output, &l.input, l.gains.unwrap_or_else(|| gains(&l.output))))
    };
    spec.problem.demands.iter().filter_map(one).collect()
}

pub(super) fn layout(
    spec: &MapSpec,
    axes: &[MapAxis],
    tuned: Option<&Tuned>,
    variables: &[Variable],
) -> Result<Layout, MapError> {
    let found = |output: &str| {
        let l = tuned.and_then(|t| t.loops.iter().find(|l| l.output == output));
        l.map_or(PiGains { ki: 0.0, kp: 0.0 }, |l| l.gains)
    };
    let ranges: Vec<_> = axes.iter().map(|a| beyond_the_axis(spec, a)).collect();
    let loops = closed(spec, &found);
    let mut layout =
        Layout::new(&spec.problem, loops, &ranges, spec.held.clone(), spec.sample_time_s, variables);
    for f in &mut layout.factors {
        if let Some(range) = spec.bed.ranges.get(&f.name) {
            (f.lower, f.upper) = (range.lower, range.upper);
        }
    }
    with_others(spec, &mut layout, variables)?;
    Ok(layout)
}

/// Range in which points are planned: a little beyond the ends of an axis where the problem lets it, so that the outermost cells
/// lie inside of what was measured.
fn beyond_the_axis(spec: &MapSpec, axis: &MapAxis) -> AxisRange {
    let p = &spec.problem;
    let demand = p.demands.iter().find(|d| d.output == axis.name).map(|d| Interval::new(d.lower, d.upper));
    let bounds =
        demand.or(p.given.iter().find(|g| g.name == axis.name).map(|g| Interval::new(g.lower, g.upper)));
    let AxisRange { name, range } = axis.range();
    let bounds = bounds.unwrap_or(range);
    let more = BEYOND * range.width();
    AxisRange {
        name,
        range: Interval::new((range.lower - more).max(bounds.lower), (range.upper + more).min(bounds.upper)),
    }
}

/// The first point: axes in their middle, inputs where they begin.
pub(super) fn first(layout: &Layout, start: &[f64]) -> Vec<f64> {
    let one = |(f, centre): (&Factor, f64)| match f.kind {
        FactorKind::Free(k) => start[k].clamp(f.lower, f.upper),
        _ => centre,
    };
    layout.factors.iter().zip(layout.centre()).map(one).collect()
}
