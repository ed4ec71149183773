//! The lag of the strong simple rival, tuned on the run's own models.

use dynocal_calib::map::lagged::LaggedStaticMap;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::map::{FeedforwardMap, Rows};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::validate::Scenario;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::stored::{StoredError, StoredModel};

/// Longest time constant that the line search looks at, in s.
const LONGEST_LAG_S: f64 = 0.6;
/// Its steps.
const STEPS: u32 = 30;

/// The lag in s at which the static map, led by the actuator `leader`, holds the demands but the first best on the steps, by
/// the identified models: the strong simple rival at its best. 0 where no model tells.
///
/// ```text
/// tau = argmin sum_k sum_t |y_k(t) - w_k(t)| / (upper_k - lower_k)          from the first step on
/// ```
pub(super) fn best_lag(
    problem: &CalibrationProblem,
    (map, leader): (&StaticMap, usize),
    steps: &Scenario,
    models: &[&StoredModel],
    sample_time_s: f64,
) -> Result<f64, StoredError> {
    let demand_of = |m: &&&StoredModel| {
        let name = m.user_output().name;
        problem.demands.iter().position(|d| d.output == name).filter(|k| *k > 0)
    };
    let judged: Vec<(usize, &&StoredModel)> =
        models.iter().filter_map(|m| Some((demand_of(&m)?, m))).collect();
    if judged.is_empty() {
        return Ok(0.0);
    }
    let from = steps.switches.get(1).copied().unwrap_or(0);
    let integral = |tau_s: f64| -> Result<f64, StoredError> {
        let lagged = LaggedStaticMap { map, tau_s, leader };
        let drive = lagged.drive(&steps.reference, sample_time_s);
        let record = as_record(problem, &drive, steps, sample_time_s);
        let mut sum = 0.0;
        for (k, m) in &judged {
            let d = &problem.demands[*k];
            for run in m.simulate(&record, None)? {
                let error = |t: usize| (run.y[t] - steps.reference.row(t)[*k]).abs() / (d.upper - d.lower);
                sum += (from..run.y.len()).map(error).sum::<f64>();
            }
        }
        Ok(if sum.is_finite() { sum } else { f64::MAX })
    };
    let mut best = (f64::INFINITY, 0.0);
    for k in 0..=STEPS {
        let tau_s = LONGEST_LAG_S * f64::from(k) / f64::from(STEPS);
        let value = integral(tau_s)?;
        if value < best.0 {
            best = (value, tau_s);
        }
    }
    Ok(best.1)
}

/// Inputs of a scenario as a record without outputs.
fn as_record(problem: &CalibrationProblem, drive: &Rows, scenario: &Scenario, sample_time_s: f64) -> Dataset {
    let demands = problem.demands.len();
    let input = |name: &str, unit: &str, values: Vec<f64>| Channel {
        name: name.into(),
        unit: unit.into(),
        role: Role::Input,
        values,
    };
    let moved = problem.inputs.iter().enumerate().map(|(k, i)| input(&i.name, &i.unit, drive.column(k)));
    let given = problem.given.iter().enumerate();
    let given = given.map(|(k, g)| input(&g.name, &g.unit, scenario.reference.column(demands + k)));
    Dataset {
        name: scenario.name.clone(),
        sample_time_s,
        channels: moved.chain(given).collect(),
        init_samples: 0,
        origin: "map".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::map::static_map::StaticPoint;
    use dynocal_calib::map::{ActuatorPort, Port, Ports};
    use dynocal_ident::model::poly::PolyNarx;
    use dynocal_ident::stored::Quantity;

    const DT_S: f64 = 0.03;

    /// Throttle and injection grow with the torque alone: `throttle = inj = torque / 5`.
    fn map(problem: &CalibrationProblem) -> StaticMap {
        let port = |name: &str, unit: &str| Port { name: name.into(), unit: unit.into() };
        let ports = Ports {
            demands: problem.demands.iter().map(|d| port(&d.output, &d.unit)).collect(),
            given: problem.given.iter().map(|g| port(&g.name, &g.unit)).collect(),
            actuators: problem
                .inputs
                .iter()
                .map(|i| ActuatorPort {
                    name: i.name.clone(),
                    unit: i.unit.clone(),
                    lower: i.lower,
                    upper: i.upper,
                })
                .collect(),
        };
        let (demand, given) = (vec![10.0, 90.0], vec![1000.0, 3000.0]);
        let point = |torque: f64, speed: f64| StaticPoint {
            demand: torque,
            given: speed,
            actuators: vec![torque / 5.0, 15.0, torque / 5.0],
            errors: vec![0.0, 0.0],
            objective: 0.0,
            missed: String::new(),
        };
        let points = demand.iter().flat_map(|d| given.iter().map(|g| point(*d, *g))).collect();
        StaticMap { ports, demand, given, points, bed_s: 0.0 }
    }

    /// `lambda = 1 + (air - inj) / 10`, the air following the throttle with the time constant `tau_s` exactly as a sampled lag
    /// does: it stays at 1 when the injection follows with the same lag, and only then.
    fn engine(tau_s: f64) -> StoredModel {
        let a = (-DT_S / tau_s).exp();
        let terms = ["1", "lambda(t-1)", "throttle(t)", "inj(t)", "inj(t-1)"];
        let model = PolyNarx::parse(&["inj", "throttle"], "lambda", &terms).unwrap();
        let theta = [1.0 - a, a, 0.1 * (1.0 - a), -0.1, 0.1 * a];
        let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
        let inputs = vec![quantity("inj", "mg"), quantity("throttle", "deg")];
        StoredModel::new(model, &theta, inputs, quantity("lambda", "-"), DT_S).unwrap()
    }

    /// Steps of the torque, lambda 1, at one speed.
    fn steps(speed: f64) -> Scenario {
        let torque = |t: usize| [30.0, 70.0, 20.0, 50.0][(t / 100) % 4];
        let mut reference = Rows::new(3);
        (0..400).for_each(|t| reference.push(&[torque(t), 1.0, speed]));
        Scenario { name: "steps".into(), reference, switches: vec![0, 100, 200, 300] }
    }

    /// The tuned lag is that of the plant, whichever it is, to the step of the search; at another speed it is as many engine
    /// cycles. A lag that is written down somewhere would miss all but one.
    #[test]
    fn the_tuned_lag_is_that_of_the_plant() {
        let problem = CalibrationProblem::thesis();
        let map = map(&problem);
        let step_s = LONGEST_LAG_S / f64::from(STEPS);
        for known_s in [0.06, 0.1, 0.15, 0.23, 0.37, 0.5] {
            for speed in [1000.0, 2000.0, 2800.0] {
                let plant = engine(known_s);
                let found = best_lag(&problem, (&map, 2), &steps(speed), &[&plant], DT_S).unwrap();
                let cycles = known_s * speed / 2000.0;
                let near =
                    (found - cycles).abs() <= step_s || (cycles > LONGEST_LAG_S && found == LONGEST_LAG_S);
                assert!(near, "{known_s} s at {speed} rpm: found {found} s, expected {cycles} s");
            }
        }
    }

    /// Without a model of a further demand there is nothing to tune on.
    #[test]
    fn without_a_judge_there_is_no_lag() {
        let problem = CalibrationProblem::thesis();
        assert_eq!(best_lag(&problem, (&map(&problem), 2), &steps(2000.0), &[], DT_S).unwrap(), 0.0);
    }
}
