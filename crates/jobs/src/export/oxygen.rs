//! The observer of a catalyst's oxygen as nodes of a program: [`dynocal_control::oxygen::OxygenObserver`] without its memory.
//!
//! Whether the rear sensor has left its band is a number, 0 or 1: what a branch chooses there is a sum of products here. Sensors that
//! show no number move nothing.

use dynocal_control::oxygen::{OXYGEN, OxygenSettings};
use dynocal_export::program::{NodeId, Op, Shape, Start};

use super::build::Build;
use super::controller::{point, term};

/// Steepness of a step between 0 and 1: a rear lambda is told from the edge of its band to a billionth.
const STEEP: f64 = 1e9;

/// Inputs `lambda_before`, `lambda_behind`, `air_flow`; outputs `lambda_trim`, `oxygen_filling`.
pub(super) fn observer(b: &mut Build, s: &OxygenSettings, dt_s: f64) {
    let front = b.input("lambda_before", "-", 1.0, None);
    let rear = b.input("lambda_behind", "-", 1.0, None);
    let flow = b.input("air_flow", "g/s", 0.0, None);
    let later = |b: &mut Build, name: &str, start: f64| {
        b.node(name, Op::Delay { of: 0, samples: 1, start: Start::Value(start) })
    };
    let oxygen_1 = later(b, "oxygen_1", s.target * s.capacity_g);
    let bias_1 = later(b, "oxygen_bias_1", 0.0);
    let air_1 = later(b, "air_since_1", 0.0);
    let outside_1 = later(b, "rear_outside_1", 0.0);

    let flowing = b.node("air_flowing", Op::Clamp { of: flow, lower: 0.0, upper: 1e6 });
    let slower = b.node("store_slower", Op::Scale { of: flowing, gain: 1.0 / s.half_g_s, offset: 1.0 });
    let capacity = b.node("store_capacity", Op::Reciprocal { of: slower, numerator: s.capacity_g });
    let air = b.node("air_step", Op::Scale { of: flowing, gain: dt_s, offset: 0.0 });
    // What is no number is lambda 1: it moves no oxygen.
    let lean = b.node("lambda_above", Op::Scale { of: front, gain: 1.0, offset: -1.0 });
    let lean = b.node("lambda_lean", Op::Clamp { of: lean, lower: 0.0, upper: 1e3 });
    let rich = b.node("lambda_below", Op::Scale { of: front, gain: -1.0, offset: 1.0 });
    let rich = b.node("lambda_rich", Op::Clamp { of: rich, lower: 0.0, upper: 0.999 });
    let sum = vec![term(1.0, &[]), term(1.0, &[lean]), term(-1.0, &[rich])];
    let held = b.node("lambda_held", Op::Polynomial { terms: sum });
    let per = b.node("lambda_inverse", Op::Reciprocal { of: held, numerator: 1.0 });
    let raw = vec![
        term(1.0, &[oxygen_1]),
        term(OXYGEN, &[air]),
        term(-OXYGEN, &[air, per]),
        term(1.0, &[bias_1, air]),
    ];
    let raw = b.node("oxygen_raw", Op::Polynomial { terms: raw });
    let inside = within(b, raw, capacity);
    let since = b.node("air_since", Op::Polynomial { terms: vec![term(1.0, &[air_1]), term(1.0, &[air])] });

    let off = b.node("rear_off", Op::Scale { of: rear, gain: 1.0, offset: -1.0 });
    let size = b.node("rear_size", Op::Function { of: off, shape: Shape::Abs });
    let outside = step(b, "rear_outside", size, s.rear_band);
    let lean = step(b, "rear_lean", off, 0.0);
    let known = b.node("oxygen_known", Op::Polynomial { terms: vec![term(1.0, &[capacity, lean])] });
    // What the store was thought to hold when it broke through, over the air since it was last known.
    let least = b.node("air_since_held", Op::Clamp { of: since, lower: 1e-12, upper: 1e12 });
    let inverse = b.node("air_since_inverse", Op::Reciprocal { of: least, numerator: 1.0 });
    let missed = b.node("oxygen_missed", Op::Difference { a: known, b: inside });
    let entering = vec![term(1.0, &[outside]), term(-1.0, &[outside, outside_1])];
    let entering = b.node("rear_entering", Op::Polynomial { terms: entering });
    let learnt = vec![term(1.0, &[bias_1]), term(s.learn, &[entering, missed, inverse])];
    let bias = b.node("oxygen_bias", Op::Polynomial { terms: learnt });
    let chosen = vec![term(1.0, &[inside]), term(1.0, &[outside, missed])];
    let oxygen = b.node("oxygen", Op::Polynomial { terms: chosen });
    let reset = vec![term(1.0, &[since]), term(-1.0, &[outside, since])];
    let since = b.node("air_since_known", Op::Polynomial { terms: reset });
    for (last, now) in [(oxygen_1, oxygen), (bias_1, bias), (air_1, since), (outside_1, outside)] {
        point(b, last, now);
    }

    let share = b.node("store_inverse", Op::Reciprocal { of: capacity, numerator: 1.0 });
    let filled = b.node("oxygen_share", Op::Polynomial { terms: vec![term(1.0, &[oxygen, share])] });
    let filling = b.node("oxygen_filling_held", Op::Clamp { of: filled, lower: 0.0, upper: 1.0 });
    let wanted = b.node("rear_trim_raw", Op::Scale { of: filling, gain: -s.gain, offset: s.gain * s.target });
    let trim = b.node("rear_trim", Op::Clamp { of: wanted, lower: -s.most, upper: s.most });
    let sum = vec![term(1.0, &[trim]), term(-1.0 / OXYGEN, &[bias])];
    let sum = b.node("lambda_trim_raw", Op::Polynomial { terms: sum });
    let out = b.node("lambda_trim_held", Op::Clamp { of: sum, lower: -2.0 * s.most, upper: 2.0 * s.most });
    b.output("lambda_trim", "-", out);
    b.output("oxygen_filling", "-", filling);
}

/// `min(max(x, 0), most)`, most being a node.
fn within(b: &mut Build, x: NodeId, most: NodeId) -> NodeId {
    let above = b.node("oxygen_positive", Op::Function { of: x, shape: Shape::Relu });
    let over = b.node("oxygen_over", Op::Difference { a: above, b: most });
    let cut = b.node("oxygen_cut", Op::Function { of: over, shape: Shape::Relu });
    b.node("oxygen_inside", Op::Difference { a: above, b: cut })
}

/// 1 where x is above `edge`, else 0.
fn step(b: &mut Build, name: &str, x: NodeId, edge: f64) -> NodeId {
    let steep = b.node(&format!("{name}_steep"), Op::Scale { of: x, gain: STEEP, offset: -edge * STEEP });
    b.node(name, Op::Clamp { of: steep, lower: 0.0, upper: 1.0 })
}
