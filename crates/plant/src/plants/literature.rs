//! Published models of real engines as plants: what answers a test is the equation with its printed parameters.
//!
//! | name | equation | inputs | box | output |
//! |---|---|---|---|---|
//! | `torque_4_17` | (4.17) | pulse width, air bleed, speed | (4.16) | torque |
//! | `lambda_4_53` | (4.53) | the same | (4.16) | lambda |
//! | `torque_5_3` | (5.3), (5.4) | air bleed, spark, speed | (5.5) | torque |
//!
//! The plant starts at rest in the middle of its box and advances by the sample time of the equation, 0.1 s. White noise of
//! the published variance lies on the measurement alone, with a stream of its own for each sample.

use crate::plants::{Make, PlantFault, PlantMember, PlantSpec};
use dynocal_ident::model::literature::{LiteratureModel, lambda_4_53, torque_4_17, torque_5_3};
use dynocal_ident::model::{Model, Run};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable, show};
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

/// Name, unit, least and greatest value of a variable.
type Row = (&'static str, &'static str, f64, f64);

/// Box (4.16) with the speeds of section 4.6.
const BOX_4_16: [Row; 3] =
    [("fpw", "us", 2000.0, 6000.0), ("abv", "-", 0.4, 0.6), ("speed", "rpm", 1000.0, 2000.0)];
/// Box (5.5).
const BOX_5_5: [Row; 3] =
    [("abv", "-", 0.42, 0.5), ("spark", "deg", 16.0, 34.0), ("speed", "rpm", 1000.0, 1800.0)];
/// Wide: the noise and every start are inside.
const TORQUE: Row = ("torque", "Nm", -100.0, 300.0);
const LAMBDA: Row = ("lambda", "-", 0.0, 9.99);

/// Row of eq. (4.17).
pub const TORQUE_4_17: PlantMember =
    row("torque_4_17", "Torque of the 1.6 l engine by thesis eq. (4.17), noise variance 80", |_, noise| {
        boxed("torque_4_17", torque_4_17(), &BOX_4_16, TORQUE, noise)
    });
/// Row of eq. (4.53).
pub const LAMBDA_4_53: PlantMember =
    row("lambda_4_53", "Lambda of the 1.6 l engine by thesis eq. (4.53), noise variance 0.04", |_, noise| {
        boxed("lambda_4_53", lambda_4_53(), &BOX_4_16, LAMBDA, noise)
    });
/// Row of eqs. (5.3), (5.4).
pub const TORQUE_5_3: PlantMember = row(
    "torque_5_3",
    "Torque of the 1.6 l engine by thesis eqs. (5.3), (5.4), noise variance 0.5",
    |_, noise| boxed("torque_5_3", torque_5_3(), &BOX_5_5, TORQUE, noise),
);

const fn row(name: &'static str, what: &'static str, make: Make) -> PlantMember {
    PlantMember {
        doc: MemberDoc { name, what, params: &[] },
        check: only_a_name,
        make: Some(make),
        sample_time_s: Some(0.1),
    }
}

/// A published model has no keys.
fn only_a_name(spec: &PlantSpec) -> Vec<PlantFault> {
    let plain = PlantSpec { name: spec.name.clone(), ..PlantSpec::default() };
    if *spec == plain {
        return Vec::new();
    }
    vec![PlantFault::new("plant", "further keys", format!("`name = \"{}\"` alone", spec.name))]
}

/// A published model that answers step by step.
struct LiteraturePlant {
    name: &'static str,
    model: LiteratureModel,
    variables: Vec<Variable>,
    /// Standard deviation of the noise.
    noise: f64,
    seed: u64,
    samples: u64,
    /// Inputs and output of the last samples, oldest first; the last row is the running one.
    u: Vec<f64>,
    y: Vec<f64>,
    /// Where the model rests.
    rest: f64,
}

fn boxed(
    name: &'static str,
    model: LiteratureModel,
    inputs: &[Row],
    output: Row,
    noise: bool,
) -> Result<Box<dyn Plant>, PlantError> {
    Ok(Box::new(LiteraturePlant::new(name, model, inputs, output, noise)?))
}

impl LiteraturePlant {
    /// The plant at rest in the middle of the box, with the published noise or without.
    ///
    /// # Errors
    /// [`PlantError::Call`] when the model does not come to rest there.
    fn new(
        name: &'static str,
        model: LiteratureModel,
        inputs: &[Row],
        output: Row,
        noise: bool,
    ) -> Result<Self, PlantError> {
        let variable = |(name, unit, min, max): Row, causality, start| Variable {
            name: name.to_owned(),
            unit: unit.to_owned(),
            causality,
            min,
            max,
            start,
        };
        let middle: Vec<f64> = inputs.iter().map(|r| 0.5 * (r.2 + r.3)).collect();
        let rest = at_rest(&model, &middle).ok_or_else(|| {
            PlantError::Call(format!("{name} does not come to rest in the middle of its box"))
        })?;
        let mut variables: Vec<Variable> =
            inputs.iter().zip(&middle).map(|(r, m)| variable(*r, Causality::Input, *m)).collect();
        variables.push(variable(output, Causality::Output, rest));
        let noise = if noise { model.noise_variance.sqrt() } else { 0.0 };
        let mut plant =
            Self { name, model, variables, noise, seed: 0, samples: 0, u: Vec::new(), y: Vec::new(), rest };
        plant.reset(0);
        Ok(plant)
    }

    fn inputs(&self) -> usize {
        self.variables.len() - 1
    }

    /// The last output with its noise, a stream a sample; at the start none was measured.
    fn shown(&self) -> f64 {
        let noisy = self.noise > 0.0 && self.samples > 0;
        let noise = if noisy { self.noise * Rng64::stream(self.seed, self.samples).normal() } else { 0.0 };
        self.y.last().unwrap_or(&self.rest) + noise
    }
}

/// Output that the model comes to with constant inputs.
fn at_rest(model: &LiteratureModel, inputs: &[f64]) -> Option<f64> {
    let n = 2000;
    let u: Vec<f64> = inputs.iter().copied().cycle().take(n * inputs.len()).collect();
    let mut y = vec![0.0; n];
    let measured = vec![0.0; n];
    let run = Run { u: &u, y: &measured, start: model.model.max_lag() };
    let status = model.model.simulate(&model.theta, &run, &mut y);
    let last = *y.last()?;
    (status != Status::Diverged && (last - y[n - 100]).abs() <= 1e-9 * last.abs().max(1.0)).then_some(last)
}

impl Plant for LiteraturePlant {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }

    fn reset(&mut self, seed: u64) {
        let rows = self.model.model.max_lag() + 1;
        let m = self.inputs();
        self.u = (0..rows).flat_map(|_| self.variables[..m].iter().map(|v| v.start)).collect();
        self.y = vec![self.rest; rows];
        (self.seed, self.samples) = (seed, 0);
    }

    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let (m, sample_s) = (self.inputs(), self.model.sample_time_s);
        if inputs.len() != m || outputs.len() != 1 {
            let found = (inputs.len(), outputs.len());
            return Err(PlantError::Call(format!("{found:?} inputs and outputs given: expected ({m}, 1)")));
        }
        if (dt_s - sample_s).abs() > 1e-9 {
            let name = self.name;
            return Err(PlantError::Call(format!("sample time {dt_s} s: {name} has {sample_s} s")));
        }
        let time_s = self.time_s();
        for (v, &found) in self.variables.iter().zip(inputs) {
            let (name, unit) = (v.name.clone(), v.unit.clone());
            if !found.is_finite() {
                return Err(PlantError::NonFinite { name, time_s });
            }
            if found < v.min || found > v.max {
                return Err(PlantError::OutOfRange { name, found, unit, min: v.min, max: v.max, time_s });
            }
        }
        self.u.rotate_left(m);
        self.y.rotate_left(1);
        let rows = self.y.len();
        self.u[(rows - 1) * m..].copy_from_slice(inputs);
        let mut y = vec![0.0; rows];
        let run = Run { u: &self.u, y: &self.y, start: rows - 1 };
        self.model.model.simulate(&self.model.theta, &run, &mut y);
        self.y[rows - 1] = y[rows - 1];
        if !y[rows - 1].is_finite() {
            return Err(PlantError::NonFinite { name: self.variables[m].name.clone(), time_s });
        }
        self.samples += 1;
        outputs[0] = self.shown();
        Ok(())
    }

    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        show(&[self.shown()], outputs)
    }

    fn time_s(&self) -> f64 {
        self.samples as f64 * self.model.sample_time_s
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }

    fn save(&self) -> PlantState {
        let halves = [(self.seed >> 32) as f64, (self.seed & 0xffff_ffff) as f64, self.samples as f64];
        PlantState(halves.iter().chain(&self.u).chain(&self.y).copied().collect())
    }

    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        let (n, m) = (self.u.len(), self.y.len());
        if state.0.len() != 3 + n + m {
            let found = state.0.len();
            return Err(PlantError::Call(format!("{found} numbers are no state of {}", self.name)));
        }
        self.seed = ((state.0[0] as u64) << 32) | state.0[1] as u64;
        self.samples = state.0[2] as u64;
        self.u.copy_from_slice(&state.0[3..3 + n]);
        self.y.copy_from_slice(&state.0[3 + n..]);
        Ok(())
    }

    fn describe(&self) -> String {
        let (source, noise) = (self.model.source, self.noise);
        format!(
            "{}: thesis {source}, noise {noise:.3}, dynocal-plant {}",
            self.name,
            env!("CARGO_PKG_VERSION")
        )
    }
}
