//! Print the steady outputs at one operating point.
//!
//! `cargo run --release -p dynocal-plant --example point -- 2000 15.85 18.95 16.754`
//! (speed rpm, throttle deg, spark deg BTDC, fuel mg).

use dynocal_plant::{engine::VirtualEngine, inputs::Inputs, params::EngineParams};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let v: Vec<f64> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let mut inputs = Inputs::default();
    if let [speed, throttle, spark, injection] = v[..] {
        inputs = Inputs {
            speed_rpm: speed,
            throttle_deg: throttle,
            spark_deg: spark,
            injection_mg: injection,
            ..inputs
        };
    }
    let mut engine = VirtualEngine::new(&EngineParams::thesis())?;
    engine.set_inputs(inputs)?;
    let start = std::time::Instant::now();
    engine.advance_time(6.0);
    let elapsed = start.elapsed().as_secs_f64();
    engine.check_state()?;
    println!("{:#?}", engine.outputs());
    println!("real-time factor {:.1}", 6.0 / elapsed);
    Ok(())
}
