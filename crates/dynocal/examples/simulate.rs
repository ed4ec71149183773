//! A stored model on new inputs, without measured outputs.
//!
//!     cargo run --release -p dynocal --example simulate

use std::error::Error;

use dynocal::ident::stored::{Quantity, StoredModel};
use dynocal::prelude::*;

fn main() -> Result<(), Box<dyn Error>> {
    // torque(t) = 2 inj(t-1) + 0.5 torque(t-1): as `dynocal identify` writes it, or made here.
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    let structure = PolyNarx::parse(&["inj"], "torque", &["inj(t-1)", "torque(t-1)"])?;
    let model = StoredModel::new(
        structure,
        &[2.0, 0.5],
        vec![quantity("inj", "mg")],
        quantity("torque", "Nm"),
        0.03,
    )?;

    let keys = "lo = 5.0\nhi = 30.0\nhold_s = 0.3".parse()?;
    let mut inj = vec![0.0; 200];
    signal("aprbs", &keys)?.fill(&mut inj, 0.03, &mut Rng64::new(1))?;
    let record = Dataset {
        name: "new inputs".into(),
        sample_time_s: 0.03,
        channels: vec![Channel { name: "inj".into(), unit: "mg".into(), role: Role::Input, values: inj }],
        init_samples: 0,
        origin: "example".into(),
    };
    for computed in model.simulate(&record, None)? {
        let most = computed.y.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        println!("{}: {} samples, at most {most:.2} Nm", computed.record, computed.y.len());
    }
    Ok(())
}
