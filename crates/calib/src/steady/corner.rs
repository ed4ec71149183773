//! Over which place the bed goes to a point.
//!
//! Along a straight way all factors change together: half way from an early spark at light load to a late one at full load the load is high
//! and the spark is early still. A calibrator changes the settings first and the load then, or the other way round.
//!
//! ```text
//! candidates   straight;  free inputs first, axes then;  axes first, free inputs then;  the leading demand last;  the leading demand first
//! worst(way)   max over places x along it and limits l of outputs of  max(0, f_l(x) + z sd_l(x) - limit_l) / scale_l
//!              (z = 0 where the limit is kept in the mean only)
//! ```
//!
//! The way with the least `worst` is taken, the straight one where that passes no more than its ends do. A loop whose input comes to an end of its
//! range on the way harms nothing, and is not looked at.

use super::cell::Setting;
use super::layout::{Layout, ResponseSource};
use dynocal_numerics::status::Status;

/// Places that are looked at along each straight part.
const PLACES: usize = 8;
/// By how much less a limit has to be passed for a corner, in its scale: less is not worth a longer way.
const WORTH: f64 = 0.02;

/// The corner of the way between two settings; none where the straight one is as good. Limits are those of `setting`, whose models are those of
/// the responses of `layout`.
pub fn corner(setting: &Setting, layout: &Layout, from: &[f64], to: &[f64]) -> Option<Vec<f64>> {
    // Behind the responses with a model there may be others.
    let modelled: Vec<_> = layout.responses.iter().filter(|r| !r.slow).collect();
    let watched = |k: &usize| {
        let response = modelled.get(setting.sides[*k].response);
        response.is_some_and(|r| r.source == ResponseSource::Output)
    };
    let watched: Vec<usize> = (0..setting.sides.len()).filter(watched).collect();
    let passed = |x: &[f64]| {
        let at = setting.judge(x, Status::Stalled, None);
        let each = watched.iter().map(|k| at.prices[*k].passed / setting.sides[*k].scale);
        // What is no number is no room.
        each.map(|p| if p.is_nan() { f64::INFINITY } else { p }).fold(0.0, f64::max)
    };
    let along = |a: &[f64], b: &[f64]| {
        let place = |n: usize| -> Vec<f64> {
            let s = n as f64 / PLACES as f64;
            a.iter().zip(b).map(|(a, b)| a + s * (b - a)).collect()
        };
        (1..PLACES).map(|n| passed(&place(n))).fold(0.0, f64::max)
    };
    let ends = passed(from).max(passed(to));
    let straight = along(from, to);
    if straight <= ends + WORTH {
        return None;
    }
    let mix = |first: &dyn Fn(usize) -> bool| -> Vec<f64> {
        (0..from.len()).map(|k| if first(k) { to[k] } else { from[k] }).collect()
    };
    let mut corners = vec![mix(&|k| k >= setting.axes), mix(&|k| k < setting.axes)];
    if let Some((demand, _)) = layout.leading_demand().filter(|_| setting.axes > 1) {
        corners.extend([mix(&|k| k != demand), mix(&|k| k == demand)]);
    }
    let mut best = (straight - WORTH, None);
    for c in corners {
        let worst = along(from, &c).max(passed(&c)).max(along(&c, to)).max(ends);
        if worst < best.0 {
            best = (worst, Some(c));
        }
    }
    best.1
}
