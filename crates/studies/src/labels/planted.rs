//! A virtual car: the bed of an engine in a loop with the fuel function of an open ECU, whose labels are known, from drive to `.mlg` with
//! its tune, and back to labels.
//!
//! ```text
//! VE = whole part of the table at (speed, load),    pulse = FACTOR required VE / 100 load / 100 + DEAD(battery),    rounded to 1 us
//! fuel of a cycle and cylinder = 2 RATE (pulse - DEAD(battery))
//! ```
//!
//! Speed and load are whole numbers, battery has a digit, as such ECUs log them. Truth of the pulse width are its labels; truth of the
//! table is what the engine breathes at its cells in steady state, from runs of their own.

use std::path::Path;

use dynocal_files::measurement::mlg::Raw;
use dynocal_files::measurement::mlg_write::{Written, write};
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_jobs::engine::Engine;
use dynocal_jobs::label::{self, Job, Verdict, curve, function};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::testbed::sensor::SensorSettings;
use dynocal_plant::testbed::settings::BedOptions;
use serde::{Deserialize, Serialize};

use super::refused;
use crate::StudyError;

const SET: &str = "pfi_1_6l";
const SAMPLE_S: f64 = 0.05;
const LENGTH_S: f64 = 240.0;
const SPARK_DEG: f64 = 20.0;
const CYLINDERS: f64 = 4.0;
/// Labels of the pulse width, and the flow of an injector in mg/ms. With a required time of 10 ms every second pulse would end on half a
/// microsecond, and rounding would always go up.
const REQUIRED_MS: f64 = 9.7;
const FACTOR: f64 = 0.5;
const BATTERY_V: [f64; 3] = [12.0, 13.0, 14.6];
const DEAD_MS: [f64; 3] = [1.06, 1.03, 1.0];
/// How far the labels of one car lie from these: as a share, and in ms. What rounding a pulse to whole steps adds is the same each time for
/// the same labels and states; only over different labels is it an error that intervals can hold.
const FACTOR_SPREAD: f64 = 0.02;
const DEAD_SPREAD_MS: f64 = 0.02;
const RATE: f64 = 3.2;
/// Breakpoints of the table.
const RPM: [f64; 5] = [1200.0, 1600.0, 2000.0, 2400.0, 2800.0];
const LOAD_KPA: [f64; 9] = [20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0];
/// Noise of lambda.
const NOISE: f64 = 0.01;

/// What came back of one seed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Back {
    /// FACTOR and DEAD at each voltage: off, and half width of the interval.
    pub(super) pulse: Vec<[f64; 2]>,
    /// Determined cells of the table whose truth is known; of these within their interval, and within one count.
    pub(super) cells: [usize; 3],
    /// Sum of the errors of these cells in counts.
    pub(super) off: f64,
    /// Whether the new table is taken.
    pub(super) taken: bool,
    /// Later lambda before and after, root mean square.
    pub(super) lambda: [f64; 2],
}

/// The labels of the pulse width in one car.
struct Own {
    factor: f64,
    dead_ms: [f64; 3],
}

impl Own {
    fn of(seed: u64) -> Self {
        let mut rng = Rng64::stream(seed, 8);
        Self {
            factor: FACTOR * (1.0 + rng.uniform_in(-FACTOR_SPREAD, FACTOR_SPREAD)),
            dead_ms: DEAD_MS.map(|d| d + rng.uniform_in(-DEAD_SPREAD_MS, DEAD_SPREAD_MS)),
        }
    }
}

fn fail(e: &dyn std::fmt::Display) -> StudyError {
    refused("planted", e)
}

struct Car {
    bed: EngineBed,
    /// Places of lambda, manifold pressure and air among the outputs.
    at: [usize; 3],
    outputs: Vec<f64>,
    afr: f64,
}

impl Car {
    fn new() -> Result<Self, StudyError> {
        let engine = Engine::named(SET).map_err(|e| fail(&e))?;
        let set = BedSettings::of_set(SET, &engine.params).map_err(|e| fail(&e))?;
        // A wide-band sensor of 50 ms behind half a gram of gas.
        let lambda =
            SensorSettings { lag_s: 0.05, transport_g: 0.5, noise: NOISE, ..SensorSettings::default() };
        let options = BedOptions {
            saturate: true,
            outputs: vec!["air".into()],
            sensors: std::iter::once(("lambda".to_string(), lambda)).collect(),
            ..BedOptions::default()
        };
        let bed = EngineBed::new(&engine.params, BedSettings { options, ..set }).map_err(|e| fail(&e))?;
        let names: Vec<String> = bed.variables().iter().skip(4).map(|v| v.name.clone()).collect();
        let place = |name: &str| {
            let found = names.iter().position(|n| n == name);
            found.ok_or_else(|| refused("planted", format!("the bed has no output `{name}`")))
        };
        let at = [place("lambda")?, place("map")?, place("air")?];
        Ok(Self { bed, at, outputs: vec![0.0; names.len()], afr: engine.params.gas.afr_stoich })
    }

    fn step(&mut self, injection_mg: f64, throttle_deg: f64, speed_rpm: f64) -> Result<(), PlantError> {
        self.bed.step(&[injection_mg, SPARK_DEG, throttle_deg, speed_rpm], SAMPLE_S, &mut self.outputs)
    }

    fn read(&self, which: usize) -> f64 {
        self.outputs[self.at[which]]
    }

    /// Fuel of a cycle and cylinder for lambda 1.
    fn wanted_mg(&self, speed_rpm: f64) -> f64 {
        1e3 * self.read(2) * 120.0 / (CYLINDERS * speed_rpm) / self.afr
    }
}

/// What the engine breathes at each cell, in percent of the table; not a number outside of what throttle and speed reach.
pub(super) fn truth() -> Result<Vec<f64>, StudyError> {
    let mut car = Car::new()?;
    let mut out = vec![f64::NAN; RPM.len() * LOAD_KPA.len()];
    for (i, rpm) in RPM.iter().enumerate() {
        let (mut load, mut ve) = (Vec::new(), Vec::new());
        for throttle in
            [6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.5, 16.0, 18.0, 20.0, 23.0, 27.0, 35.0, 60.0]
        {
            car.bed.reset(1);
            let (mut fuel, mut sums) = (12.0, [0.0; 2]);
            for k in 0..80 {
                car.step(fuel, throttle, *rpm).map_err(|e| fail(&e))?;
                fuel = car.wanted_mg(*rpm);
                if k >= 60 {
                    sums[0] += car.read(1);
                    sums[1] += fuel;
                }
            }
            load.push(sums[0] / 20.0);
            ve.push(sums[1] * 1e4 / (2.0 * FACTOR * REQUIRED_MS * RATE * sums[0]));
        }
        for (j, kpa) in LOAD_KPA.iter().enumerate() {
            // Throttles rise, and pressures with them.
            if (load[0]..=load[load.len() - 1]).contains(kpa) {
                out[j * RPM.len() + i] = curve(&load, &ve, *kpa);
            }
        }
    }
    Ok(out)
}

/// The table in the ECU: the truth, wrong by up to 12 % in waves, in whole counts.
fn wrong(truth: &[f64]) -> Vec<f64> {
    let known = truth.iter().copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
    let cell = |(k, v): (usize, &f64)| {
        let wave = 1.0 + 0.12 * (0.9 * (k % RPM.len()) as f64).sin() * (0.7 * (k / RPM.len()) as f64).cos();
        (if v.is_finite() { *v } else { 0.8 * known } * wave).round()
    };
    truth.iter().enumerate().map(cell).collect()
}

/// Value of a table at a state.
fn look_up(table: &[f64], rpm: f64, kpa: f64) -> f64 {
    let lines: Vec<f64> = table.chunks(RPM.len()).map(|line| curve(&RPM, line, rpm)).collect();
    curve(&LOAD_KPA, &lines, kpa)
}

/// A value that goes to new places at a rate and stays there for a while.
struct Wander {
    range: [f64; 2],
    rate: f64,
    hold_s: [f64; 2],
}

impl Wander {
    fn over(&self, rng: &mut Rng64, samples: usize) -> Vec<f64> {
        let mut goal = 0.5 * (self.range[0] + self.range[1]);
        let (mut value, mut left_s) = (goal, 0.0);
        (0..samples)
            .map(|_| {
                if value == goal {
                    left_s -= SAMPLE_S;
                }
                if left_s <= 0.0 {
                    goal = rng.uniform_in(self.range[0], self.range[1]);
                    left_s = rng.uniform_in(self.hold_s[0], self.hold_s[1]);
                }
                let step = self.rate * SAMPLE_S;
                value += (goal - value).clamp(-step, step);
                value
            })
            .collect()
    }
}

/// One drive, written as a log that carries its tune.
fn drive(seed: u64, own: &Own, table: &[f64], path: &Path) -> Result<(), StudyError> {
    let mut rng = Rng64::stream(seed, 7);
    let n = (LENGTH_S / SAMPLE_S) as usize;
    let wander = |range, rate, hold_s| Wander { range, rate, hold_s };
    let throttle = wander([8.0, 26.0], 4.0, [0.5, 3.0]).over(&mut rng, n);
    let speed = wander([1250.0, 2750.0], 200.0, [1.0, 4.0]).over(&mut rng, n);
    let battery = wander([12.1, 14.5], 0.5, [0.5, 5.0]).over(&mut rng, n);
    let mut car = Car::new()?;
    car.bed.reset(seed);
    car.step(12.0, throttle[0], speed[0]).map_err(|e| fail(&e))?;
    let mut log: Vec<Vec<f64>> = vec![Vec::new(); 7];
    for k in 0..n {
        let (rpm, kpa) = (speed[k].round(), car.read(1).round());
        let volts = (10.0 * battery[k]).round() / 10.0;
        let ve = look_up(table, rpm, kpa).floor();
        let dead = curve(&BATTERY_V, &own.dead_ms, volts);
        let pulse = (1e3 * (own.factor * REQUIRED_MS * ve * kpa * 1e-4 + dead)).round() * 1e-3;
        let rate = (throttle[k] - throttle[k.saturating_sub(1)]) / SAMPLE_S / 0.9;
        for (column, v) in log.iter_mut().zip([rpm, kpa, ve, car.read(0), pulse, volts, rate]) {
            column.push(v);
        }
        car.step(2.0 * RATE * (pulse - dead), throttle[k], speed[k]).map_err(|e| fail(&e))?;
    }
    let field = |name: &str, unit: &str, raw, scale, values: Vec<f64>| Written {
        name: name.into(),
        unit: unit.into(),
        raw,
        scale,
        digits: 3,
        values,
    };
    let time_s: Vec<f64> = (0..n).map(|k| SAMPLE_S * k as f64).collect();
    let mut log = log.into_iter();
    let mut next = || log.next().unwrap_or_default();
    let (rpm, kpa) = (next(), next());
    let fields = [
        field("Time", "s", Raw::Float, 1.0, time_s.clone()),
        field("RPM", "rpm", Raw::Unsigned(2), 1.0, rpm),
        field("MAP", "kPa", Raw::Unsigned(2), 1.0, kpa.clone()),
        field("FuelLoad", "kPa", Raw::Unsigned(2), 1.0, kpa),
        field("VE1", "%", Raw::Unsigned(1), 1.0, next()),
        field("Lambda", "-", Raw::Float, 1.0, next()),
        field("PW", "ms", Raw::Unsigned(2), 0.001, next()),
        field("Battery V", "V", Raw::Unsigned(1), 0.1, next()),
        field("TPS DOT", "%/s", Raw::Float, 1.0, next()),
        field("Gammae", "%", Raw::Unsigned(2), 1.0, vec![100.0; n]),
        field("CLT", "C", Raw::Float, 1.0, vec![90.0; n]),
    ];
    write(path, &time_s, &fields, Some(tune(table).as_bytes())).map_err(|e| fail(&e))
}

/// The tune: table and axes.
fn tune(table: &[f64]) -> String {
    let line = |v: &[f64]| v.iter().map(|x| format!("{x:.1}")).collect::<Vec<_>>().join(" ");
    let constant = |name: &str, unit: &str, cols: usize, values: &[f64]| {
        let rows: String = values.chunks(cols).map(|r| format!("         {} \n", line(r))).collect();
        let count = values.len() / cols;
        format!(
            "<constant cols=\"{cols}\" digits=\"0\" name=\"{name}\" rows=\"{count}\" units=\"{unit}\">\n{rows}      </constant>\n"
        )
    };
    format!(
        "<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\n<msq xmlns=\"http://www.msefi.com/:msq\">\n<versionInfo fileFormat=\"5.0\" signature=\"planted\"/>\n<page>\n{}{}{}</page>\n</msq>\n",
        constant("veTable", "%", RPM.len(), table),
        constant("rpmBins", "RPM", 1, &RPM),
        constant("fuelLoadBins", "kPa", 1, &LOAD_KPA)
    )
}

/// The truth with that of the nearest load where the engine does not come to in steady state, but may on its way.
fn everywhere(truth: &[f64]) -> Vec<f64> {
    let nearest = |k: usize| {
        let column = (k % RPM.len()..truth.len()).step_by(RPM.len()).filter(|j| truth[*j].is_finite());
        column.min_by_key(|j| j.abs_diff(k)).map_or(f64::NAN, |j| truth[j])
    };
    (0..truth.len()).map(nearest).collect()
}

/// Whether a table is taken where that in the ECU is the truth, in whole counts.
pub(super) fn changed(seed: u64, truth: &[f64], runs: &Path, watch: Watch) -> Result<bool, StudyError> {
    std::fs::create_dir_all(runs).map_err(|e| fail(&e))?;
    let path = runs.join(format!("true-{seed}.mlg"));
    let own = Own::of(seed);
    // A look-up is cut: half a count more is the truth on average.
    let count = |v: &f64| (v * FACTOR / own.factor + 0.5).round();
    let table: Vec<f64> = everywhere(truth).iter().map(count).collect();
    drive(seed, &own, &table, &path)?;
    let mut job = Job::ve(vec![path.clone()], None, None, Some(&runs.join("ve-true")));
    job.target_lambda = Some(1.0);
    let found = label::work::fit(&job, watch).map_err(|e| fail(&e))?;
    std::fs::remove_file(&path).map_err(|e| fail(&e))?;
    Ok(serde_json::to_value(found.found.judgement.decision).is_ok_and(|d| d == "change"))
}

/// Drives the car of `seed`, fits what its log says, and compares.
pub(super) fn back(seed: u64, truth: &[f64], runs: &Path, watch: Watch) -> Result<Back, StudyError> {
    std::fs::create_dir_all(runs).map_err(|e| fail(&e))?;
    let path = runs.join(format!("planted-{seed}.mlg"));
    let own = Own::of(seed);
    // What the engine breathes is more or less percent of another factor.
    let truth: Vec<f64> = truth.iter().map(|v| v * FACTOR / own.factor).collect();
    drive(seed, &own, &wrong(&truth), &path)?;
    let over = Overrides { out: Some(runs.join("pulse-planted")), ..Overrides::default() };
    let text = include_str!("pulse_planted.toml").replace("REQUIRED", &format!("{:e}", 1e-4 * REQUIRED_MS));
    let mut job = function::spec::parse("pulse_planted.toml", &text, &over).map_err(|e| fail(&e))?;
    job.data = vec![path.clone()];
    let pulse = function::work::fit(&job, watch).map_err(|e| fail(&e))?;
    let planted = std::iter::once(own.factor).chain(own.dead_ms);
    let of =
        |(k, truth): (usize, f64)| [pulse.fit.values[k] - truth, pulse.half_width[k].unwrap_or(f64::NAN)];
    let mut job = Job::ve(vec![path.clone()], None, None, Some(&runs.join("ve-planted")));
    job.target_lambda = Some(1.0);
    let found = label::work::fit(&job, watch).map_err(|e| fail(&e))?;
    let t = &found.found.table;
    let told = (0..truth.len()).filter(|k| t.verdicts[*k] == Verdict::Determined && truth[*k].is_finite());
    let (mut cells, mut off) = ([0; 3], 0.0);
    for k in told {
        cells[0] += 1;
        cells[1] += usize::from((t.exact[k] - truth[k]).abs() <= t.half_width[k]);
        cells[2] += usize::from((t.exact[k] - truth[k]).abs() <= 1.0);
        off += t.exact[k] - truth[k];
    }
    // A hundred logs are not kept.
    std::fs::remove_file(&path).map_err(|e| fail(&e))?;
    let j = &found.found.judgement;
    Ok(Back {
        pulse: planted.enumerate().map(of).collect(),
        cells,
        off,
        taken: serde_json::to_value(j.decision).is_ok_and(|d| d == "change"),
        lambda: [j.rms_before, j.rms_after],
    })
}
