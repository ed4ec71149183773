//! The static calibration of the thesis in full: 121 operating points, 36 sparks each, 10 s simulated for every one
//! (9 s to settle, 1 s averaged, thesis 6.6.1), on all cores. Prints how long it took and how far the spark of most
//! torque at given air and fuel is from the reference table.
//!
//! `cargo run --release -p dynocal-plant --example static_calibration -- virtual_engine_reference.json [every]`

use dynocal_plant::{engine::VirtualEngine, inputs::Inputs, params::EngineParams};
use rayon::prelude::*;

const SPARKS_DEG: std::ops::RangeInclusive<u32> = 5..=40;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("give the reference file")?;
    let every: usize = std::env::args().nth(2).map_or(Ok(1), |a| a.parse())?;
    let reference: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let rows = reference["static_reference"].as_array().ok_or("no table")?;
    let number = |r: &serde_json::Value, name: &str| r[name].as_f64().unwrap_or(f64::NAN);
    let points: Vec<(Inputs, f64)> = rows
        .iter()
        .step_by(every)
        .map(|r| {
            let inputs = Inputs {
                speed_rpm: number(r, "speed_rpm"),
                throttle_deg: number(r, "throttle_deg"),
                injection_mg: number(r, "inj_mg"),
                ..Inputs::default()
            };
            (inputs, number(r, "spark_opt_degBTDC"))
        })
        .collect();
    let runs: Vec<Inputs> = points
        .iter()
        .flat_map(|(i, _)| SPARKS_DEG.map(|s| Inputs { spark_deg: f64::from(s), ..*i }))
        .collect();
    let fresh = VirtualEngine::new(&EngineParams::thesis())?;
    let start = std::time::Instant::now();
    let torque: Result<Vec<f64>, dynocal_plant::error::PlantError> = runs
        .par_iter()
        .map(|inputs| {
            let mut engine = fresh.clone();
            engine.set_inputs(*inputs)?;
            engine.advance_time(9.0);
            engine.clear_interval();
            let mut sum = 0.0;
            for _ in 0..100 {
                engine.advance_time(0.01);
                sum += engine.outputs().torque_nm;
            }
            Ok(sum / 100.0)
        })
        .collect();
    let (torque, seconds) = (torque?, start.elapsed().as_secs_f64());
    let sparks = SPARKS_DEG.count();
    let first = f64::from(*SPARKS_DEG.start());
    let mut worst = 0.0f64;
    for (of_point, (_, wanted)) in torque.chunks_exact(sparks).zip(&points) {
        let best = (0..sparks).max_by(|a, b| of_point[*a].total_cmp(&of_point[*b])).unwrap_or(0);
        worst = worst.max((first + best as f64 - wanted).abs());
    }
    println!(
        "{} runs of 10 s in {seconds:.1} s on {} threads ({:.0} times real time in all); spark of most torque at most \
         {worst:.1} deg from the table",
        runs.len(),
        rayon::current_num_threads(),
        10.0 * runs.len() as f64 / seconds
    );
    Ok(())
}
