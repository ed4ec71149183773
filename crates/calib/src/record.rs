//! Running a plant and recording what a bed would record.
//!
//! Sampling convention: row t holds the inputs that are applied from instant t on and the outputs measured at
//! instant t, so that `y(t)` depends on `u(t-1)` and earlier.

use crate::control::{LoopGains, Pi};
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, variable_index};

/// Names and order of the actuators in every record of an engine campaign.
pub const INPUTS: [&str; 4] = ["inj", "spark", "throttle", "speed"];

/// Position of each actuator in [`INPUTS`].
pub const INJ: usize = 0;
/// Spark advance.
pub const SPARK: usize = 1;
/// Throttle angle.
pub const THROTTLE: usize = 2;
/// Engine speed.
pub const SPEED: usize = 3;

/// What a campaign asks of the bed at one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Demanded brake torque in Nm.
    pub torque_nm: f64,
    /// Demanded lambda.
    pub lambda: f64,
}

/// Limits of the actuators that the loops may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorLimits {
    /// Injected fuel in mg.
    pub inj_mg: (f64, f64),
    /// Spark advance in deg BTDC.
    pub spark_deg: (f64, f64),
    /// Throttle angle in deg.
    pub throttle_deg: (f64, f64),
}

/// A plant with the order of its variables resolved, ready for sampled experiments.
pub struct Bed<'a> {
    plant: &'a mut dyn Plant,
    input_index: [usize; 4],
    torque: usize,
    lambda: usize,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
    sample_time_s: f64,
    events: Vec<LimitEvent>,
    used_s: f64,
}

impl<'a> Bed<'a> {
    /// Looks the engine's variables up by name.
    ///
    /// # Errors
    /// [`PlantError::Call`] when the plant lacks one of `inj`, `spark`, `throttle`, `speed`, `torque`, `lambda`.
    pub fn new(plant: &'a mut dyn Plant, sample_time_s: f64) -> Result<Self, PlantError> {
        let mut input_index = [0; 4];
        for (i, name) in INPUTS.iter().enumerate() {
            input_index[i] = variable_index(plant, Causality::Input, name)?;
        }
        let torque = variable_index(plant, Causality::Output, "torque")?;
        let lambda = variable_index(plant, Causality::Output, "lambda")?;
        let of = |c| plant.variables().iter().filter(move |v| v.causality == c);
        let inputs: Vec<f64> = of(Causality::Input).map(|v| v.start).collect();
        let outputs: Vec<f64> = of(Causality::Output).map(|v| v.start).collect();
        Ok(Self {
            plant,
            input_index,
            torque,
            lambda,
            inputs,
            outputs,
            sample_time_s,
            events: Vec::new(),
            used_s: 0.0,
        })
    }

    /// Sample time in s.
    pub fn sample_time_s(&self) -> f64 {
        self.sample_time_s
    }

    /// Back to the plant's start; sensor noise restarts from `seed`.
    pub fn reset(&mut self, seed: u64) {
        self.plant.reset(seed);
    }

    /// Bed seconds used so far, settling included.
    pub fn used_s(&self) -> f64 {
        self.used_s
    }

    /// Limits touched so far.
    pub fn events(&self) -> &[LimitEvent] {
        &self.events
    }

    /// Description of the plant, for the origin of records.
    pub fn describe(&self) -> String {
        self.plant.describe()
    }

    /// Holds the actuators `u` (order of [`INPUTS`]) for one sample; returns torque in Nm and lambda.
    ///
    /// # Errors
    /// [`PlantError`] of the plant.
    pub fn step(&mut self, u: &[f64; 4]) -> Result<(f64, f64), PlantError> {
        for (value, index) in u.iter().zip(self.input_index) {
            self.inputs[index] = *value;
        }
        self.plant.step(&self.inputs, self.sample_time_s, &mut self.outputs)?;
        self.used_s += self.sample_time_s;
        self.events.extend(self.plant.take_events());
        Ok((self.outputs[self.torque], self.outputs[self.lambda]))
    }

    /// Holds `u` until the transient of the start is over, so that a record begins in steady state.
    ///
    /// # Errors
    /// [`PlantError`] of the plant.
    pub fn settle(&mut self, u: &[f64; 4], seconds: f64) -> Result<(f64, f64), PlantError> {
        let n = (seconds / self.sample_time_s).ceil().max(1.0) as usize;
        let mut y = (0.0, 1.0);
        for _ in 0..n {
            y = self.step(u)?;
        }
        Ok(y)
    }
}

/// What is fed to the plant at sample t: feedforward actuators and, with loops, the demand they hold.
pub struct Plan<'a> {
    /// Feedforward actuators, one row per sample, order of [`INPUTS`].
    pub feedforward: &'a [[f64; 4]],
    /// Demand per sample; empty for an open-loop run.
    pub demand: &'a [Demand],
    /// Gains of the loops that hold the demand over the feedforward.
    pub gains: LoopGains,
    /// Limits that loops and feedforward obey.
    pub limits: ActuatorLimits,
    /// Seconds held at the first row before the record starts; the loops are active then too.
    pub settle_s: f64,
}

/// Runs `plan` and records inputs as applied, measured torque and lambda, and the demand as auxiliary channels.
///
/// # Errors
/// [`PlantError`] of the plant; nothing is recorded then.
pub fn run_plan(bed: &mut Bed, name: &str, plan: &Plan) -> Result<Dataset, PlantError> {
    let n = plan.feedforward.len();
    let dt = bed.sample_time_s();
    let (l, closed) = (plan.limits, !plan.demand.is_empty());
    let mut throttle_loop = Pi::new(plan.gains.torque, 0.0, l.throttle_deg.0, l.throttle_deg.1);
    let mut fuel_loop = Pi::new(plan.gains.lambda, 0.0, l.inj_mg.0, l.inj_mg.1);
    let mut actuators = |t: usize, y: (f64, f64)| -> [f64; 4] {
        let ff = plan.feedforward[t];
        let spark = ff[SPARK].clamp(l.spark_deg.0, l.spark_deg.1);
        if closed {
            let d = plan.demand[t];
            let throttle = throttle_loop.step(ff[THROTTLE], d.torque_nm - y.0, dt);
            let inj = fuel_loop.step(ff[INJ], d.lambda - y.1, dt);
            [inj, spark, throttle, ff[SPEED]]
        } else {
            let inj = ff[INJ].clamp(l.inj_mg.0, l.inj_mg.1);
            [inj, spark, ff[THROTTLE].clamp(l.throttle_deg.0, l.throttle_deg.1), ff[SPEED]]
        }
    };
    let mut y = bed.step(&{
        let ff = plan.feedforward[0];
        [
            ff[INJ].clamp(l.inj_mg.0, l.inj_mg.1),
            ff[SPARK].clamp(l.spark_deg.0, l.spark_deg.1),
            ff[THROTTLE].clamp(l.throttle_deg.0, l.throttle_deg.1),
            ff[SPEED],
        ]
    })?;
    for _ in 0..(plan.settle_s / dt).round() as usize {
        let u = actuators(0, y);
        y = bed.step(&u)?;
    }
    let mut columns: Vec<Vec<f64>> = (0..6).map(|_| Vec::with_capacity(n)).collect();
    for t in 0..n {
        let u = actuators(t, y);
        for (column, value) in columns.iter_mut().zip(u.iter().chain([&y.0, &y.1])) {
            column.push(*value);
        }
        y = bed.step(&u)?;
    }
    Ok(assemble(name, bed, columns, plan.demand))
}

fn assemble(name: &str, bed: &Bed, columns: Vec<Vec<f64>>, demand: &[Demand]) -> Dataset {
    let meta = [
        ("inj", "mg", Role::Input),
        ("spark", "deg", Role::Input),
        ("throttle", "deg", Role::Input),
        ("speed", "rpm", Role::Input),
        ("torque", "Nm", Role::Output),
        ("lambda", "-", Role::Output),
    ];
    let mut channels: Vec<Channel> = meta
        .iter()
        .zip(columns)
        .map(|((n, u, r), values)| Channel { name: (*n).into(), unit: (*u).into(), role: *r, values })
        .collect();
    if !demand.is_empty() {
        let aux = |name: &str, unit: &str, values: Vec<f64>| Channel {
            name: name.into(),
            unit: unit.into(),
            role: Role::Auxiliary,
            values,
        };
        channels.push(aux("torque_demand", "Nm", demand.iter().map(|d| d.torque_nm).collect()));
        channels.push(aux("lambda_demand", "-", demand.iter().map(|d| d.lambda).collect()));
    }
    Dataset {
        name: name.into(),
        sample_time_s: bed.sample_time_s(),
        channels,
        init_samples: 0,
        origin: bed.describe(),
    }
}

/// Fuel mass flow of eq. 7.11 in kg/h.
pub fn fuel_kg_h(inj_mg: f64, speed_rpm: f64) -> f64 {
    1.2e-4 * inj_mg * speed_rpm
}

/// Mean fuel flow in kg/h of the rows `from..` of a record.
///
/// # Errors
/// [`dynocal_ident::data::DataError::NoChannel`].
pub fn mean_fuel_kg_h(record: &Dataset, from: usize) -> Result<f64, dynocal_ident::data::DataError> {
    let (inj, speed) = (record.values("inj")?, record.values("speed")?);
    let n = (inj.len() - from) as f64;
    Ok(inj[from..].iter().zip(&speed[from..]).map(|(i, s)| fuel_kg_h(*i, *s)).sum::<f64>() / n)
}
