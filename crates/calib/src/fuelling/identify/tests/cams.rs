//! Cams.

use super::*;
use crate::fuelling::{CamBends, CamLaw};

/// Cams that are behind their schedule while the pressure moves: what they do to the charge is found, and where they do nothing,
/// nothing is found.
#[test]
fn cams_behind_their_schedule_move_the_charge() {
    let plain = truth();
    let base = record(&plain, 40);
    let rest_deg = [vec![10.0, 15.0, 3.0, 0.0, 0.0, 0.0], vec![-5.0, 6.0, -4.0, 0.0, 0.0, 0.0]];
    let mut places = [Vec::new(), Vec::new()];
    for (k, place) in places.iter_mut().enumerate() {
        let mut at = None;
        for (n, p) in base[0].iter().zip(&base[3]) {
            let [n, p] = plain.charge.scaled(*n, *p);
            let goal = rest_deg[k][0] + rest_deg[k][1] * p + rest_deg[k][2] * n;
            let now = at.get_or_insert(goal);
            *now += DT / 0.3 * (goal - *now);
            place.push(*now);
        }
    }
    let law = CamLaw {
        rest_deg,
        most_deg: [40.0; 2],
        per_deg: [-0.006, 0.002],
        per_deg_pressure: [0.002, 0.0],
        bends: None,
    };
    let cams_deg = Some([places[0].as_slice(), &places[1]]);
    let made = |f: &Fuelling| {
        let r = TransientRecord { cams_deg, ..view(&base) };
        let p = pressure(&r, f);
        let lambda = richness(&r, f, &p).iter().map(|v| 1.0 / v).collect();
        let [speed, throttle, injection, _, _] = base.clone();
        scattered([speed, throttle, injection, shown(&r, f), lambda])
    };
    let mut moved = plain.clone();
    moved.charge.cams = Some(law);
    let channels = made(&moved);
    let found = identify(&[TransientRecord { cams_deg, ..view(&channels) }], &|| false).unwrap();
    let blind = identify(&[view(&channels)], &|| false).unwrap();
    assert!(found.rms < 0.8 * blind.rms, "{} {}", found.rms, blind.rms);
    // Where the load has risen and the cams have not: both are as far from rest as they go together.
    let charge = |f: &Fuelling| f.air(0.0, Some([0.0, -9.0])).at(2000.0, 55.0);
    assert!((charge(&found) / charge(&moved) - 1.0).abs() < 0.01, "{} {}", charge(&found), charge(&moved));
    let channels = made(&plain);
    let found = identify(&[TransientRecord { cams_deg, ..view(&channels) }], &|| false).unwrap();
    assert_eq!(found.charge.cams, None);
}

/// Cams that are moved whatever the load, as they are in a test that excites everything: they rest nowhere, and what they do has a
/// greatest place, changes with the speed, and depends on the other cam.
#[test]
fn cams_moved_at_will_bend_the_charge() {
    let plain = truth();
    let base = record(&plain, 60);
    let mut rng = Rng64::stream(11, 0);
    let mut places = [Vec::new(), Vec::new()];
    for t in 0..base[0].len() {
        for place in &mut places {
            let now = if t % 300 == 0 { rng.uniform_in(215.0, 255.0) } else { place[t - 1] };
            place.push(now);
        }
    }
    let law = CamLaw {
        rest_deg: [0, 1].map(|_| vec![235.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        most_deg: [20.0; 2],
        per_deg: [-0.005, 0.002],
        per_deg_pressure: [0.002, 0.001],
        bends: Some(CamBends { per_deg_speed: [0.002, 0.0], per_deg2: [-2e-4, -1e-4], both: 1e-4 }),
    };
    let cams_deg = Some([places[0].as_slice(), &places[1]]);
    let mut moved = plain;
    moved.charge.cams = Some(law);
    let r = TransientRecord { cams_deg, ..view(&base) };
    let p = pressure(&r, &moved);
    let lambda = richness(&r, &moved, &p).iter().map(|v| 1.0 / v).collect();
    let [speed, throttle, injection, _, _] = base.clone();
    let channels = scattered([speed, throttle, injection, shown(&r, &moved), lambda]);
    let found = identify(&[TransientRecord { cams_deg, ..view(&channels) }], &|| false).unwrap();
    let law = found.charge.cams.as_ref().unwrap();
    assert!(law.bends.is_some(), "{law:?}");
    // Where the record came to rest, with cams of other rests.
    let ends: Vec<usize> = (0..60).map(|k| 300 * k + 299).collect();
    let mut squares = 0.0;
    for (here, there) in ends.iter().zip(ends.iter().cycle().skip(7)) {
        let cams = [places[0][*there], places[1][*there]];
        let charge = |f: &Fuelling| f.air(0.0, Some(cams)).at(channels[0][*here], channels[3][*here]);
        squares += (charge(&found) / charge(&moved) - 1.0).powi(2) / 60.0;
    }
    assert!(squares.sqrt() < 0.01, "{}: {law:?}", squares.sqrt());
}
