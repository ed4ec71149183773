//! Full load and part load of a parameter file: `load FILE.toml TORQUE RPM...`.

use dynocal_plant::full_load::{LoadLimits, load_map};
use dynocal_plant::params::EngineParams;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let params = EngineParams::from_toml(&std::fs::read_to_string(&args[0])?)?;
    let torques: Vec<f64> = args[1].split(',').map(str::parse).collect::<Result<_, _>>()?;
    let speeds: Vec<f64> = args[2..].iter().map(|s| s.parse()).collect::<Result<_, _>>()?;
    println!(
        "rpm   Nm     thr  wg   spark inj  lam   map   boost pexh egt  turbo  ca50 burn knock res  bsfc pmax volef pmep fmep NO CO HC set t"
    );
    for row in load_map(&params, &speeds, &torques, LoadLimits::default())? {
        for point in row {
            let p = point?;
            let (u, y) = (p.inputs, p.outputs);
            println!(
                "{:5.0} {:6.1} {:5.1} {:5.2} {:5.1} {:5.1} {:5.3} {:5.1} {:5.1} {:5.1} {:4.0} {:6.0} {:4.1} {:4.1} {:5.2} {:5.3} {:5.1} {:5.1} {:5.3} {:5.2} {:5.2} {:5.0} {:5.2} {:5.0} {} {:.1}",
                u.speed_rpm,
                y.torque_nm,
                u.throttle_deg,
                u.wastegate_mm,
                u.spark_deg,
                u.injection_mg,
                p.lambda,
                y.map_kpa,
                y.boost_kpa,
                y.exhaust_kpa,
                y.egt_k - 273.15,
                y.turbo_rpm,
                y.ca50_deg,
                y.burn_deg,
                y.knock,
                y.residual,
                y.bsfc_g_kwh,
                y.pmax_bar,
                y.volumetric_efficiency,
                y.pmep_bar,
                y.fmep_bar,
                y.no_ppm,
                y.co_pct,
                y.hc_ppm,
                p.settled,
                p.time_s
            );
        }
    }
    Ok(())
}
