//! The search for the spark of least fuel at the early end of its range.

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::{SPARKS_DEG, SettleOptions, Target, best_spark, settle, spark_guess_deg};

/// Slow burn at light load asks for a spark near the end of the range or beyond: the search stays inside and finds the better side.
#[test]
fn it_stays_inside_of_the_range_and_is_no_worse_than_sparks_beside_it() {
    let options = SettleOptions { cams: true, ..SettleOptions::default() };
    for (set, speed_rpm, torque_nm) in
        [("twin_2l", 2000.0, 30.0), ("gtdi_2l", 2000.0, -5.0), ("gtdi_2l", 6000.0, 10.0)]
    {
        let mut engine = VirtualEngine::new(&EngineParams::named(set).expect("a set")).expect("an engine");
        let target = Target { speed_rpm, torque_nm, lambda: 1.0 };
        let guess = spark_guess_deg(speed_rpm, torque_nm);
        let best = best_spark(&mut engine, target, guess, options).expect("a point");
        let spark_deg = best.inputs.spark_deg;
        assert!((SPARKS_DEG.0..=SPARKS_DEG.1).contains(&spark_deg), "{set}: {spark_deg} deg");
        assert!((best.outputs.torque_cycle_nm - torque_nm).abs() < 0.01, "{set}: {best:?}");
        for beside in [spark_deg - 6.0, spark_deg + 6.0].into_iter().filter(|s| *s <= SPARKS_DEG.1) {
            let there = settle(&mut engine, target, beside, options).expect("a point").inputs.injection_mg;
            let here = best.inputs.injection_mg;
            assert!(there > here, "{set}: {here} mg at {spark_deg} deg, {there} mg at {beside} deg");
        }
    }
}
