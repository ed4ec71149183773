//! Parts that a parameter set has not got do not act, and parts that only observe do not act back: what is done for the boosted
//! sets cannot move the `thesis` set. That this set is right is the matter of `reference.rs` (another implementation's numbers).

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;

/// Bits of the gas, of the gas temperatures and of the outputs after each of some steps of the inputs.
fn run(params: &EngineParams, change: impl Fn(Inputs) -> Inputs) -> Vec<u64> {
    let mut e = VirtualEngine::new(params).unwrap();
    let base = Inputs::default();
    let steps = [
        base,
        Inputs { throttle_deg: 24.0, injection_mg: 24.0, ..base },
        Inputs { speed_rpm: 3200.0, spark_deg: 31.0, ..base },
        Inputs { speed_rpm: 1100.0, injection_mg: 11.0, throttle_deg: 8.0, ..base },
        Inputs { intake_mop_deg_btdc: 245.3, exhaust_mop_deg_atdc: 249.1, wiebe_m: 2.6, ..base },
        Inputs { injection_mg: 0.0, ..base },
    ];
    let mut bits = Vec::new();
    for inputs in steps {
        e.set_inputs(change(inputs)).unwrap();
        e.advance_time(0.2);
        let (y, g) = (e.outputs(), &e.state().gas);
        let mut take = |values: &[f64]| bits.extend(values.iter().map(|v| v.to_bits()));
        g.mass_kg.iter().for_each(|m| take(m));
        take(&g.energy_j);
        take(&e.state().t_k);
        take(&[y.torque_nm, y.lambda, y.map_kpa, y.exhaust_kpa, y.egt_k, y.air_g_s, y.imep_bar, y.pmep_bar]);
        take(&[y.fmep_bar, y.pmax_bar, y.ca50_deg, y.burn_deg, y.residual, y.bsfc_g_kwh]);
    }
    bits
}

#[test]
fn a_valve_without_its_path_is_refused() {
    let p = EngineParams::thesis();
    assert!(p.turbocharger.is_none() && p.egr.is_none() && p.knock.is_none() && p.emissions.is_none());
    let mut e = VirtualEngine::new(&p).unwrap();
    let refused = e.set_inputs(Inputs { egr_mm: 5.0, ..Inputs::default() }).unwrap_err();
    assert!(refused.to_string().contains("egr"), "{refused}");
    // The comparison of the other test sees what acts.
    let own = run(&p, |u| u);
    assert!(own != run(&p, |u| Inputs { spark_deg: u.spark_deg + 1e-6, ..u }));
}

#[test]
fn knock_and_emissions_only_observe() {
    let thesis = EngineParams::thesis();
    let boosted = EngineParams::named("gtdi_2l").unwrap();
    let own = run(&thesis, |u| u);
    let knock = EngineParams { knock: boosted.knock, ..thesis.clone() };
    assert!(knock.knock.is_some());
    assert!(own == run(&knock, |u| u), "knock acts back");
    let emissions = EngineParams { emissions: boosted.emissions, ..thesis.clone() };
    assert!(emissions.emissions.is_some());
    assert!(own == run(&emissions, |u| u), "emissions act back");
}
