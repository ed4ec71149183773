//! The fuel film of the virtual engine with port injection, from records of its bed: what `label film` says against the parameters.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_files::measurement::csv_io::write_columns;
use dynocal_jobs::engine::Engine;
use dynocal_jobs::engine::transient::{self, Every, Transient};
use dynocal_jobs::label::film::Film as Recipe;
use dynocal_jobs::label::{curve, function};
use dynocal_jobs::place::Place;
use dynocal_numerics::rng::Rng64;
use dynocal_plant::testbed::thermal::ThermalSettings;
use serde::{Deserialize, Serialize};

use super::refused;
use crate::{StudyError, Surroundings};

const SET: &str = "pfi_1_6l";
const SAMPLE_S: f64 = 0.02;
/// Temperatures in K at which tau is told.
const AT_K: [f64; 5] = [295.0, 302.0, 309.0, 358.0, 363.0];
/// Bed options of the two records.
const BEDS: [(&str, &str); 2] = [("warm", "start_k = 363.15"), ("cold", "start_k = 293.15")];

/// Share and time constants, found and true.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Film {
    pub(super) share: f64,
    pub(super) true_share: f64,
    /// Warm, cold: at the mean coolant temperature of the record.
    pub(super) coolant_k: [f64; 2],
    pub(super) tau_s: [f64; 2],
    pub(super) true_tau_s: [f64; 2],
    pub(super) unseen_rms: [f64; 2],
}

/// Inputs on the samples: throttle and fuel factor in steps that do not follow each other, speed now and then.
struct Drive {
    throttle_deg: Vec<f64>,
    speed_rpm: Vec<f64>,
    factor: Vec<f64>,
}

fn drive(seed: u64, length_s: f64) -> Drive {
    let mut rng = Rng64::new(seed);
    let n = (length_s / SAMPLE_S) as usize;
    let mut steps = |choices: Option<&[f64]>, range: [f64; 2], hold_s: [f64; 2]| -> Vec<f64> {
        let (mut value, mut until) = (0.0, -1.0);
        (0..n)
            .map(|k| {
                let t = SAMPLE_S * k as f64;
                if t >= until {
                    value = match choices {
                        Some(c) => c[((rng.uniform() * c.len() as f64) as usize).min(c.len() - 1)],
                        None => range[0] + (range[1] - range[0]) * rng.uniform(),
                    };
                    until = t + hold_s[0] + (hold_s[1] - hold_s[0]) * rng.uniform();
                }
                value
            })
            .collect()
    };
    Drive {
        throttle_deg: steps(Some(&[9.0, 11.0, 13.0, 16.0, 20.0, 25.0]), [0.0; 2], [2.0, 5.0]),
        speed_rpm: steps(Some(&[1200.0, 1600.0, 2000.0, 2600.0]), [0.0; 2], [8.0, 16.0]),
        factor: steps(None, [0.9, 1.1], [0.8, 2.5]),
    }
}

/// Drives the bed with this fuel.
fn record(
    d: &Drive,
    injection_mg: &[f64],
    bed: &str,
    folder: &Path,
    around: &Surroundings,
) -> Result<Transient, StudyError> {
    let fail = |e: &dyn std::fmt::Display| refused("film", e);
    let (inputs, options) = (folder.join("inputs.csv"), folder.join("bed.toml"));
    let time_s: Vec<f64> = (0..injection_mg.len()).map(|k| SAMPLE_S * k as f64).collect();
    let spark = vec![20.0; time_s.len()];
    let columns: [(&str, &str, &[f64]); 5] = [
        ("time", "s", &time_s),
        ("throttle", "deg", &d.throttle_deg),
        ("inj", "mg", injection_mg),
        ("spark", "deg", &spark),
        ("speed", "rpm", &d.speed_rpm),
    ];
    write_columns(&inputs, &columns).map_err(|e| fail(&e))?;
    let text = format!("saturate = true\noutputs = [\"air\", \"coolant\"]\n\n[engine.warm_up]\n{bed}\n");
    atomic::write(&options, text.as_bytes()).map_err(|e| fail(&e))?;
    let engine = Engine::named(SET).map_err(|e| fail(&e))?;
    let spec = transient::Spec {
        file: inputs,
        bed: Some(options),
        every: Every::Time { every_s: SAMPLE_S },
        seed: 1,
    };
    transient::run(&engine, &spec, around.watch).map_err(|e| fail(&e))
}

fn channel<'a>(t: &'a Transient, name: &str) -> Result<&'a [f64], StudyError> {
    let found = t.channels.iter().find(|c| c.name == name).map(|c| c.values.as_slice());
    found.ok_or_else(|| refused("film", format!("the bed has no channel `{name}`")))
}

/// Records, warm and cold, in which the fuel follows the air meter as an ECU does it, and their fit.
pub(super) fn fit(around: &Surroundings, length_s: f64) -> Result<Film, StudyError> {
    let fail = |e: &dyn std::fmt::Display| refused("film", e);
    let engine = Engine::named(SET).map_err(|e| fail(&e))?;
    let port = engine.params.port.ok_or_else(|| refused("film", "the engine has no port injection"))?;
    let (mut data, mut coolant_k) = (Vec::new(), [0.0; 2]);
    for (k, (name, bed)) in BEDS.iter().enumerate() {
        let folder = around.runs.join(format!("film-{name}"));
        std::fs::create_dir_all(&folder).map_err(|e| fail(&e))?;
        let d = drive(1 + k as u64, length_s);
        let first = record(&d, &vec![12.0; d.factor.len()], bed, &folder, around)?;
        let air = channel(&first, "air")?;
        // mg for each of four cylinders in two turns, two samples after the meter.
        let fuel: Vec<f64> = (0..air.len().min(d.factor.len()))
            .map(|k| {
                let mg = 1e3 * air[k.saturating_sub(2)] * 120.0
                    / (4.0 * d.speed_rpm[k])
                    / engine.params.gas.afr_stoich;
                (d.factor[k] * mg).clamp(2.0, 60.0)
            })
            .collect();
        let found = record(&d, &fuel, bed, &folder, around)?;
        let path = folder.join("record.csv");
        transient::csv(&path, &found).map_err(|e| fail(&e))?;
        let coolant = channel(&found, "coolant")?;
        coolant_k[k] = coolant.iter().sum::<f64>() / coolant.len() as f64;
        data.push(path);
    }
    let recipe = Recipe {
        data,
        fuel: "inj".into(),
        air: "air".into(),
        speed: "speed".into(),
        lambda: "lambda".into(),
        coolant: Some("coolant".into()),
        points: AT_K.to_vec(),
        cylinders: 4,
        afr: engine.params.gas.afr_stoich,
    };
    let job = recipe.job(Place::run("film", Some(&around.runs.join("film"))).out).map_err(|e| fail(&e))?;
    let (found, _) = function::run(&job, around.watch).map_err(|e| fail(&e))?;
    let tau = &found.fit.values[1..1 + AT_K.len()];
    Ok(Film {
        share: found.fit.values[0],
        true_share: port.share,
        coolant_k,
        tau_s: coolant_k.map(|t| curve(&AT_K, tau, t)),
        true_tau_s: coolant_k.map(|t| port.tau_s * ThermalSettings::default().film_factor(t)),
        unseen_rms: found.unseen_rms,
    })
}
