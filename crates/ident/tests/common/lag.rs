//! A plant that is written in one line: y(t+1) = a y(t) + b u(t).

use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable, show};

/// Inputs beyond this are refused.
const LARGEST: f64 = 1e6;

pub(crate) struct Lag {
    variables: [Variable; 2],
    a: f64,
    b: f64,
    y: f64,
    time_s: f64,
    pub(crate) steps: usize,
}

impl Lag {
    pub(crate) fn new(a: f64, b: f64) -> Self {
        let variable = |name: &str, causality| Variable {
            name: name.into(),
            unit: "-".into(),
            causality,
            min: -LARGEST,
            max: LARGEST,
            start: 0.0,
        };
        let variables = [variable("u", Causality::Input), variable("y", Causality::Output)];
        Self { variables, a, b, y: 0.0, time_s: 0.0, steps: 0 }
    }
}

impl Plant for Lag {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }
    fn reset(&mut self, _seed: u64) {
        (self.y, self.time_s) = (0.0, 0.0);
    }
    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let (found, time_s) = (inputs[0], self.time_s);
        if !(found.abs() <= LARGEST) {
            let (name, unit) = ("u".into(), "-".into());
            return Err(PlantError::OutOfRange { name, found, unit, min: -LARGEST, max: LARGEST, time_s });
        }
        self.y = self.a * self.y + self.b * found;
        self.time_s += dt_s;
        self.steps += 1;
        outputs[0] = self.y;
        Ok(())
    }
    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        show(&[self.y], outputs)
    }
    fn time_s(&self) -> f64 {
        self.time_s
    }
    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }
    fn save(&self) -> PlantState {
        PlantState(vec![self.y, self.time_s])
    }
    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        (self.y, self.time_s) = (state.0[0], state.0[1]);
        Ok(())
    }
    fn describe(&self) -> String {
        "lag".into()
    }
}
