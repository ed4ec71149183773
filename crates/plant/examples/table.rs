//! Best-spark static table compared with a reference table.
//!
//! `cargo run --release -p dynocal-plant --example table -- virtual_engine_reference.json [every]`

use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::{SettleOptions, Target, static_map};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("give the reference file")?;
    let every: usize = std::env::args().nth(2).map_or(Ok(1), |a| a.parse())?;
    let text = std::fs::read_to_string(path)?;
    let reference: serde_json::Value = serde_json::from_str(&text)?;
    let rows: Vec<_> =
        reference["static_reference"].as_array().ok_or("no table")?.iter().step_by(every).collect();
    let number = |r: &serde_json::Value, name: &str| r[name].as_f64().unwrap_or(f64::NAN);
    let targets: Vec<Target> = rows
        .iter()
        .map(|r| Target { speed_rpm: number(r, "speed_rpm"), torque_nm: number(r, "torque_Nm"), lambda: 1.0 })
        .collect();
    let start = std::time::Instant::now();
    let points = static_map(&EngineParams::thesis(), &targets, SettleOptions::default())?;
    let mut held = 0;
    let mut worst = [0.0f64; 5];
    for (r, point) in rows.iter().zip(points) {
        let (n, t) = (number(r, "speed_rpm"), number(r, "torque_Nm"));
        let point = match point {
            Ok(p) => p,
            Err(e) => {
                println!("{n:5} {t:4}  {e}");
                continue;
            }
        };
        let (u, y) = (point.inputs, point.outputs);
        let d = [
            100.0 * (u.injection_mg / number(r, "inj_mg") - 1.0),
            u.throttle_deg - number(r, "throttle_deg"),
            100.0 * (y.map_kpa / number(r, "map_kPa") - 1.0),
            y.egt_k - 273.15 - number(r, "egt_C"),
            u.spark_deg - number(r, "spark_opt_degBTDC"),
        ];
        let inside = d.iter().zip([0.5, 0.1, 0.5, 5.0, 0.7]).all(|(d, tol)| d.abs() <= tol);
        held += usize::from(inside);
        for (w, d) in worst.iter_mut().zip(d) {
            *w = w.max(d.abs());
        }
        println!(
            "{n:5} {t:4}  inj {:+.3} %  throttle {:+.3} deg  map {:+.3} %  egt {:+.2} K  spark {:+.2} deg  {:5.1} s {}",
            d[0],
            d[1],
            d[2],
            d[3],
            d[4],
            point.time_s,
            if inside { "" } else { "OUT" }
        );
    }
    println!("{held} of {} inside; worst {worst:?}; {:.1} s", rows.len(), start.elapsed().as_secs_f64());
    Ok(())
}
