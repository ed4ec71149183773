//! How well a map holds its demands by the identified models: what its dynamics are chosen by, and those of its strong simple
//! rival, the lagged static map, alike.

use super::chain::put;
use super::context::Context;
use super::fuel_on_model::FuelOnModel;
use dynocal_calib::map::lagged::LaggedStaticMap;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::map::{FeedforwardMap, Rows};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::validate::{Scenario, demand_steps, random_points};
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::plan::demand_name;
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::rng::Rng64;

/// Longest time constant that the line search looks at, in s.
const LONGEST_LAG_S: f64 = 0.6;
/// Its steps.
const STEPS: u32 = 30;
/// Weight of the leading demand: it decides where the others do not care.
const LEADING: f64 = 0.05;
/// Time at the end of a hold over which a model's own offset is told, in s.
const END_S: f64 = 0.5;
/// Stream of the random points that dynamics are chosen on; those of the comparison are others.
const STREAM: u64 = 401;

/// Models and demands that judge a map.
pub(super) struct OnModels<'a> {
    problem: &'a CalibrationProblem,
    /// Place of the demand and model of it.
    models: Vec<(usize, &'a StoredModel)>,
    scenarios: Vec<Scenario>,
    sample_time_s: f64,
    /// What injects in the place of the map.
    fuel: Option<FuelOnModel<'a>>,
    /// Demand of lambda that the models read, where they are of engine and fuelling as one plant.
    governed: Option<usize>,
    /// Models of what the others read.
    read: Vec<&'a StoredModel>,
}

impl<'a> OnModels<'a> {
    /// Steps as in the comparison, and random points of their own.
    pub(super) fn new(ctx: &'a Context, models: &[&'a StoredModel]) -> Self {
        let (spec, problem, dt) = (&ctx.spec.validate.scenario, &ctx.spec.problem, ctx.spec.sample_time_s);
        let points = random_points(spec, problem, dt, &mut Rng64::stream(ctx.spec.seed, STREAM));
        let plain = Self::over(problem, models, vec![demand_steps(spec, problem, dt), points], dt);
        let Some(by) = ctx.governs() else { return plain };
        let governed = problem.demands.iter().position(|d| d.output == by.lambda);
        let of = |name: &String| models.iter().copied().find(|m| m.user_output().name == *name);
        let read = by.read().filter_map(of).collect();
        Self { governed, read, ..plain }
    }

    fn over(
        problem: &'a CalibrationProblem,
        models: &[&'a StoredModel],
        scenarios: Vec<Scenario>,
        sample_time_s: f64,
    ) -> Self {
        let place = |m: &&'a StoredModel| {
            let name = m.user_output().name;
            problem.demands.iter().position(|d| d.output == name).map(|k| (k, *m))
        };
        let models = models.iter().filter_map(place).collect();
        Self { problem, models, scenarios, sample_time_s, fuel: None, governed: None, read: Vec::new() }
    }

    /// The same with the fuel of another: lambda is no longer the map's to hold, and the leading demand counts as any.
    pub(super) fn fuelled(self, fuel: FuelOnModel<'a>) -> Self {
        let models = self.models.into_iter().filter(|(k, _)| *k != fuel.lambda).collect();
        Self { models, fuel: Some(fuel), ..self }
    }

    /// Whether a demand other than the leading one has a model: the leading one alone says nothing of what follows it, but where that is
    /// lambda and the fuelling's.
    pub(super) fn tells(&self) -> bool {
        self.models.iter().any(|(k, _)| *k > 0 || self.governed.is_some())
    }

    /// Whether the map has to hold the leading demand alone.
    fn leads_alone(&self) -> bool {
        self.fuel.is_some() || self.governed.is_some()
    }

    /// What transients of a map cost by the models:
    ///
    /// ```text
    /// sum_k w_k sum_t |e_k(t) - mean of e_k at the end of the hold| / (upper_k - lower_k),   e_k = y_k - demand_k
    /// ```
    ///
    /// from the first step on; w is 1, and 0.05 for the leading demand as long as the map injects. What a model is off at rest is not the map's. Infinite
    /// where a model runs away.
    pub(super) fn cost(&self, map: &dyn FeedforwardMap) -> f64 {
        let mut sum = 0.0;
        for scenario in &self.scenarios {
            let mut drive = map.drive(&scenario.reference, self.sample_time_s);
            if let Some(fuel) = &self.fuel {
                fuel.inject(&mut drive, &scenario.reference, self.sample_time_s);
            }
            let mut record = as_record(self.problem, &drive, scenario, self.sample_time_s);
            if let Some(k) = self.governed {
                let d = &self.problem.demands[k];
                let (name, unit, role) = (demand_name(&d.output), d.unit.clone(), Role::Input);
                record.channels.push(Channel { name, unit, role, values: scenario.reference.column(k) });
            }
            if self.read.iter().any(|m| put(m, &mut record).is_err()) {
                return f64::INFINITY;
            }
            for (k, model) in &self.models {
                let Ok(runs) = model.simulate(&record, None) else { return f64::INFINITY };
                let d = &self.problem.demands[*k];
                let weight = if *k == 0 && !self.leads_alone() { LEADING } else { 1.0 } / (d.upper - d.lower);
                sum += runs.iter().map(|r| weight * self.moved(scenario, *k, &r.y)).sum::<f64>();
            }
        }
        if sum.is_finite() { sum } else { f64::INFINITY }
    }

    /// Absolute errors of demand `k` about their end in each hold, summed.
    fn moved(&self, scenario: &Scenario, k: usize, y: &[f64]) -> f64 {
        let error = |t: usize| y[t] - scenario.reference.row(t)[k];
        let last = (END_S / self.sample_time_s).round().max(1.0) as usize;
        let ends = scenario.switches.iter().skip(1).copied().chain([y.len()]);
        let holds = scenario.switches.iter().copied().zip(ends).skip(1);
        holds
            .map(|(from, to)| {
                let end = to.saturating_sub(last).max(from);
                let rest = (end..to).map(error).sum::<f64>() / (to - end).max(1) as f64;
                (from..to).map(|t| (error(t) - rest).abs()).sum::<f64>()
            })
            .sum()
    }
}

/// The lag in s at which the static map, led by the actuator `leader`, costs least by the identified models
/// ([`OnModels::cost`]): the strong simple rival at its best. 0 where no model tells.
pub(super) fn best_lag((map, leader): (&StaticMap, usize), judge: &OnModels) -> f64 {
    let mut best = (f64::INFINITY, 0.0);
    for k in (0..=STEPS).filter(|_| judge.tells()) {
        let tau_s = LONGEST_LAG_S * f64::from(k) / f64::from(STEPS);
        let value = judge.cost(&LaggedStaticMap { map, tau_s, leader });
        if value < best.0 {
            best = (value, tau_s);
        }
    }
    best.1
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
    use super::super::channels::ports;
    use super::*;
    use dynocal_calib::map::static_map::StaticPoint;
    use dynocal_ident::model::poly::PolyNarx;
    use dynocal_ident::stored::Quantity;

    const DT_S: f64 = 0.03;

    /// Throttle and injection grow with the torque alone: `throttle = inj = torque / 5`.
    fn map(problem: &CalibrationProblem) -> StaticMap {
        let ports = ports(problem);
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
                let judge = OnModels::over(&problem, &[&plant], vec![steps(speed)], DT_S);
                let found = best_lag((&map, 2), &judge);
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
        let judge = OnModels::over(&problem, &[], vec![steps(2000.0)], DT_S);
        assert!(!judge.tells());
        assert_eq!(best_lag((&map(&problem), 2), &judge), 0.0);
    }
}
