//! Scenario 5: heating of the catalyst, everything at 20 degC, 1200 rpm and 25 Nm for 60 s.
//!
//! Torque is held by the throttle, lambda by the fuel, with the same loops for all. The rival takes a constant retard from the spark,
//! the one of several that leaves least HC behind the catalyst. Ours takes a retard and holds a lean mixture until the thermocouple in
//! the brick shows that it converts: retard, lambda and temperature by trials on the bed that keep the rival's HC at least fuel. Beside it stands a
//! constant retard with a constant lambda, chosen by the same rule, so that what the end is worth is told from what the mixture is.

use dynocal_ident::plant::{Causality, Plant};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_report::{Cell, Column, Report, Section, Table};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::bed::SAMPLE_S;
use super::contest::Ended;
use super::engines::Group;
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
/// What is tried: retard in deg; lambda, a few hundredths (a cold engine is not sure to burn more, and NO is not looked at); temperature of the brick at which both end, in K, over so many kelvin.
const RETARDS_DEG: [f64; 9] = [0.0, 5.0, 10.0, 15.0, 20.0, 24.0, 28.0, 32.0, 36.0];
const LAMBDAS: [f64; 5] = [0.97, 1.0, 1.02, 1.04, 1.06];
const ENDS_K: [f64; 6] = [400.0, 500.0, 600.0, 700.0, 800.0, 900.0];
const OVER_K: f64 = 50.0;
/// Times that lines over end, lambda and retard are searched in turn.
const ROUNDS: usize = 2;
/// What a result depends on beside engine, seed and length: another first number with every change of the procedure.
pub(super) const TRIED: (usize, [f64; 9], [f64; 5], [f64; 6]) = (3, RETARDS_DEG, LAMBDAS, ENDS_K);
/// Share of the rival's HC that ours may have in its trials: other cold starts scatter.
const ROOM: f64 = 0.98;
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

/// A retard and the lambda that is held with it, and where both end; none: they do not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Retard {
    deg: f64,
    lambda: f64,
    until_k: Option<f64>,
}

impl Retard {
    /// Without end, at lambda 1.
    fn constant(deg: f64) -> Self {
        Self { deg, lambda: 1.0, until_k: None }
    }

    /// Retard and demanded lambda while the brick has a temperature.
    fn at(self, brick_k: f64) -> (f64, f64) {
        let left = self.until_k.map_or(1.0, |end| ((end + OVER_K - brick_k) / OVER_K).clamp(0.0, 1.0));
        (self.deg * left, 1.0 + (self.lambda - 1.0) * left)
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
    /// Constant retards as they were tried; no retard, the best constant one, ours, and a constant one with a constant lambda that is chosen as ours, as
    /// they are judged.
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
        let (retard_deg, lambda) = retard.at(y[BRICK]);
        let lean = (y[1] - lambda).clamp(-0.2, 0.2);
        factor = (factor + LAMBDA.1 * lean * SAMPLE_S).clamp(0.5, 2.0);
        u[0] = (per_kpa * y[2] * (factor + LAMBDA.0 * lean)).clamp(2.0, 60.0);
        u[1] = (SPARK_DEG - retard_deg).max(LEAST_DEG);
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
    let trials = Trials { bed: &bed, seed: case.seed, interrupted };
    let stride = if reduced { 4 } else { 1 };
    let constant = trials.all(RETARDS_DEG.iter().step_by(stride).map(|d| Retard::constant(*d)).collect())?;
    let best = least(constant.iter().copied())?;
    // A rival with the same mixtures, chosen as ours is, that does not know when to end.
    let lambdas = || LAMBDAS.iter().step_by(stride);
    let grid = RETARDS_DEG.iter().step_by(stride).flat_map(|d| lambdas().map(|l| (*d, *l)));
    let grid = grid.map(|(deg, lambda)| Retard { deg, lambda, until_k: None });
    let lean = trials.all(grid.collect())?.into_iter().fold(best, |b, t| cheaper(best.hc_g, b, t));
    let ours = trials.ended(best, stride)?;
    let judged = [Retard::constant(0.0), best.retard, ours.retard, lean.retard];
    case.judged =
        judged.par_iter().map(|r| run(&bed, case.seed + 1000, *r)).collect::<Result<_, String>>()?;
    case.tried = constant;
    Ok(())
}

/// The run that leaves least HC.
fn least(all: impl Iterator<Item = Told>) -> Result<Told, Ended> {
    all.min_by(|a, b| a.hc_g.total_cmp(&b.hc_g)).ok_or_else(|| "no retard was tried".to_string().into())
}

/// Of two runs the one with less fuel that leaves no more HC than a rival's, less some room; where one leaves more, that with less HC.
fn cheaper(rival_hc_g: f64, a: Told, b: Told) -> Told {
    let cost = |t: &Told| ((t.hc_g - ROOM * rival_hc_g).max(0.0), t.fuel_g);
    if cost(&b) < cost(&a) { b } else { a }
}

/// Trials on the bed.
struct Trials<'a> {
    bed: &'a EngineBed,
    seed: u64,
    interrupted: &'a (dyn Fn() -> bool + Sync),
}

impl Trials<'_> {
    fn all(&self, tried: Vec<Retard>) -> Result<Vec<Told>, Ended> {
        if (self.interrupted)() {
            return Err(Ended::Interrupted);
        }
        Ok(tried.par_iter().map(|r| run(self.bed, self.seed, *r)).collect::<Result<_, String>>()?)
    }

    /// Least fuel with the HC of a constant retard, less some room; where none has that, least HC. Line by line from that retard.
    fn ended(&self, from: Told, stride: usize) -> Result<Told, Ended> {
        let mut best = from;
        let rounds = if stride > 1 { 1 } else { ROUNDS };
        for _ in 0..rounds {
            for line in 0..3 {
                let at = best.retard;
                let tried: Vec<Retard> = match line {
                    0 => LAMBDAS.iter().map(|l| Retard { lambda: *l, ..at }).collect(),
                    1 => ENDS_K.iter().map(|k| Retard { until_k: Some(*k), ..at }).collect(),
                    _ => RETARDS_DEG.iter().map(|d| Retard { deg: *d, ..at }).collect(),
                };
                for t in self.all(tried.into_iter().step_by(stride).collect())? {
                    best = cheaper(from.hc_g, best, t);
                }
            }
        }
        Ok(best)
    }
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

/// A number of no retard, the best constant one, ours, and the constant one with a constant lambda that is chosen as ours.
type Of = fn(&[Told; 4]) -> f64;

/// The checks; none where no case was run.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let numbers: [(&str, &str, Asked, Of); 6] = [
        (
            "hc",
            "HC behind the catalyst over that of the best constant retard",
            Asked::AtMost(1.0),
            |[_, r, o, _]| o.hc_g / r.hc_g,
        ),
        (
            "fuel",
            "fuel beyond that without retard over that of the best constant retard",
            Asked::AtMost(0.6667),
            |[n, r, o, _]| (o.fuel_g - n.fuel_g) / (r.fuel_g - n.fuel_g),
        ),
        (
            "light-off",
            "time until half is converted over that of the best constant retard",
            Asked::Reported,
            |[_, r, o, _]| o.half_s / r.half_s,
        ),
        (
            "hc-lean",
            "HC behind the catalyst over that of a constant retard with a constant lambda, chosen as ours",
            Asked::Reported,
            |[_, _, o, l]| o.hc_g / l.hc_g,
        ),
        (
            "fuel-lean",
            "fuel beyond that without retard over that of a constant retard with a constant lambda, chosen as ours",
            Asked::Reported,
            |[n, _, o, l]| (o.fuel_g - n.fuel_g) / (l.fuel_g - n.fuel_g),
        ),
        ("none", "HC without retard over that of the best constant one", Asked::Reported, |[n, r, ..]| {
            n.hc_g / r.hc_g
        }),
    ];
    let mut out = Vec::new();
    for group in Group::ALL {
        let (own, (suffix, words)) = (group == Group::Own, group.words());
        for (id, what, asked, of) in numbers {
            let of_it = all.iter().filter(|c| Group::of(ENGINE, &c.heated) == group);
            let found: Vec<Option<f64>> =
                of_it.map(|c| <[Told; 4]>::try_from(c.judged.clone()).ok().map(|j| of(&j))).collect();
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
    let words = |r: Retard| {
        let end = r.until_k.map_or(String::new(), |k| format!(", until the brick has {k} K"));
        format!("{} deg, lambda {}{end}", r.deg, r.lambda)
    };
    let named = [
        ("none, ", 0),
        ("best constant, ", 1),
        ("ours, ", 2),
        ("constant retard and lambda, chosen as ours, ", 3),
    ];
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
        "{}, seed {}, on its real bed: 1200 rpm, 25 Nm, 60 s, everything at 20 degC at the start. The rival is the constant retard that leaves least HC; ours ends its retard and its lean mixture by the temperature of the brick.",
        first.heated, first.seed
    );
    report.section(Section::new("Heating of the catalyst").text(text).block(table))
}
