//! A model as a plant: to rehearse a campaign before it goes to the bed.

use dynocal_ident::model::{Model, Run};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable, show};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

/// A model with its parameters behind the contract of a plant, with white noise on its measured output.
///
/// ```
/// use dynocal_calib::loops::rehearsal::{Input, ModelPlant};
/// use dynocal_ident::model::poly::PolyNarx;
/// use dynocal_ident::plant::Plant;
/// let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"])?;
/// let u = Input { name: "u".into(), unit: "-".into(), min: 0.0, max: 1.0, start: 0.0 };
/// let mut plant = ModelPlant::new(Box::new(model), vec![1.0, 0.5], "y", vec![u], 0.0)?;
/// let mut y = [0.0];
/// for _ in 0..60 {
///     plant.step(&[1.0], 0.1, &mut y)?;
/// }
/// assert!((y[0] - 2.0).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct ModelPlant {
    model: Box<dyn Model>,
    theta: Vec<f64>,
    variables: Vec<Variable>,
    noise: f64,
    state: State,
}

/// An input of a [`ModelPlant`].
#[derive(Clone, Debug, PartialEq)]
pub struct Input {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Least value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Value after a reset.
    pub start: f64,
}

#[derive(Clone, Debug)]
struct State {
    seed: u64,
    samples: u64,
    time_s: f64,
    /// Past inputs, (L + 1) x m, and outputs, L + 1, the oldest first; the last output is the one to be computed.
    u: Vec<f64>,
    y: Vec<f64>,
}

impl ModelPlant {
    /// `model` at `theta`, inputs in its order, noise of standard deviation `noise` on the measured output.
    ///
    /// # Errors
    /// [`PlantError::Call`] when the numbers of inputs or parameters do not fit the model.
    pub fn new(
        model: Box<dyn Model>,
        theta: Vec<f64>,
        output: &str,
        inputs: Vec<Input>,
        noise: f64,
    ) -> Result<Self, PlantError> {
        if inputs.len() != model.n_inputs() || theta.len() != model.n_params() {
            return Err(PlantError::Call(format!(
                "{} inputs and {} parameters: the model has {} and {}",
                inputs.len(),
                theta.len(),
                model.n_inputs(),
                model.n_params()
            )));
        }
        let mut variables: Vec<Variable> = inputs
            .into_iter()
            .map(|i| Variable {
                name: i.name,
                unit: i.unit,
                causality: Causality::Input,
                min: i.min,
                max: i.max,
                start: i.start,
            })
            .collect();
        variables.push(Variable {
            name: output.into(),
            unit: "-".into(),
            causality: Causality::Output,
            min: f64::MIN,
            max: f64::MAX,
            start: 0.0,
        });
        let state = State { seed: 0, samples: 0, time_s: 0.0, u: Vec::new(), y: Vec::new() };
        let mut plant = Self { model, theta, variables, noise, state };
        plant.reset(0);
        Ok(plant)
    }
}

impl Plant for ModelPlant {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }

    fn reset(&mut self, seed: u64) {
        let rows = self.model.max_lag() + 1;
        let start: Vec<f64> = self.variables[..self.model.n_inputs()].iter().map(|v| v.start).collect();
        self.state = State { seed, samples: 0, time_s: 0.0, u: start.repeat(rows), y: vec![0.0; rows] };
    }

    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let m = self.model.n_inputs();
        if inputs.len() != m || outputs.len() != 1 {
            let (i, o) = (inputs.len(), outputs.len());
            return Err(PlantError::Call(format!("{i} inputs and {o} outputs given: expected {m} and 1")));
        }
        for (v, &found) in self.variables.iter().zip(inputs) {
            let (name, time_s) = (v.name.clone(), self.state.time_s);
            if !found.is_finite() {
                return Err(PlantError::NonFinite { name, time_s });
            }
            if found < v.min || found > v.max {
                let (unit, min, max) = (v.unit.clone(), v.min, v.max);
                return Err(PlantError::OutOfRange { name, found, unit, min, max, time_s });
            }
        }
        let mut next = self.state.clone();
        let lag = next.y.len() - 1;
        // The window moves on by one. Its last row is the instant after the step, where these inputs still stand: a model
        // that reads inputs without delay sees them.
        next.u[lag * m..].copy_from_slice(inputs);
        next.u.rotate_left(m);
        next.u[lag * m..].copy_from_slice(inputs);
        next.y.rotate_left(1);
        let past = next.y.clone();
        let run = Run { u: &next.u, y: &past, start: lag };
        if self.model.simulate(&self.theta, &run, &mut next.y) != Status::Converged {
            return Err(PlantError::NonFinite { name: self.variables[m].name.clone(), time_s: next.time_s });
        }
        next.samples += 1;
        next.time_s += dt_s;
        // A stream per sample makes the position a plain number that can be saved.
        let noise = self.noise * Rng64::stream(next.seed, next.samples).normal();
        outputs[0] = next.y[lag] + noise;
        self.state = next;
        Ok(())
    }

    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        let s = &self.state;
        let noise = if s.samples > 0 { self.noise * Rng64::stream(s.seed, s.samples).normal() } else { 0.0 };
        show(&[s.y[s.y.len() - 1] + noise], outputs)
    }

    fn time_s(&self) -> f64 {
        self.state.time_s
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }

    fn save(&self) -> PlantState {
        let s = &self.state;
        let (high, low) = ((s.seed >> 32) as f64, (s.seed & 0xffff_ffff) as f64);
        let mut numbers = vec![high, low, s.samples as f64, s.time_s];
        numbers.extend(&s.u);
        numbers.extend(&s.y);
        PlantState(numbers)
    }

    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        let (u, y) = (self.state.u.len(), self.state.y.len());
        if state.0.len() != 4 + u + y {
            return Err(PlantError::Call(format!("{} numbers are no state of this plant", state.0.len())));
        }
        let n = &state.0;
        self.state = State {
            seed: ((n[0] as u64) << 32) | n[1] as u64,
            samples: n[2] as u64,
            time_s: n[3],
            u: n[4..4 + u].to_vec(),
            y: n[4 + u..].to_vec(),
        };
        Ok(())
    }

    fn describe(&self) -> String {
        format!("model with {} parameters, noise {}", self.theta.len(), self.noise)
    }
}
