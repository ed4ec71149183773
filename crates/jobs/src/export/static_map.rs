//! The static map: a table for each actuator over given channel and leading demand, and a program that reads them.

use dynocal_calib::map::static_map::StaticMap;
use dynocal_export::characteristic::{Axis, Characteristic, identifier};
use dynocal_export::package::{Package, Provenance, ValidRange};
use dynocal_export::program::Op;
use dynocal_numerics::interval::Interval;

use super::Made;
use super::build::Build;

fn middle(points: &[f64]) -> f64 {
    0.5 * (points.first().copied().unwrap_or(0.0) + points.last().copied().unwrap_or(0.0))
}

fn ends(points: &[f64]) -> (f64, f64) {
    (points.first().copied().unwrap_or(0.0), points.last().copied().unwrap_or(0.0))
}

/// Places that are named in words; of others their number is said.
const NAMED: usize = 8;

/// Which points were not reached as asked and why, in words; none where all were.
fn missed(map: &StaticMap) -> Option<String> {
    let place = |k: usize| {
        let given = map.ports.given.first().filter(|_| map.given.len() > 1);
        let given = given.map(|p| format!("{} {} {}", p.name, map.given[k % map.given.len()], p.unit));
        let lead = map.ports.demands.first().filter(|_| map.demand.len() > 1);
        let lead = lead.map(|p| format!("{} {} {}", p.name, map.demand[k / map.given.len()], p.unit));
        lead.into_iter().chain(given).collect::<Vec<_>>().join(" at ")
    };
    let which: Vec<usize> = (0..map.points.len()).filter(|k| !map.points[*k].missed.is_empty()).collect();
    // Points with the same reason together.
    let mut reasons: Vec<(&str, Vec<String>)> = Vec::new();
    for k in which.iter().take(NAMED) {
        let why = map.points[*k].missed.as_str();
        match reasons.iter_mut().find(|r| r.0 == why) {
            Some(r) => r.1.push(place(*k)),
            None => reasons.push((why, vec![place(*k)])),
        }
    }
    let named: Vec<String> = reasons.iter().map(|(why, at)| format!("{} ({why})", at.join(", "))).collect();
    let more = match which.len().saturating_sub(NAMED) {
        0 => String::new(),
        n => format!(", and {n} more"),
    };
    let (n, all) = (which.len(), map.points.len());
    (n > 0).then(|| format!("{n} of {all} values were not reached as asked: {}{more}", named.join(", ")))
}

/// Tables on shared axes, x the given channel and y the leading demand; an axis of one point is left out. With a sample
/// time the program that looks them up goes with them.
pub fn static_map(map: &StaticMap, sample_time_s: Option<f64>) -> Made {
    let ports = &map.ports;
    // (name, unit, points), x first: the points of the map lie with the given channel fastest.
    let given = ports.given.first().map(|p| (p.name.as_str(), p.unit.as_str(), map.given.as_slice()));
    let lead = ports.demands.first().map(|p| (p.name.as_str(), p.unit.as_str(), map.demand.as_slice()));
    let along: Vec<_> = given.into_iter().chain(lead).filter(|a| a.2.len() > 1).collect();
    let axis = |(name, unit, points): &(&str, &str, &[f64])| Axis {
        name: format!("{}_AXIS", identifier(name).to_uppercase()),
        description: format!("{name} of the static map"),
        unit: (*unit).into(),
        input: identifier(name),
        points: points.to_vec(),
        shared: true,
    };
    let axes: Vec<Axis> = along.iter().map(axis).collect();
    let over = along.iter().map(|a| a.0).collect::<Vec<_>>().join(" and ");
    let missed = missed(map);
    let characteristics: Vec<Characteristic> = ports
        .actuators
        .iter()
        .enumerate()
        .map(|(k, a)| Characteristic {
            name: format!("{}_MAP", identifier(&a.name).to_uppercase()),
            description: match &missed {
                Some(missed) => format!("{} over {over}, steady; {missed}", a.name),
                None => format!("{} over {over}, steady", a.name),
            },
            unit: a.unit.clone(),
            axes: axes.clone(),
            values: map.points.iter().map(|p| p.actuators[k]).collect(),
            limits: Some(Interval::new(a.lower, a.upper)).filter(|l| l.is_finite()),
        })
        .collect();
    let range = |(name, unit, points): &(&str, &str, &[f64])| {
        let (lower, upper) = ends(points);
        ValidRange { channel: (*name).into(), unit: (*unit).into(), lower, upper }
    };
    let program = sample_time_s.filter(|_| !along.is_empty()).map(|dt| {
        let mut b = Build::new(dt);
        let inputs: Vec<_> =
            along.iter().map(|a| b.input(a.0, a.1, middle(a.2), Some(ends(a.2).into()))).collect();
        for (c, a) in characteristics.iter().zip(&ports.actuators) {
            let op = Op::Lookup { characteristic: c.name.clone(), inputs: inputs.clone() };
            let node = b.node(&format!("{}_map", a.name), op);
            b.output(&a.name, &a.unit, node);
        }
        b.program
    });
    let mut notes = Vec::new();
    if let Some(missed) = &missed {
        notes.push(format!("static map: {missed}"));
    }
    if let Some(held) = ports.demands.get(1..).filter(|d| !d.is_empty()) {
        let names: Vec<&str> = held.iter().map(|p| p.name.as_str()).collect();
        notes.push(format!("static map: it holds for one demand of {}", names.join(", ")));
    }
    Made {
        package: Package {
            name: "static_map".into(),
            description: "Static map of a calibration".into(),
            provenance: Provenance { validity: along.iter().map(range).collect(), ..Default::default() },
            characteristics,
            program,
            ..Default::default()
        },
        notes,
    }
}
