//! Stepping, sampling and setting inputs never allocate.

use dynocal_ident::plant::Plant;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::sensors::NoiseLevels;
use dynocal_plant::testbed::dynamometer::{DynoMode, DynoSettings};
use dynocal_plant::testbed::settings::BedOptions;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;

#[global_allocator]
static COUNTER: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

// One test only: the counter is global to the process.
#[test]
fn no_allocation_while_stepping() {
    let mut engine = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    // With turbocharger, dissociation, knock, emissions and recirculation.
    let mut boosted = VirtualEngine::new(&EngineParams::named("gtdi_2l").unwrap()).unwrap();
    let settings =
        BedSettings { noise: NoiseLevels { torque_nm: 1.0, lambda: 0.01 }, ..BedSettings::default() };
    let mut bed = EngineBed::new(&EngineParams::thesis(), settings).unwrap();
    // Everything that moves on a bed, under load.
    let options = BedOptions {
        dynamometer: DynoSettings { mode: DynoMode::Load, ..DynoSettings::default() },
        ..BedOptions::real()
    };
    let mut real =
        EngineBed::new(&EngineParams::thesis(), BedSettings { options, ..BedSettings::default() }).unwrap();
    let mut y = [0.0; 5];
    let region = Region::new(COUNTER);
    let mut torque = 0.0;
    for i in 0..40 {
        let speed_rpm = 1000.0 + 100.0 * f64::from(i);
        engine.set_inputs(Inputs { speed_rpm, ..Inputs::default() }).unwrap();
        engine.advance_time(0.01);
        torque += engine.outputs().torque_nm;
        let injection_mg = 1.5 * f64::from(i);
        boosted.set_inputs(Inputs { speed_rpm, injection_mg, egr_mm: 3.0, ..Inputs::default() }).unwrap();
        boosted.advance_time(0.02);
        torque += boosted.outputs().no_ppm;
        bed.step(&[15.0, 20.0, 14.0, 2000.0], 0.03, &mut y).unwrap();
        real.step(&[16.7, 19.0, 15.85, 68.0], 0.03, &mut y).unwrap();
    }
    let change = region.change();
    assert_eq!((change.allocations, change.reallocations), (0, 0), "{change:?}");
    assert!(torque.is_finite());
    // The counter itself works: a vector is seen.
    let region = Region::new(COUNTER);
    let v = std::hint::black_box(vec![torque; 100]);
    assert!(region.change().allocations >= 1 && v.len() == 100);
}
