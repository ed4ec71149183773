//! What the engine does between two steady points: steps of one input, steps of the static map, closed loops, random
//! inputs (thesis 3.4, 6.4, 7.2), each reduced to the numbers that the thesis states.

use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::statics::StaticPoint;
use serde::{Deserialize, Serialize};

/// Recording interval of the thesis \[s\].
pub const RECORD_S: f64 = 0.01;

/// Torque and lambda sampled at [`RECORD_S`], the first sample before the change.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// Torque sensor \[Nm\].
    pub torque_nm: Vec<f64>,
    /// Lambda of the exhaust manifold \[-\].
    pub lambda: Vec<f64>,
}

impl Response {
    fn push(&mut self, engine: &VirtualEngine) {
        let y = engine.outputs();
        self.torque_nm.push(y.torque_nm);
        self.lambda.push(y.lambda);
    }

    /// Lowest and highest lambda.
    pub fn lambda_range(&self) -> Interval {
        Interval::spanning(self.lambda.iter().copied())
    }
}

/// Response to `inputs` set at the present instant and held for `time_s`.
///
/// # Errors
/// [`PlantError::Input`], [`PlantError::Diverged`].
pub fn step(engine: &mut VirtualEngine, inputs: Inputs, time_s: f64) -> Result<Response, PlantError> {
    let mut out = Response::default();
    out.push(engine);
    engine.set_inputs(inputs)?;
    for _ in 0..(time_s / RECORD_S).round() as usize {
        engine.advance_time(RECORD_S);
        out.push(engine);
    }
    engine.check_state()?;
    Ok(out)
}

/// 10 to 90 % time \[s\] of a response from its first to its last value: between the first samples past each level.
///
/// ```
/// use dynocal_studies::engine::transients::rise_s;
/// // First-order lag: tau ln 9.
/// let y: Vec<f64> = (0..500).map(|k| 1.0 - (-0.01 * k as f64 / 0.2).exp()).collect();
/// assert!((rise_s(&y, 0.01) - 0.2 * 9f64.ln()).abs() <= 0.01);
/// ```
pub fn rise_s(y: &[f64], sample_time_s: f64) -> f64 {
    let (Some(a), Some(b)) = (y.first(), y.last()) else { return f64::NAN };
    let past = |share: f64| y.iter().position(|v| (v - a) / (b - a) >= share);
    match (past(0.1), past(0.9)) {
        (Some(i), Some(j)) => (j as f64 - i as f64) * sample_time_s,
        _ => f64::NAN,
    }
}

/// Time \[s\] after which `y` stays within `band` of `target`; infinite when it never does.
///
/// ```
/// use dynocal_studies::engine::transients::settling_s;
/// let y = [0.0, 0.5, 1.2, 0.95, 1.02, 1.0];
/// assert!((settling_s(&y, 1.0, 0.1, 0.01) - 0.03).abs() < 1e-12);
/// assert_eq!(settling_s(&y, 2.0, 0.1, 0.01), f64::INFINITY);
/// ```
pub fn settling_s(y: &[f64], target: f64, band: f64, sample_time_s: f64) -> f64 {
    match y.iter().rposition(|v| (v - target).abs() > band) {
        None => 0.0,
        Some(k) if k + 1 == y.len() => f64::INFINITY,
        Some(k) => (k + 1) as f64 * sample_time_s,
    }
}

/// Two PI loops: throttle on torque, fuel on lambda; gains as in thesis eq. (6.1), (7.5): K(s) = (i + p s)/s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PiLoops {
    /// Throttle per torque error: integral \[deg/(Nm s)\] and proportional \[deg/Nm\].
    pub torque: (f64, f64),
    /// Fuel per lambda error (demand minus measured): integral \[mg/s\] and proportional \[mg\].
    pub lambda: (f64, f64),
}

impl PiLoops {
    /// Thesis eq. (6.1): for the static map.
    pub const THESIS_6_1: Self = Self { torque: (0.15, 0.007), lambda: (-20.0, -1.5) };
    /// Thesis eq. (7.5): for identification in closed loop.
    pub const THESIS_7_5: Self = Self { torque: (0.3, 0.7), lambda: (-20.0, -1.5) };

    /// Response to a step of the torque demand to `torque_nm` at lambda 1 from the steady point `from`, in which
    /// `engine` is. Samples every [`RECORD_S`]; integrators stop at the limits of the actuators.
    ///
    /// # Errors
    /// [`PlantError::Input`], [`PlantError::Diverged`].
    pub fn demand_step(
        self,
        engine: &mut VirtualEngine,
        from: &StaticPoint,
        torque_nm: f64,
        time_s: f64,
    ) -> Result<Response, PlantError> {
        let mut u = from.inputs;
        let (mut throttle, mut fuel) = (u.throttle_deg, u.injection_mg);
        let mut out = Response::default();
        out.push(engine);
        for _ in 0..(time_s / RECORD_S).round() as usize {
            let y = engine.outputs();
            let (torque_error, lambda_error) = (torque_nm - y.torque_nm, 1.0 - y.lambda);
            throttle = (throttle + self.torque.0 * torque_error * RECORD_S).clamp(0.0, 90.0);
            fuel = (fuel + self.lambda.0 * lambda_error * RECORD_S).clamp(0.0, 120.0);
            u.throttle_deg = (throttle + self.torque.1 * torque_error).clamp(0.0, 90.0);
            u.injection_mg = (fuel + self.lambda.1 * lambda_error).clamp(0.0, 120.0);
            engine.set_inputs(u)?;
            engine.advance_time(RECORD_S);
            out.push(engine);
        }
        engine.check_state()?;
        Ok(out)
    }
}

/// Independent uniform random inputs, each held for the same time (the thesis' UDRN).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RandomInputs {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Range of fuel \[mg\].
    pub injection_mg: Interval,
    /// Range of spark \[deg BTDC\].
    pub spark_deg: Interval,
    /// Range of throttle \[deg\].
    pub throttle_deg: Interval,
    /// Hold time \[s\].
    pub hold_s: f64,
    /// Sample time \[s\].
    pub sample_time_s: f64,
    /// Lambda above this is read as this.
    pub lambda_cap: f64,
    /// Record length \[s\].
    pub time_s: f64,
    /// Seed.
    pub seed: u64,
}

/// Moments of the outputs under random inputs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// Mean torque \[Nm\].
    pub torque_mean_nm: f64,
    /// Standard deviation of torque \[Nm\].
    pub torque_std_nm: f64,
    /// Variance of lambda \[-\].
    pub lambda_var: f64,
}

impl RandomInputs {
    /// Runs the record and gives the moments of sampled torque and lambda (2 s of run-in left out).
    ///
    /// # Errors
    /// [`PlantError::Input`], [`PlantError::Diverged`].
    pub fn moments(&self, engine: &mut VirtualEngine) -> Result<Moments, PlantError> {
        const RUN_IN_S: f64 = 2.0;
        let mut rng = Rng64::new(self.seed);
        let per_hold = (self.hold_s / self.sample_time_s).round().max(1.0) as usize;
        let samples = (self.time_s / self.sample_time_s).round() as usize;
        let run_in = (RUN_IN_S / self.sample_time_s).round() as usize;
        let (mut torque, mut lambda) = (Vec::with_capacity(samples), Vec::with_capacity(samples));
        for k in 0..samples + run_in {
            if k % per_hold == 0 {
                let mut draw = |range: Interval| rng.uniform_in(range.lower, range.upper);
                engine.set_inputs(Inputs {
                    speed_rpm: self.speed_rpm,
                    injection_mg: draw(self.injection_mg),
                    spark_deg: draw(self.spark_deg),
                    throttle_deg: draw(self.throttle_deg),
                    ..Inputs::default()
                })?;
            }
            engine.advance_time(self.sample_time_s);
            if k >= run_in {
                let y = engine.outputs();
                torque.push(y.torque_nm);
                lambda.push(y.lambda.min(self.lambda_cap));
            }
        }
        engine.check_state()?;
        let (torque_mean_nm, torque_var) = mean_and_variance(&torque);
        let (_, lambda_var) = mean_and_variance(&lambda);
        Ok(Moments { torque_mean_nm, torque_std_nm: torque_var.sqrt(), lambda_var })
    }
}

fn mean_and_variance(y: &[f64]) -> (f64, f64) {
    let n = y.len() as f64;
    let mean = y.iter().sum::<f64>() / n;
    (mean, y.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n)
}
