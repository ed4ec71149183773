//! Steady points over the whole map of a boosted engine: what a controller would hold there.
//!
//! Once a cycle: throttle and then wastegate follow the torque (bounded by boost), fuel follows the air at the lambda
//! asked for, which is enriched where the exhaust gets too hot, the spark places 50 % burned where it is best unless the
//! knock integral stands in the way, and the cams follow the schedule of the parameter set. Where spark or mixture stand at their end and
//! knock, peak pressure or exhaust temperature are past their limit all the same, the load gives way.

mod rest;

use self::rest::Span;
use crate::engine::VirtualEngine;
use crate::error::PlantError;
use crate::inputs::Inputs;
use crate::outputs::Outputs;
use crate::params::EngineParams;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What a point is asked for, and what it must not pass.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LoadRequest {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Brake torque \[Nm\].
    pub torque_nm: f64,
    /// Lambda where nothing asks for enrichment \[-\].
    pub lambda: f64,
    /// Limits.
    pub limits: LoadLimits,
}

/// Limits of a point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LoadLimits {
    /// Intake-manifold pressure \[kPa\].
    pub map_kpa: f64,
    /// Exhaust temperature \[K\].
    pub egt_k: f64,
    /// Knock integral \[-\].
    pub knock: f64,
    /// Turbocharger speed \[rpm\].
    pub turbo_rpm: f64,
    /// Peak pressure, mean of the cycles \[bar\].
    pub pmax_bar: f64,
    /// Angle of 50 % burned without knock \[deg ATDC\].
    pub ca50_deg: f64,
    /// Richest mixture that may cool the exhaust \[-\].
    pub least_lambda: f64,
    /// Least flow of the compressor over that at which it surges, while the wastegate holds the load \[-\].
    pub surge_margin: f64,
    /// Simulated time after which the point is given up \[s\].
    pub time_s: f64,
}

impl Default for LoadLimits {
    /// 240 kPa, 950 deg C, knock at its onset, 220 000 rpm, 110 bar, 50 % burned at 8 deg, lambda 0.75, 1.02 of the
    /// surge flow, 120 s.
    fn default() -> Self {
        Self {
            map_kpa: 240.0,
            egt_k: 1223.0,
            knock: 1.0,
            turbo_rpm: 220e3,
            pmax_bar: 110.0,
            ca50_deg: 8.0,
            least_lambda: 0.75,
            surge_margin: 1.02,
            time_s: 120.0,
        }
    }
}

/// What stands at its limit where the torque asked for is not reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Barrier {
    /// Intake-manifold pressure at its limit.
    IntakePressure,
    /// Turbocharger at its limit of speed.
    TurboSpeed,
    /// Compressor at its surge line.
    Surge,
    /// Wastegate closed and throttle open: the turbine has no more.
    WastegateClosed,
    /// Throttle open.
    ThrottleOpen,
    /// Throttle closed: less torque is not to be had with fuel.
    ThrottleClosed,
    /// Injectors at the end of their box.
    Injection,
    /// Spark at the end of its box, knock or peak pressure at their limit.
    Spark,
    /// Mixture at its richest, exhaust temperature at its limit.
    Mixture,
    /// Exhaust temperature at its limit, and a richer mixture does not cool it.
    Heat,
    /// The wastegate still turns, and moves nothing any more.
    Spent,
    /// Nothing: the time allowed was too short.
    Time,
}

impl Barrier {
    /// In words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::IntakePressure => "the intake pressure stands at its limit",
            Self::TurboSpeed => "the turbocharger stands at its limit of speed",
            Self::Surge => "the compressor stands at its surge line",
            Self::WastegateClosed => "the wastegate is closed and the throttle open",
            Self::ThrottleOpen => "the throttle is open",
            Self::ThrottleClosed => "the throttle is closed",
            Self::Injection => "the injection stands at the end of its range",
            Self::Spark => "the spark stands at the end of its range",
            Self::Mixture => "the mixture stands at its richest and the exhaust at its limit of temperature",
            Self::Heat => {
                "the exhaust stands at its limit of temperature and richer mixture does not cool it"
            }
            Self::Spent => "the wastegate closes on and neither boost nor torque answers",
            Self::Time => "nothing stands at its limit, the time allowed was too short",
        }
    }
}

/// A point and what held it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LoadPoint {
    /// What was asked.
    pub request: LoadRequest,
    /// Inputs at the end.
    pub inputs: Inputs,
    /// Outputs, means of the last cycles.
    pub outputs: Outputs,
    /// Lambda held \[-\].
    pub lambda: f64,
    /// The torque is reached within 1 Nm.
    pub reached: bool,
    /// Why it is not.
    #[serde(default)]
    pub barrier: Option<Barrier>,
    /// The spark stands at the limit of knock or of peak pressure.
    pub knock_limited: bool,
    /// Everything stood still before the time was over, or over its last 10 s nothing moved but a wastegate that cannot make up what is missing.
    pub settled: bool,
    /// Simulated time \[s\].
    pub time_s: f64,
}

impl LoadPoint {
    /// Limits that are passed all the same, because what keeps them stands at its end, in words; none where all are kept, to what the
    /// controller leaves: 10 K, 3 kPa, 5 % of knock, 3 % of the others.
    pub fn passed(&self) -> Option<String> {
        self.request.limits.passed(&self.outputs, 1.0)
    }
}

impl LoadLimits {
    /// Limits that outputs pass, in words; none where all are kept. `leave` is the share of what a controller leaves
    /// ([`LoadPoint::passed`]) that counts as kept: 0 where none has held the point.
    pub fn passed(&self, y: &Outputs, leave: f64) -> Option<String> {
        let l = self;
        let all = [
            ("knock", y.knock, l.knock, (1.0 + 0.05 * leave) * l.knock, "-"),
            (
                "exhaust temperature",
                y.egt_k - 273.15,
                l.egt_k - 273.15,
                l.egt_k - 273.15 + 10.0 * leave,
                "degC",
            ),
            ("peak pressure", y.pmax_bar, l.pmax_bar, (1.0 + 0.03 * leave) * l.pmax_bar, "bar"),
            ("intake pressure", y.map_kpa, l.map_kpa, l.map_kpa + 3.0 * leave, "kPa"),
            ("turbocharger", y.turbo_rpm, l.turbo_rpm, (1.0 + 0.03 * leave) * l.turbo_rpm, "rpm"),
        ];
        let beyond = all.iter().filter(|(_, found, _, most, _)| found > most);
        let words: Vec<String> = beyond
            .map(|(name, found, limit, _, unit)| match *unit {
                "-" => format!("{name} {found:.2} (limit {limit})"),
                _ => format!("{name} {found:.0} {unit} (limit {limit:.0})"),
            })
            .collect();
        (!words.is_empty()).then(|| words.join(", "))
    }
}

/// Error of the torque in Nm within which a point counts as reached.
pub const REACHED_NM: f64 = 1.0;
/// Cycles that must stand still, and after which a change of mixture has passed the exhaust.
const STILL: usize = 25;
/// Widest throttle and wastegate.
const OPEN_DEG: f64 = 90.0;
const OPEN_MM: f64 = 28.0;
/// Ends of the spark in deg before top dead centre.
const LATEST_DEG: f64 = -10.0;
const EARLIEST_DEG: f64 = 55.0;
/// Torque in Nm by which the load gives way for a unit of knock, a bar and a kelvin past their limits: of the size that a boosted engine
/// of 2 l changes them by; the controller integrates what is left.
const KNOCK_NM: f64 = 100.0;
const PEAK_NM: f64 = 3.0;
const HOT_NM: f64 = 0.3;
/// Torque in Nm that these must leave for the spark to advance and the mixture to lean again: 0.03 of knock, 1 bar, 10 K.
const ROOM_NM: f64 = 3.0;

/// Controller state of one point.
struct Controller {
    request: LoadRequest,
    u: Inputs,
    lambda: f64,
    /// Torque in Nm that was left the cycle before, and which of torque, boost, shaft, knock and heat left it (none: surge).
    error_before: Option<(f64, Option<usize>)>,
    shaft_before: f64,
    /// A spark that is given: then neither knock nor peak pressure move anything.
    fixed_spark: bool,
    /// Whether the load gives way to knock or peak pressure, and to the exhaust's temperature: as long as it does, the spark does not
    /// advance and the mixture does not lean, or both would swing.
    gives_way: (bool, bool),
    /// Whether richer mixture cools the exhaust; none as long as nothing asked.
    cools: Option<bool>,
}

impl Controller {
    /// One cycle: new inputs; whether everything stands still.
    fn cycle(&mut self, p: &EngineParams, y: &Outputs) -> bool {
        let cycle_s = 120.0 / self.u.speed_rpm;
        let load_still = self.load(p, y, cycle_s);
        let spark_still = self.spark(y);
        let hot = y.egt_k - self.request.limits.egt_k;
        let least = if self.gives_way.1 { 0.0 } else { -1e-3 };
        let lambda = self.lambda - (2e-5 * hot).clamp(least, 1e-3);
        let richest = self.richest();
        self.lambda = lambda.clamp(richest, self.request.lambda);
        let lambda_still = hot.abs() < 2.0
            || (hot < 0.0 && self.lambda >= self.request.lambda)
            || (hot > 0.0 && self.lambda <= richest)
            || self.gives_way.1;
        let air_mg = 1e3 * y.air_g_s * cycle_s / 4.0;
        self.u.injection_mg = (air_mg / (p.gas.afr_stoich * self.lambda)).clamp(0.0, 120.0);
        if let Some(cams) = &p.cams {
            let now = (self.u.intake_mop_deg_btdc, self.u.exhaust_mop_deg_atdc);
            (self.u.intake_mop_deg_btdc, self.u.exhaust_mop_deg_atdc) =
                cams.follow(now, self.u.speed_rpm, y.map_kpa, cycle_s);
        }
        let shaft_still = (y.turbo_rpm - self.shaft_before).abs() <= 2e-5 * y.turbo_rpm;
        self.shaft_before = y.turbo_rpm;
        load_still && spark_still && lambda_still && shaft_still
    }

    /// Throttle first, then the wastegate.
    fn load(&mut self, p: &EngineParams, y: &Outputs, cycle_s: f64) -> bool {
        let limits = self.request.limits;
        // Torque that the limits of boost and shaft leave, in Nm.
        let boost = 1.7 * (limits.map_kpa - y.map_kpa);
        let shaft = 2e-3 * (limits.turbo_rpm - y.turbo_rpm);
        let free = (self.request.torque_nm - y.torque_cycle_nm).min(boost).min(shaft);
        let (knock, hot) = self.left(y);
        // Room that is left is no giving way: a spark held back there would heat the exhaust, and the load would fall for ever.
        self.gives_way = (knock < free.min(ROOM_NM), hot < free.min(ROOM_NM));
        let free = free.min(knock).min(hot);
        let u = &mut self.u;
        let boosted = p.turbocharger.is_some();
        let on_wastegate = boosted && u.throttle_deg >= OPEN_DEG && (free > 0.0 || u.wastegate_mm < OPEN_MM);
        // A throttled engine may stand near surge: nothing is to be had from the wastegate there.
        let surge = surge_ratio(p, y).filter(|_| on_wastegate);
        let error = surge.map_or(free, |s| free.min(SURGE_NM * (s - limits.surge_margin)));
        // What holds the torque may change from cycle to cycle: only of the same does a difference say that something moved.
        let own = [self.request.torque_nm - y.torque_cycle_nm, boost, shaft, knock, hot];
        let held_by = own.iter().position(|e| *e == error);
        let change = match self.error_before {
            Some((before, by)) if by == held_by => error - before,
            _ => 0.0,
        };
        self.error_before = Some((error, held_by));
        if on_wastegate {
            // Flow goes with the square of the diameter: small openings move slowly.
            let gain = (0.2 + u.wastegate_mm / OPEN_MM) * weak(p, y);
            let mm = gain * (0.08 * change + 0.04 * cycle_s * error);
            u.wastegate_mm = (u.wastegate_mm - mm.clamp(-1.0, 1.0)).clamp(0.0, OPEN_MM);
            return error.abs() < 0.3 || (error > 0.0 && u.wastegate_mm <= 0.0);
        }
        let fill_s = p.intake_manifold.volume_m3 / (0.75 * p.displacement_m3()) * cycle_s;
        let closed_loop_s = fill_s + 4.0 * cycle_s;
        let d = p.throttle.diameter0_m + p.throttle.slope_m_per_deg * u.throttle_deg;
        let load_nm = self.request.torque_nm.max(0.0) + 25.0;
        let slope_nm_deg = 2.0 * load_nm * p.throttle.slope_m_per_deg / d * share_of_choked(p, y);
        let deg = (fill_s * change + cycle_s * error) / (closed_loop_s * slope_nm_deg);
        u.throttle_deg = (u.throttle_deg + deg.clamp(-2.0, 2.0)).clamp(0.0, OPEN_DEG);
        let at_end = if error > 0.0 { u.throttle_deg >= OPEN_DEG && !boosted } else { u.throttle_deg <= 0.0 };
        error.abs() < 0.1 || at_end
    }

    /// Torque in Nm that the spark at its latest and the mixture at its richest leave: negative where a limit is passed that they keep no
    /// more; any where they are not at their ends.
    fn left(&self, y: &Outputs) -> (f64, f64) {
        let l = &self.request.limits;
        let knock = (KNOCK_NM * (l.knock - y.knock)).min(PEAK_NM * (l.pmax_bar - y.pmax_bar));
        let hot = HOT_NM * (l.egt_k - y.egt_k);
        let late = self.u.spark_deg <= LATEST_DEG && !self.fixed_spark;
        let rich = self.lambda <= self.richest();
        (if late { knock } else { f64::INFINITY }, if rich { hot } else { f64::INFINITY })
    }

    /// A mixture that is asked richer than enrichment may make it stays what it is.
    fn richest(&self) -> f64 {
        match self.cools {
            Some(false) => self.request.lambda,
            _ => self.request.limits.least_lambda.min(self.request.lambda),
        }
    }

    /// Where the mixture stands at its richest for the first time and the exhaust is too hot all the same: whether that cools it at all. Sets
    /// whose burned gas does not bind the energy of rich mixture grow hotter by it, and the load would give way for ever. Tried on copies
    /// of the engine, so that the point itself does not feel it.
    fn ask_whether_rich_cools(&mut self, engine: &VirtualEngine) -> Result<(), PlantError> {
        let richest = self.richest();
        let asks = self.cools.is_none() && self.lambda <= richest && richest < self.request.lambda;
        if !asks || engine.outputs().egt_k <= self.request.limits.egt_k {
            return Ok(());
        }
        let at = |lambda: f64| -> Result<f64, PlantError> {
            let mut copy = engine.clone();
            let injection_mg = (self.u.injection_mg * self.lambda / lambda).clamp(0.0, 120.0);
            copy.set_inputs(Inputs { injection_mg, ..self.u })?;
            copy.advance_angle(720.0 * STILL as f64);
            Ok(copy.outputs().egt_k)
        };
        self.cools = Some(at(richest)? < at(self.request.lambda)?);
        Ok(())
    }

    /// The spark places 50 % burned; knock integral and peak pressure bound it.
    fn spark(&mut self, y: &Outputs) -> bool {
        if self.fixed_spark {
            return true;
        }
        let phase = y.ca50_deg - self.request.limits.ca50_deg;
        let knock = 8.0 * (self.request.limits.knock - y.knock);
        let peak = 0.3 * (self.request.limits.pmax_bar - y.pmax_bar);
        let held = if self.gives_way.0 { 0.0 } else { f64::INFINITY };
        let off = phase.min(knock).min(peak).min(held);
        self.u.spark_deg = (self.u.spark_deg + (0.2 * off).clamp(-0.5, 0.5)).clamp(LATEST_DEG, EARLIEST_DEG);
        off.abs() < 0.1
            || (off < 0.0 && self.u.spark_deg <= LATEST_DEG)
            || (off > 0.0 && self.u.spark_deg >= EARLIEST_DEG)
    }
}

/// Brings an engine to a point and holds it; the engine keeps its state, so that neighbouring points start close.
///
/// # Errors
/// [`PlantError::Input`] for a speed outside the box, [`PlantError::Diverged`].
///
/// ```
/// use dynocal_plant::{engine::VirtualEngine, full_load::*, params::EngineParams};
/// let mut engine = VirtualEngine::new(&EngineParams::named("gtdi_2l")?)?;
/// let limits = LoadLimits::default();
/// let request = LoadRequest { speed_rpm: 2000.0, torque_nm: 60.0, lambda: 1.0, limits };
/// let point = hold_load(&mut engine, request)?;
/// assert!(point.reached && (point.outputs.ca50_deg - 8.0).abs() < 0.5);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn hold_load(engine: &mut VirtualEngine, request: LoadRequest) -> Result<LoadPoint, PlantError> {
    hold(engine, request, None)
}

/// The same with a spark that is given and stays: throttle, wastegate, mixture and cams follow, knock and peak pressure are what they are.
///
/// # Errors
/// As of [`hold_load`], and a spark outside the box.
pub fn hold_load_at_spark(
    engine: &mut VirtualEngine,
    request: LoadRequest,
    spark_deg: f64,
) -> Result<LoadPoint, PlantError> {
    hold(engine, request, Some(spark_deg))
}

fn hold(
    engine: &mut VirtualEngine,
    request: LoadRequest,
    spark_deg: Option<f64>,
) -> Result<LoadPoint, PlantError> {
    let p = engine.params().clone();
    let now = engine.state().inputs;
    let u = Inputs {
        speed_rpm: request.speed_rpm,
        wiebe_m: 2.0,
        burn_duration_deg: None,
        spark_deg: spark_deg.unwrap_or(now.spark_deg),
        ..now
    };
    let mut control = Controller {
        request,
        u,
        lambda: request.lambda,
        error_before: None,
        shaft_before: 0.0,
        fixed_spark: spark_deg.is_some(),
        gives_way: (false, false),
        cools: None,
    };
    engine.set_inputs(u)?;
    let start_s = engine.state().time_s;
    let mut still = 0;
    let mut span = Span::default();
    loop {
        engine.advance_angle(720.0);
        let y = engine.outputs();
        still = if control.cycle(&p, &y) { still + 1 } else { 0 };
        control.ask_whether_rich_cools(engine)?;
        let time_s = y.time_s - start_s;
        span.see(request.limits.time_s - time_s, &y, control.u.wastegate_mm);
        if still >= STILL || time_s > request.limits.time_s {
            // A controller that goes on turning what moves nothing is at rest, too.
            let inputs = engine.state().inputs;
            let spent = still < STILL
                && inputs.throttle_deg >= OPEN_DEG
                && span.rests(request.torque_nm - y.torque_cycle_nm);
            let settled = still >= STILL || spent;
            // Whole cycles, so that pulsation averages out.
            let average_s = 10.0 * 120.0 / request.speed_rpm;
            let outputs = crate::statics::steady(engine, inputs, 0.0, average_s)?;
            let reached = (outputs.torque_nm - request.torque_nm).abs() < REACHED_NM;
            return Ok(LoadPoint {
                request,
                barrier: (!reached).then(|| match barrier(&p, &control, &inputs, &outputs) {
                    Barrier::Time if spent => Barrier::Spent,
                    other => other,
                }),
                inputs,
                outputs,
                lambda: control.lambda,
                reached,
                knock_limited: outputs.ca50_deg > request.limits.ca50_deg + 0.5,
                settled,
                time_s,
            });
        }
        engine.set_inputs(control.u)?;
    }
}

/// Share of its choked slope that a wide throttle has. With a flow `A psi(r)` that an engine takes in proportion to the intake pressure,
/// `d ln r / d ln A = 1 / (1 - d ln psi / d ln r)`, near `r = 1` `2 (1 - r) / (2 - r)`: what an open throttle still moves. Up to a ratio of
/// [`WIDE`] the controller takes the slope as it is, and never less than [`LEAST_SHARE`].
fn share_of_choked(p: &EngineParams, y: &Outputs) -> f64 {
    let before_kpa = if p.turbocharger.is_some() { y.boost_kpa } else { 1e-3 * p.ambient.pressure_pa };
    let elasticity = |r: f64| 2.0 * (1.0 - r) / (2.0 - r);
    (elasticity(y.map_kpa / before_kpa) / elasticity(WIDE)).clamp(LEAST_SHARE, 1.0)
}

/// How much more a wastegate must move where there is little boost: what the turbine gets goes into `pi - 1`, torque with `pi`. Below a
/// ratio of [`LOW_BOOST`], at most [`MOST_WEAK`].
fn weak(p: &EngineParams, y: &Outputs) -> f64 {
    let boost = y.boost_kpa / (1e-3 * p.ambient.pressure_pa) - 1.0;
    ((LOW_BOOST - 1.0) / boost.max(1e-6)).clamp(1.0, MOST_WEAK)
}

/// Compressor ratio below which a wastegate moves torque less, and the most by which it is moved more.
const LOW_BOOST: f64 = 1.2;
const MOST_WEAK: f64 = 4.0;

/// Ratio of pressures above which a throttle is wide, and the least share of its slope.
const WIDE: f64 = 0.9;
const LEAST_SHARE: f64 = 0.2;

/// Torque of a full change of [`surge_ratio`] \[Nm\]: the flow grows with it, the surge flow more slowly.
const SURGE_NM: f64 = 200.0;

/// Flow of the compressor over that at which it surges.
fn surge_ratio(p: &EngineParams, y: &Outputs) -> Option<f64> {
    let turbo = p.turbocharger.as_ref()?;
    let (t_k, r) = (p.ambient.temperature_k, p.gas.r_j_kg_k[0]);
    let w = y.turbo_rpm * std::f64::consts::PI / 30.0;
    Some(1e-3 * y.air_g_s / turbo.surge_flow_kg_s(w, t_k, p.ambient.pressure_pa / (r * t_k)))
}

/// What stands in the way of a torque that is not reached.
fn barrier(p: &EngineParams, control: &Controller, u: &Inputs, y: &Outputs) -> Barrier {
    let r = &control.request;
    let open = u.throttle_deg >= OPEN_DEG - 0.01;
    if y.torque_nm > r.torque_nm {
        return if u.throttle_deg <= 0.01 { Barrier::ThrottleClosed } else { Barrier::Time };
    }
    match () {
        () if y.map_kpa >= r.limits.map_kpa - 1.0 => Barrier::IntakePressure,
        () if y.turbo_rpm >= 0.995 * r.limits.turbo_rpm => Barrier::TurboSpeed,
        () if open && surge_ratio(p, y).is_some_and(|s| s <= r.limits.surge_margin + 0.02) => Barrier::Surge,
        () if u.injection_mg >= 119.9 => Barrier::Injection,
        () if u.spark_deg <= LATEST_DEG + 0.1 => Barrier::Spark,
        () if control.lambda <= control.richest() + 1e-9 && y.egt_k >= r.limits.egt_k - 5.0 => {
            if control.cools == Some(false) { Barrier::Heat } else { Barrier::Mixture }
        }
        () if open && p.turbocharger.is_none() => Barrier::ThrottleOpen,
        () if open && u.wastegate_mm <= 0.05 => Barrier::WastegateClosed,
        () => Barrier::Time,
    }
}

/// Points at each speed, from low to high torque with one engine; parallel over speeds, the same for any number of
/// threads.
///
/// # Errors
/// [`PlantError`] of the parameters; each point carries its own result.
pub fn load_map(
    params: &EngineParams,
    speeds_rpm: &[f64],
    torques_nm: &[f64],
    limits: LoadLimits,
) -> Result<Vec<Vec<Result<LoadPoint, PlantError>>>, PlantError> {
    let engine = VirtualEngine::new(params)?;
    Ok(speeds_rpm
        .par_iter()
        .map(|&speed_rpm| {
            let mut engine = engine.clone();
            let at = |t: &f64| LoadRequest { speed_rpm, torque_nm: *t, lambda: 1.0, limits };
            torques_nm.iter().map(|t| hold_load(&mut engine, at(t))).collect()
        })
        .collect())
}
