//! A record optimised as a whole: heat from two burners, of which the second is cheaper and limited.
//!
//!     cargo run --release -p dynocal --example optimise

use std::error::Error;

use dynocal::calib::optimise::model::OutputModel;
use dynocal::calib::optimise::{OptimiseOptions, optimise_models};
use dynocal::calib::problem::CalibrationProblem;
use dynocal::prelude::*;

const PROBLEM: &str = r#"
inputs = [
    { name = "a", unit = "kW", lower = 0.0, upper = 9.0 },
    { name = "b", unit = "kW", lower = 0.0, upper = 2.0 },
]
demands = [{ output = "heat", unit = "kW", lower = 0.0, upper = 11.0 }]
minimise = [{ channel = "a", weight = 2.0 }, { channel = "b", weight = 1.0 }]
"#;

fn main() -> Result<(), Box<dyn Error>> {
    let problem: CalibrationProblem = toml::from_str(PROBLEM)?;
    // heat(t) = 0.5 a(t-1) + 0.5 b(t-1) + 0.5 heat(t-1)
    let heat = PolyNarx::parse(&["a", "b"], "heat", &["a(t-1)", "b(t-1)", "heat(t-1)"])?;
    let model = OutputModel::plain("heat", &heat, &[0.5, 0.5, 0.5], &["a", "b"]);
    let channel =
        |name: &str, role, v| Channel { name: name.into(), unit: "kW".into(), role, values: vec![v; 50] };
    let start = Dataset {
        name: "start".into(),
        sample_time_s: 1.0,
        channels: vec![
            channel("a", Role::Input, 4.0),
            channel("b", Role::Input, 1.0),
            channel("heat", Role::Output, 5.0),
        ],
        init_samples: 0,
        origin: "example".into(),
    };
    let found = optimise_models(&problem, &[model], &start, &OptimiseOptions::default(), &|| false)?;
    println!("{:?}: cost {:.4} instead of {:.4}", found.status, found.objective, found.start_objective);
    for v in &found.violations {
        println!("{}: largest violation {:.1e} {}", v.channel, v.largest, v.unit);
    }
    Ok(())
}
