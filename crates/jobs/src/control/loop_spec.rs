//! Loops of a spec: what each holds, by what, and within which limits.

use dynocal_control::predictor::TransportFlow;
use dynocal_control::runtime::{ActuatorLimits, PidGains};
use dynocal_files::spec::Faults;
use serde::{Deserialize, Serialize};

/// Most loops.
const MOST: usize = 4;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedLoop {
    output: Option<String>,
    input: Option<String>,
    #[serde(default)]
    extra_delay_s: f64,
    #[serde(default)]
    predictor: bool,
    #[serde(default)]
    filter_s: f64,
    transport_flow: Option<String>,
    transport_flow_nominal: Option<f64>,
    transport_flow_unit: Option<String>,
    lower: Option<f64>,
    upper: Option<f64>,
    rate_per_s: Option<f64>,
    #[serde(default)]
    start: f64,
    step: Option<f64>,
    kp: Option<f64>,
    ki: Option<f64>,
    kd: Option<f64>,
    #[serde(default)]
    derivative: bool,
    derivative_filter_s: Option<f64>,
}

/// One loop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LoopSpec {
    /// What it holds.
    pub output: String,
    /// By what.
    pub input: String,
    /// Delay in s beyond that of the plant (sampled: whole samples).
    pub extra_delay_s: f64,
    /// Whether a Smith predictor stands about that delay.
    pub predictor: bool,
    /// Time constant in s of the filter of its prediction error.
    pub filter_s: f64,
    /// Channel of the flow by which that delay goes, and the flow at which it is `extra_delay_s`.
    pub flow: Option<TransportFlow>,
    /// Limits of the actuator in the file of the controller.
    pub limits: ActuatorLimits,
    /// Actuator before the first step.
    pub start: f64,
    /// How far its input is moved either way in a test that the job makes.
    pub step: Option<f64>,
    /// Gains to be judged as they are; none: the search finds them.
    pub gains: Option<PidGains>,
    /// Whether the search may use a derivative part.
    pub derivative: bool,
    /// Time constant in s of its filter; none: by the search.
    pub derivative_filter_s: Option<f64>,
}

/// Whether a loop has gains.
pub(super) fn gains_given(l: &TypedLoop) -> bool {
    l.kp.is_some() || l.ki.is_some() || l.kd.is_some()
}

/// Whether a loop has a predictor.
pub(super) fn predicts(l: &TypedLoop) -> bool {
    l.predictor
}

/// Checks the tables `[[loops]]`.
pub(super) fn loops(typed: &[TypedLoop], faults: &mut Faults) -> Vec<LoopSpec> {
    if typed.is_empty() || typed.len() > MOST {
        let expected = format!("1 to {} tables [[loops]] with `output` and `input`", MOST);
        faults.push("loops", format!("{} loops", typed.len()), expected);
    }
    let mut out: Vec<LoopSpec> = Vec::new();
    for (k, l) in typed.iter().enumerate() {
        let key = |part: &str| format!("loops[{}].{part}", k + 1);
        let output = faults.required(&key("output"), &l.output, "the channel that the loop holds");
        let input = faults.required(&key("input"), &l.input, "the channel by which it holds it");
        if !(l.extra_delay_s >= 0.0 && l.extra_delay_s.is_finite()) {
            faults.push(&key("extra_delay_s"), l.extra_delay_s, "0 or a positive number, s");
        }
        let gains = gains(l, &key, faults);
        derivative(l, &key, faults);
        let (Some(output), Some(input)) = (output, input) else { continue };
        if out.iter().any(|o| o.output == output || o.input == input) {
            faults.push(
                &key("output"),
                format!("`{output}` by `{input}`"),
                "outputs and inputs that no other loop has",
            );
        }
        if let Some(step) = l.step {
            faults.positive(&key("step"), step, "in the unit of the input");
        }
        let limits = limits(l, k, faults);
        let flow = flow(l, &key, faults);
        let (extra_delay_s, predictor, filter_s, start) = (l.extra_delay_s, l.predictor, l.filter_s, l.start);
        let (step, derivative, derivative_filter_s) = (l.step, l.derivative, l.derivative_filter_s);
        out.push(LoopSpec {
            output,
            input,
            extra_delay_s,
            predictor,
            filter_s,
            flow,
            limits,
            start,
            step,
            gains,
            derivative,
            derivative_filter_s,
        });
    }
    out
}

/// Gains that are given.
fn gains(l: &TypedLoop, key: &dyn Fn(&str) -> String, faults: &mut Faults) -> Option<PidGains> {
    let number = |v: Option<f64>| v.unwrap_or(0.0).is_finite();
    match l.ki {
        None if !gains_given(l) => None,
        Some(ki) if ki.is_finite() && ki != 0.0 && number(l.kp) && number(l.kd) => Some(PidGains {
            kp: l.kp.unwrap_or(0.0),
            ki,
            kd: l.kd.unwrap_or(0.0),
            filter_s: if l.kd.is_some() { l.derivative_filter_s.unwrap_or(0.0) } else { 0.0 },
        }),
        found => {
            let found = found.map_or("nothing".into(), |v| v.to_string());
            let expected =
                "a number other than 0 beside `kp` and `kd` (or none of them: the search finds them)";
            faults.push(&key("ki"), found, expected);
            None
        }
    }
}

/// A delay that goes by a flow belongs to a predictor, and has a flow at which it is the one that is given.
fn flow(l: &TypedLoop, key: &dyn Fn(&str) -> String, faults: &mut Faults) -> Option<TransportFlow> {
    if let (None, Some(unit)) = (&l.transport_flow, &l.transport_flow_unit) {
        faults.push(
            &key("transport_flow"),
            format!("nothing beside the unit {unit}"),
            "the channel of that flow",
        );
    }
    match (&l.transport_flow, l.transport_flow_nominal) {
        (None, None) => None,
        (Some(channel), Some(nominal)) => {
            faults.positive(&key("transport_flow_nominal"), nominal, "in the unit of the flow");
            if !l.predictor {
                faults.push(&key("transport_flow"), channel, "`predictor = true` beside it");
            }
            let unit = l.transport_flow_unit.clone().unwrap_or_else(|| "-".into());
            Some(TransportFlow { channel: channel.clone(), unit, nominal })
        }
        (channel, nominal) => {
            let (missing, found) = match channel {
                Some(_) => ("transport_flow_nominal", "nothing".to_string()),
                None => ("transport_flow", format!("nothing beside {}", nominal.unwrap_or(0.0))),
            };
            faults.push(&key(missing), found, "`transport_flow` and `transport_flow_nominal` together");
            None
        }
    }
}

/// A derivative part is searched or given, and its filter belongs to one.
fn derivative(l: &TypedLoop, key: &dyn Fn(&str) -> String, faults: &mut Faults) {
    if l.derivative && gains_given(l) {
        faults.push(&key("derivative"), "true beside gains", "gains, or a search with `derivative = true`");
    }
    if let Some(filter_s) = l.derivative_filter_s {
        if !(filter_s >= 0.0 && filter_s.is_finite()) {
            faults.push(&key("derivative_filter_s"), filter_s, "0 or a positive number, s");
        } else if !l.derivative && l.kd.is_none() {
            faults.push(&key("derivative_filter_s"), filter_s, "`derivative = true` or `kd` beside it");
        }
    }
}

/// Limits of an actuator; a predictor needs something to predict.
fn limits(l: &TypedLoop, k: usize, faults: &mut Faults) -> ActuatorLimits {
    let key = |part: &str| format!("loops[{}].{part}", k + 1);
    // What is not limited may take any value that a 32-bit ECU can hold.
    let wide = 1e9;
    let (lower, upper) = (l.lower.unwrap_or(-wide), l.upper.unwrap_or(wide));
    if !(lower < upper && lower.is_finite() && upper.is_finite()) {
        faults.push(&key("upper"), format!("{lower} to {upper}"), "a range: `lower` below `upper`");
    } else if !(l.start >= lower && l.start <= upper) {
        faults.push(&key("start"), l.start, format!("a value between {lower} and {upper}"));
    }
    if let Some(rate) = l.rate_per_s {
        faults.positive(&key("rate_per_s"), rate, "per s");
    }
    if l.predictor && !(l.extra_delay_s > 0.0) {
        faults.push(&key("predictor"), "a predictor without `extra_delay_s`", "a delay that it predicts");
    }
    if !(l.filter_s >= 0.0 && l.filter_s.is_finite()) || (l.filter_s > 0.0 && !l.predictor) {
        faults.push(&key("filter_s"), l.filter_s, "0, or with `predictor` a positive number, s");
    }
    ActuatorLimits { lower, upper, rate_per_s: l.rate_per_s }
}

/// Most samples by which a channel may be late: margins resolve every one of them, and what takes seconds at a hundred takes minutes at thousands.
pub(super) const MOST_LATE: f64 = 1000.0;

/// Refuses delays that a test of `length_s` cannot show, or that are too many of its samples.
pub(super) fn within_test(loops: &[LoopSpec], length_s: f64, sample_time_s: f64, faults: &mut Faults) {
    for (k, l) in loops.iter().enumerate() {
        let mut push = |expected: String| {
            let key = format!("loops[{}].extra_delay_s", k + 1);
            faults.push(&key, format!("{} s", l.extra_delay_s), expected);
        };
        if l.extra_delay_s >= length_s {
            push(format!("less than the test lasts ({length_s} s)"));
        } else if l.extra_delay_s > MOST_LATE * sample_time_s {
            push(format!(
                "at most {MOST_LATE} samples of {sample_time_s} s; check its unit, or take longer samples"
            ));
        }
    }
}
