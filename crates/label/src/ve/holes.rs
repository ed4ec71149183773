//! Samples whose state is not known: they are as if they had not been logged.

use super::Log;

/// Samples without a number for speed, load, table value, correction or pulse width, and without a stamp.
pub const REASON: &str = "speed, load, table value, correction or pulse width without a value";

/// The log without such samples, and how many they are. One that is missing says nothing of the engine: what lies between its neighbours
/// is no fuel cut, as long as these are near ([`super::mask::GAP_S`]).
pub fn closed(log: &Log) -> (Log, usize) {
    let known = |k: usize| {
        let numbers = [
            log.time_s[k],
            log.speed_rpm[k],
            log.load[k],
            log.ve[k],
            log.enrichment[k],
            log.pulse_ms[k],
            log.target[k],
        ];
        numbers.iter().all(|v| v.is_finite())
    };
    let keep: Vec<bool> = (0..log.time_s.len()).map(known).collect();
    let lost = keep.iter().filter(|k| !**k).count();
    if lost == 0 {
        return (log.clone(), 0);
    }
    let of = |v: &Vec<f64>| kept(v, &keep);
    let closed = Log {
        name: log.name.clone(),
        time_s: of(&log.time_s),
        speed_rpm: of(&log.speed_rpm),
        load: of(&log.load),
        ve: of(&log.ve),
        enrichment: of(&log.enrichment),
        lambda: of(&log.lambda),
        target: of(&log.target),
        pulse_ms: of(&log.pulse_ms),
        coolant_c: log.coolant_c.as_ref().map(of),
        throttle_rate: log.throttle_rate.as_ref().map(of),
        enriching: log.enriching.as_ref().map(|e| kept(e, &keep)),
    };
    (closed, lost)
}

fn kept<T: Copy>(values: &[T], keep: &[bool]) -> Vec<T> {
    values.iter().zip(keep).filter(|(_, k)| **k).map(|(v, _)| *v).collect()
}
