//! Designed records on a plant: which inputs a test moves, how it is sampled, and the run itself.

use dynocal_design::channel::{Channel, Shape};
use dynocal_ident::data::{Channel as Column, Dataset, Role};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::plant::{Causality, Plant, Variable, variable_index};

use super::LoopError;

/// What a test moves, and how it is sampled. Inputs of the plant that are not named stay at their start values.
#[derive(Clone, Debug, PartialEq)]
pub struct TestBed {
    /// Designed channels (m); their names are inputs of the plant.
    pub channels: Vec<Channel>,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Time at the first row before the record begins, in s.
    pub settle_s: f64,
}

impl TestBed {
    /// Runs the samples `u` (N x m) and records the moved inputs and all outputs of the plant.
    ///
    /// Row t holds the inputs applied from instant t on and the outputs at instant t, so that y(t) depends on u(t-1)
    /// and earlier. The plant goes on from the state it is in.
    ///
    /// # Errors
    /// [`LoopError::Plant`] for an unknown input or one outside the plant's range; [`LoopError::Shape`].
    pub fn measure(&self, plant: &mut dyn Plant, name: &str, u: &[f64]) -> Result<Dataset, LoopError> {
        let m = self.channels.len();
        if u.is_empty() || m == 0 || !u.len().is_multiple_of(m) {
            return Err(LoopError::Shape { what: "samples of a record", found: u.len(), expected: m.max(1) });
        }
        let places = self
            .channels
            .iter()
            .map(|c| variable_index(plant, Causality::Input, &c.name))
            .collect::<Result<Vec<_>, _>>()?;
        let variables = plant.variables().to_vec();
        let of = |c: Causality| variables.iter().filter(move |v| v.causality == c);
        let mut inputs: Vec<f64> = of(Causality::Input).map(|v| v.start).collect();
        let outputs: Vec<&Variable> = of(Causality::Output).collect();
        let mut y: Vec<f64> = outputs.iter().map(|v| v.start).collect();
        let mut columns: Vec<Vec<f64>> = vec![Vec::with_capacity(u.len() / m); m + outputs.len()];
        let settle = (self.settle_s / self.sample_time_s).ceil() as usize;
        for k in 0..settle + u.len() / m {
            let t = k.saturating_sub(settle);
            let row = &u[t * m..(t + 1) * m];
            if k >= settle {
                columns.iter_mut().zip(row.iter().chain(&y)).for_each(|(c, v)| c.push(*v));
            }
            places.iter().zip(row).for_each(|(i, v)| inputs[*i] = *v);
            plant.step(&inputs, self.sample_time_s, &mut y)?;
        }
        let meta = places
            .iter()
            .map(|i| of(Causality::Input).nth(*i))
            .zip(&self.channels)
            .map(|(v, c)| (c.name.clone(), v.map_or_else(|| "-".into(), |v| v.unit.clone()), Role::Input))
            .chain(outputs.iter().map(|v| (v.name.clone(), v.unit.clone(), Role::Output)));
        let channels = meta
            .zip(columns)
            .map(|((name, unit, role), values)| Column { name, unit, role, values })
            .collect();
        Ok(Dataset {
            name: name.into(),
            sample_time_s: self.sample_time_s,
            channels,
            init_samples: 0,
            origin: plant.describe(),
        })
    }

    /// Names of the designed channels.
    pub fn names(&self) -> Vec<String> {
        self.channels.iter().map(|c| c.name.clone()).collect()
    }

    /// The records as models of `output` take them, inputs in the order of the channels.
    ///
    /// # Errors
    /// [`LoopError::Data`] for a missing channel.
    pub fn experiments(&self, records: &[Dataset], output: &str) -> Result<Vec<Experiment>, LoopError> {
        let names = self.names();
        records
            .iter()
            .map(|r| {
                Ok(Experiment {
                    name: r.name.clone(),
                    u: r.matrix(&names)?,
                    y: r.values(output)?.to_vec(),
                    init_samples: r.init_samples,
                    weights: Vec::new(),
                })
            })
            .collect()
    }

    /// Whether the samples `u` keep amplitude, hold and rate of every channel, to `1e-9` of its range.
    pub fn keeps_limits(&self, u: &[f64]) -> bool {
        let m = self.channels.len();
        self.channels.iter().enumerate().all(|(i, c)| {
            let slack = 1e-9 * (c.upper - c.lower);
            let at = |t: usize| u[t * m + i];
            let n = u.len() / m;
            let inside = (0..n).all(|t| at(t) >= c.lower - slack && at(t) <= c.upper + slack);
            let rate = c.rate_per_sample.unwrap_or(f64::INFINITY) + slack;
            let slow = (1..n).all(|t| (at(t) - at(t - 1)).abs() <= rate);
            let held = c.shape != Shape::Hold || (1..n).all(|t| t % c.hold == 0 || at(t) == at(t - 1));
            inside && slow && held
        })
    }
}
