//! The observer of a catalyst's oxygen as nodes of a program: [`dynocal_control::oxygen::OxygenObserver`] without its memory.
//!
//! Whether the rear sensor has left its band is a number, 0 or 1: what a branch chooses there is a sum of products here. Sensors that
//! show no number move nothing.

use dynocal_control::oxygen::{LEAST_AIR_G, LEAST_LAMBDA, OXYGEN, OxygenSettings};
use dynocal_export::program::{NodeId, Op, Shape, Start};

use super::build::Build;
use super::controller::{chosen, number, point, term};

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
    let known_1 = later(b, "store_known_1", 0.0);

    // What a sample tells: 1 where lambda before and flow are numbers that can be, and where lambda behind is one as well.
    let lit = step(b, "lambda_before_is", front, LEAST_LAMBDA);
    let moving = number(b, "air_flow_is", flow);
    let finite = number(b, "lambda_before_number", front);
    let told = b.node("front_told", Op::Polynomial { terms: vec![term(1.0, &[lit, finite, moving])] });
    let shown = number(b, "lambda_behind_is", rear);
    let seen = b.node("rear_told", Op::Polynomial { terms: vec![term(1.0, &[told, shown])] });

    let flowing = b.node("air_flowing", Op::Clamp { of: flow, lower: 0.0, upper: 1e6 });
    let slower = b.node("store_slower", Op::Scale { of: flowing, gain: 1.0 / s.half_g_s, offset: 1.0 });
    let capacity = b.node("store_capacity", Op::Reciprocal { of: slower, numerator: s.capacity_g });
    let air = b.node("air_step", Op::Polynomial { terms: vec![term(dt_s, &[told, flowing])] });
    let held = b.node("lambda_held", Op::Clamp { of: front, lower: LEAST_LAMBDA, upper: 1e3 });
    let per = b.node("lambda_inverse", Op::Reciprocal { of: held, numerator: 1.0 });
    let raw = vec![
        term(1.0, &[oxygen_1]),
        term(OXYGEN, &[air]),
        term(-OXYGEN, &[air, per]),
        term(1.0, &[bias_1, air]),
    ];
    let raw = b.node("oxygen_raw", Op::Polynomial { terms: raw });
    // A flow that is no number leaves the store as it is, whatever its capacity then.
    let within = within(b, raw, capacity);
    let inside = chosen(b, "oxygen_now", told, within, oxygen_1);
    let since = b.node("air_since", Op::Polynomial { terms: vec![term(1.0, &[air_1]), term(1.0, &[air])] });

    let off = b.node("rear_off", Op::Scale { of: rear, gain: 1.0, offset: -1.0 });
    let size = b.node("rear_size", Op::Function { of: off, shape: Shape::Abs });
    let beyond = step(b, "rear_beyond", size, s.rear_band);
    let lean = step(b, "rear_lean", off, 0.0);
    let outside = chosen(b, "rear_outside", seen, beyond, outside_1);
    let ended = b.node("rear_ended", Op::Polynomial { terms: vec![term(1.0, &[seen, beyond])] });
    let full = b.node("oxygen_known", Op::Polynomial { terms: vec![term(1.0, &[capacity, lean])] });
    // What the store was thought to hold when it broke through, over the air since it was last known.
    let enough = step(b, "air_enough", since, LEAST_AIR_G);
    let least = b.node("air_since_held", Op::Clamp { of: since, lower: LEAST_AIR_G, upper: 1e12 });
    let inverse = b.node("air_since_inverse", Op::Reciprocal { of: least, numerator: 1.0 });
    let missed = b.node("oxygen_missed", Op::Difference { a: full, b: inside });
    let entering = vec![term(1.0, &[ended]), term(-1.0, &[ended, outside_1])];
    let entering = b.node("rear_entering", Op::Polynomial { terms: entering });
    let counts = b.node("bias_told", Op::Polynomial { terms: vec![term(1.0, &[entering, known_1, enough])] });
    let learnt = vec![term(1.0, &[bias_1]), term(s.learn, &[counts, missed, inverse])];
    let learnt = b.node("oxygen_bias_raw", Op::Polynomial { terms: learnt });
    let most = 2.0 * s.most * OXYGEN;
    let bias = b.node("oxygen_bias", Op::Clamp { of: learnt, lower: -most, upper: most });
    let reset = vec![term(1.0, &[inside]), term(1.0, &[ended, missed])];
    let oxygen = b.node("oxygen", Op::Polynomial { terms: reset });
    let left = vec![term(1.0, &[since]), term(-1.0, &[ended, since])];
    let since = b.node("air_since_known", Op::Polynomial { terms: left });
    let ever = vec![term(1.0, &[known_1]), term(1.0, &[ended]), term(-1.0, &[ended, known_1])];
    let known = b.node("store_known", Op::Polynomial { terms: ever });
    for (last, now) in
        [(oxygen_1, oxygen), (bias_1, bias), (air_1, since), (outside_1, outside), (known_1, known)]
    {
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
