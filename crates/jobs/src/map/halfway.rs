//! Rests half way between those of lines, where the input that holds the demand is steep, or the maps jump.
//!
//! Between two rests of a line the map of a driven input is that of the points, trimmed at either end. Where the input goes steeply over its demand its shape
//! between them is what the maps know least: at 1000 rpm a throttle of `gtdi_2l` takes 19 deg for 100 Nm and 45 for 115, and beside it the maps missed 2.7 and 3.5 % of torque half way
//! (seed 4 and a perturbed engine). So lines rest half way as well where it is expected to be steep:
//!
//! ```text
//! | log(u2 / u1) / log(y2 / y1) | > 2     y1, y2: the demand at values of the axis beside each other; u1, u2: what the map says, as it is by then
//! ```
//!
//! and where a free input goes through more than half of its range from one value to the next: what lies between two optima that are valleys of their own was never measured (a
//! wastegate from 2 to 18 mm between 55 and 70 Nm: 2.7 % at 64 Nm, seed 4).

use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::station::Leg;

use super::drive::Drive;

/// Share of its range that a free input may go through between two neighbouring cells before it is said, and measured between them where lines rest.
pub(super) const JUMP: f64 = 0.5;
/// By how much more, in shares, an input has to move than its demand.
const STEEP: f64 = 2.0;

/// The demand of the first axis, where it is one that a loop holds with an input whose map goes by shares: the loop, and the ends of the input.
pub(super) fn held(layout: &Layout, drives: &[Drive]) -> Option<(usize, [f64; 2])> {
    let (_, l) = layout.leading_demand().filter(|(k, l)| *k == 0 && drives[*l].relative)?;
    let i = &layout.problem.inputs[layout.driven()[l]];
    Some((l, [i.lower, i.upper]))
}

/// Numbers of the nodes (demand, input) from which on to the next the input is steep, and between its `ends` half way.
pub(super) fn steep(nodes: &[(f64, f64)], ends: [f64; 2]) -> Vec<usize> {
    let is = |pair: &[(f64, f64)]| {
        let [(y1, u1), (y2, u2)] = *pair else { return false };
        let middle = 0.5 * (u1 + u2);
        // Not a number where it says nothing: that is not steep.
        ((u2 / u1).ln() / (y2 / y1).ln()).abs() > STEEP && ends[0] < middle && middle < ends[1]
    };
    nodes.windows(2).enumerate().filter(|(_, pair)| is(pair)).map(|(k, _)| k).collect()
}

/// Numbers of the nodes (factors) from which on to the next a free input jumps.
pub(super) fn jumps(layout: &Layout, nodes: &[Vec<f64>]) -> Vec<usize> {
    let free = || layout.axes..layout.factors.len();
    let is = |pair: &[Vec<f64>]| {
        free().any(|i| {
            let f = &layout.factors[i];
            (pair[1][i] - pair[0][i]).abs() > JUMP * (f.upper - f.lower)
        })
    };
    nodes.windows(2).enumerate().filter(|(_, pair)| is(pair)).map(|(k, _)| k).collect()
}

/// Whether a leg ends beside the values of the first axis.
pub(super) fn beside(axis: &[f64], leg: &Leg) -> bool {
    !axis.contains(&leg.to[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::problem::CalibrationProblem;
    use dynocal_calib::steady::layout::{Factor, FactorKind};

    /// A throttle that is nearly open: steep from 100 to 115 Nm, neither below nor where half of it would be past the end, and where nothing is known.
    #[test]
    fn an_input_is_steep_where_it_moves_twice_as_much_as_its_demand() {
        let ends = [2.0, 60.0];
        let nodes = [(70.0, 14.2), (85.0, 16.5), (100.0, 18.9), (115.0, 45.9), (130.0, 58.0), (145.0, 90.0)];
        assert_eq!(steep(&nodes, ends), [2]);
        assert_eq!(steep(&nodes, [2.0, 90.0]), [2, 4]);
        assert_eq!(steep(&[(85.0, f64::NAN), (100.0, 0.0), (115.0, 0.0)], ends), [0; 0]);
        // Of demands below zero, and of an input that falls.
        assert_eq!(steep(&[(-100.0, 30.0), (-90.0, 20.0), (-80.0, 19.0)], ends), [0]);
    }

    /// A wastegate of 2 to 20 mm that goes over from 2 to 18, beside a cam that moves less than half of its way.
    #[test]
    fn maps_jump_where_a_free_input_goes_through_half_of_its_range() {
        let factor = |name: &str, ends: [f64; 2], kind: FactorKind| Factor {
            name: name.into(),
            unit: String::new(),
            lower: ends[0],
            upper: ends[1],
            kind,
        };
        let layout = Layout {
            problem: CalibrationProblem::thesis(),
            loops: Vec::new(),
            factors: vec![
                factor("torque", [0.0, 90.0], FactorKind::Demand(0)),
                factor("wastegate", [2.0, 20.0], FactorKind::Free(0)),
                factor("cam", [215.0, 255.0], FactorKind::Free(1)),
            ],
            axes: 1,
            held: std::collections::BTreeMap::new(),
            responses: Vec::new(),
            sample_time_s: 0.1,
        };
        let nodes = [[40.0, 2.0, 215.0], [55.0, 2.5, 230.0], [70.0, 18.0, 245.0], [85.0, 20.0, 224.9]];
        assert_eq!(jumps(&layout, &nodes.map(Vec::from)), [1, 2]);
        assert_eq!(jumps(&layout, &nodes[..2].iter().map(|n| n.to_vec()).collect::<Vec<_>>()), [0; 0]);
    }

    #[test]
    fn a_leg_ends_at_a_value_of_the_axis_or_beside_it() {
        let leg = |to: f64| Leg { to: vec![to], driven: Vec::new(), gains: Vec::new(), seconds: 1.0 };
        assert!(beside(&[40.0, 60.0], &leg(50.0)) && !beside(&[40.0, 60.0], &leg(60.0)));
    }
}
