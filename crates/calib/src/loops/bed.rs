//! Designed records on a plant: which inputs a test moves, how it is sampled, and the run itself.

use dynocal_design::channel::{Channel, Shape};
use dynocal_ident::data::Dataset;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::plan::{Plan, PlanChannel};
use dynocal_ident::plant::{Causality, Plant};
use dynocal_ident::play::{Unwatched, play};

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
    /// [`LoopError::Play`] for an unknown input or one outside the plant's range; [`LoopError::Shape`].
    pub fn measure(&self, plant: &mut dyn Plant, name: &str, u: &[f64]) -> Result<Dataset, LoopError> {
        let m = self.channels.len();
        if u.is_empty() || m == 0 || !u.len().is_multiple_of(m) {
            return Err(LoopError::Shape { what: "samples of a record", found: u.len(), expected: m.max(1) });
        }
        let variables = plant.variables().to_vec();
        // An input that the plant does not have is the player's to refuse.
        let unit = |name: &str| {
            let mut inputs = variables.iter().filter(|v| v.causality == Causality::Input);
            inputs.find(|v| v.name == name).map_or("-", |v| v.unit.as_str())
        };
        let column = |i: usize| u.iter().skip(i).step_by(m).copied().collect();
        let channels = self.channels.iter().enumerate();
        let channels = channels.map(|(i, c)| PlanChannel::free(&c.name, unit(&c.name), column(i))).collect();
        let plan = Plan::open_loop(name, self.sample_time_s, channels).settled(self.settle_s);
        Ok(play(plant, &plan, &mut Unwatched)?.whole()?.record)
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
