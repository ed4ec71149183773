//! The channels of a calibration by their parts: what loops drive, what is free, what is given, what is demanded.

use super::spec::CalibrateSpec;
use dynocal_calib::map::{ActuatorPort, Port, Ports, Rows};
use dynocal_calib::problem::{CalibrationProblem, InputChannel};
use dynocal_ident::data::{DataError, Dataset};

/// Names of the channels of a problem, and which input each loop drives.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// Inputs that may move.
    pub inputs: Vec<String>,
    /// Number of the input that the loop of each demand drives, in the order of the demands.
    pub driven: Vec<usize>,
    /// Numbers of the inputs that no loop drives.
    pub free: Vec<usize>,
    /// Given channels.
    pub given: Vec<String>,
    /// Demanded outputs.
    pub demands: Vec<String>,
    /// Outputs with limits, and others that the objective reads.
    pub others: Vec<String>,
    /// Outputs that the models of all others may read; each of them reads those before it.
    pub read: Vec<String>,
    /// Outputs that are recorded and not modelled: something else than a loop holds each at the given channel of its demand.
    pub watched: Vec<String>,
    /// Derived channels that are minimised: a plant or bed that has a meter for one is asked for it.
    pub meters: Vec<Port>,
    /// What maps read and give.
    pub ports: Ports,
}

fn port(name: &str, unit: &str) -> Port {
    Port { name: name.into(), unit: unit.into() }
}

/// What maps read and give where `problem` is solved.
pub fn ports(problem: &CalibrationProblem) -> Ports {
    let actuator = |i: &InputChannel| ActuatorPort {
        name: i.name.clone(),
        unit: i.unit.clone(),
        lower: i.lower,
        upper: i.upper,
    };
    Ports {
        demands: problem.demands.iter().map(|d| port(&d.output, &d.unit)).collect(),
        given: problem.given.iter().map(|g| port(&g.name, &g.unit)).collect(),
        actuators: problem.inputs.iter().map(actuator).collect(),
    }
}

impl Channels {
    /// Channels of a checked spec.
    pub fn of(spec: &CalibrateSpec) -> Self {
        let problem = &spec.problem;
        let inputs = problem.input_names();
        let place = |name: &String| inputs.iter().position(|i| i == name);
        let driver = |output: &String| spec.loops.iter().find(|l| l.output == *output);
        let driven: Vec<usize> =
            problem.demands.iter().filter_map(|d| driver(&d.output).and_then(|l| place(&l.input))).collect();
        let free = (0..inputs.len()).filter(|k| !driven.contains(k)).collect();
        Self {
            inputs,
            driven,
            free,
            given: problem.given_names(),
            demands: problem.demand_names(),
            others: problem.other_outputs(),
            read: Vec::new(),
            watched: Vec::new(),
            meters: problem.meterable().into_iter().map(|d| port(&d.name, &d.unit)).collect(),
            ports: ports(problem),
        }
    }

    /// Inputs of the plant that a calibration sets: inputs that may move, then given channels.
    pub fn plant_inputs(&self) -> Vec<String> {
        self.inputs.iter().chain(&self.given).cloned().collect()
    }

    /// Outputs that are recorded and modelled: demanded ones first.
    pub fn outputs(&self) -> Vec<String> {
        self.demands.iter().chain(&self.others).cloned().collect()
    }

    /// Outputs that the model of `output` may read.
    pub fn read_by(&self, output: &str) -> &[String] {
        &self.read[..self.read.iter().position(|r| r == output).unwrap_or(self.read.len())]
    }

    /// Measured references of a record (demanded outputs, given channels).
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn references(&self, record: &Dataset) -> Result<Rows, DataError> {
        self.rows(record, &self.ports.reference_names())
    }

    /// Actuators of a record.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn actuators(&self, record: &Dataset) -> Result<Rows, DataError> {
        self.rows(record, &self.inputs)
    }

    /// Any channels of a record as rows.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn rows(&self, record: &Dataset, names: &[String]) -> Result<Rows, DataError> {
        Ok(Rows::from_values(names.len(), record.matrix(names)?))
    }
}
