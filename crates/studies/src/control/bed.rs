//! A bed about its set point: moved to identify it, and under two loops into which gain or delay is put.

use std::collections::VecDeque;

use dynocal_control::margin::Margins;
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_ident::plant::{Causality, Plant};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;

/// How tests and measures are made, for results that are kept: behind the first map; margins by pairs of runs.
pub(super) const METHOD: &str = "under loops, pairs with small kicks, and with a quarter of the scatter";
/// Interval of control in s.
pub(super) const SAMPLE_S: f64 = 0.02;
/// Movements of the test as shares of throttle and fuel.
const MOVES: [f64; 2] = [0.04, 0.04];
/// Movements behind a map as shares of torque and lambda: where the loops will work, with fuel and air that go together.
const DEMANDS: [f64; 2] = [0.1, 0.03];
/// Holds of a level in samples, drawn evenly on a logarithmic scale.
const HOLDS: (f64, f64) = (2.0, 60.0);
/// Time in s before anything is looked at.
const SETTLE_S: f64 = 20.0;
/// Length of a run that shows whether the loops oscillate, in s, and what of its end is looked at.
const RUN: (f64, f64) = (40.0, 10.0);
/// The same end in samples, and the length of a kick.
const END: usize = (RUN.1 / SAMPLE_S) as usize;
const KICK: usize = 50;
/// Times the scatter of the nominal loops at which it is an oscillation, whatever a kick does.
const OSCILLATES: f64 = 10.0;
/// Share of what a kick does in its first seconds that may be left at the end: all of it is an oscillation that goes on. Less would take the
/// last digit of the sensors for one.
const LEFT: f64 = 1.0;
/// Halvings of the interval in which it begins.
const HALVINGS: usize = 7;
/// Samples until other gains take their turn in a record under loops.
const TURN: usize = 500;
/// Places of injection, throttle, torque and lambda.
const INJ: usize = 0;
const THROTTLE: usize = 2;
const TORQUE: usize = 0;
const LAMBDA: usize = 1;
const MAP: usize = 2;
const SPARK: usize = 1;
/// The air flow is asked for behind the five outputs of every bed.
const AIR: usize = 5;

/// A bed at rest at its set point.
pub(super) struct Bench {
    settled: EngineBed,
    u0: Vec<f64>,
    /// Means of torque and lambda there.
    y0: [f64; 2],
    outputs: usize,
    seed: u64,
}

/// Loops under which a record is made: a third of it as they are, then each of them with its gain raised by its factor. A gain margin
/// is decided above the frequencies at which a loop of that margin moves the engine by itself.
pub(super) struct Under<'a> {
    pub(super) gains: &'a [PidGains],
    pub(super) raised: [f64; 2],
}

impl Under<'_> {
    /// Factors of the gains at a row.
    fn factors(&self, row: usize) -> [f64; 2] {
        let mut factors = [1.0; 2];
        if let Some(loop_raised) = (row / TURN % 3).checked_sub(1) {
            factors[loop_raised] = self.raised[loop_raised];
        }
        factors
    }
}

/// Movements about the set point.
pub(super) struct Record {
    /// Throttle and fuel, or demands of torque and lambda, rows x 2.
    pub(super) u: Vec<f64>,
    /// Torque, lambda.
    pub(super) y: [Vec<f64>; 2],
}

/// What a drive gave, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Driven {
    /// Throttle, fuel, spark.
    pub(super) u: Vec<[f64; 3]>,
    /// Torque, lambda, manifold pressure and air flow as the sensors show them.
    pub(super) shown: Vec<[f64; 4]>,
    /// Torque of the last cycle, without sensor.
    pub(super) torque_nm: Vec<f64>,
}

/// What is put into a loop.
#[derive(Clone, Copy, Debug)]
pub(super) struct Injected {
    pub(super) at: usize,
    pub(super) gain: f64,
    /// Between two samples the error is on the line between them.
    pub(super) delay_samples: f64,
}

impl Bench {
    /// The bed of a parameter set at its start point, 2000 rpm and 50 Nm, settled.
    pub(super) fn new(engine: &str, seed: u64, start_k: Option<f64>) -> Result<Self, String> {
        Self::scattering(engine, seed, start_k, 1.0)
    }

    /// The same with a share of its combustion's scatter.
    pub(super) fn scattering(
        engine: &str,
        seed: u64,
        start_k: Option<f64>,
        share: f64,
    ) -> Result<Self, String> {
        let params = EngineParams::named(engine).map_err(|e| e.to_string())?;
        let mut settings = BedSettings::of_set(engine, &params).map_err(|e| e.to_string())?;
        if settings.options.outputs.is_empty() {
            settings.options.outputs.push("air".into());
        }
        if let (Some(start_k), Some(thermal)) = (start_k, &mut settings.options.engine.warm_up) {
            thermal.start_k = start_k;
        }
        let scatter = &mut settings.options.engine.scatter;
        (scatter.heat, scatter.burn) = (share * scatter.heat, share * scatter.burn);
        let mut bed = EngineBed::new(&params, settings).map_err(|e| e.to_string())?;
        bed.reset(seed);
        let inputs = bed.variables().iter().take_while(|v| v.causality == Causality::Input).count();
        let u0: Vec<f64> = bed.variables()[..inputs].iter().map(|v| v.start).collect();
        let outputs = bed.variables().len() - inputs;
        let mut y = vec![0.0; outputs];
        let mut sums = [0.0; 2];
        let n = (2.0 * SETTLE_S / SAMPLE_S) as usize;
        for t in 0..n {
            bed.step(&u0, SAMPLE_S, &mut y).map_err(|e| e.to_string())?;
            if t >= n / 2 {
                sums[0] += y[TORQUE];
                sums[1] += y[LAMBDA];
            }
        }
        let y0 = sums.map(|s| s / (n - n / 2) as f64);
        Ok(Self { settled: bed, u0, y0, outputs, seed })
    }

    /// Rows of throttle, fuel and spark that `act` gives for the row's number and what the sensors showed last (torque, lambda,
    /// manifold pressure, air flow); the engine at its set point before.
    pub(super) fn drive(
        &self,
        rows: usize,
        act: &mut dyn FnMut(usize, &[f64; 4]) -> [f64; 3],
    ) -> Result<Driven, String> {
        let mut bed = self.settled.clone();
        let (mut u, mut y) = (self.u0.clone(), vec![0.0; self.outputs]);
        bed.outputs(&mut y).map_err(|e| e.to_string())?;
        let mut out = Driven::default();
        for t in 0..rows {
            let wanted = act(t, &[y[TORQUE], y[LAMBDA], y[MAP], y[AIR]]);
            u[THROTTLE] = wanted[0].clamp(1.0, 80.0);
            u[INJ] = wanted[1].clamp(0.3 * self.u0[INJ], 3.0 * self.u0[INJ]);
            u[SPARK] = wanted[2].clamp(-5.0, 50.0);
            bed.step(&u, SAMPLE_S, &mut y).map_err(|e| e.to_string())?;
            let truth = bed.engine().outputs();
            out.u.push([u[THROTTLE], u[INJ], u[SPARK]]);
            out.shown.push([y[TORQUE], y[LAMBDA], y[MAP], y[AIR]]);
            out.torque_nm.push(truth.torque_cycle_nm);
        }
        Ok(out)
    }

    /// Throttle, fuel and spark of the set point, and its torque and lambda.
    pub(super) fn point(&self) -> ([f64; 3], [f64; 2]) {
        ([self.u0[THROTTLE], self.u0[INJ], self.u0[SPARK]], self.y0)
    }

    /// Throttle and fuel moved at random, each on its own; behind a map demands of torque and lambda; `under` loops, what these give
    /// is added, so that the record has most of its movement where the loops have theirs.
    pub(super) fn excite(
        &self,
        length_s: f64,
        map: Option<&[f64]>,
        under: Option<&Under>,
    ) -> Result<Record, String> {
        let n = (length_s / SAMPLE_S) as usize;
        let mut rng = Rng64::stream(self.seed, 7 + u64::from(map.is_some()) + u64::from(under.is_some()));
        let (u0, y0) = self.point();
        let moves = match map {
            None => [MOVES[0] * u0[0], MOVES[1] * u0[1]],
            Some(_) => [DEMANDS[0] * y0[0], DEMANDS[1] * y0[1]],
        };
        let mut pids = started(under.map_or(&[], |u| u.gains))?;
        let mut moved = Vec::with_capacity(2 * n);
        let (mut left, mut level) = ([0usize; 2], [0.0; 2]);
        let run = self.drive(n, &mut |t, shown| {
            for k in 0..2 {
                if left[k] == 0 {
                    left[k] = rng.uniform_in(HOLDS.0.ln(), HOLDS.1.ln()).exp() as usize;
                    level[k] = moves[k] * rng.uniform_in(-1.0, 1.0);
                }
                left[k] -= 1;
            }
            let (mut asked, factors) = (level, under.map_or([1.0; 2], |u| u.factors(t)));
            for (k, pid) in pids.iter_mut().enumerate() {
                asked[k] += pid.step(0.0, factors[k] * (y0[k] - shown[k]));
            }
            moved.extend(asked);
            let d = match map {
                None => asked,
                Some(m) => [m[0] * asked[0] + m[1] * asked[1], m[2] * asked[0] + m[3] * asked[1]],
            };
            [u0[0] + d[0], u0[1] + d[1], u0[2]]
        })?;
        let column = |k: usize| run.shown.iter().map(|s| s[k] - y0[k]).collect();
        Ok(Record { u: moved, y: [column(0), column(1)] })
    }

    /// Output of loop `at` over a run with what is put in. `kicked`: its controller sees one small step at the start, so that an oscillation
    /// has something to grow from.
    fn looped(
        &self,
        map: &[f64],
        gains: &[PidGains],
        put: Injected,
        kicked: bool,
    ) -> Result<Vec<f64>, String> {
        let mut pids = started(gains)?;
        let (whole, share) = (put.delay_samples.floor() as usize, put.delay_samples.fract());
        let mut waiting: VecDeque<f64> = std::iter::repeat_n(0.0, whole + 1).collect();
        let kick = [0.03 * self.y0[0].abs(), 0.02];
        let u0 = self.point().0;
        let run = self.drive((RUN.0 / SAMPLE_S) as usize, &mut |t, shown| {
            let mut d = [0.0; 2];
            for k in 0..2 {
                let mut error = self.y0[k] - shown[k];
                if k == put.at {
                    waiting.push_back(error);
                    // Oldest first: the one before the whole delay, and the one at it.
                    let before = waiting.pop_front().unwrap_or(0.0);
                    let at = waiting.front().copied().unwrap_or(0.0);
                    // Behind what is put in: a kick that grew with the gain would leave the slopes that a margin is about, and tip an engine
                    // (it was seen on `gtdi_2l`) into a cycle of its actuators' whole range at gains at which it is calm.
                    error = put.gain * (at + share * (before - at));
                    error += if kicked && t < KICK { kick[k] } else { 0.0 };
                }
                d[k] = pids[k].step(0.0, error);
            }
            // The map takes demands to throttle and fuel; actuators end where they end.
            [u0[0] + map[0] * d[0] + map[1] * d[1], u0[1] + map[2] * d[0] + map[3] * d[1], u0[2]]
        })?;
        Ok(run.shown.iter().map(|s| s[put.at]).collect())
    }

    /// Whether a loop oscillates: of two runs with the same scatter, one with a kick, the difference does not fade; or its output
    /// scatters so much that it has ended in a cycle, in which two runs may meet again.
    fn oscillates(&self, map: &[f64], gains: &[PidGains], put: Injected, calm: f64) -> Result<bool, String> {
        let kicked = self.looped(map, gains, put, true)?;
        if scatter(&kicked) > OSCILLATES * calm {
            return Ok(true);
        }
        let other = self.looped(map, gains, put, false)?;
        let off: Vec<f64> = kicked.iter().zip(&other).map(|(a, b)| a - b).collect();
        let size = |part: &[f64]| (part.iter().map(|v| v * v).sum::<f64>() / part.len() as f64).sqrt();
        Ok(size(&off[off.len() - END..]) > LEFT * size(&off[KICK..5 * KICK]))
    }

    /// Gain (factor) or delay (s) in loop `k` at which the engine begins to oscillate; none where it does not up to three times
    /// what is promised.
    pub(super) fn lost(
        &self,
        map: &[f64],
        gains: &[PidGains],
        k: usize,
        delay: bool,
        promised: &Margins,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<f64>, String> {
        let put = |amount: f64| Injected {
            at: k,
            gain: if delay { 1.0 } else { amount },
            delay_samples: if delay { amount / SAMPLE_S } else { 0.0 },
        };
        let (least, most) = if delay {
            (0.0, 3.0 * promised.delay_s.unwrap_or(1.0))
        } else {
            (1.0, 3.0 * promised.gain_up.unwrap_or(4.0))
        };
        let calm = scatter(&self.looped(map, gains, put(least), false)?);
        let oscillates = |amount: f64| self.oscillates(map, gains, put(amount), calm);
        if !oscillates(most)? {
            return Ok(None);
        }
        let (mut good, mut bad) = (least, most);
        for _ in 0..HALVINGS {
            if stop() {
                return Err("interrupted".into());
            }
            let middle = if delay { 0.5 * (good + bad) } else { (good * bad).sqrt() };
            if oscillates(middle)? { bad = middle } else { good = middle }
        }
        Ok(Some(if delay { 0.5 * (good + bad) } else { (good * bad).sqrt() }))
    }
}

/// Controllers at rest whose actuators end where they end.
fn started(gains: &[PidGains]) -> Result<Vec<Pid>, String> {
    let wide = ActuatorLimits { lower: -1e6, upper: 1e6, rate_per_s: None };
    gains.iter().map(|g| Pid::new(*g, wide, SAMPLE_S, 0.0).map_err(|e| e.to_string())).collect()
}

/// Standard deviation over the end of a run.
fn scatter(run: &[f64]) -> f64 {
    let end = &run[run.len() - END..];
    let mean = end.iter().sum::<f64>() / END as f64;
    (end.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / END as f64).sqrt()
}
