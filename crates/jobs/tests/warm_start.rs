//! A warm start on a record of the virtual engine: never worse than the fit without it.

use std::fmt::Write as _;

use dynocal_files::atomic;
use dynocal_ident::plant::{Causality, Variable};
use dynocal_ident::validate::Kind;
use dynocal_jobs::identify::{job, spec};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants::{PLANTS, PlantSpec};

const SAMPLES: usize = 1600;
const DT_S: f64 = 0.03;

/// Inputs about their start values in held levels, and the torque with the noise of the bed: CSV and the names.
fn record() -> (String, Vec<Variable>) {
    let plant = PlantSpec { torque_noise_nm: 0.5, ..PlantSpec::default() };
    let make = PLANTS.iter().find(|p| p.doc.name == plant.name).and_then(|p| p.make).unwrap();
    let mut engine = make(&plant, true).unwrap();
    let all = engine.variables().to_vec();
    let of = |c: Causality| all.iter().filter(|v| v.causality == c).cloned().collect::<Vec<_>>();
    let (inputs, outputs) = (of(Causality::Input), of(Causality::Output));
    let torque = outputs.iter().position(|v| v.name == "torque").unwrap();
    let mut rng = Rng64::new(12);
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for v in &inputs {
        let reach = 0.08 * (v.max - v.min);
        let mut column = Vec::new();
        while column.len() < SAMPLES {
            let level = rng.uniform_in((v.start - reach).max(v.min), (v.start + reach).min(v.max));
            let hold = 8 + rng.below(40);
            column.extend(std::iter::repeat_n(level, hold));
        }
        columns.push(column);
    }
    engine.reset(1);
    let mut text =
        inputs.iter().map(|v| format!("{} [{}],", v.name, v.unit)).collect::<String>() + "torque [Nm]\n";
    let mut y = vec![0.0; outputs.len()];
    for t in 0..SAMPLES {
        let u: Vec<f64> = columns.iter().map(|c| c[t]).collect();
        engine.step(&u, DT_S, &mut y).unwrap();
        u.iter().for_each(|v| write!(text, "{v},").unwrap());
        writeln!(text, "{}", y[torque]).unwrap();
    }
    (text, inputs)
}

#[test]
fn on_an_engine_record_the_warm_start_is_never_worse() {
    let (text, inputs) = record();
    let place = tempfile::tempdir().unwrap();
    atomic::write(&place.path().join("bed.csv"), text.as_bytes()).unwrap();
    let mut head = format!("[data]\nfile = 'bed.csv'\nsample_time_s = {DT_S}\n");
    for (name, unit, role) in
        inputs.iter().map(|v| (v.name.as_str(), v.unit.as_str(), "input")).chain([("torque", "Nm", "output")])
    {
        write!(head, "[[channels]]\ncolumn = '{name}'\nunit = '{unit}'\nrole = '{role}'\n").unwrap();
    }
    head += "[split]\nestimation_rows = [[0, 1200]]\ntest_rows = [[1200, 1600]]\n";
    let mut terms = vec!["'1'".to_string(), "'torque(t-1)'".into(), "'torque(t-2)'".into()];
    for v in &inputs {
        let name = &v.name;
        terms.extend([
            format!("'{name}(t-1)'"),
            format!("'{name}(t-2)'"),
            format!("'{name}(t-1)*torque(t-1)'"),
        ]);
    }
    let polynomial = format!("{{ name = 'polynomial', regressors = [{}] }}", terms.join(", "));
    for structure in [polynomial.as_str(), "{ name = 'arx', na = 2, nb = 2 }"] {
        let rmse = |samples: usize| -> f64 {
            let spec = format!(
                "{head}[model]\nstructure = {structure}\nwarm_start_samples = {samples}\nestimator = {{ name = 'sem' }}\n"
            );
            let path = place.path().join("spec.toml");
            atomic::write(&path, spec.as_bytes()).unwrap();
            let out = Some(place.path().join(format!("run{samples}")));
            let job = spec::read(&path, &spec::Overrides { out, ..Default::default() }).unwrap();
            let found = job::run(&job, Watch::silent()).unwrap().0;
            let score = found.scores.iter().find(|s| s.part == "estimation" && s.kind == Kind::FreeRun);
            score.unwrap().rmse.unwrap_or(f64::INFINITY)
        };
        let cold = rmse(0);
        for samples in [100, 200, 400, 800] {
            let warm = rmse(samples);
            println!("{samples} samples first: RMSE {warm:.5}, without {cold:.5}");
            assert!(warm <= cold * (1.0 + 1e-6), "{structure}, {samples}: {warm} and {cold}");
        }
    }
}
