//! A plant whose lambda is held at a set point by its fuel: to a test it has one input less.
//!
//! Thesis section 4.10 identifies torque against speed, spark and throttle; what holds the mixture meanwhile is a
//! feedforward of fuel from the air that throttle and speed let in, learned on the bed itself, and a small PI loop on
//! the measured lambda, both at a sample time of their own inside the sample of the test.

use dynocal_ident::pi::{Pi, PiGains};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable, variable_index};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::linalg::least_squares;
use serde::{Deserialize, Serialize};

/// How lambda is held.
#[derive(Clone, Debug, PartialEq)]
pub struct HoldSpec {
    /// Set point.
    pub lambda: f64,
    /// Gains of the loop, fuel in mg per unit of lambda.
    pub gains: PiGains,
    /// Sample time of the loop in s; a test's sample time is a whole number of them.
    pub sample_time_s: f64,
    /// Range of speed in rpm over which the feedforward is learned.
    pub speed_rpm: Interval,
    /// Range of throttle in deg.
    pub throttle_deg: Interval,
    /// Filling of the manifold: the feedforward follows throttle and speed with the time constant `filling / speed`,
    /// in s rpm. Zero: at once.
    pub filling_s_rpm: f64,
    /// Time at each point while learning, in s.
    pub settle_s: f64,
}

impl Default for HoldSpec {
    fn default() -> Self {
        Self {
            lambda: 1.0,
            gains: PiGains { ki: -16.0, kp: -3.0 },
            sample_time_s: 0.03,
            speed_rpm: Interval::new(2000.0, 4000.0),
            throttle_deg: Interval::new(2.0, 8.0),
            filling_s_rpm: 300.0,
            settle_s: 4.0,
        }
    }
}

/// Names the held plant needs, and which input it takes away.
const FUEL: &str = "inj";
/// Grid points per axis while learning.
const GRID: usize = 4;

/// Fuel that holds lambda at rest: `speed inj = polynomial of second degree in speed and throttle` (both as shares of
/// their ranges), because the air flow of a nearly choked throttle hardly depends on speed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FuelMap {
    speed: Interval,
    throttle: Interval,
    theta: [f64; 6],
}

impl FuelMap {
    fn terms(&self, speed_rpm: f64, throttle_deg: f64) -> [f64; 6] {
        let (s, t) = (self.speed.share(speed_rpm), self.throttle.share(throttle_deg));
        [1.0, s, t, s * s, s * t, t * t]
    }

    /// Learns the fuel on `plant` at a grid of points, held by the loop alone. The plant is reset before.
    ///
    /// # Errors
    /// [`PlantError`] when the plant lacks a variable or refuses an input, or when the points do not determine the
    /// fuel.
    pub fn learn(plant: Box<dyn Plant>, spec: &HoldSpec) -> Result<Self, PlantError> {
        let blank = Self { speed: spec.speed_rpm, throttle: spec.throttle_deg, theta: [0.0; 6] };
        let mut held = LambdaHeld::new(plant, spec.clone(), blank.clone())?;
        Ok(Self { theta: held.learn_map()?, ..blank })
    }

    fn inj_mg(&self, speed_rpm: f64, throttle_deg: f64) -> f64 {
        let flow: f64 = self.terms(speed_rpm, throttle_deg).iter().zip(&self.theta).map(|(a, b)| a * b).sum();
        flow / speed_rpm
    }
}

/// A plant with inputs `inj`, `throttle`, `speed` (and others) and output `lambda`, behind the same contract without the
/// input `inj`.
pub struct LambdaHeld {
    plant: Box<dyn Plant>,
    spec: HoldSpec,
    map: FuelMap,
    variables: Vec<Variable>,
    fuel: usize,
    speed: usize,
    throttle: usize,
    lambda: usize,
    fuel_range: (f64, f64),
    start: Vec<f64>,
    /// Inputs of the plant inside.
    inputs: Vec<f64>,
    state: LoopState,
}

#[derive(Clone, Copy, Debug)]
struct LoopState {
    integral_mg: f64,
    feedforward_mg: f64,
    lambda: f64,
    /// Mean over the last sample; the start value before the first.
    mean: f64,
}

impl LambdaHeld {
    /// Holds lambda of `plant` with a feedforward learned before ([`FuelMap::learn`]).
    ///
    /// # Errors
    /// [`PlantError`] when the plant lacks a variable.
    pub fn new(plant: Box<dyn Plant>, spec: HoldSpec, map: FuelMap) -> Result<Self, PlantError> {
        let p = plant.as_ref();
        let input = |name| variable_index(p, Causality::Input, name);
        let (fuel, speed, throttle) = (input(FUEL)?, input("speed")?, input("throttle")?);
        let lambda = variable_index(p, Causality::Output, "lambda")?;
        let all = p.variables().to_vec();
        let inputs: Vec<&Variable> = all.iter().filter(|v| v.causality == Causality::Input).collect();
        let start: Vec<f64> = inputs.iter().map(|v| v.start).collect();
        let fuel_range = (inputs[fuel].min, inputs[fuel].max);
        let variables: Vec<Variable> = all.iter().filter(|v| v.name != FUEL).cloned().collect();
        let state = LoopState { integral_mg: 0.0, feedforward_mg: 0.0, lambda: spec.lambda, mean: 0.0 };
        let inputs = start.clone();
        let mut held = Self {
            plant,
            spec,
            map,
            variables,
            fuel,
            speed,
            throttle,
            lambda,
            fuel_range,
            start,
            inputs,
            state,
        };
        held.reset(0);
        Ok(held)
    }

    /// Holds lambda at a grid of points with the loop alone.
    fn learn_map(&mut self) -> Result<[f64; 6], PlantError> {
        let outputs = self.variables.iter().filter(|v| v.causality == Causality::Output).count();
        let (mut rows, mut flow) = (Vec::new(), Vec::new());
        let mut y = vec![0.0; outputs];
        let at = |range: Interval, k: usize| range.lower + range.width() * k as f64 / (GRID - 1) as f64;
        let steps = (self.spec.settle_s / self.spec.sample_time_s).ceil() as usize;
        for i in 0..GRID {
            for k in 0..GRID {
                // There and back, so that neighbouring points follow each other.
                let k = if i % 2 == 0 { k } else { GRID - 1 - k };
                self.inputs[self.speed] = at(self.spec.speed_rpm, i);
                self.inputs[self.throttle] = at(self.spec.throttle_deg, k);
                let mut sum = 0.0;
                for t in 0..steps {
                    self.inner(&mut y)?;
                    sum += if 2 * t >= steps { self.inputs[self.fuel] } else { 0.0 };
                }
                let mean = sum / (steps - steps.div_ceil(2)) as f64;
                let speed = self.inputs[self.speed];
                rows.extend(self.map.terms(speed, self.inputs[self.throttle]));
                flow.push(mean * speed);
            }
        }
        let failed = |e: &dyn std::fmt::Display| PlantError::Call(format!("fuel that holds lambda: {e}"));
        let fit = least_squares(&rows, flow.len(), 6, &flow, 0.0).map_err(|e| failed(&e))?;
        fit.x.try_into().map_err(|_| failed(&"six coefficients expected"))
    }

    /// One sample of the loop.
    fn inner(&mut self, y: &mut [f64]) -> Result<(), PlantError> {
        let dt = self.spec.sample_time_s;
        let speed = self.inputs[self.speed];
        let wanted = self.map.inj_mg(speed, self.inputs[self.throttle]);
        let share = if self.spec.filling_s_rpm > 0.0 {
            1.0 - (-dt * speed / self.spec.filling_s_rpm).exp()
        } else {
            1.0
        };
        self.state.feedforward_mg += share * (wanted - self.state.feedforward_mg);
        // The loop's own limits leave the integral room on both sides of the feedforward.
        let (low, high) = self.fuel_range;
        let mut pi = Pi::new(self.spec.gains, self.state.integral_mg, low, high);
        let inj = pi.step(self.state.feedforward_mg, self.spec.lambda - self.state.lambda, dt);
        self.state.integral_mg = pi.integral();
        self.inputs[self.fuel] = inj;
        self.plant.step(&self.inputs, dt, y)?;
        self.state.lambda = y[self.lambda].clamp(0.5 * self.spec.lambda, 2.0 * self.spec.lambda);
        Ok(())
    }
}

impl Plant for LambdaHeld {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }

    fn reset(&mut self, seed: u64) {
        self.plant.reset(seed);
        self.inputs.copy_from_slice(&self.start);
        let feedforward = self.map.inj_mg(self.start[self.speed], self.start[self.throttle]);
        let lambda = self.spec.lambda;
        let outputs = self.variables.iter().filter(|v| v.causality == Causality::Output);
        let mean = outputs.map(|v| v.start).nth(self.lambda).unwrap_or(lambda);
        self.state = LoopState { integral_mg: 0.0, feedforward_mg: feedforward, lambda, mean };
    }

    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let inner = (dt_s / self.spec.sample_time_s).round();
        if inputs.len() + 1 != self.inputs.len()
            || inner < 1.0
            || (inner * self.spec.sample_time_s - dt_s).abs() > 1e-9
        {
            return Err(PlantError::Call(format!(
                "{} inputs for {dt_s} s: expected {} and a multiple of {} s",
                inputs.len(),
                self.inputs.len() - 1,
                self.spec.sample_time_s
            )));
        }
        let fuel = self.fuel;
        let places = (0..self.inputs.len()).filter(|i| *i != fuel);
        let before = self.inputs.clone();
        places.zip(inputs).for_each(|(i, v)| self.inputs[i] = *v);
        let mut mean = 0.0;
        for k in 0..inner as usize {
            if let Err(e) = self.inner(outputs) {
                if k == 0 {
                    self.inputs = before;
                }
                return Err(e);
            }
            mean += outputs[self.lambda] / inner;
        }
        outputs[self.lambda] = mean;
        self.state.mean = mean;
        Ok(())
    }

    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        self.plant.outputs(outputs)?;
        outputs[self.lambda] = self.state.mean;
        Ok(())
    }

    fn time_s(&self) -> f64 {
        self.plant.time_s()
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        self.plant.take_events()
    }

    fn save(&self) -> PlantState {
        let s = &self.state;
        let mut numbers = vec![s.integral_mg, s.feedforward_mg, s.lambda, s.mean];
        numbers.extend(self.plant.save().0);
        PlantState(numbers)
    }

    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        let [integral_mg, feedforward_mg, lambda, mean, rest @ ..] = &state.0[..] else {
            return Err(PlantError::Call("no state of a plant with held lambda".into()));
        };
        self.plant.restore(&PlantState(rest.to_vec()))?;
        self.state = LoopState {
            integral_mg: *integral_mg,
            feedforward_mg: *feedforward_mg,
            lambda: *lambda,
            mean: *mean,
        };
        Ok(())
    }

    fn describe(&self) -> String {
        format!("{}, lambda held at {} by fuel", self.plant.describe(), self.spec.lambda)
    }
}
