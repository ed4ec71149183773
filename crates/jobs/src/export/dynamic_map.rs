//! The structured dynamic map as it works online: demands through their filters and `look_ahead` samples late, given
//! channels as they are measured, everything held in the region of the data, actuators in their limits.

use dynocal_calib::map::structured::StructuredMap;
use dynocal_calib::map::structured::terms;
use dynocal_export::package::{Package, Provenance, ValidRange};
use dynocal_export::program::{Factor, NodeId, Op, Start, Tau, Term};

use super::Made;
use super::build::Build;

/// Nodes of one reference.
struct Reference {
    name: String,
    /// Filtered and held in the region.
    held: NodeId,
    /// Samples that the present lies behind the newest value: the look-ahead of a demand, none of a given channel.
    late: usize,
    /// Scaled value, its inverse, once they are needed.
    plain: Option<NodeId>,
    inverse: Option<NodeId>,
    /// Delays of them.
    delays: Vec<(NodeId, usize, NodeId)>,
    /// Window differences by offset.
    differences: Vec<(i32, NodeId)>,
}

impl Reference {
    /// Node `of`, `samples` earlier.
    fn delayed(&mut self, b: &mut Build, of: NodeId, what: &str, samples: usize) -> NodeId {
        if samples == 0 {
            return of;
        }
        if let Some(d) = self.delays.iter().find(|d| d.0 == of && d.1 == samples) {
            return d.2;
        }
        let op = Op::Delay { of, samples, start: Start::First };
        let node = b.node(&format!("{}_{what}_{samples}", self.name), op);
        self.delays.push((of, samples, node));
        node
    }

    /// Scaled reference at offset `k` from the present.
    fn plain(&mut self, b: &mut Build, scale: &terms::Scale, k: i32) -> NodeId {
        let op = Op::Scale { of: self.held, gain: 1.0 / scale.unit, offset: -scale.offset / scale.unit };
        let name = format!("{}_scaled", self.name);
        let of = *self.plain.get_or_insert_with(|| b.node(&name, op));
        // What lies ahead of the newest value is not known: the newest stands for it.
        let samples = usize::try_from(self.late as i64 - i64::from(k)).unwrap_or(0);
        self.delayed(b, of, "scaled", samples)
    }

    /// Scaled inverse at present.
    fn inverse(&mut self, b: &mut Build, scale: &terms::Scale) -> NodeId {
        let op = Op::Reciprocal { of: self.held, numerator: scale.unit };
        let name = format!("{}_inverse", self.name);
        let of = *self.inverse.get_or_insert_with(|| b.node(&name, op));
        self.delayed(b, of, "inverse", self.late)
    }

    /// Scaled window difference to offset `k`.
    fn difference(&mut self, b: &mut Build, scale: &terms::Scale, k: i32) -> NodeId {
        if let Some(d) = self.differences.iter().find(|d| d.0 == k) {
            return d.1;
        }
        let (a, now) = (self.plain(b, scale, k), self.plain(b, scale, 0));
        let side = if k < 0 { "before" } else { "ahead" };
        let node = b.node(&format!("d_{}_{}_{side}", self.name, k.abs()), Op::Difference { a, b: now });
        self.differences.push((k, node));
        node
    }
}

/// The map as a program: inputs are its references, outputs its actuators.
pub fn dynamic_map(map: &StructuredMap, sample_time_s: f64) -> Made {
    let mut b = Build::new(sample_time_s);
    let demands = map.ports.demands.len();
    let mut references: Vec<Reference> = Vec::new();
    let mut validity = Vec::new();
    for (c, port) in map.ports.references().enumerate() {
        let range = map.region[c];
        let mut node = b.input(&port.name, &port.unit, range.middle(), Some(range));
        for (k, tau) in map.filter_s.get(c).into_iter().flatten().enumerate() {
            let op = Op::Lag { of: node, tau: Tau::Fixed(*tau) };
            node = b.node(&format!("{}_filter_{}", port.name, k + 1), op);
        }
        let held = b.node(
            &format!("{}_held", port.name),
            Op::Clamp { of: node, lower: range.lower, upper: range.upper },
        );
        references.push(Reference {
            name: port.name.clone(),
            held,
            late: if c < demands { map.look_ahead } else { 0 },
            plain: None,
            inverse: None,
            delays: Vec::new(),
            differences: Vec::new(),
        });
        validity.push(ValidRange {
            channel: port.name.clone(),
            unit: port.unit.clone(),
            lower: range.lower,
            upper: range.upper,
        });
    }
    let products: Vec<Vec<Factor>> =
        map.terms.iter().map(|t| product(&mut b, &mut references, map, t)).collect();
    for (coefficients, port) in map.coefficients.iter().zip(&map.ports.actuators) {
        let term = |(factors, c): (&Vec<Factor>, &f64)| Term { coefficient: *c, factors: factors.clone() };
        let terms = products.iter().zip(coefficients).map(term).collect();
        let raw = b.node(&format!("{}_raw", port.name), Op::Polynomial { terms });
        let limited = Op::Clamp { of: raw, lower: port.lower, upper: port.upper };
        let node = b.node(&format!("{}_limited", port.name), limited);
        b.output(&port.name, &port.unit, node);
    }
    Made {
        package: Package {
            name: "dynamic_map".into(),
            description: "Dynamic map of a calibration".into(),
            provenance: Provenance { validity, ..Default::default() },
            program: Some(b.program),
            ..Default::default()
        },
        notes: Vec::new(),
    }
}

/// Factors of one term; equal ones become a power.
fn product(
    b: &mut Build,
    references: &mut [Reference],
    map: &StructuredMap,
    term: &terms::Term,
) -> Vec<Factor> {
    let mut nodes: Vec<NodeId> = Vec::new();
    if let Some(d) = term.difference {
        nodes.push(references[d.reference].difference(b, &map.scales[d.reference], d.offset));
    }
    for f in &term.factors {
        nodes.push(match *f {
            terms::Factor::Plain(r) => references[r].plain(b, &map.scales[r], 0),
            terms::Factor::Inverse(r) => references[r].inverse(b, &map.scales[r]),
        });
    }
    let mut out: Vec<Factor> = Vec::new();
    for node in nodes {
        match out.iter_mut().find(|f| f.node == node) {
            Some(f) => f.power += 1,
            None => out.push(Factor { node, power: 1 }),
        }
    }
    out
}
