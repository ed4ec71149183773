//! The whole campaign on the embedded virtual engine, printed.
use dynocal_calib::chain::context::{Context, Event};
use dynocal_calib::chain::run::run;
use dynocal_calib::chain::spec::CalibrateSpec;
use dynocal_files::run_folder::RunFolder;
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let mut spec: CalibrateSpec = args.get(3).map_or(Ok(CalibrateSpec::default()), |p| {
        toml::from_str(&std::fs::read_to_string(p).unwrap_or_default())
    })?;
    if let Some(seed) = args.get(4) {
        spec.seed = seed.parse()?;
    }
    let (tn, ln) = (spec.plant.torque_noise_nm, spec.plant.lambda_noise);
    let plants = move |noise: bool| -> Result<Box<dyn Plant>, PlantError> {
        let mut settings = BedSettings::default();
        if noise {
            settings.noise.torque_nm = tn;
            settings.noise.lambda = ln;
        }
        let bed = EngineBed::new(&EngineParams::thesis(), settings).map_err(|e| PlantError::Call(e.to_string()))?;
        Ok(Box::new(bed))
    };
    let t0 = std::time::Instant::now();
    let tell = |e: Event| if true { eprintln!("{:7.2} {e:?}", t0.elapsed().as_secs_f64()) };
    let ctx = Context { spec: &spec, plants: Some(&plants), measured: "measured".into(), interrupt: &|| false, tell: &tell };
    let mut folder = RunFolder::open(std::path::Path::new(&args[1]), "calibrate", &spec)?;
    let r = run(&ctx, &mut folder, &args[2])?;
    eprintln!("{:7.2} done, bed {} s", t0.elapsed().as_secs_f64(), r.bed_s());
    if let Some(m) = &r.identify {
        for o in [&m.result.torque, &m.result.lambda] {
            for c in &o.candidates {
                println!("{} {}: unseen {:?} status {:?} ev {} p {}  {:?}", o.output, c.name, c.unseen_r2, c.status, c.evaluations, c.model.theta.len(), c.scores.iter().map(|s| s.r2.map(|v| (v * 1e4).round() / 1e4)).collect::<Vec<_>>());
            }
        }
    }
    if let Some(d) = &r.design {
        println!("{:?} {} {:?}", d.result.status, d.result.evaluations, d.result.criteria);
        for s in &d.result.safety { println!("{s:?}"); }
        for s in &d.result.gains { println!("{s:?}"); }
    }
    if let Some(d) = &r.optimise {
        for p in &d.result.passes {
            println!("pass {} {:?} it {} promised {:.4} measured {:.4} work {:.4} viol {:.1e} {:.1e} rms {:.3} {:.4} | R2 {:?} {:?}", p.pass, p.status, p.iterations, p.promised_ratio, p.measured_ratio, p.fuel_per_work_ratio, p.torque_violation_nm, p.lambda_violation, p.torque_rms_nm, p.lambda_rms, p.torque.best().unseen_r2, p.lambda.best().unseen_r2);
        }
    }
    if let Some(d) = &r.invert { for s in &d.result.scores { println!("{s:?}"); } }
    if let Some(d) = &r.validate {
        println!("{:?} static bed {}", d.result.best_spark, d.result.static_map.bed_s);
        for s in &d.result.scores { println!("{s:#?}"); }
    }
    Ok(())
}
