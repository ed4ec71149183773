//! A dynamic map of tables: base, slopes and lags as maps over given channel and leading demand, leads as scalars, and the program
//! that works on them as the map does.

use dynocal_calib::map::lead_lag::LeadLagMap;
use dynocal_export::characteristic::{Axis, Characteristic, identifier};
use dynocal_export::package::{Package, Provenance, ValidRange};
use dynocal_export::program::{Factor, NodeId, Op, Tau, Term};
use dynocal_numerics::interval::Interval;

use super::Made;
use super::build::Build;

fn product(coefficient: f64, nodes: &[NodeId]) -> Term {
    Term { coefficient, factors: nodes.iter().map(|n| Factor { node: *n, power: 1 }).collect() }
}

/// Tables on shared axes (x the given channel, y the leading demand), and the program.
pub fn lead_lag(map: &LeadLagMap, sample_time_s: f64) -> Made {
    let mut b = Build::new(sample_time_s);
    let ports = &map.ports;
    let (lead, given) = (0, (!ports.given.is_empty()).then_some(ports.demands.len()));
    let inputs: Vec<NodeId> = ports
        .references()
        .zip(&map.region)
        .map(|(p, range)| b.input(&p.name, &p.unit, range.middle(), Some(*range)))
        .collect();
    let names: Vec<_> = ports.references().collect();
    // x first: the tables lie with the given channel fastest.
    let along: Vec<(usize, &[f64])> =
        given.map(|g| (g, map.given.as_slice())).into_iter().chain([(lead, map.demand.as_slice())]).collect();
    let axes: Vec<Axis> = along
        .iter()
        .map(|(r, points)| Axis {
            name: format!("{}_BASE_AXIS", identifier(&names[*r].name).to_uppercase()),
            description: format!("{} of the dynamic map", names[*r].name),
            unit: names[*r].unit.clone(),
            input: identifier(&names[*r].name),
            points: points.to_vec(),
            shared: true,
        })
        .collect();
    let at: Vec<NodeId> = along.iter().map(|(r, _)| inputs[*r]).collect();
    let mut characteristics: Vec<Characteristic> = Vec::new();
    let mut table = |b: &mut Build, name: &str, about: String, unit: String, values: &[f64], limits| {
        let name = identifier(name).to_uppercase();
        characteristics.push(Characteristic {
            name: name.clone(),
            description: about,
            unit,
            axes: axes.clone(),
            values: values.to_vec(),
            limits,
        });
        let op = Op::Lookup { characteristic: name.clone(), inputs: at.clone() };
        b.node(&format!("{}_now", name.to_lowercase()), op)
    };
    // Distances of the other references from their rest, held in the region of the data.
    let others: Vec<NodeId> = map
        .others
        .iter()
        .map(|o| {
            let (name, range) = (&names[o.place].name, map.region[o.place]);
            let held = Op::Clamp { of: inputs[o.place], lower: range.lower, upper: range.upper };
            let held = b.node(&format!("{name}_held"), held);
            b.node(&format!("{name}_from_rest"), Op::Scale { of: held, gain: 1.0, offset: -o.rest })
        })
        .collect();
    for (port, a) in ports.actuators.iter().zip(&map.actuators) {
        let limits = Some(Interval::new(port.lower, port.upper)).filter(|l| l.is_finite());
        let about = format!("{} at rest", port.name);
        let base = table(&mut b, &format!("{}_BASE", port.name), about, port.unit.clone(), &a.base, limits);
        let mut terms = vec![product(1.0, &[base])];
        for ((slope, o), distance) in a.slopes.iter().zip(&map.others).zip(&others) {
            let of = names[o.place];
            let name = format!("{}_BY_{}", port.name, of.name);
            let about = format!("change of {} with {} about {}", port.name, of.name, o.rest);
            let unit = format!("{}/{}", port.unit, of.unit);
            let node = table(&mut b, &name, about, unit, slope, None);
            terms.push(product(1.0, &[node, *distance]));
        }
        let rest = b.node(&format!("{}_rest", port.name), Op::Polynomial { terms });
        let mut raw = rest;
        if a.lag_s.iter().any(|t| *t > 0.0) {
            let (name, about) = (format!("{}_LAG", port.name), format!("time constant of {}", port.name));
            let tau = table(&mut b, &name, about, "s".into(), &a.lag_s, None);
            let lagged = b.node(&format!("{}_lagged", port.name), Op::Lag { of: rest, tau: Tau::Node(tau) });
            let h = a.law.lead;
            let terms = vec![product(1.0 - h, &[lagged]), product(h, &[rest])];
            raw = match h == 0.0 {
                true => lagged,
                false => b.node(&format!("{}_led", port.name), Op::Polynomial { terms }),
            };
        }
        let limited = Op::Clamp { of: raw, lower: port.lower, upper: port.upper };
        let node = b.node(&format!("{}_limited", port.name), limited);
        b.output(&port.name, &port.unit, node);
    }
    let validity = names
        .iter()
        .zip(&map.region)
        .map(|(p, range)| ValidRange {
            channel: p.name.clone(),
            unit: p.unit.clone(),
            lower: range.lower,
            upper: range.upper,
        })
        .collect();
    Made {
        package: Package {
            name: "dynamic_map".into(),
            description: "Dynamic map of a calibration: base tables with lead and lag".into(),
            provenance: Provenance { validity, ..Default::default() },
            characteristics,
            program: Some(b.program),
            ..Default::default()
        },
        notes: Vec::new(),
    }
}
