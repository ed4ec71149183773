//! Points out of reach and the other set, as the study `engine` shows them.

use dynocal_plant::full_load::Barrier;
use dynocal_studies::engine::other::{carried_over, differences};
use dynocal_studies::engine::reach::beyond;

#[test]
fn a_point_out_of_reach_names_what_stands_in_its_way_and_moving_that_sets_torque_free() {
    for (set, speed_rpm, torque_nm, barrier) in [
        ("thesis", 2000.0, 200.0, Barrier::ThrottleOpen),
        ("gtdi_2l", 1250.0, 320.0, Barrier::Surge),
        ("gtdi_2l", 2000.0, 420.0, Barrier::IntakePressure),
        ("gtdi_2l", 2000.0, -60.0, Barrier::ThrottleClosed),
    ] {
        let found = beyond(set, speed_rpm, torque_nm).unwrap();
        assert_eq!(found.barrier, Some(barrier), "{found:?}");
        assert!(found.borne_out && found.said, "{found:?}");
    }
    // A point within reach has no reason, and none is made up.
    let held = beyond("gtdi_2l", 2000.0, 200.0).unwrap();
    assert!(held.barrier.is_none() && !held.said, "{held:?}");
}

#[test]
fn the_other_set_has_another_burn_law_heat_law_timing_bore_sensors_and_fuel() {
    let all = differences().unwrap();
    for what in ["burn law", "heat law", "valve timing", "bore", "lag", "fuel"] {
        assert!(all.iter().any(|d| d.what.starts_with(what)), "{what} is the same: {all:?}");
    }
    // It burns otherwise by more than constants that are moved by a fifth make it, and what is tuned on one engine is off on it.
    let (other, moved) = (carried_over("other_1_8l").unwrap(), carried_over("perturbed:gtdi_2l:1").unwrap());
    assert!(other.burn_pct > 20.0 && other.burn_pct > 1.5 * moved.burn_pct, "{other:?} {moved:?}");
    assert!(other.torque_pct > 5.0 && other.lambda_pct > 2.0, "{other:?}");
}
