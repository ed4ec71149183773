//! What is said of the comparison: what is out of reach, and who is better.

use super::super::run::ChainResult;
use super::super::validate_step::ValidateResult;
use dynocal_calib::limits::LimitScore;
use dynocal_calib::map::MapForm;
use dynocal_calib::validate::{DemandScore, MapScore};
use dynocal_report::{significant, with_unit};

/// Share of the saving of the static map's inputs beyond which these are no reference at its best.
const MOST_SHARE: f64 = 1.05;

/// Points that are said one by one.
const MOST_POINTS: usize = 3;

/// Points of a scenario that the map does not reach: which seconds, by how much, which actuator; the worst first.
pub(super) fn out_of_reach(own: &MapScore) -> Option<String> {
    let mut all: Vec<_> = own.unreached.iter().collect();
    let of = |output: &str| own.unreached.iter().filter(|u| u.output == output).count();
    // A leading demand that is missed explains the others.
    all.sort_by(|a, b| {
        let place = |o: &str| own.demands.iter().position(|d| d.output == o);
        place(&a.output).cmp(&place(&b.output)).then(b.error.abs().total_cmp(&a.error.abs()))
    });
    let outputs: Vec<String> = own
        .demands
        .iter()
        .filter(|d| of(&d.output) > 0)
        .map(|d| format!("{} at {}", d.output, of(&d.output)))
        .collect();
    let worst: Vec<String> = all.iter().take(MOST_POINTS).map(|u| u.to_string()).collect();
    (!worst.is_empty()).then(|| {
        format!(
            "In {} the dynamic map does not reach its demands ({} of the points): {}.",
            own.scenario,
            outputs.join(", "),
            worst.join("; ")
        )
    })
}

/// An optimum that saves clearly more than the inputs of the static map: one of the two is not what it seems.
pub(super) fn beyond_reference(v: &ValidateResult) -> Option<String> {
    let share = v.static_on_record.as_ref()?.share_of_saving?;
    (share > MOST_SHARE).then(|| {
        format!(
            "Over the record of the last pass the optimum saves {share:.2} times what the static map's inputs save: they are no reference at their best, or the demands were not held alike."
        )
    })
}

/// What the static map does about a limit that the dynamic map passes, in words.
pub(super) fn of_static(v: &ValidateResult, own: &MapScore, limit: &LimitScore) -> String {
    let rival = v.scores.iter().find(|s| s.scenario == own.scenario && s.map == "static map");
    let same = rival.and_then(|s| s.limits.iter().find(|l| l.output == limit.output && l.of == limit.of));
    match same {
        Some(l) if l.excess > 0.0 => {
            format!("the static map passes it by {}", with_unit(l.excess, 3, &l.unit))
        }
        Some(l) => format!("the static map keeps {} away from it", with_unit(-l.excess, 3, &l.unit)),
        None => "there is no static map to compare".into(),
    }
}

/// What is left of the further demands where a part of the delivered map is another one, in words.
pub(super) fn left_with(part: &str, own: &MapScore, plain: &MapScore) -> Option<String> {
    let one = |(ours, theirs): (&DemandScore, &DemandScore)| {
        let unit = if ours.unit == "-" { "s".to_string() } else { format!("{} s", ours.unit) };
        let (before, after) = (significant(theirs.integral_s, 4), significant(ours.integral_s, 4));
        format!("{before} instead of {after} {unit} of {}", ours.output)
    };
    let all: Vec<String> = own.demands.iter().zip(&plain.demands).skip(1).map(one).collect();
    (!all.is_empty()).then(|| format!("with {part} it would leave {}", all.join(", ")))
}

/// Rivals that are better than the delivered map in the same scenario, in words.
pub(super) fn beaten(v: &ValidateResult, own: &MapScore) -> Vec<String> {
    let rivals = v.scores.iter().filter(|s| s.scenario == own.scenario && s.map != own.map);
    let mut out = Vec::new();
    for rival in rivals {
        for (a, b) in own.demands.iter().zip(&rival.demands).skip(1) {
            if b.integral_s < a.integral_s && b.spike() < a.spike() {
                out.push(format!(
                    "In {} the {} holds {} better than the dynamic map: integral {:.4} against {:.4} s, spike {:.4} against {:.4}.",
                    own.scenario,
                    rival.map,
                    a.output,
                    b.integral_s,
                    a.integral_s,
                    b.spike(),
                    a.spike()
                ));
            }
        }
    }
    out
}

/// The static map's free inputs against the optimum over its own record, in words where they save more.
pub(super) fn static_saves_more(r: &ChainResult, v: &ValidateResult) -> Option<String> {
    let last = r.optimise.as_ref()?.result.passes.last()?;
    let rival = v.static_on_record.as_ref()?;
    let saved = |ratio: f64| 100.0 * (ratio - 1.0);
    (rival.ratio < last.measured_ratio).then(|| {
        format!(
            "Over the record of pass {} the static map's inputs that no loop drives save more than the optimum: {:+.2} against {:+.2} %.",
            last.pass,
            saved(rival.ratio),
            saved(last.measured_ratio)
        )
    })
}

/// Rounding of a table by so much of its range that it is worth a warning.
const ROUNDED: f64 = 0.05;

/// Tables that their resolution moves far.
pub(super) fn rounded_far(r: &ChainResult) -> Vec<String> {
    let Some(i) = &r.invert else { return Vec::new() };
    let MapForm::Tables(map) = i.result.dynamic.form() else { return Vec::new() };
    let rounding = map.steps.iter().flat_map(|s| &s.rounding);
    map.ports
        .actuators
        .iter()
        .zip(rounding)
        .filter(|(_, by)| **by > ROUNDED)
        .map(|(a, by)| {
            format!(
                "The resolution of {} changes what its tables say by up to {} % of their range.",
                a.name,
                significant(100.0 * by, 2)
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::validate::Unreached;

    fn demand(output: &str, unit: &str) -> DemandScore {
        DemandScore {
            output: output.into(),
            unit: unit.into(),
            rms: 0.0,
            mean_error: 0.0,
            integral_s: 0.0,
            offset: 0.0,
            settling_s: 0.0,
            settling_mean_s: 0.0,
            spike_above: 0.0,
            spike_below: 0.0,
        }
    }

    fn missed(output: &str, unit: &str, from_s: f64, error: f64, at_limit: &[&str]) -> Unreached {
        Unreached {
            output: output.into(),
            unit: unit.into(),
            from_s,
            to_s: from_s + 6.0,
            demand: 80.0,
            error,
            at_limit: at_limit.iter().map(|s| (*s).to_string()).collect(),
        }
    }

    /// The leading demand first, its worst point first, with seconds, amount and actuator; nothing where all is reached.
    #[test]
    fn what_is_out_of_reach_is_said_with_seconds_amount_and_actuator() {
        let mut own = MapScore {
            map: "dynamic map".into(),
            scenario: "random operating points".into(),
            demands: vec![demand("torque", "Nm"), demand("lambda", "-")],
            objective: 1.0,
            economy: None,
            economy_equal: None,
            limits: Vec::new(),
            unreached: Vec::new(),
        };
        assert_eq!(out_of_reach(&own), None);
        own.unreached = vec![
            missed("lambda", "-", 6.0, 0.1, &[]),
            missed("torque", "Nm", 12.0, -4.5, &[]),
            missed("torque", "Nm", 18.0, -21.0, &["throttle at its upper limit, 60 deg"]),
        ];
        let words = out_of_reach(&own).unwrap();
        let places: Vec<usize> = [
            "torque at 2, lambda at 1",
            "18.0 to 24.0 s: torque 21.000 Nm below",
            "upper limit, 60 deg",
            "12.0 to 18.0 s",
        ]
        .iter()
        .map(|w| words.find(w).unwrap_or_else(|| panic!("no `{w}` in: {words}")))
        .collect();
        assert!(places.windows(2).all(|p| p[0] < p[1]), "{words}");
    }
}
