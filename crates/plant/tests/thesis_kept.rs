//! The parameter set `thesis` gives what it always gave, to the last bit.
//!
//! What the thesis prints is reproduced with this set, and the reference numbers of several crates were taken from it. Work
//! on the boosted sets must not move it: not by a reordered sum, not by a branch that adds a zero. This test keeps the state
//! and the outputs after a short run through steps of every input that the set knows. The numbers are this engine's own (no
//! outside reference has sixteen digits), so a change here says that the set has moved, not that it is wrong. They hold where
//! the elementary functions of the platform round as glibc does on x86-64.

#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;

/// FNV-1a over the bits of numbers.
struct Digest(u64);

impl Digest {
    fn take(&mut self, values: &[f64]) {
        for byte in values.iter().flat_map(|v| v.to_bits().to_le_bytes()) {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

#[test]
fn thesis_is_kept_bit_for_bit() {
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let base = Inputs::default();
    let steps = [
        base,
        Inputs { throttle_deg: 24.0, injection_mg: 24.0, ..base },
        Inputs { speed_rpm: 3200.0, spark_deg: 31.0, ..base },
        Inputs { speed_rpm: 1100.0, injection_mg: 11.0, throttle_deg: 8.0, ..base },
        Inputs { intake_mop_deg_btdc: 245.3, exhaust_mop_deg_atdc: 249.1, wiebe_m: 2.6, ..base },
        Inputs { wastegate_mm: 12.0, burn_duration_deg: Some(30.0), ..base },
        Inputs { injection_mg: 0.0, ..base },
    ];
    let mut digest = Digest(0xcbf2_9ce4_8422_2325);
    let mut torque = Vec::new();
    for inputs in steps {
        e.set_inputs(inputs).unwrap();
        e.advance_time(0.3);
        let (y, g) = (e.outputs(), &e.state().gas);
        torque.push(y.torque_cycle_nm);
        g.mass_kg.iter().for_each(|m| digest.take(m));
        digest.take(&g.energy_j);
        digest.take(&e.state().t_k);
        let parts =
            [y.torque_nm, y.lambda, y.map_kpa, y.exhaust_kpa, y.egt_k, y.air_g_s, y.imep_bar, y.pmep_bar];
        digest.take(&parts);
        digest.take(&[y.fmep_bar, y.pmax_bar, y.ca50_deg, y.burn_deg, y.residual, y.bsfc_g_kwh]);
    }
    assert_eq!(format!("{:016x}", digest.0), "14b44352c97fa272", "torque of the steps {torque:?} Nm");
}
