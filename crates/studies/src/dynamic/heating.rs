//! Scenario 5: heating of the catalyst, everything at 20 degC, 1200 rpm and 25 Nm for 60 s.
//!
//! Torque is held by the throttle, lambda by the fuel, with the same loops for all. The rival takes a constant retard from the spark,
//! the one of several that leaves least HC behind the catalyst; ours takes a retard until the thermocouple in the brick shows that it
//! converts, retard and temperature by trials on the bed that keep the rival's HC at least fuel.

use dynocal_ident::plant::{Causality, Plant};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_report::{Cell, Column, Report, Section, Table};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::bed::SAMPLE_S;
use super::contest::Ended;
use super::judge::judged;
use crate::asked::Asked;
use crate::{Check, StudyError, TaskResult};

/// Parameter set.
pub(super) const ENGINE: &str = "gtdi_2l";
const START_K: f64 = 293.15;
const SPEED_RPM: f64 = 1200.0;
const TORQUE_NM: f64 = 25.0;
const LENGTH_S: f64 = 60.0;
/// Spark of a warm engine there, in deg, and its least.
const SPARK_DEG: f64 = 26.0;
const LEAST_DEG: f64 = -10.0;
/// What is tried: retard in deg; temperature of the brick at which it ends, in K, over so many kelvin.
const RETARDS_DEG: [f64; 9] = [0.0, 5.0, 10.0, 15.0, 20.0, 24.0, 28.0, 32.0, 36.0];
const ENDS_K: [f64; 6] = [400.0, 500.0, 600.0, 700.0, 800.0, 900.0];
const OVER_K: f64 = 50.0;
/// Loops: throttle per error of torque, fuel per error of lambda, per second.
const TORQUE: (f64, f64) = (0.01, 0.08);
const LAMBDA: (f64, f64) = (0.05, 0.8);
/// Places of the outputs behind the five standard ones.
const CONVERSION: usize = 5;
const BRICK: usize = 6;
const ASKED: [&str; 2] = ["conversion", "catalyst"];
/// Molar masses in g/mol: exhaust, HC as CH1.9.
const EXHAUST_G: f64 = 28.8;
const HC_G: f64 = 13.9;

/// A retard, and where it ends; none: it does not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Retard {
    deg: f64,
    until_k: Option<f64>,
}

impl Retard {
    fn at(self, brick_k: f64) -> f64 {
        let left = self.until_k.map_or(1.0, |end| ((end + OVER_K - brick_k) / OVER_K).clamp(0.0, 1.0));
        self.deg * left
    }
}

/// What a run of 60 s took and left.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Told {
    retard: Retard,
    fuel_g: f64,
    /// Unburned fuel before and behind the catalyst in g.
    hc_raw_g: f64,
    hc_g: f64,
    /// Time until half is converted in s; that of the run where it is not.
    half_s: f64,
    /// Mean distance of the torque from its demand in the last half, in Nm.
    torque_nm: f64,
}

/// An engine with a seed.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct HeatingCase {
    heated: String,
    seed: u64,
    failed: Option<String>,
    /// Constant retards as they were tried; no retard, the best constant one and ours as they are judged.
    tried: Vec<Told>,
    judged: Vec<Told>,
}

fn bed(engine: &str) -> Result<EngineBed, String> {
    let params = EngineParams::named(engine).map_err(|e| e.to_string())?;
    let mut settings = BedSettings::of_set(engine, &params).map_err(|e| e.to_string())?;
    settings.options.outputs = ASKED.map(String::from).to_vec();
    settings.options.saturate = true;
    let real = &mut settings.options.engine;
    real.warm_up.iter_mut().for_each(|t| t.start_k = START_K);
    real.catalyst.iter_mut().for_each(|c| c.start_k = START_K);
    EngineBed::new(&params, settings).map_err(|e| e.to_string())
}

fn run(bed: &EngineBed, seed: u64, retard: Retard) -> Result<Told, String> {
    let mut bed = bed.clone();
    bed.reset(seed);
    let inputs = bed.variables().iter().take_while(|v| v.causality == Causality::Input).count();
    let mut u: Vec<f64> = bed.variables()[..inputs].iter().map(|v| v.start).collect();
    let mut y = vec![0.0; bed.variables().len() - inputs];
    bed.outputs(&mut y).map_err(|e| e.to_string())?;
    let per_kpa = u[0] / y[2];
    let (mut throttle, mut factor) = (u[2], 1.0);
    let mut out = Told { retard, fuel_g: 0.0, hc_raw_g: 0.0, hc_g: 0.0, half_s: LENGTH_S, torque_nm: 0.0 };
    let n = (LENGTH_S / SAMPLE_S) as usize;
    for t in 0..n {
        let missing = TORQUE_NM - y[0];
        throttle = (throttle + TORQUE.1 * missing.clamp(-20.0, 20.0) * SAMPLE_S).clamp(1.0, 60.0);
        let lean = (y[1] - 1.0).clamp(-0.2, 0.2);
        factor = (factor + LAMBDA.1 * lean * SAMPLE_S).clamp(0.5, 2.0);
        u[0] = (per_kpa * y[2] * (factor + LAMBDA.0 * lean)).clamp(2.0, 60.0);
        u[1] = (SPARK_DEG - retard.at(y[BRICK])).max(LEAST_DEG);
        u[2] = (throttle + TORQUE.0 * missing).clamp(1.0, 60.0);
        u[3] = SPEED_RPM;
        bed.step(&u, SAMPLE_S, &mut y).map_err(|e| e.to_string())?;
        let truth = bed.engine().outputs();
        let fuel_g_s = truth.fuel_kg_h / 3.6;
        let raw = 1e-6 * truth.hc_ppm * (truth.air_g_s + fuel_g_s) * HC_G / EXHAUST_G;
        out.fuel_g += fuel_g_s * SAMPLE_S;
        out.hc_raw_g += raw * SAMPLE_S;
        out.hc_g += raw * (1.0 - y[CONVERSION]) * SAMPLE_S;
        if y[CONVERSION] >= 0.5 && out.half_s >= LENGTH_S {
            out.half_s = t as f64 * SAMPLE_S;
        }
        if t >= n / 2 {
            out.torque_nm += (truth.torque_cycle_nm - TORQUE_NM).abs() * 2.0 / n as f64;
        }
    }
    Ok(out)
}

/// A case; what fails in it is its result.
pub(super) fn case(
    name: &str,
    engine: &str,
    seed: u64,
    reduced: bool,
    interrupted: &(dyn Fn() -> bool + Sync),
) -> Result<serde_json::Value, StudyError> {
    let mut case =
        HeatingCase { heated: engine.into(), seed, failed: None, tried: Vec::new(), judged: Vec::new() };
    match filled(&mut case, reduced, interrupted) {
        Ok(()) => {}
        Err(Ended::Interrupted) => return Err(StudyError::Interrupted),
        Err(Ended::Failed(reason)) => case.failed = Some(reason),
    }
    serde_json::to_value(case).map_err(|e| StudyError::Task { what: name.into(), reason: e.to_string() })
}

fn filled(
    case: &mut HeatingCase,
    reduced: bool,
    interrupted: &(dyn Fn() -> bool + Sync),
) -> Result<(), Ended> {
    let bed = bed(&case.heated)?;
    let stride = if reduced { 4 } else { 1 };
    let tried = |all: Vec<Retard>| -> Result<Vec<Told>, Ended> {
        if interrupted() {
            return Err(Ended::Interrupted);
        }
        Ok(all.par_iter().map(|r| run(&bed, case.seed, *r)).collect::<Result<_, String>>()?)
    };
    let retards: Vec<f64> = RETARDS_DEG.iter().step_by(stride).copied().collect();
    let constant = tried(retards.iter().map(|d| Retard { deg: *d, until_k: None }).collect())?;
    let least = constant.iter().min_by(|a, b| a.hc_g.total_cmp(&b.hc_g));
    let best = *least.ok_or_else(|| "no retard was tried".to_string())?;
    let ends: Vec<f64> = ENDS_K.iter().step_by(stride.min(2)).copied().collect();
    let ended = retards.iter().flat_map(|d| ends.iter().map(|k| Retard { deg: *d, until_k: Some(*k) }));
    let ours = tried(ended.collect())?;
    // Least fuel with the rival's HC; where none has it, least HC.
    let as_clean = ours.iter().filter(|t| t.hc_g <= best.hc_g).min_by(|a, b| a.fuel_g.total_cmp(&b.fuel_g));
    let chosen = as_clean.or_else(|| ours.iter().min_by(|a, b| a.hc_g.total_cmp(&b.hc_g)));
    let chosen = chosen.map_or(best.retard, |t| t.retard);
    let judged = [Retard { deg: 0.0, until_k: None }, best.retard, chosen];
    case.judged =
        judged.par_iter().map(|r| run(&bed, case.seed + 1000, *r)).collect::<Result<_, String>>()?;
    case.tried = constant;
    Ok(())
}

fn cases(results: &[TaskResult]) -> Vec<HeatingCase> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}

/// Number of results that are cases of this scenario, and those that failed.
pub(super) fn counted(results: &[TaskResult]) -> (usize, Vec<String>) {
    let all = cases(results);
    let failed = |c: &HeatingCase| c.failed.as_ref().map(|f| format!("{}, seed {}: {f}", c.heated, c.seed));
    (all.len(), all.iter().filter_map(failed).collect())
}

/// A number of no retard, the best constant one, and ours.
type Of = fn(&[Told; 3]) -> f64;

/// The checks; none where no case was run.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let numbers: [(&str, &str, Asked, Of); 4] = [
        (
            "hc",
            "HC behind the catalyst over that of the best constant retard",
            Asked::AtMost(1.0),
            |[_, r, o]| o.hc_g / r.hc_g,
        ),
        (
            "fuel",
            "fuel beyond that without retard over that of the best constant retard",
            Asked::AtMost(0.6667),
            |[n, r, o]| (o.fuel_g - n.fuel_g) / (r.fuel_g - n.fuel_g),
        ),
        (
            "light-off",
            "time until half is converted over that of the best constant retard",
            Asked::Reported,
            |[_, r, o]| o.half_s / r.half_s,
        ),
        ("none", "HC without retard over that of the best constant one", Asked::Reported, |[n, r, _]| {
            n.hc_g / r.hc_g
        }),
    ];
    let mut out = Vec::new();
    for (own, suffix, words) in [(true, "", "mean of seeds"), (false, "-others", "worst of engines like it")]
    {
        for (id, what, asked, of) in numbers {
            let of_it = all.iter().filter(|c| (c.heated == ENGINE) == own);
            let found: Vec<Option<f64>> =
                of_it.map(|c| <[Told; 3]>::try_from(c.judged.clone()).ok().map(|j| of(&j))).collect();
            if own || !found.is_empty() {
                let (id, what) =
                    (format!("5-{id}{suffix}"), format!("catalyst from 20 degC, 60 s: {what}, {words}"));
                out.push(judged(&id, &what, asked, &found, !own));
            }
        }
    }
    out
}

/// The section of the page.
pub(super) fn section(report: Report, results: &[TaskResult]) -> Report {
    let all = cases(results);
    let Some(first) = all.iter().find(|c| !c.judged.is_empty()) else { return report };
    let mut table = Table::new(vec![
        Column::text("Retard"),
        Column::number("fuel", "g").digits(4),
        Column::number("HC before", "g").digits(3),
        Column::number("behind the catalyst", "g").digits(3),
        Column::number("half converted", "s").digits(3),
        Column::number("torque off", "Nm").digits(2),
    ]);
    let words = |r: Retard| match r.until_k {
        None => format!("{} deg", r.deg),
        Some(k) => format!("{} deg until the brick has {k} K", r.deg),
    };
    let named = [("none, ", 0), ("best constant, ", 1), ("ours, ", 2)];
    let judged = named.iter().filter_map(|(n, k)| first.judged.get(*k).map(|t| (format!("{n}judged: "), *t)));
    let rows = first.tried.iter().map(|t| ("tried: ".to_string(), *t)).chain(judged);
    for (name, t) in rows {
        let values = [t.fuel_g, t.hc_raw_g, t.hc_g, t.half_s, t.torque_nm].map(Cell::from);
        table = table.row(
            std::iter::once(Cell::from(format!("{name}{}", words(t.retard))))
                .chain(values)
                .collect::<Vec<_>>(),
        );
    }
    let text = format!(
        "{}, seed {}, on its real bed: 1200 rpm, 25 Nm, 60 s, everything at 20 degC at the start. The rival is the constant retard that leaves least HC; ours ends its retard by the temperature of the brick.",
        first.heated, first.seed
    );
    report.section(Section::new("Heating of the catalyst").text(text).block(table))
}
