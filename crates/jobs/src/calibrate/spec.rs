//! The spec of a calibration as the user writes it. Every key has a default that works on the virtual engine.

use dynocal_calib::excite::ExciteSpec;
use dynocal_calib::fuel::OptimiseSpec;
use dynocal_calib::map::static_map::StaticSpec;
use dynocal_calib::map::structured::StructuredShape;
use dynocal_calib::validate::ValidateSpec;
pub use dynocal_plant::plants::PlantSpec;
use serde::{Deserialize, Serialize};

/// A whole calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateSpec {
    /// Title of the report.
    pub title: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Control, hold and identification interval in s.
    pub sample_time_s: f64,
    /// The plant.
    pub plant: PlantSpec,
    /// Step 1: excitation.
    pub excite: ExciteSpec,
    /// Step 2: models.
    pub identify: IdentifySpec,
    /// Step 3: optimal test signal.
    pub design: DesignSpec,
    /// Step 4: fuel optimisation.
    pub optimise: ChainOptimiseSpec,
    /// Step 5: inverse map.
    pub invert: InvertSpec,
    /// Step 6: static map and comparison.
    pub validate: ChainValidateSpec,
}

impl Default for CalibrateSpec {
    fn default() -> Self {
        Self {
            title: "Dynamic calibration".into(),
            seed: 1,
            sample_time_s: 0.03,
            plant: PlantSpec::default(),
            excite: ExciteSpec::default(),
            identify: IdentifySpec::default(),
            design: DesignSpec::default(),
            optimise: ChainOptimiseSpec::default(),
            invert: InvertSpec::default(),
            validate: ChainValidateSpec::default(),
        }
    }
}

/// Structures and estimation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IdentifySpec {
    /// Terms of the selected torque model.
    pub torque_terms: usize,
    /// Terms of the selected lambda model (in 1/lambda).
    pub lambda_terms: usize,
    /// Terms that forward selection takes beyond these, for backward elimination to choose from.
    pub surplus_terms: usize,
    /// Ridge of the simulation-error search, relative to the regressors' size.
    pub ridge: f64,
    /// Leading samples of each record that enter no score.
    pub init_samples: usize,
    /// Most cost evaluations of the simulation-error search.
    pub max_evaluations: usize,
}

impl Default for IdentifySpec {
    fn default() -> Self {
        Self {
            torque_terms: 30,
            lambda_terms: 40,
            surplus_terms: 30,
            ridge: 1e-5,
            init_samples: 10,
            max_evaluations: 60,
        }
    }
}

/// The optimal test signal, designed in the reference space: levels of demanded torque, lambda, spark and speed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DesignSpec {
    /// Whether to design at all.
    pub enabled: bool,
    /// Criterion that is minimised (`d`, `ai`, ...); `d` and `ai` are reported.
    pub criterion: String,
    /// Length of the designed record in s.
    pub record_s: f64,
    /// Time in s for which torque, lambda and spark are held.
    pub hold_s: f64,
    /// Time in s from one level to the next: the rate limit, range over this time.
    pub ramp_s: f64,
    /// Time in s between the points of the speed profile, which is linear in between: its rate limit.
    pub speed_point_s: f64,
    /// Limits of the demanded torque in Nm.
    pub torque_nm: (f64, f64),
    /// Limits of the demanded lambda.
    pub lambda: (f64, f64),
    /// Limits of spark advance in deg.
    pub spark_deg: (f64, f64),
    /// Limits of the engine speed in rpm.
    pub speed_rpm: (f64, f64),
    /// Most evaluations of criterion and gradient.
    pub max_evaluations: usize,
}

impl Default for DesignSpec {
    fn default() -> Self {
        Self {
            enabled: true,
            criterion: "d".into(),
            record_s: 60.0,
            hold_s: 3.0,
            ramp_s: 0.3,
            speed_point_s: 3.0,
            torque_nm: (10.0, 90.0),
            lambda: (0.9, 1.1),
            spark_deg: (5.0, 30.0),
            speed_rpm: (1000.0, 3000.0),
            max_evaluations: 300,
        }
    }
}

/// Fuel optimisation in passes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ChainOptimiseSpec {
    /// Passes: optimise, measure, re-identify.
    pub passes: usize,
    /// Length of each record in s.
    pub record_s: f64,
    /// Torque levels of the reference in Nm.
    pub torque_nm: (f64, f64),
    /// Lambda range of the reference.
    pub lambda: (f64, f64),
    /// Hold time of the torque levels in s.
    pub hold_s: f64,
    /// Largest change of spark per sample of the start record, in deg: below the limit of the optimisation, so that
    /// the start is feasible.
    pub start_spark_rate_deg: f64,
    /// The program.
    pub program: OptimiseSpec,
}

impl Default for ChainOptimiseSpec {
    fn default() -> Self {
        Self {
            passes: 2,
            record_s: 60.0,
            torque_nm: (12.0, 88.0),
            lambda: (0.95, 1.05),
            hold_s: 1.5,
            start_spark_rate_deg: 0.8,
            program: OptimiseSpec::default(),
        }
    }
}

/// The inverse map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InvertSpec {
    /// Shape of the structured inverse.
    pub shape: StructuredShape,
    /// Whether the map learns from the re-identified model's simulated output instead of the measured one (better
    /// when sensors are noisy); `auto` decides by the noise of the plant.
    pub pairs: String,
}

impl Default for InvertSpec {
    fn default() -> Self {
        Self { shape: StructuredShape::default(), pairs: "auto".into() }
    }
}

/// Static map and comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ChainValidateSpec {
    /// Grid of the static map.
    pub static_map: StaticSpec,
    /// Scenarios.
    pub scenario: ValidateSpec,
    /// Time constant of the lagged static map at 2000 rpm in s.
    pub lag_s: f64,
}

impl Default for ChainValidateSpec {
    fn default() -> Self {
        Self { static_map: StaticSpec::default(), scenario: ValidateSpec::default(), lag_s: 0.12 }
    }
}
