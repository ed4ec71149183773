//! The engine of thesis section 4.10 as a black box: speed, spark and throttle move, lambda is held at 1 by fuel.

use dynocal_design::channel::Channel;
use dynocal_ident::data::Dataset;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::{PolyNarx, Regressor, StructureError};
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_ident::select::pool::products;

use super::known::Sequenced;
use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::bed::TestBed;
use dynocal_calib::loops::lambda_hold::{FuelMap, HoldSpec, LambdaHeld};
use dynocal_calib::loops::model::lack_of_fit;
use dynocal_calib::loops::plan::Structure;
use dynocal_jobs::calibrate::context::PlantFactory;

/// Sample time of the section in s.
pub const SAMPLE_TIME_S: f64 = 0.3;
/// Output that is identified.
pub const OUTPUT: &str = "torque";

/// Plants with held lambda, all with the same learned fuel.
pub struct Engine<'a> {
    plants: PlantFactory<'a>,
    hold: HoldSpec,
    fuel: FuelMap,
    /// Box of the section.
    pub bed: TestBed,
}

impl<'a> Engine<'a> {
    /// Learns the fuel that holds lambda, without noise, once for all plants.
    ///
    /// # Errors
    /// [`PlantError`] of the plant.
    pub fn new(plants: PlantFactory<'a>) -> Result<Self, PlantError> {
        let hold = HoldSpec::default();
        let fuel = FuelMap::learn(plants(false)?, &hold)?;
        let (speed, throttle) = (hold.speed_rpm, hold.throttle_deg);
        let channels = vec![
            Channel::free("speed", speed.lower, speed.upper),
            Channel::free("spark", 10.0, 30.0),
            Channel::free("throttle", throttle.lower, throttle.upper),
        ];
        let bed = TestBed { channels, sample_time_s: SAMPLE_TIME_S, settle_s: 3.0 };
        Ok(Self { plants, hold, fuel, bed })
    }

    /// A plant, with sensor noise or without, at its start with noise of `seed`.
    ///
    /// # Errors
    /// [`PlantError`] of the plant.
    pub fn plant(&self, noise: bool, seed: u64) -> Result<LambdaHeld, PlantError> {
        let mut plant = LambdaHeld::new((self.plants)(noise)?, self.hold.clone(), self.fuel.clone())?;
        plant.reset(seed);
        Ok(plant)
    }

    /// Measures the samples `u` on a fresh plant.
    ///
    /// # Errors
    /// [`LoopError`] of the plant.
    pub fn measure(&self, noise: bool, seed: u64, name: &str, u: &[f64]) -> Result<Dataset, LoopError> {
        self.bed.measure(&mut self.plant(noise, seed)?, name, u)
    }

    /// The affine model (4.52).
    ///
    /// # Errors
    /// Never for this list.
    pub fn affine(&self) -> Result<PolyNarx, StructureError> {
        let mut terms = vec!["1"];
        terms.extend(LAGGED);
        PolyNarx::parse(&self.bed.names(), OUTPUT, &terms)
    }

    /// The affine model followed by all products of second degree of its inputs: what it leaves out.
    ///
    /// # Errors
    /// Never for this list.
    pub fn doubted_affine(&self) -> Result<PolyNarx, StructureError> {
        let mut terms = self.affine()?.regressor_texts();
        let more = self.quadratic()?.regressor_texts();
        terms.extend(more.into_iter().filter(|t| t.contains('*') || t.contains('^')));
        PolyNarx::parse(&self.bed.names(), OUTPUT, &terms)
    }

    /// The same inputs with all products up to the second degree, and the last output: a quadratic NARX.
    ///
    /// # Errors
    /// Never for this list.
    pub fn quadratic(&self) -> Result<PolyNarx, StructureError> {
        let mut terms: Vec<String> = vec!["1".into()];
        for (i, a) in LAGGED.iter().enumerate() {
            terms.push((*a).into());
            terms.extend(
                LAGGED[i..].iter().map(|b| if a == b { format!("{a}^2") } else { format!("{a}*{b}") }),
            );
        }
        terms.push(format!("{OUTPUT}(t-1)"));
        PolyNarx::parse(&self.bed.names(), OUTPUT, &terms)
    }

    /// The quadratic NARX with the third-degree products of the inputs of the last sample: potential terms, which a
    /// design for the quadratic one had better be able to see.
    ///
    /// # Errors
    /// Never for this list.
    pub fn doubted_quadratic(&self) -> Result<PolyNarx, StructureError> {
        let mut terms = self.quadratic()?.regressor_texts();
        let last: Vec<Regressor> = (0..self.bed.channels.len()).map(|i| Regressor::input(i, 1)).collect();
        let names = self.bed.names();
        terms.extend(products(&last, 3).iter().filter(|r| r.degree() == 3).map(|r| r.format(&names, OUTPUT)));
        PolyNarx::parse(&names, OUTPUT, &terms)
    }
}

/// The quadratic NARX on the engine, for sequential design.
pub struct SequencedEngine<'a> {
    /// Engine.
    pub engine: &'a Engine<'a>,
    /// Structure.
    pub model: PolyNarx,
    /// The same with the terms that are in doubt.
    pub doubted: PolyNarx,
    /// Variance of the torque noise in Nm^2.
    pub noise_variance: f64,
}

impl Sequenced for SequencedEngine<'_> {
    fn bed(&self) -> &TestBed {
        &self.engine.bed
    }

    fn structure(&self) -> Structure<'_> {
        Structure { kept: Some(&self.model), ..Structure::new(OUTPUT, &self.doubted) }
    }

    fn criterion(&self, first: &[Dataset]) -> Result<(String, toml::Table), LoopError> {
        let data = self.engine.bed.experiments(first, OUTPUT)?;
        Ok(("mse".into(), doubt(&self.model, &self.doubted, &data)?))
    }

    fn fresh(&self, noise: bool, seed: u64) -> Result<Box<dyn Plant>, PlantError> {
        Ok(Box::new(self.engine.plant(noise, seed)?))
    }

    fn noise_variance(&self) -> f64 {
        self.noise_variance
    }
}

/// Least lack of fit that a structure is suspected of, in units of the noise variance: a short record shows no less.
const LEAST_LACK: f64 = 0.05;

/// Keys of the criterion `mse` for a model `kept` and the same with terms in doubt, from what records show of the lack.
///
/// # Errors
/// [`LoopError`] of an estimation.
pub fn doubt(kept: &PolyNarx, full: &PolyNarx, data: &[Experiment]) -> Result<toml::Table, LoopError> {
    let lack = lack_of_fit(kept, full, data)?.max(LEAST_LACK);
    let left_out = full.n_params() - kept.n_params();
    Ok(toml::Table::from_iter([
        ("left_out".to_string(), toml::Value::Integer(left_out as i64)),
        ("lack".to_string(), toml::Value::Float(lack)),
    ]))
}

/// Lagged inputs of (4.52).
const LAGGED: [&str; 5] = ["speed(t-1)", "speed(t-2)", "spark(t-1)", "throttle(t-1)", "throttle(t-2)"];
