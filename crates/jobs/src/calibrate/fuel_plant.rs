//! Engine and fuelling as one plant: what moves is everything but the injection, which is an output, and lambda is demanded as a speed
//! is given.
//!
//! ```text
//! u = (throttle, spark, ..), d = (speed, demanded lambda)  ->  y = (torque, .., injection)
//! ```
//!
//! Where fuel follows the air, measured lambda says nothing of u any more, and torque no longer depends on an injection that u does not
//! already decide. Excitation, models, design and optimisation of such a campaign are those of any plant, for a problem without the two.

use super::check;
use super::context::Governs;
use super::error::ChainError;
use super::fuel_driven::FuelDriven;
use super::spec::CalibrateSpec;
use dynocal_calib::problem::{GivenChannel, LimitChannel};
use dynocal_files::spec::Faults;
use dynocal_ident::data::Dataset;
use dynocal_ident::plan::demand_name;
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};

/// The spec of the campaign on engine and fuelling as one plant, checked.
///
/// # Errors
/// [`ChainError::Spec`]: keys that name what this plant does not have.
pub(super) fn checked(whole: &CalibrateSpec, by: &Governs) -> Result<CalibrateSpec, ChainError> {
    let s = spec(whole, by);
    let mut faults = Faults::default();
    check::one_plant(&s, &mut faults);
    match faults.first() {
        None => Ok(s),
        Some(f) => Err(ChainError::Spec {
            key: f.key.clone(),
            found: f.found.clone(),
            expected: format!("{}: with `fuelling.plant` {MOVED}", f.expected),
        }),
    }
}

/// What becomes of the channels of the fuelling.
const MOVED: &str = "the injection is an output, and lambda is given (its levels: `excite.ranges`)";

/// The spec of that campaign: the injection is an output within its bounds, the demanded lambda a given channel, its loop the fuelling's.
pub(super) fn spec(whole: &CalibrateSpec, by: &Governs) -> CalibrateSpec {
    let mut s = whole.clone();
    s.fuelling = None;
    s.loops.retain(|l| l.output != by.lambda);
    let problem = &mut s.problem;
    if let Some(k) = problem.inputs.iter().position(|i| i.name == by.injection) {
        let i = problem.inputs.remove(k);
        problem.limits.push(LimitChannel {
            output: i.name,
            unit: i.unit,
            lower: Some(i.lower),
            upper: Some(i.upper),
            mean_upper: None,
            soft_weight: None,
        });
    }
    let name = demand_name(&by.lambda);
    if let Some(k) = problem.demands.iter().position(|d| d.output == by.lambda) {
        let d = problem.demands.remove(k);
        problem.given.push(GivenChannel { name: name.clone(), unit: d.unit, lower: d.lower, upper: d.upper });
    }
    // What is derived from lambda is derived from the one that is asked for, which is held.
    for d in problem.derive.iter_mut().chain(&mut s.identify.derive) {
        if let Some(power) = d.powers.remove(&by.lambda) {
            *d.powers.entry(name.clone()).or_insert(0) += power;
        }
    }
    if let Some(range) = s.excite.ranges.remove(&by.lambda) {
        s.excite.ranges.insert(name, range);
    }
    s.excite.ranges.remove(&by.injection);
    s.excite.start.remove(&by.injection);
    // The comparison is made with the whole problem.
    s.validate.scenario.bands.remove(&by.lambda);
    if let Some(maps) = &mut s.optimise.start_maps {
        maps.axes.entry(by.lambda.clone()).or_insert_with(|| by.lambda.clone());
        maps.axes.values_mut().filter(|v| **v == by.lambda).for_each(|v| *v = demand_name(&by.lambda));
    }
    s
}

/// A record of that plant as a map is taught by it: lambda is what was demanded of it, and the injection is what is applied from a
/// sample on, where an output is what was applied before it.
pub(super) fn as_asked(record: &mut Dataset, by: &Governs) {
    let demanded = record.values(&demand_name(&by.lambda)).map(<[f64]>::to_vec);
    for c in &mut record.channels {
        if c.name == by.injection && !c.values.is_empty() {
            // The last one is held.
            c.values.copy_within(1.., 0);
        }
        if let (true, Ok(demanded)) = (c.name == by.lambda, &demanded) {
            c.values.clone_from(demanded);
        }
    }
}

/// A record of [`as_asked`] as it was played, for models of that plant: the injection that was applied before a sample. What was before the
/// first one is not there any more, and the first is taken for it.
pub(super) fn as_played(record: &Dataset, by: &Governs) -> Dataset {
    let mut out = record.clone();
    if let Some(c) = out.channels.iter_mut().find(|c| c.name == by.injection) {
        let n = c.values.len();
        c.values.copy_within(..n.saturating_sub(1), 1.min(n));
    }
    out
}

/// The plant: inputs without the injection and with the demanded lambda, outputs with the injection.
pub(super) struct FuelledPlant {
    driven: FuelDriven,
    variables: Vec<Variable>,
    /// Place of the injection among the inputs of the engine, and where it begins.
    injection: (usize, f64),
    /// Outputs of the engine.
    outputs: usize,
    inputs: Vec<f64>,
}

/// Most that can be demanded of a lambda.
const MOST_LAMBDA: f64 = 100.0;

impl FuelledPlant {
    /// An engine behind its fuelling, and the lambda that it begins with.
    ///
    /// # Errors
    /// [`PlantError::Call`]: no such injection.
    pub(super) fn new(
        driven: FuelDriven,
        injection: &str,
        lambda: &str,
        begin: f64,
    ) -> Result<Self, PlantError> {
        let of = |causality| driven.variables().iter().filter(move |v| v.causality == causality);
        let mut inputs: Vec<Variable> = of(Causality::Input).cloned().collect();
        let mut outputs: Vec<Variable> = of(Causality::Output).cloned().collect();
        let Some(at) = inputs.iter().position(|v| v.name == injection) else {
            return Err(PlantError::Call(format!("the plant has no input `{injection}`")));
        };
        let engine = (inputs.len(), outputs.len());
        let taken = inputs.remove(at);
        let start = taken.start;
        outputs.push(Variable { causality: Causality::Output, ..taken });
        inputs.push(Variable {
            name: demand_name(lambda),
            unit: "-".into(),
            causality: Causality::Input,
            min: 0.0,
            max: MOST_LAMBDA,
            start: begin,
        });
        let variables = inputs.into_iter().chain(outputs).collect();
        Ok(Self { driven, variables, injection: (at, start), outputs: engine.1, inputs: vec![0.0; engine.0] })
    }

    /// The outputs of the engine, and the place of the injection behind them.
    fn split<'a>(&self, outputs: &'a mut [f64]) -> Result<(&'a mut [f64], &'a mut f64), PlantError> {
        let found = outputs.len();
        match outputs.split_last_mut() {
            Some((last, engine)) if engine.len() == self.outputs => Ok((engine, last)),
            _ => {
                let expected = self.outputs + 1;
                Err(PlantError::Call(format!("{found} outputs asked for: expected {expected}")))
            }
        }
    }
}

impl Plant for FuelledPlant {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }

    fn reset(&mut self, seed: u64) {
        self.driven.reset(seed);
    }

    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let (at, start) = self.injection;
        let Some((lambda, moved)) = inputs.split_last().filter(|(_, m)| m.len() + 1 == self.inputs.len())
        else {
            let (found, expected) = (inputs.len(), self.inputs.len());
            return Err(PlantError::Call(format!("{found} inputs: expected {expected}")));
        };
        if !(*lambda > 0.0 && *lambda <= MOST_LAMBDA) {
            return Err(PlantError::OutOfRange {
                name: self.variables[inputs.len() - 1].name.clone(),
                found: *lambda,
                unit: "-".into(),
                min: 0.0,
                max: MOST_LAMBDA,
                time_s: self.time_s(),
            });
        }
        let (engine, injection) = self.split(outputs)?;
        self.inputs[..at].copy_from_slice(&moved[..at]);
        self.inputs[at] = start;
        self.inputs[at + 1..].copy_from_slice(&moved[at..]);
        self.driven.demand(*lambda);
        self.driven.step(&self.inputs, dt_s, engine)?;
        *injection = self.driven.given(1).first().copied().unwrap_or(start);
        Ok(())
    }

    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        let (engine, injection) = self.split(outputs)?;
        self.driven.outputs(engine)?;
        *injection = self.driven.given(1).first().copied().unwrap_or(self.injection.1);
        Ok(())
    }

    fn time_s(&self) -> f64 {
        self.driven.time_s()
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        self.driven.take_events()
    }

    /// As of [`FuelDriven`]: records are played from a reset.
    fn save(&self) -> PlantState {
        self.driven.save()
    }

    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        self.driven.restore(state)
    }

    fn describe(&self) -> String {
        self.driven.describe()
    }
}

#[cfg(test)]
mod tests {
    use super::super::channels::Channels;
    use super::super::fuel_driven::tests::driven;
    use super::super::spec::{FuelledSpec, StartMaps};
    use super::*;
    use dynocal_ident::data::{Channel, Role};
    use dynocal_ident::derived::Derived;

    fn by() -> Governs {
        Governs { injection: "inj".into(), lambda: "lambda".into(), boost: None }
    }

    /// The injection moves from the inputs to the outputs with its bounds, lambda from the demands to what is given; all that is derived
    /// from them stays, and what is left is a problem like any.
    #[test]
    fn the_problem_of_engine_and_fuelling_is_one_like_any() {
        let mut whole = CalibrateSpec { fuelling: Some(FuelledSpec::default()), ..CalibrateSpec::default() };
        whole.excite.ranges.insert("lambda".into(), (0.92, 1.08));
        whole.excite.start.insert("inj".into(), 10.0);
        let air = Derived {
            name: "air".into(),
            unit: "mg".into(),
            factor: 14.0,
            powers: [("inj".to_string(), 1), ("lambda".to_string(), 1)].into(),
        };
        whole.problem.derive.push(air);
        let s = checked(&whole, &by()).unwrap();
        let channels = Channels::of(&s);
        assert_eq!(channels.inputs, ["spark", "throttle"]);
        assert_eq!((channels.driven, channels.free), (vec![1], vec![0]));
        assert_eq!(channels.given, ["speed", "lambda_demand"]);
        assert_eq!((channels.demands, channels.others), (vec!["torque".into()], vec!["inj".to_string()]));
        let inj = &s.problem.limits[0];
        assert_eq!((inj.lower, inj.upper, inj.soft_weight), (Some(1.0), Some(30.0), None));
        assert_eq!(s.excite.ranges["lambda_demand"], (0.92, 1.08));
        assert_eq!(
            (&s.problem.minimise, &s.problem.derive[0]),
            (&whole.problem.minimise, &whole.problem.derive[0])
        );
        // What reads lambda reads the one that is asked for.
        assert_eq!(
            s.problem.derive[1].powers,
            [("inj".to_string(), 1), ("lambda_demand".to_string(), 1)].into()
        );
        assert!(s.fuelling.is_none() && s.loops.len() == 1 && s.excite.start.is_empty());
    }

    /// Keys of what moved are refused, not taken and forgotten; a model of the injection may be asked for.
    #[test]
    fn keys_of_what_moved_are_refused() {
        let whole = || CalibrateSpec {
            fuelling: Some(FuelledSpec { plant: true, excite: true, ..FuelledSpec::default() }),
            ..CalibrateSpec::default()
        };
        let model = whole().identify.models.values().next().cloned().unwrap_or_default();
        let refused = |change: &dyn Fn(&mut CalibrateSpec)| {
            let mut s = whole();
            change(&mut s);
            checked(&s, &by()).unwrap_err().to_string()
        };
        let text = refused(&|s| {
            s.optimise.ranges.insert("lambda".into(), (0.9, 1.0));
        });
        assert!(text.contains("optimise.ranges = `lambda`") && text.contains("lambda is given"), "{text}");
        let text = refused(&|s| {
            s.identify.models.insert("lambda".into(), model.clone());
        });
        assert!(text.contains("identify.models = `lambda`: expected one of torque, inj"), "{text}");
        let limit = |s: &mut CalibrateSpec| {
            s.problem.limits.push(LimitChannel {
                output: "lambda_demand".into(),
                unit: "-".into(),
                lower: Some(0.9),
                upper: None,
                mean_upper: None,
                soft_weight: None,
            });
        };
        let text = refused(&limit);
        assert!(text.contains("lambda_demand"), "{text}");
        // A band of the comparison is that of the whole problem, an axis of a map that an ECU has may be lambda.
        let mut s = whole();
        s.identify.models.insert("inj".into(), model);
        s.validate.scenario.bands.insert("lambda".into(), 0.01);
        s.optimise.start_maps = Some(StartMaps::default());
        s.optimise.start_maps.iter_mut().for_each(|m| drop(m.axes.insert("phi".into(), "lambda".into())));
        let axes = checked(&s, &by()).unwrap().optimise.start_maps.unwrap().axes;
        assert_eq!(
            (&axes["phi"], &axes["lambda"]),
            (&"lambda_demand".to_string(), &"lambda_demand".to_string())
        );
    }

    /// A map is taught by what lambda was asked to be, and by the injection that is applied from a sample on.
    #[test]
    fn a_map_is_taught_by_what_was_asked() {
        let channel = |name: &str, values: &[f64]| Channel {
            name: name.into(),
            unit: "-".into(),
            role: Role::Output,
            values: values.to_vec(),
        };
        let mut record = Dataset {
            name: "r".into(),
            sample_time_s: 0.04,
            channels: vec![
                channel("lambda_demand", &[0.95, 1.0, 1.05]),
                channel("lambda", &[0.9, 0.97, 1.1]),
                channel("inj", &[10.0, 12.0, 14.0]),
                channel("torque", &[1.0, 2.0, 3.0]),
            ],
            init_samples: 0,
            origin: String::new(),
        };
        as_asked(&mut record, &by());
        assert_eq!(record.values("lambda").unwrap(), [0.95, 1.0, 1.05]);
        assert_eq!(record.values("inj").unwrap(), [12.0, 14.0, 14.0]);
        assert_eq!(record.values("torque").unwrap(), [1.0, 2.0, 3.0]);
        assert_eq!(as_played(&record, &by()).values("inj").unwrap(), [12.0, 12.0, 14.0]);
    }

    /// An engine that takes 10 mg at 40 kPa: the plant takes the demanded lambda in the place of an injection, and shows what that makes of
    /// it; wrong calls are refused with what was expected.
    #[test]
    fn the_plant_takes_a_lambda_and_shows_the_injection() {
        let mut plant = FuelledPlant::new(driven((0.0, 60.0)), "inj", "lambda", 1.0).unwrap();
        let names: Vec<&str> = plant.variables().iter().map(|v| v.name.as_str()).collect();
        assert_eq!(names, ["throttle", "speed", "lambda_demand", "lambda", "map", "inj"]);
        let mut y = [0.0; 3];
        plant.reset(1);
        plant.outputs(&mut y).unwrap();
        assert_eq!(y, [1.0, 40.0, 10.0]);
        plant.step(&[40.0, 2000.0, 0.8], 0.01, &mut y).unwrap();
        assert!((y[2] - 10.0 / 0.8).abs() < 1e-3 && (y[0] - 20.0 / y[2] - 0.01).abs() < 1e-9, "{y:?}");
        plant.step(&[40.0, 2000.0, 1.25], 0.02, &mut y).unwrap();
        assert!((y[2] - 10.0 / 1.25).abs() < 1e-3, "{y:?}");
        let last = y;
        plant.outputs(&mut y).unwrap();
        assert_eq!(y[2], last[2]);
        let text = plant.step(&[40.0, 2000.0, 0.0], 0.01, &mut y).unwrap_err().to_string();
        assert!(text.contains("lambda_demand"), "{text}");
        assert!(plant.step(&[40.0, 2000.0], 0.01, &mut y).unwrap_err().to_string().contains("expected 3"));
        assert!(plant.outputs(&mut [0.0; 2]).unwrap_err().to_string().contains("expected 3"));
        assert!(FuelledPlant::new(driven((0.0, 60.0)), "nothing", "lambda", 1.0).is_err());
    }
}
