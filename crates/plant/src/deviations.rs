//! What makes an engine differ from the ideal one: cycles that scatter, cylinders that differ, walls that warm up.

use crate::combustion::flame_slowness;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

/// Scatter of the burn from cycle to cycle, independent between cycles and cylinders.
///
/// Cycle n of cylinder c burns the share `1 + heat z1` of its burnable fuel with delay and duration times
/// `1 + burn z2`; z1 and z2 are standard normal numbers cut at three standard deviations. At the best spark the
/// work hardly depends on the duration, so the coefficient of variation of the indicated work is that of the heat.
/// Real engines: COV of IMEP of 1 to 2 % at load, more when dilute (Heywood 1988, 9.4). With `dilution` d above 0 both
/// go with the d-th power of how much slower the flame is than at lambda 1 with a tenth of burned gas
/// ([`flame_slowness`]), [`WIDEST`] times at most: an assumption, no print was found that its value follows from.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scatter {
    /// Coefficient of variation of the heat released \[-\].
    pub heat: f64,
    /// Coefficient of variation of delay and duration \[-\].
    pub burn: f64,
    /// Exponent d of the slowness of the flame by which both grow \[-\]; 0: they are the same for every charge.
    pub dilution: f64,
}

/// Most by which dilution multiplies the scatter.
pub const WIDEST: f64 = 6.0;

/// Scales of one cycle of one cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleScale {
    /// Of the burnable fuel.
    pub heat: f64,
    /// Of delay and duration of the burn.
    pub burn: f64,
}

impl Scatter {
    /// Scales of cycle `cycle` of cylinder `cylinder` (0..3): a function of its arguments alone, so that a restored
    /// engine continues with the same cycles.
    ///
    /// ```
    /// use dynocal_plant::deviations::Scatter;
    /// let s = Scatter { heat: 0.01, burn: 0.05, dilution: 0.0 };
    /// assert_eq!(s.cycle(7, 12, 3), s.cycle(7, 12, 3));
    /// assert_ne!(s.cycle(7, 12, 3), s.cycle(8, 12, 3));
    /// assert_eq!(Scatter::default().cycle(7, 12, 3).heat, 1.0);
    /// ```
    pub fn cycle(&self, seed: u64, cycle: u64, cylinder: usize) -> CycleScale {
        if self.heat == 0.0 && self.burn == 0.0 {
            return CycleScale { heat: 1.0, burn: 1.0 };
        }
        let mut rng = Rng64::stream(seed ^ SCATTER, 4 * cycle + cylinder as u64);
        let mut scale = |share: f64| 1.0 + share * rng.normal().clamp(-3.0, 3.0);
        CycleScale { heat: scale(self.heat).max(0.0), burn: scale(self.burn).max(0.2) }
    }

    /// The scatter of a charge of this mixture and share of burned gas.
    #[must_use]
    pub fn of_charge(&self, lambda: f64, residual: f64) -> Self {
        if self.dilution == 0.0 {
            return *self;
        }
        let wider = flame_slowness(lambda, residual).powf(self.dilution).min(WIDEST);
        Self { heat: wider * self.heat, burn: wider * self.burn, ..*self }
    }
}

/// How the gross work of one cylinder varies from cycle to cycle, over about the last [`MEMORY`] cycles.
///
/// The variance is half the mean square of the difference of successive cycles (von Neumann, Kent, Bellinson and Hart, Annals of
/// Mathematical Statistics 12, 1941): what goes slowly, as on a ramp of load, is no variation from cycle to cycle. Both means
/// forget exponentially once `MEMORY` cycles were seen.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Variation {
    /// Mean gross work \[J\].
    pub mean_j: f64,
    /// Mean square of the difference of successive cycles \[J2\].
    pub square_j2: f64,
    /// Cycles seen, [`MEMORY`] at most.
    pub cycles: f64,
}

/// Cycles over which a variation is averaged.
pub const MEMORY: f64 = 50.0;

impl Variation {
    /// A cycle of gross work `now_j`, the one before of `before_j`.
    pub(crate) fn cycle(&mut self, now_j: f64, before_j: f64) {
        // The first cycle of an engine has none before it.
        if before_j == 0.0 {
            return;
        }
        self.cycles = (self.cycles + 1.0).min(MEMORY);
        let share = 1.0 / self.cycles;
        self.mean_j += share * (now_j - self.mean_j);
        self.square_j2 += share * ((now_j - before_j).powi(2) - self.square_j2);
    }

    /// Coefficient of variation \[-\]; 0 before two cycles, infinite without work.
    ///
    /// ```
    /// use dynocal_plant::deviations::Variation;
    /// let v = Variation { mean_j: 500.0, square_j2: 2.0 * 10.0 * 10.0, cycles: 50.0 };
    /// assert!((v.coefficient() - 0.02).abs() < 1e-12);
    /// ```
    pub fn coefficient(&self) -> f64 {
        if self.cycles == 0.0 {
            return 0.0;
        }
        if self.mean_j > 0.0 { (0.5 * self.square_j2).sqrt() / self.mean_j } else { f64::INFINITY }
    }
}

/// Keeps the cycles apart from the sensor noise of the same seed.
const SCATTER: u64 = 0x5ca7_7e12_0000_0000;

/// Everything in which an engine differs from the ideal one; set from outside, between steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviations {
    /// Seed of the scatter.
    pub seed: u64,
    /// Scatter from cycle to cycle.
    pub scatter: Scatter,
    /// Injected fuel of each cylinder over the demand \[-\].
    pub fuel_share: [f64; 4],
    /// Delay and duration of the burn of each cylinder over the model's \[-\].
    pub burn_share: [f64; 4],
    /// Wall temperature of the cylinders \[K\] in place of the parameter.
    pub cylinder_wall_k: Option<f64>,
    /// Coolant \[K\]: that of a cold engine cools its exhaust ports more.
    pub coolant_k: Option<f64>,
    /// Wall of the exhaust manifold \[K\] where it is followed; otherwise it is at rest ([`crate::exhaust_wall`]).
    pub manifold_wall_k: Option<f64>,
    /// Friction over that of the warm engine \[-\].
    pub friction_factor: f64,
    /// Time constant of the fuel film over that of the warm engine \[-\].
    pub film_factor: f64,
    /// Octane number of the fuel in place of the parameter.
    pub octane: Option<f64>,
}

impl Default for Deviations {
    /// None: the ideal engine.
    fn default() -> Self {
        Self {
            seed: 0,
            scatter: Scatter::default(),
            fuel_share: [1.0; 4],
            burn_share: [1.0; 4],
            cylinder_wall_k: None,
            coolant_k: None,
            manifold_wall_k: None,
            friction_factor: 1.0,
            film_factor: 1.0,
            octane: None,
        }
    }
}

impl Deviations {
    /// Cylinders that differ: fuel and burn of each drawn with a standard deviation of `fuel` and `burn` \[-\] from
    /// `seed`, then shifted to a mean of one, so that the engine as a whole stays what it was.
    #[must_use]
    pub fn with_imbalance(mut self, seed: u64, fuel: f64, burn: f64) -> Self {
        let mut rng = Rng64::stream(seed ^ SCATTER, u64::MAX);
        let mut four = |share: f64| {
            let z: [f64; 4] = [0; 4].map(|_| rng.normal().clamp(-2.0, 2.0));
            let mean = z.iter().sum::<f64>() / 4.0;
            z.map(|z| 1.0 + share * (z - mean))
        };
        self.fuel_share = four(fuel);
        self.burn_share = four(burn);
        self
    }
}
