//! Plans of the engine records of chapter 5: the order of the actuators, and loops that hold torque and lambda.

use super::gains::LoopGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
use dynocal_numerics::interval::Interval;

/// Names and order of the actuators in every record of an engine campaign.
pub const INPUTS: [&str; 4] = ["inj", "spark", "throttle", "speed"];

/// Position of each actuator in [`INPUTS`].
pub const INJ: usize = 0;
/// Spark advance.
pub const SPARK: usize = 1;
/// Throttle angle.
pub const THROTTLE: usize = 2;
/// Engine speed.
pub const SPEED: usize = 3;

/// What a campaign asks of the bed at one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Demanded brake torque in Nm.
    pub torque_nm: f64,
    /// Demanded lambda.
    pub lambda: f64,
}

/// Limits of the actuators that the loops may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorLimits {
    /// Injected fuel in mg.
    pub inj_mg: Interval,
    /// Spark advance in deg BTDC.
    pub spark_deg: Interval,
    /// Throttle angle in deg.
    pub throttle_deg: Interval,
}

/// The plan of today's rows: feedforward in the order of [`INPUTS`] and, where there is a demand, throttle and fuel in
/// loops that hold torque and lambda over it. The plant is held at the first row for `settle_s` and one sample more.
pub fn engine_plan(
    name: &str,
    sample_time_s: f64,
    feedforward: &[[f64; 4]],
    demand: &[Demand],
    gains: LoopGains,
    limits: ActuatorLimits,
    settle_s: f64,
) -> Plan {
    let channel = |i: usize, unit: &str| {
        PlanChannel::free(INPUTS[i], unit, feedforward.iter().map(|row| row[i]).collect())
    };
    let within = |c: PlanChannel, range: Interval| c.within(range.lower, range.upper);
    let channels = vec![
        within(channel(INJ, "mg"), limits.inj_mg),
        within(channel(SPARK, "deg"), limits.spark_deg),
        within(channel(THROTTLE, "deg"), limits.throttle_deg),
        channel(SPEED, "rpm"),
    ];
    let plan = Plan::open_loop(name, sample_time_s, channels)
        .settled(settle_s + sample_time_s)
        .recording(&["torque", "lambda"]);
    if demand.is_empty() {
        return plan;
    }
    let asked = |output: &str, unit: &str, values: Vec<f64>| PlanDemand {
        output: output.into(),
        unit: unit.into(),
        values,
    };
    let demands = vec![
        asked("torque", "Nm", demand.iter().map(|d| d.torque_nm).collect()),
        asked("lambda", "-", demand.iter().map(|d| d.lambda).collect()),
    ];
    let loops = vec![
        PlanLoop::closed("torque", "throttle", gains.torque),
        PlanLoop::closed("lambda", "inj", gains.lambda),
    ];
    plan.with_loops(demands, loops)
}
