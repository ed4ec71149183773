//! Points of a boosted engine where what holds the torque changes from one actuator, or one limit, to another: they come to rest as well.

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::full_load::{Barrier, LoadLimits, LoadRequest, hold_load};
use dynocal_plant::params::EngineParams;

fn request(speed_rpm: f64, torque_nm: f64) -> LoadRequest {
    LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits: LoadLimits::default() }
}

/// A throttle that is nearly open moves little, and so does a wastegate without boost.
#[test]
fn points_between_throttle_and_wastegate_rest() {
    for set in ["gtdi_2l", "twin_2l", "other_1_8l"] {
        let params = EngineParams::named(set).expect("a set");
        let speed_rpm = 1500.0;
        {
            let mut engine = VirtualEngine::new(&params).expect("an engine");
            // The torque of an open throttle, and steps of 2.5 Nm about it.
            let open = (0..40)
                .map(|k| 130.0 + 5.0 * f64::from(k))
                .find(|t| {
                    let point = hold_load(&mut engine, request(speed_rpm, *t)).expect("a point");
                    assert!(point.settled, "{set}, {speed_rpm} rpm, {t} Nm: {} s", point.time_s);
                    point.inputs.wastegate_mm < 27.9
                })
                .expect("a torque with boost");
            for torque_nm in [open - 2.5, open - 5.0, open + 2.5] {
                let point = hold_load(&mut engine, request(speed_rpm, torque_nm)).expect("a point");
                assert!(point.settled && point.reached, "{set}, {speed_rpm} rpm, {torque_nm} Nm: {point:?}");
            }
        }
    }
}

/// Where the mixture is at its richest the load gives way to the exhaust, without a swing between both.
#[test]
fn a_full_load_that_gives_way_to_heat_rests() {
    let params = EngineParams::named("twin_2l").expect("a set");
    let mut engine = VirtualEngine::new(&params).expect("an engine");
    let point = hold_load(&mut engine, request(3500.0, 366.0)).expect("a point");
    assert!(point.settled && point.barrier == Some(Barrier::Mixture), "{point:?}");
    assert!((point.outputs.egt_k - point.request.limits.egt_k).abs() < 3.0, "{point:?}");
}

/// `thesis` grows hotter by rich mixture: the controller notices and holds the temperature by the load alone.
#[test]
fn a_set_that_rich_mixture_does_not_cool_is_not_enriched() {
    let mut engine = VirtualEngine::new(&EngineParams::thesis()).expect("an engine");
    let limits = LoadLimits { egt_k: 850.0 + 273.15, ..LoadLimits::default() };
    let full = LoadRequest { limits, ..request(5000.0, 366.0) };
    let point = hold_load(&mut engine, full).expect("a point");
    assert!(point.settled && point.barrier == Some(Barrier::Heat) && point.lambda == 1.0, "{point:?}");
    assert!((point.outputs.egt_k - limits.egt_k).abs() < 3.0, "{point:?}");
    // As much torque as the same limit leaves where nothing may be enriched at all.
    let never = LoadLimits { least_lambda: 1.0, ..limits };
    let mut engine = VirtualEngine::new(&EngineParams::thesis()).expect("an engine");
    let lean = hold_load(&mut engine, LoadRequest { limits: never, ..full }).expect("a point");
    let (a, b) = (point.outputs.torque_nm, lean.outputs.torque_nm);
    assert!((a - b).abs() < 1.0, "{a} Nm and {b} Nm");
}
